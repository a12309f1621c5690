//! Table `[[fault]]` of a scene: something that breaks.

use std::ops::Range;

use serde::Deserialize;
use taxel::scan::{COLS, SENSORS};
use toml::Spanned;

use super::Device;
use super::read::Problem;
use crate::ranges::{self, Given};

/// `[[fault]]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// Start in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    at_s: f64,
    /// End in seconds; without it the fault stays.
    until_s: Option<Spanned<Given>>,
    /// Kind of fault.
    kind: Spanned<Kind>,
    /// Channel: `r1c2` a taxel, `c2` a column, `s0_a` a midpoint, `s0_r3` a resistor, `vref`.
    channel: Option<Spanned<String>>,
    /// The other column of `swapped-columns`.
    with: Option<Spanned<String>>,
    /// Share of the supply that remains during a `supply-dip`.
    ratio: Option<Spanned<Given>>,
}

/// `kind`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    DeadLed,
    StuckChannel,
    OpenChannel,
    ShortedChannel,
    SaturatedAdc,
    BrokenArm,
    SupplyDip,
    SwappedColumns,
}

/// Place of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// A taxel: its phototransistor, or its reading.
    Taxel(usize),
    /// A column's wire to the converter.
    Column(usize),
    /// The wire of a sensor's midpoint to the converter, a to d as 0 to 3.
    Midpoint(usize, usize),
    /// The reference channel.
    Reference,
}

/// Fault of the device, with its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Broken {
    /// The LED of a taxel gives no light.
    Led(usize),
    /// A phototransistor or a wire is open.
    ///
    /// An open column is pulled down by its load; the input of an open midpoint floats.
    Open(Place),
    /// A wire touches ground.
    Shorted(Place),
    /// An input is at the top of its range.
    Saturated(Place),
    /// A reading no longer changes.
    Stuck(Place),
    /// A resistor of a sensor, R1 to R8 as 0 to 7, conducts nothing.
    Arm(usize, usize),
    /// The supply is down to this share.
    Supply(f64),
    /// Two columns are wired to each other's input.
    Swapped(usize, usize),
}

impl Fault {
    /// Range of `ratio`: with less supply, nothing runs that could read.
    const DIP: [f64; 2] = [0.3, 1.0];

    /// Time range in seconds.
    ///
    /// # Errors
    /// The fault ends before it begins.
    pub(super) fn times(&self) -> Result<Range<f64>, Problem> {
        let Some(given) = &self.until_s else { return Ok(self.at_s..f64::INFINITY) };
        let until = given.get_ref().within(0.0, 86_400.0).map_err(|e| (given.span(), e))?;
        if until > self.at_s {
            return Ok(self.at_s..until);
        }
        let problem = format!(
            "ends at {until} s but begins at `at_s` {} s; allowed is any later time",
            self.at_s
        );
        Err((given.span(), problem))
    }

    /// Fault of this device that the table describes.
    ///
    /// # Errors
    /// A key is missing or does not belong to this kind, or a key names a part that this kind or
    /// this device does not have.
    pub(super) fn broken(&self, device: &Device) -> Result<Broken, Problem> {
        let kind = *self.kind.get_ref();
        self.only_keys_of(kind)?;
        let named_taxel = || self.named("channel", &self.channel, taxels(device));
        let wire = || self.named("channel", &self.channel, wires(device));
        match kind {
            Kind::DeadLed => named_taxel().map(Broken::Led),
            Kind::OpenChannel => {
                let places = places_of_taxels(device).chain(wires(device));
                self.named("channel", &self.channel, places).map(Broken::Open)
            }
            Kind::StuckChannel => {
                let reference = [("vref".to_owned(), Place::Reference)];
                let places = places_of_taxels(device).chain(wires(device)).chain(reference);
                self.named("channel", &self.channel, places).map(Broken::Stuck)
            }
            Kind::ShortedChannel => wire().map(Broken::Shorted),
            Kind::SaturatedAdc => wire().map(Broken::Saturated),
            Kind::BrokenArm => {
                let (sensor, resistor) = self.named("channel", &self.channel, arms(device))?;
                Ok(Broken::Arm(sensor, resistor))
            }
            Kind::SwappedColumns => Ok(Broken::Swapped(
                self.named("channel", &self.channel, columns(device))?,
                self.named("with", &self.with, columns(device))?,
            )),
            Kind::SupplyDip => self.dip(),
        }
    }

