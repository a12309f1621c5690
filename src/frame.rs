//! What the finger says, once a frame: status, and the fields that the host asked for.

use core::fmt;
use core::marker::PhantomData;

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::condition::Signals;
use crate::estimate::slip::Verdict;
use crate::estimate::{ContactPoint, Force, NormalContact, Uncertainty};
use crate::measured::Measured;
use crate::scan::{Codes, SENSORS};
use crate::units::{Micros, NewtonMillimetres};

/// What holds for a frame and which estimators ran for it, a bit each. The bits are the wire's and
/// are frozen: append, never renumber.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(transparent)]
pub struct Status(pub u32);

impl Status {
    /// Bit 0: the contact gate is open.
    pub const CONTACT: Self = Self(1 << 0);
    /// Bit 1: no calibration for a force this finger could measure.
    pub const UNCALIBRATED: Self = Self(1 << 1);
    /// Bit 2: a taxel is clipped; forces are withheld.
    pub const SATURATED: Self = Self(1 << 2);
    /// Bit 3: a taxel sees no light; forces are withheld and the contact point leaves it out.
    pub const DEAD_TAXEL: Self = Self(1 << 3);
    /// Bit 4: a bridge midpoint is near a rail, or the four are not about half the supply; that sensor's
    /// force is withheld.
    pub const BRIDGE_FAULT: Self = Self(1 << 4);
    /// Bit 5: a signal lies outside the calibration's range; the forces that need it are withheld.
    pub const OUT_OF_RANGE: Self = Self(1 << 5);
    /// Bit 6: scans were lost just before this one.
    pub const OVERRUN: Self = Self(1 << 6);
    /// Bit 7: a bias taken on command is in force instead of the calibration's.
    pub const BIASED: Self = Self(1 << 7);
    /// Bit 8: a code does not change any more while the others do; its taxel or sensor is left out as a
    /// dead one is.
    pub const STUCK_CHANNEL: Self = Self(1 << 8);
    /// Bit 9: no single contact accounts for the signals; the frame's contacts say more.
    pub const NOT_SINGLE: Self = Self(1 << 9);
    /// Bit 10: matrix and force sensors contradict each other; the surer one is given.
    pub const DISAGREE: Self = Self(1 << 10);
    /// Bit 11: the contact is about to slip.
    pub const SLIP_WARNING: Self = Self(1 << 11);
    /// Bit 12: the contact slides.
    pub const SLIDES: Self = Self(1 << 12);
    /// Bit 13: it is warmer or colder than the calibration knows.
    pub const TEMPERATURE: Self = Self(1 << 13);
    /// Bit 14: a force sensor is far noisier than when its bias was taken.
    pub const NOISY: Self = Self(1 << 14);
    /// Bit 16: the arg-min contact point ran.
    pub const RAN_ARG_MIN: Self = Self(1 << 16);
    /// Bit 17: the centroid contact point ran.
    pub const RAN_CENTROID: Self = Self(1 << 17);
    /// Bit 18: the force net ran.
    pub const RAN_NET: Self = Self(1 << 18);
    /// Bit 19: at least one f = S(u − b) ran.
    pub const RAN_SENSORS: Self = Self(1 << 19);

    /// Bit 20: the model of the skin ran, for a normal force at least.
    pub const RAN_MODEL: Self = Self(1 << 20);
    /// Bit 21: it ran with shear.
    pub const RAN_SHEAR: Self = Self(1 << 21);
    /// Bit 22: two contacts were looked for.
    pub const RAN_PAIR: Self = Self(1 << 22);
    /// Bit 23: the force sensors' common wrench and contact ran.
    pub const RAN_ARRAY: Self = Self(1 << 23);
    /// Bit 24: slip was judged.
    pub const RAN_SLIP: Self = Self(1 << 24);
    /// Bit 25: the force net in 16 bits ran.
    pub const RAN_QUANTISED: Self = Self(1 << 25);
    /// Bit 26: what warmth does was taken off.
    pub const RAN_WARMTH: Self = Self(1 << 26);

