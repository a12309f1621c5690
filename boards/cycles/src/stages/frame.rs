//! Stages of a whole scan, from codes to wire bytes, as the session runs it.

use core::hint::black_box;

use serde::{Serialize, Serializer};
use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::frame::{Fields, Frame, FrameRef};
use taxel::instrument::Instrument;
use taxel::scan::Scan;
use taxel::store::{RamFlash, Store};
use taxel::units::FullScale;
use taxel::wire::message::{Command, Identity, Request};
use taxel::wire::{MAX_PACKET, pack_frame};

use crate::Meter;
use crate::host::Inputs;

/// Packet on the wire.
pub struct Packet {
    bytes: [u8; MAX_PACKET],
    length: usize,
}

impl Packet {
    pub const EMPTY: Self = Self { bytes: [0; MAX_PACKET], length: 0 };

    fn pack<'f>(&mut self, frame: impl Into<FrameRef<'f>>) {
        self.length = pack_frame(frame, &mut self.bytes).map_or(0, <[u8]>::len);
    }
}

impl Serialize for Packet {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(self.bytes.get(..self.length).unwrap_or_default())
    }
}

/// Instrument whose contact gate has settled on the first scans.
fn warm(record: &[u8], fields: Fields, scans: impl Iterator<Item = Scan>) -> Instrument {
    let mut instrument = instrument(record, fields, None);
    for scan in scans.take(8) {
        instrument.scan(&scan);
    }
    instrument
}

/// Instrument that streams every scan, after the commands in `asked`.
pub fn instrument(
    record: &[u8],
    fields: Fields,
    asked: impl IntoIterator<Item = Command>,
) -> Instrument {
    const SCAN_HZ: u16 = 4000;
    let mut instrument = Instrument::new(Identity {
        board: heapless::String::new(),
        serial: heapless::String::new(),
        build: heapless::String::new(),
        scan_hz: SCAN_HZ,
        full_scale: FullScale::BITS_16,
        tick_hz: 0,
    });
    let mut store = Store::new(RamFlash::new([0; RamFlash::SIZE]));
    // The record was read once already, so that installing it cannot fail.
    let _ = instrument.install(record, &mut store);
    let commands =
        [Command::SetRate { hz: SCAN_HZ }, Command::SetFields(fields), Command::Stream(true)];
    for (tag, command) in (0..).zip(commands.into_iter().chain(asked)) {
        let _ = instrument.handle(&Request { tag, command }, &mut store);
    }
    instrument
}

pub fn whole(instrument: &mut Instrument, scan: &Scan, packet: &mut Packet) {
    packet.length = 0;
    let outcome = instrument.scan(scan);
    if outcome.frame {
        packet.pack(instrument.frame(scan));
    }
    if outcome.reply {
        let _ = black_box(instrument.take_reply());
    }
}

/// Stages with the net and the sensors' own sections; other sections have their own stages.
pub fn stages(inputs: &Inputs<'_>, calibration: &Calibration, meter: &mut impl Meter) {
    let plain = Calibration { model: None, slip: None, array: None, ..calibration.clone() };
    let mut buffer = [0; MAX_BYTES];
    // A rejected record leaves nothing to measure, and the meter's owner reports that.
    let Ok(record) = plain.to_bytes(&mut buffer) else { return };
    let mut packet = Packet::EMPTY;
    let out = &mut packet;
    for (name, fields) in [
        ("codes to wire bytes, no contact, every field", Fields::ALL),
        ("codes to wire bytes, no contact, estimates", Fields::ESTIMATES),
    ] {
        let mut instrument = warm(record, fields, inputs.free());
        meter.stage(name, &mut instrument, inputs.free(), out, whole);
    }
    for (name, fields) in [
        ("codes to wire bytes, contact, every field", Fields::ALL),
        ("codes to wire bytes, contact, estimates", Fields::ESTIMATES),
    ] {
        let mut instrument = warm(record, fields, inputs.touched());
        meter.stage(name, &mut instrument, inputs.touched(), out, whole);
    }
    let mut quiet = warm(record, Fields::ALL, inputs.touched());
    meter.stage("estimates, contact, no frame", &mut quiet, inputs.touched(), out, |i, scan, _| {
        i.scan(scan);
    });
    for (name, fields) in
        [("encode: every field", Fields::ALL), ("encode: estimates", Fields::ESTIMATES)]
    {
        let mut instrument = warm(record, fields, inputs.touched());
        let frames = inputs.touched().map(|scan| {
            instrument.scan(&scan);
            Frame::from(instrument.frame(&scan))
        });
        meter.stage(name, &mut (), frames, out, |(), frame: &Frame, packet| {
            packet.pack(frame);
        });
    }
}
