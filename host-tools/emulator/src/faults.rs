//! Systematic faults: every bit of every configuration register, written wrongly once.
//!
//! A run without a fault records the writes up to the open port. A fault inverts one bit of a
//! register's last write among them, so that the chip works with it and the firmware does not know.
//! The scene is the same in each run: start, enumeration, a stream of raw codes, a reading that
//! each converter's DMA misses, and a suspended bus. A fault is killed if the board then behaves
//! otherwise than without it, in what a user or an instrument could see, or if the chip does not
//! allow an access. It is refused if the emulator stops for want of a model. No check compares
//! registers: an inverted bit always differs.

pub mod table;

use anyhow::{Context, Result, ensure};
use taxel::frame::{Fields, Frame};
use taxel::scan::Codes;
use taxel::wire::message::{Command, Info, Response};

use crate::board::UNMODELLED;
use crate::board::chip::{PRIVATE, Writes, Written};
use crate::board::cpu::Board;
use crate::board::finger::{Finger, Moment, Pace};
use crate::board::host::{Descriptors, Host};
use crate::board::model::Model;
use crate::board::script::Session;
use crate::board::time::{Tick, micros};

/// Longest times of an enumeration and an answer; the slowest run without a fault takes a third.
const ENUMERATION: Tick = micros(100_000);
const ANSWER: Tick = micros(30_000);
/// Duration of the stream, of the stretch with missed readings, and of the suspended bus.
const STREAM: Tick = micros(30_000);
const MISSED: Tick = micros(6_000);
const SUSPENDED: Tick = micros(10_000);
/// Number of pin events that are compared.
const EVENTS: usize = 600;
/// Largest accepted difference of the core's load.
///
/// Runs repeat exactly. On silicon a cycle counter shows such a difference.
const LOAD: f64 = 0.005;
/// Error of a run in which no dark step shows on the pins.
const NO_SCAN: &str = "no dark step";

/// Ends of the names of registers that hold no configuration: data, flags, keys and commands.
const NOT_CONFIGURATION: [&str; 25] = [
    "TIM2.CCR2",
    "TIM2.CCR_DITHER[1]",
    ".BSRR",
    ".BRR",
    ".ODR",
    ".SR",
    ".ISR",
    ".ISTR",
    ".LISR",
    ".IFCR",
    ".LIFCR",
    ".HIFCR",
    ".EGR",
    ".DR",
    ".CNT",
    ".KR",
    ".KEYR",
    ".ECCR",
    ".ICR",
    ".GINTSTS",
    ".GRSTCTL",
    ".INT",
    ".CTL",
    ".TSIZ",
    ".CIR",
];
/// Peripherals whose registers are memory, or only count: no bit of them is a setting.
const MEMORIES: [&str; 2] = ["USBRAM", "CRC"];

/// Whether a register with this readable name holds configuration.
fn configures(name: &str) -> bool {
    // NVIC's commands: ICER, ISPR, ICPR. ICSR and AIRCR.
    if ["NVIC + 0x18", "NVIC + 0x2", "SCB + 0xd04", "SCB + 0xd0c", "DWT + 0x4"]
        .iter()
        .any(|begin| name.starts_with(begin))
    {
        return false;
    }
    // Endpoints' registers take commands: their bits toggle, clear and start.
    if name.starts_with("USB.EPR") {
        return false;
    }
    let (name, _) = name.split_once(" (").unwrap_or((name, ""));
    let peripheral = name.split(['.', ' ']).next().unwrap_or_default();
    let data = name.starts_with("OTG_FS + 0x1") && name.len() > "OTG_FS + 0x100".len();
    !data
        && !MEMORIES.contains(&peripheral)
        && !NOT_CONFIGURATION.iter().any(|end| name.ends_with(end))
}

/// Configuration register that the firmware writes before the port opens.
#[derive(Clone, Debug)]
pub struct Register {
    /// Readable name, without the address.
    pub name: String,
    /// Address of the register.
    pub address: u32,
    /// Writes up to the open port.
    pub written: Written,
    /// Bits that can be written; the others are reserved or read-only.
    pub writable: u32,
}

impl Register {
    /// Bits that can be written, lowest first.
    pub fn bits(&self) -> impl Iterator<Item = u32> {
        let writable = self.writable;
        (0..32).filter(move |bit| writable >> bit & 1 == 1)
    }
}

/// Bits of the core's own registers that a Cortex-M4 of these chips has.
fn core_bits(address: u32, size: u32) -> u32 {
    match address {
        // SysTick's CTRL and LOAD
        0xe000_e010 => 0x7,
        0xe000_e014 => 0xff_ffff,
        // Four bits of each priority
        0xe000_e400..0xe000_e500 | 0xe000_ed18..0xe000_ed24 => 0xf0f0_f0f0 >> (32 - 8 * size),
        // VTOR, CPACR
        0xe000_ed08 => 0x1fff_ff80,
        0xe000_ed88 => 0xf << 20,
        // DWT's CYCCNTENA; the rest is tracing.
        0xe000_1000 => 1,
        // DEMCR's TRCENA; the rest is debugging.
        0xe000_edfc => 1 << 24,
        _ => u32::MAX >> (32 - 8 * size),
    }
}

