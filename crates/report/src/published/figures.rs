//! The figures that a publication may have of a condition, each with the run's.

use scores::{ConditionScore, Derived, Interval, Spread};

use super::{PublishedCondition, PublishedFigure, group_key};

/// A figure of a run.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OwnFigure {
    /// The figure.
    pub(crate) value: f64,
    /// Its standard deviation over runs, where it has one.
    pub(crate) std: Option<f64>,
    /// Its interval, where one is computed.
    pub(crate) interval: Option<Interval>,
}

/// A figure that is not of a task group.
pub(crate) struct FigureKind {
    /// Its name in a file.
    pub(crate) key: &'static str,
    /// Its name in tables.
    pub(crate) label: &'static str,
    /// Digits after the point.
    pub(crate) digits: usize,
    /// The published figure.
    pub(crate) theirs: fn(&PublishedCondition) -> Option<PublishedFigure>,
    /// The run's; `None` where it was not measured or is not defined.
    pub(crate) ours: fn(&ConditionScore) -> Option<OwnFigure>,
}

fn spread(Spread { mean, std, interval, .. }: Spread) -> OwnFigure {
    OwnFigure { value: mean, std, interval }
}

fn derived(Derived { value, interval }: Derived) -> OwnFigure {
    OwnFigure { value, std: None, interval }
}

/// Writes the table: name in a file, name in tables and digits, published field, the run's figure.
macro_rules! kinds {
    ($($key:literal $label:literal $digits:literal $field:ident, $ours:expr;)*) => {
        [$(FigureKind {
            key: $key,
            label: $label,
            digits: $digits,
            theirs: |published| published.$field,
            ours: $ours,
        }),*]
    };
}

/// Every figure, in the order of tables.
pub(crate) const FIGURES: [FigureKind; 9] = kinds! {
    "sr" "SR %" 1 sr, |score| Some(spread(score.sr));
    "spl" "SPL" 3 spl, |score| Some(spread(score.spl));
    "change" "Δ" 1 change, |score| score.blocked?.change.map(derived);
    "retention" "Retention" 2 retention, |score| score.blocked?.retention.map(derived);
    "follow" "Follow %" 1 follow, |score| score.blocked?.follow.map(spread);
    "recovery" "Recovery %" 1 recovery, |score| score.blocked?.recovery.map(spread);
    "from-others" "From other tasks %" 1 from_others, |score| score.from_other_cases.map(spread);
    "img" "Img" 1 img, |score| score.images_per_request.map(spread);
    "mtok" "Mtok" 1 mtok, |score| score.tokens_per_100.map(|tokens| {
        let OwnFigure { value, std, .. } = spread(tokens);
        OwnFigure { value: value / 1e6, std: std.map(|std| std / 1e6), interval: None }
    });
};

/// The run's success rate in the task group that a file calls `key`.
pub(crate) fn of_group(score: &ConditionScore, key: &str) -> Option<OwnFigure> {
    let group = score.groups.iter().find(|group| group_key(&group.group) == key)?;
    Some(spread(group.sr))
}
