//! Golden bytes of the wire. A change of any of them changes the protocol.
//!
//! Clients in other languages follow `docs/protocol.md`, which shows the same bytes.

use crate::common;
use proptest::prelude::*;
use taxel::calibration::{Calibration, CalibrationError, MAX_BYTES};
use taxel::condition::{Health, Signals};
use taxel::estimate::contact_point::PointMethod;
use taxel::estimate::quantised::{Group, Net, QuantisedNet, Rows};
use taxel::estimate::slip::Verdict;
use taxel::estimate::{ContactPoint, Force, NormalContact, Uncertainty};
use taxel::frame::{Fields, Frame, Status};
use taxel::measured::NoValue;
use taxel::scan::{Codes, Midpoints, ScanSetting, ScanSettings, TaxelCodes};
use taxel::self_test::{Channel, Channels, SelfTest};
use taxel::units::{Code, FullScale, Micros, Millimetres, NewtonMillimetres, Newtons};
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{
    BoardHealth, CHUNK, Command, Cost, Erasures, Message, Refusal, Request, Reset, Response,
};
use taxel::wire::{MAX_PACKET, WireError, pack, pack_frame, unpack};

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}

fn packed<M: serde::Serialize>(message: &M) -> String {
    let mut buffer = [0; MAX_PACKET];
    hex(pack(message, &mut buffer).unwrap())
}

/// Bytes of the message without COBS and CRC.
fn body<M: serde::Serialize>(message: &M) -> String {
    let mut buffer = [0; MAX_PACKET];
    let packet = pack(message, &mut buffer).unwrap();
    let mut bytes = packet[..packet.len() - 1].to_vec();
    let length = cobs::decode_in_place(&mut bytes).unwrap();
    hex(&bytes[..length - 4])
}

/// Bytes of a frame; the hand-written serializer must match postcard.
fn frame_body(frame: Frame) -> String {
    let (mut by_reference, mut by_value) = ([0; MAX_PACKET], [0; MAX_PACKET]);
    let by_reference = pack_frame(&frame, &mut by_reference).unwrap();
    assert_eq!(by_reference, pack(&(2u8, frame), &mut by_value).unwrap());
    let message = Message::Frame(frame);
    assert_eq!(by_reference, pack(&message, &mut by_value).unwrap());
    body(&message)
}

#[test]
fn version_query_is_frozen() {
    let query = Request { tag: 1, command: Command::Version };
    assert_eq!(packed(&query), "02 01 05 be 23 c2 58 00");
    let answer = Message::Version { tag: 1, protocol: 1, firmware: [0, 1, 0] };
    assert_eq!(body(&answer), "00 01 01 00 01 00");
}

#[test]
fn requests_have_their_bytes() {
    let bytes = [
        (Command::Version, "07 00"),
        (Command::Info, "07 01"),
        (Command::Stream(true), "07 02 01"),
        (Command::SetRate { hz: 1000 }, "07 03 e8 07"),
        (Command::SetFields(Fields::ESTIMATES), "07 04 3c"),
        (Command::SetPointMethod(PointMethod::Centroid), "07 05 00"),
        (Command::SetPointMethod(PointMethod::ArgMin), "07 05 01"),
        (Command::SetPointMethod(PointMethod::Model), "07 05 02"),
        (Command::TakeBias { scans: 500 }, "07 06 f4 03"),
        (Command::ReadBias, "07 07"),
        (Command::ClearBias, "07 08"),
        (Command::CalibrationBegin { length: 1500 }, "07 09 dc 0b"),
        (
            Command::CalibrationChunk {
                offset: 128,
                data: heapless::Vec::from_slice(&[0xaa, 0xbb]).unwrap(),
            },
            "07 0a 80 01 02 aa bb",
        ),
        (Command::CalibrationCommit, "07 0b"),
        (Command::CalibrationRead { offset: 0 }, "07 0c 00"),
        (Command::SaveSettings, "07 0d"),
        (Command::SaveBias, "07 0e"),
        (Command::Health, "07 0f"),
        (Command::SelfTest { scans: 1000 }, "07 10 e8 07"),
        (Command::Bootloader, "07 11"),
        (
            Command::SetScan(ScanSettings { scan_hz: 4000, oversampling: 8, settle_ns: 26_500 }),
            "07 12 a0 1f 08 84 cf 01",
        ),
        (Command::SetFilter { hz: 150 }, "07 13 96 01"),
        (Command::HoldRow { row: None }, "07 14 00"),
        (Command::HoldRow { row: Some(3) }, "07 14 01 03"),
    ];
    for (command, expected) in bytes {
        assert_eq!(body(&Request { tag: 7, command: command.clone() }), expected, "{command:?}");
    }
}

