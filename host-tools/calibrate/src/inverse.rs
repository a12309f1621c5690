//! Fit of a finger's forward model: taxel curves, stray light and one contact's field.
//!
//! The model is [`taxel::estimate::inverse`]. Levenberg–Marquardt searches the field, each taxel's
//! curve (powers of its displacement), its place and its neighbours' stray light together. The true
//! load of each row and the true place of each press are unknowns too, held by their labels' noise
//! (`bundle`). The curves for the chip, from signal to displacement, are fitted last, to the
//! displacements of that field.

mod annulus;
mod bundle;
mod forward;

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Cholesky, SMatrix, SVector};
use taxel::estimate::field::{Field, Radial};
use taxel::estimate::inverse::{Centres, Curves, Inverse};
use taxel::scan::{COLS, ROWS, TAXELS};

use bundle::{Bundle, Labels, Places};
use forward::{Coefficients, FIELD, LOAD, RADIAL, framed};
use taxel_regress::error::FitError;
use taxel_regress::network::Progress;

/// A row of a recording: signals, force and contact point.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Signal c_k of each taxel.
    pub signals: [f64; TAXELS],
    /// Force f_x, f_y, f_z in newtons.
    pub force: [f64; 3],
    /// Contact point x, y in mm.
    pub point: [f64; 2],
}

/// Knowledge of the rows besides their values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// Friction coefficient of the recordings.
    pub friction: f64,
    /// Noise of a signal in full scale.
    pub noise: f64,
    /// Whether the recordings contain shear.
    pub shear: bool,
    /// Noise of the labelled force components in newtons.
    pub force_noise: [f64; 3],
    /// Whether the contact points are labels; otherwise they are first guesses.
    pub placed: bool,
    /// Standard deviation of estimated contact points, mm; `None` for measured ones.
    pub place_noise: Option<f64>,
}

/// Approximate number of rows after thinning; more rows do not improve the field.
const MOST_ROWS: usize = 1400;
/// Fewest rows that determine curves, stray light and field.
const LEAST_ROWS: usize = 200;
/// Steps from each start, after which the better one is followed.
const BEGINNING: usize = 21;
/// Most steps then, and the relative change of the sum of squares below which a step is small.
///
/// So many small steps in a row end the search.
const STEPS: usize = 80;
const LITTLE: f64 = 3e-4;
const SMALL_STEPS: usize = 2;
/// Small relative change once places are taken as labelled, because steps are cheap there.
const LITTLE_EXACT: f64 = 1e-5;
/// Small relative change while places are free.
const LITTLE_FREE: f64 = 1e-4;
/// Damping above which no step helps.
const STIFF: f64 = 1e6;
/// Noise of labelled places to begin with: of a press and of a row about it, mm …
const PLACED: [f64; 2] = [0.02, 0.01];
/// … and of first guesses: a press has no place of its own.
const FREE: [f64; 2] = [1e-5, 1.0];
/// Factor on the noise of a row's estimated place: neighbouring rows share its error, so that they
/// tell less than they seem to.
const SHARED: f64 = 4.0;
/// Steps between two estimates of the places' noise.
const LEARN_EVERY: usize = 3;

/// Number of powers in the polynomials from displacement to signal and back.
const POWERS: usize = 5;
/// Number of linear coefficients of a taxel: powers and four neighbours.
const LINEAR: usize = POWERS + 4;
/// Number of a taxel's coefficients: the linear ones, and the place of its facet.
const OWN: usize = LINEAR + 2;

/// A fitted model with the coefficients that another fit may start from.
pub struct Fit {
    /// Coefficients for the chip.
    pub model: Inverse,
    /// Noise of the labelled places of the presses, mm.
    pub place_noise: f64,
    field: Coefficients,
    taxels: [SVector<f64, OWN>; TAXELS],
}

