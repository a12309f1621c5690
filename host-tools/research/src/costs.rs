//! Cost of each stage on the emulated Cortex-M4F, from the table of `cargo xtask cycles`.
//!
//! The table is committed, so charts need neither the emulator nor a cross-compiler.

use anyhow::{Context, ensure};

const COMMITTED: &str = include_str!("../../emulator/data/cycles.csv");

/// Largest cost of any call.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cost {
    /// Executed instructions, an exact count.
    pub instructions: u64,
    /// Modelled cycles with every possible overlap.
    pub cycles_low: u64,
    /// Modelled cycles without any overlap.
    pub cycles_high: u64,
}

impl Cost {
    /// Returns the middle of the band of cycles.
    #[must_use]
    pub fn cycles(&self) -> f64 {
        (self.cycles_low + self.cycles_high) as f64 / 2.0
    }
}

impl std::ops::Add for Cost {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            instructions: self.instructions + other.instructions,
            cycles_low: self.cycles_low + other.cycles_low,
            cycles_high: self.cycles_high + other.cycles_high,
        }
    }
}

/// Costs by the name of the stage.
pub struct Costs(Vec<(String, Cost)>);

impl Costs {
    /// Reads the committed table.
    ///
    /// # Errors
    /// The table cannot be read.
    pub fn committed() -> anyhow::Result<Self> {
        Self::parse(COMMITTED).context("host-tools/emulator/data/cycles.csv")
    }

    fn parse(text: &str) -> anyhow::Result<Self> {
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let header = reader.headers()?;
        ensure!(
            header.iter().take(4).eq(["name", "instructions", "cycles_low", "cycles_high"]),
            "line 1: no table of costs; write it again with `cargo xtask cycles --csv`"
        );
        let rows = reader.records().map(|row| {
            let row = row?;
            let number = |i: usize| row.get(i).unwrap_or_default().parse::<u64>();
            let [instructions, cycles_low, cycles_high] = [number(1)?, number(2)?, number(3)?];
            let name = row.get(0).unwrap_or_default().to_owned();
            Ok((name, Cost { instructions, cycles_low, cycles_high }))
        });
        rows.collect::<anyhow::Result<_>>().map(Self)
    }

    /// Sums the costs of `stages`.
    ///
    /// # Errors
    /// A stage is not in the table.
    pub fn of<S: AsRef<str>>(&self, stages: &[S]) -> anyhow::Result<Cost> {
        stages.iter().try_fold(Cost::default(), |sum, stage| {
            let stage = stage.as_ref();
            let found = self.0.iter().find(|(name, _)| name == stage);
            let (_, cost) = found.with_context(|| {
                format!("{stage}: not in the table of costs; add it to boards/cycles")
            })?;
            Ok(sum + *cost)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_add_up_and_error_names_unknown_one() {
        let table = "name,instructions,cycles_low,cycles_high\n\"a, b\",1,2,3\nc,10,20,30\n";
        let costs = Costs::parse(table).unwrap();
        let both = Cost { instructions: 11, cycles_low: 22, cycles_high: 33 };
        assert_eq!(costs.of(&["a, b", "c"]).unwrap(), both);
        assert!(costs.of(&["d"]).unwrap_err().to_string().contains("boards/cycles"));
        assert!(Costs::parse("name,error\n").is_err());
    }
}
