//! Published figures beside the run's, one by one, and what was configured differently.

use std::collections::{BTreeMap, BTreeSet};

use scores::{ConditionScore, Interval};

use crate::document::{
    Missing, ReportBlock, ReportSection, RowGroup, Table, TableCell, TableColumn, TableRow,
};
use crate::published::configuration::{CASES, RUNS, WINDOW, facts, known};
use crate::published::figures::{FIGURES, OwnFigure, of_group};
use crate::published::{Published, PublishedCondition, PublishedFigure, group_key};
use crate::view::{ScoredRun, published_text, signed, with_interval};

const NOT_MEASURED: Missing =
    Missing::NotMeasured("the run did not measure it, or it is not defined there");
const NO_INTERVAL: Missing = Missing::NotApplicable("no interval of this figure is computed");

/// A published figure beside the run's.
struct Pair {
    label: String,
    digits: usize,
    theirs: PublishedFigure,
    ours: Option<OwnFigure>,
}

/// Where a published figure lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    Covered,
    Above,
    Below,
}

impl Place {
    fn of(PublishedFigure { mean, .. }: PublishedFigure, Interval { low, high }: Interval) -> Self {
        if mean > high {
            Self::Above
        } else if mean < low {
            Self::Below
        } else {
            Self::Covered
        }
    }

    const fn words(self) -> &'static str {
        match self {
            Self::Covered => "inside",
            Self::Above => "above",
            Self::Below => "below",
        }
    }
}

impl Pair {
    fn place(&self) -> Option<Place> {
        Some(Place::of(self.theirs, self.ours?.interval?))
    }

    fn row(&self) -> TableRow {
        let Self { label, digits, theirs, ours } = self;
        let missing = || TableCell::Missing(NOT_MEASURED);
        let own = |OwnFigure { value, interval, .. }: &OwnFigure| {
            with_interval(format!("{value:.digits$}").replace('-', "−"), *interval, *digits)
        };
        let difference =
            |own: &OwnFigure| TableCell::Value(signed(own.value - theirs.mean, *digits));
        let place = match (ours, self.place()) {
            (_, Some(place)) => TableCell::Value(place.words().to_owned()),
            (Some(_), None) => TableCell::Missing(NO_INTERVAL),
            (None, None) => missing(),
        };
        let cells = vec![
            TableCell::Value(published_text(*theirs, *digits)),
            ours.as_ref().map_or_else(missing, own),
            ours.as_ref().map_or_else(missing, difference),
            place,
        ];
        TableRow::new(label, cells)
    }
}

/// The published figures of a condition, each with the run's.
fn pairs(published: &PublishedCondition, score: &ConditionScore) -> Vec<Pair> {
    let kinds = FIGURES.iter().filter_map(|kind| {
        Some(Pair {
            label: kind.label.to_owned(),
            digits: kind.digits,
            theirs: (kind.theirs)(published)?,
            ours: (kind.ours)(score),
        })
    });
    let groups = published.groups.iter().map(|(key, theirs)| Pair {
        label: format!("SR %, {key}"),
        digits: 1,
        theirs: *theirs,
        ours: of_group(score, key),
    });
    kinds.chain(groups).collect()
}

/// The conditions that the publication and the run both have.
type Common<'a> = Vec<(&'a PublishedCondition, &'a ConditionScore)>;

/// The section about the run's figures beside the published ones.
pub(crate) fn section(view: &ScoredRun<'_>) -> ReportSection {
    let published = view.published;
    let common: Common<'_> = published
        .conditions
        .iter()
        .filter_map(|condition| Some((condition, view.score(&condition.name)?)))
        .collect();
    let compared: Vec<(&str, Vec<Pair>)> = common
        .iter()
        .map(|(condition, score)| (condition.name.as_str(), pairs(condition, score)))
        .collect();
    let Published { title, source, policy, notes, .. } = published;
    let source = if source.is_empty() { String::new() } else { format!(" ({source})") };
    let mut blocks = vec![
        ReportBlock::Text(format!("Published: {title}{source}. Its policy: {policy}.")),
        ReportBlock::Notice(summary(&compared, published.conditions.len())),
    ];
    blocks.extend(doubts(view).into_iter().map(ReportBlock::Notice));
    let all: Vec<&Pair> = compared.iter().flat_map(|(_, pairs)| pairs).collect();
    if all.iter().any(|pair| pair.place().is_some()) {
        blocks.push(ReportBlock::Text(meaning(published, &common)));
    }
    blocks.extend(notes.iter().cloned().map(ReportBlock::Text));
    let group = |(name, pairs): &(&str, Vec<Pair>)| RowGroup {
        label: Some((*name).to_owned()),
        rows: pairs.iter().map(Pair::row).collect(),
    };
    let figures = Table {
        id: view.id("reproduction"),
        caption: "Every published figure of a condition that this run has, this run's with its 95 % interval, this run's minus the \
                  published one, and where the published one lies: inside this run's interval, above or below it. Published: mean ± \
                  standard deviation over runs, where it is printed. Img: images per request. Mtok: million tokens per 100 cases."
            .to_owned(),
        stubs: vec!["Condition".to_owned(), "Figure".to_owned()],
        columns: vec![
            TableColumn::new("Published"),
            TableColumn::new("This run"),
            TableColumn::new("Difference"),
            TableColumn::text("Published lies"),
        ],
        groups: compared.iter().filter(|(_, pairs)| !pairs.is_empty()).map(group).collect(),
    };
    if !figures.groups.is_empty() {
        blocks.push(ReportBlock::Table(figures));
    }
    blocks.extend(configuration(view, &common));
    ReportSection::new(
        view.id("s-reproduction"),
        "Reproduction: the run beside published figures",
        blocks,
    )
}

