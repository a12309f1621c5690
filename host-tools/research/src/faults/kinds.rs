//! Kinds of faults: place, change of the codes, and the time in which each must be named.

use taxel::scan::{COLS, ROWS, SENSORS, TAXELS};

use super::codes::{ARMS, CHANNELS, DARK, REFERENCE, THERMOMETER};

/// Class of a fault, which sets the time in which it must be named.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Class {
    /// The channel has nothing of its signal: named in the first frame.
    Total,
    /// Stuck, swapped, wrong bit, noise, floating: named within 10 ms.
    Sudden,
    /// An LED row that loses a twentieth of its light: named within 50 ms.
    Row,
    /// Gain, offset and drift: only the error is bounded.
    Gradual,
}

impl Class {
    /// All classes, the most demanding first.
    pub const ALL: [Self; 4] = [Self::Total, Self::Sudden, Self::Row, Self::Gradual];

    /// Name in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Total => "total",
            Self::Sudden => "sudden",
            Self::Row => "row",
            Self::Gradual => "gradual",
        }
    }

    /// Aim for the longest time from the fault to the frame that names it, in ms.
    pub fn aim_ms(self) -> Option<f64> {
        match self {
            Self::Total => Some(0.0),
            Self::Sudden => Some(10.0),
            Self::Row => Some(50.0),
            Self::Gradual => None,
        }
    }
}

/// Kind of place that is faulty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    /// Lit reading of one taxel.
    Taxel,
    /// Lit readings of one LED row.
    Row,
    /// Lit and dark readings of one column.
    Column,
    /// Dark reading of one column.
    Dark,
    /// Midpoint of a force sensor's bridge.
    Arm,
    /// All midpoints of one force sensor.
    Sensor,
    /// Every channel of the scan.
    Scan,
    /// The reference channel.
    Reference,
    /// The thermometer.
    Thermometer,
}

impl Place {
    /// Name in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Taxel => "taxel",
            Self::Row => "LED row",
            Self::Column => "column",
            Self::Dark => "dark code",
            Self::Arm => "bridge arm",
            Self::Sensor => "force sensor",
            Self::Scan => "scan",
            Self::Reference => "reference channel",
            Self::Thermometer => "thermometer",
        }
    }

    /// Number of places of this kind in a finger.
    pub fn count(self) -> usize {
        match self {
            Self::Taxel => TAXELS,
            Self::Row => ROWS,
            Self::Column | Self::Dark => COLS,
            Self::Arm => REFERENCE - ARMS,
            Self::Sensor => SENSORS,
            Self::Scan | Self::Reference | Self::Thermometer => 1,
        }
    }

    /// Channels of the place with this index.
    pub fn channels(self, index: usize) -> Vec<usize> {
        match self {
            Self::Taxel => vec![index],
            Self::Row => (COLS * index..COLS * (index + 1)).collect(),
            Self::Column => (0..=ROWS).map(|row| COLS * row + index).collect(),
            Self::Dark => vec![DARK + index],
            Self::Arm => vec![ARMS + index],
            Self::Sensor => (ARMS + 4 * index..ARMS + 4 * (index + 1)).collect(),
            Self::Scan => (0..CHANNELS).collect(),
            Self::Reference => vec![REFERENCE],
            Self::Thermometer => vec![THERMOMETER],
        }
    }

    /// Returns whether a finger without force sensors has this place.
    pub fn of_matrix(self) -> bool {
        matches!(self, Self::Taxel | Self::Row | Self::Column | Self::Dark | Self::Scan)
    }

    /// Returns whether the place is a channel beside matrix and force sensors.
    pub fn is_auxiliary(self) -> bool {
        matches!(self, Self::Reference | Self::Thermometer)
    }
}

/// Change of the codes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Change {
    /// Rests at the code of the onset.
    Held,
    /// Rests at a share of full scale.
    At(f64),
    /// One bit of the code rests at 0 or 1.
    Bit(u32, bool),
    /// Noise of so many times the channel's own.
    Noise(f64),
    /// A random walk.
    Floating,
    /// Changes places with its neighbour.
    Swapped,
    /// Changes places with the same channel of the next sensor.
    Across,
    /// Reads its neighbour, too.
    Copied,
    /// Moves by a share of full scale.
    Offset(f64),
    /// Multiplies the signal: light above the dark code, voltage about half the supply.
    Gain(f64),
    /// Gain that changes by this share a second.
    Drift(f64),
    /// Offset that changes by this share of full scale a second.
    Slide(f64),
    /// Reads zero in bursts of 2 ms, a quarter of the time.
    Intermittent,
    /// Reads the dark code.
    Dark,
    /// The row's LEDs are on in every step.
    AlwaysOn,
    /// Each channel has the code of the one before.
    ShiftedChannels,
    /// Each row has the codes of the one before.
    ShiftedRows,
}

/// One kind of fault at one kind of place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Kind {
    pub name: &'static str,
    pub place: Place,
    pub class: Class,
    pub change: Change,
}

