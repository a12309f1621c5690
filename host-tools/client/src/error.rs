//! Errors of a port and its finger, one line each: the port, what happened, the fix.

use std::io;

use taxel::scan::ScanSetting;
use taxel::wire::message::{PROTOCOL, Refusal};

use crate::port::Port;

/// Error of a client.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// Failure of a device in this process, such as a playback whose file is damaged.
    #[error(transparent)]
    Device(#[from] Box<dyn std::error::Error + Send + Sync>),
    /// Failure of the port or of the finger behind it.
    #[error("{port}: {problem}")]
    Port {
        /// Port as the user wrote it.
        port: Port,
        /// Cause.
        problem: Problem,
    },
}

impl LinkError {
    /// Wraps the failure of a device in this process.
    pub fn device(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Device(Box::new(error))
    }

    /// Cause, where the port or its finger failed.
    #[must_use]
    pub fn problem(&self) -> Option<&Problem> {
        match self {
            Self::Device(_) => None,
            Self::Port { problem, .. } => Some(problem),
        }
    }
}

/// Cause of a failure at a port.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Problem {
    /// The operating system denies this user access.
    #[error(
        "permission denied; install the finger's udev rule (`taxel udev | sudo tee \
         /etc/udev/rules.d/70-taxel.rules`, then plug it in again), or join the group that owns the port \
         (`sudo usermod -aG dialout $USER`, then log in again)"
    )]
    Permission,
    /// Another program has the port open.
    #[error("busy; close the other program that has it open")]
    Busy,
    /// No such device; the text lists those there are.
    #[error("no such device; {0}")]
    NoSuchDevice(String),
    /// No finger on USB, several, or not the one asked for.
    #[error("{0}")]
    NoFinger(String),
    /// File where a device was expected.
    #[error("a file, not a device; write `file:` in front of it to play it back")]
    NotADevice,
    /// Recording or scene, which has no device.
    #[error(
        "played by the `taxel` command only; run `taxel serve --port PORT --tcp HOST:PORT` with it, then open \
         tcp:HOST:PORT"
    )]
    NoDevice,
    /// Nothing listens at the address.
    #[error(
        "connection refused; check address and port, and that `taxel serve` or the serial server there is \
         running"
    )]
    Refused,
    /// The address cannot be resolved or reached.
    #[error("cannot be reached: {0}; check the address and the network")]
    Unreachable(String),
    /// Any other failure to open the port.
    #[error("cannot be opened: {0}; is it the right port?")]
    Open(String),
    /// The address of a virtual finger cannot be used.
    #[error(
        "cannot be served: {0}; choose another address with --tcp, as in 127.0.0.1:0 for any free port"
    )]
    Served(String),
    /// The finger does not answer.
    #[error(
        "no answer within 2 s; is it a taxel finger, powered and running? It may also be in its \
         bootloader, or another program is connected to it"
    )]
    NoReply,
    /// The finger speaks another version of the protocol.
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
    /// The link broke: cable pulled, power lost, or server stopped.
    #[error("the finger is gone ({0}); check cable and power, then start again")]
    Unplugged(String),
    /// The recording or scene behind the port has ended.
    #[error("the playback is over")]
    Ended,
    /// The finger refused a command.
    #[error("{command}: {}", refused(.refusal))]
    Refusal {
        /// Name of the command.
        command: &'static str,
        /// Reason the finger gave.
        refusal: Refusal,
    },
    /// The reply belongs to another request.
    #[error("{0}: the reply belongs to another request; is another program using the same finger?")]
    UnexpectedReply(&'static str),
    /// An upload did not complete.
    #[error("{why}; {active}")]
    Upload {
        /// Cause.
        why: Box<Problem>,
        /// Calibration that is active now.
        active: ActiveCalibration,
    },
    /// The caller stopped the upload.
    #[error("stopped")]
    Stopped,
    /// The calibration that was read back differs from the one sent.
    #[error("the calibration that was read back differs from the one sent; upload it again")]
    ReadBack,
    /// This operating system does not support it.
    #[error("not available on this operating system; use tcp:HOST:PORT")]
    Unsupported,
}

