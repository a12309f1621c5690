//! Choice between model of the skin and net, and whether a few force sensors help them, with the
//! lines that state it.

use taxel::calibration::Calibration;
use taxel::finger::Finger;

use crate::evaluate;
use crate::prepared::Prepared;
use crate::recording::Recording;

/// Ratio of the net's error in f_z to the model's from which the model is kept for its f_z alone.
const TWICE: f64 = 2.0;

/// Errors of the force with some of the four force sensors, and without them.
pub(super) struct Helped {
    with: [f64; 3],
    without: [f64; 3],
}

impl Helped {
    /// Runs the finger over the recordings with the record and without its force sensors.
    ///
    /// A few sensors have a few numbers, so that errors on the rows of the fit are near to those on
    /// others.
    pub fn of(calibration: &Calibration, recordings: &[&Prepared<'_>]) -> Self {
        let run = |calibration: &Calibration| {
            let each = recordings.iter().map(|r| squares(calibration, &r.recording));
            let ([x, y, z], rows) = each.fold(([0.0; 3], 0.0), |(sum, count), (own, rows)| {
                (std::array::from_fn(|k| sum[k] + own[k]), count + rows)
            });
            [x, y, z].map(|sum: f64| (sum / f64::max(rows, 1.0)).sqrt())
        };
        let without = Calibration { array: None, ..calibration.clone() };
        Self { with: run(calibration), without: run(&without) }
    }

    /// Whether the force is better with them.
    pub fn keeps(&self) -> bool {
        let of = |errors: &[f64]| errors.iter().map(|e| e * e).sum::<f64>();
        of(&self.with) < of(&self.without)
    }

    /// Line that says whether the finger runs them.
    pub fn told(&self) -> String {
        let (with, without) = (all(&self.with), all(&self.without));
        match self.keeps() {
            true => {
                format!("force: matrix and force sensors ({with}) over matrix alone ({without})")
            }
            false => format!(
                "force: matrix alone ({without}) over matrix and force sensors ({with}), which do not see the whole force"
            ),
        }
    }
}

/// Squared errors of the finger's force in the touched rows of a recording, and their number.
fn squares(calibration: &Calibration, recording: &Recording) -> ([f64; 3], f64) {
    let (finger, mut state) = Finger::new(Some(calibration.clone()));
    let touched = recording.touched().unwrap_or_default();
    let (mut sum, mut rows) = ([0.0; 3], 0.0);
    for (sample, touched) in recording.samples.iter().zip(touched) {
        let force = finger.estimate(&mut state, &sample.scan).force;
        let [Some(x), Some(y), Some(z)] = sample.truth.force else { continue };
        if !touched {
            continue;
        }
        let size = || x * x + y * y + z * z;
        let found = evaluate::components(&force).into_iter().zip([x, y, z]);
        for (sum, (found, known)) in sum.iter_mut().zip(found) {
            *sum += evaluate::square(found.ok().map(f64::from), known, size);
        }
        rows += 1.0;
    }
    (sum, rows)
}

/// Errors in millinewtons.
fn all(errors: &[f64]) -> String {
    let each: Vec<String> = errors.iter().map(|e| format!("{:.1}", 1e3 * e)).collect();
    format!("{} mN", each.join(" "))
}

/// RMS errors of model and net.
pub(super) struct Judged {
    /// Errors of the model in the net's components, newtons.
    pub skin: Vec<f64>,
    /// Errors of the net in f_x, f_y, f_z or in f_z alone, newtons.
    pub net: Vec<f64>,
    /// Whether the model's errors are on presses left out; otherwise those of its fit.
    pub held_out: bool,
    /// Distances from the labelled place, of the model and of the centroid, mm; `None` without
    /// labels.
    pub place: Option<[f64; 2]>,
}

impl Judged {
    /// Whether the record keeps the model. The finger then takes force and place from it.
    ///
    /// A place below the pitch of the taxels is never dropped for the sake of the force, nor a
    /// normal force that is twice as good for the sake of the shear.
    pub fn keeps_skin(&self) -> bool {
        !self.is_worse() || self.is_placed() || self.is_firm()
    }

