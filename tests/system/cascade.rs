//! Estimators that each scene runs on the noisy virtual finger.
//!
//! A stage stays steady at its threshold, and one part of the finger replaces a faulty one.

use std::path::Path;

use taxel::calibration::Calibration;
use taxel::estimate::Force;
use taxel::finger::{Estimate, Finger, Wanted};
use taxel::frame::{Fields, Status};
use taxel::measured::NoValue;
use taxel_files::trace::Sample;
use taxel_sim::{Scene, Simulator};

const EFFECTS: &str = "effects = ['noise', 'ambient', 'flicker', 'gain-spread', 'optical-crosstalk', \
                       'bridge-mismatch', 'bridge-crosstalk']\n";

fn record() -> Calibration {
    let path = "../cli/assets/virtual-finger.cal.toml";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    taxel_files::calibration::read(&path).unwrap()
}

/// Runs a scene at 1 kHz; returns every scan with the estimate under `record` of what is wanted.
fn estimates_of(
    record: Calibration,
    duration: f64,
    acts: &str,
    wanted: impl Fn(usize) -> Wanted,
) -> Vec<(Sample, Estimate)> {
    let (finger, mut state) = Finger::new(Some(record));
    let text = format!(
        "{EFFECTS}[scan]\nrate_hz = 1000\nduration_s = {duration}\n[device]\nseed = 1\n\
         [indenter]\nradius_mm = 6\n[friction]\nmu = 0.8\n{acts}"
    );
    let scene = Scene::parse("cascade.toml", &text).unwrap();
    let samples = Simulator::new(&scene, 1).enumerate();
    let mut estimate = Estimate::NOTHING;
    samples
        .map(|(i, sample)| {
            finger.update(&mut estimate, &mut state, &sample.scan, wanted(i));
            (sample, estimate)
        })
        .collect()
}

/// Runs a scene at 1 kHz; returns every scan with its whole estimate under `record`.
fn estimates_by(record: Calibration, duration: f64, acts: &str) -> Vec<(Sample, Estimate)> {
    estimates_of(record, duration, acts, |_| Wanted::ALL)
}

/// Runs a scene at 1 kHz under the virtual finger's own record.
fn estimates(duration: f64, acts: &str) -> Vec<(Sample, Estimate)> {
    estimates_by(record(), duration, acts)
}

fn press(x: f64, y: f64, [fx, fz]: [f64; 2], hold: f64) -> String {
    format!(
        "[[press]]\nat_s = 0.3\nx_mm = {x}\ny_mm = {y}\nfz_n = {fz}\nfx_n = {fx}\nrise_s = 0.1\n\
         hold_s = {hold}\nfall_s = 0.1\n"
    )
}

/// Frames of the middle third of a hold of `hold` seconds, where shear is steady.
fn held(hold: f64, acts: &str) -> Vec<Estimate> {
    let frames = estimates(hold + 0.6, acts);
    let [from, until] = [1.0, 2.0].map(|third| (1000.0 * (0.4 + third * hold / 3.0)) as usize);
    frames[from..until].iter().map(|(_, estimate)| *estimate).collect()
}

fn all(frames: &[Estimate], ran: &[Status], not: &[Status]) {
    for frame in frames {
        assert!(ran.iter().all(|bit| frame.status.contains(*bit)), "{:?}", frame.status);
        assert!(!not.iter().any(|bit| frame.status.contains(*bit)), "{:?}", frame.status);
    }
}

