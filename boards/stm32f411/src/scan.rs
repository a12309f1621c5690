//! Scan of the STM32F411: writes the plan of `scan_plan::f411` into registers and reads the frames.
//!
//! After [`start`] only the interrupt at the end of each frame runs code. It copies 42 readings out
//! of the half of the buffer that the DMA has just left. It has a whole frame's time for that; a
//! frame that was overwritten meanwhile is dropped and counted, never delivered torn.
//!
//! A reading that the DMA misses is an overrun of the converter, which then requests no more
//! transfers. Its interrupt restarts the scan.
//!
//! Patterns and buffers are in RAM, because the flash stalls while one of its sectors is erased. A
//! late pattern would shift rows against readings for all later frames.

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

/// Settings after start-up.
pub const DEFAULT: ScanSettings =
    ScanSettings { scan_hz: 4000, oversampling: 1, settle_ns: settle::DEFAULT_NS };

/// Plan of the default settings, checked at compile time.
const PLAN: Plan = match plan(DEFAULT) {
    Ok(plan) => plan,
    Err(_) => panic!("the default settings are refused"),
};

/// Bits of each port's mode register to keep, and bits to set.
///
/// They are computed at compile time, so that the pins' names stay out of the flash.
const PINS: [(gpio::Gpio, u32, u32); 3] = [
    (GPIOA, mode(0, !0), mode(0, 0)),
    (GPIOB, mode(1, !0), mode(1, 0)),
    (GPIOC, mode(2, !0), mode(2, 0)),
];

const fn mode(port: u8, before: u32) -> u32 {
    pins::moder(&pins::F411, port, before)
}

/// Present settings, written only while the scan is stopped.
static SETTINGS: Mutex<CriticalSectionRawMutex, Cell<ScanSettings>> =
    Mutex::new(Cell::new(DEFAULT));

/// Present settings of the scan.
pub fn settings() -> ScanSettings {
    SETTINGS.lock(Cell::get)
}

/// Applies settings to the scan and returns the codes' full scale.
///
/// # Errors
/// The setting that is out of range; the scan continues unchanged.
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

/// Holds a row on in every step, or scans again; the frame in progress counts as lost.
pub fn hold_row(row: Option<u8>) {
    cortex_m::interrupt::free(|_| {
        let running = TIM1.cr1().read().cen();
        halt();
        // SAFETY: the timer that makes the DMA read them stands still, and nothing interrupts.
        unsafe { *BUFFERS.patterns.get() = pattern::holding(F411_ROWS, F411_SELECT, row) };
        if running {
            run(&present_plan());
        }
    });
}

/// Plan of the present settings, which were accepted before.
fn present_plan() -> Plan {
    plan(settings()).unwrap_or(PLAN)
}

/// Queue of frames for the session.
pub static FRAMES: Frames = Frames::new();

/// Streams of DMA2 in use.
const FROM_ADC: usize = 0;
const PATTERNS: usize = 1;

/// Memory that the DMA reads and writes.
struct Buffers {
    patterns: UnsafeCell<[u32; 5]>,
    readings: UnsafeCell<[[u16; READINGS]; 2]>,
}

// SAFETY: the patterns change only while the scan is stopped. The readings are written by the DMA
// alone, and copied in the one interrupt, between fences.
unsafe impl Sync for Buffers {}

static BUFFERS: Buffers = Buffers {
    patterns: UnsafeCell::new(pattern::words(F411_ROWS, F411_SELECT)),
    readings: UnsafeCell::new([[0; READINGS]; 2]),
};

/// Configures all peripherals and starts the scan; returns the codes' full scale.
pub fn start() -> FullScale {
    RCC.ahb1enr().modify(|w| {
        w.set_gpioaen(true);
        w.set_gpioben(true);
        w.set_gpiocen(true);
        w.set_dma2en(true);
        w.set_crcen(true);
    });
    RCC.apb2enr().modify(|w| {
        w.set_adc1en(true);
        w.set_tim1en(true);
    });
    // A peripheral responds two cycles after its clock starts; reading back takes longer.
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
    // All other interrupts can wait for a frame.
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
    TIM1.psc().write_value(plan.psc as u16);
    TIM1.arr().write_value(timer::regs::ArrCore(plan.arr));
    for (channel, compare) in [plan.ccr1, plan.ccr2, plan.ccr3].into_iter().enumerate() {
        TIM1.ccr(channel).write_value(timer::regs::Ccr1ch(compare));
    }
    TIM1.dier().write_value(timer::regs::DierAdv(plan.dier));
}

/// Starts a stopped scan at the beginning of a frame.
fn run(plan: &Plan) {
    // Switching the ADC off and on restarts the sequence at its first input.
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

/// Switches every LED off.
fn darken() {
    let word = pattern::dark(F411_ROWS, F411_SELECT);
    GPIOB.bsrr().write_value(gpio::regs::Bsrr(word));
}

/// Pauses the scan while the host suspends the bus, which powers the LEDs.
pub fn set_paused(paused: bool) {
    cortex_m::interrupt::free(|_| {
        let running = TIM1.cr1().read().cen();
        if paused && running {
            halt();
        } else if !paused && !running {
            run(&present_plan());
        }
    });
}

/// Handles a complete frame.
#[interrupt]
fn DMA2_STREAM0() {
    let begin = cortex_m::peripheral::DWT::cycle_count();
    DMA2.ifcr(0).write_value(dma::regs::Ixr(0x3D << (6 * FROM_ADC)));
    if overrun() {
        return restart();
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

/// Handles an overrun of the converter, at the same priority as a frame.
#[interrupt]
fn ADC() {
    if overrun() {
        restart();
    }
}

/// Whether the DMA missed a reading, which shifts rows against readings.
fn overrun() -> bool {
    ADC1.sr().read().ovr()
}

/// Restarts the scan; the frame being read counts as lost.
fn restart() {
    halt();
    run(&present_plan());
}

/// Half of the buffer that the DMA is not writing.
///
/// The DMA is in the first half while more than half of its transfers are left.
fn left() -> usize {
    usize::from(DMA2.st(FROM_ADC).ndtr().read().0 > READINGS as u32)
}

/// Codes of one frame.
fn read(half: usize) -> Codes {
    // Keeps the copy between the two checks of which half is complete.
    compiler_fence(Ordering::SeqCst);
    // SAFETY: both halves exist; the DMA is writing the other.
    let readings = unsafe {
        *BUFFERS.readings.get().cast::<[[Code; INPUTS.len()]; STEPS as usize]>().add(half)
    };
    compiler_fence(Ordering::SeqCst);
    // The dark step's midpoints are sensor 0's again and are left out.
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
