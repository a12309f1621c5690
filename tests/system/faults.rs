//! Flags of every simulated fault, from the scene to the estimate, at every full scale of a board.
//!
//! The last test lists the faults that codes alone do not show.

use taxel::condition::Health;
use taxel::finger::{Estimate, Finger};
use taxel::frame::Status;
use taxel::scan::{Midpoints, Scan};
use taxel::units::{Code, FullScale};
use taxel_sim::scene::{Changes, Kind, built_in};
use taxel_sim::{Scene, Simulator};

/// Effects of every scene here.
const EFFECTS: &str = "effects = ['noise', 'ambient', 'flicker', 'gain-spread', 'optical-crosstalk', \
                       'bridge-mismatch', 'bridge-crosstalk']\n";
const BIAS: usize = 300;
/// Scan with which a fault begins; scans come at 1 kHz.
const BEGIN: usize = 1000;

/// Converter of a board.
#[derive(Clone, Copy, Debug)]
struct Converter {
    /// Highest code.
    top: u16,
    /// Bits of the simulated converter.
    bits: u8,
    /// Scans after which a stuck channel is flagged while the detector does not know the noise yet.
    watched: usize,
}

/// Single conversions, sums of eight, and readings scaled to 16 bits.
const CONVERTERS: [Converter; 3] = [
    Converter { top: 4095, bits: 12, watched: 2000 },
    Converter { top: 8 * 4095, bits: 16, watched: 600 },
    Converter { top: u16::MAX, bits: 16, watched: 600 },
];

impl Converter {
    /// Scan with which a fault ends.
    fn end(self) -> usize {
        BEGIN + self.watched + 500
    }

    /// Scans of a finger that nothing touches.
    fn scans(self, more: &str) -> impl Iterator<Item = Scan> {
        let duration = 1e-3 * (self.end() + self.watched + 500) as f64;
        let scene = format!(
            "{EFFECTS}[scan]\nrate_hz = 1000\nduration_s = {duration}\n[device]\nbits = {}\n{more}",
            self.bits
        );
        let scene = Scene::parse("fault.toml", &scene).unwrap();
        Simulator::new(&scene, 3).map(move |sample| self.scaled(sample.scan))
    }

    /// Scales codes to this full scale.
    fn scaled(self, mut scan: Scan) -> Scan {
        let codes = &mut scan.codes;
        let from = u32::from(codes.full_scale.top().0);
        let to = |code: &mut Code| {
            code.0 = ((u32::from(code.0) * u32::from(self.top) + from / 2) / from) as u16;
        };
        codes.full_scale = FullScale::new(self.top).unwrap();
        let taxels = codes.taxels.as_mut().unwrap();
        taxels.lit.as_flattened_mut().iter_mut().chain(&mut taxels.dark).for_each(to);
        for Midpoints { a, b, c, d } in codes.bridges.iter_mut().flatten() {
            [a, b, c, d].into_iter().for_each(to);
        }
        codes.reference.iter_mut().chain(&mut codes.temperature).for_each(to);
        scan
    }

    /// Estimates of a finger without a calibration; the finger first takes its bias.
    fn estimates(self, more: &str) -> Vec<Estimate> {
        let (finger, mut state) = Finger::new(None);
        state.take_bias(BIAS as u16);
        self.scans(more).map(|scan| finger.estimate(&mut state, &scan)).collect()
    }

    /// The fault's table in the scene.
    fn table(self, keys: &str) -> String {
        // Between two scans, whatever the rounding.
        let until = 1e-3 * (self.end() as f64 - 0.5);
        format!("[[fault]]\nat_s = 1\nuntil_s = {until}\n{keys}\n")
    }

    fn fault(self, keys: &str) -> Vec<Estimate> {
        self.estimates(&self.table(keys))
    }

