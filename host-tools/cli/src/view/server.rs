//! HTTP server of the page, with one WebSocket for each open page.

use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde_json::{Value, json};
use tokio::sync::{mpsc, oneshot};
use tokio::time::{MissedTickBehavior, interval};

use crate::view::feed::Feed;
use crate::view::orders::{Envelope, Order, Outcome};
use crate::view::scope::Seen;

/// Interval between messages: one frame of a 60 Hz screen.
const FRAME: Duration = Duration::from_micros(16_667);
/// Interval between spectra.
const SPECTRUM: Duration = Duration::from_millis(200);

const HTML: &str = "text/html; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";

/// Paths, types and contents of the page's files.
const ASSETS: [(&str, &str, &str); 8] = [
    ("/", HTML, include_str!("../../assets/page/index.html")),
    ("/style.css", CSS, include_str!("../../assets/page/style.css")),
    ("/page.js", JS, include_str!("../../assets/page/page.js")),
    ("/finger.js", JS, include_str!("../../assets/page/finger.js")),
    ("/charts.js", JS, include_str!("../../assets/page/charts.js")),
    ("/flags.js", JS, include_str!("../../assets/page/flags.js")),
    ("/uplot.js", JS, include_str!("../../assets/page/uplot/uPlot.iife.min.js")),
    ("/uplot.css", CSS, include_str!("../../assets/page/uplot/uPlot.min.css")),
];

/// Error of a page that cannot be served.
#[derive(Debug, thiserror::Error)]
#[error("{address}: {error}; choose another address with --listen")]
pub struct ServerError {
    address: String,
    error: std::io::Error,
}

/// Running server. Dropping it closes every page.
pub struct Server {
    address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Serves `feeds` at `address`, `HOST:PORT`; port 0 selects a free port.
    ///
    /// The address is taken, or does not belong to this machine.
    pub fn start(address: &str, feeds: Vec<Feed>) -> Result<Self, ServerError> {
        let failed = |error| ServerError { address: address.to_owned(), error };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let local = listener.local_addr().map_err(failed)?;
        let name = host(address).to_owned();
        let (stop, stopped) = oneshot::channel::<()>();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(failed)?;
        let serve = move || {
            runtime.block_on(async {
                let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
                tokio::select! {
                    // The library retries a failed accept.
                    _ = axum::serve(listener, routes(feeds, name)) => {}
                    _ = stopped => {}
                }
            });
        };
        let thread = std::thread::Builder::new().name("view-server".to_owned()).spawn(serve);
        let thread = Some(thread.map_err(failed)?);
        Ok(Self { address: local, stop: Some(stop), thread })
    }

    /// Address of the page for a browser.
    #[must_use]
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // The panic of a thread is already on standard error.
            let _ = thread.join();
        }
    }
}

type Feeds = Arc<Vec<Feed>>;

/// Builds the routes, open to requests for this machine's address, `localhost` or `name`.
fn routes(feeds: Vec<Feed>, name: String) -> Router {
    let pages = ASSETS.into_iter().fold(Router::new(), |router, (path, kind, text)| {
        let headers = [(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, "no-cache")];
        router.route(path, get(move || async move { (headers, text) }))
    });
    pages
        .route("/fingers", get(fingers))
        .route("/finger/{number}", get(finger))
        .with_state(Arc::new(feeds))
        .layer(from_fn_with_state(Arc::<str>::from(name), only_by_own_name))
}

/// Rejects requests for other host names. With DNS rebinding a foreign name could lead to this
/// machine. The browser would then let the foreign page command the finger.
async fn only_by_own_name(State(name): State<Arc<str>>, request: Request, next: Next) -> Response {
    let called = request.headers().get(header::HOST).and_then(|value| value.to_str().ok());
    if is_own(called.unwrap_or_default(), &name) {
        return next.run(request).await;
    }
    let mend = "this page is served by its IP address and as localhost; for another name, give it to --listen";
    (StatusCode::FORBIDDEN, mend).into_response()
}

