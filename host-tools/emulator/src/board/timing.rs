//! Events on the pins as CSV, and as a value change dump (IEEE 1364) for waveform viewers.

use std::fmt::Write as _;
use std::io;

use vcd::{IdCode, SimulationCommand, TimescaleUnit, Value, VarType, Writer};

use super::finger::{Moment, Source, Wiring};
use super::time::{HZ, Tick};

/// Events as CSV, one a line: nanoseconds since the first, event, rows, sensor, input.
pub fn csv(timing: &[(Tick, Moment)]) -> String {
    let begin = timing.first().map_or(0, |(at, _)| *at);
    let mut text = "t_ns,event,rows,sensor,input\n".to_owned();
    for (at, moment) in timing {
        let ns = (at - begin) as f64 * 1e9 / HZ as f64;
        let line = match moment {
            Moment::Pattern(rows, sensor) => format!("pattern,{rows:04b},{sensor},"),
            Moment::Sample(source) => format!("sample,,,{}", input(*source)),
            Moment::Trigger(adc) => format!("trigger,,,ADC{}", adc + 1),
            Moment::Result(adc) => format!("result,,,ADC{}", adc + 1),
            Moment::Turn(which, input) => {
                format!("turn,,{},OPAMP{}", ["first", "second"][input % 2], which + 2)
            }
        };
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{ns:.1},{line}");
    }
    text
}

fn input(source: Source) -> String {
    match source {
        Source::Pin(pin) => pin.to_owned(),
        Source::Amplifier(which) => format!("OPAMP{}", which + 2),
        Source::Temperature => "temperature".to_owned(),
        Source::Reference => "reference".to_owned(),
    }
}

/// Time in picoseconds; a tick is 122.5 ps.
fn picoseconds(at: Tick) -> u64 {
    (u128::from(at) * 1_000_000_000_000 / u128::from(HZ)) as u64
}

/// Events as a value change dump.
///
/// Signals are the rows' pins, the multiplexer's address, the amplifiers' inputs, and events of the
/// converters.
///
/// # Errors
/// A failure to write.
pub fn vcd(timing: &[(Tick, Moment)], wiring: &Wiring, to: impl io::Write) -> io::Result<()> {
    let mut file = Writer::new(to);
    file.timescale(1, TimescaleUnit::PS)?;
    file.add_module(wiring.board)?;
    let mut wire = |name: &str| file.add_wire(1, name);
    let rows = [wire("row_0")?, wire("row_1")?, wire("row_2")?, wire("row_3")?];
    let seconds = [wire("opamp2_second_input")?, wire("opamp3_second_input")?];
    let sensor = file.add_wire(2, "sensor")?;
    let mut event = |name: &str| file.add_var(VarType::Event, 1, name, None);
    let events = [
        [event("adc1_trigger")?, event("adc1_sample")?, event("adc1_result")?],
        [event("adc2_trigger")?, event("adc2_sample")?, event("adc2_result")?],
    ];
    file.upscope()?;
    file.enddefinitions()?;

    file.begin(SimulationCommand::Dumpvars)?;
    for id in rows.iter().chain(&seconds) {
        file.change_scalar(*id, Value::X)?;
    }
    file.change_vector(sensor, [Value::X; 2])?;
    file.end()?;
    let begin = timing.first().map_or(0, |(at, _)| *at);
    for (at, moment) in timing {
        file.timestamp(picoseconds(at - begin))?;
        let mut happens = |id: IdCode| file.change_scalar(id, Value::V1);
        match *moment {
            Moment::Trigger(adc) => happens(events[adc][0])?,
            Moment::Result(adc) => happens(events[adc][2])?,
            Moment::Sample(source) => happens(events[converter(source, wiring)][1])?,
            Moment::Turn(which, input) => {
                file.change_scalar(seconds[which], Value::from(input == 1))?
            }
            Moment::Pattern(lit, connected) => {
                for (row, id) in rows.iter().enumerate() {
                    file.change_scalar(*id, Value::from(lit >> row & 1 == 1))?;
                }
                let bit = |place: usize| Value::from(connected >> place & 1 == 1);
                file.change_vector(sensor, [bit(1), bit(0)])?;
            }
        }
    }
    Ok(())
}

/// Converter that samples `source`: amplifiers and their bias are on ADC2.
fn converter(source: Source, wiring: &Wiring) -> usize {
    let bias = matches!(source, Source::Pin(pin) if wiring.bias == Some(pin));
    usize::from(bias || matches!(source, Source::Amplifier(_)))
}
