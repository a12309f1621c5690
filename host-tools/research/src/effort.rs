//! Thoroughness of a measurement, its progress, its cancellation and its threads.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Number of devices and size of the nets of a measurement.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Seeds of the devices; a figure is the mean over them.
    pub devices: Vec<u64>,
    /// Training steps of a net.
    pub steps: usize,
    /// Numbers of hidden units of the nets.
    pub widths: Vec<usize>,
}

impl Effort {
    /// Returns the effort of the documentation: five devices.
    #[must_use]
    pub fn full() -> Self {
        Self { devices: (11..16).collect(), steps: 100, widths: vec![2, 4, 6, 8, 16, 32] }
    }

    /// Returns the effort of a test: one device and few nets.
    #[must_use]
    pub fn quick() -> Self {
        Self { devices: vec![11], steps: 40, widths: vec![4, 8, 16] }
    }
}

/// Progress report and cancellation of a long measurement.
#[derive(Clone, Copy)]
pub struct Waiting<'w> {
    /// Callback for the finished share and the name of the current work.
    pub progress: &'w (dyn Fn(f64, &str) + Sync),
    /// Flag that cancels the measurement when set.
    pub stop: &'w AtomicBool,
}

/// Applies `work` to every item on all cores; returns the results in order, or the first error.
pub(crate) fn on_all_cores<T: Sync, R: Send>(
    items: &[T],
    work: impl Fn(&T) -> anyhow::Result<R> + Sync,
) -> anyhow::Result<Vec<R>> {
    let next = AtomicUsize::new(0);
    let worker = || {
        let mut done = Vec::new();
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(at) else { return done };
            done.push((at, work(item)));
        }
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut done = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..cores.min(items.len())).map(|_| scope.spawn(worker)).collect();
        let join = |worker: std::thread::ScopedJoinHandle<'_, Vec<(usize, _)>>| {
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        workers.into_iter().flat_map(join).collect::<Vec<_>>()
    });
    done.sort_by_key(|(at, _)| *at);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_keep_the_order_of_the_items() {
        let items: Vec<u64> = (0..100).collect();
        let squares = on_all_cores(&items, |x| Ok(x * x)).unwrap();
        assert_eq!(squares, items.iter().map(|x| x * x).collect::<Vec<_>>());
        let odd = on_all_cores(&items, |x| {
            anyhow::ensure!(x % 2 == 0, "{x}");
            Ok(())
        });
        assert_eq!(odd.unwrap_err().to_string(), "1");
    }
}
