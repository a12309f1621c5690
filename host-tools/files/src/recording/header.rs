//! Which finger a recording is of, and how it was set.

use std::collections::BTreeMap;

use crate::point_method;
use taxel::calibration::Calibration;
use taxel::condition::{Bias, BridgeBias, LowPass, TaxelBias};
use taxel::estimate::contact_point::PointMethod;
use taxel::finger::{Finger, FingerState};
use taxel::scan::{SENSORS, TAXELS};

/// The facts that the core is set from when a recording is computed again.
const POINT: &str = "point";
const FILTER: &str = "filter_hz";
const RATE: &str = "rate_hz";
const BIASED: &str = "biased";
/// Noise, then the level of each channel, in the fewest digits that read back as the same number.
const BIAS_MATRIX: &str = "bias_matrix";

fn bias_of_sensor(sensor: usize) -> String {
    format!("bias_s{sensor}")
}

/// What is known about a recording as a whole.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Facts by name: `board`, `serial`, `firmware`, `full_scale`, `calibration_crc`, ….
    pub facts: BTreeMap<String, String>,
    /// The calibration in force, as the TOML file that `taxel calibrate` writes. Not kept in CSV.
    pub calibration: Option<String>,
}

impl Header {
    /// Sets a fact.
    #[must_use]
    pub fn with(mut self, name: &str, value: impl ToString) -> Self {
        self.facts.insert(name.to_owned(), value.to_string());
        self
    }

    /// Sets what forces and places were computed with: the rate of the frames, the low-pass, how the contact
    /// point was found, and the bias that was taken on command, if one was.
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

    /// A fact; empty where it is not known.
    #[must_use]
    pub fn fact(&self, name: &str) -> &str {
        self.facts.get(name).map_or("", String::as_str)
    }

    /// Frames a second; 0 where it is not known.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        self.fact(RATE).parse().unwrap_or_default()
    }

    /// The corner of the low-pass; 0 for none.
    #[must_use]
    pub fn filter_hz(&self) -> u16 {
        self.fact(FILTER).parse().unwrap_or_default()
    }

    /// How the contact point was found.
    #[must_use]
    pub fn point_method(&self) -> PointMethod {
        let method = point_method::parse(self.fact(POINT)).unwrap_or_default();
        if method.is_built() { method } else { PointMethod::default() }
    }

    /// A bias taken on command was in force.
    #[must_use]
    pub fn biased(&self) -> bool {
        self.fact(BIASED) == "true"
    }

    /// That bias, where it is in the recording.
    #[must_use]
    pub fn bias(&self) -> Option<Bias> {
        if !self.biased() {
            return None;
        }
        let matrix = self.levels::<TAXELS>(BIAS_MATRIX);
        let taxels = matrix.map(|(noise, level)| TaxelBias { level, noise });
        let bridges = std::array::from_fn::<_, SENSORS, _>(|i| {
            let (noise, level) = self.levels(&bias_of_sensor(i))?;
            Some(BridgeBias { level, noise })
        });
        let known = taxels.is_some() || bridges.iter().any(Option::is_some);
        known.then_some(Bias { taxels, bridges })
    }

    /// The core as it was set, to compute the recording again.
    #[must_use]
    pub fn finger(&self, calibration: Option<Calibration>) -> (Finger, FingerState) {
        let (mut finger, mut state) = Finger::new(calibration);
        finger.point_method = self.point_method();
        // Every frame is a scan of the playback.
        let (hz, scans) = (self.filter_hz(), self.rate_hz().round() as u16);
        finger.filter = (hz > 0 && scans > 0).then(|| LowPass::new(hz, scans));
        if let Some(bias) = self.bias() {
            finger.restore_bias(&mut state, bias);
        }
        (finger, state)
    }

    fn levels<const N: usize>(&self, name: &str) -> Option<(f32, [f32; N])> {
        let numbers = self
            .facts
            .get(name)?
            .split(' ')
            .map(|text| text.parse().ok().filter(|value: &f32| value.is_finite()));
        let numbers: Vec<f32> = numbers.collect::<Option<_>>()?;
        let (noise, levels) = numbers.split_first()?;
        Some((*noise, levels.try_into().ok()?))
    }
}
