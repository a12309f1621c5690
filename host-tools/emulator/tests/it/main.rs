//! Tests of the flashed images on emulated boards, and of the stages' inputs, in one program.

mod both;
mod budget;
mod copies;
mod disturbed;
mod f411;
mod faults;
mod flood;
mod g431;
mod g473;
mod kinds;
mod load;
mod models;
mod named;
mod page;
mod replay;
mod starter;
mod support;
