//! Names of the contact-point methods on the command line and in files.

use taxel::estimate::contact_point::PointMethod;

const NAMES: [(&str, PointMethod); 3] = [
    ("centroid", PointMethod::Centroid),
    ("argmin", PointMethod::ArgMin),
    ("model", PointMethod::Model),
];

/// Returns the name of a method.
#[must_use]
pub fn name(method: PointMethod) -> &'static str {
    NAMES.iter().find(|(_, known)| *known == method).map_or("", |(name, _)| name)
}

/// Returns the method of a name.
#[must_use]
pub fn parse(name: &str) -> Option<PointMethod> {
    NAMES.iter().find(|(known, _)| *known == name).map(|(_, method)| *method)
}
