//! Skin model of a finger, fitted to recordings of presses, and its error on presses left out.

use std::collections::HashSet;
use std::sync::atomic::AtomicBool;

use taxel::condition::Signals;
use taxel::estimate::contact_point::centroid;
use taxel::estimate::inverse::{ContactFit, Inverse, InverseState};
use taxel::finger::UNSURE_PLACE;
use taxel::scan::{TAXEL_CENTRES, TAXELS};

use crate::inverse::{self, Known, Row};
use crate::prepared::Prepared;
use taxel_regress::error::FitError;
use taxel_regress::network::Progress;
use taxel_regress::quantile::{median, quantile};

/// Least normal force for the friction ratio, newtons; below it the ratio is noise.
const FIRM: f64 = 0.2;
/// Least friction coefficient; recordings without shear show none.
const LEAST_FRICTION: f64 = 0.1;
/// Least normal force of a row, in standard deviations of the reference.
const CLEAR_OF_NOISE: f64 = 5.0;
/// Distance of two rows' labelled places that belong to different presses, mm.
const APART: f64 = 0.5;
/// Fewest presses of which every other one can be left out.
const LEAST_PRESSES: usize = 8;
/// Most that the error of left-out presses widens the model's own.
const WIDEST: f64 = 10.0;
/// Share of the errors of left-out presses that three stated standard deviations cover.
const COVERED: f64 = 0.99;

/// A fitted skin model with its rows.
pub(crate) struct Skin {
    pub model: Inverse,
    /// Rows of the fit.
    pub rows: Vec<Row>,
    /// Number of rows left out: saturated or dead taxels, and outliers.
    pub left_out: usize,
    /// RMS error in f_x, f_y, f_z, newtons, on presses left out, with the model run as on the chip.
    pub residual: [f64; 3],
    /// RMS distance from the labelled place on presses left out, of the model and of the centroid,
    /// mm; `None` without labels.
    pub place: Option<[f64; 2]>,
    /// Whether presses were left out; with too few of them the errors are those of the fit.
    pub held_out: bool,
}

