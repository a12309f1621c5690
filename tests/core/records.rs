//! Records with every field drawn on its own: no accepted one gives a value that is infinite, NaN
//! or beyond what a fingertip can measure, and no memory keeps such a value.
//!
//! Ten million records: `TAXEL_LONG=1 cargo test --release -p taxel --test core-tests records::`.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use taxel::calibration::TaxelCalibration;
use taxel::calibration::{Calibration, CalibrationError, Range, SensorCalibration};
use taxel::condition::{
    BridgeBias, DriftCompensation, LagCompensation, LowPass, TaxelBias, TemperatureCompensation,
};
use taxel::estimate::ContactPoint;
use taxel::estimate::array::{Array, WrenchMethod};
use taxel::estimate::contact_point::PointMethod;
use taxel::estimate::field::{Field, Radial};
use taxel::estimate::intrinsic::Surface;
use taxel::estimate::inverse::{Centres, Curves, Inverse};
use taxel::estimate::limit_surface::LimitSurface;
use taxel::estimate::net::{ForceNet, Unit};
use taxel::estimate::quantised::{Group, Net, QuantisedNet, Rows};
use taxel::estimate::sensitivity::Sensitivity;
use taxel::estimate::slip::Slip;
use taxel::estimate::wrench::{SensorPlaces, WrenchMatrix};
use taxel::finger::{Estimate, Finger};
use taxel::frame::Status;
use taxel::measured::Measured;
use taxel::scan::{Codes, Scan, TAXELS};
use taxel::units::{Code, Micros, Millimetres, Newtons};

use crate::common::unloaded;
use crate::hostile::possible;

/// Decades over which a number without a lower bound is drawn.
const DECADES: f32 = 24.0;

struct Draw(ChaCha8Rng);

impl Draw {
    fn share(&mut self) -> f32 {
        self.0.random::<f32>()
    }

    fn one_in(&mut self, n: u32) -> bool {
        self.0.random_range(0..n) == 0
    }

    /// Draws a number between two positive ones, log-uniform.
    fn between(&mut self, low: f32, high: f32) -> f32 {
        let exponent = low.log2() + (high.log2() - low.log2()) * self.share();
        exponent.exp2().clamp(low, high)
    }

    /// Draws a number of either sign up to `most`.
    fn signed(&mut self, most: f32) -> f32 {
        let sign = if self.one_in(2) { -1.0 } else { 1.0 };
        sign * self.between(most * 10f32.powf(-DECADES), most)
    }

    fn list<const N: usize>(&mut self, mut draw: impl FnMut(&mut Self) -> f32) -> [f32; N] {
        core::array::from_fn(|_| draw(self))
    }

    fn rows<const N: usize, const M: usize>(&mut self, most: f32) -> [[f32; N]; M] {
        core::array::from_fn(|_| self.list(|draw| draw.signed(most)))
    }

    /// Draws ranges of signals: half of them hold every signal, because one of sixteen narrow
    /// ones would end nearly every estimate.
    fn ranges<const N: usize>(&mut self) -> [Range; N] {
        let wide = self.one_in(2);
        core::array::from_fn(|_| match wide {
            true => [-100.0, 100.0],
            false => [-self.between(1e-3, 100.0), self.between(1e-3, 100.0)],
        })
    }

    fn taxels(&mut self) -> TaxelCalibration {
        // Half of the levels are near those of the codes: others make dead taxels.
        let near = self.one_in(2);
        let level = self.list(|draw| if near { 0.3 } else { draw.signed(2.0) });
        let noise = self.between(1e-9, 0.02);
        let residual = self.list(|draw| draw.between(1e-9, 999.0));
        TaxelCalibration { bias: TaxelBias { level, noise }, range: self.ranges(), residual }
    }

    fn net(&mut self) -> Net {
        let outputs = if self.one_in(4) { 1 } else { 3 };
        let skip = self.one_in(2);
        if self.one_in(2) {
            // Few units mostly: each has a say in whether the net is 0 N without a contact.
            let units = self.between(1.0, 32.0) as u32 - u32::from(skip && self.one_in(2));
            let unit = |draw: &mut Self| Unit {
                weights: draw.list(|draw| draw.signed(9e8)),
                bias: draw.signed(9e8),
                output: draw.list(|draw| draw.signed(9e8)),
            };
            return Net::Float(ForceNet {
                units: (0..units).map(|_| unit(self)).collect(),
                skip: skip.then(|| self.rows(9e8)),
                output_bias: (0..outputs).map(|_| self.signed(9e8)).collect(),
            });
        }
        // Sums of products stay within 32 bits.
        let groups = self.between(1.0, 8.0) as usize - usize::from(skip && self.one_in(2));
        let group = |draw: &mut Self| Group {
            weights: draw.words(2000.0),
            bias: core::array::from_fn(|_| draw.signed(1e9) as i32),
        };
        Net::Quantised(QuantisedNet {
            signal: self.between(1.0, 9e8),
            hidden: (0..groups).map(|_| group(self)).collect(),
            shift: self.0.random_range(0..=31),
            output: (0..groups.div_ceil(4)).map(|_| self.words(2000.0)).collect(),
            skip: skip.then(|| self.words(4000.0)),
            scale: self.list(|draw| draw.signed(9e8)),
            output_bias: (0..outputs).map(|_| self.signed(9e8)).collect(),
        })
    }

