//! A finger for the tests: codes in round numbers, and a calibration with forces easy to compute.
#![allow(dead_code, reason = "each test file uses its part")]

use taxel::calibration::{Calibration, SensorCalibration, TaxelCalibration};
use taxel::condition::{
    BridgeBias, DriftCompensation, LagCompensation, TaxelBias, TemperatureCompensation,
};
use taxel::estimate::array::{Array, WrenchMethod};
use taxel::estimate::field::{Field, Radial};
use taxel::estimate::intrinsic::Surface;
use taxel::estimate::inverse::{Centres, Curves, Inverse};
use taxel::estimate::net::{ForceNet, Unit};
use taxel::estimate::quantised::Net;
use taxel::estimate::sensitivity::Sensitivity;
use taxel::estimate::slip::Slip;
use taxel::estimate::wrench::SensorPlaces;
use taxel::scan::{Codes, Midpoints, SENSORS, Scan, TAXELS, TaxelCodes};
use taxel::store::{RamFlash, Store};
use taxel::units::{Code, FullScale, Micros};
use taxel::wire::message::Identity;

pub const DARK: u16 = 2_000;
pub const LIT: u16 = 22_000;
pub const MIDPOINT: u16 = 32_768;

/// The unloaded finger at a time in microseconds, with 16-bit codes.
pub fn unloaded(time: u64) -> Scan {
    let rest = Code(MIDPOINT);
    Scan {
        time: Micros(time),
        lost: 0,
        codes: Codes {
            full_scale: FullScale::BITS_16,
            taxels: Some(TaxelCodes { lit: [[Code(LIT); 4]; 4], dark: [Code(DARK); 4] }),
            bridges: [Some(Midpoints { a: rest, b: rest, c: rest, d: rest }), None, None, None],
            reference: Some(rest),
            temperature: Some(Code(26_214)),
        },
    }
}

/// The finger with `codes` more light on taxel `k`, and a quarter of that on its neighbours.
pub fn pressed(time: u64, k: usize, codes: u16) -> Scan {
    let mut scan = unloaded(time);
    if let Some(taxels) = &mut scan.codes.taxels {
        for (i, lit) in taxels.lit.as_flattened_mut().iter_mut().enumerate() {
            lit.0 += match (i % 4).abs_diff(k % 4) + (i / 4).abs_diff(k / 4) {
                0 => codes,
                1 => codes / 4,
                _ => 0,
            };
        }
    }
    scan
}

/// Calibration with a net f_z = tanh(−Σ c_k) and one sensor of unit gain.
pub fn calibration() -> Calibration {
    let full = f32::from(u16::MAX);
    Calibration {
        serial: "test".try_into().expect("four letters fit"),
        date: 1_795_253_400,
        taxels: Some(TaxelCalibration {
            bias: TaxelBias { level: [f32::from(LIT - DARK) / full; TAXELS], noise: 1e-4 },
            range: [[-0.5, 0.05]; TAXELS],
            residual: [0.01; 3],
        }),
        net: Some(Net::Float(ForceNet {
            units: [Unit { weights: [-1.0; TAXELS], bias: 0.0, output: [0.0, 0.0, 1.0] }].into(),
            skip: None,
            output_bias: [0.0; 3].into(),
        })),
        model: None,
        slip: None,
        warmth: None,
        lag: None,
        drift: None,
        array: None,
        sensors: [
            Some(SensorCalibration {
                bias: BridgeBias { level: [0.0; 3], noise: 1e-4 },
                sensitivity: Sensitivity([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
                range: [[-0.2, 0.2]; 3],
                residual: [0.001; 3],
            }),
            None,
            None,
            None,
        ],
    }
}

/// Calibration of the same finger with every section.
///
/// The model is a point load on a half-space, 2.5 mm above the facets. The four sensors are alike.
pub fn everything() -> Calibration {
    let mut record = calibration();
    let point_load = |terms: [f32; 2], depth: f32| Radial {
        depth: [depth, 1.0],
        terms: [[terms[0], 0.0, 0.0], [terms[1], 0.0, 0.0], [0.0; 3], [0.0; 3]],
    };
    record.model = Some(Inverse {
        curves: Curves { stray: [[0.01; 4]; TAXELS], gap: [[-4.0, 0.5, 0.0, 0.0, 0.0]; TAXELS] },
        field: Field {
            normal: point_load([1.0, 1.0], 6.25),
            shear: point_load([2.5, 0.0], 6.25),
            slip: -0.4,
        },
        error: [1e-3, 2e-3],
        shear: true,
        friction: 0.8,
        centres: Centres::default(),
    });
    record.slip = Some(Slip::usual(0.8));
    record.warmth = Some(TemperatureCompensation {
        reference: 26_214.0 / 65_535.0,
        range: [0.0, 1.0],
        light: -6.6,
        sensitivity: -4.4,
        offset: [[0.05, -0.02, 0.01]; SENSORS],
    });
    record.lag = Some(LagCompensation { taxels: 4e-3, sensors: 3e-3 });
    record.drift = Some(DriftCompensation { most: 0.05 });
    let sensor = record.sensors[0].clone();
    record.sensors = core::array::from_fn(|_| sensor.clone());
    record.array = Some(Array {
        method: WrenchMethod::Sum(SensorPlaces::default()),
        residual: [1e-3; 3],
        moment_residual: 1e-2,
        surface: Surface::Plane,
    });
    record
}

pub fn identity() -> Identity {
    Identity {
        board: "test".try_into().expect("fits"),
        serial: "0001".try_into().expect("fits"),
        build: "none".try_into().expect("fits"),
        scan_hz: 4000,
        full_scale: FullScale::BITS_16,
        tick_hz: 1_000_000,
    }
}

/// An erased store in memory.
pub fn store() -> Store<RamFlash<Vec<u8>>> {
    Store::new(RamFlash::new(vec![0; RamFlash::SIZE]))
}
