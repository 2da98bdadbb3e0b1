//! What happens to the world of a stream on the way from one of its blocks to another.

use super::{Event, Stream};
use crate::world::Warehouse;

impl Stream {
    /// What happens on the way from block `from` to block `to`, in words: the events of the blocks between them. On the way to
    /// an earlier block they are undone, the last one first. A passage that closes and opens again on the way is left out.
    pub(crate) fn changes(&self, from: u32, to: u32, warehouse: &Warehouse) -> Vec<String> {
        let between = |first: u32, last: u32| {
            let blocks = self.blocks.get(first as usize + 1..=last as usize).unwrap_or_default();
            blocks.iter().flat_map(|block| &block.events)
        };
        let (forward, back) = (between(from, to), between(to, from).rev());
        let on_the_way = forward.map(|event| (event, false)).chain(back.map(|event| (event, true)));
        let mut changes: Vec<(&Event, bool)> = Vec::new();
        for (event, is_undone) in on_the_way {
            let contrary = changes.iter().position(|(earlier, _)| are_contrary(earlier, event));
            match contrary {
                Some(earlier) => drop(changes.remove(earlier)),
                None => changes.push((event, is_undone)),
            }
        }
        let words = changes.into_iter().map(|(event, is_undone)| {
            if is_undone { describe_undone(event, warehouse) } else { event.describe(warehouse) }
        });
        words.collect()
    }
}

/// What takes `event` back, in words.
fn describe_undone(event: &Event, warehouse: &Warehouse) -> String {
    let contrary = match event.clone() {
        Event::Close { cells } => Event::Open { cells },
        Event::Open { cells } => Event::Close { cells },
        Event::Move { item_type, from, to } => Event::Move { item_type, from: to, to: from },
        swap @ Event::Swap { .. } => swap,
        add @ Event::Add { .. } => return add.describe(warehouse).replacen("add", "remove", 1),
    };
    contrary.describe(warehouse)
}

/// Whether one of the two closes the passage that the other opens.
fn are_contrary(one: &Event, other: &Event) -> bool {
    match (one, other) {
        (Event::Close { cells }, Event::Open { cells: others })
        | (Event::Open { cells }, Event::Close { cells: others }) => cells == others,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use domain::Cell;

    use super::*;
    use crate::stream::Block;

    #[test]
    fn changes_follow_the_way_from_block_to_block() {
        let warehouse = Warehouse::shipped();
        let (cells, item_type) = (vec![Cell::new(2, 8)], 0);
        let (from, to) = (Cell::new(2, 8), Cell::new(3, 8));
        let events = [
            vec![],
            vec![Event::Close { cells: cells.clone() }],
            vec![Event::Move { item_type, from, to }, Event::Add { item_type, at: from }],
            vec![Event::Open { cells }],
        ];
        let blocks = events.map(|events| Block { world: 0, cases: vec![0], events });
        let stream = Stream { blocks: blocks.into() };
        let name = &warehouse.catalogue.types[0].name;
        let aisle = warehouse.layout.aisle_name(from).unwrap_or("passage");
        let [close, open] = ["close", "open"].map(|verb| format!("{verb} {aisle} at (2, 8)"));
        let there = format!("move {name} from (2, 8) to (3, 8)");
        let back = format!("move {name} from (3, 8) to (2, 8)");
        let [add, remove] = ["add", "remove"].map(|verb| format!("{verb} {name} at (2, 8)"));
        let changes = |from, to| stream.changes(from, to, &warehouse);
        assert_eq!(changes(0, 1), std::slice::from_ref(&close));
        assert_eq!(changes(1, 3), [there.clone(), add.clone(), open.clone()]);
        assert_eq!(changes(3, 1), [close, remove.clone(), back.clone()]);
        assert_eq!(changes(1, 0), [open]);
        // Closed and open again, in both directions.
        assert_eq!(changes(0, 3), [there, add]);
        assert_eq!(changes(3, 0), [remove, back]);
        assert_eq!(changes(2, 2), [""; 0]);
    }
}
