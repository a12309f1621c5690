//! Effects of rubber beyond Hooke's law: from elastic to real displacement of a facet.
//!
//! - `temperature`: the stiffness of a rubber grows with its absolute temperature (Treloar, *The
//!   Physics of Rubber Elasticity*); forces displace facets accordingly less. Its viscosity falls
//!   as that of silicone fluids does.
//! - `stiffening`: the column of skin above a facet, as thick as the skin, follows [DeMaria2011]'s
//!   Mooney–Rivlin law instead of the tangent to it.
//! - `hysteresis`: the first loading is stiffer than all later ones up to the same load
//!   ([DeMaria2011] fig. 3).
//! - `creep`: a facet goes on to move under a load that stays, and back when it has gone.
//! - `skin-response`: facets follow with a delay, and relax, as a coating of [Ospina2017] does.

use taxel::scan::TAXELS;

use crate::response::Response;
use crate::scene::{Effect, REFERENCE_C, Scene, ZERO_C};

/// Ratio α2 to α1 of [DeMaria2011] eq. (1).
const MOONEY_RIVLIN: f64 = -3.37e-4 / 3.96e-2;
/// Activation energy of the flow of silicone fluids in J/mol; [DeMaria2011] measures none of its
/// rubber.
const FLOW: f64 = 15e3;
/// Gas constant in J/(mol K).
const GAS: f64 = 8.314;

/// Shift factor of the skin's flow: speed at `celsius` over speed at the reference temperature.
#[must_use]
pub fn haste(celsius: f64) -> f64 {
    (FLOW / GAS * (1.0 / (REFERENCE_C + ZERO_C) - 1.0 / (celsius + ZERO_C))).exp()
}

/// Shortening 1 − λ of a column under the stress that shortens it by `strain` at its stiffness at
/// rest.
///
/// σ = 2(λ − 1/λ²)(α1 + α2/λ) = −6(α1 + α2)·strain ([DeMaria2011] eq. (1), nominal stress).
#[must_use]
pub fn shortening(strain: f64) -> f64 {
    let pushed = 3.0 * (1.0 + MOONEY_RIVLIN) * strain;
    // Start on the side of the root from which Newton's method converges directly, because σ is
    // concave in λ.
    let mut stretch = if strain > 0.0 { 1.0 / (1.0 + pushed).sqrt() } else { 1.0 };
    for _ in 0..8 {
        let inverse = 1.0 / stretch;
        let (shape, law) = (stretch - inverse * inverse, 1.0 + MOONEY_RIVLIN * inverse);
        let slope = (1.0 + 2.0 * inverse.powi(3)) * law - shape * MOONEY_RIVLIN * inverse * inverse;
        let next = stretch - (shape * law + pushed) / slope;
        if next == stretch {
            break;
        }
        stretch = next;
    }
    1.0 - stretch
}

/// Skin of one run, with the memory of its effects.
#[derive(Clone, Debug)]
pub struct Skin {
    /// Thickness in mm; `None` without stiffening.
    stiffens: Option<f64>,
    first_cycle: Option<FirstCycle>,
    follows: Option<Follows>,
    creep: Option<Creep>,
    /// Displacement of the last frame over that by Hooke's law.
    softness: f64,
}

impl Skin {
    /// Creates the skin of the scene; `None` where no effect changes Hooke's law.
    #[must_use]
    pub fn of(scene: &Scene) -> Option<Self> {
        let skin = Self {
            stiffens: scene.has(Effect::Stiffening).then_some(scene.layer.depth_mm),
            first_cycle: scene
                .has(Effect::Hysteresis)
                .then(|| FirstCycle::new(scene.material.first_cycle_ratio)),
            follows: scene.has(Effect::SkinResponse).then(|| Follows::new(scene)),
            creep: scene.has(Effect::Creep).then(|| Creep::new(scene)),
            softness: 1.0,
        };
        let listed = skin.stiffens.is_some()
            || skin.first_cycle.is_some()
            || skin.follows.is_some()
            || skin.creep.is_some();
        listed.then_some(skin)
    }

    /// Share of a load that makes an elastic contact as small, and as deep, as a skin so stiff does.
    ///
    /// The contact's area depends on force over stiffness, as the displacements do (Johnson §4.2).
    /// The stiffness is that of the last frame, which hardly changes from frame to frame.
    #[must_use]
    pub fn softness(&self) -> f64 {
        self.softness
    }

