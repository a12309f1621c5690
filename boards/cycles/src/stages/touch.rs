//! Stages of a contact besides the model of one contact: two contacts, the array, slip.
//!
//! The coefficients do not change the cost, as long as a contact is found.

use taxel::calibration::Calibration;
use taxel::condition::Signals;
use taxel::estimate::array::{Array, WrenchMethod};
use taxel::estimate::field::{Field, Load, Radial};
use taxel::estimate::fusion::{Gaussian, fuse};
use taxel::estimate::intrinsic::Surface;
use taxel::estimate::inverse::{Centres, Curves, FrictionUtilisation, Inverse};
use taxel::estimate::limit_surface::{LimitSurface, Sweep};
use taxel::estimate::slide::GrossSlipDetector;
use taxel::estimate::slip::{Slip, SlipState, Traction};
use taxel::estimate::two_contacts::PairState;
use taxel::estimate::vibration::VibrationDetector;
use taxel::estimate::wrench::{SensorPlaces, WrenchMatrix};
use taxel::scan::{TAXEL_CENTRES, TAXELS};
use taxel::units::{Micros, Millimetres};

use crate::Meter;

/// Skin of 2.5 mm under a point load that grows blunter with the force.
const SKIN: Field = Field {
    normal: Radial {
        depth: [6.25, 2.0],
        terms: [[1.0, 0.0, 0.0], [1.0, -0.1, 0.02], [0.0, 0.05, 0.0], [0.0; 3]],
    },
    shear: Radial {
        depth: [6.25, 3.0],
        terms: [[2.5, 0.1, 0.0], [0.0, 0.3, 0.0], [0.0; 3], [0.0; 3]],
    },
    slip: -0.4,
};

fn model() -> Inverse {
    Inverse {
        curves: Curves { stray: [[0.02; 4]; TAXELS], gap: [[-1.0, 0.3, -0.1, 0.05, 0.02]; TAXELS] },
        field: SKIN,
        error: [2e-4; 2],
        shear: true,
        friction: 0.8,
        centres: Centres::default(),
    }
}

/// Contact of 0.5 N that moves over the pad, 0.1 mm per frame.
fn loads() -> impl Iterator<Item = Load> + Clone {
    (0..64u8).map(move |i| Load {
        size: 0.8,
        point: [-3.2 + 0.1 * f32::from(i), 1.5 - 0.03 * f32::from(i)],
        ..Load::default()
    })
}

fn sunk(load: &Load) -> [f32; TAXELS] {
    let around = SKIN.around(load);
    TAXEL_CENTRES.map(|centre| around.sheared(centre.map(|c| c.0)).0)
}

/// Two contacts on opposite sides of the middle.
fn pairs() -> impl Iterator<Item = [f32; TAXELS]> + Clone {
    loads().map(|load| {
        let mut u = sunk(&load);
        let other = sunk(&Load { point: load.point.map(|c| c.signum() * (c.abs() - 6.0)), ..load });
        u.iter_mut().zip(other).for_each(|(u, more)| *u += more);
        u
    })
}

pub fn stages(
    calibration: &Calibration,
    signals: impl Iterator<Item = Signals> + Clone,
    meter: &mut impl Meter,
) {
    model_stages(signals.clone(), meter);
    array_stages(calibration, signals.clone(), meter);
    slip_stages(signals, meter);
}

fn model_stages(signals: impl Iterator<Item = Signals> + Clone, meter: &mut impl Meter) {
    let c = signals.filter_map(|signals| signals.taxels);
    meter.stage("model: displacements", &mut model(), c, &mut [0.0; TAXELS], |model, c, u| {
        *u = model.curves.displacements(c);
    });
    let mut finger = (model(), PairState::default());
    meter.stage(
        "model: two contacts",
        &mut finger,
        pairs(),
        &mut None,
        |(model, state), u, out| {
            *out =
                model.pair(state, u, 100.0, false).map(|pair| pair.contacts.map(|load| load.point));
        },
    );
}

