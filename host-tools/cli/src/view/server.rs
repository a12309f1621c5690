//! HTTP server of the page, with one WebSocket for each open page.

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;

use axum::Router;
use axum::extract::State;
use axum::http::header;
use axum::middleware::{from_fn_with_state, map_response};
use axum::response::IntoResponse;
use axum::routing::get;
use serde_json::json;
use tokio::sync::{Semaphore, oneshot};

use crate::view::access::{Token, host, only_by_own_name, only_with_token, with_policy};
use crate::view::connections;
use crate::view::conversation::finger;
use crate::view::feed::Feed;

/// Pages that may be open at once.
pub(super) const PAGES: usize = 32;

const HTML: &str = "text/html; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";

/// Paths, types and contents of the page's files.
const ASSETS: [(&str, &str, &str); 15] = [
    ("/", HTML, include_str!("../../assets/page/index.html")),
    ("/style.css", CSS, include_str!("../../assets/page/style.css")),
    ("/page.js", JS, include_str!("../../assets/page/page.js")),
    ("/finger.js", JS, include_str!("../../assets/page/finger.js")),
    ("/charts.js", JS, include_str!("../../assets/page/charts.js")),
    ("/flags.js", JS, include_str!("../../assets/page/flags.js")),
    ("/store.js", JS, include_str!("../../assets/page/store.js")),
    ("/readout.js", JS, include_str!("../../assets/page/readout.js")),
    ("/status.js", JS, include_str!("../../assets/page/status.js")),
    ("/controls.js", JS, include_str!("../../assets/page/controls.js")),
    ("/raw.js", JS, include_str!("../../assets/page/raw.js")),
    ("/selftest.js", JS, include_str!("../../assets/page/selftest.js")),
    ("/spectrum.js", JS, include_str!("../../assets/page/spectrum.js")),
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
    /// End of the address: the token, if other machines reach it.
    query: String,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Serves `feeds` at `address`, `HOST:PORT`; port 0 selects a free port. If other machines
    /// reach the address, only who knows the token in [`Self::url`] is answered.
    ///
    /// The address is taken, or does not belong to this machine.
    pub fn start(address: &str, feeds: Vec<Feed>) -> Result<Self, ServerError> {
        let failed = |error| ServerError { address: address.to_owned(), error };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let local = listener.local_addr().map_err(failed)?;
        let name = host(address).to_owned();
        let open = !local.ip().is_loopback();
        let token = open.then(|| Token::draw(local.port())).transpose().map_err(failed)?;
        let query = token.as_ref().map(Token::query).unwrap_or_default();
        let (stop, stopped) = oneshot::channel::<()>();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(failed)?;
        let serve = move || {
            runtime.block_on(async {
                let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
                tokio::select! {
                    () = connections::accept(listener, routes(feeds, name, token)) => {}
                    _ = stopped => {}
                }
            });
        };
        let thread = std::thread::Builder::new().name("view-server".to_owned()).spawn(serve);
        let thread = Some(thread.map_err(failed)?);
        Ok(Self { address: local, query, stop: Some(stop), thread })
    }

    /// Address of the page for a browser.
    #[must_use]
    pub fn url(&self) -> String {
        format!("http://{}/{}", self.address, self.query)
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

/// State shared by all pages.
pub(super) struct Served {
    pub(super) feeds: Vec<Feed>,
    /// Places for further pages.
    pub(super) places: Arc<Semaphore>,
}

/// Builds the routes, open to requests for this machine's address, `localhost` or `name` that have
/// the token, if there is one.
fn routes(feeds: Vec<Feed>, name: String, token: Option<Token>) -> Router {
    let pages = ASSETS.into_iter().fold(Router::new(), |router, (path, kind, text)| {
        let headers = [(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, "no-cache")];
        router.route(path, get(move || async move { (headers, text) }))
    });
    let pages = pages
        .route("/fingers", get(fingers))
        .route("/finger/{number}", get(finger))
        .with_state(Arc::new(Served { feeds, places: Arc::new(Semaphore::new(PAGES)) }));
    let pages = match token {
        Some(token) => pages.layer(from_fn_with_state(Arc::new(token), only_with_token)),
        None => pages,
    };
    pages
        .layer(from_fn_with_state(Arc::<str>::from(name), only_by_own_name))
        .layer(map_response(with_policy))
}

async fn fingers(State(served): State<Arc<Served>>) -> impl IntoResponse {
    let names: Vec<_> = served.feeds.iter().map(|feed| feed.name.as_str()).collect();
    ([(header::CONTENT_TYPE, "application/json")], json!(names).to_string())
}
