//! Reads frames from a port: `cargo run -p taxel-client --example read_frames -- PORT [SECONDS]`.
//!
//! PORT is `usb`, a serial device or `tcp:HOST:PORT`. Without hardware, `taxel serve --port
//! sim:tour --tcp 127.0.0.1:5000` is a simulated finger at `tcp:127.0.0.1:5000`.

use std::time::{Duration, Instant};

use taxel::frame::Fields;
use taxel_client::{Client, LinkError, Port};

/// Frames a second.
const RATE_HZ: u16 = 100;

fn read(port: &Port, seconds: f64) -> Result<(), LinkError> {
    let client = Client::open(port)?;
    let identity = client.info()?.identity;
    eprintln!("{} {}, {} scans a second", identity.board, identity.serial, identity.scan_hz);
    client.set_fields(Fields::FORCE)?;
    client.set_rate(RATE_HZ)?;
    client.stream(true)?;
    let end = Instant::now() + Duration::from_secs_f64(seconds);
    while Instant::now() < end {
        let Some(received) = client.next(Duration::from_secs(1))? else {
            eprintln!("no frame for a second");
            continue;
        };
        let frame = received.frame;
        // A force is a number or the reason for its absence.
        let force = frame.force.map(|force| match force.z {
            Ok(newtons) => format!("{:.3} N", newtons.0),
            Err(reason) => format!("{reason:?}"),
        });
        println!("{:.3} s  {}", frame.time.0 as f64 / 1e6, force.unwrap_or_default());
    }
    client.stream(false)?;
    let counts = client.counts();
    eprintln!("{} frames, {} lost", counts.frames, counts.lost);
    Ok(())
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let port = arguments.next().unwrap_or_else(|| "usb".to_owned());
    let seconds = arguments.next().and_then(|word| word.parse().ok()).unwrap_or(5.0);
    let result = port
        .parse()
        .map_err(|error| format!("{port}: {error}"))
        .and_then(|port| read(&port, seconds).map_err(|error| error.to_string()));
    if let Err(message) = result {
        eprintln!("{message}");
        std::process::exit(1);
    }
}
