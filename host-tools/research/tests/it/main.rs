//! Committed tables: against the page that quotes them, and against a fresh measurement.

mod accuracy_page;
mod baseline;
