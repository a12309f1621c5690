//! `cargo xtask cycles`: the cost of every stage of the core on an emulated Cortex-M4F.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use clap::Args;

use crate::costs::{self, Stage};
use crate::emulator::{built, cargo, directory};
use crate::firmware::{self, PRODUCT};
use crate::run::{program, root, run, setup, target};

/// The crate of `boards/` that calls the stages.
const IMAGE: &str = "cycles";

/// Arguments of `cargo xtask cycles`.
#[derive(Args)]
pub struct Cycles {
    /// Only stages whose name contains this
    #[arg(long, default_value = "")]
    filter: String,
    /// Also writes the table here
    #[arg(long)]
    csv: Option<PathBuf>,
    /// Shows the cycles of each function
    #[arg(long)]
    profile: bool,
    /// Shows the cycles of each function of the product's own image while it streams
    #[arg(long, conflicts_with_all = ["filter", "csv", "profile"])]
    board: bool,
}

/// `cargo xtask cycles`.
pub fn task(arguments: &Cycles) -> Result<()> {
    setup(&["boards", "emulator"])?;
    if arguments.board {
        let (image, _) = firmware::build(PRODUCT)?;
        return run(&mut emulator(from_source(), "profile", &image));
    }
    let image = image()?;
    let mut emulator = emulator(from_source(), "cycles", &image);
    emulator.args(["--filter", &arguments.filter]);
    if let Some(path) = &arguments.csv {
        emulator.arg("--csv").arg(std::path::absolute(path)?);
    }
    if arguments.profile {
        emulator.arg("--profile");
    }
    run(&mut emulator)
}

/// Fails where a stage, scene, net or product frame exceeds its limit of cycles.
///
/// The limits are the committed table, [`SCENES`], [`NETS`] and half a frame. The emulator must
/// have been built.
pub fn guard() -> Result<()> {
    let counted = target().join("cycles.csv");
    let mut emulator = emulator(program(built(), &directory()), "cycles", &image()?);
    emulator.arg("--csv").arg(&counted);
    run(emulator.arg("--against").arg(table()))?;
    let counted = costs::read(&counted)?;
    within_their_cycles(&counted)?;
    scenes_within_their_cycles(&counted)?;
    let page = page();
    let text = std::fs::read_to_string(&page).with_context(|| page.display().to_string())?;
    within_half_a_frame(&counted, &text)
}

/// Nets of [DeMaria2011] and their limits in modelled cycles.
///
/// A stage may grow by a tenth from one committed table to the next; a net may never exceed its
/// limit.
const NETS: [(&str, u64); 2] = [("net 16-16-3", 1_900), ("q15 net 16-16-3", 900)];

/// Fails where one of the [`NETS`] exceeds its limit.
fn within_their_cycles(table: &[Stage]) -> Result<()> {
    for (net, most) in NETS {
        let stage = table.iter().find(|stage| stage.name == net);
        let Stage { cycles, .. } =
            stage.with_context(|| format!("the table has no stage `{net}`"))?;
        if *cycles > most {
            bail!("{net}: {cycles} cycles, at most {most}; reduce its cost");
        }
    }
    Ok(())
}

/// Scenes of the reference finger with every section that a default fit writes, and their limits in
/// modelled cycles: mean and worst scan.
const SCENES: [(&str, [u64; 2]); 8] = [
    ("finger: no contact, no frame due", [3_900, 4_800]),
    ("finger: no contact, estimates", [7_300, 8_200]),
    ("finger: normal contact, estimates", [18_600, 29_200]),
    ("finger: normal contact, frames at 1 kHz", [9_250, 29_000]),
    ("finger: shear, estimates", [22_650, 34_100]),
    ("finger: shear, frames at 1 kHz", [11_600, 33_200]),
    ("finger: two contacts, estimates", [21_350, 36_400]),
    ("finger: two contacts, frames at 1 kHz", [10_150, 36_600]),
];

/// Fails where the mean or the worst scan of one of the [`SCENES`] exceeds its limit.
fn scenes_within_their_cycles(table: &[Stage]) -> Result<()> {
    for (scene, [mean, worst]) in SCENES {
        let stage = table.iter().find(|stage| stage.name == scene);
        let stage = stage.with_context(|| format!("the table has no stage `{scene}`"))?;
        let Stage { cycles, mean_cycles, .. } = stage;
        if *cycles > worst || *mean_cycles > mean as f64 {
            bail!(
                "{scene}: {mean_cycles:.0} cycles in the mean and {cycles} in the worst scan, at most {mean} and \
                 {worst}; reduce its cost"
            );
        }
    }
    Ok(())
}

/// Prefix of the names of stages that are a whole frame of the product.
const FRAME: &str = "product: ";
/// Cycles of half a frame at 170 MHz and 4 kHz.
const HALF_A_FRAME: u64 = 170_000_000 / 4_000 / 2;

/// Path of the product's page.
fn page() -> PathBuf {
    root().join("docs/boards").join(PRODUCT).with_extension("md")
}

