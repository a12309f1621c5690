use super::*;
use crate::estimate::array::WrenchMethod;
use crate::estimate::field::{Field, Radial};
use crate::estimate::intrinsic::Surface;
use crate::estimate::inverse::{Centres, Curves};
use crate::estimate::net::{ForceNet, Layers, Unit};
use crate::estimate::quantised::{QuantisedNet, Rows};
use crate::estimate::wrench::{SensorPlaces, WrenchMatrix};
use crate::units::Millimetres;

fn largest() -> Calibration {
    let bias = TaxelBias { level: [0.3; TAXELS], noise: 1e-4 };
    let unit = Unit { weights: [0.5; TAXELS], bias: 0.1, output: [0.25; 3] };
    let net = ForceNet {
        units: core::iter::repeat_n(unit, 24).collect(),
        skip: Some([[0.125; TAXELS]; 3]),
        output_bias: [0.0; 3].into(),
    };
    let sensor = SensorCalibration {
        bias: BridgeBias { level: [0.01; 3], noise: 1e-4 },
        sensitivity: Sensitivity([[1.0; 3]; 3]),
        range: [[-0.1, 0.1]; 3],
        residual: [0.001; 3],
    };
    Calibration {
        serial: String::try_from("0123456789abcdef0123456789abcdef").unwrap(),
        date: u64::MAX,
        taxels: Some(TaxelCalibration { bias, range: [[-0.5, 0.1]; TAXELS], residual: [0.01; 3] }),
        net: Some(Net::Float(net)),
        model: Some(Inverse {
            curves: Curves {
                stray: [[0.01, 0.02, 0.03, 0.04]; TAXELS],
                gap: [[1.0, 2.0, 3.0, 4.0, 5.0]; TAXELS],
            },
            field: Field {
                normal: Radial { depth: [6.25, 2.0], terms: [[1.0, 0.5, 0.25]; 4] },
                shear: Radial { depth: [6.5, 2.5], terms: [[2.5, 0.0, 0.75]; 4] },
                slip: -0.4,
            },
            error: [1e-3, 2e-3],
            shear: true,
            friction: 0.8,
            centres: Centres([[0.5; 2]; TAXELS]),
        }),
        slip: Some(Slip::usual(0.8)),
        warmth: Some(TemperatureCompensation {
            reference: 0.23,
            range: [0.22, 0.24],
            light: -6.6,
            sensitivity: -4.4,
            offset: [[0.05, -0.02, 0.01]; SENSORS],
        }),
        lag: Some(LagCompensation { taxels: 4.36e-3, sensors: 3.98e-3 }),
        drift: Some(DriftCompensation { most: 0.05 }),
        sensors: core::array::from_fn(|_| Some(sensor.clone())),
        array: Some(Array {
            method: WrenchMethod::Matrix(WrenchMatrix([[[0.5; 3]; SENSORS]; 6])),
            residual: [0.001; 3],
            moment_residual: 0.01,
            surface: Surface::Ellipsoid {
                half_axes: [Millimetres(9.0), Millimetres(12.0), Millimetres(15.0)],
            },
        }),
    }
}

fn float(record: &mut Calibration) -> &mut ForceNet {
    let Some(Net::Float(net)) = &mut record.net else { panic!("a net in f32") };
    net
}

/// Recomputes the CRC after a change.
fn sealed(bytes: &mut [u8]) -> &[u8] {
    let end = bytes.len() - 4;
    let crc = crc32(&bytes[..end]).to_le_bytes();
    bytes[end..].copy_from_slice(&crc);
    bytes
}

fn bytes(calibration: &Calibration) -> std::vec::Vec<u8> {
    let mut buffer = [0; MAX_BYTES];
    calibration.to_bytes(&mut buffer).unwrap().to_vec()
}

#[test]
fn largest_record_round_trips() {
    assert_eq!(Calibration::from_bytes(&bytes(&largest())), Ok(largest()));
}

#[test]
fn reading_drops_sections_missing_in_record() {
    let without = Calibration { net: None, ..largest() };
    let mut place = largest();
    place.read(&bytes(&without)).unwrap();
    assert_eq!(place, without);
    let weights = 4 * (24 * 16 + 24 + 3 * 24 + 3 * 16 + 3);
    let saved = bytes(&largest()).len() - bytes(&without).len();
    assert!((weights..weights + 16).contains(&saved), "{saved}");
    let empty = Calibration::default();
    assert_eq!(Calibration::from_bytes(&bytes(&empty)), Ok(empty));
}

