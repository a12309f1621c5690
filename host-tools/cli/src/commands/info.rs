//! `taxel info`: identity, settings and counters of the finger.

use std::time::{Duration, UNIX_EPOCH};

use serde_json::json;
use taxel::frame::schema;
use taxel::scan::ScanSettings;
use taxel::wire::message::{BoardHealth, CalibrationId, Cost, Erasures, Info, Reset};
use taxel_client::client::Version;
use taxel_client::{Port, fields};
use taxel_files::point_method;

use crate::finger::PortArg;
use crate::output;

/// Shows the finger's identity, settings and counters.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    port: PortArg,
    /// Print them as JSON.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  taxel info
  taxel info --port sim:tour --json";

/// Runs the command.
///
/// # Errors
/// The finger cannot be reached.
pub fn run(args: Args) -> anyhow::Result<()> {
    let client = args.port.connect()?;
    let (version, info, health) = (client.version(), client.info()?, client.health()?);
    let live = !matches!(args.port.port, Port::File(_));
    if args.json {
        output::json(&as_json(version, &info, &health, live))
    } else {
        output::line(as_text(version, &info, &health, live))
    }
}

/// Formats the report as text. `live` is false for a recording, because a playback's counters are
/// not the finger's.
fn as_text(version: Version, info: &Info, health: &BoardHealth, live: bool) -> String {
    let identity = &info.identity;
    let calibration = match &info.calibration {
        Some(id) => format!("{} of {}, CRC {:08x}", id.serial, date(id), id.crc),
        None => "none, so no forces; `taxel calibrate upload --calibration FILE` installs one"
            .to_owned(),
    };
    [
        format!(
            "finger       {}, serial {}, build {}",
            identity.board, identity.serial, identity.build
        ),
        format!("firmware     {}, protocol {}", firmware(version), version.protocol),
        format!("scan         {} Hz, full scale {}", identity.scan_hz, identity.full_scale.top().0),
        format!(
            "stream       {} Hz, {}, fields {}",
            f64::from(info.rate_millihertz) / 1000.0,
            if info.streaming { "on" } else { "off" },
            fields::list(info.fields)
        ),
        format!("filter       {}", filter(info.filter_hz)),
        format!("point        {}", point_method::name(info.point_method)),
        format!("estimators   {}", estimators(info).join(", ")),
        format!("calibration  {calibration}"),
        format!(
            "bias         {}",
            if info.biased { "taken on command" } else { "the calibration's" }
        ),
    ]
    .into_iter()
    .chain(live.then(|| running(info, health)).into_iter().flatten())
    .collect::<Vec<_>>()
    .join("\n")
}

/// Counters and timings of the finger.
fn running(info: &Info, health: &BoardHealth) -> Vec<String> {
    let Info { identity, counters, cost, .. } = info;
    let micros = |ticks: u32| f64::from(ticks) * 1e6 / f64::from(identity.tick_hz.max(1));
    [
        format!(
            "counted      {} scans, {} overrun, {} frames, {} lost, {} bad packets, {} lost replies",
            counters.scans,
            counters.overruns,
            counters.frames,
            counters.lost,
            counters.bad_packets,
            counters.lost_replies
        ),
        format!("cost         {:.1} µs a scan, worst {:.1} µs", micros(cost.last), micros(cost.worst)),
    ]
    .into_iter()
    .chain(board(health, micros))
    .collect()
}

fn filter(hz: u16) -> String {
    if hz == 0 { "none".to_owned() } else { format!("{hz} Hz, second order") }
}

