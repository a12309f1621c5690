//! Tests of the real client with the real session, over TCP and over a pseudo-terminal.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::ops::ControlFlow;
use std::time::Duration;

use crate::fingers::*;
use taxel::calibration::CalibrationError;
use taxel::estimate::contact_point::PointMethod;
use taxel::frame::{Fields, Status};
use taxel::wire::message::{Command, PROTOCOL, Refusal, Request};
use taxel::wire::{MAX_PACKET, pack};
use taxel_cli::VirtualFinger;
use taxel_cli::finger::connect as connect_port;
use taxel_cli::virtual_finger::Source;
use taxel_client::{ActiveCalibration, Client, LinkError, Port, Problem};

fn refusal(result: Result<impl std::fmt::Debug, LinkError>) -> Refusal {
    match result.unwrap_err().problem() {
        Some(Problem::Refusal { refusal, .. }) => *refusal,
        other => panic!("not a refusal: {other:?}"),
    }
}

#[test]
fn finger_reports_its_identity() {
    for finger in on_every_link() {
        let client = connect(&finger);
        assert_eq!(client.version().protocol, PROTOCOL);
        let info = client.info().unwrap();
        assert_eq!(info.identity.board, "virtual");
        assert_eq!(info.identity.serial, "still");
        assert_eq!(u64::from(info.identity.scan_hz), SCAN_HZ);
        assert_eq!(info.calibration, None);
        assert!(!info.streaming);
        assert_eq!(info.counters.bad_packets, 0);
    }
}

#[test]
fn stream_is_lossless_at_stated_rate() {
    for finger in on_every_link() {
        let client = connect(&finger);
        client.stream(true).unwrap();
        let frames = frames(&client, 2000);
        for pair in frames.windows(2) {
            assert_eq!(pair[1].frame.seq, pair[0].frame.seq + 1);
            assert_eq!(pair[1].frame.time.0, pair[0].frame.time.0 + 1000);
        }
        let counts = client.counts();
        assert!(counts.frames >= 2000);
        assert_eq!((counts.lost, counts.bad_packets, counts.overflow), (0, 0, 0));
    }
}

#[test]
fn frames_carry_requested_fields() {
    for finger in on_every_link() {
        let client = connect(&finger);
        client.set_fields(Fields::CODES).unwrap();
        client.stream(true).unwrap();
        let frame = frames(&client, 1)[0].frame;
        assert!(frame.codes.is_some());
        assert!(frame.force.is_none() && frame.point.is_none() && frame.sensors.is_none());

        client.set_fields(Fields::FORCE | Fields::POINT).unwrap();
        assert_eq!(client.info().unwrap().fields, Fields::FORCE | Fields::POINT);
        client.stream(true).unwrap();
        let last = frames(&client, 1000).pop().unwrap().frame;
        assert!(last.codes.is_none() && last.force.is_some() && last.point.is_some());
    }
}

#[test]
fn held_row_is_read_in_every_step_until_released() {
    for finger in on_every_link() {
        let client = connect(&finger);
        client.set_fields(Fields::CODES | Fields::FORCE).unwrap();
        client.hold_row(Some(2)).unwrap();
        client.stream(true).unwrap();
        let held = frames(&client, 1)[0].frame;
        assert_eq!(held.status, Status::ROW_HELD);
        let taxels = held.codes.unwrap().taxels.unwrap();
        assert_eq!((taxels.lit, taxels.dark), ([taxels.lit[2]; 4], taxels.lit[2]));
        // A pseudo-terminal does not tell the finger that its host has left; TCP does.
        let client = if matches!(finger.port(), Port::Tcp { .. }) {
            drop(client);
            connect(&finger)
        } else {
            client.hold_row(None).unwrap();
            client
        };
        client.stream(true).unwrap();
        let scanned = frames(&client, 1000).pop().unwrap().frame;
        assert!(!scanned.status.contains(Status::ROW_HELD));
        assert_ne!(scanned.codes.unwrap().taxels.unwrap().dark, taxels.dark);
        assert_eq!(refusal(client.hold_row(Some(4))), Refusal::OutOfRange { low: 0, high: 3 });
    }
}

#[test]
fn rate_is_nearest_possible_or_refused() {
    let finger = on_tcp(still());
    let client = connect(&finger);
    assert_eq!(client.set_rate(500).unwrap(), 500.0);
    assert_eq!(client.set_rate(1500).unwrap(), 1333.333);
    assert_eq!(refusal(client.set_rate(0)), Refusal::OutOfRange { low: 1, high: 4000 });
    client.set_rate(200).unwrap();
    client.set_point_method(PointMethod::ArgMin).unwrap();
    client.stream(true).unwrap();
    let frames = frames(&client, 3);
    assert_eq!(frames[2].frame.time.0 - frames[1].frame.time.0, 5000);
    assert_eq!(client.info().unwrap().point_method, PointMethod::ArgMin);
}

