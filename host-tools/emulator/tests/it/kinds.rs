//! Tests that nine tenths of each recorded run are of its kind of scene once that has begun.

use cycles::kinds::{KINDS, PERIOD, UNTOUCHED};
use taxel::finger::Finger;
use taxel::frame::Status;
use taxel::scan::Scan;
use taxel::units::Micros;

use crate::load::{calibration, scans};

#[test]
fn run_keeps_its_kind_of_scene() {
    let record = calibration();
    let sections = [
        record.taxels.is_some(),
        record.net.is_some(),
        record.model.is_some(),
        record.array.is_some(),
        record.slip.is_some(),
        record.warmth.is_some(),
        record.lag.is_some(),
        record.drift.is_some(),
        record.sensors.iter().all(Option::is_some),
    ];
    assert_eq!(sections, [true; 9]);
    let finger = Finger::new(Some(record)).0;
    let nothing: Vec<Scan> = scans(&KINDS[0]).collect();
    // The filters follow in turns while nothing touches: a touch comes in any of these.
    for (kind, late) in KINDS.iter().flat_map(|kind| (0..12).map(move |late| (kind, late))) {
        let untouched = nothing.iter().cycle().copied().take(UNTOUCHED + late);
        let times = (0..).map(|i| Micros(PERIOD * i));
        let mut state = finger.restarted();
        let statuses: Vec<Status> = untouched
            .chain(scans(kind))
            .zip(times)
            .map(|(scan, time)| finger.estimate(&mut state, &Scan { time, ..scan }).status)
            .skip(UNTOUCHED + late)
            .collect();
        let of_kind: Vec<_> = statuses.iter().skip_while(|status| !kind.holds(**status)).collect();
        assert!(of_kind.len() >= 32, "{}: {} scans", kind.name, of_kind.len());
        // A contact that is let go needs less at its end.
        let others = of_kind.iter().filter(|status| !kind.holds(***status)).count();
        let most = if kind.name == "no contact" { 0 } else { of_kind.len() / 10 };
        assert!(others <= most, "{}, {late}: {others}, at most {most}", kind.name);
        // Every run uses temperature compensation, and every contact the slip detector.
        let all = if kind.name == "no contact" { Status(0) } else { Status::RAN_SLIP };
        let all = all | Status::RAN_WARMTH | Status::RAN_SENSORS;
        assert!(of_kind.iter().all(|status| status.contains(all)), "{}: {statuses:?}", kind.name);
    }
}
