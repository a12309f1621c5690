//! The live page of a finger: a server on this machine, and the page that it serves.
//!
//! ```text
//! finger ──Client──▶ feed::live ──┐
//!                                 ├─rows─▶ Scope ──ticks, 60 a second──▶ server ──WebSocket──▶ page
//! recording ───▶ feed::playback ──┘                                         ◀──── orders ─────
//! ```
//! A tick is what a screen can show: the latest row, and the least and greatest of every measured value
//! since the tick before. However fast the stream, no peak is lost, and a page that is slow to read gets
//! the ticks it has not seen. Nothing in here knows which fields a frame has: columns have names.

mod feed;
mod orders;
mod scope;
mod server;
mod spectrum;

pub use feed::{Feed, Source, Tap};
pub use server::{Server, ServerError};
