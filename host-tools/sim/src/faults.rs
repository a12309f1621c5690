//! Faults at a moment of a scene, and their effect on voltages and codes.
//!
//! The input of an open midpoint floats. The converter then reads the charge that its sampling
//! capacitor holds from the conversion before. It is that of the previous midpoint, or of the
//! sensor's last one for its first.

use std::ops::Range;

use taxel::scan::{COLS, Codes, Midpoints, ROWS, TaxelCodes};
use taxel::units::Code;

use crate::optics::Missing;
use crate::scene::{Broken, Place, Scene};

/// Level well above the range, so that noise cannot bring it back into range.
const ABOVE: f64 = 2.0;

/// Faults of a scene.
#[derive(Clone, Debug)]
pub struct Faults {
    events: Vec<Event>,
    /// Present time of the scene in µs.
    now: f64,
}

#[derive(Clone, Debug)]
struct Event {
    /// Time range of the fault in µs of the scene.
    while_: Range<f64>,
    broken: Broken,
    /// Codes of the frame in which a channel stuck.
    held: Option<Codes>,
}

impl Faults {
    /// Creates the faults of a scene that has been checked.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        let events = scene.faults().map(|(seconds, broken)| Event {
            while_: seconds.start * 1e6..seconds.end * 1e6,
            broken,
            held: None,
        });
        Self { events: events.collect(), now: 0.0 }
    }

    /// Moves to the time `scene_us` of the scene.
    pub fn advance(&mut self, scene_us: f64) {
        self.now = scene_us;
    }

    fn active(&self) -> impl Iterator<Item = Broken> + '_ {
        self.events.iter().filter(|e| e.while_.contains(&self.now)).map(|e| e.broken)
    }

    /// Dead LEDs and open phototransistors.
    #[must_use]
    pub fn missing(&self) -> Missing {
        let mut missing = Missing::default();
        for broken in self.active() {
            match broken {
                Broken::Led(k) => missing.leds |= 1 << k,
                Broken::Open(Place::Taxel(k)) => missing.phototransistors |= 1 << k,
                _ => {}
            }
        }
        missing
    }

    /// Share of each column's phototransistors that the light of the room reaches.
    #[must_use]
    pub fn ambient_shares(&self) -> [f64; COLS] {
        let blind = self.missing().phototransistors;
        let mut shares = [1.0; COLS];
        if blind != 0 {
            for (c, share) in shares.iter_mut().enumerate() {
                let cut_off = (0..ROWS).filter(|r| blind >> (r * COLS + c) & 1 == 1).count();
                *share = 1.0 - cut_off as f64 / ROWS as f64;
            }
        }
        shares
    }

    /// Remaining share of the supply.
    #[must_use]
    pub fn supply(&self) -> f64 {
        self.active().fold(1.0, |left, b| if let Broken::Supply(s) = b { left * s } else { left })
    }

    /// Broken resistors of a sensor, one bit each.
    #[must_use]
    pub fn arms(&self, sensor: usize) -> u8 {
        self.active().fold(0, |arms, b| match b {
            Broken::Arm(of, resistor) if of == sensor => arms | 1 << resistor,
            _ => arms,
        })
    }

    /// Applies the faults of columns to the voltages at the converter.
    pub fn columns(&self, levels: &mut [f64; COLS]) {
        for broken in self.active() {
            match broken {
                Broken::Open(Place::Column(c)) | Broken::Shorted(Place::Column(c)) => {
                    set(levels, c, 0.0)
                }
                Broken::Saturated(Place::Column(c)) => set(levels, c, ABOVE),
                Broken::Swapped(one, other) => levels.swap(one, other),
                _ => {}
            }
        }
    }

    /// Applies the faults of midpoints to a sensor's voltages at the converter.
    pub fn midpoints(&self, sensor: usize, levels: &mut [f64; 4]) {
        for broken in self.active() {
            match broken {
                Broken::Open(Place::Midpoint(of, i)) if of == sensor => {
                    let before = levels.get((i + 3) % 4).copied().unwrap_or_default();
                    set(levels, i, before);
                }
                Broken::Shorted(Place::Midpoint(of, i)) if of == sensor => set(levels, i, 0.0),
                Broken::Saturated(Place::Midpoint(of, i)) if of == sensor => set(levels, i, ABOVE),
                _ => {}
            }
        }
    }

    /// Replaces codes of stuck channels by those of the first frame in which they stuck.
    pub fn stick(&mut self, codes: &mut Codes) {
        let now = self.now;
        for event in &mut self.events {
            let Broken::Stuck(place) = event.broken else { continue };
            if event.while_.contains(&now) {
                let held = event.held.get_or_insert(*codes);
                repeat(codes, held, place);
            } else {
                event.held = None;
            }
        }
    }
}

fn set<const N: usize>(levels: &mut [f64; N], i: usize, to: f64) {
    if let Some(level) = levels.get_mut(i) {
        *level = to;
    }
}

/// Repeats the held reading of a taxel, or keeps the input of a column at its last row.
fn repeat(codes: &mut Codes, held: &Codes, place: Place) {
    match place {
        Place::Taxel(k) => {
            if let (Some(now), Some(then)) = (&mut codes.taxels, &held.taxels) {
                let then = then.lit.as_flattened().get(k);
                if let (Some(now), Some(then)) = (now.lit.as_flattened_mut().get_mut(k), then) {
                    *now = *then;
                }
            }
        }
        Place::Column(c) => {
            let Some(TaxelCodes { lit: [.., last], .. }) = held.taxels else { return };
            let (Some(now), Some(then)) = (&mut codes.taxels, last.get(c)) else { return };
            let rows = now.lit.iter_mut().chain([&mut now.dark]);
            rows.filter_map(|row| row.get_mut(c)).for_each(|code| *code = *then);
        }
        Place::Midpoint(sensor, i) => {
            let then = held.bridges.get(sensor).copied().flatten();
            let now = codes.bridges.get_mut(sensor).and_then(Option::as_mut);
            if let (Some(now), Some(then)) = (now, then) {
                let pick = |m: Midpoints| [m.a, m.b, m.c, m.d].get(i).copied();
                let now = [&mut now.a, &mut now.b, &mut now.c, &mut now.d].into_iter().nth(i);
                if let (Some(now), Some(then)) = (now, pick(then)) {
                    let code: &mut Code = now;
                    *code = then;
                }
            }
        }
        Place::Reference => codes.reference = held.reference,
    }
}
