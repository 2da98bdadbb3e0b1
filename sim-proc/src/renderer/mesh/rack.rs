//! The racks: a bay of shelves behind each open face, a sheet of steel over each closed one.
//!
//! The frame of a face: x to the viewer's right, y into the rack, z up, with the origin on the floor in the middle of the
//! face, which is 1 m wide.

use super::builder::{Detail, Material, Mesh, MeshBuilder, Side};

/// Height of the shelf that items stand on, in metres.
pub(crate) const SHELF_TOP_M: f32 = 0.80;

/// Height of the racks and their back panels, in metres. Nothing behind a rack that is no taller is visible from the
/// camera's height.
pub(crate) const RACK_HEIGHT_M: f32 = 3.0;

/// Depth of a bay, in metres.
pub(crate) const BAY_DEPTH_M: f32 = 0.62;

/// Depth of a bay that shares its rack square with another, in metres.
pub(crate) const SHALLOW_BAY_DEPTH_M: f32 = 0.29;

/// The label on the shelf's edge, in the frame of the face: left, bottom, right, top.
pub(crate) const LABEL_M: [f32; 4] = [-0.46, 0.682, 0.46, 0.797];

/// The bay's number on the upper beam, likewise.
pub(crate) const BAY_NUMBER_M: [f32; 4] = [-0.16, 1.85, 0.16, 1.918];

/// Ends of the sheet of a closed face, on the floor plan.
pub(crate) const CLOSED_FACE_OCCLUDER_M: [[f32; 2]; 2] = [[-0.494, 0.034], [0.494, 0.034]];

/// How far panels with text stand out from the face, in metres.
pub(crate) const PANEL_OFFSET_M: f32 = 0.012;

const UPRIGHT: Material = Material::dull([52, 74, 108]);
const BEAM: Material = Material::dull([212, 104, 44]);
const DECK: Material = Material::dull([150, 152, 152]);
const SHEET: Material = Material::dull([206, 209, 208]);
const END_SHEET: Material = Material::dull([122, 136, 152]);
const PALLET: Material = Material::dull([150, 124, 92]);
const FLOOR: Material = Material::dull([118, 118, 115]);
const STRAP: Material = Material::dull([70, 70, 66]);

const LOWER_DECK_M: f32 = 0.77;
const UPPER_DECK_M: f32 = 1.86;
const HALF_UPRIGHT_M: f32 = 0.035;
const BEAM_M: f32 = 0.04;
/// The bottom of upright parts, so that no gap opens between them and the floor.
const BELOW_FLOOR_M: f32 = -0.01;
/// How far the floor under a closed face extends to both sides: around the corner, under the aisle's floor.
const UNDER_M: f32 = 0.53;
/// The depth of sheets that cover a face, and where a sheet that narrows a bay ends.
const COVER_M: f32 = 0.02;
const COVER_END_M: f32 = 0.48;

/// How a bay ends to its left or right.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum BayEdge {
    /// The row continues with another bay.
    Joined,
    /// The row continues with a bay that is only this deep.
    Step(f32),
    /// The row continues with a closed face or a wall: a side sheet and a whole upright end the bay.
    Ended,
    /// The row ends here, with a closed face around the corner. A side sheet and a whole upright end the bay.
    Closed,
    /// Around the corner is another bay, this deep: a sheet covers this face as far as that bay reaches.
    Narrowed(f32),
}

impl BayEdge {
    /// Where shelves, floor and back panel end, in metres from the bay's middle.
    fn inside(self) -> f32 {
        match self {
            Self::Joined | Self::Step(_) => 0.5,
            Self::Ended | Self::Closed => 0.46,
            Self::Narrowed(depth) => 0.5 - depth,
        }
    }

    /// Where the beams along the face end.
    fn beam(self) -> f32 {
        match self {
            Self::Narrowed(_) => 0.5,
            Self::Joined | Self::Step(_) | Self::Ended | Self::Closed => self.inside(),
        }
    }

    /// The upright: half of one that is shared with the next bay, or a whole one that is set back from the planes of the
    /// face around the corner.
    fn upright(self) -> [f32; 2] {
        match self {
            Self::Joined | Self::Step(_) => [0.5 - HALF_UPRIGHT_M, 0.5],
            Self::Ended => [0.44, 0.51],
            Self::Closed => [0.44, 0.49],
            Self::Narrowed(depth) => [0.5 - depth - HALF_UPRIGHT_M, 0.5 - depth + HALF_UPRIGHT_M],
        }
    }

    /// The sheet that closes the bay on this side: its distance from the middle, and the depth where it begins.
    fn side_sheet(self) -> Option<(f32, f32)> {
        match self {
            Self::Joined => None,
            Self::Step(depth) => Some((0.5, depth)),
            Self::Ended | Self::Closed | Self::Narrowed(_) => Some((self.inside(), COVER_M)),
        }
    }
}

/// One bay of a rack.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RackBay {
    pub(crate) left: BayEdge,
    pub(crate) right: BayEdge,
    pub(crate) depth: f32,
    /// Whether an item stands in it.
    pub(crate) stocked: bool,
    /// Whether a plate hangs in it.
    pub(crate) plate: bool,
    /// Determines the loads above and below the item.
    pub(crate) seed: u32,
}

