//! Fingers on USB, found by their descriptors.

use serialport::{SerialPortType, UsbPortInfo};

use crate::error::Problem;

/// USB vendor id, as in `boards/common`. It is for testing and shared, so the manufacturer is
/// checked too.
pub const VENDOR: u16 = 0x1209;
/// USB product id.
pub const PRODUCT: u16 = 0x0001;
/// USB manufacturer.
pub const MANUFACTURER: &str = "taxel";

/// Serial device of this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Device {
    /// Name in the operating system.
    pub name: String,
    /// Serial number, if it is a finger.
    pub finger: Option<String>,
    /// Manufacturer and product.
    pub product: String,
}

/// Lists the serial devices; none where the system cannot.
#[must_use]
pub fn devices() -> Vec<Device> {
    let ports = serialport::available_ports().unwrap_or_default();
    let device = |port: serialport::SerialPortInfo| match port.port_type {
        SerialPortType::UsbPort(usb) => Device {
            name: port.port_name,
            finger: is_finger(&usb).then(|| usb.serial_number.clone().unwrap_or_default()),
            product: [usb.manufacturer, usb.product]
                .into_iter()
                .flatten()
                .collect::<Vec<_>>()
                .join(" "),
        },
        _ => Device { name: port.port_name, finger: None, product: String::new() },
    };
    let mut devices: Vec<_> = ports.into_iter().map(device).collect();
    devices.sort_by(|a, b| a.name.cmp(&b.name));
    devices
}

fn is_finger(usb: &UsbPortInfo) -> bool {
    (usb.vid, usb.pid) == (VENDOR, PRODUCT) && usb.manufacturer.as_deref() == Some(MANUFACTURER)
}

/// Finds the finger of this serial number, or the only one.
pub(crate) fn find(devices: &[Device], serial: Option<&str>) -> Result<String, Problem> {
    let fingers: Vec<(&str, &Device)> =
        devices.iter().filter_map(|d| Some((d.finger.as_deref()?, d))).collect();
    let list =
        || fingers.iter().map(|(serial, _)| format!("usb:{serial}")).collect::<Vec<_>>().join(", ");
    match (serial, fingers.as_slice()) {
        (_, []) => Err(Problem::NoFinger(
            "no finger on USB; plug it in, or choose another port with --port: `taxel ports` lists them, \
             sim:tour is a simulated finger"
                .to_owned(),
        )),
        (None, [(_, only)]) => Ok(only.name.clone()),
        (None, _) => {
            Err(Problem::NoFinger(format!("several fingers on USB; choose from {}", list())))
        }
        (Some(serial), fingers) => match fingers.iter().find(|(its, _)| *its == serial) {
            Some((_, device)) => Ok(device.name.clone()),
            None => Err(Problem::NoFinger(format!("not on USB; there are {}", list()))),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn usb(vid: u16, pid: u16, manufacturer: &str) -> UsbPortInfo {
        UsbPortInfo {
            vid,
            pid,
            serial_number: Some("F-1".to_owned()),
            manufacturer: Some(manufacturer.to_owned()),
            product: None,
        }
    }

    #[test]
    fn finger_is_recognised_by_ids_and_manufacturer() {
        assert!(is_finger(&usb(VENDOR, PRODUCT, "taxel")));
        assert!(!is_finger(&usb(VENDOR, PRODUCT, "somebody else")));
        assert!(!is_finger(&usb(0x0483, 0x5740, "taxel")));
    }

    #[test]
    fn several_fingers_need_serial_number() {
        let device = |name: &str, serial: &str| Device {
            name: name.to_owned(),
            finger: Some(serial.to_owned()),
            product: String::new(),
        };
        let other = Device { name: "/dev/ttyS0".into(), finger: None, product: String::new() };
        let said = |devices: &[Device], serial| match find(devices, serial) {
            Ok(name) => name,
            Err(problem) => problem.to_string(),
        };
        let one = [other.clone(), device("/dev/ttyACM3", "A")];
        assert_eq!(said(&one, None), "/dev/ttyACM3");
        assert_eq!(said(&one, Some("A")), "/dev/ttyACM3");
        assert_eq!(said(&one, Some("B")), "not on USB; there are usb:A");
        let two = [device("/dev/ttyACM0", "A"), device("/dev/ttyACM1", "B")];
        assert_eq!(said(&two, Some("B")), "/dev/ttyACM1");
        assert_eq!(said(&two, None), "several fingers on USB; choose from usb:A, usb:B");
        assert!(said(&[other], None).starts_with("no finger on USB; plug it in"));
    }

    /// Compares with the firmware's source, because the firmware is in another workspace.
    #[test]
    fn usb_ids_match_firmware() {
        let source = include_str!("../../../boards/common/src/link.rs");
        for line in [
            format!("const VENDOR: u16 = {VENDOR:#06x};"),
            format!("const PRODUCT: u16 = {PRODUCT:#06x};"),
            format!("config.manufacturer = Some({MANUFACTURER:?});"),
        ] {
            assert!(source.contains(&line), "{line}");
        }
    }
}
