//! Commands from the page.

use serde::Deserialize;

/// Command as the page sends it: `{"order": "rate", "hz": 500}`.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(tag = "order", rename_all = "kebab-case")]
pub(crate) enum Order {
    /// Average scans into a new bias.
    Bias,
    /// Return to the calibration's own bias.
    ClearBias,
    /// Begin or end a recording.
    Record { on: bool },
    /// Frames a second.
    Rate { hz: u16 },
    /// Corner of the low-pass; 0 for none.
    Filter { hz: u16 },
    /// Names of fields, separated by commas.
    Fields { list: String },
    /// Method of the contact point: `centroid`, `argmin` or `model`.
    Method { name: String },
    /// Measure noise and level of every channel.
    SelfTest,
    /// Channel of the spectrum.
    Channel { name: String },
    /// Continue or pause a playback.
    Play { on: bool },
    /// Move a playback to a time, in seconds from its start.
    Seek { to: f64 },
}

/// Result of a command, in words for the page.
pub(crate) type Outcome = Result<String, String>;

/// Command in transit, with the channel for its outcome.
pub(crate) struct Envelope {
    pub(crate) order: Order,
    pub(crate) reply: tokio::sync::mpsc::UnboundedSender<Outcome>,
}

impl Envelope {
    /// Executes the command and sends the outcome.
    pub(crate) fn answer(self, carry_out: impl FnOnce(Order) -> Outcome) {
        // A closed page does not receive its answer.
        let _ = self.reply.send(carry_out(self.order));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_commands_parse_from_json() {
        let read = |text| serde_json::from_str::<Order>(text);
        assert_eq!(read(r#"{"order":"rate","hz":500}"#).unwrap(), Order::Rate { hz: 500 });
        assert_eq!(read(r#"{"order":"self-test"}"#).unwrap(), Order::SelfTest);
        assert!(read(r#"{"order":"explode"}"#).is_err());
        assert!(read(r#"{"order":"rate","hz":70000}"#).is_err());
    }
}
