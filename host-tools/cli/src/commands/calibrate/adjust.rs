//! `taxel calibrate adjust`.

use std::path::PathBuf;

use serde::Serialize;
use taxel_calibrate::adjust;
use taxel_files::calibration;
use taxel_files::stretch::Stretch;

use super::data::{self, Aligned};
use super::now;
use crate::output::{self, Overwrite};

/// Updates a calibration from a few presses of known weight, without moving the finger.
///
/// Fitted again: bias, one gain per taxel (for the net and the model of the skin alike) and one per
/// row of each sensor's matrix. All else stays. Three presses are the least; nine, spread over the
/// finger, are better. Each recording must begin with 0.5 s without contact.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A recording of presses, or a stretch of it in seconds; may be given several times.
    #[arg(long, value_name = "FILE[@FROM..TO]", required = true)]
    data: Vec<Stretch>,
    /// Force of every contact in the recordings: a weight at rest, in newtons straight down.
    /// Without this option the reference columns fx_n fy_n fz_n (or s0_fx_n …) give the force.
    #[arg(long, value_name = "NEWTONS", value_parser = weight)]
    weight: Option<f64>,
    /// Reference that another clock logged, one for each --data, as for `calibrate fit`.
    #[arg(long, value_name = "FILE", conflicts_with = "weight")]
    reference: Vec<PathBuf>,
    /// The calibration to start from.
    #[arg(long, value_name = "OLD.toml")]
    calibration: PathBuf,
    /// The calibration to write.
    #[arg(long, value_name = "NEW.toml")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Print the outcome as JSON.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  taxel calibrate adjust --calibration finger.toml --data presses.csv --out today.toml
  taxel calibrate adjust --calibration finger.toml --data 50g.csv --weight 0.4905 --out today.toml
  taxel calibrate adjust --calibration finger.toml --data presses.csv --reference cell.csv --out today.toml";

fn weight(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(newtons) if newtons > 0.0 && newtons < 1000.0 => Ok(newtons),
        _ => Err("expected newtons, more than 0, as in 0.4905 for 50 g".into()),
    }
}

/// Result of an adjustment, as JSON.
#[derive(Serialize)]
struct Outcome {
    calibration: PathBuf,
    presses: usize,
    taxel_gains: Vec<f64>,
    sensor_gains: [Option<[f64; 3]>; 4],
    /// Errors of each estimator of the taxels.
    errors: Vec<Error>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    alignments: Vec<Aligned>,
    warnings: Vec<String>,
}

/// RMS error of f_z over the presses, newtons.
#[derive(Serialize)]
struct Error {
    estimator: &'static str,
    /// With the new bias, before the gains.
    before: f64,
    /// On presses left out of the fit of the gains.
    after: f64,
}

impl From<adjust::Helped> for Error {
    fn from(adjust::Helped { estimator, before, after }: adjust::Helped) -> Self {
        Self { estimator, before, after }
    }
}

/// Runs the command.
///
/// A file is invalid, or the recordings lack presses.
pub fn run(args: Args) -> anyhow::Result<()> {
    let data = args.data.iter().map(|data| data.path.as_path());
    let references = args.reference.iter().map(PathBuf::as_path);
    output::keep(
        data.chain(references).chain([args.calibration.as_path()]),
        &args.out,
        args.overwrite,
    )?;
    let old = calibration::read(&args.calibration)?;
    let data::Read { mut recordings, alignments } =
        data::traces(&args.data, &args.reference, old.lag)?;
    if let Some(newtons) = args.weight {
        for recording in &mut recordings {
            adjust::weigh(&old, recording, newtons)?;
        }
    }
    let adjusted = adjust::adjust(&old, &recordings, now())?;
    calibration::write(&args.out, &adjusted.calibration)?;
    for warning in &adjusted.warnings {
        output::note(format_args!("taxel: warning: {warning}"));
    }
    let outcome = Outcome {
        calibration: args.out,
        presses: adjusted.presses,
        taxel_gains: adjusted.taxels,
        sensor_gains: adjusted.sensors,
        errors: adjusted.helped.into_iter().map(Error::from).collect(),
        alignments,
        warnings: adjusted.warnings,
    };
    if args.json {
        return output::json(&outcome);
    }
    print(&outcome)
}

fn print(outcome: &Outcome) -> anyhow::Result<()> {
    for aligned in &outcome.alignments {
        output::line(aligned.describe())?;
    }
    output::line(format!("{} presses", outcome.presses))?;
    for Error { estimator, before, after } in &outcome.errors {
        output::line(format!(
            "{estimator}: RMS error of fz {:.2} mN with the new bias alone, {:.2} mN on presses left out of the \
             gains",
            before * 1e3,
            after * 1e3
        ))?;
    }
    for row in outcome.taxel_gains.chunks(4) {
        let row: Vec<String> = row.iter().map(|gain| format!("{gain:.3}")).collect();
        output::line(format!("gains  {}", row.join("  ")))?;
    }
    for (i, gains) in outcome.sensor_gains.iter().enumerate() {
        if let Some([x, y, z]) = gains {
            output::line(format!("s{i}: gains {x:.3} {y:.3} {z:.3}"))?;
        }
    }
    output::line(format!("wrote {}", outcome.calibration.display()))
}
