//! Tests of committed tables: against the page that quotes them, and against a new measurement.

mod accuracy_page;
mod baseline;
mod throughput;
