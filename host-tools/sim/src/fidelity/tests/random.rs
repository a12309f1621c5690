//! Tests of `auto` on random scenes, at moments that `auto` did not choose.

use std::time::Duration;

use super::*;
use crate::cost::timed;
use crate::scene::Act;

/// Range of the duration in seconds of one half of the scenes; the others last seconds.
const LONG_S: [f64; 2] = [60.0, 3600.0];
/// One scene in this many has walls.
const WALLS: u64 = 20;

/// Random generator of scenes.
struct Draw(ChaCha8Rng);

impl Draw {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// Draws a number that is uniform in the logarithm.
    fn scale(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.0.random::<f64>())
    }

    fn indenter(&mut self, seed: u64) -> String {
        let axis = format!(
            "length_mm = {}\nturn_deg = {}",
            self.between(2.0, 6.0),
            self.between(-90.0, 90.0)
        );
        let kind = match seed % 7 {
            0 => format!("kind = 'sphere'\nradius_mm = {}", self.between(2.0, 15.0)),
            1 => format!("kind = 'punch'\nradius_mm = {}", self.between(0.5, 3.0)),
            2 => format!("kind = 'corner'\nslope = {}", self.between(0.2, 0.8)),
            3 => format!("kind = 'cylinder'\nradius_mm = {}\n{axis}", self.between(2.0, 15.0)),
            4 => format!("kind = 'block'\nwidth_mm = {}\n{axis}", self.between(0.5, 3.0)),
            5 => format!("kind = 'edge'\nslope = {}\n{axis}", self.between(0.2, 0.8)),
            _ => "kind = 'point'".to_owned(),
        };
        format!("[indenter]\n{kind}\n")
    }

    /// Draws an act of the given kind within `at` and `at + lasts`, with up to `force` newtons.
    fn act(&mut self, kind: u64, at: f64, lasts: f64, force: f64) -> String {
        let [x, y] = [self.between(-4.0, 4.0), self.between(-4.0, 4.0)];
        let [to_x, to_y] = [self.between(-4.0, 4.0), self.between(-4.0, 4.0)];
        let moves = format!("from_mm = [{x}, {y}]\nto_mm = [{to_x}, {to_y}]\nfz_n = {force}");
        let third = lasts / 3.0;
        let moving = format!("rise_s = {third}\ntravel_s = {third}\nfall_s = {third}\n");
        let held = format!("x_mm = {x}\ny_mm = {y}\nfz_n = {force}");
        let press = format!("rise_s = {third}\nhold_s = {third}\nfall_s = {third}\n");
        match kind {
            0 => {
                let [fx, fy] = [self.between(-1.0, 1.0) * force, self.between(-1.0, 1.0) * force];
                format!("[[press]]\nat_s = {at}\n{held}\nfx_n = {fx}\nfy_n = {fy}\n{press}")
            }
            1 => {
                let torsion = self.between(-3.0, 3.0) * force;
                format!("[[press]]\nat_s = {at}\n{held}\ntorsion_nmm = {torsion}\n{press}")
            }
            2 => {
                let width = self.scale(0.005, 0.1).min(lasts);
                let at = at + self.between(0.0, lasts - width);
                format!("[[tap]]\nat_s = {at}\n{held}\nwidth_s = {width}\n")
            }
            3 => format!("[[slide]]\nat_s = {at}\n{moves}\n{moving}"),
            4 => {
                let spring = "spring = { stiffness_n_mm = 0.5, mass_g = 20 }\n";
                format!("[[slide]]\nat_s = {at}\n{moves}\n{moving}{spring}")
            }
            5 => format!("[[roll]]\nat_s = {at}\n{moves}\n{moving}"),
            6 => {
                // Two contacts at once, as far from each other as the pad allows.
                let other = format!("x_mm = {}\ny_mm = {}\nfz_n = {}", 4.5, 4.5, 0.5 * force);
                format!(
                    "[[press]]\nat_s = {at}\nx_mm = -4.5\ny_mm = -4.5\nfz_n = {force}\n{press}[[tap]]\n\
                     at_s = {}\n{other}\nwidth_s = {}\n",
                    at + 0.4 * lasts,
                    (0.2 * lasts).min(0.1)
                )
            }
            _ => format!(
                "[[random]]\nat_s = {at}\npresses = 4\neach_s = {}\nx_mm = [{}, {x}]\n\
                 y_mm = [{}, {y}]\nfz_n = [{}, {force}]\nshear_of_limit = [0, 1]\nroll_mm = 1\n",
                lasts / 4.0,
                x - 0.9,
                y - 0.9,
                0.05 * force
            ),
        }
    }
}

