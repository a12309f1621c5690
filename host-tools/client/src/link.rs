//! Opens a port as a pair of byte streams.

use std::error::Error;
use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::path::Path;
use std::time::Duration;

use crate::error::{LinkError, Problem, one_line};
use crate::port::Port;
use crate::usb;

/// Baud rate of a UART bridge; USB and pseudo-terminals ignore it.
const BAUD: u32 = 1_000_000;
/// Time limit of a read, after which the reader checks whether to stop.
const POLL: Duration = Duration::from_millis(50);
/// Time limit of a write, after which the link counts as broken.
const WRITE_PATIENCE: Duration = Duration::from_secs(1);
/// Time limit of a TCP connection.
const CONNECT_PATIENCE: Duration = Duration::from_secs(2);

/// Silence of a TCP peer before the first probe, interval of the probes, and probes without an
/// answer after which the link counts as broken: 25 s in all.
const KEEP_ALIVE_AFTER: Duration = Duration::from_secs(10);
const KEEP_ALIVE_EVERY: Duration = Duration::from_secs(5);
const KEEP_ALIVE_RETRIES: u32 = 3;
/// Time after which sent data without a receipt ends the link: that of all probes.
#[cfg(target_os = "linux")]
const GONE_AFTER: Duration = Duration::from_secs(25);

/// Open port: bytes in both directions.
pub struct Link {
    pub(crate) reader: Box<dyn Read + Send>,
    pub(crate) writer: Box<dyn Write + Send>,
    pub(crate) device: Option<Box<dyn Device>>,
    pub(crate) first_tag: Option<u8>,
}

/// Device in this process, behind its own [`Link`]. Dropping it ends it.
pub trait Device: Send + Sync {
    /// Returns how the device ended by itself: `Ok` when its data was over. `None` while it runs,
    /// or if the link broke.
    fn outcome(&self) -> Option<Result<(), Box<dyn Error + Send + Sync>>>;
}

impl Link {
    /// Opens a finger's USB, serial or TCP port.
    ///
    /// # Errors
    /// The port cannot be opened. `file:` and `sim:` never can: the `taxel` command plays those.
    pub fn open(port: &Port) -> Result<Self, LinkError> {
        let opened = match port {
            Port::Usb(number) => {
                usb::find(&usb::devices(), number.as_deref()).and_then(|name| serial(&name))
            }
            Port::Serial(name) => serial(name),
            Port::Tcp { host, port: number } => tcp((host.as_str(), *number)),
            Port::File(_) | Port::Sim(_) => Err(Problem::NoDevice),
        };
        opened.map_err(|problem| problem.at(port))
    }

    /// Combines any two byte streams. Reads must return [`TimedOut`](io::ErrorKind::TimedOut) or
    /// [`WouldBlock`](io::ErrorKind::WouldBlock) at least every 100 ms.
    #[must_use]
    pub fn over(reader: Box<dyn Read + Send>, writer: Box<dyn Write + Send>) -> Self {
        Self { reader, writer, device: None, first_tag: None }
    }

    /// Numbers the requests from `tag` on instead of a random number: the same requests are then
    /// the same bytes. The link must hold no replies to an earlier program.
    #[must_use]
    pub fn with_first_tag(self, tag: u8) -> Self {
        Self { first_tag: Some(tag), ..self }
    }

    /// Ties the device at the other end to this link.
    #[must_use]
    pub fn with_device(self, device: impl Device + 'static) -> Self {
        Self { device: Some(Box::new(device)), ..self }
    }
}

fn serial(name: &str) -> Result<Link, Problem> {
    let mut builder = serialport::new(name, BAUD).timeout(POLL);
    if cfg!(windows) {
        // Elsewhere opening sets DTR; the firmware streams only to an open port.
        builder = builder.dtr_on_open(true);
    }
    let reader = builder.open().map_err(|error| no_serial(name, &error))?;
    // Bytes that an earlier program left unread; a driver that cannot drop them does no harm.
    let _ = reader.clear(serialport::ClearBuffer::Input);
    let mut writer = reader.try_clone().map_err(|error| no_serial(name, &error))?;
    writer.set_timeout(WRITE_PATIENCE).map_err(|error| no_serial(name, &error))?;
    Ok(Link::over(Box::new(reader), Box::new(writer)))
}

