//! Readable form of the 16-bit net: a row for each unit and each output, as in f32.

use serde::{Deserialize, Serialize};
use taxel::estimate::net::MAX_OUTPUTS;
use taxel::estimate::quantised::{GROUP, Group, QuantisedNet, Rows};
use taxel::scan::TAXELS;

/// Key that does not fit, with the reason.
type Wrong = (&'static str, String);

#[derive(Serialize, Deserialize)]
pub(super) struct Quantised {
    signal: f32,
    shift: u8,
    hidden: Vec<[i16; TAXELS]>,
    hidden_bias: Vec<i32>,
    output: Vec<Vec<i16>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    skip: Option<[[i16; TAXELS]; MAX_OUTPUTS]>,
    scale: [f32; 2],
    output_bias: Vec<f32>,
}

impl Quantised {
    pub(super) fn new(net: &QuantisedNet) -> Self {
        let rows = |k: usize| net.output.iter().flat_map(move |rows| rows.weights()[k]).collect();
        Self {
            signal: net.signal,
            shift: net.shift,
            hidden: net.hidden.iter().flat_map(|group| group.weights.weights()).collect(),
            hidden_bias: net.hidden.iter().flat_map(|group| group.bias).collect(),
            output: (0..MAX_OUTPUTS).map(rows).collect(),
            skip: net.skip.map(|rows| rows.weights()),
            scale: net.scale,
            output_bias: net.output_bias.to_vec(),
        }
    }

    pub(super) fn net(self) -> Result<QuantisedNet, Wrong> {
        let (rows, rest) = self.hidden.as_chunks::<GROUP>();
        let (biases, no_rest) = self.hidden_bias.as_chunks::<GROUP>();
        if !rest.is_empty() || !no_rest.is_empty() || rows.len() != biases.len() {
            let problem = format!(
                "{} units with {} biases: units come in fours, each with one",
                self.hidden.len(),
                self.hidden_bias.len()
            );
            return Err(("hidden", problem));
        }
        let groups = rows
            .iter()
            .zip(biases)
            .map(|(weights, bias)| Group { bias: *bias, weights: Rows::new(weights) });
        let width = self.output.first().map_or(0, Vec::len);
        let even = self.output.iter().all(|row| row.len() == width);
        if self.output.len() != MAX_OUTPUTS || !even || !width.is_multiple_of(TAXELS) {
            let problem =
                format!("expected {MAX_OUTPUTS} rows of as many weights, a multiple of {TAXELS}");
            return Err(("output", problem));
        }
        let block = |i: usize| {
            let row = |k: usize| self.output[k].as_chunks::<TAXELS>().0[i];
            Rows::new(&std::array::from_fn(row))
        };
        Ok(QuantisedNet {
            signal: self.signal,
            shift: self.shift,
            hidden: fitting("hidden", groups)?,
            output: fitting("output", (0..width / TAXELS).map(block))?,
            skip: self.skip.map(|rows| Rows::new(&rows)),
            scale: self.scale,
            output_bias: fitting("output_bias", self.output_bias.iter().copied())?,
        })
    }
}

fn fitting<T, const N: usize>(
    key: &'static str,
    parts: impl Iterator<Item = T>,
) -> Result<heapless::Vec<T, N>, Wrong> {
    let mut fitting = heapless::Vec::new();
    for part in parts {
        fitting.push(part).map_err(|_| (key, "more of them than a record can hold".to_owned()))?;
    }
    Ok(fitting)
}