/// Draws a scene of random device, indenter, geometry, material, temperature, tolerance, length and
/// acts.
fn random_scene(seed: u64) -> Scene {
    let mut draw = Draw(stream(seed, Purpose::Noise));
    let walls = seed.is_multiple_of(WALLS);
    let line = !walls && seed % 10 == 3;
    let tolerance = draw.scale(0.003, 0.03);
    let tolerance = if walls { tolerance.max(Layer::ERROR) } else { tolerance };
    let [young, poisson] = [draw.between(0.15, 1.0), draw.between(0.4, 0.5)];
    let [depth, facet] = [draw.between(1.5, 5.0), draw.between(1.0, if line { 4.0 } else { 2.4 })];
    let [young, poisson] =
        if walls { [crate::contact::SILICONE_YOUNG_MPA, 0.5] } else { [young, poisson] };
    let [depth, facet] = if walls { [2.5, 1.9] } else { [depth, facet] };
    let duration = if seed.is_multiple_of(2) { draw.scale(LONG_S[0], LONG_S[1]) } else { 4.0 };
    let mut effects = vec![];
    if walls {
        effects.push("'walls'");
    }
    let warms = seed % 4 == 1;
    if warms {
        effects.push("'temperature'");
    }
    let [start, end] = [draw.between(-10.0, 60.0), draw.between(-10.0, 60.0)];
    let kind = if line { "taxel-4x1" } else { "taxel-4x4" };
    let [mu, kinetic] = [draw.between(0.1, 1.5), draw.between(0.5, 1.0)];
    let indenter = draw.indenter(seed);
    let acts = 1 + seed % 3;
    let mut most = draw.between(0.1, 2.0);
    loop {
        let mut text = format!(
            "effects = [{}]\ntolerance = {tolerance}\n[scan]\nrate_hz = 1000\nduration_s = {duration}\n\
             [device]\nkind = '{kind}'\n[material]\nyoung_mpa = {young}\npoisson = {poisson}\n[layer]\n\
             depth_mm = {depth}\nfacet_mm = {facet}\n[temperature]\nstart_c = {start}\nend_c = {end}\n\
             [friction]\nmu = {mu}\nmu_kinetic = {}\n{indenter}",
            effects.join(", "),
            mu * kinetic
        );
        for act in 0..acts {
            let each = duration / acts as f64;
            let lasts = draw.scale(0.05, 1.0).min(0.9 * each);
            let at = act as f64 * each + draw.between(0.0, 0.95 * each - lasts);
            let force = draw.between(0.3, 1.0) * most;
            text.push_str(&draw.act((seed / 7 + act) % 8, at, lasts, force));
        }
        match Scene::parse("random.toml", &text) {
            Ok(scene) => return scene,
            // The force is too much for a soft or thin pad, or for two contacts near each other.
            Err(error) => {
                assert!(most > 1e-4, "{error}");
                most *= 0.5;
            }
        }
    }
}

/// Random moments: `each` of every act, and as many of the whole run.
fn moments(scene: &Scene, seed: u64, each: usize) -> Vec<f64> {
    let mut draw = Draw(stream(seed, Purpose::Reference));
    let spans = scene.acts().iter().map(|act: &Act| [act.at_s(), act.end_s()]).collect::<Vec<_>>();
    let run = [[0.0, scene.scan.duration_s]];
    let spans = spans.into_iter().chain(run);
    spans
        .flat_map(|[from, to]| (0..each).map(|_| draw.between(from, to)).collect::<Vec<_>>())
        .collect()
}

/// Shortest of several times, because other work disturbs the rest.
fn quickest(work: impl Fn() -> [f64; TAXELS]) -> Duration {
    (0..7).map(|_| timed(|| core::hint::black_box(work())).1).min().unwrap_or_default()
}

/// Tests on many scenes.
mod endurance {
    use super::*;

    #[test]
    fn auto_keeps_tolerance_on_200_random_scenes() {
        let silicone = HalfSpace::new(crate::contact::SILICONE_YOUNG_MPA, 0.5);
        let framed = Support::Framed(Arc::new(Layer::new(silicone, 2.5, 1.9)));
        let (mut savings, mut faster) = (vec![], vec![]);
        let mut touched = [0; 2];
        for seed in 0..200 {
            let scene = random_scene(seed);
            let walls = scene.has_walls();
            let ladder = if walls {
                Ladder::on(&scene, seed, silicone, framed.clone())
            } else {
                Ladder::new(&scene, seed)
            };
            let report = *ladder.report();
            let times = moments(&scene, seed, if walls { 8 } else { 50 });
            let found = worst(&ladder, &scene, seed, times.iter().copied());
            assert!(found <= report.tolerance, "scene {seed}: {found}, {report}");
            savings.push(report.top_evaluations as f64 / report.evaluations as f64);
            let mut path = Path::new(&scene, seed);
            let contacts: Vec<Contacts> = times.iter().map(|time| path.at(*time)).collect();
            let contacts = contacts.iter().filter(|at| !at.is_empty());
            touched[(seed % 2) as usize] += contacts.clone().count();
            let [chosen, top] = [report.rung, report.top].map(|rung| {
                let took = contacts.clone().take(2).map(|at| quickest(|| ladder.on_rung(rung, at)));
                took.sum::<Duration>().as_secs_f64()
            });
            faster.push(top / chosen);
        }
        assert!(touched.iter().all(|frames| *frames > 5000), "{touched:?}");
        let [saved, faster] = [savings, faster].map(|mut ratios| {
            ratios.sort_by(f64::total_cmp);
            0.5 * (ratios[99] + ratios[100])
        });
        assert!(saved >= 20.0, "{saved}");
        // Evaluations, which are the same on every machine, stand for time.
        assert!(faster > 0.7 * saved, "{faster} times as fast for {saved} times less");
    }
}