impl RackBay {
    /// The bay's occluders on the floor plan: back panel, sides and uprights.
    pub(crate) fn occluders(&self) -> Vec<[[f32; 2]; 2]> {
        let d = self.depth;
        let mut occluders = vec![[[-self.left.inside(), d], [self.right.inside(), d]]];
        for (edge, sign) in [(self.left, -1.0), (self.right, 1.0)] {
            occluders.push(edge.upright().map(|x| [sign * x, 0.04]));
            occluders.extend(edge.side_sheet().map(|(x, y)| [[sign * x, y], [sign * x, d]]));
            if let BayEdge::Narrowed(_) = edge {
                occluders.push([[sign * edge.inside(), COVER_M], [sign * COVER_END_M, COVER_M]]);
            }
        }
        occluders
    }

    /// Uprights, beams, shelves, panels and filler loads.
    pub(crate) fn mesh(&self, detail: Detail) -> Mesh {
        let mut b = MeshBuilder::new(detail);
        // Front to back, so that little is drawn over.
        if self.plate {
            plate_holder(&mut b);
        }
        self.uprights(&mut b);
        self.shelf(&mut b, LOWER_DECK_M, SHELF_TOP_M, 0.66);
        self.shelf(&mut b, UPPER_DECK_M, UPPER_DECK_M + 0.06, UPPER_DECK_M - 0.03);
        self.loads(&mut b);
        self.sheets(&mut b);
        b.finish()
    }

    fn sides(&self) -> [(BayEdge, f32); 2] {
        [(self.left, -1.0), (self.right, 1.0)]
    }

    fn uprights(&self, b: &mut MeshBuilder) {
        b.material(UPRIGHT);
        for (edge, sign) in self.sides() {
            let [near, far] = edge.upright().map(|x| sign * x);
            // In front of a wall it protrudes slightly, to cover the end of the wall.
            let front = if edge == BayEdge::Ended { -0.004 } else { 0.01 };
            let (min, max) =
                ([near.min(far), front, BELOW_FLOOR_M], [near.max(far), 0.07, RACK_HEIGHT_M]);
            b.block_without(min, max, &[Side::Bottom, Side::Back, Side::Top]);
        }
    }

    /// Floor, back panel and side sheets.
    fn sheets(&self, b: &mut MeshBuilder) {
        let (l, r, d) = (-self.left.inside(), self.right.inside(), self.depth);
        let sides = self.sides();
        // Slightly lower than the aisle's floor, and reaching slightly under it.
        let (near, z) = (-0.02, -0.003);
        let under = |edge: BayEdge| if edge == BayEdge::Ended { 0.5 } else { edge.inside() };
        b.material(FLOOR);
        let (left, right) = (-under(self.left), under(self.right));
        b.polygon(&[[left, near, z], [right, near, z], [right, d, z], [left, d, z]]);
        // In three pieces, so that shade can differ between shelves. They join behind the decks and share corners: a
        // gap as wide as a rounding error would show what is behind.
        let joints = [BELOW_FLOOR_M, LOWER_DECK_M + 0.015, UPPER_DECK_M + 0.03, RACK_HEIGHT_M];
        let heights = [0, 1, 2].map(|i| (joints[i], joints[i + 1]));
        for (low, high) in heights {
            b.material(SHEET);
            upright(b, l, r, d, low, high);
            for (edge, sign) in sides {
                let Some((out, y)) = edge.side_sheet() else { continue };
                let x = sign * out;
                let mut side = [[x, y, low], [x, d, low], [x, d, high], [x, y, high]];
                if sign > 0.0 {
                    side.reverse();
                }
                b.polygon(&side);
            }
        }
        for (edge, sign) in sides {
            if let BayEdge::Narrowed(_) = edge {
                let (p, q) = (sign * edge.inside(), sign * COVER_END_M);
                let (x0, x1) = (p.min(q), p.max(q));
                b.material(END_SHEET);
                upright(b, x0, x1, COVER_M, BELOW_FLOOR_M, RACK_HEIGHT_M);
                b.material(FLOOR);
                let (x0, x1) = (x0.min(UNDER_M * sign), x1.max(UNDER_M * sign));
                let (y, z) = (0.1, z - 0.003);
                b.polygon(&[[x0, near, z], [x1, near, z], [x1, y, z], [x0, y, z]]);
            }
        }
    }

    /// A deck with its front beam, which reaches down to `beam_bottom`.
    fn shelf(&self, b: &mut MeshBuilder, bottom: f32, top: f32, beam_bottom: f32) {
        let hidden = [Side::Left, Side::Right, Side::Back, Side::Front];
        b.material(DECK);
        let (l, r) = (-self.left.inside(), self.right.inside());
        b.block_without([l, BEAM_M, bottom], [r, self.depth, top], &hidden);
        b.material(BEAM);
        let (l, r) = (-self.left.beam(), self.right.beam());
        b.block_without([l, 0.0, beam_bottom], [r, BEAM_M, top], &hidden[2..3]);
    }

