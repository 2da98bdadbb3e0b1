//! What an instruction asks for: the ten task templates (SPEC section 3), read back from English.

use plates::{self, Plate};

/// One kind of thing to stand in front of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Want<'a> {
    /// Of a type, or any of a category.
    pub(super) rank: Rank,
    /// As the instruction calls it.
    pub(super) name: &'a str,
    /// As the plates spell it.
    pub(super) code: [u8; 3],
}

/// What a name is the name of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rank {
    /// Of a type: "blue barrel".
    Type,
    /// Of a category: "barrels".
    Category,
}

impl<'a> Want<'a> {
    fn new(rank: Rank, name: &'a str) -> Self {
        Self { rank, name, code: plates::code(name) }
    }

    /// Whether the item under `plate` is one of these.
    pub(super) fn is_met_by(self, plate: Plate) -> bool {
        match self.rank {
            Rank::Type => plate.0[3..] == self.code,
            Rank::Category => plate.0[..3] == self.code,
        }
    }
}

/// In which way the things wanted are to be visited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Visit<'a> {
    /// One of it (tasks 1, 2, 7).
    One(Want<'a>),
    /// All of it (tasks 3, 4, 8).
    Every(Want<'a>),
    /// One of each, either first (task 5).
    Both(Want<'a>, Want<'a>),
    /// One of the first, then one of the second (tasks 6, 9, 10).
    InOrder(Want<'a>, Want<'a>),
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
pub(super) struct Goal<'a> {
    /// What to visit.
    pub(super) visit: Visit<'a>,
    /// Where to end.
    pub(super) ending: Ending,
}

impl<'a> Goal<'a> {
    /// The goal that `instruction` states; `None` when it follows none of the ten templates.
    pub(super) fn parse(instruction: &'a str) -> Option<Self> {
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

    /// The kinds of things to visit, in the order of the instruction.
    pub(super) fn wants(&self) -> Vec<Want<'a>> {
        match self.visit {
            Visit::One(want) | Visit::Every(want) => vec![want],
            Visit::Both(a, b) | Visit::InOrder(a, b) => vec![a, b],
        }
    }
}

fn visit(text: &str) -> Option<Visit<'_>> {
    if let Some(category) = text.strip_prefix("Find any item of the category ") {
        return Some(Visit::One(Want::new(Rank::Category, name(category)?)));
    }
    if let Some(one) = text.strip_prefix("Find ") {
        return Some(Visit::One(item(one)?));
    }
    let text = text.strip_prefix("Visit ")?;
    if let Some(every) = text.strip_prefix("every ") {
        let every = every.strip_suffix(" in the warehouse")?;
        return Some(Visit::Every(match every.strip_prefix("item of the category ") {
            Some(category) => Want::new(Rank::Category, name(category)?),
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
fn item(text: &str) -> Option<Want<'_>> {
    let text = text.strip_prefix("a ").or_else(|| text.strip_prefix("an "))?;
    name(text).map(kind)
}

/// A name stands alone: nothing in it could belong to the sentence around it.
fn name(text: &str) -> Option<&str> {
    (!text.is_empty() && !text.contains([',', '.'])).then_some(text)
}

fn kind(name: &str) -> Want<'_> {
    Want::new(Rank::Type, name)
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
            let wants = goal.wants();
            let wants = wants.iter().map(|want| format!("{:?} {}", want.rank, want.name));
            let order = format!("{:?}", goal.visit);
            let order = order.split('(').next().unwrap();
            let wants = wants.collect::<Vec<_>>().join(", ");
            writeln!(table, "{order} of {wants} -> {:?}", goal.ending).unwrap();
        }
        writeln!(table, "a blue barrel is {:?}", plates::code("blue barrel")).unwrap();
        writeln!(table, "an orange cone is {:?}", plates::code("orange cone")).unwrap();
        writeln!(table, "barrels are {:?}", plates::code("barrels")).unwrap();
        insta::assert_snapshot!(table, @r"
        One of Type blue barrel -> There
        One of Category barrels -> There
        Every of Type blue barrel -> There
        Every of Category barrels -> There
        Both of Type blue barrel, Type orange cone -> There
        InOrder of Type blue barrel, Type orange cone -> There
        One of Type orange cone -> Origin
        Every of Type orange cone -> Origin
        InOrder of Type blue barrel, Type orange cone -> FirstItem
        InOrder of Type blue barrel, Type orange cone -> Origin
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
        assert!(Want::new(Rank::Type, "blue barrel").is_met_by(plate));
        assert!(Want::new(Rank::Category, "barrels").is_met_by(plate));
        assert!(!Want::new(Rank::Type, "barrels").is_met_by(plate));
        assert!(!Want::new(Rank::Category, "cones").is_met_by(plate));
    }
}
