use super::*;
use crate::condition::random::noise;
use crate::condition::{BridgeBias, Health, TaxelBias};
use crate::units::FullScale;

/// Noise of a reading in codes, of 16 bits.
const CODES: f32 = 10.0;
const SQRT_2: f32 = core::f32::consts::SQRT_2;
const LIT: f32 = 30_000.0;
const DARK: f32 = 2_000.0;
const MIDPOINT: f32 = 32_768.0;
/// Scans of 10 ms at 4 kHz.
const TEN_MS: usize = 40;

/// A finger with four sensors, and what changes its readings.
struct Fingertip {
    watch: JumpWatch,
    random: u32,
    /// Codes added to each lit reading, dark reading and midpoint.
    lit: [f32; TAXELS],
    dark: [f32; COLS],
    midpoints: [[f32; 4]; SENSORS],
    sensors: usize,
    touched: bool,
    /// Dark codes that are stuck.
    held: [Option<Code>; COLS],
    /// Noise of a reading, and what each sensor has more.
    codes: f32,
    louder: [f32; SENSORS],
    /// Faults that other detectors have found.
    known: Health,
    /// Times that each scan is given.
    repeats: usize,
}

impl Fingertip {
    fn new() -> Self {
        let mut finger = Self {
            watch: JumpWatch::default(),
            random: 7,
            lit: [0.0; TAXELS],
            dark: [0.0; COLS],
            midpoints: [[0.0; 4]; SENSORS],
            sensors: SENSORS,
            touched: false,
            held: [None; COLS],
            codes: CODES,
            louder: [1.0; SENSORS],
            known: Health::SOUND,
            repeats: 1,
        };
        finger.rests(1000);
        finger
    }

    /// A finger that has just been switched on.
    fn restarted(mut self) -> Self {
        self.watch = JumpWatch::default();
        self
    }

    fn rests(&mut self, scans: usize) {
        assert!((0..scans).all(|_| self.next() == self.known));
    }

    fn next(&mut self) -> Health {
        let top = 65_535.0;
        let (random, codes) = (&mut self.random, self.codes);
        let mut code = |at: f32| Code((at + codes * noise(random) + 0.5) as u16);
        let mut dark = self.dark.map(|by| code(DARK + by));
        let stuck = dark.iter_mut().zip(self.held);
        stuck.for_each(|(dark, held)| *dark = held.unwrap_or(*dark));
        let mut lit = [[Code(0); COLS]; 4];
        let mut c = [0.0; TAXELS];
        for (k, (lit, c)) in lit.as_flattened_mut().iter_mut().zip(&mut c).enumerate() {
            *lit = code(LIT + self.lit[k]);
            *c = (LIT - DARK - f32::from(lit.0) + f32::from(dark[k % COLS].0)) / top;
        }
        let mut bridges = [None; SENSORS];
        let mut outputs = [None; SENSORS];
        for i in 0..self.sensors {
            let mut midpoint = |by| {
                let Code(read) = code(0.5 * MIDPOINT);
                let noise = f32::from(read) - 0.5 * MIDPOINT;
                Code((MIDPOINT + by + self.louder[i] * noise) as u16)
            };
            let [a, b, c, d] = self.midpoints[i].map(&mut midpoint);
            let [fa, fb, fc, fd] = [a, b, c, d].map(|code| f32::from(code.0) / top);
            bridges[i] = Some(Midpoints { a, b, c, d });
            outputs[i] = Some([fb - fa, fc - fd, fa + fb - fc - fd]);
        }
        let codes = Codes {
            full_scale: FullScale::BITS_16,
            taxels: Some(TaxelCodes { lit, dark }),
            bridges,
            reference: None,
            temperature: None,
        };
        let mut signals = Signals { taxels: Some(c), bridges: outputs, health: self.known };
        let taxels = TaxelBias { level: [0.0; TAXELS], noise: SQRT_2 * CODES / top };
        let sensor = BridgeBias { level: [0.0; 3], noise: 1.63 * CODES / top };
        let bias = Bias { taxels: Some(taxels), bridges: [Some(sensor); SENSORS] };
        for _ in 0..self.repeats {
            signals.health = self.known;
            self.watch.update(&codes, &mut signals, &bias, self.touched);
        }
        signals.health
    }

