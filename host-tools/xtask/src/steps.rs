//! Steps of a long task, with headings and times.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};

/// Finished steps and left-out parts of a task.
pub struct Steps {
    start: Instant,
    done: Vec<(String, Duration)>,
    left_out: Vec<String>,
}

impl Default for Steps {
    fn default() -> Self {
        Self { start: Instant::now(), done: Vec::new(), left_out: Vec::new() }
    }
}

impl Steps {
    /// Runs one step under a heading and records its time.
    pub fn take<T>(&mut self, name: &str, step: impl FnOnce() -> Result<T>) -> Result<T> {
        eprintln!("\n── {name} ──");
        let start = Instant::now();
        let outcome = step().with_context(|| format!("{name} failed"))?;
        let took = start.elapsed();
        eprintln!("── {name}: {:.1} s ──", took.as_secs_f64());
        self.done.push((name.to_owned(), took));
        Ok(outcome)
    }

    /// Runs two rows of steps in parallel; returns the first error of either after both end.
    pub fn side_by_side(
        &mut self,
        one: impl FnOnce(&mut Self) -> Result<()>,
        other: impl FnOnce(&mut Self) -> Result<()> + Send,
    ) -> Result<()> {
        std::thread::scope(|scope| {
            let other = scope.spawn(|| {
                let mut steps = Self::default();
                other(&mut steps).map(|()| steps)
            });
            let one = one(self);
            let other = other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            one?;
            let Self { done, left_out, .. } = other?;
            self.done.extend(done);
            self.left_out.extend(left_out);
            Ok(())
        })
    }

    /// Records a part that is not tested, with the reason.
    pub fn leave_out(&mut self, what: &str, why: &str) {
        eprintln!("\n── {what}: left out ({why}) ──");
        self.left_out.push(format!("{what} ({why})"));
    }

    /// Prints the time of each step; prints nothing where no step ran.
    pub fn summary(&self) {
        if self.done.is_empty() {
            return;
        }
        eprintln!();
        for (name, took) in &self.done {
            eprintln!("{:6.1} s  {name}", took.as_secs_f64());
        }
        let left_out = match self.left_out.as_slice() {
            [] => String::new(),
            list => format!("; left out: {}", list.join(", ")),
        };
        let cpu = children_cpu().map(|cpu| format!(", {} s of processors", cpu.as_secs()));
        eprintln!(
            "\nxtask: all {} steps passed in {:.0} s{}{left_out}",
            self.done.len(),
            self.start.elapsed().as_secs_f64(),
            cpu.unwrap_or_default()
        );
    }
}

/// Returns the processor time of all ended child programs, where the kernel reports it.
fn children_cpu() -> Option<Duration> {
    /// Ticks a second in `/proc` on Linux.
    const TICKS: u64 = 100;
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // Fields follow the program's name, which may hold spaces: 16 and 17 are the children's times.
    let mut fields = stat.rsplit_once(')')?.1.split_ascii_whitespace().skip(13);
    let mut next = || fields.next()?.parse::<u64>().ok();
    Some(Duration::from_millis((next()? + next()?) * 1000 / TICKS))
}
