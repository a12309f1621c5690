//! Erasures of the finger's flash: their count, and the second between two of them.

use super::wire::Reader;
use super::{Expected, Model};

/// Knowledge that a host has of the erasures.
#[derive(Clone, Default)]
pub(super) struct Flash {
    /// Erasures for calibrations, and as many of them as a restart finds.
    calibration: u64,
    found: u64,
    /// Erasures for settings and biases that Health told of last, and saves since. A save of what
    /// is stored already erases nothing.
    settings: u64,
    saves: u64,
    /// Scans before the last certain erasure at least, and before the last possible one at most.
    certain: Option<u64>,
    possible: Option<u64>,
}

impl Flash {
    /// Notes an accepted request, after `told` scans at least and `most` at most, of which there
    /// were `second` in a second until then.
    pub fn note(&mut self, command: u8, [told, most]: [u64; 2], second: u64) {
        match command {
            9 => {
                self.calibration += 1;
                (self.certain, self.possible) = (Some(told), Some(most));
            }
            11 => self.found = self.calibration,
            13 | 14 => {
                self.saves += 1;
                self.possible = Some(most);
            }
            // Another rate of the scan begins the second again, if it has not passed.
            18 => {
                self.certain = self.certain.filter(|at| most < at + second).map(|_| told);
                self.possible = self.possible.filter(|at| told < at + second).map(|_| most);
            }
            _ => {}
        }
    }

    /// Takes the power away and gives it back.
    pub fn restart(&mut self) {
        (self.calibration, self.certain, self.possible) = (self.found, None, None);
    }

    /// Whether the two numbers of a Health are right.
    pub fn agrees(&mut self, numbers: &[u8]) -> bool {
        let mut rest = Reader(numbers);
        let (Some(calibration), Some(settings)) = (rest.number(32), rest.number(32)) else {
            return false;
        };
        let may = self.settings..=self.settings + self.saves;
        if calibration != self.calibration || !may.contains(&settings) || !rest.0.is_empty() {
            return false;
        }
        (self.settings, self.saves) = (settings, 0);
        true
    }
}

impl Model {
    /// Reply to a request that erases flash: Busy, `otherwise`, or either where only the scans
    /// decide, of which there were so many at most.
    pub(super) fn paced(&self, tag: u8, most: u64, otherwise: Expected) -> Expected {
        let within = |since: Option<u64>, scans| since.is_some_and(|at| scans < at + self.scan_hz);
        if self.lossless || !within(self.flash.possible, self.scans) {
            return otherwise;
        }
        let busy = vec![1, tag, 1, 2];
        if within(self.flash.certain, most) {
            return Expected::Message(busy);
        }
        Expected::Either(busy, Box::new(otherwise))
    }
}