/// Calibration that is active after an interrupted upload. It is complete in every case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ActiveCalibration {
    /// Previous calibration, or none if there was none.
    #[error("the previous calibration stays active; upload again")]
    Previous,
    /// Previous or new calibration: the commit was sent, and no reply came.
    #[error(
        "the previous or the new calibration is active, complete in either case; upload again, or see which \
         with `taxel info`"
    )]
    Either,
    /// New calibration.
    #[error(
        "the new calibration is active, but was not read back; `taxel calibrate download` reads it"
    )]
    New,
}

impl Problem {
    /// Returns this cause as an error of `port`.
    #[must_use]
    pub fn at(self, port: &Port) -> LinkError {
        LinkError::Port { port: port.clone(), problem: self }
    }

    /// Cause of a link that broke with this error.
    pub(crate) fn broken(error: &io::Error) -> Self {
        Self::Unplugged(one_line(error))
    }
}

/// Text of an error on one line.
pub(crate) fn one_line(error: &dyn std::error::Error) -> String {
    let text = error.to_string();
    // Rust appends the system's error number, which does not help users.
    let said = text.rfind(" (os error ").filter(|_| text.ends_with(')'));
    text[..said.unwrap_or(text.len())].split_whitespace().collect::<Vec<_>>().join(" ")
}

fn refused(refusal: &Refusal) -> String {
    match refusal {
        Refusal::OutOfRange { low, high } => format!("must lie in {low}…{high}"),
        Refusal::Saturated => {
            "a taxel is clipped, so its unloaded level is unknown; shade the finger or lower its light, \
             then try again"
                .to_owned()
        }
        Refusal::NotStill => {
            "refused, the finger moved; the old bias stays; release the finger and try again".into()
        }
        Refusal::Busy => {
            "refused for now: a bias, a self-test or a save is under way; try again in a second"
                .to_owned()
        }
        Refusal::OutOfOrder => {
            "refused, bytes of the calibration were lost; the old one stays, upload again".into()
        }
        Refusal::Calibration(error) => {
            format!("refused, {error}; the old calibration stays")
        }
        Refusal::Storage => {
            "the finger's flash failed; what was stored stays; try again, and replace the board if it \
             fails again"
                .into()
        }
        Refusal::Unsupported => "this board cannot do that".into(),
        Refusal::Scan { setting, low, high } => {
            let within = format!("must lie in {low}…{high} with the other two settings as they are");
            let must = match setting {
                ScanSetting::ScanHz => format!(
                    "--scan {within}; fewer samples (--oversampling) or a shorter --settle allow more"
                ),
                ScanSetting::Oversampling => format!("--oversampling must be {}", powers(*low, *high)),
                ScanSetting::SettleNs => format!("--settle in nanoseconds {within}"),
            };
            format!("{must}; the scan is unchanged")
        }
        Refusal::Uncalibrated => "the finger has no calibration; upload one".into(),
    }
}

/// Lists the powers of two from `low` to `high`.
fn powers(low: u32, high: u32) -> String {
    let powers =
        (0..u32::BITS).map(|power| 1 << power).filter(|number| (low..=high).contains(number));
    let powers: Vec<_> = powers.map(|number: u32| number.to_string()).collect();
    match &powers[..] {
        [first @ .., last] if !first.is_empty() => format!("{} or {last}", first.join(", ")),
        powers => powers.concat(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refused_oversampling_is_told_its_values() {
        let told =
            |high| refused(&Refusal::Scan { setting: ScanSetting::Oversampling, low: 1, high });
        assert_eq!(told(16), "--oversampling must be 1, 2, 4, 8 or 16; the scan is unchanged");
        assert_eq!(told(1), "--oversampling must be 1; the scan is unchanged");
    }
}
