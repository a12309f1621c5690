//! Tables and chart of docs/front-end.md: the reference circuit, and candidates beside it.

use anyhow::Result;
use scan_plan::finger::{REFERENCE, shot_noise};
use scan_plan::g431::plan;
use scan_plan::settle;
use taxel::scan::{ScanSetting, ScanSettings};
use taxel::wire::message::Refusal;

use super::chart::{Axis, Chart, Series};
use super::deck::Circuit;
use super::measure::{self, DEFAULT, Measured, STEPS};
use super::page::Part;

/// Settings of the fast scan on the board's page.
pub const FAST: ScanSettings =
    ScanSettings { scan_hz: 8_000, oversampling: 2, settle_ns: settle::ON_LOAD_NS };

/// Candidate with its measurements in the default scan.
type Candidate = (Circuit, Measured);

/// Measures all candidates, each on a thread of its own.
pub fn candidates() -> Result<Vec<Candidate>> {
    let timing = measure::timing(DEFAULT)?;
    std::thread::scope(|scope| {
        let all = measure::candidates().into_iter();
        let runs: Vec<_> =
            all.map(|one| (one, scope.spawn(move || measure::measure(&one, timing)))).collect();
        let join = |(one, run): (Circuit, std::thread::ScopedJoinHandle<'_, Result<Measured>>)| {
            run.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)).map(|m| (one, m))
        };
        runs.into_iter().map(join).collect()
    })
}

/// Noise in volts of one conversion by the simulator's formula: shot noise in the band 1/4τ.
#[must_use]
pub fn formula_noise_v() -> f64 {
    let pair = REFERENCE.pair;
    let shot = shot_noise(pair.rest_a()) / (4.0 * REFERENCE.time_constant_s());
    REFERENCE.column.feedback_ohm * shot.sqrt()
}

/// Table of the reference circuit.
pub fn reference() -> Result<Part> {
    let circuit = Circuit::reference();
    let now = measure::measure(&circuit, measure::timing(DEFAULT)?)?;
    let fast = measure::measure(&circuit, measure::timing(FAST)?)?;
    let small = measure::small_change(&circuit)?;
    let [rise, fall] = measure::data_sheet()?;
    let supply = measure::supply_step(measure::timing(DEFAULT)?)?;
    let tau = REFERENCE.time_constant_s();
    let us = |seconds: f64| format!("{:.2} µs", 1e6 * seconds);
    let percent = |share: f64| format!("{:.2} %", 100.0 * share);
    let row =
        |what: &str, formula: &str, circuit: String| format!("| {what} | {formula} | {circuit} |");
    let none = "–";
    let sample = format!("at {:.2} µs", f64::from(settle::ON_LOAD_NS) / 1e3);
    let lines = [
        "| reference circuit | sheet or formula | simulated circuit |".to_owned(),
        "|---|---|---|".to_owned(),
        row(
            "SFH3010 in its data sheet's circuit: rise, fall (10–90 %)",
            "7 µs, 7 µs",
            format!("{}, {}", us(rise), us(fall)),
        ),
        row("a small change of light: 63 %", &us(tau), us(small.rise_s)),
        row(
            "a small change of light: within 1/4096 of itself",
            &us(1e-9 * f64::from(REFERENCE.settles_ns())),
            us(small.settles_s),
        ),
        row("a row lit in the scan: within half a step of 12 bits", none, us(now.settles_s)),
        row(
            &format!("the same reading {sample}, 8 kHz: steps away"),
            none,
            format!("{:.1}", fast.unsettled),
        ),
        row(
            "left in the next row's first sample, of a pair's signal",
            none,
            percent(now.afterglow),
        ),
        row("the same, of a change of the signal", none, percent(now.follows)),
        row("the same at 8 kHz", none, percent(fast.follows)),
        row("in the dark step, of a pair's signal", none, percent(now.dark)),
        row("room light left after the dark step is subtracted", "0 %", percent(now.ambient)),
        row(
            "noise density at rest, µV/√Hz",
            &format!("{:.2}", 1e6 * circuit.ohm * shot_noise(circuit.rest_a).sqrt()),
            format!("{:.2}", 1e6 * now.noise.density),
        ),
        row(
            "noise of one conversion at rest, steps",
            &format!("{:.2}", formula_noise_v() / (2.0 * measure::HALF_STEP_V)),
            format!("{:.2}", now.noise.total / (2.0 * measure::HALF_STEP_V)),
        ),
        row("VDDA falls under a row of LEDs", none, format!("{:.1} mV", 1e3 * supply.falls_v)),
        row(
            "VDDA moves after a step's first sample",
            none,
            format!("{:.2} mV", 1e3 * supply.moves_v),
        ),
        row(
            "gain against an undisturbed supply",
            none,
            format!("{:.2} % less", -100.0 * supply.gain),
        ),
        row(
            "readings against an undisturbed supply: lit, dark, steps",
            none,
            format!("{:.1}, {:.1}", supply.lit_steps, supply.dark_steps),
        ),
    ];
    Ok(Part { name: "reference", lines: lines.to_vec() })
}

