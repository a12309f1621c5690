//! Detection of a force sensor that is far noisier than when its bias was taken.
//!
//! Fourth differences separate noise from movement. Movement at a twenty-fifth of the scan rate or
//! slower has hardly any. White noise is 70 times as strong in them (1 + 16 + 36 + 16 + 1). The
//! number of loud blocks in a window separates noise from knocks: a knock is in one or two blocks,
//! noise in all.

use super::{Bias, Signals};
use crate::scan::SENSORS;

/// Scans in a block, and blocks in a window.
const BLOCK: u8 = 16;
const BLOCKS: u8 = 8;
/// Scans before the first fourth difference.
const FILL: u8 = 4;
/// Variance gain of fourth differences for white noise.
const GAIN: f32 = 70.0;
/// Thresholds: variance of a loud block over the bias' own, and loud blocks of a noisy sensor.
///
/// Of the blocks of a sound sensor 0.7 % are loud, so that one window of 10¹¹ reports a sound
/// sensor. With twice the noise 99.9 % of the windows report it.
const LOUD: f32 = 2.0;
const NOISY: u8 = 6;

/// State of the noise detector. One sensor is watched at a time: three differences a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NoiseWatch {
    sensor: u8,
    seen: u8,
    loud: u8,
    /// Last signals of the watched sensor, and their differences up to the third.
    last: [[f32; 4]; 3],
    /// Sum of the squared fourth differences of the block.
    sum: f32,
    /// Bit i: sensor i was noisy in its last window.
    noisy: u8,
}

impl NoiseWatch {
    /// Processes one scan and returns the noisy sensors, a bit each.
    pub fn update(&mut self, signals: &Signals, bias: &Bias) -> u8 {
        let i = usize::from(self.sensor);
        let (Some(Some(signal)), Some(Some(bias))) = (signals.bridges.get(i), bias.bridges.get(i))
        else {
            self.next(false);
            return self.noisy;
        };
        for (last, u) in self.last.iter_mut().zip(*signal) {
            // Each difference is the previous one minus its last value.
            let fourth = last.iter_mut().fold(u, |now, last| now - core::mem::replace(last, now));
            self.sum += fourth * fourth;
        }
        self.seen += 1;
        if self.seen == FILL {
            self.sum = 0.0;
        } else if self.seen % BLOCK == FILL {
            let values = 3.0 * f32::from(BLOCK);
            self.loud += u8::from(self.sum > LOUD * GAIN * values * bias.noise * bias.noise);
            self.sum = 0.0;
        }
        if self.seen == FILL + BLOCK * BLOCKS {
            self.next(self.loud >= NOISY);
        }
        self.noisy
    }

    /// Restarts the window after lost scans, because the step over the gap may be movement, and
    /// while the finger slides, which shakes every sensor.
    pub fn interrupt(&mut self) {
        *self = Self { sensor: self.sensor, noisy: self.noisy, ..Self::default() };
    }