    /// Scans until just `expected` is in doubt; no other channel may be before.
    fn until(&mut self, expected: Health, mut change: impl FnMut(&mut Self)) -> usize {
        for scan in 1..=2 * TEN_MS {
            change(self);
            let doubted = self.next();
            if doubted == expected {
                return scan;
            }
            assert!(doubted.dead & !expected.dead == 0, "{doubted:?} for {expected:?}");
            assert!(
                doubted.bridge_faults & !expected.bridge_faults == 0,
                "{doubted:?} for {expected:?}"
            );
        }
        panic!("{expected:?} was not found");
    }
}

fn taxel(k: usize) -> Health {
    Health { dead: 1 << k, ..Health::SOUND }
}

fn sensor(i: usize) -> Health {
    Health { bridge_faults: 1 << i, ..Health::SOUND }
}

#[test]
fn noisy_reading_is_named_within_10_ms() {
    for k in 0..TAXELS {
        let mut finger = Fingertip::new();
        let scans = finger.until(taxel(k), |finger| {
            finger.lit[k] = 40.0 * CODES * noise(&mut finger.random);
        });
        assert!(scans <= TEN_MS, "taxel {k}: {scans}");
    }
    for i in 0..SENSORS {
        let mut finger = Fingertip::new();
        let scans = finger.until(sensor(i), |finger| {
            finger.midpoints[i][2] = 20.0 * CODES * noise(&mut finger.random);
        });
        assert!(scans <= TEN_MS, "sensor {i}: {scans}");
    }
}

#[test]
fn tenfold_noise_of_any_reading_is_named_within_10_ms() {
    let mut late = 0;
    for reading in 0..TAXELS + COLS + 4 * SENSORS {
        let mut finger = Fingertip::new();
        let (expected, part) = match reading {
            0..16 => (taxel(reading), 0),
            16..20 => (Health { dead: COLUMN << (reading - 16), ..Health::SOUND }, 1),
            _ => (sensor((reading - 20) / 4), 2),
        };
        let scans = finger.until(expected, |finger| {
            let codes = 10.0 * CODES * noise(&mut finger.random);
            match part {
                0 => finger.lit[reading] = codes,
                1 => finger.dark[reading - 16] = codes,
                _ => finger.midpoints[(reading - 20) / 4][reading % 4] = codes,
            }
        });
        late += usize::from(scans > TEN_MS);
    }
    assert!(late <= 3, "{late} of 36");
}

#[test]
fn dark_reading_that_rests_is_named_within_10_ms() {
    for column in 0..COLS {
        let mut finger = Fingertip::new();
        finger.held[column] = Some(Code(2_003));
        let lost = Health { dead: COLUMN << column, ..Health::SOUND };
        let scans = finger.until(lost, |_| ());
        assert!(scans <= TEN_MS, "column {column}: {scans}");
        assert!((0..1000).all(|_| finger.next() == lost));
        finger.held[column] = None;
        assert!((0..500).any(|_| finger.next() == Health::SOUND));
    }
    // All that rest together are as sound as one at a rail.
    let mut finger = Fingertip::new();
    finger.held = [Some(Code(2_003)); COLS];
    finger.rests(1000);
    let mut finger = finger.restarted();
    finger.held = [Some(Code(0)), None, None, None];
    finger.rests(1000);
    // Nor is one that rests just above three at the rail.
    let mut finger = finger.restarted();
    finger.held = [0, 0, 0, 1].map(|code| Some(Code(code)));
    finger.rests(1000);
}

#[test]
fn reading_that_rests_beside_a_movement_is_not_noisy() {
    let mut finger = Fingertip::new();
    for scan in 0..200_000 {
        // A short touch, because a longer movement teaches that more is usual.
        let touch = (scan % 500).min(60);
        let [_, moving @ ..] = &mut finger.lit;
        *moving = [1_500.0 * (1.0 - f32::cos(touch as f32 * 0.1047)); TAXELS - 1];
        assert_eq!(finger.next(), Health::SOUND, "scan {scan}");
    }
}

#[test]
fn movement_between_lost_scans_is_no_noise() {
    let mut finger = Fingertip::new();
    for scan in 0..100_000 {
        // Four short touches, of which single scans come.
        let touched = scan % 500 < 16 && scan % 4 == 1;
        finger.lit = core::array::from_fn(|k| match (touched, k) {
            (false, _) => 0.0,
            (true, 5) => 3_000.0,
            (true, _) => 1_000.0,
        });
        finger.watch.interrupt();
        assert_eq!(finger.next(), Health::SOUND, "scan {scan}");
    }
}

