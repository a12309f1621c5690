//! The net of a finger in 16 bits: the f32 net rounded, not another fit.

use taxel::estimate::quantised::QuantisedNet;

use crate::error::FitError;
use crate::finger::{Fitted, Part};
use crate::prepared::Prepared;

/// In which numbers the record holds the net.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Form {
    /// f32.
    #[default]
    F32,
    /// 16 bits: less time on a Cortex-M4, a larger error, which the fit states.
    Q15,
}

/// Rounds the net of `fitted`, for the signals of its range and no others. What rounding adds to its error
/// is measured on the recordings.
///
/// # Errors
/// A unit's weights are beyond 16 bits.
pub(crate) fn net(fitted: &mut Fitted, recordings: &[&Prepared<'_>]) -> Result<(), FitError> {
    let Some(taxels) = &mut fitted.calibration.taxels else { return Ok(()) };
    let Some(float) = fitted.calibration.force.take() else { return Ok(()) };
    let largest = taxels.range.as_flattened().iter().fold(0.0f32, |most, end| most.max(end.abs()));
    let net = QuantisedNet::new(&float, largest).ok_or_else(|| FitError::Shape {
        part: "net".into(),
        problem: "a unit's weights are beyond 16 bits; fit it in f32".into(),
    })?;
    let seen = recordings.iter().flat_map(|recording| &recording.signals);
    let (mut squares, mut rows) = ([0.0; 3], 0u32);
    for c in seen.filter_map(|signals| signals.taxels.as_ref()) {
        rows += 1;
        let off = net.forces(c).into_iter().zip(float.forces(c)).map(|(a, b)| f64::from(a - b));
        squares.iter_mut().zip(off).for_each(|(sum, off)| *sum += off * off);
    }
    let outputs = float.output_bias.len();
    for (residual, squares) in taxels.residual.iter_mut().zip(squares) {
        let rounding = squares / f64::from(rows.max(1));
        *residual = (f64::from(*residual).powi(2) + rounding).sqrt() as f32;
    }
    fitted.parts.push(Part {
        name: "the net in 16 bits".into(),
        rows: rows as usize,
        faulty: 0,
        condition: None,
        chosen: None,
        effective: None,
        residual: taxels.residual.iter().take(outputs).map(|r| f64::from(*r)).collect(),
    });
    fitted.calibration.quantised = Some(net);
    Ok(())
}