/// State of the board; fields that the board does not report are left out.
fn board(health: &BoardHealth, micros: impl Fn(u32) -> f64) -> Vec<String> {
    let mut lines = vec![format!("started      after {}", reset(health.reset))];
    lines.extend(health.panic.as_ref().map(|panic| format!("last panic   {panic}")));
    for (name, cost) in [("reading", health.reading), ("sending", health.sending)] {
        lines.extend(cost.map(|Cost { last, worst }| {
            format!("{name:12} {:.1} µs, worst {:.1} µs", micros(last), micros(worst))
        }));
    }
    lines.extend(health.stack.map(|(used, of)| format!("stack        {used} of {of} bytes")));
    lines.extend(health.scan.map(|ScanSettings { oversampling, settle_ns, .. }| {
        let settle_us = f64::from(settle_ns) / 1000.0;
        format!("settings     {oversampling} samples a reading, {settle_us} µs to settle")
    }));
    lines.extend(health.erasures.map(|Erasures { calibration, settings }| {
        format!("erased       {calibration}× for calibrations, {settings}× for settings and biases")
    }));
    lines
}

fn reset(reset: Reset) -> &'static str {
    match reset {
        Reset::Unknown => "a reset that it cannot tell",
        Reset::Power => "power-up",
        Reset::Pin => "the reset pin",
        Reset::Software => "a reset by the firmware",
        Reset::Watchdog => "the watchdog: no scan came through",
        Reset::Other => "option bytes or low power",
    }
}

fn as_json(version: Version, info: &Info, health: &BoardHealth, live: bool) -> serde_json::Value {
    let Info { identity, counters, cost, .. } = info;
    let mut all = json!({
        "board": identity.board.as_str(),
        "serial": identity.serial.as_str(),
        "build": identity.build.as_str(),
        "firmware": firmware(version),
        "protocol": version.protocol,
        "scan_hz": identity.scan_hz,
        "full_scale": identity.full_scale.top().0,
        "rate_hz": f64::from(info.rate_millihertz) / 1000.0,
        "streaming": info.streaming,
        "fields": fields::list(info.fields),
        "filter_hz": info.filter_hz,
        "point": point_method::name(info.point_method),
        "estimators": estimators(info),
        "biased": info.biased,
        "calibration": info.calibration.as_ref().map(|id| json!({
            "serial": id.serial.as_str(),
            "date": date(id),
            "crc": format!("{:08x}", id.crc),
        })),
        "counters": {
            "scans": counters.scans,
            "overruns": counters.overruns,
            "frames": counters.frames,
            "lost": counters.lost,
            "bad_packets": counters.bad_packets,
            "lost_replies": counters.lost_replies,
        },
        "cost": { "last": cost.last, "worst": cost.worst, "tick_hz": identity.tick_hz },
        "started_after": reset(health.reset),
        "last_panic": health.panic.as_deref(),
        "reading": health.reading.map(|cost| json!({ "last": cost.last, "worst": cost.worst })),
        "sending": health.sending.map(|cost| json!({ "last": cost.last, "worst": cost.worst })),
        "stack": health.stack.map(|(used, of)| json!({ "used": used, "of": of })),
        "oversampling": health.scan.map(|scan| scan.oversampling),
        "erasures": health.erasures.map(|Erasures { calibration, settings }| {
            json!({ "calibration": calibration, "settings": settings })
        }),
        "settle_us": health.scan.map(|scan| f64::from(scan.settle_ns) / 1000.0),
    });
    if !live {
        for key in ["counters", "cost", "started_after"] {
            all[key] = serde_json::Value::Null;
        }
    }
    all
}

fn firmware(version: Version) -> String {
    version.firmware.map(|part| part.to_string()).join(".")
}

/// 9999-12-31, the last date of the text format, in seconds since 1970.
const LAST_DATE: u64 = 253_402_300_799;

fn date(id: &CalibrationId) -> String {
    let at = UNIX_EPOCH + Duration::from_secs(id.date.min(LAST_DATE));
    humantime::format_rfc3339_seconds(at).to_string()
}

/// Lists the estimators in the finger's firmware, named as in a frame's status.
fn estimators(info: &Info) -> Vec<&'static str> {
    schema::named(info.estimators).map(|bit| bit.name.trim_start_matches("ran-")).collect()
}