#[test]
fn refusals_have_their_bytes() {
    let bytes = [
        (Refusal::OutOfRange { low: 1, high: 4000 }, "01 07 01 00 01 a0 1f"),
        (Refusal::NotStill, "01 07 01 01"),
        (Refusal::Busy, "01 07 01 02"),
        (Refusal::OutOfOrder, "01 07 01 03"),
        (Refusal::Calibration(CalibrationError::Crc), "01 07 01 04 01"),
        (Refusal::Calibration(CalibrationError::Version { found: 3 }), "01 07 01 04 02 03"),
        (
            Refusal::Calibration(CalibrationError::Field { section: 16, field: 2 }),
            "01 07 01 04 04 10 02",
        ),
        (Refusal::Calibration(CalibrationError::WithoutTaxels { section: 2 }), "01 07 01 04 05 02"),
        (Refusal::Calibration(CalibrationError::Rehearsal { section: 2 }), "01 07 01 04 06 02"),
        (Refusal::Uncalibrated, "01 07 01 05"),
        (Refusal::Saturated, "01 07 01 06"),
        (Refusal::Storage, "01 07 01 07"),
        (Refusal::Unsupported, "01 07 01 08"),
        (
            Refusal::Scan { setting: ScanSetting::SettleNs, low: 17_400, high: 100_000 },
            "01 07 01 09 02 f8 87 01 a0 8d 06",
        ),
    ];
    for (refusal, expected) in bytes {
        assert_eq!(body(&Message::Reply { tag: 7, result: Err(refusal) }), expected, "{refusal:?}");
    }
    let done = Message::Reply { tag: 7, result: Ok(Response::Done) };
    assert_eq!(body(&done), "01 07 00 00");
    let rate = Message::Reply { tag: 7, result: Ok(Response::Rate { millihertz: 1_000_000 }) };
    assert_eq!(body(&rate), "01 07 00 02 c0 84 3d");
}

#[test]
fn calibration_record_has_its_bytes() {
    let full = common::calibration();
    let record = Calibration {
        serial: "F".try_into().unwrap(),
        date: 300,
        sensors: full.sensors,
        ..Calibration::default()
    };
    let mut buffer = [0; MAX_BYTES];
    let zero = "00 00 00 00 ";
    let one = "00 00 80 3f ";
    let range = "cd cc 4c be cd cc 4c 3e ".repeat(3);
    let residual = "6f 12 83 3a ".repeat(3);
    assert_eq!(
        hex(record.to_bytes(&mut buffer).unwrap()),
        format!(
            "02 00 01 46 ac 02 10 58 00 {}17 b7 d1 38 {one}{}{one}{}{one}{range}{residual}bb 0e 4b f5",
            zero.repeat(3),
            zero.repeat(3),
            zero.repeat(3),
        )
    );
}

#[test]
fn q15_net_has_its_bytes() {
    let mut weights = [0; 16];
    (weights[0], weights[1], weights[15]) = (1, -2, 0x1234);
    let group = Group { weights: Rows::new(&[weights; 4]), bias: [-1; 4] };
    let record = Calibration {
        net: Some(Net::Quantised(QuantisedNet {
            signal: 1024.0,
            hidden: [group].into_iter().collect(),
            shift: 9,
            output: [Rows::new(&[weights; 3])].into_iter().collect(),
            skip: None,
            scale: [1.0, 2.0],
            output_bias: [1.0].into_iter().collect(),
        })),
        sensors: Default::default(),
        ..common::calibration()
    };
    let weights = format!("01 00 fe ff {}34 12 ", "00 00 ".repeat(13));
    let section = format!(
        "05 00 01 00 00 80 44 01 {}{}09 01 {}00 00 00 80 3f 00 00 00 40 01 00 00 80 3f",
        weights.repeat(4),
        "ff ff ff ff ".repeat(4),
        weights.repeat(3),
    );
    let length = section.split(' ').count() - 3;
    let section =
        section.replacen("05 00 01", &format!("05 {:02x} {:02x}", length % 256, length / 256), 1);
    let mut buffer = [0; MAX_BYTES];
    let bytes = record.to_bytes(&mut buffer).unwrap();
    let found = hex(&bytes[..bytes.len() - 4]);
    assert!(found.ends_with(&section), "{found}\n{section}");
}

