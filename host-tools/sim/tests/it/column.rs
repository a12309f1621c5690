//! OHKA-COLUMN ([Ohka2004]): its calibration tests A and B, steps, inclinations and friction, from
//! codes.

use taxel_files::trace::Sample;
use taxel_papers::column::{
    CENTRES, COLUMNS, Column, ColumnLoad, PITCH_MM, friction_distribution, inclination, quadrants,
    step_height,
};
use taxel_sim::systems::column::LIGHT_PER_MM2;

use crate::{HELD_OUT, contacts, force, line, meets, rms, run, run_on, signals};

/// Areas S_1 … S_4 in mm² of every column, frame by frame.
fn areas(samples: &[Sample]) -> Vec<([[f32; 4]; COLUMNS], &Sample)> {
    let per_mm2 = LIGHT_PER_MM2 as f32;
    let scaled = |c| quadrants(&c).map(|column| column.map(|light| light / per_mm2));
    signals(samples).into_iter().map(|(s, sample)| (scaled(s.taxels.unwrap()), sample)).collect()
}

/// Sums A_x and A_z of the areas.
fn sums([s1, s2, s3, s4]: [f32; 4]) -> (f64, f64) {
    ((s1 - s2 - s3 + s4).into(), (s1 + s2 + s3 + s4).into())
}

fn touched((_, sample): &([[f32; 4]; COLUMNS], &Sample)) -> bool {
    sample.truth.contact == Some(true)
}

/// Index of the column under a sample's contact.
fn column_of(sample: &Sample) -> usize {
    let point = sample.truth.point.map(Option::unwrap);
    CENTRES.iter().position(|centre| *centre == point).unwrap()
}

/// Coefficient α_v of each column, from calibration test A.
fn test_a(samples: &[Sample]) -> Vec<f64> {
    let rows = areas(samples);
    let slope = |press: &&[([[f32; 4]; COLUMNS], &Sample)]| {
        let column = column_of(press[0].1);
        let points = press.iter().map(|(s, sample)| (sums(s[column]).1, force(sample)[2]));
        line(points)[0]
    };
    contacts(&rows, touched).iter().map(slope).collect()
}

/// Coefficients α_h0 and α_h from calibration test B: slope of F_x over A_x at each normal force,
/// over A_z.
fn test_b(samples: &[Sample]) -> [f64; 2] {
    let rows = areas(samples);
    let presses = contacts(&rows, touched);
    assert_eq!(presses.len(), 5);
    let sensitivities = presses.iter().map(|press| {
        let column = column_of(press[0].1);
        let most = press.iter().map(|(_, s)| force(s)[2]).fold(0.0, f64::max);
        let held = press.iter().filter(|(_, s)| force(s)[2] > 0.999 * most);
        let held: Vec<_> = held.map(|(s, sample)| (sums(s[column]), force(sample)[0])).collect();
        let mean = held.iter().map(|((_, z), _)| z).sum::<f64>() / held.len() as f64;
        (mean, line(held.iter().map(|((x, _), f)| (*x, *f)))[0])
    });
    let [slope, height] = line(sensitivities);
    [height, -slope]
}

/// Sensor calibrated by tests A and B; its `sinking` is the paper's value.
fn calibrated() -> Column {
    calibrated_by(|name| run(name, 1))
}

fn calibrated_by(run: impl Fn(&str) -> Vec<Sample>) -> Column {
    let of_columns = test_a(&run("column-press"));
    let [shear, flattening] = test_b(&run("column-shear")).map(|value| value as f32);
    let normal = (of_columns.iter().sum::<f64>() / COLUMNS as f64) as f32;
    Column { normal, shear, flattening, ..Column::PAPER }
}

#[test]
fn tests_a_and_b_recover_sensitivities() {
    let of_columns = test_a(&run("column-press", 1));
    assert_eq!(of_columns.len(), COLUMNS);
    for alpha_v in of_columns {
        meets("alpha_v", alpha_v, 0.25, 5.0);
    }
    let [alpha_h0, alpha_h] = test_b(&run("column-shear", 1));
    meets("alpha_h0", alpha_h0, 0.20, 5.0);
    meets("alpha_h", alpha_h, 0.081, 5.0);
}

#[test]
fn combined_loads_follow_from_codes() {
    let sensor = calibrated();
    let samples = run("column-shear", 2);
    let mut worst = [0.0f64; 3];
    for (areas, sample) in areas(&samples).iter().filter(|row| touched(row)) {
        let found = sensor.load(areas[column_of(sample)]).force;
        for (worst, (found, asked)) in worst.iter_mut().zip(found.into_iter().zip(force(sample))) {
            *worst = worst.max((f64::from(found) - asked).abs());
        }
    }
    // Bounds: 2 % of the 0.25 N and of the 0.07 N.
    assert!(worst[2] < 0.005 && worst[0].max(worst[1]) < 0.0035, "{worst:?}");
}

