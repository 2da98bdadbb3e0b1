//! The instruction of a task in other words.
//!
//! It names the same items in the same order, with the same words for them, and says the same of how many have to be visited
//! and where to end. That a reader of instructions understands the same is checked by the grounded policy's tests.

use crate::catalogue::Catalogue;
use crate::task::{Task, with_article};

/// So many forms has each type of task beside the one of [`Task::instruction`].
pub(crate) const FORMS: usize = 2;

impl Task {
    /// The [`instruction`](Self::instruction) in other words, in the form with this number modulo [`FORMS`].
    pub(crate) fn paraphrase(&self, catalogue: &Catalogue, form: usize) -> String {
        let plain = |index: usize| catalogue.types[index].name.as_str();
        let one = |index: usize| with_article(plain(index));
        let category = |index: usize| catalogue.categories[index].name.as_str();
        let is_first = form.is_multiple_of(FORMS);
        let each = |items: &str| match is_first {
            true => format!("Go to each {items} in the warehouse"),
            false => format!("Go round the warehouse until you have been at every {items}"),
        };
        let come_back = match is_first {
            true => "come back to the cell where you began",
            false => "end in the cell where you began",
        };
        match (*self, is_first) {
            (Self::FindType { a }, true) => format!("Go to {}.", one(a)),
            (Self::FindType { a }, false) => format!("Look for {} and go up to it.", one(a)),
            (Self::FindCategory { c }, true) => {
                format!("Go to one item of the category {}, whichever you like.", category(c))
            }
            (Self::FindCategory { c }, false) => {
                format!("Look for an item of the category {} and go up to it.", category(c))
            }
            (Self::EveryOfType { a }, _) => format!("{}.", each(plain(a))),
            (Self::EveryOfCategory { c }, _) => {
                format!("{}.", each(&format!("item of the category {}", category(c))))
            }
            (Self::BothTypes { a, b }, true) => {
                format!("Go to {} and to {}; the order is up to you.", one(a), one(b))
            }
            (Self::BothTypes { a, b }, false) => {
                format!("In whichever order you like, go to {} and to {}.", one(a), one(b))
            }
            (Self::InOrder { a, b }, true) => {
                format!("First go to {}, and after that to {}.", one(a), one(b))
            }
            (Self::InOrder { a, b }, false) => {
                format!("Go to {}, and only then to {}.", one(a), one(b))
            }
            (Self::FindAndReturn { a }, true) => {
                format!("Go to {}, and after that {come_back}.", one(a))
            }
            (Self::FindAndReturn { a }, false) => {
                format!("Look for {}, and {come_back}.", one(a))
            }
            (Self::EveryAndReturn { a }, _) => {
                format!("{}, and after that {come_back}.", each(plain(a)))
            }
            (Self::Revisit { a, b }, true) => format!(
                "Go to {}, after that to {}, and end again at the same {}.",
                one(a),
                one(b),
                plain(a)
            ),
            (Self::Revisit { a, b }, false) => format!(
                "First look for {}, after that for {}, and come back to the same {}.",
                one(a),
                one(b),
                plain(a)
            ),
            (Self::InOrderAndReturn { a, b }, true) => {
                format!("First go to {}, after that to {}, and {come_back}.", one(a), one(b))
            }
            (Self::InOrderAndReturn { a, b }, false) => {
                format!("Go to {}, only then to {}, and {come_back}.", one(a), one(b))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use domain::limits::MAX_INSTRUCTION;

    use super::*;
    use crate::testing::{all_tasks, tiny};
    use crate::{CaseSet, Warehouse};

    #[test]
    fn paraphrases_read_well() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let firsts = cases.cases.iter().filter(|case| case.id.ends_with("-01"));
        let lines = firsts.flat_map(|case| {
            let form = |form| case.task.paraphrase(&warehouse.catalogue, form);
            [case.task.instruction(&warehouse.catalogue), form(0), form(1)]
        });
        insta::assert_snapshot!(lines.collect::<Vec<_>>().join("\n"), @"
        Find a yellow fire extinguisher.
        Go to a yellow fire extinguisher.
        Look for a yellow fire extinguisher and go up to it.
        Find any item of the category toolboxes.
        Go to one item of the category toolboxes, whichever you like.
        Look for an item of the category toolboxes and go up to it.
        Visit every red barrel in the warehouse.
        Go to each red barrel in the warehouse.
        Go round the warehouse until you have been at every red barrel.
        Visit every item of the category buckets in the warehouse.
        Go to each item of the category buckets in the warehouse.
        Go round the warehouse until you have been at every item of the category buckets.
        Visit a white helmet and a black tyre, in any order.
        Go to a white helmet and to a black tyre; the order is up to you.
        In whichever order you like, go to a white helmet and to a black tyre.
        Visit a red cable reel, then a turquoise gas cylinder.
        First go to a red cable reel, and after that to a turquoise gas cylinder.
        Go to a red cable reel, and only then to a turquoise gas cylinder.
        Find a yellow toolbox, then return to the cell where you started.
        Go to a yellow toolbox, and after that come back to the cell where you began.
        Look for a yellow toolbox, and end in the cell where you began.
        Visit every red fire extinguisher in the warehouse, then return to the cell where you started.
        Go to each red fire extinguisher in the warehouse, and after that come back to the cell where you began.
        Go round the warehouse until you have been at every red fire extinguisher, and after that end in the cell where you began.
        Find an orange cone, then visit a yellow fire extinguisher, then go back to the same orange cone.
        Go to an orange cone, after that to a yellow fire extinguisher, and end again at the same orange cone.
        First look for an orange cone, after that for a yellow fire extinguisher, and come back to the same orange cone.
        Visit a black tyre, then a red crate, then return to the cell where you started.
        First go to a black tyre, after that to a red crate, and come back to the cell where you began.
        Go to a black tyre, only then to a red crate, and end in the cell where you began.
        ");
    }

    #[test]
    fn no_two_tasks_have_the_same_words_and_all_fit() {
        for warehouse in [tiny(), Warehouse::shipped()] {
            let mut known = BTreeSet::new();
            for task in all_tasks(&warehouse) {
                let forms = (0..FORMS).map(|form| task.paraphrase(&warehouse.catalogue, form));
                for text in forms.chain([task.instruction(&warehouse.catalogue)]) {
                    assert!(text.len() <= MAX_INSTRUCTION, "{text}");
                    assert!(known.insert(text.clone()), "{text}");
                }
            }
        }
    }
}
