//! Self-test of the channels: mean and noise of each over a number of scans.
//!
//! The sums are integers, so that a small noise on a large code is not lost. Only the last step
//! rounds.

use serde::{Deserialize, Serialize};

use crate::math::sqrt;
use crate::scan::{COLS, Codes, Midpoints, ROWS, SENSORS};
use crate::units::{Code, FullScale};

/// Largest number of scans in a test: 4096 squares of 16 bits, times 4096, fit 64 bits.
pub const MOST_SCANS: u16 = 4096;

/// One value for every channel of the finger.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Channels<T> {
    /// Taxels with their row lit, `lit[row][column]`.
    pub lit: [[T; COLS]; ROWS],
    /// Columns with every LED off.
    pub dark: [T; COLS],
    /// Midpoints A … D of each sensor.
    pub bridges: [[T; 4]; SENSORS],
    /// The reference channel.
    pub reference: T,
    /// The temperature channel.
    pub temperature: T,
}

/// Statistics of one channel over a test, in codes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Channel {
    /// Mean code.
    pub mean: f32,
    /// Standard deviation of the codes.
    pub noise: f32,
}

/// Result of a self-test.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SelfTest {
    /// Number of scans.
    pub scans: u16,
    /// Full scale of the codes.
    pub full_scale: FullScale,
    /// Channels; `None` for those that the finger does not have.
    pub channels: Channels<Option<Channel>>,
    /// Whether the stored calibration is intact; `None` if there is none. False if the newest
    /// record was found damaged at power-up; an older one is then active, or none.
    pub record_intact: Option<bool>,
}

/// A self-test that is under way.
#[derive(Debug)]
pub struct Running {
    left: u16,
    scans: u16,
    /// Full scale of the last scan.
    full_scale: FullScale,
    sums: Channels<Sums>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    count: u16,
    sum: u32,
    squares: u64,
}

// Small rather than fast, because a test is rare and there are 38 channels.
impl Sums {
    #[inline(never)]
    fn add(&mut self, code: Option<Code>) {
        if let Some(Code(code)) = code {
            self.count += 1;
            self.sum += u32::from(code);
            self.squares += u64::from(code) * u64::from(code);
        }
    }

    /// Returns mean and noise; `None` for an absent channel.
    #[inline(never)]
    fn channel(&self) -> Option<Channel> {
        let count = u64::from(self.count);
        let pairs = count * count.saturating_sub(1);
        let spread = (count * self.squares).saturating_sub(u64::from(self.sum).pow(2));
        (count > 1).then(|| Channel {
            mean: self.sum as f32 / f32::from(self.count),
            noise: sqrt(spread as f32 / pairs as f32),
        })
    }
}

impl Running {
    /// Makes a test of so many scans, [`MOST_SCANS`] at most.
    #[must_use]
    pub fn over(scans: u16) -> Self {
        let scans = scans.min(MOST_SCANS);
        let full_scale = FullScale::BITS_16;
        Self { left: scans, scans, full_scale, sums: Channels::default() }
    }

    /// Adds a scan. Returns true when it was the last.
    // A cold function, because it must not slow the code of every scan.
    #[cold]
    #[inline(never)]
    pub fn scan(&mut self, codes: &Codes) -> bool {
        for (sums, code) in pairs(&mut self.sums, &read(codes)) {
            sums.add(*code);
        }
        self.full_scale = codes.full_scale;
        self.left = self.left.saturating_sub(1);
        self.is_over()
    }

    /// Returns whether the test has had all its scans.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.left == 0
    }

    /// Returns the result of the test.
    #[must_use]
    pub fn result(&self, record_intact: Option<bool>) -> SelfTest {
        let mut channels = Channels::default();
        for (channel, sums) in pairs(&mut channels, &self.sums) {
            *channel = sums.channel();
        }
        SelfTest { scans: self.scans, full_scale: self.full_scale, channels, record_intact }
    }
}

/// Returns the codes of a scan by channel.
fn read(codes: &Codes) -> Channels<Option<Code>> {
    let mut read = Channels {
        reference: codes.reference,
        temperature: codes.temperature,
        ..Channels::default()
    };
    if let Some(taxels) = &codes.taxels {
        read.lit = taxels.lit.map(|row| row.map(Some));
        read.dark = taxels.dark.map(Some);
    }
    for (read, midpoints) in read.bridges.iter_mut().zip(codes.bridges) {
        if let Some(Midpoints { a, b, c, d }) = midpoints {
            *read = [a, b, c, d].map(Some);
        }
    }
    read
}

fn pairs<'c, A, B>(
    to: &'c mut Channels<A>,
    from: &'c Channels<B>,
) -> impl Iterator<Item = (&'c mut A, &'c B)> {
    let to = (to.lit.as_flattened_mut().iter_mut())
        .chain(&mut to.dark)
        .chain(to.bridges.as_flattened_mut())
        .chain([&mut to.reference, &mut to.temperature]);
    let from = (from.lit.as_flattened().iter())
        .chain(&from.dark)
        .chain(from.bridges.as_flattened())
        .chain([&from.reference, &from.temperature]);
    to.zip(from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::TaxelCodes;

    fn codes(lit: u16, midpoint: u16) -> Codes {
        let midpoint = Code(midpoint);
        let sensor = Midpoints { a: midpoint, b: midpoint, c: midpoint, d: midpoint };
        Codes {
            full_scale: FullScale::BITS_16,
            taxels: Some(TaxelCodes { lit: [[Code(lit); COLS]; ROWS], dark: [Code(100); COLS] }),
            bridges: [Some(sensor), None, None, None],
            reference: Some(Code(30_000)),
            temperature: None,
        }
    }

    fn run(scans: u16, of: impl Fn(u16) -> Codes) -> Channels<Option<Channel>> {
        let mut running = Running::over(scans);
        for i in 1..scans {
            assert!(!running.scan(&of(i)));
        }
        assert!(running.scan(&of(0)), "that was the last");
        let test = running.result(None);
        assert_eq!((test.scans, test.full_scale), (scans, FullScale::BITS_16));
        test.channels
    }

    #[test]
    fn one_step_of_noise_on_highest_code_is_measured() {
        let channels = run(1000, |i| codes(65_534 + i % 2, 32_768));
        let taxel = channels.lit[3][2].unwrap();
        // Half of the codes one step higher: σ = ½ √(n / (n − 1)).
        assert!((taxel.noise - 0.500_25).abs() < 1e-5, "{}", taxel.noise);
        assert!((taxel.mean - 65_534.5).abs() < 0.01, "{}", taxel.mean);
        let quiet = Some(Channel { mean: 100.0, noise: 0.0 });
        assert_eq!(channels.dark, [quiet; 4]);
    }

    #[test]
    fn absent_channel_is_none() {
        let channels = run(10, |_| codes(1, 2));
        assert_eq!(channels.temperature, None);
        assert_eq!(channels.bridges[1], [None; 4]);
        assert!(channels.bridges[0][3].is_some() && channels.reference.is_some());
    }

    #[test]
    fn longest_test_does_not_overflow() {
        let channels = run(MOST_SCANS, |i| codes(if i % 2 == 0 { u16::MAX } else { 0 }, u16::MAX));
        let wild = channels.lit[0][0].unwrap();
        assert!((wild.noise - 32_771.5).abs() < 1.0, "{}", wild.noise);
        assert_eq!(channels.bridges[0][0].unwrap().noise, 0.0);
        assert_eq!(Running::over(u16::MAX).scans, MOST_SCANS);
    }
}
