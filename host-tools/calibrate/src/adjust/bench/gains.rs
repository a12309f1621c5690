//! Gains of a part from the presses.

use std::ops::Range;

use taxel::finger::SKIN_ERROR;
use taxel_regress::metrics::surely_less;
use taxel_regress::shear::NO_SHEAR;

use super::{Bench, Judged, Press};
use crate::adjust::limits::{AGED, COMMON, LEAST_PRESSES};
use crate::adjust::{Part, fold};
use crate::evaluate::{Against, Only};

impl Bench<'_> {
    /// Gains of a part from all presses and from each half.
    pub(in crate::adjust) fn gains(
        &self,
        part: Part,
        judged: &Judged,
    ) -> Result<Option<[Vec<f64>; 3]>, String> {
        let Some(all) = self.solve(part, judged, None)? else { return Ok(None) };
        let half = |half| {
            let own = self.solve(part, judged, Some(half))?.unwrap_or_default();
            // A gain that all presses do not show is none.
            let own = own.iter().zip(&all).map(|(own, all)| if *all == 1.0 { 1.0 } else { *own });
            Ok::<Vec<f64>, String>(own.collect())
        };
        let (one, two) = (half(0)?, half(1)?);
        Ok(Some([all, one, two]))
    }

    /// Gains of a part from some of the presses; `None` if the finger lacks it or nothing shows it.
    ///
    /// # Errors
    ///
    /// The reason, in a full sentence, why gains of the part cannot be ageing.
    fn solve(
        &self,
        part: Part,
        judged: &Judged,
        half: Option<usize>,
    ) -> Result<Option<Vec<f64>>, String> {
        let record = &judged.halves[0];
        let axes = |of, axes, sigma| self.axes(part, (judged, half), of, axes, sigma);
        let gains = match part {
            Part::Bias => Ok(Some(Vec::new())),
            Part::Light => Ok(self.light.clone()),
            Part::Skin if self.unpressed => Err(format!(
                "{part}: not looked for, because a skin is up to a tenth stiffer until it was pressed harder than \
                 by the weights: press the pad hard all over, after the unloaded stretch of the recording and \
                 before the first weight"
            )),
            Part::Skin => match &record.taxels {
                Some(taxels) => {
                    let found = axes((Only::Matrix, 0), 2..3, taxels.residual)?;
                    let aged = |gain: f64| (gain - 1.0).abs() > f64::from(SKIN_ERROR);
                    Ok(found.filter(|gains| half.is_some() || gains.iter().any(|g| aged(*g))))
                }
                None => Ok(None),
            },
            Part::Sensor(i) => match &record.sensors[i] {
                Some(sensor) if !fold::is_block(record, i) => {
                    let alone = self.against == Some(Against::Sensor(i));
                    let first = if alone { 0 } else { 5 + 3 * i };
                    axes((Only::Both, first), 0..3, sensor.residual)
                }
                _ => Ok(None),
            },
            Part::Array => match &record.array {
                Some(array) => axes((Only::Array, 0), 0..3, array.residual),
                None => Ok(None),
            },
        }?;
        let most = gains.iter().flatten().fold(0.0, |most: f64, gain| most.max((gain - 1.0).abs()));
        if most > AGED {
            let percent = 100.0 * most;
            return Err(format!(
                "{part}: a gain would change by {percent:.0} %, which is more than ageing; its gains stay"
            ));
        }
        Ok(gains)
    }

    /// Gains of some axes of a force, whose first quantity is `first`, by a part of the finger.
    ///
    /// # Errors
    ///
    /// The reason, in a full sentence, why a gain cannot be ageing.
    fn axes(
        &self,
        part: Part,
        (judged, half): (&Judged, Option<usize>),
        (only, first): (Only, usize),
        axes: Range<usize>,
        sigma: [f32; 3],
    ) -> Result<Option<Vec<f64>>, String> {
        let at = self.parts.iter().position(|of| *of == only).unwrap_or_default();
        let presses = judged.presses[at].iter().enumerate();
        let presses: Vec<&Press> = presses
            .filter(|(i, _)| half.is_none_or(|half| i % 2 == half))
            .map(|(_, press)| press)
            .collect();
        let mut gains = Vec::new();
        let known = |axis: usize| {
            // A touch below the gate reads zero, which shows no gain.
            let rows = presses.iter().flat_map(|press| &press.rows).filter(|row| row.contact);
            rows.filter_map(move |row| row.values[first + axis])
        };
        let peak = |axis: usize| known(axis).fold(0.0, |most: f64, (_, f)| most.max(f.abs()));
        let most = (0..3).map(peak).fold(0.0, f64::max);
        for axis in axes {
            // A component without a load shows no gain.
            if peak(axis) <= NO_SHEAR * most {
                gains.push(1.0);
                continue;
            }
            let sigma = f64::from(sigma[axis]).max(1e-3);
            let known: Vec<Vec<[f64; 2]>> = presses
                .iter()
                .map(|press| {
                    let rows = press.rows.iter().filter(|row| row.contact);
                    let rows = rows.filter_map(|row| row.values[first + axis]);
                    rows.filter_map(|(found, truth)| Some([found?, truth])).collect::<Vec<_>>()
                })
                .filter(|press| !press.is_empty())
                .collect();
            gains.push(match gain_of(known.iter(), sigma) {
                None => {
                    let name = ["x", "y", "z"][axis];
                    return Err(format!(
                        "{part}: in {name} the force has the opposite sign of the estimate: is the reference's \
                         sign right? its gains stay"
                    ));
                }
                Some(gain) if half.is_some() || helps(&known, sigma) => gain,
                Some(_) => 1.0,
            });
        }
        Ok(Some(gains).filter(|gains| half.is_some() || gains.iter().any(|g| *g != 1.0)))
    }
}