    /// Displacement of the facets in mm, one frame later, for the displacement `elastic` by Hooke's
    /// law.
    #[must_use]
    pub fn displace(&mut self, elastic: [f64; TAXELS], celsius: f64) -> [f64; TAXELS] {
        let mut displacement = elastic;
        if let Some(thickness) = self.stiffens {
            displacement = displacement.map(|u| thickness * shortening(u / thickness));
        }
        if let Some(first_cycle) = &mut self.first_cycle {
            displacement = first_cycle.displace(displacement);
        }
        self.softness = share(&displacement, &elastic);
        if let Some(creep) = &mut self.creep {
            displacement = creep.displace(displacement);
        }
        match &mut self.follows {
            Some(follows) => follows.displace(displacement, celsius),
            None => displacement,
        }
    }
}

/// Factor of `whole`, in mm, that comes closest to `part`; 1 where it is less than a nanometre.
fn share(part: &[f64; TAXELS], whole: &[f64; TAXELS]) -> f64 {
    const NANOMETRE: f64 = 1e-6;
    let dot = |a: &[f64; TAXELS]| a.iter().zip(whole).map(|(a, b)| a * b).sum::<f64>();
    let squares = dot(whole);
    if squares > NANOMETRE * NANOMETRE { dot(part) / squares } else { 1.0 }
}

/// Softening by the largest load so far, after Mullins.
///
/// A facet whose largest displacement is m moves to u(1 − D|u|/m) under the load that moves a
/// worked-in one to u. Beyond m it moves to u(1 − D). The first loading is therefore a straight
/// line, stiffer by 1/(1 − D). Unloading and all later loadings follow a curve that meets the line
/// at m and starts as soft as a worked-in skin.
#[derive(Clone, Debug)]
struct FirstCycle {
    ratio: f64,
    most: [f64; TAXELS],
}

impl FirstCycle {
    fn new(ratio: f64) -> Self {
        Self { ratio, most: [0.0; TAXELS] }
    }

    fn displace(&mut self, mut displacement: [f64; TAXELS]) -> [f64; TAXELS] {
        for (u, most) in displacement.iter_mut().zip(&mut self.most) {
            *most = most.max(u.abs());
            if *most > 0.0 {
                *u *= 1.0 - self.ratio * u.abs() / *most;
            }
        }
        displacement
    }
}

/// Slow part of the displacement, one time constant.
#[derive(Clone, Debug)]
struct Creep {
    /// Share of a difference that one frame makes up.
    share: f64,
    crept: [f64; TAXELS],
}

impl Creep {
    /// Displacement that creep adds in the end, as a share; an assumption for soft silicone.
    const ADDS: f64 = 0.03;
    /// Time constant in seconds; an assumption.
    const AFTER_S: f64 = 20.0;

    fn new(scene: &Scene) -> Self {
        let share = -(-1.0 / (Self::AFTER_S * f64::from(scene.rate_hz()))).exp_m1();
        Self { share, crept: [0.0; TAXELS] }
    }

    fn displace(&mut self, mut displacement: [f64; TAXELS]) -> [f64; TAXELS] {
        for (u, crept) in displacement.iter_mut().zip(&mut self.crept) {
            *crept += (Self::ADDS * *u - *crept) * self.share;
            *u += *crept;
        }
        displacement
    }
}

/// Delay that shortens with temperature.
#[derive(Clone, Debug)]
struct Follows {
    response: Response<TAXELS>,
    period: f64,
    /// Temperature in °C for which the response is set.
    celsius: f64,
}

impl Follows {
    fn new(scene: &Scene) -> Self {
        let period = 1.0 / f64::from(scene.rate_hz());
        let response = Response::new(scene.material.follows, period);
        Self { response, period, celsius: REFERENCE_C }
    }

