//! Generated parts of pages, and how near two of them must be.

use anyhow::{Context, Result, ensure};

/// Generated part of a page, between `<!-- hardware: NAME -->` and `<!-- hardware: end -->`.
pub struct Part {
    /// Name in the page.
    pub name: &'static str,
    /// Lines of the part.
    pub lines: Vec<String>,
}

/// Share by which a number may differ from the page's.
///
/// Two versions of ngspice choose other time steps.
const TOLERANCE: f64 = 0.05;

/// Lines of a part in a page, with the numbers of the lines around it.
fn find<'a>(text: &'a str, part: &Part) -> Result<(usize, Vec<&'a str>)> {
    let begin = format!("<!-- hardware: {} -->", part.name);
    let all: Vec<&str> = text.lines().collect();
    let start = all.iter().position(|line| *line == begin);
    let start = start.with_context(|| format!("no line `{begin}`"))? + 1;
    let length = all[start..].iter().position(|line| *line == "<!-- hardware: end -->");
    let end = start + length.with_context(|| format!("no end of `{begin}`"))?;
    Ok((start, all[start..end].to_vec()))
}

/// Fails where the page's part differs in words, or in numbers by more than the tolerance.
pub fn check(text: &str, part: &Part) -> Result<()> {
    let (_, there) = find(text, part)?;
    ensure!(
        there.len() == part.lines.len(),
        "`{}` has {} lines, not {}",
        part.name,
        there.len(),
        part.lines.len()
    );
    for (there, new) in there.iter().zip(&part.lines) {
        ensure!(alike(there, new), "differs from its circuit:\n{there}\n{new}");
    }
    Ok(())
}

/// Replaces the part of a page.
pub fn fill(text: &str, part: &Part) -> Result<String> {
    let (start, there) = find(text, part)?;
    let all: Vec<&str> = text.lines().collect();
    let new = part.lines.iter().map(String::as_str);
    let lines =
        all[..start].iter().copied().chain(new).chain(all[start + there.len()..].iter().copied());
    Ok(lines.map(|line| line.to_owned() + "\n").collect())
}

/// Whether two lines have the same words, and numbers within the tolerance or one last digit.
fn alike(one: &str, other: &str) -> bool {
    let (one, other) = (tokens(one), tokens(other));
    one.len() == other.len()
        && one.iter().zip(&other).all(|(a, b)| match (a.parse::<f64>(), b.parse::<f64>()) {
            (Ok(x), Ok(y)) => {
                let digits = a.split_once('.').map_or(0, |(_, after)| after.len());
                let last = 10f64.powi(-(digits as i32));
                (x - y).abs() <= f64::max(TOLERANCE * y.abs(), 1.001 * last)
            }
            _ => a == b,
        })
}

/// Splits a line into numbers and what is between them.
fn tokens(line: &str) -> Vec<String> {
    let mut tokens: Vec<String> = Vec::new();
    let mut number = false;
    for c in line.chars() {
        let digit = c.is_ascii_digit() || c == '.' && number;
        match tokens.last_mut() {
            Some(last) if digit == number => last.push(c),
            _ => tokens.push(c.into()),
        }
        number = digit;
    }
    tokens
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn part_is_filled_and_checked_within_5_percent() {
        let part = |line: &str| Part { name: "a", lines: vec![line.to_owned()] };
        let page = "x\n<!-- hardware: a -->\nold\n<!-- hardware: end -->\ny\n";
        let filled = fill(page, &part("| b | 19.0 µs |")).unwrap();
        assert_eq!(filled, page.replace("old", "| b | 19.0 µs |"));
        for (line, holds) in [
            ("| b | 19.0 µs |", true),
            ("| b | 19.9 µs |", true),
            ("| b | 20.1 µs |", false),
            ("| c | 19.0 µs |", false),
            ("| b | 19.0 ms |", false),
        ] {
            assert_eq!(check(&filled, &part(line)).is_ok(), holds, "{line}");
        }
        assert!(fill("no part\n", &part("")).is_err());
    }
}
