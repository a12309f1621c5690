//! Stages of a finger with everything a default fit writes, one for each kind of scene.
//!
//! They measure the path from codes to wire bytes at 4 kHz, from the first scan of the kind on. A
//! frame is due in every scan, in every fourth (`frames at 1 kHz`), or in none.

use taxel::frame::Fields;
use taxel::scan::Scan;
use taxel::units::Micros;
use taxel::wire::message::Command;

use super::frame::{Packet, instrument, whole};
use crate::Meter;
use crate::host::{Whole, scans};
use crate::kinds::{KINDS, Kind, PERIOD, UNTOUCHED};

/// Scans without contact, then the run.
fn scene<'a>(nothing: &'a [u8], run: &'a [u8]) -> impl Iterator<Item = Scan> + Clone + use<'a> {
    let untouched = scans(nothing).cycle().take(UNTOUCHED);
    let times = (0..).map(|i| Micros(PERIOD * i));
    untouched.chain(scans(run)).zip(times).map(|(scan, time)| Scan { time, ..scan })
}

/// Number of scans before the first one of the kind.
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
        // A run that is not of its kind has no stage, and its stage is missed in the report.
        let Some(before) = before(kind, inputs.record, scans.clone()) else { continue };
        for (stage, rate) in kind.stages {
            let asked = rate.map(|hz| Command::SetRate { hz });
            let mut instrument = instrument(inputs.record, Fields::ESTIMATES, asked);
            scans.clone().take(before).for_each(|scan| {
                instrument.scan(&scan);
            });
            meter.stage(stage, &mut instrument, scans.clone().skip(before), &mut packet, whole);
        }
    }
}