/// Whether `called` is an IP address, `localhost` or `name`. DNS rebinding needs a name, so that
/// any IP address is safe.
fn is_own(called: &str, name: &str) -> bool {
    let called = host(called);
    called.parse::<IpAddr>().is_ok()
        || ["localhost", name].iter().any(|own| called.eq_ignore_ascii_case(own))
}

/// Extracts the host of `HOST:PORT`, `[HOST]:PORT` or `HOST`.
fn host(address: &str) -> &str {
    let end = address.rfind(':').filter(|colon| !address.ends_with(']') && *colon > 0);
    address[..end.unwrap_or(address.len())].trim_matches(['[', ']'])
}

async fn fingers(State(feeds): State<Feeds>) -> impl IntoResponse {
    let names: Vec<_> = feeds.iter().map(|feed| feed.name.as_str()).collect();
    ([(header::CONTENT_TYPE, "application/json")], json!(names).to_string())
}

async fn finger(
    State(feeds): State<Feeds>,
    Path(number): Path<usize>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !same_origin(&headers) {
        // Any web page may open a WebSocket to this machine; only the served page may command the
        // finger.
        return (StatusCode::FORBIDDEN, "only the page served here may connect").into_response();
    }
    if feeds.get(number).is_none() {
        return (StatusCode::NOT_FOUND, "no such finger").into_response();
    }
    upgrade.on_upgrade(move |socket| async move {
        if let Some(feed) = feeds.get(number) {
            // A closed page is no failure.
            let _ = converse(socket, feed).await;
        }
    })
}

fn same_origin(headers: &HeaderMap) -> bool {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    match text(header::ORIGIN) {
        // The client is no browser.
        None => true,
        Some(origin) => {
            let host = origin.split_once("://").map(|(_, host)| host);
            host.is_some() && host == text(header::HOST)
        }
    }
}

async fn converse(mut socket: WebSocket, feed: &Feed) -> Result<(), axum::Error> {
    let (reply, mut replies) = mpsc::unbounded_channel::<Outcome>();
    let mut frames = interval(FRAME);
    let mut spectra = interval(SPECTRUM);
    // A slow page gets fewer, larger messages.
    frames.set_missed_tick_behavior(MissedTickBehavior::Skip);
    spectra.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut seen = Seen::default();
    loop {
        let message = tokio::select! {
            _ = frames.tick() => feed.scope.lock().news(&mut seen),
            _ = spectra.tick() => json!({ "spectrum": feed.scope.lock().spectrum() }),
            Some(outcome) = replies.recv() => match outcome {
                Ok(text) => json!({ "done": text }),
                Err(text) => json!({ "failed": text }),
            },
            received = socket.recv() => match received {
                None => return Ok(()),
                Some(message) => match order(&message?, feed, &reply) {
                    Some(message) => message,
                    None => continue,
                },
            },
        };
        socket.send(Message::text(message.to_string())).await?;
    }
}

/// Forwards a command to the feed; answers an invalid one at once.
fn order(message: &Message, feed: &Feed, reply: &mpsc::UnboundedSender<Outcome>) -> Option<Value> {
    let Message::Text(text) = message else { return None };
    match serde_json::from_str::<Order>(text.as_str()) {
        Err(error) => Some(json!({ "failed": error.to_string() })),
        Ok(order) => {
            let sent = feed.orders.send(Envelope { order, reply: reply.clone() });
            sent.is_err().then(|| json!({ "failed": "the finger is not connected" }))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_own_host_names_are_accepted() {
        let name = host("robot.local:8173");
        for own in ["127.0.0.1:8173", "192.168.1.20", "[::1]:8173", "[fe80::1]", "localhost:8173"] {
            assert!(is_own(own, name), "{own}");
        }
        assert!(is_own("Robot.Local:8173", name));
        for other in ["", ":8173", "evil.example:8173", "127.0.0.1.evil.example", "localhost.evil"]
        {
            assert!(!is_own(other, name), "{other}");
        }
    }
}