    fn words<const N: usize>(&mut self, most: f32) -> Rows<N> {
        Rows::new(&core::array::from_fn(|_| core::array::from_fn(|_| self.signed(most) as i16)))
    }

    fn radial(&mut self) -> Radial {
        Radial { depth: self.list(|draw| draw.signed(1e9)), terms: self.rows(1e9) }
    }

    fn model(&mut self) -> Inverse {
        Inverse {
            curves: Curves { stray: self.rows(0.999), gap: self.rows(1e9) },
            field: Field { normal: self.radial(), shear: self.radial(), slip: self.signed(1.0) },
            error: [self.between(1e-9, 0.999), self.between(1e-9, 0.999)],
            shear: self.one_in(2),
            friction: self.between(0.01, 9.99),
            centres: if self.one_in(2) { Centres::default() } else { Centres(self.rows(10.0)) },
        }
    }

    fn slip(&mut self) -> Slip {
        Slip {
            usual: [self.between(0.05, 2.0), self.between(1e-6, 20.0)],
            surface: LimitSurface {
                radius: [self.between(1e-3, 999.0), self.between(1e-6, 1.0)],
                torque: self.between(1e-3, 1.0),
                curve: self.list(|draw| draw.between(0.5, 1.5)),
            },
            warn: self.between(1e-6, 1.0),
            safety: self.between(1.0, 100.0),
        }
    }

    fn warmth(&mut self) -> TemperatureCompensation {
        let [range] = self.ranges();
        TemperatureCompensation {
            reference: self.between(1e-6, 1.0),
            range,
            light: self.signed(10.9),
            sensitivity: self.signed(10.9),
            offset: self.rows(1e3),
        }
    }

    fn lag(&mut self) -> LagCompensation {
        LagCompensation { taxels: self.between(1e-4, 0.05), sensors: self.between(1e-4, 0.05) }
    }

    fn sensor(&mut self) -> SensorCalibration {
        let bias = BridgeBias {
            level: self.list(|draw| draw.signed(2.0)),
            noise: self.between(1e-9, 0.02),
        };
        let residual = self.list(|draw| draw.between(1e-9, 999.0));
        let sensitivity = Sensitivity(self.rows(1e6));
        SensorCalibration { bias, sensitivity, range: self.ranges(), residual }
    }

    fn array(&mut self) -> Array {
        let axis = |draw: &mut Self| Millimetres(draw.between(1e-3, 1e3));
        Array {
            method: match self.one_in(2) {
                true => WrenchMethod::Sum(SensorPlaces(self.rows(1e3))),
                false => WrenchMethod::Matrix(WrenchMatrix([(); 6].map(|()| self.rows(1e9)))),
            },
            residual: self.list(|draw| draw.between(1e-9, 999.0)),
            moment_residual: self.between(1e-9, 999.0),
            surface: match self.0.random_range(0..3) {
                0 => Surface::Plane,
                1 => Surface::Sphere { radius: axis(self) },
                _ => Surface::Ellipsoid { half_axes: [axis(self), axis(self), axis(self)] },
            },
        }
    }

    /// Draws a record that a finger accepts; a refused section is drawn again.
    fn record(&mut self) -> Calibration {
        let mut record = Calibration {
            taxels: Some(self.taxels()),
            net: (!self.one_in(3)).then(|| self.net()),
            model: (!self.one_in(3)).then(|| self.model()),
            slip: (!self.one_in(4)).then(|| self.slip()),
            warmth: self.one_in(2).then(|| self.warmth()),
            lag: self.one_in(2).then(|| self.lag()),
            drift: self.one_in(2).then(|| DriftCompensation { most: self.between(1e-6, 0.2) }),
            array: (!self.one_in(3)).then(|| self.array()),
            sensors: core::array::from_fn(|_| self.one_in(2).then(|| self.sensor())),
            ..Calibration::EMPTY
        };
        loop {
            match record.validate().and_then(|()| record.rehearse()) {
                Ok(()) => return record,
                Err(CalibrationError::Rehearsal { section: 1 }) => {
                    (record.taxels, record.net) = (Some(self.taxels()), Some(self.net()));
                }
                Err(
                    CalibrationError::Rehearsal { section: 2 }
                    | CalibrationError::Field { section: 5, .. },
                ) => record.net = Some(self.net()),
                Err(CalibrationError::Rehearsal { section: 16 }) => {
                    record.sensors = core::array::from_fn(|_| Some(self.sensor()));
                }
                Err(error) => panic!("{error} of {record:?}"),
            }
        }
    }

