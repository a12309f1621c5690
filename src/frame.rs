//! Frames of the stream: status and the fields that the host asked for.

pub mod schema;

use core::fmt;

use serde::de::{Error, SeqAccess, Visitor};
use serde::ser::SerializeStruct;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::units::Micros;
pub use schema::{Fields, Status};

macro_rules! frames {
    (
        head { $($head:ident: $type:ty = $HEAD:ident($bit:literal) $meaning:literal $about:tt)* }
        tail { $($tail:ident: $last:ty = $TAIL:ident($at:literal) $last_meaning:literal $last_about:tt)* }
    ) => {
        /// One frame of the stream.
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct Frame {
            /// Counter of the stream's frames, dropped ones included: a gap is a loss.
            pub seq: u32,
            /// Start of the scan.
            pub time: Micros,
            /// State, and the estimators that ran.
            pub status: Status,
            $(
                #[doc = concat!($meaning, ".")]
                pub $head: Option<$type>,
            )*
            $(
                #[doc = concat!($last_meaning, ".")]
                pub $tail: Option<$last>,
            )*
        }

        /// A frame that borrows its fields, so that half a kilobyte is sent without a copy.
        #[derive(Clone, Copy, Debug)]
        #[expect(missing_docs, reason = "the fields are those of `Frame`")]
        pub struct FrameRef<'f> {
            pub seq: u32,
            pub time: Micros,
            pub status: Status,
            $(pub $head: Option<&'f $type>,)*
            $(pub $tail: Option<&'f $last>,)*
        }

        impl FrameRef<'_> {
            /// Returns the fields of the frame's tail that are present.
            pub(crate) const fn tail(&self) -> Fields {
                Fields(0 $(| (self.$tail.is_some() as u16) << $at)*)
            }
        }

        impl Frame {
            /// Returns the fields that are present.
            #[must_use]
            pub fn fields(&self) -> Fields {
                let head = 0 $(| u16::from(self.$head.is_some()) << $bit)*;
                Fields(head) | FrameRef::from(self).tail()
            }

            /// Returns the frame reduced to the fields in `fields`.
            #[must_use]
            pub fn masked(self, fields: Fields) -> Self {
                Self {
                    $($head: self.$head.filter(|_| fields.contains(Fields::$HEAD)),)*
                    $($tail: self.$tail.filter(|_| fields.contains(Fields::$TAIL)),)*
                    ..self
                }
            }
        }

        impl<'f> From<&'f Frame> for FrameRef<'f> {
            fn from(frame: &'f Frame) -> Self {
                let Frame { seq, time, status, .. } = *frame;
                let ($($head,)* $($tail,)*) = ($(frame.$head.as_ref(),)* $(frame.$tail.as_ref(),)*);
                Self { seq, time, status, $($head,)* $($tail,)* }
            }
        }

        impl From<FrameRef<'_>> for Frame {
            fn from(frame: FrameRef<'_>) -> Self {
                let FrameRef { seq, time, status, .. } = frame;
                let ($($head,)* $($tail,)*) = ($(frame.$head.copied(),)* $(frame.$tail.copied(),)*);
                Self { seq, time, status, $($head,)* $($tail,)* }
            }
        }

        impl Serialize for Frame {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                let mut out = serializer.serialize_struct("Frame", PARTS)?;
                out.serialize_field("seq", &self.seq)?;
                out.serialize_field("time", &self.time)?;
                out.serialize_field("status", &self.status)?;
                $(out.serialize_field(stringify!($head), &self.$head)?;)*
                let tail = FrameRef::from(self).tail();
                $(
                    // Before a later field, one that is missing says so.
                    if tail.0 >> $at != 0 {
                        out.serialize_field(stringify!($tail), &self.$tail)?;
                    }
                )*
                out.end()
            }
        }

        impl<'de> Visitor<'de> for FrameVisitor {
            type Value = Frame;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a frame")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut parts: A) -> Result<Frame, A::Error> {
                let mut frame = Frame {
                    seq: next(&mut parts)?,
                    time: next(&mut parts)?,
                    status: next(&mut parts)?,
                    $($head: next(&mut parts)?,)*
                    $($tail: None,)*
                };
                // A frame ends after its last field that has a value.
                let mut complete = true;
                $(
                    complete = match parts.next_element::<u8>() {
                        Err(_) | Ok(None) if complete => return Ok(frame),
                        Ok(Some(0)) => false,
                        Ok(Some(1)) => {
                            frame.$tail = Some(next(&mut parts)?);
                            true
                        }
                        _ => return Err(A::Error::custom("frame with a broken tail")),
                    };
                )*
                if complete { Ok(frame) } else { Err(A::Error::custom("frame with a broken tail")) }
            }
        }
    };
}
crate::frame_fields!(frames);

/// Largest number of serde elements in a frame: two for each field, presence and value.
const PARTS: usize = 3 + 2 * schema::FIELDS.len();

struct FrameVisitor;

fn next<'de, A: SeqAccess<'de>, T: Deserialize<'de>>(parts: &mut A) -> Result<T, A::Error> {
    parts.next_element()?.ok_or_else(|| A::Error::custom("frame that ends too early"))
}

impl<'de> Deserialize<'de> for Frame {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_tuple(PARTS, FrameVisitor)
    }
}

#[cfg(test)]
mod tests {
    use super::schema::{BITS, CSV, FIELDS, Group};
    use super::*;

    #[test]
    fn status_bits_are_frozen() {
        assert_eq!(Status::all(), Status(0x1fff_ffff));
        let named = BITS.iter().fold(Status(0), |all, bit| {
            assert_eq!((bit.status.0.count_ones(), all & bit.status), (1, Status(0)));
            all | bit.status
        });
        assert_eq!(named, Status::all());
    }

    #[test]
    fn fields_are_numbered_in_order() {
        for (i, field) in FIELDS.iter().enumerate() {
            assert_eq!(field.mask, Fields(1 << i), "{}", field.name);
        }
        assert_eq!(Fields::ALL.0.count_ones() as usize, FIELDS.len());
    }

    #[test]
    fn csv_has_every_field_once() {
        let fields = CSV.iter().filter_map(|group| match group {
            Group::Field(field) => Some(*field),
            Group::Flag { .. } => None,
        });
        let all = fields.fold(Fields::empty(), |all, field| {
            assert!(!all.intersects(field), "{field:?}");
            all | field
        });
        assert_eq!(all, Fields::ALL);
    }
}
