//! Key `fidelity` of a scene: how finely contact is computed.

use serde::Deserialize;

/// Value of `fidelity`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Fidelity {
    /// The cheapest rung within the tolerance.
    #[default]
    Auto,
    /// [`Rung::Point`](crate::fidelity::Rung::Point).
    Point,
    /// [`Rung::Hertz`](crate::fidelity::Rung::Hertz).
    Hertz,
    /// [`Rung::Converged`](crate::fidelity::Rung::Converged).
    Converged,
    /// [`Rung::Layer`](crate::fidelity::Rung::Layer).
    Layer,
}
