//! Runs the bench image, counts every stage on every input, and compares results with this host.
//!
//! The flash is that of the STM32G431 at 170 MHz. Its caches are empty at the begin of each call,
//! because the rest of a firmware overwrites them from one scan to the next.
//!
//! Each result must equal that of the same code on this host, bit for bit.

use anyhow::{Context, Result, bail, ensure};
use cycles::host::{COMPARE, INPUTS, Inputs, MEASURE, REPORT};
use cycles::{MAX_RESULT, Meter, result_bytes};
use serde::Serialize;

use crate::clock::{Clock, Count};
use crate::fetch::Settings;
use crate::machine::{HostCall, Machine};

/// Most instructions between two host calls, far above any stage and its preparation.
const INSTRUCTION_LIMIT: u64 = 1 << 28;

/// Operations of the semihosting specification.
const SYS_OPEN: u32 = 0x01;
const SYS_WRITE: u32 = 0x05;
const SYS_EXIT: u32 = 0x18;
/// Parameter of `SYS_EXIT` when a program ends without error.
const APPLICATION_EXIT: u32 = 0x2_0026;

/// Counts of one stage on all of its inputs.
#[derive(Clone, Debug)]
pub struct Stage {
    /// Name of the stage.
    pub name: String,
    /// Count of each call.
    pub calls: Vec<Count>,
}

impl Stage {
    /// Largest count of a call, each figure on its own.
    pub fn worst(&self) -> Count {
        self.calls.iter().fold(Count::default(), |mut worst, call| {
            worst.instructions = worst.instructions.max(call.instructions);
            worst.cycles.low = worst.cycles.low.max(call.cycles.low);
            worst.cycles.high = worst.cycles.high.max(call.cycles.high);
            worst.bounds.low = worst.bounds.low.max(call.bounds.low);
            worst.bounds.high = worst.bounds.high.max(call.bounds.high);
            worst
        })
    }

    /// Most cycles of a call with waits for the flash.
    pub fn worst_time(&self) -> u64 {
        self.calls.iter().map(Count::time).max().unwrap_or(0)
    }

    /// Mean instructions, mean cycles (low and high), and mean cycles with waits for the flash.
    pub fn mean(&self) -> [f64; 4] {
        let mean = |figure: fn(&Count) -> u64| {
            self.calls.iter().map(figure).sum::<u64>() as f64 / self.calls.len().max(1) as f64
        };
        [
            mean(|call| call.instructions),
            mean(|call| call.cycles.low),
            mean(|call| call.cycles.high),
            mean(Count::time),
        ]
    }
}

/// Results of the stages on this host.
#[derive(Default)]
struct Here {
    results: Vec<(String, Vec<u8>)>,
}

impl Meter for Here {
    fn stage<M, I, O: Serialize>(
        &mut self,
        name: &str,
        memory: &mut M,
        inputs: impl Iterator<Item = I>,
        out: &mut O,
        stage: fn(&mut M, &I, &mut O),
    ) {
        for input in inputs {
            stage(memory, &input, out);
            let mut buffer = [0; MAX_RESULT];
            let result = result_bytes(out, &mut buffer).unwrap_or_default();
            self.results.push((name.to_owned(), result.to_owned()));
        }
    }
}

/// Checks that the result of a call equals the one on this host.
fn agree(
    expected: &mut impl Iterator<Item = (String, Vec<u8>)>,
    name: &str,
    result: &[u8],
) -> Result<()> {
    let Some((here, wanted)) = expected.next() else {
        bail!("{name}: the image makes more calls than this host");
    };
    ensure!(here == name, "the image calls {name} where this host calls {here}");
    ensure!(result == wanted, "{name}: the Cortex-M4 gives {result:02x?}, this host {wanted:02x?}");
    Ok(())
}

