//! Tests of uploads interrupted at every byte either way, and at every operation of the flash.
//!
//! The finger must then have the old record or the new one, byte for byte. The error must state
//! which one, or that it is unknown.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::io::{Read, copy};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::ops::ControlFlow;
use std::rc::Rc;
use std::thread;
use std::time::Duration;

use crate::fingers::*;
use embedded_io_adapters::tokio_1::FromTokio;
use embedded_io_async::{ErrorKind, ErrorType, Write};
use taxel::instrument::Instrument;
use taxel::scan::{Codes, Scan};
use taxel::session::{Board, Buffers, Pace, run_session};
use taxel::store::{Area, Flash, FlashError, RamFlash, Store, Word};
use taxel::units::{FullScale, Micros};
use taxel::wire::message::{CHUNK, Identity, Refusal};
use taxel_cli::VirtualFinger;
use taxel_client::{ActiveCalibration, Client, LinkError, Port, Problem};

/// Previous record and new record.
fn records() -> [Vec<u8>; 2] {
    let mut newer = calibration();
    newer.date += 86_400;
    let records = [record(), bytes(&newer)];
    assert!(records[1].len() > CHUNK, "a last chunk after others");
    records
}

/// Uploads through `port`; returns the active calibration according to the error, if there was one.
fn upload(port: &Port, record: &[u8]) -> Result<(), ActiveCalibration> {
    // A cut in the first bytes prevents connecting at all.
    let client = Client::open(port).map_err(|error| {
        assert!(matches!(error.problem(), Some(Problem::Unplugged(_))), "{error}");
        ActiveCalibration::Previous
    })?;
    client
        .upload_calibration(record, |_| ControlFlow::Continue(()))
        .map_err(|error| in_force(&error))
}

fn in_force(error: &LinkError) -> ActiveCalibration {
    let Some(Problem::Upload { why, active }) = error.problem() else { panic!("{error}") };
    assert!(matches!(**why, Problem::Unplugged(_)), "{error}");
    let says = match active {
        ActiveCalibration::Previous => "the previous calibration stays active",
        ActiveCalibration::Either => "the previous or the new calibration is active",
        ActiveCalibration::New => "the new calibration is active",
    };
    assert!(error.to_string().contains(says) && !error.to_string().contains('\n'), "{error}");
    *active
}

/// Creates a cable that is pulled after so many bytes to the finger or to the host. Returns the
/// bytes carried each way, and the port at its near end.
fn cable(finger: &Port, most: [u64; 2]) -> (thread::JoinHandle<[u64; 2]>, Port) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let finger = TcpStream::connect(address(finger)).unwrap();
    let carry = move || {
        let (host, _) = listener.accept().unwrap();
        let pull = |host: &TcpStream, finger: &TcpStream| {
            // Either may be closed already.
            let _ = (host.shutdown(Shutdown::Both), finger.shutdown(Shutdown::Both));
        };
        let ends = [&host, &finger].map(|end| end.try_clone().unwrap());
        let back = thread::spawn(move || {
            let [mut host, finger] = ends;
            let sent = copy(&mut (&finger).take(most[1]), &mut host).unwrap_or_default();
            pull(&host, &finger);
            sent
        });
        let sent = copy(&mut (&host).take(most[0]), &mut &finger).unwrap_or_default();
        pull(&host, &finger);
        [sent, back.join().unwrap()]
    };
    (thread::spawn(carry), Port::Tcp { host: "127.0.0.1".to_owned(), port })
}

fn downloaded(port: &Port) -> Vec<u8> {
    Client::open(port).unwrap().download_calibration().unwrap()
}

