//! One step of the skin model's fit, with the loads of the rows and the places of the presses free.
//!
//! Bundle adjustment (Triggs et al. 1999): each row's load and each press's place may differ from
//! its label by the label's noise. They are eliminated from the normal equations (Schur), which
//! leaves those of field, curves and stray light.

mod equations;
mod settle;

use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use nalgebra::{Cholesky, SMatrix, SVector};
use taxel::scan::{TAXEL_CENTRES, TAXELS};

use super::forward::{
    Coefficients, Displacement, FIELD, LOAD, UNIT, arm, displacement, half_space,
};
use super::{LINEAR, OWN, POWERS, Row, neighbours};
use equations::Equations;

/// All coefficients: the field, then curve, stray light and place of each taxel.
pub(super) const ALL: usize = FIELD + TAXELS * OWN;

/// Share of a row's largest signal that adds to a signal's standard deviation.
const SHARE: f64 = 0.005;
/// Prior of stray light: a share of 0.015 ± 0.01 of the neighbour's signal.
const STRAY: [f64; 2] = [0.015, 0.01];
/// Prior standard deviation of a facet's place, mm: parts are placed to a tenth of a millimetre,
/// and errors of neighbouring rows are alike, so that they tell less than they seem to.
const FACET: f64 = 0.03;
/// Prior standard deviation of the field's coefficients about those of a half-space, and that of
/// the slip share: slip draws the traction in, and never out.
const SPREAD: [f64; 2] = [100.0, 0.3];
/// Squared sizes of contacts whose arm of the shear is held where no place is labelled, and its
/// prior standard deviation about that of a half-space, mm: fingers with labels differ by as much.
const SIZES: [f64; 3] = [0.5, 1.0, 1.5];
const ARM: f64 = 0.3;
/// Relative prior precision of a curve's powers.
const LITTLE: f64 = 1e-9;
/// Normalised residual of a row from which it counts less (Huber 1964).
const HUBER: f64 = 3.0;
/// Least standard deviation of a press's place and of a row's place, mm.
const LEAST_PLACE: f64 = 1e-3;
/// Noise of the labelled places that is no more than the model's own error, mm.
const SURE_PLACE: f64 = 0.01;
/// Noise of forces and places that are taken as labelled, newtons and mm.
const EXACT: f64 = 1e-6;
/// Largest step of a place, mm.
const PLACE_STEP: f64 = 0.5;

/// Standard deviations of the labels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Labels {
    /// Force components, newtons.
    pub force: [f64; 3],
    /// Place of a whole press, mm.
    pub press: f64,
    /// Place of a row about that of its press, mm.
    pub row: f64,
    /// Meaning of the places.
    pub places: Places,
}

/// Meaning of the labelled places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Places {
    /// Measured.
    Labels,
    /// Estimated, with a known noise.
    Estimated,
    /// First guesses, which count for nothing.
    Free,
}

impl Labels {
    /// Root of a row's sum of squares from which it counts less.
    ///
    /// Exact labels have no outliers, and the rows that the model meets worst count fully.
    fn huber(&self) -> f64 {
        if self.press > EXACT { HUBER * (TAXELS as f64).sqrt() } else { f64::INFINITY }
    }
}

/// Rows of one press and its place's distance from the label.
#[derive(Clone)]
struct Press<'r> {
    rows: Vec<Seen<'r>>,
    away: SVector<f64, 2>,
}

/// A row with the distance of its load from the label.
#[derive(Clone)]
struct Seen<'r> {
    row: &'r Row,
    sigma: f64,
    away: SVector<f64, LOAD>,
}

/// Usual value and inverse variance of a taxel's coefficient; the curve is free.
fn prior(coefficient: usize) -> [f64; 2] {
    let [stray, deviation] = STRAY;
    match coefficient {
        ..POWERS => [0.0; 2],
        POWERS..LINEAR => [stray, deviation.powi(-2)],
        LINEAR.. => [0.0, FACET.powi(-2)],
    }
}

/// Prior inverse variance of a coefficient of the field about the start.
fn held(coefficient: usize) -> f64 {
    let [free, slip] = SPREAD;
    if coefficient == FIELD - 1 { slip.powi(-2) } else { free.powi(-2) }
}

