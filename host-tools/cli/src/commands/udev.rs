//! `taxel udev`: udev rules that let users open a finger.

use crate::output;

/// Text of the rule file.
const RULES: &str = include_str!("../../assets/70-taxel.rules");

/// Prints the udev rules of a finger: access, a stable device name, no modem manager.
#[derive(clap::Args)]
#[command(after_help = "Example: taxel udev | sudo tee /etc/udev/rules.d/70-taxel.rules
         sudo udevadm control --reload && sudo udevadm trigger")]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// Standard output is closed.
pub fn run(_: Args) -> anyhow::Result<()> {
    output::line(RULES.trim_end())
}

#[cfg(test)]
mod tests {
    use taxel_client::usb::{MANUFACTURER, PRODUCT, VENDOR};

    #[test]
    fn udev_rule_matches_usb_ids() {
        for part in [
            format!("ATTRS{{idVendor}}==\"{VENDOR:04x}\""),
            format!("ATTRS{{idProduct}}==\"{PRODUCT:04x}\""),
            format!("ATTRS{{manufacturer}}==\"{MANUFACTURER}\""),
        ] {
            assert!(super::RULES.contains(&part), "{part}");
        }
    }
}
