//! Reference finger: the parts of the bill of materials, and what follows from them.
//!
//! The boards' settle time, the simulator's reference device, the pages' bills of materials and the
//! circuit simulation read [`REFERENCE`]. A test fails where a page disagrees.

use taxel::scan::ScanSettings;

/// Finger that the pages describe.
#[derive(Clone, Copy, Debug)]
pub struct Finger {
    /// Optical pairs.
    pub pair: Pair,
    /// Amplifier of a column.
    pub column: Column,
    /// Converter of the columns.
    pub converter: Converter,
    /// Supply of LEDs, columns and converter.
    pub supply: Supply,
    /// Skin above the pairs.
    pub skin: Skin,
}

/// LED and phototransistor of a taxel.
#[derive(Clone, Copy, Debug)]
pub struct Pair {
    /// Order name of the LED.
    pub led: &'static str,
    /// Resistor of an LED in ohms.
    pub led_ohm: f64,
    /// Forward voltage of an LED in volts.
    pub led_v: f64,
    /// Order name of the phototransistor.
    pub phototransistor: &'static str,
    /// Distance between LED and phototransistor in mm.
    pub separation_mm: f64,
    /// Distance from an unloaded facet to the pair in mm.
    pub gap_mm: f64,
    /// Height of the phototransistor above the board in mm.
    pub height_mm: f64,
    /// Length and width of either package in mm.
    pub package_mm: [f64; 2],
    /// Length of solder beyond each end of a package in mm.
    pub toe_mm: f64,
    /// Photocurrent of a mean pair at the peak of its light curve, in amperes.
    pub peak_a: f64,
}

impl Pair {
    /// Photocurrent in amperes of a mean pair whose facet is `gap_mm` away.
    ///
    /// The law of the simulator's light curve: 4qs²/(q + s²)² with q = 4g².
    #[must_use]
    pub const fn photocurrent_a(&self, gap_mm: f64) -> f64 {
        let (q, s2) = (4.0 * gap_mm * gap_mm, self.separation_mm * self.separation_mm);
        self.peak_a * 4.0 * q * s2 / ((q + s2) * (q + s2))
    }

    /// Length of a package with its solder in mm: from end to end of its pads.
    #[must_use]
    pub const fn pads_mm(&self) -> f64 {
        self.package_mm[0] + 2.0 * self.toe_mm
    }

    /// Photocurrent in amperes of a mean pair at rest.
    #[must_use]
    pub const fn rest_a(&self) -> f64 {
        self.photocurrent_a(self.gap_mm)
    }
}

/// Transimpedance amplifier of a column.
///
/// The phototransistors' collectors meet at the inverting input, which holds them at the reference.
/// The output is the reference and the photocurrent times the feedback resistor.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Order name of the quad amplifier.
    pub amplifier: &'static str,
    /// Feedback resistor in ohms.
    pub feedback_ohm: f64,
    /// Feedback capacitor in farads.
    pub feedback_f: f64,
    /// Divider of the non-inverting input's voltage in ohms: to the supply, and to ground.
    pub divider_ohm: [f64; 2],
    /// Gain times bandwidth of the amplifier in hertz.
    pub bandwidth_hz: f64,
    /// Voltage noise of the amplifier in volts per root hertz.
    pub noise_v: f64,
    /// Slew rate of the amplifier in volts per second.
    pub slew_v_s: f64,
    /// Distance in volts from a rail that the amplifier's output reaches.
    pub swing_v: f64,
    /// Capacitance of the amplifier's inverting input in farads.
    pub input_f: f64,
    /// Capacitance of a column's wires in farads.
    pub wires_f: f64,
    /// Resistor between the amplifier and the converter's pin in ohms.
    pub pin_ohm: f64,
}

impl Column {
    /// Voltage of the non-inverting input, as a share of the supply.
    #[must_use]
    pub const fn reference_ratio(&self) -> f64 {
        let [high, low] = self.divider_ohm;
        low / (high + low)
    }
}

/// Converter of a column's voltage.
#[derive(Clone, Copy, Debug)]
pub struct Converter {
    /// Supply and range in volts.
    pub range_v: f64,
    /// Bits of one conversion.
    pub bits: u32,
    /// Noise of one conversion in steps, one standard deviation.
    ///
    /// The value is an assumption on the safe side: the sheet of the STM32F301 gives 66 dB for such
    /// a converter, which is 0.67 steps besides the rounding.
    pub noise_steps: f64,
    /// Capacitor that samples the pin's voltage, in farads.
    pub sampling_f: f64,
    /// Conversions of a reading at the default rate.
    pub oversampling: u16,
    /// Default rate of frames in hertz.
    pub scan_hz: u16,
    /// Default settle time in nanoseconds.
    pub settle_ns: u32,
}

