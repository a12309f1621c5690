//! Contact as ROS 2 messages: its point, an arrow of its force, and its frame.

use std::time::Duration;

use serde::Serialize;
use taxel_files::recording::{Contact, contact_frame};

use super::super::tool::Tool;
use super::{Header, Point, Quaternion, Time, Type, Vector3, cdr, header};

/// `geometry_msgs/msg/PointStamped`.
pub const POINT: Type = Type {
    name: "geometry_msgs::msg::dds_::PointStamped_",
    hash: "RIHS01_4c0296af86e01e562e9e0405d138a01537247580076c58ea38d7923ac1045897",
};

/// `visualization_msgs/msg/Marker`.
pub const MARKER: Type = Type {
    name: "visualization_msgs::msg::dds_::Marker_",
    hash: "RIHS01_45b13ccf791f225962bf74e746f9644518855d783a6f42ba0cc14fde2b4f3ce0",
};

/// `tf2_msgs/msg/TFMessage`.
pub const TF: Type = Type {
    name: "tf2_msgs::msg::dds_::TFMessage_",
    hash: "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
};

/// Diameters of the arrow's shaft and head, and length of its head, in m.
const ARROW_SIZE: Vector3 = Vector3 { x: 0.001, y: 0.002, z: 0.003 };
const GREEN: Colour = Colour { r: 0.1, g: 0.75, b: 0.3, a: 1.0 };

/// `Marker.type` of an arrow between two points.
const TYPE_ARROW: i32 = 0;
const ACTION_ADD: i32 = 0;
const ACTION_DELETE: i32 = 2;

fn place(contact: &Contact) -> Point {
    let [x, y] = contact.point;
    Point { x, y, z: 0.0 }
}

#[derive(Serialize)]
struct PointStamped<'n> {
    header: Header<'n>,
    point: Point,
}

#[derive(Serialize)]
struct TfMessage<'n> {
    transforms: Vec<TransformStamped<'n>>,
}

#[derive(Serialize)]
struct TransformStamped<'n> {
    header: Header<'n>,
    child_frame_id: String,
    translation: Vector3,
    rotation: Quaternion,
}

#[derive(Clone, Copy, Serialize)]
struct Colour {
    r: f32,
    g: f32,
    b: f32,
    a: f32,
}

#[derive(Serialize)]
struct Marker<'n> {
    header: Header<'n>,
    ns: &'n str,
    id: i32,
    kind: i32,
    action: i32,
    position: Point,
    orientation: Quaternion,
    scale: Vector3,
    colour: Colour,
    lifetime: Time,
    frame_locked: bool,
    points: Vec<Point>,
    colours: Vec<Colour>,
    texture_resource: &'static str,
    texture: CompressedImage<'n>,
    uv_coordinates: Vec<[f32; 2]>,
    text: &'static str,
    mesh_resource: &'static str,
    mesh_file: MeshFile,
    mesh_use_embedded_materials: bool,
}

#[derive(Serialize)]
struct CompressedImage<'n> {
    header: Header<'n>,
    format: &'static str,
    data: Vec<u8>,
}

#[derive(Serialize)]
struct MeshFile {
    filename: &'static str,
    data: Vec<u8>,
}

/// Encodes the contact point.
pub fn point_stamped(contact: &Contact, at: Duration, name: &str) -> Vec<u8> {
    cdr(&PointStamped { header: header(at, name), point: place(contact) })
}

/// Encodes the arrow of a contact's force, 10 mm for each newton. Without a force it is removed.
pub fn marker(contact: Option<&Contact>, at: Duration, name: &str) -> Vec<u8> {
    let arrow = contact.and_then(Contact::arrow);
    let points = arrow.iter().flatten().map(|&[x, y, z]| Point { x, y, z }).collect();
    let none = Header { stamp: Time { sec: 0, nanosec: 0 }, frame_id: "" };
    cdr(&Marker {
        header: header(at, name),
        ns: name,
        id: 0,
        kind: TYPE_ARROW,
        action: if arrow.is_some() { ACTION_ADD } else { ACTION_DELETE },
        position: Point::ORIGIN,
        orientation: Quaternion::NONE,
        scale: ARROW_SIZE,
        colour: GREEN,
        lifetime: Time { sec: 0, nanosec: 0 },
        frame_locked: true,
        points,
        colours: Vec::new(),
        texture_resource: "",
        texture: CompressedImage { header: none, format: "", data: Vec::new() },
        uv_coordinates: Vec::new(),
        text: "",
        mesh_resource: "",
        mesh_file: MeshFile { filename: "", data: Vec::new() },
        mesh_use_embedded_materials: false,
    })
}

/// Encodes the frames of the contact and of the tool, as children of the finger's. `None` without
/// either.
pub fn tf(
    contact: Option<&Contact>,
    tool: Option<&Tool>,
    at: Duration,
    name: &str,
) -> Option<Vec<u8>> {
    let contact = contact.map(|contact| {
        let Point { x, y, z } = place(contact);
        (contact_frame(name), [x, y, z], Quaternion::NONE)
    });
    let tool = tool.map(|tool| {
        let [x, y, z, w] = tool.quaternion();
        (tool_frame(name), tool.origin(), Quaternion { x, y, z, w })
    });
    let child = |(child_frame_id, [x, y, z], rotation): (String, [f64; 3], _)| TransformStamped {
        header: header(at, name),
        child_frame_id,
        translation: Vector3 { x, y, z },
        rotation,
    };
    let transforms: Vec<_> = contact.into_iter().chain(tool).map(child).collect();
    (!transforms.is_empty()).then(|| cdr(&TfMessage { transforms }))
}

/// Returns the name of the tool's frame.
pub fn tool_frame(name: &str) -> String {
    format!("{name}_tool")
}
