//! The finger's firmware on a board that needs no hardware: QEMU's `mps2-an386`, a Cortex-M4F.
//!
//! The core and its session are the product's; in place of the ADC stands a trace that the host loads
//! into the PSRAM ([`image`], [`trace`]), in place of USB stands UART 0. When the scans are over the
//! firmware says a last [`Command::Info`] unasked, so that the host learns what all of them cost, the
//! depth of the stack on stderr, and ends the emulator with exit code 0. Anything wrong is one line on
//! stderr and exit code 1.
#![no_std]
#![no_main]

mod image;
mod mmio;
mod nor;
mod psram;
mod stack;
mod time_driver;
mod trace;
mod uart;

use core::panic::PanicInfo;

use cortex_m_rt::{ExceptionFrame, entry, exception};
use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS, ExitStatus};
use cortex_m_semihosting::heprintln;
use embassy_executor::InterruptExecutor;
use embedded_io_async::Write;
use taxel::instrument::Instrument;
use taxel::session::{Board, run_session};
use taxel::wire::message::{Command, Identity, Request};
use taxel::wire::{MAX_PACKET, pack};

use crate::mmio::{CLOCK_HZ, Irq};
use crate::trace::Trace;

static EXECUTOR: InterruptExecutor = InterruptExecutor::new();

/// Tasks run in a software interrupt, below the drivers, and thread mode only sleeps. embassy's thread
/// executor would sleep by WFE, which QEMU treats as a no-op: the idle loop would take a whole host core
/// and, under `-icount`, hold virtual time behind real time. QEMU does sleep on WFI.
#[entry]
fn main() -> ! {
    let mut core = cortex_m::Peripherals::take().expect("main runs once");
    // SAFETY: no critical section relies on priorities, and this runs before the first interrupt is
    // let through.
    unsafe { core.NVIC.set_priority(Irq::Executor, 0xFF) };
    time_driver::init(core.SYST);
    EXECUTOR.start(Irq::Executor).spawn(run().expect("the only instance"));
    loop {
        cortex_m::asm::wfi();
    }
}

#[embassy_executor::task]
async fn run() {
    let Some(mut trace) = Trace::open(psram::contents()) else {
        fail(format_args!(
            "no trace for this firmware in the PSRAM; \
             start it with `taxel replay TRACE.csv --on mps2-an386`"
        ))
    };
    let mut instrument = Instrument::new(identity(&trace));
    let (rx, mut tx) = uart::init();
    let pace = trace.pace();
    // Neither can this link fail, nor can the host close it: it ends with the scans.
    let Ok(_) = run_session(rx, &mut tx, &mut trace, &mut instrument, pace).await;
    if trace.missing() > 0 {
        fail(format_args!("the trace breaks off {} scans before its end", trace.missing()));
    }
    let mut buffer = [0; MAX_PACKET];
    if let Some(info) =
        instrument.handle(&Request { tag: 0, command: Command::Info }, trace.store())
        && let Ok(packet) = pack(&info, &mut buffer)
    {
        let Ok(()) = tx.write_all(packet).await;
        let Ok(()) = tx.flush().await;
    }
    heprintln!("stack {} bytes", stack::deepest());
    exit(EXIT_SUCCESS)
}

fn identity(trace: &Trace) -> Identity {
    let text = |text: &str| text.try_into().unwrap_or_default();
    Identity {
        board: text("mps2-an386"),
        serial: "qemu".try_into().unwrap_or_default(),
        build: option_env!("TAXEL_BUILD").unwrap_or("unknown").try_into().unwrap_or_default(),
        scan_hz: trace.header.scan_hz,
        full_scale: trace.header.full_scale,
        tick_hz: CLOCK_HZ,
    }
}

/// Every external interrupt: the image has no vendor's names for the vectors.
#[exception]
unsafe fn DefaultHandler(irqn: i16) {
    const UART0_RX: i16 = Irq::Uart0Rx as i16;
    const UART0_TX: i16 = Irq::Uart0Tx as i16;
    const TIMER0: i16 = Irq::Timer0 as i16;
    const EXEC: i16 = Irq::Executor as i16;
    match irqn {
        UART0_RX => uart::on_rx(),
        UART0_TX => uart::on_tx(),
        TIMER0 => time_driver::on_timer0(),
        // SAFETY: only `start` unmasks this line, and this is its handler.
        EXEC => unsafe { EXECUTOR.on_interrupt() },
        _ => panic!("unexpected interrupt {irqn}"),
    }
}

/// The default handler would spin for ever and hang the emulator.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    panic!("hard fault at {:#010x}, called from {:#010x}", frame.pc(), frame.lr());
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    fail(format_args!("{info}"))
}

fn fail(why: core::fmt::Arguments) -> ! {
    cortex_m::interrupt::disable();
    heprintln!("{}", why);
    exit(EXIT_FAILURE)
}

fn exit(status: ExitStatus) -> ! {
    loop {
        debug::exit(status);
    }
}
