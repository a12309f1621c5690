//! Built-in scenes with an effect or a fault: codes compared with the same scene without it.

use taxel::scan::{Codes, TAXELS};
use taxel_files::trace::Sample;
use taxel_sim::{Effect, Scene, Simulator};

use crate::{changed, run};

fn at(samples: &[Sample], seconds: f64) -> &Sample {
    let found = samples.iter().find(|s| s.scan.time.0 as f64 >= 1e6 * seconds);
    found.unwrap()
}

/// Lit minus dark of each taxel.
fn levels(codes: &Codes) -> [f64; TAXELS] {
    let codes = codes.taxels.unwrap();
    std::array::from_fn(|k| f64::from(codes.lit[k / 4][k % 4].0) - f64::from(codes.dark[k % 4].0))
}

/// Means of the levels over 40 ms, starting at `from` seconds.
fn mean(samples: &[Sample], from: f64) -> [f64; TAXELS] {
    let within = |s: &&Sample| (from..from + 0.04).contains(&(s.scan.time.0 as f64 * 1e-6));
    let rows: Vec<_> = samples.iter().filter(within).map(|s| levels(&s.scan.codes)).collect();
    std::array::from_fn(|k| rows.iter().map(|row| row[k]).sum::<f64>() / rows.len() as f64)
}

/// Change of each taxel's light by a touch, as a share of its light at rest.
fn rise(samples: &[Sample], from: f64) -> [f64; TAXELS] {
    let (rest, now) = (mean(samples, 0.1), mean(samples, from));
    std::array::from_fn(|k| now[k] / rest[k] - 1.0)
}

fn largest(rise: [f64; TAXELS]) -> f64 {
    rise.into_iter().fold(0.0, |most, r| f64::max(most, r.abs()))
}

#[test]
fn framed_facets_move_less_and_only_nearby() {
    // 1 N above the middle of a window, then above the corner of four.
    let held = |at_s: f64, x: f64, y: f64| {
        format!("{{at_s={at_s},x_mm={x},y_mm={y},fz_n=1.0,rise_s=0.1,hold_s=0.5,fall_s=0.1}}")
    };
    let presses = format!("press=[{},{}]", held(0.5, -1.25, 1.25), held(1.5, 0.0, 0.0));
    let set = ["scan.rate_hz=500", "scan.duration_s=2.5", &presses];
    let free = changed("press", &set, 1);
    let walls = changed("press", &[&set[..], &["effects.walls=true"]].concat(), 1);
    // The window is that of taxel 9; taxel 11 is two windows away.
    let (framed, half_space) = (rise(&walls, 0.8), rise(&free, 0.8));
    assert!(largest(framed) == framed[9] && largest(half_space) == half_space[9]);
    assert!((2.0..5.0).contains(&(half_space[9] / framed[9])), "{framed:?} {half_space:?}");
    assert!(framed[11].abs() < 0.03 * framed[9], "{framed:?}");
    assert!(half_space[11] > 0.15 * half_space[9], "{half_space:?}");
    // Above the walls between four windows the frame carries more of the force.
    let between = rise(&walls, 1.8);
    assert!(largest(between) < 0.8 * framed[9] && largest(between) > 0.3 * framed[9]);
}

#[test]
fn frame_keeps_a_quarter_of_shear() {
    // Shear to +x and to −x under the same load: half the difference is the effect of shear.
    let sheared = |at_s: f64, x: f64| {
        let press = "x_mm=0.6,y_mm=-0.4,fz_n=1.2,rise_s=0.1,hold_s=0.9,fall_s=0.1";
        format!("{{at_s={at_s},fx_n={x},{press}}}")
    };
    let presses = format!("press=[{},{}]", sheared(0.5, 0.7), sheared(2.0, -0.7));
    let set = ["scan.rate_hz=500", "scan.duration_s=3.5", &presses];
    let free = changed("press", &set, 1);
    let walls = changed("press", &[&set[..], &["effects.walls=true"]].concat(), 1);
    let shear = |samples: &[Sample]| -> [f64; TAXELS] {
        let (right, left) = (rise(samples, 1.03), rise(samples, 2.53));
        std::array::from_fn(|k| 0.5 * (right[k] - left[k]))
    };
    let (framed, half_space) = (shear(&walls), shear(&free));
    let k =
        (0..TAXELS).max_by(|a, b| half_space[*a].abs().total_cmp(&half_space[*b].abs())).unwrap();
    assert!(framed[k] * half_space[k] > 0.0, "{framed:?} {half_space:?}");
    let left = largest(framed) / largest(half_space);
    assert!((0.15..0.4).contains(&left), "{framed:?} {half_space:?}");
    // Shear also fades faster, as the row farthest from the contact shows.
    let far = |shear: [f64; TAXELS]| shear[12..].iter().fold(0.0f64, |m, s| m.max(s.abs()));
    assert!(far(framed) / far(half_space) < 0.6 * left, "{framed:?} {half_space:?}");
}

