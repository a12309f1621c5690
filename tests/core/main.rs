//! The core on its own: golden bytes, sessions, the store under power cuts, hostile inputs, the C header.

mod c_header;
mod common;
mod finger;
mod hostile;
mod session;
mod store;
mod wire_golden;
