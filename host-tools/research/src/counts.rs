//! Tallies of a failure map: judged, flagged and failed values at each value of a sweep.

/// Error over claimed accuracy beyond which a value is a failure.
pub(crate) const FAILS: f64 = 3.0;
/// Largest share of failing frames, flagged or not, up to which a method is trusted.
pub(crate) const TRUSTED: f64 = 0.01;

/// Tally of one method at one value of a sweep.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Count {
    pub frames: usize,
    pub flagged: usize,
    /// Values beyond [`FAILS`] times the claimed accuracy, flagged or not; a missing value never
    /// counts.
    pub failed: usize,
    /// Values that failed without a flag: undetected errors.
    pub silent: usize,
    squares: f64,
    valued: usize,
    stated: f64,
}

impl Count {
    pub(crate) fn add(&mut self, error: Option<f64>, stated: f64, warned: bool) {
        let flagged = warned || error.is_none();
        let fails = error.is_some_and(|error| error > FAILS * stated);
        self.frames += 1;
        self.flagged += usize::from(flagged);
        self.failed += usize::from(fails);
        self.silent += usize::from(fails && !flagged);
        self.stated += stated;
        if let Some(error) = error {
            self.squares += error * error;
            self.valued += 1;
        }
    }

    pub(crate) fn merge(&mut self, other: &Self) {
        self.frames += other.frames;
        self.flagged += other.flagged;
        self.failed += other.failed;
        self.silent += other.silent;
        self.squares += other.squares;
        self.valued += other.valued;
        self.stated += other.stated;
    }

    /// Returns the RMS error of the values that were given.
    pub(crate) fn error(&self) -> Option<f64> {
        (self.valued > 0).then(|| (self.squares / self.valued as f64).sqrt())
    }

    pub(crate) fn stated(&self) -> f64 {
        self.stated / self.frames.max(1) as f64
    }

    pub(crate) fn share(&self, of: usize) -> f64 {
        of as f64 / self.frames.max(1) as f64
    }
}

/// Part of the finger that a method uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Of {
    /// Matrix and force sensors together.
    Finger,
    /// The optical matrix alone.
    Matrix,
}

/// Failure map of one method over one sweep.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    pub(crate) of: Of,
    pub(crate) method: &'static str,
    pub(crate) sweep: &'static str,
    pub(crate) points: Vec<Point>,
}

impl Map {
    /// Returns the last trusted value, from the harmless end of the sweep on.
    #[must_use]
    pub fn boundary(&self) -> Option<f64> {
        let trusted = |point: &&Point| point.count.share(point.count.failed) <= TRUSTED;
        self.points.iter().take_while(trusted).last().map(|point| point.value)
    }
}

/// Tallies at one value of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Point {
    pub value: f64,
    /// True where the value lies in the working range.
    pub within: bool,
    pub count: Count,
    /// Tally in the working range; empty where the value lies outside.
    pub working: Count,
}

impl Point {
    /// Returns whether most of the values are flagged or missing.
    pub(crate) fn flagged(&self) -> bool {
        self.count.share(self.count.flagged) > 0.5
    }
}

/// Sums the tallies of some points: of all frames, and of those in the working range.
pub(crate) fn sums<'m>(points: impl IntoIterator<Item = &'m Point>) -> [Count; 2] {
    let [mut all, mut within] = [Count::default(); 2];
    for point in points {
        all.merge(&point.count);
        within.merge(&point.working);
    }
    [all, within]
}