/// What may be mistaken in the file of figures.
fn doubts(view: &ScoredRun<'_>) -> Vec<String> {
    let conditions = &view.published.conditions;
    let percentages = conditions.iter().flat_map(|condition| {
        let PublishedCondition { sr, follow, recovery, from_others, groups, .. } = condition;
        let single = [sr, follow, recovery, from_others].into_iter().flatten();
        single.chain(groups.values()).map(|figure| figure.mean)
    });
    let largest = percentages.reduce(f64::max);
    let fractions = largest.filter(|largest| *largest > 0.0 && *largest <= 1.0).map(|_| {
        "No published percentage is above 1. The format has percentages from 0 to 100: if these are fractions, nothing below is \
         true of them."
            .to_owned()
    });
    let told_groups: BTreeSet<String> =
        view.log.world.groups.iter().map(|group| group_key(&group.name)).collect();
    let keys: BTreeSet<&String> = conditions.iter().flat_map(|one| one.groups.keys()).collect();
    let unknown: Vec<&str> =
        keys.into_iter().filter(|key| !told_groups.contains(*key)).map(String::as_str).collect();
    let groups = (!unknown.is_empty()).then(|| {
        format!(
            "The world of this run has no task group {}; it has {}.",
            unknown.join(", "),
            Vec::from_iter(told_groups).join(", ")
        )
    });
    fractions.into_iter().chain(groups).collect()
}

/// How many published figures lie in the run's intervals, and what is not counted.
fn summary(compared: &[(&str, Vec<Pair>)], conditions: usize) -> String {
    let pairs = || compared.iter().flat_map(|(_, pairs)| pairs);
    let places: Vec<Place> = pairs().filter_map(Pair::place).collect();
    let covered = places.iter().filter(|place| **place == Place::Covered).count();
    let measured = pairs().filter(|pair| pair.ours.is_some()).count();
    let figures = |count: usize, one: &str, many: &str| match count {
        1 => format!("1 published figure {one}"),
        count => format!("{count} published figures {many}"),
    };
    let mut text = match places.len() {
        0 if compared.is_empty() => "This run has none of the published conditions.".to_owned(),
        0 => "No published figure has an interval in this run.".to_owned(),
        all => format!("{covered} of {} in this run's intervals.", figures(all, "lies", "lie")),
    };
    let without = measured - places.len();
    if without > 0 {
        text +=
            &format!(" Not counted: {} no interval in this run.", figures(without, "has", "have"));
    }
    let missing = pairs().count() - measured;
    if missing > 0 {
        text += &format!(" {} not measured in this run.", figures(missing, "was", "were"));
    }
    if !compared.is_empty() && compared.len() < conditions {
        text += &format!(" This run has {} of {conditions} published conditions.", compared.len());
    }
    text
}

/// What it says that a published figure lies in an interval, with the errors that the published ones have.
fn meaning(published: &Published, common: &Common<'_>) -> String {
    let mut text = "A figure inside an interval is not contradicted by this run; a wide interval contradicts little. The intervals \
                    are of this run alone, and a published figure has an error of its own: if both measured the \
                    same, each on its own set of as many cases, about 83 % of the published figures would lie in the intervals; on \
                    the same cases more would. Figures of one condition are of the same episodes, so they lie in or out together."
        .to_owned();
    let errors = common.iter().filter_map(|(condition, _)| {
        let runs = published.runs(condition)?;
        Some(condition.sr?.std? / f64::from(runs).sqrt())
    });
    let errors: Vec<f64> = errors.collect();
    let end = |of: fn(f64, f64) -> f64| errors.iter().copied().reduce(of);
    let has_spread =
        common.iter().any(|(condition, _)| condition.sr.is_some_and(|sr| sr.std.is_some()));
    match end(f64::min).zip(end(f64::max)) {
        Some((least, most)) => {
            let [least, most] = [least, most].map(|error| format!("{error:.1}"));
            let errors = match least == most {
                true => format!("{least} points"),
                false => format!("from {least} to {most} points"),
            };
            text += &format!(
                " The published deviations are over runs on the same cases. Divided by the root of the number of runs they are the \
                 error of a published SR that comes from repetition, {errors}; they say nothing about other cases."
            );
        }
        _ if has_spread => {
            text += " The publication gives deviations over runs without the number of runs, so the error of its means is unknown.";
        }
        _ => {
            text += " The publication gives no deviations, so the error of its figures is unknown."
        }
    }
    text
}

