//! The loaded trace in place of an ADC.

use embassy_futures::yield_now;
use embassy_time::{Duration, Instant, Timer};
use taxel::scan::Scan;
use taxel::session::{Board, Pace};
use taxel::store::Store;
use taxel::units::Micros;

use crate::image::{Header, MAGIC, VERSION};
use crate::nor::{self, Nor};
use crate::time_driver;

/// Scans from an image, one after the other.
pub struct Trace {
    /// How to play them back.
    pub header: Header,
    next: Option<Scan>,
    rest: &'static [u8],
    left: u32,
    /// When the first scan was asked for, and the time it carries.
    began: Option<(Instant, Micros)>,
    store: Store<Nor>,
}

impl Trace {
    /// The trace in `image`, if there is one.
    pub fn open(image: &'static [u8]) -> Option<Self> {
        let (header, rest) = postcard::take_from_bytes::<Header>(image).ok()?;
        if header.magic != MAGIC || header.version != VERSION {
            return None;
        }
        let store = Store::new(nor::erased());
        let (next, began, left) = (None, None, header.scans);
        let mut trace = Self { header, next, rest, left, began, store };
        trace.read_next();
        Some(trace)
    }

    /// Who waits for whom.
    pub fn pace(&self) -> Pace {
        if self.header.lossless { Pace::Lossless } else { Pace::Live }
    }

    /// How many of the promised scans have not been played back.
    pub fn missing(&self) -> u32 {
        self.left
    }

    fn read_next(&mut self) {
        self.next = None;
        if self.left > 0
            && let Ok((scan, rest)) = postcard::take_from_bytes(self.rest)
        {
            (self.next, self.rest) = (Some(scan), rest);
            self.left -= 1;
        }
    }
}

impl Board for Trace {
    type Flash = Nor;

    async fn scan(&mut self) -> Option<Scan> {
        let due = self.next?.time;
        match self.pace() {
            // Whoever else has something to do goes first.
            Pace::Lossless => yield_now().await,
            Pace::Live => {
                let (began, first) = *self.began.get_or_insert((Instant::now(), due));
                Timer::at(began + Duration::from_micros(due.0.saturating_sub(first.0))).await;
            }
        }
        // Taken only now: a future that is dropped while it waits has taken nothing.
        let scan = self.next;
        self.read_next();
        scan
    }

    fn ticks(&self) -> u32 {
        time_driver::cycles() as u32
    }

    fn store(&mut self) -> &mut Store<Nor> {
        &mut self.store
    }
}
