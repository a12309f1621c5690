//! Random numbers: one ChaCha stream per purpose.
//!
//! An effect added to a scene therefore leaves every other random number unchanged.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

/// Purpose of random numbers.
#[derive(Clone, Copy)]
pub enum Purpose {
    /// Gains and gaps of the optical pairs, offsets of the columns; a property of the device.
    GainSpread,
    /// Stray light between neighbouring pairs; a property of the device.
    OpticalCrosstalk,
    /// Resistances of the bridges; a property of the device.
    BridgeMismatch,
    /// Temperature coefficients of the bridges' resistances; a property of the device.
    BridgeDrift,
    /// Sensitivities and cross-talk of the force sensors; a property of the device.
    BridgeCrosstalk,
    /// Phase of the room's lamps against the first frame; a property of the run.
    Flicker,
    /// Noise of every reading; a property of the run.
    Noise,
    /// Error of a bench's load cell; a property of the run.
    Reference,
    /// Error of the load cell's moments; a property of the run.
    ReferenceMoments,
    /// Non-linearity of the converter; a property of the device.
    Nonlinearity,
    /// Errors of load cell and placement in the truth; a property of the run.
    BenchError,
    /// Press `.1` of the random presses with index `.0` in the scene; a property of the run.
    RandomPress(u8, u32),
}

/// Random stream of `seed` for this purpose.
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
        Purpose::Nonlinearity => 9,
        Purpose::BenchError => 10,
        Purpose::ReferenceMoments => 11,
        Purpose::RandomPress(act, press) => 1 << 63 | u64::from(act) << 32 | u64::from(press),
    });
    rng
}