/// Table of the candidates.
#[must_use]
pub fn table(candidates: &[Candidate]) -> Part {
    let mut lines = vec![
        "| circuit | resistor | lit row settles | left in the next row | of a change | in the dark step | room light left | noise of a conversion | resolution at 4 kHz | fastest scan |".to_owned(),
        "|---|---|---|---|---|---|---|---|---|---|".to_owned(),
    ];
    for (circuit, measured) in candidates {
        let percent = |share: f64| format!("{:.2} %", 100.0 * share);
        let never = measured.unsettled > 0.5;
        let settles =
            if never { "no".to_owned() } else { format!("{:.1} µs", 1e6 * measured.settles_s) };
        let at_4_khz = resolution(measured, DEFAULT.scan_hz);
        let fastest =
            (1..=15).rev().map(|khz| khz * 1_000).find(|hz| resolution(measured, *hz).is_some());
        lines.push(format!(
            "| {} | {} | {settles} | {} | {} | {} | {} | {:.2} steps | {} | {} |",
            circuit.name,
            ohms(circuit.ohm),
            percent(measured.afterglow),
            percent(measured.follows.abs()),
            percent(measured.dark.abs()),
            percent(measured.ambient),
            measured.noise.total / (2.0 * measure::HALF_STEP_V),
            at_4_khz.map_or("–".to_owned(), |nm| format!("{nm:.0} nm")),
            fastest.map_or("–".to_owned(), |hz| format!("{} kHz", hz / 1_000)),
        ));
    }
    Part { name: "candidates", lines }
}

/// Number of ohms as the pages write it.
#[must_use]
pub fn ohms(ohm: f64) -> String {
    let kilo = ohm / 1_000.0;
    match ohm {
        ..1_000.0 => format!("{ohm:.0} Ω"),
        ..10_000.0 => format!("{} kΩ", (10.0 * kilo).round() / 10.0),
        _ => format!("{kilo:.0} kΩ"),
    }
}

/// Shortest settle time of the STM32G431 in nanoseconds.
///
/// Its converters read temperature, reference and bridges within the settle time.
fn least_settle_ns() -> u32 {
    let settings = ScanSettings { settle_ns: 0, ..DEFAULT };
    match plan(settings) {
        Err(Refusal::Scan { setting: ScanSetting::SettleNs, low, .. }) => low,
        _ => 0,
    }
}

