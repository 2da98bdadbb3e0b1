//! The names in instructions, and the plates that they belong to.

use std::collections::BTreeSet;

use plates::{ItemName, Plate, item_names};

/// Names of types and categories.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct CatalogueNames {
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

impl CatalogueNames {
    /// The names in `instruction`.
    pub(super) fn of(instruction: &str) -> Self {
        let mut names = Self::default();
        names.add(instruction);
        names
    }

    /// Adds the names in `instruction`.
    pub(super) fn add(&mut self, instruction: &str) {
        for name in item_names(instruction) {
            match name {
                ItemName::Type(name) => self.types.insert(name.to_owned()),
                ItemName::Category(name) => self.categories.insert(name.to_owned()),
            };
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
    use warehouse::{CaseSet, Warehouse};

    use super::*;

    /// The warehouse words the instructions: exactly the names that it used are found.
    #[test]
    fn the_names_in_every_shipped_instruction_are_found() {
        let catalogue = &Warehouse::shipped().catalogue;
        let mut names = CatalogueNames::default();
        for case in &CaseSet::shipped().cases {
            let instruction = case.task.instruction(catalogue);
            let own = CatalogueNames::of(&instruction);
            assert!(own != CatalogueNames::default(), "{instruction}");
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
        let label = |instruction| CatalogueNames::of(instruction).label(plate).to_string();
        assert_eq!(label("Find a blue barrel."), "blue barrel");
        assert_eq!(label("Find any item of the category barrels."), "barrels item");
        assert_eq!(label("Find a red barrel."), "item");
        let mut both = CatalogueNames::of("Find a blue barrel.");
        both.add("Find any item of the category barrels.");
        assert_eq!(both.label(plate), PlateLabel::Type("blue barrel"));
        assert_eq!(both.category(plate), Some("barrels"));
    }
}
