//! `taxel calibrate adjust`.

use std::path::PathBuf;

use serde::Serialize;
use taxel::scan::{SENSORS, TAXELS};
use taxel_calibrate::adjust::{self, Adjusted, Part};
use taxel_files::calibration;
use taxel_files::recording::Scans;
use taxel_files::stretch::Stretch;
use taxel_regress::error::FitError;

use super::data::{self, Aligned};
use super::{bar, now, show};
use crate::interrupt::Interrupt;
use crate::output::{self, Overwrite};

/// Updates a calibration from a few presses of known weight, without moving the finger.
///
/// Found again: the zero, the light of each taxel, the stiffness of the skin, and the gains of the
/// force sensors. Each is judged on presses that it was not found from, and kept only if it makes
/// some quantity better and none worse by more than 5 % (10 % for a zero that ends contacts at
/// rest). Three presses are the least; nine, spread over the finger, are better. Each recording
/// must begin with 0.5 s without contact. Ctrl-C writes the record with what was kept so far.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A recording of presses, or a stretch of it in seconds; may be given several times.
    #[arg(long, value_name = "FILE[@FROM..TO]", required = true)]
    data: Vec<Stretch>,
    /// Force of every contact of 0.3 s or longer: a weight at rest, in newtons straight down.
    /// The stiffness of the skin is found if the pad was pressed hard all over before, briefly.
    /// Without this option the reference columns fx_n fy_n fz_n (or s0_fx_n …) give the force.
    #[arg(long, value_name = "NEWTONS", value_parser = weight)]
    weight: Option<f64>,
    /// Reference that another clock logged, one for each --data, as for `calibrate fit`.
    #[arg(long, value_name = "FILE", conflicts_with = "weight", group = "references")]
    reference: Vec<PathBuf>,
    #[command(flatten)]
    cell: data::Cell,
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
    /// Gains of the parts that were kept.
    taxel_gains: Vec<f64>,
    stiffness: f64,
    sensor_gains: [[f64; 3]; SENSORS],
    array_gains: [f64; 3],
    parts: Vec<Tried>,
    errors: Vec<Error>,
    shares: Vec<Share>,
    /// Whether nothing has aged.
    unaged: bool,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    alignments: Vec<Aligned>,
    warnings: Vec<String>,
    /// Whether Ctrl-C came before all parts were tried.
    interrupted: bool,
}

/// Part of the record, and whether it was kept and why.
#[derive(Serialize)]
struct Tried {
    part: String,
    kept: bool,
    why: String,
}

/// RMS error of a quantity over the presses, newtons or mm.
#[derive(Serialize)]
struct Error {
    by: &'static str,
    quantity: String,
    before: f64,
    /// With the new zero alone.
    zeroed: f64,
    /// On presses that the gains were not found from.
    after: f64,
}

/// Share of rows of the whole finger, 0 to 1.
#[derive(Serialize)]
struct Share {
    name: &'static str,
    before: f64,
    zeroed: f64,
    after: f64,
}

impl Outcome {
    fn new(calibration: PathBuf, adjusted: Adjusted, alignments: Vec<Aligned>) -> Self {
        let three = |part| {
            let gains = adjusted.gains(part).and_then(|gains| gains.try_into().ok());
            gains.unwrap_or([1.0; 3])
        };
        let gains = adjusted.gains(Part::Light);
        let taxel_gains = gains.map_or_else(|| vec![1.0; TAXELS], <[f64]>::to_vec);
        let stiffness = adjusted.gains(Part::Skin).and_then(<[f64]>::first).copied();
        Self {
            calibration,
            presses: adjusted.presses,
            taxel_gains,
            stiffness: stiffness.unwrap_or(1.0),
            sensor_gains: std::array::from_fn(|i| three(Part::Sensor(i))),
            array_gains: three(Part::Array),
            parts: adjusted.parts.iter().map(Tried::from).collect(),
            errors: adjusted.errors.into_iter().map(Error::from).collect(),
            shares: adjusted.shares.into_iter().map(Share::from).collect(),
            unaged: adjusted.unaged,
            alignments,
            warnings: adjusted.warnings,
            interrupted: adjusted.stopped,
        }
    }
}