impl Kind {
    /// Index of the place with which this one is swapped, or which it copies.
    pub fn neighbour(&self, index: usize) -> usize {
        match (self.place, self.change) {
            (Place::Arm, Change::Across) => (index + 4) % self.place.count(),
            (Place::Taxel | Place::Arm, _) => index ^ 1,
            _ => (index + 1) % self.place.count(),
        }
    }
}

macro_rules! kinds {
    ($($place:ident { $($class:ident $name:literal $change:ident $(($($value:expr),*))?;)* })*) => {
        /// Every kind of fault.
        pub(crate) const KINDS: &[Kind] = &[$($(Kind {
            name: $name,
            place: Place::$place,
            class: Class::$class,
            change: Change::$change $(($($value),*))?,
        }),*),*];
    };
}

kinds! {
    Taxel {
        Total "at zero" At(0.0);
        Total "at full scale" At(1.0);
        Sudden "stuck at its code" Held;
        Sudden "stuck at half scale" At(0.5);
        Sudden "bit 2 at 0" Bit(2, false);
        Sudden "bit 2 at 1" Bit(2, true);
        Sudden "bit 6 at 0" Bit(6, false);
        Sudden "bit 6 at 1" Bit(6, true);
        Sudden "bit 10 at 0" Bit(10, false);
        Sudden "bit 10 at 1" Bit(10, true);
        Sudden "bit 13 at 0" Bit(13, false);
        Sudden "bit 13 at 1" Bit(13, true);
        Sudden "noise ×10" Noise(10.0);
        Sudden "noise ×50" Noise(50.0);
        Sudden "floating" Floating;
        Sudden "swapped with its neighbour" Swapped;
        Sudden "reads its neighbour" Copied;
        Sudden "at zero now and then" Intermittent;
        Gradual "offset +2 % of the range" Offset(0.02);
        Gradual "offset −2 % of the range" Offset(-0.02);
        Gradual "gain −5 %" Gain(0.95);
        Gradual "gain −50 %" Gain(0.5);
        Gradual "gain +20 %" Gain(1.2);
        Gradual "gain falls by 10 % a second" Drift(-0.1);
    }
    Row {
        Total "off" Dark;
        Total "always on" AlwaysOn;
        Sudden "swapped with the next" Swapped;
        Row "light −5 %" Gain(0.95);
        Gradual "light −20 %" Gain(0.8);
        Gradual "light +5 %" Gain(1.05);
        Gradual "light falls by 10 % a second" Drift(-0.1);
    }
    Column {
        Total "at zero" At(0.0);
        Total "at full scale" At(1.0);
        Total "open: dark in every step" Dark;
        Sudden "stuck at its codes" Held;
        Sudden "swapped with the next" Swapped;
        Sudden "reads the next" Copied;
        Gradual "gain −5 %" Gain(0.95);
        Gradual "offset +2 % of the range" Offset(0.02);
    }
    Dark {
        Total "at zero" At(0.0);
        Total "at full scale" At(1.0);
        Sudden "stuck at its code" Held;
        Sudden "noise ×10" Noise(10.0);
        Sudden "noise ×50" Noise(50.0);
        Gradual "offset +2 % of the range" Offset(0.02);
        Gradual "offset −2 % of the range" Offset(-0.02);
    }
    Arm {
        Total "at ground" At(0.0);
        Total "at the supply" At(1.0);
        Sudden "stuck at its code" Held;
        Sudden "bit 6 at 0" Bit(6, false);
        Sudden "bit 6 at 1" Bit(6, true);
        Sudden "bit 10 at 0" Bit(10, false);
        Sudden "bit 10 at 1" Bit(10, true);
        Sudden "noise ×10" Noise(10.0);
        Sudden "noise ×50" Noise(50.0);
        Sudden "floating" Floating;
        Sudden "swapped in its sensor" Swapped;
        Sudden "swapped with the next sensor's" Across;
        Sudden "reads its neighbour (open)" Copied;
        Sudden "at zero now and then" Intermittent;
        Gradual "offset +2 % of the range" Offset(0.02);
        Gradual "gain −20 %" Gain(0.8);
        Gradual "offset rises by 2 % a second" Slide(0.02);
    }
    Sensor {
        Total "unplugged: at ground" At(0.0);
        Total "at half the supply" At(0.5);
        Sudden "stuck at its codes" Held;
        Sudden "swapped with the next" Swapped;
    }
    Scan {
        Sudden "frozen" Held;
        Sudden "shifted by a channel" ShiftedChannels;
        Sudden "shifted by a row" ShiftedRows;
    }
    Reference {
        Total "at full scale" At(1.0);
        Sudden "stuck at its code" Held;
    }
    Thermometer {
        Total "at zero" At(0.0);
        Total "at full scale" At(1.0);
        Sudden "stuck at its code" Held;
        Gradual "offset +2 % of the range" Offset(0.02);
    }
}
