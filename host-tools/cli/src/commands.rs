//! A file a command.

pub mod bias;
pub mod demo;
pub mod info;
pub mod record;
pub mod set;
