//! Words and picture of a guide: what to press next, what the recording lacks, the map of the pad.

use std::fmt::{self, Display, Formatter, Write as _};

use taxel::scan::{COLS, ROWS};

use super::{ASKED, Guide, MISHAPS, PRESSES, Press, Step, TIMES, Target};

/// Names of the levels.
const HOW: [&str; 3] = ["lightly", "half as hard as the hardest", "as hard as the hardest"];
/// Directions of shear, an eighth of the circle each.
pub(super) const TOWARDS: [&str; 8] = [
    "to the right",
    "up and to the right",
    "up",
    "up and to the left",
    "to the left",
    "down and to the left",
    "down",
    "down and to the right",
];
/// Arrows of the directions.
const ARROWS: [char; 8] = ['→', '↗', '↑', '↖', '←', '↙', '↓', '↘'];

impl Display for Step {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::LetGo => f.write_str("touch nothing for a second"),
            Self::Press(words) => f.write_str(words),
            Self::Enough => f.write_str("enough"),
            Self::Ended(lacking) => write!(f, "ended: {lacking} recorded"),
        }
    }
}

impl Guide {
    /// Loads that the recording lacks, each as "no …".
    pub(super) fn lacking(&self) -> Vec<String> {
        let open = || self.left_out.iter().filter(|target| !self.is_met(**target));
        let directions: Vec<usize> = open()
            .filter_map(
                |target| if let Target::Shear(eighth) = target { Some(*eighth) } else { None },
            )
            .collect();
        let mut regions: Vec<usize> = open()
            .filter_map(|target| if let Target::Region(k, _) = target { Some(*k) } else { None })
            .collect();
        regions.dedup();
        let (some, none): (Vec<usize>, Vec<usize>) =
            regions.into_iter().partition(|region| self.counts(*region) != [0; 3]);
        let names = |regions: &[usize]| -> String {
            let names = regions.iter().map(|k| format!("r{}c{}", k / COLS, k % COLS));
            names.collect::<Vec<_>>().join(" ")
        };
        let mut lacking = Vec::new();
        if !none.is_empty() {
            lacking.push(format!("no press in {}", names(&none)));
        }
        if !some.is_empty() {
            lacking.push(format!("not every strength in {}", names(&some)));
        }
        match directions.len() {
            0 => {}
            all if all == TOWARDS.len() => lacking.push("no shear".into()),
            _ => lacking.extend(directions.iter().map(|k| format!("no shear {}", TOWARDS[*k]))),
        }
        let timed = |target: Target, name: &str, of: fn(&Press) -> bool| {
            let found = self.presses.iter().filter(|press| of(press)).count();
            open().any(|other| *other == target).then(|| match found {
                0 => format!("no {name} press"),
                found => format!(
                    "no more than {found} {name} press{}",
                    if found == 1 { "" } else { "es" }
                ),
            })
        };
        lacking.extend(timed(Target::Hold, "held", |press| press.held));
        lacking.extend(timed(Target::Fast, "fast", |press| press.fast));
        lacking
    }

    /// Words of a target.
    pub(super) fn words(&self, target: Target) -> String {
        match target {
            Target::Full => format!(
                "press the middle {} times, as hard as it will ever be pressed",
                MISHAPS + 1
            ),
            Target::Region(region, level) => {
                format!(
                    "press {} (r{}c{}), {}",
                    whereabouts(region),
                    region / COLS,
                    region % COLS,
                    self.how(level)
                )
            }
            Target::Shear(eighth) => {
                format!("press firmly and push sideways {} until it slips", TOWARDS[eighth])
            }
            Target::Hold => "press and hold for half a second".into(),
            Target::Fast => "tap as fast as in use".into(),
            Target::More => format!(
                "press all over the pad, briefly and pushed any way, {PRESSES} times in all"
            ),
        }
    }

    /// Strength of a level: in newtons if they are known, else compared with the last press.
    fn how(&self, level: usize) -> String {
        let asked = ASKED[level] * self.full();
        if self.newtons {
            return format!("{}, with about {asked:.1} N", HOW[level]);
        }
        let last = self.presses.last().map_or(asked, |press| press.peak);
        let compared = match asked / last.max(f64::MIN_POSITIVE) {
            ratio if ratio > 3.0 => ", much harder than the last",
            ratio if ratio > 1.5 => ", about twice as hard as the last",
            ratio if ratio < 0.3 => ", much more lightly than the last",
            ratio if ratio < 0.7 => ", about half as hard as the last",
            _ => "",
        };
        format!("{}{compared}", HOW[level])
    }

    /// Map of the pad with what each region still lacks, and counts of the other targets.
    #[must_use]
    pub fn picture(&self) -> String {
        let asked = match self.target {
            Some(Target::Region(region, _)) => Some(region),
            _ => None,
        };
        let mut text = String::new();
        for row in (0..ROWS).rev() {
            let _ = write!(text, "  r{row}");
            for region in row * COLS..(row + 1) * COLS {
                let counts = self.counts(region);
                let marks = ['l', 'm', 'h'].into_iter().zip(counts);
                let marks: String = marks.map(|(mark, n)| if n > 0 { mark } else { '·' }).collect();
                let (open, close) = if asked == Some(region) { ('>', '<') } else { ('[', ']') };
                let _ = write!(text, " {open}{marks}{:3}{close}", counts.iter().sum::<usize>());
            }
            text.push('\n');
        }
        text += "       c0       c1       c2       c3\n";
        let pushed =
            |eighth| if self.is_met(Target::Shear(eighth)) { ARROWS[eighth] } else { '·' };
        let arrows: String = (0..TOWARDS.len()).map(pushed).collect();
        let times = |of: fn(&Press) -> bool| {
            self.presses.iter().filter(|press| of(press)).count().min(TIMES)
        };
        let _ = write!(
            text,
            "  sideways {arrows}, held {} of {TIMES}, fast {} of {TIMES}, presses {}{}",
            times(|press| press.held),
            times(|press| press.fast),
            self.presses.len(),
            if self.sensors { format!(" of {PRESSES}") } else { String::new() }
        );
        text
    }
}

/// Place of a region in words, with y up and x to the right.
fn whereabouts(region: usize) -> String {
    let (row, column) = (region / COLS, region % COLS);
    let up = ["lower", "lower", "upper", "upper"][row];
    let side = ["left", "left", "right", "right"][column];
    let height = ["down", "down", "up", "up"][row];
    match ([0, ROWS - 1].contains(&row), [0, COLS - 1].contains(&column)) {
        (true, true) => format!("the {up} {side} corner"),
        (true, false) => format!("the {up} edge, a little to the {side}"),
        (false, true) => format!("the {side} edge, a little {height}"),
        (false, false) => format!("{up} {side} of the middle"),
    }
}
