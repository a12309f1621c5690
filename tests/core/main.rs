//! Tests of the core alone: golden bytes, sessions, store, hostile inputs and the C header.

mod c_header;
mod campaign;
mod common;
mod day;
mod finger;
mod flood;
mod hostile;
mod model;
mod noise;
mod records;
mod session;
mod store;
mod uploads;
mod wire_golden;
mod wraps;