    /// Rejects keys that have no effect for this kind.
    fn only_keys_of(&self, kind: Kind) -> Result<(), Problem> {
        let (channel, with, ratio) = match kind {
            Kind::SupplyDip => (false, false, true),
            Kind::SwappedColumns => (true, true, false),
            _ => (true, false, false),
        };
        let spans = [
            ("channel", channel, self.channel.as_ref().map(Spanned::span)),
            ("with", with, self.with.as_ref().map(Spanned::span)),
            ("ratio", ratio, self.ratio.as_ref().map(Spanned::span)),
        ];
        let allowed: Vec<&str> = spans.iter().filter(|key| key.1).map(|key| key.0).collect();
        for (_, wanted, span) in &spans {
            if let (false, Some(span)) = (wanted, span) {
                let problem = format!(
                    "this kind of fault has no such key; allowed are `at_s`, `until_s`, `{}`",
                    allowed.join("`, `")
                );
                return Err((span.clone(), problem));
            }
        }
        Ok(())
    }

    fn missing(&self, key: &str, allowed: &str) -> Problem {
        (self.kind.span(), format!("this kind of fault needs `{key}`; allowed are {allowed}"))
    }

    /// Looks up the place that a key names.
    fn named<T>(
        &self,
        key: &str,
        value: &Option<Spanned<String>>,
        places: impl Iterator<Item = (String, T)>,
    ) -> Result<T, Problem> {
        let mut names = Vec::new();
        for (name, place) in places {
            if value.as_ref().is_some_and(|value| *value.get_ref() == name) {
                return Ok(place);
            }
            names.push(name);
        }
        let allowed = if names.is_empty() {
            "none: the finger has no such part".to_owned()
        } else {
            names.join(", ")
        };
        Err(value.as_ref().map_or_else(
            || self.missing(key, &allowed),
            |name| {
                let problem = format!("no channel `{}`; allowed are {allowed}", name.get_ref());
                (name.span(), problem)
            },
        ))
    }

    fn dip(&self) -> Result<Broken, Problem> {
        let [least, most] = Self::DIP;
        let allowed = format!("{least} to {most}");
        let ratio = self.ratio.as_ref().ok_or_else(|| self.missing("ratio", &allowed))?;
        let left = ratio.get_ref().within(least, most);
        left.map(Broken::Supply).map_err(|problem| (ratio.span(), problem))
    }
}

fn taxels(device: &Device) -> impl Iterator<Item = (String, usize)> {
    let there = device.rows() * COLS;
    (0..there).map(|k| (format!("r{}c{}", k / COLS, k % COLS), k))
}

fn columns(device: &Device) -> impl Iterator<Item = (String, usize)> {
    let there = if device.rows() > 0 { COLS } else { 0 };
    (0..there).map(|c| (format!("c{c}"), c))
}

/// Names of one part of each existing force sensor, with both indices: sensor and part.
fn of_sensors<const N: usize>(
    device: &Device,
    names: [&'static str; N],
) -> impl Iterator<Item = (String, (usize, usize))> {
    let there = device.sensors();
    (0..SENSORS).filter(move |s| there.get(*s) == Some(&true)).flat_map(move |s| {
        names.into_iter().enumerate().map(move |(i, name)| (format!("s{s}_{name}"), (s, i)))
    })
}

fn arms(device: &Device) -> impl Iterator<Item = (String, (usize, usize))> {
    of_sensors(device, ["r1", "r2", "r3", "r4", "r5", "r6", "r7", "r8"])
}

fn places_of_taxels(device: &Device) -> impl Iterator<Item = (String, Place)> {
    taxels(device).map(|(name, k)| (name, Place::Taxel(k)))
}

fn wires(device: &Device) -> impl Iterator<Item = (String, Place)> {
    let columns = columns(device).map(|(name, c)| (name, Place::Column(c)));
    let midpoints = of_sensors(device, ["a", "b", "c", "d"]);
    columns.chain(midpoints.map(|(name, (s, i))| (name, Place::Midpoint(s, i))))
}
