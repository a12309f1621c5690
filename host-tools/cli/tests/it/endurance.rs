//! Long tests that try every byte, every operation, or real time; not in the quick profile.

mod broken_uploads;
mod ill_posed;
