//! Registers on which the two descriptions of a chip disagree: table, and section of a page.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use super::metapac;
use super::svd::Register;

/// Lines around the generated part of the page.
const BEGIN: &str = "<!-- register differences -->";
const END: &str = "<!-- register differences: end -->";

/// Kind of a difference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// A field of the same name has other bits, none in common.
    Moved,
    /// A field of the same name has more or fewer bits.
    Width,
    /// Fields of `stm32-metapac` have bits that the SVD file reserves.
    Reserved,
    /// `stm32-metapac` has no field for bits that have one in the SVD file.
    Missing,
    /// `stm32-metapac` has no register there.
    Absent,
}

impl Kind {
    const ALL: [Self; 5] = [Self::Moved, Self::Width, Self::Reserved, Self::Missing, Self::Absent];

    /// Name in the table, and meaning on the page.
    fn text(self) -> [&'static str; 2] {
        match self {
            Self::Moved => ["moved", "a field of the same name has other bits"],
            Self::Width => ["width", "a field of the same name has more or fewer bits"],
            Self::Reserved => {
                ["reserved", "fields of `stm32-metapac` on bits that the SVD file reserves"]
            }
            Self::Missing => ["missing", "fields of the SVD file that `stm32-metapac` lacks"],
            Self::Absent => ["absent", "registers of the SVD file that `stm32-metapac` lacks"],
        }
    }
}

/// Difference on a register.
#[derive(Debug, PartialEq, Eq)]
pub struct Difference {
    board: &'static str,
    address: u32,
    register: String,
    kind: Kind,
    /// Names of the fields; of `stm32-metapac` unless it lacks them.
    fields: String,
    /// Bits in `stm32-metapac` and in the SVD file.
    bits: [u32; 2],
    /// Whether the firmware configures the register.
    written: bool,
}

/// Lists the differences on the registers of the SVD file, by address.
pub fn list(
    board: &'static str,
    svd: &BTreeMap<u32, Register>,
    metapac: &metapac::Registers,
    written: &BTreeSet<u32>,
) -> Vec<Difference> {
    let mut found = Vec::new();
    for (&address, register) in svd {
        let mut add = |kind, fields: Vec<&str>, bits| {
            let (register, fields) = (register.names.join(" "), fields.join(" "));
            let written = written.contains(&address);
            found.push(Difference { board, address, register, kind, fields, bits, written });
        };
        let Some(described) = metapac.get(&address) else {
            add(Kind::Absent, Vec::new(), [0, register.fields]);
            continue;
        };
        // A register without fields has no description to compare.
        if described.values().any(BTreeMap::is_empty) || register.fields == 0 {
            continue;
        }
        let fields: BTreeMap<&str, u32> =
            described.values().flatten().map(|(name, bits)| (name.as_str(), *bits)).collect();
        let all = fields.values().fold(0, |all, bits| all | bits);
        let (mut reserved, mut strays) = (Vec::new(), 0);
        // Bits that another difference explains.
        let mut told = 0;
        for (&name, &bits) in &fields {
            let same = register.named.iter().find(|(other, _)| plain(other) == plain(name));
            match same {
                Some((_, &theirs)) if theirs & bits == 0 => {
                    add(Kind::Moved, vec![name], [bits, theirs]);
                    told |= bits | theirs;
                }
                // Parts of a field may have names of their own.
                Some((_, &theirs)) if bits & !register.fields | theirs & !all != 0 => {
                    add(Kind::Width, vec![name], [bits, theirs]);
                    told |= bits | theirs;
                }
                Some(_) => {}
                None if bits & !register.fields != 0 => {
                    reserved.push(name);
                    strays |= bits & !register.fields;
                }
                None => {}
            }
        }
        if strays & !told != 0 {
            add(Kind::Reserved, reserved, [strays & !told, 0]);
        }
        let missing = register.fields & !all & !told;
        if missing != 0 {
            let names = register.named.iter().filter(|(_, bits)| *bits & missing != 0);
            add(Kind::Missing, names.map(|(name, _)| name.as_str()).collect(), [0, missing]);
        }
    }
    found
}

fn plain(name: &str) -> String {
    name.replace('_', "").to_lowercase()
}

/// Table as CSV.
pub fn csv(differences: &[Difference]) -> String {
    let mut text = "board,address,register,kind,fields,metapac,svd,written\n".to_owned();
    for Difference { board, address, register, kind, fields, bits: [ours, theirs], written } in
        differences
    {
        let [kind, _] = kind.text();
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "{board},{address:#010x},{register},{kind},{fields},{ours:#x},{theirs:#x},{}",
            u8::from(*written)
        );
    }
    text
}

