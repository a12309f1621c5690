//! What can go wrong between a host and a finger, in one line each: the port, what happened, the mend.

use std::io;

use taxel::scan::ScanSetting;
use taxel::wire::message::{PROTOCOL, Refusal};

use crate::port::Port;

/// Something went wrong with a finger.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// Failure of a device in this process, such as a playback whose file is damaged.
    #[error(transparent)]
    Device(#[from] Box<dyn std::error::Error + Send + Sync>),
    /// With the port itself.
    #[error("{port}: {problem}")]
    Port {
        /// Which port.
        port: Port,
        /// What is the matter.
        problem: Problem,
    },
}

impl LinkError {
    /// Wraps the failure of a device in this process.
    pub fn device(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Device(Box::new(error))
    }

    /// What is the matter, where it is the port's matter.
    #[must_use]
    pub fn problem(&self) -> Option<&Problem> {
        match self {
            Self::Device(_) => None,
            Self::Port { problem, .. } => Some(problem),
        }
    }
}

/// What can be the matter with a port.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Problem {
    /// The operating system does not let this user at it.
    #[error(
        "permission denied; install the finger's udev rule (`taxel udev | sudo tee \
         /etc/udev/rules.d/70-taxel.rules`, then plug it in again), or join the group that owns the port \
         (`sudo usermod -aG dialout $USER`, then log in again)"
    )]
    Permission,
    /// Somebody else has it.
    #[error("busy; close the other program that has it open")]
    Busy,
    /// There is no such device.
    #[error("no such device; {0}")]
    Missing(String),
    /// Not one finger on USB, or not this one.
    #[error("{0}")]
    NoFinger(String),
    /// A file where a device was expected.
    #[error("a file, not a device; write `file:` before it to play it back")]
    NotADevice,
    /// A recording or a scene, which is not a device.
    #[error(
        "played by the `taxel` command only; run `taxel serve --port PORT --tcp HOST:PORT` with it, then open \
         tcp:HOST:PORT"
    )]
    NoDevice,
    /// Nobody listens at that address.
    #[error(
        "connection refused; check address and port, and that `taxel serve` or the serial server there is \
         running"
    )]
    Refused,
    /// The address leads nowhere.
    #[error("cannot be reached: {0}; check the address and the network")]
    Unreachable(String),
    /// Anything else that opening it brought.
    #[error("cannot be opened: {0}; is it the right port?")]
    Open(String),
    /// Nobody answers.
    #[error(
        "no answer within 2 s; is it a taxel finger, powered and running? It may also be in its \
         bootloader, or another program is connected to it"
    )]
    Silent,
    /// The other side speaks another protocol.
    #[error(
        "the finger (firmware {}.{}.{}) speaks protocol {theirs}, this program {PROTOCOL}; {}",
        .firmware[0], .firmware[1], .firmware[2],
        if *.theirs > PROTOCOL { "update this program" } else { "update the firmware" }
    )]
    Protocol {
        /// The finger's protocol version.
        theirs: u16,
        /// The finger's firmware version.
        firmware: [u8; 3],
    },
    /// The link broke off: the cable was pulled, the finger lost power, or its server went away.
    #[error("the finger is gone ({0}); check cable and power, then start again")]
    Unplugged(String),
    /// The trace or scene behind the port is over. For a playback this is how things end.
    #[error("the playback is over")]
    Ended,
    /// The finger did not do what it was asked.
    #[error("{command}: {}", refused(.refusal))]
    Refusal {
        /// What was asked.
        command: &'static str,
        /// Its reason.
        refusal: Refusal,
    },
    /// The finger answered something else.
    #[error(
        "{0}: the answer belongs to another question; is another program using the same finger?"
    )]
    Confused(&'static str),
    /// An upload did not come to its end.
    #[error("{why}; {in_force}")]
    Upload {
        /// What broke it off.
        why: Box<Problem>,
        /// What that leaves.
        in_force: InForce,
    },
    /// The user has had enough.
    #[error("stopped")]
    Stopped,
    /// A calibration came back other than it was sent.
    #[error("the calibration reads back differently from what was sent; upload it again")]
    ReadBack,
    /// This platform lacks it.
    #[error("not available on this operating system; use tcp:HOST:PORT")]
    Unsupported,
}

/// Which calibration is in force on a finger after an upload that was broken off. Whichever it is, it is whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InForce {
    /// The one before, or none if there was none.
    #[error("what was in force before stays; upload again")]
    Before,
    /// That of before or the new one: it was told to put the new one in force, and nothing came back.
    #[error(
        "either the calibration of before or the new one is in force, whole; upload again, or see which \
         with `taxel info`"
    )]
    Either,
    /// The new one.
    #[error(
        "the new calibration is in force, but was not read back; `taxel calibrate download` reads it"
    )]
    New,
}

impl Problem {
    /// As an error of `port`.
    #[must_use]
    pub fn at(self, port: &Port) -> LinkError {
        LinkError::Port { port: port.clone(), problem: self }
    }

    /// What the link said when it broke.
    pub(crate) fn broken(error: &io::Error) -> Self {
        Self::Unplugged(one_line(error))
    }
}

/// The text of an error on one line.
pub(crate) fn one_line(error: &dyn std::error::Error) -> String {
    let text = error.to_string();
    // The number that Rust appends to the system's own words helps nobody.
    let said = text.rfind(" (os error ").filter(|_| text.ends_with(')'));
    text[..said.unwrap_or(text.len())].split_whitespace().collect::<Vec<_>>().join(" ")
}

fn refused(refusal: &Refusal) -> String {
    match refusal {
        Refusal::OutOfRange { low, high } => format!("must lie in {low}…{high}"),
        Refusal::Saturated => {
            "a taxel is clipped, so that its unloaded level is not known; shade the finger or lower \
             its light, then try again"
                .to_owned()
        }
        Refusal::NotStill => {
            "refused, the finger moved meanwhile; the old bias stays, let go and try again".into()
        }
        Refusal::Busy => "refused, a bias is being taken or a self-test runs; wait for it".into(),
        Refusal::OutOfOrder => {
            "refused, bytes of the calibration were lost; the old one stays, upload again".into()
        }
        Refusal::Calibration(error) => {
            format!("refused, {error}; the old calibration stays")
        }
        Refusal::Storage => {
            "the finger's flash failed; what was stored before stays; try again, and replace the board \
             if it goes on"
                .into()
        }
        Refusal::Unsupported => "this board cannot do that".into(),
        Refusal::Scan { setting, low, high } => {
            let name = match setting {
                ScanSetting::ScanHz => "--scan",
                ScanSetting::Oversampling => "--oversampling",
                ScanSetting::SettleNs => "--settle in nanoseconds",
            };
            format!(
                "{name} must lie in {low}…{high} while the other two stay; the scan goes on as it was"
            )
        }
        Refusal::Uncalibrated => "the finger has no calibration; upload one".into(),
    }
}
