//! World states: a warehouse after things have changed in it.

use domain::Cell;
use serde::{Deserialize, Serialize};

use crate::asset::Problem;
use crate::dynamics::Variant;
use crate::world::{Item, Warehouse, faced_bay};

/// The difference between a world state and the warehouse it is a state of. The default is no difference.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldChange {
    /// The cells closed by a barricade, sorted.
    pub closed: Vec<Cell>,
    /// The bays that hold something else, sorted by standpoint, each once.
    pub stock: Vec<StockChange>,
}

/// What a bay holds in a world state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StockChange {
    /// The bay's standpoint: a free cell beside exactly one rack.
    pub standpoint: Cell,
    /// The index in [`Catalogue::types`](crate::Catalogue::types) of the type of item that it holds; `None` if it is empty.
    pub item_type: Option<usize>,
}

/// Why a [`WorldChange`] does not fit a warehouse.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct WorldChangeError(Problem);

/// A warehouse with its changed stock, and its closed cells.
///
/// Items are numbered anew by standpoint, so ids of one state mean nothing in another. Types and categories keep their
/// indices.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WorldState {
    /// The layout, the catalogue and the changed stock.
    pub warehouse: Warehouse,
    /// The closed cells.
    pub variant: Variant,
}

impl WorldChange {
    /// Whether nothing has changed.
    pub fn is_empty(&self) -> bool {
        self.closed.is_empty() && self.stock.is_empty()
    }
}

impl WorldState {
    /// The state of `base` after `change`.
    ///
    /// # Errors
    /// A closed cell that is not free, a bay without exactly one rack, a type that is unknown or has no item left, a category
    /// with more items than planning allows, lists that are not sorted.
    pub fn new(base: &Warehouse, change: &WorldChange) -> Result<Self, WorldChangeError> {
        Self::build(base, change).map_err(WorldChangeError)
    }

    fn build(base: &Warehouse, change: &WorldChange) -> Result<Self, Problem> {
        let layout = &base.layout;
        if let Some(cell) = change.closed.iter().find(|&&cell| !layout.is_free(cell)) {
            return Err(format!("closed cell {cell} is not free floor"));
        }
        if !change.closed.is_sorted_by(|one, next| one < next) {
            return Err("closed cells must be sorted, each once".into());
        }
        if !change.stock.is_sorted_by(|one, next| one.standpoint < next.standpoint) {
            return Err("stock changes must be sorted by standpoint, each once".into());
        }
        let mut warehouse = base.clone();
        for &StockChange { standpoint, item_type } in &change.stock {
            if !layout.is_free(standpoint) {
                return Err(format!("stock at {standpoint}, which is not free floor"));
            }
            let (rack, face) = faced_bay(layout, standpoint)
                .map_err(|problem| format!("stock at {standpoint}: {problem}"))?;
            warehouse.items.retain(|item| item.standpoint != standpoint);
            if let Some(item_type) = item_type {
                let known = base.catalogue.types.len();
                if item_type >= known {
                    return Err(format!(
                        "stock at {standpoint}: type {item_type}, and the catalogue has {known} types"
                    ));
                }
                warehouse.items.push(Item { id: 0, item_type, rack, face, standpoint });
            }
        }
        warehouse.items.sort_unstable_by_key(|item| (item.standpoint.y, item.standpoint.x));
        for (id, item) in (0..).zip(&mut warehouse.items) {
            item.id = id;
        }
        warehouse.check_sizes()?;
        Ok(Self { warehouse, variant: Variant::closing(change.closed.iter().copied()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{BLUE_BARREL, GREEN_CONE, RED_BARREL, cells, tiny};

    fn change(closed: &[(u8, u8)], stock: &[((u8, u8), Option<usize>)]) -> WorldChange {
        let stock = stock
            .iter()
            .map(|&((x, y), item_type)| StockChange { standpoint: Cell::new(x, y), item_type });
        WorldChange { closed: cells(closed), stock: stock.collect() }
    }

    #[test]
    fn no_change_is_the_warehouse_itself() {
        let base = tiny();
        let state = WorldState::new(&base, &WorldChange::default()).unwrap();
        assert_eq!(state, WorldState { warehouse: base, variant: Variant::UNCHANGED });
    }

    #[test]
    fn items_change_and_are_numbered_anew() {
        let base = tiny();
        let changed = change(&[(3, 2)], &[((0, 1), None), ((6, 3), Some(RED_BARREL))]);
        let state = WorldState::new(&base, &changed).unwrap();
        let items = &state.warehouse.items;
        assert_eq!(items.len(), base.items.len() - 1);
        assert!(items.iter().enumerate().all(|(at, item)| usize::from(item.id) == at));
        assert_eq!(state.warehouse.item_at(Cell::new(0, 1)), None);
        let [before, after] =
            [&base, &state.warehouse].map(|w| *w.item_at(Cell::new(6, 3)).unwrap());
        assert_eq!((before.item_type, after.item_type), (BLUE_BARREL, RED_BARREL));
        assert_eq!((before.rack, before.face), (after.rack, after.face));
        assert!(state.variant.is_closed(Cell::new(3, 2)));
        // A bay that has been emptied can be filled again.
        let emptied = state.warehouse;
        let back = change(&[], &[((0, 1), Some(BLUE_BARREL)), ((6, 3), Some(BLUE_BARREL))]);
        assert_eq!(WorldState::new(&emptied, &back).unwrap().warehouse, base);
    }

    #[test]
    fn a_change_that_does_not_fit_says_where() {
        for (change, expected) in [
            (change(&[(1, 2)], &[]), "closed cell (1, 2) is not free floor"),
            (change(&[(3, 3), (3, 2)], &[]), "closed cells must be sorted"),
            (change(&[], &[((1, 2), None)]), "stock at (1, 2), which is not free floor"),
            (change(&[], &[((0, 1), Some(99))]), "type 99, and the catalogue has 4 types"),
            (change(&[], &[((6, 3), None), ((0, 1), None)]), "sorted by standpoint"),
            (change(&[], &[((3, 1), None)]), "no green cone"),
            (change(&[], &[((3, 2), Some(GREEN_CONE))]), "two racks beside this cell"),
        ] {
            let error = WorldState::new(&tiny(), &change).unwrap_err().to_string();
            assert!(error.contains(expected), "{change:?}: {error}");
        }
    }
}
