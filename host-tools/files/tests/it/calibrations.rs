//! Tests of calibration files: bit-exact in both directions, with an error for every damage.

use std::path::Path;

use proptest::prelude::*;
use taxel::calibration::{Calibration, SensorCalibration, TaxelCalibration};
use taxel::condition::{
    BridgeBias, DriftCompensation, LagCompensation, TaxelBias, TemperatureCompensation,
};
use taxel::estimate::array::{Array, WrenchMethod};
use taxel::estimate::field::{Field, Radial};
use taxel::estimate::intrinsic::Surface;
use taxel::estimate::inverse::{Centres, Curves, Inverse};
use taxel::estimate::net::{ForceNet, Unit};
use taxel::estimate::quantised::{Net, QuantisedNet};
use taxel::estimate::sensitivity::Sensitivity;
use taxel::estimate::slip::Slip;
use taxel::estimate::wrench::SensorPlaces;
use taxel::units::Millimetres;
use taxel_files::calibration::{self, Kind};

fn record(weights: &[f32]) -> Calibration {
    let weight = |i: usize| weights[i % weights.len()];
    // Two units each that cancel without a contact, where a net must give no force.
    let unit = |j: usize| Unit {
        weights: std::array::from_fn(|i| weight(16 * j + i)),
        bias: weight(j / 2),
        output: std::array::from_fn(|k| [1.0, -1.0][j % 2] * weight(12 * k + j / 2)),
    };
    let force = ForceNet {
        units: (0..12).map(unit).collect(),
        skip: Some(std::array::from_fn(|k| std::array::from_fn(|i| weight(16 * k + i)))),
        output_bias: (0..3).map(|k| weight(k).clamp(-0.5, 0.5)).collect(),
    };
    let sensor = SensorCalibration {
        bias: BridgeBias { level: [0.01, -0.02, 0.003], noise: 1.25e-4 },
        sensitivity: Sensitivity([[1.0, 0.1, 0.2], [weight(1), 2.0, 0.3], [0.0, 0.4, 3.0]]),
        range: [[-0.1, 0.1]; 3],
        residual: [0.001; 3],
    };
    Calibration {
        serial: "F-0042".try_into().unwrap(),
        date: 1_795_253_400,
        taxels: Some(TaxelCalibration {
            bias: TaxelBias { level: [0.31; 16], noise: 9.1e-5 },
            range: [[-0.6, 0.05]; 16],
            residual: [0.01, 0.02, 0.004],
        }),
        net: Some(Net::Float(force)),
        model: Some(Inverse {
            curves: Curves {
                stray: std::array::from_fn(|k| std::array::from_fn(|i| 0.01 * (k + i) as f32)),
                gap: std::array::from_fn(|k| std::array::from_fn(|i| weight(k + i))),
            },
            field: Field {
                normal: Radial { depth: [6.25, 2.0], terms: [[weight(2), 0.5, 0.25]; 4] },
                shear: Radial { depth: [6.5, 2.5], terms: [[2.5, weight(3), 0.75]; 4] },
                slip: -0.4,
            },
            error: [1e-3, 2e-3],
            shear: true,
            friction: 0.8,
            centres: Centres(std::array::from_fn(|k| {
                [weight(k).clamp(-9.0, 9.0), 0.25 * k as f32]
            })),
        }),
        slip: Some(Slip::usual(0.7)),
        warmth: Some(TemperatureCompensation {
            reference: 0.231,
            range: [0.229, 0.24],
            light: -6.6,
            sensitivity: -4.4,
            offset: [[0.05, -0.02, 0.01]; 4],
        }),
        lag: Some(LagCompensation { taxels: 4.36e-3, sensors: 3.98e-3 }),
        drift: Some(DriftCompensation { most: 0.05 }),
        sensors: [None, Some(sensor), None, None],
        array: Some(Array {
            method: WrenchMethod::Sum(SensorPlaces::default()),
            residual: [0.001, 0.002, 0.003],
            moment_residual: 0.02,
            surface: Surface::Sphere { radius: Millimetres(12.0) },
        }),
    }
}

