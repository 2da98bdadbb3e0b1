//! The ten task types: what must be visited, in which order, and the instruction for the policy.
//!
//! Types and categories are indices into the [`Catalogue`]. [`Progress`](crate::Progress) and the planner both work on the
//! [`Phase`]s of a task.

use crate::catalogue::Catalogue;
use crate::task_type::{TaskGroup, TaskType};
use crate::world::{Item, Warehouse};

/// A task. `a` and `b` are item types, `c` is a category (specification, section 3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Task {
    /// 1: reach one instance of A.
    FindType {
        /// A.
        a: usize,
    },
    /// 2: reach one item of C.
    FindCategory {
        /// C.
        c: usize,
    },
    /// 3: visit every instance of A.
    EveryOfType {
        /// A.
        a: usize,
    },
    /// 4: visit every item of C.
    EveryOfCategory {
        /// C.
        c: usize,
    },
    /// 5: visit one A and one B, in any order.
    BothTypes {
        /// A.
        a: usize,
        /// B.
        b: usize,
    },
    /// 6: visit an A, then a B.
    InOrder {
        /// A.
        a: usize,
        /// B.
        b: usize,
    },
    /// 7: reach an A, then end at the origin.
    FindAndReturn {
        /// A.
        a: usize,
    },
    /// 8: visit every A, then end at the origin.
    EveryAndReturn {
        /// A.
        a: usize,
    },
    /// 9: reach an A, then a B, then the same A again.
    Revisit {
        /// A.
        a: usize,
        /// B.
        b: usize,
    },
    /// 10: visit an A, then a B, then end at the origin.
    InOrderAndReturn {
        /// A.
        a: usize,
        /// B.
        b: usize,
    },
}

/// A part of a task that must be complete before the next begins.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Phase {
    /// One item of each set, in any order. Every set is one sub-goal and holds item ids, sorted.
    OneOfEach(Vec<Vec<u16>>),
    /// The cell where the episode began.
    Origin,
    /// The item that was reached first in the episode.
    FirstAgain,
}

impl Task {
    /// Its type.
    pub const fn task_type(&self) -> TaskType {
        match self {
            Self::FindType { .. } => TaskType::FindType,
            Self::FindCategory { .. } => TaskType::FindCategory,
            Self::EveryOfType { .. } => TaskType::EveryOfType,
            Self::EveryOfCategory { .. } => TaskType::EveryOfCategory,
            Self::BothTypes { .. } => TaskType::BothTypes,
            Self::InOrder { .. } => TaskType::InOrder,
            Self::FindAndReturn { .. } => TaskType::FindAndReturn,
            Self::EveryAndReturn { .. } => TaskType::EveryAndReturn,
            Self::Revisit { .. } => TaskType::Revisit,
            Self::InOrderAndReturn { .. } => TaskType::InOrderAndReturn,
        }
    }

    /// The instruction for the policy. Policies parse these exact forms.
    pub fn instruction(&self, catalogue: &Catalogue) -> String {
        let plain = |index: usize| catalogue.types[index].name.as_str();
        let one = |index: usize| with_article(plain(index));
        let category = |index: usize| catalogue.categories[index].name.as_str();
        match *self {
            Self::FindType { a } => format!("Find {}.", one(a)),
            Self::FindCategory { c } => format!("Find any item of the category {}.", category(c)),
            Self::EveryOfType { a } => format!("Visit every {} in the warehouse.", plain(a)),
            Self::EveryOfCategory { c } => {
                format!("Visit every item of the category {} in the warehouse.", category(c))
            }
            Self::BothTypes { a, b } => format!("Visit {} and {}, in any order.", one(a), one(b)),
            Self::InOrder { a, b } => format!("Visit {}, then {}.", one(a), one(b)),
            Self::FindAndReturn { a } => {
                format!("Find {}, then return to the cell where you started.", one(a))
            }
            Self::EveryAndReturn { a } => format!(
                "Visit every {} in the warehouse, then return to the cell where you started.",
                plain(a)
            ),
            Self::Revisit { a, b } => {
                format!(
                    "Find {}, then visit {}, then go back to the same {}.",
                    one(a),
                    one(b),
                    plain(a)
                )
            }
            Self::InOrderAndReturn { a, b } => format!(
                "Visit {}, then {}, then return to the cell where you started.",
                one(a),
                one(b)
            ),
        }
    }