#[test]
fn noisy_dark_reading_is_named_in_flickering_light() {
    for column in 0..COLS {
        let mut finger = Fingertip::new().restarted();
        let flicker = |finger: &mut Fingertip, scan: usize| {
            let light = 200.0 * f32::sin(scan as f32 * 0.157);
            finger.dark = [light; COLS];
            finger.lit = [light; TAXELS];
        };
        for scan in 0..10_000 {
            flicker(&mut finger, scan);
            assert_eq!(finger.next(), Health::SOUND, "scan {scan}");
        }
        let lost = Health { dead: COLUMN << column, ..Health::SOUND };
        let mut scan = 10_000;
        finger.until(lost, |finger| {
            flicker(finger, scan);
            finger.dark[column] += 10.0 * CODES * noise(&mut finger.random);
            scan += 1;
        });
    }
}

#[test]
fn noise_that_ends_is_forgotten_at_rest() {
    let mut finger = Fingertip::new();
    finger.until(taxel(3), |finger| finger.lit[3] = 50.0 * CODES * noise(&mut finger.random));
    finger.lit[3] = 0.0;
    let left = (0..500).filter(|_| finger.next() != Health::SOUND).count();
    assert!(left <= usize::from(QUIET) + 4, "{left}");
}

#[test]
fn step_of_one_reading_is_named_at_once_and_lasts() {
    for k in 0..TAXELS {
        let mut finger = Fingertip::new();
        let scans = finger.until(taxel(k), |finger| finger.lit[k] = 800.0);
        assert!(scans <= usize::from(TURN), "taxel {k}: {scans}");
        for scan in 0..1000 {
            assert_eq!(finger.next(), taxel(k), "scan {scan}");
        }
    }
}

#[test]
fn step_back_ends_the_doubt_in_a_touch() {
    let mut finger = Fingertip::new();
    finger.touched = true;
    finger.lit.iter_mut().for_each(|lit| *lit = 3_000.0);
    finger.dark.iter_mut().for_each(|dark| *dark = 3_000.0);
    finger.until(taxel(9), |finger| finger.lit[9] = 4_000.0);
    assert!((0..500).all(|_| finger.next() == taxel(9)));
    finger.lit[9] = 3_000.0;
    let left = (0..500).filter(|_| finger.next() != Health::SOUND).count();
    assert!((60..70).contains(&left), "{left}");
}

#[test]
fn neighbours_that_change_places_are_both_named() {
    let mut finger = Fingertip::new();
    let both = Health { dead: 0b110, ..Health::SOUND };
    finger.until(both, |finger| (finger.lit[1], finger.lit[2]) = (700.0, -700.0));
    let mut finger = Fingertip::new();
    (finger.lit[1], finger.lit[2]) = (700.0, 500.0);
    finger.rests(100);
}

#[test]
fn row_or_column_that_jumps_is_named_and_lasts() {
    for line in 0..4 {
        for (taxels, step) in [(0b1111 << (4 * line), 4), (0x1111 << line, 1)] {
            let mut finger = Fingertip::new();
            let lost = Health { dead: taxels, ..Health::SOUND };
            let scans = finger.until(lost, |finger| {
                let own = |k: &usize| taxels >> k & 1 == 1;
                (0..TAXELS).filter(own).for_each(|k| finger.lit[k] = -0.05 * LIT);
            });
            assert!(scans <= usize::from(TURN), "line {line}, {step}: {scans}");
            (0..1000).for_each(|_| assert_eq!(finger.next(), lost));
        }
    }
}

#[test]
fn rows_or_columns_that_change_places_are_named() {
    let tilt = |at: usize| 900.0 * at as f32;
    for (a, b) in [(0, 1), (1, 3), (2, 3)] {
        for step in [1, 4] {
            let mut finger = Fingertip::new();
            let line = |k: usize| if step == 4 { k / COLS } else { k % COLS };
            finger.lit = core::array::from_fn(|k| tilt(line(k)));
            let taxels = (0..TAXELS).filter(|k| [a, b].contains(&line(*k)));
            let lost = Health { dead: taxels.map(|k| 1 << k).sum(), ..Health::SOUND };
            (0..200).for_each(|_| _ = finger.next());
            let scans = finger.until(lost, |finger| {
                let other = |at| {
                    if at == a {
                        b
                    } else if at == b {
                        a
                    } else {
                        at
                    }
                };
                finger.lit = core::array::from_fn(|k| tilt(other(line(k))));
            });
            assert!(scans <= usize::from(TURN), "{a}, {b}, {step}: {scans}");
        }
    }
}

