//! Uploads and saves: what is active afterwards, and the erasures of flash that they cost.

use crate::common::{calibration, identity};
use crate::session::{Host, fresh, run, scans};
use taxel::calibration::{CalibrationError, MAX_BYTES};
use taxel::instrument::Instrument;
use taxel::scan::ScanSettings;
use taxel::session::{Board, Pace};
use taxel::store::{RamFlash, Store};
use taxel::wire::message::{CHUNK, Command, Erasures, Refusal, Response};

pub(crate) async fn upload(host: &mut Host, record: &[u8]) -> Result<Response, Refusal> {
    host.ask(Command::CalibrationBegin { length: record.len() as u16 }).await?;
    for (i, chunk) in record.chunks(CHUNK).enumerate() {
        let data = heapless::Vec::from_slice(chunk).unwrap();
        host.ask(Command::CalibrationChunk { offset: (i * CHUNK) as u16, data }).await?;
    }
    host.ask(Command::CalibrationCommit).await
}

#[test]
fn uploaded_calibration_is_active_and_read_back() {
    let mut buffer = [0; MAX_BYTES];
    let record = calibration().to_bytes(&mut buffer).unwrap();
    run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        assert_eq!(
            host.ask(Command::CalibrationRead { offset: 0 }).await,
            Err(Refusal::Uncalibrated)
        );
        assert_eq!(upload(host, record).await, Ok(Response::Done));
        let id = host.info().await.calibration.unwrap();
        assert_eq!(id.serial, "test");
        assert_eq!(id.crc.to_le_bytes(), *record.last_chunk().unwrap(), "the CRC in the file");
        let mut back = vec![];
        loop {
            let offset = back.len() as u16;
            let part = host.ask(Command::CalibrationRead { offset }).await;
            let Ok(Response::Calibration { data, .. }) = part else { panic!("{part:?}") };
            back.extend_from_slice(&data);
            if data.len() < CHUNK {
                break;
            }
        }
        assert_eq!(back, record);
    });
}

#[test]
fn damaged_upload_keeps_old_calibration_active() {
    let mut buffer = [0; MAX_BYTES];
    let length = calibration().to_bytes(&mut buffer).unwrap().len();
    let (mut instrument, mut board) = (fresh(), scans(1_000_000));
    instrument.install(&buffer[..length], board.store()).unwrap();
    run(instrument, board, Pace::Live, 4096, async |host| {
        let crc = host.info().await.calibration.unwrap().crc;
        buffer[40] ^= 1;
        let refused = upload(host, &buffer[..length]).await;
        assert_eq!(refused, Err(Refusal::Calibration(CalibrationError::Crc)));
        let begin = Command::CalibrationBegin { length: length as u16 };
        when_rested(host, begin).await.unwrap();
        assert_eq!(host.ask(Command::CalibrationCommit).await, Err(Refusal::OutOfOrder));
        let data = heapless::Vec::from_slice(&[0; 4]).unwrap();
        let gap = host.ask(Command::CalibrationChunk { offset: 4, data }).await;
        assert_eq!(gap, Err(Refusal::OutOfOrder));
        assert_eq!(host.info().await.calibration.unwrap().crc, crc);
    });
}

/// Asks again until the finger has rested from its last erasure.
async fn when_rested(host: &mut Host, command: Command) -> Result<Response, Refusal> {
    loop {
        match host.ask(command.clone()).await {
            Err(Refusal::Busy) => {}
            answer => return answer,
        }
    }
}

