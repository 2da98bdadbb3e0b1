//! What an instruction asks for: the ten task templates (SPEC section 3), read back from English.

use shm_types::plate::{self, Plate};

/// One kind of thing to stand in front of, as the plates spell it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Want {
    /// An item of the type with this code.
    Type([u8; 3]),
    /// Any item of the category with this code.
    Category([u8; 3]),
}

impl Want {
    /// Whether the item under `plate` is one of these.
    pub(super) fn is_met_by(self, plate: Plate) -> bool {
        match self {
            Self::Type(code) => plate.0[3..] == code,
            Self::Category(code) => plate.0[..3] == code,
        }
    }
}

/// In which way the things wanted are to be visited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Visit {
    /// One of it (tasks 1, 2, 7).
    One(Want),
    /// All of it (tasks 3, 4, 8).
    Every(Want),
    /// One of each, either first (task 5).
    Both(Want, Want),
    /// One of the first, then one of the second (tasks 6, 9, 10).
    InOrder(Want, Want),
}

/// Where the walk ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ending {
    /// At the last thing visited.
    There,
    /// On the cell the episode began on (tasks 7, 8, 10).
    Origin,
    /// In front of the item visited first (task 9).
    FirstItem,
}

/// What an instruction asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Goal {
    /// What to visit.
    pub(super) visit: Visit,
    /// Where to end.
    pub(super) ending: Ending,
}

impl Goal {
    /// The goal that `instruction` states; `None` when it follows none of the ten templates.
    pub(super) fn parse(instruction: &str) -> Option<Self> {
        let text = instruction.strip_suffix('.')?;
        let (text, ending) = match text.strip_suffix("then return to the cell where you started") {
            Some(rest) => (rest.strip_suffix(", ")?, Ending::Origin),
            None => (text, Ending::There),
        };
        if let Some((rest, again)) = text.split_once(", then go back to the same ") {
            let (first, second) = rest.strip_prefix("Find ")?.split_once(", then visit ")?;
            let visit = Visit::InOrder(item(first)?, item(second)?);
            let same = item(first)? == name(again).map(kind)?;
            return (same && ending == Ending::There)
                .then_some(Self { visit, ending: Ending::FirstItem });
        }
        Some(Self { visit: visit(text)?, ending })
    }
}

fn visit(text: &str) -> Option<Visit> {
    if let Some(category) = text.strip_prefix("Find any item of the category ") {
        return Some(Visit::One(Want::Category(plate::code(name(category)?))));
    }
    if let Some(one) = text.strip_prefix("Find ") {
        return Some(Visit::One(item(one)?));
    }
    let text = text.strip_prefix("Visit ")?;
    if let Some(every) = text.strip_prefix("every ") {
        let every = every.strip_suffix(" in the warehouse")?;
        return Some(Visit::Every(match every.strip_prefix("item of the category ") {
            Some(category) => Want::Category(plate::code(name(category)?)),
            None => kind(name(every)?),
        }));
    }
    if let Some(pair) = text.strip_suffix(", in any order") {
        let (first, second) = pair.split_once(" and ")?;
        return Some(Visit::Both(item(first)?, item(second)?));
    }
    let (first, second) = text.split_once(", then ")?;
    Some(Visit::InOrder(item(first)?, item(second)?))
}

/// "a blue barrel", "an orange cone".
fn item(text: &str) -> Option<Want> {
    let text = text.strip_prefix("a ").or_else(|| text.strip_prefix("an "))?;
    name(text).map(kind)
}

/// A name stands alone: nothing in it could belong to the sentence around it.
fn name(text: &str) -> Option<&str> {
    (!text.is_empty() && !text.contains([',', '.'])).then_some(text)
}

fn kind(name: &str) -> Want {
    Want::Type(plate::code(name))
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
            let goal = Goal::parse(instruction).expect(instruction);
            writeln!(table, "{:?} -> {:?}", goal.visit, goal.ending).unwrap();
        }
        writeln!(table, "a blue barrel is {:?}", plate::code("blue barrel")).unwrap();
        writeln!(table, "an orange cone is {:?}", plate::code("orange cone")).unwrap();
        writeln!(table, "barrels are {:?}", plate::code("barrels")).unwrap();
        insta::assert_snapshot!(table, @r"
        One(Type([6, 1, 1])) -> There
        One(Category([5, 5, 4])) -> There
        Every(Type([6, 1, 1])) -> There
        Every(Category([5, 5, 4])) -> There
        Both(Type([6, 1, 1]), Type([1, 1, 0])) -> There
        InOrder(Type([6, 1, 1]), Type([1, 1, 0])) -> There
        One(Type([1, 1, 0])) -> Origin
        Every(Type([1, 1, 0])) -> Origin
        InOrder(Type([6, 1, 1]), Type([1, 1, 0])) -> FirstItem
        InOrder(Type([6, 1, 1]), Type([1, 1, 0])) -> Origin
        a blue barrel is [6, 1, 1]
        an orange cone is [1, 1, 0]
        barrels are [5, 5, 4]
        ");
    }

    #[test]
    fn anything_else_is_no_goal() {
        for instruction in [
            "",
            "Find a blue barrel",
            "Find blue barrel.",
            "find a blue barrel.",
            "Find a .",
            "Visit every blue barrel.",
            "Visit a blue barrel.",
            "Visit a blue barrel and an orange cone.",
            "Find a blue barrel, then visit an orange cone, then go back to the same orange cone.",
            "Find a blue barrel, then dance.",
            "Find a blue barrel, then return to the cell where you started, then stop.",
        ] {
            assert_eq!(Goal::parse(instruction), None, "{instruction}");
        }
    }

    #[test]
    fn a_want_is_met_by_its_own_plates() {
        let plate = Plate::new("barrels", "blue barrel");
        assert!(Want::Type(plate::code("blue barrel")).is_met_by(plate));
        assert!(Want::Category(plate::code("barrels")).is_met_by(plate));
        assert!(!Want::Type(plate::code("barrels")).is_met_by(plate));
        assert!(!Want::Category(plate::code("cones")).is_met_by(plate));
    }
}