#[test]
fn pulled_cable_at_any_byte_leaves_one_record() {
    let [old, new] = records();
    let of = |record: &[u8]| taxel::calibration::Calibration::from_bytes(record).unwrap();
    // A finger for each cut, because one takes a second between two uploads.
    let pulled_after = |most: [u64; 2]| {
        let finger = VirtualFinger::on_tcp("127.0.0.1:0", still(), Some(&of(&old))).unwrap();
        let (cable, port) = cable(finger.port(), most);
        let ended = upload(&port, &new);
        (ended, cable.join().unwrap(), downloaded(finger.port()))
    };
    let (whole, total, found) = pulled_after([u64::MAX; 2]);
    assert_eq!((whole, found), (Ok(()), new.clone()));
    // Length of the record's last chunk, in bytes.
    let last = (new.len() - new.len() / CHUNK * CHUNK) as u64;
    let [to_finger, to_host] = total;
    let every_byte = (to_finger - last - new.len() as u64 / 4)..to_finger;
    let before = (0..every_byte.start).step_by(8);
    let cuts = before.chain(every_byte).map(|bytes| [bytes, u64::MAX]);
    // Answers are short until the record is read back.
    let answers =
        (0..to_host - new.len() as u64).chain((to_host - new.len() as u64..to_host).step_by(16));
    let mut seen = BTreeMap::new();
    for most in cuts.chain(answers.map(|bytes| [u64::MAX, bytes])) {
        let (ended, _, found) = pulled_after(most);
        let is_new = found == new;
        assert!(is_new || found == old, "{most:?}: neither of the two");
        let said = ended.unwrap_err();
        match said {
            ActiveCalibration::Previous => assert!(!is_new, "{most:?}"),
            ActiveCalibration::Either => {}
            ActiveCalibration::New => assert!(is_new, "{most:?}"),
        }
        *seen.entry((format!("{said:?}"), is_new)).or_insert(0) += 1;
    }
    eprintln!("{total:?} bytes each way: {seen:?}");
    for (said, is_new) in [("Previous", false), ("Either", false), ("Either", true), ("New", true)]
    {
        assert!(seen.contains_key(&(said.to_owned(), is_new)), "{said} {is_new}: {seen:?}");
    }
}

/// Power supply that lasts for a number of flash operations. Torn operations are covered by the
/// store's own tests.
#[derive(Clone)]
struct Mains(Rc<Cell<Option<usize>>>);

impl Mains {
    fn is_on(&self) -> bool {
        self.0.get() != Some(0)
    }

    /// Uses up one operation.
    fn use_up(&self) -> Result<(), FlashError> {
        match self.0.get() {
            Some(0) => Err(FlashError),
            left => {
                self.0.set(left.map(|left| left - 1));
                Ok(())
            }
        }
    }
}

struct Mortal {
    cells: RamFlash<Vec<u8>>,
    mains: Mains,
    done: usize,
}

impl Flash for Mortal {
    fn bytes(&self, area: Area) -> &[u8] {
        self.cells.bytes(area)
    }

    fn erase(&mut self, area: Area) -> Result<(), FlashError> {
        self.mains.use_up()?;
        self.done += 1;
        self.cells.erase(area)
    }

    fn program(&mut self, area: Area, offset: usize, word: Word) -> Result<(), FlashError> {
        self.mains.use_up()?;
        self.done += 1;
        self.cells.program(area, offset, word)
    }
}

struct Mcu(Store<Mortal>);

impl Board for Mcu {
    type Flash = Mortal;

    async fn scan(&mut self) -> Option<Scan> {
        tokio::time::sleep(Duration::from_millis(1)).await;
        let full_scale = FullScale::BITS_12;
        let codes = Codes {
            full_scale,
            taxels: None,
            bridges: [None; 4],
            reference: None,
            temperature: None,
        };
        self.0.flash().mains.is_on().then_some(Scan { time: Micros(0), lost: 0, codes })
    }

    fn ticks(&self) -> u32 {
        0
    }

    fn store(&mut self) -> &mut Store<Mortal> {
        &mut self.0
    }
}

/// Writer of a finger that sends nothing without power.
struct Line<W>(W, Mains);