/// The largest record with its net in 16 bits, of a given shape.
fn quantised(hidden: usize, outputs: usize, skip: bool) -> Calibration {
    let weight = |i: usize| (i * 37 % 101) as f32 / 50.0 - 1.0;
    let list = |count: usize| (0..count).map(weight).collect::<std::vec::Vec<_>>();
    // Without a contact the forces stay below 1 N.
    let small = |count: usize| list(count).iter().map(|w| 0.02 * w).collect::<std::vec::Vec<_>>();
    let net = ForceNet::new(&Layers {
        hidden: &list(hidden * 16),
        hidden_bias: &list(hidden),
        output: &small(outputs * hidden),
        skip: &list(usize::from(skip) * outputs * 16),
        output_bias: &small(outputs),
    })
    .unwrap();
    Calibration { net: QuantisedNet::new(&net, 0.6).map(Net::Quantised), ..largest() }
}

#[test]
fn quantised_net_round_trips() {
    for (hidden, outputs, skip) in [(16, 3, false), (6, 3, true), (32, 1, true), (0, 3, true)] {
        let record = quantised(hidden, outputs, skip);
        assert!(matches!(record.net, Some(Net::Quantised(_))));
        assert_eq!(Calibration::from_bytes(&bytes(&record)), Ok(record));
    }
}

#[test]
fn net_in_f32_precedes_net_in_16_bits() {
    // Both have no section but the taxels' and the net's: a body ends where the CRC begins.
    let only = |net| Calibration { net, taxels: largest().taxels, ..Calibration::default() };
    let float = only(largest().net);
    let mut both = bytes(&float);
    let section = bytes(&only(quantised(16, 3, true).net));
    let head = bytes(&only(None)).len() - 4;
    both.truncate(both.len() - 4);
    both.extend(&section[head..]);
    assert_eq!(Calibration::from_bytes(sealed(&mut both)), Ok(float));
}

#[test]
fn record_that_cannot_measure_fails_rehearsal() {
    let only = |change: fn(&mut Calibration)| {
        let mut record = largest();
        change(&mut record);
        assert_eq!(record.validate(), Ok(()), "every field is accepted by itself");
        match record.rehearse() {
            Err(error @ CalibrationError::Rehearsal { section }) => {
                let read = Calibration::from_bytes(&bytes(&record));
                assert_eq!(read, Err(error), "a finger refuses it");
                section
            }
            other => panic!("{other:?}"),
        }
    };
    fn noisy(record: &mut Calibration) {
        record.taxels.as_mut().unwrap().bias.noise = 0.02;
        record.sensors.iter_mut().flatten().for_each(|sensor| sensor.bias.noise = 0.02);
        let gains = |sensor: &mut SensorCalibration| sensor.sensitivity.0[2] = [1.5, 2.5, 7.0];
        record.sensors.iter_mut().flatten().for_each(gains);
        record.model = None;
    }
    assert_eq!(only(|r| float(r).output_bias[2] = -4.0), 2);
    assert_eq!(only(|r| float(r).units[3].output[0] = 1e4), 2);
    assert_eq!(only(|r| r.net = quantised(16, 3, true).net.map(offset)), 2);
    let deaf = |r: &mut Calibration| {
        noisy(r);
        r.net = None;
    };
    assert_eq!(only(deaf), 16);
    let deaf = |r: &mut Calibration| {
        noisy(r);
        float(r).skip = Some([[-1.0; TAXELS]; 3]);
    };
    assert_eq!(only(deaf), 1);
    // A net that says 6 N at the threshold's dents, and nothing for as much more light.
    let deaf = |r: &mut Calibration| {
        noisy(r);
        let dented = Unit { weights: [-4.0; TAXELS], bias: -3.0, output: [3.0; 3] };
        let (units, output_bias) = ([dented].into_iter().collect(), [3.0; 3].into());
        *float(r) = ForceNet { units, skip: None, output_bias };
    };
    assert_eq!(only(deaf), 1);
    // One sensor that notices a contact suffices.
    let mut one = largest();
    noisy(&mut one);
    one.sensors[1].as_mut().unwrap().bias.noise = 1e-4;
    assert_eq!((one.rehearse(), Calibration::EMPTY.rehearse()), (Ok(()), Ok(())));
}

fn offset(net: Net) -> Net {
    let Net::Quantised(mut net) = net else { panic!() };
    net.output_bias[1] = 3.0;
    Net::Quantised(net)
}

