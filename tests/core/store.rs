//! Stored calibration and settings: kept over power-off, replaced in turn, checked when read.

mod flash;
mod power_cuts;

use crate::common;
use crate::common::{calibration, identity};
use taxel::calibration::MAX_BYTES;
use taxel::condition::{Bias, TaxelBias};
use taxel::estimate::contact_point::PointMethod;
use taxel::frame::Fields;
use taxel::instrument::Instrument;
use taxel::scan::{ScanSetting, ScanSettings};
use taxel::store::{Area, Flash, FlashError, RamFlash, Settings, Store, StoreError, StoredBias};
use taxel::units::FullScale;
use taxel::wire::message::{Command, Info, Message, Refusal, Request, Response};

use flash::Mortal;

/// A record unique to `number`, longer than one chunk.
fn record(number: u64) -> Vec<u8> {
    let mut calibration = calibration();
    calibration.date = number;
    let mut buffer = [0; MAX_BYTES];
    calibration.to_bytes(&mut buffer).unwrap().to_vec()
}

fn crc(record: &[u8]) -> u32 {
    u32::from_le_bytes(*record.last_chunk().unwrap())
}

/// A board whose scan rate is at most 2 kHz.
fn rescan(scan: &ScanSettings) -> Result<FullScale, Refusal> {
    let (setting, low, high) = (ScanSetting::ScanHz, 1, 2000);
    let possible = u32::from(scan.scan_hz) <= high;
    if possible { Ok(FullScale::BITS_16) } else { Err(Refusal::Scan { setting, low, high }) }
}

/// Powers up.
fn wake(flash: Mortal) -> (Instrument, Store<Mortal>) {
    let mut instrument = Instrument::new(identity());
    let mut store = Store::new(flash);
    instrument.restore(&mut store, rescan);
    (instrument, store)
}

fn asleep(store: Store<Mortal>) -> Mortal {
    store.into_flash()
}

fn ask(
    instrument: &mut Instrument,
    store: &mut Store<Mortal>,
    command: Command,
) -> Result<Response, Refusal> {
    match instrument.handle(&Request { tag: 0, command }, store) {
        Some(Message::Reply { result, .. }) => result,
        other => panic!("{other:?}"),
    }
}

fn info(instrument: &mut Instrument, store: &mut Store<Mortal>) -> Info {
    match ask(instrument, store, Command::Info) {
        Ok(Response::Info(info)) => info,
        other => panic!("{other:?}"),
    }
}

fn active_crc(instrument: &mut Instrument, store: &mut Store<Mortal>) -> Option<u32> {
    let shown = info(instrument, store).calibration.map(|id| id.crc);
    // The reported, the read and the active record are the same.
    assert_eq!(shown, store.record().map(crc));
    shown
}

#[test]
fn calibration_survives_power_off() {
    let (mut instrument, mut store) = wake(Mortal::new());
    assert_eq!(active_crc(&mut instrument, &mut store), None);
    for number in 1..6 {
        instrument.install(&record(number), &mut store).unwrap();
        (instrument, store) = wake(asleep(store));
        assert_eq!(active_crc(&mut instrument, &mut store), Some(crc(&record(number))));
    }
}

#[test]
fn interrupted_upload_keeps_old_calibration() {
    let (mut instrument, mut store) = wake(Mortal::new());
    instrument.install(&record(1), &mut store).unwrap();
    let (new, old) = (record(2), crc(&record(1)));
    ask(&mut instrument, &mut store, Command::CalibrationBegin { length: new.len() as u16 })
        .unwrap();
    let data = new[..64].iter().copied().collect();
    ask(&mut instrument, &mut store, Command::CalibrationChunk { offset: 0, data }).unwrap();
    // The host disconnects. Another host finds the old record and can read it meanwhile.
    assert_eq!(active_crc(&mut instrument, &mut store), Some(old));
    let read = ask(&mut instrument, &mut store, Command::CalibrationRead { offset: 0 });
    assert!(matches!(read, Ok(Response::Calibration { .. })), "{read:?}");
    instrument.install(&new, &mut store).unwrap();
    assert_eq!(active_crc(&mut instrument, &mut store), Some(crc(&new)));
}

