//! Label plates: an item's category and type as colours in an image.
//!
//! Every item hangs under a plate on the rack face: a magenta frame around six horizontal bands of
//! unlit, saturated colour. Three bands spell the category and three the type, each group a base-7
//! number hashed from the *name*, so a policy that reads "blue barrel" in its instruction knows the plate
//! without a catalogue. Bands are horizontal because a plate at a grazing angle keeps its height and
//! loses its width.
//!
//! The simulator draws plates; [`read()`] finds them in an image, and [`item_names()`] the names in an instruction.

mod names;
pub mod painter;
mod read;

pub use names::{ItemName, item_names};
pub use read::{Landmark, Sighting, read};

/// Width and height of the plate's outside edge, in metres.
pub const SIZE_M: f32 = 0.36;

/// Width of the magenta frame on all four sides, in metres.
pub const FRAME_M: f32 = 0.03;

/// Height of the plate's centre above the floor, in metres. The plate is centred on its bay and
/// stands [`FACE_OFFSET_M`] in front of the rack face, which lies on the boundary between two cells.
pub const CENTRE_HEIGHT_M: f32 = 1.50;

/// How far the plate stands out from the rack face, in metres.
pub const FACE_OFFSET_M: f32 = 0.02;

/// The frame's colour. Nothing else in the world is drawn in it.
pub const FRAME_RGB: [u8; 3] = [255, 0, 255];

/// The seven colours of bands: every channel is 0 or 255; magenta is left out.
pub const BAND_RGB: [[u8; 3]; 7] = [
    [0, 0, 0],
    [255, 0, 0],
    [0, 255, 0],
    [0, 0, 255],
    [255, 255, 0],
    [0, 255, 255],
    [255, 255, 255],
];

/// Bands on a plate, top to bottom: three for the category, then three for the type.
pub const BANDS: usize = 6;

/// The bands of one plate, top to bottom, as indices into [`BAND_RGB`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Plate(pub [u8; BANDS]);

impl Plate {
    /// The plate of an item of type `item_type` ("blue barrel") in category `category` ("barrels").
    pub fn new(category: &str, item_type: &str) -> Self {
        let ([a, b, c], [d, e, f]) = (code(category), code(item_type));
        Self([a, b, c, d, e, f])
    }
}

/// Three base-7 digits from a name: FNV-1a over its bytes, so any language can compute it.
///
/// Names may collide (343 codes); a catalogue is checked for that when it is loaded.
pub fn code(name: &str) -> [u8; 3] {
    let hash = name
        .bytes()
        .fold(0x811c_9dc5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    let n = hash % 343;
    [(n / 49) as u8, (n / 7 % 7) as u8, (n % 7) as u8]
}
