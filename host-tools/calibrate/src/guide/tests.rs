//! Tests of the guide by a person who obeys, errs or has no sensors.

use super::*;
use taxel::scan::{Midpoints, SENSORS, TAXEL_CENTRES, TAXELS, TaxelCodes};
use taxel::units::{Code, FullScale};

/// Finger whose codes follow its presses, at 200 frames a second.
struct Person {
    guide: Guide,
    now: u64,
    sensors: bool,
    known: bool,
}

impl Person {
    fn new(sensors: bool, known: bool) -> Self {
        let mut person = Self { guide: Guide::new(200), now: 0, sensors, known };
        assert_eq!(person.guide.step(), Step::LetGo);
        person.press([0.0; 2], 0.0, [0.0; 2], [0, 200, 0]);
        person
    }

    /// Presses a place with a strength, sheared, for so many frames to rise, hold and fall.
    fn press(&mut self, place: [f64; 2], strength: f64, shear: [f64; 2], frames: [u64; 3]) {
        let [rise, hold, fall] = frames;
        for i in 0..rise + hold + fall + 10 {
            let share = match i {
                i if i < rise => (i + 1) as f64 / rise as f64,
                i if i < rise + hold => 1.0,
                i => 1.0 - ((i - rise - hold + 1) as f64 / fall.max(1) as f64).min(1.0),
            };
            self.frame(place, share * strength, shear);
        }
    }

    fn frame(&mut self, place: [f64; 2], strength: f64, shear: [f64; 2]) {
        self.now += 5_000;
        // A step of noise, so that the bias has some.
        let noise = (self.now / 5_000 % 3) as f64;
        let code = |value: f64| Code((value + noise).clamp(0.0, 65_535.0) as u16);
        let mut lit = [[Code(0); COLS]; ROWS];
        for (k, [x, y]) in TAXEL_CENTRES.iter().enumerate() {
            let away = (place[0] - f64::from(x.0)).hypot(place[1] - f64::from(y.0));
            lit[k / COLS][k % COLS] =
                code(20_000.0 + 10_000.0 * strength * (1.0 + (away / 2.5).powi(2)).powf(-1.5));
        }
        let [x, y] = shear.map(|shear| 2_000.0 * shear * strength);
        let z = 1_000.0 * strength;
        let bridge = Midpoints {
            a: code(32_000.0 - x / 2.0 + z / 2.0),
            b: code(32_000.0 + x / 2.0 + z / 2.0),
            c: code(32_000.0 + y / 2.0 - z / 2.0),
            d: code(32_000.0 - y / 2.0 - z / 2.0),
        };
        let codes = Codes {
            full_scale: FullScale::BITS_16,
            taxels: Some(TaxelCodes { lit, dark: [Code(3_000); COLS] }),
            bridges: [self.sensors.then_some(bridge); SENSORS],
            reference: None,
            temperature: None,
        };
        let force = [shear[0] * strength, shear[1] * strength, strength];
        let known = self.known.then_some(Known { force, place: Some(place) });
        self.guide.add(Micros(self.now), &codes, known);
    }

    /// Does what the guide asks for.
    fn obey(&mut self) {
        let Some(target) = self.guide.target else { return };
        let centre = |k: usize| TAXEL_CENTRES[k].map(|c| f64::from(c.0));
        match target {
            Target::Full => self.press([0.0; 2], 1.0, [0.0; 2], [30, 10, 10]),
            Target::Region(region, level) => {
                self.press(centre(region), ASKED[level], [0.0; 2], [30, 10, 10]);
            }
            Target::Shear(eighth) => {
                let (y, x) = (eighth as f64 * FRAC_PI_4).sin_cos();
                self.press([0.0; 2], 0.8, [0.5 * x, 0.5 * y], [30, 10, 10]);
            }
            Target::Hold => self.press([0.0; 2], 0.8, [0.0; 2], [30, 120, 10]),
            Target::Fast => self.press([0.0; 2], 0.8, [0.0; 2], [4, 5, 5]),
            Target::More => self.press([1.0, 1.0], 0.5, [0.0; 2], [30, 10, 10]),
        }
    }

    /// Obeys until it is enough; returns the number of presses.
    fn finish(&mut self) -> usize {
        for _ in 0..300 {
            if matches!(self.guide.step(), Step::Enough) {
                break;
            }
            self.obey();
        }
        assert_eq!(self.guide.step(), Step::Enough, "{}", self.guide.picture());
        self.guide.presses.len()
    }
}

#[test]
fn obedient_person_covers_the_pad() {
    for (sensors, known) in [(true, false), (false, false), (true, true), (false, true)] {
        let mut person = Person::new(sensors, known);
        let presses = person.finish();
        // The hardest ones in the middle fill a region, too.
        let least = MISHAPS + 3 * TAXELS + TOWARDS.len() + 2 * TIMES;
        assert_eq!(presses, if sensors { PRESSES } else { least }, "{sensors} {known}");
        assert_eq!(person.guide.left_out(), Vec::<String>::new());
        let picture = person.guide.picture();
        assert_eq!(picture.matches("[lmh").count(), TAXELS, "{picture}");
        assert!(picture.contains("sideways →↗↑↖←↙↓↘, held 3 of 3, fast 3 of 3"), "{picture}");
    }
}

