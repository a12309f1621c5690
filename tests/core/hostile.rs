//! No output is NaN, infinite or beyond what a fingertip can measure, for any codes and any
//! accepted calibration.

use crate::common::{LIT, MIDPOINT, everything, unloaded};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::condition::{LowPass, TemperatureCompensation};
use taxel::estimate::ContactPoint;
use taxel::estimate::array::WrenchMethod;
use taxel::estimate::contact_point::PointMethod;
use taxel::estimate::field::{Field, Radial};
use taxel::estimate::intrinsic::Surface;
use taxel::estimate::inverse::Curves;
use taxel::estimate::limit_surface::LimitSurface;
use taxel::estimate::net::{ForceNet, Unit};
use taxel::estimate::quantised::{Group, Net, QuantisedNet, Rows};
use taxel::estimate::slip::Slip;
use taxel::estimate::wrench::{SensorPlaces, WrenchMatrix};
use taxel::finger::{Estimate, Finger, FingerState};
use taxel::frame::Status;
use taxel::scan::{Codes, Midpoints, Scan, TaxelCodes};
use taxel::units::{Code, FullScale, Micros, Millimetres};

fn any_codes() -> impl Strategy<Value = Codes> {
    let midpoints = any::<[u16; 4]>().prop_map(|[a, b, c, d]| Midpoints {
        a: Code(a),
        b: Code(b),
        c: Code(c),
        d: Code(d),
    });
    (
        1u16..,
        proptest::option::of(any::<([[u16; 4]; 4], [u16; 4])>()),
        proptest::array::uniform4(proptest::option::of(midpoints)),
        any::<(Option<u16>, Option<u16>)>(),
    )
        .prop_map(|(top, taxels, bridges, (reference, temperature))| Codes {
            full_scale: FullScale::new(top).unwrap(),
            taxels: taxels.map(|(lit, dark)| TaxelCodes {
                lit: lit.map(|row| row.map(Code)),
                dark: dark.map(Code),
            }),
            bridges,
            reference: reference.map(Code),
            temperature: temperature.map(Code),
        })
}

/// Codes that a finger of this record can read: some taxels brighter, bridges near their middle.
///
/// [`any_codes`] breaks the bridges nearly always.
fn likely_codes() -> impl Strategy<Value = Codes> {
    let nearer = proptest::collection::vec((0..16usize, 0..30_000u16), 1..6);
    let bridges = any::<[[i8; 4]; 4]>();
    (nearer, bridges, 26_000..27_000u16).prop_map(|(nearer, bridges, temperature)| {
        let mut codes = unloaded(0).codes;
        let taxels = codes.taxels.as_mut().unwrap().lit.as_flattened_mut();
        nearer.into_iter().for_each(|(k, by)| taxels[k].0 = LIT + by);
        codes.bridges = bridges.map(|off| {
            let [a, b, c, d] =
                off.map(|off| Code(MIDPOINT.saturating_add_signed(8 * i16::from(off))));
            Some(Midpoints { a, b, c, d })
        });
        codes.temperature = Some(Code(temperature));
        codes
    })
}

/// Checks that all numbers are finite, forces within 200 N and places within 20 mm.
pub fn possible(estimate: &Estimate) -> bool {
    let forces = estimate.sensors.iter().chain([&estimate.force]);
    let newtons = forces.clone().flat_map(|f| [f.x, f.y, f.z]).flatten().map(|n| n.0);
    let pairs = || estimate.contacts.into_iter().flatten();
    let newtons = newtons.chain(pairs().map(|c| c.normal.0));
    let mut newtons = newtons.chain(estimate.slip.into_iter().map(|v| v.grip.0));
    let mut places = estimate.point.into_iter().chain(pairs().map(|c| c.point));
    newtons.all(|n| n.abs() <= 200.0)
        && places.all(|p| p.x.0.abs() <= 20.0 && p.y.0.abs() <= 20.0)
        && finite(estimate)
}

