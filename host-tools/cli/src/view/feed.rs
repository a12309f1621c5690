//! Sources of rows: a connected finger, or a recording.

mod live;
mod playback;
mod self_test;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use serde_json::{Value, json};
use taxel::calibration::Calibration;
use taxel::frame::schema::{BITS, FIELDS};
use taxel::scan::TAXEL_CENTRES;
use taxel::wire::message::Info;
use taxel_client::{Client, LinkError, ReconnectingClient, fields};
use taxel_files::{FileError, point_method};

use crate::view::orders::{Envelope, Queue};
use crate::view::scope::Scope;
pub use live::Tap;

/// Orders that may wait for the finger.
const WAITING: usize = 32;

/// Source that a page can show.
pub enum Source {
    /// A finger, with the folder for recordings started from the page.
    Finger(Box<ReconnectingClient>, PathBuf),
    /// A recording or a trace, with a calibration to compute it with instead of its own.
    File(PathBuf, Option<Box<Calibration>>),
}

/// Running source.
pub struct Feed {
    pub(crate) name: String,
    pub(crate) scope: Shared,
    pub(crate) orders: SyncSender<Envelope>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

/// Scope shared by threads.
#[derive(Clone)]
pub(crate) struct Shared(Arc<Mutex<Scope>>);

impl Shared {
    fn new() -> Self {
        Self(Arc::new(Mutex::new(Scope::new())))
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, Scope> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// State shared by the threads of a feed.
#[derive(Clone)]
struct Context {
    scope: Shared,
    stop: Arc<AtomicBool>,
}

impl Context {
    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

impl Feed {
    /// Starts a source.
    ///
    /// A file cannot be read. An unplugged finger is no error; it is waited for.
    pub fn start(source: Source) -> Result<Self, FileError> {
        match source {
            Source::Finger(steady, folder) => Ok(live::start(Arc::new(*steady), folder)),
            Source::File(path, calibration) => {
                playback::start(path, calibration.map(|calibration| *calibration))
            }
        }
    }

    /// Creates a feed that shows the frames given to its [`Tap`]. The finger streams to another
    /// part of this program.
    ///
    /// The finger does not reply.
    pub fn tapped(
        finger: &Arc<ReconnectingClient>,
        folder: PathBuf,
    ) -> Result<(Self, Tap), LinkError> {
        live::tapped(finger, folder)
    }

    fn new(name: String) -> (Self, Context, Queue) {
        let scope = Shared::new();
        // Facts that do not depend on the finger, for the page until the finger replies.
        scope.lock().facts = page_facts(json!({}));
        let stop = Arc::new(AtomicBool::new(false));
        let (orders, received) = sync_channel(WAITING);
        let context = Context { scope: scope.clone(), stop: Arc::clone(&stop) };
        (Self { name, scope, orders, stop, threads: Vec::new() }, context, Queue::new(received))
    }

    fn spawn(&mut self, name: &str, work: impl FnOnce() + Send + 'static) {
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(work);
        // A failure to start a thread is not reported here.
        self.threads.extend(thread);
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // The panic of a thread is already on standard error.
            let _ = thread.join();
        }
    }
}

/// Facts about a finger for the page.
fn facts(client: &Client, info: &Info) -> Value {
    let identity = &info.identity;
    let [major, minor, patch] = client.version().firmware;
    page_facts(json!({
        "live": true,
        "board": identity.board,
        "serial": identity.serial,
        "firmware": format!("{major}.{minor}.{patch}"),
        "scan_hz": identity.scan_hz,
        "full_scale": identity.full_scale.top().0,
        "rate_hz": f64::from(info.rate_millihertz) / 1000.0,
        "filter_hz": info.filter_hz,
        "fields": fields::list(info.fields),
        "method": point_method::name(info.point_method),
        "biased": info.biased,
        "calibration": info.calibration.as_ref().map(|id| &id.serial),
    }))
}

/// Adds the facts common to all fingers: fields, flags, positions of the taxels.
fn page_facts(mut facts: Value) -> Value {
    facts["field_names"] = FIELDS.iter().map(|field| field.name).collect();
    facts["flags"] = BITS.iter().map(|bit| json!([bit.status.0, bit.name])).collect();
    facts["taxels"] = TAXEL_CENTRES.iter().map(|centre| json!(centre.map(|mm| mm.0))).collect();
    facts
}
