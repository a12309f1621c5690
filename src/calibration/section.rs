//! Traits of a section of the record, independent of its content.

use serde::Serialize;

use super::Calibration;
use crate::estimate::net::ForceNet;
use crate::estimate::quantised::Net;
#[cfg(feature = "quantised")]
use crate::estimate::quantised::QuantisedNet;

/// Numbers of the matrix's section, of the two of a net, and of the first sensor's.
pub(super) const TAXELS: u8 = 1;
pub(super) const FLOAT: u8 = 2;
pub(super) const QUANTISED: u8 = 5;
pub(super) const SENSORS: u8 = 16;

/// Names of a section's fields, each with its check. Positions are those of the wire: append only.
pub(super) type Checks<T> = &'static [(&'static str, fn(&T) -> bool)];

/// Coefficients of one estimator, as stored in a section.
pub(super) trait Coefficients: Default + Serialize + 'static {
    /// Fields and their checks.
    const CHECKS: Checks<Self>;
    /// Whether it works on the taxels' signals, which need the section of the taxels.
    const NEEDS_TAXELS: bool = false;

    /// Reads the section from all of `bytes`, or returns `None` if they are something else. The
    /// section is read in place, because postcard's deserializer needs the stack.
    fn read(&mut self, bytes: &[u8]) -> Option<()>;
}

/// Value within a section that is read in place.
pub(super) trait Part {
    /// Reads the value from the front of `bytes` and returns the rest. Returns `None` if the bytes
    /// do not fit.
    fn read<'b>(&mut self, bytes: &'b [u8]) -> Option<&'b [u8]>;
}

/// An optional section of a calibration. A number chooses between sections that share a place.
pub(super) trait Section {
    fn present(&self, number: u8) -> bool;
    fn clear(&mut self);
    fn read(&mut self, number: u8, bytes: &[u8]) -> Option<()>;
    fn wrong_field(&self, number: u8) -> Option<u8>;
    fn field_name(&self, number: u8, field: u8) -> Option<&'static str>;
    fn needs_taxels(&self) -> bool;
}

impl<T: Coefficients> Section for Option<T> {
    fn present(&self, _: u8) -> bool {
        self.is_some()
    }

    fn clear(&mut self) {
        *self = None;
    }

    fn read(&mut self, _: u8, bytes: &[u8]) -> Option<()> {
        self.insert(T::default()).read(bytes)
    }

    fn wrong_field(&self, _: u8) -> Option<u8> {
        wrong_field(self.as_ref()?)
    }

    fn field_name(&self, _: u8, field: u8) -> Option<&'static str> {
        field_name::<T>(field)
    }

    fn needs_taxels(&self) -> bool {
        T::NEEDS_TAXELS
    }
}

/// The net's two sections, of which a calibration holds one.
impl Section for Option<Net> {
    fn present(&self, number: u8) -> bool {
        match self {
            Some(Net::Float(_)) => number == FLOAT,
            #[cfg(feature = "quantised")]
            Some(Net::Quantised(_)) => number == QUANTISED,
            None => false,
        }
    }

    fn clear(&mut self) {
        *self = None;
    }

    /// Reads the net. The net in f32 comes first in a record; the one in 16 bits is then skipped.
    fn read(&mut self, number: u8, bytes: &[u8]) -> Option<()> {
        if self.is_some() {
            return Some(());
        }
        // Each is made where it stays, because a value that is chosen first would be copied.
        match number {
            #[cfg(feature = "quantised")]
            QUANTISED => *self = Some(Net::Quantised(QuantisedNet::default())),
            _ => *self = Some(Net::Float(ForceNet::default())),
        }
        match self.as_mut()? {
            Net::Float(net) => net.read(bytes),
            #[cfg(feature = "quantised")]
            Net::Quantised(net) => net.read(bytes),
        }
    }

    fn wrong_field(&self, number: u8) -> Option<u8> {
        match self.as_ref().filter(|_| self.present(number))? {
            Net::Float(net) => wrong_field(net),
            #[cfg(feature = "quantised")]
            Net::Quantised(net) => wrong_field(net),
        }
    }

    fn field_name(&self, number: u8, field: u8) -> Option<&'static str> {
        match number {
            #[cfg(feature = "quantised")]
            QUANTISED => field_name::<QuantisedNet>(field),
            _ => field_name::<ForceNet>(field),
        }
    }

    fn needs_taxels(&self) -> bool {
        ForceNet::NEEDS_TAXELS
    }
}

fn wrong_field<T: Coefficients>(coefficients: &T) -> Option<u8> {
    let wrong = T::CHECKS.iter().position(|(_, holds)| !holds(coefficients))?;
    u8::try_from(wrong).ok()
}

fn field_name<T: Coefficients>(field: u8) -> Option<&'static str> {
    T::CHECKS.get(usize::from(field)).map(|(name, _)| *name)
}

/// Writes a section and returns its length; `None` if it is too long.
pub(super) fn write<T: Coefficients>(section: &T, buffer: &mut [u8]) -> Option<usize> {
    Some(postcard::to_slice(section, buffer).ok()?.len())
}

/// Entry of the list of sections.
pub(super) struct Entry {
    /// Number in a record.
    pub number: u8,
    /// Version of the record that introduced it.
    pub since: u16,
    /// Name in files and messages.
    pub name: &'static str,
    /// Accessor of the section in a calibration.
    pub get: fn(&Calibration) -> &dyn Section,
    pub get_mut: fn(&mut Calibration) -> &mut dyn Section,
}

pub(super) const fn entry(
    number: u8,
    since: u16,
    name: &'static str,
    get: fn(&Calibration) -> &dyn Section,
    get_mut: fn(&mut Calibration) -> &mut dyn Section,
) -> Entry {
    Entry { number, since, name, get, get_mut }
}

/// Checks that no value is NaN or larger than `most`.
#[inline(never)]
pub(super) fn bounded(values: &[f32], most: f32) -> bool {
    // A comparison with a NaN is false.
    values.iter().all(|value| value.abs() <= most)
}
