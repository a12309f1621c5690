//! Least sampling times of the ADC's sources.

use crate::board::Outcome;
use crate::board::finger::Source;
use crate::board::time::{Tick, nanos};

/// Sampling times in nanoseconds, and the largest impedances in ohms of a fast and a slow input
/// that they suffice for (DS12589 table 67); slow inputs cannot be sampled for the shortest.
const IMPEDANCES: [(u64, [f64; 2]); 8] = [
    (42, [100.0, -1.0]),
    (109, [330.0, 100.0]),
    (209, [680.0, 470.0]),
    (409, [1_500.0, 1_200.0]),
    (792, [2_200.0, 1_800.0]),
    (1_542, [4_700.0, 3_900.0]),
    (4_125, [12_000.0, 10_000.0]),
    (10_675, [39_000.0, 33_000.0]),
];
/// Highest input that is a fast one.
const FAST: u32 = 5;
/// Least sampling times in nanoseconds: temperature and reference (DS12589 tables 79, 24), and an
/// amplifier's output (table 88).
const TEMPERATURE_NS: u64 = 5_000;
const REFERENCE_NS: u64 = 4_000;
const AMPLIFIER_NS: u64 = 200;

/// Least sampling time of an input with this source, which has `ohm` on a pin.
pub fn least(input: u32, source: Source, ohm: f64) -> Outcome<Tick> {
    let ns = match source {
        Source::Temperature => TEMPERATURE_NS,
        Source::Reference => REFERENCE_NS,
        Source::Amplifier(_) => AMPLIFIER_NS,
        Source::Pin(_) => {
            let which = usize::from(input > FAST);
            let enough = IMPEDANCES.iter().find(|(_, most)| ohm <= most[which]);
            enough.ok_or_else(|| format!("a source of {ohm} ohms, which no time suffices for"))?.0
        }
    };
    Ok(nanos(ns))
}
