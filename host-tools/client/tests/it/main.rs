//! Tests of the client against scripted fingers. Those against the virtual finger are in
//! `taxel-cli`.

mod broken_links;
mod steady;
