//! Simulator: runs a scene frame by frame.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use taxel::scan::{COLS, Codes, Midpoints, SENSORS, Scan, TAXELS, TaxelCodes};
use taxel::units::{Code, FullScale, Micros};
use taxel_files::trace::{Sample, TraceHeader, Truth};
use taxel_papers::sheet::FEELERS;

use crate::adc::Adc;
use crate::bridge::{Bridge, Surroundings};
use crate::electronics::Columns;
use crate::faults::Faults;
use crate::fidelity::Report;
use crate::light::Room;
use crate::load::{Contacts, Load};
use crate::optics;
use crate::path::Path;
use crate::response::Response;
use crate::scene::{Device, Effect, Kind, REFERENCE_C, Scene, Temperature};
use crate::seeds::{Purpose, stream};
use crate::sheet::Sheet;
use crate::supply::Supply;
use crate::systems;
use crate::systems::matrix::Matrix;

/// Level of the reference channel: a separate voltage, half of the converter's range at nominal
/// supply.
const REFERENCE: f64 = 0.5;

/// Reading of the STM32G431's thermometer: 0.76 V at 30 °C and 2.5 mV/K (its data sheet), of 3.3 V.
fn thermometer(celsius: f64) -> f64 {
    (0.76 + 2.5e-3 * (celsius - 30.0)) / 3.3
}

/// One run of a scene: an iterator over its frames.
#[derive(Clone, Debug)]
pub struct Simulator {
    path: Path,
    device: Device,
    matrix: Option<Matrix>,
    room: Room,
    supply: Supply,
    temperature: Option<Temperature>,
    sheet: Option<Sheet>,
    faults: Faults,
    columns: Columns,
    bridges: [Option<Bridge>; SENSORS],
    response: Option<Box<[Response<3>; SENSORS]>>,
    bench: Option<usize>,
    reference: Option<Reference>,
    bench_error: Option<BenchError>,
    heats: bool,
    adc: Adc,
    rate_hz: u64,
    step_us: f64,
    frames: u64,
    endless: bool,
    next: u64,
}

