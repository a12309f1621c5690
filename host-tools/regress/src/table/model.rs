//! Model of a table, in the form of its file.

use serde::{Deserialize, Serialize};
use taxel::calibration::Range;
use taxel::estimate::net::Layers;

use crate::model::Family;
use crate::network;
use crate::paper_models::Law;
use crate::polynomial::Expansion;

/// A net from N named inputs to some named targets, for [`taxel::estimate::net::Layers`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TableModel {
    /// Serial number of the sensor.
    #[serde(default)]
    pub serial: String,
    /// Date of the fit, seconds since 1970-01-01 UTC.
    #[serde(default, with = "taxel_files::calibration::date")]
    pub date: u64,
    /// Names of the input columns, in the order of the weights.
    pub inputs: Vec<String>,
    /// Names of the targets.
    pub targets: Vec<String>,
    /// Range of each input in training, margin included.
    pub range: Vec<Range>,
    /// Expansion of the inputs, less `centre`, into the terms that the weights multiply.
    #[serde(default)]
    pub expansion: Expansion,
    /// Offset subtracted from the inputs of an expansion; empty without one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub centre: Vec<f32>,
    /// Weights W of the hidden layer, a row a unit.
    pub hidden: Vec<f32>,
    /// Biases a of the hidden layer.
    pub hidden_bias: Vec<f32>,
    /// Weights V of the outputs, a row a target.
    pub output: Vec<f32>,
    /// Weights L of the skip path, a row a target; empty without one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub skip: Vec<f32>,
    /// Biases b of the outputs.
    pub output_bias: Vec<f32>,
    /// RMS error of the fit, in the targets' units.
    pub residual: Vec<f32>,
    /// Law of a paper, in place of the weights above.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub law: Option<Law>,
}

impl TableModel {
    /// Borrows the weights as layers for the core.
    #[must_use]
    pub fn layers(&self) -> Layers<'_> {
        Layers {
            hidden: &self.hidden,
            hidden_bias: &self.hidden_bias,
            output: &self.output,
            skip: &self.skip,
            output_bias: &self.output_bias,
        }
    }

    /// Estimates the targets for one row of inputs.
    #[must_use]
    pub fn estimate(&self, inputs: &[f32]) -> Vec<f32> {
        if let Some(law) = &self.law {
            return law.estimate(inputs);
        }
        let layers = self.layers();
        if self.expansion == Expansion::None {
            return network::outputs(layers, inputs);
        }
        let from_centre: Vec<f64> =
            inputs.iter().zip(&self.centre).map(|(x, c)| f64::from(x - c)).collect();
        network::outputs(layers, &super::to_f32(&self.expansion.terms(&from_centre)))
    }

    /// Shape of the model: `skip 15-16-1`, `cubic 15-1`, `row`.
    #[must_use]
    pub fn shape(&self) -> String {
        let (inputs, outputs) = (self.inputs.len(), self.targets.len());
        match (&self.law, self.expansion) {
            (Some(law), _) => law.family().to_string(),
            (None, Expansion::Cubic) => format!("{} {inputs}-{outputs}", Family::Cubic),
            (None, Expansion::Quadratic) => format!("{} {inputs}-{outputs}", Family::Quadratic),
            (None, Expansion::None) => {
                network::shape_name(inputs, self.hidden_bias.len(), outputs, !self.skip.is_empty())
            }
        }
    }

    /// Whether every input lies within the trained range.
    #[must_use]
    pub fn within_range(&self, inputs: &[f32]) -> bool {
        self.range.iter().zip(inputs).all(|([low, high], x)| (low..=high).contains(&x))
    }
}
