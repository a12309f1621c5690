//! `taxel set`: rate, filter, fields, contact point method and scan settings.

use anyhow::{Context, bail};
use taxel::estimate::contact_point::PointMethod;
use taxel::frame::Fields;
use taxel::frame::schema::FIELD_NAMES;
use taxel::scan::ScanSettings;
use taxel_client::{Client, LinkError, Settings, fields};

use crate::finger::{PortArg, checked_by_finger};
use crate::output;

/// Changes the finger's settings, until it loses power or permanently with --save. If it refuses
/// one, all stay as they were.
#[derive(clap::Args)]
#[command(group(clap::ArgGroup::new("settings").required(true).multiple(true)))]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    port: PortArg,
    /// Frames a second; the finger uses the nearest possible rate.
    #[arg(long, value_name = "HZ", group = "settings", value_parser = checked_by_finger)]
    rate: Option<u16>,
    /// Low-pass on forces and contact points: frequency of −3 dB in hertz, 0 for none. The filter
    /// is of second order.
    #[arg(long, value_name = "HZ", group = "settings", value_parser = checked_by_finger)]
    filter: Option<u16>,
    #[arg(long, value_name = "LIST", value_parser = fields::parse, group = "settings",
          help = format!("Fields that frames carry, with commas between: {FIELD_NAMES}"))]
    fields: Option<Fields>,
    /// Method of the contact point.
    #[arg(long, value_name = "METHOD", group = "settings")]
    point: Option<Point>,
    /// Scans a second.
    #[arg(long, value_name = "HZ", group = "settings", value_parser = checked_by_finger)]
    scan: Option<u16>,
    /// Samples summed for one reading: 1, 2, 4, 8 or 16.
    #[arg(long, value_name = "SAMPLES", group = "settings", value_parser = checked_by_finger)]
    oversampling: Option<u16>,
    /// Time from the change of LED row to the first sample, in microseconds.
    #[arg(long, value_name = "US", group = "settings", value_parser = settle)]
    settle: Option<u32>,
    /// Keep the resulting scan, rate, filter, fields and method over power-off.
    #[arg(long, group = "settings")]
    save: bool,
}

const EXAMPLES: &str = "\
Examples:
  taxel set --rate 500 --fields force,point
  taxel set --scan 4000 --oversampling 4 --settle 20 --save";

/// Methods of finding the contact point.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Point {
    /// Centroid of the dimmed taxels.
    Centroid,
    /// The taxel with the least light.
    Argmin,
    /// The calibration's model of the skin, which gives the force as well.
    Model,
}

fn settle(text: &str) -> Result<u32, String> {
    let us: f64 = text.parse().map_err(|_| format!("`{text}` is not a number of microseconds"))?;
    if (0.0..=1e6).contains(&us) {
        Ok((us * 1000.0).round() as u32)
    } else {
        Err(format!("{us} µs must lie in 0…1000000"))
    }
}

/// Runs the command.
///
/// # Errors
/// The finger cannot be reached or refuses; it then has the settings from before.
pub fn run(args: Args) -> anyhow::Result<()> {
    let client = args.port.connect()?;
    let (before, _) = Settings::of(&client)?;
    let lines = match change(&args, &client, before.scan) {
        Ok(lines) => lines,
        Err(error) => bail!("{error}; {}", restored(before.restore(&client))),
    };
    lines.iter().try_for_each(output::line)?;
    if args.save {
        client.save_settings().context("the settings are changed, but not saved")?;
        output::line("saved")?;
    }
    Ok(())
}

/// States which settings the finger has after one was refused.
fn restored(restored: Result<bool, LinkError>) -> &'static str {
    match restored {
        Ok(false) => "all settings are as before",
        Ok(true) => "all settings are as before, but the bias is lost; take it again",
        Err(_) => "some settings may have changed; see which with `taxel info`",
    }
}

/// Changes all settings that were asked for. Returns a line on each.
fn change(args: &Args, client: &Client, now: Option<ScanSettings>) -> anyhow::Result<Vec<String>> {
    let mut lines = Vec::new();
    if args.scan.is_some() || args.oversampling.is_some() || args.settle.is_some() {
        let now = now.context(
            "this board cannot scan in another way; leave out --scan, --oversampling and --settle",
        )?;
        let wish = ScanSettings {
            scan_hz: args.scan.unwrap_or(now.scan_hz),
            oversampling: args.oversampling.unwrap_or(now.oversampling),
            settle_ns: args.settle.unwrap_or(now.settle_ns),
        };
        client.set_scan(wish)?;
        lines.push(format!(
            "scan {} Hz, {} samples a reading, {} µs to settle",
            wish.scan_hz,
            wish.oversampling,
            f64::from(wish.settle_ns) / 1000.0
        ));
    }
    if let Some(hz) = args.rate {
        lines.push(format!("rate {} Hz", client.set_rate(hz)?));
    }
    if let Some(hz) = args.filter {
        client.set_filter(hz)?;
        lines.push(match hz {
            0 => "filter none".to_owned(),
            hz => format!("filter {hz} Hz"),
        });
    }
    if let Some(chosen) = args.fields {
        client.set_fields(chosen)?;
        lines.push(format!("fields {}", fields::list(chosen)));
    }
    if let Some(point) = args.point {
        let (method, name) = match point {
            Point::Centroid => (PointMethod::Centroid, "centroid"),
            Point::Argmin => (PointMethod::ArgMin, "argmin"),
            Point::Model => (PointMethod::Model, "model"),
        };
        client.set_point_method(method)?;
        lines.push(format!("point {name}"));
    }
    Ok(lines)
}
