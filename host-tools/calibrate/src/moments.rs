//! Contact points and torsions of a recording from the moments of a six-axis load cell.
//!
//! About the middle of the skin, a contact at (x, y, 0) has the moments M_x = y F_z, M_y = −x F_z
//! and M_z = x F_y − y F_x + T.

use std::array;
use std::borrow::Cow;

use nalgebra::{Cholesky, SMatrix, SVector};
use taxel_files::table::Table;
use taxel_regress::align::{self, Alignment};

use crate::recording::Recording;
use crate::skin::guessed;

/// Columns of a six-axis log: forces, and moments about the cell's origin.
pub const WRENCH: [&str; 6] = ["fx_n", "fy_n", "fz_n", "mx_nmm", "my_nmm", "mz_nmm"];

/// Largest standard deviation of a contact point that is a label, mm.
pub const SURE_MM: f64 = 0.3;
/// Time before and after a row in which the contact point is taken to move evenly, seconds.
const AROUND_S: f64 = 0.05;
/// Least time before and after a row, in rows of the log.
const AROUND_ROWS: f64 = 4.0;
/// Least share of the touched rows with a contact point; fewer are no labels for the rest.
const LEAST_SHARE: f64 = 0.2;
/// Half of the pad with a margin for the edge of a contact, mm.
const PAD_MM: f64 = 6.0;
/// Largest distance of the cell's origin from where the signals tell it, mm: sideways, in depth.
///
/// They tell it to 0.1 mm sideways and to 1 mm in depth, if the presses are all over the pad.
const APART_MM: [f64; 2] = [2.0, 3.0];
/// Least slope of the labels over the middle of the signals; good ones have 1 or more.
const LEAST_SLOPE: f64 = 0.3;
/// Least RMS ratio of shear to normal force that shows the depth of the cell's origin.
const SHEARED: f64 = 0.05;

/// Contact points that a recording has from its reference's moments.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// Number of the recording's rows with a contact point; with too few of them none has one.
    pub rows: usize,
    /// Warning about too few rows, the cell's origin or its moments' signs, in a full sentence.
    pub warning: Option<String>,
}

/// Contact point in mm, its standard deviation, and torsion in N·mm.
#[derive(Clone, Copy)]
struct Contact {
    point: [f64; 2],
    sigma: f64,
    torsion: f64,
}

/// Forces, and moments about the middle of the skin.
type Wrench = [f64; 6];

impl Recording {
    /// Takes contact point and torsion from an aligned log with the columns [`WRENCH`].
    ///
    /// `cell_at` is the place of the cell's origin in the finger's axes, mm; z runs into the skin.
    /// Rows whose contact point is not known to [`SURE_MM`] get none. `None` if the recording has
    /// contact points of its own.
    pub fn locate(
        &mut self,
        log: &Table,
        alignment: &Alignment,
        cell_at: [f64; 3],
    ) -> Option<Located> {
        if self.samples.iter().any(|sample| sample.truth.point.iter().any(Option::is_some)) {
            return None;
        }
        let clock = align::told_apart(&log.times).unwrap_or(Cow::Borrowed(&log.times));
        let wrenches: Vec<Wrench> = log.rows.iter().map(|row| moved(row, cell_at)).collect();
        let contacts = contacts(&clock, &wrenches);
        let times = self.samples.iter().map(|s| alignment.time(s.scan.time.0 as f64 * 1e-6));
        let mut places = align::places(&clock, &times.collect::<Vec<_>>());
        let touched = self.touched().unwrap_or_default();
        places.iter_mut().zip(&touched).for_each(|(place, touched)| {
            *place = place.filter(|_| *touched);
        });
        let found = places.iter().map(|place| {
            let (before, share) = (*place)?;
            let a = contacts.get(before).copied().flatten()?;
            if share == 0.0 {
                return Some(a);
            }
            let b = contacts.get(before + 1).copied().flatten()?;
            let between = |a: f64, b: f64| a + share * (b - a);
            Some(Contact {
                point: array::from_fn(|k| between(a.point[k], b.point[k])),
                sigma: between(a.sigma, b.sigma),
                torsion: between(a.torsion, b.torsion),
            })
        });
        let found: Vec<Option<Contact>> = found.collect();
        let nearest = places.iter().enumerate().filter_map(|(row, place)| {
            let (before, share) = (*place)?;
            Some((row, *wrenches.get(before + usize::from(share > 0.5))?))
        });
        let warning = self.origin_warning(&nearest.collect::<Vec<_>>(), cell_at);
        let rows = found.iter().flatten().count();
        let loaded = touched.iter().filter(|touched| **touched).count();
        if (rows as f64) < LEAST_SHARE * loaded as f64 || rows == 0 {
            let few = format!(
                "{}: the moments tell the contact point to {SURE_MM} mm in {rows} of {loaded} touched rows only, and \
                 are not used",
                self.name
            );
            let warning = warning.map_or(few.clone(), |why| format!("{few}; {why}"));
            return Some(Located { rows: 0, warning: Some(warning) });
        }
        for (sample, contact) in self.samples.iter_mut().zip(found) {
            if let Some(Contact { point, sigma, torsion }) = contact {
                sample.truth.point = point.map(Some);
                sample.truth.point_sigma = Some(sigma);
                sample.truth.torsion = Some(torsion);
            }
        }
        let warning = warning.map(|why| format!("{}: {why}", self.name));
        Some(Located { rows, warning })
    }