impl Simulator {
    /// Creates a run of `scene`.
    ///
    /// Noise, lamps and random presses follow from `seed`; the device's own imperfections follow
    /// from the scene.
    #[must_use]
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let matrix = Matrix::new(scene, seed);
        let room = Room::new(scene, seed);
        let warmer_k = scene.temperature().map_or(0.0, |t| t.at(0.0) - REFERENCE_C);
        let leakage = matrix.as_ref().map_or([0.0; COLS], |matrix| matrix.leakage(warmer_k));
        let dark = leakage.map(|leakage| leakage + room.at(0.0, 0.0));
        let mut bridges = Bridge::of(scene).map(Some);
        for (bridge, there) in bridges.iter_mut().zip(scene.device.sensors()) {
            *bridge = bridge.take().filter(|_| there);
        }
        Self {
            path: Path::new(scene, seed),
            device: scene.device.clone(),
            matrix,
            room,
            supply: Supply::new(scene),
            temperature: scene.temperature(),
            sheet: (scene.device.kind == Kind::OhkaSheet).then(|| scene.sheet()),
            faults: Faults::of(scene),
            columns: Columns::new(scene, dark),
            bridges,
            response: scene.has(Effect::Response).then(|| Box::new(responses(scene))),
            bench: scene.bench_sensor(),
            reference: Reference::of(scene, seed),
            bench_error: scene.has(Effect::BenchError).then(|| BenchError::new(seed)),
            heats: scene.has(Effect::SelfHeating),
            adc: Adc::new(scene, seed),
            rate_hz: u64::from(scene.rate_hz()),
            step_us: f64::from(scene.scan.step_us()),
            frames: scene.frames(),
            endless: false,
            next: 0,
        }
    }

    /// Repeats the scene without end; device time continues, and noise does not repeat.
    #[must_use]
    pub fn endless(mut self) -> Self {
        self.endless = true;
        self
    }

    /// Full scale of the codes.
    #[must_use]
    pub fn full_scale(&self) -> FullScale {
        self.adc.full_scale()
    }

    /// Columns of the simulator's trace, with or without those of the truth.
    #[must_use]
    pub fn trace_header(&self, truth: bool) -> TraceHeader {
        TraceHeader {
            full_scale: self.full_scale(),
            rows: self.device.rows(),
            bridges: self.device.sensors(),
            reference: true,
            temperature: self.temperature.is_some(),
            truth,
            sensor_truth: truth,
        }
    }

    /// Fidelity of the contact model, with the error that remains.
    ///
    /// `None` where no facet is displaced: on the bench or without the matrix.
    #[must_use]
    pub fn fidelity(&self) -> Option<&Report> {
        self.matrix.as_ref().and_then(Matrix::fidelity)
    }

    fn taxels(&mut self, contacts: &Contacts, now: &Moment) -> Option<TaxelCodes> {
        let matrix = self.matrix.as_mut()?;
        let light = matrix.light(contacts, self.faults.missing(), now.warmer_k);
        let leakage = matrix.leakage(now.warmer_k);
        let dip = self.faults.supply();
        let open = self.faults.ambient_shares();
        let mut codes = TaxelCodes::default();
        let steps = [&mut codes.dark].into_iter().chain(&mut codes.lit);
        let rows = [&[0.0; COLS][..]].into_iter().chain(light.chunks_exact(COLS));
        for (step, (codes, row)) in steps.zip(rows).enumerate() {
            let later = step as f64 * self.step_us;
            let room = self.room.at(now.device_us + later, now.scene_us + later);
            let supply = self.supply.at(now.device_us + later, dip);
            let mut level = leakage;
            for ((level, led), share) in level.iter_mut().zip(row).zip(open) {
                let seen = room * share + led * supply.leds * now.leds;
                *level = (*level + seen) * supply.fixed;
            }
            if step == 0 {
                self.columns.pause(&level);
            }
            let mut level = self.columns.step(level);
            self.faults.columns(&mut level);
            for (code, level) in codes.iter_mut().zip(level) {
                *code = self.adc.light(level);
            }
        }
        Some(codes)
    }

    /// Which facets were nearer than the peak of their pair's light curve in the last frame.
    #[must_use]
    pub fn wrong_side(&self) -> [bool; TAXELS] {
        self.matrix.as_ref().map_or([false; TAXELS], Matrix::wrong_side)
    }

    /// Displacement of the facets in the last frame, in mm; `None` without facets.
    #[must_use]
    pub fn displacement(&self) -> Option<&[f64; TAXELS]> {
        self.matrix.as_ref().and_then(Matrix::displacement)
    }

    /// Forces on the four sensors in newtons, from the contacts.
    fn shares(&self, contacts: &Contacts) -> [[f64; 3]; SENSORS] {
        let Some(sensor) = self.bench else { return systems::shares(&self.device, contacts) };
        let mut shares = [[0.0; 3]; SENSORS];
        if let (Some(share), Some(load)) = (shares.get_mut(sensor), contacts.whole()) {
            *share = load.force;
        }
        shares
    }

    /// Forces that the sensors report, after their response.
    fn sensed(&mut self, mut shares: [[f64; 3]; SENSORS]) -> [[f64; 3]; SENSORS] {
        if let Some(responses) = &mut self.response {
            for (share, response) in shares.iter_mut().zip(responses.iter_mut()) {
                *share = response.follow(*share);
            }
        }
        shares
    }

    fn midpoints(
        &mut self,
        shares: &[[f64; 3]; SENSORS],
        now: &Moment,
    ) -> [Option<Midpoints>; SENSORS] {
        let dip = self.faults.supply();
        let mut midpoints = [None; SENSORS];
        let sensors = midpoints.iter_mut().zip(&self.bridges).zip(shares);
        for (sensor, ((midpoints, bridge), share)) in sensors.enumerate() {
            let Some(bridge) = bridge else { continue };
            let broken_arms = self.faults.arms(sensor);
            let around = Surroundings { warmer_k: now.warmer_k, broken_arms };
            // Sensor i is read together with row i, after the dark step.
            let later = (sensor + 1) as f64 * self.step_us;
            let supply = self.supply.at(now.device_us + later, dip);
            let mut levels = bridge.midpoints(*share, around).map(|v| v * supply.share);
            self.faults.midpoints(sensor, &mut levels);
            let [a, b, c, d]: [Code; 4] = levels.map(|v| self.adc.voltage(v));
            *midpoints = Some(Midpoints { a, b, c, d });
        }
        midpoints
    }

    fn truth(&mut self, load: Option<&Load>, shares: &[[f64; 3]; SENSORS]) -> Truth {
        let mut sensors = [[None; 3]; SENSORS];
        for ((truth, share), bridge) in sensors.iter_mut().zip(shares).zip(&self.bridges) {
            if bridge.is_some() {
                *truth = share.map(Some);
            }
        }
        let mut force = load.map_or([0.0; 3], |load| load.force).map(Some);
        if let (Some(reference), Some(sensor)) = (&mut self.reference, self.bench) {
            force = reference.read(force);
            if let Some(truth) = sensors.get_mut(sensor) {
                *truth = force;
            }
        }
        // No contact point: on the bench nothing touches the skin, and a feeler has no position in
        // it.
        let placed = self.bench.is_none() && self.device.kind != Kind::OhkaMicro;
        let mut point = load.filter(|_| placed).map_or([None; 2], |load| load.point.map(Some));
        if let Some(error) = &mut self.bench_error {
            (force, point) = error.read(force, point);
        }
        Truth {
            force,
            point,
            point_sigma: None,
            torsion: Some(load.map_or(0.0, |load| load.torsion)),
            contact: Some(load.is_some()),
            slip: Some(load.is_some_and(|load| load.slip)),
            sensors,
        }
    }
}

