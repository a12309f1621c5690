//! The kinds of scene that the finger tells apart, each by the estimators that it runs.

use taxel::frame::Status;

/// A kind of scene.
pub struct Kind {
    /// What it is called.
    pub name: &'static str,
    /// The stage that measures it.
    pub stage: &'static str,
    /// What ran, or holds …
    with: Status,
    /// … and what does not.
    without: Status,
}

/// All of them, the cheapest first.
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
    /// A scan with this status is of the kind.
    #[must_use]
    pub fn holds(&self, status: Status) -> bool {
        status.contains(self.with) && !status.intersects(self.without)
    }
}