#[test]
fn foreign_record_is_skipped_for_the_older_one() {
    let (mut instrument, mut store) = wake(Mortal::new());
    instrument.install(&record(1), &mut store).unwrap();
    let mut foreign = record(2);
    foreign[0] = 99;
    let end = foreign.len() - 4;
    let sum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&foreign[..end]);
    foreign[end..].copy_from_slice(&sum.to_le_bytes());
    store.begin(foreign.len()).unwrap();
    store.write(0, &foreign).unwrap();
    store.commit().unwrap();
    let (mut instrument, mut store) = wake(asleep(store));
    assert_eq!(active_crc(&mut instrument, &mut store), Some(crc(&record(1))));
}

/// Stores `content` in an erased area under the number `sequence`.
fn number(flash: &mut Mortal, area: Area, sequence: u32, content: &[u8]) {
    let mut stored = b"TXCL".to_vec();
    stored.extend(sequence.to_le_bytes());
    stored.extend((content.len() as u32).to_le_bytes());
    stored.extend(crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&stored).to_le_bytes());
    stored.extend(content);
    flash.rewrite(area, |bytes| bytes[..stored.len()].copy_from_slice(&stored));
}

#[test]
fn newest_record_is_found_where_numbers_wrap() {
    let mut flash = Mortal::new();
    number(&mut flash, Area::SlotA, u32::MAX - 2, &record(1));
    let (mut instrument, mut store) = wake(flash);
    assert_eq!(active_crc(&mut instrument, &mut store), Some(crc(&record(1))));
    for newest in 2..8 {
        instrument.install(&record(newest), &mut store).unwrap();
        (instrument, store) = wake(asleep(store));
        let found = active_crc(&mut instrument, &mut store);
        assert_eq!(found, Some(crc(&record(newest))), "record {newest}");
    }
}

#[test]
fn unordered_or_torn_words_are_errors() {
    let mut store = Store::new(Mortal::new());
    assert_eq!(store.write(0, &[1; 8]), Err(StoreError::OutOfOrder), "nothing was begun");
    assert_eq!(store.commit(), Err(StoreError::OutOfOrder));
    assert_eq!(store.begin(MAX_BYTES + 1), Err(StoreError::OutOfOrder));
    store.begin(20).unwrap();
    assert_eq!(store.write(8, &[1; 8]), Err(StoreError::OutOfOrder), "a gap");
    assert_eq!(store.write(0, &[1; 7]), Err(StoreError::OutOfOrder), "half a word");
    store.write(0, &[1; 16]).unwrap();
    assert_eq!(store.written(), Err(StoreError::OutOfOrder), "parts are missing");
    assert_eq!(store.write(16, &[1; 8]), Err(StoreError::OutOfOrder), "too much");
    store.write(16, &[1; 4]).unwrap();
    assert_eq!(store.written(), Ok(&[1; 20][..]));
}

#[test]
fn memory_flash_is_as_strict_as_flash() {
    let mut flash = RamFlash::new(vec![0; RamFlash::SIZE]);
    flash.program(Area::SlotB, 8, [0; 8]).unwrap();
    assert_eq!(flash.program(Area::SlotB, 8, [0; 8]), Err(FlashError), "twice");
    assert_eq!(flash.program(Area::SlotB, 4, [0; 8]), Err(FlashError), "across words");
    assert_eq!(flash.program(Area::PageB, 2048, [0; 8]), Err(FlashError), "beyond its end");
    assert_eq!(flash.bytes(Area::SlotA), [0xff; 4096]);
    flash.erase(Area::SlotB).unwrap();
    flash.program(Area::SlotB, 8, [1; 8]).unwrap();
}

/// Clears the bits of the first non-zero byte from `offset` on, as in aged cells.
fn rot(flash: &mut Mortal, area: Area, offset: usize) {
    flash.rewrite(area, |bytes| {
        *bytes[offset..].iter_mut().find(|byte| **byte != 0).unwrap() = 0;
    });
}

