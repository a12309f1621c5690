//! Firmware of the product, on an STM32G431CB or an STM32G473CE.
//!
//! The scan runs by itself ([`scan`]), and a frame's interrupt puts its codes into a queue. One
//! task runs the session with the host that has the USB port open, another runs the USB device, a
//! third the status LED. `scan-plan` holds the wiring of the pins, and the board's page,
//! `docs/boards/stm32g431.md`, shows it.
#![no_std]
#![no_main]

mod ccm;
mod clocks;
mod flash;
mod scan;
mod status;
mod usb;

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::{entry, exception};
use defmt_rtt as _;
use embassy_executor::Executor;
use embassy_stm32::peripherals::USB;
use embassy_stm32::usb::InterruptHandler;
use embassy_stm32::{bind_interrupts, pac, uid};
use embassy_usb::UsbDevice;
use static_cell::StaticCell;
use taxel::instrument::Instrument;
use taxel::scan::ScanSettings;
use taxel::session::Board;
use taxel::store::Store;
use taxel::units::FullScale;
use taxel::wire::message::Refusal;
use taxel_board::boot;
use taxel_board::identity::{BUILD, identity};
use taxel_board::link::{self, Link};
use taxel_board::scanner::{Chip, Scanner, Started};

use crate::flash::Pages;
use crate::usb::Driver;

bind_interrupts!(struct Irqs {
    USB_LP => InterruptHandler<USB>;
});

/// Name of the board: build.rs has it from the chip.
const BOARD: &str = env!("BOARD");
/// Name of the USB device.
const PRODUCT: &str = concat!("fingertip ", env!("BOARD"));
/// Address of the ROM bootloader's vector table (AN2606).
const ROM: usize = 0x1FFF_0000;

static EXECUTOR: StaticCell<Executor> = StaticCell::new();
static INSTRUMENT: StaticCell<Instrument> = StaticCell::new();

/// Resets a chip that does not start from a reset, and fills the CCM.
///
/// The ROM bootloader jumps here with its clocks and interrupts on (AN3156 leaves them to the
/// application). Statics have no values yet, and this function uses none.
#[unsafe(no_mangle)]
extern "C" fn __pre_init() {
    if !clocks::are_reset() {
        SCB::sys_reset();
    }
    ccm::load();
}

#[entry]
fn main() -> ! {
    // SAFETY: nothing runs yet, and the chip's bootloader is at that address.
    let panic = unsafe { boot::resume(ROM) };
    let chip = embassy_stm32::init(clocks::config());
    clocks::boost();
    clocks::freeze_in_debug();
    clocks::start_time();
    let reset = clocks::reset_cause();
    defmt::info!("start, build {=str}", BUILD);
    if let Some(panic) = &panic {
        defmt::error!("last panic: {=str}", panic.as_str());
    }
    // SAFETY: nothing else takes the core's peripherals; others only read the cycle counter.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();

    // The watchdog starts first, so that a converter that never gets ready causes a reported reset.
    clocks::start_watchdog();
    let full_scale = scan::start();
    let store = Store::new(flash::pages(chip.FLASH));
    let mut scanner = Scanner::new(&scan::FRAMES, Registers, store, Started { reset, panic });

    let driver = embassy_stm32::usb::Driver::new(chip.USB, Irqs, chip.PA12, chip.PA11);
    let driver = Driver::new(driver);
    let (port, link) = link::device(driver, PRODUCT, uid::uid_hex(), scan::set_paused);
    let identity = identity(
        BOARD,
        uid::uid_hex(),
        scan::DEFAULT.scan_hz,
        full_scale,
        scan_plan::g431::CLOCK_HZ,
    );
    let instrument = INSTRUMENT.init_with(|| Instrument::new(identity));
    instrument.restore(scanner.store(), |scan| Registers.set_scan(scan));
    EXECUTOR.init(Executor::new()).run(|spawner| {
        spawner.spawn(device(port).expect("spawned once"));
        spawner.spawn(session(link, scanner, instrument).expect("spawned once"));
        spawner.spawn(status::show().expect("spawned once"));
    })
}

/// Chip functions by its registers.
struct Registers;

impl Chip for Registers {
    fn feed(&self) {
        pac::IWDG.kr().write(|kr| kr.set_key(pac::iwdg::vals::Key::RESET));
    }

    fn scan_settings(&self) -> ScanSettings {
        scan::settings()
    }

    fn set_scan(&self, wish: &ScanSettings) -> Result<FullScale, Refusal> {
        scan::set(*wish)
    }

    fn hold_row(&self, row: Option<u8>) {
        scan::hold_row(row);
    }
}

#[embassy_executor::task]
async fn device(mut device: UsbDevice<'static, Driver>) {
    device.run().await;
}

#[embassy_executor::task]
async fn session(
    mut link: Link<Driver>,
    mut scanner: Scanner<Registers, Pages>,
    instrument: &'static mut Instrument,
) {
    link.serve(&mut scanner, instrument).await;
}

/// Handles the read of a flash word that a power cut damaged.
///
/// The ECC finds two wrong bits and reading continues (RM0440 §3.3.8); the store handles such a
/// word.
#[exception]
unsafe fn NonMaskableInt() {
    if !pac::FLASH.eccr().read().eccd() {
        panic!("NMI, not of flash");
    }
    pac::FLASH.eccr().modify(|eccr| eccr.set_eccd(true));
}

// Inlined, so that the linker sees that no message is read: 2.4 KB of flash. rustc says that it
// ignores the attribute, but LLVM follows it.
#[expect(unused_attributes)]
#[inline(always)]
#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    boot::panic(info.location())
}