/// Five presses on a fresh skin, less an effect: held at 1.8 N from 0.6 + 0.7 i to 0.9 + 0.7 i s.
fn skin_cycle(less: Option<&str>) -> Vec<Sample> {
    let press = |at_s: &str| {
        let press = "x_mm=0,y_mm=0,fz_n=1.8,rise_s=0.1,hold_s=0.3,fall_s=0.01";
        format!("{{at_s={at_s},{press}}}")
    };
    let presses = format!("press=[{}]", ["0.5", "1.2", "1.9", "2.6", "3.3"].map(press).join(","));
    let effects = ["stiffening", "hysteresis", "skin-response"];
    let set = effects.map(|effect| format!("effects.{effect}={}", Some(effect) != less));
    let [stiff, slack, slow] = set.each_ref().map(String::as_str);
    changed("press", &["scan.duration_s=4", &presses, stiff, slack, slow], 1)
}

#[test]
fn fresh_skin_is_stiffer_in_first_press() {
    let cycle = skin_cycle(None);
    let presses: Vec<f64> =
        (0..5).map(|i| largest(rise(&cycle, 0.85 + 0.7 * f64::from(i)))).collect();
    // At the largest load so far every press is on the curve of the first; below it, on the softer
    // curve.
    let half_way = |i: u32| largest(rise_at(&cycle, 0.55 + 0.7 * f64::from(i)));
    let later: Vec<f64> = (1..5).map(half_way).collect();
    for (i, later) in later.iter().enumerate() {
        assert!((1.03..1.15).contains(&(later / half_way(0))), "{i}: {later} {}", half_way(0));
        assert!((later / half_way(1) - 1.0).abs() < 0.01, "{i}");
    }
    assert!(presses.iter().all(|p| (p / presses[0] - 1.0).abs() < 0.01), "{presses:?}");
    let worked_in = skin_cycle(Some("hysteresis"));
    let of = |i: u32| largest(rise_at(&worked_in, 0.55 + 0.7 * f64::from(i)));
    assert!((of(1) / of(0) - 1.0).abs() < 0.01);
}

/// Change of each taxel's light as [`rise`], over 4 ms, for a moment while the force changes.
fn rise_at(samples: &[Sample], seconds: f64) -> [f64; TAXELS] {
    let rest = mean(samples, 0.1);
    let frames = (0..4).map(|i| levels(&at(samples, seconds + 1e-3 * f64::from(i)).scan.codes));
    let sum = frames.fold([0.0; TAXELS], |sum, row| std::array::from_fn(|k| sum[k] + row[k]));
    std::array::from_fn(|k| 0.25 * sum[k] / rest[k] - 1.0)
}

#[test]
fn stiffening_skin_moves_less_under_hard_press() {
    let (stiffening, linear) = (skin_cycle(None), skin_cycle(Some("stiffening")));
    let less =
        |seconds: f64| largest(rise_at(&stiffening, seconds)) / largest(rise_at(&linear, seconds));
    // At 1.8 N during the hold, and at a tenth of it during the rise.
    assert!((0.6..0.95).contains(&less(0.85)), "{}", less(0.85));
    assert!((less(0.52) - 1.0).abs() < 0.5 * (1.0 - less(0.85)), "{} {}", less(0.52), less(0.85));
}

#[test]
fn slow_skin_stays_displaced_after_release() {
    let (slow, prompt) = (skin_cycle(None), skin_cycle(Some("skin-response")));
    // The release lasts from 0.9 to 0.91 s.
    let left =
        |samples: &[Sample]| largest(rise_at(samples, 0.911)) / largest(rise_at(samples, 0.85));
    assert!(left(&prompt) < 0.01, "{}", left(&prompt));
    assert!(left(&slow) > 0.05, "{}", left(&slow));
    // rA settles in 10 ms ([Ospina2017] fig. 1.21); after 30 ms the rest is below 1 %.
    let settled = largest(rise_at(&slow, 0.94)) / largest(rise_at(&slow, 0.85));
    assert!(settled < 0.01, "{settled}");
}

