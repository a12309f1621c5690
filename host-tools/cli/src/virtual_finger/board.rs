//! Simulated board whose scans come from a source, each at its own time.
//!
//! Deadlines are absolute, from the first scan on, so that the rate is exact with any timer. The
//! timer wakes once a millisecond; all due scans follow. If this machine falls behind by more than
//! [`PATIENCE`] (a suspended laptop, a source slower than real time), the finger's clock stops
//! meanwhile. The next scan reports the lost time.

use std::sync::PoisonError;
use std::time::Duration;

use taxel::scan::Scan;
use taxel::session::Board;
use taxel::store::{RamFlash, Store, StoredBias};
use taxel::wire::message::{Identity, Refusal};
use taxel_files::trace::Sample;
use tokio::time::{Instant, sleep, sleep_until};

use super::source::Source;
use super::truth::TruthLog;
use super::{Ending, Outcome};
use taxel_client::LinkError;

/// Largest delay of the scans before the finger stops catching up.
const PATIENCE: Duration = Duration::from_millis(250);

/// Late scans in a row before a pause of 1 ms. Catching up at once would overrun the buffers
/// between finger and host.
const BURST: u32 = 16;

/// Unit of [`Board::ticks`]: nanoseconds.
const TICK_HZ: u32 = 1_000_000_000;

pub(super) struct PacedBoard {
    source: Source,
    scan_hz: u16,
    /// Next sample. It stays here during the wait, so that a dropped wait loses nothing.
    next: Option<Sample>,
    /// A moment of this machine and its device time, in microseconds.
    origin: Option<(Instant, u64)>,
    lost: u32,
    burst: u32,
    truth: TruthLog,
    ending: Ending,
    epoch: std::time::Instant,
    store: Store<RamFlash<Vec<u8>>>,
    held: Option<u8>,
}

impl PacedBoard {
    pub(super) fn new(
        mut source: Source,
        truth: TruthLog,
        ending: Ending,
    ) -> Result<Self, LinkError> {
        let scan_hz = source.scan_hz()?;
        let epoch = std::time::Instant::now();
        Ok(Self {
            source,
            scan_hz,
            next: None,
            origin: None,
            lost: 0,
            burst: 0,
            truth,
            ending,
            epoch,
            store: Store::new(RamFlash::new(vec![0; RamFlash::SIZE])),
            held: None,
        })
    }

    /// Identity that the finger reports.
    pub(super) fn identity(&self) -> Identity {
        let short = |text: &str| text.chars().filter(char::is_ascii).collect::<String>();
        let cut = |text: String, most: usize| text.chars().take(most).collect::<String>();
        Identity {
            board: cut(short(self.source.board()), 24).as_str().try_into().unwrap_or_default(),
            serial: cut(short(self.source.serial()), 32).as_str().try_into().unwrap_or_default(),
            build: env!("CARGO_PKG_VERSION").try_into().unwrap_or_default(),
            scan_hz: self.scan_hz,
            full_scale: self.source.full_scale(),
            tick_hz: TICK_HZ,
        }
    }

    /// Stores the settings and bias of a recorded finger, as if it had saved them. The bias belongs
    /// to the calibration with this CRC.
    pub(super) fn keep(&mut self, calibration: u32) {
        // Writing to a flash in memory cannot fail.
        if let Some(settings) = self.source.settings() {
            let _ = self.store.save_settings(&settings);
        }
        if let Some(bias) = self.source.bias() {
            let _ = self.store.save_bias(&StoredBias { calibration, bias: Some(bias) });
        }
    }

    /// Loads the next scan and returns its deadline.
    fn due(&mut self) -> Option<Instant> {
        if self.next.is_none() {
            self.next = self.source.next();
        }
        let Some(next) = &self.next else {
            let outcome = self.source.failure().map_or(Outcome::Finished, Outcome::Failed);
            self.ending.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(outcome);
            return None;
        };
        let time = next.scan.time.0;
        let (start, first) = *self.origin.get_or_insert_with(|| (Instant::now(), time));
        Some(start + Duration::from_micros(time.saturating_sub(first)))
    }
}

impl Board for PacedBoard {
    type Flash = RamFlash<Vec<u8>>;

    async fn scan(&mut self) -> Option<Scan> {
        let due = self.due()?;
        let now = Instant::now();
        if due > now {
            sleep_until(due).await;
            self.burst = 0;
        } else if self.burst < BURST {
            // The link may run between any two scans.
            tokio::task::yield_now().await;
            self.burst += 1;
        } else {
            sleep(Duration::from_millis(1)).await;
            self.burst = 0;
        }
        if now.duration_since(due) > PATIENCE {
            self.origin = None;
            self.lost += 1;
        }
        let Sample { mut scan, truth } = self.next.take()?;
        scan.lost += std::mem::take(&mut self.lost);
        if let (Some(row), Some(taxels)) = (self.held, &mut scan.codes.taxels) {
            taxels.hold(row);
        }
        self.truth.push(scan.time, truth);
        Some(scan)
    }

    fn ticks(&self) -> u32 {
        // The counter wraps; only differences count.
        self.epoch.elapsed().as_nanos() as u32
    }

    fn store(&mut self) -> &mut Store<Self::Flash> {
        &mut self.store
    }

    fn hold_row(&mut self, row: Option<u8>) -> Result<(), Refusal> {
        self.held = row;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::virtual_finger::source::tests::still;

    fn run<T>(future: impl Future<Output = T>) -> T {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        builder.enable_time().start_paused(true).build().unwrap().block_on(future)
    }

    fn board(samples: usize) -> PacedBoard {
        let source = Source::samples("still", still(4000).take(samples));
        PacedBoard::new(source, TruthLog::default(), Ending::default()).unwrap()
    }

    #[test]
    fn one_second_of_scans_takes_one_second() {
        run(async {
            let mut board = board(4001);
            let start = Instant::now();
            let mut scans = 0;
            while let Some(scan) = board.scan().await {
                assert_eq!(scan.lost, 0);
                scans += 1;
            }
            assert_eq!(scans, 4001);
            assert!(start.elapsed().abs_diff(Duration::from_secs(1)) <= Duration::from_millis(1));
        });
    }

    #[test]
    fn dropped_wait_loses_no_scan() {
        run(async {
            let mut board = board(100);
            let mut times = Vec::new();
            while times.len() < 100 {
                let dropped = tokio::time::timeout(Duration::from_micros(10), board.scan()).await;
                if let Ok(Some(scan)) = dropped {
                    times.push(scan.time.0);
                }
            }
            assert_eq!(times, (0..100).map(|i| i * 250).collect::<Vec<_>>());
        });
    }

    #[test]
    fn long_stall_stops_clock_and_is_reported() {
        run(async {
            let mut board = board(8000);
            assert_eq!(board.scan().await.unwrap().lost, 0);
            tokio::time::advance(Duration::from_secs(1)).await;
            let late = board.scan().await.unwrap();
            assert!(late.lost > 0);
            assert_eq!(late.time.0, 250);
            let resumed = Instant::now();
            for _ in 0..4000 {
                assert_eq!(board.scan().await.unwrap().lost, 0);
            }
            assert!(resumed.elapsed().abs_diff(Duration::from_secs(1)) <= Duration::from_millis(1));
        });
    }
}
