//! Tests of the systematic faults: a sample of them, and the committed verdicts and their page.

use taxel_emulator::board::model::Model::{self, F411, G431};
use taxel_emulator::faults::table::{self, Row};
use taxel_emulator::faults::{Campaign, Verdict};

use crate::support::{image, name, repository, scene};

/// Number of faults of each board in a sample.
const SAMPLE: usize = 200;
/// Least share of the faults that is killed, and largest that is refused and that is unnoticed, in
/// per cent.
const fn shares(model: Model) -> [f64; 3] {
    match model {
        Model::F411 => [43.0, 34.0, 24.0],
        Model::G431 | Model::G473 => [36.0, 46.0, 19.0],
    }
}

fn campaign(model: Model) -> Campaign {
    Campaign::new(model, image(model), scene()).unwrap()
}

fn committed(model: Model) -> Vec<Row> {
    let path = repository().join(format!("host-tools/emulator/data/faults-{}.csv", name(model)));
    table::read(&std::fs::read_to_string(path).unwrap()).expect("a table of faults")
}

/// First of these faults whose verdict is another one than the table's.
fn disagreement(campaign: &Campaign, rows: &[Row], faults: &[(usize, u32)]) -> Option<String> {
    faults.iter().find_map(|(i, bit)| {
        let (register, row) = (&campaign.registers[*i], &rows[*i]);
        let verdict = campaign.judge(register, 1 << bit);
        let [survives, refused] = [row.survivors, row.refused].map(|bits| bits >> bit & 1 == 1);
        let refuses = matches!(verdict, Verdict::Refused(_));
        ((verdict == Verdict::Survived, refuses) != (survives, refused))
            .then(|| format!("{}, bit {bit}: {verdict:?}, the table says otherwise", row.register))
    })
}

/// All faults of a campaign: index of the register, and bit.
fn all(campaign: &Campaign) -> Vec<(usize, u32)> {
    let registers = campaign.registers.iter().enumerate();
    registers.flat_map(|(i, register)| register.bits().map(move |bit| (i, bit))).collect()
}

fn sample_agrees_with_the_committed_table(model: Model) {
    let (campaign, rows) = (campaign(model), committed(model));
    let names = campaign.registers.iter().map(|register| (&register.name, register.writable));
    assert!(
        names.eq(rows.iter().map(|row| (&row.register, row.bits))),
        "other registers are written"
    );
    let ([killed, refused, unnoticed], [least, most, worst]) =
        (table::shares(&rows), shares(model));
    assert!(
        killed > least && refused < most && unnoticed < worst,
        "{killed}, {refused}, {unnoticed}"
    );

    let faults = all(&campaign);
    let sample: Vec<_> = faults.iter().copied().step_by(faults.len() / SAMPLE).collect();
    assert_eq!(disagreement(&campaign, &rows, &sample), None);

    // A table that takes the first killed fault for an unnoticed or a refused one is noticed; no
    // fault is none.
    let other = |(i, bit): &&(usize, u32)| (rows[*i].survivors | rows[*i].refused) >> bit & 1 == 0;
    let (i, bit) = *sample.iter().find(other).unwrap();
    let columns: [fn(&mut Row) -> &mut u32; 2] = [|row| &mut row.survivors, |row| &mut row.refused];
    for column in columns {
        let mut wrong = rows.clone();
        *column(&mut wrong[i]) |= 1 << bit;
        assert!(disagreement(&campaign, &wrong, &[(i, bit)]).is_some());
    }
    assert_eq!(campaign.judge(&campaign.registers[i], 0), Verdict::Survived);
}

#[test]
fn g431_sample_agrees_with_the_committed_table() {
    sample_agrees_with_the_committed_table(G431);
}

#[test]
fn f411_sample_agrees_with_the_committed_table() {
    sample_agrees_with_the_committed_table(F411);
}

#[test]
fn pages_list_the_committed_survivors() {
    for model in [G431, F411] {
        let path = repository().join(format!("docs/boards/{}.md", name(model)));
        let page = std::fs::read_to_string(path).unwrap();
        let drawn = table::drawn(&page, model, &committed(model));
        assert!(drawn == Some(page), "docs/emulator.md says how the page is drawn again");
    }
}

mod nightly {
    use super::*;

    fn table_agrees(model: Model) {
        let (campaign, rows) = (campaign(model), committed(model));
        assert_eq!(disagreement(&campaign, &rows, &all(&campaign)), None);
    }

    #[test]
    fn g431_table_agrees_with_all_faults() {
        table_agrees(G431);
    }

    #[test]
    fn f411_table_agrees_with_all_faults() {
        table_agrees(F411);
    }
}
