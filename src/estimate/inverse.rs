//! Inverse of the skin model: the single contact that best explains the signals.
//!
//! [TactileEnc] states the problem; [DeMaria2011] names it as future work. Each taxel's measured
//! curve turns signals into displacements. Gauss–Newton then finds the contact whose [`Field`] fits
//! them best. Each scan takes one step from the contact of the last, with a
//! [linearisation](super::linearised) that is renewed when the contact has left its reach; a new
//! contact takes a few. The result includes its covariance and its misfit; a large misfit that
//! stays means that the contact is not a single one of the calibrated kind.

use core::ops::Range;

use serde::{Deserialize, Serialize};

use super::field::{Around, Field, Load};
use super::linearised::{Linearised, Six, UNKNOWNS};
use crate::math::{at_least, at_most, sqrt};
use crate::measured::{Measured, NoValue};
use crate::scan::{COLS, ROWS, TAXEL_CENTRES, TAXELS};

/// Steps in the first scan of a contact and after a gap, if the scans leave time for them.
/// Other scans take one: from the last contact it practically converges at a kilohertz.
const FIRST_STEPS: u8 = 3;
/// Time between scans, in microseconds, that leaves enough for [`FIRST_STEPS`].
const UNHURRIED_US: u32 = 900;
/// Reach of a linearisation with shear: change of s as its share, of x and y in mm, and of the
/// shear as a share of the normal force.
///
/// Shear and position resemble each other, so that slopes a few per cent off already show as noise
/// of both.
const REACH: [f32; 3] = [0.015, 0.02, 0.02];
/// Normal force in newtons at which the reach with shear is twice as long: noise moves a light
/// contact without a need for other slopes.
const LIGHT: f32 = 0.05;
/// Reach of a linearisation without shear, or with a shear that nobody needs, in reaches of one
/// with shear.
pub(super) const PRESSED_REACH: f32 = 6.0;
/// Unknowns of a contact without shear: s, x, y.
const PRESSED: Range<usize> = 2..5;
/// Share of a scan's change of shear and friction utilisation by which the next step's start
/// follows, where no other sensor measures the shear.
///
/// Slopes are proportional to the shear, and slopes with a scan's noise in them bias what the next
/// scans tell. A change of more than [`SMOOTHED`] reaches is no noise, and a contact with a misfit
/// above [`SURE`] is still being searched: the start follows these at once.
const SLOWLY: f32 = 0.25;
const SMOOTHED: f32 = 5.0;
const SURE: f32 = 2.0;
/// Misfit of a contact that may be a wrong one, and number of fits with it after which the search
/// begins again, once: the contact may be right and the calibration old.
const ASTRAY: f32 = 10.0;
const ENDURED: u8 = 12;
/// Least s of a contact: f_z of 1 mN.
const LEAST_SIZE: f32 = 0.1;
/// Largest s: f_z of 27 N, beyond the range of any sensor of [DeMaria2011] or [Ospina2017].
const MOST_SIZE: f32 = 3.0;
/// Largest step of the contact position in mm, and of s.
const POINT_STEP: f32 = 1.0;
const SIZE_STEP: f32 = 0.3;
/// Farthest contact position in mm: the pad ends at 5.
const FARTHEST: f32 = 7.0;
/// Contact position in mm that no touch of the pad has.
const OFF_PAD: f32 = 6.0;
/// Largest friction coefficient of rubber.
const MOST_FRICTION: f32 = 2.0;
/// Prior standard deviation of a shear component over the normal force: even within the friction
/// cone of rubber, whose coefficient is about 1.
const USUAL_SHEAR: f32 = 0.5;
/// Prior mean and standard deviation of the friction utilisation: even between 0 and 1.
const USED: [f32; 2] = [0.5, 0.4];
/// Least variance of the friction utilisation: a thousandth, squared.
const LEAST_VARIANCE: f32 = 1e-6;

/// Conversion from signals to displacements.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Curves {
    /// Crosstalk: share of each neighbour's signal in a taxel. The order is left, right, below (row
    /// − 1), above (row + 1).
    pub stray: [[f32; 4]; TAXELS],
    /// Linearisation curve u, a polynomial of the taxel's own signal: coefficients of c … c⁵.
    pub gap: [[f32; 5]; TAXELS],
}