    /// Whether the task ends at the cell where the episode began.
    pub const fn returns_to_origin(&self) -> bool {
        matches!(self.task_type().group(), TaskGroup::ReturnLoop)
    }

    /// The phases, in order. A return is always the last.
    pub fn phases(&self, warehouse: &Warehouse) -> Vec<Phase> {
        let of_type = |index| ids(warehouse.instances(index));
        let of_category = |index| ids(warehouse.items_in(index));
        let one = |set: Vec<u16>| Phase::OneOfEach(vec![set]);
        let every = |set: Vec<u16>| Phase::OneOfEach(set.into_iter().map(|id| vec![id]).collect());
        match *self {
            Self::FindType { a } => vec![one(of_type(a))],
            Self::FindCategory { c } => vec![one(of_category(c))],
            Self::EveryOfType { a } => vec![every(of_type(a))],
            Self::EveryOfCategory { c } => vec![every(of_category(c))],
            Self::BothTypes { a, b } => vec![Phase::OneOfEach(vec![of_type(a), of_type(b)])],
            Self::InOrder { a, b } => vec![one(of_type(a)), one(of_type(b))],
            Self::FindAndReturn { a } => vec![one(of_type(a)), Phase::Origin],
            Self::EveryAndReturn { a } => vec![every(of_type(a)), Phase::Origin],
            Self::Revisit { a, b } => vec![one(of_type(a)), one(of_type(b)), Phase::FirstAgain],
            Self::InOrderAndReturn { a, b } => {
                vec![one(of_type(a)), one(of_type(b)), Phase::Origin]
            }
        }
    }

    /// The types or the category that the task is about.
    pub(crate) const fn subject(&self) -> TaskSubject {
        match *self {
            Self::FindCategory { c } | Self::EveryOfCategory { c } => TaskSubject::Category(c),
            Self::FindType { a }
            | Self::EveryOfType { a }
            | Self::FindAndReturn { a }
            | Self::EveryAndReturn { a } => TaskSubject::Type(a),
            Self::BothTypes { a, b }
            | Self::InOrder { a, b }
            | Self::Revisit { a, b }
            | Self::InOrderAndReturn { a, b } => TaskSubject::Types(a, b),
        }
    }

    /// The same task with the indices of another catalogue; the first name that it lacks, if there is one.
    pub(crate) fn translated<'c>(
        &self,
        from: &'c Catalogue,
        to: &Catalogue,
    ) -> Result<Self, &'c str> {
        let item_type = |index: usize| {
            let name = from.types[index].name.as_str();
            to.type_named(name).ok_or(name)
        };
        let category = |index: usize| {
            let name = from.categories[index].name.as_str();
            to.category_named(name).ok_or(name)
        };
        Ok(match *self {
            Self::FindType { a } => Self::FindType { a: item_type(a)? },
            Self::FindCategory { c } => Self::FindCategory { c: category(c)? },
            Self::EveryOfType { a } => Self::EveryOfType { a: item_type(a)? },
            Self::EveryOfCategory { c } => Self::EveryOfCategory { c: category(c)? },
            Self::BothTypes { a, b } => Self::BothTypes { a: item_type(a)?, b: item_type(b)? },
            Self::InOrder { a, b } => Self::InOrder { a: item_type(a)?, b: item_type(b)? },
            Self::FindAndReturn { a } => Self::FindAndReturn { a: item_type(a)? },
            Self::EveryAndReturn { a } => Self::EveryAndReturn { a: item_type(a)? },
            Self::Revisit { a, b } => Self::Revisit { a: item_type(a)?, b: item_type(b)? },
            Self::InOrderAndReturn { a, b } => {
                Self::InOrderAndReturn { a: item_type(a)?, b: item_type(b)? }
            }
        })
    }

    /// The letter of an item that counts: A, B or C, as in the descriptions of the types.
    pub fn letter(&self, warehouse: &Warehouse, item: &Item) -> Option<char> {
        let found = item.item_type;
        match self.subject() {
            TaskSubject::Category(c) => (warehouse.category_of(item) == c).then_some('C'),
            TaskSubject::Type(a) | TaskSubject::Types(a, _) if found == a => Some('A'),
            TaskSubject::Types(_, b) if found == b => Some('B'),
            TaskSubject::Type(_) | TaskSubject::Types(..) => None,
        }
    }

    /// The items that count, by id: every instance of A and B, or every item of C. All of them must be visited if the task
    /// says "every"; otherwise any of them counts.
    pub fn targets<'w>(&self, warehouse: &'w Warehouse) -> Vec<&'w Item> {
        let counts = |item: &&Item| self.letter(warehouse, item).is_some();
        warehouse.items.iter().filter(counts).collect()
    }
}

