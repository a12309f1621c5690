//! Frames as ROS 2 messages, in CDR.
//!
//! Units are those of ROS, metres and newton metres (REP 103). `geometry_msgs/WrenchStamped` cannot
//! mark a value as missing. A frame whose force or place of contact has no value therefore has no
//! wrench; `taxel_msgs/Frame` carries the reason.

pub mod contact;
pub mod diagnostics;
pub mod services;

use std::time::Duration;

use cdr_encoding::to_writer;
use serde::Serialize;
use taxel::condition::Signals;
use taxel::estimate::Force;
use taxel::frame::{Fields, Frame};
use taxel::measured::{Measured, NoValue};
use taxel::scan::SENSORS;
use taxel::units::Newtons;

/// Message type, part of every key: DDS name and hash of the definition (REP 2016).
pub struct Type {
    pub name: &'static str,
    pub hash: &'static str,
}

/// `geometry_msgs/msg/WrenchStamped`.
pub const WRENCH: Type = Type {
    name: "geometry_msgs::msg::dds_::WrenchStamped_",
    hash: "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
};

/// `taxel_msgs/msg/Frame`, defined in `host-tools/ros2/taxel_msgs`.
pub const FRAME: Type = Type {
    name: "taxel_msgs::msg::dds_::Frame_",
    hash: "RIHS01_1558c72b9c38b8aa5b1f8bedea5a03aa7bf4c88f9d31b83c6fb4ae51afbdd65a",
};

#[derive(Clone, Copy, Serialize)]
struct Time {
    sec: i32,
    nanosec: u32,
}

#[derive(Clone, Copy, Serialize)]
struct Header<'n> {
    stamp: Time,
    frame_id: &'n str,
}

#[derive(Clone, Copy, Serialize)]
struct Vector3 {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Clone, Copy, Serialize)]
struct Point {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Clone, Copy, Serialize)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

impl Point {
    const ORIGIN: Self = Self { x: 0.0, y: 0.0, z: 0.0 };
}

impl Quaternion {
    const NONE: Self = Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 };
}

#[derive(Serialize)]
struct WrenchStamped<'n> {
    header: Header<'n>,
    force: Vector3,
    torque: Vector3,
}

#[derive(Clone, Copy, Serialize)]
struct Value {
    value: f32,
    withheld: u8,
}

#[derive(Serialize)]
struct FrameMessage<'n> {
    header: Header<'n>,
    device_us: u64,
    seq: u32,
    status: u32,
    force: Vec<Value>,
    point: Vec<Value>,
    torsion: Vec<Value>,
    slip: Vec<Value>,
    contacts: Vec<Value>,
    sensors: Vec<Value>,
    taxels: Vec<f32>,
    bridges: Vec<Value>,
}

/// Fields that a frame needs for a [`wrench`].
pub const WRENCH_FIELDS: Fields = Fields::FORCE.union(Fields::POINT).union(Fields::TORSION);

/// Returns force in N and moment in N m about the middle of the skin's surface.
///
/// The moment is r × F, with r from the middle to the contact point, and the torsion about the
/// contact's normal (0 if the finger [measures none](no_torsion)). `None` if a component of the
/// force has no value, if a force that is not zero has no contact point or no torsion, or if one of
/// [`WRENCH_FIELDS`] is not streamed.
pub fn wrench(frame: &Frame) -> Option<[[f64; 3]; 2]> {
    let Force { x: Ok(fx), y: Ok(fy), z: Ok(fz) } = frame.force? else { return None };
    let force @ [fx, fy, fz] = [fx, fy, fz].map(|newtons| f64::from(newtons.0));
    let (point, torsion) = (frame.point?, frame.torsion?);
    if force == [0.0; 3] {
        return Some([force, [0.0; 3]]);
    }
    let point = point.ok()?;
    let [x, y] = [point.x, point.y].map(|mm| f64::from(mm.0) * 1e-3);
    let torsion = match torsion {
        Ok(torsion) => f64::from(torsion.0) * 1e-3,
        Err(_) if no_torsion(frame) => 0.0,
        Err(_) => return None,
    };
    Some([force, [y * fz, -x * fz, x * fy - y * fx + torsion]])
}

/// Whether the finger measures no torsion: it has no calibrated array of force sensors, or one that
/// was calibrated without moments, or the touch is so light that torsion is next to nothing.
pub fn no_torsion(frame: &Frame) -> bool {
    use NoValue::{Absent, IllConditioned, NotEstimated, Uncalibrated};
    matches!(frame.torsion, Some(Err(Absent | IllConditioned | NotEstimated | Uncalibrated)))
}

/// Whether a frame tells that the finger never measures torsion: it has none of a firm press.
pub fn never_torsion(frame: &Frame) -> bool {
    const FIRM: f32 = 0.5;
    let firm = frame.force.is_some_and(|force| force.z.is_ok_and(|fz| fz.0 > FIRM));
    no_torsion(frame) && (firm || frame.torsion != Some(Err(NoValue::IllConditioned)))
}

/// Encodes a [`wrench`] in the named frame.
pub fn wrench_stamped([force, torque]: [[f64; 3]; 2], at: Duration, frame: &str) -> Vec<u8> {
    let [force, torque] = [force, torque].map(|[x, y, z]| Vector3 { x, y, z });
    cdr(&WrenchStamped { header: header(at, frame), force, torque })
}

