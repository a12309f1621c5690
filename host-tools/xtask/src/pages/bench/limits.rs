//! Limits of a bench check, from the words of its expectation.
//!
//! A clause ends at `; `. It has limits where it says `below N UNIT`, `at most N UNIT`,
//! `N UNIT, within P %`, `within ±N UNIT`, or nothing but `N UNIT`. A person judges the others.

/// Range of a measured number.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    pub min: f64,
    pub max: f64,
    /// Highest value of a finger without force sensors, where it is another.
    pub matrix_max: Option<f64>,
    pub unit: String,
}

/// Expectation with one verdict: a number in limits, or words.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    pub expected: String,
    pub limits: Option<Limits>,
}

/// Splits an expectation into one reading for each number with limits, and one for all words.
pub fn readings(expected: &str) -> Vec<Reading> {
    let mut readings: Vec<Reading> = Vec::new();
    for clause in expected.split("; ") {
        let limits = limits(clause);
        let words = readings.iter_mut().find(|reading| reading.limits.is_none());
        match words {
            Some(words) if limits.is_none() => words.expected += &format!("; {clause}"),
            _ => readings.push(Reading { expected: clause.to_owned(), limits }),
        }
    }
    readings
}

/// Limits that a clause states.
fn limits(clause: &str) -> Option<Limits> {
    let range = |min, max, unit: &str| Limits { min, max, matrix_max: None, unit: unit.to_owned() };
    let behind = |mark: &str| clause.split_once(mark).map(|(_, rest)| rest);
    if let Some((most, unit)) = behind("at most ").or_else(|| behind("below ")).and_then(quantity) {
        return Some(range(0.0, most, first_word(unit)));
    }
    if let Some((most, unit)) = behind("within ±").and_then(quantity) {
        return Some(range(-most, most, first_word(unit)));
    }
    let (value, unit) = quantity(clause)?;
    if let Some((unit, share)) = unit.split_once(", within ") {
        let share = quantity(share).filter(|(_, unit)| *unit == "%")?.0 / 100.0;
        // Limits are the numbers that a person would write.
        let round = |limit: f64| (1e6 * limit).round() / 1e6;
        return Some(range(round(value * (1.0 - share)), round(value * (1.0 + share)), unit));
    }
    let plain = |word: &str| word.chars().all(char::is_alphabetic);
    let words: Vec<&str> = unit.split(' ').collect();
    (words.len() <= 3 && words.into_iter().all(plain)).then(|| range(value, value, unit))
}

/// Number at the beginning of a text, with spaces before its thousands, and the text behind it.
fn quantity(text: &str) -> Option<(f64, &str)> {
    let (mut digits, mut rest) = text.split_once(' ')?;
    let mut number = digits.to_owned();
    while let Some((next, behind)) = rest.split_once(' ') {
        if next.len() != 3 || !next.bytes().all(|b| b.is_ascii_digit()) {
            break;
        }
        (digits, rest) = (next, behind);
        number += digits;
    }
    Some((number.parse().ok()?, rest))
}

fn first_word(text: &str) -> &str {
    text.split(' ').next().unwrap_or_default().trim_end_matches([',', '.'])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clause_with_limits_is_told_from_words() {
        let range = |clause| limits(clause).map(|found| (found.min, found.max, found.unit));
        let expected = |min, max, unit: &str| Some((min, max, unit.to_owned()));
        assert_eq!(range("44 mA, at most 53 mA"), expected(0.0, 53.0, "mA"));
        assert_eq!(range("2.1 V, below 2.25 V"), expected(0.0, 2.25, "V"));
        assert_eq!(range("noise below 16 codes of 32 760, two"), expected(0.0, 16.0, "codes"));
        assert_eq!(range("offset, within ±1 %"), expected(-1.0, 1.0, "%"));
        assert_eq!(range("240 000 frames, within 1 %"), expected(237_600.0, 242_400.0, "frames"));
        assert_eq!(range("500 frames a second"), expected(500.0, 500.0, "frames a second"));
        for words in [
            "24 hexadecimal digits, the same on both",
            "50 µs each in turn, 50 µs all low",
            "alike at 40 and 26.5 µs, other at 13.25 µs by more than the noise",
            "what wait states cost, 5 300 at most",
            "`0483:df11`, then as under *Flash it*",
        ] {
            assert_eq!(range(words), None, "{words}");
        }
    }

    #[test]
    fn words_of_an_expectation_are_one_reading() {
        let found = readings("lit; 0 frames lost; in order");
        let texts: Vec<&str> = found.iter().map(|reading| reading.expected.as_str()).collect();
        assert_eq!(texts, ["lit; in order", "0 frames lost"]);
        assert!(found[0].limits.is_none() && found[1].limits.is_some());
    }
}
