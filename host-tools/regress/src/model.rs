//! Families of models, with the names that the command accepts.

use std::fmt;
use std::str::FromStr;

/// A family of models.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Family {
    /// Family, width and decay chosen by cross-validation.
    Auto,
    /// Net with one hidden layer of tanh units ([DeMaria2011]).
    #[default]
    Mlp,
    /// Net like [`Self::Mlp`] with a linear skip path.
    Skip,
    /// Linear, with a decay.
    Ridge,
    /// Linear in every input, its square and its cube.
    Cubic,
    /// Linear in every input and every product of two.
    Quadratic,
    /// Linear without a decay: S(u − b) row by row ([Ospina2017] eqs (1.22)–(1.24)), 3×3 or 6×3n.
    LeastSquares,
    /// Line of four taxels ([DeMaria2011]).
    Row,
    /// Micro-feeler ([Ohka2005]).
    Feeler,
    /// Columnar feeler ([Ohka2004]).
    Column,
    /// Gap curve: each signal to the displacement of its own facet.
    Gap,
}

/// All families with their names.
const NAMES: [(&str, Family); 11] = [
    ("auto", Family::Auto),
    ("mlp", Family::Mlp),
    ("skip", Family::Skip),
    ("ridge", Family::Ridge),
    ("cubic", Family::Cubic),
    ("quadratic", Family::Quadratic),
    ("least-squares", Family::LeastSquares),
    ("row", Family::Row),
    ("feeler", Family::Feeler),
    ("column", Family::Column),
    ("gap", Family::Gap),
];

impl fmt::Display for Family {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = NAMES.iter().find(|(_, family)| family == self).map_or("", |(name, _)| name);
        f.write_str(name)
    }
}

impl FromStr for Family {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        NAMES.iter().find(|(name, _)| *name == text).map(|(_, family)| *family).ok_or_else(|| {
            format!("no such model; there are {}", NAMES.map(|(name, _)| name).join(", "))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn family_names_parse_and_print() {
        for (name, family) in NAMES {
            assert_eq!(name.parse(), Ok(family));
            assert_eq!(family.to_string(), name);
        }
        assert!("cubist".parse::<Family>().unwrap_err().contains("quadratic"));
    }
}