impl From<&adjust::Tried> for Tried {
    fn from(adjust::Tried { part, gains, kept, why }: &adjust::Tried) -> Self {
        let [least, most] = [f64::min, f64::max].map(|of| gains.iter().copied().reduce(of));
        let range = match (&gains[..], least.zip(most)) {
            ([only], _) => format!(" × {only:.3}"),
            (_, Some((least, most))) => format!(" × {least:.3} … {most:.3}"),
            _ => String::new(),
        };
        Self { part: format!("{part}{range}"), kept: *kept, why: why.clone() }
    }
}

impl From<adjust::Error> for Error {
    fn from(adjust::Error { by, quantity, before, zeroed, after }: adjust::Error) -> Self {
        Self { by, quantity, before, zeroed, after }
    }
}

impl From<adjust::Share> for Share {
    fn from(adjust::Share { name, before, zeroed, after }: adjust::Share) -> Self {
        Self { name, before, zeroed, after }
    }
}

/// Refuses a recording whose active calibration is of another finger.
///
/// The serial number of the chip is no name of a finger, and is not compared.
fn same_serial(data: &[Stretch], record: &str) -> anyhow::Result<()> {
    for path in data.iter().map(|stretch| &stretch.path) {
        let Some(active) = Scans::open(path)?.calibration else { continue };
        let own = active.serial.as_str();
        anyhow::ensure!(
            own.is_empty() || record.is_empty() || own == record,
            "{}: recorded with the calibration of finger `{own}`, but --calibration is of `{record}`; \
             give that of `{own}`, or upload that of `{record}` and record again",
            path.display()
        );
    }
    Ok(())
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
    let bar = bar("reading the recordings")?;
    let data::Read { mut recordings, alignments } =
        data::traces(&args.data, (&args.reference, args.cell), old.lag)?;
    same_serial(&args.data, &old.serial)?;
    if let Some(newtons) = args.weight {
        for recording in &mut recordings {
            adjust::weigh(&old, recording, newtons)?;
        }
    }
    // Before this Ctrl-C ends the process as the system does.
    let interrupt = Interrupt::watch()?;
    interrupt.outcome("; nothing was written");
    let mut progress = |progress| show(&bar, progress);
    let adjusted = match adjust::adjust(&old, &recordings, now(), &mut progress, interrupt.flag()) {
        Err(FitError::Stopped) => anyhow::bail!("stopped early; nothing was written"),
        adjusted => adjusted?,
    };
    interrupt.finishing();
    bar.finish_and_clear();
    calibration::write(&args.out, &adjusted.calibration)?;
    for warning in &adjusted.warnings {
        output::note(format_args!("taxel: warning: {warning}"));
    }
    if adjusted.stopped {
        output::note("taxel: stopped early: the parts kept so far were written, others not tried");
    }
    let outcome = Outcome::new(args.out, adjusted, alignments);
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
    for Tried { part, kept, why } in &outcome.parts {
        output::line(format!("{part}: {} ({why})", if *kept { "kept" } else { "left out" }))?;
    }
    output::line("RMS error                   before  new zero  adjusted, on presses not used")?;
    for Error { by, quantity, before, zeroed, after } in &outcome.errors {
        let unit = if quantity.ends_with("mm") { "µm" } else { "mN" };
        let [before, zeroed, after] = [before, zeroed, after].map(|error| 1e3 * error);
        output::line(format!(
            "{by:<14}{quantity:<10}{before:>10.1}{zeroed:>10.1}{after:>10.1} {unit}"
        ))?;
    }
    for Share { name, before, zeroed, after } in &outcome.shares {
        let [before, zeroed, after] = [before, zeroed, after].map(|share| 100.0 * share);
        output::line(format!("{name:<25}{before:>9.1}{zeroed:>10.1}{after:>10.1} %"))?;
    }
    if outcome.unaged {
        output::line("nothing has aged; the record is unchanged")?;
    }
    output::line(format!("wrote {}", outcome.calibration.display()))
}
