//! Signals of a press: its strength, its shear, and whether it was held or fast.

use taxel::condition::{Bias, Levels, Signals};
use taxel::scan::TAXELS;

use super::{Current, Known};

/// Least strength of a held press, as a share of its peak, and the time that it takes.
const HELD: (f64, u64) = (0.8, 500_000);
/// Longest time of a fast press from its beginning to nine tenths of its peak.
const FAST: (f64, u64) = (0.9, 100_000);

impl Current {
    /// Whether the strength stays near the peak for half a second.
    pub(super) fn is_held(&self) -> bool {
        let (share, time) = HELD;
        let firm =
            self.course.chunk_by(|a, b| (a.1 >= share * self.peak) == (b.1 >= share * self.peak));
        firm.filter(|run| run[0].1 >= share * self.peak)
            .any(|run| run[run.len() - 1].0.saturating_sub(run[0].0) >= time)
    }

    /// Whether the strength nearly reaches the peak at once.
    pub(super) fn is_fast(&self) -> bool {
        let (share, time) = FAST;
        let reached = self.course.iter().find(|(_, strength)| *strength >= share * self.peak);
        reached.is_some_and(|(at, _)| at.saturating_sub(self.began) <= time)
    }
}

/// Changes of the taxels relative to their light at rest; negative where it came nearer.
pub(super) fn changes(signals: &Signals, bias: &Bias) -> Option<[f32; TAXELS]> {
    let (mut changes, rest) = (signals.taxels?, bias.taxels?.level);
    changes.iter_mut().zip(rest).for_each(|(change, rest)| *change /= rest.max(f32::MIN_POSITIVE));
    Some(changes)
}

/// Strength of a frame, and its shear over the normal signal if that is known.
pub(super) fn strength(
    signals: &Signals,
    changes: &[f32; TAXELS],
    known: Option<Known>,
) -> (f64, Option<[f64; 2]>) {
    if let Some(Known { force: [x, y, z], .. }) = known {
        return (z.max(0.0), (z > 0.0).then(|| [x / z, y / z]));
    }
    let faulty = signals.health.dead | signals.health.saturated;
    let sound = (0..TAXELS).filter(|k| faulty >> k & 1 == 0);
    let squares: f64 = sound.map(|k| f64::from(changes[k]).powi(2)).sum();
    let sum =
        |axis: usize| -> f64 { signals.bridges.iter().flatten().map(|u| f64::from(u[axis])).sum() };
    let [x, y, z] = [sum(0), sum(1), sum(2).abs()];
    ((squares / TAXELS as f64).sqrt(), (z > 0.0).then(|| [x / z, y / z]))
}

/// Lets the bias follow the levels of the unloaded finger, which drift as it warms.
pub(super) fn follow(bias: &mut Bias, levels: &Levels) {
    const SHARE: f32 = 1e-3;
    let towards = |bias: &mut [f32], levels: &[f32]| {
        bias.iter_mut().zip(levels).for_each(|(bias, level)| *bias += SHARE * (level - *bias));
    };
    if let (Some(bias), Some(levels)) = (&mut bias.taxels, &levels.taxels) {
        towards(&mut bias.level, levels);
    }
    for (bias, levels) in bias.bridges.iter_mut().zip(&levels.bridges) {
        if let (Some(bias), Some(levels)) = (bias, levels) {
            towards(&mut bias.level, levels);
        }
    }
}
