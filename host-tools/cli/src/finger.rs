//! Port of a command's finger, opened for hardware, recordings and scenes.

use std::net::ToSocketAddrs;
use std::path::Path;

use taxel::calibration::{Calibration, MAX_BYTES};
use taxel_client::{Client, Link, LinkError, Port, ReconnectingClient};
use taxel_files::recording::Recording;
use taxel_files::{FileError, calibration};
use taxel_sim::Scene;
use taxel_sim::scene::{Kind, built_in};

use crate::output;
use crate::virtual_finger::{Source, VirtualFinger};

/// Calibration of the finger in the built-in scenes. The README next to the file describes its
/// origin.
const VIRTUAL: &str = include_str!("../assets/virtual-finger.cal.toml");

/// Port argument of every command with a finger.
#[derive(clap::Args)]
pub struct PortArg {
    /// The finger: usb, usb:SERIAL, a serial device, tcp:HOST:PORT, file:PATH or sim:SCENE.
    #[arg(long, value_name = "PORT", default_value = "usb")]
    pub port: Port,
}

impl PortArg {
    /// Connects to the finger.
    ///
    /// # Errors
    /// The port cannot be opened.
    pub fn connect(&self) -> Result<Client, LinkError> {
        let calibration = match &self.port {
            Port::Sim(scene) => scene_calibration(None, scene).map_err(LinkError::device)?,
            Port::File(path) => {
                // A file that is no recording is reported by the client.
                let remarks = Recording::open(path).map(|recording| recording.remarks(path));
                remarks.into_iter().flatten().for_each(output::note);
                None
            }
            _ => None,
        };
        connect(&self.port, calibration.as_ref())
    }
}

/// Opens any port. A virtual finger starts with `calibration`; hardware keeps its own.
///
/// # Errors
/// The port cannot be opened, or the recording or scene behind it is damaged.
pub fn open(port: &Port, calibration: Option<&Calibration>) -> Result<Link, LinkError> {
    let finger = match port {
        Port::File(path) => VirtualFinger::of_file(path, calibration)?,
        Port::Sim(scene) => {
            VirtualFinger::on_tcp("127.0.0.1:0", Source::scene(scene)?, calibration)?
        }
        device => return Link::open(device),
    };
    Ok(Link::open(finger.port())?.with_device(finger))
}

/// Connects to any port, as [`open`] opens it.
///
/// # Errors
/// As [`open`], and [`Client::open`].
pub fn connect(port: &Port, calibration: Option<&Calibration>) -> Result<Client, LinkError> {
    Client::over(port, open(port, calibration)?)
}

/// Creates a client of any port that reconnects after the finger was unplugged. A virtual finger
/// starts with the file of a calibration, else with its scene's own.
///
/// The calibration cannot be read, or there is no such scene or file, for which nobody could wait.
pub fn steady(port: Port, calibration: Option<&Path>) -> Result<ReconnectingClient, FileError> {
    let scene = match &port {
        Port::Sim(scene) => {
            Scene::load(scene)?;
            scene.as_str()
        }
        Port::File(path) => {
            path.metadata().map_err(|error| FileError::io(path, &error))?;
            ""
        }
        _ => "",
    };
    let calibration = scene_calibration(calibration, scene)?;
    Ok(ReconnectingClient::opened_by(port, move |port| open(port, calibration.as_ref())))
}

/// Returns the initial calibration of a scene's finger. It is the named file, else the built-in
/// scene's own. The finger of another scene is another device and has none.
///
/// The file cannot be read or is no calibration.
pub fn scene_calibration(
    path: Option<&Path>,
    scene: &str,
) -> Result<Option<Calibration>, FileError> {
    match path {
        Some(path) => calibration::read(path).map(Some),
        None if is_virtual_finger(scene) => {
            calibration::parse(Path::new("virtual-finger.cal.toml"), VIRTUAL).map(Some)
        }
        None => Ok(None),
    }
}

/// Whether the scene is built in and its device matches the calibration: 4×4 taxels, no walls.
fn is_virtual_finger(scene: &str) -> bool {
    built_in().any(|(name, _)| name == scene)
        && Scene::load(scene)
            .is_ok_and(|scene| scene.device.kind == Kind::Taxel4x4 && !scene.has_walls())
}

/// Encodes a calibration as the bytes that go to a finger.
///
/// # Errors
/// The calibration is not valid.
pub fn record(calibration: &Calibration) -> anyhow::Result<Vec<u8>> {
    let mut buffer = [0; MAX_BYTES];
    let bytes = calibration.to_bytes(&mut buffer);
    bytes.map(<[u8]>::to_vec).map_err(|error| anyhow::anyhow!("{error}"))
}

/// Parses a number whose range the finger knows.
///
/// # Errors
/// The text is not a whole number.
pub fn checked_by_finger(text: &str) -> Result<u16, String> {
    text.parse().map(in_16_bits).map_err(|_| "expected a whole number".to_owned())
}

/// Makes a number that 16 bits cannot hold the largest, which the finger refuses with its range.
pub fn in_16_bits(number: i64) -> u16 {
    u16::try_from(number).unwrap_or(u16::MAX)
}

/// Parses the address for `--tcp`.
///
/// # Errors
/// The text is not an address.
pub fn address(text: &str) -> Result<String, String> {
    let known = text.to_socket_addrs().is_ok_and(|mut addresses| addresses.next().is_some());
    if known { Ok(text.to_owned()) } else { Err("expected HOST:PORT, as in 127.0.0.1:5000".into()) }
}

/// Refuses an `address` that other machines reach, unless that was asked for by `--open`. TCP and
/// Foxglove have no password.
///
/// # Errors
/// The address is not of this machine alone.
pub fn closed(address: &str, open: bool) -> anyhow::Result<()> {
    let addresses = address.to_socket_addrs()?.filter(|address| !address.ip().is_loopback());
    anyhow::ensure!(
        open || addresses.count() == 0,
        "{address}: every machine of the network reaches it, and there is no password; use 127.0.0.1 and SSH, \
         or add --open if that is meant"
    );
    Ok(())
}