#[test]
fn scene_runs_its_own_stages_only() {
    use Status as S;
    let beyond_one = [S::RAN_PAIR, S::NOT_SINGLE, S::DISAGREE];
    let untouched = estimates(0.3, "");
    let untouched: Vec<Estimate> = untouched[50..].iter().map(|(_, estimate)| *estimate).collect();
    let ran = [S::RAN_MODEL, S::RAN_SHEAR, S::RAN_ARRAY, S::RAN_SLIP];
    all(&untouched, &[S::RAN_SENSORS], &[ran.as_slice(), &beyond_one].concat());

    let pressed = held(0.6, &press(0.6, -0.4, [0.0, 1.0], 0.6));
    let always = [S::RAN_MODEL, S::RAN_ARRAY, S::RAN_SLIP];
    all(&pressed, &always, &[&[S::RAN_SHEAR][..], &beyond_one].concat());

    let sheared = held(0.6, &press(0.6, -0.4, [0.2, 1.0], 0.6));
    all(&sheared, &[&[S::RAN_SHEAR][..], &always].concat(), &beyond_one);

    let two = press(-3.0, -0.4, [0.0, 0.6], 0.6) + &press(3.0, 0.3, [0.0, 0.4], 0.6);
    let two = held(0.6, &two);
    all(&two, &[&[S::RAN_PAIR, S::NOT_SINGLE][..], &always].concat(), &[S::DISAGREE]);
    assert!(two.iter().all(|frame| frame.contacts.is_ok()));
}

#[test]
fn force_known_by_array_runs_no_matrix() {
    let fields = Fields::FORCE | Fields::TORSION | Fields::SENSORS | Fields::SIGNALS;
    let wanted = |_| Wanted { fields, due: true };
    let press = press(0.6, -0.4, [0.2, 1.0], 0.6);
    let frames = estimates_of(record(), 1.2, &press, wanted);
    for (sample, frame) in &frames[450..950] {
        all(&[*frame], &[Status::RAN_ARRAY, Status::RAN_SLIP], &[Status::RAN_MODEL]);
        let fz = f64::from(frame.force.z.unwrap().0);
        assert!((fz / sample.truth.force[2].unwrap() - 1.0).abs() < 0.02, "{fz}");
    }
    // A field of the matrix, or a faulty sensor, brings the model back.
    for more in [Fields::POINT, Fields::SLIP, Fields::CONTACTS, Fields::UNCERTAINTY] {
        let frames =
            estimates_of(record(), 1.2, &press, |_| Wanted { fields: fields | more, due: true });
        assert!(frames[600].1.status.contains(Status::RAN_MODEL), "{more:?}");
    }
    let fault = "[[fault]]\nat_s = 0.6\nuntil_s = 1.2\nkind = 'broken-arm'\nchannel = 's2_r3'\n";
    let frames = estimates_of(record(), 1.2, &format!("{press}{fault}"), wanted);
    assert!(!frames[590].1.status.contains(Status::RAN_MODEL));
    let frame = &frames[620].1;
    assert!(frame.status.contains(Status::RAN_MODEL) && frame.force.z.is_ok());
}

#[test]
fn channel_that_fails_or_returns_withholds_slip_for_50_ms() {
    let press = press(0.6, -0.4, [0.2, 1.0], 0.9);
    let fault = "[[fault]]\nat_s = 0.6\nuntil_s = 0.8\nkind = 'open-channel'\nchannel = 'r1c2'\n";
    let frames = estimates_of(record(), 1.5, &format!("{press}{fault}"), |_| Wanted::ALL);
    let mut returned = 800;
    for (i, (_, frame)) in frames.iter().enumerate().take(1250).skip(450) {
        let dead = frame.status.contains(Status::DEAD_TAXEL);
        // A channel that has jumped stays in doubt for 64 scans after it has jumped back.
        assert!(dead == (600..800).contains(&i) || dead && (800..872).contains(&i), "{i}");
        returned = returned.max(if dead { i } else { 0 });
        // The press is steady, and the array gives its force all the time.
        let doubted =
            [600, 800, returned + 1].iter().any(|change| (*change..change + 50).contains(&i));
        assert_eq!(frame.slip.err(), doubted.then_some(NoValue::DeadChannel), "{i}");
        let slides = frame.status.intersects(Status::SLIDES | Status::SLIP_WARNING);
        assert!(!slides && frame.force.z.is_ok(), "{i}");
    }
}

