//! Finger in Foxglove's own schemas: pad, taxels and force in 3-D, and flags as log lines.
//!
//! Positions are in metres in the finger's frame, z into the skin.

use taxel::condition::Signals;
use taxel::frame::schema::{BITS, Kind};
use taxel::frame::{Frame, Status};
use taxel::scan::{PITCH, TAXEL_CENTRES};

use crate::commands::bridge::ros::contact::Contact;

/// Edge of the pad and thickness of what is drawn of it, in m.
const PAD: [f64; 3] = [0.010, 0.010, 0.002];
/// Edge of a taxel's plate, as a share of the pitch, and its thickness in m.
const PLATE: (f64, f64) = (0.85, 0.0004);
/// Signal of a taxel that has the brightest colour, as a share of full scale.
const BRIGHT: f64 = 0.3;

/// Box by its middle, size and colour (red, green, blue, opacity).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plate {
    pub middle: [f64; 3],
    pub size: [f64; 3],
    pub colour: [f64; 4],
}

/// Arrow from its tail along a unit quaternion x, y, z, w, which turns the x axis into it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrow {
    pub tail: [f64; 3],
    pub turn: [f64; 4],
    pub length: f64,
}

/// Returns the pad and, if their signals are streamed, its taxels.
pub fn plates(frame: &Frame) -> Vec<Plate> {
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
pub fn arrow(frame: &Frame) -> Option<Arrow> {
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
pub struct Line {
    pub fault: bool,
    pub text: String,
}

/// Flags that were raised between two frames.
#[derive(Default)]
pub struct Flags {
    before: Status,
    /// Device time in seconds of the last line of each flag.
    told: [Option<u64>; 32],
}

impl Flags {
    /// Returns a line for each warning and fault that began. A flag that flickers has one a second.
    pub fn raised(&mut self, frame: &Frame) -> Vec<Line> {
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
    use taxel::estimate::{ContactPoint, Force};
    use taxel::units::{Micros, Millimetres};

    use super::*;

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
