mod bonded;
mod spectrum;
mod windows;
pub use bonded::Bonded;
