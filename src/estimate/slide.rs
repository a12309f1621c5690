//! Detection of gross slip by displacement.
//!
//! A sliding contact moves along its shear while the ratio of shear to normal force stays constant.
//!
//! Rolling also moves the contact, but friction does not hold the ratio then. A contact that is
//! rolled along under a steady shear is mistaken for gross slip.

use super::slip::Traction;
use crate::math::{at_least, sqrt};
use crate::units::Micros;

/// Least displacement of gross slip in mm: ten times the scatter of a smoothed contact point.
const DISPLACEMENT: f32 = 0.35;
/// Share of a look's contact point in the smoothed one, because that of a light contact sways under
/// lamps, a hundred times a second.
const NEW: f32 = 0.2;
/// Standard deviation of a contact point, in mm, beyond which it takes a longer displacement, and
/// how many times the rest.
const SURE: f32 = 0.15;
const SWAYS: f32 = 3.0;
/// Shortest time between two scans that are looked at.
const SAMPLE_US: u32 = 900;
/// Longest time for that displacement; gross slip ends if the next one takes longer.
const WITHIN_US: u32 = 300_000;
/// Largest relative change of shear during gross slip, plus a multiple of its standard deviation.
const STEADY: f32 = 0.05;
const NOISE: f32 = 4.0;
/// Least cosine of the angle between displacement and shear.
const ALONG: f32 = 0.97;
/// Least cosine at which noise of the contact position may hide gross slip: a longer displacement
/// shows the angle more exactly.
const NEARLY_ALONG: f32 = 0.86;
/// Least ratio of shear to normal force during gross slip.
const LEAST_RATIO: f32 = 0.04;
/// Least normal force and shear, in newtons, for a known ratio and contact position.
const LEAST_NORMAL: f32 = 0.15;
const LEAST_SHEAR: f32 = 0.02;

/// Possible beginning of gross slip.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Anchor {
    time: Micros,
    place: [f32; 2],
    ratio: f32,
}

/// Detector of gross slip, with its state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GrossSlipDetector {
    anchor: Option<Anchor>,
    slid: Option<Micros>,
    /// Time of the last scan that was looked at, and the contact point, smoothed.
    seen: Option<(Micros, [f32; 2])>,
}

impl GrossSlipDetector {
    /// Processes one scan: `place` of the contact in mm and its traction. Returns true during gross
    /// slip. Scans that follow within a millisecond change nothing.
    #[inline]
    pub fn update(&mut self, time: Micros, place: [f32; 2], traction: &Traction) -> bool {
        let place = match self.seen {
            None => place,
            Some((seen, [x, y])) if time.since(seen) >= SAMPLE_US => {
                [x + NEW * (place[0] - x), y + NEW * (place[1] - y)]
            }
            Some(_) => return self.slid.is_some(),
        };
        self.seen = Some((time, place));
        self.look(time, place, traction);
        self.slid.is_some()
    }