    /// What fills the shelves without an item: wrapped loads on pallets, in muted colours.
    fn loads(&self, b: &mut MeshBuilder) {
        let (l, r) = (0.06 - self.left.inside(), self.right.inside() - 0.06);
        for (level, (floor, room)) in
            [(0.0, 0.60), (UPPER_DECK_M + 0.06, 1.0)].into_iter().enumerate()
        {
            let dice = self.seed.wrapping_mul(2_654_435_761).rotate_left(9 + 7 * level as u32);
            if dice.is_multiple_of(7) && self.stocked {
                continue; // Some places are empty.
            }
            let (front, back) = (0.085, self.depth - 0.02);
            let top = floor + room * (0.72 + 0.05 * (dice / 7 % 5) as f32);
            b.material(PALLET);
            b.block_without([l, front, floor + 0.075], [r, back, floor + 0.11], &[Side::Back]);
            b.small(|b| {
                let hidden = [Side::Back, Side::Bottom, Side::Top];
                let middle = (l + r) / 2.0;
                for x in [l, middle - 0.05, r - 0.1] {
                    let (min, max) = ([x, front + 0.01, floor], [x + 0.1, back, floor + 0.075]);
                    b.block_without(min, max, &hidden);
                }
            });
            let wraps = [
                [148, 142, 132],
                [136, 132, 126],
                [158, 150, 136],
                [142, 144, 146],
                [128, 122, 114],
            ];
            let wrap = Material::dull(wraps[(dice / 35 % 5) as usize]);
            b.material(wrap);
            let inset = 0.02 + 0.01 * (dice / 175 % 3) as f32;
            let (l, r, front) = (l + inset, r - inset, front + 0.015);
            b.bevelled([l, front, floor + 0.11], [r, back, top], 0.02);
            b.small(|b| {
                b.material(STRAP);
                for share in [0.27, 0.73] {
                    let x = l + (r - l) * share;
                    upright(b, x - 0.009, x + 0.009, front - 0.003, floor + 0.112, top - 0.02);
                }
                b.material(wrap.shaded(0.86));
                let seam = floor + 0.11 + (top - floor - 0.11) * 0.5;
                upright(b, l + 0.02, r - 0.02, front - 0.0015, seam, seam + 0.012);
            });
        }
    }
}

/// A rectangle facing the viewer.
fn upright(b: &mut MeshBuilder, x0: f32, x1: f32, y: f32, z0: f32, z1: f32) {
    b.polygon(&[[x0, y, z0], [x1, y, z0], [x1, y, z1], [x0, y, z1]]);
}

/// The two rods and the board that carry a label plate.
fn plate_holder(b: &mut MeshBuilder) {
    let half = plates::SIZE_M / 2.0 - 0.002;
    let (front, back) = (-plates::FACE_OFFSET_M + 0.001, -0.008);
    let (low, high) = (plates::CENTRE_HEIGHT_M - half, plates::CENTRE_HEIGHT_M + half);
    b.material(Material::dull([72, 76, 82]));
    b.block_without([-half, front, low], [half, back, high], &[Side::Front]);
    for x in [-0.12, 0.12] {
        let hidden = [Side::Bottom, Side::Top];
        b.block_without(
            [x - 0.008, front + 0.002, high],
            [x + 0.008, back, UPPER_DECK_M - 0.02],
            &hidden,
        );
    }
}

/// A closed face: corrugated steel between two posts, with a kick plate and a bumper.
pub(crate) fn closed_face() -> Mesh {
    let mut b = MeshBuilder::new(Detail::Near);
    b.material(END_SHEET);
    // Corrugation: alternating planes joined by narrow slopes.
    let (near, far, ribs) = (0.02, 0.034, 6);
    let step = 0.96 / ribs as f32;
    for i in 0..ribs {
        let x = -0.48 + step * i as f32;
        let xs = [x, x + step * 0.42, x + step * 0.5, x + step * 0.92, x + step];
        let ys = [near, near, far, far, near];
        for k in 0..4 {
            let (x0, x1, y0, y1) = (xs[k], xs[k + 1], ys[k], ys[k + 1]);
            b.polygon(&[
                [x0, y0, 0.1],
                [x1, y1, 0.1],
                [x1, y1, RACK_HEIGHT_M],
                [x0, y0, RACK_HEIGHT_M],
            ]);
        }
    }
    b.material(UPRIGHT);
    // The posts keep clear of the planes of a bay around the corner.
    for x in [-0.494, 0.47] {
        b.block_without(
            [x, 0.008, BELOW_FLOOR_M],
            [x + 0.024, 0.06, RACK_HEIGHT_M],
            &[Side::Bottom, Side::Back, Side::Top],
        );
    }
    b.material(Material::dull([58, 60, 64]));
    b.block_without([-0.48, 0.012, BELOW_FLOOR_M], [0.48, 0.04, 0.12], &[Side::Back, Side::Bottom]);
    b.material(FLOOR);
    let (near, far, z) = (-0.02, 0.1, -0.006);
    b.polygon(&[[-UNDER_M, near, z], [UNDER_M, near, z], [UNDER_M, far, z], [-UNDER_M, far, z]]);
    b.finish()
}