/// Gain of a force, each press counting once; `None` if measured and true force disagree in sign.
///
/// The measured force is regressed on the true force and the slope inverted. The noise is in the
/// measured force; the opposite regression would draw the gain towards zero.
fn gain_of<'p>(presses: impl Iterator<Item = &'p Vec<[f64; 2]>>, sigma: f64) -> Option<f64> {
    let (mut product, mut square) = (COMMON.powi(-2), COMMON.powi(-2));
    for press in presses {
        let weight = 1.0 / (press.len() as f64 * sigma.powi(2));
        for [found, truth] in press {
            product += weight * found * truth;
            square += weight * truth * truth;
        }
    }
    (product > 0.0).then(|| square / product)
}

/// Whether the gain from all presses but one surely helps with that one.
fn helps(presses: &[Vec<[f64; 2]>], sigma: f64) -> bool {
    let square = |press: &[[f64; 2]], gain: f64| {
        press.iter().map(|[found, truth]| (gain * found - truth).powi(2)).sum::<f64>()
            / press.len() as f64
    };
    let judged = presses.iter().enumerate().map(|(i, press)| {
        let others = presses.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, press)| press);
        let gain = gain_of(others, sigma).unwrap_or(1.0);
        (square(press, gain), square(press, 1.0))
    });
    let (after, before): (Vec<f64>, Vec<f64>) = judged.unzip();
    presses.len() >= LEAST_PRESSES && surely_less(&after, &before)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nine presses of ten rows; S gives `share` of the true force.
    ///
    /// The noise is a millinewton, within a press and from press to press.
    fn presses(share: f64) -> Vec<Vec<[f64; 2]>> {
        let noise = |i: usize| 1e-3 * (12.9898 * (i * i) as f64).sin();
        let press = |p: usize| {
            let truth = 0.3 + 0.1 * p as f64;
            (0..10)
                .map(|row| [share * truth + noise(p) + noise(100 + 10 * p + row), truth])
                .collect()
        };
        (0..9).map(press).collect()
    }

    #[test]
    fn gain_helps_only_an_aged_sensor() {
        let aged = presses(0.9);
        let gain = gain_of(aged.iter(), 1e-3).unwrap();
        assert!((gain * 0.9 - 1.0).abs() < 2e-3 && helps(&aged, 1e-3), "{gain}");
        let young = presses(1.0);
        assert!(!helps(&young, 1e-3), "{:?}", gain_of(young.iter(), 1e-3));
        assert!(!helps(&aged[..2], 1e-3));
    }
}