#[test]
fn dark_reading_names_its_column() {
    let mut finger = Fingertip::new();
    let column = Health { dead: 0x2222, ..Health::SOUND };
    finger.until(column, |finger| finger.dark[1] = 40.0 * CODES);
}

#[test]
fn light_force_and_a_rippling_supply_are_no_jumps() {
    let mut finger = Fingertip::new();
    for scan in 0..20_000 {
        let swing = f32::sin(scan as f32 * 0.16);
        finger.dark = [1.0, 1.1, 0.9, 1.05].map(|gain| 1_500.0 * gain * swing);
        for (k, lit) in finger.lit.iter_mut().enumerate() {
            // A touch that moves over the pad, up to 300 codes in two scans.
            let touch = f32::sin(scan as f32 * 0.011).max(0.0) * 8_000.0;
            let (x, y) = (f32::sin(scan as f32 * 7e-4), f32::cos(scan as f32 * 5e-4));
            let (dx, dy) = ((k % COLS) as f32 - 1.5 - x, (k / COLS) as f32 - 1.5 - y);
            *lit = touch / (1.0 + dx * dx + dy * dy) + 1_500.0 * swing;
        }
        for (i, arms) in finger.midpoints.iter_mut().enumerate() {
            let (force, ripple) = (6_000.0 * f32::sin(scan as f32 * 0.02), 500.0 * swing);
            let gain = 1.0 - 0.02 * i as f32;
            *arms = [force, -force, 0.5 * force, -0.5 * force].map(|u| gain * (u + ripple));
        }
        assert_eq!(finger.next(), Health::SOUND, "scan {scan}");
    }
}

#[test]
fn sensors_are_not_judged_if_one_is_missing() {
    for sensors in 1..SENSORS {
        let mut finger = Fingertip::new();
        finger.sensors = sensors;
        finger.rests(20_000);
        finger.midpoints[0][0] = 2_000.0;
        finger.rests(100);
    }
}

#[test]
fn wrong_code_in_a_moving_touch_is_forgotten() {
    for sensors in [0, SENSORS] {
        let mut finger = Fingertip::new();
        (finger.sensors, finger.touched) = (sensors, true);
        let light = |scan: usize| 2_000.0 * f32::sin(scan as f32 * 0.03);
        let mut doubted = 0;
        for scan in 0..2_000 {
            for (k, lit) in finger.lit.iter_mut().enumerate() {
                let (dx, dy) = ((k % COLS) as f32 - 1.5, (k / COLS) as f32 - 1.5);
                *lit = light(scan) / (1.0 + dx * dx + dy * dy);
            }
            if scan == 1_000 {
                finger.lit[5] = 9_000.0;
            }
            doubted += usize::from(finger.next() != Health::SOUND);
        }
        assert!((1..=80).contains(&doubted), "{sensors} sensors: {doubted}");
    }
}

#[test]
fn more_noise_than_the_record_knows_is_learned() {
    let mut finger = Fingertip::new().restarted();
    finger.codes = 3.0 * CODES;
    finger.rests(200_000);
    let mut finger = Fingertip::new().restarted();
    finger.louder = [1.0, 3.0, 1.0, 2.0];
    finger.rests(400_000);
}

#[test]
fn finger_with_a_fault_from_the_start_is_judged_like_others() {
    let dead = Health { dead: 1 << 6, ..Health::SOUND };
    let broken = Health { bridge_faults: 1 << 2, ..Health::SOUND };
    for known in [dead, broken] {
        let mut finger = Fingertip::new().restarted();
        finger.known = known;
        finger.rests(20_000);
        let named = Health { dead: known.dead | 1 << 9, ..known };
        finger.until(named, |finger| finger.lit[9] = 800.0);
    }
    // A sensor that is plugged in later.
    let mut finger = Fingertip::new().restarted();
    finger.sensors = SENSORS - 1;
    finger.rests(2_000);
    finger.sensors = SENSORS;
    finger.rests(20_000);
    finger.until(sensor(3), |finger| finger.midpoints[3][0] = 600.0);
}

#[test]
fn scans_that_repeat_are_no_jumps() {
    for repeats in [2, 10, 50] {
        let mut finger = Fingertip::new().restarted();
        finger.repeats = repeats;
        finger.rests(200_000 / repeats);
    }
}

