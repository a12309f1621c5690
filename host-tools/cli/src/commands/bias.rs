//! `taxel bias`: reading of the unloaded finger.

use serde::Serialize;
use taxel::condition::Bias;
use taxel::scan::COLS;
use taxel_client::client::ActiveBias;

use crate::finger::PortArg;
use crate::output;

/// Takes, reads, clears or saves the finger's bias (its tare). The bias changes only on this
/// command.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    port: PortArg,
    /// Action.
    action: Action,
    /// Scans to average for `take`.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u16).range(2..))]
    scans: u16,
    /// Print the bias as JSON.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  taxel bias take
  taxel bias save
  taxel bias --port sim:presses take --scans 50";

/// Action on a bias.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Action {
    /// Average the unloaded, still finger into a new bias.
    Take,
    /// Show the active bias.
    Read,
    /// Return to the calibration's own bias.
    Clear,
    /// Keep the active bias over power-off; after `clear`, forget the saved one.
    Save,
}

/// Bias as JSON: levels and noise as fractions of full scale.
#[derive(Serialize)]
struct Report {
    on_command: bool,
    in_contact: bool,
    taxels: Option<Channels>,
    sensors: Vec<Option<Channels>>,
}

/// Level of each channel of a group, and the noise of the group.
#[derive(Serialize)]
struct Channels {
    level: Vec<f32>,
    noise: f32,
}

/// Runs the command.
///
/// # Errors
/// The finger cannot be reached, or was not still.
pub fn run(args: Args) -> anyhow::Result<()> {
    let client = args.port.connect()?;
    let bias = match args.action {
        Action::Take => client.take_bias(args.scans)?,
        Action::Read => client.read_bias()?,
        Action::Clear => {
            client.clear_bias()?;
            client.read_bias()?
        }
        Action::Save => {
            client.save_bias()?;
            client.read_bias()?
        }
    };
    let report = report(&bias);
    if args.json {
        return output::json(&report);
    }
    output::line(match (bias.on_command, bias.in_contact) {
        (true, true) => "bias taken on command, while something seemed to touch the finger",
        (true, false) => "bias taken on command",
        (false, _) => "the calibration's own bias",
    })?;
    if let Some(taxels) = &report.taxels {
        output::line(format_args!("taxels      noise {:.6}", taxels.noise))?;
        for row in taxels.level.chunks(COLS) {
            output::line(format_args!("           {}", numbers(row)))?;
        }
    }
    for (i, sensor) in report.sensors.iter().enumerate() {
        if let Some(sensor) = sensor {
            let levels = numbers(&sensor.level);
            output::line(format_args!("sensor {i}   {levels}   noise {:.6}", sensor.noise))?;
        }
    }
    Ok(())
}

fn report(ActiveBias { bias, on_command, in_contact }: &ActiveBias) -> Report {
    let Bias { taxels, bridges } = bias;
    let sensor = |level: [f32; 3], noise| Channels { level: level.into(), noise };
    Report {
        on_command: *on_command,
        in_contact: *in_contact,
        taxels: taxels.map(|bias| Channels { level: bias.level.into(), noise: bias.noise }),
        sensors: bridges.iter().map(|b| b.map(|bias| sensor(bias.level, bias.noise))).collect(),
    }
}

fn numbers(levels: &[f32]) -> String {
    levels.iter().map(|level| format!(" {level:8.5}")).collect()
}