#[test]
fn health_and_self_test_have_their_bytes() {
    let reply = |response| Message::Reply { tag: 7, result: Ok(response) };
    let health = BoardHealth {
        reset: Reset::Watchdog,
        panic: Some("a:1 b".try_into().unwrap()),
        reading: Some(Cost { last: 300, worst: 301 }),
        sending: None,
        stack: Some((2000, 9000)),
        scan: None,
        erasures: Some(Erasures { calibration: 3, settings: 300 }),
    };
    assert_eq!(
        body(&reply(Response::Health(health))),
        "01 07 00 05 04 01 05 61 3a 31 20 62 01 ac 02 ad 02 00 01 d0 0f a8 46 00 01 03 ac 02"
    );
    let one = Some(Channel { mean: 1.0, noise: 0.5 });
    let test = SelfTest {
        scans: 300,
        full_scale: FullScale::BITS_12,
        channels: Channels { reference: one, ..Channels::default() },
        record_intact: Some(true),
    };
    let absent = "00 ".repeat(16 + 4 + 16);
    assert_eq!(
        body(&reply(Response::SelfTest(test))),
        format!("01 07 00 06 ac 02 ff 0f {absent}01 00 00 80 3f 00 00 00 3f 00 01 01")
    );
}

fn frame() -> Frame {
    Frame {
        seq: 300,
        time: Micros(1_000_000),
        status: Status::CONTACT | Status::RAN_NET,
        ..Frame::default()
    }
}

#[test]
fn frames_have_their_bytes() {
    assert_eq!(frame_body(frame()), "02 ac 02 c0 84 3d 81 80 10 00 00 00 00 00 00 00 00");
    let estimates = Frame {
        sensors: Some([
            Force::known(0.5, -0.5, 1.0),
            Force::none(NoValue::Absent),
            Force::none(NoValue::Uncalibrated),
            Force::none(NoValue::DeadChannel),
        ]),
        force: Some(Force { x: Err(NoValue::NotEstimated), ..Force::known(0.0, 0.0, 0.25) }),
        point: Some(Ok(ContactPoint { x: Millimetres(1.25), y: Millimetres(-2.0) })),
        slip: Some(Ok(Verdict { margin: 0.25, friction: 0.5, grip: Newtons(2.0) })),
        torsion: Some(Ok(NewtonMillimetres(-2.0))),
        contacts: Some(Ok([(0.25, [1.25, -2.0]), (0.5, [-0.5, 1.0])].map(NormalContact::new))),
        ..frame()
    };
    let without = "02 ac 02 c0 84 3d 81 80 10 00 00 00 00 00 00 00 00";
    let sure = Uncertainty {
        force: Force { x: Err(NoValue::NotEstimated), ..Force::known(0.0, 0.5, 0.25) },
        point: Ok(ContactPoint { x: Millimetres(0.5), y: Millimetres(0.25) }),
        misfit: Ok(1.0),
    };
    assert_eq!(
        frame_body(Frame { uncertainty: Some(Ok(sure)), ..frame() }),
        format!(
            "{without} 01 00 01 07 00 00 00 00 3f 00 00 00 80 3e \
             00 00 00 00 3f 00 00 80 3e 00 00 00 80 3f"
        )
    );
    let untouched = Frame { uncertainty: Some(Err(NoValue::NoContact)), ..frame() };
    assert_eq!(frame_body(untouched), format!("{without} 01 01 01"));
    assert_eq!(
        frame_body(estimates),
        "02 ac 02 c0 84 3d 81 80 10 00 00 \
         01 00 00 00 00 3f 00 00 00 00 bf 00 00 00 80 3f 01 06 01 06 01 06 01 00 01 00 01 00 \
         01 03 01 03 01 03 \
         01 01 07 00 00 00 00 00 00 00 00 80 3e \
         01 00 00 00 a0 3f 00 00 00 c0 \
         01 00 00 00 80 3e 00 00 00 3f 00 00 00 40 \
         01 00 00 00 00 c0 \
         01 00 00 00 a0 3f 00 00 00 c0 00 00 80 3e 00 00 00 bf 00 00 80 3f 00 00 00 3f"
    );
    let mut codes = Codes { bridges: [None; 4], ..common::unloaded(0).codes };
    codes.taxels = None;
    codes.reference = Some(Code(0x1234));
    codes.temperature = None;
    codes.full_scale = FullScale::BITS_12;
    let signals = Signals {
        taxels: Some([-0.5; 16]),
        bridges: [Some([0.25; 3]), None, None, None],
        health: Health { saturated: 0x0101, dead: 0, bridge_faults: 8 },
    };
    let raw = Frame { codes: Some(codes), signals: Some(signals), ..frame() };
    let minus_half = "00 00 00 bf ".repeat(16);
    let quarter = "00 00 80 3e ".repeat(3);
    assert_eq!(
        frame_body(raw),
        format!(
            "02 ac 02 c0 84 3d 81 80 10 01 ff 0f 00 00 00 00 00 01 34 12 00 \
             01 01 {minus_half}01 {quarter}00 00 00 81 02 00 08 00 00 00 00 00 00"
        )
    );
}

