//! Stages of the costliest frame of the product.
//!
//! The record has every section that the firmware reads, each in its costliest form, and the scene
//! uses all of them. Stages named `product: …` must fit half a frame at 4 kHz (`cargo xtask
//! cycles`, `host-tools/xtask`). Every field of every scan exceeds USB's rate.

use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::estimate::array::{Array, WrenchMethod};
use taxel::estimate::contact_point::PointMethod;
use taxel::estimate::intrinsic::Surface;
use taxel::estimate::net::{ForceNet, MAX_HIDDEN, MAX_OUTPUTS, Unit};
use taxel::estimate::quantised::Net;
use taxel::estimate::slip::Slip;
use taxel::estimate::wrench::{SensorPlaces, WrenchMatrix};
use taxel::frame::Fields;
use taxel::scan::{Codes, SENSORS, Scan, TAXELS};
use taxel::units::{Code, Micros, Millimetres};
use taxel::wire::message::Command;

use super::frame::{Packet, instrument, whole};
use crate::Meter;
use crate::host::Inputs;

/// Time between two scans, microseconds.
const PERIOD: u64 = 250;
/// Scans without contact, enough for the vibration detector to learn its noise floor and band.
const UNTOUCHED: usize = 880;
const TOUCHED: usize = 138;
/// Code of the chip's temperature sensor.
const ROOM: Code = Code(15_000);

/// Costliest record with the content of `calibration`.
#[must_use]
pub fn costliest(calibration: &Calibration) -> Calibration {
    let sums = WrenchMethod::Matrix(as_matrix(calibration));
    Calibration {
        net: calibration.net.as_ref().and_then(Net::float).map(widest).map(Net::Float),
        // No record has room for it together with such a net.
        model: None,
        slip: Some(Slip::usual(0.5)),
        array: Some(Array {
            method: sums,
            residual: [1e-3; 3],
            moment_residual: 1e-3,
            surface: Surface::Ellipsoid { half_axes: [9.0, 12.0, 15.0].map(Millimetres) },
        }),
        ..calibration.clone()
    }
}

/// Equivalent net with as many units as fit, and a linear bypass that adds nothing.
fn widest(net: &ForceNet) -> ForceNet {
    let times = (MAX_HIDDEN / net.units.len().max(1)).max(1);
    let share = 1.0 / times as f32;
    let units = net.units.iter().cycle().take(times * net.units.len());
    ForceNet {
        units: units.map(|unit| Unit { output: unit.output.map(|v| share * v), ..*unit }).collect(),
        skip: Some([[0.0; TAXELS]; MAX_OUTPUTS]),
        output_bias: net.output_bias.clone(),
    }
}

/// Sum of the sensors' wrenches as a matrix of signals.
fn as_matrix(calibration: &Calibration) -> WrenchMatrix {
    let mut matrix = WrenchMatrix::default();
    for (i, sensor) in calibration.sensors.iter().enumerate() {
        let Some(sensor) = sensor else { continue };
        for axis in 0..3 {
            let unit = |j: usize, value: f32| if j == axis { value } else { 0.0 };
            let mut forces = [[0.0; 3]; SENSORS];
            if let Some(force) = forces.get_mut(i) {
                *force = sensor.sensitivity.force([0, 1, 2].map(|j| unit(j, 1.0)));
            }
            let wrench = SensorPlaces::default().wrench(&forces);
            let components = wrench.force.into_iter().chain(wrench.moment);
            for (row, value) in matrix.0.iter_mut().zip(components) {
                if let Some(place) = row.get_mut(i).and_then(|row| row.get_mut(axis)) {
                    *place = value;
                }
            }
        }
    }
    matrix
}

/// Scans at the product's rate: no contact, then contacts, then no contact.
fn scene<'a>(inputs: &Inputs<'a>) -> impl Iterator<Item = Scan> + Clone + use<'a> {
    let free = inputs.free();
    let untouched = free.clone().cycle().take(UNTOUCHED);
    let touched = inputs.touched().cycle().take(TOUCHED);
    let times = (0u64..).map(|i| Micros(PERIOD * i));
    let warm = |codes: Codes| Codes { temperature: Some(ROOM), ..codes };
    let scans = untouched.chain(touched).chain(free).zip(times);
    scans.map(move |(scan, time)| Scan { time, codes: warm(scan.codes), ..scan })
}

pub fn stages(inputs: &Inputs<'_>, calibration: &Calibration, meter: &mut impl Meter) {
    let mut buffer = [0; MAX_BYTES];
    // A rejected record leaves nothing to measure, and the meter's owner reports that.
    let Ok(record) = costliest(calibration).to_bytes(&mut buffer) else { return };
    // The costlier method for the contact point, which runs in addition to net and array; and all
    // signals filtered.
    let usual = [Command::SetPointMethod(PointMethod::ArgMin), Command::SetFilter { hz: 300 }];
    let mut packet = Packet::EMPTY;
    let self_test = Command::SelfTest { scans: taxel::self_test::MOST_SCANS };
    for (name, fields, busy) in [
        ("product: every section, estimates", Fields::ESTIMATES, None),
        (
            "product: the same while a bias is taken",
            Fields::ESTIMATES,
            Some(Command::TakeBias { scans: u16::MAX }),
        ),
        ("every section, every field", Fields::ALL, None),
        ("every section, every field, in a self-test", Fields::ALL, Some(self_test)),
    ] {
        let asked = usual.iter().cloned().chain(busy);
        let mut instrument = instrument(record, fields, asked);
        meter.stage(name, &mut instrument, scene(inputs), &mut packet, whole);
    }
}