/// Standard deviation in nanometres of a facet's place at rest, in one frame of a scan of `hz`.
///
/// The reading waits until the circuit has settled and then takes as many samples as fit; `None`
/// where not even one does.
#[must_use]
pub fn resolution(measured: &Measured, hz: u16) -> Option<f64> {
    if measured.unsettled > 0.5 {
        return None;
    }
    let settle_ns = ((1e9 * measured.settles_s).ceil() as u32).max(least_settle_ns());
    let settings = |oversampling| ScanSettings { scan_hz: hz, oversampling, settle_ns };
    let fits = [16, 8, 4, 2, 1].into_iter().find(|samples| plan(settings(*samples)).is_ok())?;
    let timing = measure::timing(settings(fits)).ok()?;
    let noise = measured.noise;
    let left = averaged(fits, timing.conversion / noise.correlation());
    let converter = REFERENCE.converter;
    let light = (noise.total / converter.range_v).powi(2) * left;
    let steps = (converter.noise_steps.powi(2) + 1.0 / 12.0) / STEPS.powi(2) / f64::from(fits);
    // Slope of the light curve at rest, as a share of the signal for each nanometre.
    let pair = REFERENCE.pair;
    let [near, far] = [-1e-6, 1e-6].map(|mm| pair.photocurrent_a(pair.gap_mm + mm));
    let slope = (near - far) / 2.0 / pair.rest_a();
    Some((light + steps).sqrt() / (measured.rest * slope))
}

/// Share of the variance that remains in a mean of samples with correlation e^−|i − j|·apart.
fn averaged(samples: u16, apart: f64) -> f64 {
    let n = f64::from(samples);
    let lags = (1..samples).map(f64::from);
    let sum: f64 = lags.map(|lag| (n - lag) * (-lag * apart).exp()).sum();
    (n + 2.0 * sum) / (n * n)
}

/// Chart of resolution against scan rate.
#[must_use]
pub fn chart(candidates: &[Candidate]) -> String {
    let series = candidates.iter().filter_map(|(circuit, measured)| {
        let rates = (4..=60).map(|quarter| quarter * 250);
        let points: Vec<_> =
            rates.filter_map(|hz| Some((f64::from(hz) / 1e3, resolution(measured, hz)?))).collect();
        (!points.is_empty()).then_some(Series { name: circuit.name, points })
    });
    Chart {
        title: "Resolution of a facet's place at rest in one frame, calculated and simulated",
        x: Axis { name: "scans a second, kHz", ticks: &[1.0, 2.0, 4.0, 8.0, 15.0] },
        y: Axis {
            name: "standard deviation, nm",
            ticks: &[100.0, 200.0, 500.0, 1_000.0, 2_000.0, 5_000.0, 10_000.0, 20_000.0],
        },
        series: series.collect(),
    }
    .svg()
}

#[cfg(test)]
mod tests {
    use super::*;
    use scan_plan::finger::{CURRENT_GAIN, THERMAL_V, UNBIASED_F};

    /// Whether two numbers differ by at most this share.
    fn near(a: f64, b: f64, share: f64) -> bool {
        (a / b - 1.0).abs() <= share
    }

    #[test]
    fn phototransistor_model_meets_its_data_sheet() {
        let [rise, fall] = measure::data_sheet().unwrap();
        assert!(near(rise, 7e-6, 0.01), "{rise}");
        // The sheet gives the same typical 7 µs for both; no such model falls as fast as it rises.
        assert!(near(fall, 7e-6, 0.25), "{fall}");
        let [collector, emitter] = UNBIASED_F;
        assert!(near(1.0 / (1.0 / collector + 1.0 / emitter), 1.3e-12, 0.01));
    }

    #[test]
    fn lit_row_settles_within_the_default_settle_time() {
        let timing = measure::timing(DEFAULT).unwrap();
        let measured = measure::measure(&Circuit::reference(), timing).unwrap();
        assert!(measured.settles_s <= 1e-9 * f64::from(settle::DEFAULT_NS), "{measured:?}");
        // Signal and slope of the definition: the rest level without the reference's share.
        let rest = REFERENCE.share(REFERENCE.pair.rest_a()) - REFERENCE.column.reference_ratio();
        assert!(near(measured.rest, rest, 0.01), "{measured:?}");
        // A base discharges by its own current: its light decays as Q/t whatever it was, with
        // Q = h·C·V_T. The junctions' bias changes C, hence a fifth.
        let [collector, emitter] = UNBIASED_F;
        let charge = CURRENT_GAIN * (collector + emitter) * THERMAL_V;
        let rest_a = REFERENCE.pair.rest_a();
        let left = 1.0 / (1.0 + rest_a * timing.sample / charge);
        assert!(near(measured.afterglow, left, 0.2), "{} {left}", measured.afterglow);
        // So a change of the light leaves the square of that.
        assert!(near(measured.follows, left * left, 0.35), "{} {left}", measured.follows);
    }

