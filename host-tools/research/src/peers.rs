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
    /// Ends of what the manual leaves open.
    bounds: String,
}

/// Writes table and picture into `folder`.
///
/// # Errors
/// One of them cannot be written, or the committed table is none.
pub fn write(folder: &Path) -> anyhow::Result<()> {
    let bars = bars(&parse(COMMITTED).context("host-tools/emulator/data/peers.csv")?);
    let title = "The 16-16-3 net with tanh units, modelled Cortex-M4F cycles a call (bounds)";
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
        let bounds = format!("{}–{}", cell(6), cell(7));
        Ok(Peer {
            name: cell(0).to_owned(),
            max_error: cell(2).to_owned(),
            cycles: low.zip(high).map(|(low, high)| (low + high) / 2.0),
            bounds,
        })
    });
    rows.collect()
}

/// Lists a bar for each implementation: cycles, error and ratio to the core's net of that
/// arithmetic.
fn bars(peers: &[Peer]) -> Vec<Bar> {
    let own = |q15| peers.iter().find(|peer| is_own(peer) && is_q15(peer) == q15)?.cycles;
    let figures = |peer: &Peer| match (peer.cycles, own(is_q15(peer))) {
        (Some(cycles), own) => {
            let ratio = own.filter(|_| !is_own(peer)).map(|own| cycles / own);
            let ratio = ratio.map_or(String::new(), |ratio| format!(", {ratio:.2} × taxel"));
            format!("{cycles:.0} ({}){ratio}; error ≤ {}", peer.bounds, peer.max_error)
        }
        _ => "not built".to_owned(),
    };
    let bar = |peer: &Peer| Bar {
        name: peer.name.clone(),
        long: peer.cycles,
        figures: figures(peer),
        own: is_own(peer),
    };
    peers.iter().map(bar).collect()
}

/// Whether this is the core's net.
fn is_own(peer: &Peer) -> bool {
    peer.name.starts_with("taxel")
}

/// Whether the net is in 16-bit fixed point.
fn is_q15(peer: &Peer) -> bool {
    peer.name.split(',').next().is_some_and(|name| name.contains("q15"))
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

    #[test]
    fn ratio_is_to_the_net_of_the_same_arithmetic() {
        let figures: Vec<String> = bars(&parse(
            "name,net,max_error,cycles_low,cycles_high,instructions,cycles_least,cycles_most\n\
             taxel,n,1e-7,99,101,9,90,110\ntaxel q15,n,1e-4,50,50,9,40,60\n\
             \"a, -O2\",n,2e-7,300,300,9,200,400\n\"a q15, -O2\",n,2e-4,200,200,9,100,300\nb: none,n,,,,,,\n",
        )
        .unwrap())
        .into_iter()
        .map(|bar| bar.figures)
        .collect();
        let expected = [
            "100 (90–110); error ≤ 1e-7",
            "50 (40–60); error ≤ 1e-4",
            "300 (200–400), 3.00 × taxel; error ≤ 2e-7",
            "200 (100–300), 4.00 × taxel; error ≤ 2e-4",
            "not built",
        ];
        assert_eq!(figures, expected);
    }
}