fn record_intact(instrument: &mut Instrument, store: &mut Store<Mortal>) -> Option<bool> {
    let request = Request { tag: 0, command: Command::SelfTest { scans: 2 } };
    assert_eq!(instrument.handle(&request, store), None);
    let _ = instrument.scan(&common::unloaded(0));
    assert!(instrument.scan(&common::unloaded(250)).reply);
    match instrument.take_reply() {
        Some(Message::Reply { result: Ok(Response::SelfTest(test)), .. }) => test.record_intact,
        other => panic!("{other:?}"),
    }
}

#[test]
fn self_test_reports_record_damaged_at_power_up() {
    let (mut instrument, mut store) = wake(Mortal::new());
    assert_eq!(record_intact(&mut instrument, &mut store), None);
    instrument.install(&record(1), &mut store).unwrap();
    assert_eq!(record_intact(&mut instrument, &mut store), Some(true));
    instrument.install(&record(2), &mut store).unwrap();

    // The byte lies among the second record's coefficients, after its header.
    let mut flash = asleep(store);
    rot(&mut flash, Area::SlotB, 200);
    let (mut instrument, mut store) = wake(flash);
    assert_eq!(active_crc(&mut instrument, &mut store), Some(crc(&record(1))), "the older one");
    assert_eq!(record_intact(&mut instrument, &mut store), Some(false));

    let mut flash = asleep(store);
    rot(&mut flash, Area::SlotA, 200);
    let (mut instrument, mut store) = wake(flash);
    assert_eq!(active_crc(&mut instrument, &mut store), None);
    assert_eq!(record_intact(&mut instrument, &mut store), Some(false));

    // One upload repairs it, also after a restart.
    instrument.install(&record(3), &mut store).unwrap();
    assert_eq!(record_intact(&mut instrument, &mut store), Some(true));
    let (mut instrument, mut store) = wake(asleep(store));
    assert_eq!(active_crc(&mut instrument, &mut store), Some(crc(&record(3))));
    assert_eq!(record_intact(&mut instrument, &mut store), Some(true));
}

fn settings(hz: u16) -> Settings {
    Settings {
        hz,
        fields: Fields::FORCE,
        point_method: PointMethod::ArgMin,
        scan: None,
        filter_hz: 0,
    }
}

#[test]
fn saved_settings_and_bias_survive_power_off() {
    let (mut instrument, mut store) = wake(Mortal::new());
    instrument.install(&record(1), &mut store).unwrap();
    ask(&mut instrument, &mut store, Command::SetRate { hz: 250 }).unwrap();
    let (mut instrument, mut store) = wake(asleep(store));
    assert_eq!(info(&mut instrument, &mut store).rate_millihertz, 1_000_000, "not saved");

    ask(&mut instrument, &mut store, Command::SetRate { hz: 250 }).unwrap();
    ask(&mut instrument, &mut store, Command::SetFields(Fields::FORCE)).unwrap();
    ask(&mut instrument, &mut store, Command::SetPointMethod(PointMethod::ArgMin)).unwrap();
    ask(&mut instrument, &mut store, Command::SetFilter { hz: 50 }).unwrap();
    ask(&mut instrument, &mut store, Command::SaveSettings).unwrap();
    assert!(
        instrument
            .handle(&Request { tag: 0, command: Command::TakeBias { scans: 4 } }, &mut store)
            .is_none()
    );
    assert_eq!(ask(&mut instrument, &mut store, Command::SaveBias), Err(Refusal::Busy));
    for t in 0..4 {
        let _ = instrument.scan(&common::unloaded(250 * t));
    }
    ask(&mut instrument, &mut store, Command::SaveBias).unwrap();
    let before = ask(&mut instrument, &mut store, Command::ReadBias);

    let (mut instrument, mut store) = wake(asleep(store));
    let found = info(&mut instrument, &mut store);
    assert_eq!((found.rate_millihertz, found.fields), (250_000, Fields::FORCE));
    assert_eq!((found.point_method, found.filter_hz), (PointMethod::ArgMin, 50));
    assert!(found.biased);
    assert_eq!(ask(&mut instrument, &mut store, Command::ReadBias), before);

    // A cleared and saved bias is gone.
    ask(&mut instrument, &mut store, Command::ClearBias).unwrap();
    ask(&mut instrument, &mut store, Command::SaveBias).unwrap();
    let (mut instrument, mut store) = wake(asleep(store));
    assert!(!info(&mut instrument, &mut store).biased);
}

