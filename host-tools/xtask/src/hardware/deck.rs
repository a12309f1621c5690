//! Circuit of a column as text for ngspice, made from the reference finger.

use std::fmt::Write as _;

use scan_plan::finger::{CURRENT_GAIN, Finger, REFERENCE, THERMAL_V, UNBIASED_F};
use taxel::scan::ROWS;

/// Voltage noise squared of 1 Ω at 25 °C, in V²/Hz: 4kT.
const OHM_NOISE: f64 = 4.0 * 1.380_649e-23 * 298.15;

/// Device that makes a current of the light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detector {
    /// SFH3010 of the reference finger.
    Phototransistor,
    /// SFH3010 with its emitter on the row's switch instead of ground.
    Switched,
    /// Photodiode of this capacitance in femtofarads.
    Photodiode(u32),
}

/// Device that makes a voltage of a column's current.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Front {
    /// Resistor to ground, and an amplifier of this gain behind it.
    Load(f64),
    /// Transimpedance amplifier with this feedback capacitor in farads.
    Amplifier(f64),
}

/// Circuit of a column.
#[derive(Clone, Copy, Debug)]
pub struct Circuit {
    /// Name in tables.
    pub name: &'static str,
    /// Device under a facet.
    pub detector: Detector,
    /// Device of the column.
    pub front: Front,
    /// Load or feedback resistor in ohms.
    pub ohm: f64,
    /// Current of a mean pair at rest, in amperes.
    pub rest_a: f64,
}

/// Light of one row's pair: a share of the light at rest over time.
#[derive(Clone, Copy, Debug)]
pub enum Light {
    /// No LED.
    Off,
    /// LED that is always on.
    Steady(f64),
    /// LED that is always on, with a step from the first share to the second after a time.
    Step(f64, f64, f64),
    /// LED that a scan turns on in its row's step.
    Scanned(f64),
}

/// Times of a scan in seconds.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// Length of a step.
    pub step: f64,
    /// First sample of a column after the change of row.
    pub sample: f64,
    /// Time from one sample to the next.
    pub conversion: f64,
}

impl Circuit {
    /// Circuit of the reference finger.
    #[must_use]
    pub fn reference() -> Self {
        Self {
            name: "TIA of the reference finger",
            detector: Detector::Phototransistor,
            front: Front::Amplifier(REFERENCE.column.feedback_f),
            ohm: REFERENCE.column.feedback_ohm,
            rest_a: REFERENCE.pair.rest_a(),
        }
    }

    /// Adds the column `name` with its four pairs; its output is the node `adc` and the name.
    ///
    /// `ambient` is light that no LED makes, as a share of the light at rest.
    pub fn column(
        &self,
        deck: &mut String,
        name: &str,
        lights: [Light; ROWS],
        ambient: f64,
        timing: Timing,
    ) {
        for (row, light) in lights.into_iter().enumerate() {
            self.pair(deck, &format!("{name}{row}"), name, light, ambient, (row, timing));
        }
        self.front(deck, name);
    }

    /// Adds a pair `name` on the column `column`.
    fn pair(
        &self,
        deck: &mut String,
        name: &str,
        column: &str,
        light: Light,
        ambient: f64,
        scan: (usize, Timing),
    ) {
        let (from, to, amperes) = match (self.detector, self.front) {
            (Detector::Photodiode(fall), _) => {
                add(deck, format_args!("Cd{name} in{column} 0 {fall}f"));
                (format!("in{column}"), "0".to_owned(), self.rest_a)
            }
            // On a load the phototransistors are emitter followers from the supply.
            (Detector::Phototransistor, Front::Load(_)) => {
                add(deck, format_args!("Q{name} vdd b{name} in{column} pair"));
                ("vdd".to_owned(), format!("b{name}"), self.rest_a / CURRENT_GAIN)
            }
            (Detector::Phototransistor, Front::Amplifier(_)) => {
                add(deck, format_args!("Q{name} in{column} b{name} 0 pair"));
                (format!("in{column}"), format!("b{name}"), self.rest_a / CURRENT_GAIN)
            }
            (Detector::Switched, _) => {
                add(deck, format_args!("Q{name} in{column} b{name} e{name} pair"));
                row_switch(deck, name, light, scan);
                (format!("in{column}"), format!("b{name}"), self.rest_a / CURRENT_GAIN)
            }
        };
        let source = |deck: &mut String, part: &str, shape: std::fmt::Arguments| {
            add(deck, format_args!("I{part}{name} {from} {to} {shape}"));
        };
        // A nanoampere of dark current, as the data sheet has.
        let dark = 1e-9 / self.rest_a;
        source(deck, "d", format_args!("{:e}", amperes * (ambient + dark)));
        match light {
            Light::Off => {}
            Light::Steady(share) => source(deck, "l", format_args!("{:e}", amperes * share)),
            Light::Step(low, high, at) => source(
                deck,
                "l",
                format_args!("PULSE({:e} {:e} {at:e} 10n 10n 1 2)", amperes * low, amperes * high),
            ),
            Light::Scanned(share) => {
                let (row, Timing { step, .. }) = scan;
                let begin = (row + 1) as f64 * step;
                source(
                    deck,
                    "l",
                    format_args!(
                        "PULSE(0 {:e} {begin:e} 20n 20n {:e} {:e})",
                        amperes * share,
                        step - 20e-9,
                        5.0 * step
                    ),
                );
            }
        }
    }

