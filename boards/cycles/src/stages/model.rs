//! Stages of the model of the skin, which finds the single contact behind the signals.

use taxel::estimate::field::{Field, Radial};
use taxel::estimate::inverse::{Centres, Curves, Inverse, InverseState};
use taxel::measured::{Measured, NoValue};
use taxel::scan::TAXELS;

use crate::Meter;

/// Millimetres per unit of signal, about the initial value of a finger's curves.
const GAP: f32 = -4.0;

/// Model of a point load on a half-space 2.5 mm deep, with every term used.
fn model() -> Inverse {
    let normal = Radial {
        depth: [6.25, 2.0],
        terms: [[1.0, 0.01, 0.01], [1.0, -0.1, 0.02], [0.01, 0.05, 0.01], [0.01; 3]],
    };
    let shear =
        Radial { depth: [6.25, 3.0], terms: [[2.5, 0.1, 0.01], [0.01; 3], [0.01; 3], [0.01; 3]] };
    Inverse {
        curves: Curves { stray: [[0.015; 4]; TAXELS], gap: [[GAP, 0.1, 0.1, 0.1, 0.1]; TAXELS] },
        field: Field { normal, shear, slip: -0.3 },
        error: [1e-3, 1e-3],
        shear: true,
        friction: 0.8,
        centres: Centres::default(),
    }
}

/// Load and standard deviations, as bits to compare.
type Found = Measured<[f32; 9]>;

pub fn stages(c: impl Iterator<Item = [f32; TAXELS]> + Clone, meter: &mut impl Meter) {
    let nowhere: Found = Err(NoValue::NoContact);
    let mut memory = (model(), InverseState::default());
    meter.stage(
        "model, normal contact",
        &mut memory,
        c.clone(),
        &mut nowhere.clone(),
        |(model, state), c, out| {
            *out = model.pressed(state, &model.curves.displacements(c)).map(components);
        },
    );
    let mut memory = (model(), InverseState::default());
    meter.stage(
        "model, with shear",
        &mut memory,
        c,
        &mut nowhere.clone(),
        |(model, state), c, out| {
            *out = model.sheared(state, &model.curves.displacements(c), None).map(components);
        },
    );
}

fn components(touch: taxel::estimate::inverse::ContactFit) -> [f32; 9] {
    let ([fx, fy, fz], [x, y], [sx, sy, sz, ..]) = (touch.force(), touch.load.point, touch.sigma);
    [fx, fy, fz, x, y, sx, sy, sz, touch.misfit]
}