/// The fit's unknowns and data.
#[derive(Clone)]
pub(super) struct Bundle<'r> {
    presses: Vec<Press<'r>>,
    pub labels: Labels,
    friction: f64,
    shear: bool,
    pub field: Coefficients,
    /// Coefficients of u … u⁵ and of the four neighbours, and the distance of the facet's centre
    /// from the drawing's in mm, of each taxel.
    pub taxels: [SVector<f64, OWN>; TAXELS],
}

impl<'r> Bundle<'r> {
    /// Starts at a half-space with the labels' loads.
    pub fn new(
        presses: &[Vec<&'r Row>],
        labels: Labels,
        (friction, noise, shear): (f64, f64, bool),
    ) -> Self {
        let most = |row: &Row| row.signals.iter().fold(0.0f64, |most, c| most.max(c.abs()));
        let seen = |row: &&'r Row| Seen {
            row,
            sigma: 2.0 * noise + SHARE * most(row),
            away: SVector::zeros(),
        };
        let presses = presses
            .iter()
            .map(|rows| Press { rows: rows.iter().map(seen).collect(), away: SVector::zeros() })
            .collect();
        let taxels = [SVector::zeros(); TAXELS];
        let mut bundle = Self { presses, labels, friction, shear, field: half_space(), taxels };
        bundle.solve_linear();
        bundle
    }

    fn spread(&self) -> SVector<f64, LOAD> {
        let [fx, fy, fz] = self.labels.force;
        SVector::from([fx, fy, fz, self.labels.row, self.labels.row])
    }

    /// Load of a row: its label moved by what is known of its error.
    fn load(press: &Press<'_>, seen: &Seen<'_>) -> [f64; LOAD] {
        let ([fx, fy, fz], [x, y]) = (seen.row.force, seen.row.point);
        let mut load = [fx, fy, fz, x + press.away[0], y + press.away[1]];
        load.iter_mut().zip(seen.away.iter()).for_each(|(load, away)| *load += away);
        load
    }

