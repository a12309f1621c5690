//! Tests of the plans against the chips' manuals, and of the boards' pages against the plans.

mod bill;
mod common;
mod f411;
mod g431;
mod pages;
mod wiring;
