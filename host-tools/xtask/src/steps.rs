//! Steps of a long task, with headings and times.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};

/// Finished steps and left-out parts of a task.
pub struct Steps {
    start: Instant,
    done: Vec<Step>,
    left_out: Vec<String>,
    /// Whether the steps after a failed one run too; then [`Self::summary`] reports the failure.
    pub keep_going: bool,
}

/// Finished step.
struct Step {
    name: String,
    took: Duration,
    failed: bool,
}

impl Default for Steps {
    fn default() -> Self {
        Self::new(false)
    }
}

impl Steps {
    fn new(keep_going: bool) -> Self {
        Self { start: Instant::now(), done: Vec::new(), left_out: Vec::new(), keep_going }
    }

    /// Runs one step under a heading and records its time.
    pub fn take<T>(&mut self, name: &str, step: impl FnOnce() -> Result<T>) -> Result<()> {
        eprintln!("\n── {name} ──");
        let start = Instant::now();
        let outcome = step().with_context(|| format!("{name} failed"));
        let (took, failed) = (start.elapsed(), outcome.is_err());
        if let Err(error) = outcome {
            if !self.keep_going {
                return Err(error);
            }
            eprintln!("xtask: {error:#}");
        }
        eprintln!("── {name}: {:.1} s ──", took.as_secs_f64());
        self.done.push(Step { name: name.to_owned(), took, failed });
        Ok(())
    }

    /// Runs two rows of steps in parallel; returns the first error of either after both end.
    pub fn side_by_side(
        &mut self,
        one: impl FnOnce(&mut Self) -> Result<()>,
        other: impl FnOnce(&mut Self) -> Result<()> + Send,
    ) -> Result<()> {
        let keep_going = self.keep_going;
        std::thread::scope(|scope| {
            let other = scope.spawn(move || {
                let mut steps = Self::new(keep_going);
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
    ///
    /// # Errors
    /// A step failed.
    pub fn summary(&self) -> Result<()> {
        if self.done.is_empty() {
            return Ok(());
        }
        eprintln!();
        for Step { name, took, failed } in &self.done {
            eprintln!(
                "{:6.1} s  {name}{}",
                took.as_secs_f64(),
                if *failed { ": FAILED" } else { "" }
            );
        }
        let left_out = match self.left_out.as_slice() {
            [] => String::new(),
            list => format!("; left out: {}", list.join(", ")),
        };
        let cpu = children_cpu().map(|cpu| format!(", {} s of processors", cpu.as_secs()));
        let (steps, failed) =
            (self.done.len(), self.done.iter().filter(|step| step.failed).count());
        eprintln!(
            "\nxtask: {} of {steps} steps passed in {:.0} s{}{left_out}",
            steps - failed,
            self.start.elapsed().as_secs_f64(),
            cpu.unwrap_or_default()
        );
        ensure!(failed == 0, "{failed} of {steps} steps failed; their messages are above");
        Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;

    fn failing() -> Result<()> {
        anyhow::bail!("as asked")
    }

    #[test]
    fn failed_step_ends_the_task_unless_it_keeps_going() {
        let mut steps = Steps::new(false);
        assert!(steps.take("one", failing).is_err());
        let mut steps = Steps::new(true);
        steps
            .side_by_side(|one| one.take("one", failing), |two| two.take("two", || Ok(())))
            .unwrap();
        assert_eq!(steps.done.len(), 2);
        assert_eq!(
            steps.summary().unwrap_err().to_string(),
            "1 of 2 steps failed; their messages are above"
        );
    }
}
