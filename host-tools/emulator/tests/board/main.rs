//! The very images that are flashed, on emulated boards.

mod both;
mod f411;
mod g431;
mod support;
