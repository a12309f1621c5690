//! Tests of the firmware's memory functions against C's semantics, for every length, alignment and
//! overlap.

use object::LittleEndian;
use object::read::elf::ElfFile32;
use object::{Object, ObjectSegment, ObjectSymbol};
use taxel_emulator::board::model::Model::G431;
use unicorn_engine::{Arch, ArmCpuModel, Mode, Prot, RegisterARM, Unicorn};

use crate::support::image;

/// Addresses of the code, of its data, and of its return.
const CCM: u32 = 0x1000_0000;
const RAM: u32 = 0x2000_0000;
const BACK: u32 = 0x3000_0000;
/// Longest copy: more than one turn of sixteen bytes and every remainder.
const LONGEST: usize = 70;
const PLACES: usize = 4;
/// Size of the checked memory, bytes.
const BYTES: usize = 256;

struct Image {
    unicorn: Unicorn<'static, ()>,
    symbols: Vec<(String, u32)>,
}

impl Image {
    fn open() -> Self {
        let bytes = image(G431);
        let elf = ElfFile32::<LittleEndian>::parse(&*bytes).unwrap();
        let mut unicorn = Unicorn::new(Arch::ARM, Mode::THUMB).unwrap();
        unicorn.ctl_set_cpu_model(ArmCpuModel::CORTEX_M4 as i32).unwrap();
        for place in [CCM, RAM, BACK] {
            unicorn.mem_map(u64::from(place), 0x4000, Prot::ALL).unwrap();
        }
        let ccm = u64::from(CCM)..u64::from(CCM) + 0x4000;
        for segment in elf.segments().filter(|segment| ccm.contains(&segment.address())) {
            unicorn.mem_write(segment.address(), segment.data().unwrap()).unwrap();
        }
        let symbols = elf.symbols().map(|s| (s.name().unwrap().to_owned(), s.address() as u32));
        Self { symbols: symbols.collect(), unicorn }
    }

    /// Calls `function` on `memory` and returns the memory afterwards.
    fn after(&mut self, function: &str, arguments: [u32; 3], memory: &[u8]) -> Vec<u8> {
        let (_, address) = self
            .symbols
            .iter()
            .find(|(name, _)| name == function)
            .unwrap_or_else(|| panic!("no function {function}"));
        let address = u64::from(*address | 1);
        assert!((CCM..CCM + 0x4000).contains(&(address as u32)), "{function} is not in the CCM");
        self.unicorn.mem_write(u64::from(RAM), memory).unwrap();
        let registers = [RegisterARM::R0, RegisterARM::R1, RegisterARM::R2];
        for (register, value) in registers.into_iter().zip(arguments) {
            self.unicorn.reg_write(register, u64::from(value)).unwrap();
        }
        self.unicorn.reg_write(RegisterARM::SP, u64::from(RAM) + 0x4000).unwrap();
        self.unicorn.reg_write(RegisterARM::LR, u64::from(BACK | 1)).unwrap();
        self.unicorn.emu_start(address, u64::from(BACK), 0, 10_000).unwrap();
        assert_eq!(self.unicorn.reg_read(RegisterARM::SP).unwrap(), u64::from(RAM) + 0x4000);
        self.unicorn.mem_read_as_vec(u64::from(RAM), memory.len()).unwrap()
    }
}

fn memory() -> Vec<u8> {
    (0..BYTES).map(|i| (i * 7 + 1) as u8).collect()
}

/// Checks `name` on all copies without overlap; `aligned` ones only if it requires that.
fn copies(image: &mut Image, name: &str, aligned: bool) {
    let places = if aligned { 1 } else { PLACES };
    for (to, from) in (0..places).flat_map(|to| (0..places).map(move |from| (to, 128 + from))) {
        for length in 0..LONGEST {
            let mut expected = memory();
            expected.copy_within(from..from + length, to);
            let arguments = [RAM + to as u32, RAM + from as u32, length as u32];
            let found = image.after(name, arguments, &memory());
            assert!(found == expected, "{name}: {length} bytes from {from} to {to}");
        }
    }
}

#[test]
fn memcpy_copies_every_length_and_alignment() {
    let mut image = Image::open();
    copies(&mut image, "__aeabi_memcpy", false);
    copies(&mut image, "__aeabi_memcpy4", true);
}

#[test]
fn memclr_clears_exactly_the_range() {
    let mut image = Image::open();
    for (at, length) in (0..PLACES).flat_map(|at| (0..LONGEST).map(move |length| (at, length))) {
        let mut expected = memory();
        expected[at..at + length].fill(0);
        let found =
            image.after("__aeabi_memclr", [RAM + at as u32, length as u32, 0x55], &memory());
        assert!(found == expected, "{length} bytes at {at}");
    }
}

#[test]
fn memmove_handles_overlap() {
    let mut image = Image::open();
    for (to, from) in (40..60).flat_map(|to| (40..60).map(move |from| (to, from))) {
        for length in (0..LONGEST).step_by(3) {
            let mut expected = memory();
            expected.copy_within(from..from + length, to);
            let arguments = [RAM + to as u32, RAM + from as u32, length as u32];
            let found = image.after("__aeabi_memmove", arguments, &memory());
            assert!(found == expected, "{length} bytes from {from} to {to}");
        }
    }
}
