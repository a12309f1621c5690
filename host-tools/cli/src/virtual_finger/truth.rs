//! True values of each scan, to compare frames with.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use taxel::units::Micros;
use taxel_files::trace::Truth;

/// Scans kept, about 4 s at 4 kHz. Older ones are dropped.
const MOST: usize = 1 << 14;

/// Log of the last seconds' truth, by device time. Clones share it.
#[derive(Clone, Debug, Default)]
pub struct TruthLog(Arc<Mutex<VecDeque<(Micros, Truth)>>>);

impl TruthLog {
    pub(super) fn push(&self, time: Micros, truth: Truth) {
        let mut log = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if log.len() == MOST {
            log.pop_front();
        }
        log.push_back((time, truth));
    }

    /// Returns the truth at `time` and drops all before it. Calls must be in the order of time, as
    /// frames come.
    #[must_use]
    pub fn take(&self, time: Micros) -> Option<Truth> {
        let mut log = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        while let Some((at, _)) = log.front()
            && *at < time
        {
            log.pop_front();
        }
        match log.front() {
            Some((at, truth)) if *at == time => Some(*truth),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn truth_log_finds_frames_in_bounded_memory() {
        let log = TruthLog::default();
        for i in 0..MOST as u64 + 100 {
            log.push(Micros(i), Truth { torsion: Some(i as f64), ..Truth::default() });
        }
        assert_eq!(log.0.lock().unwrap().len(), MOST);
        assert_eq!(log.take(Micros(99)), None);
        assert_eq!(log.take(Micros(4000)).unwrap().torsion, Some(4000.0));
        assert_eq!(log.take(Micros(4004)).unwrap().torsion, Some(4004.0));
        assert_eq!(log.take(Micros(1 << 40)), None);
    }
}