#[test]
fn quantised_net_refuses_possible_overflow() {
    let refused = |change: fn(&mut QuantisedNet)| {
        let mut record = quantised(32, 3, true);
        let Some(Net::Quantised(net)) = &mut record.net else { panic!() };
        change(net);
        match record.validate() {
            Err(CalibrationError::Field { section, field }) => names(section, field).unwrap(),
            other => panic!("{other:?}"),
        }
    };
    // Two weights of −2¹⁵ times signals of −2¹⁵ each make 2³¹.
    const LARGE: [i16; 16] = [i16::MIN; 16];
    assert_eq!(
        refused(|net| net.hidden[3].weights = Rows::new(&[LARGE; 4])),
        ("quantised", "hidden")
    );
    assert_eq!(refused(|net| net.hidden[3].bias[1] = i32::MIN), ("quantised", "hidden"));
    assert_eq!(refused(|net| net.shift = 32), ("quantised", "shift"));
    assert_eq!(refused(|net| net.output[1] = Rows::new(&[LARGE; 3])), ("quantised", "output"));
    assert_eq!(refused(|net| net.output.truncate(1)), ("quantised", "output"));
    assert_eq!(refused(|net| net.output_bias.truncate(2)), ("quantised", "output"));
    assert_eq!(refused(|net| net.skip = Some(Rows::new(&[LARGE; 3]))), ("quantised", "skip"));
    assert_eq!(refused(|net| net.scale[0] = f32::NAN), ("quantised", "scale"));
    assert_eq!(refused(|net| net.signal = 0.0), ("quantised", "signal"));
    assert_eq!(refused(|net| (net.skip, net.hidden) = Default::default()), ("quantised", "hidden"));
}

#[test]
fn any_flipped_bit_fails_the_crc() {
    let mut bytes = bytes(&largest());
    for bit in 0..bytes.len() * 8 {
        bytes[bit / 8] ^= 1 << (bit % 8);
        assert_eq!(Calibration::from_bytes(&bytes), Err(CalibrationError::Crc));
        bytes[bit / 8] ^= 1 << (bit % 8);
    }
}

#[test]
fn unknown_version_is_reported() {
    for found in [0, 1, VERSION + 1, 0xffff] {
        let mut bytes = bytes(&largest());
        bytes[..2].copy_from_slice(&found.to_le_bytes());
        let refused = Calibration::from_bytes(sealed(&mut bytes));
        assert_eq!(refused, Err(CalibrationError::Version { found }));
    }
}

#[test]
fn wrong_section_lists_are_malformed() {
    let only = |sections: &[(u8, &[u8])]| {
        let mut bytes = VERSION.to_le_bytes().to_vec();
        bytes.extend([0, 0]);
        for (number, body) in sections {
            bytes.push(*number);
            bytes.extend((body.len() as u16).to_le_bytes());
            bytes.extend(*body);
        }
        bytes.extend([0; 4]);
        Calibration::from_bytes(sealed(&mut bytes))
    };
    let mut section = [0; 200];
    let sensor = largest().sensors[0].clone();
    let sensor = postcard::to_slice(&sensor.unwrap(), &mut section).unwrap();
    assert!(only(&[(16, sensor), (18, sensor)]).is_ok());
    let long = [&*sensor, &[0]].concat();
    for wrong in [
        &[(16, &*sensor), (16, sensor)][..],
        &[(18, sensor), (16, sensor)],
        &[(99, sensor)],
        &[(16, &sensor[1..])],
        &[(16, &long)],
        &[(16, &[])],
    ] {
        assert_eq!(only(wrong), Err(CalibrationError::Malformed), "{wrong:?}");
    }
}

#[test]
fn section_numbers_are_unique() {
    let numbers: std::collections::BTreeSet<u8> = SECTIONS.iter().map(|e| e.number).collect();
    assert_eq!(numbers.len(), SECTIONS.len());
    assert_eq!(SECTIONS.iter().map(|entry| entry.since).max(), Some(VERSION));
}

