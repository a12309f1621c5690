//! A whole scan, from codes to wire bytes, as the session does it.

use serde::{Serialize, Serializer};
use taxel::frame::{Fields, Frame};
use taxel::instrument::Instrument;
use taxel::scan::Scan;
use taxel::store::{RamFlash, Store};
use taxel::units::FullScale;
use taxel::wire::message::{Command, Identity, Request};
use taxel::wire::{MAX_PACKET, pack_frame};

use crate::Meter;
use crate::host::Inputs;

/// A packet.
struct Packet {
    bytes: [u8; MAX_PACKET],
    length: usize,
}

impl Packet {
    fn pack(&mut self, frame: &Frame) {
        self.length = pack_frame(frame, &mut self.bytes).map_or(0, <[u8]>::len);
    }
}

impl Serialize for Packet {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(self.bytes.get(..self.length).unwrap_or_default())
    }
}

/// An instrument that has seen the first of the scans, so that its gate has made up its mind.
fn instrument(record: &[u8], fields: Fields, mut scans: impl Iterator<Item = Scan>) -> Instrument {
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
    // Refused only where the stages end before they begin: the record was read once already.
    let _ = instrument.install(record, &mut store);
    let commands =
        [Command::SetRate { hz: SCAN_HZ }, Command::SetFields(fields), Command::Stream(true)];
    for (tag, command) in (0..).zip(commands) {
        let _ = instrument.handle(&Request { tag, command }, &mut store);
    }
    for scan in scans.by_ref().take(8) {
        instrument.scan(&scan);
    }
    instrument
}

fn whole(instrument: &mut Instrument, scan: &Scan, packet: &mut Packet) {
    packet.length = 0;
    if instrument.scan(scan).frame {
        packet.pack(instrument.frame());
    }
}

pub fn stages(inputs: &Inputs<'_>, meter: &mut impl Meter) {
    let mut packet = Packet { bytes: [0; MAX_PACKET], length: 0 };
    let out = &mut packet;
    for (name, fields) in [
        ("codes to wire bytes, no contact, every field", Fields::ALL),
        ("codes to wire bytes, no contact, estimates", Fields::ESTIMATES),
    ] {
        let mut instrument = instrument(inputs.record, fields, inputs.free());
        meter.stage(name, &mut instrument, inputs.free(), out, whole);
    }
    for (name, fields) in [
        ("codes to wire bytes, contact, every field", Fields::ALL),
        ("codes to wire bytes, contact, estimates", Fields::ESTIMATES),
    ] {
        let mut instrument = instrument(inputs.record, fields, inputs.touched());
        meter.stage(name, &mut instrument, inputs.touched(), out, whole);
    }
    let mut quiet = instrument(inputs.record, Fields::ALL, inputs.touched());
    meter.stage("estimates, contact, no frame", &mut quiet, inputs.touched(), out, |i, scan, _| {
        i.scan(scan);
    });
    for (name, fields) in
        [("encode: every field", Fields::ALL), ("encode: estimates", Fields::ESTIMATES)]
    {
        let mut instrument = instrument(inputs.record, fields, inputs.touched());
        let frames = inputs.touched().map(|scan| {
            instrument.scan(&scan);
            *instrument.frame()
        });
        meter.stage(name, &mut (), frames, out, |(), frame: &Frame, packet| {
            packet.pack(frame);
        });
    }
}
