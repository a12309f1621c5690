//! Measurements on the simulated column: settle time, afterglow, noise, supply.

use anyhow::{Context, Result, anyhow};
use scan_plan::finger::{CURRENT_GAIN, REFERENCE};
use scan_plan::g431::plan;
use taxel::scan::ScanSettings;

use super::deck::{Circuit, Detector, Front, Light, Timing, add, ideal_supply, models};
use super::spice::{Noise, noise, transient};

/// Steps of a converter's range.
pub const STEPS: f64 = (1u32 << REFERENCE.converter.bits) as f64;

/// Half a step of the converter in volts.
pub const HALF_STEP_V: f64 = REFERENCE.converter.range_v / STEPS / 2.0;

/// Settings of the default scan.
pub const DEFAULT: ScanSettings = REFERENCE.converter.settings();

/// Times of a scan on the STM32G431.
pub fn timing(settings: ScanSettings) -> Result<Timing> {
    let step = plan(settings).map_err(|refusal| anyhow!("{settings:?}: {refusal:?}"))?.step;
    let seconds = |ticks: u32| f64::from(ticks) / f64::from(step.tick_hz);
    let conversions = 4.0 * f64::from(settings.oversampling);
    Ok(Timing {
        step: seconds(step.top + 1),
        sample: seconds(step.columns - step.light),
        conversion: seconds(step.done - step.columns) / conversions,
    })
}

/// Properties of a circuit; shares are of the signal of a pair at rest.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// Share of the converter's range that a pair at rest makes.
    pub rest: f64,
    /// Time in seconds until a lit row's reading stays within half a step of its end.
    ///
    /// The pair was dark since its step of the scan before. Never later than the step's end.
    pub settles_s: f64,
    /// Largest distance in steps from the end to the reading at the first sample.
    pub unsettled: f64,
    /// Share that a row leaves in the first sample of the step after it.
    pub afterglow: f64,
    /// Share of a change of a row's light that the step after it shows.
    pub follows: f64,
    /// Share in the dark step while all four rows are lit in turn.
    pub dark: f64,
    /// Share of the room's light that is left where the dark step is subtracted, in the worst row.
    pub ambient: f64,
    /// Noise of one conversion of a pair at rest.
    pub noise: Noise,
}

/// Change of light with which [`Measured::follows`] is measured.
const CHANGE: f64 = 0.1;
/// Light of the room on a pair, as a share of a pair's light at rest.
const ROOM: f64 = 0.01;

/// Measures a circuit in a scan.
pub fn measure(circuit: &Circuit, timing: Timing) -> Result<Measured> {
    let Timing { step, sample, .. } = timing;
    let lit = Light::Scanned(1.0);
    let mut deck = models(circuit.name) + &ideal_supply();
    let alone = [lit, Light::Off, Light::Off, Light::Off];
    let brighter = [lit, lit, lit, Light::Scanned(1.0 + CHANGE)];
    let steady = [Light::Steady(1.0), Light::Off, Light::Off, Light::Off];
    circuit.column(&mut deck, "a", alone, 0.0, timing);
    circuit.column(&mut deck, "b", [lit; 4], 0.0, timing);
    circuit.column(&mut deck, "c", brighter, 0.0, timing);
    circuit.column(&mut deck, "d", [lit; 4], ROOM, timing);
    circuit.column(&mut deck, "e", steady, 0.0, timing);
    let [alone, all, brighter, room, steady] = [0, 1, 2, 3, 4];
    // The third frame repeats the second to less than a thousandth of a step.
    let frames = 3.0;
    let begin = |index: usize| ((frames - 1.0) * 5.0 + index as f64) * step;
    let nodes = ["adca", "adcb", "adcc", "adcd", "adce"];
    let length = frames * 5.0 * step;
    let waves = transient(&deck, step / 400.0, length, &nodes)?;
    let level = waves.at(steady, begin(2) - 100e-9);
    // At the start every pair has been dark long.
    let darkness = waves.at(alone, 0.0);
    let signal = level - darkness;
    let read = |node: usize, index: usize| waves.at(node, begin(index) + sample);
    // The amplifier holds the last step's level until its end.
    let span = (begin(1), begin(2));
    // A fixed light on every pair is all that `d` has more than `b`.
    let all_room = 4.0 * ROOM * signal;
    let left = |row: usize| {
        let of = |node: usize| read(node, row + 1) - read(node, 0);
        ((of(room) - of(all)) / all_room).abs()
    };
    Ok(Measured {
        rest: signal / REFERENCE.converter.range_v,
        settles_s: waves.settles(alone, span, level, HALF_STEP_V),
        unsettled: (read(alone, 1) - level).abs() / (2.0 * HALF_STEP_V),
        afterglow: (read(alone, 2) - darkness) / signal,
        follows: (read(brighter, 0) - read(all, 0)) / (CHANGE * signal),
        dark: (read(all, 0) - darkness) / signal,
        ambient: (0..4).map(left).fold(0.0, f64::max),
        noise: at_rest(circuit, timing)?,
    })
}

