//! USB host: detects the device, resets and enumerates it as Linux does, and uses its serial port.
//!
//! It can keep all transfers for a capture. The bus carries one transaction after the other. An
//! endpoint that would answer NAK is asked again as soon as it is ready. Polling, frames and their
//! start packets are not modelled.

mod control;
mod enumeration;

use std::collections::VecDeque;

use super::Outcome;
use super::capture::{Kind, Urb};
use super::time::{HZ, Tick, micros};
use super::usb::{Answer, Device};
use control::{CLEAR_FEATURE, Control, SET_CONTROL_LINE_STATE, SET_FEATURE, Stage};

/// Debounce, reset and recovery (USB 2.0, 7.1.7.3, 7.1.7.5, 9.2.6.3).
const DEBOUNCE: Tick = micros(100_000);
const RESET: Tick = micros(50_000);
const RESET_RECOVERY: Tick = micros(10_000);
/// Longest time for a request (9.2.6.1).
const PATIENCE: Tick = micros(5_000_000);
/// Idle time before the device must suspend (7.1.7.6).
const IDLE: Tick = micros(3_000);

/// Factor by which a hurried host shortens the waits above.
const HURRY: Tick = 20;

/// Bits of a transaction besides its data: token, handshake, framing of the data, turnaround.
const OVERHEAD_BITS: Tick = 100;
const BIT: Tick = HZ / 12_000_000;

const PACKET: usize = 64;

/// State of the device on this host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// No device, or no cable.
    Detached,
    /// Device seen, debounced until then.
    Debouncing(Tick),
    /// Bus held in reset until then.
    Resetting(Tick),
    /// Device being enumerated, or working.
    Running,
}

/// Descriptors of the device.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Descriptors {
    /// Device descriptor.
    pub device: Vec<u8>,
    /// Configuration descriptor, with all descriptors in it.
    pub configuration: Vec<u8>,
    /// Strings with their numbers, in the order of reading.
    pub strings: Vec<(u8, String)>,
}

/// USB host with one port.
pub struct Host {
    plugged: bool,
    state: State,
    address: u8,
    resets: u8,
    /// Time at which the bus is free.
    free: Tick,
    queue: VecDeque<Control>,
    /// Descriptors that the device returned.
    pub descriptors: Descriptors,
    /// Bulk endpoints: to the host, to the device.
    bulk: Option<[u8; 2]>,
    toggles: [bool; 2],
    /// Whether the last bulk transaction was from the device; both directions have their turn.
    took: bool,
    configured: bool,
    opened: bool,
    /// Whether the port's reader takes data.
    pub reading: bool,
    suspended: bool,
    suspend_at: Option<Tick>,
    /// Whether debounce, reset and recovery take a twentieth of their time.
    pub hurries: bool,
    /// Injected fault: the device receives the result of this function as the request.
    pub misread: Option<fn([u8; 8]) -> [u8; 8]>,
    /// Number of bulk transactions that a stall answered.
    pub stalls: usize,
    received: Vec<u8>,
    to_send: VecDeque<u8>,
    /// Transfers on the bus, if kept.
    pub capture: Option<Vec<Urb>>,
}

impl Host {
    /// Host with the cable plugged in.
    pub fn new(capture: bool) -> Self {
        Self {
            plugged: true,
            state: State::Detached,
            address: 0,
            resets: 0,
            free: 0,
            queue: VecDeque::new(),
            descriptors: Descriptors::default(),
            bulk: None,
            toggles: [false; 2],
            took: false,
            configured: false,
            opened: false,
            reading: true,
            suspended: false,
            suspend_at: None,
            hurries: false,
            misread: None,
            stalls: 0,
            received: Vec::new(),
            to_send: VecDeque::new(),
            capture: capture.then(Vec::new),
        }
    }

    /// Whether the device is configured and no request is pending.
    pub fn is_ready(&self) -> bool {
        self.configured && self.queue.is_empty()
    }

    /// Whether the device has received that its serial port is open.
    pub fn is_open(&self) -> bool {
        self.opened
    }

    /// Opens or closes the serial port: DTR and RTS.
    pub fn open(&mut self, open: bool) {
        self.queue.push_back(Control::new(SET_CONTROL_LINE_STATE, if open { 3 } else { 0 }, 0, 0));
    }

    /// Plugs in or pulls the cable.
    pub fn plug(&mut self, plugged: bool) {
        self.plugged = plugged;
        self.forget();
    }

