//! Tables of tasks: each stands in a CSV file and, between marks, on a page.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result};
use taxel_research::Waiting;

use crate::root;

/// Runs a measurement to its end, and tells its progress.
pub fn measured<R>(measure: impl FnOnce(Waiting<'_>) -> Result<R>) -> Result<R> {
    let progress = |share: f64, what: &str| eprintln!("{:3.0} %  {what}", 100.0 * share);
    measure(Waiting { progress: &progress, stop: &AtomicBool::new(false) })
}

/// Table of a task.
pub struct Table {
    /// Name of the task, of its CSV file and of its marks.
    pub task: &'static str,
    /// Page, from the root of the repository.
    pub page: &'static str,
    /// Text between the marks, from the content of the CSV file.
    pub section: fn(&str) -> Result<String>,
}

impl Table {
    pub fn csv(&self) -> PathBuf {
        root().join(format!("host-tools/research/data/{}.csv", self.task))
    }

    /// Draws the CSV file's content on the page.
    pub fn draw(&self) -> Result<()> {
        let [_, drawn] = self.drawn()?;
        Ok(std::fs::write(root().join(self.page), drawn)?)
    }

    /// Returns the page as it is, and with the CSV file's content.
    pub fn drawn(&self) -> Result<[String; 2]> {
        let page = std::fs::read_to_string(root().join(self.page))?;
        let text = (self.section)(&std::fs::read_to_string(self.csv())?)?;
        let [begin, end] =
            ["begin", "end"].map(|mark| format!("<!-- {mark}: taxel-research {} -->\n", self.task));
        let missing = |mark: &str| format!("{} has no line `{}`", self.page, mark.trim_end());
        let (before, rest) = page.split_once(&begin).with_context(|| missing(&begin))?;
        let (_, after) = rest.split_once(&end).with_context(|| missing(&end))?;
        let drawn = format!("{before}{begin}\n{text}\n{end}{after}");
        Ok([page, drawn])
    }
}

#[cfg(test)]
mod tests {
    use crate::{ablation, coverage, detection, effects, idle, slip};

    #[test]
    fn pages_have_the_tables_of_the_csv_files() {
        let tables = [
            ablation::TABLE,
            coverage::TABLE,
            detection::TABLE,
            effects::TABLE,
            idle::TABLE,
            slip::TABLE,
        ];
        for table in tables {
            let [page, drawn] = table.drawn().unwrap();
            let (name, task) = (table.page, table.task);
            assert!(page == drawn, "{name}: draw it with `taxel-research {task} --draw`");
        }
    }
}
