//! Names of ports.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// Port of a finger, in the same words in every command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Port {
    /// `usb:SERIAL`, the finger of that serial number on USB, or `usb`, the only one.
    Usb(Option<String>),
    /// Serial device by its name in the operating system.
    Serial(String),
    /// `tcp:HOST:PORT`: finger on a network.
    Tcp {
        /// Name or address; IPv6 without brackets.
        host: String,
        /// TCP port.
        port: u16,
    },
    /// `file:PATH`: trace or recording, played back in real time by the `taxel` command.
    File(PathBuf),
    /// `sim:SCENE`: simulated finger in a scene, by name or path, run by the `taxel` command.
    Sim(String),
}

/// Reason that a word is not a port.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PortError {
    /// The name is empty.
    #[error("`{0}` has no name; write usb, a serial device, tcp:HOST:PORT, file:PATH or sim:SCENE")]
    Empty(String),
    /// Unknown kind of port.
    #[error(
        "unknown kind of port `{0}:`; write usb, a serial device, tcp:HOST:PORT, file:PATH or sim:SCENE"
    )]
    Kind(String),
    /// `tcp:` without host and port.
    #[error("`{0}` is not HOST:PORT; write for example tcp:192.168.1.20:5000 or tcp:[::1]:5000")]
    Address(String),
}

impl FromStr for Port {
    type Err = PortError;

    fn from_str(word: &str) -> Result<Self, PortError> {
        let (kind, name) = match word.split_once(':') {
            // A path may contain a colon: /dev/serial/by-path/pci-0000:00:14.0-usb…
            Some((kind, name)) if !kind.contains(['/', '\\', '.']) => (kind, name),
            _ => ("", word),
        };
        if word == "usb" {
            return Ok(Self::Usb(None));
        }
        if name.is_empty() {
            return Err(PortError::Empty(word.to_owned()));
        }
        match kind {
            "" => Ok(Self::Serial(name.to_owned())),
            "usb" => Ok(Self::Usb(Some(name.to_owned()))),
            "tcp" => address(name).ok_or_else(|| PortError::Address(name.to_owned())),
            "file" => Ok(Self::File(name.into())),
            "sim" => Ok(Self::Sim(name.to_owned())),
            _ => Err(PortError::Kind(kind.to_owned())),
        }
    }
}

fn address(name: &str) -> Option<Port> {
    let (host, port) = name.rsplit_once(':')?;
    let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    let host = match bare {
        Some(host) => host,
        // Without brackets a colon would make the port ambiguous.
        None if host.contains(':') => return None,
        None => host,
    };
    let port = port.parse().ok().filter(|port| *port != 0)?;
    (!host.is_empty()).then(|| Port::Tcp { host: host.to_owned(), port })
}

impl fmt::Display for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Usb(None) => f.write_str("usb"),
            Self::Usb(Some(serial)) => write!(f, "usb:{serial}"),
            Self::Serial(name) => f.write_str(name),
            Self::Tcp { host, port } if host.contains(':') => write!(f, "tcp:[{host}]:{port}"),
            Self::Tcp { host, port } => write!(f, "tcp:{host}:{port}"),
            Self::File(path) => write!(f, "file:{}", path.display()),
            Self::Sim(scene) => write!(f, "sim:{scene}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_of_port_reads_back() {
        for word in [
            "usb",
            "usb:F-0042",
            "/dev/ttyACM0",
            "COM3",
            "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0",
            "tcp:finger.local:5000",
            "tcp:[::1]:5000",
            "file:traces/a:b.csv",
            "sim:press",
            "sim:./scenes/press.toml",
        ] {
            assert_eq!(word.parse::<Port>().unwrap().to_string(), word);
        }
    }

    #[test]
    fn invalid_port_is_refused_with_valid_forms() {
        for (word, part) in [
            ("", "has no name"),
            ("sim:", "has no name"),
            ("udp:1.2.3.4:5", "unknown kind of port `udp:`"),
            ("tcp:localhost", "not HOST:PORT"),
            ("tcp::5000", "not HOST:PORT"),
            ("tcp:localhost:0", "not HOST:PORT"),
            ("tcp:localhost:70000", "not HOST:PORT"),
            ("tcp:::1:5000", "not HOST:PORT"),
        ] {
            let error = word.parse::<Port>().unwrap_err().to_string();
            assert!(error.contains(part), "{word}: {error}");
            assert!(!error.contains('\n'));
        }
    }
}
