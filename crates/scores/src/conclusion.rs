//! What is concluded from a comparison: whether a difference is shown, what could have been, and what the conclusion rests on.

use serde::Serialize;

use super::comparison::Counts;
use super::sign_test::{CorrectedSignTest, LEVEL, MOST_CASES, is_shown};

/// What a comparison shows of the first configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ComparisonVerdict {
    /// It succeeds in more cases.
    Better,
    /// It succeeds in fewer cases.
    Worse,
    /// Neither is shown. That is not to say that there is no difference.
    NoDifferenceShown,
}

impl ComparisonVerdict {
    /// The verdict in words.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Better => "better",
            Self::Worse => "worse",
            Self::NoDifferenceShown => "no difference shown",
        }
    }

    /// The verdict about cases of which so many are better and worse, where p is multiplied by `factor`.
    fn of(counts: Counts, factor: usize) -> Self {
        match is_shown(counts.p(), factor) {
            false => Self::NoDifferenceShown,
            true if counts.more_under_a > counts.more_under_b => Self::Better,
            true => Self::Worse,
        }
    }
}

/// What follows from a comparison, made together with others.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Conclusion {
    /// The number of comparisons that were made together, this one among them.
    pub family: usize,
    /// p after the correction for them (Holm).
    pub corrected_p: f64,
    /// By what p was multiplied to decide: the number of comparisons less those of the others that show a difference without
    /// this one.
    pub factor: usize,
    /// Whether the first is better or worse: the corrected p is below 5 %.
    pub verdict: ComparisonVerdict,
    /// The smallest difference of the success rates, in percentage points, that would have been shown with a probability of
    /// 80 % with as many cases, of which as large a share is unequal, in the same family. `None` where none would.
    pub detectable: Option<f64>,
    /// The number of cases beyond these with which the observed difference would be shown with a probability of 80 %.
    /// `None` where one is shown already, where as many cases are better as worse, and where it would take more than
    /// [`MOST_CASES`] cases.
    pub more_cases: Option<u32>,
    /// What the verdict becomes when a part of the pairs is left out.
    pub robustness: Robustness,
    /// All this as a sentence.
    pub sentence: String,
}

/// A comparison, as far as its test needs it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tested {
    pub(super) counts: Counts,
    pub(super) cases: usize,
    /// The difference of the success rates.
    pub(super) points: f64,
    /// The mean distance of the success rates of a case that is better or worse.
    pub(super) points_of_unequal_case: f64,
}

/// A p value as it is printed: never as zero, and below 5 % never as 5 %.
pub fn p_value(p: f64) -> String {
    match p {
        p if p < 0.001 => "<0.001".to_owned(),
        p if p < LEVEL && format!("{p:.3}") == "0.050" => "<0.050".to_owned(),
        p => format!("{p:.3}"),
    }
}

impl Conclusion {
    pub(super) fn new(
        tested: &Tested,
        (family, corrected_p): (usize, f64),
        test: &CorrectedSignTest,
        robustness: Robustness,
    ) -> Self {
        let Tested { counts, cases, .. } = *tested;
        let factor = test.factor;
        let verdict = ComparisonVerdict::of(counts, factor);
        let count = u32::try_from(cases).unwrap_or(u32::MAX);
        let unequal = counts.unequal() as f64 / cases as f64;
        let needed = || {
            let [better, worse] =
                [counts.more_under_a, counts.more_under_b].map(|count| count as u32);
            test.cases_needed(count, better, worse)
        };
        let needed = (verdict == ComparisonVerdict::NoDifferenceShown).then(needed).flatten();
        let detectable = test.detectable(count, unequal);
        let mut conclusion = Self {
            family,
            corrected_p,
            factor,
            verdict,
            detectable: detectable.map(|excess| excess * tested.points_of_unequal_case),
            more_cases: needed.map(|needed| needed - count),
            robustness,
            sentence: String::new(),
        };
        conclusion.sentence = conclusion.in_words(tested, test.least_cases());
        conclusion
    }