    /// Halts the device's bulk endpoint to the host, or clears the halt.
    pub fn halt(&mut self, halted: bool) {
        let Some([data_in, _]) = self.bulk else { return };
        let request = if halted { SET_FEATURE } else { CLEAR_FEATURE };
        self.queue.push_back(Control::new(request, 0, u16::from(data_in) | 0x80, 0));
    }

    /// Wait for `time`, shortened if the host hurries.
    fn wait(&self, time: Tick) -> Tick {
        if self.hurries { time / HURRY } else { time }
    }

    fn forget(&mut self) {
        let capture = self.capture.take();
        let (received, free) = (std::mem::take(&mut self.received), self.free);
        *self = Self {
            plugged: self.plugged,
            reading: self.reading,
            hurries: self.hurries,
            misread: self.misread,
            stalls: self.stalls,
            capture,
            received,
            free,
            ..Self::new(false)
        };
    }

    /// Suspends or wakes the bus.
    pub fn suspend(&mut self, suspended: bool, now: Tick) {
        self.suspended = suspended;
        self.suspend_at = Some(if suspended { now + IDLE } else { now });
    }

    /// Queues bytes for the device.
    pub fn send(&mut self, bytes: &[u8]) {
        self.to_send.extend(bytes);
    }

    /// Number of queued bytes that the device has not taken yet.
    pub fn unsent(&self) -> usize {
        self.to_send.len()
    }

