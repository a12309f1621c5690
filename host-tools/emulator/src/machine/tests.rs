//! Small programs with a cost computed by hand.

use std::cell::Cell;
use std::rc::Rc;

use super::*;
use crate::clock::Count;
use crate::cost::Band;
use crate::fetch::Settings;

const CODE: u32 = FLASH + 0x40;
/// bkpt #0xab
const CALL_HOST: u16 = 0xbeab;
const PLENTY: u64 = 1_000_000;

fn machine(halves: &[u16]) -> Machine {
    let mut machine = Machine::blank().unwrap();
    let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
    let vectors = [0x2000_1000u32, CODE | 1].map(u32::to_le_bytes).concat();
    machine.write(FLASH, &vectors).unwrap();
    machine.write(CODE, &code).unwrap();
    machine.reset().unwrap();
    machine
}

fn count(instructions: u64, low: u64, high: u64) -> Count {
    Count { instructions, cycles: Band { low, high }, ..Count::default() }
}

/// movs r0, #10; subs r0, #1; bne back to it; bkpt
const LOOP: [u16; 4] = [0x200a, 0x3801, 0xd1fd, CALL_HOST];

#[test]
fn a_loop_costs_its_turns() {
    let mut machine = machine(&LOOP);
    machine.run(PLENTY).unwrap();
    // Ten subtractions, nine branches taken, one not, and the instructions before and after.
    assert_eq!(machine.clock().total(), count(1 + 10 + 10 + 1, 1 + 10 + 9 * 3 + 1 + 1, 40));
}

#[test]
fn host_call_returns_and_program_continues() {
    // movs r0, #24; movs r1, #7; bkpt; adds r0, #1; bkpt
    let mut machine = machine(&[0x2018, 0x2107, CALL_HOST, 0x3001, CALL_HOST]);
    assert_eq!(machine.run(PLENTY).unwrap(), HostCall { operation: 24, parameter: 7 });
    machine.answer(41).unwrap();
    assert_eq!(machine.run(PLENTY).unwrap().operation, 42);
}

#[test]
fn measured_call_covers_the_function_only() {
    let program = [
        // ldr r3, [pc, #8]; movs r2, #1; bkpt; blx r3; bkpt; nop
        0x4b02, 0x2201, CALL_HOST, 0x4798, CALL_HOST, 0xbf00, //
        // the function's address
        0x0051, 0x0800, //
        // vmul.f32 s0, s0, s0; vadd.f32 s0, s0, s0; bx lr
        0xee20, 0x0a00, 0xee30, 0x0a00, 0x4770,
    ];
    let mut machine = machine(&program);
    machine.run(PLENTY).unwrap();
    machine.clock().await_call(CODE + 0x11);
    machine.run(PLENTY).unwrap();
    // A multiplication, an addition that waits a cycle for it, a return that refills the pipeline.
    let measured = machine.clock().take_measured().unwrap();
    assert_eq!(Count { bounds: Band::default(), ..measured }, count(3, 1 + 2 + 3, 6));
    assert_eq!(measured.bounds, Band { low: 1 + 2 + 2, high: 1 + 2 + 4 });
    let visited: u64 = machine.clock().blocks().iter().map(|(_, v)| v.taken + v.fell_through).sum();
    assert_eq!(visited, 1);
}

#[test]
fn call_without_return_is_not_measured() {
    let mut machine = machine(&LOOP);
    machine.clock().await_call(CODE + 2);
    machine.run(PLENTY).unwrap();
    assert_eq!(machine.clock().take_measured(), None);
}

#[test]
fn blocks_and_single_steps_count_alike() {
    // Longer than any block of the translator's and across pages: 5000 times
    // adds r1, #1; cmp r1, #9; ite eq; moveq r2, r1; movne r3, r1; then a loop.
    let mut program = [0x3101, 0x2909, 0xbf0c, 0x460a, 0x460b].repeat(5000);
    program.extend(LOOP);
    let mut machine = machine(&program);
    let steps = Rc::new(Cell::new(0));
    let counter = steps.clone();
    machine.unicorn.add_code_hook(1, 0, move |_, _, _| counter.set(counter.get() + 1)).unwrap();
    machine.run(PLENTY).unwrap();
    assert_eq!(machine.clock().total().instructions, 25_000 + 22);
    // The translator steps over what is skipped; on silicon it takes its cycle.
    assert_eq!(steps.get(), 25_000 + 22 - 5000);
}

#[test]
fn floating_point_matches_host_bit_for_bit() {
    // vdiv.f32 s0, s0, s1; vsqrt.f32 s0, s0; vmov r0, s0; bkpt
    let program = [0xee80, 0x0a20, 0xeeb1, 0x0ac0, 0xee10, 0x0a10, CALL_HOST];
    for (a, b) in [(1.0f32, 3.0f32), (2.0, 7.0), (1e-38, 3e3), (f32::MAX, 0.5)] {
        let mut machine = machine(&program);
        for (register, value) in [(RegisterARM::S0, a), (RegisterARM::S1, b)] {
            machine.set(register, value.to_bits()).unwrap();
        }
        assert_eq!(machine.run(PLENTY).unwrap().operation, (a / b).sqrt().to_bits());
    }
}

fn error(halves: &[u16]) -> String {
    machine(halves).run(1000).unwrap_err().to_string()
}

