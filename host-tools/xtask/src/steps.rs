//! Steps of a long task, with headings and times.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};

/// What has been done, and what has been left out.
#[derive(Default)]
pub struct Steps {
    done: Vec<(String, Duration)>,
    left_out: Vec<String>,
}

impl Steps {
    /// Takes one step.
    pub fn take<T>(&mut self, name: &str, step: impl FnOnce() -> Result<T>) -> Result<T> {
        eprintln!("\n── {name} ──");
        let start = Instant::now();
        let outcome = step().with_context(|| format!("{name} failed"))?;
        let took = start.elapsed();
        eprintln!("── {name}: {:.1} s ──", took.as_secs_f64());
        self.done.push((name.to_owned(), took));
        Ok(outcome)
    }

    /// Notes what has not been done, and why.
    pub fn leave_out(&mut self, what: &str, why: &str) {
        eprintln!("\n── {what}: left out ({why}) ──");
        self.left_out.push(format!("{what} ({why})"));
    }

    /// Says in one line how it went; nothing where there were no steps.
    pub fn summary(&self) {
        if self.done.is_empty() {
            return;
        }
        let total: Duration = self.done.iter().map(|(_, took)| took).sum();
        let left_out = match self.left_out.as_slice() {
            [] => String::new(),
            list => format!("; left out: {}", list.join(", ")),
        };
        let count = self.done.len();
        eprintln!("\nxtask: all {count} steps passed in {:.0} s{left_out}", total.as_secs_f64());
    }
}
