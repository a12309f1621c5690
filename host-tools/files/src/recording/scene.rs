//! Finger in Foxglove's own schemas: pad, taxels and force in 3-D, and flags as log lines.
//!
//! Positions are in metres in the finger's frame, z into the skin.

use taxel::condition::Signals;
use taxel::estimate::{ContactPoint, Force};
use taxel::frame::schema::{BITS, Kind};
use taxel::frame::{Frame, Status};
use taxel::scan::{COLS, PITCH, TAXEL_CENTRES, TAXELS};
use taxel::units::{Micros, Millimetres, Newtons};

use crate::frames::{Cell, Column};

/// Edge of the pad and thickness of what is drawn of it, in m.
const PAD: [f64; 3] = [0.010, 0.010, 0.002];
/// Edge of a taxel's plate, as a share of the pitch, and its thickness in m.
const PLATE: (f64, f64) = (0.85, 0.0004);
/// Signal of a taxel that has the brightest colour, as a share of full scale.
const BRIGHT: f64 = 0.3;

/// Length of the arrow of a force, in m per N.
const ARROW: f64 = 0.01;

/// Single contact with a place.
#[derive(Clone, Copy)]
pub struct Contact {
    /// Place on the surface of the skin in m.
    pub point: [f64; 2],
    /// Force in N; `None` if a component has no value.
    pub force: Option<[f64; 3]>,
}

impl Contact {
    /// Returns the frame's contact; `None` without a contact point.
    #[must_use]
    pub fn of(frame: &Frame) -> Option<Self> {
        let point = frame.point?.ok()?;
        let force = match frame.force {
            Some(Force { x: Ok(x), y: Ok(y), z: Ok(z) }) => Some([x, y, z]),
            _ => None,
        };
        Some(Self {
            point: [point.x, point.y].map(|mm| f64::from(mm.0) * 1e-3),
            force: force.map(|force| force.map(|newtons| f64::from(newtons.0))),
        })
    }

    /// Returns the ends of the arrow that pushes onto the contact point.
    #[must_use]
    pub fn arrow(&self) -> Option<[[f64; 3]; 2]> {
        let [x, y] = self.point;
        let tip = [x, y, 0.0];
        let force = self.force?;
        Some([std::array::from_fn(|i| tip[i] - ARROW * force[i]), tip])
    }
}

/// Returns the name of the frame at the contact point of a finger.
#[must_use]
pub fn contact_frame(finger: &str) -> String {
    format!("{finger}_contact")
}

/// Columns of a recording that a scene and a log are made of.
pub(crate) struct Columns {
    time: usize,
    status: usize,
    force: Option<[usize; 3]>,
    point: Option<[usize; 2]>,
    taxels: Option<[usize; TAXELS]>,
}

impl Columns {
    /// Finds them; `None` in rows without a status, which are no frames.
    pub(crate) fn of(columns: &[Column]) -> Option<Self> {
        let find = |name: &str| columns.iter().position(|column| column.name == name);
        let taxel = |k: usize| find(&format!("c_r{}c{}", k / COLS, k % COLS));
        let taxels: Option<Vec<usize>> = (0..TAXELS).map(taxel).collect();
        let three = || Some([find("fx_n")?, find("fy_n")?, find("fz_n")?]);
        let two = || Some([find("x_mm")?, find("y_mm")?]);
        Some(Self {
            time: find("t_us")?,
            status: find("status")?,
            force: three(),
            point: two(),
            taxels: taxels.and_then(|taxels| taxels.try_into().ok()),
        })
    }

