//! Connections of the page server, with bounds that no client can exhaust.

use std::collections::VecDeque;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::task::AbortHandle;

/// Time for a request's header, and for the next request of an idle connection.
const HEADER: Duration = Duration::from_secs(5);
/// Bytes of a request's header. A browser's has less than 2 kB.
const LARGEST: usize = 16 << 10;
/// Connections that are not a page's stream. A further one closes the oldest, so that a client that
/// opens many and says nothing keeps nobody out.
const OPEN: usize = 256;
/// Pause after a failed accept, for example because descriptors are short.
const PAUSE: Duration = Duration::from_millis(50);

/// Serves `routes` to every client until dropped.
pub(super) async fn accept(listener: TcpListener, routes: Router) {
    let mut open = VecDeque::<AbortHandle>::new();
    loop {
        open.retain(|connection| !connection.is_finished());
        let Ok((stream, _)) = listener.accept().await else {
            open.pop_front().inspect(AbortHandle::abort);
            tokio::time::sleep(PAUSE).await;
            continue;
        };
        if open.len() >= OPEN {
            open.pop_front().inspect(AbortHandle::abort);
        }
        // A tick is a small packet that must not wait for another.
        let _ = stream.set_nodelay(true);
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEADER)
            .max_buf_size(LARGEST)
            .serve_connection(TokioIo::new(stream), TowerToHyperService::new(routes.clone()))
            // It ends when it becomes a page's stream.
            .with_upgrades();
        let connection = tokio::spawn(async {
            // A client that breaks off is no failure.
            let _ = connection.await;
        });
        open.push_back(connection.abort_handle());
    }
}
