//! `taxel ports`: lists serial devices and fingers.

use serde_json::json;
use taxel_client::usb;

use crate::output;

/// Lists the serial devices of this machine; fingers by their permanent port name.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  taxel ports\n  taxel ports --json")]
pub struct Args {
    /// Print the list as JSON.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// Standard output is closed.
pub fn run(args: Args) -> anyhow::Result<()> {
    let devices = usb::devices();
    let port = |device: &usb::Device| match &device.finger {
        Some(serial) => format!("usb:{serial}"),
        None => device.name.clone(),
    };
    if args.json {
        let list: Vec<_> = devices
            .iter()
            .map(|d| json!({ "port": port(d), "device": d.name, "product": d.product, "finger": d.finger.is_some() }))
            .collect();
        return output::json(&list);
    }
    if devices.is_empty() {
        output::note("no serial device found; `sim:tour` is a simulated finger");
    }
    devices.iter().try_for_each(|device| {
        output::line(
            format!("{:24} {:16} {}", port(device), device.name, device.product).trim_end(),
        )
    })
}