    /// Returns the frame of a row, as far as it is drawn.
    pub(crate) fn frame(&self, row: &[Cell]) -> Frame {
        let whole = |at: usize| match row.get(at) {
            Some(Cell::Whole(value)) => *value,
            _ => 0,
        };
        let value = |at: usize| match row.get(at)? {
            Cell::Real(value) => Some(Ok(*value)),
            Cell::Withheld(why) => Some(Err(*why)),
            _ => None,
        };
        let force = self.force.and_then(|[x, y, z]| {
            let newtons = |at| value(at).map(|value| value.map(Newtons));
            Some(Force { x: newtons(x)?, y: newtons(y)?, z: newtons(z)? })
        });
        let point = self.point.and_then(|[x, y]| {
            let place = |(x, y)| ContactPoint { x: Millimetres(x), y: Millimetres(y) };
            let (x, y) = (value(x)?, value(y)?);
            Some(x.and_then(|x| y.map(|y| (x, y))).map(place))
        });
        let taxels = self.taxels.and_then(|taxels| {
            let mut signals = [0.0; TAXELS];
            for (signal, at) in signals.iter_mut().zip(taxels) {
                *signal = value(at)?.ok()?;
            }
            Some(signals)
        });
        Frame {
            time: Micros(whole(self.time)),
            status: Status(whole(self.status) as u32),
            force,
            point,
            signals: taxels.map(|taxels| Signals { taxels: Some(taxels), ..Signals::default() }),
            ..Frame::default()
        }
    }
}

/// Box by its middle, size and colour (red, green, blue, opacity).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Plate {
    pub(crate) middle: [f64; 3],
    pub(crate) size: [f64; 3],
    pub(crate) colour: [f64; 4],
}

/// Arrow from its tail along a unit quaternion x, y, z, w, which turns the x axis into it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Arrow {
    pub(crate) tail: [f64; 3],
    pub(crate) turn: [f64; 4],
    pub(crate) length: f64,
}

/// Returns the pad and, if their signals are streamed, its taxels.
pub(crate) fn plates(frame: &Frame) -> Vec<Plate> {
    let pad =
        Plate { middle: [0.0, 0.0, PAD[2] / 2.0], size: PAD, colour: [0.85, 0.85, 0.88, 0.35] };
    let taxels = frame.signals.and_then(|Signals { taxels, .. }| taxels);
    let taxels = taxels.into_iter().flat_map(|taxels| {
        TAXEL_CENTRES.into_iter().zip(taxels).map(|([x, y], signal)| {
            let edge = f64::from(PITCH.0) * 1e-3 * PLATE.0;
            Plate {
                middle: [f64::from(x.0) * 1e-3, f64::from(y.0) * 1e-3, PAD[2]],
                size: [edge, edge, PLATE.1],
                colour: colour(signal),
            }
        })
    });
    [pad].into_iter().chain(taxels).collect()
}

/// Returns the colour of a signal: from dark blue at rest to yellow.
fn colour(signal: f32) -> [f64; 4] {
    let share = (f64::from(signal.abs()) / BRIGHT).min(1.0);
    let between = |from: f64, to: f64| from + share * (to - from);
    [between(0.10, 1.0), between(0.15, 0.85), between(0.45, 0.1), 1.0]
}

/// Returns the arrow of the frame's force; `None` without a force, a place or a length.
pub(crate) fn arrow(frame: &Frame) -> Option<Arrow> {
    let [tail, tip] = Contact::of(frame)?.arrow()?;
    let along: [f64; 3] = std::array::from_fn(|i| tip[i] - tail[i]);
    let length = along.iter().map(|part| part * part).sum::<f64>().sqrt();
    if length < 1e-9 {
        return None;
    }
    let [x, y, z] = along.map(|part| part / length);
    // Half way between the x axis and the arrow; opposite to the x axis any half turn serves.
    let turn = if x < -1.0 + 1e-9 {
        [0.0, 0.0, 1.0, 0.0]
    } else {
        let norm = (2.0 * (1.0 + x)).sqrt();
        [0.0, -z / norm, y / norm, norm / 2.0]
    };
    Some(Arrow { tail, turn, length })
}

/// Line of the log, with whether it is a fault.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Line {
    pub(crate) fault: bool,
    pub(crate) text: String,
}

/// Flags that were raised between two frames.
#[derive(Default)]
pub(crate) struct Flags {
    before: Status,
    /// Device time in seconds of the last line of each flag.
    told: [Option<u64>; 32],
}

