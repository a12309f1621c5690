//! Serializer of frames, byte-identical to postcard's `Message::Frame`
//! (`tests/core/wire_golden.rs`).
//!
//! The serializer takes a third of postcard's modelled cycles. Each function takes the rest of the
//! buffer by value and returns it, so that the rest stays in two registers.

use crate::condition::Signals;
use crate::estimate::slip::Verdict;
use crate::estimate::{ContactPoint, Force, NormalContact, Uncertainty};
use crate::frame::FrameRef;
use crate::measured::Measured;
use crate::scan::{Codes, Midpoints, SENSORS, TAXELS, TaxelCodes};
use crate::units::{Code, Micros, NewtonMillimetres, Newtons};

/// Discriminant of the message.
const FRAME: u8 = 2;

/// Serializes the frame into `buffer` and returns its length; `None` if it does not fit.
pub(super) fn serialize(frame: &FrameRef<'_>, buffer: &mut [u8]) -> Option<usize> {
    let length = buffer.len();
    let rest = byte(buffer, FRAME)?;
    let rest = varint(rest, frame.seq)?;
    let rest = time(rest, frame.time)?;
    let mut rest = varint(rest, frame.status.0)?;
    macro_rules! fields {
        (
            head { $($head:ident: $type:ty = $HEAD:ident $bit:tt $meaning:literal $about:tt)* }
            tail { $($tail:ident: $last:ty = $TAIL:ident($at:literal) $last_meaning:literal $last_about:tt)* }
        ) => {
            $(rest = option(rest, frame.$head, Encode::encode)?;)*
            let tail = frame.tail();
            $(
                // Before a later field, one that is missing says so.
                if tail.0 >> $at != 0 {
                    rest = option(rest, frame.$tail, Encode::encode)?;
                }
            )*
        };
    }
    crate::frame_fields!(fields);
    Some(length - rest.len())
}

/// Remaining part of a buffer; `None` if there was not enough room.
type Rest<'b> = Option<&'b mut [u8]>;

/// Writes a value's bytes as postcard does and returns the rest of the buffer.
trait Encode: Sized {
    fn encode<'b>(rest: &'b mut [u8], value: &Self) -> Rest<'b>;
}

/// Implements [`Encode`] with the given functions.
macro_rules! encode {
    ($($type:ty: $encode:expr;)*) => {
        $(
            impl Encode for $type {
                #[inline(always)]
                fn encode<'b>(rest: &'b mut [u8], value: &Self) -> Rest<'b> {
                    $encode(rest, value)
                }
            }
        )*
    };
}

encode! {
    Codes: codes;
    Signals: signals;
    [Force; SENSORS]: |rest, sensors: &'_ Self| forces(rest, sensors);
    Force: |rest, force| forces(rest, core::slice::from_ref(force));
    ContactPoint: place;
    Verdict: verdict;
    NewtonMillimetres: moment;
    [NormalContact; 2]: contacts;
    Uncertainty: uncertain;
}

impl<T: Encode> Encode for Measured<T> {
    #[inline(always)]
    fn encode<'b>(rest: &'b mut [u8], value: &Self) -> Rest<'b> {
        measured(rest, value, T::encode)
    }
}

#[inline(always)]
fn bytes<'b, const N: usize>(rest: &'b mut [u8], bytes: [u8; N]) -> Rest<'b> {
    let (place, rest) = rest.split_first_chunk_mut()?;
    *place = bytes;
    Some(rest)
}

#[inline(always)]
fn byte(rest: &mut [u8], byte: u8) -> Rest<'_> {
    bytes(rest, [byte])
}

#[inline(never)]
fn varint(mut rest: &mut [u8], mut value: u32) -> Rest<'_> {
    while value >= 0x80 {
        rest = byte(rest, value as u8 | 0x80)?;
        value >>= 7;
    }
    byte(rest, value as u8)
}

fn time(mut rest: &mut [u8], Micros(mut time): Micros) -> Rest<'_> {
    // A 32-bit word holds 71 minutes.
    while time > u64::from(u32::MAX) {
        rest = byte(rest, time as u8 | 0x80)?;
        time >>= 7;
    }
    varint(rest, time as u32)
}

#[inline(always)]
fn option<'b, T>(
    rest: &'b mut [u8],
    value: Option<&T>,
    put: impl Fn(&'b mut [u8], &T) -> Rest<'b>,
) -> Rest<'b> {
    match value {
        None => byte(rest, 0),
        Some(value) => put(byte(rest, 1)?, value),
    }
}

#[inline(always)]
fn measured<'b, T>(
    rest: &'b mut [u8],
    value: &Measured<T>,
    put: impl Fn(&'b mut [u8], &T) -> Rest<'b>,
) -> Rest<'b> {
    match value {
        Ok(value) => put(byte(rest, 0)?, value),
        Err(reason) => bytes(rest, [1, *reason as u8]),
    }
}

