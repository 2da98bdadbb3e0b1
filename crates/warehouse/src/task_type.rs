//! The ten types of tasks, and their groups in results (specification, section 3).

/// A type of tasks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum TaskType {
    /// Reach one instance of A.
    FindType,
    /// Reach one item of the category C.
    FindCategory,
    /// Visit every instance of A.
    EveryOfType,
    /// Visit every item of the category C.
    EveryOfCategory,
    /// Visit one A and one B, in any order.
    BothTypes,
    /// Visit an A, then a B.
    InOrder,
    /// Reach an A, then end at the origin.
    FindAndReturn,
    /// Visit every A, then end at the origin.
    EveryAndReturn,
    /// Reach an A, then a B, then the same A again.
    Revisit,
    /// Visit an A, then a B, then end at the origin.
    InOrderAndReturn,
}

/// A number that no type of tasks has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{0} is not a task type; 1 to 10 are")]
pub struct UnknownTaskType(pub u8);

impl TaskType {
    /// All types, in the order of their numbers.
    pub const ALL: [Self; 10] = [
        Self::FindType,
        Self::FindCategory,
        Self::EveryOfType,
        Self::EveryOfCategory,
        Self::BothTypes,
        Self::InOrder,
        Self::FindAndReturn,
        Self::EveryAndReturn,
        Self::Revisit,
        Self::InOrderAndReturn,
    ];

    /// The paper's number of the type, 1 to 10.
    pub const fn number(self) -> u8 {
        match self {
            Self::FindType => 1,
            Self::FindCategory => 2,
            Self::EveryOfType => 3,
            Self::EveryOfCategory => 4,
            Self::BothTypes => 5,
            Self::InOrder => 6,
            Self::FindAndReturn => 7,
            Self::EveryAndReturn => 8,
            Self::Revisit => 9,
            Self::InOrderAndReturn => 10,
        }
    }

    /// The paper's name of the type.
    pub const fn name(self) -> &'static str {
        match self {
            Self::FindType => "single object search",
            Self::FindCategory => "category search",
            Self::EveryOfType => "exhaustive object search",
            Self::EveryOfCategory => "exhaustive category search",
            Self::BothTypes => "unordered search",
            Self::InOrder => "ordered search",
            Self::FindAndReturn => "search with return",
            Self::EveryAndReturn => "exhaustive with return",
            Self::Revisit => "revisit",
            Self::InOrderAndReturn => "two with return",
        }
    }

    /// The group that it is in.
    pub const fn group(self) -> TaskGroup {
        match self {
            Self::FindType | Self::FindCategory => TaskGroup::Basic,
            Self::EveryOfType | Self::EveryOfCategory | Self::BothTypes | Self::InOrder => {
                TaskGroup::MultiObject
            }
            Self::FindAndReturn | Self::EveryAndReturn | Self::InOrderAndReturn => {
                TaskGroup::ReturnLoop
            }
            Self::Revisit => TaskGroup::Revisit,
        }
    }

    /// Whether an A has to be visited before a B.
    pub const fn is_ordered(self) -> bool {
        matches!(self, Self::InOrder | Self::Revisit | Self::InOrderAndReturn)
    }

    /// Whether the task ends at the origin.
    pub const fn ends_at_origin(self) -> bool {
        matches!(self, Self::FindAndReturn | Self::EveryAndReturn | Self::InOrderAndReturn)
    }

    /// Whether every instance has to be visited.
    pub const fn is_exhaustive(self) -> bool {
        matches!(self, Self::EveryOfType | Self::EveryOfCategory | Self::EveryAndReturn)
    }
}

impl TryFrom<u8> for TaskType {
    type Error = UnknownTaskType;

    fn try_from(number: u8) -> Result<Self, UnknownTaskType> {
        let found = Self::ALL.into_iter().find(|one| one.number() == number);
        found.ok_or(UnknownTaskType(number))
    }
}

/// Groups of task types in results.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum TaskGroup {
    /// Types 1 and 2.
    Basic,
    /// Types 3 to 6.
    MultiObject,
    /// Types 7, 8 and 10.
    ReturnLoop,
    /// Type 9.
    Revisit,
}

impl TaskGroup {
    /// All groups, in the order of the paper's table.
    pub const ALL: [Self; 4] = [Self::Basic, Self::MultiObject, Self::ReturnLoop, Self::Revisit];

    /// The heading of the group's column.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Basic => "basic",
            Self::MultiObject => "multi-object",
            Self::ReturnLoop => "return loops",
            Self::Revisit => "revisit",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_the_types_and_other_numbers_are_refused() {
        for number in 0..=u8::MAX {
            match TaskType::try_from(number) {
                Ok(found) => assert_eq!(TaskType::ALL[usize::from(number) - 1], found),
                Err(error) => {
                    assert!(!(1..=10).contains(&number));
                    assert_eq!(
                        error.to_string(),
                        format!("{number} is not a task type; 1 to 10 are")
                    );
                }
            }
        }
        let groups: Vec<_> = TaskType::ALL.map(TaskType::group).into();
        let [basic, multi, loops, revisit] = TaskGroup::ALL;
        assert_eq!(
            groups,
            [basic, basic, multi, multi, multi, multi, loops, loops, revisit, loops]
        );
    }
}