/// Loads of the four columns, averaged over the frames with a plate at a share of its path.
fn loads(
    sensor: &Column,
    plate: &[([[f32; 4]; COLUMNS], &Sample)],
    from: f64,
    to: f64,
) -> [ColumnLoad; COLUMNS] {
    let at = |share: f64| (share * plate.len() as f64) as usize;
    let rows = &plate[at(from)..at(to)];
    std::array::from_fn(|column| {
        let mut mean = [0.0; 4];
        for (areas, _) in rows {
            mean.iter_mut().zip(areas[column]).for_each(|(m, s)| *m += s / rows.len() as f32);
        }
        sensor.load(mean)
    })
}

#[test]
fn inclination_error_is_far_below_the_paper() {
    let sensor = calibrated();
    let samples = run("column-incline", 2);
    let rows = areas(&samples);
    let plates = contacts(&rows, touched);
    let asked = [-0.38f32, -0.19, 0.0, 0.19, 0.38];
    assert_eq!(plates.len(), asked.len());
    for (plate, asked) in plates.into_iter().zip(asked) {
        let [a, b, c, d] = loads(&sensor, plate, 0.4, 0.6).map(|load| load.sunk);
        for pair in [[a, b], [c, d]] {
            let found = inclination(&pair, PITCH_MM as f32).unwrap();
            // The paper reaches ±0.4°.
            assert!((found - asked).abs() < 0.02, "{found} for {asked}");
        }
    }
}

#[test]
fn inclination_scatter_is_below_0_1_degree() {
    let asked = [-0.38f32, -0.19, 0.0, 0.19, 0.38];
    let sigma = HELD_OUT.map(|device| {
        let sensor = calibrated_by(|name| run_on(device, name, 1));
        let samples = run_on(device, "column-incline", 2);
        let rows = areas(&samples);
        let plates = contacts(&rows, touched);
        assert_eq!(plates.len(), asked.len());
        let mut errors = Vec::new();
        for (plate, asked) in plates.into_iter().zip(asked) {
            let at = |share: f64| (share * plate.len() as f64) as usize;
            for (frame, _) in &plate[at(0.3)..at(0.7)] {
                let [a, b, c, d] = frame.map(|areas| sensor.load(areas).sunk);
                for pair in [[a, b], [c, d]] {
                    let found = inclination(&pair, PITCH_MM as f32).unwrap();
                    errors.push(f64::from(found - asked));
                }
            }
        }
        assert!(errors.len() > 3000);
        rms(&errors)
    });
    let mean = sigma.iter().sum::<f64>() / sigma.len() as f64;
    println!("inclination: {sigma:.4?}, mean {mean:.4} degrees");
    assert!(mean < 0.1, "{sigma:?}");
}

#[test]
fn steps_scale_with_height_on_five_devices() {
    let mut mean = [0.0; 3];
    for device in HELD_OUT {
        let sensor = calibrated_by(|name| run_on(device, name, 1));
        let samples = run_on(device, "column-step", 2);
        let rows = areas(&samples);
        for (step, plate) in contacts(&rows, touched).into_iter().enumerate() {
            let (before, after) =
                (loads(&sensor, plate, 0.2, 0.23), loads(&sensor, plate, 0.77, 0.8));
            for (before, after) in before.iter().zip(after) {
                let found = step_height(&sensor, before.force[2], after.force[2]).unwrap();
                // Three steps up and three down, four columns each.
                mean[step % 3] += f64::from(found.abs()) / (8.0 * HELD_OUT.len() as f64);
            }
        }
    }
    let [one, two, four] = mean;
    println!("steps: {mean:.4?} mm, 1 : {:.3} : {:.3}", two / one, four / one);
    assert!(
        (two / one / 2.0 - 1.0).abs() < 0.1 && (four / one / 4.0 - 1.0).abs() < 0.1,
        "{mean:?}"
    );
}

#[test]
fn steps_up_and_down_measure_their_heights() {
    let sensor = calibrated();
    let samples = run("column-step", 2);
    let rows = areas(&samples);
    let plates = contacts(&rows, touched);
    let asked = [0.05f32, 0.1, 0.2, -0.05, -0.1, -0.2];
    assert_eq!(plates.len(), asked.len());
    for (plate, asked) in plates.into_iter().zip(asked) {
        // A third of the contact is rise and fall; the edge reaches the columns between.
        let (before, after) = (loads(&sensor, plate, 0.2, 0.23), loads(&sensor, plate, 0.77, 0.8));
        for (before, after) in before.iter().zip(after) {
            let found = step_height(&Column::PAPER, before.force[2], after.force[2]).unwrap();
            assert!((found / asked - 1.0).abs() < 0.02, "{found} mm for {asked} mm");
        }
    }
}

#[test]
fn rubbed_columns_show_friction_at_a_step() {
    let sensor = calibrated();
    let samples = run("column-step", 2);
    let rows = areas(&samples);
    for plate in contacts(&rows, touched) {
        for (from, to) in [(0.27, 0.3), (0.7, 0.73)] {
            for mu in friction_distribution(&loads(&sensor, plate, from, to), 0.02) {
                assert!((mu.unwrap() - 0.3).abs() < 0.03, "{mu:?}");
            }
        }
    }
}

#[test]
fn only_rubbing_columns_slip_in_the_truth() {
    let slips = |name| run(name, 1).iter().filter(|s| s.truth.slip == Some(true)).count();
    assert!(slips("column-step") > 1000);
    assert_eq!(slips("column-incline") + slips("column-press") + slips("column-shear"), 0);
}