    fn displace(&mut self, displacement: [f64; TAXELS], celsius: f64) -> [f64; TAXELS] {
        /// Change in kelvin that changes the shift factor by 0.2 %.
        const STEP: f64 = 0.1;
        if (celsius - self.celsius).abs() > STEP {
            self.celsius = celsius;
            self.response.set_period(self.period * haste(celsius));
        }
        self.response.follow(displacement)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn creep_adds_its_share_and_goes_back() {
        let text = "effects = ['creep']\n[scan]\nrate_hz = 100\nduration_s = 1\n";
        let mut skin = Skin::of(&Scene::parse("test.toml", text).unwrap()).unwrap();
        let mut after = |load: f64, frames: usize| {
            (0..frames).map(|_| skin.displace([load; TAXELS], 25.0)[0]).last().unwrap()
        };
        assert!((after(0.2, 1) / 0.2 - 1.0).abs() < 1e-4);
        // 63 % of 3 % after 20 s, all of it in the end.
        assert!((after(0.2, 1999) / 0.2 - 1.0 - 0.03 * 0.632).abs() < 1e-4);
        assert!((after(0.2, 30_000) / 0.2 - 1.03).abs() < 1e-4);
        assert!(after(0.0, 30_000).abs() < 1e-6);
    }
    use proptest::prelude::*;

    fn skin(effects: &str) -> Skin {
        let text = format!("effects = [{effects}]\n[scan]\nrate_hz = 1000\nduration_s = 1\n");
        Skin::of(&Scene::parse("test.toml", &text).unwrap()).unwrap()
    }

    /// Displacement of facet 0 alone.
    fn displace(skin: &mut Skin, u: f64) -> f64 {
        let mut elastic = [0.0; TAXELS];
        elastic[0] = u;
        skin.displace(elastic, REFERENCE_C)[0]
    }

    #[test]
    fn column_follows_mooney_rivlin() {
        // [DeMaria2011] eq. (1) as printed, in MPa; E = 6(α1 + α2).
        let (a1, a2) = (3.96e-2, -3.37e-4);
        for stretch in [0.4, 0.6, 0.8, 0.95, 1.0, 1.05, 1.3, 2.0f64] {
            let stress = 2.0 * (stretch - 1.0 / (stretch * stretch)) * (a1 + a2 / stretch);
            let strain = -stress / (6.0 * (a1 + a2));
            assert!((shortening(strain) - (1.0 - stretch)).abs() < 1e-9, "{stretch}");
        }
    }

    #[test]
    fn stiffening_starts_at_large_loads() {
        let mut skin = skin("'stiffening'");
        assert!((displace(&mut skin, 1e-4) / 1e-4 - 1.0).abs() < 1e-4);
        // 2.5 mm thick, under a load for 0.5 mm.
        let ratio = displace(&mut skin, 0.5) / 0.5;
        assert!((0.82..0.83).contains(&ratio), "{ratio}");
    }

    #[test]
    fn first_loading_is_stiffer_later_loops_close() {
        let mut skin = skin("'hysteresis'");
        let ramp: Vec<f64> = (0..=100).map(|i| f64::from(i) * 0.005).collect();
        let mut run = |up: bool| -> Vec<f64> {
            let mut loads = ramp.clone();
            if !up {
                loads.reverse();
            }
            let mut displacement: Vec<f64> =
                loads.into_iter().map(|u| displace(&mut skin, u)).collect();
            if !up {
                displacement.reverse();
            }
            displacement
        };
        let [first, back, again, back_again] = [true, false, true, false].map(&mut run);
        for i in 1..100 {
            assert!((first[i] / ramp[i] - 0.9).abs() < 1e-12, "a tenth stiffer");
            assert!(back[i] > first[i], "the way back is softer");
        }
        assert_eq!(back, again);
        assert_eq!(again, back_again);
        assert!((first[100] - back[100]).abs() < 1e-12, "without a jump at the turn");
    }

    #[test]
    fn first_cycle_is_kept_per_taxel() {
        let mut skin = skin("'hysteresis'");
        let _ = displace(&mut skin, 0.5);
        let after = skin.displace([0.1; TAXELS], REFERENCE_C);
        assert!(after[0] > 0.097 && after[1..].iter().all(|u| (u - 0.09).abs() < 1e-12));
        // A load above the largest so far is a first loading again.
        assert!((displace(&mut skin, 0.8) - 0.72).abs() < 1e-12);
    }

    #[test]
    fn skin_settles_faster_when_warm() {
        let frames = |celsius: f64| {
            let mut skin = skin("'skin-response'");
            (1..).find(|_| skin.displace([1.0; TAXELS], celsius)[5] > 0.95).unwrap()
        };
        assert_eq!(frames(REFERENCE_C), 11);
        assert!((15..30).contains(&frames(-10.0)) && frames(60.0) < 9, "{}", frames(-10.0));
    }

    #[test]
    fn warm_rubber_is_stiffer() {
        use crate::scene::softness;
        assert_eq!(softness(REFERENCE_C), 1.0);
        assert!((softness(55.0) - 298.15 / 328.15).abs() < 1e-12);
    }

    #[test]
    fn skin_is_none_without_skin_effects() {
        let text =
            "effects = ['temperature', 'response']\n[scan]\nrate_hz = 1000\nduration_s = 1\n";
        assert!(Skin::of(&Scene::parse("test.toml", text).unwrap()).is_none());
    }

    proptest! {
        #[test]
        fn displacement_grows_with_load_after_any_load(
            before in 0.0..1.0f64, load in -0.5..1.0f64, more in 0.001..0.5f64,
        ) {
            let mut skin = skin("'stiffening', 'hysteresis'");
            let _ = displace(&mut skin, before);
            prop_assert!(displace(&mut skin.clone(), load + more) > displace(&mut skin, load));
        }
    }
}
