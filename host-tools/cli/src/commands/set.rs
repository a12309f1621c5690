//! `taxel set`: rate, fields and contact point method.

use taxel::estimate::contact_point::PointMethod;
use taxel::frame::Fields;
use taxel_link::fields;

use crate::finger::PortArg;
use crate::output;

/// Changes the finger's settings, which it keeps until it loses power, or for good with --save.
#[derive(clap::Args)]
#[command(group(clap::ArgGroup::new("settings").required(true).multiple(true)))]
pub struct Args {
    #[command(flatten)]
    port: PortArg,
    /// Frames a second; the finger takes the nearest it can.
    #[arg(long, value_name = "HZ", group = "settings")]
    rate: Option<u16>,
    /// Fields that frames carry, with commas between: codes, signals, sensors, force, point,
    /// estimates, all.
    #[arg(long, value_name = "LIST", value_parser = fields::parse, group = "settings")]
    fields: Option<Fields>,
    /// How the contact point is found.
    #[arg(long, value_name = "METHOD", group = "settings")]
    point: Option<Point>,
    /// Keep rate, fields and method as they then are over power-off.
    #[arg(long, group = "settings")]
    save: bool,
}

/// The ways to find the contact point.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Point {
    /// Centroid of the dimmed taxels.
    Centroid,
    /// The taxel with the least light.
    Argmin,
}

/// Runs the command.
///
/// # Errors
/// The finger cannot be reached or refuses.
pub fn run(args: Args) -> anyhow::Result<()> {
    let client = args.port.connect()?;
    if let Some(hz) = args.rate {
        output::line(format_args!("rate {} Hz", client.set_rate(hz)?))?;
    }
    if let Some(chosen) = args.fields {
        client.set_fields(chosen)?;
        output::line(format_args!("fields {}", fields::list(chosen)))?;
    }
    if let Some(point) = args.point {
        let (method, name) = match point {
            Point::Centroid => (PointMethod::Centroid, "centroid"),
            Point::Argmin => (PointMethod::ArgMin, "argmin"),
        };
        client.set_point_method(method)?;
        output::line(format_args!("point {name}"))?;
    }
    if args.save {
        client.save_settings()?;
        output::line("saved")?;
    }
    Ok(())
}
