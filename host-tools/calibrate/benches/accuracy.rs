//! Table of the estimators' accuracy: `cargo bench -p taxel-calibrate --bench accuracy`.
//!
//! Five devices, each calibrated on its own recording and judged on another run, with noise.

#[path = "../tests/it/judge/mod.rs"]
mod judge;

use taxel::frame::Status;

use judge::response::{SWEEP, resolution, response};
use judge::slip::{Onsets, after_slide, begins, grasp, onsets};
use judge::{RINGS, With, calibrated, errors, mean, pairs, presses, replay, run};

const DEVICES: [u32; 5] = [11, 12, 13, 14, 15];

fn main() {
    let records = DEVICES.map(|device| (device, calibrated(device)));
    println!("single contact, f_z >= 0.1 N; mean over {} devices", records.len());
    println!(
        "| with | out to mm | point mm | fx mN | fy mN | fz mN | direction deg | torsion N mm | missing | frames |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for with in [With::Matrix, With::Array, With::Both] {
        let rings = records.each_ref().map(|(device, record)| {
            let samples = run(*device, 77, 1000, 30.0, 0.8, &presses(140, [0.0, 0.99], 2.0));
            errors(&samples, &replay(record, &samples, with), 0.1)
        });
        for (i, out) in RINGS.iter().enumerate() {
            let of = |value: &dyn Fn(&judge::Ring) -> f64| mean(rings.iter().map(|r| value(&r[i])));
            println!(
                "| {with:?} | {out} | {:.3} | {:.1} | {:.1} | {:.1} | {:.2} | {:.3} | {} | {} |",
                of(&|r| r.point.value()),
                1e3 * of(&|r| r.force[0].value()),
                1e3 * of(&|r| r.force[1].value()),
                1e3 * of(&|r| r.force[2].value()),
                of(&|r| r.direction.value()),
                of(&|r| r.torsion.value()),
                rings.iter().map(|r| r[i].missing).sum::<usize>(),
                rings.iter().map(|r| r[i].frames).sum::<usize>(),
            );
        }
    }

    println!("\ntwo contacts, two pitches apart and more, 0.2 to 0.8 N each");
    println!("| with | shown | found | point mm | normal mN |\n|---|---|---|---|---|");
    for with in [With::Matrix, With::Both] {
        let pairs = records.each_ref().map(|(device, record)| pairs(*device, record, 200, with));
        println!(
            "| {with:?} | {} | {} | {:.3} | {:.1} |",
            pairs.iter().map(|p| p.shown).sum::<usize>(),
            pairs.iter().map(|p| p.found).sum::<usize>(),
            mean(pairs.iter().map(|p| p.point.value())),
            1e3 * mean(pairs.iter().map(|p| p.normal.value())),
        );
    }

    println!("\nslip: friction 0.2 to 1.2, 0.2 to 2 N; warned 20 ms before the slide");
    println!(
        "| with | first onsets | warned | later onsets | warned | false in 10 min of grasp at 0.2, 0.6, 1.2 | on unknown friction |"
    );
    println!("|---|---|---|---|---|---|---|");
    let variants = [With::Matrix, With::Array, With::Both];
    let mut told: [Onsets; 3] = Default::default();
    records.iter().for_each(|(device, record)| onsets(&mut told, *device, record, variants));
    let (device, record) = &records[0];
    let grasps = [0.2, 0.6, 1.2].map(|mu| grasp(*device, 500, mu, 10.0));
    for (with, Onsets { first, later, .. }) in variants.into_iter().zip(&told) {
        let [known, unknown] = [true, false].map(|known| {
            grasps.each_ref().map(|grasp| {
                begins(&after_slide(record, grasp, with, known), Status::SLIP_WARNING).len()
            })
        });
        println!(
            "| {with:?} | {} | {} | {} | {} | {known:?} | {unknown:?} |",
            first[0], first[1], later[0], later[1]
        );
    }
    println!("\ngross slip told; ms after it began in 50, 95 and 100 of 100; told before it began");
    println!("| with | slides | told | ms | early |\n|---|---|---|---|---|");
    for (with, told) in variants.into_iter().zip(&told) {
        let [shown, _] = told.all();
        println!(
            "| {with:?} | {shown} | {} | {:?} | {} |",
            told.told.len(),
            told.delays(),
            told.early
        );
    }

    println!(
        "\nresolution at 1 N, 1 kHz (standard deviation), and what is left of a sine at {SWEEP:?} Hz"
    );
    println!(
        "| with | fx mN | fy mN | fz mN | range 2 N over fz | left |\n|---|---|---|---|---|---|"
    );
    for with in variants {
        let sigma = records.each_ref().map(|(device, record)| resolution(*device, record, with));
        let of = |axis: usize| mean(sigma.iter().map(|s| s[axis]));
        let left = records.each_ref().map(|(device, record)| response(*device, record, with));
        let left: [f64; SWEEP.len()] =
            std::array::from_fn(|i| mean(left.iter().map(|left| left[i])));
        println!(
            "| {with:?} | {:.2} | {:.2} | {:.2} | {:.0} | {left:.3?} |",
            1e3 * of(0),
            1e3 * of(1),
            1e3 * of(2),
            2.0 / of(2)
        );
    }
}
