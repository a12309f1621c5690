//! Status line of the latest frame, on a terminal only.

use std::collections::VecDeque;
use std::fmt::Write as _;
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use taxel::frame::schema::{self, Kind};
use taxel::frame::{Frame, Status};
use taxel_client::{Counts, Received};

/// Interval between updates of the line.
const PERIOD: Duration = Duration::from_millis(100);
/// Updates that the rate is averaged over.
const AVERAGED: usize = 10;

/// Status line on standard error.
pub struct Live {
    on: bool,
    due: Option<Instant>,
    /// Times of past updates, with the count of frames at each.
    history: VecDeque<(Instant, u64)>,
}

impl Live {
    /// Creates the line. It shows nothing unless `wanted` and standard error is a terminal.
    pub fn new(wanted: bool) -> Self {
        Self { on: wanted && std::io::stderr().is_terminal(), due: None, history: VecDeque::new() }
    }

    /// Shows the frame if an update is due.
    pub fn show(&mut self, received: &Received, counts: &Counts) {
        if !self.on || self.due.is_some_and(|due| received.at < due) {
            return;
        }
        self.due = Some(received.at + PERIOD);
        self.history.push_back((received.at, counts.frames));
        if self.history.len() > AVERAGED {
            self.history.pop_front();
        }
        let line = line(&received.frame, self.rate(), counts.lost);
        // A failed write must not stop the demo.
        let _ = write!(std::io::stderr(), "\r{line}\x1b[K");
    }

    /// Clears the line.
    pub fn clear(&self) {
        if self.on {
            let _ = write!(std::io::stderr(), "\r\x1b[K");
        }
    }

    fn rate(&self) -> f64 {
        let (Some((start, before)), Some((end, now))) = (self.history.front(), self.history.back())
        else {
            return 0.0;
        };
        let span = end.duration_since(*start).as_secs_f64();
        if span > 0.0 { (now - before) as f64 / span } else { 0.0 }
    }
}

fn line(frame: &Frame, rate: f64, lost: u64) -> String {
    let mut line = format!("{rate:6.0} Hz");
    if lost > 0 {
        let _ = write!(line, ", {lost} lost");
    }
    if let Some(force) = frame.force {
        line += "  force";
        for component in [force.x, force.y, force.z] {
            match component {
                Ok(newtons) => {
                    let _ = write!(line, " {:6.2}", newtons.0);
                }
                Err(_) => line += "      –",
            }
        }
        line += " N";
    }
    if let Some(Ok(point)) = frame.point {
        let _ = write!(line, "  at {:5.2} {:5.2} mm", point.x.0, point.y.0);
    }
    line + "  " + &flags(frame.status)
}

/// Lists the names of status flags, except those of estimators that ran.
fn flags(status: Status) -> String {
    let held = schema::named(status).filter(|bit| bit.kind != Kind::Estimator);
    held.map(|bit| bit.name).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use taxel::estimate::{ContactPoint, Force};
    use taxel::units::Millimetres;

    use super::*;

    #[test]
    fn status_line_names_flags_and_values() {
        let frame = Frame {
            status: Status::CONTACT | Status::RAN_NET | Status::OUT_OF_RANGE,
            force: Some(Force::known(0.5, -0.25, 2.0)),
            point: Some(Ok(ContactPoint { x: Millimetres(1.0), y: Millimetres(-2.0) })),
            ..Frame::default()
        };
        assert_eq!(
            line(&frame, 1000.0, 3),
            "  1000 Hz, 3 lost  force   0.50  -0.25   2.00 N  at  1.00 -2.00 mm  contact out-of-range"
        );
    }
}