    #[inline(never)]
    fn look(&mut self, time: Micros, place: [f32; 2], traction: &Traction) {
        let Traction { shear: [fx, fy], normal, sigma, place_sigma, .. } = *traction;
        let shear = sqrt(fx * fx + fy * fy);
        let known = normal > LEAST_NORMAL && shear > LEAST_SHEAR;
        let ratio = if known { shear / normal } else { 0.0 };
        let since = |then: Micros| time.since(then);
        let steady = |anchor: &Anchor| {
            let apart = (ratio - anchor.ratio).abs() * normal;
            apart < STEADY * shear + NOISE * sigma[0] && since(anchor.time) < WITHIN_US
        };
        let now = Anchor { time, place, ratio };
        match self.anchor.filter(steady).filter(|_| ratio > LEAST_RATIO) {
            None => {
                self.anchor = (ratio > LEAST_RATIO).then_some(now);
                self.slid = None;
            }
            Some(anchor) => {
                let [dx, dy] = [place[0] - anchor.place[0], place[1] - anchor.place[1]];
                let far = SWAYS * at_least(place_sigma, SURE) + (DISPLACEMENT - SWAYS * SURE);
                let way2 = dx * dx + dy * dy;
                if way2 > far * far {
                    let way = sqrt(way2);
                    let along = dx * fx + dy * fy;
                    let slid = along > ALONG * way * shear;
                    if slid {
                        self.slid = Some(time);
                    }
                    if slid || along < NEARLY_ALONG * way * shear {
                        self.anchor = Some(now);
                    }
                }
            }
        }
        self.slid = self.slid.filter(|slid| since(*slid) < WITHIN_US && self.anchor.is_some());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pulled(shear: f32) -> Traction {
        Traction { shear: [shear, 0.0], normal: 1.0, ..Traction::default() }
    }

    /// Number of scans with gross slip, at 1 kHz. The contact moves by `way` mm a scan under
    /// `shear`.
    fn slid(way: [f32; 2], shear: impl Fn(u32) -> f32) -> usize {
        let mut state = GrossSlipDetector::default();
        (0..1000)
            .filter(|i| {
                let place = way.map(|w| w * *i as f32);
                state.update(Micros(u64::from(*i) * 1000), place, &pulled(shear(*i)))
            })
            .count()
    }

    #[test]
    fn contact_dragged_under_steady_shear_slides() {
        let frames = slid([0.002, 0.0], |_| 0.5);
        assert!((815..825).contains(&frames), "{frames}");
    }

    #[test]
    fn contact_with_known_shear_noise_slides() {
        let mut state = GrossSlipDetector::default();
        let frames = (0..1000).filter(|i| {
            let noisy = 0.2 + if i % 3 == 0 { 0.02 } else { -0.01 };
            let traction = Traction { sigma: [0.015, 0.0], ..pulled(noisy) };
            state.update(Micros(1000 * i), [0.002 * *i as f32, 0.0], &traction)
        });
        let frames = frames.count();
        assert!((810..825).contains(&frames), "{frames}");
    }

    #[test]
    fn swaying_place_of_a_light_contact_does_not_slide() {
        let slides = |hertz: f32, place_sigma: f32| {
            let mut state = GrossSlipDetector::default();
            (0..1000).any(|i| {
                let turn = core::f32::consts::TAU * hertz * 1e-3 * i as f32;
                let traction = Traction { place_sigma, ..pulled(0.2) };
                state.update(Micros(1000 * i), [0.5 * turn.sin(), 0.0], &traction)
            })
        };
        assert!(!slides(100.0, 0.18), "under lamps");
        assert!(slides(2.0, 0.1) && !slides(2.0, 0.4), "a slow sway");
    }

    #[test]
    fn noisy_first_position_hides_gross_slip_briefly() {
        let mut state = GrossSlipDetector::default();
        let frames = (0..1000).filter(|i| {
            let across = if *i == 0 { 0.11 } else { 0.0 };
            state.update(Micros(1000 * i), [0.002 * *i as f32, across], &pulled(0.5))
        });
        // Within 0.45 mm the angle falls below that of the least cosine.
        let frames = frames.count();
        assert!((770..785).contains(&frames), "{frames}");
    }

    #[test]
    fn resting_rolling_creeping_contact_does_not_slide() {
        assert_eq!(slid([0.0, 0.0], |_| 0.5), 0);
        assert_eq!(slid([0.002, 0.0], |_| 0.0), 0, "rolls freely");
        assert_eq!(slid([0.0, 0.002], |_| 0.5), 0, "rolls across the shear");
        assert_eq!(slid([0.002, 0.0], |i| 0.2 + 0.001 * i as f32), 0, "is being loaded");
        assert_eq!(slid([0.0005, 0.0], |_| 0.5), 0, "creeps");
    }

    #[test]
    fn gross_slip_ends_with_motion_or_shear() {
        let mut state = GrossSlipDetector::default();
        let mut at = |i: u32, x: f32, shear: f32| {
            state.update(Micros(u64::from(i) * 1000), [x, 0.0], &pulled(shear))
        };
        assert!((0..500).map(|i| at(i, 0.002 * i as f32, 0.5)).last().unwrap());
        assert!(!at(500, 1.0, 0.0));
        assert!(!(501..1000).map(|i| at(i, 1.0, 0.5)).last().unwrap());
    }
}