    /// Every row with its present load.
    pub fn loads(&self) -> Vec<(&'r Row, [f64; LOAD])> {
        let of = |press: &Press<'r>| -> Vec<(&'r Row, [f64; LOAD])> {
            press.rows.iter().map(|seen| (seen.row, Self::load(press, seen))).collect()
        };
        self.presses.iter().flat_map(of).collect()
    }

    /// Displacements under a load, with their derivatives.
    fn displaced(&self, load: &[f64; LOAD]) -> impl Iterator<Item = Displacement> {
        (0..TAXELS)
            .map(|k| displacement(&self.field, load, self.centre(k), (self.friction, self.shear)))
    }

    /// Centre of a taxel's facet, mm.
    pub fn centre(&self, k: usize) -> [f64; 2] {
        let [x, y] = TAXEL_CENTRES[k].map(|c| f64::from(c.0));
        [x + self.taxels[k][LINEAR], y + self.taxels[k][LINEAR + 1]]
    }

    /// Displacements under a load.
    pub fn displacements(&self, load: &[f64; LOAD]) -> [f64; TAXELS] {
        let mut values = [0.0; TAXELS];
        values.iter_mut().zip(self.displaced(load)).for_each(|(value, u)| *value = u.value);
        values
    }

    /// Starts from another field.
    pub fn with_field(mut self, field: Coefficients) -> Self {
        self.field = field;
        self.solve_linear();
        self
    }

    /// Solves for the curves and stray light at the present field and loads.
    fn solve_linear(&mut self) {
        let none = (SMatrix::<f64, OWN, OWN>::zeros(), SVector::<f64, OWN>::zeros());
        let mut sums = vec![none; TAXELS];
        for (press, seen) in self.presses.iter().flat_map(|p| p.rows.iter().map(move |s| (p, s))) {
            let u = self.displacements(&Self::load(press, seen));
            // A force that is off by the label's noise moves every signal by its share.
            let off = self.labels.force[2] / seen.row.force[2].abs().max(1e-3);
            let most = seen.row.signals.iter().fold(0.0f64, |most, c| most.max(c.abs()));
            let weight = (seen.sigma.powi(2) + (off * most).powi(2)).recip();
            for (k, (matrix, right)) in sums.iter_mut().enumerate() {
                let features = features(k, u[k], seen.row);
                matrix.ger(weight, &features, &features, 1.0);
                right.axpy(weight * seen.row.signals[k], &features, 1.0);
            }
        }
        for (taxel, (mut matrix, mut right)) in self.taxels.iter_mut().zip(sums) {
            for i in 0..OWN {
                let [usual, weight] = prior(i);
                matrix[(i, i)] += weight;
                right[i] += weight * usual;
            }
            (0..POWERS).for_each(|i| matrix[(i, i)] *= 1.0 + LITTLE);
            *taxel = Cholesky::new(matrix).map_or_else(SVector::zeros, |f| f.solve(&right));
        }
    }

    /// Robust sum of squares of signals and labels.
    pub fn objective(&self) -> f64 {
        let spread = self.spread();
        let of_press = |press: &Press<'_>| {
            let rows = press
                .rows
                .iter()
                .map(|seen| huber(self.squares(press, seen, &spread), self.labels.huber()));
            rows.sum::<f64>() + press.away.norm_squared() / self.labels.press.powi(2)
        };
        let presses: f64 =
            spread_over_cores(&self.presses, |presses| presses.iter().map(of_press).sum::<f64>())
                .into_iter()
                .sum();
        let away = self.field - half_space();
        let field: f64 = away.iter().enumerate().map(|(i, away)| held(i) * away * away).sum();
        let arms: f64 =
            self.held_sizes().iter().map(|size2| arm_off(&self.field, *size2).powi(2)).sum();
        let own = self.taxels.iter().flat_map(|taxel| taxel.iter().enumerate());
        let own = own.map(|(n, value)| {
            let [usual, weight] = prior(n);
            weight * (value - usual).powi(2)
        });
        presses + field + arms + own.sum::<f64>()
    }

    /// Sizes whose arm of the shear is held: none where places are labelled.
    fn held_sizes(&self) -> &'static [f64] {
        if self.labels.places == Places::Free && self.shear { &SIZES } else { &[] }
    }

    /// Derivatives by the field of [`arm_off`].
    fn arm_slopes(&self, size2: f64) -> Coefficients {
        const STEP: f64 = 1e-5;
        Coefficients::from_fn(|i, _| {
            let mut moved = self.field;
            moved[i] += STEP;
            let after = arm_off(&moved, size2);
            moved[i] -= 2.0 * STEP;
            (after - arm_off(&moved, size2)) / (2.0 * STEP)
        })
    }

    /// Number of residuals of the signals.
    pub fn values(&self) -> usize {
        TAXELS * self.presses.iter().map(|press| press.rows.len()).sum::<usize>()
    }

    /// Moves all unknowns by the damped solution; `None` if it does not exist.
    pub fn moved(&self, equations: &Equations, damping: f64) -> Option<Self> {
        let free: Vec<usize> = (0..ALL)
            .filter(|i| *i != UNIT && (self.shear || *i < FIELD / 2 || *i >= FIELD))
            .collect();
        let mut matrix = equations.matrix.select_rows(&free).select_columns(&free);
        let right = equations.right.select_rows(&free);
        for i in 0..free.len() {
            let own = matrix[(i, i)].max(f64::MIN_POSITIVE);
            matrix[(i, i)] += (damping + LITTLE) * own;
        }
        let solved = Cholesky::new(matrix)?.solve(&right);
        let mut step = SVector::<f64, ALL>::zeros();
        free.iter().zip(solved.iter()).for_each(|(i, s)| step[*i] = *s);
        let mut next = self.clone();
        for i in 0..FIELD {
            next.field[i] += step[i];
        }
        for (k, taxel) in next.taxels.iter_mut().enumerate() {
            for n in 0..OWN {
                taxel[n] += step[FIELD + k * OWN + n];
            }
        }
        let spread = self.spread();
        if self.labels.places == Places::Free {
            next.settle();
            return Some(next);
        }
        for (press, back) in next.presses.iter_mut().zip(&equations.back) {
            let mut away = back.own - back.by_all.tr_mul(&step);
            away.iter_mut().for_each(|d| *d = d.clamp(-PLACE_STEP, PLACE_STEP));
            press.away += away;
            for (seen, back) in press.rows.iter_mut().zip(&back.rows) {
                let own = back.own - back.by_others(&step, &away);
                seen.away += own.component_mul(&spread);
            }
        }
        Some(next)
    }

    /// Whether forces and places were found to be exact, and are not yet taken so.
    pub fn places_are_sure(&self) -> bool {
        let Labels { force, press, places, .. } = self.labels;
        places == Places::Labels
            && force.iter().all(|noise| *noise < EXACT)
            && press < SURE_PLACE
            && press > EXACT
    }

    /// Takes forces and places as labelled.
    ///
    /// Free places would hide a part of the model's own error.
    pub fn take_places_as_labelled(&mut self) {
        (self.labels.press, self.labels.row) = (EXACT, EXACT);
        for press in &mut self.presses {
            press.away = SVector::zeros();
            press.rows.iter_mut().for_each(|seen| seen.away = SVector::zeros());
        }
    }

    /// Re-estimates the noise of the places from their posterior.
    pub fn learn_places(&mut self, equations: &Equations) {
        if self.labels.press <= EXACT || self.labels.places != Places::Labels {
            return;
        }
        let presses = self.presses.len().max(1) as f64;
        let of_presses = self.presses.iter().zip(&equations.back);
        let press: f64 = of_presses.map(|(p, back)| p.away.norm_squared() + back.variance).sum();
        let rows = self.presses.iter().zip(&equations.back);
        let rows = rows.flat_map(|(p, back)| p.rows.iter().zip(&back.rows));
        let (mut row, mut count) = (0.0, 0.0);
        for (seen, back) in rows {
            let at = seen.away.fixed_rows::<2>(3);
            row += at.norm_squared() + self.labels.row.powi(2) * back.variance;
            count += 2.0;
        }
        self.labels.press = (press / (2.0 * presses)).sqrt().max(LEAST_PLACE);
        self.labels.row = (row / f64::max(count, 1.0)).sqrt().max(LEAST_PLACE);
    }
}

