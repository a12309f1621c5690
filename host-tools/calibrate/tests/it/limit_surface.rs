//! Error and cost of the chip's limit surfaces.
//!
//! `cargo bench -p taxel-calibrate --bench limit-surface` writes the table again.

use crate::judge::limit_surfaces::{error, table};

#[test]
fn limit_surface_forms_meet_their_error_bounds() {
    assert!(error("sweep") < 0.0033, "{}", error("sweep"));
    assert!(error("table") < 0.0033, "{}", error("table"));
    assert!((0.06..0.07).contains(&error("ellipse")), "{}", error("ellipse"));
}

#[test]
fn committed_limit_surface_table_is_current() {
    let committed = include_str!("../../data/limit-surface.csv");
    assert_eq!(
        committed,
        table(),
        "write it again: cargo bench -p taxel-calibrate --bench limit-surface"
    );
}
