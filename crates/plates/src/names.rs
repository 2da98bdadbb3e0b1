//! What instructions call items.
//!
//! An instruction names types in the singular ("a blue barrel", "every blue barrel", "the same blue barrel") and
//! categories in the plural ("of the category barrels"), in all forms of a task. This module knows only this wording.

use crate::{Plate, code};

/// Words in front of a type's name.
const DETERMINERS: [&str; 5] = ["a ", "an ", "every ", "each ", "same "];

/// Words in front of a category's name.
const CATEGORY: &str = "of the category ";

/// Words that may follow a name.
const EVERYWHERE: &str = " in the warehouse";

/// A kind of item, by its name in an instruction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ItemName<'a> {
    /// "blue barrel"
    Type(&'a str),
    /// "barrels"
    Category(&'a str),
}

impl ItemName<'_> {
    /// Tells whether the item labelled with a plate is of this kind.
    pub fn matcher(self) -> impl Fn(Plate) -> bool + use<> {
        let (name, bands) = match self {
            Self::Category(name) => (name, 0..3),
            Self::Type(name) => (name, 3..6),
        };
        let wanted = code(name);
        move |plate| plate.0[bands.clone()] == wanted
    }
}

/// The kinds of items that `instruction` names, in its order.
pub fn item_names(instruction: &str) -> impl Iterator<Item = ItemName<'_>> {
    let text = instruction.trim().trim_end_matches('.');
    text.split([',', ';']).flat_map(|part| part.split(" and ")).filter_map(|clause| {
        let clause = clause.trim();
        let clause = clause.strip_suffix(EVERYWHERE).unwrap_or(clause);
        let category = name_after(CATEGORY, clause).map(ItemName::Category);
        let item_type = || DETERMINERS.into_iter().find_map(|words| name_after(words, clause));
        category.or_else(|| item_type().map(ItemName::Type))
    })
}

/// What follows `words`, which may begin the clause or stand within it.
fn name_after<'a>(words: &str, clause: &'a str) -> Option<&'a str> {
    let mut places = clause.match_indices(words).map(|(at, _)| at);
    let at = places.find(|&at| at == 0 || clause[..at].ends_with(' '))?;
    Some(&clause[at + words.len()..])
}

#[cfg(test)]
mod tests {
    use super::ItemName::{Category, Type};
    use super::*;

    #[test]
    fn types_are_singular_and_categories_plural() {
        for (instruction, expected) in [
            ("Find a blue barrel.", &[Type("blue barrel")][..]),
            ("Visit every item of the category barrels in the warehouse.", &[Category("barrels")]),
            (
                "Visit a blue barrel, then an orange cone.",
                &[Type("blue barrel"), Type("orange cone")],
            ),
            (
                "Find an orange cone, then return to the cell where you started.",
                &[Type("orange cone")],
            ),
            (
                "Go to each blue barrel in the warehouse, and after that come back to the cell where you began.",
                &[Type("blue barrel")],
            ),
            (
                "Go to a blue barrel and to an orange cone; the order is up to you.",
                &[Type("blue barrel"), Type("orange cone")],
            ),
            ("Find a .", &[]),
            ("Do nothing.", &[]),
            ("", &[]),
        ] {
            let names: Vec<_> = item_names(instruction).collect();
            assert_eq!(names, expected, "{instruction}");
        }
    }
}
