//! Messages of Foxglove's well-known schemas, in Protocol Buffers: Rerun reads these and not their JSON form. Field numbers
//! and types are those of <https://github.com/foxglove/foxglove-sdk/tree/main/schemas/proto>; fields that are not written
//! are left out of the descriptors. Times are in nanoseconds from the beginning of the file.

use domain::camera::CameraSetup;
use domain::{Heading, Pose};
use world_client::EventLevel;

use super::protobuf::ProtobufMessage;

/// The type of a field, with the name of a message or enum.
#[derive(Clone, Copy)]
enum Type {
    Double,
    Int64,
    Int32,
    Text,
    Message(&'static str),
    Bytes,
    Enum(&'static str),
}

use Type::{Bytes, Double, Int32, Int64, Text};

impl Type {
    /// The number in `FieldDescriptorProto.Type`.
    const fn code(self) -> u64 {
        match self {
            Self::Double => 1,
            Self::Int64 => 3,
            Self::Int32 => 5,
            Self::Text => 9,
            Self::Message(_) => 11,
            Self::Bytes => 12,
            Self::Enum(_) => 14,
        }
    }
}

/// Names and types; fields are numbered from 1.
type Fields = &'static [(&'static str, Type)];

const TIME: Type = Type::Message(".google.protobuf.Timestamp");
const VECTOR: Type = Type::Message(".foxglove.Vector3");
const QUATERNION: Type = Type::Message(".foxglove.Quaternion");
const POSE: Type = Type::Message(".foxglove.Pose");
const LEVEL: Type = Type::Enum(".foxglove.Log.Level");

const TIMESTAMP: (&str, Fields) = ("Timestamp", &[("seconds", Int64), ("nanos", Int32)]);

const MESSAGES: [(&str, Fields); 7] = [
    ("Vector3", &[("x", Double), ("y", Double), ("z", Double)]),
    ("Quaternion", &[("x", Double), ("y", Double), ("z", Double), ("w", Double)]),
    ("Pose", &[("position", VECTOR), ("orientation", QUATERNION)]),
    ("PoseInFrame", &[("timestamp", TIME), ("frame_id", Text), ("pose", POSE)]),
    (
        "FrameTransform",
        &[
            ("timestamp", TIME),
            ("parent_frame_id", Text),
            ("child_frame_id", Text),
            ("translation", VECTOR),
            ("rotation", QUATERNION),
        ],
    ),
    (
        "CompressedImage",
        &[("timestamp", TIME), ("data", Bytes), ("format", Text), ("frame_id", Text)],
    ),
    ("Log", &[("timestamp", TIME), ("level", LEVEL), ("message", Text), ("name", Text)]),
];

/// The levels of a log message, by number.
const LEVELS: [&str; 6] = ["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"];

/// The `FileDescriptorSet` that describes all messages.
pub(super) fn descriptor_set() -> Vec<u8> {
    ProtobufMessage::of(|set| {
        set.nested(1, |file| {
            file.text(1, "google/protobuf/timestamp.proto");
            file.text(2, "google.protobuf");
            file.nested(4, |message| describe(message, TIMESTAMP));
            file.text(12, "proto3");
        });
        set.nested(1, |file| {
            file.text(1, "foxglove/memtransfer.proto");
            file.text(2, "foxglove");
            file.text(3, "google/protobuf/timestamp.proto");
            for message in MESSAGES {
                file.nested(4, |out| describe(out, message));
            }
            file.text(12, "proto3");
        });
    })
}

/// Writes a `DescriptorProto`.
fn describe(out: &mut ProtobufMessage, (name, fields): (&str, Fields)) {
    out.text(1, name);
    for (number, &(name, kind)) in (1..).zip(fields) {
        out.nested(2, |field| {
            field.text(1, name);
            field.whole(3, number);
            field.whole(4, 1); // LABEL_OPTIONAL
            field.whole(5, kind.code());
            if let Type::Message(of) | Type::Enum(of) = kind {
                field.text(6, of);
            }
        });
    }
    if name == "Log" {
        out.nested(4, |levels| {
            levels.text(1, "Level");
            for (number, name) in (0..).zip(LEVELS) {
                levels.nested(2, |level| {
                    level.text(1, name);
                    level.whole(2, number);
                });
            }
        });
    }
}

fn timestamp(out: &mut ProtobufMessage, at: u64) {
    out.nested(1, |time| {
        time.whole(1, at / super::SECOND);
        time.whole(2, at % super::SECOND);
    });
}

fn vector(out: &mut ProtobufMessage, field: u32, values: &[f64]) {
    out.nested(field, |vector| {
        (1..).zip(values).for_each(|(axis, value)| vector.double(axis, *value));
    });
}

/// The rotation about z, as x, y, z, w, that turns east into `heading`.
fn yaw(heading: Heading) -> [f64; 4] {
    const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
    let (z, w) = match heading {
        Heading::E => (0.0, 1.0),
        Heading::N => (HALF, HALF),
        Heading::W => (1.0, 0.0),
        Heading::S => (-HALF, HALF),
    };
    [0.0, 0.0, z, w]
}

fn position(pose: Pose) -> [f64; 3] {
    [pose.cell.x.into(), pose.cell.y.into(), 0.0]
}

/// `foxglove.CompressedImage`: a view.
pub(super) fn image(at: u64, jpeg: &[u8]) -> Vec<u8> {
    ProtobufMessage::of(|message| {
        timestamp(message, at);
        message.data(2, jpeg);
        message.text(3, "jpeg");
        message.text(4, "camera");
    })
}

/// `foxglove.FrameTransform`: where the agent is.
pub(super) fn agent(at: u64, pose: Pose) -> Vec<u8> {
    transform(at, ["warehouse", "agent"], position(pose), yaw(pose.heading))
}

/// `foxglove.FrameTransform`: where the camera is on the agent. Its z axis points forward, its x axis to the right.
pub(super) fn camera_mount(at: u64, camera: CameraSetup) -> Vec<u8> {
    let height_m = f64::from(camera.height_cm) / 100.0;
    transform(at, ["agent", "camera"], [0.0, 0.0, height_m], [-0.5, 0.5, -0.5, 0.5])
}

fn transform(
    at: u64,
    [parent, child]: [&str; 2],
    translation: [f64; 3],
    rotation: [f64; 4],
) -> Vec<u8> {
    ProtobufMessage::of(|message| {
        timestamp(message, at);
        message.text(2, parent);
        message.text(3, child);
        vector(message, 4, &translation);
        vector(message, 5, &rotation);
    })
}

/// `foxglove.PoseInFrame`: the pose of the agent.
pub(super) fn pose(at: u64, pose: Pose) -> Vec<u8> {
    ProtobufMessage::of(|message| {
        timestamp(message, at);
        message.text(2, "warehouse");
        message.nested(3, |inner| {
            vector(inner, 1, &position(pose));
            vector(inner, 2, &yaw(pose.heading));
        });
    })
}

/// `foxglove.Log`: an event of the episode `name`.
pub(super) fn log(at: u64, level: EventLevel, text: &str, name: &str) -> Vec<u8> {
    let level = match level {
        EventLevel::Info => 2,
        EventLevel::Warning => 3,
        EventLevel::Error => 4,
    };
    ProtobufMessage::of(|message| {
        timestamp(message, at);
        message.whole(2, level);
        message.text(3, text);
        message.text(4, name);
    })
}
