//! The scan: what `scan_plan::f411` computed, written into the registers, and the frames that come of it.
//!
//! After [`start`] no code takes part in a frame but the interrupt at its end, which copies 42 readings
//! out of the half of the buffer that the DMA has just left. It has the time of a whole frame for it; a
//! frame that was overwritten meanwhile is dropped and counted, never delivered torn.
//!
//! A reading for which the DMA comes too late is an overrun of the converter, which then asks for no more
//! transfers: an interrupt of its own begins the scan again.
//!
//! The patterns and the buffers lie in RAM: the flash stands still while one of its sectors is erased,
//! and a pattern that came late would leave rows and readings out of step for good.

use core::cell::{Cell, UnsafeCell};
use core::sync::atomic::{Ordering, compiler_fence};

use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::pac::{ADC1, ADC1_COMMON, DMA2, GPIOA, GPIOB, GPIOC};
use embassy_stm32::pac::{Interrupt, RCC, TIM1, interrupt};
use embassy_stm32::pac::{adc, adccommon, dma, gpio, timer};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use scan_plan::f411::{INPUTS, Plan, READINGS, Stream, Timer, plan};
use scan_plan::pins::{self, F411_ROWS, F411_SELECT};
use scan_plan::{STEPS, pattern, settle};
use taxel::scan::{Codes, Midpoints, ScanSettings, TaxelCodes};
use taxel::units::{Code, FullScale};
use taxel::wire::message::Refusal;
use taxel_board::scanner::Frames;

/// What the finger starts with.
pub const DEFAULT: ScanSettings =
    ScanSettings { scan_hz: 4000, oversampling: 1, settle_ns: settle::DEFAULT_NS };

/// Checked when this is compiled.
const PLAN: Plan = match plan(DEFAULT) {
    Ok(plan) => plan,
    Err(_) => panic!("the default settings cannot be had"),
};

/// For each port the bits of its mode register that stay, and those that are set: worked out by the
/// compiler, so that the names of the pins stay out of the flash.
const PINS: [(gpio::Gpio, u32, u32); 3] = [
    (GPIOA, mode(0, !0), mode(0, 0)),
    (GPIOB, mode(1, !0), mode(1, 0)),
    (GPIOC, mode(2, !0), mode(2, 0)),
];

const fn mode(port: u8, before: u32) -> u32 {
    pins::moder(&pins::F411, port, before)
}

/// What is in force. Written while the scan stands still.
static SETTINGS: Mutex<CriticalSectionRawMutex, Cell<ScanSettings>> =
    Mutex::new(Cell::new(DEFAULT));

/// How it scans.
pub fn settings() -> ScanSettings {
    SETTINGS.lock(Cell::get)
}

/// Scans differently from now on; the codes' full scale.
///
/// # Errors
/// The setting that is in the way; the scan goes on as it was.
pub fn set(wish: ScanSettings) -> Result<FullScale, Refusal> {
    let plan = plan(wish)?;
    cortex_m::interrupt::free(|_| {
        let running = TIM1.cr1().read().cen();
        halt();
        SETTINGS.lock(|settings| settings.set(wish));
        configure_timer(plan.timer);
        if running {
            run(&plan);
        }
    });
    Ok(FullScale::BITS_12)
}

/// The plan in force; it has been had before.
fn in_force() -> Plan {
    plan(settings()).unwrap_or(PLAN)
}

/// The frames, for the session.
pub static FRAMES: Frames = Frames::new();

/// Streams of DMA2.
const FROM_ADC: usize = 0;
const PATTERNS: usize = 1;

/// What the DMA reads and writes.
struct Buffers {
    patterns: UnsafeCell<[u32; 5]>,
    readings: UnsafeCell<[[u16; READINGS]; 2]>,
}

// SAFETY: the patterns never change; the readings are written by the DMA alone, and copied in the one
// interrupt, between fences.
unsafe impl Sync for Buffers {}

static BUFFERS: Buffers = Buffers {
    patterns: UnsafeCell::new(pattern::words(F411_ROWS, F411_SELECT)),
    readings: UnsafeCell::new([[0; READINGS]; 2]),
};