/// Runs the image in `elf` and calls `watch` after each stage with the blocks that ran.
pub fn run(
    elf: &[u8],
    inputs: &Inputs<'_>,
    mut watch: impl FnMut(&Stage, &Clock),
) -> Result<Vec<Stage>> {
    let mut here = Here::default();
    cycles::all(inputs, &mut here);
    ensure!(!here.results.is_empty(), "the core rejects the calibration record");
    let mut expected = here.results.into_iter();

    let mut machine = Machine::new(elf)?;
    machine.clock().fetch().set(Settings::G431);
    let bytes = postcard::to_stdvec(inputs).context("writing the inputs")?;
    let length = u32::try_from(bytes.len()).context("too many inputs")?;
    machine.write(INPUTS as u32, &[&length.to_le_bytes()[..], &bytes].concat())?;

    let mut stages = Vec::<Stage>::new();
    let mut said = String::new();
    while let Some(event) = next(&mut machine, &mut said)? {
        match event {
            Event::Call { name, function } => {
                if stages.last().is_none_or(|stage| stage.name != name) {
                    if let Some(done) = stages.last() {
                        watch(done, machine.clock());
                    }
                    machine.clock().forget_visits();
                    stages.push(Stage { name, calls: Vec::new() });
                }
                machine.clock().await_call(function);
            }
            Event::Result(result) => {
                let Some(stage) = stages.last_mut() else { bail!("a result without a call") };
                let name = &stage.name;
                let count = machine
                    .clock()
                    .take_measured()
                    .with_context(|| format!("{name}: the call did not return"))?;
                agree(&mut expected, name, &result)?;
                stage.calls.push(count);
            }
            Event::Compared { name, result } => agree(&mut expected, &name, &result)?,
        }
    }
    if let Some(done) = stages.last() {
        watch(done, machine.clock());
    }
    ensure!(expected.next().is_none(), "the image makes fewer calls than this host");
    Ok(stages)
}

/// Message of an image to its machine.
pub enum Event {
    /// Announcement of a call to measure.
    Call {
        /// Name in the table.
        name: String,
        /// Address of the function.
        function: u32,
    },
    /// End of the measured call, with its result.
    Result(Vec<u8>),
    /// Result of a call that is not measured.
    Compared {
        /// Name in the error message.
        name: String,
        /// Result in postcard.
        result: Vec<u8>,
    },
}

/// Runs to the next event; `None` at a normal end. `said` collects the printed text.
pub fn next(machine: &mut Machine, said: &mut String) -> Result<Option<Event>> {
    loop {
        let HostCall { operation, parameter } = machine.run(INSTRUCTION_LIMIT)?;
        match operation {
            operation if operation == MEASURE as u32 => {
                let call = Words::<3>::read(machine, parameter)?;
                let name = String::from_utf8_lossy(&call.span(machine, 1)?).into_owned();
                return Ok(Some(Event::Call { name, function: call.0[0] }));
            }
            operation if operation == REPORT as u32 => {
                let result = Words::<2>::read(machine, parameter)?.span(machine, 0)?;
                return Ok(Some(Event::Result(result)));
            }
            operation if operation == COMPARE as u32 => {
                let compared = Words::<4>::read(machine, parameter)?;
                let name = String::from_utf8_lossy(&compared.span(machine, 0)?).into_owned();
                let result = compared.span(machine, 2)?;
                return Ok(Some(Event::Compared { name, result }));
            }
            SYS_OPEN => machine.answer(1)?,
            SYS_WRITE => {
                let write = Words::<3>::read(machine, parameter)?;
                *said += &String::from_utf8_lossy(&write.span(machine, 1)?);
                machine.answer(0)?;
            }
            SYS_EXIT if parameter == APPLICATION_EXIT => return Ok(None),
            SYS_EXIT => bail!("the image ended with {parameter:#x}: {}", said.trim()),
            other => {
                bail!("the image makes the host call {other:#x}, which the machine does not know")
            }
        }
    }
}

/// Parameter block of a host call.
struct Words<const N: usize>([u32; N]);

impl<const N: usize> Words<N> {
    fn read(machine: &Machine, address: u32) -> Result<Self> {
        let mut words = [0; N];
        for (word, at) in words.iter_mut().zip((address..).step_by(4)) {
            *word = machine.word(at)?;
        }
        Ok(Self(words))
    }

    /// Bytes at the address in word `i`; the next word is their length.
    fn span(&self, machine: &Machine, i: usize) -> Result<Vec<u8>> {
        match self.0.get(i..i + 2) {
            Some([address, length]) => machine.read(*address, *length),
            _ => Ok(Vec::new()),
        }
    }
}