/// Observations of a run.
#[derive(Debug)]
struct Observed {
    descriptors: Descriptors,
    /// Events on the pins from a dark step on, with their distance from it.
    events: Vec<(Tick, Moment)>,
    /// Codes of each scan that the converters took.
    seen: Vec<Codes>,
    frames: Vec<Frame>,
    /// Lost frames, lost scans and bad packets: after the stream, and after the missed readings.
    counters: [[u32; 3]; 2],
    /// Share of the time in which the core is awake.
    load: f64,
    /// Time from the watchdog's last feeding to the reset that would come.
    watchdog: Option<Tick>,
    /// Rows and events of the suspended bus, and whether frames come after it.
    dark: (u32, usize, bool),
    /// Times at which the clock's compare match and its overflow would come, after the run's end.
    alarms: [Tick; 2],
    /// Interrupts that occur.
    taken: Vec<usize>,
    /// Whether the board reports the cycles of its estimates.
    costs: bool,
}

/// Result of a fault.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Another behaviour, seen by this check, or an access that the chip does not allow; the
    /// machine's reason if it stopped.
    Killed(&'static str, String),
    /// The emulator stops, for it has no model of what the fault sets; its reason.
    Refused(String),
    /// Unnoticed.
    Survived,
}

/// Image with its scene and its run without a fault.
pub struct Campaign {
    model: Model,
    elf: Vec<u8>,
    scene: Vec<Codes>,
    reference: Observed,
    /// Configuration registers in the order of their addresses.
    pub registers: Vec<Register>,
}

impl Campaign {
    /// Runs the image once without a fault.
    ///
    /// # Errors
    /// The machine stops, or the run does not repeat.
    pub fn new(model: Model, elf: Vec<u8>, scene: Vec<Codes>) -> Result<Self> {
        let (reference, [writes, later]) = observe(model, &elf, &scene, None)?;
        let chip = model.chip(Finger::new(Vec::new(), Pace::Scans), Host::new(false));
        let rows = &chip.common().registers;
        // A register that is written while the board streams holds data or commands.
        let once =
            writes.into_iter().filter(|(address, written)| later.get(address) == Some(written));
        let registers = once.map(|(address, written)| {
            let name = chip.name(address);
            let mut name = name.split(" (").next().unwrap_or_default().to_owned();
            if address >= PRIVATE {
                name = format!("{name} + {:#x}", address & 0xfff);
            }
            let row = rows.get(&address).map(|row| row.writable);
            let writable = row.unwrap_or_else(|| core_bits(address, written.last.0));
            Register { name, address, written, writable }
        });
        // The priority of an interrupt that never occurs has no effect.
        let effective = |register: &Register| {
            let interrupt = register.address.wrapping_sub(0xe000_e400) as usize;
            interrupt > 0xf0 || reference.taken.contains(&interrupt)
        };
        let registers = registers
            .filter(|register| configures(&register.name) && effective(register))
            .collect();
        let campaign = Self { model, elf, scene, reference, registers };
        let (again, _) = observe(model, &campaign.elf, &campaign.scene, None)?;
        let differs = campaign.difference(&again);
        ensure!(
            differs.is_none(),
            "two runs without a fault differ: {}",
            differs.unwrap_or_default()
        );
        Ok(campaign)
    }

    /// Runs the image with these bits of a register's last write inverted.
    ///
    /// # Panics
    /// As the model does, which is a mistake of it.
    pub fn judge(&self, register: &Register, bits: u32) -> Verdict {
        let fault = (register.address, register.written.times, bits);
        match observe(self.model, &self.elf, &self.scene, Some(fault)) {
            Err(error) => {
                let why = format!("{error:#}");
                let check = match () {
                    () if why.contains(UNMODELLED) => return Verdict::Refused(why),
                    () if why.contains("still waiting") => "silence",
                    () if why.contains("the board ended") => "reset",
                    () if why.contains("is answered with") => "answer",
                    () if why.contains(NO_SCAN) => "pins",
                    () => "rule",
                };
                Verdict::Killed(check, why)
            }
            Ok((run, _)) => match self.difference(&run) {
                Some(check) => Verdict::Killed(check, String::new()),
                None => Verdict::Survived,
            },
        }
    }

