//! The very images that are flashed, on emulated boards, and the stages' inputs: one program, linked once.

mod both;
mod budget;
mod copies;
mod disturbed;
mod f411;
mod g431;
mod kinds;
mod support;
