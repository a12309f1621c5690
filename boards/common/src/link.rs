//! USB CDC ACM link of the session.
//!
//! * "Connected" is not "open": a port is open while the host holds DTR, and a session lasts as
//!   long.
//! * One packet is in flight at a time, so packets are filled: bytes go out 64 at a time, and a
//!   flush sends the rest. A flush also sends the zero-length packet that ends a transfer of full
//!   packets, because the driver does not.
//! * A write waits without end while nobody reads. It times out now and then to check whether the
//!   port is still open. Meanwhile the session's pipe is full and drops whole frames, counted.
//! * Each session begins with a zero byte, which ends a message that the last session cut.

use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use embassy_time::{Duration, with_timeout};
use embassy_usb::class::cdc_acm::{CdcAcmClass, ControlChanged, Receiver, Sender, State};
use embassy_usb::driver::Driver;
use embassy_usb::{Builder, Config, Handler, UsbDevice, UsbVersion};
use embedded_io_async::{Error, ErrorKind, ErrorType, Read, Write};
use static_cell::StaticCell;
use taxel::instrument::Instrument;
use taxel::session::{Board, Buffers, Pace, run_session};

/// Bytes in a packet of a full-speed bulk endpoint.
const PACKET: usize = 64;
/// Interval at which a write checks whether the port is still open.
const PATIENCE: Duration = Duration::from_millis(100);

/// Test identifiers of pid.codes; a product on sale needs its own.
const VENDOR: u16 = 0x1209;
const PRODUCT: u16 = 0x0001;

/// Error of a port that the host closed or unplugged.
#[derive(Debug)]
pub struct Closed;

impl Error for Closed {
    fn kind(&self) -> ErrorKind {
        ErrorKind::NotConnected
    }
}

impl core::fmt::Display for Closed {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("the port is closed")
    }
}

impl core::error::Error for Closed {}

/// Serial port of the finger.
pub struct Link<D: Driver<'static>> {
    sender: Sender<'static, D>,
    receiver: Receiver<'static, D>,
    control: ControlChanged<'static>,
    buffers: &'static mut Buffers,
}

/// Handler that reports suspend and resume of the bus.
struct Suspend(fn(bool));

impl Handler for Suspend {
    fn suspended(&mut self, suspended: bool) {
        (self.0)(suspended);
    }

    fn reset(&mut self) {
        (self.0)(false);
    }
}

/// Builds the USB device and its serial port.
///
/// `suspend` is called with true when the host suspends the bus. A finger powered by the bus must
/// then switch off its LEDs.
///
/// # Panics
/// On the second call.
pub fn device<D: Driver<'static>>(
    driver: D,
    product: &'static str,
    serial: &'static str,
    suspend: fn(bool),
) -> (UsbDevice<'static, D>, Link<D>) {
    static CONFIGURATION: StaticCell<[u8; 128]> = StaticCell::new();
    static CONTROL: StaticCell<[u8; PACKET]> = StaticCell::new();
    static STATE: StaticCell<State> = StaticCell::new();
    static SUSPEND: StaticCell<Suspend> = StaticCell::new();
    static BUFFERS: StaticCell<Buffers> = StaticCell::new();

    let mut config = Config::new(VENDOR, PRODUCT);
    config.manufacturer = Some("taxel");
    config.product = Some(product);
    config.serial_number = Some(serial);
    // LEDs 8 mA, controller 35 mA, bridges 7 mA, columns 3 mA; see the board's page.
    config.max_power = 100;
    config.max_packet_size_0 = PACKET as u8;
    // From 2.01 on a host asks for capabilities (BOS) and treats an empty answer as an error.
    config.bcd_usb = UsbVersion::Two;
    let mut builder = Builder::new(
        driver,
        config,
        CONFIGURATION.init([0; 128]),
        &mut [],
        &mut [],
        CONTROL.init([0; PACKET]),
    );
    builder.handler(SUSPEND.init(Suspend(suspend)));
    let class = CdcAcmClass::new(&mut builder, STATE.init(State::new()), PACKET as u16);
    let (sender, receiver, control) = class.split_with_control();
    let buffers = BUFFERS.init_with(Buffers::new);
    (builder.build(), Link { sender, receiver, control, buffers })
}

