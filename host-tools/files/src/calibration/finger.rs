//! Readable form of a finger's record: weights in rows, numbered sensors, the date as a date.

use serde::{Deserialize, Serialize};
use taxel::calibration::{Calibration, Range, SensorCalibration, TaxelCalibration};
use taxel::condition::{
    BridgeBias, DriftCompensation, LagCompensation, TaxelBias, TemperatureCompensation,
};
use taxel::estimate::array::Array;
use taxel::estimate::inverse::Inverse;
use taxel::estimate::net::{ForceNet, Layers, MAX_HIDDEN};
use taxel::estimate::quantised::Net as RecordNet;
use taxel::estimate::sensitivity::Sensitivity;
use taxel::estimate::slip::Slip;
use taxel::scan::TAXELS;

use super::date;
use super::quantised::Quantised;

/// Units of every number in a finger's file; a file with other units is rejected.
const UNITS: &str = "N, mm, N*mm; signals as fractions of full scale";

#[derive(Serialize, Deserialize)]
pub(super) struct FingerFile {
    serial: String,
    date: String,
    units: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    taxels: Option<Taxels>,
    #[serde(skip_serializing_if = "Option::is_none")]
    force: Option<Net>,
    #[serde(skip_serializing_if = "Option::is_none")]
    quantised: Option<Quantised>,
    #[serde(skip_serializing_if = "Option::is_none")]
    model: Option<Inverse>,
    #[serde(skip_serializing_if = "Option::is_none")]
    slip: Option<Slip>,
    #[serde(skip_serializing_if = "Option::is_none")]
    warmth: Option<TemperatureCompensation>,
    #[serde(skip_serializing_if = "Option::is_none")]
    lag: Option<LagCompensation>,
    #[serde(skip_serializing_if = "Option::is_none")]
    drift: Option<DriftCompensation>,
    #[serde(skip_serializing_if = "Option::is_none")]
    array: Option<Array>,
    #[serde(default, rename = "sensor", skip_serializing_if = "Vec::is_empty")]
    sensors: Vec<Sensor>,
}

#[derive(Serialize, Deserialize)]
struct Taxels {
    /// Unloaded level of each taxel as a share of full scale.
    bias: [f32; TAXELS],
    noise: f32,
    range: [Range; TAXELS],
    residual_n: [f32; 3],
}

#[derive(Serialize, Deserialize)]
struct Net {
    hidden: Vec<Vec<f32>>,
    hidden_bias: Vec<f32>,
    output: Vec<Vec<f32>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    skip: Vec<Vec<f32>>,
    output_bias: Vec<f32>,
}

#[derive(Serialize, Deserialize)]
struct Sensor {
    sensor: usize,
    bias: [f32; 3],
    noise: f32,
    range: [Range; 3],
    residual_n: [f32; 3],
    sensitivity: [[f32; 3]; 3],
}

impl FingerFile {
    pub(super) fn new(calibration: &Calibration) -> Self {
        let taxels = calibration.taxels.as_ref().map(|taxels| Taxels {
            bias: taxels.bias.level,
            noise: taxels.bias.noise,
            range: taxels.range,
            residual_n: taxels.residual,
        });
        let net = calibration.net.as_ref();
        let force = net.and_then(RecordNet::float).map(|net| Net {
            hidden: net.units.iter().map(|unit| unit.weights.to_vec()).collect(),
            hidden_bias: net.hidden_bias().collect(),
            output: rows(&net.output().collect::<Vec<_>>(), net.units.len()),
            skip: rows(net.straight(), TAXELS),
            output_bias: net.output_bias.to_vec(),
        });
        let sensors = calibration.sensors.iter().enumerate().filter_map(|(i, sensor)| {
            sensor.as_ref().map(|sensor| Sensor {
                sensor: i,
                bias: sensor.bias.level,
                noise: sensor.bias.noise,
                range: sensor.range,
                residual_n: sensor.residual,
                sensitivity: sensor.sensitivity.0,
            })
        });
        Self {
            serial: calibration.serial.as_str().to_owned(),
            date: date::to_text(calibration.date),
            units: UNITS.to_owned(),
            taxels,
            force,
            quantised: net.and_then(RecordNet::quantised).map(Quantised::new),
            model: calibration.model.clone(),
            slip: calibration.slip,
            warmth: calibration.warmth,
            lag: calibration.lag,
            drift: calibration.drift,
            array: calibration.array,
            sensors: sensors.collect(),
        }
    }