/// Writes all of `values`, or none if there is not enough room.
#[inline(always)]
fn floats<'b, const N: usize>(rest: &'b mut [u8], values: &[f32; N]) -> Rest<'b> {
    let (place, rest) = rest.split_at_mut_checked(4 * N)?;
    place.as_chunks_mut().0.iter_mut().zip(values).for_each(|(p, value)| *p = value.to_le_bytes());
    Some(rest)
}

#[inline(never)]
fn matrix<'b>(mut rest: &'b mut [u8], taxels: &[f32; TAXELS]) -> Rest<'b> {
    for four in taxels.as_chunks::<4>().0 {
        rest = floats(rest, four)?;
    }
    Some(rest)
}

/// Writes the four codes of a row or of a sensor.
#[inline(always)]
fn four<'b>(rest: &'b mut [u8], &[a, b, c, d]: &[Code; 4]) -> Rest<'b> {
    let words = [[a, b], [c, d]].map(|[low, high]| u32::from(low.0) | u32::from(high.0) << 16);
    let [[e, f, g, h], [i, j, k, l]] = words.map(u32::to_le_bytes);
    bytes(rest, [e, f, g, h, i, j, k, l])
}

fn code<'b>(rest: &'b mut [u8], code: &Code) -> Rest<'b> {
    bytes(rest, code.0.to_le_bytes())
}

fn codes<'b>(rest: &'b mut [u8], codes: &Codes) -> Rest<'b> {
    let rest = code(rest, &codes.full_scale.top())?;
    let mut rest = option(rest, codes.taxels.as_ref(), |rest, TaxelCodes { lit, dark }| {
        let rest = lit.iter().try_fold(rest, |rest, row| four(rest, row))?;
        four(rest, dark)
    })?;
    for midpoints in &codes.bridges {
        rest = option(rest, midpoints.as_ref(), |rest, &Midpoints { a, b, c, d }| {
            four(rest, &[a, b, c, d])
        })?;
    }
    let rest = option(rest, codes.reference.as_ref(), code)?;
    option(rest, codes.temperature.as_ref(), code)
}

fn signals<'b>(rest: &'b mut [u8], signals: &Signals) -> Rest<'b> {
    let mut rest = option(rest, signals.taxels.as_ref(), |rest, taxels| matrix(rest, taxels))?;
    for bridge in &signals.bridges {
        rest = option(rest, bridge.as_ref(), |rest, bridge| floats(rest, bridge))?;
    }
    let health = &signals.health;
    let rest = varint(varint(rest, health.saturated.into())?, health.dead.into())?;
    byte(rest, health.bridge_faults)
}

#[inline(never)]
fn forces<'b>(mut rest: &'b mut [u8], forces: &[Force]) -> Rest<'b> {
    for Force { x, y, z } in forces {
        rest = if let (Ok(x), Ok(y), Ok(z)) = (x, y, z) {
            let ([a, b, c, d], [e, f, g, h]) = (x.0.to_le_bytes(), y.0.to_le_bytes());
            let [i, j, k, l] = z.0.to_le_bytes();
            bytes(rest, [0, a, b, c, d, 0, e, f, g, h, 0, i, j, k, l])?
        } else {
            newtons(newtons(newtons(rest, x)?, y)?, z)?
        };
    }
    Some(rest)
}

#[inline(never)]
fn newtons<'b>(rest: &'b mut [u8], value: &Measured<Newtons>) -> Rest<'b> {
    match value {
        Ok(value) => {
            let [a, b, c, d] = value.0.to_le_bytes();
            bytes(rest, [0, a, b, c, d])
        }
        Err(reason) => bytes(rest, [1, *reason as u8]),
    }
}

fn place<'b>(rest: &'b mut [u8], &ContactPoint { x, y }: &ContactPoint) -> Rest<'b> {
    floats(rest, &[x.0, y.0])
}

fn verdict<'b>(rest: &'b mut [u8], verdict: &Verdict) -> Rest<'b> {
    floats(rest, &[verdict.margin, verdict.friction, verdict.grip.0])
}

fn moment<'b>(rest: &'b mut [u8], moment: &NewtonMillimetres) -> Rest<'b> {
    floats(rest, &[moment.0])
}

fn uncertain<'b>(rest: &'b mut [u8], sure: &Uncertainty) -> Rest<'b> {
    let rest = forces(rest, core::slice::from_ref(&sure.force))?;
    let rest = measured(rest, &sure.point, place)?;
    measured(rest, &sure.misfit, |rest, misfit| floats(rest, &[*misfit]))
}

fn contacts<'b>(mut rest: &'b mut [u8], contacts: &[NormalContact; 2]) -> Rest<'b> {
    for NormalContact { point, normal } in contacts {
        rest = floats(place(rest, point)?, &[normal.0])?;
    }
    Some(rest)
}