impl<W> ErrorType for Line<W> {
    type Error = ErrorKind;
}

impl<W: Write> Write for Line<W> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        let sent = if self.1.is_on() { self.0.write(bytes).await.ok() } else { None };
        sent.ok_or(ErrorKind::BrokenPipe)
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        Ok(())
    }
}

/// Powers a board up on `cells` for so many operations of its flash, and serves one host. Returns
/// the flash's contents and the number of operations.
fn powered(
    cells: RamFlash<Vec<u8>>,
    operations: Option<usize>,
    host: impl FnOnce(&Port) + Send,
) -> (RamFlash<Vec<u8>>, usize) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let port = Port::Tcp { host: "127.0.0.1".to_owned(), port };
    thread::scope(|scope| {
        let host = scope.spawn(move || host(&port));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let served = runtime.block_on(tokio::task::LocalSet::new().run_until(async move {
            let session = tokio::task::spawn_local(serve(listener, cells, operations));
            session.await.unwrap()
        }));
        host.join().unwrap();
        served
    })
}

fn identity() -> Identity {
    Identity {
        board: "bench".try_into().unwrap(),
        serial: "F-0042".try_into().unwrap(),
        build: "test".try_into().unwrap(),
        scan_hz: 1000,
        full_scale: FullScale::BITS_12,
        tick_hz: 1_000_000,
    }
}

async fn serve(
    listener: TcpListener,
    cells: RamFlash<Vec<u8>>,
    operations: Option<usize>,
) -> (RamFlash<Vec<u8>>, usize) {
    let mains = Mains(Rc::new(Cell::new(operations)));
    let mut mcu = Mcu(Store::new(Mortal { cells, mains: mains.clone(), done: 0 }));
    let mut instrument = Instrument::new(identity());
    instrument.restore(mcu.store(), |_| Err(Refusal::Unsupported));
    let (stream, _) = listener.accept().unwrap();
    stream.set_nonblocking(true).unwrap();
    stream.set_nodelay(true).unwrap();
    let mut stream = tokio::net::TcpStream::from_std(stream).unwrap();
    let (rx, tx) = stream.split();
    let tx = Line(FromTokio::new(tx), mains);
    // The session may end by the power or by the host.
    let _ = run_session(
        FromTokio::new(rx),
        tx,
        &mut mcu,
        &mut instrument,
        &mut Buffers::new(),
        Pace::Live,
    )
    .await;
    let Mortal { cells, done, .. } = mcu.0.into_flash();
    (cells, done)
}

#[test]
fn power_cut_at_any_operation_leaves_one_record() {
    let [old, new] = records();
    let empty = RamFlash::new(vec![0; RamFlash::SIZE]);
    let (with_old, _) = powered(empty, None, |port| upload(port, &old).unwrap());
    let (_, operations) = powered(with_old.clone(), None, |port| upload(port, &new).unwrap());
    assert!(operations > new.len() / 8, "a word each, and the slot's own");
    let mut seen = BTreeMap::new();
    for cut in 1..=operations {
        let mut said = None;
        let (left, _) =
            powered(with_old.clone(), Some(cut), |port| said = upload(port, &new).err());
        let mut found = Vec::new();
        let _ = powered(left, None, |port| found = downloaded(port));
        let is_new = found == new;
        assert!(is_new || found == old, "cut at {cut} of {operations}: neither of the two");
        let said = said.unwrap();
        // No record becomes active before the request, and no answer comes from a board without
        // power.
        assert!(
            if is_new { said == ActiveCalibration::Either } else { said != ActiveCalibration::New },
            "{cut}: {said:?}"
        );
        *seen.entry((format!("{said:?}"), is_new)).or_insert(0) += 1;
    }
    eprintln!("{operations} operations: {seen:?}");
    assert!(seen[&("Previous".to_owned(), false)] > new.len() / 8);
    assert!(seen.contains_key(&("Either".to_owned(), true)), "{seen:?}");
}
