//! A scene, frame by frame.

use taxel::scan::{COLS, Codes, Midpoints, SENSORS, Scan, TAXELS, TaxelCodes};
use taxel::units::{Code, FullScale, Micros};
use taxel_formats::trace::{Sample, Truth};

use crate::adc::Adc;
use crate::bridge::{self, Bridge};
use crate::fidelity::{Ladder, Report};
use crate::optics::Optics;
use crate::path::{Load, Path};
use crate::response::Response;
use crate::scene::{Effect, Scene};

/// The reference channel reads half of the converter's range.
const REFERENCE: f64 = 0.5;

/// One run of a scene: an iterator over its frames.
#[derive(Clone, Debug)]
pub struct Simulator {
    path: Path,
    contact: Option<Ladder>,
    optics: Option<Optics>,
    bridges: [Option<Bridge>; SENSORS],
    response: Option<Box<[Response; SENSORS]>>,
    bench: Option<usize>,
    adc: Adc,
    /// Light of the unloaded pairs.
    unloaded: [f64; TAXELS],
    rate_hz: u64,
    step_us: f64,
    frames: u64,
    endless: bool,
    next: u64,
}

impl Simulator {
    /// A run of `scene`. Noise, lamps and random presses follow from `seed`; the device's own
    /// imperfections follow from the scene.
    #[must_use]
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let optics = scene.device.taxels.then(|| Optics::new(scene, seed));
        let on_skin = optics.is_some() && scene.bench.is_none();
        let mut bridges = Bridge::of(scene).map(Some);
        for (bridge, there) in bridges.iter_mut().zip(scene.device.bridges) {
            *bridge = bridge.take().filter(|_| there);
        }
        Self {
            path: Path::new(scene, seed),
            contact: on_skin.then(|| Ladder::new(scene, seed)),
            unloaded: optics.as_ref().map_or([0.0; TAXELS], |o| o.reflected(&[0.0; TAXELS])),
            optics,
            bridges,
            response: scene.has(Effect::Response).then(|| Box::new(responses(scene))),
            bench: scene.bench.as_ref().map(|bench| *bench.sensor.get_ref()),
            adc: Adc::new(scene, seed),
            rate_hz: u64::from(scene.rate_hz()),
            step_us: f64::from(scene.scan.step_us),
            frames: scene.frames(),
            endless: false,
            next: 0,
        }
    }

    /// Begins again when the scene is over, for ever; device time runs on, and noise does not repeat.
    #[must_use]
    pub fn endless(mut self) -> Self {
        self.endless = true;
        self
    }

    /// What the codes are fractions of.
    #[must_use]
    pub fn full_scale(&self) -> FullScale {
        self.adc.full_scale()
    }

    /// How finely contact is computed and what error that leaves; `None` where no facet sinks, on the
    /// bench or without the matrix.
    #[must_use]
    pub fn fidelity(&self) -> Option<&Report> {
        self.contact.as_ref().map(Ladder::report)
    }

    fn taxels(&mut self, load: Option<&Load>, time_us: f64) -> Option<TaxelCodes> {
        let optics = self.optics.as_ref()?;
        let light = match (load, &self.contact) {
            (Some(load), Some(contact)) => optics.reflected(&contact.displacement(load)),
            _ => self.unloaded,
        };
        let adc = &mut self.adc;
        let dark = optics.dark(time_us).map(|dark| adc.light(dark));
        let mut codes = TaxelCodes { dark, ..TaxelCodes::default() };
        let mut time_us = time_us;
        for (lit, light) in codes.lit.iter_mut().zip(light.chunks_exact(COLS)) {
            time_us += self.step_us;
            for ((code, light), dark) in lit.iter_mut().zip(light).zip(optics.dark(time_us)) {
                *code = adc.light(light + dark);
            }
        }
        Some(codes)
    }

    /// The four sensors' shares of a load.
    fn shares(&self, load: Option<&Load>) -> [[f64; 3]; SENSORS] {
        let Some(load) = load else { return [[0.0; 3]; SENSORS] };
        let Some(sensor) = self.bench else { return bridge::shares(load.point, load.force) };
        let mut shares = [[0.0; 3]; SENSORS];
        if let Some(share) = shares.get_mut(sensor) {
            *share = load.force;
        }
        shares
    }

    /// What of their shares the sensors have felt by now.
    fn felt(&mut self, mut shares: [[f64; 3]; SENSORS]) -> [[f64; 3]; SENSORS] {
        if let Some(responses) = &mut self.response {
            for (share, response) in shares.iter_mut().zip(responses.iter_mut()) {
                *share = response.follow(*share);
            }
        }
        shares
    }

    fn midpoints(&mut self, shares: &[[f64; 3]; SENSORS]) -> [Option<Midpoints>; SENSORS] {
        let adc = &mut self.adc;
        let mut midpoints = [None; SENSORS];
        for ((midpoints, bridge), share) in midpoints.iter_mut().zip(&self.bridges).zip(shares) {
            *midpoints = bridge.as_ref().map(|bridge| {
                let [a, b, c, d]: [Code; 4] = bridge.midpoints(*share).map(|v| adc.voltage(v));
                Midpoints { a, b, c, d }
            });
        }
        midpoints
    }

    fn truth(&self, load: Option<&Load>, shares: &[[f64; 3]; SENSORS]) -> Truth {
        let mut sensors = [[None; 3]; SENSORS];
        for ((truth, share), bridge) in sensors.iter_mut().zip(shares).zip(&self.bridges) {
            if bridge.is_some() {
                *truth = share.map(Some);
            }
        }
        Truth {
            force: load.map_or([0.0; 3], |load| load.force).map(Some),
            // On the bench nothing touches the skin, so there is no contact point.
            point: load
                .filter(|_| self.bench.is_none())
                .map_or([None; 2], |load| load.point.map(Some)),
            // Hertz traction has no moment about the normal of the contact.
            torsion: Some(0.0),
            contact: Some(load.is_some()),
            slip: Some(load.is_some_and(|load| load.slip)),
            sensors,
        }
    }
}

