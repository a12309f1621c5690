//! Scan of the STM32G431: writes the plan of `scan_plan::g431` into registers and reads the frames.
//!
//! After [`start`] only the interrupt at the end of each frame runs code. It copies 47 readings out
//! of the half of the buffer that the DMA has just left. It has a whole frame's time for that; a
//! frame that was overwritten meanwhile is dropped and counted, never delivered torn.
//!
//! A reading that the DMA misses is an overrun of its converter, which then requests no more
//! transfers. Its interrupt restarts the scan.
//!
//! Patterns and buffers are in RAM, because the flash stalls while one of its pages is erased. A
//! late pattern would shift rows against readings for all later frames.

use core::cell::{Cell, UnsafeCell};
use core::sync::atomic::{AtomicU16, Ordering, compiler_fence};

use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::pac::{ADC1, ADC2, ADC12_COMMON, DMA1, DMAMUX1, GPIOA, GPIOB};
use embassy_stm32::pac::{Interrupt, OPAMP2, OPAMP3, RCC, TIM1, interrupt};
use embassy_stm32::pac::{adc, adccommon, bdma, dmamux, gpio, opamp, timer};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use scan_plan::finger::REFERENCE;
use scan_plan::g431::{
    BRIDGE_INPUTS, BRIDGE_READINGS, COLUMN_READINGS, Channel, Last, Plan, Timer, plan,
};
use scan_plan::pins::{self, G431_ROWS, G431_SELECT};
use scan_plan::{STEPS, pattern};
use taxel::scan::{Codes, Midpoints, ScanSettings, TaxelCodes};
use taxel::units::{Code, FullScale};
use taxel::wire::message::Refusal;
use taxel_board::scanner::Frames;

/// Settings after start-up.
pub const DEFAULT: ScanSettings = REFERENCE.converter.settings();

/// Plan of the default settings, checked at compile time.
const PLAN: Plan = match plan(DEFAULT) {
    Ok(plan) => plan,
    Err(_) => panic!("the default settings are refused"),
};

/// Bits of each port's mode register to keep, and bits to set.
///
/// They are computed at compile time, so that the pins' names stay out of the flash.
const PINS: [(gpio::Gpio, u32, u32); 2] =
    [(GPIOA, mode(0, !0), mode(0, 0)), (GPIOB, mode(1, !0), mode(1, 0))];

const fn mode(port: u8, before: u32) -> u32 {
    pins::moder(&pins::G431, port, before)
}

/// Present settings and the interrupt's copies of them, written only while the scan is stopped.
static SETTINGS: Mutex<CriticalSectionRawMutex, Cell<ScanSettings>> =
    Mutex::new(Cell::new(DEFAULT));
static OVERSAMPLING: AtomicU16 = AtomicU16::new(DEFAULT.oversampling);
static FULL_SCALE: AtomicU16 = AtomicU16::new(PLAN.full_scale);

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
    // About 20 µs, because the longest conversion has to end.
    cortex_m::interrupt::free(|_| {
        let running = TIM1.cr1().read().cen();
        halt();
        SETTINGS.lock(|settings| settings.set(wish));
        OVERSAMPLING.store(wish.oversampling, Ordering::Relaxed);
        FULL_SCALE.store(plan.full_scale, Ordering::Relaxed);
        configure(&plan);
        if running {
            run(&plan);
        }
    });
    Ok(full_scale())
}

/// Holds a row on in every step, or scans again; the frame in progress counts as lost.
pub fn hold_row(row: Option<u8>) {
    cortex_m::interrupt::free(|_| {
        let running = TIM1.cr1().read().cen();
        halt();
        // SAFETY: the timer that makes the DMA read them stands still, and nothing interrupts.
        unsafe { *BUFFERS.patterns.get() = pattern::holding(G431_ROWS, G431_SELECT, row) };
        if running {
            run(&present_plan());
        }
    });
}

fn full_scale() -> FullScale {
    FullScale::new(FULL_SCALE.load(Ordering::Relaxed)).unwrap_or(FullScale::BITS_12)
}

/// Plan of the present settings, which were accepted before.
fn present_plan() -> Plan {
    plan(settings()).unwrap_or(PLAN)
}