/// Fits the model to the recordings with forces, without their wrong rows.
///
/// Places without labels are found together with the model. `None` if no recording has a force.
///
/// # Errors
///
/// Too few rows, or stopped.
pub(crate) fn fit(
    recordings: &[&Prepared<'_>],
    (wrong, noise): (&[HashSet<usize>], f32),
    force_noise: [f64; 3],
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Option<Skin>, FitError> {
    let samples = recordings.iter().flat_map(|r| &r.recording.samples);
    let placed = samples.clone().any(|s| s.truth.point.iter().all(Option::is_some));
    let sheared = samples.clone().any(|s| known_shear(s.truth.force).is_some());
    let least = CLEAR_OF_NOISE * force_noise[2];
    let labelled = Labelled { placed, sheared, least };
    let (runs, left_out): (Vec<Vec<Option<Row>>>, Vec<usize>) =
        recordings.iter().zip(wrong).map(|(r, wrong)| rows(r, wrong, labelled)).unzip();
    let presses: Vec<Vec<Row>> = runs.into_iter().flat_map(split).collect();
    if presses.is_empty() {
        return Ok(None);
    }
    let rows: Vec<Row> = presses.iter().flatten().cloned().collect();
    let friction = friction(&rows);
    let shear = friction > LEAST_FRICTION;
    let noise = f64::from(noise);
    let friction = friction.max(LEAST_FRICTION);
    let variances = samples.filter_map(|s| s.truth.point_sigma.map(|sigma| sigma * sigma));
    let variances: Vec<f64> = variances.collect();
    let place_noise = (!variances.is_empty())
        .then(|| (variances.iter().sum::<f64>() / variances.len() as f64).sqrt());
    let known = Known { friction, noise, shear, force_noise, placed, place_noise };
    let whole = inverse::fit("model of the skin", &presses, (known, None), progress, stop)?;
    let mut model = whole.model.clone();
    let [fx, fy, _] = force_noise;
    let labels =
        [(shear, fx), (shear, fy), (placed, whole.place_noise), (placed, whole.place_noise)];
    let labels = labels.map(|(known, noise)| known.then_some(noise));
    let mut judged = judge(&model, &presses, labels);
    let mut held_out = false;
    if presses.len() >= LEAST_PRESSES {
        let halves = [0, 1].map(|half| {
            let (own, other): (Vec<_>, Vec<_>) =
                presses.iter().cloned().enumerate().partition(|(i, _)| i % 2 == half);
            let [own, other] = [own, other].map(|p| p.into_iter().map(|(_, p)| p).collect());
            let own: Vec<Vec<Row>> = own;
            let part = format!("model of the skin, half {} left out", 2 - half);
            let half = inverse::fit(&part, &own, (known, Some(&whole)), progress, stop)?;
            Ok::<_, FitError>((half.model, own, other))
        });
        // Stopped, or too few rows for a half: the error of the fit stands.
        if let [Ok(one), Ok(two)] = halves {
            let mut halves = [one, two];
            let over = |halves: &[(Inverse, Vec<_>, Vec<_>); 2], part: fn(&_) -> &Vec<_>| {
                let [one, two] = halves.each_ref().map(|half| judge(&half.0, part(half), labels));
                one.with(two)
            };
            let (own, other) = (over(&halves, |half| &half.1), over(&halves, |half| &half.2));
            let wider = f64::max(other.misfit() / own.misfit(), other.beyond_stated());
            let wider = wider.clamp(1.0, WIDEST) as f32;
            // A wider error leans more on the usual contact, so that the errors are others.
            for model in halves.iter_mut().map(|half| &mut half.0).chain([&mut model]) {
                let [floor, share] = model.error;
                model.error = [floor * wider, (share * wider).min(0.99)];
            }
            judged = over(&halves, |half| &half.2);
            held_out = true;
        }
    }
    let residual = judged.force();
    let place = placed.then(|| judged.place());
    Ok(Some(Skin { model, rows, left_out: left_out.iter().sum(), residual, place, held_out }))
}

/// Largest ratio of shear to normal force under a firm load.
pub(crate) fn friction(rows: &[Row]) -> f64 {
    rows.iter()
        .filter(|row| row.force[2] > FIRM)
        .map(|row| row.force[0].hypot(row.force[1]) / row.force[2])
        .fold(0.0, f64::max)
}

/// Returns the shear of a reference, if it has both components.
fn known_shear([x, y, _]: [Option<f64>; 3]) -> Option<[f64; 2]> {
    Some([x?, y?])
}

/// Factor on the noise that the signals of a row exceed to serve a fit. Weaker rows tell more of
/// noise and drift than of a touch.
pub(crate) const TOUCHED: f32 = 5.0;

/// Labels of the recordings besides the normal force.
#[derive(Clone, Copy)]
struct Labelled {
    /// Whether the contact point is a label.
    placed: bool,
    /// Whether shear is a label; rows without it serve a model of normal contacts otherwise.
    sheared: bool,
    /// Least normal force of a row, newtons.
    least: f64,
}

/// Touched, sound and known rows of a recording, and the number of unsound ones.
fn rows(
    prepared: &Prepared<'_>,
    wrong: &HashSet<usize>,
    Labelled { placed, sheared, least }: Labelled,
) -> (Vec<Option<Row>>, usize) {
    let samples = prepared.recording.samples.iter().zip(&prepared.signals);
    let mut left_out = 0;
    let rows = samples
        .enumerate()
        .map(|(at, (sample, signals))| {
            let c = signals.taxels?;
            let shear = known_shear(sample.truth.force);
            let [fx, fy] = if sheared { shear? } else { [0.0; 2] };
            let point = if placed {
                let [x, y] = sample.truth.point;
                [x?, y?]
            } else {
                guessed(&c)
            };
            let alone = Signals { taxels: Some(c), ..Signals::default() };
            let touched = prepared.bias.exceeded(&alone, TOUCHED * TOUCHED);
            let sound =
                signals.health.dead == 0 && signals.health.saturated == 0 && !wrong.contains(&at);
            let force = [fx, fy, sample.truth.force[2]?];
            let row = Row { signals: c.map(f64::from), force, point };
            let load = touched && row.force[2] > least;
            left_out += usize::from(load && !sound);
            (load && sound).then_some(row)
        })
        .collect();
    (rows, left_out)
}

/// First guess of a contact's place: the middle of the squared signals.
pub(crate) fn guessed(c: &[f32; TAXELS]) -> [f64; 2] {
    let (mut sum, mut at) = (f64::MIN_POSITIVE, [0.0; 2]);
    for (c, centre) in c.iter().zip(&TAXEL_CENTRES) {
        let weight = f64::from(c.min(0.0)).powi(2);
        sum += weight;
        at.iter_mut().zip(centre).for_each(|(at, c)| *at += weight * f64::from(c.0));
    }
    at.map(|at| at / sum)
}

/// Splits a recording into presses: rows without a gap and without a jump of the place.
fn split(rows: Vec<Option<Row>>) -> Vec<Vec<Row>> {
    let mut presses: Vec<Vec<Row>> = Vec::new();
    let mut last: Option<[f64; 2]> = None;
    for row in rows {
        let Some(row) = row else {
            last = None;
            continue;
        };
        let here = row.point;
        let same = last.is_some_and(|[x, y]| (here[0] - x).hypot(here[1] - y) < APART);
        last = Some(here);
        match presses.last_mut() {
            Some(press) if same => press.push(row),
            _ => presses.push(vec![row]),
        }
    }
    presses
}

/// Standard deviations of the labels f_x, f_y (N), x, y (mm); `None` without such a label.
type Labels = [Option<f64>; 4];

/// Errors of a model over some presses.
#[derive(Default)]
struct Judged {
    force: [f64; 3],
    place: [f64; 2],
    misfits: Vec<f64>,
    /// Errors of f_x, f_y, x, y in stated standard deviations.
    ///
    /// F_z is left out: its errors in the first scans of a press are those of the search.
    ratios: [Vec<f64>; 4],
    rows: f64,
    fits: f64,
}

impl Judged {
    fn with(self, other: Self) -> Self {
        let sum = |a: f64, b: f64| a + b;
        Self {
            force: std::array::from_fn(|k| sum(self.force[k], other.force[k])),
            place: std::array::from_fn(|k| sum(self.place[k], other.place[k])),
            misfits: [self.misfits, other.misfits].concat(),
            ratios: std::array::from_fn(|k| [&self.ratios[k][..], &other.ratios[k]].concat()),
            rows: self.rows + other.rows,
            fits: self.fits + other.fits,
        }
    }

    fn force(&self) -> [f64; 3] {
        self.force.map(|squares| (squares / self.rows.max(1.0)).sqrt())
    }

    fn place(&self) -> [f64; 2] {
        self.place.map(|squares| (squares / self.fits.max(1.0)).sqrt())
    }

    /// Median misfit: a few contacts that the model cannot explain are flagged by theirs.
    fn misfit(&self) -> f64 {
        median(self.misfits.clone()).max(f64::MIN_POSITIVE)
    }

    /// Factor by which the stated deviations must grow to cover the errors.
    fn beyond_stated(&self) -> f64 {
        let most = self.ratios.iter().map(|ratios| quantile(ratios.clone(), COVERED));
        most.fold(0.0, f64::max) / 3.0
    }
}

/// Judges the forces and places as the chip would estimate them, row after row of each press.
fn judge(model: &Inverse, presses: &[Vec<Row>], labels: Labels) -> Judged {
    let mut sum = Judged::default();
    for press in presses {
        let mut state = InverseState::default();
        for row in press {
            let c: [f32; TAXELS] = row.signals.map(|c| c as f32);
            let u = model.curves.displacements(&c);
            let touch = if model.shear {
                model.sheared(&mut state, &u, None)
            } else {
                model.pressed(&mut state, &u)
            };
            let on_pad = touch.as_ref().is_ok_and(ContactFit::is_on_pad);
            if !on_pad {
                // The chip withholds it and begins again.
                state.lose();
            }
            let touch = touch.ok().filter(|_| on_pad);
            // Without an estimate the error is the force itself.
            let found = touch.as_ref().map_or([0.0; 3], |touch| touch.force());
            for ((sum, found), force) in sum.force.iter_mut().zip(found).zip(row.force) {
                *sum += (f64::from(found) - force).powi(2);
            }
            sum.rows += 1.0;
            let (Some(touch), Ok(middle)) = (touch, centroid(&c, 0, 0.0)) else { continue };
            sum.misfits.push(f64::from(touch.misfit));
            let [x, y] = row.point;
            // The chip withholds a place that it does not know.
            if touch.sigma[3].max(touch.sigma[4]) < UNSURE_PLACE {
                for (sum, [px, py]) in
                    sum.place.iter_mut().zip([touch.load.point, [middle.x.0, middle.y.0]])
                {
                    *sum += (f64::from(px) - x).powi(2) + (f64::from(py) - y).powi(2);
                }
                sum.fits += 1.0;
            }
            let ([fx, fy, _], [px, py], [sx, sy, _, sigma_x, sigma_y, _]) =
                (touch.force(), touch.load.point, touch.sigma);
            let errors = [
                (fx, row.force[0], sx),
                (fy, row.force[1], sy),
                (px, x, sigma_x),
                (py, y, sigma_y),
            ];
            for ((ratios, noise), (found, label, sigma)) in
                sum.ratios.iter_mut().zip(labels).zip(errors)
            {
                let Some(noise) = noise else { continue };
                let stated = f64::from(sigma).hypot(noise);
                ratios.push((f64::from(found) - label).abs() / stated);
            }
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_beyond_stated_sigma_widen_it() {
        let ratios = |scale: f64| {
            let even: Vec<f64> = (0..=100).map(|i| scale * f64::from(i) / 100.0).collect();
            Judged { ratios: [vec![], even, vec![], vec![0.5; 9]], ..Judged::default() }
        };
        assert!((ratios(12.0).beyond_stated() - 0.99 * 12.0 / 3.0).abs() < 1e-9);
        assert!(ratios(2.0).beyond_stated() < 1.0, "covered errors do not widen");
        assert_eq!(Judged::default().beyond_stated(), 0.0);
    }
}
