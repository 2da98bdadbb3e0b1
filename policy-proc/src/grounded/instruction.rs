//! Reads instructions: the ten task templates of the specification, section 3, and their paraphrases, section 6.

use plates::{ItemName, item_names};

/// Which items of the target kinds have to be visited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum VisitOrder {
    /// One item of the only kind (tasks 1, 2, 7).
    One,
    /// All items of the only kind (tasks 3, 4, 8).
    Every,
    /// One item of each of two kinds, in any order (task 5).
    AnyOrder,
    /// One item of the first kind, then one of the second (tasks 6, 9, 10).
    InOrder,
}

/// Where the episode has to end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FinalCell {
    /// At the last item visited.
    LastItem,
    /// At the cell where the episode started (tasks 7, 8, 10).
    Origin,
    /// At the item visited first (task 9).
    FirstItem,
}

/// What an instruction asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct NavigationGoal<'a> {
    pub(super) visit: VisitOrder,
    /// One or two kinds of items, in the order of the instruction.
    pub(super) targets: Vec<ItemName<'a>>,
    pub(super) ending: FinalCell,
}

impl<'a> NavigationGoal<'a> {
    /// Reads `instruction`; `None` unless it names one or two kinds of items.
    pub(super) fn read(instruction: &'a str) -> Option<Self> {
        let mut targets: Vec<ItemName<'_>> = Vec::new();
        for name in item_names(instruction) {
            if !targets.contains(&name) {
                targets.push(name);
            }
        }
        let says = |words: &str| instruction.contains(words);
        let visit = match targets.len() {
            1 if says(" every ") || says(" each ") => VisitOrder::Every,
            1 => VisitOrder::One,
            2 if says(" order") => VisitOrder::AnyOrder,
            2 => VisitOrder::InOrder,
            _ => return None,
        };
        let ending = if says(" the same ") {
            FinalCell::FirstItem
        } else if says("to the cell where you") || says("in the cell where you") {
            FinalCell::Origin
        } else {
            FinalCell::LastItem
        };
        Some(Self { visit, targets, ending })
    }

    /// The kinds of items of which one completes sub-goal `number` of `total`, counted from 1: one kind, several where the
    /// order is free, none at the return to the start.
    pub(super) fn completed_at(&self, number: usize, total: usize) -> &[ItemName<'a>] {
        let kinds = match (self.visit, self.ending) {
            (_, FinalCell::Origin) if number == total => 0..0,
            (VisitOrder::One | VisitOrder::Every | VisitOrder::AnyOrder, _) => {
                0..self.targets.len()
            }
            (VisitOrder::InOrder, FinalCell::FirstItem) if number == total => 0..1,
            (VisitOrder::InOrder, _) => number.saturating_sub(1)..number,
        };
        self.targets.get(kinds).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt::Write;

    #[test]
    fn all_ten_templates_are_read() {
        let mut table = String::new();
        for instruction in [
            "Find a blue barrel.",
            "Find any item of the category barrels.",
            "Visit every blue barrel in the warehouse.",
            "Visit every item of the category barrels in the warehouse.",
            "Visit a blue barrel and an orange cone, in any order.",
            "Visit a blue barrel, then an orange cone.",
            "Find an orange cone, then return to the cell where you started.",
            "Visit every orange cone in the warehouse, then return to the cell where you started.",
            "Find a blue barrel, then visit an orange cone, then go back to the same blue barrel.",
            "Visit a blue barrel, then an orange cone, then return to the cell where you started.",
        ] {
            let goal = NavigationGoal::read(instruction).expect(instruction);
            writeln!(table, "{:?}: {:?} -> {:?}", goal.visit, goal.targets, goal.ending).unwrap();
        }
        insta::assert_snapshot!(table, @r#"
        One: [Type("blue barrel")] -> LastItem
        One: [Category("barrels")] -> LastItem
        Every: [Type("blue barrel")] -> LastItem
        Every: [Category("barrels")] -> LastItem
        AnyOrder: [Type("blue barrel"), Type("orange cone")] -> LastItem
        InOrder: [Type("blue barrel"), Type("orange cone")] -> LastItem
        One: [Type("orange cone")] -> Origin
        Every: [Type("orange cone")] -> Origin
        InOrder: [Type("blue barrel"), Type("orange cone")] -> FirstItem
        InOrder: [Type("blue barrel"), Type("orange cone")] -> Origin
        "#);
    }

    #[test]
    fn the_paraphrase_of_every_case_is_read_as_its_instruction() {
        let book = warehouse::case_book::write_books(&case_book::BookRequest::default()).unwrap();
        let mut read = 0;
        for case in &book.cases.cases {
            let paraphrase = case.paraphrase.as_deref().unwrap();
            assert_ne!(paraphrase, case.instruction);
            let goal = NavigationGoal::read(&case.instruction).expect(&case.instruction);
            assert_eq!(NavigationGoal::read(paraphrase), Some(goal), "{paraphrase}");
            read += 1;
        }
        assert_eq!(read, 100);
    }

    #[test]
    fn an_instruction_that_names_nothing_is_no_goal() {
        for instruction in ["", "Find blue barrel.", "Find a .", "Dance."] {
            assert_eq!(NavigationGoal::read(instruction), None, "{instruction}");
        }
    }
}
