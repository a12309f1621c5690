//! Commands from the page.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use serde::Deserialize;

/// Command as the page sends it: `{"order": "rate", "hz": 500}`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
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
    pub(crate) reply: tokio::sync::oneshot::Sender<Outcome>,
}

/// Orders that wait for one finger. Each open page has at most one.
pub(crate) struct Queue {
    received: Receiver<Envelope>,
    waiting: VecDeque<Envelope>,
}

impl Queue {
    pub(crate) fn new(received: Receiver<Envelope>) -> Self {
        Self { received, waiting: VecDeque::new() }
    }

    /// Waits for an order of a page that is still open, and executes it. Equal orders that wait
    /// meanwhile get the same outcome: ten pages that ask for a self-test share one.
    ///
    /// No order came in time, or none can come.
    pub(crate) fn answer(
        &mut self,
        patience: Duration,
        carry_out: impl FnOnce(Order) -> Outcome,
    ) -> Result<(), RecvTimeoutError> {
        let next =
            self.waiting.pop_front().map_or_else(|| self.received.recv_timeout(patience), Ok);
        let Envelope { order, reply } = next?;
        if reply.is_closed() {
            return Ok(());
        }
        let outcome = carry_out(order.clone());
        self.waiting.extend(self.received.try_iter());
        self.waiting.retain(|one| !one.reply.is_closed());
        let (equal, other): (VecDeque<_>, _) =
            self.waiting.drain(..).partition(|one| one.order == order);
        self.waiting = other;
        for reply in equal.into_iter().map(|one| one.reply).chain([reply]) {
            // A page that has closed meanwhile does not receive its answer.
            let _ = reply.send(outcome.clone());
        }
        Ok(())
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

    #[test]
    fn equal_waiting_orders_share_an_outcome() {
        let (sender, received) = std::sync::mpsc::sync_channel(8);
        let send = |order| {
            let (reply, outcome) = tokio::sync::oneshot::channel();
            sender.send(Envelope { order, reply }).unwrap();
            outcome
        };
        let mut queue = Queue::new(received);
        let mut done = 0;
        let mut tests: Vec<_> = (0..3).map(|_| send(Order::SelfTest)).collect();
        let mut rate = send(Order::Rate { hz: 500 });
        drop(send(Order::Bias));
        tests.push(send(Order::SelfTest));
        let carry_out = |done: &mut u32, order: Order| {
            *done += 1;
            Ok(format!("{order:?} {done}"))
        };
        while queue.answer(Duration::ZERO, |order| carry_out(&mut done, order)).is_ok() {}
        for test in &mut tests {
            assert_eq!(test.try_recv().unwrap().unwrap(), "SelfTest 1");
        }
        assert_eq!(rate.try_recv().unwrap().unwrap(), "Rate { hz: 500 } 2");
        assert_eq!(done, 2, "the order of a closed page is dropped");
    }
}