    fn in_words(&self, tested: &Tested, least_cases: Option<u32>) -> String {
        let Tested { counts, cases, points, .. } = *tested;
        let verdict = match self.verdict {
            ComparisonVerdict::Better => "Better",
            ComparisonVerdict::Worse => "Worse",
            ComparisonVerdict::NoDifferenceShown => "No difference shown",
        };
        let difference = match format!("{points:+.1}") {
            none if ["+0.0", "-0.0"].contains(&none.as_str()) => "0.0".to_owned(),
            some => some.replace('-', "−"),
        };
        let p = match p_value(self.corrected_p) {
            least if least.starts_with('<') => format!("p < {}", &least[1..]),
            p => format!("p = {p}"),
        };
        let corrected = if self.family > 1 { "corrected " } else { "" };
        let Counts { more_under_a: better, more_under_b: worse } = counts;
        // With several repetitions the cases may say other than their mean.
        let is_opposed = (better > worse && points < 0.0) || (better < worse && points > 0.0);
        let finding = match is_opposed {
            false => format!("{verdict}: {difference} points, {corrected}{p}."),
            true => format!(
                "{verdict}: {better} cases are better and {worse} worse, although the mean difference is {difference} points; \
                 {corrected}{p}."
            ),
        };
        if self.verdict != ComparisonVerdict::NoDifferenceShown {
            return finding;
        }
        let would_be_shown = match (self.detectable, least_cases) {
            (Some(points), _) => {
                format!("With a probability of 80 %, {points:.1} points would be shown")
            }
            (None, Some(least)) if cases < least as usize => {
                format!("At least {least} cases are needed to show any difference")
            }
            (None, _) => "No difference would be shown with a probability of 80 %".to_owned(),
        };
        let observed = if is_opposed { "what the cases say" } else { "this difference" };
        let needed = match self.more_cases {
            Some(more) => format!("to show {observed} would take about {more} more cases"),
            None if better == worse => "as many cases are better as worse".to_owned(),
            None => format!("to show {observed} would take more than {MOST_CASES} cases"),
        };
        format!("{finding} {would_be_shown}; {needed}.")
    }
}

/// What the verdict becomes when a part of the pairs is left out. The others keep theirs: p is multiplied by the same factor.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Robustness {
    /// Without each group of tasks, by its name.
    pub groups: LeftOut,
    /// Without each type of tasks, by its number.
    pub tasks: LeftOut,
    /// Without each repetition, by its number.
    pub repetitions: LeftOut,
    /// Without each case, by its id.
    pub cases: LeftOut,
}

/// The parts of one kind, left out one at a time.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// The number of parts that were left out; 0 where there is only one.
    pub parts: usize,
    /// Those without which the verdict is another.
    pub changes: Vec<ChangedVerdict>,
}

/// A part of the pairs without which the verdict is another.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ChangedVerdict {
    /// The name of the part.
    pub without: String,
    /// The verdict without it.
    pub verdict: ComparisonVerdict,
}

impl LeftOut {
    /// For the counts of all pairs, and those that remain without each part, if any do.
    pub(super) fn of(all: Counts, parts: Vec<(String, Option<Counts>)>, factor: usize) -> Self {
        let verdict = ComparisonVerdict::of(all, factor);
        let tried = || parts.iter().filter_map(|(name, rest)| Some((name, (*rest)?)));
        let change = |(without, rest): (&String, Counts)| {
            let changed = ComparisonVerdict::of(rest, factor);
            let without = without.clone();
            (changed != verdict).then_some(ChangedVerdict { without, verdict: changed })
        };
        Self { parts: tried().count(), changes: tried().filter_map(change).collect() }
    }

    fn names(&self) -> impl Iterator<Item = &str> {
        self.changes.iter().map(|change| change.without.as_str())
    }
}

impl Robustness {
    /// The parts without which the verdict is another, in words: `return loops, task 9, any of 12 of 100 cases`. Empty where
    /// there are none.
    pub fn changing(&self) -> String {
        let named = |left_out: &LeftOut, kind: &str| {
            left_out.names().map(|name| format!("{kind}{name}")).collect::<Vec<_>>()
        };
        let mut changing = named(&self.groups, "");
        changing.extend(named(&self.tasks, "task "));
        changing.extend(named(&self.repetitions, "repetition "));
        let LeftOut { parts, changes } = &self.cases;
        if !changes.is_empty() {
            changing.push(format!("any of {} of {parts} cases", changes.len()));
        }
        changing.join(", ")
    }

    /// What the verdict rests on, as a sentence: `This holds except without return loops, task 9.`, `This holds without any one
    /// group, task or case.`
    pub fn in_words(&self) -> String {
        let changing = self.changing();
        if !changing.is_empty() {
            return format!("This holds except without {changing}.");
        }
        let kinds = [
            (&self.groups, "group"),
            (&self.tasks, "task"),
            (&self.repetitions, "repetition"),
            (&self.cases, "case"),
        ];
        let tried: Vec<&str> = kinds
            .into_iter()
            .filter(|(left_out, _)| left_out.parts > 0)
            .map(|(_, kind)| kind)
            .collect();
        match tried.split_last() {
            None => "Nothing can be left out: there is one case only.".to_owned(),
            Some((last, [])) => format!("This holds without any one {last}."),
            Some((last, others)) => {
                format!("This holds without any one {} or {last}.", others.join(", "))
            }
        }
    }
}
