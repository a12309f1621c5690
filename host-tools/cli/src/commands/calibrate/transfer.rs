//! `taxel calibrate upload` and `download`.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::Context;
use indicatif::ProgressBar;
use taxel::calibration::Calibration;
use taxel::estimate::quantised::Net;
use taxel::frame::Status;
use taxel_client::Port;
use taxel_files::calibration;

use crate::finger::{PortArg, record};
use crate::interrupt::Interrupt;
use crate::output::{self, Overwrite};

/// Uploads a calibration to a finger, activates it and reads it back.
///
/// If Ctrl-C, the cable or the power interrupts it, the previous or the new calibration is active
/// and whole. The last line states which.
#[derive(clap::Args)]
#[command(after_help = UPLOAD_EXAMPLES)]
pub struct UploadArgs {
    #[command(flatten)]
    port: PortArg,
    /// Calibration to upload.
    #[arg(long, value_name = "CAL.toml")]
    calibration: PathBuf,
}

const UPLOAD_EXAMPLES: &str = "\
Examples, with a finger and without one:
  taxel calibrate upload --port usb --calibration finger.toml
  taxel serve --port sim:tour --tcp 127.0.0.1:5000
  taxel calibrate upload --port tcp:127.0.0.1:5000 --calibration finger.toml";

/// Writes the finger's active calibration to a file.
#[derive(clap::Args)]
#[command(after_help = DOWNLOAD_EXAMPLES)]
pub struct DownloadArgs {
    #[command(flatten)]
    port: PortArg,
    /// File to write.
    #[arg(long, value_name = "CAL.toml")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

const DOWNLOAD_EXAMPLES: &str = "\
Example:
  taxel calibrate download --port usb:F-0042 --out F-0042.toml";

/// Outcome of an upload that ends before its commit.
const UNCHANGED: &str = "; the previous calibration stays active; upload again";
/// Outcome of an upload that ends at its commit.
const UNKNOWN: &str = "; the previous or the new calibration is active, complete in either case; \
                       see which with `taxel info`";

/// Runs `upload`.
///
/// The file is invalid, or the finger refused the record.
pub fn upload(args: UploadArgs) -> anyhow::Result<()> {
    let calibration = calibration::read(&args.calibration)?;
    let bytes = record(&calibration)?;
    let interrupt = Interrupt::watch()?;
    interrupt.outcome(UNCHANGED);
    let client = args.port.connect()?;
    let info = client.info()?;
    let bar = ProgressBar::new(bytes.len() as u64);
    let uploaded = client.upload_calibration(&bytes, |sent| {
        bar.set_position(sent as u64);
        if sent == bytes.len() {
            // The commit follows the last byte.
            interrupt.outcome(UNKNOWN);
        }
        if interrupt.came() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    bar.finish_and_clear();
    uploaded?;
    output::line(format!("{}: {} bytes uploaded and read back", args.port.port, bytes.len()))?;
    if let Port::Sim(_) | Port::File(_) = args.port.port {
        output::note(format_args!(
            "{0}: this virtual finger and its calibration end with the command; `taxel serve --port {0} \
             --tcp 127.0.0.1:5000` starts one that keeps running",
            args.port.port
        ));
    }
    for section in unsupported_sections(&calibration, info.estimators) {
        output::note(format_args!(
            "{}: the firmware of {} has no estimator for `{section}`: it stores the section and \
             ignores it",
            args.port.port, info.identity.board
        ));
    }
    Ok(())
}

/// Lists the sections of a record whose estimators the firmware does not have.
fn unsupported_sections(calibration: &Calibration, held: Status) -> Vec<&'static str> {
    let quantised = calibration.net.as_ref().and_then(Net::quantised);
    let sections = [
        ("quantised", quantised.is_some(), Status::RAN_QUANTISED),
        ("model", calibration.model.is_some(), Status::RAN_MODEL),
        ("slip", calibration.slip.is_some(), Status::RAN_SLIP),
        ("warmth", calibration.warmth.is_some(), Status::RAN_WARMTH),
        ("lag", calibration.lag.is_some(), Status::RAN_LAG),
        ("drift", calibration.drift.is_some(), Status::RAN_DRIFT),
        ("array", calibration.array.is_some(), Status::RAN_ARRAY),
    ];
    let passed =
        |(name, present, ran): (_, bool, _)| (present && !held.contains(ran)).then_some(name);
    sections.into_iter().filter_map(passed).collect()
}

/// Runs `download`.
///
/// The finger has no calibration, or the file cannot be written.
pub fn download(args: DownloadArgs) -> anyhow::Result<()> {
    output::keep([], &args.out, args.overwrite)?;
    let bytes = args.port.connect()?.download_calibration()?;
    let record = Calibration::from_bytes(&bytes)
        .map_err(|error| anyhow::anyhow!("the record read back is not a calibration: {error}"))
        .with_context(|| args.port.port.to_string())?;
    calibration::write(&args.out, &record)?;
    output::line(format!("wrote {}", args.out.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use taxel::estimate::slip::Slip;

    #[test]
    fn sections_without_estimator_are_listed() {
        let calibration = Calibration {
            model: Some(taxel::estimate::inverse::Inverse::default()),
            slip: Some(Slip::usual(0.5)),
            ..Calibration::default()
        };
        assert_eq!(unsupported_sections(&calibration, Status::BUILT), Vec::<&str>::new());
        assert_eq!(unsupported_sections(&calibration, Status::RAN_SLIP), ["model"]);
        assert_eq!(
            unsupported_sections(&Calibration::default(), Status::default()),
            Vec::<&str>::new()
        );
    }
}
