//! Tests that each recorded run stays in its kind of scene once that has begun.

use std::path::PathBuf;

use cycles::kinds::KINDS;
use taxel::finger::Finger;
use taxel::frame::Status;
use taxel_files::trace::TraceReader;

use crate::support::repository;

fn whole() -> PathBuf {
    repository().join("host-tools/emulator/data/whole")
}

#[test]
fn run_keeps_its_kind_of_scene() {
    let record = taxel_files::calibration::read(whole().join("finger.cal.toml")).unwrap();
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
    for kind in KINDS {
        let path = whole().join(kind.name.replace(' ', "-")).with_extension("csv");
        let mut state = finger.restarted();
        let statuses: Vec<Status> = TraceReader::open(&path)
            .unwrap()
            .map(|sample| finger.estimate(&mut state, &sample.unwrap().scan).status)
            .collect();
        let of_kind: Vec<_> = statuses.iter().skip_while(|status| !kind.holds(**status)).collect();
        assert!(of_kind.len() >= 32, "{}: {} scans", kind.name, of_kind.len());
        assert!(of_kind.iter().all(|status| kind.holds(**status)), "{}: {statuses:?}", kind.name);
        // Every run uses temperature compensation, and every contact the slip detector.
        let all = if kind.name == "no contact" { Status(0) } else { Status::RAN_SLIP };
        let all = all | Status::RAN_WARMTH | Status::RAN_SENSORS;
        assert!(of_kind.iter().all(|status| status.contains(all)), "{}: {statuses:?}", kind.name);
    }
}