/// Encodes all fields of the frame except its codes.
pub fn frame(frame: &Frame, at: Duration, name: &str) -> Vec<u8> {
    let signals = frame.signals;
    cdr(&FrameMessage {
        header: header(at, name),
        device_us: frame.time.0,
        seq: frame.seq,
        status: frame.status.0,
        force: frame.force.iter().flat_map(forces).collect(),
        point: values(frame.point, |point| [metres(point.x.0), metres(point.y.0)]),
        torsion: values(frame.torsion, |torsion| [torsion.0 * 1e-3]),
        slip: values(frame.slip, |slip| [slip.margin, slip.friction, slip.grip.0]),
        contacts: values(frame.contacts, |[a, b]| {
            let [ax, ay, bx, by] =
                [a.point.x, a.point.y, b.point.x, b.point.y].map(|mm| metres(mm.0));
            [ax, ay, a.normal.0, bx, by, b.normal.0]
        }),
        sensors: frame.sensors.iter().flatten().flat_map(forces).collect(),
        taxels: signals.and_then(|s| s.taxels).map_or(Vec::new(), |taxels| taxels.to_vec()),
        bridges: signals.iter().flat_map(bridges).collect(),
    })
}

fn header(at: Duration, name: &str) -> Header<'_> {
    // ROS seconds are 32 bits and end in 2038.
    let sec = i32::try_from(at.as_secs()).unwrap_or(i32::MAX);
    Header { stamp: Time { sec, nanosec: at.subsec_nanos() }, frame_id: name }
}

fn metres(mm: f32) -> f32 {
    mm * 1e-3
}

fn forces(force: &Force) -> [Value; 3] {
    [force.x, force.y, force.z].map(|axis| value(axis.map(|Newtons(newtons)| newtons)))
}

fn bridges(signals: &Signals) -> impl Iterator<Item = Value> {
    let bridges = signals.bridges;
    (0..SENSORS).flat_map(move |i| match bridges[i] {
        Some(axes) => axes.map(|axis| value(Ok(axis))),
        None => [value(Err(NoValue::Absent)); 3],
    })
}

/// Converts a field to its values. Empty if not streamed; one reason for each value if it has none.
fn values<T, const N: usize>(
    field: Option<Measured<T>>,
    numbers: impl FnOnce(T) -> [f32; N],
) -> Vec<Value> {
    match field {
        None => Vec::new(),
        Some(Ok(given)) => numbers(given).map(|number| value(Ok(number))).to_vec(),
        Some(Err(why)) => vec![value(Err(why)); N],
    }
}

fn value(measured: Measured<f32>) -> Value {
    match measured {
        Ok(value) => Value { value, withheld: 0 },
        // Zero marks a value; the wire counts reasons from zero.
        Err(why) => Value { value: 0.0, withheld: why as u8 + 1 },
    }
}

/// Encodes a message after the four bytes that mark little-endian CDR.
fn cdr(message: &impl Serialize) -> Vec<u8> {
    let mut bytes = vec![0, 1, 0, 0];
    // Writing these structures to a vector cannot fail.
    let written = to_writer::<_, byteorder::LittleEndian, _>(&mut bytes, message);
    debug_assert!(written.is_ok());
    bytes
}

#[cfg(test)]
mod tests {
    use taxel::estimate::ContactPoint;
    use taxel::units::{Millimetres, NewtonMillimetres};

    use super::*;

    fn pressed(torsion: Option<Measured<NewtonMillimetres>>) -> Frame {
        let newtons = |newtons| Ok(Newtons(newtons));
        Frame {
            force: Some(Force { x: newtons(0.5), y: newtons(0.0), z: newtons(2.0) }),
            point: Some(Ok(ContactPoint { x: Millimetres(1.0), y: Millimetres(3.0) })),
            torsion,
            ..Frame::default()
        }
    }

    fn moment(torsion: Option<Measured<NewtonMillimetres>>) -> Option<[i32; 3]> {
        let [_, moment] = wrench(&pressed(torsion))?;
        Some(moment.map(|metres| (metres * 1e6).round() as i32))
    }

    #[test]
    fn wrench_has_the_torsion() {
        assert_eq!(moment(Some(Ok(NewtonMillimetres(2.5)))), Some([6000, -2000, 1000]));
    }

    #[test]
    fn wrench_is_withheld_when_torsion_is_missing() {
        assert_eq!(moment(None), None);
        for why in [NoValue::Saturated, NoValue::DeadChannel, NoValue::OutOfTrainedRange] {
            assert_eq!(moment(Some(Err(why))), None, "{why:?}");
        }
    }

    #[test]
    fn finger_without_array_has_a_wrench() {
        for why in [NoValue::Absent, NoValue::NotEstimated, NoValue::Uncalibrated] {
            assert_eq!(moment(Some(Err(why))), Some([6000, -2000, -1500]), "{why:?}");
        }
    }

    #[test]
    fn finger_calibrated_by_forces_alone_has_a_wrench() {
        let unknown = Some(Err(NoValue::IllConditioned));
        assert_eq!(moment(unknown), Some([6000, -2000, -1500]));
        let firm = pressed(unknown);
        assert!(never_torsion(&firm));
        let force = firm.force.map(|force| Force { z: Ok(Newtons(0.02)), ..force });
        assert!(!never_torsion(&Frame { force, ..firm }), "a light touch tells nothing");
    }
}
