//! Commands from the page.

use serde::Deserialize;

/// An order, as the page sends it: `{"order": "rate", "hz": 500}`.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(tag = "order", rename_all = "kebab-case")]
pub(crate) enum Order {
    /// Average scans into a new bias.
    Bias,
    /// Back to the calibration's own bias.
    ClearBias,
    /// Begin or end a recording.
    Record { on: bool },
    /// Frames a second.
    Rate { hz: u16 },
    /// Corner of the low-pass; 0 for none.
    Filter { hz: u16 },
    /// Fields by their names, with commas between.
    Fields { list: String },
    /// Method of the contact point: `centroid`, `argmin` or `model`.
    Method { name: String },
    /// Measure every channel.
    SelfTest,
    /// The channel that the spectrum is of.
    Channel { name: String },
    /// Go on with a playback, or halt it.
    Play { on: bool },
    /// Go to a time of a playback, in seconds from its start.
    Seek { to: f64 },
}

/// Result of a command, in words for the page.
pub(crate) type Outcome = Result<String, String>;

/// An order on its way, and where its outcome goes.
pub(crate) struct Envelope {
    pub(crate) order: Order,
    pub(crate) reply: tokio::sync::mpsc::UnboundedSender<Outcome>,
}

impl Envelope {
    /// Carries it out.
    pub(crate) fn answer(self, carry_out: impl FnOnce(Order) -> Outcome) {
        // A page that has been closed wants no answer.
        let _ = self.reply.send(carry_out(self.order));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_read_as_the_page_writes_them() {
        let read = |text| serde_json::from_str::<Order>(text);
        assert_eq!(read(r#"{"order":"rate","hz":500}"#).unwrap(), Order::Rate { hz: 500 });
        assert_eq!(read(r#"{"order":"self-test"}"#).unwrap(), Order::SelfTest);
        assert!(read(r#"{"order":"explode"}"#).is_err());
        assert!(read(r#"{"order":"rate","hz":70000}"#).is_err());
    }
}