    fn next(&mut self, noisy: bool) {
        let others = self.noisy & !(1 << self.sensor);
        self.noisy = others | u8::from(noisy) << self.sensor;
        self.sensor = (self.sensor + 1) % SENSORS as u8;
        self.interrupt();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::condition::BridgeBias;
    use crate::condition::random::noise;

    const NOISE: f32 = 1e-4;

    fn bias() -> Bias {
        let sensor = BridgeBias { level: [0.0; 3], noise: NOISE };
        Bias { bridges: [Some(sensor); SENSORS], ..Bias::default() }
    }

    /// Share of scans in which a sensor is reported as noisy.
    fn flagged(times: f32, moving: impl Fn(usize) -> f32) -> f32 {
        let (mut watch, mut state, mut flagged) = (NoiseWatch::default(), 1, 0);
        let scans = 60_000;
        for i in 0..scans {
            let bridges = core::array::from_fn(|_| {
                let axis = |_| moving(i) + times * NOISE * noise(&mut state);
                Some(core::array::from_fn(axis))
            });
            let signals = Signals { bridges, ..Signals::default() };
            flagged += u32::from(watch.update(&signals, &bias()) != 0);
        }
        flagged as f32 / scans as f32
    }

    #[test]
    fn doubled_noise_is_flagged_usual_noise_is_not() {
        assert_eq!(flagged(1.0, |_| 0.0), 0.0);
        assert!(flagged(2.0, |_| 0.0) > 0.98);
        assert!(flagged(10.0, |_| 0.0) > 0.98);
    }

    #[test]
    fn presses_and_knocks_are_not_flagged() {
        // A newton is 0.13 of full scale: pressed, or knocked at, ten times a second.
        let slow = |i: usize| 0.13 * f32::sin(i as f32 * core::f32::consts::TAU * 10.0 / 1000.0);
        assert_eq!(flagged(1.0, slow), 0.0);
        assert_eq!(flagged(1.0, |i| if i % 100 == 0 { 0.05 } else { 0.0 }), 0.0);
    }

    #[test]
    fn movement_during_lost_scans_is_not_flagged() {
        let mut watch = NoiseWatch::default();
        let noisy = (0..10_000u16).map(|i| {
            if i % 3 == 0 {
                watch.interrupt();
            }
            let steps = [Some([f32::from(i / 3); 3]); SENSORS];
            watch.update(&Signals { bridges: steps, ..Signals::default() }, &bias())
        });
        assert_eq!(noisy.max(), Some(0));
    }

    /// Scans in which each sensor is watched for a window.
    const TURN: usize = SENSORS * (FILL + BLOCK * BLOCKS) as usize;

    /// Reports after some scans in which each sensor has so many times its noise.
    fn after(watch: &mut NoiseWatch, state: &mut u32, times: [f32; SENSORS], scans: usize) -> u8 {
        let scan = |_| {
            let bridges = times.map(|times| Some([0.0; 3].map(|_| times * NOISE * noise(state))));
            watch.update(&Signals { bridges, ..Signals::default() }, &bias())
        };
        (0..scans).map(scan).last().unwrap_or_default()
    }

    #[test]
    fn each_noisy_sensor_is_named_until_it_is_quiet() {
        for loud in 0..SENSORS {
            let (mut watch, mut state) = (NoiseWatch::default(), 1);
            let mut times = [1.0; SENSORS];
            times[loud] = 3.0;
            assert_eq!(after(&mut watch, &mut state, times, TURN), 1 << loud);
            times[(loud + 1) % SENSORS] = 3.0;
            let both = 1 << loud | 1 << ((loud + 1) % SENSORS);
            assert_eq!(after(&mut watch, &mut state, times, TURN), both);
            assert_eq!(after(&mut watch, &mut state, [1.0; SENSORS], TURN), 0);
        }
    }

    #[test]
    fn lost_scans_keep_no_sensor_from_its_turn() {
        let (mut watch, mut state) = (NoiseWatch::default(), 1);
        let mut noisy = 0;
        for _ in 0..2 * SENSORS {
            noisy = after(&mut watch, &mut state, [1.0, 1.0, 1.0, 3.0], TURN / SENSORS + 10);
            watch.interrupt();
        }
        assert_eq!(noisy, 0b1000);
    }

    #[test]
    fn finger_without_noise_is_not_noisy() {
        let silent = Bias {
            bridges: [Some(BridgeBias { level: [0.0; 3], noise: 0.0 }); SENSORS],
            ..Bias::default()
        };
        let still = Signals { bridges: [Some([0.0; 3]); SENSORS], ..Signals::default() };
        let mut watch = NoiseWatch::default();
        assert_eq!((0..2 * TURN).map(|_| watch.update(&still, &silent)).max(), Some(0));
    }

    #[test]
    fn nan_signals_do_not_stop_the_watch() {
        let mut watch = NoiseWatch::default();
        for i in 0..1000 {
            let wild = [f32::NAN, f32::MAX, f32::NEG_INFINITY][i % 3];
            let signals = Signals { bridges: [Some([wild; 3]); SENSORS], ..Signals::default() };
            let _ = watch.update(&signals, &bias());
        }
        let still = Signals { bridges: [Some([0.0; 3]); SENSORS], ..Signals::default() };
        let last = (0..1000).map(|_| watch.update(&still, &bias())).last();
        assert_eq!(last, Some(0));
    }
}