/// Range of the normal forces, in newtons, of a press whose light flickers by ±1 %.
fn ripple(instrument: &mut Instrument, start: u64) -> f32 {
    let forces = (0..1000).filter_map(|i| {
        let codes = if i % 2 == 0 { 3_244 } else { 3_310 };
        let scan = common::pressed(start + 250 * i, 6, codes);
        let frame = instrument.scan(&scan).frame.then(|| instrument.frame(&scan));
        frame.filter(|_| i >= 500).map(|frame| frame.force.unwrap().z.unwrap().0)
    });
    let (low, high) =
        forces.fold((f32::MAX, f32::MIN), |(low, high), fz| (low.min(fz), high.max(fz)));
    high - low
}

#[test]
fn saved_filter_smooths_forces_until_set_to_none() {
    let (mut instrument, mut store) = wake(Mortal::new());
    instrument.install(&record(1), &mut store).unwrap();
    ask(&mut instrument, &mut store, Command::SetRate { hz: 4000 }).unwrap();
    ask(&mut instrument, &mut store, Command::SetFilter { hz: 100 }).unwrap();
    ask(&mut instrument, &mut store, Command::SaveSettings).unwrap();

    let (mut instrument, mut store) = wake(asleep(store));
    ask(&mut instrument, &mut store, Command::Stream(true)).unwrap();
    let smooth = ripple(&mut instrument, 0);
    ask(&mut instrument, &mut store, Command::SetFilter { hz: 0 }).unwrap();
    let plain = ripple(&mut instrument, 250_000);
    assert!(plain > 1.5e-3 && smooth < 0.01 * plain, "{plain} N, smoothed {smooth} N");
}

#[test]
fn saving_unchanged_settings_erases_nothing() {
    let (mut instrument, mut store) = wake(Mortal::new());
    ask(&mut instrument, &mut store, Command::SetRate { hz: 250 }).unwrap();
    ask(&mut instrument, &mut store, Command::SaveSettings).unwrap();
    let operations = store.flash().done;
    ask(&mut instrument, &mut store, Command::SaveSettings).unwrap();
    assert_eq!(store.flash().done, operations);
    ask(&mut instrument, &mut store, Command::SetRate { hz: 500 }).unwrap();
    ask(&mut instrument, &mut store, Command::SaveSettings).unwrap();
    assert!(store.flash().done > operations);
}

#[test]
fn saved_scan_is_restored_where_board_can() {
    for (scan_hz, taken_up) in [(1000, true), (3000, false)] {
        let (mut instrument, mut store) = wake(Mortal::new());
        // The session reports the board's new scan.
        let scan = ScanSettings { scan_hz, oversampling: 4, settle_ns: 30_000 };
        instrument.rescanned(&scan, FullScale::BITS_12);
        ask(&mut instrument, &mut store, Command::SetRate { hz: 500 }).unwrap();
        ask(&mut instrument, &mut store, Command::SaveSettings).unwrap();
        assert_eq!(store.settings().unwrap().scan, Some(scan));

        let (mut instrument, mut store) = wake(asleep(store));
        let found = info(&mut instrument, &mut store);
        let scan_hz = if taken_up { scan_hz } else { identity().scan_hz };
        assert_eq!((found.identity.scan_hz, found.rate_millihertz), (scan_hz, 500_000));
        assert_eq!(found.identity.full_scale, FullScale::BITS_16, "as the board says");
    }
}

#[test]
fn saved_bias_is_void_under_another_calibration() {
    let (mut instrument, mut store) = wake(Mortal::new());
    instrument.install(&record(1), &mut store).unwrap();
    let taxels = TaxelBias { level: [0.25; 16], noise: 1e-4 };
    let bias = Some(Bias { taxels: Some(taxels), ..Bias::default() });
    store.save_bias(&StoredBias { calibration: crc(&record(1)), bias }).unwrap();
    let (mut instrument, mut store) = wake(asleep(store));
    assert!(info(&mut instrument, &mut store).biased);
    instrument.install(&record(2), &mut store).unwrap();
    assert!(!info(&mut instrument, &mut store).biased);
    let (mut instrument, mut store) = wake(asleep(store));
    assert!(!info(&mut instrument, &mut store).biased);
}
