//! 16-bit net of a finger: the f32 net rounded, not another fit.

use taxel::calibration::TaxelCalibration;
use taxel::estimate::net::{ForceNet, Layers};
use taxel::estimate::quantised::{ARGUMENT_BITS, GROUP, QuantisedNet, UNIT};
use taxel::scan::TAXELS;

use crate::prepared::Prepared;
use taxel_regress::error::FitError;
use taxel_regress::range::largest;

/// Number format of the net in the record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Form {
    /// 32-bit floating point.
    #[default]
    F32,
    /// 16-bit fixed point: faster on a Cortex-M4, with a larger error, which the fit reports.
    Q15,
}

/// Rounds a net for signals within `taxels`' range.
///
/// The rounding error is measured on the recordings and added to the residual in `taxels`. Returns
/// the net and the number of rows.
///
/// # Errors
///
/// A unit's weights exceed 16 bits.
pub(crate) fn net(
    float: &ForceNet,
    taxels: &mut TaxelCalibration,
    recordings: &[&Prepared<'_>],
) -> Result<(QuantisedNet, usize), FitError> {
    let net = whole(float, taxels)?;
    let seen = recordings.iter().flat_map(|recording| &recording.signals);
    let (mut squares, mut rows) = ([0.0; 3], 0u32);
    for c in seen.filter_map(|signals| signals.taxels.as_ref()) {
        rows += 1;
        let off = net.forces(c).into_iter().zip(float.forces(c)).map(|(a, b)| f64::from(a - b));
        squares.iter_mut().zip(off).for_each(|(sum, off)| *sum += off * off);
    }
    for (residual, squares) in taxels.residual.iter_mut().zip(squares) {
        let rounding = squares / f64::from(rows.max(1));
        *residual = (f64::from(*residual).powi(2) + rounding).sqrt() as f32;
    }
    Ok((net, rows as usize))
}

/// Converts `net` to 16 bits, for signals within this range.
///
/// # Errors
///
/// A unit's weights exceed 16 bits.
pub(crate) fn whole(net: &ForceNet, taxels: &TaxelCalibration) -> Result<QuantisedNet, FitError> {
    QuantisedNet::new(net, largest(&taxels.range)).ok_or_else(|| FitError::Shape {
        part: "net".into(),
        problem: "a unit's weights are beyond 16 bits; fit it in f32".into(),
    })
}

/// Converts a 16-bit net to f32; units that only fill up a group have no effect.
pub(crate) fn float(net: &QuantisedNet) -> ForceNet {
    let row = |row: [i16; TAXELS], one: f32| row.map(|w| f32::from(w) * one);
    let one = f32::from(net.shift + ARGUMENT_BITS).exp2().recip();
    let units =
        net.hidden.iter().flat_map(|group| group.weights.weights().into_iter().zip(group.bias));
    let half = 1i32 << net.shift >> 1;
    let outputs = 0..net.output_bias.len();
    let [bend, slope] = net.scale;
    let hidden = GROUP * net.hidden.len();
    let output = |k: usize| {
        let blocks = net.output.iter().flat_map(move |rows| row(rows.weights()[k], bend * UNIT));
        blocks.take(hidden)
    };
    let skip = net
        .skip
        .iter()
        .flat_map(|rows| outputs.clone().map(|k| row(rows.weights()[k], slope * net.signal)));
    let layers = Layers {
        hidden: &units.clone().flat_map(|(w, _)| row(w, one * net.signal)).collect::<Vec<_>>(),
        hidden_bias: &units.map(|(_, bias)| (bias - half) as f32 * one).collect::<Vec<_>>(),
        output: &outputs.clone().flat_map(output).collect::<Vec<_>>(),
        skip: &skip.flatten().collect::<Vec<_>>(),
        output_bias: &net.output_bias,
    };
    ForceNet::new(&layers).expect("a 16-bit net has a finger's shape")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantised_net_survives_round_trip_through_f32() {
        let wave = |k: usize, by: f32| by * (1.7 * k as f32 + 0.3).sin();
        for (units, outputs) in [(6, 3), (20, 1)] {
            let list = |count: usize, by| (0..count).map(|k| wave(k, by)).collect::<Vec<_>>();
            let net = ForceNet::new(&Layers {
                hidden: &list(units * 16, 5.0),
                hidden_bias: &list(units, 0.5),
                output: &list(units * outputs, 0.4),
                skip: &list(16 * outputs, 0.9),
                output_bias: &list(outputs, 0.1),
            })
            .unwrap();
            let taxels = TaxelCalibration { range: [[-0.4, 0.3]; 16], ..Default::default() };
            let first = whole(&net, &taxels).unwrap();
            let again = whole(&float(&first), &taxels).unwrap();
            for k in 0..100 {
                let c = std::array::from_fn(|i| wave(16 * k + i, 0.4));
                for (a, b) in first.forces(&c).iter().zip(again.forces(&c)) {
                    assert!((a - b).abs() < 1e-4, "{a} {b}");
                }
            }
        }
    }
}
