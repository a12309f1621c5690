//! Which finger a command talks to.

use std::path::Path;

use taxel::calibration::Calibration;
use taxel_formats::FileError;
use taxel_link::{Client, LinkError, Port};

/// The one argument that every command with a finger has.
#[derive(clap::Args)]
pub struct PortArg {
    /// The finger: a serial device, tcp:HOST:PORT, file:TRACE.csv or sim:SCENE.
    #[arg(long, value_name = "PORT")]
    pub port: Port,
}

impl PortArg {
    /// Connects to it.
    ///
    /// # Errors
    /// What the port said.
    pub fn connect(&self) -> Result<Client, LinkError> {
        Client::open(&self.port, virtual_calibration(None)?.as_ref())
    }
}

/// What a virtual finger starts with: the file that the user named, if any.
///
/// # Errors
/// The file cannot be read or is no calibration.
pub fn virtual_calibration(path: Option<&Path>) -> Result<Option<Calibration>, FileError> {
    path.map(taxel_formats::calibration::read).transpose()
}