pub fn finite(estimate: &Estimate) -> bool {
    let forces = estimate.sensors.iter().chain([&estimate.force]);
    let forces = forces.flat_map(|f| [f.x, f.y, f.z]).flatten().map(|n| n.0);
    let at = |p: ContactPoint| [p.x.0, p.y.0];
    let contacts = estimate.contacts.into_iter().flatten();
    let slip = estimate.slip.into_iter().flat_map(|v| [v.margin, v.friction, v.grip.0]);
    let unsure = estimate.uncertainty.into_iter().flat_map(|sure| {
        let force = [sure.force.x, sure.force.y, sure.force.z];
        let force = force.into_iter().flatten().map(|n| n.0);
        force.chain(sure.point.into_iter().flat_map(at)).chain(sure.misfit)
    });
    forces
        .chain(unsure)
        .chain(estimate.point.into_iter().flat_map(at))
        .chain(contacts.flat_map(|c| [c.point.x.0, c.point.y.0, c.normal.0]))
        .chain(slip)
        .chain(estimate.torsion.into_iter().map(|t| t.0))
        .chain(estimate.signals.taxels.into_iter().flatten())
        .chain(estimate.signals.bridges.into_iter().flatten().flatten())
        .all(f32::is_finite)
}

/// A net in 16 bits with sums as large as a record may have.
///
/// It replaces the other net, because a finger runs only one.
fn hostile_in_sixteen_bits(weight: f32) -> QuantisedNet {
    // Sums of products stay within 32 bits: 1000 · 2¹⁵ · 32 is half of that range.
    let most: [i16; 16] = core::array::from_fn(|k| if k % 2 == 0 { -1000 } else { 1000 });
    let sign = if weight < 0.0 { most } else { most.map(|w| !w) };
    let bias = [if weight < 0.0 { 1 } else { -1 }; 4];
    let group = Group { weights: Rows::new(&[sign; 4]), bias };
    QuantisedNet {
        signal: 1.0 + 9e8 * weight.abs().min(1.0),
        hidden: core::iter::repeat_n(group, 8).collect(),
        shift: 31,
        output: core::iter::repeat_n(Rows::new(&[most; 3]), 2).collect(),
        skip: Some(Rows::new(&[most; 3])),
        scale: [weight, -weight],
        output_bias: core::iter::repeat_n(weight, 3).collect(),
    }
}

/// Errors, slip and surface of a record, each at an end of its accepted range or inside.
#[derive(Clone, Copy, Debug)]
struct Ends {
    error: [f32; 2],
    friction: f32,
    shear: bool,
    /// Residuals of taxels and sensors, and of the array's forces and moments.
    residual: [f32; 2],
    surface: Surface,
    slip: Slip,
}

/// Draws an end of a range without its upper bound, or a value inside.
fn ends(low: f32, high: f32) -> impl Strategy<Value = f32> {
    prop_oneof![Just(low), Just(high.next_down()), low..high]
}

/// Draws an end of a range with its upper bound, or a value inside.
fn closed(low: f32, high: f32) -> impl Strategy<Value = f32> {
    ends(low, high.next_up())
}

fn any_slip() -> impl Strategy<Value = Slip> {
    let surface = (
        (ends(1e-3, 1e3), closed(0.0, 1.0)),
        closed(1e-3, 1.0),
        proptest::array::uniform9(closed(0.5, 1.5)),
    );
    let surface = surface.prop_map(|((c, gamma), torque, curve)| LimitSurface {
        radius: [c, gamma],
        torque,
        curve,
    });
    let rest = (closed(0.05, 2.0), closed(0.0, 20.0), closed(0.0, 1.0), closed(1.0, 100.0));
    (surface, rest).prop_map(|(surface, (friction, spread, warn, safety))| Slip {
        usual: [friction, spread],
        surface,
        warn,
        safety,
    })
}

fn any_surface() -> impl Strategy<Value = Surface> {
    let axis = || closed(1e-3, 1e3).prop_map(Millimetres);
    prop_oneof![
        Just(Surface::Plane),
        axis().prop_map(|radius| Surface::Sphere { radius }),
        // Radii near a fingertip's.
        (4.0..20.0f32).prop_map(|radius| Surface::Sphere { radius: Millimetres(radius) }),
        [(); 3].map(|()| axis()).prop_map(|half_axes| Surface::Ellipsoid { half_axes }),
    ]
}

/// Draws microseconds between scans, and the number of scans lost before every other one.
fn any_pace() -> impl Strategy<Value = (u64, u32)> {
    (prop_oneof![Just(1), Just(250), Just(1000), any::<u32>().prop_map(u64::from)], 0..3u32)
}