#[test]
fn scan_without_frame_runs_slip_in_turn_only() {
    let wanted = |i| Wanted { fields: Fields::ESTIMATES, due: i % 100 == 0 };
    let frames = estimates_of(record(), 1.2, &press(0.6, -0.4, [0.2, 1.0], 0.6), wanted);
    let ran = |range: core::ops::Range<usize>, bit: Status| {
        range.filter(|i| i % 100 > 0 && frames[*i].1.status.contains(bit)).count()
    };
    assert_eq!(ran(0..290, Status::RAN_SENSORS), 0);
    for bit in [Status::RAN_SENSORS, Status::RAN_SHEAR, Status::RAN_SLIP] {
        // Every second scan of 1 ms, because the next turn is due after 1.4 ms.
        assert!((240..=250).contains(&ran(450..950, bit)), "{bit:?}: {}", ran(450..950, bit));
    }
}

#[test]
fn slip_does_not_depend_on_stream_rate() {
    let press = press(0.6, -0.4, [0.6, 1.0], 0.8);
    let learned = |every: usize| {
        let wanted = |i| Wanted { fields: Fields::ESTIMATES, due: i % every == 0 };
        let frames = estimates_of(record(), 1.4, &press, wanted);
        frames[1100].1.slip.unwrap()
    };
    // The second stream has its only frame of this contact at the end.
    let [often, seldom] = [1, 1100].map(learned);
    assert!((often.friction / seldom.friction - 1.0).abs() < 0.05, "{often:?} {seldom:?}");
    assert!((often.margin - seldom.margin).abs() < 0.03, "{often:?} {seldom:?}");
}

/// Returns the most switches of a stage per second, in holds of 6 s near its threshold.
///
/// The threshold lies between the two levels; each hold halves the range.
fn most_switches(
    [mut below, mut above]: [f64; 2],
    scene: impl Fn(f64) -> String,
    on: impl Fn(&Estimate) -> bool,
) -> f64 {
    const HOLD: f64 = 6.0;
    let counted = |level: f64| {
        let on: Vec<bool> = held(HOLD, &scene(level)).iter().map(&on).collect();
        let share = on.iter().filter(|on| **on).count() as f64 / on.len() as f64;
        (on.windows(2).filter(|pair| pair[0] != pair[1]).count(), share)
    };
    assert_eq!((counted(below), counted(above)), ((0, 0.0), (0, 1.0)), "no threshold within");
    let mut most = 0;
    for _ in 0..14 {
        let level = f64::midpoint(below, above);
        let (switches, share) = counted(level);
        most = most.max(switches);
        *(if share < 0.5 { &mut below } else { &mut above }) = level;
    }
    println!("threshold at {below:.6} N: {most} switches in {:.0} s", HOLD / 3.0);
    most as f64 / (HOLD / 3.0)
}

/// Largest accepted number of switches a second.
const FEW: f64 = 3.0;

#[test]
fn shear_at_threshold_does_not_chatter() {
    let most = most_switches(
        [0.008, 0.02],
        |fx| press(0.6, -0.4, [fx, 1.0], 6.0),
        |e| e.status.contains(Status::RAN_SHEAR),
    );
    assert!(most <= FEW, "{most} switches a second");
}

#[test]
fn second_contact_at_threshold_does_not_chatter() {
    let scene = |fz| press(-2.5, -0.4, [0.0, 0.5], 6.0) + &press(2.5, 0.3, [0.0, fz], 6.0);
    let stage = most_switches([0.2, 0.4], scene, |e| e.status.contains(Status::RAN_PAIR));
    let reported = most_switches([0.2, 0.4], scene, |e| e.contacts.is_ok());
    assert!(stage <= FEW && reported <= FEW, "{stage} and {reported} switches a second");
}

/// A press of 1 N held for a second, with `fault` in the middle 600 ms.
fn faulty(fault: &str) -> Vec<(Sample, Estimate)> {
    let press = press(0.6, -0.4, [0.1, 1.0], 1.0);
    estimates(1.6, &format!("{press}[[fault]]\nat_s = 0.6\nuntil_s = 1.2\n{fault}\n"))
}

const BOTH: [Status; 2] = [Status::RAN_MODEL, Status::RAN_ARRAY];

