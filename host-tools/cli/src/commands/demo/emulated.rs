//! Demo finger on an emulated board: the flashed image with converters and USB.

use std::ops::ControlFlow;

use taxel::calibration::Calibration;
use taxel::frame::Frame;
use taxel_client::Client;
use taxel_files::trace::{Sample, TraceWriter, Truth};
use taxel_sim::{Scene, Simulator};
use tempfile::NamedTempFile;

use super::Performer;
use crate::emulated::{Board, Emulated};
use crate::finger::record;

/// Seed of the scene's noise.
const SEED: u64 = 1;

/// Running board with the truth about its finger.
pub struct OnBoard {
    board: Board,
    emulated: Emulated,
    calibration: Option<Calibration>,
    samples: Vec<Sample>,
    period_us: u64,
    // The emulator has read the trace; dropping this deletes the file.
    _trace: NamedTempFile,
}

impl OnBoard {
    /// Starts the firmware on a scene.
    ///
    /// The scene is invalid, or the emulator or the image is missing.
    pub fn start(
        board: Board,
        scene: &str,
        calibration: Option<Calibration>,
    ) -> anyhow::Result<Self> {
        let scene = Scene::load(scene)?;
        let simulator = Simulator::new(&scene, SEED);
        let header = simulator.trace_header(false);
        let samples: Vec<Sample> = simulator.collect();
        let trace = NamedTempFile::with_suffix(".csv")?;
        let mut writer = TraceWriter::create(trace.path(), header)?;
        for sample in &samples {
            writer.write(sample)?;
        }
        writer.finish()?;
        let emulated = Emulated::start(board, trace.path())?;
        let period_us = 1_000_000 / u64::from(scene.rate_hz()).max(1);
        Ok(Self { board, emulated, calibration, samples, period_us, _trace: trace })
    }
}

impl Performer for OnBoard {
    fn name(&self) -> String {
        format!("{} on the emulator, at {}", self.board.name(), self.emulated.port())
    }

    fn connect(&mut self) -> anyhow::Result<Client> {
        let client = Client::open(self.emulated.port())?;
        if let Some(calibration) = &self.calibration {
            client.upload_calibration(&record(calibration)?, |_| ControlFlow::Continue(()))?;
        }
        Ok(client)
    }

    /// Returns the truth of the sample at the beginning of the frame's dark step.
    fn truth(&self, frame: &Frame) -> Option<Truth> {
        let since = frame.time.0.checked_sub(self.emulated.scene_us())?;
        let place = (since / self.period_us) as usize % self.samples.len().max(1);
        self.samples.get(place).map(|sample| sample.truth)
    }
}
