//! The core's net beside other people's: `peers.csv`, as `cargo xtask cycles --peers` left it.

use std::path::Path;

use anyhow::Context;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::files;
use crate::style::{COLOURS, Done, FONT, GREY, svg};

const COMMITTED: &str = include_str!("../../emulator/data/peers.csv");

/// One implementation; without a cost where it could not be built.
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
    let peers = parse(COMMITTED).context("host-tools/emulator/data/peers.csv")?;
    files::write(&folder.join("peers.csv"), COMMITTED)?;
    files::write(&folder.join("peers.svg"), &draw(&peers)?)
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

const WIDTH: u32 = 900;
/// A bar and its gap, in pixels.
const ROW: i32 = 52;

fn draw(peers: &[Peer]) -> anyhow::Result<String> {
    let height = u32::try_from(ROW)? * u32::try_from(peers.len())? + 44;
    svg((WIDTH, height), |area| bars(area, peers))
}

fn bars(area: &DrawingArea<SVGBackend<'_>, Shift>, peers: &[Peer]) -> Done {
    let font = |size: i32| (FONT, size).into_font();
    let middle = Pos::new(HPos::Left, VPos::Center);
    let title = "The 16-16-3 net with tanh units, modelled Cortex-M4F cycles a call";
    area.draw(&Text::new(title, (16, 10), font(16)))?;
    let own = peers.first().and_then(|peer| peer.cycles);
    let most = peers.iter().filter_map(|peer| peer.cycles).fold(1.0, f64::max);
    for (i, peer) in (0..).zip(peers) {
        let y = 40 + ROW * i;
        area.draw(&Text::new(peer.name.clone(), (16, y + 8), font(14).color(&BLACK).pos(middle)))?;
        let (text, from) = match (peer.cycles, own) {
            (Some(cycles), Some(own)) => {
                let long = (500.0 * cycles / most) as i32;
                let colour = if i == 0 { COLOURS[0] } else { COLOURS[4] };
                area.draw(&Rectangle::new([(16, y + 18), (16 + long, y + 38)], colour.filled()))?;
                let ratio = if i == 0 {
                    String::new()
                } else {
                    format!(", {:.2} times as many", cycles / own)
                };
                (format!("{cycles:.0}{ratio}; error ≤ {}", peer.max_error), 24 + long)
            }
            _ => ("not built".to_owned(), 16),
        };
        let style = font(14).color(if peer.cycles.is_some() { &BLACK } else { &GREY }).pos(middle);
        area.draw(&Text::new(text, (from, y + 28), style))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_committed_table_has_the_core_first_and_no_peer_without_name() {
        let peers = parse(COMMITTED).unwrap();
        assert_eq!(peers[0].name, "taxel");
        assert!(peers.len() > 2 && peers.iter().all(|peer| !peer.name.is_empty()));
        assert!(peers[0].cycles.is_some());
    }
}