    /// Adds what makes a voltage of the current of node `in` and the name.
    fn front(&self, deck: &mut String, name: &str) {
        let column = REFERENCE.column;
        let detectors = match self.front {
            Front::Load(gain) => {
                add(deck, format_args!("Rl{name} in{name} 0 {:e}", self.ohm));
                add(deck, format_args!("Eg{name} out{name} 0 in{name} 0 {gain}"));
                column.wires_f
            }
            Front::Amplifier(farad) => {
                add(deck, format_args!("X{name} ref in{name} out{name} vdd amplifier"));
                add(deck, format_args!("Rf{name} out{name} in{name} {:e}", self.ohm));
                add(deck, format_args!("Cf{name} out{name} in{name} {farad:e}"));
                column.wires_f
            }
        };
        add(deck, format_args!("Cw{name} in{name} 0 {detectors:e}"));
        add(deck, format_args!("Rp{name} out{name} adc{name} {:e}", column.pin_ohm));
        add(deck, format_args!("Cp{name} adc{name} 0 {:e}", REFERENCE.converter.sampling_f));
    }

    /// Adds the noise of light on row 0's pair of the column `name`, and an input `Vs` for its
    /// gain.
    ///
    /// A current of photons has shot noise 2qI, which is the thermal noise of a resistor 2V_T/I.
    pub fn photon_noise(&self, deck: &mut String, name: &str) {
        let (amperes, from, to) = match self.detector {
            Detector::Photodiode(_) => (self.rest_a, format!("in{name}"), "0".to_owned()),
            Detector::Phototransistor | Detector::Switched => {
                let from = match self.front {
                    Front::Load(_) => "vdd".to_owned(),
                    Front::Amplifier(_) => format!("in{name}"),
                };
                (self.rest_a / CURRENT_GAIN, from, format!("b{name}0"))
            }
        };
        add(deck, format_args!("Rphoton photon sense {:e}", 2.0 * THERMAL_V / amperes));
        add(deck, format_args!("Vs photon 0 0 AC 1"));
        add(deck, format_args!("Vsense sense 0 0"));
        add(deck, format_args!("Fphoton {from} {to} Vsense 1"));
    }
}

/// Adds the line of a row's LEDs, on which the emitter of the pair `name` is.
///
/// The switch holds it near ground; without it the LEDs pull it up until hardly any current is
/// left.
fn row_switch(
    deck: &mut String,
    name: &str,
    light: Light,
    (row, Timing { step, .. }): (usize, Timing),
) {
    let up = REFERENCE.converter.range_v - REFERENCE.pair.led_v;
    let begin = (row + 1) as f64 * step;
    let voltage = match light {
        Light::Steady(_) | Light::Step(..) => "0".to_owned(),
        Light::Off | Light::Scanned(_) => {
            format!("PULSE({up} 0 {begin:e} 20n 20n {:e} {:e})", step - 20e-9, 5.0 * step)
        }
    };
    add(deck, format_args!("Ve{name} line{name} 0 {voltage}\nRe{name} line{name} e{name} 5"));
}

/// Adds a line to a deck.
pub fn add(deck: &mut String, line: std::fmt::Arguments) {
    let _ = deck.write_fmt(line);
    deck.push('\n');
}

/// Models and tolerances that every deck begins with.
#[must_use]
pub fn models(title: &str) -> String {
    let Finger { column, .. } = REFERENCE;
    let [collector, emitter] = UNBIASED_F;
    let omega = std::f64::consts::TAU * column.bandwidth_hz;
    let mut deck = format!("* {title}\n");
    // The saturation current puts the base of a pair at rest at 0.56 V.
    add(
        &mut deck,
        format_args!(".model pair NPN(IS=3e-14 BF={CURRENT_GAIN} BR=5 VAF=80 TF=1n FC=0.5"),
    );
    add(
        &mut deck,
        format_args!("+ CJC={collector:e} VJC=0.7 MJC=0.33 CJE={emitter:e} VJE=0.75 MJE=0.33)"),
    );
    // Integrator that slews, a second pole for a phase margin of 60°, and an output that stops at
    // the rails. Its noise is that of a resistor.
    add(&mut deck, format_args!(".subckt amplifier plus minus out vdd"));
    add(&mut deck, format_args!("Ci minus 0 {:e}", column.input_f));
    add(&mut deck, format_args!("Rn noise 0 {:e}", column.noise_v * column.noise_v / OHM_NOISE));
    add(&mut deck, format_args!("Ep input noise plus 0 1"));
    let slew = column.slew_v_s;
    add(
        &mut deck,
        format_args!("Bg 0 g I = {:e}*tanh({:e}*(v(input)-v(minus)))", 1e-12 * slew, omega / slew),
    );
    add(&mut deck, format_args!("Cg g 0 1p\nRg g 0 1e11"));
    add(&mut deck, format_args!(".model rail D(IS=1p N=0.02)"));
    add(&mut deck, format_args!("Vt vdd top {:e}\nDt g top rail", column.swing_v));
    add(&mut deck, format_args!("Vb bottom 0 {:e}\nDb bottom g rail", column.swing_v));
    add(
        &mut deck,
        format_args!("Eb buffer 0 g 0 1\nRb buffer pole 1k\nCb pole 0 {:e}", 1e-3 / (1.73 * omega)),
    );
    add(&mut deck, format_args!("Eo drive 0 pole 0 1\nRo drive out 50\n.ends"));
    add(
        &mut deck,
        format_args!(".options reltol=1e-5 abstol=1e-14 vntol=1e-8 method=gear temp=25 tnom=25"),
    );
    deck
}

/// Supply and reference that nothing disturbs.
#[must_use]
pub fn ideal_supply() -> String {
    let range = REFERENCE.converter.range_v;
    let reference = REFERENCE.column.reference_ratio() * range;
    format!("Vdd vdd 0 {range}\nVref ref 0 {reference}\n")
}