#[test]
fn first_steps_are_told_in_words() {
    let mut person = Person::new(true, false);
    let mut said = vec![person.guide.step().to_string()];
    for _ in 0..6 {
        person.obey();
        said.push(person.guide.step().to_string());
    }
    said.dedup();
    assert_eq!(
        said,
        [
            "press the middle 3 times, as hard as it will ever be pressed",
            "press the upper left corner (r3c0), lightly, much more lightly than the last",
            "press the upper left corner (r3c0), half as hard as the hardest, about twice as hard as the last",
            "press the upper left corner (r3c0), as hard as the hardest, about twice as hard as the last",
            "press the upper edge, a little to the left (r3c1), lightly, much more lightly than the last",
        ]
    );
    let mut known = Person::new(true, true);
    (0..3).for_each(|_| known.obey());
    let asked = "press the upper left corner (r3c0), lightly, with about 0.2 N";
    assert_eq!(known.guide.step().to_string(), asked);
}

#[test]
fn picture_shows_the_region_that_is_asked_for() {
    let mut person = Person::new(true, false);
    (0..4).for_each(|_| person.obey());
    let lines: Vec<String> = person.guide.picture().lines().map(str::to_owned).collect();
    assert_eq!(lines[0], "  r3 >l··  1< [···  0] [···  0] [···  0]");
    assert_eq!(lines[5], "  sideways ········, held 0 of 3, fast 0 of 3, presses 4 of 100");
}

#[test]
fn presses_out_of_order_count() {
    let mut person = Person::new(true, false);
    (0..3).for_each(|_| person.obey());
    let last = TAXEL_CENTRES[TAXELS - 1].map(|c| f64::from(c.0));
    person.press(last, 0.5, [0.4, 0.0], [30, 10, 10]);
    assert_eq!(person.guide.counts(TAXELS - 1), [0, 1, 0]);
    assert!(person.guide.is_met(Target::Shear(0)));
}

#[test]
fn harder_presses_ask_for_the_earlier_regions_again() {
    let mut person = Person::new(true, false);
    (0..6).for_each(|_| person.obey());
    assert_eq!(person.guide.counts(12), [1, 1, 1]);
    // One mishap changes nothing, but three hard presses are the new full strength.
    person.press([0.0; 2], 1.9, [0.0; 2], [30, 10, 10]);
    assert_eq!(person.guide.counts(12), [1, 1, 1]);
    (0..2).for_each(|_| person.press([0.0; 2], 1.9, [0.0; 2], [30, 10, 10]));
    assert_eq!(person.guide.counts(12), [2, 1, 0]);
    assert_eq!(person.guide.target, Some(Target::Region(12, 2)));
}

#[test]
fn region_that_cannot_be_pressed_is_left_out() {
    let mut person = Person::new(true, false);
    (0..3).for_each(|_| person.obey());
    (0..3 * PATIENCE).for_each(|_| person.press([0.0; 2], 0.5, [0.0; 2], [30, 10, 10]));
    let left_out = person.guide.left_out();
    assert_eq!(left_out.len(), 3, "{left_out:?}");
    assert!(left_out[0].starts_with("press the upper left corner (r3c0), lightly"));
    let asked = person.guide.step().to_string();
    assert!(asked.contains("upper edge, a little to the left (r3c1), lightly"), "{asked}");
    // It is asked for once more when there is nothing else.
    for _ in 0..200 {
        match person.guide.target {
            Some(Target::Region(12, _)) => person.press([0.0; 2], 0.5, [0.0; 2], [30, 10, 10]),
            _ => person.obey(),
        }
    }
    let ended = Step::Ended("no press in r3c0".into());
    assert_eq!((person.guide.step(), person.guide.left_out().len()), (ended, 3));
    assert_eq!(person.guide.presses.len(), PRESSES + 3 * PATIENCE);
}

#[test]
fn recording_without_shear_and_held_presses_is_not_enough() {
    let mut person = Person::new(true, false);
    for _ in 0..300 {
        match person.guide.target {
            None => break,
            Some(Target::Shear(_) | Target::Hold) => {
                person.press([0.0; 2], 0.8, [0.0; 2], [30, 10, 10]);
            }
            Some(_) => person.obey(),
        }
    }
    let told = "ended: no shear, no held press recorded";
    assert_eq!(person.guide.step().to_string(), told);
}

#[test]
fn restarted_finger_begins_again_without_a_touch() {
    let mut person = Person::new(true, false);
    (0..3).for_each(|_| person.obey());
    // It restarts in a press.
    (0..20).for_each(|_| person.frame([0.0; 2], 1.0, [0.0; 2]));
    person.guide.restart();
    person.now = 0;
    assert_eq!(person.guide.step(), Step::LetGo);
    person.press([0.0; 2], 0.0, [0.0; 2], [0, 400, 0]);
    assert_eq!(person.guide.presses.len(), 3);
    assert!(matches!(person.guide.step(), Step::Press(_)));
}

#[test]
fn force_that_comes_late_does_not_mix_with_relative_strengths() {
    let mut person = Person::new(true, false);
    (0..3).for_each(|_| person.obey());
    person.known = true;
    person.press([0.0; 2], 1.0, [0.0; 2], [30, 10, 10]);
    let peaks: Vec<f64> = person.guide.presses.iter().map(|press| press.peak).collect();
    assert!((peaks[3] / peaks[0] - 1.0).abs() < 0.1, "{peaks:?}");
}

#[test]
fn touched_finger_is_asked_to_be_let_go() {
    let mut person = Person { guide: Guide::new(200), now: 0, sensors: true, known: false };
    person.press([0.0; 2], 1.0, [0.0; 2], [40, 20, 40]);
    assert_eq!(person.guide.step(), Step::LetGo);
    person.press([0.0; 2], 0.0, [0.0; 2], [0, 400, 0]);
    assert!(matches!(person.guide.step(), Step::Press(_)));
    // A contact that does not end is a zero that has moved.
    person.press([0.0; 2], 0.1, [0.0; 2], [10, 4_100, 0]);
    assert_eq!(person.guide.presses.len(), 0, "{:?}", person.guide.presses);
}