/// Noise of one conversion of a pair at rest.
fn at_rest(circuit: &Circuit, timing: Timing) -> Result<Noise> {
    let mut deck = models(circuit.name) + &ideal_supply();
    let lights = [Light::Steady(1.0), Light::Off, Light::Off, Light::Off];
    circuit.column(&mut deck, "a", lights, 0.0, timing);
    circuit.photon_noise(&mut deck, "a");
    noise(&deck, "adca")
}

/// Response to a small change of a light at rest.
#[derive(Clone, Copy, Debug)]
pub struct SmallChange {
    /// Time in seconds to 1 − 1/e of the change.
    pub rise_s: f64,
    /// Time in seconds until the output stays within a step of the converter over its range.
    pub settles_s: f64,
}

/// Measures the response of a circuit to one hundredth more light.
pub fn small_change(circuit: &Circuit) -> Result<SmallChange> {
    let timing = timing(DEFAULT)?;
    let (at, length) = (20e-6, 200e-6);
    let mut deck = models(circuit.name) + &ideal_supply();
    let light = Light::Step(1.0, 1.01, at);
    circuit.column(&mut deck, "a", [light, Light::Off, Light::Off, Light::Off], 0.0, timing);
    let waves = transient(&deck, 50e-9, length, &["adca"])?;
    let (low, high) = (waves.at(0, at), waves.at(0, length));
    let rose = low + (high - low) * (1.0 - (-1.0f64).exp());
    let crossed = waves.time.iter().zip(&waves.nodes[0]).find(|(t, v)| **t > at && **v >= rose);
    let (time, _) = crossed.context("no rise")?;
    let settles_s = waves.settles(0, (at, length), high, (high - low) / STEPS);
    Ok(SmallChange { rise_s: time - at, settles_s })
}

/// Rise and fall times (10–90 %) of the phototransistor's model in its data sheet's circuit.
pub fn data_sheet() -> Result<[f64; 2]> {
    let mut deck = models("SFH3010 on 1 kΩ at 5 V, 1 mA");
    let base = 1e-3 / CURRENT_GAIN;
    add(&mut deck, format_args!("Vcc vcc 0 5\nRl vcc out 1k\nQ1 out b 0 pair\nId out b 0.1p"));
    add(&mut deck, format_args!("Il out b PULSE(0 {base:e} 10u 10n 10n 60u 1)"));
    let waves = transient(&deck, 20e-9, 200e-6, &["out"])?;
    let crossing = |level: f64, from: f64, falls: bool| -> Result<f64> {
        let points = waves.time.iter().zip(&waves.nodes[0]);
        let found = points.filter(|(t, _)| **t > from).find(|(_, v)| (**v < level) == falls);
        Ok(*found.context("no crossing")?.0)
    };
    // The collector falls by 1 V under the light.
    let rise = crossing(4.1, 10e-6, true)? - crossing(4.9, 10e-6, true)?;
    let fall = crossing(4.9, 70e-6, false)? - crossing(4.1, 70e-6, false)?;
    Ok([rise, fall])
}

/// Effect of the LEDs' current on the supply and through it on a reading.
#[derive(Clone, Copy, Debug)]
pub struct SupplyStep {
    /// Largest fall of VDDA in a scan, in volts.
    pub falls_v: f64,
    /// Largest change of VDDA from a step's first sample to its end, in volts.
    pub moves_v: f64,
    /// Largest change of a lit reading, in steps, against a supply that nothing disturbs.
    pub lit_steps: f64,
    /// Change of the dark reading, in steps.
    pub dark_steps: f64,
    /// Largest change of a reading's change with light, as a share.
    pub gain: f64,
}

