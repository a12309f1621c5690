//! CMSDK APB UART 0 as `embedded-io-async` halves.
//!
//! The UART holds one byte each way. Receiving is interrupt-driven into a ring; when the ring is full
//! the interrupt is switched off and the byte stays in the UART, so QEMU holds the sender back and
//! nothing is lost (silicon would overrun). Sending writes for as long as the UART takes bytes and
//! sleeps on the interrupt only when it is full; QEMU is rarely full, so that a frame usually costs no
//! interrupt at all.

use core::convert::Infallible;
use core::future::poll_fn;
use core::sync::atomic::{AtomicBool, Ordering};
use core::task::Poll;

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::pipe::Pipe;
use embassy_sync::waitqueue::AtomicWaker;
use embedded_io_async::{ErrorType, Read, Write};

use crate::mmio::{Irq, Reg, unmask};

const UART0: usize = 0x4000_4000;
const DATA: Reg = Reg::apb(UART0, 0x00);
const STATE: Reg = Reg::apb(UART0, 0x04);
const CTRL: Reg = Reg::apb(UART0, 0x08);
const INT_CLEAR: Reg = Reg::apb(UART0, 0x0C);
const BAUD_DIV: Reg = Reg::apb(UART0, 0x10);

/// Bits of `STATE`.
const TX_FULL: u32 = 1 << 0;
const RX_FULL: u32 = 1 << 1;
/// Bits of `CTRL`.
const TX_ENABLE: u32 = 1 << 0;
const RX_ENABLE: u32 = 1 << 1;
const TX_INT_ENABLE: u32 = 1 << 2;
const RX_INT_ENABLE: u32 = 1 << 3;
/// Bits of `INT_CLEAR`.
const TX_INT: u32 = 1 << 0;
const RX_INT: u32 = 1 << 1;

/// The smallest divider the UART accepts: 25 MHz / 16 = 1.56 Mbaud. QEMU ignores the rate but will not
/// start a UART without a valid divider.
const DIVIDER: u32 = 16;

static RX: Pipe<CriticalSectionRawMutex, 1024> = Pipe::new();
static TX_READY: AtomicWaker = AtomicWaker::new();
static TAKEN: AtomicBool = AtomicBool::new(false);

/// Receiving half.
pub struct Rx(());

/// Sending half.
pub struct Tx(());

/// Starts the UART.
///
/// # Panics
/// On the second call: the halves are unique.
pub fn init() -> (Rx, Tx) {
    assert!(!TAKEN.swap(true, Ordering::Relaxed), "UART 0 is already in use");
    BAUD_DIV.write(DIVIDER);
    CTRL.write(TX_ENABLE | RX_ENABLE | RX_INT_ENABLE);
    unmask(Irq::Uart0Rx);
    unmask(Irq::Uart0Tx);
    (Rx(()), Tx(()))
}

/// Handler of [`Irq::Uart0Rx`].
pub fn on_rx() {
    INT_CLEAR.write(RX_INT);
    critical_section::with(|_| fill_ring());
}

/// Handler of [`Irq::Uart0Tx`].
pub fn on_tx() {
    INT_CLEAR.write(TX_INT);
    critical_section::with(|_| CTRL.modify(|ctrl| ctrl & !TX_INT_ENABLE));
    TX_READY.wake();
}

/// Moves what the UART holds into the ring; call in a critical section.
fn fill_ring() {
    while STATE.read() & RX_FULL != 0 {
        if RX.is_full() {
            return CTRL.modify(|ctrl| ctrl & !RX_INT_ENABLE);
        }
        // Cannot fail: there is room, and this is the only writer.
        let _ = RX.try_write(&[DATA.read() as u8]);
    }
    CTRL.modify(|ctrl| ctrl | RX_INT_ENABLE);
}

impl ErrorType for Rx {
    type Error = Infallible;
}

impl Read for Rx {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        let length = RX.read(buffer).await;
        // A byte that waited while the interrupt was off will not raise it again.
        critical_section::with(|_| {
            if CTRL.read() & RX_INT_ENABLE == 0 {
                fill_ring();
            }
        });
        Ok(length)
    }
}

impl ErrorType for Tx {
    type Error = Infallible;
}

impl Write for Tx {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        if bytes.is_empty() {
            return Ok(0);
        }
        self.flush().await?;
        let mut written = 0;
        for byte in bytes {
            if STATE.read() & TX_FULL != 0 {
                break;
            }
            DATA.write(u32::from(*byte));
            written += 1;
        }
        Ok(written)
    }

    /// Waits until the UART has taken the last byte.
    async fn flush(&mut self) -> Result<(), Infallible> {
        let idle = || STATE.read() & TX_FULL == 0;
        poll_fn(|context| {
            if idle() {
                return Poll::Ready(Ok(()));
            }
            TX_READY.register(context.waker());
            critical_section::with(|_| CTRL.modify(|ctrl| ctrl | TX_INT_ENABLE));
            // The byte may have left before its interrupt was enabled.
            if idle() { Poll::Ready(Ok(())) } else { Poll::Pending }
        })
        .await
    }
}