/// Scan `i` at a pace of [`any_pace`].
fn paced(i: u64, (apart, lost): (u64, u32), codes: Codes) -> Scan {
    Scan {
        time: Micros(i.wrapping_mul(apart)),
        lost: if i.is_multiple_of(2) { lost } else { 0 },
        codes,
    }
}

fn any_ends() -> impl Strategy<Value = Ends> {
    let error = (ends(1e-9, 1.0), ends(0.0, 1.0));
    let residual = (ends(0.0, 1e3), ends(1e-9, 1e3));
    (error, ends(0.01, 10.0), any::<bool>(), residual, any_surface(), any_slip()).prop_map(
        |(error, friction, shear, residual, surface, slip)| Ends {
            error: error.into(),
            friction,
            shear,
            residual: residual.into(),
            surface,
            slip,
        },
    )
}

/// A record whose every number is extreme but accepted.
fn hostile(weight: f32, level: f32, sixteen_bits: bool, ends: &Ends) -> Calibration {
    let mut record = everything();
    let taxels = record.taxels.as_mut().unwrap();
    taxels.bias.level = [level; 16];
    taxels.bias.noise = 1e-9;
    taxels.range = [[-99.0, 99.0]; 16];
    taxels.residual = [ends.residual[0]; 3];
    let unit = Unit { weights: [weight; 16], bias: -weight, output: [weight; 3] };
    record.net = Some(match sixteen_bits {
        true => Net::Quantised(hostile_in_sixteen_bits(weight)),
        false => Net::Float(ForceNet {
            units: core::iter::repeat_n(unit, 32).collect(),
            skip: Some([[weight; 16]; 3]),
            output_bias: [weight; 3].into(),
        }),
    });
    // Half of the light and of the sensitivity at the largest followed difference: 60 K of 758 µ
    // each.
    let share = 10.9 * (level / 2.0);
    record.warmth = Some(TemperatureCompensation {
        reference: level.abs() / 2.0,
        range: [-99.0, 99.0],
        light: share,
        sensitivity: -share,
        offset: [[weight.clamp(-1e3, 1e3); 3]; 4],
    });
    for sensor in record.sensors.iter_mut().flatten() {
        sensor.range = [[-99.0, 99.0]; 3];
        sensor.sensitivity.0 = [[weight.clamp(-9e5, 9e5); 3]; 3];
        sensor.residual = [ends.residual[0]; 3];
    }
    let model = record.model.as_mut().unwrap();
    model.curves = Curves { stray: [[level / 2.5; 4]; 16], gap: [[weight; 5]; 16] };
    let radial = Radial { depth: [level, weight], terms: [[weight, level, -weight]; 4] };
    model.field = Field { normal: radial, shear: radial, slip: level / 2.0 };
    (model.error, model.friction, model.shear) = (ends.error, ends.friction, ends.shear);
    record.slip = Some(ends.slip);
    let array = record.array.as_mut().unwrap();
    (array.residual, array.moment_residual) = ([ends.residual[1]; 3], ends.residual[1]);
    array.method = match level > 0.0 {
        true => WrenchMethod::Sum(SensorPlaces([[weight.clamp(-9e2, 9e2); 3]; 4])),
        false => WrenchMethod::Matrix(WrenchMatrix([[[weight.clamp(-9e8, 9e8); 3]; 4]; 6])),
    };
    array.surface = ends.surface;
    record
}

/// A working record with extreme values only in `ends`.
fn working(ends: &Ends, sensitivity: f32) -> Calibration {
    let mut record = everything();
    let taxels = record.taxels.as_mut().unwrap();
    (taxels.range, taxels.residual) = ([[-99.0, 99.0]; 16], [ends.residual[0]; 3]);
    let model = record.model.as_mut().unwrap();
    (model.error, model.friction, model.shear) = (ends.error, ends.friction, ends.shear);
    record.slip = Some(ends.slip);
    for sensor in record.sensors.iter_mut().flatten() {
        sensor.range = [[-99.0, 99.0]; 3];
        sensor.sensitivity.0.iter_mut().flatten().for_each(|s| *s *= sensitivity);
    }
    let array = record.array.as_mut().unwrap();
    (array.residual, array.moment_residual) = ([ends.residual[1]; 3], ends.residual[1]);
    array.surface = ends.surface;
    record
}

