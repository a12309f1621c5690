//! Finger in Foxglove's own schemas, in MCAP files and live: its scene, log and contact.
//!
//! A schema has the fields that are written, by their official numbers. The Python client's tests
//! compare them with Foxglove's.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet, Timestamp,
};
use taxel::frame::Frame;

use super::scene::{Arrow, Contact, Flags, Line, Plate, arrow, contact_frame, plates};

/// Interval of what is drawn, in nanoseconds: 60 a second.
const DRAW: u64 = 16_666_000;

/// Topics of a finger besides that of its frames: ends of their names, and names of their schemas.
pub const TOPICS: [(&str, &str); 4] = [
    ("/scene", "foxglove.SceneUpdate"),
    ("/log", "foxglove.Log"),
    ("/contact", "foxglove.PoseInFrame"),
    ("/tf", "foxglove.FrameTransform"),
];
const SCENE: usize = 0;
const LOG: usize = 1;
const CONTACT: usize = 2;
const TF: usize = 3;

/// Encoder of a stream of frames for [`TOPICS`].
pub struct Standard {
    serial: String,
    flags: Flags,
    /// Time of the last scene.
    drawn: Option<u64>,
    message: Vec<u8>,
}

impl Standard {
    /// Begins a stream of the finger with this serial number.
    #[must_use]
    pub fn new(serial: &str) -> Self {
        let (serial, flags) = (serial.to_owned(), Flags::default());
        Self { serial, flags, drawn: None, message: Vec::new() }
    }

    /// Gives `put` the messages of a frame, each with the position of its topic in [`TOPICS`].
    ///
    /// `nanos` is the frame's time in nanoseconds since 1970. A line of the log is a flag that was
    /// raised. A contact with a place has a pose, with the x axis along its force, and a frame.
    ///
    /// # Errors
    /// The first error of `put`.
    pub fn messages<E>(
        &mut self,
        frame: &Frame,
        nanos: u64,
        mut put: impl FnMut(usize, &[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        for line in self.flags.raised(frame) {
            self.message.clear();
            self.log(&line, nanos).encode_raw(&mut self.message);
            put(LOG, &self.message)?;
        }
        if self.drawn.is_none_or(|drawn| nanos.abs_diff(drawn) >= DRAW) {
            self.drawn = Some(nanos);
            let arrow = arrow(frame);
            self.message.clear();
            self.scene(&plates(frame), arrow, nanos).encode_raw(&mut self.message);
            put(SCENE, &self.message)?;
            let Some(contact) = Contact::of(frame) else { return Ok(()) };
            let ([x, y], turn) = (contact.point, arrow.map_or(NO_TURN, |arrow| arrow.turn));
            self.message.clear();
            self.contact([x, y, 0.0], turn, nanos).encode_raw(&mut self.message);
            put(CONTACT, &self.message)?;
            self.message.clear();
            self.frame([x, y, 0.0], nanos).encode_raw(&mut self.message);
            put(TF, &self.message)?;
        }
        Ok(())
    }

    fn contact(&self, place: [f64; 3], turn: [f64; 4], nanos: u64) -> PoseInFrame {
        let frame_id = self.serial.clone();
        PoseInFrame { timestamp: Some(stamp(nanos)), frame_id, pose: pose(place, turn) }
    }

    fn frame(&self, place: [f64; 3], nanos: u64) -> FrameTransform {
        FrameTransform {
            timestamp: Some(stamp(nanos)),
            parent_frame_id: self.serial.clone(),
            child_frame_id: contact_frame(&self.serial),
            translation: three(place),
            rotation: four(NO_TURN),
        }
    }

    /// Draws the finger; what was drawn before disappears.
    fn scene(&self, plates: &[Plate], arrow: Option<Arrow>, nanos: u64) -> SceneUpdate {
        let entity = SceneEntity {
            timestamp: Some(stamp(nanos)),
            frame_id: self.serial.clone(),
            id: "finger".to_owned(),
            frame_locked: true,
            arrows: arrow.into_iter().map(primitive).collect(),
            cubes: plates.iter().map(cube).collect(),
        };
        SceneUpdate { entities: vec![entity] }
    }

    fn log(&self, line: &Line, nanos: u64) -> Log {
        Log {
            timestamp: Some(stamp(nanos)),
            level: if line.fault { ERROR } else { WARNING },
            message: line.text.clone(),
            name: self.serial.clone(),
        }
    }
}

/// Encodes the schema of a topic of [`TOPICS`]: a serialised `FileDescriptorSet`.
#[must_use]
pub fn descriptor(topic: usize) -> Vec<u8> {
    let enums = if topic == LOG { LEVELS.to_vec() } else { Vec::new() };
    let messages: &[Described<'_>] = match topic {
        SCENE => &[SCENE_UPDATE, ENTITY, ARROW, CUBE, POSE, VECTOR, QUATERNION, COLOUR],
        CONTACT => &[POSE_IN_FRAME, POSE, VECTOR, QUATERNION],
        TF => &[FRAME_TRANSFORM, VECTOR, QUATERNION],
        _ => &[LOG_MESSAGE],
    };
    let mut file = FileDescriptorProto {
        name: Some(format!("{}.proto", TOPICS[topic].1.replace('.', "/"))),
        package: Some("foxglove".to_owned()),
        dependency: vec!["google/protobuf/timestamp.proto".to_owned()],
        message_type: messages.iter().map(message).collect(),
        syntax: Some("proto3".to_owned()),
        ..Default::default()
    };
    if let Some(log) = file.message_type.first_mut().filter(|_| !enums.is_empty()) {
        let value = |(name, number): (&str, i32)| EnumValueDescriptorProto {
            name: Some(name.to_owned()),
            number: Some(number),
            options: None,
        };
        log.enum_type = vec![EnumDescriptorProto {
            name: Some("Level".to_owned()),
            value: enums.into_iter().map(value).collect(),
            ..Default::default()
        }];
    }
    let stamp = ("Timestamp", &[("seconds", 1, Is::Long), ("nanos", 2, Is::Int)] as &[_]);
    let time = FileDescriptorProto {
        name: Some("google/protobuf/timestamp.proto".to_owned()),
        package: Some("google.protobuf".to_owned()),
        message_type: vec![message(&stamp)],
        syntax: Some("proto3".to_owned()),
        ..Default::default()
    };
    FileDescriptorSet { file: vec![time, file] }.encode_to_vec()
}

/// Type of a field.
#[derive(Clone, Copy)]
enum Is {
    Double,
    Text,
    Flag,
    Long,
    Int,
    Level,
    Time,
    One(&'static str),
    Many(&'static str),
}

/// Name of a message, and names, numbers and types of its fields.
type Described<'d> = (&'d str, &'d [(&'d str, i32, Is)]);

const SCENE_UPDATE: Described<'_> = ("SceneUpdate", &[("entities", 2, Is::Many("SceneEntity"))]);

const ENTITY: Described<'_> = (
    "SceneEntity",
    &[
        ("timestamp", 1, Is::Time),
        ("frame_id", 2, Is::Text),
        ("id", 3, Is::Text),
        ("frame_locked", 5, Is::Flag),
        ("arrows", 7, Is::Many("ArrowPrimitive")),
        ("cubes", 8, Is::Many("CubePrimitive")),
    ],
);

