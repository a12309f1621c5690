//! Checks that the C header reads this core's messages and compiles without a warning.

use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::common;
use taxel::condition::{Health, Signals};
use taxel::estimate::slip::Verdict;
use taxel::estimate::{ContactPoint, Force, NormalContact, Uncertainty};
use taxel::frame::{Frame, Status};
use taxel::measured::NoValue;
use taxel::units::{Micros, Millimetres, Newtons};
use taxel::wire::message::Message;
use taxel::wire::{MAX_PACKET, pack};

/// Compiles the C program and returns its output for a stream.
fn printed(stream: &[u8]) -> String {
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("print_frames");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("host-tools/c/print_frames.c");
    let compiled = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-O1"])
        .args(["-fsanitize=undefined,address", "-fno-sanitize-recover=all"])
        .arg(source)
        .arg("-o")
        .arg(&program)
        .output()
        .expect("a C compiler named cc");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    let mut child =
        Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(stream).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap()
}

fn packet(frame: Frame) -> Vec<u8> {
    pack(&Message::Frame(frame), &mut [0; MAX_PACKET]).unwrap().to_vec()
}

#[test]
fn c_header_reads_each_field_and_skips_missing_ones() {
    let small = Frame {
        seq: 300,
        time: Micros(1_000_000),
        status: Status::CONTACT | Status::RAN_NET,
        ..Frame::default()
    };
    let estimates = Frame {
        seq: u32::MAX,
        time: Micros(u64::MAX),
        sensors: Some([
            Force::known(0.5, -0.5, 1.0),
            Force::known(0.1, 0.2, 0.3),
            Force::known(0.0, 0.0, 0.0),
            Force { z: Err(NoValue::DeadChannel), ..Force::known(1.0, 2.0, 3.0) },
        ]),
        force: Some(Force { x: Err(NoValue::NotEstimated), ..Force::known(0.0, 1.0e-7, 0.25) }),
        point: Some(Ok(ContactPoint { x: Millimetres(1.25), y: Millimetres(-2.0) })),
        slip: Some(Ok(Verdict { margin: 0.25, friction: 0.5, grip: Newtons(2.0) })),
        torsion: Some(Err(NoValue::IllConditioned)),
        contacts: Some(Ok([(0.25, [1.25, -2.0]), (0.5, [-0.5, 1.0])].map(NormalContact::new))),
        uncertainty: Some(Ok(Uncertainty {
            force: Force { x: Err(NoValue::NotEstimated), ..Force::known(0.0, 0.5, 0.125) },
            point: Ok(ContactPoint { x: Millimetres(0.25), y: Millimetres(0.75) }),
            misfit: Ok(1.5),
        })),
        ..Frame::default()
    };
    let codes = common::unloaded(0).codes;
    let raw = Frame {
        codes: Some(codes),
        signals: Some(Signals {
            taxels: Some(std::array::from_fn(|k| k as f32 / -3.0)),
            bridges: [Some([0.1, 0.2, 0.3]), None, None, None],
            health: Health { saturated: 0x8001, dead: 2, bridge_faults: 8 },
        }),
        point: Some(Err(NoValue::NoContact)),
        uncertainty: Some(Err(NoValue::NoContact)),
        ..Frame::default()
    };
    let mut damaged = packet(small);
    damaged[5] ^= 0x10;
    let version = Message::Version { tag: 1, protocol: 2, firmware: [0, 1, 0] };
    let version = pack(&version, &mut [0; MAX_PACKET]).unwrap().to_vec();
    let stream = [
        vec![0x41, 0x42, 0],
        packet(small),
        damaged,
        version,
        vec![0x11; 1000],
        vec![0, 0],
        packet(estimates),
        packet(raw),
    ];
    let taxels = codes.taxels.unwrap();
    let or_minus_one = |code: Option<taxel::units::Code>| code.map_or(-1, |code| i32::from(code.0));
    let bridge = |s: usize| codes.bridges[s];
    let expected = [
        "seq=300 time_us=1000000 status=262145".to_owned(),
        "seq=4294967295 time_us=18446744073709551615 status=0 s0_fx_n=0.5 s0_fy_n=-0.5 s0_fz_n=1 \
         s1_fx_n=0.100000001 s1_fy_n=0.200000003 s1_fz_n=0.300000012 s2_fx_n=0 s2_fy_n=0 s2_fz_n=0 \
         s3_fx_n=1 s3_fy_n=2 s3_fz_n=!3 fx_n=!7 fy_n=1.00000001e-07 fz_n=0.25 x_mm=1.25 y_mm=-2 \
         slip_margin=0.25 friction=0.5 grip_n=2 torsion_nmm=!5 contact1_x_mm=1.25 contact1_y_mm=-2 \
         contact1_fz_n=0.25 contact2_x_mm=-0.5 contact2_y_mm=1 contact2_fz_n=0.5 fx_sigma_n=!7 \
         fy_sigma_n=0.5 fz_sigma_n=0.125 x_sigma_mm=0.25 y_sigma_mm=0.75 misfit=1.5"
            .to_owned(),
        format!(
            "seq=0 time_us=0 status=0 full_scale={} lit0={} lit15={} dark3={} bridge0d={} bridge3a={} \
             reference={} temperature={} c0=-0 c15=-5 u0z=0.300000012 saturated=32769 dead=2 \
             bridge_faults=8 x_mm=!1 y_mm=!1 fx_sigma_n=!1 fy_sigma_n=!1 fz_sigma_n=!1 x_sigma_mm=!1 \
             y_sigma_mm=!1 misfit=!1",
            codes.full_scale.top().0,
            taxels.lit[0][0].0,
            taxels.lit[3][3].0,
            taxels.dark[3].0,
            or_minus_one(bridge(0).map(|b| b.d)),
            or_minus_one(bridge(3).map(|b| b.a)),
            or_minus_one(codes.reference),
            or_minus_one(codes.temperature),
        ),
    ];
    assert_eq!(printed(&stream.concat()).lines().collect::<Vec<_>>(), expected);
}
