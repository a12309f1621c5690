//! Estimates forces from ADC codes with the core alone: `cargo run --example estimate_codes`.
//!
//! A finger with one force sensor is unloaded for 50 ms and then pressed and sheared. Its
//! calibration is written by hand here; `taxel calibrate fit` fits a real one. The optical matrix
//! has no calibration, so that its net force is absent, with the reason.

use taxel::calibration::{Calibration, SensorCalibration};
use taxel::condition::BridgeBias;
use taxel::estimate::sensitivity::Sensitivity;
use taxel::finger::Finger;
use taxel::scan::{Codes, Midpoints, Scan, TaxelCodes};
use taxel::units::{Code, FullScale, Micros};

/// Scans a second.
const SCAN_HZ: u64 = 1000;

/// Returns the codes of one scan: sensor 0 moves by `x` and `z`, the matrix stays constant.
fn scan(time: Micros, x: i16, z: i16) -> Scan {
    let midpoint = |change: i16| Code(32_768_u16.saturating_add_signed(change));
    // Shear along x tilts A against B; a normal force moves A and B against C and D.
    let (a, b) = (midpoint(z - x), midpoint(z + x));
    let bridge = Midpoints { a, b, c: midpoint(-z), d: midpoint(-z) };
    Scan {
        time,
        lost: 0,
        codes: Codes {
            full_scale: FullScale::BITS_16,
            taxels: Some(TaxelCodes { lit: [[Code(22_000); 4]; 4], dark: [Code(2_000); 4] }),
            bridges: [Some(bridge), None, None, None],
            reference: None,
            temperature: None,
        },
    }
}

/// Returns the calibration f = S(u − b): a matrix S without crosstalk, in newtons per full scale.
fn calibration() -> Calibration {
    let mut calibration = Calibration::default();
    calibration.sensors[0] = Some(SensorCalibration {
        bias: BridgeBias { level: [0.0; 3], noise: 1e-4 },
        sensitivity: Sensitivity([[20.0, 0.0, 0.0], [0.0, 20.0, 0.0], [0.0, 0.0, 40.0]]),
        range: [[-0.2, 0.2]; 3],
        residual: [0.001; 3],
    });
    calibration
}

fn main() {
    let (finger, mut state) = Finger::new(Some(calibration()));
    println!("t_ms contact  sensor 0: fx_n fy_n fz_n   finger: fz_n");
    for step in 0..200 {
        let press = i16::try_from(step).unwrap_or(0).saturating_sub(50).clamp(0, 100);
        let scan = scan(Micros(step * 1_000_000 / SCAN_HZ), 5 * press, 10 * press);
        let estimate = finger.estimate(&mut state, &scan);
        if step % 20 == 0 {
            let sensor = &estimate.sensors[0];
            let [x, y, z] = [sensor.x, sensor.y, sensor.z].map(|force| match force {
                Ok(force) => format!("{:7.3}", force.0),
                Err(reason) => format!("{reason:?}"),
            });
            let whole = estimate.force.z.map(|force| force.0);
            println!("{step:4} {:7}  {x} {y} {z}   {whole:?}", state.contact());
        }
    }
}