/// Queue of frames for the session.
pub static FRAMES: Frames = Frames::new();

/// Channels of DMA1 in use.
const PATTERNS: usize = 0;
const COLUMNS: usize = 1;
const BRIDGES: usize = 2;

/// Largest deviation of the bias from the middle: full scale divided by this.
///
/// Divider and buffer keep it within a hundredth.
const BIAS_MARGIN: u16 = 20;

/// Memory that the DMA reads and writes.
struct Buffers {
    patterns: UnsafeCell<[u32; 5]>,
    columns: UnsafeCell<[[u16; COLUMN_READINGS]; 2]>,
    bridges: UnsafeCell<[[u16; BRIDGE_READINGS]; 2]>,
}

// SAFETY: the patterns change only while the scan is stopped. The readings are written by the DMA
// alone, and copied in the one interrupt, between fences.
unsafe impl Sync for Buffers {}

static BUFFERS: Buffers = Buffers {
    patterns: UnsafeCell::new(pattern::words(G431_ROWS, G431_SELECT)),
    columns: UnsafeCell::new([[0; COLUMN_READINGS]; 2]),
    bridges: UnsafeCell::new([[0; BRIDGE_READINGS]; 2]),
};

/// Configures all peripherals and starts the scan; returns the codes' full scale.
pub fn start() -> FullScale {
    RCC.ahb2enr().modify(|w| {
        w.set_gpioaen(true);
        w.set_gpioben(true);
        w.set_adc12en(true);
    });
    RCC.ahb1enr().modify(|w| {
        w.set_dma1en(true);
        w.set_dmamux1en(true);
        w.set_crcen(true);
    });
    RCC.apb2enr().modify(|w| {
        w.set_syscfgen(true);
        w.set_tim1en(true);
    });
    // A peripheral responds two cycles after its clock starts; reading back takes longer.
    let _ = RCC.apb2enr().read();

    darken();
    for (port, kept, set) in PINS {
        let moder = port.moder().read().0 & kept | set;
        port.moder().write_value(gpio::regs::Moder(moder));
    }
    for amplifier in [OPAMP2, OPAMP3] {
        amplifier.tcmr().write_value(opamp::regs::Tcmr(PLAN.amplifier.tcmr));
        amplifier.csr().write_value(opamp::regs::Csr(PLAN.amplifier.csr));
    }
    ADC12_COMMON.ccr().write_value(adccommon::regs::Ccr(PLAN.adc_common));
    for converter in [ADC1, ADC2] {
        wake(converter);
    }
    configure(&PLAN);
    // All other interrupts can wait for a frame.
    for later in [Interrupt::USB_LP, Interrupt::TIM2] {
        later.set_priority(Priority::P4);
    }
    run(&PLAN);
    full_scale()
}

/// Writes all registers that depend on the settings, while the scan is stopped.
fn configure(plan: &Plan) {
    for (converter, plan) in [(ADC1, plan.adc1), (ADC2, plan.adc2)] {
        converter.ier().write_value(adc::regs::Ier(plan.ier));
        converter.cfgr().write_value(adc::regs::Cfgr(plan.cfgr));
        converter.cfgr2().write_value(adc::regs::Cfgr2(plan.cfgr2));
        converter.smpr().write_value(adc::regs::Smpr(plan.smpr1));
        converter.smpr2().write_value(adc::regs::Smpr2(plan.smpr2));
        converter.sqr1().write_value(adc::regs::Sqr1(plan.sqr1));
        converter.sqr2().write_value(adc::regs::Sqr2(plan.sqr2));
        converter.jsqr().write_value(adc::regs::Jsqr(plan.jsqr));
    }
    configure_timer(plan.timer);
}

