//! `taxel bridge`: publishes fingers to ROS 2 over Zenoh, without ROS, and live to Foxglove.
//!
//! ```text
//! finger ─ReconnectingClient▶ Finger ─┬─CDR──────▶ Nodes ───Zenoh──────▶ any Zenoh program
//!   ▲                                 └─protobuf─▶ Topics ──WebSocket──▶ Foxglove
//!   └──requests── Services ◀──calls── Nodes
//! ```
//! Both outlets always compile. Their transports, [`peer`] and [`websocket`], are real only with
//! the features `zenoh` and `foxglove`, because those double the crates to build.

mod finger;
mod foxglove;
mod graph;
mod peer;
mod ros;
mod services;
mod tool;
mod websocket;
mod zenoh;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use anyhow::anyhow;
use clap::ArgGroup;
use taxel::frame::Fields;
use taxel::frame::schema::FIELD_NAMES;
use taxel_client::{Port, ReconnectingClient, fields};

use crate::finger::{address, checked_by_finger, closed, steady};
use crate::interrupt::Interrupt;
use crate::{output, stream};
use finger::{Finger, Outlet, Report};
use graph::{Namespace, Qos};
use services::Services;
use tool::Tool;

/// Interval at which the loop checks whether to stop.
const LOOK: Duration = Duration::from_millis(100);

/// Publishes fingers as ROS 2 nodes over Zenoh, or live to Foxglove. Runs until Ctrl-C or the end
/// of --duration.
///
/// --zenoh: no ROS is needed here. A ROS 2 system with RMW_IMPLEMENTATION=rmw_zenoh_cpp shows the
/// fingers in its graph: `ros2 topic list`, `ros2 topic echo /taxel/F_0042/wrench`. Each finger is
/// a node named after its serial number. Its topics below NAMESPACE/FINGER are wrench,
/// contact_point and marker; NAMESPACE/frames (taxel_msgs/Frame), /tf and /diagnostics are shared
/// by all fingers. Its services are tare and self_test; rate, filter, fields and method are
/// parameters. See docs/ros2.md.
///
/// --foxglove: each finger is a topic, /taxel/FINGER, with the messages of an MCAP recording. In
/// Foxglove: Open connection, Foxglove WebSocket, ws://localhost:8765.
///
/// A finger that is not connected, or is unplugged, is waited for.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES, group = ArgGroup::new("to").required(true).multiple(true))]
pub struct Args {
    /// The finger: usb, usb:SERIAL, a serial device, tcp:HOST:PORT, file:PATH or sim:SCENE; may be
    /// given more than once.
    #[arg(long, value_name = "PORT", required = true)]
    port: Vec<Port>,
    /// Publish over Zenoh, as rmw_zenoh does.
    #[arg(long, group = "to")]
    zenoh: bool,
    /// Publish to Foxglove, which connects to this address [default: 127.0.0.1:8765].
    #[arg(long, group = "to", value_name = "HOST:PORT", value_parser = address)]
    #[arg(num_args = 0..=1, default_missing_value = "127.0.0.1:8765")]
    foxglove: Option<String>,
    /// Let every machine that reaches the address of --foxglove read the stream.
    #[arg(long, requires = "foxglove")]
    open: bool,
    /// Zenoh router or peer to connect to; may be given more than once. The router or peer may
    /// start later.
    #[arg(long, value_name = "ENDPOINT", default_value = "tcp/localhost:7447")]
    connect: Vec<String>,
    /// Address on which other peers can connect; may be given more than once.
    #[arg(long, value_name = "ENDPOINT", default_value = "tcp/localhost:0")]
    listen: Vec<String>,
    /// Domain of the ROS 2 system [default: ROS_DOMAIN_ID, else 0].
    #[arg(long, value_name = "N", value_parser = ros_domain)]
    domain: Option<u32>,
    /// Prefix of the names of nodes and topics.
    #[arg(long, value_name = "NAME", default_value = "/taxel")]
    namespace: Namespace,
    /// Publish wrenches about the origin and along the axes of this frame: its pose in the finger's
    /// frame, x,y,z in mm, or x,y,z,roll,pitch,yaw in mm and degrees (fixed axes, as in URDF).
    /// Given once for all fingers, or once for each --port in order.
    #[arg(long, value_name = "POSE", requires = "zenoh", allow_hyphen_values = true)]
    tool: Vec<Tool>,
    /// Announce the topics as best effort instead of reliable.
    #[arg(long, requires = "zenoh")]
    best_effort: bool,
    /// Frames a second [default: as the finger is set].
    #[arg(long, value_name = "HZ", value_parser = checked_by_finger)]
    rate: Option<u16>,
    #[arg(long, value_name = "LIST", value_parser = fields::parse, help = format!(
        "Fields to publish, with commas between (codes are not published): {FIELD_NAMES} \
         [default: as the finger is set, besides force,point,torsion for the wrench of --zenoh, \
         and signals for the scene of --foxglove]"
    ))]
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
  taxel bridge --zenoh --port usb --tool 0,0,-25,0,0,90 --best-effort
  taxel bridge --foxglove --port usb
  taxel bridge --zenoh --port sim:tour --connect tcp/robot.local:7447 --domain 7";

