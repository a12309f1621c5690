//! Build and test tasks of this repository.

fn main() {}