/// Bytes packed as a message.
struct Bytes<'b>(&'b [u8]);

impl serde::Serialize for Bytes<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeTuple;
        let mut bytes = serializer.serialize_tuple(self.0.len())?;
        self.0.iter().try_for_each(|byte| bytes.serialize_element(byte))?;
        bytes.end()
    }
}

#[test]
fn frame_ends_with_or_before_its_uncertainty() {
    let read = |bytes: &[u8]| {
        let mut packet = [0; MAX_PACKET];
        let length = pack(&Bytes(bytes), &mut packet).unwrap().len();
        unpack::<Message>(&mut packet[..length - 1])
    };
    let sure = Uncertainty {
        force: Force { y: Err(NoValue::NotEstimated), ..Force::known(0.5, 0.0, 0.25) },
        point: Err(NoValue::DeadChannel),
        misfit: Ok(1.0),
    };
    let mut before = Vec::new();
    for uncertainty in [None, Some(Err(NoValue::NoContact)), Some(Ok(sure))] {
        let message = Message::Frame(Frame { uncertainty, ..frame() });
        let text = body(&message);
        let mut bytes: Vec<u8> =
            text.split(" ").map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
        for end in before.len() + 1..bytes.len() {
            assert_eq!(read(&bytes[..end]), Err(WireError::Message), "{uncertainty:?} to {end}");
        }
        if before.is_empty() {
            before.clone_from(&bytes);
        }
        assert_eq!(read(&bytes), Ok(message));
        bytes.push(0);
        assert_eq!(read(&bytes), Err(WireError::Message), "{uncertainty:?} and a byte more");
    }
}