#[test]
fn fields_out_of_range_are_refused_by_name() {
    let refused = |change: fn(&mut Calibration)| {
        let mut record = largest();
        change(&mut record);
        match record.validate() {
            Err(CalibrationError::Field { section, field }) => names(section, field).unwrap(),
            other => panic!("{other:?}"),
        }
    };
    fn taxels(r: &mut Calibration) -> &mut TaxelCalibration {
        r.taxels.as_mut().unwrap()
    }
    fn sensor(r: &mut Calibration, i: usize) -> &mut SensorCalibration {
        r.sensors[i].as_mut().unwrap()
    }
    assert_eq!(refused(|r| taxels(r).bias.level[3] = f32::NAN), ("taxels", "bias"));
    assert_eq!(refused(|r| taxels(r).bias.noise = 0.0), ("taxels", "noise"));
    assert_eq!(refused(|r| taxels(r).range[0] = [1.0, 1.0]), ("taxels", "range"));
    assert_eq!(refused(|r| taxels(r).residual[1] = f32::INFINITY), ("taxels", "residual_n"));
    assert_eq!(refused(|r| float(r).units[7].weights[3] = f32::NAN), ("force", "hidden"));
    assert_eq!(refused(|r| float(r).units[7].bias = f32::INFINITY), ("force", "hidden"));
    assert_eq!(refused(|r| float(r).units[7].output[1] = 1e30), ("force", "output"));
    assert_eq!(refused(|r| float(r).output_bias.truncate(2)), ("force", "output"));
    assert_eq!(refused(|r| float(r).skip = Some([[f32::NAN; 16]; 3])), ("force", "skip"));
    assert_eq!(
        refused(|r| {
            float(r).units.clear();
            float(r).skip = None;
        }),
        ("force", "hidden")
    );
    assert_eq!(refused(|r| sensor(r, 2).sensitivity.0[1][1] = f32::NAN), ("s2", "sensitivity"));
    assert_eq!(refused(|r| sensor(r, 3).range[0][1] = -9.0), ("s3", "range"));
    assert_eq!(refused(|r| sensor(r, 0).bias.noise = -1.0), ("s0", "noise"));
    assert_eq!(refused(|r| sensor(r, 0).bias.level[0] = 3.0), ("s0", "bias"));
    assert_eq!(refused(|r| sensor(r, 1).residual[0] = -1.0), ("s1", "residual_n"));
    fn model(r: &mut Calibration) -> &mut Inverse {
        r.model.as_mut().unwrap()
    }
    fn slip(r: &mut Calibration) -> &mut Slip {
        r.slip.as_mut().unwrap()
    }
    fn array(r: &mut Calibration) -> &mut Array {
        r.array.as_mut().unwrap()
    }
    assert_eq!(refused(|r| model(r).curves.stray[3][1] = 1.0), ("model", "stray"));
    assert_eq!(refused(|r| model(r).curves.gap[3][1] = f32::NAN), ("model", "gap"));
    assert_eq!(refused(|r| model(r).field.normal.depth[1] = 1e30), ("model", "normal"));
    assert_eq!(refused(|r| model(r).field.shear.terms[3][2] = f32::NAN), ("model", "shear"));
    assert_eq!(refused(|r| model(r).field.slip = -1.5), ("model", "slip"));
    assert_eq!(refused(|r| model(r).error[0] = 0.0), ("model", "error"));
    assert_eq!(refused(|r| model(r).friction = 0.0), ("model", "friction"));
    assert_eq!(refused(|r| slip(r).usual[0] = 0.0), ("slip", "usual"));
    assert_eq!(refused(|r| slip(r).surface.radius[0] = f32::NAN), ("slip", "radius"));
    assert_eq!(refused(|r| slip(r).surface.torque = 2.0), ("slip", "torque"));
    assert_eq!(refused(|r| slip(r).surface.curve[8] = 0.0), ("slip", "curve"));
    assert_eq!(refused(|r| slip(r).warn = 1.5), ("slip", "warn"));
    assert_eq!(refused(|r| slip(r).safety = 0.5), ("slip", "safety"));
    assert_eq!(refused(|r| array(r).residual[2] = 0.0), ("array", "residual"));
    assert_eq!(refused(|r| array(r).moment_residual = 0.0), ("array", "moment_residual"));
    assert_eq!(
        refused(|r| array(r).surface = Surface::Sphere { radius: Millimetres(0.0) }),
        ("array", "surface")
    );
    assert_eq!(
        refused(|r| array(r).method = WrenchMethod::Sum(SensorPlaces([[f32::INFINITY; 3]; 4]))),
        ("array", "method")
    );
    assert_eq!(names(2, 9), None);
    assert_eq!(names(99, 0), None);
}

#[test]
fn linear_net_still_needs_taxels() {
    let mut linear = largest();
    float(&mut linear).units.clear();
    assert_eq!(linear.validate(), Ok(()));
    linear.taxels = None;
    assert_eq!(linear.validate(), Err(CalibrationError::WithoutTaxels { section: 2 }));
    linear.net = None;
    assert_eq!(linear.validate(), Err(CalibrationError::WithoutTaxels { section: 3 }));
    linear.model = None;
    assert_eq!(linear.validate(), Ok(()));
}
