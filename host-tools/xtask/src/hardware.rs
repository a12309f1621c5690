//! `cargo xtask hardware`: what is generated from the reference finger for building one.
//!
//! Needs ngspice, which simulates the columns' circuit for docs/front-end.md.

mod chart;
mod deck;
mod front_end;
mod measure;
mod page;
mod spice;

use anyhow::{Context, Result};

use crate::run::root;

/// Writes the files; with `check`, fails if one differs and writes nothing.
pub fn task(check: bool) -> Result<()> {
    let candidates = front_end::candidates()?;
    let parts = [front_end::reference()?, front_end::table(&candidates)];
    let page = root().join("docs/front-end.md");
    let mut text = std::fs::read_to_string(&page)?;
    for part in &parts {
        if check {
            page::check(&text, part).context("docs/front-end.md")?;
        } else {
            text = page::fill(&text, part).context("docs/front-end.md")?;
        }
    }
    if !check {
        std::fs::write(&page, text)?;
        std::fs::write(root().join("docs/images/front-end.svg"), front_end::chart(&candidates))?;
    }
    Ok(())
}
