//! Tables of a scene that make contact.

use serde::Deserialize;

use crate::ranges;

/// `[[press]]`: normal force first, shear while it is held, then release.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Press {
    /// Beginning in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    pub at_s: f64,
    /// Contact point in mm.
    #[serde(deserialize_with = "ranges::on_pad")]
    pub x_mm: f64,
    /// Contact point in mm.
    #[serde(deserialize_with = "ranges::on_pad")]
    pub y_mm: f64,
    /// Normal force in newtons.
    #[serde(deserialize_with = "ranges::normal")]
    pub fz_n: f64,
    /// Requested shear in newtons; friction may allow less.
    #[serde(default, deserialize_with = "ranges::tangential")]
    pub fx_n: f64,
    /// Requested shear in newtons; friction may allow less.
    #[serde(default, deserialize_with = "ranges::tangential")]
    pub fy_n: f64,
    /// Time to full normal force in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub rise_s: f64,
    /// Time at full normal force in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub hold_s: f64,
    /// Time of release in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub fall_s: f64,
}

/// `[[slide]]`: press down, stick, slip along a line, stick, release.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Slide {
    /// Beginning in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    pub at_s: f64,
    /// Where it comes down, in mm.
    #[serde(deserialize_with = "ranges::point_on_pad")]
    pub from_mm: [f64; 2],
    /// Where it leaves, in mm.
    #[serde(deserialize_with = "ranges::point_on_pad")]
    pub to_mm: [f64; 2],
    /// Normal force in newtons.
    #[serde(deserialize_with = "ranges::normal")]
    pub fz_n: f64,
    /// Time to full normal force in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub rise_s: f64,
    /// Time of being dragged in seconds: a tenth until it breaks loose, a tenth while it is eased.
    #[serde(deserialize_with = "ranges::seconds")]
    pub travel_s: f64,
    /// Time of release in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub fall_s: f64,
}

/// `[[random]]`: presses drawn from ranges, new ones for every seed of a run.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Random {
    /// Beginning in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    pub at_s: f64,
    /// How many.
    pub presses: u32,
    /// Time of each in seconds, pause included.
    #[serde(deserialize_with = "ranges::seconds")]
    pub each_s: f64,
    /// Lowest and highest x of the contact point in mm.
    #[serde(deserialize_with = "ranges::span_on_pad")]
    pub x_mm: [f64; 2],
    /// Lowest and highest y of the contact point in mm.
    #[serde(deserialize_with = "ranges::span_on_pad")]
    pub y_mm: [f64; 2],
    /// Lowest and highest of the peak normal force in newtons.
    #[serde(deserialize_with = "ranges::span_of_normals")]
    pub fz_n: [f64; 2],
    /// Lowest and highest peak of shear as a share of what friction holds; its direction turns.
    #[serde(default, deserialize_with = "ranges::span_of_shares")]
    pub shear_of_limit: [f64; 2],
    /// Longest way the contact point rolls during a press, in mm, within the ranges of x and y.
    #[serde(default, deserialize_with = "ranges::roll")]
    pub roll_mm: f64,
}