    #[test]
    fn small_change_settles_within_the_boards_formula() {
        let small = measure::small_change(&Circuit::reference()).unwrap();
        // The formula adds delays of first order. Two of them are one of second order here, slower
        // at first and faster at the end.
        assert!(near(small.rise_s, REFERENCE.time_constant_s(), 0.25), "{small:?}");
        assert!(small.settles_s <= 1e-9 * f64::from(REFERENCE.settles_ns()), "{small:?}");
    }

    #[test]
    fn circuit_has_twice_the_formulas_shot_noise() {
        let timing = measure::timing(DEFAULT).unwrap();
        let circuit = Circuit::reference();
        let noise = measure::measure(&circuit, timing).unwrap().noise;
        // Photons and recombination, 2qhI each, and the collector's own 2qI; amplifier and resistor
        // add less than a hundredth.
        let formula = circuit.ohm * shot_noise(circuit.rest_a).sqrt();
        let recombination = (2.0 * CURRENT_GAIN + 1.0) / (CURRENT_GAIN + 1.0);
        assert!(near(noise.density, formula * recombination.sqrt(), 0.02), "{noise:?} {formula}");
        // The band 1/4τ of the formula is that of the circuit. A pole of second order has less
        // beyond it, the amplifier's noise is more.
        let total = formula_noise_v() * recombination.sqrt();
        assert!(near(noise.total, total, 0.1), "{noise:?} {total}");
    }

    #[test]
    fn supply_is_still_when_a_row_is_sampled() {
        let supply = measure::supply_step(measure::timing(DEFAULT).unwrap()).unwrap();
        assert!(supply.falls_v > 5e-3, "the LEDs' current is there: {supply:?}");
        assert!(supply.moves_v < measure::HALF_STEP_V, "{supply:?}");
        assert!(supply.lit_steps < 4.0 && supply.dark_steps < 4.0, "{supply:?}");
        assert!(supply.gain.abs() < 2e-3, "{supply:?}");
    }

    #[test]
    fn other_feedback_resistor_is_another_circuit() {
        let timing = measure::timing(DEFAULT).unwrap();
        let reference = Circuit::reference();
        let half = Circuit { ohm: reference.ohm / 2.0, ..reference };
        let [whole, half] = [reference, half].map(|one| measure::measure(&one, timing).unwrap());
        assert!(near(half.rest, whole.rest / 2.0, 0.01));
        assert!(near(half.noise.density, whole.noise.density / 2.0, 0.02));
        assert!(!near(half.settles_s, whole.settles_s, 0.05), "{half:?}");
    }

    #[test]
    fn circuits_of_the_choice_settle_within_15_us() {
        let timing = measure::timing(DEFAULT).unwrap();
        let all = measure::candidates();
        let named = |name| {
            let circuit = all.iter().find(|circuit| circuit.name == name).unwrap();
            measure::measure(circuit, timing).unwrap()
        };
        let chosen = named("TIA, photodiodes, LED at 4.4 mA");
        assert!(chosen.settles_s <= 15e-6 && chosen.ambient < 1e-3, "{chosen:?}");
        assert!(chosen.afterglow.abs() < 1e-4 && chosen.follows.abs() < 1e-4, "{chosen:?}");
        // Parts as now: a change in the row before shows by less than a 12-bit step of itself.
        let rows = named("TIA, emitters on the rows");
        assert!(rows.settles_s <= 15e-6 && rows.follows.abs() < 1.0 / STEPS, "{rows:?}");
    }

    #[test]
    fn page_has_the_circuits_figures() {
        crate::hardware::front_end(true).unwrap();
    }
}
