//! The names in instructions, and the plates that they belong to.
//!
//! An instruction names types in the singular ("a blue barrel", "every blue barrel", "the same blue barrel") and
//! categories in the plural ("of the category barrels"). This module knows only this wording.

use std::collections::BTreeSet;

use plates::Plate;

/// Words in front of a type's name.
const DETERMINERS: [&str; 4] = [" a ", " an ", " every ", " same "];

/// Words in front of a category's name.
const CATEGORY: &str = " of the category ";

/// Words that may follow a name.
const EVERYWHERE: &str = " in the warehouse";

/// Names of types and categories.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Names {
    types: BTreeSet<String>,
    categories: BTreeSet<String>,
}

/// The name of what a plate labels, as far as it is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum PlateLabel<'a> {
    /// Its type's name.
    Type(&'a str),
    /// Its category's name only.
    Category(&'a str),
    /// Neither.
    Unnamed,
}

impl std::fmt::Display for PlateLabel<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Type(name) => f.write_str(name),
            Self::Category(name) => write!(f, "{name} item"),
            Self::Unnamed => f.write_str("item"),
        }
    }
}

impl Names {
    /// The names in `instruction`.
    pub(super) fn of(instruction: &str) -> Self {
        let mut names = Self::default();
        names.add(instruction);
        names
    }

    /// Adds the names in `instruction`.
    pub(super) fn add(&mut self, instruction: &str) {
        let text = instruction.trim().trim_end_matches('.');
        for clause in text.split(',').flat_map(|part| part.split(" and ")) {
            // The determiner may be the first word of a clause.
            let clause = format!(" {}", clause.trim());
            let clause = clause.strip_suffix(EVERYWHERE).unwrap_or(&clause);
            let after = |words: &str| clause.split_once(words).map(|(_, name)| name.to_owned());
            if let Some(name) = after(CATEGORY) {
                self.categories.insert(name);
            } else if let Some(name) = DETERMINERS.iter().find_map(|words| after(words)) {
                self.types.insert(name);
            }
        }
    }

    /// The label of `plate`.
    pub(super) fn label(&self, plate: Plate) -> PlateLabel<'_> {
        if let Some(name) = self.types.iter().find(|name| plate.is_type(name)) {
            return PlateLabel::Type(name);
        }
        self.category(plate).map_or(PlateLabel::Unnamed, PlateLabel::Category)
    }

    /// The name of the category of `plate`, if it is known.
    pub(super) fn category(&self, plate: Plate) -> Option<&str> {
        self.categories.iter().find(|name| plate.is_category(name)).map(String::as_str)
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Write;

    use warehouse::{CaseSet, Warehouse};

    use super::*;

    #[test]
    fn types_are_singular_and_categories_plural() {
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
            "Do nothing.",
            "",
        ] {
            let Names { types, categories } = Names::of(instruction);
            writeln!(table, "{types:?} {categories:?}").unwrap();
        }
        insta::assert_snapshot!(table, @r#"
        {"blue barrel"} {}
        {} {"barrels"}
        {"blue barrel"} {}
        {} {"barrels"}
        {"blue barrel", "orange cone"} {}
        {"blue barrel", "orange cone"} {}
        {"orange cone"} {}
        {"orange cone"} {}
        {"blue barrel", "orange cone"} {}
        {"blue barrel", "orange cone"} {}
        {} {}
        {} {}
        "#);
    }

    /// The warehouse words the instructions: exactly the names that it used are found.
    #[test]
    fn the_names_in_every_shipped_instruction_are_found() {
        let catalogue = &Warehouse::shipped().catalogue;
        let mut names = Names::default();
        for case in &CaseSet::shipped().cases {
            let instruction = case.task.instruction(catalogue);
            let own = Names::of(&instruction);
            assert!(own != Names::default(), "{instruction}");
            assert!(own.types.iter().all(|name| catalogue.type_named(name).is_some()), "{own:?}");
            let known = |name: &String| catalogue.category_named(name).is_some();
            assert!(own.categories.iter().all(known), "{own:?}");
            names.add(&instruction);
        }
        assert!(names.types.len() > 20 && names.categories.len() > 5, "{names:?}");
    }

    #[test]
    fn a_plate_has_the_most_specific_name_that_was_mentioned() {
        let plate = Plate::new("barrels", "blue barrel");
        let label = |instruction| Names::of(instruction).label(plate).to_string();
        assert_eq!(label("Find a blue barrel."), "blue barrel");
        assert_eq!(label("Find any item of the category barrels."), "barrels item");
        assert_eq!(label("Find a red barrel."), "item");
        let mut both = Names::of("Find a blue barrel.");
        both.add("Find any item of the category barrels.");
        assert_eq!(both.label(plate), PlateLabel::Type("blue barrel"));
        assert_eq!(both.category(plate), Some("barrels"));
    }
}
