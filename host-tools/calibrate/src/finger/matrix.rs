//! Parts of the optical matrix beside its net: the model of the skin, the 16-bit net, and slip.

use std::collections::HashSet;
use std::sync::atomic::AtomicBool;

use taxel::estimate::quantised::Net;
use taxel::estimate::slip::Slip;

use super::{Fitted, Part, choice};
use crate::limit_surface;
use crate::prepared::{self, Prepared};
use crate::quantise;
use crate::skin::{self, Skin};
use taxel_regress::error::FitError;
use taxel_regress::network::Progress;

/// Default friction coefficient of rubber.
const USUAL_FRICTION: f32 = 0.6;
/// Exponent of Hertz's pressure in the power law of [Ospina2017].
const HERTZ: f64 = 2.0;

/// Noise of each component of the reference: that at rest, or that given.
///
/// A given one below that at rest is not taken: it would ruin the model of the skin.
pub(super) fn noise_of_reference(
    fitted: &mut Fitted,
    recordings: &[&Prepared<'_>],
    given: Option<f64>,
) -> [f64; 3] {
    let found = prepared::noise_with_flanks(recordings);
    let [least, most] = [f64::min, f64::max].map(|of| found.into_iter().fold(found[0], of));
    let Some(given) = given else { return found };
    if given < 0.5 * least {
        fitted.warnings.push(format!(
            "the reference's noise was given as {:.1} mN and is up to {:.1} mN where nothing is touched, which was \
             taken; leave --reference-noise out",
            1e3 * given,
            1e3 * most
        ));
    }
    found.map(|found| found.max(given))
}

/// Fits the skin model, if the recordings contain forces.
pub(super) fn skin(
    recordings: &[&Prepared<'_>],
    (wrong, force_noise): (&[HashSet<usize>], [f64; 3]),
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Option<Skin>, FitError> {
    let Some(bias) = recordings.first().and_then(|first| first.bias.taxels) else {
        return Ok(None);
    };
    match skin::fit(recordings, (wrong, bias.noise), force_noise, progress, stop) {
        // With too few rows or too little time for a skin model, keep the net alone.
        Err(FitError::TooFewRows { .. } | FitError::Stopped) => Ok(None),
        skin => skin,
    }
}

/// Keeps the skin model in the record if it is better than the net.
pub(super) fn keep_skin(fitted: &mut Fitted, skin: Skin) {
    let Some(taxels) = &fitted.calibration.taxels else { return };
    let Skin { model, rows, left_out, residual, place, held_out } = skin;
    let components = fitted.calibration.net.as_ref().map_or(1, Net::outputs).min(3);
    let net = taxels.residual[..components].iter().map(|e| f64::from(*e)).collect();
    let from = 3 - components;
    let judged = choice::Judged { skin: residual[from..].to_vec(), net, held_out, place };
    fitted.choices.extend(judged.told());
    if !judged.keeps_skin() {
        if place.is_some() {
            fitted.warnings.push(format!(
                "the model of the skin meets neither force nor contact point better than net and centroid, {}, and \
                 is left out",
                judged.left_out()
            ));
        }
        return;
    }
    fitted.calibration.slip = Some(slip(model.shear.then_some(model.friction)));
    fitted.calibration.model = Some(model);
    fitted.parts.push(Part {
        name: "model of the skin".into(),
        rows: rows.len(),
        left_out,
        condition: None,
        chosen: None,
        effective: None,
        residual: judged.skin,
        held_out,
    });
}

/// Replaces the net by its 16-bit form and its residual by that of the 16-bit form.
pub(super) fn quantised(
    fitted: &mut Fitted,
    recordings: &[&Prepared<'_>],
    net_only: bool,
) -> Result<(), FitError> {
    let Some(taxels) = &mut fitted.calibration.taxels else { return Ok(()) };
    let Some(float) = fitted.calibration.net.as_ref().and_then(Net::float) else { return Ok(()) };
    let (net, rows) = quantise::net(float, taxels, recordings)?;
    let outputs = float.output_bias.len();
    fitted.parts.push(Part {
        name: "the net in 16 bits".into(),
        rows,
        left_out: 0,
        condition: None,
        chosen: None,
        effective: None,
        residual: taxels.residual.iter().take(outputs).map(|r| f64::from(*r)).collect(),
        held_out: !net_only,
    });
    fitted.calibration.net = Some(Net::Quantised(net));
    Ok(())
}

/// Limit surface of a contact: Hertz's pressure swept over the centres of rotation.
pub(super) fn slip(friction: Option<f32>) -> Slip {
    let usual = Slip::usual(friction.unwrap_or(USUAL_FRICTION));
    let [c, gamma] = usual.surface.radius.map(f64::from);
    Slip { surface: limit_surface::power_law(HERTZ, c, gamma), ..usual }
}
