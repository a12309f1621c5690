//! Flags of every simulated fault, from the scene to the estimate.
//!
//! The last test lists the faults that codes alone do not show.

use taxel::finger::{Estimate, Finger};
use taxel::frame::Status;
use taxel::scan::Scan;
use taxel_sim::{Scene, Simulator};

/// Scene of a built-in finger: unloaded, from 1 s to 2 s with the fault, then without.
const SCENE: &str = "effects = ['noise', 'ambient', 'flicker', 'gain-spread', 'optical-crosstalk', \
                     'bridge-mismatch', 'bridge-crosstalk']\n[scan]\nrate_hz = 1000\nduration_s = 3\n";
const BIAS: usize = 300;

/// Scans at 1 kHz.
fn scans(more: &str) -> impl Iterator<Item = Scan> {
    let scene = Scene::parse("fault.toml", &format!("{SCENE}{more}")).unwrap();
    Simulator::new(&scene, 3).map(|sample| sample.scan)
}

/// Estimates of a finger without a calibration; the finger first takes its bias.
fn estimates(more: &str) -> Vec<Estimate> {
    let (finger, mut state) = Finger::new(None);
    state.take_bias(BIAS as u16);
    scans(more).map(|scan| finger.estimate(&mut state, &scan)).collect()
}

/// The fault's table in the scene, from 1 s to 2 s.
fn table(keys: &str) -> String {
    format!("[[fault]]\nat_s = 1\nuntil_s = 2\n{keys}\n")
}

fn fault(keys: &str) -> Vec<Estimate> {
    estimates(&table(keys))
}

const FAULTS: Status = Status::SATURATED
    .union(Status::DEAD_TAXEL)
    .union(Status::BRIDGE_FAULT)
    .union(Status::STUCK_CHANNEL)
    .union(Status::OUT_OF_RANGE);

/// Checks for exactly `faults` from `from` ms until the end of the fault; returns its last
/// estimate.
///
/// No fault is flagged before it, nor from `again` ms after its end on.
fn check_flags(keys: &str, from: usize, faults: &[Status], again: usize) -> Estimate {
    let expected = faults.iter().fold(0, |all, one| all | one.0);
    let estimates = fault(keys);
    for (t, estimate) in estimates.iter().enumerate().skip(BIAS) {
        let found = estimate.status.0 & FAULTS.0;
        if (from..2000).contains(&t) {
            assert_eq!(found, expected, "{keys} at {t} ms");
        } else if !(1000..2000 + again).contains(&t) {
            assert_eq!(found, 0, "{keys} at {t} ms");
        }
    }
    estimates[1999]
}

/// Checks a fault of light or voltage, which its first frame flags.
fn check_flags_at_once(keys: &str, faults: &[Status]) -> Estimate {
    check_flags(keys, 1000, faults, 0)
}

const COLUMN_2: u16 = 1 << 2 | 1 << 6 | 1 << 10 | 1 << 14;
/// Two windows of the detector for stuck channels, in scans.
const WATCHED: usize = 2 * 256;

#[test]
fn healthy_finger_reports_no_fault() {
    assert!(estimates("").iter().all(|estimate| !estimate.status.intersects(FAULTS)));
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
        let estimate = fault(&keys)[1999];
        assert_eq!(estimate.signals.health.dead, COLUMN_2, "{kind}");
        assert!(estimate.status.contains(Status::DEAD_TAXEL));
        // At the voltage where the channel stuck, the reading does not change either.
        assert_eq!(estimate.status.contains(Status::STUCK_CHANNEL), kind == "stuck-channel");
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
fn stuck_reading_is_flagged_within_two_windows() {
    let stuck = |channel: &str, with| {
        let keys = format!("kind = 'stuck-channel'\nchannel = '{channel}'");
        check_flags(&keys, 1000 + WATCHED, &[Status::STUCK_CHANNEL, with], WATCHED)
    };
    assert_eq!(stuck("r1c2", Status::DEAD_TAXEL).signals.health.dead, 1 << 6);
    let midpoint = stuck("s3_b", Status::BRIDGE_FAULT);
    assert_eq!(midpoint.signals.health.bridge_faults, 1 << 3);
}

#[test]
fn supply_dip_by_a_quarter_flags_the_bridges() {
    let dip = |ratio: f64| {
        format!(
            "[electronics]\nratiometric = false\n[[fault]]\nat_s = 1\nkind = 'supply-dip'\nratio = {ratio}\n"
        )
    };
    let down = estimates(&dip(0.75))[1500];
    assert_eq!(down.signals.health.bridge_faults, 0b1111);
    // A smaller dip stays undetected.
    assert_eq!(estimates(&dip(0.9))[1500].signals.health.bridge_faults, 0);
}

/// Faults that codes alone do not show, so that silence does not prove health.
///
/// The codes hold the reference channel, but no record holds its expected value.
#[test]
fn ratiometric_dip_and_swaps_stay_undetected() {
    for keys in [
        "kind = 'supply-dip'\nratio = 0.8",
        "kind = 'swapped-columns'\nchannel = 'c0'\nwith = 'c3'",
        "kind = 'open-channel'\nchannel = 's1_b'",
        "kind = 'stuck-channel'\nchannel = 'vref'",
    ] {
        let estimate = check_flags_at_once(keys, &[]);
        let moved = estimate.signals.taxels.unwrap().iter().any(|c| c.abs() > 0.01);
        let bridge = estimate.signals.bridges[1].unwrap()[0].abs() > 0.005;
        assert!(moved || bridge || keys.contains("vref"), "{keys} changes what is measured");
    }
    let dip: Vec<_> = scans(&table("kind = 'supply-dip'\nratio = 0.8")).collect();
    let reference = |t: usize| dip[t].codes.full_scale.ratio(dip[t].codes.reference.unwrap()).0;
    assert!((reference(500) - 0.5).abs() < 1e-3 && (reference(1500) - 0.625).abs() < 1e-3);
}