fn written(calibration: &Calibration) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cal.toml");
    calibration::write(&path, calibration).unwrap();
    std::fs::read_to_string(path).unwrap()
}

fn parse(text: &str) -> Result<Calibration, String> {
    calibration::parse(Path::new("cal.toml"), text).map_err(|error| error.to_string())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn weights_survive_a_file_bit_for_bit(
        weights in proptest::collection::vec(-1e6f32..1e6, 7), tiny in -1e-30f32..1e-30,
    ) {
        let mut weights = weights;
        weights.push(tiny);
        let record = record(&weights);
        prop_assert_eq!(parse(&written(&record)), Ok(record));
    }

    #[test]
    fn reader_accepts_any_text(text in "\\PC{0,200}") {
        let _ = parse(&text);
    }

    #[test]
    fn reader_accepts_any_mangled_calibration(at in any::<usize>(), with in "\\PC{1}") {
        let text = written(&record(&[0.5]));
        let at = at % text.len();
        let _ = parse(&format!("{}{with}{}", &text[..at], &text[at + 1..]));
    }
}

#[test]
fn q15_net_survives_a_file_and_misfits_are_errors() {
    let mut record = record(&[0.5, -0.25, 0.125]);
    let quantised = record.net.as_ref().and_then(Net::float).map(|net| QuantisedNet::new(net, 0.6));
    record.net = quantised.flatten().map(Net::Quantised);
    assert!(record.net.is_some());
    let text = written(&record);
    assert_eq!(parse(&text), Ok(record));
    let line = |key: &str| text.lines().position(|line| line.starts_with(key)).unwrap() + 1;
    for (from, to, key, message) in [
        ("hidden_bias = [", "hidden_bias = [1, ", "hidden =", "`hidden`: 12 units with 13 biases"),
        ("output = [[", "output = [[7, ", "output =", "`output`: expected 3 rows of as many"),
        ("shift = ", "shift = 77 # ", "shift =", "`shift`: shift of quantised is out of range"),
    ] {
        let error = parse(&text.replacen(from, to, 1)).unwrap_err();
        let expected = format!("cal.toml:{}: {message}", line(key));
        assert!(error.contains(&expected), "{error}\n  lacks {expected}");
    }
}

#[test]
fn damage_is_an_error_with_line_and_mend() {
    let text = written(&record(&[0.5, -0.25]));
    let crc = text.lines().find(|line| line.starts_with("crc32")).unwrap().to_owned();
    let cases = [
        (String::new(), "cal.toml: the file is empty: expected a calibration in TOML; "),
        (
            text.replace("taxel_calibration = 2", "taxel_calibration = 7"),
            "cal.toml:1: `taxel_calibration`: version 7 where this build reads 2; fit it again",
        ),
        (
            text.replace("\"finger\"", "\"table\""),
            "cal.toml:2: `kind`: a table calibration where a finger one is needed; ",
        ),
        (
            text.replace(&crc, "crc32 = \"00000000\""),
            "cal.toml:3: `crc32`: says 00000000, the contents give ",
        ),
        (text.replacen("0.31", "0.32", 1), "cal.toml:3: `crc32`: says "),
        (text.replacen("0.31", "oops", 1), "cal.toml:9: "),
        (text.replacen("0.31", "nan", 1), "cal.toml:9: `bias`: bias of taxels is out of range; "),
        (text.replace("sensor = 1", "sensor = 9"), ": `sensor`: there is no sensor 9: 0…3; "),
        (
            text.replace("date = \"20", "date = \"x"),
            "cal.toml:5: `date`: `x26-11-21T09:30:00Z` is not a date",
        ),
    ];
    for (text, message) in cases {
        let error = parse(&text).unwrap_err();
        assert!(error.contains(message), "{error}\n  lacks {message}");
        assert!(!error.contains('\n'), "{error}");
    }
}

#[test]
fn kind_is_read_without_the_rest() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cal.toml");
    calibration::write(&path, &record(&[1.0])).unwrap();
    assert_eq!(calibration::kind(&path), Ok(Kind::Finger));
}
