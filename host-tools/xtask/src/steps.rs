//! Steps of a long task, with headings and times.

use std::fmt;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};

/// Steps that were taken, and parts that were left out.
#[derive(Default)]
pub struct Steps {
    done: Vec<(String, Took)>,
    left_out: Vec<String>,
}

/// Time of a step on the wall, and of its programs on all processors.
#[derive(Clone, Copy, Default)]
struct Took {
    wall: Duration,
    cpu: Option<Duration>,
}

impl fmt::Display for Took {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{:.1} s", self.wall.as_secs_f64())?;
        self.cpu.map_or(Ok(()), |cpu| write!(f, ", CPU {:.1} s", cpu.as_secs_f64()))
    }
}

impl Steps {
    /// Takes one step.
    pub fn take<T>(&mut self, name: &str, step: impl FnOnce() -> Result<T>) -> Result<T> {
        eprintln!("\n── {name} ──");
        let (start, before) = (Instant::now(), children_cpu());
        let outcome = step().with_context(|| format!("{name} failed"))?;
        let cpu = before.zip(children_cpu()).map(|(before, after)| after - before);
        let took = Took { wall: start.elapsed(), cpu };
        eprintln!("── {name}: {took} ──");
        self.done.push((name.to_owned(), took));
        Ok(outcome)
    }

    /// Notes a part that is not tested, and why.
    pub fn leave_out(&mut self, what: &str, why: &str) {
        eprintln!("\n── {what}: left out ({why}) ──");
        self.left_out.push(format!("{what} ({why})"));
    }

    /// Prints what each step took and how it went; nothing where there were no steps.
    pub fn summary(&self) {
        if self.done.is_empty() {
            return;
        }
        eprintln!();
        for (name, took) in &self.done {
            eprintln!("{name}: {took}");
        }
        let total = self.done.iter().map(|(_, took)| took.wall).sum::<Duration>();
        let left_out = match self.left_out.as_slice() {
            [] => String::new(),
            list => format!("; left out: {}", list.join(", ")),
        };
        let count = self.done.len();
        eprintln!("\nxtask: all {count} steps passed in {:.0} s{left_out}", total.as_secs_f64());
    }
}

/// Processor time of all programs that ended so far, where the kernel tells.
fn children_cpu() -> Option<Duration> {
    /// Ticks a second in `/proc`, on every Linux of today.
    const TICKS: u64 = 100;
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // Behind the name, which may have spaces: from field 3 on; fields 16 and 17 are the children's.
    let mut fields = stat.rsplit_once(')')?.1.split_ascii_whitespace().skip(13);
    let mut next = || fields.next()?.parse::<u64>().ok();
    Some(Duration::from_millis((next()? + next()?) * 1000 / TICKS))
}
