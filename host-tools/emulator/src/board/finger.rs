//! Finger on the pins: LEDs, phototransistors, and sensors behind their multiplexer.
//!
//! The wiring is that of the board's page. Inputs of the ADCs follow the pins with the time
//! constants of the parts.

use scan_plan::finger::REFERENCE;
use taxel::scan::{Codes, Midpoints, TaxelCodes};
use taxel::units::{Code, FullScale};

use super::time::{HZ, Tick};

/// Time constant of an SFH3010 on 1 kΩ, seconds.
///
/// It is the rise time of 7 µs (10 to 90 %) over ln 9.
const PHOTOTRANSISTOR_S: f64 = 7.0e-6 / 2.197_224_577;
/// Time constant of an amplifier at a gain of 1, seconds.
///
/// The amplifier's bandwidth is 7 MHz (DS12589 table 88).
const AMPLIFIER_S: f64 = 1.0 / (2.0 * std::f64::consts::PI * 7.0e6);
/// Gain of the amplifiers for which the scene has its codes of the midpoints.
const SCENE_GAIN: f64 = 16.0;
/// Top code of a 12-bit converter.
const TOP: f64 = 4095.0;
/// Code of the bridges' reference, in the middle of the range.
const BIAS: f64 = 2048.0;
/// Impedance of a midpoint in ohms: half bridges of 4 kΩ behind 120 Ω of the multiplexer.
const MIDPOINT_OHM: f64 = 1_000.0 + 120.0;

/// Wiring of a finger to a board's pins.
#[derive(Clone, Copy, Debug)]
pub struct Wiring {
    /// Name of the board.
    pub board: &'static str,
    /// Pins of the LED rows, on port B.
    pub rows: [u8; 4],
    /// Pins of the multiplexer's address, on port B.
    pub select: [u8; 2],
    /// Pins of the columns.
    pub columns: [&'static str; 4],
    /// Pins of the midpoints A to D.
    pub midpoints: [&'static str; 4],
    /// Pin of the amplifiers' bias, on boards with amplifiers.
    pub bias: Option<&'static str>,
}

/// Source of an ADC's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Pin of the chip.
    Pin(&'static str),
    /// Output of an amplifier.
    Amplifier(usize),
    /// Temperature sensor of the chip.
    Temperature,
    /// Voltage reference of the chip.
    Reference,
}

/// Gain of an amplifier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gain {
    /// Ratio of output to input.
    pub times: f64,
    /// Whether the amplifier works about the bridges' bias instead of ground.
    pub biased: bool,
}

impl Gain {
    /// Output for a midpoint that has this code in the scene, about the bias `bias`.
    fn of(self, code: f64, bias: f64) -> f64 {
        let about = if self.biased { bias } else { 0.0 };
        let input = bias + (code - bias) / SCENE_GAIN;
        (about + self.times * (input - about)).clamp(0.0, TOP)
    }
}

/// Voltage in codes that follows another with a time constant.
#[derive(Clone, Copy)]
struct Settling {
    from: f64,
    to: f64,
    since: Tick,
    seconds: f64,
}

impl Settling {
    const fn new(seconds: f64) -> Self {
        Self { from: 0.0, to: 0.0, since: 0, seconds }
    }

    fn at(&self, now: Tick) -> f64 {
        let passed = now.saturating_sub(self.since) as f64 / HZ as f64;
        self.to + (self.from - self.to) * (-passed / self.seconds).exp()
    }

    fn turn(&mut self, to: f64, now: Tick) {
        if to.to_bits() != self.to.to_bits() {
            (self.from, self.to, self.since) = (self.at(now), to, now);
        }
    }
}

/// Event on the pins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// New lit rows (one bit each), and the sensor that the multiplexer connects.
    Pattern(u32, usize),
    /// Sample of an input.
    Sample(Source),
    /// Start of a converter; ADC1 is 0.
    Trigger(usize),
    /// Result of a converter.
    Result(usize),
    /// Switch of an amplifier to its first (0) or second (1) input.
    Turn(usize, usize),
}

/// Order in which the scans of a scene are shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// One scan of the scene per scan of the board, starting over after the last.
    Scans,
    /// Each scan lasts this long, counted from the end of the first; starting over after the last.
    Timed(Tick),
    /// One scan of the scene per scan of the board, from the first whenever scanning starts.
    ///
    /// The last scan stays.
    Replay,
}

/// Codes converted in a frame.
#[derive(Clone, Debug)]
pub struct Seen {
    /// Begin of the dark step.
    pub begin: Tick,
    /// Sums of samples.
    pub codes: Codes,
}

