//! Firmware of the finger on an STM32F411CE, a "Black Pill" board.
//!
//! The scan runs by itself ([`scan`]), and a frame's interrupt puts its codes into a queue. One
//! task runs the session with the host that has the USB port open, another runs the USB device, a
//! third the status LED. `scan-plan` holds the wiring of the pins, and the board's page,
//! `docs/boards/stm32f411.md`, shows it.
#![no_std]
#![no_main]

mod clocks;
mod flash;
mod scan;
mod status;
mod usb;

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::entry;
use defmt_rtt as _;
use embassy_executor::Executor;
use embassy_stm32::peripherals::USB_OTG_FS;
use embassy_stm32::usb::{self as otg, InterruptHandler};
use embassy_stm32::wdg::IndependentWatchdog;
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

use crate::flash::Sectors;
use crate::usb::Driver;

bind_interrupts!(struct Irqs {
    OTG_FS => InterruptHandler<USB_OTG_FS>;
});

/// Address of the ROM bootloader's vector table (AN2606).
const ROM: usize = 0x1FFF_0000;
/// Watchdog timeout in microseconds, within which a scan must reach the session.
///
/// It covers the erasure of the largest data sector, 64 KB (1.1 s, DS10314 table 47).
const WATCHDOG_US: u32 = 3_000_000;

static EXECUTOR: StaticCell<Executor> = StaticCell::new();
static INSTRUMENT: StaticCell<Instrument> = StaticCell::new();

/// Resets a chip that does not start from a reset.
///
/// The ROM bootloader jumps here with its clocks and interrupts on (AN3156 leaves them to the
/// application). Statics have no values yet, and this function uses none.
#[unsafe(no_mangle)]
extern "C" fn __pre_init() {
    if !clocks::are_reset() {
        SCB::sys_reset();
    }
}

#[entry]
fn main() -> ! {
    // SAFETY: nothing runs yet, and the chip's bootloader is at that address.
    let panic = unsafe { boot::resume(ROM) };
    let chip = embassy_stm32::init(clocks::config());
    clocks::accelerate_flash();
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
    IndependentWatchdog::new(chip.IWDG, WATCHDOG_US).unleash();
    let full_scale = scan::start();
    let store = Store::new(flash::sectors(chip.FLASH));
    let mut scanner = Scanner::new(&scan::FRAMES, Registers, store, Started { reset, panic });

    // Received packets that nobody has read: one for each of two endpoints.
    static RECEIVED: StaticCell<[u8; 256]> = StaticCell::new();
    let mut config = otg::Config::default();
    // A Black Pill does not wire VBUS to PA9.
    config.vbus_detection = false;
    let received = RECEIVED.init([0; 256]);
    let driver = otg::Driver::new_fs(chip.USB_OTG_FS, Irqs, chip.PA12, chip.PA11, received, config);
    let driver = Driver::new(driver);
    let (port, link) =
        link::device(driver, "fingertip stm32f411", uid::uid_hex(), scan::set_paused);
    let identity = identity(
        "stm32f411",
        uid::uid_hex(),
        scan::DEFAULT.scan_hz,
        full_scale,
        scan_plan::f411::CLOCK_HZ,
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
    mut scanner: Scanner<Registers, Sectors>,
    instrument: &'static mut Instrument,
) {
    link.serve(&mut scanner, instrument).await;
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    boot::panic(info.location())
}
