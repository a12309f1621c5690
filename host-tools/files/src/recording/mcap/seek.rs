//! Finds the chunk of a time, without reading those before it.
//!
//! Chunks are found by the lengths of their records and searched by halves. Device time must never
//! go back, which it does if the finger restarted: then, and wherever a chunk cannot be read, there
//! is no answer and the file has to be read from its start.

use std::fs::File;
use std::io;
use std::path::Path;

use mcap::records::Record;

use super::container::{Container, Found};
use crate::frames::{Cell, Column};
use crate::recording::{in_order, schema};

/// Returns where the last chunk begins whose first row is not after `micros` of device time.
pub(super) fn chunk_before(
    path: &Path,
    micros: u64,
    (channel, columns): &(u16, Vec<Column>),
) -> io::Result<Option<u64>> {
    let mut container = Container::new(File::open(path)?)?;
    let Some(starts) = container.chunks()? else { return Ok(None) };
    let mut chunks = Chunks { container, channel: *channel, columns };
    // The first chunks may hold the schema alone.
    let mut first = None;
    let mut begin = 0;
    for start in &starts {
        let Some(rows) = chunks.rows(*start)? else { return Ok(None) };
        first = rows.into_iter().next();
        if first.is_some() {
            break;
        }
        begin += 1;
    }
    let starts = starts.get(begin..).unwrap_or_default();
    let (Some(first), Some(last)) = (first, starts.last()) else { return Ok(None) };
    let last = chunks.rows(*last)?.and_then(|rows| rows.into_iter().next_back());
    if !last.is_some_and(|last| chunks.in_order(&first, &last)) {
        return Ok(None);
    }
    // Those below `low` begin in time, those from `high` on too late.
    let (mut low, mut high) = (0, starts.len());
    while low < high {
        let middle = low + (high - low) / 2;
        let Some(start) = starts.get(middle) else { return Ok(None) };
        let rows = chunks.rows(*start)?;
        let Some(time) = rows.and_then(|rows| chunks.whole(rows.first()?, "t_us")) else {
            return Ok(None);
        };
        if time <= micros {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    Ok(low.checked_sub(1).and_then(|at| starts.get(at)).copied())
}

struct Chunks<'c> {
    container: Container,
    channel: u16,
    columns: &'c [Column],
}

impl Chunks<'_> {
    /// Reads the rows of the chunk that begins at `start`; `None` if they are damaged.
    fn rows(&mut self, start: u64) -> io::Result<Option<Vec<Vec<Cell>>>> {
        self.container.jump(start)?;
        let Some(Found::Chunk(chunk)) = self.container.next()? else { return Ok(None) };
        let Ok(records) = chunk.records() else { return Ok(None) };
        let mut rows = Vec::new();
        for record in records {
            match record {
                Ok(Record::Message { header, data }) if header.channel_id == self.channel => {
                    match schema::decode(&data, self.columns) {
                        Some(row) => rows.push(row),
                        None => return Ok(None),
                    }
                }
                Ok(_) => {}
                Err(_) => return Ok(None),
            }
        }
        Ok(Some(rows))
    }

    fn whole(&self, row: &[Cell], name: &str) -> Option<u64> {
        let at = self.columns.iter().position(|column| column.name == name)?;
        match row.get(at) {
            Some(Cell::Whole(value)) => Some(*value),
            _ => None,
        }
    }

    /// Returns whether the finger did not restart between the two rows.
    fn in_order(&self, first: &[Cell], last: &[Cell]) -> bool {
        in_order(|name| Some((self.whole(first, name)?, self.whole(last, name)?)))
    }
}