/// Finger that shows a scene.
pub struct Finger {
    wiring: Option<Wiring>,
    scene: Vec<Codes>,
    pace: Pace,
    /// End of the first scan.
    first: Option<Tick>,
    scan: usize,
    rows: u32,
    select: usize,
    columns: [Settling; 4],
    amplifiers: [Settling; 2],
    /// Midpoints that the amplifiers amplify.
    amplified: [Option<(usize, Gain)>; 2],
    /// Voltage on the amplifiers' bias pin, in codes.
    pub bias: f64,
    /// Impedance of a column in ohms: the resistor between its amplifier and the pin.
    pub column_ohm: f64,
    begin: Tick,
    sums: Sums,
    /// Events on the pins with their times, if kept.
    pub timing: Option<Vec<(Tick, Moment)>>,
    /// Whether whole frames are kept in `seen`.
    pub keeps: bool,
    /// Whole frames, oldest first.
    pub seen: Vec<Seen>,
}

/// Sums of the samples of the frame being read.
#[derive(Clone, Copy, Default)]
struct Sums {
    dark: [u32; 4],
    lit: [[u32; 4]; 4],
    bridges: [[u32; 4]; 4],
    internal: [u32; 2],
    samples: u32,
}

impl Finger {
    /// Finger that shows these scans, in codes of 12 bits.
    pub fn new(scene: Vec<Codes>, pace: Pace) -> Self {
        Self {
            wiring: None,
            scene,
            pace,
            first: None,
            scan: 0,
            rows: 0,
            select: 0,
            columns: [Settling::new(PHOTOTRANSISTOR_S); 4],
            amplifiers: [Settling::new(AMPLIFIER_S * SCENE_GAIN); 2],
            amplified: [None; 2],
            bias: BIAS,
            column_ohm: REFERENCE.column.pin_ohm,
            begin: 0,
            sums: Sums::default(),
            timing: None,
            keeps: true,
            seen: Vec::new(),
        }
    }

    /// Shows these scans from now on, in codes of 12 bits.
    pub fn show(&mut self, scene: Vec<Codes>) {
        (self.scene, self.scan) = (scene, 0);
    }

    /// Connects the finger to a board.
    pub fn wire(&mut self, wiring: Wiring) {
        self.wiring = Some(wiring);
    }

    /// Wiring of the finger, once connected.
    pub fn wiring(&self) -> Option<&Wiring> {
        self.wiring.as_ref()
    }

    /// Row of the step, if just one is lit.
    fn row(&self) -> Option<usize> {
        (self.rows.count_ones() == 1).then(|| self.rows.trailing_zeros() as usize)
    }

    /// Lit rows, one bit each.
    pub fn rows(&self) -> u32 {
        self.rows
    }

    /// End of the first scan, from which the scene's times count.
    pub fn first(&self) -> Option<Tick> {
        self.first
    }

    fn codes(&self) -> Option<&Codes> {
        let last = self.scene.len().checked_sub(1)?;
        self.scene.get(match self.pace {
            Pace::Replay => self.scan.min(last),
            Pace::Scans | Pace::Timed(_) => self.scan % (last + 1),
        })
    }

    /// Records that the board starts scanning.
    pub fn scanned_anew(&mut self, now: Tick) {
        (self.sums, self.begin) = (Sums::default(), now);
        if self.pace == Pace::Replay {
            self.scan = 0;
        }
    }

    /// Records a change of port B's outputs.
    pub fn pins(&mut self, high: u32, now: Tick) {
        let Some(Wiring { rows, select, .. }) = &self.wiring else { return };
        let bit = |pin: u8| high >> pin & 1;
        let rows = rows.iter().enumerate().map(|(i, pin)| bit(*pin) << i).sum();
        let select = select.iter().enumerate().map(|(i, pin)| bit(*pin) << i).sum::<u32>();
        if rows == 0 && self.rows != 0 {
            self.end(now);
        }
        (self.rows, self.select) = (rows, select as usize);
        self.note(now, Moment::Pattern(self.rows, self.select));
        self.light(now);
        self.bridge(now);
    }

    /// Records an event, if events are kept.
    pub fn note(&mut self, now: Tick, moment: Moment) {
        if let Some(timing) = &mut self.timing {
            timing.push((now, moment));
        }
    }

    /// Ends the frame and moves to the next scan of the scene.
    fn end(&mut self, now: Tick) {
        // Four columns in five steps, four midpoints in four.
        const READINGS: u32 = 4 * 5 + 4 * 4;
        let sums = std::mem::take(&mut self.sums);
        let samples = sums.samples / READINGS;
        if sums.samples.is_multiple_of(READINGS) && samples > 0 {
            let code = |sum: u32| Code(sum as u16);
            let full_scale = FullScale::new((TOP as u32 * samples) as u16);
            let codes = Codes {
                full_scale: full_scale.unwrap_or(FullScale::BITS_12),
                taxels: Some(TaxelCodes {
                    lit: sums.lit.map(|row| row.map(code)),
                    dark: sums.dark.map(code),
                }),
                bridges: sums.bridges.map(|sums| {
                    let [a, b, c, d] = sums.map(code);
                    Some(Midpoints { a, b, c, d })
                }),
                temperature: Some(code(sums.internal[0] * samples)),
                reference: Some(code(sums.internal[1] * samples)),
            };
            if self.keeps {
                self.seen.push(Seen { begin: self.begin, codes });
            }
        }
        self.begin = now;
        let first = *self.first.get_or_insert(now);
        self.scan = match self.pace {
            Pace::Timed(each) => ((now - first) / each.max(1)) as usize,
            Pace::Scans | Pace::Replay => self.scan + 1,
        };
    }