impl<D: Driver<'static>> Link<D> {
    /// Runs one session after the other, without end.
    ///
    /// The instrument keeps its settings between sessions, and takes its scans while the port is
    /// closed.
    pub async fn serve(&mut self, board: &mut impl Board, instrument: &mut Instrument) {
        loop {
            let scans = select(opened(&self.control), idle(board, instrument)).await;
            if let Either::Second(()) = scans {
                return;
            }
            defmt::info!("port opened");
            let rx = Rx { receiver: &mut self.receiver, control: &self.control };
            let tx = Tx { sender: &mut self.sender, packet: [0; PACKET], length: 1, full: false };
            if run_session(rx, tx, board, instrument, self.buffers, Pace::Live).await.is_err() {
                defmt::info!("port closed while writing");
            }
            defmt::info!("session over");
            // A bus reset disables the endpoints at once, but DTR falls only when the device's task
            // runs: let it run.
            yield_now().await;
        }
    }
}

/// Takes scans while the port is closed.
async fn idle(board: &mut impl Board, instrument: &mut Instrument) {
    while let Some(scan) = board.scan().await {
        let before = board.ticks();
        let _ = instrument.scan(&scan);
        instrument.note_cost(board.ticks().wrapping_sub(before));
        // Scans that come faster than they are processed would never let the port open.
        yield_now().await;
    }
}

async fn opened(control: &ControlChanged<'static>) {
    while !control.dtr() {
        control.control_changed().await;
    }
}

async fn closed(control: &ControlChanged<'static>) {
    while control.dtr() {
        control.control_changed().await;
    }
}

struct Rx<'l, D: Driver<'static>> {
    receiver: &'l mut Receiver<'static, D>,
    control: &'l ControlChanged<'static>,
}

impl<D: Driver<'static>> ErrorType for Rx<'_, D> {
    type Error = Closed;
}

impl<D: Driver<'static>> Read for Rx<'_, D> {
    /// Reads a packet, which must fit `bytes`; 0 ends the session.
    async fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Closed> {
        loop {
            match select(self.receiver.read_packet(bytes), closed(self.control)).await {
                // A zero-length packet does not end the session.
                Either::First(Ok(0)) => {}
                Either::First(Ok(length)) => return Ok(length),
                Either::First(Err(_)) | Either::Second(()) => return Ok(0),
            }
        }
    }
}

struct Tx<'l, D: Driver<'static>> {
    sender: &'l mut Sender<'static, D>,
    packet: [u8; PACKET],
    length: usize,
    /// Whether the last packet was full, so that the host waits for a shorter one.
    full: bool,
}

impl<D: Driver<'static>> Tx<'_, D> {
    async fn send(&mut self) -> Result<(), Closed> {
        let packet = self.packet.get(..self.length).unwrap_or_default();
        loop {
            match with_timeout(PATIENCE, self.sender.write_packet(packet)).await {
                Ok(Ok(())) => break,
                Ok(Err(_)) => return Err(Closed),
                Err(_) if !self.sender.dtr() => return Err(Closed),
                Err(_) => {}
            }
        }
        self.full = self.length == PACKET;
        self.length = 0;
        Ok(())
    }
}

impl<D: Driver<'static>> ErrorType for Tx<'_, D> {
    type Error = Closed;
}

impl<D: Driver<'static>> Write for Tx<'_, D> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Closed> {
        if self.length == PACKET {
            self.send().await?;
        }
        let room = self.packet.get_mut(self.length..).unwrap_or_default();
        let taken = room.len().min(bytes.len());
        if let (Some(room), Some(bytes)) = (room.get_mut(..taken), bytes.get(..taken)) {
            room.copy_from_slice(bytes);
        }
        self.length += taken;
        Ok(taken)
    }

    async fn flush(&mut self) -> Result<(), Closed> {
        if self.length == PACKET {
            self.send().await?;
        }
        if self.length > 0 || self.full {
            self.send().await?;
        }
        Ok(())
    }
}
