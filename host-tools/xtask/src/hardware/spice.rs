//! Runs of ngspice, and measurements on its waveforms.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, ensure};

use crate::run::{program, target};

/// Help for a machine without ngspice.
const MISSING: &str = "ngspice is needed: `.ci/setup spice`, or `sudo apt-get install ngspice`";

/// Voltages of some nodes over time.
#[derive(Clone, Debug)]
pub struct Waves {
    /// Times in seconds.
    pub time: Vec<f64>,
    /// Voltages of each node.
    pub nodes: Vec<Vec<f64>>,
}

impl Waves {
    /// Voltage of a node at a time, between two points of the waveform.
    #[must_use]
    pub fn at(&self, node: usize, time: f64) -> f64 {
        let (times, values) = (&self.time, &self.nodes[node]);
        let after = times.partition_point(|t| *t < time).clamp(1, times.len() - 1);
        let share = (time - times[after - 1]) / (times[after] - times[after - 1]);
        values[after - 1] + share * (values[after] - values[after - 1])
    }

    /// Time from `from` until a node stays within `band` of `value` up to `to`.
    #[must_use]
    pub fn settles(&self, node: usize, (from, to): (f64, f64), value: f64, band: f64) -> f64 {
        let outside =
            |(time, v): &(&f64, &f64)| **time >= from && **time < to && (*v - value).abs() > band;
        let last = self.time.iter().zip(&self.nodes[node]).rfind(outside);
        last.map_or(0.0, |(time, _)| time - from)
    }
}

/// Simulates `length` seconds and returns the voltages of `nodes`.
pub fn transient(deck: &str, longest_step: f64, length: f64, nodes: &[&str]) -> Result<Waves> {
    let folder = Folder::new()?;
    let vectors: Vec<String> = nodes.iter().map(|node| format!("v({node})")).collect();
    let control = format!(
        "set wr_singlescale\ntran {longest_step:e} {length:e} 0 {longest_step:e}\nwrdata waves.txt {}\n",
        vectors.join(" ")
    );
    run(deck, &control, &folder)?;
    let text = std::fs::read_to_string(folder.0.join("waves.txt")).context("no waveforms")?;
    let mut waves = Waves { time: Vec::new(), nodes: vec![Vec::new(); nodes.len()] };
    for line in text.lines() {
        let numbers = line.split_whitespace().map(str::parse::<f64>);
        let numbers = numbers.collect::<Result<Vec<_>, _>>().context("waves.txt")?;
        ensure!(numbers.len() == nodes.len() + 1, "waves.txt: {line}");
        waves.time.push(numbers[0]);
        waves.nodes.iter_mut().zip(&numbers[1..]).for_each(|(node, value)| node.push(*value));
    }
    ensure!(waves.time.last().is_some_and(|end| *end > 0.99 * length), "simulation ended early");
    Ok(waves)
}

/// Noise at a node.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    /// Density at 1 kHz in volts per root hertz.
    pub density: f64,
    /// Standard deviation in volts, 1 kHz to 100 MHz.
    pub total: f64,
}

impl Noise {
    /// Correlation time in seconds of first-order noise with this density and standard deviation.
    #[must_use]
    pub fn correlation(&self) -> f64 {
        (self.density / self.total).powi(2) / 4.0
    }
}

/// Computes the noise at `node`; the deck has a source `Vs`.
pub fn noise(deck: &str, node: &str) -> Result<Noise> {
    let folder = Folder::new()?;
    let control = format!(
        "noise v({node}) Vs dec 20 1k 100meg\nsetplot noise1\nprint onoise_spectrum[0]\nsetplot \
         noise2\nprint onoise_total\n"
    );
    let output = run(deck, &control, &folder)?;
    let value = |name: &str| -> Result<f64> {
        let line = output.lines().find_map(|line| line.strip_prefix(name));
        let value = line.and_then(|line| line.trim().strip_prefix('='));
        value.with_context(|| format!("no {name} in:\n{output}"))?.trim().parse().context("noise")
    };
    Ok(Noise { density: value("onoise_spectrum[0]")?, total: value("onoise_total")? })
}

/// Runs the deck with its commands and returns what ngspice prints.
fn run(deck: &str, control: &str, folder: &Folder) -> Result<String> {
    let deck = format!("{deck}.control\n{control}quit\n.endc\n.end\n");
    std::fs::write(folder.0.join("deck.cir"), &deck)?;
    let output =
        program("ngspice", &folder.0).args(["-b", "deck.cir"]).output().context(MISSING)?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr);
    let failed = ["Error", "error", "Timestep too small", "singular matrix", "aborted"];
    let complaint = errors.lines().find(|line| failed.iter().any(|word| line.contains(word)));
    ensure!(complaint.is_none(), "ngspice: {}\n{deck}", complaint.unwrap_or_default());
    Ok(text)
}

/// Folder of one run below the target folder.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Result<Self> {
        static RUNS: AtomicUsize = AtomicUsize::new(0);
        let run = RUNS.fetch_add(1, Ordering::Relaxed);
        let folder = target().join(format!("spice/{}-{run}", std::process::id()));
        std::fs::create_dir_all(&folder)?;
        Ok(Self(folder))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
