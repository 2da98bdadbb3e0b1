//! What each mismatch between demonstrations and test is in a warehouse (specification, section 6).

use domain::{Appearance, Cell, Mismatch};

use crate::draw::Draw;
use crate::state::{StockChange, WorldChange};
use crate::task::Task;
use crate::world::{Item, Warehouse};

/// Marks the draws of the pairs of items that change places.
const STOCK_STREAM: u64 = 5 << 56;

/// How the world looks in an episode with this mismatch, where demonstrations look like `standard`: other light has the next
/// seed.
pub const fn appearance(standard: Appearance, mismatch: Mismatch) -> Appearance {
    match mismatch {
        Mismatch::Light => Appearance { seed: standard.seed.wrapping_add(1), ..standard },
        Mismatch::Labels => Appearance { labels: false, ..standard },
        Mismatch::None
        | Mismatch::CameraHeight
        | Mismatch::FieldOfView
        | Mismatch::Wording
        | Mismatch::Stock => standard,
    }
}

/// The pairs of items that can change places: each item is in at most one, and the two of a pair are of different categories.
#[derive(Debug, Clone)]
pub struct ExchangedItems(Vec<[Item; 2]>);

impl ExchangedItems {
    /// The pairs of `warehouse`, drawn from the seed of its cases.
    pub fn draw(warehouse: &Warehouse, seed: u64) -> Self {
        let mut left = Draw::new(seed, STOCK_STREAM).shuffled(warehouse.items.clone());
        let mut pairs = Vec::new();
        while let Some(item) = left.pop() {
            let is_other =
                |other: &Item| warehouse.category_of(other) != warehouse.category_of(&item);
            if let Some(at) = left.iter().rposition(is_other) {
                pairs.push([item, left.remove(at)]);
            }
        }
        Self(pairs)
    }

    /// How the stock differs in an episode with `task`: both items of every pair without an item of the task have changed places.
    pub fn change(&self, warehouse: &Warehouse, task: &Task) -> WorldChange {
        let is_of_task = |item: &Item| task.letter(warehouse, item).is_some();
        let pairs = self.0.iter().filter(|pair| !pair.iter().any(is_of_task));
        let holds = |standpoint: Cell, item: Item| StockChange {
            standpoint,
            item_type: Some(item.item_type),
        };
        let changes = pairs.flat_map(|&[a, b]| [holds(a.standpoint, b), holds(b.standpoint, a)]);
        let mut stock: Vec<StockChange> = changes.collect();
        stock.sort_unstable();
        WorldChange { closed: Vec::new(), stock }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use domain::camera::CameraSetup;

    use super::*;
    use crate::{CaseSet, WorldState};

    #[test]
    fn most_items_change_places_and_none_of_the_task() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let pairs = ExchangedItems::draw(&warehouse, cases.seed);
        assert_eq!(pairs.0.len() * 2, warehouse.items.len());
        for case in &cases.cases {
            let change = pairs.change(&warehouse, &case.task);
            let state = WorldState::new(&warehouse, &change).unwrap();
            let places = |warehouse: &Warehouse| {
                let items = case.task.targets(warehouse).into_iter();
                items.map(|item| (item.standpoint, item.item_type)).collect::<BTreeSet<_>>()
            };
            assert_eq!(places(&state.warehouse), places(&warehouse), "{}", case.id);
            assert_eq!(state.warehouse.items.len(), warehouse.items.len());
            let changed = warehouse.items.iter().filter(|item| {
                let now = state.warehouse.item_at(item.standpoint).unwrap();
                warehouse.category_of(now) != warehouse.category_of(item)
            });
            let changed = changed.count();
            assert_eq!(changed, change.stock.len());
            assert!(changed * 4 >= warehouse.items.len() * 3, "{}: {changed}", case.id);
            for kind in [&case.original, &case.test] {
                let replay = |warehouse: &Warehouse| {
                    kind.replay(warehouse, &case.task, &state.variant).goal_steps
                };
                assert_eq!(replay(&state.warehouse), replay(&warehouse), "{}", case.id);
            }
        }
    }

    #[test]
    fn each_mismatch_of_looks_changes_one_thing() {
        let standard = Appearance { plates: true, labels: true, seed: u64::MAX };
        let described = Mismatch::ALL.iter().map(|&mismatch| {
            let CameraSetup { height_cm, half_width_percent } = CameraSetup::of(mismatch);
            let look = appearance(standard, mismatch);
            format!("{mismatch}: {look}, {height_cm} cm, {half_width_percent} %")
        });
        insta::assert_snapshot!(described.collect::<Vec<_>>().join("\n"), @"
        none: plates, seed 18446744073709551615, 120 cm, 100 %
        light: plates, 120 cm, 100 %
        labels: plates, no labels, seed 18446744073709551615, 120 cm, 100 %
        camera-height: plates, seed 18446744073709551615, 170 cm, 100 %
        field-of-view: plates, seed 18446744073709551615, 120 cm, 70 %
        wording: plates, seed 18446744073709551615, 120 cm, 100 %
        stock: plates, seed 18446744073709551615, 120 cm, 100 %
        ");
    }
}
