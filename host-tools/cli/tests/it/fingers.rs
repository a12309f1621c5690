//! Virtual fingers for the tests: still, moving, behind TCP or a pseudo-terminal.

use std::time::{Duration, Instant};

use taxel::calibration::{Calibration, MAX_BYTES, TaxelCalibration};
use taxel::condition::TaxelBias;
use taxel::scan::{Codes, Scan, TAXELS, TaxelCodes};
use taxel::units::{Code, FullScale, Micros};
use taxel_cli::VirtualFinger;
use taxel_cli::virtual_finger::Source;
use taxel_client::{Client, Port, Received};
use taxel_files::trace::{Sample, Truth};

/// Scan rate of every test finger, in Hz.
pub const SCAN_HZ: u64 = 4000;
/// Time limit of a wait. Only a failing test reaches it.
pub const PATIENCE: Duration = Duration::from_secs(20);

fn samples(level: impl Fn(u64) -> u16 + Send + 'static) -> impl Iterator<Item = Sample> + Send {
    (0u64..).map(move |i| {
        let taxels = TaxelCodes { lit: [[Code(level(i)); 4]; 4], dark: [Code(200); 4] };
        let codes = Codes {
            full_scale: FullScale::BITS_12,
            taxels: Some(taxels),
            bridges: [None; 4],
            reference: None,
            temperature: None,
        };
        let time = Micros(i * 1_000_000 / SCAN_HZ);
        let truth = Truth { force: [None, None, Some(i as f64)], ..Truth::default() };
        Sample { scan: Scan { time, lost: 0, codes }, truth }
    })
}

/// Unloaded finger.
pub fn still() -> Source {
    Source::samples("still", samples(|i| 1800 + (i % 2) as u16))
}

/// Finger pushed to and fro, ten times a second.
pub fn moving() -> Source {
    Source::samples("moving", samples(|i| 1800 + (i % 400) as u16))
}

/// Unloaded finger that ends after so many scans.
pub fn short(scans: usize) -> Source {
    Source::samples("short", samples(|_| 1800).take(scans))
}

pub fn on_tcp(source: Source) -> VirtualFinger {
    VirtualFinger::on_tcp("127.0.0.1:0", source, None).unwrap()
}

/// Unloaded fingers, one on every kind of link.
pub fn on_every_link() -> Vec<VirtualFinger> {
    let mut fingers = vec![on_tcp(still())];
    if cfg!(unix) {
        fingers.push(VirtualFinger::on_pty(still(), None).unwrap());
    }
    fingers
}

pub fn connect(finger: &VirtualFinger) -> Client {
    Client::open(finger.port()).unwrap()
}

pub fn address(port: &Port) -> (&str, u16) {
    match port {
        Port::Tcp { host, port } => (host, *port),
        other => panic!("{other} is not TCP"),
    }
}

/// Receives the next `count` frames.
pub fn frames(client: &Client, count: usize) -> Vec<Received> {
    let deadline = Instant::now() + PATIENCE;
    let mut frames = Vec::new();
    while frames.len() < count {
        assert!(Instant::now() < deadline, "{} of {count} frames came", frames.len());
        frames.extend(client.next(Duration::from_millis(100)).unwrap());
    }
    frames
}

/// Returns a small valid calibration whose record has several chunks.
pub fn calibration() -> Calibration {
    let taxels = TaxelCalibration {
        bias: TaxelBias { level: [0.39; TAXELS], noise: 1e-3 },
        range: [[-0.5, 0.5]; TAXELS],
        residual: [0.1; 3],
    };
    Calibration {
        serial: "F-0042".try_into().unwrap(),
        date: 1_790_000_000,
        taxels: Some(taxels),
        ..Calibration::default()
    }
}

pub fn bytes(calibration: &Calibration) -> Vec<u8> {
    let mut buffer = [0; MAX_BYTES];
    calibration.to_bytes(&mut buffer).unwrap().to_vec()
}

pub fn record() -> Vec<u8> {
    bytes(&calibration())
}
