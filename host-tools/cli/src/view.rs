//! Live page of a finger: a server on this machine and the page it serves.
//!
//! ```text
//! finger ──Client──▶ feed::live ──┐
//!                                 ├─rows─▶ Scope ──ticks, 60 Hz──▶ server ──WebSocket──▶ page
//! recording ───▶ feed::playback ──┘                                   ◀──── orders ─────
//! ```
//! A tick holds one screen frame: the latest row, and minimum and maximum of every measured value
//! since the previous tick. No peak is lost at any stream rate. A slow page gets the ticks that it
//! has not seen. Columns are known by name only, so that this module does not depend on the frame's
//! fields.

mod access;
mod connections;
mod conversation;
mod feed;
mod orders;
mod scope;
mod server;
mod spectrum;

pub use feed::{Feed, Source, Tap};
pub use server::{Server, ServerError};
