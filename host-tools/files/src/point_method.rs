//! Names of the ways to the contact point, as the command line and the files use them.

use taxel::estimate::contact_point::PointMethod;

const NAMES: [(&str, PointMethod); 3] = [
    ("centroid", PointMethod::Centroid),
    ("argmin", PointMethod::ArgMin),
    ("model", PointMethod::Model),
];

/// What it is called.
#[must_use]
pub fn name(method: PointMethod) -> &'static str {
    NAMES.iter().find(|(_, known)| *known == method).map_or("", |(name, _)| name)
}

/// What is called so.
#[must_use]
pub fn parse(name: &str) -> Option<PointMethod> {
    NAMES.iter().find(|(known, _)| *known == name).map(|(_, method)| *method)
}
