//! Comparison of other libraries' nets with the core's: `peers.csv`.
//!
//! All run the 16-16-3 net of [DeMaria2011] on the same machine, on the same signals of a finger in
//! contact, with the same cost tables. Errors are against the net in `f64`.

use std::fmt::Write as _;

use anyhow::{Context, Result, bail, ensure};
use taxel::estimate::net::{ForceNet, Unit};
use taxel::scan::TAXELS;

use crate::bench::{Event, Stage, next};
use crate::clock::Count;
use crate::machine::{Machine, SHARED};

/// Outputs of the net: f_x, f_y, f_z.
const OUTPUTS: usize = 3;

/// Figures of one implementation of the net.
pub struct Peer {
    /// Library, and its compiler and options.
    pub name: String,
    /// Largest error of an output in newtons; outputs go up to 8 N.
    pub max_error: f64,
    /// Largest count of a call, each figure on its own.
    pub worst: Count,
}

/// Outputs of the net, computed in `f64`.
fn exact(net: &ForceNet, c: &[f32; TAXELS]) -> Vec<f64> {
    let wide = |x: &f32| f64::from(*x);
    let mut outputs: Vec<f64> = net.output_bias.iter().map(wide).collect();
    for Unit { weights, bias, output } in &net.units {
        let terms = weights.iter().zip(c).map(|(w, c)| wide(w) * wide(c));
        let activation = (wide(bias) + terms.sum::<f64>()).tanh();
        outputs.iter_mut().zip(output).for_each(|(y, v)| *y += wide(v) * activation);
    }
    outputs
}

fn largest_error(net: &ForceNet, c: &[f32; TAXELS], found: &[f32]) -> f64 {
    let errors = exact(net, c).into_iter().zip(found).map(|(y, f)| (y - f64::from(*f)).abs());
    errors.fold(0.0, f64::max)
}

/// Figures of the core's own net; `forces` computes it on this host.
///
/// The machine gives the same bits ([`crate::bench`] checks that).
pub fn own(
    name: &str,
    stage: &Stage,
    net: &ForceNet,
    inputs: &[[f32; TAXELS]],
    forces: impl Fn(&[f32; TAXELS]) -> heapless::Vec<f32, OUTPUTS>,
) -> Peer {
    let errors = inputs.iter().map(|c| largest_error(net, c, &forces(c)));
    Peer { name: name.into(), max_error: errors.fold(0.0, f64::max), worst: stage.worst() }
}

/// Runs the image of `peers/peers.c` in `elf`; `with` is its compiler and options.
///
/// `signal` is the value of a signal of 1.0 in 16 bits.
pub fn run(
    elf: &[u8],
    with: &str,
    (net, signal): (&ForceNet, f32),
    inputs: &[[f32; TAXELS]],
) -> Result<Vec<Peer>> {
    let mut machine = Machine::new(elf)?;
    machine.write(SHARED, &given(net, signal, inputs)?)?;
    let mut peers: Vec<(Stage, f64)> = Vec::new();
    let mut said = String::new();
    while let Some(event) = next(&mut machine, &mut said)? {
        match event {
            Event::Call { name, function } => {
                if peers.last().is_none_or(|(stage, _)| stage.name != name) {
                    peers.push((Stage { name, calls: Vec::new() }, 0.0));
                }
                machine.clock().await_call(function);
            }
            Event::Result(bytes) => {
                let (stage, error) = peers.last_mut().context("a result without a call")?;
                let count = machine.clock().take_measured();
                let name = &stage.name;
                let count = count.with_context(|| format!("{name}: the call did not return"))?;
                let c =
                    inputs.get(stage.calls.len()).context("more calls than inputs in the image")?;
                let words = bytes.as_chunks::<4>().0;
                let y: Vec<f32> = words.iter().map(|word| f32::from_le_bytes(*word)).collect();
                ensure!(y.len() == OUTPUTS, "{name}: gives {} outputs", y.len());
                *error = largest_error(net, c, &y).max(*error);
                stage.calls.push(count);
            }
            Event::Compared { name, .. } => bail!("{name}: only the core compares with this host"),
        }
    }
    let peer = |(stage, max_error): (Stage, f64)| Peer {
        name: format!("{}, {with}", stage.name),
        max_error,
        worst: stage.worst(),
    };
    Ok(peers.into_iter().map(peer).collect())
}

/// Bytes of `struct given` in peers.c.
fn given(net: &ForceNet, signal: f32, inputs: &[[f32; TAXELS]]) -> Result<Vec<u8>> {
    let count = u32::try_from(inputs.len())?;
    let weights = net.hidden().chain(net.hidden_bias()).chain(net.output());
    let weights = weights.chain(net.output_bias.iter().copied());
    let numbers = std::iter::once(signal).chain(weights).chain(inputs.iter().flatten().copied());
    let numbers = numbers.flat_map(f32::to_le_bytes);
    let mut bytes: Vec<u8> = [0; 4].into_iter().chain(count.to_le_bytes()).chain(numbers).collect();
    let length = u32::try_from(bytes.len() - 4)?;
    bytes[..4].copy_from_slice(&length.to_le_bytes());
    Ok(bytes)
}

/// Keeps the build of each library that takes the fewest cycles, in order of first appearance.
pub fn best(peers: Vec<Peer>) -> Vec<Peer> {
    let library = |peer: &Peer| peer.name.split(',').next().unwrap_or_default().to_owned();
    let mut best: Vec<Peer> = Vec::new();
    for peer in peers {
        match best.iter_mut().find(|other| library(other) == library(&peer)) {
            None => best.push(peer),
            Some(other) if peer.worst.cycles.high < other.worst.cycles.high => *other = peer,
            Some(_) => {}
        }
    }
    best
}

/// Table as CSV; `missing` lists the libraries that could not be built, with the reason.
pub fn csv(peers: &[Peer], missing: &[String]) -> String {
    let mut table = String::from(
        "name,net,max_error,cycles_low,cycles_high,instructions,cycles_least,cycles_most\n",
    );
    for Peer { name, max_error, worst } in peers {
        let (low, high) = (worst.cycles.low, worst.cycles.high);
        let (least, most) = (worst.bounds.low, worst.bounds.high);
        // Writing into a string cannot fail.
        let _ = writeln!(
            table,
            "\"{name}\",16-16-3,{max_error:.1e},{low},{high},{},{least},{most}",
            worst.instructions
        );
    }
    for name in missing {
        let _ = writeln!(table, "\"{name}\",16-16-3,,,,,,");
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peer(name: &str, high: u64) -> Peer {
        let mut worst = Count::default();
        worst.cycles.high = high;
        Peer { name: name.into(), max_error: 0.0, worst }
    }

    #[test]
    fn best_keeps_fastest_build_of_each_library() {
        let all = vec![peer("a, -O2", 9), peer("b, -O2", 4), peer("a, -O3", 7), peer("b, -O3", 5)];
        let names: Vec<String> = best(all).into_iter().map(|peer| peer.name).collect();
        assert_eq!(names, ["a, -O3", "b, -O2"]);
    }

    #[test]
    fn missing_peer_is_listed_without_figures() {
        let table = csv(&[peer("a, -O2", 9)], &["b: no sources".into()]);
        assert!(
            table
                .ends_with("\"a, -O2\",16-16-3,0.0e0,0,9,0,0,0\n\"b: no sources\",16-16-3,,,,,,\n")
        );
    }
}
