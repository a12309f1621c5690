//! The taxel command.

fn main() {}