/// Configures everything and lets it run. The codes' full scale.
pub fn start() -> FullScale {
    RCC.ahb1enr().modify(|w| {
        w.set_gpioaen(true);
        w.set_gpioben(true);
        w.set_gpiocen(true);
        w.set_dma2en(true);
    });
    RCC.apb2enr().modify(|w| {
        w.set_adc1en(true);
        w.set_tim1en(true);
    });
    // Two cycles after its clock a peripheral answers; a read back takes longer.
    let _ = RCC.apb2enr().read();

    darken();
    for (port, kept, set) in PINS {
        let moder = port.moder().read().0 & kept | set;
        port.moder().write_value(gpio::regs::Moder(moder));
    }
    let plan = PLAN.adc;
    ADC1_COMMON.ccr().write_value(adccommon::regs::Ccr(plan.ccr));
    ADC1.smpr1().write_value(adc::regs::Smpr1(plan.smpr1));
    ADC1.smpr2().write_value(adc::regs::Smpr2(plan.smpr2));
    ADC1.sqr1().write_value(adc::regs::Sqr1(plan.sqr1));
    ADC1.sqr2().write_value(adc::regs::Sqr2(plan.sqr2));
    ADC1.sqr3().write_value(adc::regs::Sqr3(plan.sqr3));
    ADC1.jsqr().write_value(adc::regs::Jsqr(plan.jsqr));
    configure_timer(PLAN.timer);
    // Whatever else interrupts can wait for a frame.
    for later in [Interrupt::OTG_FS, Interrupt::TIM2] {
        later.set_priority(Priority::P4);
    }
    run(&PLAN);
    FullScale::BITS_12
}

fn configure_timer(plan: Timer) {
    TIM1.cr2().write_value(timer::regs::Cr2Adv(plan.cr2));
    TIM1.ccmr_output(0).write_value(timer::regs::CcmrOutputGp16(plan.ccmr1));
    TIM1.ccmr_output(1).write_value(timer::regs::CcmrOutputGp16(plan.ccmr2));
    TIM1.ccer().write_value(timer::regs::CcerAdv(plan.ccer));
    TIM1.bdtr().write_value(timer::regs::BdtrAdv(plan.bdtr));
    TIM1.psc().write_value(0);
    TIM1.arr().write_value(timer::regs::ArrCore(plan.arr));
    for (channel, compare) in [plan.ccr1, plan.ccr2, plan.ccr3].into_iter().enumerate() {
        TIM1.ccr(channel).write_value(timer::regs::Ccr1ch(compare));
    }
    TIM1.dier().write_value(timer::regs::DierAdv(plan.dier));
}

/// Starts at the beginning of a frame, from a standstill.
fn run(plan: &Plan) {
    // Off and on again, so that the sequence starts at its first input.
    ADC1.cr2().write_value(adc::regs::Cr2(0));
    arm(PATTERNS, plan.patterns, GPIOB.bsrr().as_ptr().cast(), BUFFERS.patterns.get().cast());
    arm(FROM_ADC, plan.readings, ADC1.dr().as_ptr().cast(), BUFFERS.readings.get().cast());
    ADC1.sr().write_value(adc::regs::Sr(0));
    ADC1.cr1().write_value(adc::regs::Cr1(plan.adc.cr1));
    for line in [Interrupt::DMA2_STREAM0, Interrupt::ADC] {
        line.set_priority(Priority::P0);
        line.unpend();
        // SAFETY: its handler is below, and no critical section relies on a masked line.
        unsafe { line.enable() };
    }
    ADC1.cr2().write_value(adc::regs::Cr2(plan.adc.cr2 | 1));
    // 3 µs until it is stable (DS10314 table 66).
    cortex_m::asm::delay(scan_plan::ticks(3_000, scan_plan::f411::CLOCK_HZ));
    TIM1.egr().write(|egr| egr.set_ug(true));
    TIM1.sr().write_value(timer::regs::SrAdv(0));
    FRAMES.begin(plan.step.frame_us());
    TIM1.cr1().write_value(timer::regs::Cr1Gp16(plan.timer.cr1 | 1));
}

