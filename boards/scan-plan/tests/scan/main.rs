//! The plans against the chips' reference manuals, and the boards' pages against the plans.

mod common;
mod f411;
mod g431;
mod pages;
mod wiring;