impl Curves {
    /// Returns the displacements u_k, positive where the facet came nearer.
    #[must_use]
    pub fn displacements(&self, c: &[f32; TAXELS]) -> [f32; TAXELS] {
        let at = |k: Option<usize>| k.and_then(|k| c.get(k)).copied().unwrap_or_default();
        let mut u = [0.0; TAXELS];
        for (k, ((u, [left, right, below, above]), [a1, a2, a3, a4, a5])) in
            u.iter_mut().zip(&self.stray).zip(&self.gap).enumerate()
        {
            let column = k % COLS;
            let own = at(Some(k))
                - left * at((column > 0).then(|| k.wrapping_sub(1)))
                - right * at((column + 1 < COLS).then_some(k + 1))
                - below * at(k.checked_sub(COLS))
                - above * at((k + COLS < ROWS * COLS).then_some(k + COLS));
            *u = own * (a1 + own * (a2 + own * (a3 + own * (a4 + own * a5))));
        }
        u
    }
}

/// Centre of each facet in mm. Parts are placed to a tenth of a millimetre, and near its frame a
/// skin acts as if facets were nearer to the middle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Centres(pub [[f32; 2]; TAXELS]);

impl Default for Centres {
    fn default() -> Self {
        Self(TAXEL_CENTRES.map(|centre| centre.map(|c| c.0)))
    }
}

impl Centres {
    /// Returns whether all facets are where the drawing has them.
    #[must_use]
    pub fn are_nominal(&self) -> bool {
        *self == Self::default()
    }
}

/// Coefficients of the inverse for one finger.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Inverse {
    /// Conversion from signals to displacements.
    pub curves: Curves,
    /// Displacement field of a contact.
    pub field: Field,
    /// Residual displacement in calibration without load, and its increase per newton. The two
    /// values are root mean squares over the taxels.
    pub error: [f32; 2],
    /// Whether the calibration included shear, so that T is known.
    pub shear: bool,
    /// Friction coefficient of the object that touched the finger in calibration.
    pub friction: f32,
    /// Centres of the facets; a record without them has the drawing's.
    #[serde(default, skip_serializing_if = "Centres::are_nominal")]
    pub centres: Centres,
}

/// State of the inverse: the contact of the last scan, and the linearisation near it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InverseState {
    last: Option<Load>,
    /// Whether the contact has been found before, and followed without a gap since.
    followed: bool,
    /// Whether scans follow too fast for more than a step.
    hurried: bool,
    /// Whether the next fit's shear and friction utilisation are not needed.
    coarse: bool,
    /// Fits in a row with a misfit above [`ASTRAY`].
    astray: u8,
    /// Contact of `kept`, and whether it includes shear.
    at: Option<(Load, bool)>,
    kept: Linearised,
}

/// Shear as measured by other sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShearPrior {
    /// Ratios f_x/f_z and f_y/f_z.
    pub ratio: [f32; 2],
    /// Standard deviation of either ratio.
    pub sigma: f32,
}

/// Estimated contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactFit {
    /// Force and position.
    pub load: Load,
    /// Standard deviations of f_x, f_y, f_z (N), x, y (mm) and of the friction utilisation.
    pub sigma: [f32; 6],
    /// Information of this scan on the friction utilisation.
    pub ring: FrictionUtilisation,
    /// Normalised residual: root mean square of the remaining displacements over that of the
    /// calibration at this force.
    pub misfit: f32,
}

/// Information of one scan on the friction utilisation, without the prior. The information of
/// several scans may be added.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrictionUtilisation {
    /// Inverse variance; 0 without information.
    pub weight: f32,
    /// Friction utilisation times its weight.
    pub moment: f32,
}

impl FrictionUtilisation {
    /// Removes the prior [`USED`] from an estimate and its variance.
    fn of(found: f32, variance: f32) -> Self {
        let [usual, spread] = USED;
        let (before, after) = (1.0 / (spread * spread), 1.0 / variance.max(LEAST_VARIANCE));
        let seen = after > before;
        let known = Self { weight: after - before, moment: found * after - usual * before };
        if seen { known } else { Self::default() }
    }
}

impl ContactFit {
    /// Returns f_x, f_y, f_z in newtons.
    #[must_use]
    pub fn force(&self) -> [f32; 3] {
        let [x, y] = self.load.shear;
        [x, y, self.load.normal()]
    }

    #[inline(never)]
    fn is_sound(&self) -> bool {
        self.misfit < f32::MAX && self.sigma.iter().all(|sigma| *sigma < f32::MAX)
    }

    /// Returns whether the contact explains the displacements.
    #[must_use]
    pub fn is_sure(&self) -> bool {
        self.misfit < SURE
    }

    /// Returns whether a touch of the pad can be there.
    #[must_use]
    pub fn is_on_pad(&self) -> bool {
        self.load.point.iter().all(|at| at.abs() < OFF_PAD)
    }
}

impl InverseState {
    /// Forgets the contact.
    pub fn clear(&mut self) {
        // The kept linearisation stays: it is large, and unused without its contact.
        self.lose();
        self.followed = false;
    }