/// Load cell of a bench, with an error of its own.
#[derive(Clone, Debug)]
struct Reference {
    rng: ChaCha8Rng,
    sigma: f64,
}

impl Reference {
    /// Creates the load cell if the scene's bench has an imperfect one.
    fn of(scene: &Scene, seed: u64) -> Option<Self> {
        let sigma = scene.bench.as_ref().map_or(0.0, |bench| bench.reference_n);
        (sigma > 0.0).then(|| Self { rng: stream(seed, Purpose::Reference), sigma })
    }

    /// Adds the error to `force`; [Ospina2017]'s reaches 24.85 mN with a standard deviation of 6.07
    /// mN (§1.3.4).
    fn read(&mut self, force: [Option<f64>; 3]) -> [Option<f64>; 3] {
        const WORST: f64 = 24.85 / 6.07;
        force.map(|force| {
            let unit: f64 = StandardNormal.sample(&mut self.rng);
            force.map(|force| force + self.sigma * unit.clamp(-WORST, WORST))
        })
    }
}

/// Errors of a calibration bench, in the truth of the finger.
#[derive(Clone, Debug)]
struct BenchError {
    rng: ChaCha8Rng,
    /// Error of the place of this contact in mm; `None` without contact.
    away: Option<[f64; 2]>,
}

impl BenchError {
    /// Noise of each component of the load cell in newtons, [Ospina2017]'s.
    const FORCE_N: f64 = 0.006;
    /// Error of the place of a contact in mm, one standard deviation each way; an assumption.
    const PLACE_MM: f64 = 0.05;

    fn new(seed: u64) -> Self {
        Self { rng: stream(seed, Purpose::BenchError), away: None }
    }

    fn read(
        &mut self,
        force: [Option<f64>; 3],
        point: [Option<f64>; 2],
    ) -> ([Option<f64>; 3], [Option<f64>; 2]) {
        let rng = &mut self.rng;
        let mut draw = |sigma: f64| -> f64 {
            let unit: f64 = StandardNormal.sample(rng);
            sigma * unit
        };
        let force = force.map(|force| force.map(|force| force + draw(Self::FORCE_N)));
        if point.iter().all(Option::is_none) {
            self.away = None;
            return (force, point);
        }
        let [x, y] = *self.away.get_or_insert_with(|| [0; 2].map(|_| draw(Self::PLACE_MM)));
        let [at_x, at_y] = point;
        (force, [at_x.map(|at| at + x), at_y.map(|at| at + y)])
    }
}

/// Times and temperature effects of one frame.
#[derive(Clone, Copy, Debug)]
struct Moment {
    device_us: f64,
    scene_us: f64,
    /// Kelvin above the reference temperature.
    warmer_k: f64,
    /// Light of an LED relative to the reference temperature.
    leds: f64,
}