/// Brings a converter from deep power-down to ready (RM0440 §21.4.6, §21.4.8, §21.4.9).
fn wake(converter: adc::Adc) {
    // 20 µs for the regulator (DS12589 table 66).
    const REGULATOR: u32 = scan_plan::ticks(20_000, scan_plan::g431::CLOCK_HZ);
    converter.cr().write_value(adc::regs::Cr(0));
    converter.cr().write(|cr| cr.set_advregen(true));
    cortex_m::asm::delay(REGULATOR);
    converter.cr().modify(|cr| cr.set_adcal(true));
    while converter.cr().read().adcal() {}
    // Enabling must wait four ADC cycles after calibration.
    cortex_m::asm::delay(4 * scan_plan::g431::TICKS_PER_CYCLE + 4);
    converter.isr().write(|isr| isr.set_adrdy(true));
    converter.cr().modify(|cr| cr.set_aden(true));
    while !converter.isr().read().adrdy() {}
}

fn configure_timer(plan: Timer) {
    TIM1.cr2().write_value(timer::regs::Cr2Adv(plan.cr2));
    TIM1.ccmr_output(0).write_value(timer::regs::CcmrOutputGp16(plan.ccmr1));
    TIM1.ccmr_output(1).write_value(timer::regs::CcmrOutputGp16(plan.ccmr2));
    TIM1.ccmr3().write_value(timer::regs::Ccmr3Adv(plan.ccmr3));
    TIM1.ccer().write_value(timer::regs::CcerAdv(plan.ccer));
    TIM1.bdtr().write_value(timer::regs::BdtrAdv(plan.bdtr));
    TIM1.psc().write_value(plan.psc as u16);
    TIM1.arr().write_value(timer::regs::ArrCore(plan.arr));
    for (channel, compare) in [plan.ccr1, plan.ccr2, plan.ccr3].into_iter().enumerate() {
        TIM1.ccr(channel).write_value(timer::regs::Ccr1ch(compare));
    }
    TIM1.ccr6().write_value(timer::regs::Ccr1ch(plan.ccr6));
    TIM1.dier().write_value(timer::regs::DierAdv(plan.dier));
}

/// Starts a stopped scan at the beginning of a frame.
fn run(plan: &Plan) {
    arm(PATTERNS, plan.patterns, GPIOB.bsrr().as_ptr().cast(), BUFFERS.patterns.get().cast());
    arm(COLUMNS, plan.columns, ADC1.dr().as_ptr().cast(), BUFFERS.columns.get().cast());
    arm(BRIDGES, plan.bridges, ADC2.dr().as_ptr().cast(), BUFFERS.bridges.get().cast());
    let last = match plan.last {
        Last::Columns => Interrupt::DMA1_CHANNEL2,
        Last::Bridges => Interrupt::DMA1_CHANNEL3,
    };
    for converter in [ADC1, ADC2] {
        // An unread reading would make the next one an overrun.
        converter.isr().write(|isr| {
            isr.set_eoc(true);
            isr.set_ovr(true);
        });
    }
    for line in [last, Interrupt::ADC1_2] {
        line.set_priority(Priority::P0);
        line.unpend();
        // SAFETY: its handler is below, and no critical section relies on a masked line.
        unsafe { line.enable() };
    }
    for converter in [ADC1, ADC2] {
        converter.cr().modify(|cr| cr.set_adstart(true));
    }
    ADC1.cr().modify(|cr| cr.set_jadstart(true));
    TIM1.egr().write(|egr| egr.set_ug(true));
    TIM1.sr().write_value(timer::regs::SrAdv(0));
    FRAMES.begin(plan.step.frame_us());
    TIM1.cr1().write_value(timer::regs::Cr1Gp16(plan.timer.cr1 | 1));
}

fn arm(channel: usize, plan: Channel, peripheral: *const (), memory: *mut u32) {
    let registers = DMA1.ch(channel);
    registers.cr().write_value(bdma::regs::Cr(0));
    DMA1.ifcr().write_value(bdma::regs::Isr(0xF << (4 * channel)));
    DMAMUX1.ccr(channel).write_value(dmamux::regs::Ccr(plan.request));
    registers.par().write_value(peripheral.addr() as u32);
    registers.mar().write_value(memory.expose_provenance() as u32);
    registers.ndtr().write_value(bdma::regs::Ndtr(plan.count));
    registers.cr().write_value(bdma::regs::Cr(plan.ccr | 1));
}