    /// Forgets where the contact is: the search begins again, with a single step.
    pub fn lose(&mut self) {
        (self.last, self.at, self.astray) = (None, None, 0);
    }

    /// Tells that the contact may have moved far since the last fit.
    pub fn interrupt(&mut self) {
        self.followed = false;
    }

    /// Tells that scans come every `period` microseconds, lost ones included.
    ///
    /// An overloaded finger would not recover if each lost scan made the next fit longer.
    pub fn wait(&mut self, period: u32) {
        self.hurried = period < UNHURRIED_US;
    }

    /// Tells whether shear and friction utilisation of the next fits are needed, or known from
    /// elsewhere. They are needed until this is called.
    pub fn need_shear(&mut self, needed: bool) {
        self.coarse = !needed;
    }

    /// Returns whether scans follow too fast for more than a step.
    #[must_use]
    pub fn hurried(&self) -> bool {
        self.hurried
    }

    /// Returns whether the next fit searches a new contact, or one that may have moved far.
    #[must_use]
    pub fn searches(&self) -> bool {
        !self.followed
    }
}

impl Inverse {
    /// Estimates a contact without shear from one scan of displacements.
    ///
    /// # Errors
    /// [`NoValue::IllConditioned`] if the displacements do not determine a contact.
    pub fn pressed(&self, state: &mut InverseState, u: &[f32; TAXELS]) -> Measured<ContactFit> {
        self.find(state, u, false, None)
    }

    /// Estimates a contact with shear and friction utilisation from one scan of displacements.
    ///
    /// Force and position come from the displacements alone. The friction utilisation also uses the
    /// shear measured by other sensors, because displacements hardly distinguish it from a weaker
    /// shear.
    ///
    /// # Errors
    /// [`NoValue::NotEstimated`] if the calibration had no shear, [`NoValue::IllConditioned`] if
    /// the displacements do not determine a contact.
    pub fn sheared(
        &self,
        state: &mut InverseState,
        u: &[f32; TAXELS],
        measured: Option<ShearPrior>,
    ) -> Measured<ContactFit> {
        if !self.shear {
            return Err(NoValue::NotEstimated);
        }
        self.find(state, u, true, measured)
    }

    fn find(
        &self,
        state: &mut InverseState,
        u: &[f32; TAXELS],
        sheared: bool,
        measured: Option<ShearPrior>,
    ) -> Measured<ContactFit> {
        let steps = if state.searches() && !state.hurried { FIRST_STEPS } else { 1 };
        let mut last = state.last;
        if last.is_none() || state.searches() {
            last = self.start(u).map(|start| match last {
                Some(last) if self.left(&last, u, sheared) < self.left(&start, u, sheared) => last,
                _ => start,
            });
        }
        let found = last.as_mut().and_then(|load| {
            (0..steps).fold(None, |_, _| self.step(state, load, u, sheared, measured))
        });
        let sound = found.filter(ContactFit::is_sound);
        match &sound {
            Some(fit) if fit.misfit < ASTRAY => {
                (state.last, state.followed, state.astray) = (last, true, 0);
            }
            Some(_) => {
                (state.last, state.followed) = (last, true);
                state.astray = state.astray.saturating_add(1);
                if state.astray == ENDURED {
                    (state.last, state.at) = (None, None);
                }
            }
            None => state.clear(),
        }
        sound.ok_or(NoValue::IllConditioned)
    }

    /// Returns the sum of the positive displacements and their centroid.
    #[inline(never)]
    pub(super) fn centroid(&self, u: &[f32; TAXELS]) -> Option<(f32, [f32; 2])> {
        let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
        for (u, [cx, cy]) in u.iter().zip(&self.centres.0) {
            let weight = u.max(0.0);
            sum += weight;
            x += weight * cx;
            y += weight * cy;
        }
        (sum > f32::MIN_POSITIVE && sum < f32::MAX).then(|| (sum, [x / sum, y / sum]))
    }

    /// Returns the sum of the squared displacements that a contact leaves.
    #[inline(never)]
    fn left(&self, load: &Load, u: &[f32; TAXELS], sheared: bool) -> f32 {
        let mut left = *u;
        self.field.around(load).subtract(&mut left, &self.centres.0, sheared);
        squared(&left)
    }

