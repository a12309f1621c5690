//! Verdicts of all faults as CSV, and the survivors as a table on the board's page.

use super::{Campaign, Register, Verdict};
use crate::board::model::Model;

/// Lines around the generated part of a page.
const BEGIN: &str = "<!-- faults -->";
const END: &str = "<!-- faults: end -->";

/// Verdicts of a register's bits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Row {
    /// Name of the register.
    pub register: String,
    /// Address of the register.
    pub address: u32,
    /// Bytes of the write.
    pub bytes: u32,
    /// Value that the firmware writes last before the port opens.
    pub value: u32,
    /// Bits that can be written.
    pub bits: u32,
    /// Bits whose fault passes unnoticed.
    pub survivors: u32,
    /// Bits whose fault the emulator refuses, for it has no model of it.
    pub refused: u32,
}

impl Row {
    /// Injects all faults of a register.
    pub fn of(campaign: &Campaign, register: &Register) -> Self {
        let (bytes, value) = register.written.last;
        let (mut survivors, mut refused) = (0, 0);
        for bit in register.bits() {
            match campaign.judge(register, 1 << bit) {
                Verdict::Survived => survivors |= 1 << bit,
                Verdict::Refused(_) => refused |= 1 << bit,
                Verdict::Killed(..) => {}
            }
        }
        Self {
            register: register.name.clone(),
            address: register.address,
            bytes,
            value,
            bits: register.writable,
            survivors,
            refused,
        }
    }

    /// Row as a line of CSV.
    pub fn line(&self) -> String {
        let Self { register, address, bytes, value, bits, survivors, refused } = self;
        format!(
            "{register},{address:#010x},{bytes},{value:#x},{bits:#x},{survivors:#x},{refused:#x}"
        )
    }
}

/// Numbers of faults that are killed, refused, and unnoticed.
pub fn score(rows: &[Row]) -> [u32; 3] {
    let sum = |of: fn(&Row) -> u32| rows.iter().map(|row| of(row).count_ones()).sum::<u32>();
    let [refused, survivors] = [sum(|row| row.refused), sum(|row| row.survivors)];
    [sum(|row| row.bits) - refused - survivors, refused, survivors]
}

/// Shares of the faults that are killed, refused, and unnoticed, in per cent.
pub fn shares(rows: &[Row]) -> [f64; 3] {
    let score = score(rows);
    let all: u32 = score.iter().sum();
    score.map(|part| 100.0 * f64::from(part) / f64::from(all.max(1)))
}

/// Table as CSV.
pub fn csv(rows: &[Row]) -> String {
    let lines = rows.iter().map(|row| format!("{}\n", row.line()));
    format!("register,address,bytes,value,bits,survivors,refused\n{}", lines.collect::<String>())
}

/// Reads the table; `None` if a line is not one of [`csv`].
pub fn read(csv: &str) -> Option<Vec<Row>> {
    let row = |line: &str| {
        let [register, address, bytes, value, bits, survivors, refused] =
            line.split(',').collect::<Vec<_>>().try_into().ok()?;
        let hex = |text: &str| u32::from_str_radix(text.strip_prefix("0x")?, 16).ok();
        Some(Row {
            register: register.to_owned(),
            address: hex(address)?,
            bytes: bytes.parse().ok()?,
            value: hex(value)?,
            bits: hex(bits)?,
            survivors: hex(survivors)?,
            refused: hex(refused)?,
        })
    };
    csv.lines().skip(1).map(row).collect()
}

/// Page with the survivors between its two marks; `None` if it lacks them.
pub fn drawn(page: &str, board: Model, rows: &[Row]) -> Option<String> {
    let (before, rest) = page.split_once(BEGIN)?;
    let (_, after) = rest.split_once(END)?;
    Some(format!("{before}{BEGIN}\n{}{END}{after}", list(board, rows)))
}

/// Score and survivors as Markdown.
fn list(board: Model, rows: &[Row]) -> String {
    let chip = match board {
        Model::G431 => "STM32G431CBTx",
        Model::G473 => "STM32G473CETx",
        Model::F411 => "STM32F411CEUx",
    };
    let ([killed, refused, survivors], shares) = (score(rows), shares(rows));
    let mut text = format!(
        "Of {} faults, {killed} ({:.1} %) are killed: they show in what the board does, or break a rule of the reference\n\
         manual. {refused} ({:.1} %) are refused: the emulator has no model of what the bit does or points to, and stops. On\n\
         silicon those may do harm or nothing. {survivors} ({:.1} %) pass unnoticed:\n\n\
         | register | bits | on the bench, while it streams | expected of these bits |\n|---|---|---|---|\n",
        killed + refused + survivors,
        shares[0],
        shares[1],
        shares[2]
    );
    for row in rows.iter().filter(|row| row.survivors != 0) {
        let Row { register, address, bytes, value, survivors, .. } = row;
        text += &format!(
            "| {register} | {} | `probe-rs read --chip {chip} b{} {address:#010x} 1` | `& {survivors:#x}` = {:#x} |\n",
            ranges(*survivors),
            8 * bytes,
            value & survivors
        );
    }
    text
}

/// Bits as numbers and ranges.
fn ranges(bits: u32) -> String {
    let mut found: Vec<[u32; 2]> = Vec::new();
    for bit in (0..32).filter(|bit| bits >> bit & 1 == 1) {
        match found.last_mut() {
            Some([_, last]) if *last + 1 == bit => *last = bit,
            _ => found.push([bit, bit]),
        }
    }
    let texts = found.iter().map(|[first, last]| match last - first {
        0 => format!("{first}"),
        _ => format!("{first}–{last}"),
    });
    texts.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row() -> Row {
        let register = "TIM1.CR2".to_owned();
        let (bits, survivors, refused) = (0xff, 0b1_0110, 0b1000_0000);
        Row { register, address: 0x10, bytes: 4, value: 0x50, bits, survivors, refused }
    }

    #[test]
    fn table_reads_back_as_written() {
        assert_eq!(read(&csv(&[row()])), Some(vec![row()]));
        assert_eq!(read("register\nTIM1.CR2,16\n"), None);
        assert_eq!(score(&[row(), row()]), [8, 2, 6]);
        assert_eq!(shares(&[row(), row()]), [50.0, 12.5, 37.5]);
    }

    #[test]
    fn page_lists_survivors_with_their_values() {
        let page = drawn("a\n<!-- faults -->\nold\n<!-- faults: end -->\nb", Model::G431, &[row()]);
        let page = page.unwrap();
        assert!(
            page.starts_with("a\n<!-- faults -->\nOf 8 faults, 4 (50.0 %) are killed: they show"),
            "{page}"
        );
        assert!(
            page.contains("| TIM1.CR2 | 1–2, 4 |") && page.contains("`& 0x16` = 0x10 |"),
            "{page}"
        );
        assert!(page.ends_with("<!-- faults: end -->\nb") && !page.contains("old"));
        assert_eq!(drawn("no part", Model::G431, &[]), None);
    }
}
