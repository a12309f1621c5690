//! Amplitude spectrum of one channel.

use std::collections::VecDeque;
use std::sync::Arc;

use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

/// Samples in a spectrum: 2 s at 1 kHz, 0.5 s at 4 kHz.
pub(crate) const LENGTH: usize = 2048;

/// Last [`LENGTH`] samples of a channel without a gap.
pub(crate) struct Spectrum {
    samples: VecDeque<f32>,
    times: VecDeque<u64>,
    sequence: Option<u64>,
    fft: Arc<dyn Fft<f32>>,
}

impl Default for Spectrum {
    fn default() -> Self {
        Self {
            samples: VecDeque::new(),
            times: VecDeque::new(),
            sequence: None,
            fft: FftPlanner::new().plan_fft_forward(LENGTH),
        }
    }
}

impl Spectrum {
    /// Discards all samples, for example for another channel.
    pub(crate) fn clear(&mut self) {
        self.samples.clear();
        self.times.clear();
    }

    /// Adds a sample; a missing frame or value discards all earlier ones.
    pub(crate) fn push(&mut self, sequence: u64, time_us: u64, value: Option<f32>) {
        let follows = self.sequence.is_none_or(|last| sequence == last.wrapping_add(1));
        self.sequence = Some(sequence);
        if !follows || value.is_none() {
            self.clear();
        }
        let Some(value) = value else { return };
        if self.samples.len() == LENGTH {
            self.samples.pop_front();
            self.times.pop_front();
        }
        self.samples.push_back(value);
        self.times.push_back(time_us);
    }

    /// Share of the spectrum's samples collected, 0 to 1.
    pub(crate) fn filled(&self) -> f32 {
        self.samples.len() as f32 / LENGTH as f32
    }

    /// Returns the step between lines in hertz, and each line's amplitude up to half the rate.
    /// Amplitudes are in the channel's unit: a sine of amplitude 1 has a line of 1. The mean is
    /// subtracted, and a Hann window applied.
    pub(crate) fn lines(&self) -> Option<(f64, Vec<f32>)> {
        let (first, last) = (self.times.front()?, self.times.back()?);
        if self.samples.len() < LENGTH || last <= first {
            return None;
        }
        let rate = (LENGTH - 1) as f64 * 1e6 / (last - first) as f64;
        let mean = self.samples.iter().map(|v| f64::from(*v)).sum::<f64>() / LENGTH as f64;
        let step = std::f32::consts::TAU / LENGTH as f32;
        let windowed = self.samples.iter().enumerate().map(|(i, value)| {
            let hann = 0.5 - 0.5 * (step * i as f32).cos();
            Complex::new((value - mean as f32) * hann, 0.0)
        });
        let mut line: Vec<_> = windowed.collect();
        self.fft.process(&mut line);
        // Half the energy of a sine lies at negative frequencies, and Hann's window halves it
        // again.
        let scale = 4.0 / LENGTH as f32;
        Some((rate / LENGTH as f64, line[..LENGTH / 2].iter().map(|c| c.norm() * scale).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sine(hz: f64, amplitude: f64, rate: u64) -> Spectrum {
        let mut spectrum = Spectrum::default();
        for i in 0..3000 {
            let time = i * 1_000_000 / rate;
            let phase = std::f64::consts::TAU * hz * i as f64 / rate as f64;
            spectrum.push(i, time, Some((5.0 + amplitude * phase.sin()) as f32));
        }
        spectrum
    }

    #[test]
    fn sine_has_its_amplitude_at_its_frequency() {
        let (step, lines) = sine(125.0, 0.25, 1000).lines().unwrap();
        assert!((step - 1000.0 / 2048.0).abs() < 1e-6);
        let peak = (125.0 / step).round() as usize;
        assert!((lines[peak] - 0.25).abs() < 0.001, "{}", lines[peak]);
        assert!(lines.iter().enumerate().all(|(i, line)| i.abs_diff(peak) < 4 || *line < 1e-4));
    }

    #[test]
    fn missing_frame_or_value_restarts_spectrum() {
        let mut spectrum = sine(50.0, 1.0, 1000);
        spectrum.push(3001, 3_001_000, Some(0.0));
        assert_eq!(spectrum.samples.len(), 1);
        spectrum.push(3002, 3_002_000, None);
        assert!(spectrum.lines().is_none() && spectrum.filled() == 0.0);
    }
}
