//! A section of the record, whatever is in it.

use serde::Serialize;

use super::Calibration;

/// Numbers beyond this are no calibration of a fingertip; it keeps every product finite.
pub(super) const HUGE: f32 = 1e30;

/// Names of a section's fields, each with what must hold for it. Positions are the wire's: append.
pub(super) type Checks<T> = &'static [(&'static str, fn(&T) -> bool)];

/// The coefficients of one estimator, as a section holds them.
pub(super) trait Coefficients: Default + Serialize + 'static {
    /// Its fields.
    const CHECKS: Checks<Self>;
    /// It works on the taxels' signals, which exist only with the taxels' own calibration.
    const NEEDS_TAXELS: bool = false;

    /// Reads it from all of `bytes`, in place, because postcard's way is over the stack; `None` where they
    /// are something else.
    fn read(&mut self, bytes: &[u8]) -> Option<()>;
}

/// A place in a section, read where it is.
pub(super) trait Part {
    /// Takes it from the front of `bytes`. Returns what follows it; `None` where that is something else.
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

/// Writes a section that is present; how long it has become.
pub(super) fn write<T: Coefficients>(section: &Option<T>, buffer: &mut [u8]) -> Option<usize> {
    Some(postcard::to_slice(section.as_ref()?, buffer).ok()?.len())
}

/// A line of the list of sections.
pub(super) struct Entry {
    /// Number in a record.
    pub number: u8,
    /// Version of the record that brought it.
    pub since: u16,
    /// Name in files and messages.
    pub name: &'static str,
    /// Where a calibration keeps it.
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

/// None of them is NaN, infinite, or large enough to make a product so.
#[inline(never)]
pub(super) fn finite(values: &[f32]) -> bool {
    // A comparison with a NaN is false.
    values.iter().all(|value| value.abs() < HUGE)
}