    /// Checks for exactly `faults` from `late` scans after the fault's beginning until its end;
    /// returns its last estimate.
    ///
    /// No fault is flagged before it, nor from `late` scans after its end on, or from those in
    /// which a channel that has jumped stays in doubt.
    fn check_flags(self, keys: &str, late: usize, faults: &[Status]) -> Estimate {
        let expected = faults.iter().fold(0, |all, one| all | one.0);
        let estimates = self.fault(keys);
        for (t, estimate) in estimates.iter().enumerate().skip(BIAS) {
            let found = estimate.status.0 & FAULTS.0;
            if (BEGIN + late..self.end()).contains(&t) {
                assert_eq!(found, expected, "{keys} at {t} ms, {self:?}");
            } else if !(BEGIN..self.end() + late.max(DOUBTED)).contains(&t) {
                assert_eq!(found, 0, "{keys} at {t} ms, {self:?}");
            }
        }
        estimates[self.end() - 1]
    }
}

/// Scans for which a channel that has jumped back stays in doubt, at most.
const DOUBTED: usize = 72;

const FAULTS: Status = Status::SATURATED
    .union(Status::DEAD_TAXEL)
    .union(Status::BRIDGE_FAULT)
    .union(Status::STUCK_CHANNEL)
    .union(Status::OUT_OF_RANGE);

/// Checks a fault of light or voltage, which its first frame flags, at every full scale.
fn check_flags_at_once(keys: &str, faults: &[Status]) -> Estimate {
    CONVERTERS.map(|converter| converter.check_flags(keys, 0, faults))[2]
}

const COLUMN_2: u16 = 1 << 2 | 1 << 6 | 1 << 10 | 1 << 14;

#[test]
fn healthy_finger_reports_no_fault() {
    for converter in CONVERTERS {
        let estimates = converter.estimates("");
        assert!(estimates.iter().all(|estimate| !estimate.status.intersects(FAULTS)));
    }
}

#[test]
fn dead_led_or_transistor_is_a_dead_taxel() {
    for kind in ["dead-led", "open-channel"] {
        let keys = format!("kind = '{kind}'\nchannel = 'r1c2'");
        let estimate = check_flags_at_once(&keys, &[Status::DEAD_TAXEL]);
        assert_eq!(estimate.signals.health.dead, 1 << 6);
        assert!(estimate.force.z.is_err());
    }
}

#[test]
fn faulty_column_is_four_dead_taxels() {
    for kind in ["open-channel", "shorted-channel", "stuck-channel"] {
        let keys = format!("kind = '{kind}'\nchannel = 'c2'");
        for converter in CONVERTERS {
            let estimate = converter.fault(&keys)[converter.end() - 1];
            assert_eq!(estimate.signals.health.dead, COLUMN_2, "{kind}, {converter:?}");
            assert!(estimate.status.contains(Status::DEAD_TAXEL));
            // At the voltage where the channel stuck, the reading does not change either.
            let stuck = estimate.status.contains(Status::STUCK_CHANNEL);
            assert_eq!(stuck, kind == "stuck-channel", "{converter:?}");
        }
    }
}

#[test]
fn saturated_column_is_four_clipped_taxels() {
    // Lit and dark codes are equal, so the taxel shows no light either.
    let saturated = [Status::SATURATED, Status::DEAD_TAXEL];
    let estimate = check_flags_at_once("kind = 'saturated-adc'\nchannel = 'c2'", &saturated);
    assert_eq!(estimate.signals.health.saturated, COLUMN_2);
}

#[test]
fn broken_arm_or_midpoint_flags_that_sensor() {
    let arms = (1..=8).map(|r| format!("kind = 'broken-arm'\nchannel = 's2_r{r}'"));
    let rails = ["shorted-channel", "saturated-adc"]
        .into_iter()
        .flat_map(|kind| ["a", "d"].map(|m| format!("kind = '{kind}'\nchannel = 's2_{m}'")));
    for keys in arms.chain(rails) {
        let estimate = check_flags_at_once(&keys, &[Status::BRIDGE_FAULT]);
        assert_eq!(estimate.signals.health.bridge_faults, 1 << 2, "{keys}");
        assert!(!estimate.status.contains(Status::CONTACT), "{keys}");
    }
}