    /// The estimators that this build holds.
    pub const BUILT: Self = {
        let always =
            Self::RAN_ARG_MIN.0 | Self::RAN_CENTROID.0 | Self::RAN_NET.0 | Self::RAN_SENSORS.0;
        let model = Self::RAN_MODEL.0 | Self::RAN_SHEAR.0 | Self::RAN_PAIR.0;
        Self(
            always
                | if cfg!(feature = "model") { model } else { 0 }
                | if cfg!(feature = "array") { Self::RAN_ARRAY.0 } else { 0 }
                | if cfg!(feature = "slip") { Self::RAN_SLIP.0 } else { 0 }
                | if cfg!(feature = "quantised") { Self::RAN_QUANTISED.0 } else { 0 }
                | if cfg!(feature = "warmth") { Self::RAN_WARMTH.0 } else { 0 },
        )
    };

    /// Every bit with its name, as the tools print it.
    pub const NAMES: [(Self, &'static str); 26] = [
        (Self::CONTACT, "contact"),
        (Self::UNCALIBRATED, "uncalibrated"),
        (Self::SATURATED, "saturated"),
        (Self::DEAD_TAXEL, "dead-taxel"),
        (Self::BRIDGE_FAULT, "bridge-fault"),
        (Self::OUT_OF_RANGE, "out-of-range"),
        (Self::OVERRUN, "overrun"),
        (Self::BIASED, "biased"),
        (Self::STUCK_CHANNEL, "stuck-channel"),
        (Self::NOT_SINGLE, "not-single"),
        (Self::DISAGREE, "disagree"),
        (Self::SLIP_WARNING, "slip-warning"),
        (Self::SLIDES, "slides"),
        (Self::TEMPERATURE, "temperature"),
        (Self::NOISY, "noisy"),
        (Self::RAN_ARG_MIN, "ran-arg-min"),
        (Self::RAN_CENTROID, "ran-centroid"),
        (Self::RAN_NET, "ran-net"),
        (Self::RAN_SENSORS, "ran-sensors"),
        (Self::RAN_MODEL, "ran-model"),
        (Self::RAN_SHEAR, "ran-shear"),
        (Self::RAN_PAIR, "ran-pair"),
        (Self::RAN_ARRAY, "ran-array"),
        (Self::RAN_SLIP, "ran-slip"),
        (Self::RAN_QUANTISED, "ran-quantised-net"),
        (Self::RAN_WARMTH, "ran-warmth"),
    ];

    /// Sets the bits of `other`.
    pub fn set(&mut self, other: Self) {
        self.0 |= other.0;
    }

    /// All bits of `other` are set.
    #[must_use]
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// Which fields a frame carries, a bit a field; the host chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(transparent)]
pub struct Fields(pub u16);

impl Fields {
    /// Bit 0: the ADC codes.
    pub const CODES: Self = Self(1 << 0);
    /// Bit 1: conditioned signals and channel health.
    pub const SIGNALS: Self = Self(1 << 1);
    /// Bit 2: per-sensor forces.
    pub const SENSORS: Self = Self(1 << 2);
    /// Bit 3: the finger's force.
    pub const FORCE: Self = Self(1 << 3);
    /// Bit 4: the contact point.
    pub const POINT: Self = Self(1 << 4);
    /// Bit 5: slip.
    pub const SLIP: Self = Self(1 << 5);
    /// Bit 6: torsion.
    pub const TORSION: Self = Self(1 << 6);
    /// Bit 7: two contacts, one by one.
    pub const CONTACTS: Self = Self(1 << 7);
    /// Bit 8: how sure all that is.
    pub const UNCERTAINTY: Self = Self(1 << 8);

    /// Every field there is.
    pub const ALL: Self = Self(0b1_1111_1111);
    /// What a controller wants: force, contact point, per-sensor forces and slip.
    pub const ESTIMATES: Self =
        Self(Self::SENSORS.0 | Self::FORCE.0 | Self::POINT.0 | Self::SLIP.0);

    /// All bits of `other` are chosen.
    #[must_use]
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// One frame of the stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Frame {
    /// Counts frames of the stream, those that were dropped included: a gap is a loss.
    pub seq: u32,
    /// When the scan of this frame began.
    pub time: Micros,
    /// What holds, and which estimators ran.
    pub status: Status,
    /// The ADC codes.
    pub codes: Option<Codes>,
    /// Conditioned signals.
    pub signals: Option<Signals>,
    /// Force on each MEMS sensor.
    pub sensors: Option<[Force; SENSORS]>,
    /// The finger's force. Zero, not missing, while nothing touches it.
    pub force: Option<Force>,
    /// The contact point.
    pub point: Option<Measured<ContactPoint>>,
    /// How near to slip it is, what friction it has, how hard to grip.
    pub slip: Option<Measured<Verdict>>,
    /// Moment about the normal of the contact.
    pub torsion: Option<Measured<NewtonMillimetres>>,
    /// Two contacts, the stronger one first, where a single one does not account for the signals.
    pub contacts: Option<Measured<[NormalContact; 2]>>,
    /// How sure all that is. Newer than the first frames: where it was not asked for, a frame ends before it,
    /// as those who never heard of it expect.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "last")]
    pub uncertainty: Option<Measured<Uncertainty>>,
}

/// What may stand at a frame's end: nothing, or an option that holds something.
fn last<'de, D, T>(deserializer: D) -> Result<Option<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct Last<T>(PhantomData<T>);
    impl<'de, T: Deserialize<'de>> Visitor<'de> for Last<T> {
        type Value = Option<T>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("nothing, or 1 and a value")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut bytes: A) -> Result<Self::Value, A::Error> {
            match bytes.next_element::<u8>() {
                // The message is over.
                Err(_) | Ok(None) => Ok(None),
                Ok(Some(1)) => bytes.next_element(),
                Ok(Some(_)) => Err(A::Error::custom("no 1")),
            }
        }
    }
    deserializer.deserialize_tuple(2, Last(PhantomData))
}