    /// Check in which a run differs from the one without a fault.
    fn difference(&self, run: &Observed) -> Option<&'static str> {
        let own = &self.reference;
        let steps = |frames: &[Frame]| -> Vec<(u32, bool)> {
            let pairs = frames
                .windows(2)
                .map(|pair| (pair[1].seq - pair[0].seq, pair[1].time.0 - pair[0].time.0));
            pairs.map(|(seq, time)| (seq, (999..=1001).contains(&time))).collect()
        };
        let scans = own.seen.len().min(run.seen.len());
        match () {
            () if run.descriptors != own.descriptors => Some("descriptors"),
            () if run.events != own.events => Some("pins"),
            () if run.seen[..scans] != own.seen[..scans] => Some("codes"),
            () if !carried(&run.frames, &run.seen) => Some("frames"),
            () if steps(&run.frames) != steps(&own.frames) => Some("time"),
            () if run.counters != own.counters => Some("counters"),
            () if (run.load / own.load - 1.0).abs() > LOAD => Some("load"),
            () if run.watchdog != own.watchdog => Some("watchdog"),
            () if run.dark != own.dark => Some("suspend"),
            () if run.alarms != own.alarms => Some("alarms"),
            () if run.taken != own.taken => Some("interrupts"),
            () if run.costs != own.costs => Some("cost"),
            () => None,
        }
    }
}

/// Whether the frames hold every fourth scan's codes, in order.
fn carried(frames: &[Frame], seen: &[Codes]) -> bool {
    let fits = |first: usize| {
        let scans = seen.iter().skip(first).step_by(4);
        frames.iter().zip(scans).all(|(frame, codes)| frame.codes.as_ref() == Some(codes))
    };
    !frames.is_empty() && (0..seen.len().saturating_sub(4 * (frames.len() - 1))).any(fits)
}

/// Writes before the port opens, by address.
type ByAddress = std::collections::BTreeMap<u32, Written>;

fn observe(
    model: Model,
    elf: &[u8],
    scene: &[Codes],
    fault: Option<(u32, u32, u32)>,
) -> Result<(Observed, [ByAddress; 2])> {
    let mut host = Host::new(false);
    host.hurries = true;
    let mut board = Board::new(model, elf, Finger::new(scene.to_vec(), Pace::Scans), host)?;
    board.chip().common_mut().writes = Some(Writes { fault, ..Writes::default() });
    let mut session = Session::open_within(board, ENUMERATION)?;
    session.patience = ANSWER;
    let written = |session: &mut Session| {
        session.board.chip().common_mut().writes.as_ref().map(|writes| writes.by_address.clone())
    };
    let opened = written(&mut session).unwrap_or_default();
    session.ask(Command::SetFields(Fields::CODES))?;
    session.ask(Command::Stream(true))?;
    session.frames.clear();
    session.board.finger().timing = Some(Vec::new());
    let before = (session.board.now(), session.board.slept());
    session.run(STREAM)?;
    let (time, slept) = (session.board.now() - before.0, session.board.slept() - before.1);
    let timing = session.board.finger().timing.take().unwrap_or_default();
    let dark = timing.iter().position(|(_, moment)| matches!(moment, Moment::Pattern(0, _)));
    let timing = &timing[dark.context(NO_SCAN)?..];
    let begin = timing.first().map_or(0, |(at, _)| *at);
    let events = timing.iter().take(EVENTS).map(|(at, moment)| (at - begin, *moment)).collect();
    let (first, costs) = counters(&mut session)?;
    let streamed = written(&mut session).unwrap_or_default();
    let alarms = session.board.chip().common().alarms();
    let converters = match model {
        Model::G431 | Model::G473 => 2,
        Model::F411 => 1,
    };
    let frames = std::mem::take(&mut session.frames).into_iter().map(|(_, frame)| frame).collect();
    for adc in 0..converters {
        session.board.chip().withhold(adc);
        session.run(MISSED)?;
    }
    let (second, _) = counters(&mut session)?;
    let watchdog = session.board.chip().common().watchdog();

    let now = session.board.now();
    session.board.host().suspend(true, now);
    session.run(SUSPENDED)?;
    session.board.finger().timing = Some(Vec::new());
    session.run(SUSPENDED)?;
    let events_in_suspend = session.board.finger().timing.take().map_or(0, |timing| timing.len());
    let rows = session.board.finger().rows();
    session.frames.clear();
    let now = session.board.now();
    session.board.host().suspend(false, now);
    session.run(SUSPENDED)?;
    let observed = Observed {
        descriptors: session.board.host().descriptors.clone(),
        events,
        seen: session.board.finger().seen.iter().map(|seen| seen.codes).collect(),
        frames,
        counters: [first, second],
        load: (time - slept) as f64 / time as f64,
        watchdog,
        dark: (rows, events_in_suspend, session.frames.is_empty()),
        alarms,
        taken: session.board.chip().common().system.taken().collect(),
        costs,
    };
    Ok((observed, [opened, streamed]))
}

fn counters(session: &mut Session) -> Result<([u32; 3], bool)> {
    match session.ask(Command::Info)? {
        Response::Info(Info { counters, cost, .. }) => {
            Ok(([counters.lost, counters.overruns, counters.bad_packets], cost.worst > 0))
        }
        other => anyhow::bail!("Info is answered with {other:?}"),
    }
}