impl Flags {
    /// Returns a line for each warning and fault that began. A flag that flickers has one a second.
    pub(crate) fn raised(&mut self, frame: &Frame) -> Vec<Line> {
        let now = frame.time.0 / 1_000_000;
        let new = frame.status - self.before;
        self.before = frame.status;
        let mut lines = Vec::new();
        for bit in BITS.iter().filter(|bit| new.contains(bit.status)) {
            let fault = match bit.kind {
                Kind::Fault => true,
                Kind::Warning => false,
                Kind::Good | Kind::Estimator => continue,
            };
            let told = self.told.get_mut(bit.status.0.trailing_zeros() as usize);
            if told.is_some_and(|told| told.replace(now) != Some(now)) {
                let text = format!("{}: {}. To mend: {}", bit.name, bit.title, bit.remedy);
                lines.push(Line { fault, text });
            }
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use taxel::frame::Fields;
    use taxel::measured::NoValue;

    use super::*;
    use crate::frames;

    fn pressed(force: [f32; 3]) -> Frame {
        let [x, y, z] = force;
        Frame {
            force: Some(Force::known(x, y, z)),
            point: Some(Ok(ContactPoint { x: Millimetres(1.0), y: Millimetres(-2.0) })),
            ..Frame::default()
        }
    }

    /// Turns the x axis by a quaternion.
    fn turned([x, y, z, w]: [f64; 4]) -> [f64; 3] {
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)]
    }

    #[test]
    fn arrow_pushes_onto_the_contact_along_the_force() {
        for force in [[0.0, 0.0, 1.0], [0.5, -0.25, 2.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] {
            let Arrow { tail, turn, length } = arrow(&pressed(force)).unwrap();
            let newtons = force.map(f64::from).iter().map(|f| f * f).sum::<f64>().sqrt();
            assert!((length - 0.01 * newtons).abs() < 1e-9);
            let direction = turned(turn);
            for (i, tip) in [0.001, -0.002, 0.0].into_iter().enumerate() {
                assert!((tail[i] + length * direction[i] - tip).abs() < 1e-7, "{force:?}");
            }
        }
        assert_eq!(arrow(&pressed([0.0; 3])), None);
        assert_eq!(arrow(&Frame::default()), None);
    }

    #[test]
    fn row_draws_what_its_frame_draws() {
        let taxels = std::array::from_fn(|k| k as f32 * -0.01);
        let sent = Frame {
            time: Micros(7_000),
            status: Status::CONTACT,
            signals: Some(Signals { taxels: Some(taxels), ..Signals::default() }),
            ..pressed([0.5, -0.25, 2.0])
        };
        let withheld = Frame {
            force: Some(Force { y: Err(NoValue::Saturated), ..Force::known(0.0, 0.0, 1.0) }),
            point: Some(Err(NoValue::NoContact)),
            ..sent
        };
        let columns = Columns::of(&frames::columns(Fields::ALL)).unwrap();
        for sent in [sent, withheld, Frame::default()] {
            let mut row = Vec::new();
            frames::cells(&sent, Fields::ALL, &mut row);
            let read = columns.frame(&row);
            assert_eq!((read.time, read.status), (sent.time, sent.status));
            assert_eq!((read.force, read.point), (sent.force, sent.point));
            assert_eq!((plates(&read), arrow(&read)), (plates(&sent), arrow(&sent)));
        }
        assert!(Columns::of(&frames::columns(Fields::ALL)[3..]).is_none());
    }

    #[test]
    fn taxels_are_drawn_if_their_signals_are_streamed() {
        assert_eq!(plates(&Frame::default()).len(), 1);
        let mut taxels = [0.0; 16];
        taxels[5] = -0.3;
        let signals = Some(Signals { taxels: Some(taxels), ..Signals::default() });
        let plates = plates(&Frame { signals, ..Frame::default() });
        assert_eq!(plates.len(), 17);
        let brightest = plates[1 + 5].colour.into_iter().zip([1.0, 0.85, 0.1, 1.0]);
        assert!(brightest.into_iter().all(|(found, wanted)| (found - wanted).abs() < 1e-6));
        assert!((plates[1 + 5].middle[0] + 0.00125).abs() < 1e-9);
    }

    #[test]
    fn flickering_flag_is_told_once_a_second() {
        let mut flags = Flags::default();
        let mut lines = Vec::new();
        for i in 0..4000u64 {
            let status = if i % 2 == 0 { Status::DEAD_TAXEL } else { Status::CONTACT };
            lines.extend(flags.raised(&Frame {
                status,
                time: Micros(i * 500),
                ..Frame::default()
            }));
        }
        assert_eq!(lines.len(), 2);
        assert!(lines.iter().all(|line| line.fault && line.text.starts_with("dead-taxel: ")));
    }
}
