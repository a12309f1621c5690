//! What a scan costs a finger that has everything a default fit writes, a stage for each kind of scene: the whole
//! way from codes to wire bytes, from the first scan on that is of the kind.

use taxel::frame::Fields;
use taxel::scan::Scan;
use taxel::units::Micros;

use super::frame::{Packet, instrument, whole};
use crate::Meter;
use crate::host::{Whole, scans};
use crate::kinds::{KINDS, Kind};

/// Between two scans, in microseconds: the runs' own rate.
const PERIOD: u64 = 1000;
/// Scans until the ear for vibration knows its floor, and more.
const UNTOUCHED: usize = 220;

/// Nothing for long enough, then the run.
fn scene<'a>(nothing: &'a [u8], run: &'a [u8]) -> impl Iterator<Item = Scan> + Clone + use<'a> {
    let untouched = scans(nothing).cycle().take(UNTOUCHED);
    let times = (0..).map(|i| Micros(PERIOD * i));
    untouched.chain(scans(run)).zip(times).map(|(scan, time)| Scan { time, ..scan })
}

/// How many scans come before the first of the kind.
fn before(kind: &Kind, record: &[u8], mut scans: impl Iterator<Item = Scan>) -> Option<usize> {
    let mut instrument = instrument(record, Fields::ESTIMATES, None);
    let mut number = 0..;
    scans.find_map(|scan| {
        instrument.scan(&scan);
        let holds = kind.holds(instrument.frame(&scan).status);
        number.next().filter(|number| holds && *number >= UNTOUCHED)
    })
}

pub fn stages(inputs: &Whole<'_>, meter: &mut impl Meter) {
    let [nothing, ..] = inputs.runs;
    let mut packet = Packet::EMPTY;
    for (kind, run) in KINDS.iter().zip(inputs.runs) {
        let scans = scene(nothing, run);
        // A run that is not of its kind has no stage, and whoever measures will miss it.
        let Some(before) = before(kind, inputs.record, scans.clone()) else { continue };
        let mut instrument = instrument(inputs.record, Fields::ESTIMATES, None);
        scans.clone().take(before).for_each(|scan| {
            instrument.scan(&scan);
        });
        meter.stage(kind.stage, &mut instrument, scans.skip(before), &mut packet, whole);
    }
}