/// A frame whose every choice and value comes from `words`.
pub fn made_of(words: &[u32]) -> Frame {
    let words = std::cell::RefCell::new(words.iter().copied().cycle());
    let word = || words.borrow_mut().next().unwrap();
    let float = || f32::from_bits(word());
    let code = || Code(word() as u16);
    let missing = || NoValue::ALL.get(word() as usize % 16).copied();
    let present = || word() % 4 != 0;
    let newtons = || missing().map_or_else(|| Ok(Newtons(float())), Err);
    let force = || Force { x: newtons(), y: newtons(), z: newtons() };
    let place = || ContactPoint { x: Millimetres(float()), y: Millimetres(float()) };
    let verdict = || Verdict { margin: float(), friction: float(), grip: Newtons(float()) };
    let contact = |_| NormalContact { point: place(), normal: Newtons(float()) };
    let uncertainty = || Uncertainty {
        force: force(),
        point: missing().map_or_else(|| Ok(place()), Err),
        misfit: missing().map_or_else(|| Ok(float()), Err),
    };
    let codes = || Codes {
        full_scale: FullScale::new(word() as u16).unwrap_or(FullScale::BITS_12),
        taxels: present().then(|| TaxelCodes {
            lit: [(); 4].map(|()| [(); 4].map(|()| code())),
            dark: [(); 4].map(|()| code()),
        }),
        bridges: [(); 4]
            .map(|()| present().then(|| Midpoints { a: code(), b: code(), c: code(), d: code() })),
        reference: present().then(code),
        temperature: present().then(code),
    };
    let signals = || Signals {
        taxels: present().then(|| [(); 16].map(|()| float())),
        bridges: [(); 4].map(|()| present().then(|| [(); 3].map(|()| float()))),
        health: Health {
            saturated: word() as u16,
            dead: word() as u16,
            bridge_faults: word() as u8,
        },
    };
    Frame {
        seq: word(),
        time: Micros(u64::from(word()) << (word() % 33)),
        status: Status(word()),
        codes: present().then(codes),
        signals: present().then(signals),
        sensors: present().then(|| [(); 4].map(|()| force())),
        force: present().then(force),
        point: present().then(|| missing().map_or_else(|| Ok(place()), Err)),
        slip: present().then(|| missing().map_or_else(|| Ok(verdict()), Err)),
        torsion: present().then(|| missing().map_or_else(|| Ok(NewtonMillimetres(float())), Err)),
        contacts: present().then(|| missing().map_or_else(|| Ok([(); 2].map(contact)), Err)),
        uncertainty: present().then(|| missing().map_or_else(|| Ok(uncertainty()), Err)),
    }
}

#[test]
fn longest_messages_fit_a_packet() {
    let scan = common::unloaded(u64::MAX);
    let codes = Codes { bridges: [scan.codes.bridges[0]; 4], ..scan.codes };
    let signals = Signals {
        taxels: Some([1.0; 16]),
        bridges: [Some([1.0; 3]); 4],
        health: Health { saturated: u16::MAX, dead: u16::MAX, bridge_faults: u8::MAX },
    };
    let all = Frame {
        seq: u32::MAX,
        time: Micros(u64::MAX),
        status: Status(u32::MAX),
        codes: Some(codes),
        signals: Some(signals),
        sensors: Some([Force::known(1.0, 1.0, 1.0); 4]),
        force: Some(Force::known(1.0, 1.0, 1.0)),
        point: Some(Ok(ContactPoint { x: Millimetres(1.0), y: Millimetres(1.0) })),
        slip: Some(Ok(Verdict { margin: 1.0, friction: 1.0, grip: Newtons(1.0) })),
        torsion: Some(Ok(NewtonMillimetres(1.0))),
        contacts: Some(Ok([(1.0, [1.0; 2]); 2].map(NormalContact::new))),
        uncertainty: Some(Ok(Uncertainty {
            force: Force::known(1.0, 1.0, 1.0),
            point: Ok(ContactPoint { x: Millimetres(1.0), y: Millimetres(1.0) }),
            misfit: Ok(1.0),
        })),
    };
    let bias = taxel::condition::Bias {
        taxels: common::calibration().taxels.map(|t| t.bias),
        bridges: [common::calibration().sensors[0].as_ref().map(|s| s.bias); 4],
    };
    let text = |length: usize| "x".repeat(length);
    let mut identity = common::identity();
    identity.board = text(24).as_str().try_into().unwrap();
    identity.serial = text(32).as_str().try_into().unwrap();
    identity.build = text(24).as_str().try_into().unwrap();
    let counters = taxel::wire::message::Counters {
        scans: u32::MAX,
        frames: u32::MAX,
        lost: u32::MAX,
        overruns: u32::MAX,
        bad_packets: u32::MAX,
        lost_replies: u32::MAX,
    };
    let info = taxel::wire::message::Info {
        identity,
        rate_millihertz: u32::MAX,
        fields: Fields::ALL,
        streaming: true,
        point_method: PointMethod::Centroid,
        biased: true,
        calibration: Some(taxel::wire::message::CalibrationId {
            serial: text(32).as_str().try_into().unwrap(),
            date: u64::MAX,
            crc: u32::MAX,
        }),
        counters,
        cost: taxel::wire::message::Cost { last: u32::MAX, worst: u32::MAX },
        estimators: Status(u32::MAX),
        filter_hz: u16::MAX,
    };
    let reply = |response| Message::Reply { tag: u8::MAX, result: Ok(response) };
    let most = Cost { last: u32::MAX, worst: u32::MAX };
    let health = BoardHealth {
        reset: Reset::Other,
        panic: Some(text(96).as_str().try_into().unwrap()),
        reading: Some(most),
        sending: Some(most),
        stack: Some((u32::MAX, u32::MAX)),
        scan: Some(ScanSettings { scan_hz: u16::MAX, oversampling: u16::MAX, settle_ns: u32::MAX }),
        erasures: Some(Erasures { calibration: u32::MAX, settings: u32::MAX }),
    };
    let channel = Some(Channel { mean: 1.0, noise: 1.0 });
    let channels = Channels {
        lit: [[channel; 4]; 4],
        dark: [channel; 4],
        bridges: [[channel; 4]; 4],
        reference: channel,
        temperature: channel,
    };
    let full_scale = FullScale::BITS_16;
    let test = SelfTest { scans: u16::MAX, full_scale, channels, record_intact: Some(true) };
    let chunk = heapless::Vec::from_slice(&[0xff; CHUNK]).unwrap();
    for message in [
        Message::Frame(all),
        reply(Response::Bias { bias, on_command: true, in_contact: true }),
        reply(Response::Info(info)),
        reply(Response::Calibration { offset: u16::MAX, data: chunk }),
        reply(Response::Health(health)),
        reply(Response::SelfTest(test)),
    ] {
        let mut buffer = [0; MAX_PACKET];
        let mut packet = pack(&message, &mut buffer).unwrap().to_vec();
        packet.pop();
        assert_eq!(unpack(&mut packet), Ok(message));
    }
}

