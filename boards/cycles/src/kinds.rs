//! Kinds of scene, each recognised by the estimators that run.

use taxel::frame::Status;

/// Kind of scene.
pub struct Kind {
    /// Name of the kind.
    pub name: &'static str,
    /// Stage that measures the kind.
    pub stage: &'static str,
    /// Status bits that are set.
    with: Status,
    /// Status bits that are not set.
    without: Status,
}

/// All kinds, the cheapest first.
pub const KINDS: [Kind; 4] = [
    Kind {
        name: "no contact",
        stage: "finger: no contact, estimates",
        with: Status::RAN_SENSORS,
        without: Status::CONTACT,
    },
    Kind {
        name: "normal contact",
        stage: "finger: normal contact, estimates",
        with: Status::RAN_MODEL,
        without: Status::RAN_SHEAR,
    },
    Kind {
        name: "shear",
        stage: "finger: shear, estimates",
        with: Status::RAN_SHEAR,
        without: Status::RAN_PAIR,
    },
    Kind {
        name: "two contacts",
        stage: "finger: two contacts, estimates",
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