/// Measures a scan with the regulator, the ferrite bead and the capacitors of the board.
pub fn supply_step(timing: Timing) -> Result<SupplyStep> {
    let circuit = Circuit { name: "supply step", ..Circuit::reference() };
    let supply = REFERENCE.supply;
    let range = REFERENCE.converter.range_v;
    let pair = REFERENCE.pair;
    let Timing { step, sample, .. } = timing;
    let leds = |v: &str| format!("4*(v({v})-{:e})/{:e}", pair.led_v, pair.led_ohm);
    let mut deck = models(circuit.name);
    // Loop of the regulator: a resistance, and above its bandwidth an inductance.
    let regulator_h = supply.regulator_ohm / (std::f64::consts::TAU * supply.regulator_hz);
    add(&mut deck, format_args!("Vreg reg 0 {range}\nRreg reg loop {:e}", supply.regulator_ohm));
    add(
        &mut deck,
        format_args!(
            "Lreg loop vcc {regulator_h:e}\nCvcc vcc esr {:e}\nResr esr 0 10m",
            supply.before_f
        ),
    );
    add(
        &mut deck,
        format_args!("Rbead vcc bead {:e}\nLbead bead vdd {:e}", supply.bead_ohm, supply.bead_h),
    );
    add(
        &mut deck,
        format_args!(
            "Rloss bead vdd {:e}\nCvdd vdd esa {:e}\nResa esa 0 10m",
            supply.bead_loss_ohm, supply.behind_f
        ),
    );
    // Divider of the columns' reference with its 100 nF.
    let [high, low] = REFERENCE.column.divider_ohm;
    add(&mut deck, format_args!("Rhigh vdd ref {high:e}\nRlow ref 0 {low:e}\nCref ref 0 100n"));
    // A scan turns one row after another on; the light follows the LEDs' current.
    add(
        &mut deck,
        format_args!(
            "Von on 0 PULSE(0 1 {step:e} 20n 20n {:e} {:e})",
            4.0 * step - 20e-9,
            5.0 * step
        ),
    );
    add(&mut deck, format_args!("Bled vdd 0 I = v(on)*{}", leds("vdd")));
    // One pair on the amplifier, lit with row 0; its light follows the current of its LED.
    let rest_led = (range - pair.led_v) / pair.led_ohm;
    let base = circuit.rest_a / CURRENT_GAIN;
    circuit.column(&mut deck, "a", [Light::Off; 4], 0.0, timing);
    add(
        &mut deck,
        format_args!("Vrow row 0 PULSE(0 1 {step:e} 20n 20n {:e} {:e})", step - 20e-9, 5.0 * step),
    );
    add(
        &mut deck,
        format_args!(
            "Bla ina ba0 I = v(row)*{base:e}*(v(vdd)-{:e})/{:e}",
            pair.led_v,
            rest_led * pair.led_ohm
        ),
    );
    let frames = 4.0;
    let length = frames * 5.0 * step;
    let waves = transient(&deck, step / 400.0, length, &["adca", "vdd"])?;
    let mut quiet = models(circuit.name) + &ideal_supply();
    circuit.column(
        &mut quiet,
        "a",
        [Light::Scanned(1.0), Light::Off, Light::Off, Light::Off],
        0.0,
        timing,
    );
    let ideal = transient(&quiet, step / 400.0, length, &["adca"])?;
    let begin = |index: usize| ((frames - 1.0) * 5.0 + index as f64) * step;
    let at = |index: usize| begin(index) + sample;
    let code = |index: usize| waves.at(0, at(index)) / waves.at(1, at(index)) * STEPS;
    let quiet = |index: usize| ideal.at(0, at(index)) / range * STEPS;
    let points = waves.time.iter().zip(&waves.nodes[1]).filter(|(t, _)| **t > begin(0));
    let lowest = points.map(|(_, v)| *v).fold(range, f64::min);
    let moved =
        |index: usize| (waves.at(1, at(index)) - waves.at(1, begin(index + 1) - 1e-7)).abs();
    let change = |code: &dyn Fn(usize) -> f64| code(1) - code(0);
    Ok(SupplyStep {
        falls_v: range - lowest,
        moves_v: (0..5).map(moved).fold(0.0, f64::max),
        lit_steps: (code(1) - quiet(1)).abs(),
        dark_steps: (code(0) - quiet(0)).abs(),
        gain: change(&code) / change(&quiet) - 1.0,
    })
}

/// Candidates for the columns, the reference finger's circuit first.
#[must_use]
pub fn candidates() -> Vec<Circuit> {
    let reference = Circuit::reference();
    let scaled = |name, ohm, front| Circuit { name, ohm, front, ..reference };
    // 470 Ω give an LED 4.36 mA, at most 4.8 mA; its light is assumed to follow the current.
    let brighter = REFERENCE.pair.led_ohm / 470.0;
    // The VEMD4110X01 gives 2.4 µA of 1 mW/cm², the pairs' phototransistors 100 µA.
    let diode = reference.rest_a * 2.4 / 100.0;
    let photodiode = Detector::Photodiode(5_000);
    let ohms = |amperes: f64| reference.ohm * reference.rest_a / amperes;
    vec![
        reference,
        scaled("680 Ω load", 680.0, Front::Load(1.0)),
        scaled("15 kΩ load", reference.ohm, Front::Load(1.0)),
        scaled("1 kΩ load, chip's amplifier ×16", 1_000.0, Front::Load(16.0)),
        Circuit { name: "TIA, emitters on the rows", detector: Detector::Switched, ..reference },
        Circuit {
            name: "TIA, LED at 4.4 mA",
            ohm: ohms(brighter * reference.rest_a),
            rest_a: brighter * reference.rest_a,
            ..reference
        },
        Circuit {
            name: "TIA, photodiodes VEMD4110X01",
            detector: photodiode,
            front: Front::Amplifier(1e-12),
            ohm: ohms(diode),
            rest_a: diode,
        },
        Circuit {
            name: "TIA, photodiodes, LED at 4.4 mA",
            detector: photodiode,
            front: Front::Amplifier(2e-12),
            ohm: ohms(brighter * diode),
            rest_a: brighter * diode,
        },
    ]
}
