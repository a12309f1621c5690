//! The five systems of the papers: each turns a contact into light or strain.
//!
//! Values of `kind` in `[device]`, with their papers:
//!
//! - `taxel-4x4` ([DeMaria2011], [Ospina2017]): displaced facets ([`crate::fidelity`]) and, through
//!   [`plate`](crate::plate), four force sensors;
//! - `taxel-4x1` ([DeMaria2011]): displaced facets of the [`line`](taxel_papers::line_of_four);
//! - `mems-3axis` ([Ospina2017] ch. 1): the force on one sensor, under its
//!   [`coating`](crate::response::Coating);
//! - `mems-array` ([Ospina2017] ch. 2): four sensors under a [`plate`](crate::plate) that carries a
//!   curved [`surface`](crate::surface);
//! - `ohka-micro` ([Ohka2005]): a bright spot under a conical feeler, [`feeler`];
//! - `ohka-sheet` ([Ohka2005]): such spots under a [`sheet`](crate::sheet) of 10×12 feelers, one
//!   per scan;
//! - `ohka-column` ([Ohka2004]): contact areas of the cones under four columns, [`column`].
//!
//! The optical sensors of Ohka are inverses of their papers' own constitutive laws: from force to
//! brightness, shift and areas. The dark readings, the noise and the converter are the finger's,
//! because an estimator must reach its accuracy from codes.

pub mod column;
pub mod feeler;
pub mod matrix;

use taxel::scan::SENSORS;
use taxel_papers::column as columns;
use taxel_papers::feeler::slips;

use crate::load::{Contacts, Load};
use crate::plate::Wrench;
use crate::scene::{Device, Kind};
use crate::surface::Surface;

/// Contacts in the device's frame, at the places that the device has.
///
/// A feeler slips when it slides on its board.
#[must_use]
pub fn taken(device: &Device, contacts: Contacts) -> Contacts {
    let place: fn(&Device, Load) -> Load = match device.kind {
        Kind::MemsArray => |device, load| {
            let (_, normal) = device.surface.at(load.point);
            Load { force: Surface::turned(normal, load.force), ..load }
        },
        Kind::OhkaMicro => |_, load| Load { slip: slips(load.force), ..load },
        Kind::OhkaColumn => |_, load| {
            let column =
                columns::below(load.point).and_then(|at| columns::CENTRES.get(at).copied());
            Load { point: column.unwrap_or(load.point), ..load }
        },
        Kind::Taxel4x4 | Kind::Taxel4x1 | Kind::Mems3Axis | Kind::OhkaSheet => return contacts,
    };
    let mut taken = Contacts::default();
    contacts.loads().iter().for_each(|load| taken.push(place(device, *load)));
    taken
}

/// Forces on the four sensors under a plate, from contacts that [`taken`] has placed.
#[must_use]
pub fn shares(device: &Device, contacts: &Contacts) -> [[f64; 3]; SENSORS] {
    let mut shares = [[0.0; 3]; SENSORS];
    for load in contacts.loads() {
        let (place, normal) = match device.kind {
            Kind::MemsArray => device.surface.at(load.point),
            _ => Surface::Plane.at(load.point),
        };
        let carried = Wrench::at(place, load.force, load.torsion, normal).shares();
        let sums = shares.as_flattened_mut().iter_mut();
        sums.zip(carried.as_flattened()).for_each(|(sum, part)| *sum += part);
    }
    shares
}
