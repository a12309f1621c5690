//! Automatic model choice: linear or a net, and its width, by cross-validation.

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::DMatrix;

use crate::distil::{Lesson, distil};
use crate::error::FitError;
use crate::folds::{LeftOut, stretches};
use crate::gaussian::{self, CHOICE_ROWS, ROWS, Scores};
use crate::network::{Build, Net, Progress};
use crate::ridge;
use crate::scaling::Scaling;
use crate::training::{Chosen, Teacher, Training};

/// Widths tried, narrowest first; the widest allowed follows.
const WIDTHS: [usize; 3] = [4, 8, 16];
/// Fewest units at which a net taught by the skin model gets a linear path.
///
/// The units then need not carry the linear share. With fewer units, two more units do better at
/// the same cost.
const STRAIGHT: usize = 8;
/// Largest share that a net's distance from its teacher may add to the mean square error.
///
/// The error is that of a usual held-out stretch; a tenth is 5 % of the RMS error.
const ADDED: f64 = 0.1;

/// Chooses and fits a model. Stopped early, the linear fit is kept.
///
/// # Errors
///
/// Too few rows, a target that never changes, or stopped before there was a linear fit.
pub(crate) fn fit(
    choice: &Training<'_>,
    hidden: Option<usize>,
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<(Net, Chosen), FitError> {
    let (left_out, scaling, all) = prepared(choice)?;
    let (few, many) = (thin(&all, CHOICE_ROWS), thin(&all, ROWS));

    if stop.load(Ordering::Relaxed) {
        return Err(FitError::Stopped);
    }
    let no_line = || FitError::NoLoad { part: choice.part.into() };
    let line = ridge::fit(&all).ok_or_else(no_line)?;
    let newtons = |errors: Vec<f64>| -> Vec<f64> {
        errors.iter().zip(&scaling.targets).map(|(error, s)| error * s.spread).collect()
    };
    let mut chosen = Chosen {
        left_out,
        line: newtons(line.left_out.error()),
        bent: Vec::new(),
        apart: Vec::new(),
        skin: Vec::new(),
        hidden: 0,
        widths: Vec::new(),
    };
    let straight = Net::linear(&line.slope, line.level.as_slice(), &scaling, all.x.nrows());
    if hidden == Some(0) {
        return Ok((straight, chosen));
    }
    let tried = &mut |step, of| {
        let error = line.left_out.error().iter().copied().fold(0.0, f64::max);
        progress(Progress { part: format!("{}: prior", choice.part), step, of, error });
    };
    let teacher = match gaussian::fit(&few, &many, all.heard(), tried, stop) {
        Err(FitError::Stopped) => return Ok((straight, chosen)),
        other => other?,
    };
    chosen.bent = newtons(teacher.left_out.error());
    if hidden.is_none() && !bends(&line.left_out, &teacher.left_out) {
        return Ok((straight, chosen));
    }
    if let Some(Teacher { residual, hidden: usual, teach }) = choice.teacher {
        let own = &residual[residual.len().saturating_sub(chosen.bent.len())..];
        let squares = |errors: &[f64]| errors.iter().map(|e| e * e).sum::<f64>();
        if squares(own) < squares(&chosen.bent) {
            let hidden = hidden.unwrap_or(usual);
            let part = format!("{}: {hidden} units", choice.part);
            let build = Build { hidden, skip: hidden >= STRAIGHT };
            return match teach(&part, (build, choice.options), progress, stop) {
                Err(FitError::Stopped) => Ok((straight, chosen)),
                net => {
                    (chosen.skin, chosen.hidden) = (own.to_vec(), hidden);
                    Ok((net?, chosen))
                }
            };
        }
    }
    let lesson = Lesson { x: &many.x, stretch: &many.stretch, scaling: &scaling };
    let widths: Vec<usize> = match hidden {
        Some(hidden) => vec![hidden],
        None => {
            let narrow = WIDTHS.into_iter().filter(|width| *width < choice.most);
            narrow.chain([choice.most]).collect()
        }
    };
    let mut net = straight;
    for hidden in widths {
        let build = Build { hidden, skip: true };
        let part = format!("{}: {hidden} units", choice.part);
        let pupil = match distil(
            &part,
            &teacher,
            &lesson,
            (build, choice.inputs, choice.options),
            progress,
            stop,
        ) {
            // Keep the narrower net found before.
            Err(FitError::Stopped) => break,
            other => other?,
        };
        let close = pupil
            .apart
            .iter()
            .zip(teacher.left_out.usual())
            .all(|(apart, error)| apart.powi(2) <= ADDED * error.powi(2));
        net = pupil.net;
        chosen.apart = newtons(pupil.apart);
        chosen.hidden = hidden;
        if close {
            break;
        }
    }
    Ok((net, chosen))
}

/// Fits a straight line without a decay.
///
/// # Errors
///
/// Too few rows, a target that never changes, or linearly dependent channels.
pub(crate) fn line(choice: &Training<'_>) -> Result<Net, FitError> {
    let (_, scaling, rows) = prepared(choice)?;
    let (slope, level) = ridge::without_decay(&rows).ok_or_else(|| FitError::Shape {
        part: choice.part.into(),
        problem: "some channels are linear combinations of others; leave them out or choose ridge"
            .into(),
    })?;
    Ok(Net::linear(&slope, level.as_slice(), &scaling, rows.x.nrows()))
}

/// Scaled rows with their stretches.
fn prepared(choice: &Training<'_>) -> Result<(LeftOut, Scaling, gaussian::Rows), FitError> {
    let targets: Vec<&[Vec<f64>]> = choice.recordings.iter().map(|r| r.1.as_slice()).collect();
    let (left_out, stretch) = stretches(&targets);
    let x: Vec<&[f64]> = choice.recordings.iter().flat_map(|r| &r.0).map(Vec::as_slice).collect();
    let y: Vec<&[f64]> = choice.recordings.iter().flat_map(|r| &r.1).map(Vec::as_slice).collect();
    let least = 4 * (x.first().map_or(0, |row| row.len()) + 1);
    if x.len() < least {
        return Err(FitError::TooFewRows { part: choice.part.into(), rows: x.len(), least });
    }
    let scaling = Scaling::of(&x, &y, choice.inputs);
    if scaling.a_target_rests() {
        return Err(FitError::NoLoad { part: choice.part.into() });
    }
    let all = gaussian::Rows { x: scaling.inputs(&x), y: scaling.targets(&y), stretch };
    Ok((left_out, scaling, all))
}

/// Whether the bent model beats the line on held-out stretches, for any target.
///
/// The gain must exceed the standard error of the difference.
fn bends(line: &Scores, bent: &Scores) -> bool {
    (0..line.0.ncols()).any(|k| {
        let gain = line.0.column(k) - bent.0.column(k);
        gain.mean() > (gain.variance() / gain.len() as f64).sqrt()
    })
}

/// Keeps every k-th row, so that at most `most` are left.
fn thin(rows: &gaussian::Rows, most: usize) -> gaussian::Rows {
    let every = rows.x.nrows().div_ceil(most).max(1);
    let kept: Vec<usize> = (0..rows.x.nrows()).step_by(every).collect();
    let pick = |matrix: &DMatrix<f64>| matrix.select_rows(&kept);
    let mut stretch: Vec<usize> = kept.iter().map(|row| rows.stretch[*row]).collect();
    // Renumber without gaps, because a stretch may be shorter than the step.
    let mut next = 0;
    for i in 0..stretch.len() {
        let same = i > 0 && rows.stretch[kept[i]] == rows.stretch[kept[i - 1]];
        next += usize::from(i > 0 && !same);
        stretch[i] = next;
    }
    gaussian::Rows { x: pick(&rows.x), y: pick(&rows.y), stretch }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Family;
    use crate::network::NetOptions;
    use crate::scaling::Inputs;
    use crate::training::Recorded;

    const NEVER: (&str, usize) = ("", usize::MAX);

    /// Two varying channels and a force that is linear in them, or bends.
    fn recording(rows: usize, bent: f64) -> Recorded {
        let x: Vec<Vec<f64>> = (0..rows)
            .map(|row| row as f64 * 0.11)
            .map(|t| vec![30.0 * (0.9 * t).sin(), 20.0 * (1.7 * t).cos()])
            .collect();
        let force = |x: &Vec<f64>| 0.1 * x[0] - 0.05 * x[1] + bent * (x[0] / 10.0).sin();
        let y = x.iter().map(|x| vec![force(x)]).collect();
        (x, y)
    }

    fn fit_to(
        recordings: &[Recorded],
        hidden: Option<usize>,
        (part, step): (&str, usize),
    ) -> Result<(Net, Chosen), FitError> {
        let stop = AtomicBool::new(false);
        let options = NetOptions { seed: 1, starts: 1, steps: 40 };
        let inputs = Inputs::Alike;
        let choice = Training {
            part: "force",
            targets: &[],
            family: Family::Auto,
            recordings,
            inputs,
            hidden,
            usual: 16,
            most: 16,
            options,
            teacher: None,
        };
        let mut progress = |p: Progress| {
            if p.part.contains(part) && p.step >= step {
                stop.store(true, Ordering::Relaxed);
            }
        };
        fit(&choice, hidden, &mut progress, &stop)
    }

    #[test]
    fn auto_fits_line_or_net_as_data_require() {
        let (net, chosen) = fit_to(&[recording(300, 0.0)], None, NEVER).unwrap();
        assert_eq!((net.name(2).as_str(), chosen.hidden), ("linear 2-1", 0));
        assert!(chosen.line[0] < 1e-3 && chosen.left_out == LeftOut::Stretches, "{chosen:?}");

        let bent = recording(300, 1.0);
        let (net, chosen) = fit_to(std::slice::from_ref(&bent), None, NEVER).unwrap();
        assert!(chosen.hidden > 0 && chosen.bent[0] < 0.1 * chosen.line[0], "{chosen:?}");
        let error = bent.0.iter().zip(&bent.1).map(|(x, y)| {
            let x: Vec<f32> = x.iter().map(|x| *x as f32).collect();
            (f64::from(net.outputs(&x)[0]) - y[0]).abs()
        });
        assert!(error.fold(0.0, f64::max) < 0.15, "{chosen:?}");
    }

    #[test]
    fn stopping_keeps_line_or_narrow_net() {
        let bent = [recording(300, 1.0)];
        let (net, _) = fit_to(&bent, None, ("prior", 1)).unwrap();
        assert_eq!(net.name(2), "linear 2-1");
        let (net, chosen) = fit_to(&bent, Some(4), ("4 units", 20)).unwrap();
        assert_eq!((net.name(2).as_str(), chosen.hidden), ("skip 2-4-1", 4));
    }

    #[test]
    fn constant_target_and_dozen_rows_are_refused() {
        let mut still = recording(300, 1.0);
        still.1.iter_mut().for_each(|y| y[0] = 2.0);
        assert!(matches!(fit_to(&[still], None, NEVER), Err(FitError::NoLoad { .. })));
        let few = fit_to(&[recording(11, 1.0)], None, NEVER).unwrap_err();
        assert!(matches!(few, FitError::TooFewRows { rows: 11, least: 12, .. }), "{few}");
    }
}