    /// Takes the bytes received from the device.
    pub fn take_received(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.received)
    }

    /// Number of the present USB frame.
    pub fn frame(&self, now: Tick) -> u32 {
        (now / micros(1_000)) as u32
    }

    /// Time of the host's next action.
    pub fn next(&self, usb: &dyn Device) -> Option<Tick> {
        if let Some(at) = self.suspend_at {
            return Some(at);
        }
        if !self.plugged {
            return None;
        }
        match self.state {
            State::Detached => usb.is_attached().then_some(self.free),
            // The device reset itself or detached.
            _ if !usb.is_attached() => Some(self.free),
            State::Debouncing(until) | State::Resetting(until) => Some(until),
            State::Running if self.suspended => None,
            State::Running => self.next_transaction(usb),
        }
    }

    fn next_transaction(&self, usb: &dyn Device) -> Option<Tick> {
        if let Some(control) = self.queue.front() {
            let ready = match (control.stage, control.is_in()) {
                (Stage::Setup, _) => true,
                (Stage::Data, true) | (Stage::Status, false) => usb.ready_to_send(self.address, 0),
                (Stage::Data, false) | (Stage::Status, true) => {
                    usb.ready_to_receive(self.address, 0)
                }
            };
            return Some(if ready { self.free } else { control.begun + PATIENCE });
        }
        let [data_in, data_out] = self.bulk.filter(|_| self.configured)?;
        let reads = self.reading && usb.ready_to_send(self.address, data_in);
        let writes = !self.to_send.is_empty() && usb.ready_to_receive(self.address, data_out);
        (reads || writes).then_some(self.free)
    }

    /// Runs the host's next action.
    pub fn advance(&mut self, now: Tick, usb: &mut dyn Device) -> Outcome {
        if self.suspend_at.take().is_some() {
            usb.suspend(self.suspended);
            return Ok(());
        }
        match self.state {
            State::Detached => self.state = State::Debouncing(now + self.wait(DEBOUNCE)),
            _ if !usb.is_attached() => {
                self.forget();
                self.free = now;
            }
            State::Debouncing(_) => self.reset(now, usb),
            State::Resetting(_) => {
                usb.bus_reset_over();
                self.free = now + self.wait(RESET_RECOVERY);
                self.state = State::Running;
                self.ask_first();
            }
            State::Running => return self.transact(now, usb).map_err(|why| format!("USB: {why}")),
        }
        Ok(())
    }

    fn reset(&mut self, now: Tick, usb: &mut dyn Device) {
        usb.bus_reset();
        self.resets += 1;
        self.address = 0;
        self.state = State::Resetting(now + self.wait(RESET));
    }

    fn transact(&mut self, now: Tick, usb: &mut dyn Device) -> Outcome {
        if let Some(mut control) = self.queue.pop_front() {
            let done = self.control(&mut control, now, usb)?;
            if done {
                self.conclude(control, now, usb)?
            } else {
                self.queue.push_front(control)
            }
            return Ok(());
        }
        let Some([data_in, data_out]) = self.bulk else { return Ok(()) };
        let gives = !self.to_send.is_empty() && usb.ready_to_receive(self.address, data_out);
        let takes = self.reading && usb.ready_to_send(self.address, data_in);
        self.took = takes && !(gives && self.took);
        if self.took {
            match usb.take(self.address, data_in)? {
                Answer::Data(data1, data) => {
                    if data1 != self.toggles[0] {
                        return Err(
                            "a packet of the bulk IN endpoint is missing or repeated".into()
                        );
                    }
                    self.toggles[0] = !data1;
                    self.occupy(now, data.len());
                    self.note(Kind::Bulk, data_in | 0x80, None, &data, now);
                    self.received.extend(data);
                }
                // A driver clears the halt after a stall.
                Answer::Stall => {
                    self.stalls += 1;
                    self.occupy(now, 0);
                    self.halt(false);
                }
                other => return Err(format!("bulk IN answered with {other:?}")),
            }
        } else {
            let count = self.to_send.len().min(PACKET);
            let data: Vec<u8> = self.to_send.drain(..count).collect();
            match usb.out(self.address, data_out, self.toggles[1], &data)? {
                Answer::Ack => {
                    self.toggles[1] = !self.toggles[1];
                    self.occupy(now, data.len());
                    self.note(Kind::Bulk, data_out, None, &data, now);
                }
                other => return Err(format!("bulk OUT answered with {other:?}")),
            }
        }
        Ok(())
    }

    /// Runs the next transaction of a control transfer; true if it was the last.
    fn control(&mut self, control: &mut Control, now: Tick, usb: &mut dyn Device) -> Outcome<bool> {
        let name = |control: &Control| format!("request {:02x?}", control.setup);
        if control.stage != Stage::Setup && now >= control.begun + PATIENCE {
            return Err(format!("{}: no answer within 5 s", name(control)));
        }
        let is_in = control.is_in();
        let answer = match (control.stage, is_in) {
            (Stage::Setup, _) => {
                control.begun = now;
                self.occupy(now, 8);
                let setup = self.misread.map_or(control.setup, |misread| misread(control.setup));
                match usb.setup(self.address, setup)? {
                    Answer::Ack => {
                        control.stage =
                            if control.length() > 0 { Stage::Data } else { Stage::Status };
                        return Ok(false);
                    }
                    other => return Err(format!("{}: answered with {other:?}", name(control))),
                }
            }
            (Stage::Data, true) | (Stage::Status, false) => usb.take(self.address, 0)?,
            (Stage::Data, false) => {
                let rest = &control.data[control.moved..];
                usb.out(self.address, 0, control.data1, &rest[..rest.len().min(PACKET)])?
            }
            (Stage::Status, true) => usb.out(self.address, 0, true, &[])?,
        };
        match (answer, control.stage) {
            (Answer::Data(true, data), Stage::Status) if data.is_empty() => return Ok(true),
            (Answer::Ack, Stage::Status) => return Ok(true),
            (Answer::Data(data1, data), Stage::Data) if data1 == control.data1 => {
                self.occupy(now, data.len());
                control.data1 = !data1;
                let short = data.len() < PACKET;
                control.data.extend(data);
                if short || control.data.len() >= control.length() {
                    control.stage = Stage::Status;
                }
            }
            (Answer::Ack, Stage::Data) => {
                let moved = (control.data.len() - control.moved).min(PACKET);
                self.occupy(now, moved);
                control.moved += moved;
                control.data1 = !control.data1;
                if control.moved == control.data.len() {
                    control.stage = Stage::Status;
                }
            }
            (Answer::Stall, _) if control.refused => {
                control.data.clear();
                return Ok(true);
            }
            (other, stage) => {
                return Err(format!(
                    "{}: answered with {other:?} in stage {stage:?}",
                    name(control)
                ));
            }
        }
        Ok(false)
    }

    /// Occupies the bus with a transaction of `bytes` bytes; bit stuffing is not modelled.
    fn occupy(&mut self, now: Tick, bytes: usize) {
        self.free = now + (OVERHEAD_BITS + 8 * bytes as Tick) * BIT;
    }

    fn note(
        &mut self,
        kind: Kind,
        endpoint: u8,
        setup: Option<([u8; 8], Tick)>,
        data: &[u8],
        now: Tick,
    ) {
        if let Some(capture) = &mut self.capture {
            let (setup, begun) = setup.map_or((None, now), |(setup, begun)| (Some(setup), begun));
            let stalled = setup.is_some_and(|s| s[0] & 0x80 != 0) && data.is_empty();
            capture.push(Urb {
                kind,
                address: self.address,
                endpoint,
                setup,
                data: data.to_vec(),
                begun,
                done: now,
                stalled,
            });
        }
    }
}
