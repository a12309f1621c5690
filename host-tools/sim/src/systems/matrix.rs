//! Light on the sixteen lit phototransistors, for each of the optical systems.

use taxel::scan::{COLS, TAXELS};

use super::column::Columns;
use super::feeler::{Feeler, Spot};
use crate::fidelity::{Ladder, Report};
use crate::load::Contacts;
use crate::optics::{self, Missing, Optics};
use crate::scene::{Kind, REFERENCE_C, Scene, softness};
use crate::skin::Skin;

/// Optical matrix of one run.
#[derive(Clone, Debug)]
pub struct Matrix {
    /// Offsets of the columns' amplifiers.
    offsets: [f64; COLS],
    target: Target,
}

#[derive(Clone, Debug)]
enum Target {
    Facets(Box<Facets>),
    Feeler(Feeler),
    Columns(Columns),
}

/// White facets under the skin, each with its LED.
#[derive(Clone, Debug)]
struct Facets {
    /// `None` on the bench, where nothing touches the skin.
    contact: Option<Ladder>,
    /// `None` where the skin is linear: no effect changes Hooke's law.
    skin: Option<Skin>,
    optics: Optics,
    /// Light of the unloaded pairs.
    unloaded: [f64; TAXELS],
    /// Displacement of the facets in the last frame, in mm.
    displacement: [f64; TAXELS],
    /// Number of taxels that exist.
    present: usize,
}

impl Matrix {
    /// Creates the matrix of the scene's device; `None` without phototransistors.
    #[must_use]
    pub fn new(scene: &Scene, seed: u64) -> Option<Self> {
        let present = scene.device.rows() * COLS;
        if present == 0 {
            return None;
        }
        let optics = Optics::new(scene);
        let offsets = optics.offsets();
        let target = match scene.device.kind {
            Kind::OhkaMicro | Kind::OhkaSheet => Target::Feeler(Feeler::new(scene)),
            Kind::OhkaColumn => Target::Columns(Columns::new(scene)),
            _ => {
                let contact = scene.bench_sensor().is_none().then(|| Ladder::new(scene, seed));
                let unloaded = optics.reflected(&[0.0; TAXELS], absent(present));
                let displacement = [0.0; TAXELS];
                let skin = Skin::of(scene);
                Target::Facets(Box::new(Facets {
                    contact,
                    skin,
                    optics,
                    unloaded,
                    displacement,
                    present,
                }))
            }
        };
        Some(Self { offsets, target })
    }

    /// Reading of the columns in the dark, without light, `warmer_k` above the reference.
    #[must_use]
    pub fn leakage(&self, warmer_k: f64) -> [f64; COLS] {
        let dark = optics::dark_current(warmer_k);
        self.offsets.map(|offset| offset + dark)
    }

    /// Fidelity report of the contact; `None` where no facets are displaced.
    #[must_use]
    pub fn fidelity(&self) -> Option<&Report> {
        match &self.target {
            Target::Facets(facets) => facets.contact.as_ref().map(Ladder::report),
            Target::Feeler(_) | Target::Columns(_) => None,
        }
    }

    /// Light of each taxel on its column while its row is lit.
    ///
    /// The value holds at a nominal supply and with LEDs at their reference temperature; the skin
    /// is `warmer_k` above its own. Where one light serves all taxels, a missing LED acts as a
    /// missing phototransistor.
    pub fn light(&mut self, contacts: &Contacts, missing: Missing, warmer_k: f64) -> [f64; TAXELS] {
        let light = match &mut self.target {
            Target::Facets(facets) => return facets.light(contacts, missing, warmer_k),
            Target::Feeler(feeler) => {
                let force = contacts.whole().map_or([0.0; 3], |load| load.force);
                feeler.light(&Spot::under(force))
            }
            Target::Columns(columns) => columns.light(contacts.loads()),
        };
        optics::without(&light, missing.leds | missing.phototransistors)
    }

    /// Displacement of the facets in the last frame, in mm; `None` without facets.
    #[must_use]
    pub fn displacement(&self) -> Option<&[f64; TAXELS]> {
        match &self.target {
            Target::Facets(facets) => Some(&facets.displacement),
            Target::Feeler(_) | Target::Columns(_) => None,
        }
    }

    /// Which facets were nearer than the peak of their pair's light curve in the last frame.
    #[must_use]
    pub fn wrong_side(&self) -> [bool; TAXELS] {
        match &self.target {
            Target::Facets(facets) => {
                facets.optics.gaps(&facets.displacement).map(Optics::wrong_side)
            }
            Target::Feeler(_) | Target::Columns(_) => [false; TAXELS],
        }
    }
}

impl Facets {
    fn light(&mut self, contacts: &Contacts, missing: Missing, warmer_k: f64) -> [f64; TAXELS] {
        let touched = self.contact.as_ref().filter(|_| !contacts.is_empty());
        let celsius = REFERENCE_C + warmer_k;
        // A stiffer skin is displaced as by a smaller load: less, and on a smaller area.
        let worked = self.skin.as_ref().map_or(1.0, Skin::softness);
        let borne = contacts.scaled(softness(celsius) * worked);
        self.displacement = touched.map_or([0.0; TAXELS], |contact| contact.displacement(&borne));
        if let Some(skin) = &mut self.skin {
            let elastic = self.displacement.map(|u| u / worked);
            self.displacement = skin.displace(elastic, celsius);
        }
        if touched.is_none() && self.skin.is_none() && missing == Missing::default() {
            return self.unloaded;
        }
        let Missing { leds, phototransistors } = absent(self.present);
        let missing = Missing {
            leds: missing.leds | leds,
            phototransistors: missing.phototransistors | phototransistors,
        };
        self.optics.reflected(&self.displacement, missing)
    }
}

/// Taxels that do not exist.
fn absent(present: usize) -> Missing {
    let bits = (0..TAXELS).skip(present).fold(0, |bits, k| bits | 1 << k);
    Missing { leds: bits, phototransistors: bits }
}