/// Stops the scan with every LED off.
fn halt() {
    TIM1.cr1().write_value(timer::regs::Cr1Gp16(0));
    for converter in [ADC1, ADC2] {
        // ADSTP and JADSTP are two bits above ADSTART and JADSTART, and may be set only with them.
        converter.cr().modify(|cr| cr.0 |= (cr.0 & 0b1100) << 2);
        while converter.cr().read().0 & 0b11_0000 != 0 {}
    }
    for line in [Interrupt::DMA1_CHANNEL2, Interrupt::DMA1_CHANNEL3, Interrupt::ADC1_2] {
        line.disable();
    }
    darken();
    FRAMES.halt();
}

/// Switches every LED off.
fn darken() {
    let word = pattern::dark(G431_ROWS, G431_SELECT);
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

#[interrupt]
fn DMA1_CHANNEL2() {
    on_frame(COLUMNS, 2 * COLUMN_READINGS as u32);
}

#[interrupt]
fn DMA1_CHANNEL3() {
    on_frame(BRIDGES, 2 * BRIDGE_READINGS as u32);
}

/// Handles a complete frame.
#[unsafe(link_section = ".ccm.on_frame")]
fn on_frame(channel: usize, count: u32) {
    let begin = cortex_m::peripheral::DWT::cycle_count();
    DMA1.ifcr().write_value(bdma::regs::Isr(0xF << (4 * channel)));
    if overrun() {
        return restart();
    }
    let end = FRAMES.tick();
    let half = left(channel, count);
    let codes = read(half);
    if left(channel, count) != half {
        return FRAMES.lose(1);
    }
    FRAMES.push(codes, end);
    FRAMES.note_cost(cortex_m::peripheral::DWT::cycle_count().wrapping_sub(begin));
}

/// Handles an overrun of a converter, at the same priority as a frame.
#[interrupt]
fn ADC1_2() {
    if overrun() {
        restart();
    }
}

/// Whether the DMA missed a reading, which shifts rows against readings.
fn overrun() -> bool {
    ADC1.isr().read().ovr() || ADC2.isr().read().ovr()
}

/// Restarts the scan; the frame being read counts as lost.
fn restart() {
    halt();
    run(&present_plan());
}

/// Half of the buffers that the DMA is not writing.
///
/// The DMA is in the first half while more than half of its transfers are left.
fn left(channel: usize, count: u32) -> usize {
    usize::from(DMA1.ch(channel).ndtr().read().0 > count / 2)
}

/// Codes of one frame.
fn read(half: usize) -> Codes {
    // Keeps the copy between the two checks of which half is complete.
    compiler_fence(Ordering::SeqCst);
    // SAFETY: both halves exist; the DMA is writing the other.
    let (columns, bridges) = unsafe {
        (
            &*BUFFERS
                .columns
                .get()
                .cast::<[[Code; scan_plan::COLUMNS as usize]; STEPS as usize]>()
                .add(half),
            &*BUFFERS
                .bridges
                .get()
                .cast::<[[Code; BRIDGE_INPUTS.len()]; STEPS as usize]>()
                .add(half),
        )
    };
    let [dark, lit @ ..] = columns;
    // The dark step's midpoints are sensor 0's again and are left out.
    let [_, steps @ ..] = bridges;
    let top = FULL_SCALE.load(Ordering::Relaxed);
    let sensors = steps.each_ref().map(|&[a, c, bias, b, d]| {
        // With a bias off the middle the amplifiers' outputs are meaningless: a midpoint at the
        // rail marks the bridge as faulty.
        let biased = bias.0.abs_diff(top / 2) <= top / BIAS_MARGIN;
        Some(if biased { Midpoints { a, b, c, d } } else { Midpoints::default() })
    });
    let taxels = TaxelCodes { lit: *lit, dark: *dark };
    compiler_fence(Ordering::SeqCst);
    // Single samples, scaled like the other readings, which are sums.
    let internal = |place: usize| {
        let sample = ADC1.jdr(place).read().0 as u16 & 0xFFF;
        Some(Code(sample * OVERSAMPLING.load(Ordering::Relaxed)))
    };
    Codes {
        full_scale: full_scale(),
        taxels: Some(taxels),
        bridges: sensors,
        temperature: internal(0),
        reference: internal(1),
    }
}
