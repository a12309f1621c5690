//! `taxel dfu`: restarts the finger in its chip's bootloader, for new firmware.

use crate::finger::PortArg;
use crate::output;

/// Restarts the finger in its chip's own bootloader, where `dfu-util` finds it. See docs/boards.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    port: PortArg,
}

const EXAMPLES: &str = "\
Example:
  taxel dfu && dfu-util -a 0 -s 0x08000000:leave -D stm32g431.bin";

/// Runs the command.
///
/// # Errors
/// The finger cannot be reached, or has no bootloader.
pub fn run(args: Args) -> anyhow::Result<()> {
    args.port.connect()?.bootloader()?;
    output::line("in the bootloader; `dfu-util --list` shows it")
}