#[test]
fn ripple_reaches_light_and_fixed_bridges() {
    // Amplitude of a code at 100 Hz over its mean, in the unloaded half second.
    let swing = |samples: &[Sample], code: &dyn Fn(&Codes) -> f64| {
        let codes: Vec<f64> = samples[..500].iter().map(|s| code(&s.scan.codes)).collect();
        let turn = |i: usize| std::f64::consts::TAU * 0.1 * i as f64;
        let (sin, cos) = codes.iter().enumerate().fold((0.0, 0.0), |(sin, cos), (i, code)| {
            (sin + code * turn(i).sin(), cos + code * turn(i).cos())
        });
        2.0 * f64::hypot(sin, cos) / codes.iter().sum::<f64>()
    };
    let bridge = |codes: &Codes| f64::from(codes.bridges[0].unwrap().a.0);
    let light = |codes: &Codes| levels(codes)[5];
    let fixed = run("ripple", 1);
    let follows = changed("ripple", &["electronics.ratiometric=true"], 1);
    // 1 % of 5 V is 1 % in a midpoint, and 1.35 % in the light of an LED that drops 1.3 V. Lamps
    // swing at the same frequency, as `flicker` does without it.
    assert!((swing(&fixed, &bridge) - 0.01).abs() < 2e-4, "{}", swing(&fixed, &bridge));
    assert!(swing(&follows, &bridge) < 1e-4, "{}", swing(&follows, &bridge));
    assert!((swing(&fixed, &light) - 0.0135).abs() < 1e-3, "{}", swing(&fixed, &light));
    let still = changed("ripple", &["effects.supply-ripple=false"], 1);
    assert!(swing(&still, &light) < 2e-3 && swing(&still, &bridge) < 1e-4);
}

/// Codes of the scene `fault` with this fault, in changes apart by spaces, and without any; both are
/// equal until it begins.
fn with_and_without(fault: &str) -> (Vec<Sample>, Vec<Sample>) {
    let set: Vec<&str> = fault.split_whitespace().collect();
    let (broken, sound) = (changed("fault", &set, 1), changed("fault", &["fault="], 1));
    assert!(broken[..1000] == sound[..1000], "{fault}");
    assert!(broken[1000..].iter().zip(&sound[1000..]).all(|(b, s)| b.truth == s.truth), "{fault}");
    (broken, sound)
}

/// Taxels whose level differs from the intact one's by more than a tenth.
fn off(broken: &Sample, sound: &Sample) -> Vec<usize> {
    let (broken, sound) = (levels(&broken.scan.codes), levels(&sound.scan.codes));
    (0..TAXELS).filter(|k| (broken[*k] / sound[*k] - 1.0).abs() > 0.1).collect()
}

#[test]
fn dead_led_darkens_only_its_taxel() {
    let (broken, sound) = with_and_without("");
    assert_eq!(off(&broken[1500], &sound[1500]), [6]);
    // The rest is stray light of its row.
    assert!(levels(&broken[1500].scan.codes)[6] < 0.1 * levels(&sound[1500].scan.codes)[6]);
}

#[test]
fn open_column_reads_zero() {
    let (broken, sound) = with_and_without("fault.kind=open-channel fault.channel=c2");
    assert_eq!(off(&broken[1500], &sound[1500]), [2, 6, 10, 14]);
    let codes = broken[1500].scan.codes.taxels.unwrap();
    assert!(codes.lit.iter().all(|row| row[2].0 < 50) && codes.dark[2].0 < 50);
}

#[test]
fn shorted_midpoint_reads_zero_until_repaired() {
    let set = "fault.kind=shorted-channel fault.channel=s0_a fault.until_s=1.5";
    let (broken, sound) = with_and_without(set);
    let midpoints = |sample: &Sample| sample.scan.codes.bridges.map(Option::unwrap);
    for (t, (broken, sound)) in broken.iter().zip(&sound).enumerate() {
        let (broken, sound) = (midpoints(broken), midpoints(sound));
        let shorted = (1000..1500).contains(&t);
        assert_eq!(broken[0].a.0 < 50, shorted, "{t}");
        assert!((i32::from(broken[0].b.0) - i32::from(sound[0].b.0)).abs() < 100, "{t}");
    }
}

