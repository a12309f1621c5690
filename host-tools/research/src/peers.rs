//! Chart of the core's net against other libraries' nets: `peers.csv`.
//!
//! The program `taxel-research peers` counts the cycles and writes the table.

use std::path::Path;

use taxel_files::save;

use crate::bars::{self, Bar};
use crate::picture::save_page;
use anyhow::Context;

const COMMITTED: &str = include_str!("../../emulator/data/peers.csv");

/// One implementation; no cost where it could not be built.
struct Peer {
    name: String,
    max_error: String,
    cycles: Option<f64>,
}

/// Writes table and picture into `folder`.
///
/// # Errors
/// One of them cannot be written, or the committed table is none.
pub fn write(folder: &Path) -> anyhow::Result<()> {
    let bars = bars(&parse(COMMITTED).context("host-tools/emulator/data/peers.csv")?);
    let title = "The 16-16-3 net with tanh units, modelled Cortex-M4F cycles a call";
    save(folder.join("peers.csv"), COMMITTED)?;
    let picture = bars::draw(title, &bars)?;
    picture.save(folder.join("peers.svg"))?;
    save_page(folder.join("peers.html"), "Compared with other people's nets", title, &[&picture])
}

fn parse(table: &str) -> anyhow::Result<Vec<Peer>> {
    let mut reader = csv::Reader::from_reader(table.as_bytes());
    let rows = reader.records().map(|row| {
        let row = row?;
        let cell = |i: usize| row.get(i).unwrap_or_default();
        let [low, high] = [3, 4].map(|i| cell(i).parse::<f64>().ok());
        Ok(Peer {
            name: cell(0).to_owned(),
            max_error: cell(2).to_owned(),
            cycles: low.zip(high).map(|(low, high)| (low + high) / 2.0),
        })
    });
    rows.collect()
}

/// Lists a bar for each implementation: cycles, error and ratio to the first one's cycles.
fn bars(peers: &[Peer]) -> Vec<Bar> {
    let own = peers.first().and_then(|peer| peer.cycles);
    let figures = |(i, peer): (usize, &Peer)| match (peer.cycles, own) {
        (Some(cycles), Some(own)) if i > 0 => {
            let ratio = cycles / own;
            format!("{cycles:.0}, {ratio:.2} times as many; error ≤ {}", peer.max_error)
        }
        (Some(cycles), _) => format!("{cycles:.0}; error ≤ {}", peer.max_error),
        _ => "not built".to_owned(),
    };
    let bar = |(i, peer): (usize, &Peer)| Bar {
        name: peer.name.clone(),
        long: peer.cycles,
        figures: figures((i, peer)),
        own: peer.name.starts_with("taxel"),
    };
    peers.iter().enumerate().map(bar).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn committed_table_begins_with_the_core() {
        let peers = parse(COMMITTED).unwrap();
        assert_eq!(peers[0].name, "taxel");
        assert!(peers.len() > 2 && peers.iter().all(|peer| !peer.name.is_empty()));
        assert!(peers[0].cycles.is_some());
    }
}
