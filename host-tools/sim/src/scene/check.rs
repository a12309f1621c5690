//! Checks of a scene that need several of its values.

use toml::Spanned;

use super::read::Problem;
use super::{Effect, Fidelity, Kind, Layer, Scene, acts, device, limits, trials};
use crate::contact::layer;

impl Scene {
    /// Checks that the values fit together and fit the device.
    pub(super) fn check(&self) -> Result<(), Problem> {
        self.check_scan()?;
        self.check_bench()?;
        for fault in &self.fault {
            fault.times()?;
            fault.broken(&self.device)?;
        }
        if let Some(kinetic) = &self.friction.mu_kinetic {
            kinetic
                .get_ref()
                .within(0.0, self.friction.mu)
                .map_err(|problem| (kinetic.span(), format!("{problem}, which is `mu`")))?;
        }
        if let Some(tolerance) = &self.tolerance {
            let [low, high] = Self::TOLERANCES;
            tolerance.get_ref().within(low, high).map_err(|problem| (tolerance.span(), problem))?;
        }
        self.indenter.indenter()?;
        device::check(self)?;
        self.check_walls()?;
        acts::check(self)?;
        trials::check(self)?;
        limits::check(self)
    }

    /// Checks that the steps fit into a frame, and the conversions of a reading into a step.
    fn check_scan(&self) -> Result<(), Problem> {
        let (rate, step) = (self.rate_hz(), self.scan.step_us());
        let period = 1_000_000 / rate;
        if 5 * step > period {
            let (longest, fastest) = (period / 5, 1_000_000 / (5 * step));
            let mend = match (longest, fastest) {
                (0, _) => format!("allowed is `rate_hz` up to {fastest}"),
                (_, 0) => format!("allowed is `step_us` up to {longest}"),
                _ => format!("allowed are `rate_hz` up to {fastest} or `step_us` up to {longest}"),
            };
            let problem = format!(
                "a frame lasts {period} µs at {rate} Hz but its five steps of `step_us` {step} µs last \
                 {} µs; {mend}",
                5 * step
            );
            return Err((self.scan.rate_hz.span(), problem));
        }
        let sampled = self.sampling_us();
        if sampled < f64::from(step) {
            return Ok(());
        }
        let problem = format!(
            "{} conversions of a reading last {sampled} µs, but its step `step_us` {step} µs; take fewer \
             conversions (`oversampling`, or 12 `bits`) or a longer step",
            self.oversampling()
        );
        let given = self.electronics.oversampling.as_ref().map(Spanned::span);
        Err((given.unwrap_or_else(|| self.scan.step_us.span()), problem))
    }

    fn check_bench(&self) -> Result<(), Problem> {
        let (Some(bench), Some(sensor)) = (&self.bench, self.bench_sensor()) else { return Ok(()) };
        let there = self.device.sensors();
        if there.get(sensor) == Some(&true) {
            return Ok(());
        }
        let all = there.iter().enumerate().filter(|(_, there)| **there);
        let names = all.map(|(sensor, _)| sensor.to_string()).collect::<Vec<_>>().join(", ");
        let allowed = if names.is_empty() { "none: it has no sensors" } else { &names };
        Err((
            bench.sensor.span(),
            format!("the device has no sensor {sensor}; allowed are {allowed}"),
        ))
    }

    /// Checks the ranges for which the framed layer holds.
    fn check_walls(&self) -> Result<(), Problem> {
        let listed = self.effects.iter().find(|effect| *effect.get_ref() == Effect::Walls);
        let named = self.fidelity.as_ref().filter(|f| *f.get_ref() == Fidelity::Layer);
        let Some(at) = listed.map(Spanned::span).or(named.map(Spanned::span)) else {
            return Ok(());
        };
        if self.device.kind != Kind::Taxel4x4 {
            let problem = "the layer is that of the 4×4 finger; leave `fidelity` out";
            return Err((at, problem.into()));
        }
        let Layer { depth_mm, facet_mm, .. } = self.layer;
        for (key, value, [low, high]) in [
            ("depth_mm", depth_mm, layer::Layer::THICKNESS_MM),
            ("facet_mm", facet_mm, layer::Layer::FACET_MM),
            ("poisson", self.material.poisson, layer::Layer::POISSON),
        ] {
            if !(low..=high).contains(&value) {
                let problem = format!(
                    "walls with `{key}` {value}; allowed are {low} to {high}, for which the layer's error is \
                     known: change `{key}` or leave the walls out"
                );
                return Err((at, problem));
            }
        }
        let least = layer::Layer::ERROR;
        match &self.tolerance {
            Some(given) if self.fidelity() == Fidelity::Auto && self.tolerance() < least => {
                let problem = format!(
                    "{} is below the error of the layer with walls; allowed are {least} to 0.5",
                    self.tolerance()
                );
                Err((given.span(), problem))
            }
            _ => Ok(()),
        }
    }
}