fn arm(stream: usize, plan: Stream, peripheral: *const (), memory: *mut u32) {
    let registers = DMA2.st(stream);
    registers.cr().write_value(dma::regs::Cr(0));
    while registers.cr().read().en() {}
    // Flags of streams 0 and 1 are bits 0–5 and 6–11.
    DMA2.ifcr(0).write_value(dma::regs::Ixr(0x3D << (6 * stream)));
    registers.par().write_value(peripheral.addr() as u32);
    registers.m0ar().write_value(memory.expose_provenance() as u32);
    registers.ndtr().write_value(dma::regs::Ndtr(plan.count));
    registers.cr().write_value(dma::regs::Cr(plan.cr | 1));
}

/// Stops the scan with every LED off.
fn halt() {
    TIM1.cr1().write_value(timer::regs::Cr1Gp16(0));
    ADC1.cr2().write_value(adc::regs::Cr2(0));
    for line in [Interrupt::DMA2_STREAM0, Interrupt::ADC] {
        line.disable();
    }
    darken();
    FRAMES.halt();
}

/// Every LED off.
fn darken() {
    let word = pattern::dark(F411_ROWS, F411_SELECT);
    GPIOB.bsrr().write_value(gpio::regs::Bsrr(word));
}

/// The host has suspended the bus, which feeds the LEDs, or goes on.
pub fn set_paused(paused: bool) {
    cortex_m::interrupt::free(|_| {
        let running = TIM1.cr1().read().cen();
        if paused && running {
            halt();
        } else if !paused && !running {
            run(&in_force());
        }
    });
}

/// A frame is complete.
#[interrupt]
fn DMA2_STREAM0() {
    let begin = cortex_m::peripheral::DWT::cycle_count();
    DMA2.ifcr(0).write_value(dma::regs::Ixr(0x3D << (6 * FROM_ADC)));
    if overrun() {
        return begin_anew();
    }
    let end = FRAMES.tick();
    let half = left();
    let codes = read(half);
    if left() != half {
        return FRAMES.lose(1);
    }
    FRAMES.push(codes, end);
    FRAMES.note_cost(cortex_m::peripheral::DWT::cycle_count().wrapping_sub(begin));
}

/// The converter has overrun; of the same priority as the frame's.
#[interrupt]
fn ADC() {
    if overrun() {
        begin_anew();
    }
}

/// The DMA came too late for a reading: rows and readings are out of step.
fn overrun() -> bool {
    ADC1.sr().read().ovr()
}

/// The frame that is being read is lost, and counted as such.
fn begin_anew() {
    halt();
    run(&in_force());
}

/// The half of the buffer that the DMA is not writing: while more than half is left to do it is in the
/// first.
fn left() -> usize {
    usize::from(DMA2.st(FROM_ADC).ndtr().read().0 > READINGS as u32)
}

/// The codes of one frame.
fn read(half: usize) -> Codes {
    // Between what says which half is complete, before and after.
    compiler_fence(Ordering::SeqCst);
    // SAFETY: both halves are there; the DMA is writing the other.
    let readings = unsafe {
        *BUFFERS.readings.get().cast::<[[Code; INPUTS.len()]; STEPS as usize]>().add(half)
    };
    compiler_fence(Ordering::SeqCst);
    // The dark step's midpoints are sensor 0's again, and are left out.
    let [[d0, d1, d2, d3, ..], steps @ ..] = readings;
    let lit = steps.map(|[c0, c1, c2, c3, ..]| [c0, c1, c2, c3]);
    let sensors = steps.map(|[.., a, b, c, d]| Some(Midpoints { a, b, c, d }));
    let internal = |place: usize| Some(Code(ADC1.jdr(place).read().0 as u16 & 0xFFF));
    Codes {
        full_scale: FullScale::BITS_12,
        taxels: Some(TaxelCodes { lit, dark: [d0, d1, d2, d3] }),
        bridges: sensors,
        temperature: internal(0),
        reference: internal(1),
    }
}
