//! Header of a recording: the finger and its settings.

use std::collections::BTreeMap;

use crate::point_method;
use taxel::calibration::{Calibration, bias_fits};
use taxel::condition::{Bias, BridgeBias, LowPass, TaxelBias};
use taxel::estimate::contact_point::PointMethod;
use taxel::finger::{Finger, FingerState};
use taxel::scan::{SENSORS, TAXELS};

/// Names of the facts that set the core when a recording is computed again.
const POINT: &str = "point";
const FILTER: &str = "filter_hz";
const RATE: &str = "rate_hz";
const BIASED: &str = "biased";
/// Name of the matrix's bias: noise, then each channel's level, in digits that read back exactly.
const BIAS_MATRIX: &str = "bias_matrix";

fn bias_of_sensor(sensor: usize) -> String {
    format!("bias_s{sensor}")
}

/// Facts about a whole recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Facts by name: `board`, `serial`, `firmware`, `full_scale`, `calibration_crc`, ….
    pub facts: BTreeMap<String, String>,
    /// Active calibration as the TOML file of `taxel calibrate`; CSV files lack it.
    pub calibration: Option<String>,
}

impl Header {
    /// Adds a fact.
    #[must_use]
    pub fn with(mut self, name: &str, value: impl ToString) -> Self {
        self.facts.insert(name.to_owned(), value.to_string());
        self
    }

    /// Adds the settings of the estimates: frame rate, low-pass, contact-point method and bias.
    ///
    /// `bias` is one taken on command, if any.
    #[must_use]
    pub fn with_settings(
        self,
        rate_hz: f64,
        filter_hz: u16,
        point: PointMethod,
        bias: Option<&Bias>,
    ) -> Self {
        let header =
            self.with(RATE, rate_hz).with(FILTER, filter_hz).with(POINT, point_method::name(point));
        let Some(bias) = bias else { return header };
        let matrix = bias.taxels.iter().map(|b| (BIAS_MATRIX.to_owned(), b.noise, &b.level[..]));
        let sensors = bias.bridges.iter().enumerate().filter_map(|(i, bias)| {
            bias.as_ref().map(|b| (bias_of_sensor(i), b.noise, &b.level[..]))
        });
        matrix.chain(sensors).fold(header, |header, (name, noise, levels)| {
            let numbers: Vec<_> = [noise].iter().chain(levels).map(ToString::to_string).collect();
            header.with(&name, numbers.join(" "))
        })
    }

    /// Returns a fact; empty if unknown.
    #[must_use]
    pub fn fact(&self, name: &str) -> &str {
        self.facts.get(name).map_or("", String::as_str)
    }

    /// Returns frames per second; 0 if unknown.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        self.fact(RATE).parse().unwrap_or_default()
    }

    /// Returns the corner of the low-pass in Hz; 0 without one.
    #[must_use]
    pub fn filter_hz(&self) -> u16 {
        self.fact(FILTER).parse().unwrap_or_default()
    }

    /// Returns the contact-point method.
    #[must_use]
    pub fn point_method(&self) -> PointMethod {
        let method = point_method::parse(self.fact(POINT)).unwrap_or_default();
        if method.is_built() { method } else { PointMethod::default() }
    }

    /// Returns whether a bias taken on command was active.
    #[must_use]
    pub fn biased(&self) -> bool {
        self.fact(BIASED) == "true"
    }

    /// Returns the bias taken on command, if the recording holds it whole.
    #[must_use]
    pub fn bias(&self) -> Option<Bias> {
        self.recorded_bias().ok().flatten()
    }

    /// Returns the name of the fact that should be a part of the bias and is none.
    #[must_use]
    pub fn bad_bias(&self) -> Option<String> {
        self.recorded_bias().err()
    }

    /// Returns the bias; an error names the part that is none.
    fn recorded_bias(&self) -> Result<Option<Bias>, String> {
        let none = Bias { taxels: None, bridges: [None; SENSORS] };
        if !self.biased() {
            return Ok(None);
        }
        let mut bias = none;
        if let Some((noise, level)) = self.levels::<TAXELS>(BIAS_MATRIX)? {
            bias.taxels = Some(TaxelBias { level, noise });
            if !bias_fits(&Bias { taxels: bias.taxels, ..none }) {
                return Err(BIAS_MATRIX.to_owned());
            }
        }
        for (i, bridge) in bias.bridges.iter_mut().enumerate() {
            let name = bias_of_sensor(i);
            let Some((noise, level)) = self.levels(&name)? else { continue };
            *bridge = Some(BridgeBias { level, noise });
            let mut alone = none;
            alone.bridges[i] = *bridge;
            if !bias_fits(&alone) {
                return Err(name);
            }
        }
        Ok((bias != none).then_some(bias))
    }

    /// Returns the core with the recording's settings, to compute it again.
    #[must_use]
    pub fn finger(&self, calibration: Option<Calibration>) -> (Finger, FingerState) {
        let (mut finger, mut state) = Finger::new(calibration);
        finger.point_method = self.point_method();
        // Every recorded frame counts as one scan.
        let (hz, scans) = (self.filter_hz(), self.rate_hz().round() as u16);
        finger.filter = (hz > 0 && scans > 0).then(|| LowPass::new(hz, scans));
        if let Some(bias) = self.bias() {
            finger.restore_bias(&mut state, bias);
        }
        (finger, state)
    }

    /// Returns noise and levels of a part of the bias, if it is there; an error names a part that
    /// is not so many finite numbers.
    fn levels<const N: usize>(&self, name: &str) -> Result<Option<(f32, [f32; N])>, String> {
        let Some(text) = self.facts.get(name) else { return Ok(None) };
        let finite = |text: &str| text.parse().ok().filter(|value: &f32| value.is_finite());
        let numbers: Option<Vec<f32>> = text.split(' ').map(finite).collect();
        let parts = numbers.as_deref().and_then(|numbers| numbers.split_first());
        let parts = parts.and_then(|(noise, levels)| Some((*noise, levels.try_into().ok()?)));
        parts.map(Some).ok_or_else(|| name.to_owned())
    }
}