#[test]
fn settings_survive_a_reconnect() {
    for finger in on_every_link() {
        let first = connect(&finger);
        first.set_rate(250).unwrap();
        first.stream(true).unwrap();
        frames(&first, 10);
        drop(first);

        let second = connect(&finger);
        let info = second.info().unwrap();
        assert_eq!(info.rate_millihertz, 250_000);
        assert!(info.streaming);
        // A new connection must not see earlier frames, or half a frame.
        second.stream(true).unwrap();
        frames(&second, 10);
        let counts = second.counts();
        assert_eq!((counts.lost, counts.bad_packets), (0, 0));
    }
}

#[test]
fn bias_is_taken_from_still_finger() {
    for finger in on_every_link() {
        let client = connect(&finger);
        assert!(!client.read_bias().unwrap().on_command);
        let taken = client.take_bias(400).unwrap();
        assert!(taken.on_command && !taken.in_contact);
        assert!(taken.bias.taxels.is_some());
        assert_eq!(client.read_bias().unwrap(), taken);
        assert!(client.info().unwrap().biased);
        client.clear_bias().unwrap();
        assert!(!client.read_bias().unwrap().on_command);
    }
}

#[test]
fn bias_is_refused_while_finger_moves() {
    let finger = on_tcp(moving());
    let client = connect(&finger);
    let before = client.read_bias().unwrap();
    assert_eq!(refusal(client.take_bias(800)), Refusal::NotStill);
    assert_eq!(client.read_bias().unwrap(), before);
}

#[test]
fn calibration_uploads_and_reads_back_equal() {
    for finger in on_every_link() {
        let client = connect(&finger);
        assert_eq!(refusal(client.download_calibration()), Refusal::Uncalibrated);
        let mut seen = Vec::new();
        let told = |bytes| {
            seen.push(bytes);
            ControlFlow::Continue(())
        };
        client.upload_calibration(&record(), told).unwrap();
        assert_eq!(seen.last(), Some(&record().len()));
        assert_eq!(client.download_calibration().unwrap(), record());
        let id = client.info().unwrap().calibration.unwrap();
        assert_eq!(id.serial, "F-0042");
    }
}

#[test]
fn calibration_with_flipped_bit_is_refused() {
    let finger = on_tcp(still());
    let client = connect(&finger);
    client.upload_calibration(&record(), |_| ControlFlow::Continue(())).unwrap();
    let mut damaged = record();
    damaged[100] ^= 1 << 4;
    let refused = refusal(client.upload_calibration(&damaged, |_| ControlFlow::Continue(())));
    assert_eq!(refused, Refusal::Calibration(CalibrationError::Crc));
    assert_eq!(client.download_calibration().unwrap(), record());
}

#[test]
fn calibration_uploads_during_stream() {
    for finger in on_every_link() {
        let client = connect(&finger);
        client.stream(true).unwrap();
        client.upload_calibration(&record(), |_| ControlFlow::Continue(())).unwrap();
        assert_eq!(client.counts().lost, 0);
    }
}

#[test]
fn stopped_upload_keeps_old_calibration() {
    let finger = on_tcp(still());
    connect(&finger).upload_calibration(&record(), |_| ControlFlow::Continue(())).unwrap();
    let mut other = calibration();
    other.date += 1;
    let other = bytes(&other);
    let stop_at = |most: usize| {
        let halt =
            |sent| if sent < most { ControlFlow::Continue(()) } else { ControlFlow::Break(()) };
        let stopped = connect(&finger).upload_calibration(&other, halt).unwrap_err();
        let why = Box::new(Problem::Stopped);
        let active = ActiveCalibration::Previous;
        assert_eq!(stopped.problem(), Some(&Problem::Upload { why, active }));
        assert_eq!(connect(&finger).download_calibration().unwrap(), record());
    };
    // Stops before the first byte, with half of it there, and with all of it.
    [0, other.len() / 2, other.len()].into_iter().for_each(stop_at);
    let client = connect(&finger);
    assert_eq!(client.download_calibration().unwrap(), record());
    client.upload_calibration(&other, |_| ControlFlow::Continue(())).unwrap();
    assert_eq!(client.download_calibration().unwrap(), other);
}

#[test]
fn settings_and_bias_are_saved_on_command() {
    let finger = on_tcp(still());
    let client = connect(&finger);
    client.set_rate(250).unwrap();
    client.save_settings().unwrap();
    client.take_bias(100).unwrap();
    client.save_bias().unwrap();
    assert!(client.info().unwrap().biased);
}

#[test]
fn virtual_finger_starts_with_given_calibration() {
    let finger = VirtualFinger::on_tcp("127.0.0.1:0", still(), Some(&calibration())).unwrap();
    assert_eq!(connect(&finger).download_calibration().unwrap(), record());
}

#[test]
fn truth_of_every_frame_is_known() {
    let finger = on_tcp(still());
    let client = connect(&finger);
    client.stream(true).unwrap();
    for received in frames(&client, 500) {
        let truth = finger.truth().take(received.frame.time).unwrap();
        assert_eq!(truth.force[2], Some((received.frame.time.0 * SCAN_HZ / 1_000_000) as f64));
    }
}