fn no_serial(name: &str, error: &serialport::Error) -> Problem {
    use serialport::ErrorKind as Kind;
    let path = Path::new(name);
    if path.is_file() {
        return Problem::NotADevice;
    }
    match error.kind() {
        Kind::Io(io::ErrorKind::PermissionDenied) => Problem::Permission,
        // The library reports a device that another program holds as "no device" too.
        Kind::NoDevice if path.exists() => Problem::Busy,
        Kind::NoDevice | Kind::Io(io::ErrorKind::NotFound) => Problem::NoSuchDevice(devices()),
        _ => Problem::Open(one_line(error)),
    }
}

fn devices() -> String {
    let ports = serialport::available_ports().unwrap_or_default();
    let names: Vec<_> = ports.into_iter().map(|port| port.port_name).collect();
    match names.as_slice() {
        [] => "there is no serial device; is the finger plugged in?".to_owned(),
        names => format!("there are {}", names.join(", ")),
    }
}

fn tcp(address: (&str, u16)) -> Result<Link, Problem> {
    let unreachable = |error: io::Error| match error.kind() {
        io::ErrorKind::ConnectionRefused => Problem::Refused,
        _ => Problem::Unreachable(one_line(&error)),
    };
    let mut problem = Problem::Unreachable("the name has no address".to_owned());
    for address in address.to_socket_addrs().map_err(unreachable)? {
        match TcpStream::connect_timeout(&address, CONNECT_PATIENCE) {
            Ok(stream) => return split(stream).map_err(|error| Problem::Open(one_line(&error))),
            Err(error) => problem = unreachable(error),
        }
    }
    Err(problem)
}

/// Lets TCP notice after 25 s that the peer is gone: a machine without power or network.
///
/// # Errors
/// The operating system does not allow it.
pub fn keep_alive<'s, S>(stream: &'s S) -> io::Result<()>
where
    socket2::SockRef<'s>: From<&'s S>,
{
    let probes = socket2::TcpKeepalive::new()
        .with_time(KEEP_ALIVE_AFTER)
        .with_interval(KEEP_ALIVE_EVERY)
        .with_retries(KEEP_ALIVE_RETRIES);
    let socket = socket2::SockRef::from(stream);
    // Linux sends no probe while sent data waits for its receipt.
    #[cfg(target_os = "linux")]
    socket.set_tcp_user_timeout(Some(GONE_AFTER))?;
    socket.set_tcp_keepalive(&probes)
}

fn split(stream: TcpStream) -> io::Result<Link> {
    stream.set_nodelay(true)?;
    keep_alive(&stream)?;
    stream.set_read_timeout(Some(POLL))?;
    stream.set_write_timeout(Some(WRITE_PATIENCE))?;
    let writer = stream.try_clone()?;
    Ok(Link::over(Box::new(stream), Box::new(writer)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tcp_link_probes_a_silent_peer() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let stream = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let same = stream.try_clone().unwrap();
        let _link = split(stream).unwrap();
        let probes = socket2::SockRef::from(&same);
        assert!(probes.keepalive().unwrap());
        assert_eq!(probes.tcp_keepalive_time().unwrap(), Duration::from_secs(10));
        assert_eq!(probes.tcp_keepalive_interval().unwrap(), Duration::from_secs(5));
        assert_eq!(probes.tcp_keepalive_retries().unwrap(), 3);
        #[cfg(target_os = "linux")]
        assert_eq!(probes.tcp_user_timeout().unwrap(), Some(Duration::from_secs(25)));
    }

    /// The error is constructed, because the tests' user may have access to every device.
    #[test]
    fn permission_error_names_udev_rule() {
        let denied = serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied);
        let denied = serialport::Error::new(denied, "Permission denied");
        let problem = no_serial("/dev/ttyACM0", &denied);
        assert_eq!(problem, Problem::Permission);
        let line = problem.at(&Port::Serial("/dev/ttyACM0".to_owned())).to_string();
        assert!(line.starts_with("/dev/ttyACM0: permission denied; "), "{line}");
        assert!(line.contains("taxel udev") && !line.contains('\n'), "{line}");
    }
}