impl Converter {
    /// Default settings of a scan.
    #[must_use]
    pub const fn settings(&self) -> ScanSettings {
        let Self { scan_hz, oversampling, settle_ns, .. } = *self;
        ScanSettings { scan_hz, oversampling, settle_ns }
    }
}

/// Regulator and filter of the analogue supply.
#[derive(Clone, Copy, Debug)]
pub struct Supply {
    /// Order name of the regulator.
    pub regulator: &'static str,
    /// Output resistance of the regulator in ohms.
    pub regulator_ohm: f64,
    /// Frequency in hertz up to which the regulator's loop holds its output.
    pub regulator_hz: f64,
    /// Capacitors before the ferrite bead in farads.
    pub before_f: f64,
    /// Order name of the ferrite bead.
    pub bead: &'static str,
    /// Resistance of the ferrite bead in ohms.
    pub bead_ohm: f64,
    /// Inductance of the ferrite bead in henries, below its resistive range.
    pub bead_h: f64,
    /// Resistance of the ferrite bead at 100 MHz in ohms.
    pub bead_loss_ohm: f64,
    /// Capacitors on VDDA and VREF+ in farads.
    pub behind_f: f64,
}

/// Skin with its frame.
#[derive(Clone, Copy, Debug)]
pub struct Skin {
    /// Young's modulus in MPa.
    pub young_mpa: f64,
    /// Thickness above the facets in mm.
    pub depth_mm: f64,
    /// Side of a facet, which is the window in the frame, in mm.
    pub facet_mm: f64,
}

/// Current gain of the phototransistor: collector current over base current.
///
/// The 25 µA of the SFH 3010's sheet come from 0.04 mm² of silicon, which at 0.6 A/W make 0.12 µA
/// of 0.5 mW/cm². The gain is therefore at least 208, and some 450 with twice the minimum current.
/// The sheet of the larger SFH 3401 has 340 to 860.
pub const CURRENT_GAIN: f64 = 450.0;
/// Rise time (10–90 %) of an SFH3010 at 1 mA on a load of 1 kΩ, in seconds (data sheet).
const RISE_S: f64 = 7e-6;
/// Load in ohms and current in amperes at which the data sheet gives the rise time.
const SHEET: (f64, f64) = (1_000.0, 1e-3);
/// Thermal voltage at 25 °C.
pub const THERMAL_V: f64 = 25.7e-3;
/// Elementary charge in coulombs (SI).
const ELEMENTARY_CHARGE: f64 = 1.602_176_634e-19;
/// ln 9: ratio of the rise time of a first-order response to its time constant.
const LN_9: f64 = 2.197_224_577_336_219;
/// ln 2.
const LN_2: f64 = core::f64::consts::LN_2;

/// Capacitance in farads of a phototransistor's collector–base junction under its sheet's bias.
///
/// The base–emitter junction counts as much: it is the smaller one, but forward-biased.
pub const JUNCTION_F: f64 = RISE_S / LN_9 / (CURRENT_GAIN * (SHEET.0 + 2.0 * THERMAL_V / SHEET.1));

/// Capacitances in farads of an SFH3010's collector–base and base–emitter junctions without bias.
///
/// Two values of the data sheet give both: a rise time of 7 µs, and 1.3 pF from collector to
/// emitter at 0 V, the two in series. The circuit simulation checks that they do.
pub const UNBIASED_F: [f64; 2] = [12.02e-12, 1.458e-12];

/// Time constant in seconds of a phototransistor that carries `current_a` into `input_ohm`.
///
/// The base current charges the collector–base junction by the voltage on the input, and both
/// junctions by the change of the base's own voltage: h·C·(R + 2V_T/I). The second part is that of
/// the phototransistor; no circuit behind it changes it.
#[must_use]
pub const fn time_constant_s(input_ohm: f64, current_a: f64) -> f64 {
    CURRENT_GAIN * JUNCTION_F * (input_ohm + 2.0 * THERMAL_V / current_a)
}

