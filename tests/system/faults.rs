//! Every fault that the simulator knows, from the scene through the codes to what the finger says of it,
//! and the faults that codes alone do not give away.

use taxel::finger::{Estimate, Finger};
use taxel::frame::Status;
use taxel::scan::Scan;
use taxel_sim::{Scene, Simulator};

/// The finger of the built-in scenes, unloaded for a second, then with the fault, then without again.
const SCENE: &str = "effects = ['noise', 'ambient', 'flicker', 'gain-spread', 'optical-crosstalk', \
                     'bridge-mismatch', 'bridge-crosstalk']\n[scan]\nrate_hz = 1000\nduration_s = 3\n";
const BIAS: usize = 300;

/// A scan a millisecond.
fn scans(more: &str) -> impl Iterator<Item = Scan> {
    let scene = Scene::parse("fault.toml", &format!("{SCENE}{more}")).unwrap();
    Simulator::new(&scene, 3).map(|sample| sample.scan)
}

/// Estimates of a finger without a calibration that takes its bias first.
fn estimates(more: &str) -> Vec<Estimate> {
    let (finger, mut state) = Finger::new(None);
    state.take_bias(BIAS as u16);
    scans(more).map(|scan| finger.estimate(&mut state, &scan)).collect()
}

/// The scene's fault, from the first to the second second.
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

/// From `from` ms on every frame of the fault says exactly `faults`; before it came and `again` ms after
/// it went, nothing is wrong. The last estimate of the fault.
fn says(keys: &str, from: usize, faults: &[Status], again: usize) -> Estimate {
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

/// A fault that changes the light or a voltage shows in its first frame.
fn says_at_once(keys: &str, faults: &[Status]) -> Estimate {
    says(keys, 1000, faults, 0)
}

const COLUMN_2: u16 = 1 << 2 | 1 << 6 | 1 << 10 | 1 << 14;
/// Two windows of the watch for stuck channels.
const WATCHED: usize = 2 * 256;

#[test]
fn a_finger_without_a_fault_reports_none() {
    assert!(estimates("").iter().all(|estimate| !estimate.status.intersects(FAULTS)));
}

#[test]
fn a_dead_led_or_a_phototransistor_that_is_cut_off_is_a_dead_taxel_and_no_touch() {
    for kind in ["dead-led", "open-channel"] {
        let keys = format!("kind = '{kind}'\nchannel = 'r1c2'");
        let estimate = says_at_once(&keys, &[Status::DEAD_TAXEL]);
        assert_eq!(estimate.signals.health.dead, 1 << 6);
        assert!(estimate.force.z.is_err());
    }
}

#[test]
fn a_column_that_is_open_shorted_or_stuck_is_four_dead_taxels() {
    for kind in ["open-channel", "shorted-channel", "stuck-channel"] {
        let keys = format!("kind = '{kind}'\nchannel = 'c2'");
        let estimate = fault(&keys)[1999];
        assert_eq!(estimate.signals.health.dead, COLUMN_2, "{kind}");
        assert!(estimate.status.contains(Status::DEAD_TAXEL));
        // At the voltage where it stuck it does not change either.
        assert_eq!(estimate.status.contains(Status::STUCK_CHANNEL), kind == "stuck-channel");
    }
}

#[test]
fn a_saturated_column_is_four_clipped_taxels() {
    // Lit and dark read the same, so that there is no light to be seen either.
    let saturated = [Status::SATURATED, Status::DEAD_TAXEL];
    let estimate = says_at_once("kind = 'saturated-adc'\nchannel = 'c2'", &saturated);
    assert_eq!(estimate.signals.health.saturated, COLUMN_2);
}

#[test]
fn a_broken_arm_and_a_midpoint_at_a_rail_are_faults_of_that_sensor() {
    let arms = (1..=8).map(|r| format!("kind = 'broken-arm'\nchannel = 's2_r{r}'"));
    let rails = ["shorted-channel", "saturated-adc"]
        .into_iter()
        .flat_map(|kind| ["a", "d"].map(|m| format!("kind = '{kind}'\nchannel = 's2_{m}'")));
    for keys in arms.chain(rails) {
        let estimate = says_at_once(&keys, &[Status::BRIDGE_FAULT]);
        assert_eq!(estimate.signals.health.bridge_faults, 1 << 2, "{keys}");
        assert!(!estimate.status.contains(Status::CONTACT), "{keys}");
    }
}

#[test]
fn a_reading_stuck_at_a_plausible_code_is_found_and_freed_within_two_windows() {
    let stuck = |channel: &str, with| {
        let keys = format!("kind = 'stuck-channel'\nchannel = '{channel}'");
        says(&keys, 1000 + WATCHED, &[Status::STUCK_CHANNEL, with], WATCHED)
    };
    assert_eq!(stuck("r1c2", Status::DEAD_TAXEL).signals.health.dead, 1 << 6);
    let midpoint = stuck("s3_b", Status::BRIDGE_FAULT);
    assert_eq!(midpoint.signals.health.bridge_faults, 1 << 3);
}

#[test]
fn a_supply_that_the_converter_does_not_follow_shows_in_the_bridges_once_it_is_down_by_a_quarter() {
    let dip = |ratio: f64| {
        format!(
            "[electronics]\nratiometric = false\n[[fault]]\nat_s = 1\nkind = 'supply-dip'\nratio = {ratio}\n"
        )
    };
    let down = estimates(&dip(0.75))[1500];
    assert_eq!(down.signals.health.bridge_faults, 0b1111);
    // Less is not seen.
    assert_eq!(estimates(&dip(0.9))[1500].signals.health.bridge_faults, 0);
}

/// What codes alone do not tell, so that nobody takes the silence for health: the reference channel is in
/// the codes, but no record says what it should read.
#[test]
fn a_dip_that_the_converter_follows_swapped_columns_and_a_floating_midpoint_go_unnoticed() {
    for keys in [
        "kind = 'supply-dip'\nratio = 0.8",
        "kind = 'swapped-columns'\nchannel = 'c0'\nwith = 'c3'",
        "kind = 'open-channel'\nchannel = 's1_b'",
        "kind = 'stuck-channel'\nchannel = 'vref'",
    ] {
        let estimate = says_at_once(keys, &[]);
        let moved = estimate.signals.taxels.unwrap().iter().any(|c| c.abs() > 0.01);
        let bridge = estimate.signals.bridges[1].unwrap()[0].abs() > 0.005;
        assert!(moved || bridge || keys.contains("vref"), "{keys} changes what is measured");
    }
    let dip: Vec<_> = scans(&table("kind = 'supply-dip'\nratio = 0.8")).collect();
    let reference = |t: usize| dip[t].codes.full_scale.ratio(dip[t].codes.reference.unwrap()).0;
    assert!((reference(500) - 0.5).abs() < 1e-3 && (reference(1500) - 0.625).abs() < 1e-3);
}
