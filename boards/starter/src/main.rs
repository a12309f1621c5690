//! Start of a port: a finger by embassy's HAL alone, here on an STM32F411CE, a "Black Pill".
//!
//! LED rows are [`Output`]s, a [`Ticker`] starts each scan and [`Adc`] reads one column after the
//! other. Nearly every chip of embassy has these: a port changes the names of the peripherals, the
//! clocks and the USB driver, and streams on its first day. Compared with the other boards
//!
//! * it scans at [`SCAN_HZ`] instead of 4 kHz, and rows change late by whatever else runs;
//! * nothing survives power-off, because the store is in RAM;
//! * it has no force sensors, watchdog, bootloader command or record of a panic.
//!
//! `docs/boards/adding-a-board.md` says how each of these comes next.
#![no_std]
#![no_main]

use core::panic::PanicInfo;
use core::sync::atomic::{AtomicBool, AtomicU8, Ordering};

use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_stm32::adc::{Adc, AdcChannel, AnyAdcChannel, SampleTime};
use embassy_stm32::gpio::{AnyPin, Level, Output, Speed};
use embassy_stm32::peripherals::{ADC1, USB_OTG_FS};
use embassy_stm32::rcc::{
    APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk,
    mux::Clk48sel,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::usb::{self as otg, Driver, InterruptHandler};
use embassy_stm32::{Peri, bind_interrupts, uid};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Duration, Instant, Ticker, Timer};
use embassy_usb::UsbDevice;
use static_cell::StaticCell;
use taxel::instrument::Instrument;
use taxel::scan::{Codes, Scan, TaxelCodes};
use taxel::session::Board;
use taxel::store::{RamFlash, Store};
use taxel::units::{Code, FullScale, Micros};
use taxel::wire::message::Refusal;
use taxel_board::identity::identity;
use taxel_board::link;

/// Scans a second: five steps of [`SETTLE`] and four readings take about 300 µs.
const SCAN_HZ: u16 = 500;
/// Time from a row's light to the first reading.
const SETTLE: Duration = Duration::from_micros(scan_plan::settle::DEFAULT_NS.div_ceil(1000) as u64);
/// Value of [`HELD`] without a held row.
const NO_ROW: u8 = u8::MAX;

/// Scans on their way to the session.
static SCANS: Channel<CriticalSectionRawMutex, Scan, 4> = Channel::new();
/// Whether the host suspends the bus, which powers the LEDs.
static PAUSED: AtomicBool = AtomicBool::new(false);
/// Row that is on in every step.
static HELD: AtomicU8 = AtomicU8::new(NO_ROW);

bind_interrupts!(struct Irqs {
    OTG_FS => InterruptHandler<USB_OTG_FS>;
});