#[test]
fn lasting_step_is_not_forgotten_with_another_jump() {
    let mut finger = Fingertip::new();
    finger.touched = true;
    finger.until(taxel(3), |finger| finger.lit[3] = 1_500.0);
    // A fast touch in which another taxel jumps, so that far more is allowed.
    let both = Health { dead: 1 << 3 | 1 << 12, ..Health::SOUND };
    finger.until(both, |finger| {
        finger.lit[12] += 10_000.0;
        finger.lit[9] += 500.0;
    });
    (finger.lit[9], finger.lit[12]) = (0.0, 0.0);
    let last = (0..500).map(|_| finger.next()).last();
    assert_eq!(last, Some(taxel(3)));
}

#[test]
fn clipping_taxels_are_no_jumps() {
    let mut watch = JumpWatch::default();
    let bias =
        Bias { taxels: Some(TaxelBias { level: [0.0; TAXELS], noise: 1e-4 }), ..Bias::default() };
    for scan in 0..4_000u32 {
        // All but one are clipped, and that one follows the light.
        let light = if scan % 400 < 200 { 40_000 } else { 60_000 };
        let (mut lit, mut signals) = ([[Code(65_535); COLS]; 4], Signals::default());
        lit[2][1] = Code(light);
        signals.health.saturated = !(1 << 9);
        signals.taxels = Some([0.0; TAXELS]);
        let codes = Codes {
            full_scale: FullScale::BITS_16,
            taxels: Some(TaxelCodes { lit, dark: [Code(9_000); COLS] }),
            bridges: [None; SENSORS],
            reference: None,
            temperature: None,
        };
        watch.update(&codes, &mut signals, &bias, false);
        assert_eq!((signals.health.dead, signals.health.bridge_faults), (0, 0));
    }
}

#[test]
fn light_that_flickers_faster_than_scans_is_no_fault() {
    // Light from above or from one side, in a lamp's pulses that scans meet by chance.
    for share in [[1.0; COLS], [3.0, 1.0, 1.0, 1.0], [5.0, 1.0, 1.0, 1.0]] {
        let mut finger = Fingertip::new();
        for scan in 0..20_000 {
            let light = 25.0 * CODES * noise(&mut finger.random);
            finger.dark = share.map(|share| share * light);
            finger.lit = core::array::from_fn(|k| finger.dark[k % COLS]);
            assert_eq!(finger.next(), Health::SOUND, "{share:?}, scan {scan}");
        }
    }
}

/// Midpoints of which one moves far more than the others, so that their sum rests.
fn mostly_one(by: f32) -> [f32; 4] {
    [by, -by / 3.0, -by / 3.0, -by / 3.0]
}

#[test]
fn sensor_under_stick_slip_is_no_fault() {
    for creep in [20, 40, 100] {
        let mut finger = Fingertip::new();
        for scan in 0..200_000 {
            // A midpoint creeps away, and comes back at once.
            let at = 120.0 * CODES * (scan % creep) as f32 / creep as f32;
            finger.midpoints[0] = mostly_one(at);
            assert_eq!(finger.next(), Health::SOUND, "{creep} scans, scan {scan}");
        }
    }
}

#[test]
fn two_noisy_readings_are_both_named() {
    for [one, other] in [[1, 2], [3, 9]] {
        let mut finger = Fingertip::new();
        finger.until(Health { dead: 1 << one | 1 << other, ..Health::SOUND }, |finger| {
            for k in [one, other] {
                finger.lit[k] = 10.0 * CODES * noise(&mut finger.random);
            }
        });
    }
}

#[test]
fn noise_is_not_told_beside_a_clipped_taxel_or_a_faulty_sensor() {
    let mut finger = Fingertip::new();
    finger.known = Health { saturated: 1 << 5, bridge_faults: 1, ..Health::SOUND };
    for scan in 0..2_000 {
        finger.lit[9] = 10.0 * CODES * noise(&mut finger.random);
        finger.midpoints[2] = mostly_one(10.0 * CODES * noise(&mut finger.random));
        assert_eq!(finger.next(), finger.known, "scan {scan}");
    }
}

#[test]
fn force_that_shakes_is_no_noise_of_a_reading() {
    // A slide shakes the whole finger at once; each sensor has a midpoint that feels most of it.
    let mut finger = Fingertip::new();
    for scan in 0..200_000 {
        let slides = scan % 700 < 200;
        let force = if slides { 12.0 * CODES * noise(&mut finger.random) } else { 0.0 };
        finger.midpoints = [0, 1, 2, 3]
            .map(|sensor| core::array::from_fn(|i| if i == sensor { force } else { 0.3 * force }));
        finger.lit = core::array::from_fn(|k| if k % 5 == 0 { force } else { 0.3 * force });
        assert_eq!(finger.next(), Health::SOUND, "scan {scan}");
    }
}