/// Settings and stop flag shared by the fingers of a bridge.
struct Shared {
    rate: Option<u16>,
    fields: Option<Fields>,
    stop: AtomicBool,
}

/// Runs the command.
///
/// # Errors
/// The feature is not built in, two fingers have one name, or the network fails.
pub fn run(args: Args) -> anyhow::Result<()> {
    let interrupt = Interrupt::watch()?;
    args.foxglove.iter().try_for_each(|address| closed(address, args.open))?;
    let domain = match args.domain {
        Some(domain) => domain,
        None => domain_from_environment()?,
    };
    let tools = tools(&args.tool, args.port.len())?;
    let steadies =
        args.port.into_iter().map(|port| Ok(Arc::new(steady(port, args.calibration.as_deref())?)));
    let steadies = steadies.collect::<anyhow::Result<Vec<_>>>()?;
    let qos = if args.best_effort { Qos::BestEffort } else { Qos::Reliable };
    let zenoh = args
        .zenoh
        .then(|| zenoh::Session::open(domain, args.namespace, qos, &args.connect, &args.listen));
    let zenoh = zenoh.transpose()?;
    let foxglove = args.foxglove.as_deref().map(foxglove::start).transpose()?;
    let outlets = |steady: &Arc<ReconnectingClient>, tool, changed| {
        let nodes = zenoh.clone().map(|session| {
            let services = Services::start(Arc::clone(steady), changed)?;
            anyhow::Ok(Box::new(zenoh::Nodes::new(session, services, tool)) as Box<dyn Outlet>)
        });
        let topics = foxglove.clone().map(|server| {
            let topics: Box<dyn Outlet> = Box::new(foxglove::Topics::new(server));
            Ok(topics)
        });
        nodes.into_iter().chain(topics).collect::<anyhow::Result<Vec<_>>>()
    };
    let stop = AtomicBool::new(false);
    let shared = Arc::new(Shared { rate: args.rate, fields: args.fields, stop });
    let began = Instant::now();
    let start = |(steady, tool): (Arc<ReconnectingClient>, Option<Tool>)| {
        let (change, changed) = channel();
        let outlets = outlets(&steady, tool, change)?;
        let finger = Finger::new(steady, Arc::clone(&shared), outlets, changed);
        anyhow::Ok(std::thread::spawn(move || finger.serve()))
    };
    let fingers = steadies.into_iter().zip(tools).map(start).collect::<anyhow::Result<Vec<_>>>()?;
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
        Err(_) => Err(anyhow!("a finger's thread failed by a bug in this program")),
    });
    let reports = reports.collect::<Vec<_>>().into_iter().collect::<anyhow::Result<Vec<_>>>()?;
    if args.json {
        return output::json(&reports);
    }
    reports.iter().try_for_each(|report| output::line(as_text(report)))
}

/// Returns the tool frame of each port.
fn tools(tools: &[Tool], ports: usize) -> anyhow::Result<Vec<Option<Tool>>> {
    match *tools {
        [] => Ok(vec![None; ports]),
        [tool] => Ok(vec![Some(tool); ports]),
        _ if tools.len() == ports => Ok(tools.iter().copied().map(Some).collect()),
        _ => Err(anyhow!(
            "--tool: {} poses for {ports} fingers; give one for all, or one for each --port",
            tools.len()
        )),
    }
}

/// Error of a bridge that this program lacks. Its mend names both features, because an installation
/// replaces the one before.
#[cfg(any(test, not(all(feature = "zenoh", feature = "foxglove"))))]
fn not_built_in(feature: &str) -> anyhow::Error {
    anyhow!(
        "bridge --{feature}: not built in; in a checkout of the repository run `cargo install --path \
         host-tools/cli --features zenoh,foxglove`"
    )
}

fn as_text(report: &Report) -> String {
    let Report { port, names, frames, lost, withheld } = report;
    let wrenches = frames - withheld;
    let name = if names.is_empty() { "never there".to_owned() } else { names.join(", ") };
    format!("{port}: {name}, {frames} frames, {lost} lost, {wrenches} with a wrench")
}

/// Parses a domain of ROS 2.
fn ros_domain(text: &str) -> Result<u32, String> {
    let domain = text.parse().ok().filter(|domain| (0..=232).contains(domain));
    domain.ok_or_else(|| "expected a whole number in 0…232".to_owned())
}

/// Reads the domain from `ROS_DOMAIN_ID`, as ROS 2 does: 0 if unset or empty.
fn domain_from_environment() -> anyhow::Result<u32> {
    match std::env::var("ROS_DOMAIN_ID") {
        Ok(text) if !text.is_empty() => {
            ros_domain(&text).map_err(|error| anyhow!("ROS_DOMAIN_ID: `{text}`: {error}"))
        }
        _ => Ok(0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mend_of_one_bridge_keeps_the_other() {
        for feature in ["zenoh", "foxglove"] {
            let error = not_built_in(feature).to_string();
            assert!(error.starts_with(&format!("bridge --{feature}: ")), "{error}");
            assert!(error.contains("--features zenoh,foxglove`"), "{error}");
        }
    }
}
