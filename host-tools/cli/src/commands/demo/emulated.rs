//! The demo's finger on the emulated board: the firmware itself, in real time.

use std::collections::HashMap;
use std::ops::ControlFlow;

use crate::emulated::{BOARD, Emulated, Image};
use anyhow::Context;
use taxel::calibration::Calibration;
use taxel::frame::Frame;
use taxel::session::Pace;
use taxel::units::Micros;
use taxel_client::{Client, Link, Port};
use taxel_files::trace::{Sample, Truth};
use taxel_sim::{Scene, Simulator};

use super::Performer;
use crate::finger::record;

/// The board's memory holds the scans of some three minutes at 1 kHz; without a duration the demo takes
/// two.
const LONG: f64 = 120.0;
/// The board scans from the moment it starts: this long, besides the duration, for connecting and for the
/// calibration on its way.
const LEAD: f64 = 4.0;
/// Seed of the scene's noise.
const SEED: u64 = 1;

/// A running board, and what really happens to its finger.
pub struct Board {
    board: Emulated,
    calibration: Option<Calibration>,
    truth: HashMap<Micros, Truth>,
}

impl Board {
    /// Starts the firmware on a scene, repeated for `duration` seconds.
    ///
    /// # Errors
    /// The scene is wrong or too long, or QEMU or the firmware is missing.
    pub fn start(
        scene: &str,
        duration: Option<f64>,
        calibration: Option<Calibration>,
    ) -> anyhow::Result<Self> {
        let scene = Scene::load(scene)?;
        let seconds = duration.unwrap_or(LONG) + LEAD;
        let count = (seconds * f64::from(scene.rate_hz())).ceil() as usize;
        let samples: Vec<Sample> = Simulator::new(&scene, SEED).endless().take(count).collect();
        let scans: Vec<_> = samples.iter().map(|sample| sample.scan).collect();
        let image = Image::new(&scans, Pace::Live)?;
        Ok(Self {
            board: Emulated::start(&image)?,
            calibration,
            truth: samples.iter().map(|sample| (sample.scan.time, sample.truth)).collect(),
        })
    }
}

impl Performer for Board {
    fn name(&self) -> String {
        format!("{BOARD} under QEMU")
    }

    fn connect(&mut self) -> anyhow::Result<Client> {
        let (reader, writer) = self.board.take_link().context("the board has no link left")?;
        let client = Client::over(&Port::Serial(BOARD.to_owned()), Link::over(reader, writer))?;
        if let Some(calibration) = &self.calibration {
            client.upload_calibration(&record(calibration)?, |_| ControlFlow::Continue(()))?;
        }
        Ok(client)
    }

    fn truth(&self, frame: &Frame) -> Option<Truth> {
        self.truth.get(&frame.time).copied()
    }
}
