//! Polynomial terms of the inputs, for linear models.

use serde::{Deserialize, Serialize};

/// Polynomial expansion of a model's inputs into terms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Expansion {
    /// The inputs themselves.
    #[default]
    None,
    /// Each input, its square and its cube.
    Cubic,
    /// Each input, and each product of two, squares included.
    Quadratic,
}

impl Expansion {
    /// Computes the terms of one row.
    #[must_use]
    pub fn terms(self, x: &[f64]) -> Vec<f64> {
        match self {
            Self::None => x.to_vec(),
            Self::Cubic => {
                let power = |n: i32| x.iter().map(move |x| x.powi(n));
                power(1).chain(power(2)).chain(power(3)).collect()
            }
            Self::Quadratic => {
                let products =
                    x.iter().enumerate().flat_map(|(i, a)| x[i..].iter().map(move |b| a * b));
                x.iter().copied().chain(products).collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terms_are_powers_or_products() {
        let x = [2.0, -3.0];
        assert_eq!(Expansion::None.terms(&x), [2.0, -3.0]);
        assert_eq!(Expansion::Cubic.terms(&x), [2.0, -3.0, 4.0, 9.0, 8.0, -27.0]);
        assert_eq!(Expansion::Quadratic.terms(&x), [2.0, -3.0, 4.0, -6.0, 9.0]);
    }
}