    /// Warns of contact points off the pad, or far from where the taxels answer.
    fn origin_warning(&self, wrenches: &[(usize, Wrench)], cell_at: [f64; 3]) -> Option<String> {
        let signals = self.bias(None).map(|bias| self.signals(&bias, None)).unwrap_or_default();
        let guess = |row: usize| Some(guessed(signals.get(row)?.taxels.as_ref()?));
        let axes = [0, 1].map(|k| {
            Offset::find(wrenches.iter().filter_map(|(row, wrench)| {
                Some((arms(wrench)[k], guess(*row)?[k], [wrench[k], wrench[2]]))
            }))
        });
        if let [Some(x), Some(y)] = &axes {
            let wrong: Vec<&str> = [(y, "mx_nmm"), (x, "my_nmm")]
                .into_iter()
                .filter_map(|(axis, moment)| (axis.slope < LEAST_SLOPE).then_some(moment))
                .collect();
            if !wrong.is_empty() {
                let opposite = [x, y].iter().all(|axis| axis.slope.abs() >= LEAST_SLOPE);
                let cause = if opposite {
                    "its sign is wrong"
                } else {
                    "mx_nmm and my_nmm are exchanged, or not in N·mm"
                };
                return Some(format!(
                    "contact points from the moments do not follow the taxels that answer, by {}: probably {cause}",
                    wrong.join(" and ")
                ));
            }
            let depths: Vec<f64> = [x.depth, y.depth].into_iter().flatten().collect();
            let depth = depths.iter().sum::<f64>() / depths.len().max(1) as f64;
            let [aside, below] = APART_MM;
            if x.aside.abs().max(y.aside.abs()) > aside || depth.abs() > below {
                let fits = [cell_at[0] - x.aside, cell_at[1] - y.aside, cell_at[2] + depth];
                let [fx, fy, fz] = fits.map(|mm| format!("{:.0}", mm.round() + 0.0));
                let far = x.aside.hypot(y.aside).max(depth.abs());
                return Some(format!(
                    "contact points from the moments lie as if the cell's origin stood {far:.0} mm elsewhere; \
                     --cell-at {fx},{fy},{fz} would fit: look where it stands"
                ));
            }
        }
        let squares = |off_pad: bool| -> f64 {
            let of = |(_, wrench): &(usize, Wrench)| {
                let far = arms(wrench).iter().any(|arm| arm.abs() > PAD_MM * wrench[2].abs());
                if far || !off_pad { wrench[2].powi(2) } else { 0.0 }
            };
            wrenches.iter().map(of).sum()
        };
        (squares(true) > 0.5 * squares(false)).then(|| {
            "most contact points from the moments lie off the pad: look whether --cell-at is given, in mm, and at the \
             signs of the moments"
                .to_owned()
        })
    }
}

/// Moments by which a contact's x and y stand out: F_z times each of them.
fn arms([.., mx, my, _]: &Wrench) -> [f64; 2] {
    [-my, *mx]
}