const ARROW: Described<'_> = (
    "ArrowPrimitive",
    &[
        ("pose", 1, Is::One("Pose")),
        ("shaft_length", 2, Is::Double),
        ("shaft_diameter", 3, Is::Double),
        ("head_length", 4, Is::Double),
        ("head_diameter", 5, Is::Double),
        ("color", 6, Is::One("Color")),
    ],
);

const CUBE: Described<'_> = (
    "CubePrimitive",
    &[
        ("pose", 1, Is::One("Pose")),
        ("size", 2, Is::One("Vector3")),
        ("color", 3, Is::One("Color")),
    ],
);

const POSE: Described<'_> =
    ("Pose", &[("position", 1, Is::One("Vector3")), ("orientation", 2, Is::One("Quaternion"))]);

const VECTOR: Described<'_> =
    ("Vector3", &[("x", 1, Is::Double), ("y", 2, Is::Double), ("z", 3, Is::Double)]);

const QUATERNION: Described<'_> = (
    "Quaternion",
    &[("x", 1, Is::Double), ("y", 2, Is::Double), ("z", 3, Is::Double), ("w", 4, Is::Double)],
);

const COLOUR: Described<'_> = (
    "Color",
    &[("r", 1, Is::Double), ("g", 2, Is::Double), ("b", 3, Is::Double), ("a", 4, Is::Double)],
);

const POSE_IN_FRAME: Described<'_> = (
    "PoseInFrame",
    &[("timestamp", 1, Is::Time), ("frame_id", 2, Is::Text), ("pose", 3, Is::One("Pose"))],
);

const FRAME_TRANSFORM: Described<'_> = (
    "FrameTransform",
    &[
        ("timestamp", 1, Is::Time),
        ("parent_frame_id", 2, Is::Text),
        ("child_frame_id", 3, Is::Text),
        ("translation", 4, Is::One("Vector3")),
        ("rotation", 5, Is::One("Quaternion")),
    ],
);

const LOG_MESSAGE: Described<'_> = (
    "Log",
    &[
        ("timestamp", 1, Is::Time),
        ("level", 2, Is::Level),
        ("message", 3, Is::Text),
        ("name", 4, Is::Text),
    ],
);

const WARNING: i32 = 3;
const ERROR: i32 = 4;
const LEVELS: [(&str, i32); 6] = [
    ("UNKNOWN", 0),
    ("DEBUG", 1),
    ("INFO", 2),
    ("WARNING", WARNING),
    ("ERROR", ERROR),
    ("FATAL", 5),
];