fn responses(scene: &Scene) -> [Response; SENSORS] {
    let period = 1.0 / f64::from(scene.rate_hz());
    core::array::from_fn(|_| Response::new(scene.device.coating, period))
}

impl Iterator for Simulator {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        if self.next >= self.frames && !self.endless {
            return None;
        }
        let time_us = self.next * 1_000_000 / self.rate_hz;
        let load = self.path.at((self.next % self.frames) as f64 / self.rate_hz as f64);
        self.next += 1;
        let on_skin = load.filter(|_| self.bench.is_none());
        let shares = self.shares(load.as_ref());
        let felt = self.felt(shares);
        let codes = Codes {
            full_scale: self.adc.full_scale(),
            taxels: self.taxels(on_skin.as_ref(), time_us as f64),
            bridges: self.midpoints(&felt),
            reference: Some(self.adc.voltage(REFERENCE)),
            temperature: None,
        };
        let scan = Scan { time: Micros(time_us), overrun: false, codes };
        Some(Sample { scan, truth: self.truth(load.as_ref(), &shares) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::BUILT_IN;

    fn run(name: &str, seed: u64) -> Vec<Sample> {
        Simulator::new(&Scene::load(name).unwrap(), seed).collect()
    }

    /// Lit less dark of each taxel, in 16-bit codes.
    fn levels(sample: &Sample) -> [f64; TAXELS] {
        let codes = sample.scan.codes.taxels.unwrap();
        std::array::from_fn(|k| {
            f64::from(codes.lit[k / 4][k % 4].0) - f64::from(codes.dark[k % 4].0)
        })
    }

    #[test]
    fn the_same_scene_and_seed_give_the_same_frames_and_another_seed_does_not() {
        assert_eq!(run("press", 5), run("press", 5));
        assert_ne!(run("press", 5), run("press", 6));
    }

    #[test]
    fn every_built_in_scene_runs_to_its_end_within_range() {
        for (name, _) in BUILT_IN {
            let scene = Scene::load(name).unwrap();
            let mut last = None;
            let mut frames = 0;
            for sample in Simulator::new(&scene, 1) {
                assert!(last < Some(sample.scan.time), "{name}: time runs");
                last = Some(sample.scan.time);
                frames += 1;
                let codes = sample.scan.codes;
                let taxels = codes.taxels.unwrap();
                let lit = taxels.lit.as_flattened();
                assert!(lit.iter().all(|c| c.0 > 3000 && !codes.full_scale.clips(*c)), "{name}");
                for m in codes.bridges.iter().flatten() {
                    let intact = |c: Code| (0.25..0.75).contains(&codes.full_scale.ratio(c).0);
                    assert!([m.a, m.b, m.c, m.d].into_iter().all(intact), "{name}");
                }
            }
            assert_eq!(frames, scene.frames(), "{name}");
        }
    }

    #[test]
    fn an_endless_run_repeats_the_path_but_not_the_clock_or_the_noise() {
        let scene = Scene::load("press").unwrap();
        let once = scene.frames() as usize;
        let samples: Vec<Sample> = Simulator::new(&scene, 1).endless().take(2 * once).collect();
        let (first, second) = (samples[once / 2], samples[once / 2 + once]);
        assert_eq!(first.truth, second.truth);
        assert!(second.scan.time > first.scan.time);
        assert_ne!(first.scan.codes, second.scan.codes);
    }

    #[test]
    fn the_brightest_rise_is_under_the_contact() {
        let samples = run("presses", 2);
        let rest = levels(&samples[0]);
        let hard = |s: &&Sample| s.truth.force[2] > Some(0.5);
        for sample in samples.iter().filter(hard).step_by(97) {
            let now = levels(sample);
            let [Some(x), Some(y)] = sample.truth.point else { panic!("contact has a point") };
            let rise = |k: usize| now[k] / rest[k];
            let brightest = (0..TAXELS).max_by(|a, b| rise(*a).total_cmp(&rise(*b))).unwrap();
            let centre = taxel::scan::TAXEL_CENTRES[brightest];
            let away = (x - f64::from(centre[0].0)).hypot(y - f64::from(centre[1].0));
            assert!(away < 2.5, "{away} mm");
        }
    }

    #[test]
    fn the_truth_of_the_sensors_sums_to_the_force() {
        for sample in run("shear", 1).iter().step_by(101) {
            for axis in 0..3 {
                let sum: f64 = sample.truth.sensors.iter().filter_map(|s| s[axis]).sum();
                assert!((sum - sample.truth.force[axis].unwrap()).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn on_the_bench_only_its_sensor_feels_the_force() {
        let samples = run("bench-s0", 1);
        let rest = levels(&samples[0]);
        let most = |i: usize| {
            let near = |s: &Sample| s.truth.sensors[i][2].unwrap();
            samples.iter().map(near).fold(0.0f64, f64::max)
        };
        assert!(most(0) > 0.5);
        assert_eq!([most(1), most(2), most(3)], [0.0; 3]);
        for sample in samples.iter().step_by(53) {
            assert_eq!(sample.truth.sensors[0], sample.truth.force);
            assert!(levels(sample).iter().zip(rest).all(|(now, rest)| (now - rest).abs() < 100.0));
        }
    }

    #[test]
    fn sensors_lag_the_truth_only_where_the_scene_lists_it() {
        let run = |effects: &str| -> Vec<Sample> {
            let text = format!(
                "effects = [{effects}]\n[scan]\nrate_hz = 1000\nduration_s = 1\n[device]\n\
                 coating = 'rB'\n[[press]]\nat_s = 0.1\nx_mm = 0\ny_mm = 0\nfz_n = 1\n\
                 rise_s = 0.01\nhold_s = 0.5\nfall_s = 0.01\n"
            );
            Simulator::new(&Scene::parse("test.toml", &text).unwrap(), 1).collect()
        };
        let (at_once, lagging) = (run(""), run("'response'"));
        let level = |samples: &[Sample], i: usize| samples[i].scan.codes.bridges[0].unwrap().a.0;
        assert_eq!(level(&at_once, 112), level(&at_once, 300));
        assert_ne!(level(&lagging, 112), level(&at_once, 112));
        assert_eq!(level(&lagging, 300), level(&at_once, 300));
        assert_eq!(lagging[112].truth, at_once[112].truth);
    }

    #[test]
    fn a_sensor_that_is_not_there_has_neither_codes_nor_truth() {
        let scene = Scene::parse(
            "test.toml",
            "[scan]\nrate_hz = 1000\nduration_s = 1\n[device]\ntaxels = false\n\
             bridges = [true, false, true, true]\n",
        );
        let sample = Simulator::new(&scene.unwrap(), 1).next().unwrap();
        assert_eq!(sample.scan.codes.taxels, None);
        assert!(sample.scan.codes.bridges[1].is_none() && sample.scan.codes.bridges[2].is_some());
        assert_eq!(sample.truth.sensors[1], [None; 3]);
    }
}
