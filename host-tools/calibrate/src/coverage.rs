//! Loads that a finger's recordings cover, and those to record next.

use std::fmt::{self, Display, Formatter};

use serde::Serialize;
use taxel::scan::{COLS, ROWS, TAXEL_CENTRES, TAXELS};

use crate::recording::Recording;
use crate::skin::guessed;

/// Names of the directions of shear, an eighth of the circle each.
const TOWARDS: [&str; 8] = ["+x", "+x+y", "+y", "-x+y", "-x", "-x-y", "-y", "+x-y"];
/// Time over which a change of the load is measured, seconds.
const OVER: f64 = 0.05;
/// Changes of F_z between held and slow, and between slow and fast, N/s.
const CHANGES: [f64; 2] = [0.5, 10.0];
/// Least share of the largest load anywhere that covers a taxel or a direction.
const COVERED: f64 = 0.3;
/// Least share of the loaded time that each kind of change should have.
const LEAST_TIME: f64 = 0.03;
/// Least shear that counts, as a share of the largest normal force.
const SHEARED: f64 = 0.05;

/// Loads of the recordings.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Coverage {
    /// Largest F_z nearest to each taxel, newtons.
    pub normal_n: [[f64; COLS]; ROWS],
    /// Whether some places are guessed from the codes, which draws them to the middle.
    pub guessed: bool,
    /// Largest shear in each direction, newtons: +x, +x+y, +y, …
    pub shear_n: [f64; 8],
    /// Share of the loaded time in which F_z is held, changes slowly, changes fast.
    pub changes: [f64; 3],
    /// Advice on what to record next.
    pub next: Vec<String>,
}

impl Coverage {
    /// Counts the loads of recordings with a reference; `None` without any.
    #[must_use]
    pub fn of(recordings: &[Recording]) -> Option<Self> {
        let mut found = Self::default();
        let mut rows = [0u32; 3];
        for recording in recordings {
            found.add(recording, &mut rows);
        }
        let all: u32 = rows.iter().sum();
        if all == 0 {
            return None;
        }
        found.changes = rows.map(|rows| f64::from(rows) / f64::from(all));
        found.next = found.advice();
        Some(found)
    }

    fn add(&mut self, recording: &Recording, rows: &mut [u32; 3]) {
        let Some(touched) = recording.touched() else { return };
        let signals = recording.bias(None).map(|bias| recording.signals(&bias, None));
        let signals = signals.unwrap_or_default();
        let mut back = 0;
        for (i, sample) in recording.samples.iter().enumerate() {
            let seconds = |i: usize| recording.samples[i].scan.time.0 as f64 * 1e-6;
            while seconds(i) - seconds(back) > OVER {
                back += 1;
            }
            let ([fx, fy, Some(fz)], true) = (sample.truth.force, touched[i]) else { continue };
            let place = match sample.truth.point {
                [Some(x), Some(y)] => Some([x, y]),
                _ => {
                    let guess = signals.get(i).and_then(|s| s.taxels).map(|c| guessed(&c));
                    self.guessed |= guess.is_some();
                    guess
                }
            };
            if let Some(place) = place {
                let k = nearest(place);
                let most = &mut self.normal_n[k / COLS][k % COLS];
                *most = most.max(fz);
            }
            if let (Some(fx), Some(fy)) = (fx, fy) {
                let eighths = fy.atan2(fx) / std::f64::consts::FRAC_PI_4;
                let most = &mut self.shear_n[(eighths.round() as i32).rem_euclid(8) as usize];
                *most = most.max(fx.hypot(fy));
            }
            let former = recording.samples[back].truth.force[2].unwrap_or(fz);
            let change = (fz - former).abs() / (seconds(i) - seconds(back)).max(OVER / 2.0);
            rows[CHANGES.iter().filter(|least| change > **least).count()] += 1;
        }
    }

    /// Largest F_z anywhere.
    fn most(&self) -> f64 {
        self.normal_n.as_flattened().iter().copied().fold(0.0, f64::max)
    }

    fn advice(&self) -> Vec<String> {
        let (most, mut next) = (self.most(), Vec::new());
        let bare: Vec<String> = (0..TAXELS)
            .filter(|k| self.normal_n[k / COLS][k % COLS] < COVERED * most)
            .map(|k| format!("r{}c{}", k / COLS, k % COLS))
            .collect();
        if most > 0.0 && !self.guessed && !bare.is_empty() {
            next.push(format!("press {}, up to {most:.1} N", bare.join(", ")));
        }
        let shear = self.shear_n.iter().copied().fold(0.0, f64::max);
        if shear < SHEARED * most {
            next.push("push sideways in every direction while pressing: there is no shear".into());
        } else {
            let towards = TOWARDS.iter().zip(self.shear_n);
            let bare: Vec<&str> =
                towards.filter(|(_, n)| *n < COVERED * shear).map(|(t, _)| *t).collect();
            if !bare.is_empty() {
                next.push(format!("push towards {}, up to {shear:.1} N", bare.join(", ")));
            }
        }
        let [held, _, fast] = self.changes;
        if held < LEAST_TIME {
            next.push("hold some presses for half a second".into());
        }
        if fast < LEAST_TIME {
            next.push("press some times as fast as in use".into());
        }
        next
    }
}