    /// Returns the initial contact: the centroid of the displacements, and the force that causes
    /// their sum.
    #[inline(never)]
    fn start(&self, u: &[f32; TAXELS]) -> Option<Load> {
        let (sum, point) = self.centroid(u)?;
        let newton = Load { size: 1.0, point, used: USED[0], ..Load::default() };
        let mut left = [0.0; TAXELS];
        self.field.around(&newton).subtract(&mut left, &self.centres.0, false);
        let whole = -left.iter().sum::<f32>();
        let force = if whole > f32::MIN_POSITIVE { sum / whole } else { 0.0 };
        let size = crate::math::cube_root(force).clamp(LEAST_SIZE, MOST_SIZE);
        Some(Load { size, ..newton })
    }

    /// Returns whether 1 N dents the facet below it by four times the signal `dent`.
    ///
    /// The root mean square of sixteen signals, of which one is four times as large, is that.
    pub(crate) fn notices(&self, dent: f32) -> bool {
        let [_, _, _, _, _, [slope, ..], ..] = self.curves.gap;
        self.dented_by_newton() > (4.0 * dent * slope).abs()
    }

    /// Returns calibration's residual at 1 N over the displacement under that contact.
    pub(crate) fn expected_share(&self) -> f32 {
        let sinks = self.dented_by_newton();
        let [floor, share] = self.error;
        if sinks > f32::MIN_POSITIVE { ((floor + share) / sinks).min(1.0) } else { 1.0 }
    }

    /// Returns the displacement of a facet under a contact of 1 N.
    #[inline(never)]
    fn dented_by_newton(&self) -> f32 {
        let newton = Load { size: 1.0, ..Load::default() };
        self.field.around(&newton).pressed([0.0; 2]).0
    }

    /// Returns calibration's residual displacement at this normal force.
    pub(super) fn expected(&self, normal: f32) -> f32 {
        let [floor, share] = self.error;
        floor + share * normal
    }

    /// Subtracts a contact without shear from the displacements `left`. Its slopes by s, x, y go to
    /// three columns from the one given.
    #[inline(never)]
    pub(super) fn press(
        &self,
        around: &Around<'_>,
        left: &mut [f32; TAXELS],
        slopes: &mut [Six; TAXELS],
        column: usize,
    ) {
        for ((facet, left), row) in self.centres.0.iter().zip(left).zip(slopes) {
            let (model, slopes) = around.pressed(*facet);
            *left -= model;
            row.iter_mut().skip(column).zip(slopes).for_each(|(to, slope)| *to = slope);
        }
    }

    /// Takes one step from `load`, with the kept linearisation if it reaches so far.
    fn step(
        &self,
        state: &mut InverseState,
        load: &mut Load,
        u: &[f32; TAXELS],
        sheared: bool,
        measured: Option<ShearPrior>,
    ) -> Option<ContactFit> {
        let error = self.expected(load.normal());
        let light = at_most(1.0 + LIGHT / load.normal(), PRESSED_REACH);
        let reach = if sheared && !state.coarse { light } else { PRESSED_REACH };
        let reached =
            state.at.is_some_and(|(at, with)| with == sheared && load.apart(&at) <= reach);
        if !sheared {
            load.shear = [0.0; 2];
            load.used = USED[0];
        }
        let left = if reached {
            let mut left = *u;
            self.field.around(load).subtract(&mut left, &self.centres.0, sheared);
            left
        } else {
            state.at = None;
            state.kept.weights = weights(load, error, sheared);
            let mut left = *u;
            let slopes = &mut state.kept.slopes;
            let around = self.field.around(load);
            if sheared {
                let facets = self.centres.0.iter().zip(&mut left).zip(slopes);
                for ((facet, left), row) in facets {
                    let model;
                    (model, *row) = around.sheared(*facet);
                    *left -= model;
                }
            } else {
                *slopes = [[0.0; UNKNOWNS]; TAXELS];
                self.press(&around, &mut left, slopes, PRESSED.start);
            }
            if !state.kept.renew(if sheared { 0..UNKNOWNS } else { PRESSED }) {
                return None;
            }
            state.at = Some((*load, sheared));
            left
        };
        let squares = squared(&left);
        let pull = if sheared { pull(load, &state.kept.weights) } else { [0.0; UNKNOWNS] };
        let (mut step, explained) = state.kept.step(&left, &pull);
        let mut variances = state.kept.variances();
        if let Some(prior) = measured {
            let (more, variance) = prior.refine(&state.kept, &step, load, error);
            step[5] += more;
            variances[5] = variance;
        }
        let found = load.after(&step);
        // Far from its start a step explains less than its slopes tell.
        let far = found.apart(load) > SMOOTHED;
        let unexplained = if far { self.left(&found, u, sheared) } else { squares - explained };
        let misfit = misfit(unexplained, error);
        let sure = misfit < SURE && !far;
        let share = if sure && measured.is_none() { SLOWLY } else { 1.0 };
        let toward = |from: f32, to: f32| from + share * (to - from);
        let ([fx, fy], [to_x, to_y]) = (load.shear, found.shear);
        *load = Load {
            shear: [toward(fx, to_x), toward(fy, to_y)],
            used: toward(load.used, found.used),
            ..found
        };
        let wide = error * misfit.max(1.0);
        let mut sigma = variances.map(|variance| wide * sqrt(variance));
        sigma[2] *= 3.0 * found.size * found.size;
        if !sheared {
            let [x, y, .., used] = &mut sigma;
            (*x, *y, *used) = (0.0, 0.0, USED[1]);
        }
        let ring = if sheared {
            FrictionUtilisation::of(found.used, sigma[5] * sigma[5])
        } else {
            FrictionUtilisation::default()
        };
        Some(ContactFit { load: found, sigma, ring, misfit })
    }
}