/// Fails where a frame of the product takes half of its time or more.
///
/// The other half belongs to USB and to the user's code. The stages do not include the frame's
/// interrupt; its cycles come from the product's page, which the emulator's tests hold to the
/// image.
fn within_half_a_frame(table: &[Stage], page: &str) -> Result<()> {
    const INTERRUPT: &str = "| reading: the frame's interrupt |";
    let row = page.lines().find_map(|line| line.strip_prefix(INTERRUPT));
    let digits = |cell: &str| cell.chars().filter(char::is_ascii_digit).collect::<String>();
    let interrupt = row.and_then(|row| digits(row.split('|').next()?).parse::<u64>().ok());
    let interrupt = interrupt.with_context(|| format!("the page has no row `{INTERRUPT} …`"))?;
    let mut frames = table.iter().filter(|stage| stage.name.starts_with(FRAME)).peekable();
    if frames.peek().is_none() {
        bail!("the table has no stage {FRAME}…: boards/cycles/src/stages/product.rs");
    }
    for Stage { name, cycles, .. } in frames {
        if cycles + interrupt >= HALF_A_FRAME {
            bail!(
                "{name}: {cycles} cycles and {interrupt} of the interrupt, more than half a frame at 4 kHz \
                 ({HALF_A_FRAME})"
            );
        }
    }
    Ok(())
}

fn image() -> Result<PathBuf> {
    firmware::build(IMAGE).map(|(path, _)| path)
}

/// Path of the committed table of costs.
fn table() -> PathBuf {
    directory().join("data/cycles.csv")
}

/// Returns a command that builds and runs the emulator.
fn from_source() -> Command {
    let mut command = cargo("run");
    command.arg("--");
    command
}

/// Adds the task to the emulator's command: `image` with the committed finger and scans.
fn emulator(mut command: Command, task: &str, image: &Path) -> Command {
    command.arg(task).arg(image);
    command.arg("--calibration").arg(directory().join("data/finger.cal.toml"));
    command.arg("--scans").arg(directory().join("data/scans.csv"));
    command.arg("--whole").arg(directory().join("data/whole"));
    command
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn committed_product_frames_fit_half_their_time() {
        let table = costs::read(&super::table()).unwrap();
        within_half_a_frame(&table, &std::fs::read_to_string(page()).unwrap()).unwrap();
    }

    #[test]
    fn committed_nets_stay_within_their_cycles() {
        within_their_cycles(&costs::read(&super::table()).unwrap()).unwrap();
    }

    #[test]
    fn committed_scenes_stay_within_their_cycles() {
        scenes_within_their_cycles(&costs::read(&super::table()).unwrap()).unwrap();
    }

    #[test]
    fn costly_or_missing_scene_is_an_error() {
        let judged = |more: [u64; 2]| {
            let row = |(i, (scene, [mean, worst])): (usize, &(&str, [u64; 2]))| {
                let [more_mean, more_worst] = if i == 3 { more } else { [0; 2] };
                format!("\"{scene}\",{},{}\n", worst + more_worst, mean + more_mean)
            };
            let rows: String = SCENES.iter().enumerate().map(row).collect();
            let table = format!("name,cycles_high,mean_cycles_high\n{rows}");
            scenes_within_their_cycles(&costs::parse(&table).unwrap())
        };
        assert!(judged([0, 0]).is_ok());
        for more in [[1, 0], [0, 1]] {
            let refused = judged(more).unwrap_err().to_string();
            assert!(refused.starts_with("finger: normal contact, frames at 1 kHz: "), "{refused}");
        }
        assert!(scenes_within_their_cycles(&[]).is_err());
    }

    #[test]
    fn costly_or_missing_net_is_an_error() {
        let judged = |rows: &str| {
            let table = costs::parse(&format!("name,cycles_high\n{rows}")).unwrap();
            within_their_cycles(&table).map_err(|error| error.to_string())
        };
        assert_eq!(judged("net 16-16-3,1900\nq15 net 16-16-3,900\n"), Ok(()));
        let costly = judged("net 16-16-3,1900\nq15 net 16-16-3,901\n").unwrap_err();
        assert!(costly.starts_with("q15 net 16-16-3: 901 cycles, at most 900"), "{costly}");
        assert!(judged("net 16-16-3,1900\n").unwrap_err().contains("no stage `q15 net 16-16-3`"));
    }

    #[test]
    fn costly_or_missing_frame_is_an_error() {
        let table = |rows: &str| costs::parse(&format!("name,cycles_high\n{rows}")).unwrap();
        let with = |cycles: u64| table(&format!("\"product: a, b\",{cycles}\n\"other\",99999\n"));
        let page = "| reading: the frame's interrupt | 1 081 | 3 % |";
        assert!(within_half_a_frame(&with(HALF_A_FRAME - 1_082), page).is_ok());
        let refused =
            within_half_a_frame(&with(HALF_A_FRAME - 1_081), page).unwrap_err().to_string();
        assert!(refused.contains("a, b: 20169 cycles and 1081 of the interrupt"), "{refused}");
        assert!(within_half_a_frame(&table("\"other\",3\n"), page).is_err());
        assert!(within_half_a_frame(&with(1), "").is_err());
    }
}
