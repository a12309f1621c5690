//! Helpers for the tests of both boards.

use std::path::{Path, PathBuf};

use taxel::frame::{Fields, Frame};
use taxel::scan::Codes;
use taxel::units::{Code, FullScale};
use taxel::wire::message::{BoardHealth, Command, Info, Response};
use taxel::wire::{MAX_PACKET, pack_frame};
use taxel_files::trace::TraceReader;

use taxel_emulator::board::cpu::Board;
use taxel_emulator::board::finger::{Finger, Moment, Pace, Seen};
use taxel_emulator::board::host::Host;
use taxel_emulator::board::model::Model;
use taxel_emulator::board::script::Session;
use taxel_emulator::board::time::{Tick, micros};
use taxel_emulator::board::{f411, g431};

pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Name of a board in `boards/`.
pub fn name(model: Model) -> &'static str {
    match model {
        Model::G431 => "stm32g431",
        Model::G473 => "stm32g473",
        Model::F411 => "stm32f411",
    }
}

/// Address of the scan's timer.
pub fn tim1(model: Model) -> u32 {
    match model {
        Model::G431 | Model::G473 => g431::names::base("TIM1"),
        Model::F411 => f411::registers::base("TIM1"),
    }
}

/// Image that is flashed, from `cargo xtask firmware`.
pub fn image(model: Model) -> Vec<u8> {
    firmware(name(model))
}

/// Image of a board by its name in `boards/`.
pub fn firmware(name: &str) -> Vec<u8> {
    let path = repository().join("boards/target/firmware").join(name).with_extension("elf");
    std::fs::read(&path).unwrap_or_else(|error| {
        panic!("{}: {error}; build it with `cargo xtask firmware {name}`", path.display())
    })
}

/// Scans of a finger with and without contact, in codes of 12 bits.
pub fn scene() -> Vec<Codes> {
    let trace = repository().join("host-tools/emulator/data/scans.csv");
    let scans = TraceReader::open(&trace).unwrap().map(|sample| sample.unwrap().scan.codes);
    scans.map(|codes| codes.rescaled(FullScale::BITS_12)).collect()
}

/// Board that shows `scene` scan by scan, just powered.
pub fn board(model: Model, scene: Vec<Codes>, capture: bool) -> Board {
    let finger = Finger::new(scene, Pace::Scans);
    Board::new(model, &image(model), finger, Host::new(capture)).unwrap()
}

/// Session with a board that shows [`scene`].
pub fn session(model: Model, capture: bool) -> Session {
    Session::open(board(model, scene(), capture)).unwrap()
}

pub fn info(session: &mut Session) -> Info {
    match session.ask(Command::Info).unwrap() {
        Response::Info(info) => info,
        other => panic!("{other:?}"),
    }
}

pub fn health(session: &mut Session) -> BoardHealth {
    match session.ask(Command::Health).unwrap() {
        Response::Health(health) => health,
        other => panic!("{other:?}"),
    }
}

/// Reads a row of the product's page: the value and the limit, if there is one.
///
/// The limit is in per cent of a frame.
pub fn stated(row: &str) -> (u32, Option<u32>) {
    let page = std::fs::read_to_string(repository().join("docs/boards/stm32g431.md")).unwrap();
    let line = page.lines().find(|line| line.starts_with(&format!("| {row} |")));
    let cells: Vec<_> =
        line.unwrap_or_else(|| panic!("no row `{row}`")).split('|').map(str::trim).collect();
    let digits = |cell: &&str| cell.chars().filter(char::is_ascii_digit).collect::<String>();
    (digits(&cells[2]).parse().unwrap(), cells.get(4).and_then(|cell| digits(cell).parse().ok()))
}

/// Reads a board's row of the images' table: deepest stack by machine code, and as seen, in KB.
pub fn stack(board: &str) -> (f64, f64) {
    let page = std::fs::read_to_string(repository().join("docs/boards/images.md")).unwrap();
    let row = page.lines().find_map(|line| line.strip_prefix(&format!("| {board} | "))).unwrap();
    let cells: Vec<f64> =
        row.split(" | ").map_while(|cell| cell.trim_end_matches(" |").parse().ok()).collect();
    (cells[6], cells[8])
}

/// Largest difference between streamed codes and the scene, in codes of 12 bits.
///
/// It covers all channels of all frames, which are `divider` scans apart.
pub fn deviation(frames: &[(Tick, Frame)], scene: &[Codes], divider: usize) -> f32 {
    let distance = |first: usize| {
        let shown = scene.iter().cycle().skip(first).step_by(divider);
        let pairs = frames.iter().zip(shown);
        pairs.map(|((_, frame), shown)| worst(&frame.codes.unwrap(), shown)).fold(0.0, f32::max)
    };
    (0..scene.len()).map(distance).fold(f32::INFINITY, f32::min)
}

fn worst(read: &Codes, shown: &Codes) -> f32 {
    let samples = f32::from(read.full_scale.top().0) / 4095.0;
    let (read, shown) = (channels(read), channels(shown));
    read.zip(shown)
        .map(|(read, shown)| (f32::from(read.0) / samples - f32::from(shown.0)).abs())
        .fold(0.0, f32::max)
}

fn channels(codes: &Codes) -> impl Iterator<Item = Code> {
    let taxels = codes.taxels.unwrap();
    let bridges = codes.bridges.into_iter().flatten().flat_map(|m| [m.a, m.b, m.c, m.d]);
    taxels.lit.into_iter().flatten().chain(taxels.dark).chain(bridges)
}

pub fn stream_codes(session: &mut Session, time: Tick) -> Vec<(Tick, Frame)> {
    session.ask(Command::SetFields(Fields::CODES)).unwrap();
    session.ask(Command::Stream(true)).unwrap();
    session.run(time).unwrap();
    session.ask(Command::Stream(false)).unwrap();
    std::mem::take(&mut session.frames)
}

pub fn packed(frame: &Frame) -> Vec<u8> {
    let mut buffer = [0; MAX_PACKET];
    pack_frame(frame, &mut buffer).unwrap().to_vec()
}

pub fn moments(timing: &[(Tick, Moment)], wanted: impl Fn(&Moment) -> bool) -> Vec<Tick> {
    timing.iter().filter(|(_, moment)| wanted(moment)).map(|(at, _)| *at).collect()
}

/// Index of the first frame's scan among the converted ones.
///
/// Every later frame must be `divider` scans on.
pub fn first_seen(seen: &[Seen], frames: &[(Tick, Frame)], divider: usize) -> usize {
    let fits = |first: &usize| {
        let scans = seen.iter().skip(*first).step_by(divider);
        frames.iter().zip(scans).all(|((_, frame), seen)| frame.codes == Some(seen.codes))
    };
    let last = seen.len() - divider * (frames.len() - 1);
    (0..last)
        .find(fits)
        .expect("the codes of all frames, in order, are among those that were converted")
}

/// Largest difference of streamed codes with an injected fault.
pub fn deviation_with(model: Model, address: u32, change: fn(u32) -> u32) -> f32 {
    let mut board = board(model, scene(), false);
    board.chip().plant(address, change);
    let mut session = Session::open(board).unwrap();
    deviation(&stream_codes(&mut session, micros(100_000)), &scene(), 4)
}

/// Reason why the machine stops with an injected fault.
pub fn stop_with(model: Model, address: u32, change: fn(u32) -> u32) -> String {
    let mut board = board(model, scene(), false);
    board.chip().plant(address, change);
    let ran = board.run(micros(200_000));
    ran.expect_err("the machine runs with the fault").to_string()
}
