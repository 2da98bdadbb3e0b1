//! The faces of racks: which are bays of open shelves and which are closed.

use domain::{Cell, Heading};

use crate::layout::{Layout, Square};
use crate::world::Warehouse;

/// What a side of a rack square is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FaceKind {
    /// Not a rack, or no floor in front of it.
    Inner,
    /// A sheet of steel.
    Closed,
    /// Shelves. Bays beside each other, with the same heading, have no wall between them.
    Bay,
}

impl FaceKind {
    /// The side `face` of the square `rack`, where `holds_item` tells which sides of a square hold an item.
    pub fn of(
        layout: &Layout,
        holds_item: impl Fn(Cell, Heading) -> bool,
        rack: Cell,
        face: Heading,
    ) -> Self {
        let is_open = |face| layout.free_neighbour(rack, face).is_some();
        if layout.square(rack) != Square::Rack || !is_open(face) {
            return Self::Inner;
        }
        if holds_item(rack, face) {
            return Self::Bay;
        }
        // Without an item, a face is a bay only if the square holds no other bay.
        let first_open = Heading::ALL.into_iter().find(|&other| is_open(other));
        let any_item = Heading::ALL.into_iter().any(|other| holds_item(rack, other));
        if !any_item && first_open == Some(face) { Self::Bay } else { Self::Closed }
    }
}

impl Warehouse {
    /// What the side `face` of the square `rack` is.
    pub fn face(&self, rack: Cell, face: Heading) -> FaceKind {
        let holds_item =
            |rack, face| self.items.iter().any(|item| (item.rack, item.face) == (rack, face));
        FaceKind::of(&self.layout, holds_item, rack, face)
    }
}