/// Returns the weights of the prior of a single contact.
fn weights(load: &Load, error: f32, sheared: bool) -> Six {
    let placed = square(error / FARTHEST);
    if sheared {
        let pulled = square(error / (USUAL_SHEAR * load.normal()));
        [pulled, pulled, 0.0, placed, placed, square(error / USED[1])]
    } else {
        // Unknowns without slopes stay as they are.
        [1.0, 1.0, 0.0, placed, placed, 1.0]
    }
}

/// Returns the gradient of the prior.
fn pull(load: &Load, weights: &Six) -> Six {
    let ([fx, fy], [x, y, .., used]) = (load.shear, *weights);
    [-x * fx, -y * fy, 0.0, 0.0, 0.0, used * (USED[0] - load.used)]
}

impl ShearPrior {
    /// Returns by how much this prior changes the friction utilisation of `step`, and its variance
    /// then. `error` is the residual of the displacements.
    fn refine(&self, kept: &Linearised, step: &Six, load: &Load, error: f32) -> (f32, f32) {
        let normal = load.normal();
        let slope = -3.0 * load.size * load.size;
        let ([rx, ry], [fx, fy]) = (self.ratio, load.shear);
        let missed = [rx * normal - fx, ry * normal - fy];
        kept.refine(step, [rx * slope, ry * slope], missed, square(error / (self.sigma * normal)))
    }
}

impl Load {
    /// Returns how far another contact is from this one, in reaches of a linearisation.
    pub(super) fn apart(&self, other: &Self) -> f32 {
        let [size, place, shear] = REACH;
        let ([x, y], [fx, fy]) = (self.point, self.shear);
        let ([to_x, to_y], [to_fx, to_fy]) = (other.point, other.shear);
        let size = (self.size - other.size).abs() / (size * other.size);
        let place = at_least((x - to_x).abs(), (y - to_y).abs()) * (1.0 / place);
        let shear = at_least((fx - to_fx).abs(), (fy - to_fy).abs()) / (shear * other.normal());
        at_least(at_least(size, place), shear)
    }

    /// Returns the contact a step of its unknowns f_x, f_y, s, x, y, b away, within their ranges.
    fn after(&self, step: &Six) -> Self {
        let [dfx, dfy, ds, dx, dy, db] = *step;
        let mut load = *self;
        load.advance(ds, [dx, dy]);
        let [fx, fy] = [self.shear[0] + dfx, self.shear[1] + dfy];
        let (shear, most) = (sqrt(fx * fx + fy * fy), MOST_FRICTION * load.normal());
        let share = if shear > most { most / shear } else { 1.0 };
        load.shear = [fx * share, fy * share];
        load.used = (self.used + db).clamp(-0.5, 1.5);
        load
    }

    /// Moves the contact by a limited step within its allowed range.
    #[inline(never)]
    pub(super) fn advance(&mut self, ds: f32, [dx, dy]: [f32; 2]) {
        self.size = (self.size + ds.clamp(-SIZE_STEP, SIZE_STEP)).clamp(LEAST_SIZE, MOST_SIZE);
        let [x, y] = self.point;
        self.point = [
            (x + dx.clamp(-POINT_STEP, POINT_STEP)).clamp(-FARTHEST, FARTHEST),
            (y + dy.clamp(-POINT_STEP, POINT_STEP)).clamp(-FARTHEST, FARTHEST),
        ];
    }
}

pub(super) fn misfit(squares: f32, error: f32) -> f32 {
    sqrt(squares * (1.0 / TAXELS as f32)) / error
}

/// Returns the sum of squares.
pub(super) fn squared(left: &[f32; TAXELS]) -> f32 {
    left.iter().fold(0.0, |sum, left| sum + left * left)
}

pub(super) fn square(x: f32) -> f32 {
    x * x
}

