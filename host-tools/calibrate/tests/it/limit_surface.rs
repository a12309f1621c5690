//! Error and cost of the chip's limit surfaces.
//!
//! `cargo bench -p taxel-calibrate --bench limit-surface` writes the table again.

use crate::judge::limit_surfaces::{error, table};

#[test]
fn the_sweep_and_the_table_are_within_a_third_of_a_per_cent_and_the_ellipse_within_seven() {
    assert!(error("sweep") < 0.0033, "{}", error("sweep"));
    assert!(error("table") < 0.0033, "{}", error("table"));
    assert!((0.06..0.07).contains(&error("ellipse")), "{}", error("ellipse"));
}

#[test]
fn the_committed_table_is_what_the_forms_leave_and_cost_now() {
    let committed = include_str!("../../data/limit-surface.csv");
    assert_eq!(
        committed,
        table(),
        "write it again: cargo bench -p taxel-calibrate --bench limit-surface"
    );
}