#[test]
fn stuck_taxel_repeats_its_code_bit_for_bit() {
    let (broken, sound) = with_and_without("fault.kind=stuck-channel");
    let lit = |samples: &[Sample]| -> Vec<u16> {
        samples[1000..].iter().map(|s| s.scan.codes.taxels.unwrap().lit[1][2].0).collect()
    };
    let (broken, sound) = (lit(&broken), lit(&sound));
    assert!(broken.iter().all(|code| *code == broken[0]));
    assert!(sound.iter().any(|code| code.abs_diff(sound[0]) > 1000), "it was let go meanwhile");
}

#[test]
fn saturated_input_reads_full_scale() {
    let set = "fault.kind=saturated-adc fault.channel=c2 fault.until_s=1.5";
    let (broken, _) = with_and_without(set);
    for (t, sample) in broken.iter().enumerate() {
        let codes = sample.scan.codes.taxels.unwrap();
        let full = codes.lit.iter().chain([&codes.dark]).all(|row| row[2].0 == 65_535);
        assert_eq!(full, (1000..1500).contains(&t), "{t}");
    }
}

#[test]
fn broken_arm_drives_its_midpoint_to_a_rail() {
    let (broken, sound) = with_and_without("fault.kind=broken-arm fault.channel=s0_r3");
    let share = |sample: &Sample| {
        let m = sample.scan.codes.bridges[0].unwrap();
        [m.a, m.b, m.c, m.d].map(|code| f64::from(code.0) / 65_535.0)
    };
    let rails = |shares: [f64; 4]| shares.map(|v| !(0.05..0.95).contains(&v));
    assert_eq!(rails(share(&sound[1500])), [false; 4]);
    assert_eq!(rails(share(&broken[1500])).iter().filter(|rail| **rail).count(), 1);
    assert_eq!(broken[1500].scan.codes.bridges[1], sound[1500].scan.codes.bridges[1]);
}

#[test]
fn supply_dip_dims_light_lifts_reference() {
    let set = "fault.kind=supply-dip fault.channel= fault.ratio=0.8 fault.until_s=1.5";
    let (broken, sound) = with_and_without(set);
    let reference = |sample: &Sample| f64::from(sample.scan.codes.reference.unwrap().0) / 65_535.0;
    assert!((reference(&sound[1250]) - 0.5).abs() < 1e-3);
    assert!((reference(&broken[1250]) - 0.5 / 0.8).abs() < 1e-3);
    // A volt less of 3.7 V for an LED, on a converter whose range shrinks to 0.8.
    let dimmed = (4.0 - 1.3) / 3.7 / 0.8;
    let (lit, was) = (mean(&broken, 1.2), mean(&sound, 1.2));
    assert!(lit.iter().zip(was).all(|(lit, was)| (lit / was - dimmed).abs() < 0.01), "{lit:?}");
    assert_eq!(off(&broken[1600], &sound[1600]), [0usize; 0]);
}

#[test]
fn swapped_columns_mirror_the_pattern() {
    let set = "fault.kind=swapped-columns fault.channel=c1 fault.with=c2";
    let (broken, sound) = with_and_without(set);
    let (now, was) = (mean(&broken, 1.2), mean(&sound, 1.2));
    for row in 0..4 {
        for (column, other) in [(0, 0), (1, 2), (2, 1), (3, 3)] {
            let ratio = now[4 * row + column] / was[4 * row + other];
            assert!((ratio - 1.0).abs() < 0.005, "{row} {column}: {ratio}");
        }
    }
}

#[test]
fn bench_error_is_one_place_a_contact() {
    let text = include_str!("../../scenes/press.toml");
    let exact = Scene::parse("press.toml", text).unwrap();
    let run = |scene: &Scene| Simulator::new(scene, 1).collect::<Vec<_>>();
    let noisy = run(&exact.clone().with_effect(Effect::BenchError));
    let exact = run(&exact);
    let pairs = || noisy.iter().zip(&exact);
    // Codes and contacts are the same; force has 6 mN of noise, the place is off by a constant.
    assert!(pairs().all(|(n, e)| n.scan == e.scan && n.truth.contact == e.truth.contact));
    let errors: Vec<f64> =
        pairs().map(|(n, e)| n.truth.force[2].unwrap() - e.truth.force[2].unwrap()).collect();
    let spread = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    assert!((spread / 0.006 - 1.0).abs() < 0.1, "{spread}");
    let away: Vec<f64> =
        pairs().filter_map(|(n, e)| Some(n.truth.point[0]? - e.truth.point[0]?)).collect();
    assert!(away[0] != 0.0 && away.iter().all(|a| (a - away[0]).abs() < 1e-12));
}