/// Index of the taxel nearest to a place in mm.
pub(crate) fn nearest(place: [f64; 2]) -> usize {
    let distance = |k: usize| {
        let [x, y] = TAXEL_CENTRES[k].map(|c| f64::from(c.0));
        (place[0] - x).hypot(place[1] - y)
    };
    (0..TAXELS).min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap_or(0)
}

impl Display for Coverage {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        if self.most() > 0.0 {
            let places = if self.guessed {
                "; places estimated from the codes, drawn to the middle"
            } else {
                ""
            };
            writeln!(f, "coverage: largest F_z nearest to each taxel, N (r0 to r3 down{places})")?;
            for row in &self.normal_n {
                let cells: Vec<String> = row.iter().map(|n| format!("{n:6.2}")).collect();
                writeln!(f, "  {}", cells.join(" "))?;
            }
        }
        let shear: Vec<String> =
            TOWARDS.iter().zip(self.shear_n).map(|(t, n)| format!("{t} {n:.2}")).collect();
        writeln!(f, "coverage: largest shear towards, N: {}", shear.join(", "))?;
        let [held, slow, fast] = self.changes.map(|share| 100.0 * share);
        let [least, most] = CHANGES;
        write!(
            f,
            "coverage: F_z held {held:.0} % of the loaded time, slow {slow:.0} %, fast {fast:.0} % \
             (below {least} N/s, between, above {most} N/s)"
        )?;
        match &self.next[..] {
            [] if self.guessed => write!(
                f,
                "\nrecord next: nothing else, if the presses were all over the pad, edges included"
            ),
            [] => write!(f, "\nrecord next: nothing; the loads are covered"),
            next => next.iter().try_for_each(|next| write!(f, "\nrecord next: {next}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taxel::scan::TaxelCodes;
    use taxel::units::Code;
    use taxel_files::trace::Truth;

    use crate::recording::bare_sample;

    /// Presses at each place for half a second, sheared as given.
    fn presses(places: &[[f64; 2]], shear: [f64; 2]) -> Recording {
        let row = |i: usize| {
            let force = if i % 100 < 50 { 0.0 } else { 1.0 };
            let truth = Truth {
                force: [Some(force * shear[0]), Some(force * shear[1]), Some(force)],
                point: places[i / 100].map(Some),
                contact: Some(force > 0.0),
                ..Truth::default()
            };
            bare_sample(10_000 * i as u64, truth)
        };
        Recording { name: "a".into(), samples: (0..100 * places.len()).map(row).collect() }
    }

    #[test]
    fn advice_names_bare_taxels_and_directions() {
        let of = |places: &[[f64; 2]], shear| Coverage::of(&[presses(places, shear)]).unwrap();
        let centres: Vec<[f64; 2]> =
            TAXEL_CENTRES.iter().map(|c| c.map(|c| f64::from(c.0))).collect();
        let found = of(&centres[..15], [0.0, 0.0]);
        assert_eq!(found.normal_n[0][0], 1.0);
        assert_eq!(
            found.next,
            [
                "press r3c3, up to 1.0 N",
                "push sideways in every direction while pressing: there is no shear"
            ]
        );
        let found = of(&centres, [0.5, 0.0]);
        assert_eq!(found.shear_n[0], 0.5);
        let [next] = &found.next[..] else { panic!("{:?}", found.next) };
        assert_eq!(next, "push towards +x+y, +y, -x+y, -x, -x-y, -y, +x-y, up to 0.5 N");
        assert!(found.to_string().contains("towards, N: +x 0.50, +x+y 0.00"), "{found}");
        assert!(found.changes[0] > 0.5 && found.changes[2] > 0.05, "{:?}", found.changes);
    }

    /// The codes of unpressed taxels, whose middle is the middle of the pad.
    #[test]
    fn guessed_places_give_no_advice_on_taxels() {
        let mut recording = presses(&[[3.0; 2]; 16], [0.0; 2]);
        for sample in &mut recording.samples {
            sample.truth.point = [None; 2];
            let taxels =
                TaxelCodes { lit: [[Code(20_000); COLS]; ROWS], dark: [Code(3_000); COLS] };
            sample.scan.codes.taxels = Some(taxels);
        }
        let found = Coverage::of(&[recording]).unwrap();
        assert!(found.guessed && found.most() == 1.0, "{found:?}");
        assert!(!found.next.iter().any(|next| next.starts_with("press r")), "{:?}", found.next);
        assert!(found.to_string().contains("estimated from the codes, drawn to the middle"));
        assert!(!Coverage::of(&[presses(&[[3.0; 2]; 16], [0.0; 2])]).unwrap().guessed);
    }

    #[test]
    fn recordings_without_reference_have_no_coverage() {
        let mut recording = presses(&[[0.0; 2]], [0.0; 2]);
        recording.samples.iter_mut().for_each(|sample| sample.truth = Truth::default());
        assert_eq!(Coverage::of(&[recording]), None);
        assert_eq!(Coverage::of(&[]), None);
    }
}
