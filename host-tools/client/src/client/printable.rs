//! Texts of a finger, made fit for a terminal and a file's header.

use taxel::wire::message::Info;

/// Makes every text of a finger's description printable.
pub(super) fn printable(mut info: Info) -> Info {
    info.identity.board = shown(&info.identity.board);
    info.identity.serial = shown(&info.identity.serial);
    info.identity.build = shown(&info.identity.build);
    if let Some(calibration) = &mut info.calibration {
        calibration.serial = shown(&calibration.serial);
    }
    info
}

/// Replaces all but printable ASCII, because a finger may hold and send anything.
///
/// A control sequence would reach the terminal, and a line break the header of a CSV file.
pub(super) fn shown<T: AsRef<str> + FromIterator<char>>(text: &T) -> T {
    let printable = |c: char| c.is_ascii_graphic() || c == ' ';
    text.as_ref().chars().map(|c| if printable(c) { c } else { '?' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_and_line_breaks_are_replaced() {
        let texts =
            [("F-0042 a", "F-0042 a"), ("\x1b[2J", "?[2J"), ("a\nb=c\r", "a?b=c?"), ("µ", "?")];
        for (sent, expected) in texts {
            assert_eq!(shown(&sent.to_owned()), expected);
        }
    }
}