#[cfg(test)]
pub(crate) mod tests {
    use super::super::field::tests::HALF_SPACE;
    use super::*;
    use crate::condition::random::noise;
    use proptest::prelude::*;

    pub(crate) fn finger() -> Inverse {
        Inverse {
            curves: Curves { stray: [[0.0; 4]; TAXELS], gap: [[-1.0, 0.0, 0.0, 0.0, 0.0]; TAXELS] },
            field: HALF_SPACE,
            error: [2e-4, 2e-4],
            shear: true,
            friction: 0.8,
            centres: Centres::default(),
        }
    }

    pub(crate) fn displaced(load: &Load) -> [f32; TAXELS] {
        let around = HALF_SPACE.around(load);
        Centres::default().0.map(|c| around.sheared(c).0)
    }

    /// Returns the contact after twelve scans. A shear of two thirds of the normal force near the
    /// outer taxels needs seven, with a high misfit until then.
    fn settled(u: &[f32; TAXELS]) -> ContactFit {
        let (finger, mut state) = (finger(), InverseState::default());
        (0..12).map(|_| finger.sheared(&mut state, u, None)).last().unwrap().unwrap()
    }

    proptest! {
        #[test]
        fn contact_round_trips_through_displacements(
            share in 0.0..0.7f32, turn in -3.0..3.0f32, size in 0.5..1.26f32,
            x in -3.75..3.75f32, y in -3.75..3.75f32,
        ) {
            let shear = share * size.powi(3);
            let load = Load {
                shear: [shear * turn.cos(), shear * turn.sin()], size, point: [x, y], used: 0.5,
            };
            let touch = settled(&displaced(&load));
            prop_assert!((touch.load.normal() / load.normal() - 1.0).abs() < 0.01, "{touch:?}");
            for axis in 0..2 {
                prop_assert!((touch.load.point[axis] - load.point[axis]).abs() < 0.02, "{touch:?}");
                let apart = (touch.load.shear[axis] - load.shear[axis]).abs();
                prop_assert!(apart < 0.02 * load.normal(), "{touch:?} {load:?}");
            }
            prop_assert!(touch.misfit < 1.0);
        }

        #[test]
        fn contact_is_finite_for_any_input(
            u in proptest::array::uniform16(prop_oneof![-1e9..1e9f32, -1.0..1.0f32, Just(0.0f32)]),
            scale in prop_oneof![-1e3..1e3f32, -1.0..1.0f32, Just(0.0f32)],
            floor in prop_oneof![1e-9..1.0f32, Just(1e-9f32)],
            ratio in proptest::array::uniform2(-2.0..2.0f32), sigma in 1e-6..1.0f32, pulls in any::<bool>(),
        ) {
            let pull = pulls.then_some(ShearPrior { ratio, sigma });
            let mut finger = finger();
            finger.error = [floor, 0.0];
            for radial in [&mut finger.field.normal, &mut finger.field.shear] {
                radial.terms.as_flattened_mut().iter_mut().for_each(|t| *t *= scale);
                radial.depth[1] *= scale;
            }
            let mut state = InverseState::default();
            for _ in 0..4 {
                for touch in [finger.pressed(&mut state, &u), finger.sheared(&mut state, &u, pull)]
                    .into_iter().flatten()
                {
                    let numbers = touch.force().into_iter().chain(touch.load.point)
                        .chain(touch.sigma).chain([touch.misfit, touch.load.used])
                        .chain([touch.ring.weight, touch.ring.moment]);
                    for number in numbers {
                        prop_assert!(number.is_finite(), "{touch:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn large_contact_shows_friction_utilisation() {
        for used in [0.2, 0.9] {
            let load = Load { shear: [0.9, 0.0], size: 1.2, point: [0.3, -0.2], used };
            let touch = settled(&displaced(&load));
            assert!((touch.load.used - used).abs() < 0.05, "{used}: {touch:?}");
        }
    }

    #[test]
    fn doubtful_displacements_lean_on_the_usual_contact() {
        let load = Load { shear: [0.4, 0.0], size: 1.0, point: [1.5, 0.0], used: 0.5 };
        let found = |error: f32| {
            let (mut finger, mut state) = (finger(), InverseState::default());
            finger.error = [error, 0.0];
            let u = displaced(&load);
            let touch = (0..12).map(|_| finger.sheared(&mut state, &u, None)).last();
            touch.unwrap().unwrap().load
        };
        let (sure, unsure) = (found(1e-4), found(0.1));
        assert!((sure.shear[0] - 0.4).abs() < 0.01, "{sure:?}");
        assert!((0.0..0.3).contains(&unsure.shear[0]), "{unsure:?}");
        assert!((unsure.normal() - 1.0).abs() < 0.1, "what signals tell stays: {unsure:?}");
    }

    #[test]
    fn measured_shear_refines_friction_utilisation_only() {
        let load = Load { shear: [0.3, 0.0], size: 1.0, point: [0.3, -0.2], used: 0.7 };
        let found = |measured| {
            let (finger, mut state) = (finger(), InverseState::default());
            let u = displaced(&load);
            (0..6).map(|_| finger.sheared(&mut state, &u, measured)).last().unwrap().unwrap()
        };
        let (alone, measured) =
            (found(None), found(Some(ShearPrior { ratio: [0.3, 0.0], sigma: 0.003 })));
        assert!(measured.ring.weight > 1.3 * alone.ring.weight, "{measured:?} {alone:?}");
        assert!((measured.ring.moment / measured.ring.weight - 0.7).abs() < 0.05, "{measured:?}");
        assert!(
            (measured.load.shear[0] - alone.load.shear[0]).abs() < 0.01,
            "{measured:?} {alone:?}"
        );
    }

    #[test]
    fn two_contacts_have_a_large_misfit() {
        let one = Load { size: 0.8, point: [-3.0, 0.0], ..Load::default() };
        let two = Load { point: [3.0, 0.5], ..one };
        let mut u = displaced(&one);
        assert!(settled(&u).misfit < 1.0);
        u.iter_mut().zip(displaced(&two)).for_each(|(u, more)| *u += more);
        assert!(settled(&u).misfit > 10.0);
    }

    #[test]
    fn moving_contact_is_tracked_without_lag() {
        let (finger, mut state) = (finger(), InverseState::default());
        for i in 0..200 {
            let t = i as f32 / 200.0;
            let load = Load {
                size: 0.4 + 0.8 * t,
                point: [4.0 * t - 2.0, t],
                used: 0.5,
                shear: [0.1 * t, 0.0],
            };
            let touch = finger.sheared(&mut state, &displaced(&load), None).unwrap();
            if i > 3 {
                assert!((touch.load.point[0] - load.point[0]).abs() < 0.01, "{i}: {touch:?}");
            }
        }
    }

    #[test]
    fn first_of_fast_scans_finds_contact_roughly() {
        for (size, point) in [(0.6, [2.5, -2.5]), (1.2, [-2.5, 0.5])] {
            let load = Load { size, point, ..Load::default() };
            let (finger, mut state) = (finger(), InverseState::default());
            state.wait(250);
            let found = finger.pressed(&mut state, &displaced(&load)).unwrap().load;
            assert!((found.normal() / load.normal() - 1.0).abs() < 0.3, "{found:?} {load:?}");
            for (found, at) in found.point.iter().zip(point) {
                assert!((found - at).abs() < 0.8, "{found} {load:?}");
            }
        }
    }

    #[test]
    fn contact_moved_during_lost_scans_is_found() {
        let at = |x: f32| displaced(&Load { size: 1.0, point: [x, 0.0], ..Load::default() });
        let far_off = |lost: bool| {
            let (finger, mut state) = (finger(), InverseState::default());
            for _ in 0..6 {
                finger.pressed(&mut state, &at(-1.2)).unwrap();
            }
            if lost {
                state.interrupt();
            }
            (finger.pressed(&mut state, &at(1.2)).unwrap().load.point[0] - 1.2).abs()
        };
        assert!(far_off(true) < 0.2, "{}", far_off(true));
        assert!(far_off(false) > 1.0, "one step is a millimetre: {}", far_off(false));
    }

    #[test]
    fn contact_that_jumps_is_found_within_four_scans() {
        let at = |x: f32| displaced(&Load { size: 1.0, point: [x, 0.0], ..Load::default() });
        let (finger, mut state) = (finger(), InverseState::default());
        let mut x = |to: f32| finger.pressed(&mut state, &at(to)).unwrap().load.point[0];
        for _ in 0..6 {
            x(-1.2);
        }
        let off = [1.2; 4].map(|to| (x(to) - to).abs());
        assert!(off[0] > 1.0 && off[3] < 0.05, "a step is a millimetre: {off:?}");
    }

    proptest! {
        #[test]
        fn sheared_contact_that_jumps_is_found(
            from in proptest::array::uniform2(-3.0..3.0f32),
            to in proptest::array::uniform2(-3.0..3.0f32),
            size in proptest::array::uniform2(0.6..1.2f32),
            fx in -0.4..0.4f32, lost in any::<bool>(), hurried in any::<bool>(),
        ) {
            let at = |point, size: f32, fx: f32| {
                Load { size, point, shear: [fx * size.powi(3), 0.0], used: 0.5 }
            };
            let (finger, mut state) = (finger(), InverseState::default());
            let (before, after) = (at(from, size[0], 0.0), at(to, size[1], fx));
            for _ in 0..12 {
                finger.sheared(&mut state, &displaced(&before), None).unwrap();
            }
            if lost {
                state.interrupt();
            }
            state.wait(if hurried { 250 } else { 2000 });
            let u = displaced(&after);
            let touch = (0..40).map(|_| finger.sheared(&mut state, &u, None)).last().unwrap().unwrap();
            for axis in 0..2 {
                let off = touch.load.point[axis] - after.point[axis];
                prop_assert!(off.abs() < 0.05, "{touch:?} {after:?}");
            }
        }
    }

    #[test]
    fn calibration_without_shear_gives_no_shear() {
        let finger = Inverse { shear: false, ..finger() };
        let mut state = InverseState::default();
        assert_eq!(finger.sheared(&mut state, &[0.1; TAXELS], None), Err(NoValue::NotEstimated));
    }

    #[test]
    fn crosstalk_is_subtracted_before_the_curve() {
        let mut curves = finger().curves;
        curves.stray[5] = [0.1, 0.0, 0.0, 0.2];
        let mut c = [0.0; TAXELS];
        (c[4], c[5], c[9]) = (-0.5, -1.0, -0.25);
        let u = curves.displacements(&c);
        assert!((u[5] - (1.0 - 0.05 - 0.05)).abs() < 1e-6, "{}", u[5]);
        assert_eq!(u[6], 0.0);
    }

    #[test]
    fn expected_share_compares_with_the_dent_of_1_n() {
        let at = Centres::default().0[5];
        let dent = displaced(&Load { size: 1.0, point: at, ..Load::default() })[5];
        let share = |field: Field, [floor, more]: [f32; 2]| {
            Inverse { field, error: [floor * dent, more * dent], ..finger() }.expected_share()
        };
        assert!((share(HALF_SPACE, [0.01, 0.04]) - 0.05).abs() < 1e-4);
        assert_eq!(share(HALF_SPACE, [2.0, 1.0]), 1.0, "nothing is left of the force");
        assert_eq!(share(Field::default(), [0.01, 0.04]), 1.0, "a skin that does not yield");
    }

    #[test]
    fn stated_sigma_is_the_scatter_of_noisy_scans() {
        const NOISE: f32 = 2e-4;
        const SCANS: usize = 400;
        let (finger, mut random) = (Inverse { error: [NOISE, 0.0], ..finger() }, 1);
        for size in [0.6, 1.0, 1.3] {
            let load = Load { size, point: [0.7, -0.4], ..Load::default() };
            let u = displaced(&load);
            let (mut scatter, mut stated) = ([0.0; 3], [0.0; 3]);
            for _ in 0..SCANS {
                let noisy = u.map(|u| u + NOISE * noise(&mut random));
                let mut state = InverseState::default();
                let fits = (0..6).map(|_| finger.pressed(&mut state, &noisy).unwrap());
                let ContactFit { load: found, sigma, .. } = fits.last().unwrap();
                let off = [
                    found.normal() - load.normal(),
                    found.point[0] - load.point[0],
                    found.point[1] - load.point[1],
                ];
                for i in 0..3 {
                    scatter[i] += off[i] * off[i] / SCANS as f32;
                    stated[i] += sigma[2 + i] * sigma[2 + i] / SCANS as f32;
                }
            }
            for (scatter, stated) in scatter.iter().zip(stated) {
                let ratio = (stated / scatter).sqrt();
                assert!((0.85..1.25).contains(&ratio), "size {size}: {ratio}");
            }
        }
    }

    #[test]
    fn loads_are_apart_by_what_changed_most() {
        let kept = Load { size: 0.8, shear: [0.02, -0.03], point: [0.5, -0.5], used: 0.5 };
        let [size, place, shear] = REACH;
        let shear = 3.0 * shear * kept.normal();
        for way in [1.0, -1.0] {
            for axis in 0..2 {
                let (mut moved, mut pulled) = (kept, kept);
                moved.point[axis] += way * 3.0 * place;
                pulled.shear[axis] += way * shear;
                let grown = Load { size: (1.0 + way * 3.0 * size) * kept.size, ..kept };
                for (load, change) in [(moved, "place"), (pulled, "shear"), (grown, "force")] {
                    let reaches = load.apart(&kept);
                    assert!((reaches - 3.0).abs() < 1e-3, "{change}, {way}: {reaches}");
                }
            }
        }
        assert_eq!(kept.apart(&kept), 0.0);
    }
}
