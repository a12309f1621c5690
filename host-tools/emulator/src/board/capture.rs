//! USB capture in the format of Linux's usbmon, readable by any dissector.

use super::time::{HZ, Tick};

/// Link type USB_LINUX_MMAPPED.
const LINK_TYPE: u32 = 220;

/// Kind of a transfer, with usbmon's number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Control transfer: a request.
    Control = 2,
    /// Bulk transfer: data.
    Bulk = 3,
}

/// USB transfer, or one packet of a bulk endpoint.
#[derive(Clone, Debug)]
pub struct Urb {
    /// Kind of the transfer.
    pub kind: Kind,
    /// Address of the device.
    pub address: u8,
    /// Endpoint; bit 7 is set for transfers to the host.
    pub endpoint: u8,
    /// SETUP packet of a control transfer.
    pub setup: Option<[u8; 8]>,
    /// Data sent or received.
    pub data: Vec<u8>,
    /// Begin of the transfer.
    pub begun: Tick,
    /// End of the transfer.
    pub done: Tick,
    /// Whether the device answered with a stall.
    pub stalled: bool,
}

/// Bytes of a pcap file with these transfers.
pub fn pcap(urbs: &[Urb]) -> Vec<u8> {
    let mut file = Vec::new();
    for word in [0xa1b2_c3d4, 2 | 4 << 16, 0, 0, 0x4_0000, LINK_TYPE] {
        file.extend(u32::to_le_bytes(word));
    }
    for (number, urb) in urbs.iter().enumerate() {
        packet(&mut file, number as u64 + 1, urb, false);
        packet(&mut file, number as u64 + 1, urb, true);
    }
    file
}

/// Appends the packet of a transfer's submission, or of its completion.
fn packet(file: &mut Vec<u8>, number: u64, urb: &Urb, complete: bool) {
    // -EINPROGRESS, -EPIPE
    let status: i32 = match (complete, urb.stalled) {
        (false, _) => -115,
        (true, true) => -32,
        (true, false) => 0,
    };
    // Data to the device go with the submission, data to the host with the completion.
    let data: &[u8] = if (urb.endpoint & 0x80 != 0) == complete { &urb.data } else { &[] };
    let us = if complete { urb.done } else { urb.begun } / (HZ / 1_000_000);
    let (seconds, micros) = (us / 1_000_000, us % 1_000_000);
    let wanted = urb
        .setup
        .map_or(urb.data.len(), |setup| usize::from(u16::from_le_bytes([setup[6], setup[7]])));
    let length = if complete { urb.data.len() } else { wanted };

    let mut header = Vec::with_capacity(64);
    header.extend(number.to_le_bytes());
    header.extend([if complete { b'C' } else { b'S' }, urb.kind as u8, urb.endpoint, urb.address]);
    // The bus number; then flags for a setup packet and for data, zero if present.
    header.extend(1u16.to_le_bytes());
    header.push(if urb.setup.is_some() && !complete { 0 } else { b'-' });
    header.push(match (data.is_empty(), urb.endpoint & 0x80 != 0) {
        (false, _) => 0,
        (true, true) => b'<',
        (true, false) => b'>',
    });
    header.extend(seconds.to_le_bytes());
    header.extend((micros as u32).to_le_bytes());
    header.extend(status.to_le_bytes());
    header.extend((length as u32).to_le_bytes());
    header.extend((data.len() as u32).to_le_bytes());
    header.extend(urb.setup.filter(|_| !complete).unwrap_or_default());
    // Interval, start frame, flags, isochronous descriptors.
    header.extend([0; 16]);

    let captured = (header.len() + data.len()) as u32;
    for word in [seconds as u32, micros as u32, captured, captured] {
        file.extend(word.to_le_bytes());
    }
    file.extend(header);
    file.extend(data);
}
