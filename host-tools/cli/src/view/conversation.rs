//! Stream of one open page: ticks to it, orders from it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};
use tokio::sync::oneshot;
use tokio::time::{MissedTickBehavior, interval, timeout};

use crate::view::access::same_origin;
use crate::view::feed::Feed;
use crate::view::orders::{Envelope, Order, Outcome};
use crate::view::scope::Seen;
use crate::view::server::{PAGES, Served};

/// Interval between messages: one frame of a 60 Hz screen.
const FRAME: Duration = Duration::from_micros(16_667);
/// Interval between spectra.
const SPECTRUM: Duration = Duration::from_millis(200);
/// Bytes of an order. A list of all fields has less than 200.
const ORDER: usize = 4096;
/// Bytes of the connection's buffers, which the library would make 128 kB each.
const BUFFER: usize = 4096;
/// Time after which a page that reads nothing is closed. A browser's page connects again.
const STALLED: Duration = Duration::from_secs(10);
/// Close code "try again later".
const LATER: u16 = 1013;
/// Reply to an order that nobody takes.
const NOT_CONNECTED: &str = "the finger is not connected";

/// Route of a page's stream.
pub(super) async fn finger(
    State(served): State<Arc<Served>>,
    Path(number): Path<usize>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !same_origin(&headers) {
        // Any web page may open a WebSocket to this machine; only the served page may command the
        // finger.
        return (StatusCode::FORBIDDEN, "only the page served here may connect").into_response();
    }
    if served.feeds.get(number).is_none() {
        return (StatusCode::NOT_FOUND, "no such finger").into_response();
    }
    let place = Arc::clone(&served.places).try_acquire_owned();
    let upgrade = upgrade.max_message_size(ORDER).max_frame_size(ORDER);
    let upgrade = upgrade.read_buffer_size(BUFFER).write_buffer_size(BUFFER);
    upgrade.on_upgrade(move |mut socket| async move {
        match (place, served.feeds.get(number)) {
            (Ok(_place), Some(feed)) => {
                // A closed page is no failure.
                let _ = converse(socket, feed).await;
            }
            _ => {
                let reason = format!("{PAGES} pages are open already; close one of them");
                let close = CloseFrame { code: LATER, reason: reason.into() };
                let _ = timeout(STALLED, socket.send(Message::Close(Some(close)))).await;
            }
        }
    })
}

async fn converse(mut socket: WebSocket, feed: &Feed) -> Result<(), axum::Error> {
    let mut frames = interval(FRAME);
    let mut spectra = interval(SPECTRUM);
    // A slow page gets fewer, larger messages.
    frames.set_missed_tick_behavior(MissedTickBehavior::Skip);
    spectra.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut seen = Seen::default();
    // The page's order in work. The next one is read after its outcome: further ones wait in the
    // page's own connection, and one page cannot delay another by more than one order.
    let mut order: Option<oneshot::Receiver<Outcome>> = None;
    loop {
        let message = tokio::select! {
            outcome = finished(&mut order) => {
                order = None;
                match outcome {
                    Ok(text) => json!({ "done": text }),
                    Err(text) => json!({ "failed": text }),
                }
            }
            _ = frames.tick() => feed.scope.lock().news(&mut seen, Instant::now()),
            _ = spectra.tick() => json!({ "spectrum": feed.scope.lock().spectrum() }),
            received = socket.recv(), if order.is_none() => match received {
                None => return Ok(()),
                Some(message) => match begin(&message?, feed) {
                    None => continue,
                    Some(Err(message)) => message,
                    Some(Ok(outcome)) => {
                        order = Some(outcome);
                        continue;
                    }
                },
            },
        };
        let sent = timeout(STALLED, socket.send(Message::text(message.to_string()))).await;
        sent.map_err(axum::Error::new)??;
    }
}

/// Waits for the outcome of the order in work; never ends without one.
async fn finished(order: &mut Option<oneshot::Receiver<Outcome>>) -> Outcome {
    match order {
        Some(order) => order.await.unwrap_or_else(|_| Err(NOT_CONNECTED.to_owned())),
        None => std::future::pending().await,
    }
}

/// Forwards a command to the feed; answers an invalid one at once.
fn begin(message: &Message, feed: &Feed) -> Option<Result<oneshot::Receiver<Outcome>, Value>> {
    let Message::Text(text) = message else { return None };
    let failed = |error: &str| Err(json!({ "failed": error }));
    Some(match serde_json::from_str::<Order>(text.as_str()) {
        Err(error) => failed(&error.to_string()),
        Ok(order) => {
            let (reply, outcome) = oneshot::channel();
            match feed.orders.try_send(Envelope { order, reply }) {
                Ok(()) => Ok(outcome),
                Err(std::sync::mpsc::TrySendError::Full(_)) => {
                    failed("the finger is busy with other orders; try again")
                }
                Err(std::sync::mpsc::TrySendError::Disconnected(_)) => failed(NOT_CONNECTED),
            }
        }
    })
}