fn message((name, fields): &Described<'_>) -> DescriptorProto {
    let field = |(name, number, is): &(&str, i32, Is)| {
        let message = |name: &str| (Type::Message, Some(format!(".foxglove.{name}")));
        let (kind, type_name) = match is {
            Is::Double => (Type::Double, None),
            Is::Text => (Type::String, None),
            Is::Flag => (Type::Bool, None),
            Is::Long => (Type::Int64, None),
            Is::Int => (Type::Int32, None),
            Is::Level => (Type::Enum, Some(".foxglove.Log.Level".to_owned())),
            Is::Time => (Type::Message, Some(".google.protobuf.Timestamp".to_owned())),
            Is::One(of) | Is::Many(of) => message(of),
        };
        let many = matches!(is, Is::Many(_));
        FieldDescriptorProto {
            name: Some((*name).to_owned()),
            number: Some(*number),
            label: Some(if many { Label::Repeated } else { Label::Optional }.into()),
            r#type: Some(kind.into()),
            type_name,
            ..Default::default()
        }
    };
    DescriptorProto {
        name: Some((*name).to_owned()),
        field: fields.iter().map(field).collect(),
        ..Default::default()
    }
}

/// Turn of what is not turned.
const NO_TURN: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

#[derive(Message)]
struct PoseInFrame {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(message, optional, tag = "3")]
    pose: Option<Pose>,
}

#[derive(Message)]
struct FrameTransform {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    parent_frame_id: String,
    #[prost(string, tag = "3")]
    child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    translation: Option<Three>,
    #[prost(message, optional, tag = "5")]
    rotation: Option<Four>,
}

#[derive(Message)]
struct SceneUpdate {
    #[prost(message, repeated, tag = "2")]
    entities: Vec<SceneEntity>,
}

#[derive(Message)]
struct SceneEntity {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(string, tag = "3")]
    id: String,
    #[prost(bool, tag = "5")]
    frame_locked: bool,
    #[prost(message, repeated, tag = "7")]
    arrows: Vec<ArrowPrimitive>,
    #[prost(message, repeated, tag = "8")]
    cubes: Vec<CubePrimitive>,
}

#[derive(Message)]
struct ArrowPrimitive {
    #[prost(message, optional, tag = "1")]
    pose: Option<Pose>,
    #[prost(double, tag = "2")]
    shaft_length: f64,
    #[prost(double, tag = "3")]
    shaft_diameter: f64,
    #[prost(double, tag = "4")]
    head_length: f64,
    #[prost(double, tag = "5")]
    head_diameter: f64,
    #[prost(message, optional, tag = "6")]
    color: Option<Four>,
}

#[derive(Message)]
struct CubePrimitive {
    #[prost(message, optional, tag = "1")]
    pose: Option<Pose>,
    #[prost(message, optional, tag = "2")]
    size: Option<Three>,
    #[prost(message, optional, tag = "3")]
    color: Option<Four>,
}

#[derive(Message)]
struct Pose {
    #[prost(message, optional, tag = "1")]
    position: Option<Three>,
    #[prost(message, optional, tag = "2")]
    orientation: Option<Four>,
}

/// `Vector3`.
#[derive(Clone, Copy, Message)]
struct Three {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
}

/// `Quaternion` (x, y, z, w) or `Color` (r, g, b, a).
#[derive(Clone, Copy, Message)]
struct Four {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
    #[prost(double, tag = "4")]
    w: f64,
}

#[derive(Message)]
struct Log {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(int32, tag = "2")]
    level: i32,
    #[prost(string, tag = "3")]
    message: String,
    #[prost(string, tag = "4")]
    name: String,
}

fn stamp(nanos: u64) -> Timestamp {
    const SECOND: u64 = 1_000_000_000;
    Timestamp { seconds: (nanos / SECOND) as i64, nanos: (nanos % SECOND) as i32 }
}

fn three([x, y, z]: [f64; 3]) -> Option<Three> {
    Some(Three { x, y, z })
}

fn four([x, y, z, w]: [f64; 4]) -> Option<Four> {
    Some(Four { x, y, z, w })
}

fn pose(place: [f64; 3], turn: [f64; 4]) -> Option<Pose> {
    Some(Pose { position: three(place), orientation: four(turn) })
}

fn cube(plate: &Plate) -> CubePrimitive {
    CubePrimitive {
        pose: pose(plate.middle, NO_TURN),
        size: three(plate.size),
        color: four(plate.colour),
    }
}

/// Draws an arrow whose head takes at most a third of it.
fn primitive(Arrow { tail, turn, length }: Arrow) -> ArrowPrimitive {
    let head_length = (length / 3.0).min(0.003);
    ArrowPrimitive {
        pose: pose(tail, turn),
        shaft_length: length - head_length,
        shaft_diameter: 0.001,
        head_length,
        head_diameter: 0.002,
        color: four([0.1, 0.75, 0.3, 1.0]),
    }
}