#[test]
fn unsupported_access_stops_machine_by_name() {
    // mov.w r0, #0xe000e000; ldr r1, [r0, #16]; bkpt: SysTick is not modelled here.
    let systick = error(&[0xf04f, 0x20e0, 0xf44f, 0x4060, 0xf2ce, 0x0000, 0x6901, CALL_HOST]);
    assert!(systick.contains("read of 0xe000e010"), "{systick}");
    // vadd.f64 d0, d1, d2
    let double = error(&[0xee31, 0x0b02, CALL_HOST]);
    assert!(double.contains("no model of the instruction 0x0b02ee31"), "{double}");
    // movs r0, #0; ldr r1, [r0]: nothing is mapped there.
    assert!(error(&[0x2000, 0x6801, CALL_HOST]).contains("READ_UNMAPPED"));
    // bkpt #1 is not semihosting.
    assert!(error(&[0xbe01]).contains("without a semihosting call"));
}

#[test]
fn hanging_program_is_stopped() {
    // b to itself
    assert!(error(&[0xe7fe]).contains("still running"));
}

/// Cycles that the core waits for the flash in a program at `address`, with these settings.
fn waits(address: u32, halves: &[u16], settings: Settings) -> u64 {
    let mut machine = Machine::blank().unwrap();
    let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
    let vectors = [0x2000_1000u32, address | 1].map(u32::to_le_bytes).concat();
    machine.write(FLASH, &vectors).unwrap();
    machine.write(address, &code).unwrap();
    machine.reset().unwrap();
    machine.clock().fetch().set(settings);
    machine.run(PLENTY).unwrap();
    machine.clock().total().waits
}

/// Accelerator off.
fn bare(wait_states: u64) -> Settings {
    Settings { wait_states, ..Settings::default() }
}

const CACHED: Settings = Settings { prefetch: false, ..Settings::G431 };

#[test]
fn code_in_ram_never_waits() {
    for wait_states in 0..=8 {
        assert_eq!(waits(0x2000_2000, &LOOP, bare(wait_states)), 0);
        let on = Settings { wait_states, ..Settings::G431 };
        assert_eq!(waits(0x2000_2000, &LOOP, on), 0);
    }
}

#[test]
fn straight_code_waits_for_each_word() {
    // adds r1, #1, a hundred words of four; then the call.
    let mut program = vec![0x3101; 400];
    program.push(CALL_HOST);
    for wait_states in 0..=8 {
        assert_eq!(waits(CODE, &program, bare(wait_states)), 101 * wait_states);
        // Nothing runs twice, so that the caches are of no use.
        let cached = Settings { wait_states, ..CACHED };
        assert_eq!(waits(CODE, &program, cached), 101 * wait_states);
        // A read takes one cycle more than the wait states, of which four pass in the word before.
        let prefetched = Settings { wait_states, ..Settings::G431 };
        let hidden = (wait_states + 1).saturating_sub(4);
        assert_eq!(waits(CODE, &program, prefetched), wait_states + 100 * hidden);
    }
}

#[test]
fn cached_loop_waits_in_its_first_turn_only() {
    // Without a cache the present word is there all the same, and it holds the whole loop.
    let short = [&[0xbf00; 3][..], &LOOP].concat();
    assert_eq!(waits(CODE, &short, CACHED), 2 * 4);
    assert_eq!(waits(CODE, &short, bare(4)), 2 * 4);
    // movs r0, #10; then ten turns of 16 words; bne.w back to the first; the call.
    let mut long = vec![0x200a, 0xbf00, 0xbf00, 0xbf00];
    long.extend([0x3101; 61]);
    long.extend([0x3801, 0xf47f, 0xafc0, CALL_HOST]);
    assert_eq!(waits(CODE, &long, CACHED), (1 + 16 + 1) * 4);
    assert_eq!(waits(CODE, &long, bare(4)), (1 + 10 * 16 + 1) * 4);
}

#[test]
fn loop_longer_than_the_cache_waits_every_turn() {
    // As above, with 1200 bytes a turn: 150 words, and the least recently used go first.
    let mut program = vec![0x200a, 0xbf00, 0xbf00, 0xbf00];
    program.extend([0x3101; 596]);
    program.extend([0xbf00, 0x3801, 0xf47f, 0xada8, CALL_HOST]);
    assert_eq!(waits(CODE, &program, CACHED), (1 + 10 * 150 + 1) * 4);
}

#[test]
fn constant_waits_once_while_its_cache_holds_it() {
    // movs r0, #10; ldr r1, [pc, #4]; subs r0, #1; bne back to the load; call; nop; the constant
    let program = [0x200a, 0x4902, 0x3801, 0xd1fc, CALL_HOST, 0xbf00, 1, 2, 3, 4];
    assert_eq!(waits(CODE, &program, CACHED), 2 * 4 + 4);
    let instructions_only = Settings { caches: [true, false], ..CACHED };
    assert_eq!(waits(CODE, &program, instructions_only), 2 * 4 + 10 * 4);
}

#[test]
fn accelerator_and_fewer_wait_states_save_time() {
    let mut program = vec![0x200a, 0xbf00, 0xbf00, 0xbf00];
    program.extend([0x3101; 61]);
    program.extend([0x3801, 0xf47f, 0xafc0, CALL_HOST]);
    let all = waits(CODE, &program, Settings::G431);
    let prefetched = waits(CODE, &program, Settings { caches: [false; 2], ..Settings::G431 });
    let off = waits(CODE, &program, bare(4));
    assert!(0 < all && all < prefetched && prefetched < off, "{all}, {prefetched}, {off}");
    assert!(waits(CODE, &program, bare(3)) < off);
}
