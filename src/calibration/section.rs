//! Traits of a section of the record, independent of its content.

use serde::Serialize;

use super::Calibration;

/// Upper limit of a number in a calibration, which keeps every product finite.
pub(super) const HUGE: f32 = 1e30;

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

/// An optional section of a calibration.
pub(super) trait Section {
    fn present(&self) -> bool;
    fn clear(&mut self);
    fn read(&mut self, bytes: &[u8]) -> Option<()>;
    fn wrong_field(&self) -> Option<u8>;
    fn field_name(&self, field: u8) -> Option<&'static str>;
    fn needs_taxels(&self) -> bool;
}

impl<T: Coefficients> Section for Option<T> {
    fn present(&self) -> bool {
        self.is_some()
    }

    fn clear(&mut self) {
        *self = None;
    }

    fn read(&mut self, bytes: &[u8]) -> Option<()> {
        self.insert(T::default()).read(bytes)
    }

    fn wrong_field(&self) -> Option<u8> {
        let coefficients = self.as_ref()?;
        let wrong = T::CHECKS.iter().position(|(_, holds)| !holds(coefficients))?;
        u8::try_from(wrong).ok()
    }

    fn field_name(&self, field: u8) -> Option<&'static str> {
        T::CHECKS.get(usize::from(field)).map(|(name, _)| *name)
    }

    fn needs_taxels(&self) -> bool {
        T::NEEDS_TAXELS
    }
}

/// Writes a present section and returns its length; `None` if it is absent or too long.
pub(super) fn write<T: Coefficients>(section: &Option<T>, buffer: &mut [u8]) -> Option<usize> {
    Some(postcard::to_slice(section.as_ref()?, buffer).ok()?.len())
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

/// Checks that no value is NaN, infinite, or large enough to make a product infinite.
#[inline(never)]
pub(super) fn finite(values: &[f32]) -> bool {
    // A comparison with a NaN is false.
    values.iter().all(|value| value.abs() < HUGE)
}
