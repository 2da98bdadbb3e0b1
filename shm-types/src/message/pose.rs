//! A pose on the wire.

use bytemuck::{Pod, Zeroable};
use domain::{Heading, Pose, UnknownCode};
use iceoryx2::prelude::ZeroCopySend;

use crate::layout::{Field, FieldType, Struct, WireLayout, WireType};

/// A pose on the wire: column, row, heading code, and a zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[repr(C)]
#[type_name("memtransfer.WirePose")]
pub struct WirePose(pub [u8; 4]);

impl WireType for WirePose {
    const SHAPE: FieldType = FieldType::Struct("WirePose");
}

impl WireLayout for WirePose {
    const LAYOUT: Struct = {
        const fn byte(offset: usize, name: &'static str, doc: &'static str) -> Field {
            Field { name, shape: u8::SHAPE, offset, bytes: 1, doc }
        }
        Struct {
            name: "WirePose",
            type_name: "memtransfer.WirePose",
            doc: "A pose: a cell and a heading.",
            bytes: size_of::<Self>(),
            align: align_of::<Self>(),
            fields: &[
                byte(0, "x", "Column, growing east."),
                byte(1, "y", "Row, growing north."),
                byte(2, "heading", "Code of the [`Heading`]."),
                byte(3, "reserved", "Zero."),
            ],
        }
    };
}

impl From<Pose> for WirePose {
    fn from(pose: Pose) -> Self {
        Self([pose.cell.x, pose.cell.y, pose.heading as u8, 0])
    }
}

impl TryFrom<WirePose> for Pose {
    type Error = UnknownCode;

    fn try_from(WirePose([x, y, heading, _]): WirePose) -> Result<Self, UnknownCode> {
        Ok(Self::new(x, y, Heading::try_from(heading)?))
    }
}