/// The types or the category that a task is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TaskSubject {
    Type(usize),
    Types(usize, usize),
    Category(usize),
}

fn ids<'a>(items: impl Iterator<Item = &'a Item>) -> Vec<u16> {
    items.map(|item| item.id).collect()
}

pub(crate) fn with_article(noun: &str) -> String {
    let article = if noun.starts_with(['a', 'e', 'i', 'o', 'u']) { "an" } else { "a" };
    format!("{article} {noun}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{BLUE_BARREL, CONES, ORANGE_CONE, all_tasks, tiny};

    #[test]
    fn instructions_read_well() {
        let (a, b) = (ORANGE_CONE, BLUE_BARREL);
        let tasks = [
            Task::FindType { a },
            Task::FindCategory { c: CONES },
            Task::EveryOfType { a },
            Task::EveryOfCategory { c: CONES },
            Task::BothTypes { a, b },
            Task::InOrder { a, b },
            Task::FindAndReturn { a },
            Task::EveryAndReturn { a },
            Task::Revisit { a, b },
            Task::InOrderAndReturn { a, b },
        ];
        let catalogue = tiny().catalogue;
        let lines: Vec<String> = tasks
            .map(|task| format!("{} {}", task.task_type().number(), task.instruction(&catalogue)))
            .into();
        insta::assert_snapshot!(lines.join("\n"), @"
        1 Find an orange cone.
        2 Find any item of the category cones.
        3 Visit every orange cone in the warehouse.
        4 Visit every item of the category cones in the warehouse.
        5 Visit an orange cone and a blue barrel, in any order.
        6 Visit an orange cone, then a blue barrel.
        7 Find an orange cone, then return to the cell where you started.
        8 Visit every orange cone in the warehouse, then return to the cell where you started.
        9 Find an orange cone, then visit a blue barrel, then go back to the same orange cone.
        10 Visit an orange cone, then a blue barrel, then return to the cell where you started.
        ");
    }

    #[test]
    fn targets_are_the_items_of_the_phases() {
        let warehouse = tiny();
        for task in all_tasks(&warehouse) {
            let mut in_phases: Vec<u16> = Vec::new();
            for phase in task.phases(&warehouse) {
                match phase {
                    Phase::OneOfEach(sets) => in_phases.extend(sets.into_iter().flatten()),
                    Phase::Origin => assert!(task.returns_to_origin()),
                    Phase::FirstAgain => assert_eq!(task.task_type(), TaskType::Revisit),
                }
            }
            in_phases.sort_unstable();
            let targets: Vec<u16> = task.targets(&warehouse).iter().map(|item| item.id).collect();
            assert_eq!(targets, in_phases, "{task:?}");
        }
    }
}