    /// Lines that say what the finger runs, over what, by which errors.
    pub fn told(&self) -> Vec<String> {
        let (skin, net) = (all(&self.skin), all(&self.net));
        let (kept, left_out) = (self.keeps_skin(), self.left_out());
        let force = match (self.is_worse(), kept) {
            (false, _) => format!("model of the skin ({skin}) over net ({net}), {left_out}"),
            (true, true) => {
                let why = if self.is_firm() { "F_z" } else { "contact point" };
                format!("model of the skin ({skin}), kept for its {why}; net {net}, {left_out}")
            }
            (true, false) => format!("net ({net}) over model of the skin ({skin}), {left_out}"),
        };
        let place = self.place.map(|place| {
            let [own, centroid] = place.map(|mm| format!("{mm:.3} mm"));
            match (self.is_placed(), kept) {
                (true, _) => {
                    format!("model of the skin ({own}) over centroid ({centroid}), {left_out}")
                }
                (false, true) => format!(
                    "model of the skin ({own}), kept for its force; centroid {centroid}, {left_out}"
                ),
                (false, false) => {
                    format!("centroid ({centroid}) over model of the skin ({own}), {left_out}")
                }
            }
        });
        let unjudged = || match kept {
            true => "model of the skin, not judged: no recording has x_mm, y_mm".to_owned(),
            false => "centroid, because the model of the skin is left out".to_owned(),
        };
        let place = place.unwrap_or_else(unjudged);
        vec![format!("force from the matrix: {force}"), format!("contact point: {place}")]
    }

    /// Rows that the errors are of.
    pub fn left_out(&self) -> &'static str {
        match self.held_out {
            true => "on presses left out",
            false => "on those of the fit, too few to leave any out",
        }
    }

    fn is_worse(&self) -> bool {
        let of = |errors: &[f64]| errors.iter().map(|e| e * e).sum::<f64>();
        of(&self.skin) >= of(&self.net)
    }

    fn is_placed(&self) -> bool {
        self.place.is_some_and(|[own, centroid]| own <= centroid)
    }

    fn is_firm(&self) -> bool {
        let [skin, net] = [&self.skin, &self.net].map(|errors| errors.last().copied());
        skin.zip(net).is_some_and(|(skin, net)| TWICE * skin < net)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(skin: [f64; 3], net: [f64; 3], place: Option<[f64; 2]>) -> (bool, String) {
        let milli = |errors: [f64; 3]| errors.map(|e| 1e-3 * e).to_vec();
        let judged = Judged { skin: milli(skin), net: milli(net), held_out: true, place };
        (judged.keeps_skin(), judged.told().join("\n"))
    }

    #[test]
    fn few_force_sensors_are_kept_if_they_help() {
        let of = |with, without| {
            let helped = Helped { with, without };
            (helped.keeps(), helped.told())
        };
        let (kept, told) = of([0.01, 0.01, 0.02], [0.03, 0.03, 0.01]);
        assert!(kept && told.contains("force sensors (10.0 10.0 20.0 mN) over"), "{told}");
        let (kept, told) = of([0.09, 0.09, 0.02], [0.015, 0.015, 0.01]);
        assert!(!kept && told.contains("matrix alone (15.0 15.0 10.0 mN) over"), "{told}");
    }

    #[test]
    fn choice_on_presses_of_the_fit_says_so() {
        let judged =
            Judged { skin: vec![0.01], net: vec![0.02], held_out: false, place: Some([0.1, 0.2]) };
        let lines = judged.told();
        let told = |line: &String| line.ends_with("on those of the fit, too few to leave any out");
        assert!(lines.iter().all(told), "{lines:?}");
    }

    #[test]
    fn choice_says_what_the_finger_runs() {
        let (bad, good) = ([190.0, 190.0, 63.0], [140.0, 140.0, 58.0]);
        let (firm, left_out) = ([190.0, 190.0, 20.0], "on presses left out");
        let [bad_mn, good_mn, firm_mn] =
            ["190.0 190.0 63.0 mN", "140.0 140.0 58.0 mN", "190.0 190.0 20.0 mN"];
        for (skin, net, place, kept, force, point) in [
            (
                good,
                bad,
                Some([0.6, 0.5]),
                true,
                format!("model of the skin ({good_mn}) over net ({bad_mn}), {left_out}"),
                format!(
                    "model of the skin (0.600 mm), kept for its force; centroid 0.500 mm, {left_out}"
                ),
            ),
            (
                bad,
                good,
                Some([0.1, 0.5]),
                true,
                format!(
                    "model of the skin ({bad_mn}), kept for its contact point; net {good_mn}, {left_out}"
                ),
                format!("model of the skin (0.100 mm) over centroid (0.500 mm), {left_out}"),
            ),
            (
                firm,
                good,
                None,
                true,
                format!(
                    "model of the skin ({firm_mn}), kept for its F_z; net {good_mn}, {left_out}"
                ),
                "model of the skin, not judged: no recording has x_mm, y_mm".to_owned(),
            ),
            (
                bad,
                good,
                None,
                false,
                format!("net ({good_mn}) over model of the skin ({bad_mn}), {left_out}"),
                "centroid, because the model of the skin is left out".to_owned(),
            ),
        ] {
            let lines = format!("force from the matrix: {force}\ncontact point: {point}");
            assert_eq!(told(skin, net, place), (kept, lines));
        }
    }
}