    /// Draws codes that a finger can read: some taxels brighter, bridges off their middle.
    fn codes(&mut self) -> Codes {
        let mut codes = unloaded(0).codes;
        for lit in codes.taxels.iter_mut().flat_map(|taxels| taxels.lit.as_flattened_mut()) {
            lit.0 = lit.0.saturating_add_signed(self.signed(30_000.0) as i16);
        }
        let middle = codes.bridges[0];
        codes.bridges = core::array::from_fn(|_| {
            let mut midpoints = middle?;
            for code in [&mut midpoints.a, &mut midpoints.b, &mut midpoints.c, &mut midpoints.d] {
                code.0 = code.0.saturating_add_signed(self.signed(6_000.0) as i16);
            }
            Some(midpoints)
        });
        codes.temperature = Some(Code(self.between(1.0, 65_535.0) as u16));
        codes
    }
}

#[derive(Default)]
struct Seen {
    ran: Status,
    scans: u64,
    known: u64,
    withheld: u64,
}

impl Seen {
    fn note(&mut self, estimate: &Estimate) {
        self.ran |= estimate.status;
        self.scans += 1;
        self.known += u64::from(estimate.force.z.is_ok_and(|force| force.0 != 0.0));
        self.withheld += u64::from(estimate.status.contains(Status::OUT_OF_RANGE));
    }
}

/// Estimates with `records` drawn records; `plant` may change the estimates of a record.
///
/// Fails at an impossible value, and at one that is not finite in the memory.
fn campaign(records: u64, mut plant: impl FnMut(u64, &mut Estimate)) -> Result<Seen, String> {
    let long = std::env::var_os("TAXEL_LONG").is_some();
    let mut draw = Draw(ChaCha8Rng::seed_from_u64(24));
    let mut seen = Seen::default();
    for i in 0..records {
        let (mut finger, mut state) = Finger::new(Some(draw.record()));
        finger.point_method =
            [PointMethod::Model, PointMethod::Centroid, PointMethod::ArgMin][i as usize % 3];
        finger.filter = draw.one_in(4).then(|| LowPass::new(500, 4000));
        let mut codes = draw.codes();
        for t in 0..12 {
            if t % 4 == 0 {
                codes = draw.codes();
            }
            let scan = Scan { time: Micros(1000 * t), lost: 0, codes };
            let mut estimate = finger.estimate(&mut state, &scan);
            plant(i, &mut estimate);
            if !possible(&estimate) {
                return Err(format!("record {i}, scan {t}: {estimate:?} of {finger:?}"));
            }
            seen.note(&estimate);
        }
        if !long || i % 64 == 0 {
            let memory = format!("{state:?}");
            if memory.contains("NaN") || memory.contains("inf") {
                return Err(format!("record {i}: {memory} of {finger:?}"));
            }
        }
    }
    Ok(seen)
}

#[test]
fn no_accepted_record_gives_an_impossible_value() {
    let long = std::env::var_os("TAXEL_LONG").is_some();
    let records: u64 = if long { 10_000_000 } else { 20_000 };
    let Seen { ran, scans, known, withheld } = campaign(records, |_, _| {}).unwrap();
    println!("{records} records, {scans} scans, {known} with a force, {withheld} out of range");
    assert!(ran.contains(Status::BUILT), "{ran:?} of {:?}", Status::BUILT);
    // Records that give nothing, or nothing possible, would prove little.
    assert!(known > scans / 20 && withheld > scans / 20, "{known} and {withheld} of {scans}");
}

fn at(x: f32, y: f32) -> Measured<ContactPoint> {
    Ok(ContactPoint { x: Millimetres(x), y: Millimetres(y) })
}

#[test]
fn impossible_values_of_one_record_are_noticed() {
    let plants: [fn(&mut Estimate); 6] = [
        |estimate| estimate.force.x = Ok(Newtons(f32::NAN)),
        |estimate| estimate.force.z = Ok(Newtons(201.0)),
        |estimate| estimate.sensors[3].y = Ok(Newtons(-201.0)),
        |estimate| estimate.signals.taxels = Some([f32::INFINITY; TAXELS]),
        |estimate| estimate.point = at(21.0, 0.0),
        |estimate| estimate.point = at(0.0, -21.0),
    ];
    for (number, plant) in plants.iter().enumerate() {
        let one = |i, estimate: &mut Estimate| {
            if i == 40 {
                plant(estimate)
            }
        };
        let found = campaign(50, one).err().unwrap_or_default();
        assert!(found.starts_with("record 40, scan 0"), "plant {number}: {found}");
    }
    assert!(campaign(50, |_, _| {}).is_ok());
}