/// Fits the model to presses, each a list of rows in the order of time.
///
/// # Errors
///
/// Too few rows, or stopped before the first step.
pub fn fit(
    part: &str,
    presses: &[Vec<Row>],
    (known, start): (Known, Option<&Fit>),
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Fit, FitError> {
    let count: usize = presses.iter().map(Vec::len).sum();
    if count < LEAST_ROWS {
        return Err(FitError::TooFewRows { part: part.into(), rows: count, least: LEAST_ROWS });
    }
    let presses = thinned(presses, count.div_ceil(MOST_ROWS));
    let Known { friction, noise, shear, force_noise, placed, place_noise } = known;
    let ([press, row], places) = match place_noise {
        _ if !placed => (FREE, Places::Free),
        None => (PLACED, Places::Labels),
        Some(noise) => ([noise, SHARED * noise], Places::Estimated),
    };
    let labels = Labels { force: force_noise, press, row, places };
    let mut first = Bundle::new(&presses, labels, (friction, noise, shear));
    let mut at = if let Some(start) = start {
        (first.field, first.taxels) = (start.field, start.taxels);
        if !placed {
            first.settle();
        }
        first
    } else {
        // A search ends near its start.
        let mut framed = first.clone().with_field(framed()).alternated();
        search(&format!("{part}, from a framed skin"), &mut framed, BEGINNING, progress, stop)?;
        let mut wide = first.alternated();
        // Stopped before its first step, the second start is compared as it is.
        let _ = search(&format!("{part}, from a half-space"), &mut wide, BEGINNING, progress, stop);
        if framed.objective() < wide.objective() { framed } else { wide }
    };
    let ended = search(part, &mut at, STEPS, progress, stop);
    // Without a start, the better beginning is kept.
    if start.is_some() {
        ended?;
    }
    let model = finish(&at, known);
    Ok(Fit { model, place_noise: at.labels.press, field: at.field, taxels: at.taxels })
}

/// Levenberg–Marquardt from a start. Stopped later than in the first step, it keeps the best so
/// far.
///
/// # Errors
///
/// Stopped before the first step.
fn search(
    part: &str,
    at: &mut Bundle<'_>,
    steps: usize,
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<(), FitError> {
    let mut damping = 1e-3;
    let (mut squares, mut equations, mut small) = (at.objective(), None, 0);
    let mut little = if at.labels.places == Places::Free { LITTLE_FREE } else { LITTLE };
    for step in 0..steps {
        let error = (squares / at.values() as f64).sqrt();
        progress(Progress { part: part.into(), step, of: steps, error });
        if stop.load(Ordering::Relaxed) {
            if step == 0 {
                return Err(FitError::Stopped);
            }
            break;
        }
        let slopes = equations.take().unwrap_or_else(|| at.equations());
        let next = at.moved(&slopes, damping).map(|next| (next.objective(), next));
        match next {
            Some((found, next)) if found < squares => {
                let gain = squares - found;
                let done = gain < little * squares;
                (*at, squares) = (next, found);
                damping = (0.3 * damping).max(1e-9);
                small = if done { small + 1 } else { 0 };
                if small == SMALL_STEPS {
                    if !at.places_are_sure() {
                        break;
                    }
                    at.take_places_as_labelled();
                    (squares, small, little) = (at.objective(), 0, LITTLE_EXACT);
                } else if (step + 1) % LEARN_EVERY == 0 {
                    at.learn_places(&slopes);
                    squares = at.objective();
                }
            }
            _ if damping > STIFF => break,
            _ => {
                equations = Some(slopes);
                damping *= 3.0;
            }
        }
    }
    Ok(())
}

/// Keeps every n-th row, counted through all presses.
fn thinned(presses: &[Vec<Row>], every: usize) -> Vec<Vec<&Row>> {
    let mut count = 0;
    let mut keep = |_: &&Row| {
        count += 1;
        (count - 1) % every == 0
    };
    let presses = presses.iter().map(|rows| rows.iter().filter(&mut keep).collect::<Vec<_>>());
    presses.filter(|rows| !rows.is_empty()).collect()
}

/// Taxels to the left and right, and in the row before and after.
pub(crate) fn neighbours(k: usize) -> [Option<usize>; 4] {
    let column = k % COLS;
    [
        (column > 0).then(|| k - 1),
        (column + 1 < COLS).then_some(k + 1),
        k.checked_sub(COLS),
        (k + COLS < ROWS * COLS).then_some(k + COLS),
    ]
}

/// Row, load and displacements.
type Settled<'r> = (&'r Row, [f64; LOAD], [f64; TAXELS]);

fn finish(at: &Bundle<'_>, known: Known) -> Inverse {
    let settled = |(row, load)| (row, load, at.displacements(&load));
    let rows: Vec<Settled<'_>> = at.loads().into_iter().map(settled).collect();
    let mut curves = Curves { stray: [[0.0; 4]; TAXELS], gap: [[0.0; POWERS]; TAXELS] };
    for (k, linear) in at.taxels.iter().enumerate() {
        curves.stray[k] = std::array::from_fn(|i| linear[POWERS + i] as f32);
        curves.gap[k] = gap(k, linear, &rows);
    }
    let p = if known.shear { annulus::completed(&at.field) } else { at.field };
    let [normal, shear] = [0, RADIAL].map(|from| Radial {
        depth: [p[from] as f32, p[from + 1] as f32],
        terms: std::array::from_fn(|i| std::array::from_fn(|j| p[from + 2 + 3 * i + j] as f32)),
    });
    let field = Field { normal, shear, slip: (p[FIELD - 1] as f32).clamp(-1.0, 1.0) };
    let error = error(&curves, &rows, known.noise);
    let centres = std::array::from_fn(|k| at.centre(k).map(|c| c as f32));
    Inverse {
        curves,
        field,
        error,
        shear: known.shear,
        friction: known.friction as f32,
        centres: Centres(centres),
    }
}

/// Fits the curve from the signal without stray light to the displacement.
fn gap(k: usize, linear: &SVector<f64, OWN>, rows: &[Settled<'_>]) -> [f32; POWERS] {
    let mut matrix = SMatrix::<f64, POWERS, POWERS>::zeros();
    let mut right = SVector::<f64, POWERS>::zeros();
    for (row, load, u) in rows {
        let stray: f64 = (0..4)
            .filter_map(|i| neighbours(k)[i].map(|j| linear[POWERS + i] * row.signals[j]))
            .sum();
        let own = row.signals[k] - stray;
        let mut power = 1.0;
        let powers = SVector::<f64, POWERS>::from_fn(|_, _| {
            power *= own;
            power
        });
        let weight = (0.002 + 0.01 * load[2]).powi(-2);
        matrix.ger(weight, &powers, &powers, 1.0);
        right.axpy(weight * u[k], &powers, 1.0);
    }
    for i in 0..POWERS {
        matrix[(i, i)] = matrix[(i, i)] * (1.0 + 1e-12) + 1e-12;
    }
    let found = Cholesky::new(matrix).map_or_else(SVector::zeros, |factor| factor.solve(&right));
    std::array::from_fn(|i| found[i] as f32)
}

/// Residuals of the displacements, by the arithmetic of the chip: [`Inverse::error`].
fn error(curves: &Curves, rows: &[Settled<'_>], noise: f64) -> [f32; 2] {
    let slope = curves.gap.iter().map(|gap| f64::from(gap[0]).powi(2)).sum::<f64>();
    let floor = noise * (slope / TAXELS as f64).sqrt();
    // Rows are weighted by their force, because light touches contain mostly noise.
    let (mut excess, mut loads) = (0.0, 0.0);
    for (row, load, u) in rows {
        let found = curves.displacements(&row.signals.map(|c| c as f32));
        let squares: f64 =
            found.iter().zip(u).map(|(found, u)| (f64::from(*found) - u).powi(2)).sum();
        let force2 = load[2].powi(2);
        excess += force2 * (squares / TAXELS as f64 - floor * floor);
        loads += force2 * force2;
    }
    let share = (excess.max(0.0) / loads.max(f64::MIN_POSITIVE)).sqrt();
    [(floor.max(1e-7)) as f32, share as f32]
}
