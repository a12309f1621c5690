//! Scans of a virtual finger, from a scene, a trace or a recording.

use std::collections::VecDeque;
use std::path::Path;

use taxel::calibration::Calibration;
use taxel::condition::Bias;
use taxel::frame::Fields;
use taxel::store::Settings;
use taxel::units::FullScale;
use taxel_files::FileError;
use taxel_files::recording::{Header, Scans};
use taxel_files::trace::Sample;
use taxel_sim::{Scene, Simulator};

use taxel_client::LinkError;
use taxel_client::fields;

/// Iterator over samples, each with its device time and its truth.
pub struct Source {
    name: String,
    samples: Box<dyn Iterator<Item = Result<Sample, FileError>> + Send>,
    /// Samples read in advance to learn the rate.
    ahead: VecDeque<Sample>,
    failure: Option<FileError>,
    /// Identity and settings of a recorded finger.
    header: Header,
    calibration: Option<Calibration>,
}

impl Source {
    /// Wraps any samples; `name` becomes the finger's serial number.
    pub fn samples(
        name: impl Into<String>,
        samples: impl Iterator<Item = Sample> + Send + 'static,
    ) -> Self {
        Self::fallible(name.into(), samples.map(Ok))
    }

    /// Opens a trace or a recording. A recording also gives the finger's settings and its
    /// [`Self::calibration`].
    ///
    /// # Errors
    /// The file cannot be opened or has no codes.
    pub fn trace(path: &Path) -> Result<Self, LinkError> {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let Scans { samples, header, calibration, .. } =
            Scans::open(path).map_err(LinkError::device)?;
        Ok(Self { header, calibration, ..Self::fallible(name, samples) })
    }

    /// Calibration of the finger at the time of the recording.
    #[must_use]
    pub fn calibration(&self) -> Option<&Calibration> {
        self.calibration.as_ref()
    }

    /// Simulates a scene endlessly, by name or path.
    ///
    /// The scene is missing or invalid.
    pub fn scene(name: &str) -> Result<Self, LinkError> {
        let scene = Scene::load(name).map_err(LinkError::device)?;
        let name = Path::new(name).file_stem().unwrap_or_default().to_string_lossy();
        Ok(Self::samples(name, Simulator::new(&scene, SEED).endless()))
    }

    fn fallible(
        name: String,
        samples: impl Iterator<Item = Result<Sample, FileError>> + Send + 'static,
    ) -> Self {
        Self {
            name,
            samples: Box::new(samples),
            ahead: VecDeque::new(),
            failure: None,
            header: Header::default(),
            calibration: None,
        }
    }

    /// Serial number of the finger.
    pub(super) fn serial(&self) -> &str {
        match self.header.fact("serial") {
            "" => &self.name,
            recorded => recorded,
        }
    }

    pub(super) fn board(&self) -> &str {
        match self.header.fact("board") {
            "" => "virtual",
            recorded => recorded,
        }
    }

    /// Settings of a recorded finger; `None` without a recording.
    pub(super) fn settings(&self) -> Option<Settings> {
        let hz = self.header.rate_hz().round() as u16;
        (hz > 0).then(|| Settings {
            hz,
            fields: fields::parse(self.header.fact("fields")).unwrap_or(Fields::ESTIMATES),
            point_method: self.header.point_method(),
            scan: None,
            filter_hz: self.header.filter_hz(),
        })
    }

    /// Recorded bias that was taken on command.
    pub(super) fn bias(&self) -> Option<Bias> {
        self.header.bias()
    }

    /// Returns the scans a second, as recorded or else from the times of the first two.
    pub(super) fn scan_hz(&mut self) -> Result<u16, LinkError> {
        let two = self.samples.by_ref().take(2).collect::<Result<Vec<_>, _>>();
        self.ahead.extend(two.map_err(LinkError::device)?);
        let Some(first) = self.ahead.front() else {
            let error = FileError::new(&self.name, "no scans");
            return Err(LinkError::device(error.mend("a finger needs at least one line of codes")));
        };
        let last = self.ahead.back().unwrap_or(first);
        let period = last.scan.time.0.saturating_sub(first.scan.time.0);
        let hz = 1_000_000u64.checked_div(period).unwrap_or(1000).clamp(1, u16::MAX.into());
        Ok(self.settings().map_or(hz as u16, |settings| settings.hz))
    }

    pub(super) fn full_scale(&self) -> FullScale {
        self.ahead.front().map_or(FullScale::BITS_12, |sample| sample.scan.codes.full_scale)
    }

    pub(super) fn failure(&mut self) -> Option<FileError> {
        self.failure.take()
    }
}

/// Seed of the simulator; fixed, so that the simulated finger is always the same.
const SEED: u64 = 1;

impl Iterator for Source {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        if let Some(sample) = self.ahead.pop_front() {
            return Some(sample);
        }
        match self.samples.next()? {
            Ok(sample) => Some(sample),
            Err(error) => {
                self.failure = Some(error);
                None
            }
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use taxel::scan::{Codes, Scan, TaxelCodes};
    use taxel::units::{Code, Micros};
    use taxel_files::trace::Truth;

    use super::*;

    /// Endless samples of an unloaded finger.
    pub(in super::super) fn still(scan_hz: u64) -> impl Iterator<Item = Sample> + Send {
        (0u64..).map(move |i| {
            let taxels = TaxelCodes { lit: [[Code(1800); 4]; 4], dark: [Code(200); 4] };
            let codes = Codes {
                full_scale: FullScale::BITS_12,
                taxels: Some(taxels),
                bridges: [None; 4],
                reference: None,
                temperature: None,
            };
            let scan = Scan { time: Micros(i * 1_000_000 / scan_hz), lost: 0, codes };
            Sample { scan, truth: Truth::default() }
        })
    }

    #[test]
    fn reading_rate_loses_no_sample() {
        let mut source = Source::samples("still", still(4000).take(10));
        assert_eq!(source.scan_hz().unwrap(), 4000);
        assert_eq!(source.count(), 10);
    }

    #[test]
    fn source_without_scans_is_refused() {
        assert!(Source::samples("empty", std::iter::empty()).scan_hz().is_err());
    }
}