async fn erasures(host: &mut Host) -> Erasures {
    match host.ask(Command::Health).await {
        Ok(Response::Health(health)) => health.erasures.unwrap(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn erasures_are_a_second_of_scans_apart() {
    run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        let second = u32::from(host.info().await.identity.scan_hz);
        let begin = Command::CalibrationBegin { length: 1000 };
        let mut last = None;
        for hz in 1..6 {
            host.ask(Command::SetRate { hz }).await.unwrap();
            for command in [Command::SaveSettings, begin.clone()] {
                let before = erasures(host).await;
                when_rested(host, command).await.unwrap();
                assert_ne!(erasures(host).await, before);
                let scans = host.info().await.counters.scans;
                if let Some(last) = last.replace(scans) {
                    // Some scans pass between the erasure and the count.
                    assert!(scans - last > second - 10, "{last} {scans}");
                }
            }
        }
        assert_eq!(erasures(host).await, Erasures { calibration: 5, settings: 5 });
    });
}

#[test]
fn slower_scan_does_not_shorten_the_second() {
    run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        let scan =
            |scan_hz| Command::SetScan(ScanSettings { scan_hz, oversampling: 1, settle_ns: 0 });
        host.ask(scan(8000)).await.unwrap();
        host.ask(Command::SaveSettings).await.unwrap();
        let saved = host.info().await.counters.scans;
        while host.info().await.counters.scans - saved < 1000 {}
        host.ask(scan(1000)).await.unwrap();
        let rescanned = host.info().await.counters.scans;
        when_rested(host, Command::SaveSettings).await.unwrap();
        assert!(host.info().await.counters.scans - rescanned > 990);
    });
}

#[test]
fn faster_scan_does_not_bring_a_past_second_back() {
    run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        let scan =
            |scan_hz| Command::SetScan(ScanSettings { scan_hz, oversampling: 1, settle_ns: 0 });
        host.ask(scan(1000)).await.unwrap();
        host.ask(Command::SaveSettings).await.unwrap();
        let saved = host.info().await.counters.scans;
        while host.info().await.counters.scans - saved < 1000 {}
        host.ask(scan(8000)).await.unwrap();
        assert_eq!(host.ask(Command::SaveSettings).await, Ok(Response::Done));
    });
}

#[test]
fn refused_erasure_leaves_flash_and_upload_as_they_are() {
    let mut buffer = [0; MAX_BYTES];
    let record = calibration().to_bytes(&mut buffer).unwrap();
    run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        let begin = Command::CalibrationBegin { length: record.len() as u16 };
        host.ask(begin.clone()).await.unwrap();
        // Another host's wishes come between the chunks of an upload.
        for command in [begin, Command::SaveSettings, Command::SaveBias] {
            assert_eq!(host.ask(command).await, Err(Refusal::Busy));
        }
        for (i, chunk) in record.chunks(CHUNK).enumerate() {
            let data = heapless::Vec::from_slice(chunk).unwrap();
            let chunk = Command::CalibrationChunk { offset: (i * CHUNK) as u16, data };
            host.ask(chunk).await.unwrap();
        }
        assert_eq!(host.ask(Command::CalibrationCommit).await, Ok(Response::Done));
        assert_eq!(erasures(host).await, Erasures { calibration: 1, settings: 0 });
    });
}

#[test]
fn replay_without_scans_may_erase_at_once() {
    run(fresh(), scans(100), Pace::Lossless, 4096, async |host| {
        for hz in 1..6 {
            host.ask(Command::SetRate { hz }).await.unwrap();
            assert_eq!(host.ask(Command::SaveSettings).await, Ok(Response::Done));
        }
        assert_eq!(erasures(host).await.settings, 5);
    });
}

#[test]
fn erasures_are_counted_over_the_life_of_the_flash() {
    let mut buffer = [0; MAX_BYTES];
    let record = calibration().to_bytes(&mut buffer).unwrap();
    let mut flash = RamFlash::new(vec![0; RamFlash::SIZE]);
    for life in 1..=5 {
        let mut store = Store::new(flash);
        let mut instrument = Instrument::new(identity());
        instrument.restore(&mut store, |_| unreachable!("no scan settings were saved"));
        // The second upload breaks off, and a third is completed after it.
        instrument.install(record, &mut store).unwrap();
        store.begin(record.len()).unwrap();
        instrument.install(record, &mut store).unwrap();
        let expected = Erasures { calibration: 3 * life, settings: 0 };
        assert_eq!(store.erasures(), expected);
        flash = store.into_flash();
    }
}