/// 96 MHz from the crystal of 25 MHz, and the USB's 48 MHz.
fn clocks() -> embassy_stm32::Config {
    let mut config = embassy_stm32::Config::default();
    config.rcc.hse = Some(Hse { freq: Hertz(25_000_000), mode: HseMode::Oscillator });
    config.rcc.pll_src = PllSource::HSE;
    config.rcc.pll = Some(Pll {
        prediv: PllPreDiv::DIV25,
        mul: PllMul::MUL192,
        divp: Some(PllPDiv::DIV2),
        divq: Some(PllQDiv::DIV4),
        divr: None,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.apb1_pre = APBPrescaler::DIV2;
    config.rcc.mux.clk48sel = Clk48sel::PLL1_Q;
    config
}

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    let chip = embassy_stm32::init(clocks());
    let rows: [Peri<'_, AnyPin>; 4] =
        [chip.PB12.into(), chip.PB13.into(), chip.PB14.into(), chip.PB15.into()];
    let rows = rows.map(|pin| Output::new(pin, Level::Low, Speed::Low));
    let columns = [
        chip.PA1.degrade_adc(),
        chip.PA2.degrade_adc(),
        chip.PA3.degrade_adc(),
        chip.PA4.degrade_adc(),
    ];
    spawner.spawn(scan(rows, Adc::new(chip.ADC1), columns).expect("spawned once"));

    static RECEIVED: StaticCell<[u8; 256]> = StaticCell::new();
    let mut config = otg::Config::default();
    // A Black Pill does not wire VBUS to PA9.
    config.vbus_detection = false;
    let received = RECEIVED.init([0; 256]);
    let driver = Driver::new_fs(chip.USB_OTG_FS, Irqs, chip.PA12, chip.PA11, received, config);
    let pause = |paused| PAUSED.store(paused, Ordering::Relaxed);
    let (port, mut link) = link::device(driver, "fingertip starter", uid::uid_hex(), pause);
    spawner.spawn(device(port).expect("spawned once"));

    static MEMORY: StaticCell<[u8; RamFlash::SIZE]> = StaticCell::new();
    static INSTRUMENT: StaticCell<Instrument> = StaticCell::new();
    let mut board = Starter { store: Store::new(RamFlash::new(MEMORY.init([0; _]))) };
    let ticks = embassy_time::TICK_HZ as u32;
    let identity = identity("starter", uid::uid_hex(), SCAN_HZ, FullScale::BITS_12, ticks);
    let instrument = INSTRUMENT.init_with(|| Instrument::new(identity));
    link.serve(&mut board, instrument).await;
}

#[embassy_executor::task]
async fn device(mut device: UsbDevice<'static, Driver<'static, USB_OTG_FS>>) {
    device.run().await;
}

/// Scans without end: a dark step, then each row. A scan that finds the queue full is lost.
#[embassy_executor::task]
async fn scan(
    mut rows: [Output<'static>; 4],
    mut adc: Adc<'static, ADC1>,
    mut columns: [AnyAdcChannel<'static, ADC1>; 4],
) {
    let mut ticker = Ticker::every(Duration::from_hz(SCAN_HZ.into()));
    let mut lost = 0;
    loop {
        ticker.next().await;
        if PAUSED.load(Ordering::Relaxed) {
            rows.iter_mut().for_each(Output::set_low);
            continue;
        }
        let time = Micros(Instant::now().as_micros());
        let held = HELD.load(Ordering::Relaxed);
        let mut steps = [[Code(0); 4]; 5];
        for (step, codes) in (0..).zip(&mut steps) {
            for (row, output) in (0..).zip(&mut rows) {
                let on = if held == NO_ROW { step == row + 1 } else { held == row };
                output.set_level(on.into());
            }
            Timer::after(SETTLE).await;
            for (code, column) in codes.iter_mut().zip(&mut columns) {
                *code = Code(adc.blocking_read(column, SampleTime::CYCLES15));
            }
        }
        if held == NO_ROW {
            rows.iter_mut().for_each(Output::set_low);
        }
        if held != HELD.load(Ordering::Relaxed) {
            lost += 1;
            continue;
        }
        let [dark, lit @ ..] = steps;
        let codes = Codes {
            full_scale: FullScale::BITS_12,
            taxels: Some(TaxelCodes { lit, dark }),
            bridges: [None; 4],
            reference: None,
            temperature: None,
        };
        lost = if SCANS.try_send(Scan { time, lost, codes }).is_ok() { 0 } else { lost + 1 };
    }
}

/// Session's side of the board.
struct Starter {
    store: Store<RamFlash<&'static mut [u8; RamFlash::SIZE]>>,
}

impl Board for Starter {
    type Flash = RamFlash<&'static mut [u8; RamFlash::SIZE]>;

    async fn scan(&mut self) -> Option<Scan> {
        Some(SCANS.receive().await)
    }

    fn ticks(&self) -> u32 {
        Instant::now().as_ticks() as u32
    }

    fn store(&mut self) -> &mut Store<Self::Flash> {
        &mut self.store
    }

    fn hold_row(&mut self, row: Option<u8>) -> Result<(), Refusal> {
        HELD.store(row.unwrap_or(NO_ROW), Ordering::Relaxed);
        // These were read with the other rows.
        SCANS.clear();
        Ok(())
    }
}

#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}
