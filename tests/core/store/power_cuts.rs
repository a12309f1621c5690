//! Power cuts at every flash operation and in the middle of one: the last confirmed content stays.
//!
//! Ten million cuts:
//! `TAXEL_LONG=1 cargo test --release -p taxel --test core-tests power_cuts::`. They took 52 s of
//! processor time: 1.0 million torn erasures, 1.9 million torn words of headers, 7.0 million of
//! contents, and no confirmed value was lost.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use taxel::store::{Store, StoredBias};

use super::flash::{Fault, Mortal};
use super::{active_crc, asleep, crc, record, settings, wake};

#[test]
fn power_cut_in_upload_leaves_one_whole_calibration() {
    let (old, new, newer) = (record(1), record(2), record(3));
    let upload = |left: usize, seed: u64| {
        let (mut instrument, mut store) = wake(Mortal::new());
        instrument.install(&old, &mut store).unwrap();
        let (mut instrument, mut store) = wake(asleep(store).revived(left, seed));
        let done = instrument.install(&new, &mut store);
        // Until the restart, a failed upload leaves the old record active.
        let expected = if done.is_ok() { crc(&new) } else { crc(&old) };
        assert_eq!(active_crc(&mut instrument, &mut store), Some(expected));
        (done, asleep(store))
    };
    let operations = upload(usize::MAX, 0).1.done;
    assert_eq!(operations, 1 + new.len().div_ceil(8) + 2, "erase, words, header");
    let mut survivors = [0, 0];
    for left in 1..=operations + 1 {
        for seed in 0..8 {
            let (done, flash) = upload(left, seed);
            let (mut instrument, mut store) = wake(flash.revived(usize::MAX, 0));
            let found = active_crc(&mut instrument, &mut store);
            let is_new = found == Some(crc(&new));
            assert!(is_new || found == Some(crc(&old)), "cut at {left}: {found:?}");
            assert!(is_new || done.is_err(), "cut at {left}: what was confirmed is gone");
            survivors[usize::from(is_new)] += 1;
            // The torn slot takes the next record.
            instrument.install(&newer, &mut store).unwrap();
            assert_eq!(active_crc(&mut instrument, &mut store), Some(crc(&newer)));
        }
    }
    assert!(survivors[0] > 8 * (operations - 3) && survivors[1] >= 8, "{survivors:?}");
}

#[test]
fn power_cut_in_save_leaves_whole_settings() {
    let bias = StoredBias { calibration: 7, bias: None };
    let save = |left: usize, seed: u64| {
        let mut store = wake(Mortal::new()).1;
        store.save_bias(&bias).unwrap();
        store.save_settings(&settings(1)).unwrap();
        let (_, mut store) = wake(asleep(store).revived(left, seed));
        let done = store.save_settings(&settings(2));
        (done, asleep(store))
    };
    let operations = save(usize::MAX, 0).1.done;
    let mut survivors = [0, 0];
    for left in 1..=operations + 1 {
        for seed in 0..8 {
            let (done, flash) = save(left, seed);
            let (_, mut store) = wake(flash.revived(usize::MAX, 0));
            let found = store.settings().map(|settings| settings.hz);
            assert!(matches!(found, Some(1 | 2)), "cut at {left}: {found:?}");
            assert!(found == Some(2) || done.is_err(), "cut at {left}: what was confirmed is gone");
            assert_eq!(store.bias(), Some(bias), "cut at {left}");
            survivors[usize::from(found == Some(2))] += 1;
            store.save_settings(&settings(3)).unwrap();
            assert_eq!(store.settings(), Some(settings(3)));
        }
    }
    assert!(survivors[0] >= 8 && survivors[1] >= 8, "{survivors:?}");
}

/// Contents found after the power cuts of a campaign.
#[derive(Debug, Default)]
struct Survivors {
    /// Records found at power-up: the confirmed one, and the one under way at the cut.
    records: [u64; 2],
    /// Settings found at power-up: the confirmed ones, and those under way at the cut.
    settings: [u64; 2],
    /// Torn erasures, words of a header and words of a content.
    torn: [u64; 3],
}

/// Checks what was found against the confirmed content and the one under way, and counts it.
fn check<T: PartialEq + std::fmt::Debug>(
    found: &T,
    [confirmed, under_way]: &[T; 2],
    counts: &mut [u64; 2],
) -> Result<(), String> {
    if found != confirmed && found != under_way {
        return Err(format!("found {found:?} in place of {confirmed:?} or {under_way:?}"));
    }
    if confirmed != under_way {
        counts[usize::from(found == under_way)] += 1;
    }
    Ok(())
}

/// Cuts the power `cuts` times among mixed uploads and saved settings, at a random operation.
///
/// At each power-up the store must hold the last confirmed value, or the one that was being written
/// at the power cut.
fn campaign(cuts: u64, fault: Fault) -> Result<Survivors, String> {
    let mut draw = ChaCha8Rng::seed_from_u64(7);
    let (mut flash, mut survivors) = (Mortal::with(fault), Survivors::default());
    // Numbers of the last record and of the last settings.
    let (mut number, mut hz) = (0, 0_u16);
    let (mut records, mut rates) = ([None; 2], [None; 2]);
    for cut in 0..=cuts {
        let left = draw.random_range(1..100);
        let (mut instrument, mut store) = wake(flash.revived(left, draw.random()));
        let found = active_crc(&mut instrument, &mut store);
        check(&found, &records, &mut survivors.records).map_err(|e| format!("cut {cut}: {e}"))?;
        records = [found; 2];
        let found = store.settings();
        check(&found, &rates, &mut survivors.settings).map_err(|e| format!("cut {cut}: {e}"))?;
        rates = [found; 2];
        while !off(&store) {
            // An upload has ten times the operations of a save.
            if draw.random_range(0..8) == 0 {
                number += 1;
                let new = record(number);
                let done = instrument.install(&new, &mut store);
                let new = Some(crc(&new));
                records = [if done.is_ok() { new } else { records[0] }, new];
            } else {
                hz = hz.wrapping_add(1);
                let new = settings(hz);
                let done = store.save_settings(&new);
                rates = [if done.is_ok() { Some(new) } else { rates[0] }, Some(new)];
            }
        }
        flash = asleep(store);
    }
    survivors.torn = flash.torn;
    Ok(survivors)
}

fn off(store: &Store<Mortal>) -> bool {
    store.flash().left == 0
}

#[test]
fn last_confirmed_value_survives_power_cuts() {
    let long = std::env::var_os("TAXEL_LONG").is_some();
    let cuts: u64 = if long { 10_000_000 } else { 10_000 };
    let survivors = campaign(cuts, Fault::None).unwrap();
    println!("{cuts} power cuts: {survivors:?}");
    let Survivors { records, settings, torn } = survivors;
    // Cuts that tear nothing, or always leave the same content, would prove little.
    assert!(records.iter().chain(&settings).all(|count| *count > cuts / 1000), "{survivors:?}");
    assert!(torn.iter().all(|count| *count > cuts / 50), "{torn:?}");
}

#[test]
fn power_cuts_find_flash_that_writes_late() {
    campaign(1000, Fault::WritesLate).unwrap_err();
}

#[test]
fn power_cuts_find_disturbed_neighbour() {
    campaign(1000, Fault::DisturbsNeighbour).unwrap_err();
}
