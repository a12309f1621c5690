//! Loads of rows whose places are free, with the coefficients as they are.

use nalgebra::{Cholesky, SMatrix, SVector};

use super::{
    Bundle, LOAD, PLACE_STEP, Places, Press, Seen, features, normalised, spread_over_cores,
};

/// Most steps in which the load of a row with a free place is found.
const SETTLING: usize = 8;
/// Times that curves and loads are found in turn before the search.
const ALTERNATIONS: usize = 3;

impl Bundle<'_> {
    /// Finds curves and loads in turn, if places are free.
    pub fn alternated(mut self) -> Self {
        if self.labels.places == Places::Free {
            self.settle();
            for _ in 0..ALTERNATIONS {
                self.solve_linear();
                self.settle();
            }
        }
        self
    }

    /// Finds the load of every row again, with the coefficients as they are.
    ///
    /// A place that is free moves by more than the linearised equations tell.
    pub fn settle(&mut self) {
        let spread = self.spread();
        let settled = spread_over_cores(&self.presses, |presses| {
            let rows =
                presses.iter().flat_map(|press| press.rows.iter().map(move |row| (press, row)));
            rows.map(|(press, seen)| self.settled(press, seen, &spread)).collect::<Vec<_>>()
        });
        let rows = self.presses.iter_mut().flat_map(|press| &mut press.rows);
        rows.zip(settled.into_iter().flatten()).for_each(|(seen, away)| seen.away = away);
    }

    /// Distance of a row's load from its label that explains its signals best: Levenberg–Marquardt.
    fn settled(
        &self,
        press: &Press<'_>,
        seen: &Seen<'_>,
        spread: &SVector<f64, LOAD>,
    ) -> SVector<f64, LOAD> {
        let mut at = seen.clone();
        let (mut damping, mut linearised) = (0.0, None);
        let mut squares = self.squares(press, &at, spread);
        for _ in 0..SETTLING {
            let line = linearised.take().unwrap_or_else(|| self.linearise(press, &at, spread));
            let own = SMatrix::<f64, LOAD, LOAD>::identity() + line.by_load.tr_mul(&line.by_load);
            let right = line.by_load.tr_mul(&line.error) - normalised(&at.away, spread);
            let damped = own + SMatrix::from_diagonal(&(own.diagonal() * damping));
            let Some(factor) = Cholesky::new(damped) else { break };
            let mut step = factor.solve(&right).component_mul(spread);
            step.fixed_rows_mut::<2>(3)
                .iter_mut()
                .for_each(|d| *d = d.clamp(-PLACE_STEP, PLACE_STEP));
            let next = Seen { away: at.away + step, ..at.clone() };
            let found = self.squares(press, &next, spread);
            if found < squares {
                let done = squares - found < 1e-3 * squares;
                (at, squares, damping) = (next, found, 0.3 * damping);
                if done {
                    break;
                }
            } else {
                linearised = Some(line);
                damping = 10.0 * f64::max(damping, 0.01);
            }
        }
        at.away
    }

    /// Sum of squares of a row's signals and load.
    pub(super) fn squares(
        &self,
        press: &Press<'_>,
        seen: &Seen<'_>,
        spread: &SVector<f64, LOAD>,
    ) -> f64 {
        let u = self.displacements(&Self::load(press, seen));
        let mut squares = normalised(&seen.away, spread).norm_squared();
        for (k, u) in u.iter().enumerate() {
            let said = features(k, *u, seen.row).dot(&self.taxels[k]);
            squares += ((seen.row.signals[k] - said) / seen.sigma).powi(2);
        }
        squares
    }
}