/// Page with the differences between its two marks; `None` if it lacks them.
pub fn drawn(page: &str, differences: &[Difference]) -> Option<String> {
    let (before, rest) = page.split_once(BEGIN)?;
    let (_, after) = rest.split_once(END)?;
    Some(format!("{before}{BEGIN}\n{}{END}{after}", section(differences)))
}

/// Counts of each kind, and the differences that a program could meet without noticing.
fn section(differences: &[Difference]) -> String {
    let mut boards: Vec<_> = differences.iter().map(|one| one.board).collect();
    boards.dedup();
    let mut text =
        format!("| kind | {} |\n|---|{}\n", boards.join(" | "), "---|".repeat(boards.len()));
    for kind in Kind::ALL {
        let [_, meaning] = kind.text();
        text += &format!("| {meaning} |");
        for board in &boards {
            let of = differences.iter().filter(|one| one.board == *board && one.kind == kind);
            let [all, written] = [of.clone().count(), of.filter(|one| one.written).count()];
            text += &format!(" {written} of {all} |");
        }
        text += "\n";
    }
    text += "\n| board | register | field | bits in `stm32-metapac` | bits in the SVD file |\n|---|---|---|---|---|\n";
    let told = |one: &&Difference| {
        one.kind == Kind::Moved || one.written && [Kind::Width, Kind::Missing].contains(&one.kind)
    };
    // Chips of a family share most rows.
    let mut rows: Vec<(String, Vec<&str>)> = Vec::new();
    for Difference { board, register, fields, bits, .. } in differences.iter().filter(told) {
        let [ours, theirs] =
            bits.map(|bits| if bits == 0 { "–".into() } else { format!("{bits:#x}") });
        let row = format!("{register} | {} | {ours} | {theirs}", fields.to_uppercase());
        match rows.iter_mut().find(|(other, _)| *other == row) {
            Some((_, boards)) => boards.push(board),
            None => rows.push((row, vec![board])),
        }
    }
    for (row, boards) in rows {
        text += &format!("| {} | {row} |\n", boards.join(", "));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn register(fields: &[(&str, u32)]) -> Register {
        let named: BTreeMap<_, _> =
            fields.iter().map(|(name, bits)| ((*name).to_owned(), *bits)).collect();
        let all = named.values().fold(0, |all, bits| all | bits);
        let names = vec!["PWR.CR5".to_owned()];
        Register { names, reset: 0, fields: all, writable: all, named }
    }

    /// Kinds, fields and bits of the differences between two descriptions of a register.
    fn between(svd: &[(&str, u32)], metapac: &[(&str, u32)]) -> Vec<(Kind, String, [u32; 2])> {
        let fields = metapac.iter().map(|(name, bits)| ((*name).to_owned(), *bits)).collect();
        let described = [(0x80, [("PWR.CR5".to_owned(), fields)].into())].into();
        let found = list("b", &[(0x80, register(svd))].into(), &described, &BTreeSet::new());
        found.into_iter().map(|one| (one.kind, one.fields, one.bits)).collect()
    }

    #[test]
    fn field_on_other_bits_is_found() {
        let found = between(&[("r1mode", 1 << 8)], &[("R1_MODE", 1)]);
        assert_eq!(found, [(Kind::Moved, "R1_MODE".into(), [1, 1 << 8])]);
        let found = between(&[("a", 0x3)], &[("a", 0x7)]);
        assert_eq!(found, [(Kind::Width, "a".into(), [0x7, 0x3])]);
        let found = between(&[("a", 1), ("b", 2)], &[("a", 1), ("c", 4)]);
        let expected = [(Kind::Reserved, "c".into(), [4, 0]), (Kind::Missing, "b".into(), [0, 2])];
        assert_eq!(found, expected);
    }

    #[test]
    fn same_bits_by_other_names_agree() {
        assert_eq!(between(&[("sms", 7), ("sms_3", 1 << 16)], &[("sms", 0x1_0007)]), []);
        assert_eq!(between(&[("cc1ie", 2), ("cc2ie", 4)], &[("ccie0", 2), ("ccie1", 4)]), []);
    }

    #[test]
    fn missing_register_is_found() {
        let svd = [(0x80, register(&[("a", 1)]))].into();
        let found = list("b", &svd, &metapac::Registers::new(), &[0x80].into());
        assert_eq!(found[0].kind, Kind::Absent);
        assert_eq!(csv(&found).lines().nth(1), Some("b,0x00000080,PWR.CR5,absent,,0x0,0x1,1"));
    }

    #[test]
    fn page_without_marks_is_refused() {
        assert_eq!(drawn("no part", &[]), None);
    }

    #[test]
    fn committed_table_has_the_boost_mode() {
        let table = include_str!("../../../emulator/data/register-differences.csv");
        assert!(table.contains(",PWR.CR5,moved,r1mode,0x1,0x100,1\n"), "{table}");
    }
}
