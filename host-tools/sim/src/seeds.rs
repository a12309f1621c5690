//! Random numbers: one ChaCha stream per purpose, so that adding an effect to a scene leaves every
//! other number as it was.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

/// What random numbers are for.
#[derive(Clone, Copy)]
pub enum Purpose {
    /// Gains and gaps of the optical pairs, offsets of the columns; a property of the device.
    GainSpread,
    /// Stray light between neighbouring pairs; a property of the device.
    OpticalCrosstalk,
    /// Resistances of the bridges; a property of the device.
    BridgeMismatch,
    /// How differently the bridges' resistances warm; a property of the device.
    BridgeDrift,
    /// Sensitivities and cross-talk of the force sensors; a property of the device.
    BridgeCrosstalk,
    /// Phase of the room's lamps against the first frame; a property of the run.
    Flicker,
    /// Noise of every reading; a property of the run.
    Noise,
    /// Error of a bench's load cell; a property of the run.
    Reference,
    /// Press `.1` of the random presses that stand `.0`-th in the scene; a property of the run.
    RandomPress(u8, u32),
}

/// The stream of `seed` for this purpose.
pub fn stream(seed: u64, purpose: Purpose) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(match purpose {
        Purpose::GainSpread => 1,
        Purpose::OpticalCrosstalk => 2,
        Purpose::BridgeMismatch => 3,
        Purpose::BridgeCrosstalk => 4,
        Purpose::Flicker => 5,
        Purpose::Noise => 6,
        Purpose::BridgeDrift => 7,
        Purpose::Reference => 8,
        Purpose::RandomPress(act, press) => 1 << 63 | u64::from(act) << 32 | u64::from(press),
    });
    rng
}
