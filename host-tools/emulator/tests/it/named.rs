//! Tests of single faults, planted in the flashed images or written as small programs.
//!
//! `docs/emulator.md` names the test of each fault of its list.

use taxel_emulator::board::chip::Cause;
use taxel_emulator::board::cpu::{Board, End};
use taxel_emulator::board::f411::registers;
use taxel_emulator::board::finger::{Finger, Pace};
use taxel_emulator::board::g431::names::base;
use taxel_emulator::board::host::Host;
use taxel_emulator::board::model::Model::{self, F411, G431};
use taxel_emulator::board::time::micros;

use crate::support::{board, deviation_with, repository, scene, session, stop_with};

/// Program that loads `address` into r0, runs one instruction of two halves, and stands still.
fn program(access: [u16; 2], address: u32) -> Vec<u8> {
    // Stack, entry; ldr r0, [pc, #4]; the access; b .; the address
    let mut code = [0x2000_1000u32, 0x0800_0009].map(u32::to_le_bytes).concat();
    let halves = [0x4801, access[0], access[1], 0xe7fe];
    code.extend(halves.iter().flat_map(|half| u16::to_le_bytes(*half)));
    code.extend(address.to_le_bytes());
    // ELF of 32 bits, little-endian: executable, ARM, one program header behind this one.
    let mut elf = vec![0x7f, b'E', b'L', b'F', 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    elf.extend([2u16, 40].iter().flat_map(|half| half.to_le_bytes()));
    elf.extend([1u32, 0x0800_0009, 52, 0, 0].iter().flat_map(|word| word.to_le_bytes()));
    elf.extend([52u16, 32, 1, 40, 0, 0].iter().flat_map(|half| half.to_le_bytes()));
    // PT_LOAD, offset, addresses, sizes, read and execute, alignment
    let length = code.len() as u32;
    let header = [1, 84, 0x0800_0000, 0x0800_0000, length, length, 5, 4];
    elf.extend(header.iter().flat_map(|word: &u32| word.to_le_bytes()));
    elf.extend(code);
    elf
}

/// Runs such a program for a millisecond.
fn runs(model: Model, access: [u16; 2], address: u32) -> Result<End, String> {
    let finger = Finger::new(scene(), Pace::Scans);
    let elf = program(access, address);
    let mut board = Board::new(model, &elf, finger, Host::new(false)).unwrap();
    board.run(micros(1_000)).map_err(|why| format!("{why:#}"))
}

#[test]
fn address_beyond_the_ram_stops_the_machine() {
    // ldr r1, [r0]; str r1, [r0]
    const LOAD_AND_STORE: [u16; 2] = [0x6801, 0x6001];
    // 16 + 6 KB and the CCM's 10 KB; 128 KB.
    for (model, last) in [(G431, 0x2000_57fc), (G431, 0x1000_27fc), (F411, 0x2001_fffc)] {
        assert_eq!(runs(model, LOAD_AND_STORE, last), Ok(End::Time));
        let beyond = runs(model, LOAD_AND_STORE, last + 4).unwrap_err();
        assert!(beyond.contains("READ_UNMAPPED"), "{beyond}");
        let across = runs(model, LOAD_AND_STORE, last + 2).unwrap_err();
        assert!(across.contains("UNMAPPED"), "{across}");
    }
}

#[test]
fn unaligned_access_of_several_words_stops_the_machine() {
    const RAM: u32 = 0x2000_0100;
    let aligned = [
        ("ldrd r1, r2, [r0]", [0xe9d0, 0x1200]),
        ("strd r1, r2, [r0]", [0xe9c0, 0x1200]),
        ("ldm r0!, {r1, r2}; nop", [0xc806, 0xbf00]),
        ("stm.w r0!, {r1, r2}", [0xe8a0, 0x0006]),
        ("vldr s0, [r0]", [0xed90, 0x0a00]),
        ("vstm r0!, {s0, s1}", [0xeca0, 0x0a02]),
    ];
    for (what, access) in aligned {
        assert_eq!(runs(G431, access, RAM), Ok(End::Time), "{what}");
        for offset in [1, 2, 3] {
            let stopped = runs(G431, access, RAM + offset).expect_err(what);
            assert!(stopped.contains("which is no multiple of four (r0)"), "{what}: {stopped}");
        }
    }
    // ldrex r1, [r0]: unicorn checks that itself.
    assert_eq!(runs(G431, [0xe850, 0x1f00], RAM), Ok(End::Time));
    assert!(runs(G431, [0xe850, 0x1f00], RAM + 2).unwrap_err().contains("exception 4"));
    // ldr.w r1, [r0] may be unaligned.
    assert_eq!(runs(G431, [0xf8d0, 0x1000], RAM + 1), Ok(End::Time));
}

#[test]
fn short_sampling_stops_the_machine() {
    const SMPR2: u32 = 0x18;
    // Temperature for 92.5 cycles, which are 2.2 µs.
    let internal = stop_with(G431, base("ADC1") + SMPR2, |smpr| smpr & !(7 << 18) | 5 << 18);
    assert!(internal.contains("ADC1: input 16 is sampled for 2176 ns"), "{internal}");
    // OPAMP2's output for 2.5 cycles.
    let amplifier = stop_with(G431, base("ADC2") + SMPR2, |smpr| smpr & !(7 << 18));
    assert!(amplifier.contains("ADC2: input 16 is sampled for 58 ns"), "{amplifier}");
    // The STM32F411's inputs for three cycles.
    let columns = stop_with(F411, registers::base("ADC1") + 0x10, |_| 0);
    assert!(columns.contains("ADC1: input 1 is sampled for 125 ns"), "{columns}");
}

#[test]
fn column_with_a_weak_driver_stops_the_machine() {
    for (model, ohm) in [(G431, 1_000.0), (F411, 5_000.0)] {
        let mut board = board(model, scene(), false);
        board.finger().column_ohm = ohm;
        let stopped = board.run(micros(200_000)).unwrap_err().to_string();
        assert!(stopped.contains("and its source needs"), "{stopped}");
    }
}

#[test]
fn stale_data_cache_stops_the_machine() {
    // DCRST stays zero.
    for (model, acr) in [(G431, base("FLASH")), (F411, registers::base("FLASH"))] {
        let mut session = session(model, false);
        session.board.chip().plant(acr, |acr| acr & !(1 << 12));
        let stale = session.upload(&[0x55; 200]).unwrap_err();
        assert!(stale.to_string().contains("the data cache was not reset"), "{stale}");
    }
}

#[test]
fn wrong_request_or_trigger_ends_in_a_watchdog_reset() {
    let ends = |register: u32, change: fn(u32) -> u32| {
        let mut board = board(G431, scene(), false);
        board.chip().plant(register, change);
        board.run(micros(900_000)).unwrap()
    };
    // Request 6 instead of ADC1's 5; another EXTSEL.
    let request = ends(base("DMAMUX1") + 4, |request| if request == 5 { 6 } else { request });
    let trigger = ends(base("ADC1") + 0x0c, |cfgr| cfgr ^ 1 << 5);
    assert_eq!([request, trigger], [End::Reset(Cause::Watchdog); 2]);
}

#[test]
fn missing_clock_or_reference_stops_the_machine() {
    let timer = stop_with(G431, base("RCC") + 0x60, |enables| enables & !(1 << 11));
    assert!(timer.contains("its clock is off: APB2ENR.TIM1EN"), "{timer}");
    let reference = stop_with(G431, base("ADC12_COMMON") + 8, |ccr| ccr & !(1 << 22));
    assert!(reference.contains("ADC1 has no such input"), "{reference}");
}

#[test]
fn dead_row_and_single_place_in_memory_show_in_the_codes() {
    // PB9, the first row, is an alternate function.
    let row = deviation_with(G431, base("GPIOB"), |modes| modes & !(3 << 18) | 2 << 18);
    assert!(row > 10.0, "{row} codes");
    // ADC1's channel of the DMA without MINC.
    let place = deviation_with(G431, base("DMA1") + 0x1c, |ccr| ccr & !(1 << 7));
    assert!(place > 10.0, "{place} codes");
}

#[test]
fn wrong_bias_input_stops_the_machine() {
    // ADC2's third input is PB2 instead of PA5, and its sampling time is not set.
    let wrong = stop_with(G431, base("ADC2") + 0x30, |sqr| sqr & !(0x1f << 18) | 12 << 18);
    assert!(wrong.contains("ADC2: input 12 is sampled for 58 ns"), "{wrong}");
}

#[test]
fn page_names_tests_that_there_are() {
    let page = std::fs::read_to_string(repository().join("docs/emulator.md")).unwrap();
    let (_, list) = page.split_once("## Eighteen faults").expect("the list of faults");
    let (list, _) = list.split_once("\n## ").unwrap();
    let is_row = |line: &&str| line.starts_with("| ") && line.as_bytes()[2].is_ascii_digit();
    let rows: Vec<_> = list.lines().filter(is_row).collect();
    assert_eq!(rows.len(), 18);
    let folder = repository().join("host-tools/emulator");
    for row in rows {
        let mut named = 0;
        for name in row.split('`').skip(1).step_by(2) {
            let Some((file, test)) = name.rsplit_once("::") else { continue };
            let file = file.replace("::", "/");
            let places = [
                format!("tests/it/{file}.rs"),
                format!("src/board/{file}.rs"),
                format!("src/board/{file}/tests.rs"),
            ];
            let sources = places.iter().map(|place| std::fs::read_to_string(folder.join(place)));
            let found = sources.flatten().any(|source| source.contains(&format!("fn {test}(")));
            assert!(found, "no test {name}");
            named += 1;
        }
        assert!(named > 0, "{row}");
    }
}
