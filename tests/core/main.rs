//! Tests of the core alone: golden bytes, sessions, store, hostile inputs and the C header.

mod c_header;
mod common;
mod day;
mod finger;
mod flood;
mod hostile;
mod noise;
mod records;
mod session;
mod store;
mod uploads;
mod wire_golden;
mod wraps;