/// Checks force within 2 % and contact point within 0.25 mm.
///
/// Of matrix and array, only `ran` may have run.
fn check_running_parts(frames: &[(Sample, Estimate)], ran: &[Status]) {
    for (sample, estimate) in frames {
        for part in BOTH {
            let status = estimate.status;
            assert_eq!(status.contains(part), ran.contains(&part), "{status:?}");
        }
        assert!(!estimate.status.contains(Status::DISAGREE), "{:?}", estimate.status);
        let fz = f64::from(estimate.force.z.unwrap().0);
        assert!((fz / sample.truth.force[2].unwrap() - 1.0).abs() < 0.02, "{fz}");
        let point = estimate.point.unwrap();
        let [x, y] = sample.truth.point.map(Option::unwrap);
        let off = (f64::from(point.x.0) - x).hypot(f64::from(point.y.0) - y);
        assert!(off < 0.25, "{off} mm");
    }
}

#[test]
fn force_sensors_replace_faulty_matrix() {
    let frames = faulty("kind = 'dead-led'\nchannel = 'r1c2'");
    check_running_parts(&frames[450..600], &BOTH);
    assert!(frames[610].1.status.contains(Status::DEAD_TAXEL));
    check_running_parts(&frames[600..1200], &[Status::RAN_ARRAY]);
    check_running_parts(&frames[1280..1370], &BOTH);
}

#[test]
fn matrix_replaces_faulty_force_sensor() {
    let frames = faulty("kind = 'broken-arm'\nchannel = 's2_r3'");
    assert!(frames[610].1.status.contains(Status::BRIDGE_FAULT));
    check_running_parts(&frames[600..1200], &[Status::RAN_MODEL]);
    // Only the force sensors measure torsion, so nothing replaces them there.
    assert!(frames[600..1200].iter().all(|(_, e)| e.torsion == Err(NoValue::DeadChannel)));
    check_running_parts(&frames[1280..1370], &BOTH);
}

#[test]
fn force_is_missing_where_both_are_faulty() {
    let fault = "kind = 'broken-arm'\nchannel = 's2_r3'\n[[fault]]\nat_s = 0.6\nuntil_s = 1.2\n\
                 kind = 'dead-led'\nchannel = 'r1c2'";
    for (_, estimate) in &faulty(fault)[600..1200] {
        assert_eq!(estimate.force, Force::none(NoValue::DeadChannel));
    }
}

/// Codes alone do not show a swapped cable; the shape of a press does.
#[test]
fn swapped_columns_yield_to_force_sensors() {
    let frames = faulty("kind = 'swapped-columns'\nchannel = 'c0'\nwith = 'c3'");
    let doubted = |(_, e): &(Sample, Estimate)| e.status.contains(Status::NOT_SINGLE);
    assert!(!frames[450..600].iter().any(doubted));
    assert!(frames[610..1200].iter().all(doubted));
    check_running_parts(&frames[610..1200], &BOTH);
    assert!(!frames[1230..1300].iter().any(doubted));
}

/// Codes alone do not show that the force sensors' calibration is another finger's.
///
/// The contradiction of both halves on the same contact does.
#[test]
fn disagreement_is_flagged_and_surer_part_wins() {
    let mut record = record();
    for sensor in record.sensors.iter_mut().flatten() {
        sensor.sensitivity.0.iter_mut().flatten().for_each(|s| *s *= 0.4);
    }
    let frames = estimates_by(record, 1.1, &press(0.6, -0.4, [0.0, 1.0], 0.5));
    for (_, estimate) in &frames[420..880] {
        assert!(estimate.status.contains(Status::DISAGREE), "{:?}", estimate.status);
        // The force sensors claim the smaller error: the output is theirs alone, not a mean.
        let fz = estimate.force.z.unwrap().0;
        assert!((fz - 0.4).abs() < 0.01, "{fz}");
    }
    assert!(!frames[..250].iter().any(|(_, e)| e.status.contains(Status::DISAGREE)));
}