#[test]
fn playback_returns_every_frame_before_its_end() {
    let finger = on_tcp(short(2000));
    let client = connect(&finger);
    client.stream(true).unwrap();
    let mut last = None;
    let end = loop {
        match client.next(PATIENCE) {
            Ok(Some(received)) => last = Some(received.frame.time.0),
            Ok(None) => panic!("neither frame nor end"),
            Err(error) => break error,
        }
    };
    // Over TCP the client cannot know that the source has ended: it reports an unplugged finger.
    assert!(matches!(end.problem(), Some(Problem::Unplugged(_))), "{end}");
    assert!(last.unwrap() >= 2000 * 250 - 1000);
    assert_eq!(client.counts().lost, 0);
}

#[test]
fn trace_file_plays_as_finger() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("short.csv");
    let mut trace = String::from("t_us,bridge_s0_a,bridge_s0_b,bridge_s0_c,bridge_s0_d\n");
    for i in 0..1000 {
        trace += &format!("{},2000,2001,2002,2003\n", i * 1000);
    }
    std::fs::write(&path, &trace).unwrap();
    let client = connect_port(&Port::File(path.clone()), None).unwrap();
    assert_eq!(client.info().unwrap().identity.serial, "short");
    assert_eq!(client.info().unwrap().identity.scan_hz, 1000);
    client.set_fields(Fields::CODES).unwrap();
    client.stream(true).unwrap();
    assert_eq!(frames(&client, 1)[0].frame.codes.unwrap().bridges[0].unwrap().d.0, 2003);
    let end = std::iter::repeat_with(|| client.next(PATIENCE)).find_map(Result::err).unwrap();
    assert_eq!(end.problem(), Some(&Problem::Ended));

    trace += "oops\n";
    std::fs::write(&path, &trace).unwrap();
    let client = connect_port(&Port::File(path), None).unwrap();
    client.stream(true).unwrap();
    let end = std::iter::repeat_with(|| client.next(PATIENCE)).find_map(Result::err).unwrap();
    assert!(end.to_string().contains("short.csv:1002"), "{end}");
}

#[test]
fn scene_plays_as_finger() {
    let client = connect_port(&"sim:press".parse().unwrap(), None).unwrap();
    client.stream(true).unwrap();
    assert_eq!(frames(&client, 100).len(), 100);
    assert!(connect_port(&"sim:no-such-scene".parse().unwrap(), None).is_err());
}

#[test]
fn virtual_finger_refuses_empty_source() {
    let empty = Source::samples("nothing", std::iter::empty());
    assert!(VirtualFinger::on_tcp("127.0.0.1:0", empty, None).is_err());
}

#[test]
fn requests_and_frames_do_not_wait_for_each_other() {
    let finger = on_tcp(still());
    let client = connect(&finger);
    client.stream(true).unwrap();
    std::thread::scope(|scope| {
        let infos = scope.spawn(|| (0..50).map(|_| client.info().unwrap().counters.scans).max());
        frames(&client, 500);
        assert!(infos.join().unwrap().unwrap() > 0);
    });
    assert!(client.next(Duration::from_secs(5)).unwrap().is_some());
}

#[test]
fn second_program_on_tcp_is_told_of_the_first() {
    let finger = on_tcp(still());
    let first = connect(&finger);
    let refused = Client::open(finger.port()).err().unwrap();
    assert_eq!(refused.problem(), Some(&Problem::Busy), "{refused}");
    first.info().unwrap();
    drop(first);
    connect(&finger).info().unwrap();
}

#[test]
fn post_of_a_web_page_changes_nothing() {
    let finger = on_tcp(still());
    let before = connect(&finger).info().unwrap();
    let mut buffer = [0; MAX_PACKET];
    let request = Request { tag: 1, command: Command::SetRate { hz: 13 } };
    let request = pack(&request, &mut buffer).unwrap();
    let head = format!("POST / HTTP/1.1\r\nContent-Length: {}\r\n\r\n", request.len() + 1);
    let address = finger.port().to_string().replace("tcp:", "");
    for first in [head.as_bytes(), b"", b"\0"] {
        let mut page = TcpStream::connect(&address).unwrap();
        page.set_read_timeout(Some(PATIENCE)).unwrap();
        page.write_all(&[first, &[0], request].concat()).unwrap();
        let mut answer = Vec::new();
        // The link may be reset, because bytes of the page were left unread.
        let _ = page.read_to_end(&mut answer);
        assert_eq!(answer, [0; 0], "closed without an answer");
    }
    assert_eq!(connect(&finger).info().unwrap().rate_millihertz, before.rate_millihertz);
}

#[test]
fn silent_tcp_client_shuts_nobody_out() {
    let finger = on_tcp(still());
    let address = finger.port().to_string().replace("tcp:", "");
    let silent: Vec<_> = (0..20).map(|_| TcpStream::connect(&address).unwrap()).collect();
    connect(&finger).info().unwrap();
    drop(silent);
}