    fn light(&mut self, now: Tick) {
        let Some(TaxelCodes { lit, dark }) = self.codes().and_then(|codes| codes.taxels) else {
            return;
        };
        for (column, settling) in self.columns.iter_mut().enumerate() {
            let dark = f64::from(dark[column].0);
            let light: f64 = (0..4)
                .filter(|row| self.rows >> row & 1 == 1)
                .map(|row| f64::from(lit[row][column].0) - dark)
                .sum();
            settling.turn((dark + light).clamp(0.0, TOP), now);
        }
    }

    fn bridge(&mut self, now: Tick) {
        for i in 0..self.amplifiers.len() {
            if let Some((midpoint, gain)) = self.amplified[i] {
                let code = gain.of(self.connected(midpoint), self.bias);
                self.amplifiers[i].turn(code, now);
            }
        }
    }

    /// Records that an amplifier is connected to `pin`.
    pub fn amplify(&mut self, amplifier: usize, pin: &str, gain: Gain, now: Tick) {
        let before = self.amplified[amplifier];
        self.amplified[amplifier] = self.midpoint(pin).map(|midpoint| (midpoint, gain));
        self.amplifiers[amplifier].seconds = AMPLIFIER_S * gain.times;
        if let Some((midpoint, _)) = self.amplified[amplifier]
            && before.map(|(midpoint, _)| midpoint) != Some(midpoint)
        {
            self.note(now, Moment::Turn(amplifier, midpoint % 2));
        }
        self.bridge(now);
    }

    /// Midpoint on a pin.
    fn midpoint(&self, pin: &str) -> Option<usize> {
        self.wiring?.midpoints.iter().position(|midpoint| *midpoint == pin)
    }

    /// Impedance in ohms of what drives a pin; the bias has a buffer.
    pub fn ohm(&self, pin: &str) -> f64 {
        let is_column = self.wiring.is_some_and(|wiring| wiring.columns.contains(&pin));
        match self.midpoint(pin) {
            _ if is_column => self.column_ohm,
            Some(_) => MIDPOINT_OHM,
            None => 0.0,
        }
    }

    /// Voltage of a midpoint behind the multiplexer, in codes.
    fn connected(&self, midpoint: usize) -> f64 {
        match self.codes().and_then(|codes| codes.bridges.get(self.select).copied().flatten()) {
            Some(Midpoints { a, b, c, d }) => f64::from([a, b, c, d][midpoint].0),
            None => self.bias,
        }
    }

    /// Code of a converter without noise for the present input.
    pub fn sample(&mut self, source: Source, now: Tick) -> u32 {
        self.note(now, Moment::Sample(source));
        let code = |value: f64| value.round().clamp(0.0, TOP) as u32;
        match source {
            Source::Pin(pin) => {
                let column = self.wiring.and_then(|w| w.columns.iter().position(|at| *at == pin));
                if let Some(column) = column {
                    let code = code(self.columns[column].at(now));
                    let row = self.row();
                    let place = match row {
                        Some(row) => &mut self.sums.lit[row][column],
                        None => &mut self.sums.dark[column],
                    };
                    *place += code;
                    self.sums.samples += 1;
                    return code;
                }
                if let Some(midpoint) = self.midpoint(pin) {
                    let code = code(self.connected(midpoint));
                    self.bridge_sample(midpoint, code);
                    return code;
                }
                let bias = self.wiring.is_some_and(|wiring| wiring.bias == Some(pin));
                code(if bias { self.bias } else { 0.0 })
            }
            Source::Amplifier(which) => {
                let code = code(self.amplifiers[which].at(now));
                if let Some((midpoint, _)) = self.amplified[which] {
                    self.bridge_sample(midpoint, code);
                }
                code
            }
            Source::Temperature | Source::Reference => {
                let codes = self.codes();
                let (which, own) = match source {
                    Source::Temperature => (0, codes.and_then(|codes| codes.temperature)),
                    _ => (1, codes.and_then(|codes| codes.reference)),
                };
                // 30 °C and 1.212 V at a supply of 3.3 V.
                let code = own.map_or([943, 1504][which], |code| u32::from(code.0));
                self.sums.internal[which] = code;
                code
            }
        }
    }

    /// Adds the sample of a midpoint; those of the dark step are left out.
    fn bridge_sample(&mut self, midpoint: usize, code: u32) {
        if self.row().is_some() {
            self.sums.bridges[self.select][midpoint] += code;
            self.sums.samples += 1;
        }
    }
}