    /// Returns the record, or the key that does not fit and the reason.
    pub(super) fn calibration(self) -> Result<Calibration, (&'static str, String)> {
        if self.units != UNITS {
            return Err(("units", format!("`{}` where this build knows `{UNITS}`", self.units)));
        }
        let mut calibration = Calibration {
            serial: heapless::String::try_from(self.serial.as_str())
                .map_err(|_| ("serial", "more than 32 bytes".to_owned()))?,
            date: date::from_text(&self.date).map_err(|problem| ("date", problem))?,
            ..Calibration::default()
        };
        if let Some(taxels) = self.taxels {
            calibration.taxels = Some(TaxelCalibration {
                bias: TaxelBias { level: taxels.bias, noise: taxels.noise },
                range: taxels.range,
                residual: taxels.residual_n,
            });
        }
        let force = self.force.map(Net::weights).transpose()?;
        let quantised = self.quantised.map(Quantised::net).transpose()?;
        // As in a record, the net in f32 is used if there are both.
        calibration.net =
            force.map(RecordNet::Float).or_else(|| quantised.map(RecordNet::Quantised));
        (calibration.model, calibration.slip, calibration.array) =
            (self.model, self.slip, self.array);
        (calibration.warmth, calibration.lag) = (self.warmth, self.lag);
        calibration.drift = self.drift;
        for sensor in self.sensors {
            let number = sensor.sensor;
            let slot = calibration
                .sensors
                .get_mut(number)
                .ok_or_else(|| ("sensor", format!("there is no sensor {number}: 0…3")))?;
            *slot = Some(SensorCalibration {
                bias: BridgeBias { level: sensor.bias, noise: sensor.noise },
                sensitivity: Sensitivity(sensor.sensitivity),
                range: sensor.range,
                residual: sensor.residual_n,
            });
        }
        Ok(calibration)
    }
}

impl Net {
    fn weights(self) -> Result<ForceNet, (&'static str, String)> {
        let layers = Layers {
            hidden: &flat("hidden", &self.hidden, TAXELS)?,
            hidden_bias: &self.hidden_bias,
            output: &flat("output", &self.output, self.hidden_bias.len())?,
            skip: &flat("skip", &self.skip, TAXELS)?,
            output_bias: &self.output_bias,
        };
        ForceNet::new(&layers).map_err(|key| (key, self.lengths()))
    }

    fn lengths(&self) -> String {
        let [rows, units, output, skip, outputs] = [
            self.hidden.len(),
            self.hidden_bias.len(),
            self.output.len(),
            self.skip.len(),
            self.output_bias.len(),
        ];
        format!(
            "rows: {rows} of hidden for {units} of hidden_bias (as many, at most {MAX_HIDDEN}), {output} of \
             output and {skip} of skip for {outputs} of output_bias (one or three; of skip none or as many)"
        )
    }
}

fn rows(flat: &[f32], width: usize) -> Vec<Vec<f32>> {
    flat.chunks(width.max(1)).map(<[f32]>::to_vec).collect()
}

fn flat(
    key: &'static str,
    rows: &[Vec<f32>],
    width: usize,
) -> Result<Vec<f32>, (&'static str, String)> {
    if let Some(row) = rows.iter().find(|row| row.len() != width) {
        return Err((key, format!("a row of {} weights where {width} belong", row.len())));
    }
    Ok(rows.concat())
}