fn responses(scene: &Scene) -> [Response<3>; SENSORS] {
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
        let scene_s = (self.next % self.frames) as f64 / self.rate_hz as f64;
        let mut contacts = systems::taken(&self.device, self.path.at(scene_s));
        if let Some(sheet) = &self.sheet {
            contacts = sheet.seen((self.next % FEELERS as u64) as usize, &contacts);
        }
        let load = contacts.whole();
        self.next += 1;
        let celsius = self.temperature.map(|temperature| temperature.at(scene_s));
        let warmer_k = celsius.map_or(0.0, |celsius| celsius - REFERENCE_C);
        let own_k = if self.heats { optics::own_heat(time_us as f64 * 1e-6) } else { 0.0 };
        let now = Moment {
            device_us: time_us as f64,
            scene_us: scene_s * 1e6,
            warmer_k,
            leds: optics::warm_led(warmer_k + own_k),
        };
        self.faults.advance(now.scene_us);
        let shares = self.shares(&contacts);
        let sensed = self.sensed(shares);
        let fixed = self.supply.at(now.device_us, self.faults.supply()).fixed;
        let mut codes = Codes {
            full_scale: self.adc.full_scale(),
            taxels: self.taxels(&contacts, &now),
            bridges: self.midpoints(&sensed, &now),
            reference: Some(self.adc.voltage(REFERENCE * fixed)),
            temperature: celsius.map(|celsius| self.adc.voltage(thermometer(celsius) * fixed)),
        };
        self.faults.stick(&mut codes);
        let scan = Scan { time: Micros(time_us), lost: 0, codes };
        Some(Sample { scan, truth: self.truth(load.as_ref(), &shares) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::SILICONE_YOUNG_MPA;

    fn run(name: &str, seed: u64) -> Vec<Sample> {
        Simulator::new(&Scene::load(name).unwrap(), seed).collect()
    }

    /// Lit minus dark of each taxel, in 16-bit codes.
    fn levels(sample: &Sample) -> [f64; TAXELS] {
        let codes = sample.scan.codes.taxels.unwrap();
        std::array::from_fn(|k| {
            f64::from(codes.lit[k / 4][k % 4].0) - f64::from(codes.dark[k % 4].0)
        })
    }

    #[test]
    fn endless_run_repeats_path_not_noise() {
        let scene = Scene::load("press").unwrap();
        let once = scene.frames() as usize;
        let samples: Vec<Sample> = Simulator::new(&scene, 1).endless().take(2 * once).collect();
        let (first, second) = (samples[once / 2], samples[once / 2 + once]);
        assert_eq!(first.truth, second.truth);
        assert!(second.scan.time > first.scan.time);
        assert_ne!(first.scan.codes, second.scan.codes);
    }

    #[test]
    fn largest_light_rise_is_under_the_contact() {
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
    fn sensor_truths_sum_to_the_force() {
        for sample in run("shear", 1).iter().step_by(101) {
            for axis in 0..3 {
                let sum: f64 = sample.truth.sensors.iter().filter_map(|s| s[axis]).sum();
                assert!((sum - sample.truth.force[axis].unwrap()).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn bench_force_reaches_only_its_sensor() {
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
    fn sensors_lag_the_truth_only_when_listed() {
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
    fn skin_effects_change_light_when_listed() {
        let of = |effects: &str, young: f64| -> Vec<f64> {
            let text = format!(
                "effects = [{effects}]\n[scan]\nrate_hz = 1000\nduration_s = 1\n[material]\n\
                 young_mpa = {young}\n[temperature]\nstart_c = 55\nend_c = 55\n[[press]]\nat_s = 0.1\nx_mm = -1\ny_mm = -1\nfz_n = 1\n\
                 rise_s = 0.01\nhold_s = 0.5\nfall_s = 0.01\n"
            );
            let scene = Scene::parse("test.toml", &text).unwrap();
            let mut run = Simulator::new(&scene, 1);
            let displacement =
                core::iter::from_fn(|| run.next().map(|_| run.displacement().unwrap()[5]));
            displacement.collect()
        };
        let run = |effects: &str| of(effects, SILICONE_YOUNG_MPA);
        let elastic = run("");
        let stiff = run("'stiffening'");
        let first = run("'hysteresis'");
        let slow = run("'skin-response'");
        let warm = run("'temperature'");
        // During the hold, so at rest.
        assert!(stiff[500] < 0.9 * elastic[500], "{} of {}", stiff[500], elastic[500]);
        // The area of the contact too is that of a skin as stiff.
        let stiffer = of("", SILICONE_YOUNG_MPA / 0.9);
        assert!((first[500] / stiffer[500] - 1.0).abs() < 1e-9, "{} {}", first[500], stiffer[500]);
        assert!((first[500] / elastic[500] - 0.9).abs() > 1e-3);
        assert!((slow[500] / elastic[500] - 1.0).abs() < 1e-6 && slow[111] < 0.9 * elastic[111]);
        assert!((0.9..0.99).contains(&(warm[500] / elastic[500])));
        assert!(elastic[621] == 0.0 && slow[621] > 0.1 * elastic[500], "it comes up slowly");
    }

    #[test]
    fn twist_appears_in_truth_and_sensors() {
        let text = "[scan]\nrate_hz = 1000\nduration_s = 1\n[[press]]\nat_s = 0.1\nx_mm = 0\ny_mm = 0\n\
                    fz_n = 1\ntorsion_nmm = 0.5\nrise_s = 0.1\nhold_s = 0.5\nfall_s = 0.1\n";
        let scene = Scene::parse("test.toml", text).unwrap();
        let sample = Simulator::new(&scene, 1).nth(450).unwrap();
        assert!((sample.truth.torsion.unwrap() - 0.5).abs() < 1e-12);
        // 0.5 N mm over four levers: sensor 0 at (−5, −5) is pushed to +x and −y.
        assert!((sample.truth.sensors[0][0].unwrap() - 0.5 * 5.0 / 200.0).abs() < 1e-12);
        assert!((sample.truth.sensors[0][1].unwrap() + 0.5 * 5.0 / 200.0).abs() < 1e-12);
    }

    #[test]
    fn absent_sensor_has_no_codes_and_no_truth() {
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
