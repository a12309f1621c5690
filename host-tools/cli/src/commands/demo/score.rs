//! Errors of frames against the truth.

use std::collections::BTreeMap;

use serde::Serialize;
use taxel::frame::Frame;
use taxel_files::trace::Truth;

/// Compared quantities, by their column names.
const TARGETS: [&str; 5] = ["fx_n", "fy_n", "fz_n", "x_mm", "y_mm"];

/// Squared errors so far.
#[derive(Default)]
pub struct Score {
    squares: [f64; TARGETS.len()],
    compared: [u64; TARGETS.len()],
}

/// Accuracy of the frames. Only frames in true contact count, because an unloaded finger is easily
/// right.
#[derive(Serialize)]
pub struct Accuracy {
    /// Root mean square error; `None` if no value could be compared.
    pub rmse: BTreeMap<&'static str, Option<f64>>,
    /// Number of frames in which truth and estimate are both known.
    pub compared: BTreeMap<&'static str, u64>,
}

impl Score {
    /// Compares one frame.
    pub fn add(&mut self, frame: &Frame, truth: &Truth) {
        if truth.contact == Some(false) {
            return;
        }
        let force = frame.force.map(|force| [force.x, force.y, force.z]);
        let point = frame.point.and_then(Result::ok);
        let force = |axis: usize| Some(f64::from(force?.get(axis)?.ok()?.0));
        let said = [
            force(0),
            force(1),
            force(2),
            point.map(|point| f64::from(point.x.0)),
            point.map(|point| f64::from(point.y.0)),
        ];
        let happened = truth.force.iter().chain(&truth.point);
        for (k, (said, happened)) in said.into_iter().zip(happened).enumerate() {
            if let (Some(said), Some(happened)) = (said, *happened) {
                self.squares[k] += (said - happened) * (said - happened);
                self.compared[k] += 1;
            }
        }
    }

    /// Returns the accuracy over all frames so far.
    pub fn accuracy(&self) -> Accuracy {
        let rmse = |k: usize| {
            (self.compared[k] > 0).then(|| (self.squares[k] / self.compared[k] as f64).sqrt())
        };
        let names = || TARGETS.iter().enumerate();
        Accuracy {
            rmse: names().map(|(k, name)| (*name, rmse(k))).collect(),
            compared: names().map(|(k, name)| (*name, self.compared[k])).collect(),
        }
    }
}

impl Accuracy {
    /// Lists target, error and number of compared frames.
    pub fn rows(&self) -> impl Iterator<Item = (&'static str, Option<f64>, u64)> + '_ {
        self.rmse.iter().zip(self.compared.values()).map(|((name, rmse), n)| (*name, *rmse, *n))
    }
}

#[cfg(test)]
mod tests {
    use taxel::estimate::{ContactPoint, Force};
    use taxel::measured::NoValue;
    use taxel::units::{Millimetres, Newtons};

    use super::*;

    fn frame(z: f32) -> Frame {
        Frame {
            force: Some(Force { z: Ok(Newtons(z)), ..Force::none(NoValue::NotEstimated) }),
            point: Some(Ok(ContactPoint { x: Millimetres(1.0), y: Millimetres(2.0) })),
            ..Frame::default()
        }
    }

    #[test]
    fn rmse_counts_only_values_known_to_both() {
        let truth = Truth {
            force: [Some(9.0), None, Some(1.0)],
            point: [Some(1.5), None],
            ..Truth::default()
        };
        let mut score = Score::default();
        score.add(&frame(4.0), &truth);
        score.add(&frame(-3.0), &truth);
        let accuracy = score.accuracy();
        assert_eq!(accuracy.rmse["fz_n"], Some((25.0f64 / 2.0).sqrt()));
        assert_eq!(accuracy.rmse["x_mm"], Some(0.5));
        assert_eq!(accuracy.rmse["fx_n"], None);
        assert_eq!(accuracy.compared["fz_n"], 2);
        assert_eq!(accuracy.compared["y_mm"], 0);
    }

    #[test]
    fn frames_without_contact_are_not_scored() {
        let truth = Truth { force: [Some(0.0); 3], contact: Some(false), ..Truth::default() };
        let mut score = Score::default();
        score.add(&frame(0.0), &truth);
        assert_eq!(score.accuracy().compared["fz_n"], 0);
    }
}