/// Checks that the drawn records reach every estimator, because others would prove nothing.
#[test]
fn hostile_records_run_every_estimator() {
    let mut runner = TestRunner::deterministic();
    let draw = (likely_codes(), any_ends());
    let mut ran = Status(0);
    for i in 0..200 {
        let (codes, ends) = draw.new_tree(&mut runner).unwrap().current();
        for record in [working(&ends, 1.0), hostile(0.5, 0.3, i % 2 == 0, &ends)] {
            let (mut finger, mut state) = Finger::new(Some(record));
            finger.point_method = match i % 3 {
                0 => PointMethod::Model,
                1 => PointMethod::Centroid,
                _ => PointMethod::ArgMin,
            };
            for t in 0..8 {
                let scan = Scan { time: Micros(1000 * t), lost: 0, codes };
                ran |= finger.estimate(&mut state, &scan).status;
            }
        }
    }
    assert!(ran.contains(Status::BUILT), "{ran:?} of {:?}", Status::BUILT);
}

/// Estimates six scans of each code set, and fails at an output that is not finite.
fn outputs_stay_finite(
    finger: &Finger,
    state: &mut FingerState,
    scans: &[Codes],
    pace: (u64, u32),
) -> Result<(), TestCaseError> {
    for (t, codes) in scans.iter().enumerate() {
        for i in 0..6 {
            let scan = paced(6 * t as u64 + i, pace, *codes);
            let estimate = finger.estimate(state, &scan);
            prop_assert!(possible(&estimate), "{estimate:?}");
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn outputs_are_finite_for_any_accepted_record(
        scans in proptest::collection::vec(prop_oneof![any_codes(), likely_codes()], 1..8),
        weight in prop_oneof![-9e8f32..9e8, -1e-38f32..1e-38, -10.0f32..10.0],
        level in -2.0f32..2.0,
        (sixteen_bits, taking) in any::<(bool, bool)>(),
        method in prop_oneof![
            Just(PointMethod::Model), Just(PointMethod::Centroid), Just(PointMethod::ArgMin),
        ],
        corner in proptest::option::of(1u16..2000),
        (ends, pace) in (any_ends(), any_pace()),
    ) {
        let record = hostile(weight, level, sixteen_bits, &ends);
        prop_assert_eq!(record.validate(), Ok(()));
        let (mut finger, mut state) = Finger::new(Some(record));
        finger.point_method = method;
        finger.filter = corner.map(|corner| LowPass::new(corner, 4000));
        if taking {
            state.take_bias(3);
        }
        outputs_stay_finite(&finger, &mut state, &scans, pace)?;
    }

    /// A finger with a point load's field and likely codes, for which the estimators run far.
    #[test]
    fn outputs_are_finite_at_ends_of_working_record(
        scans in proptest::collection::vec(likely_codes(), 1..8),
        ends in any_ends(),
        sensitivity in prop_oneof![ends(-9e5, 9e5), -10.0f32..10.0],
        method in prop_oneof![Just(PointMethod::Model), Just(PointMethod::Centroid)],
        pace in any_pace(),
    ) {
        let (mut finger, mut state) = Finger::new(Some(working(&ends, sensitivity)));
        prop_assert_eq!(finger.calibration().unwrap().validate(), Ok(()));
        finger.point_method = method;
        outputs_stay_finite(&finger, &mut state, &scans, pace)?;
    }

    #[test]
    fn calibration_reader_accepts_any_bytes(
        bytes in proptest::collection::vec(any::<u8>(), 0..300),
    ) {
        let _ = Calibration::from_bytes(&bytes);
    }

    #[test]
    fn overwritten_record_is_rejected_or_harmless(
        at in any::<usize>(), with in any::<[u8; 4]>(), codes in any_codes(),
    ) {
        // The test repairs the CRC, so that the fields' own checks must hold.
        let mut buffer = [0; MAX_BYTES];
        let length = everything().to_bytes(&mut buffer).unwrap().len();
        let at = 2 + at % (length - 10);
        buffer[at..at + 4].copy_from_slice(&with);
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&buffer[..length - 4]);
        buffer[length - 4..length].copy_from_slice(&crc.to_le_bytes());
        if let Ok(record) = Calibration::from_bytes(&buffer[..length]) {
            let (finger, mut state) = Finger::new(Some(record));
            for t in 0..8 {
                let scan = Scan { time: Micros(1000 * t), lost: 0, codes };
                prop_assert!(finite(&finger.estimate(&mut state, &scan)));
            }
        }
    }
}