/// A fact that the publication states.
struct StatedFact {
    name: String,
    theirs: String,
    ours: String,
    comparison: String,
}

const SAME: &str = "same";
const DIFFERS: &str = "differs";

impl StatedFact {
    fn of(name: &str, theirs: &str, ours: &str) -> Self {
        let comparison = if theirs == ours { SAME } else { DIFFERS };
        let [name, theirs, ours, comparison] = [name, theirs, ours, comparison].map(str::to_owned);
        Self { name, theirs, ours, comparison }
    }
}

/// What was configured, stated and not.
fn configuration(view: &ScoredRun<'_>, common: &Common<'_>) -> Vec<ReportBlock> {
    let published = view.published;
    let mut own = facts(view.log);
    let windows = common.iter().map(|(_, score)| score.condition.variation.window);
    own.insert(WINDOW.to_owned(), distinct(windows));
    let mut stated: BTreeMap<&str, &str> = published
        .configuration
        .iter()
        .map(|(name, value)| (name.as_str(), value.as_str()))
        .collect();
    let policy = view.log.manifest.policy_label().to_string();
    let mut rows = vec![StatedFact::of("policy", &published.policy, &policy)];
    type OfPublished = fn(&Published, &PublishedCondition) -> Option<u32>;
    type OfRun = fn(&ConditionScore) -> usize;
    let counts: [(&str, OfPublished, OfRun); 2] = [
        (CASES, Published::cases, |score| score.cases),
        (RUNS, Published::runs, |score| score.runs),
    ];
    for (name, theirs, ours) in counts {
        stated.remove(name);
        let both = common
            .iter()
            .filter_map(|(condition, score)| Some((theirs(published, condition)?, ours(score))));
        let both: Vec<(u32, usize)> = both.collect();
        let differ = both.iter().filter(|(theirs, ours)| *theirs as usize != *ours).count();
        let fact = StatedFact {
            name: name.to_owned(),
            theirs: distinct(both.iter().map(|(theirs, _)| *theirs)),
            ours: distinct(both.iter().map(|(_, ours)| *ours)),
            comparison: match differ {
                0 => SAME.to_owned(),
                _ if differ == both.len() => DIFFERS.to_owned(),
                _ => format!("{DIFFERS} in {differ} of {} conditions", both.len()),
            },
        };
        rows.extend((!both.is_empty()).then_some(fact));
    }
    rows.extend(stated.iter().map(|(name, value)| {
        StatedFact::of(name, value, own.get(*name).map_or("not set", String::as_str))
    }));
    // What differs comes first.
    rows.sort_by_key(|fact| fact.comparison == SAME);
    let rows = rows.into_iter().map(|StatedFact { name, theirs, ours, comparison }| {
        (name, vec![theirs, ours, comparison])
    });
    let columns = ["Published", "This run", "Comparison"];
    let caption = "What was configured, as it was published and in this run's manifest. Texts are compared word for word: the \
                   same thing may have two names.";
    let table = Table::of_text(view.id("configuration"), caption, (&["Fact"], &columns), rows)
        .with_text(&columns);
    let stated: BTreeSet<&str> = stated.into_keys().collect();
    // The window is in the names of conditions.
    let unknown: Vec<&str> = known()
        .filter(|name| ![CASES, RUNS, WINDOW].contains(name))
        .filter(|name| !stated.contains(name) && own.contains_key(*name))
        .collect();
    let mut blocks = vec![ReportBlock::Table(table)];
    if !unknown.is_empty() {
        let unknown = unknown.join(", ");
        blocks.push(ReportBlock::Text(format!(
            "Not stated in the publication, so unknown: {unknown}."
        )));
    }
    blocks
}

/// The different values, in order.
fn distinct<T: Ord + ToString>(values: impl Iterator<Item = T>) -> String {
    let values: BTreeSet<T> = values.collect();
    values.iter().map(T::to_string).collect::<Vec<_>>().join(", ")
}
