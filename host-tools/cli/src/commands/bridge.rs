//! `taxel bridge`: fingers as a part of a ROS 2 system, without ROS.
//!
//! ```text
//! finger ──Steady──▶ finger ──CDR──┐
//! finger ──Steady──▶ finger ──CDR──┼──pipe──▶ taxel-bridge ──Zenoh──▶ rmw_zenoh, any Zenoh program
//! ```

mod finger;
mod graph;
mod pipe;
mod ros;

use std::hash::{BuildHasher, RandomState};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use anyhow::{anyhow, bail};
use serde_json::json;
use taxel::frame::Fields;
use taxel_link::{Port, Steady, fields};

use crate::finger::scene_calibration;
use crate::interrupt::Interrupt;
use crate::{output, stream};
use finger::{Finger, Report};
use graph::{Context, Namespace};
use pipe::Pipe;

/// How often the loop looks whether it should end.
const LOOK: Duration = Duration::from_millis(100);

/// Publishes fingers over Zenoh as ROS 2 nodes, until Ctrl-C or for a while; no ROS is needed here.
///
/// A ROS 2 system with RMW_IMPLEMENTATION=rmw_zenoh_cpp has them in its graph: `ros2 topic list`, `ros2 topic echo
/// /taxel/F_0042/wrench`. Each finger is a node named after its serial number, with two topics:
/// NAMESPACE/FINGER/wrench (geometry_msgs/WrenchStamped) and NAMESPACE/frames (taxel_msgs/Frame), which all
/// fingers of all machines share. A finger that is not there, or goes, is waited for. docs/ros2.md says more.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The finger: usb, usb:SERIAL, a serial device, tcp:HOST:PORT, file:PATH or sim:SCENE; may be given more than once.
    #[arg(long, value_name = "PORT", required = true)]
    port: Vec<Port>,
    /// Over Zenoh, as rmw_zenoh does it.
    #[arg(long, required = true)]
    zenoh: bool,
    /// A Zenoh router or peer to connect to; may be given more than once. It need not be there yet.
    #[arg(long, value_name = "ENDPOINT", default_value = "tcp/localhost:7447")]
    connect: Vec<String>,
    /// Where other peers can connect to this; may be given more than once.
    #[arg(long, value_name = "ENDPOINT", default_value = "tcp/localhost:0")]
    listen: Vec<String>,
    /// Domain of the ROS 2 system [default: ROS_DOMAIN_ID, else 0].
    #[arg(long, value_name = "N")]
    domain: Option<u32>,
    /// What the names of nodes and topics begin with.
    #[arg(long, value_name = "NAME", default_value = "/taxel")]
    namespace: Namespace,
    /// Frames a second [default: as the finger is set].
    #[arg(long, value_name = "HZ")]
    rate: Option<u16>,
    /// Fields to publish, with commas between: signals, sensors, force, point, slip, torsion, contacts,
    /// estimates, all [default: as the finger is set]. The wrench needs force.
    #[arg(long, value_name = "LIST", value_parser = fields::parse)]
    fields: Option<Fields>,
    /// Calibration of a virtual finger [default: a built-in scene's own].
    #[arg(long, value_name = "CAL")]
    calibration: Option<PathBuf>,
    /// Seconds to run.
    #[arg(long, value_name = "SEC", value_parser = stream::seconds)]
    duration: Option<f64>,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  taxel bridge --zenoh --port usb
  taxel bridge --zenoh --port usb:F-0042 --port usb:F-0043 --namespace /left_hand
  taxel bridge --zenoh --port sim:tour --connect tcp/robot.local:7447 --domain 7";

/// What all fingers of a bridge have.
struct Shared {
    context: Context,
    pipe: Pipe,
    /// So that no two fingers have one name.
    names: Mutex<Vec<String>>,
    publishers: Mutex<u32>,
    rate: Option<u16>,
    fields: Option<Fields>,
    stop: AtomicBool,
}