/// Wrench about the middle of the skin from one about the cell's origin: M + r₀ × F.
fn moved(row: &[f64], [rx, ry, rz]: [f64; 3]) -> Wrench {
    let [fx, fy, fz, mx, my, mz] = array::from_fn(|k| row.get(k).copied().unwrap_or_default());
    [fx, fy, fz, mx + ry * fz - rz * fy, my + rz * fx - rx * fz, mz + rx * fy - ry * fx]
}

/// Contact of each row, where the rows around it tell its point surely.
///
/// The point moves evenly within those rows. A weighted straight line gives it in the middle one,
/// and the residuals give its standard deviation, which grows where the force is small, the moments
/// are noisy, or two presses come together.
fn contacts(times: &[f64], wrenches: &[Wrench]) -> Vec<Option<Contact>> {
    let around = AROUND_S.max(AROUND_ROWS * align::median_step(times)) * (1.0 + 1e-6);
    let (mut from, mut to) = (0, 0);
    let contact = |(row, now): (usize, &f64)| {
        while now - times[from] > around {
            from += 1;
        }
        while times.get(to).is_some_and(|next| next - now <= around) {
            to += 1;
        }
        let rows = || {
            let of = |(wrench, t): (&Wrench, &f64)| (wrench[2], t - now, arms(wrench));
            wrenches[from..to].iter().zip(&times[from..to]).map(of)
        };
        let (mut left, mut right) = ([0.0; 3], [[0.0; 2]; 2]);
        for (force, t, arms) in rows() {
            let own = force * force;
            left = [left[0] + own, left[1] + own * t, left[2] + own * t * t];
            for (right, arm) in right.iter_mut().zip(arms) {
                *right = [right[0] + force * arm, right[1] + force * t * arm];
            }
        }
        let [s0, s1, s2] = left;
        let det = s0 * s2 - s1 * s1;
        let freedom = 2.0 * (to - from) as f64 - 4.0;
        if det <= 1e-9 * s0 * s2 || freedom <= 0.0 {
            return None;
        }
        let lines = right.map(|[r0, r1]| [(s2 * r0 - s1 * r1) / det, (s0 * r1 - s1 * r0) / det]);
        let off = |(force, t, arms): (f64, f64, [f64; 2])| -> f64 {
            let each = lines.iter().zip(arms);
            each.map(|([at, way], arm)| (arm - force * (at + way * t)).powi(2)).sum()
        };
        let variance = rows().map(off).sum::<f64>() / freedom * s2 / det;
        let ([[x, _], [y, _]], [fx, fy, .., mz]) = (lines, wrenches[row]);
        let sigma = variance.sqrt();
        (sigma < SURE_MM).then_some(Contact {
            point: [x, y],
            sigma,
            torsion: mz - (x * fy - y * fx),
        })
    };
    times.iter().enumerate().map(contact).collect()
}

/// Labels of one axis over the middle of the signals.
struct Offset {
    /// Change of the label by that of the middle.
    slope: f64,
    /// Distance of the labels sideways, mm.
    aside: f64,
    /// Distance of the labels by ratio of shear to normal force, mm: the cell's origin is deeper
    /// by as much. `None` without shear.
    depth: Option<f64>,
}

impl Offset {
    /// Fits F_z·(aside + slope·guess) + depth·shear to rows of moment, guess, shear and F_z.
    ///
    /// `None` if they do not determine it.
    fn find(rows: impl Iterator<Item = (f64, f64, [f64; 2])> + Clone) -> Option<Self> {
        let squares = |k: usize| rows.clone().map(|row| row.2[k].powi(2)).sum::<f64>();
        let sheared = squares(0).sqrt() > SHEARED * squares(1).sqrt();
        let (mut matrix, mut right) = (SMatrix::<f64, 3, 3>::zeros(), SVector::<f64, 3>::zeros());
        for (moment, guess, [shear, force]) in rows.clone() {
            let shear = if sheared { shear } else { 0.0 };
            let features = SVector::from([force, force * guess, shear]);
            matrix.ger(1.0, &features, &features, 1.0);
            right.axpy(moment, &features, 1.0);
        }
        if !sheared {
            matrix[(2, 2)] = 1.0;
        }
        let found = Cholesky::new(matrix)?.solve(&right);
        let found = [found[0], found[1], found[2]];
        let [aside, slope, depth] = found;
        found.iter().all(|value| value.is_finite()).then_some(Self {
            slope,
            aside,
            depth: sheared.then_some(depth),
        })
    }
}
