//! Kinds of scene, each recognised by the estimators that run.

use taxel::frame::Status;

/// Time between two scans of the recorded runs, in microseconds.
pub const PERIOD: u64 = 250;
/// Scans without contact before a run, more than the vibration detector needs to learn its noise
/// floor.
pub const UNTOUCHED: usize = 880;

/// Kind of scene.
pub struct Kind {
    /// Name of the kind.
    pub name: &'static str,
    /// Stages that measure the kind, and their frames a second if not one in every scan.
    pub stages: [(&'static str, Option<u16>); 2],
    /// Status bits that are set.
    with: Status,
    /// Status bits that are not set.
    without: Status,
}

/// All kinds, the cheapest first.
pub const KINDS: [Kind; 4] = [
    Kind {
        name: "no contact",
        // The first frame is due long before the run is measured, the second one long after.
        stages: [
            ("finger: no contact, estimates", None),
            ("finger: no contact, no frame due", Some(1)),
        ],
        with: Status::RAN_SENSORS,
        without: Status::CONTACT,
    },
    Kind {
        name: "normal contact",
        stages: [
            ("finger: normal contact, estimates", None),
            ("finger: normal contact, frames at 1 kHz", Some(1000)),
        ],
        with: Status::RAN_MODEL,
        without: Status::RAN_SHEAR,
    },
    Kind {
        name: "shear",
        stages: [
            ("finger: shear, estimates", None),
            ("finger: shear, frames at 1 kHz", Some(1000)),
        ],
        with: Status::RAN_SHEAR,
        without: Status::RAN_PAIR,
    },
    Kind {
        name: "two contacts",
        stages: [
            ("finger: two contacts, estimates", None),
            ("finger: two contacts, frames at 1 kHz", Some(1000)),
        ],
        with: Status::RAN_PAIR,
        without: Status(0),
    },
];

impl Kind {
    /// Whether a scan with this status is of the kind.
    #[must_use]
    pub fn holds(&self, status: Status) -> bool {
        status.contains(self.with) && !status.intersects(self.without)
    }
}