/// Runs the command.
///
/// # Errors
/// Zenoh cannot be had, two fingers have one name, or the other side of the pipe goes.
pub fn run(args: Args) -> anyhow::Result<()> {
    let interrupt = Interrupt::watch()?;
    let domain = match args.domain {
        Some(domain) => domain,
        None => ros_domain()?,
    };
    let steadies = args.port.into_iter().map(|port| {
        let scene = if let Port::Sim(scene) = &port { scene.as_str() } else { "" };
        let calibration = scene_calibration(args.calibration.as_deref(), scene)?;
        Ok(Arc::new(Steady::new(port, calibration)))
    });
    let steadies = steadies.collect::<anyhow::Result<Vec<_>>>()?;
    let session = session();
    let pipe = Pipe::open(&config(&session, &args.connect, &args.listen))?;
    let shared = Arc::new(Shared {
        context: Context { domain, session, namespace: args.namespace },
        pipe,
        names: Default::default(),
        publishers: Default::default(),
        rate: args.rate,
        fields: args.fields,
        stop: AtomicBool::new(false),
    });
    let began = Instant::now();
    let start = |steady: Arc<Steady>| {
        let shared = Arc::clone(&shared);
        std::thread::spawn(move || Finger::new(steady, shared).serve())
    };
    let fingers: Vec<_> = steadies.into_iter().map(start).collect();
    let enough = |now: Duration| args.duration.is_some_and(|most| now.as_secs_f64() >= most);
    while !interrupt.came()
        && !enough(began.elapsed())
        && !fingers.iter().all(std::thread::JoinHandle::is_finished)
        && !shared.stop.load(Ordering::Relaxed)
    {
        std::thread::sleep(LOOK);
    }
    shared.stop.store(true, Ordering::Relaxed);
    let reports = fingers.into_iter().map(|finger| match finger.join() {
        Ok(report) => report,
        Err(_) => Err(anyhow!("a finger's thread ended by a fault of this program")),
    });
    let reports = reports.collect::<Vec<_>>().into_iter().collect::<anyhow::Result<Vec<_>>>();
    let broken = reports.as_ref().is_err_and(|error| error.is::<std::io::Error>());
    if broken && let Some(Shared { mut pipe, .. }) = Arc::into_inner(shared) {
        bail!("Zenoh: {}", pipe.last_words());
    }
    let reports = reports?;
    if args.json {
        return output::json(&reports);
    }
    reports.iter().try_for_each(|report| output::line(as_text(report)))
}

fn as_text(report: &Report) -> String {
    let Report { port, names, frames, lost, withheld } = report;
    let wrenches = frames - withheld;
    let name = if names.is_empty() { "never there".to_owned() } else { names.join(", ") };
    format!("{port}: {name}, {frames} frames, {lost} lost, {wrenches} wrenches")
}

/// What ROS 2 itself goes by.
fn ros_domain() -> anyhow::Result<u32> {
    match std::env::var("ROS_DOMAIN_ID") {
        Ok(text) if !text.is_empty() => {
            text.parse().map_err(|_| anyhow!("ROS_DOMAIN_ID: `{text}` is no number"))
        }
        _ => Ok(0),
    }
}

/// A session's identity: 128 bits, the first of its digits not nought.
fn session() -> String {
    let random = || RandomState::new().hash_one(std::process::id());
    format!("{:016x}{:016x}", random() | 1 << 63, random())
}

/// As rmw_zenoh sets up its sessions: peers that find each other through a router, and no multicast.
fn config(session: &str, connect: &[String], listen: &[String]) -> String {
    json!({
        "id": session,
        "mode": "peer",
        "connect": {
            "endpoints": connect,
            "exit_on_failure": false,
            "timeout_ms": -1,
            // A router that is started later, or anew, is found within a second.
            "retry": { "period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5 },
        },
        "listen": { "endpoints": listen },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": true } },
        // A millisecond, the default, is less than a reader may be held up by its operating system.
        "transport": { "link": { "tx": { "queue": { "congestion_control": {
            "drop": { "wait_before_drop": 50_000 }
        } } } } },
    })
    .to_string()
}