/// A frame whose fields lie where they were made: half a kilobyte that need not be copied to be sent.
#[derive(Clone, Copy, Debug)]
#[expect(missing_docs, reason = "they are those of a frame")]
pub struct FrameRef<'f> {
    pub seq: u32,
    pub time: Micros,
    pub status: Status,
    pub codes: Option<&'f Codes>,
    pub signals: Option<&'f Signals>,
    pub sensors: Option<&'f [Force; SENSORS]>,
    pub force: Option<&'f Force>,
    pub point: Option<&'f Measured<ContactPoint>>,
    pub slip: Option<&'f Measured<Verdict>>,
    pub torsion: Option<&'f Measured<NewtonMillimetres>>,
    pub contacts: Option<&'f Measured<[NormalContact; 2]>>,
    pub uncertainty: Option<&'f Measured<Uncertainty>>,
}

impl<'f> From<&'f Frame> for FrameRef<'f> {
    fn from(frame: &'f Frame) -> Self {
        let Frame { seq, time, status, .. } = *frame;
        Self {
            seq,
            time,
            status,
            codes: frame.codes.as_ref(),
            signals: frame.signals.as_ref(),
            sensors: frame.sensors.as_ref(),
            force: frame.force.as_ref(),
            point: frame.point.as_ref(),
            slip: frame.slip.as_ref(),
            torsion: frame.torsion.as_ref(),
            contacts: frame.contacts.as_ref(),
            uncertainty: frame.uncertainty.as_ref(),
        }
    }
}

impl From<FrameRef<'_>> for Frame {
    fn from(frame: FrameRef<'_>) -> Self {
        let FrameRef { seq, time, status, .. } = frame;
        Self {
            seq,
            time,
            status,
            codes: frame.codes.copied(),
            signals: frame.signals.copied(),
            sensors: frame.sensors.copied(),
            force: frame.force.copied(),
            point: frame.point.copied(),
            slip: frame.slip.copied(),
            torsion: frame.torsion.copied(),
            contacts: frame.contacts.copied(),
            uncertainty: frame.uncertainty.copied(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_status_bit_has_one_name() {
        let all = Status::NAMES.iter().fold(0u32, |all, (bit, _)| {
            assert_eq!(bit.0.count_ones(), 1);
            assert_eq!(all & bit.0, 0);
            all | bit.0
        });
        assert_eq!(all, 0x07ff_7fff);
    }
}