/// Deviation of the shear's arm from a half-space's, in its prior's.
fn arm_off(field: &Coefficients, size2: f64) -> f64 {
    (arm(field, size2) - arm(&half_space(), size2)) / ARM
}

fn normalised(away: &SVector<f64, LOAD>, spread: &SVector<f64, LOAD>) -> SVector<f64, LOAD> {
    away.zip_map(spread, |away, spread| if spread > 0.0 { away / spread } else { 0.0 })
}

/// Weight of a row with this sum of squares over all signals.
fn huber_weight(squares: f64, limit: f64) -> f64 {
    (limit / squares.sqrt().max(f64::MIN_POSITIVE)).min(1.0)
}

fn huber(squares: f64, limit: f64) -> f64 {
    let root = squares.sqrt();
    if root < limit { squares } else { limit * (2.0 * root - limit) }
}

/// Features of taxel k's signal: powers of its displacement, signals of its neighbours; none of its
/// place.
pub(super) fn features(k: usize, u: f64, row: &Row) -> SVector<f64, OWN> {
    let mut features = SVector::<f64, OWN>::zeros();
    let mut power = 1.0;
    for n in 0..POWERS {
        power *= u;
        features[n] = power;
    }
    for (i, j) in neighbours(k).into_iter().enumerate() {
        features[POWERS + i] = j.map_or(0.0, |j| row.signals[j]);
    }
    features
}

/// Least number of items for a thread of its own.
const CHUNK: usize = 4;

/// Runs `work` on chunks of fixed bounds, in all cores; the results are in the order of the items.
///
/// The chunks do not depend on the number of cores, so that the sums are the same bits everywhere.
fn spread_over_cores<T: Sync, R: Send>(items: &[T], work: impl Fn(&[T]) -> R + Sync) -> Vec<R> {
    let chunks: Vec<&[T]> = items.chunks(items.len().div_ceil(8).max(CHUNK)).collect();
    let threads = thread::available_parallelism().map_or(1, usize::from).min(chunks.len());
    let next = AtomicUsize::new(0);
    let mut results: Vec<(usize, R)> = thread::scope(|scope| {
        let run = || {
            let mut own = Vec::new();
            loop {
                let i = next.fetch_add(1, Ordering::Relaxed);
                let Some(chunk) = chunks.get(i) else { return own };
                own.push((i, work(chunk)));
            }
        };
        let handles: Vec<_> = (0..threads).map(|_| scope.spawn(run)).collect();
        let done = handles.into_iter().map(|h| h.join().unwrap_or_default());
        done.flatten().collect()
    });
    results.sort_by_key(|(i, _)| *i);
    results.into_iter().map(|(_, result)| result).collect()
}