#[test]
fn stuck_reading_is_flagged_in_time() {
    for converter in CONVERTERS {
        let stuck = |channel: &str, with| {
            let keys = format!("kind = 'stuck-channel'\nchannel = '{channel}'");
            converter.check_flags(&keys, converter.watched, &[Status::STUCK_CHANNEL, with])
        };
        assert_eq!(stuck("r1c2", Status::DEAD_TAXEL).signals.health.dead, 1 << 6);
        let midpoint = stuck("s3_b", Status::BRIDGE_FAULT);
        assert_eq!(midpoint.signals.health.bridge_faults, 1 << 3);
    }
}

#[test]
fn supply_dip_by_a_quarter_flags_the_bridges() {
    let dip = |ratio: f64| {
        format!(
            "[electronics]\nratiometric = false\n[[fault]]\nat_s = 1\nkind = 'supply-dip'\nratio = {ratio}\n"
        )
    };
    for converter in CONVERTERS {
        let down = converter.estimates(&dip(0.75))[1500];
        assert_eq!(down.signals.health.bridge_faults, 0b1111);
        // A smaller dip stays undetected.
        let down = converter.estimates(&dip(0.9))[1500];
        assert_eq!(down.signals.health.bridge_faults, 0);
    }
}

#[test]
fn columns_that_change_places_are_dead_taxels() {
    for converter in CONVERTERS {
        let keys = "kind = 'swapped-columns'\nchannel = 'c0'\nwith = 'c3'";
        let estimate = converter.check_flags(keys, 4, &[Status::DEAD_TAXEL]);
        let both = COLUMN_2 >> 2 | COLUMN_2 << 1;
        assert_eq!(estimate.signals.health.dead & !both, 0);
    }
}

/// Faults that codes alone do not show, so that silence does not prove health.
///
/// The codes hold the reference channel, but no record holds its expected value.
#[test]
fn ratiometric_dip_and_stuck_reference_stay_undetected() {
    for keys in ["kind = 'supply-dip'\nratio = 0.8", "kind = 'stuck-channel'\nchannel = 'vref'"] {
        let estimate = check_flags_at_once(keys, &[]);
        let moved = estimate.signals.taxels.unwrap().iter().any(|c| c.abs() > 0.01);
        assert!(moved || keys.contains("vref"), "{keys} changes what is measured");
    }
    let sixteen = CONVERTERS[2];
    let dip: Vec<_> = sixteen.scans(&sixteen.table("kind = 'supply-dip'\nratio = 0.8")).collect();
    let reference = |t: usize| dip[t].codes.full_scale.ratio(dip[t].codes.reference.unwrap()).0;
    assert!((reference(500) - 0.5).abs() < 1e-3 && (reference(1500) - 0.625).abs() < 1e-3);
}

/// Tests of every built-in scene.
mod endurance {
    use super::*;

    #[test]
    fn slow_scans_of_a_sound_finger_have_no_faulty_channel() {
        // The slower the scan, the further a touch moves until the next one.
        let changes = Changes { reference: true, set: vec!["scan.rate_hz=250".into()] };
        for (name, _) in built_in() {
            let own = Scene::load(name).unwrap();
            if own.faults().next().is_some() || own.device.kind != Kind::Taxel4x4 {
                continue;
            }
            let scene = Scene::load_changed(name, &changes).unwrap();
            let (finger, mut state) = Finger::new(None);
            for (n, sample) in Simulator::new(&scene, 41).enumerate() {
                let Estimate { signals, status, .. } = finger.estimate(&mut state, &sample.scan);
                let Health { dead, bridge_faults, .. } = signals.health;
                assert_eq!((dead, bridge_faults), (0, 0), "{name}: scan {n}: {status:?}");
            }
        }
    }
}
