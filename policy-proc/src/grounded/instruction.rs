//! Parses instructions: the ten task templates of the specification, section 3.

use plates::Plate;

/// A kind of item that the instruction names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ItemKind<'a> {
    pub(super) rank: NameRank,
    pub(super) name: &'a str,
    /// The digits with which plates spell the name.
    pub(super) code: [u8; 3],
}

/// What a target's name refers to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NameRank {
    /// "blue barrel"
    Type,
    /// "barrels"
    Category,
}

impl<'a> ItemKind<'a> {
    /// A target with this name, which must be a name on its own: no punctuation of the sentence around it.
    fn new(rank: NameRank, name: &'a str) -> Option<Self> {
        let is_name = !name.is_empty() && !name.contains([',', '.']);
        is_name.then(|| Self { rank, name, code: plates::code(name) })
    }

    /// "a blue barrel", "an orange cone"
    fn with_article(text: &'a str) -> Option<Self> {
        let name = text.strip_prefix("a ").or_else(|| text.strip_prefix("an "))?;
        Self::new(NameRank::Type, name)
    }

    /// Whether the item labelled with `plate` is of this kind.
    pub(super) fn matches(self, plate: Plate) -> bool {
        match self.rank {
            NameRank::Type => plate.0[3..] == self.code,
            NameRank::Category => plate.0[..3] == self.code,
        }
    }
}

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

/// A parsed instruction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct NavigationGoal<'a> {
    pub(super) visit: VisitOrder,
    /// One or two kinds of items, in the order of the instruction.
    pub(super) targets: Vec<ItemKind<'a>>,
    pub(super) ending: FinalCell,
}

impl<'a> NavigationGoal<'a> {
    /// Parses `instruction`; `None` if it follows none of the ten templates.
    pub(super) fn parse(instruction: &'a str) -> Option<Self> {
        let text = instruction.strip_suffix('.')?;
        if let Some((rest, same)) = text.split_once(", then go back to the same ") {
            let (first, second) = rest.strip_prefix("Find ")?.split_once(", then visit ")?;
            let targets = vec![ItemKind::with_article(first)?, ItemKind::with_article(second)?];
            let ending = FinalCell::FirstItem;
            return (targets[0].name == same).then_some(Self {
                visit: VisitOrder::InOrder,
                targets,
                ending,
            });
        }
        let returns = text.strip_suffix(", then return to the cell where you started");
        let ending = if returns.is_some() { FinalCell::Origin } else { FinalCell::LastItem };
        let (visit, targets) = parse_visit(returns.unwrap_or(text))?;
        Some(Self { visit, targets, ending })
    }
}

fn parse_visit(text: &str) -> Option<(VisitOrder, Vec<ItemKind<'_>>)> {
    if let Some(category) = text.strip_prefix("Find any item of the category ") {
        return Some((VisitOrder::One, vec![ItemKind::new(NameRank::Category, category)?]));
    }
    if let Some(item) = text.strip_prefix("Find ") {
        return Some((VisitOrder::One, vec![ItemKind::with_article(item)?]));
    }
    let text = text.strip_prefix("Visit ")?;
    if let Some(kind) = text.strip_prefix("every ") {
        let kind = kind.strip_suffix(" in the warehouse")?;
        let target = match kind.strip_prefix("item of the category ") {
            Some(category) => ItemKind::new(NameRank::Category, category)?,
            None => ItemKind::new(NameRank::Type, kind)?,
        };
        return Some((VisitOrder::Every, vec![target]));
    }
    let (visit, (first, second)) = match text.strip_suffix(", in any order") {
        Some(pair) => (VisitOrder::AnyOrder, pair.split_once(" and ")?),
        None => (VisitOrder::InOrder, text.split_once(", then ")?),
    };
    Some((visit, vec![ItemKind::with_article(first)?, ItemKind::with_article(second)?]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt::Write;

    #[test]
    fn all_ten_templates_are_parsed() {
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
            let goal = NavigationGoal::parse(instruction).expect(instruction);
            let targets = goal.targets.iter();
            let targets = targets.map(|target| format!("{:?} {}", target.rank, target.name));
            let targets = targets.collect::<Vec<_>>().join(", ");
            writeln!(table, "{:?}: {targets} -> {:?}", goal.visit, goal.ending).unwrap();
        }
        insta::assert_snapshot!(table, @r"
        One: Type blue barrel -> LastItem
        One: Category barrels -> LastItem
        Every: Type blue barrel -> LastItem
        Every: Category barrels -> LastItem
        AnyOrder: Type blue barrel, Type orange cone -> LastItem
        InOrder: Type blue barrel, Type orange cone -> LastItem
        One: Type orange cone -> Origin
        Every: Type orange cone -> Origin
        InOrder: Type blue barrel, Type orange cone -> FirstItem
        InOrder: Type blue barrel, Type orange cone -> Origin
        ");
    }

    #[test]
    fn other_sentences_are_rejected() {
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
            assert_eq!(NavigationGoal::parse(instruction), None, "{instruction}");
        }
    }

    #[test]
    fn targets_match_their_own_plates_only() {
        let plate = Plate::new("barrels", "blue barrel");
        let matches = |rank, name| ItemKind::new(rank, name).unwrap().matches(plate);
        assert!(matches(NameRank::Type, "blue barrel") && matches(NameRank::Category, "barrels"));
        assert!(!matches(NameRank::Type, "barrels") && !matches(NameRank::Category, "cones"));
    }
}