fn feed(deframer: &mut Deframer, bytes: &[u8]) -> Vec<Result<Request, WireError>> {
    bytes.iter().filter_map(|byte| deframer.push(*byte)).collect()
}

#[test]
fn stream_joined_midway_costs_one_packet() {
    let request = Request { tag: 9, command: Command::SetRate { hz: 250 } };
    let mut buffer = [0; MAX_PACKET];
    let packet = pack(&request, &mut buffer).unwrap().to_vec();
    let mut stream = packet[3..].to_vec();
    stream.extend([0, 0]);
    stream.extend(&packet);
    let found = feed(&mut Deframer::default(), &stream);
    assert_eq!(found.len(), 2);
    assert!(found[0].is_err());
    assert_eq!(found[1], Ok(request));
}

#[test]
fn overlong_packet_is_dropped() {
    let request = Request { tag: 9, command: Command::Info };
    let mut buffer = [0; MAX_PACKET];
    let mut stream = vec![0x55; 3 * MAX_PACKET];
    stream.push(0);
    stream.extend(pack(&request, &mut buffer).unwrap());
    let found = feed(&mut Deframer::default(), &stream);
    assert_eq!(found, [Err(WireError::TooLong), Ok(request)]);
}

proptest! {
    #[test]
    fn deframer_accepts_any_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..2000)) {
        let mut requests = Deframer::<MAX_PACKET>::default();
        let mut messages = Deframer::<MAX_PACKET>::default();
        for byte in bytes {
            let _: Option<Result<Request, _>> = requests.push(byte);
            let _: Option<Result<Message, _>> = messages.push(byte);
        }
    }

    /// [`frame_body`] compares the hand-written serializer with postcard.
    #[test]
    fn frame_packs_alike_by_reference_and_value(
        words in proptest::collection::vec(
            prop_oneof![4 => any::<u32>(), 1 => Just(0), 1 => 0..300u32, 1 => Just(0x3f80_0000)],
            1..150,
        )
    ) {
        frame_body(made_of(&words));
    }

    #[test]
    fn flipped_bit_never_passes(bit in any::<usize>(), tag in any::<u8>(), hz in any::<u16>()) {
        let request = Request { tag, command: Command::SetRate { hz } };
        let mut buffer = [0; MAX_PACKET];
        let mut packet = pack(&request, &mut buffer).unwrap().to_vec();
        let bit = bit % ((packet.len() - 1) * 8);
        packet[bit / 8] ^= 1 << (bit % 8);
        for found in feed(&mut Deframer::default(), &packet) {
            prop_assert!(found.is_err(), "{found:?}");
        }
    }
}