fn array_stages(
    calibration: &Calibration,
    signals: impl Iterator<Item = Signals> + Clone,
    meter: &mut impl Meter,
) {
    let felt = signals.map(|signals| {
        let mut sensors = calibration.sensors.iter().flatten();
        let forces = signals.bridges.map(|u| {
            let u = u.unwrap_or_default();
            sensors.next().map_or(u, |sensor| sensor.sensitivity.force(u))
        });
        (signals.bridges, forces)
    });
    let array =
        |method, surface| Array { method, residual: [1e-3; 3], moment_residual: 1e-3, surface };
    let sum = WrenchMethod::Sum(SensorPlaces::default());
    for (name, method) in [
        ("array: wrench as a sum", sum),
        ("array: wrench by 6x12", WrenchMethod::Matrix(WrenchMatrix([[[0.5; 3]; 4]; 6]))),
    ] {
        let mut array = array(method, Surface::Plane);
        meter.stage(
            name,
            &mut array,
            felt.clone(),
            &mut [[0.0; 3]; 2],
            |array, (u, forces), out| {
                let wrench = array.wrench(u, forces);
                *out = [wrench.force, wrench.moment];
            },
        );
    }
    for (name, surface) in [
        ("array: contact on a plane", Surface::Plane),
        (
            "array: contact on an ellipsoid",
            Surface::Ellipsoid { half_axes: [9.0, 12.0, 15.0].map(Millimetres) },
        ),
    ] {
        let mut array = array(sum, surface);
        let wrenches = felt.clone().map(|(u, forces)| array.wrench(&u, &forces));
        let wrenches: heapless::Vec<_, 128> = wrenches.collect();
        let out = &mut None;
        meter.stage(name, &mut array, wrenches.into_iter(), out, |array, wrench, out| {
            *out = array
                .contact(wrench)
                .ok()
                .map(|(contact, sigma)| (contact.place, contact.torsion, sigma));
        });
    }
    let components = (0..64u8).map(|i| {
        let of = |value: f32| Gaussian { value, sigma: 0.01 };
        (of(0.01 * f32::from(i)), of(0.011 * f32::from(i)))
    });
    meter.stage("fusion of one component", &mut (), components, &mut 0.0, |(), (a, b), out| {
        *out = fuse(*a, *b).0.value;
    });
}

fn slip_stages(signals: impl Iterator<Item = Signals> + Clone, meter: &mut impl Meter) {
    let tractions = (0..64u8).map(|i| Traction {
        shear: [0.006 * f32::from(i), 0.05],
        normal: 1.0,
        torsion: 0.02 * f32::from(i),
        sigma: [0.005, 0.01],
        ring: Some(FrictionUtilisation { weight: 19.0, moment: 9.5 }),
        ..Traction::default()
    });
    let mut finger = (Slip::usual(0.5), SlipState::default());
    meter.stage(
        "slip: verdict",
        &mut finger,
        tractions.clone(),
        &mut None,
        |(slip, state), traction, out| {
            *out = slip.judge(state, traction, 1e-3).ok();
        },
    );
    limit_surface_stages(tractions.clone(), meter);
    let way = tractions
        .zip(0u8..)
        .map(|(traction, i)| (Micros(1000 * u64::from(i)), [0.01 * f32::from(i), 0.0], traction));
    let slide = &mut GrossSlipDetector::default();
    meter.stage(
        "slip: by its way",
        slide,
        way,
        &mut false,
        |state, (time, place, traction), out| {
            *out = state.update(*time, *place, traction);
        },
    );
    let heard = signals.zip(0u8..).map(|(signals, i)| (Micros(250 * u64::from(i)), signals));
    let ear = &mut VibrationDetector::default();
    meter.stage("slip: by its vibration", ear, heard, &mut false, |ear, (time, signals), out| {
        *out = ear.update(*time, signals);
    });
}

/// Stages of the limit surface's three forms on the same tractions.
fn limit_surface_stages(tractions: impl Iterator<Item = Traction> + Clone, meter: &mut impl Meter) {
    let mut surface = LimitSurface {
        curve: [1.0, 1.01, 1.02, 1.02, 1.01, 1.0, 1.0, 1.0, 1.0],
        ..Slip::usual(0.5).surface
    };
    let mut sweep = Sweep::power_law(2.0, surface.radius);
    let out = &mut 0.0;
    meter.stage("slip: the ellipse", &mut surface, tractions.clone(), out, |surface, at, out| {
        *out = surface.load_by_ellipse(at.shear, at.torsion, at.normal, 0.5);
    });
    meter.stage(
        "slip: the limit surface",
        &mut surface,
        tractions.clone(),
        out,
        |surface, at, out| {
            *out = surface.load(at.shear, at.torsion, at.normal, 0.5);
        },
    );
    meter.stage("slip: the limit surface, swept", &mut sweep, tractions, out, |sweep, at, out| {
        *out = sweep.load(at.shear, at.torsion, at.normal, 0.5);
    });
}