/// Shot noise in A²/Hz of a phototransistor that carries `current_a`.
///
/// The noise of the photons' current, amplified, and of the collector's own: 2q(1 + h)I. Holes that
/// recombine in the base have as much again, which this leaves out; the circuit simulation has it.
#[must_use]
pub const fn shot_noise(current_a: f64) -> f64 {
    2.0 * ELEMENTARY_CHARGE * (1.0 + CURRENT_GAIN) * current_a
}

impl Finger {
    /// Impedance in ohms of a column's input at the speed of the phototransistor.
    ///
    /// There the amplifier has the gain f_T/f left, at f = 1/2πτ of the phototransistor alone.
    #[must_use]
    pub const fn input_ohm(&self) -> f64 {
        let alone_s = time_constant_s(0.0, self.pair.rest_a());
        let gain = core::f64::consts::TAU * alone_s * self.column.bandwidth_hz;
        self.column.feedback_ohm / (1.0 + gain)
    }

    /// Time constant in seconds of a column at rest: phototransistor and feedback.
    #[must_use]
    pub const fn time_constant_s(&self) -> f64 {
        time_constant_s(self.input_ohm(), self.pair.rest_a())
            + self.column.feedback_ohm * self.column.feedback_f
    }

    /// Nanoseconds in which a small change settles to a step of the converter, rounded up.
    #[must_use]
    pub const fn settles_ns(&self) -> u32 {
        (1e9 * self.time_constant_s() * LN_2 * self.converter.bits as f64) as u32 + 1
    }

    /// Share of the converter's range that `current_a` makes.
    #[must_use]
    pub const fn share(&self, current_a: f64) -> f64 {
        self.column.reference_ratio()
            + current_a * self.column.feedback_ohm / self.converter.range_v
    }
}

/// Reference finger of this project.
pub const REFERENCE: Finger = Finger {
    pair: Pair {
        led: "SFH4050",
        // 1.86 mA: 0.12 mW/sr towards the phototransistor, which `peak_a` follows from. Assumed are
        // a light in proportion to the current, from 9 mW/sr at 100 mA on the axis (sheet; at least
        // 4), and 0.7 of it at 45°. A built finger chooses the resistor by its codes.
        led_ohm: 1_100.0,
        // 1.5 V at 100 mA (sheet), less 2kT/q for a factor of e in current, less its resistance.
        led_v: 1.25,
        phototransistor: "SFH3010",
        separation_mm: 1.4,
        // Nearer is brighter and so faster; 2 N on the framed skin stay clear of the peak at
        // 0.7 mm.
        gap_mm: 1.4,
        height_mm: 0.65,
        package_mm: [1.7, 0.8],
        toe_mm: 0.2,
        peak_a: 154.687_5e-6,
    },
    column: Column {
        amplifier: "TLV9064IPWR",
        feedback_ohm: 15_000.0,
        feedback_f: 10e-12,
        // E24 values whose ratio is 7: an eighth of the supply.
        divider_ohm: [91_000.0, 13_000.0],
        bandwidth_hz: 10e6,
        noise_v: 10e-9,
        slew_v_s: 6.5e6,
        swing_v: 0.02,
        input_f: 6e-12,
        wires_f: 10e-12,
        pin_ohm: 100.0,
    },
    converter: Converter {
        range_v: 3.3,
        bits: 12,
        noise_steps: 0.8,
        sampling_f: 5e-12,
        oversampling: 8,
        scan_hz: 4_000,
        // 12 bits on the load of the data sheet; the columns need less.
        settle_ns: 26_500,
    },
    supply: Supply {
        regulator: "MCP1700T-3302E/TT",
        // Resistance and loop are assumptions: the sheet has neither.
        regulator_ohm: 0.1,
        regulator_hz: 50e3,
        before_f: 6e-6,
        bead: "BLM18AG601SN1D",
        bead_ohm: 0.38,
        bead_h: 1e-6,
        bead_loss_ohm: 600.0,
        behind_f: 2.2e-6,
    },
    skin: Skin { young_mpa: 0.236, depth_mm: 2.5, facet_mm: 1.9 },
};

// The default settle time covers the circuit.
const _: () = assert!(REFERENCE.settles_ns() <= REFERENCE.converter.settle_ns);
// Lit phototransistors stay above their saturation voltage of 0.14 V (data sheet).
const _: () = assert!(REFERENCE.column.reference_ratio() * REFERENCE.converter.range_v >= 0.3);
