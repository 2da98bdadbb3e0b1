//! Two configurations on the same episodes: both figures, the mean difference with its interval, and a test of whether one
//! succeeds in more cases than the other.
//!
//! Episodes are paired by case and repetition, and only pairs are compared. So both sides have as many repetitions of a case,
//! and where the configurations do not differ, a case is as likely to succeed more often under the one as under the other:
//! that is what the sign test supposes. With more repetitions on one side it would not hold.
//!
//! [`Pairing`] holds the pairs; [`conclude`] makes [`Comparison`]s of several that are made together.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::compare::in_short;
use super::conclusion::{Conclusion, LeftOut, Robustness, Tested};
use super::holm::{factors, holm};
use super::interval::{Interval, Units};
use super::mean::mean;
use super::sign_test::{CorrectedSignTest, sign_test};
use super::trial::{Trials, path_weight};
use super::unpaired::{Absence, ComparedSide, PlannedEpisodes, Unpaired};
use conditions::Condition;
use run_log::{EpisodeRecord, RunLog};

/// How configuration A compares with configuration B on the episodes of the same case and repetition.
///
/// Figures are means over cases of each case's mean over its pairs of episodes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The name of the first configuration.
    pub a: String,
    /// The name of the second.
    pub b: String,
    /// Cases of which there is a pair.
    pub cases: usize,
    /// Finished episodes of A.
    pub episodes_a: usize,
    /// Finished episodes of B.
    pub episodes_b: usize,
    /// Pairs of episodes: of one case and one repetition, finished under both.
    pub pairs: usize,
    /// Finished episodes of A without one of B. They enter nothing here.
    pub unpaired_a: usize,
    /// Finished episodes of B without one of A.
    pub unpaired_b: usize,
    /// Success rates in percent, their difference in percentage points.
    pub sr: FigureDifference,
    /// SPL.
    pub spl: FigureDifference,
    /// Cases with more successes under A than under B.
    pub more_under_a: usize,
    /// Cases with more successes under B.
    pub more_under_b: usize,
    /// Two-sided p of the exact sign test on those two counts; with one pair of each case this is McNemar's exact test.
    /// 1 when the counts are equal. Not corrected for the number of comparisons.
    pub p: f64,
    /// What follows, with all comparisons that were made together.
    #[serde(flatten)]
    pub conclusion: Conclusion,
    /// The unpaired episodes, those of A first, by case and repetition.
    pub unpaired: Vec<Unpaired>,
}

impl Comparison {
    /// The unpaired episodes in words, where the sides are called by `names`: case and repetition of the first of each side and
    /// reason, of the others how many. Empty where there are none.
    pub fn unpaired_in_words(&self, names: [&str; 2]) -> String {
        let mut by_reason: BTreeMap<(ComparedSide, Absence), Vec<String>> = BTreeMap::new();
        for Unpaired { case, repetition, finished_in, absence } in &self.unpaired {
            let reason = (*finished_in, *absence);
            by_reason.entry(reason).or_default().push(format!("{case}/run{repetition}"));
        }
        let told = |((side, absence), episodes): ((ComparedSide, Absence), Vec<String>)| {
            let [own, other] = match side {
                ComparedSide::A => names,
                ComparedSide::B => [names[1], names[0]],
            };
            let (count, listed) = (episodes.len(), in_short(&episodes));
            format!("{count} of {own}, {} in {other} ({listed})", absence.words())
        };
        by_reason.into_iter().map(told).collect::<Vec<_>>().join("; ")
    }
}

/// A figure of both configurations, and the mean difference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FigureDifference {
    /// The figure of A.
    pub a: f64,
    /// The figure of B.
    pub b: f64,
    /// A minus B.
    pub mean: f64,
    /// The 95 % interval of the difference over the cases, or over the streams. `None` for one case or stream, and for
    /// streams that all differ by the same.
    pub interval: Option<Interval>,
}

/// One side of a comparison: a condition of a run.
#[derive(Debug, Clone)]
pub struct Side<'a> {
    /// The name by which the comparison calls it.
    pub name: String,
    /// The run.
    pub log: &'a RunLog,
    /// The condition.
    pub condition: Condition,
}

/// The pairs of one case.
#[derive(Debug, Clone, Copy, Default)]
struct PairedCase {
    pairs: u32,
    /// Successes under each side, counted: means of counts may differ by rounding where they are equal.
    successes: [u32; 2],
    /// The sum of `s_i l_i / max(p_i, l_i)` under each side.
    path_weight: [f64; 2],
}

impl PairedCase {
    fn add(&mut self, pair: [&EpisodeRecord; 2]) {
        self.pairs += 1;
        for (side, record) in pair.into_iter().enumerate() {
            self.successes[side] += u32::from(record.is_success());
            self.path_weight[side] += path_weight(record);
        }
    }

    fn success_rates(&self) -> [f64; 2] {
        self.successes.map(|count| 100.0 * f64::from(count) / f64::from(self.pairs))
    }

    fn path_weighted(&self) -> [f64; 2] {
        self.path_weight.map(|sum| sum / f64::from(self.pairs))
    }
}

/// The number of cases with more successes under either side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Counts {
    pub(super) more_under_a: usize,
    pub(super) more_under_b: usize,
}

impl Counts {
    fn of(cases: &[PairedCase]) -> Self {
        let more = |first: usize, second: usize| {
            cases.iter().filter(|case| case.successes[first] > case.successes[second]).count()
        };
        Self { more_under_a: more(0, 1), more_under_b: more(1, 0) }
    }

    /// Those of the cases that are in `self` and not in `part`.
    const fn without(self, part: Self) -> Self {
        Self {
            more_under_a: self.more_under_a - part.more_under_a,
            more_under_b: self.more_under_b - part.more_under_b,
        }
    }

    pub(super) fn p(self) -> f64 {
        sign_test(self.more_under_a, self.more_under_b)
    }

    /// Cases that do not have as many successes under either side.
    pub(super) const fn unequal(self) -> usize {
        self.more_under_a + self.more_under_b
    }
}

/// The pairs of two configurations, before anything is concluded from them.
#[derive(Debug, Clone)]
pub struct Pairing<'a> {
    a: Side<'a>,
    b: Side<'a>,
    /// The pairs, by case and repetition: at least one.
    pairs: Vec<[&'a EpisodeRecord; 2]>,
    /// Finished episodes of each side.
    episodes: [usize; 2],
    unpaired: Vec<Unpaired>,
    sr: FigureDifference,
    spl: FigureDifference,
    pub(super) counts: Counts,
}

impl<'a> Pairing<'a> {
    /// The pairs of `a` and `b`; `None` when they have none.
    pub fn of(a: Side<'a>, b: Side<'a>) -> Option<Self> {
        Self::of_cases(a, b, |_| true)
    }

    /// The pairs of the selected cases.
    pub(super) fn of_cases(
        a: Side<'a>,
        b: Side<'a>,
        is_selected: impl Fn(&str) -> bool,
    ) -> Option<Self> {
        let trials = [&a, &b].map(|side| Trials::of(side.log, &side.condition, &is_selected));
        let others: BTreeMap<(&str, u32), &EpisodeRecord> =
            trials[1].iter().map(|record| (place(record), record)).collect();
        let pair = |record: &'a EpisodeRecord| Some([record, *others.get(&place(record))?]);
        let pairs: Vec<[&EpisodeRecord; 2]> = trials[0].iter().filter_map(pair).collect();
        let paired: BTreeSet<(&str, u32)> = pairs.iter().map(|[record, _]| place(record)).collect();
        let unpaired = |(trials, side): (&Trials<'a>, ComparedSide), other: &Side<'a>| {
            let alone: Vec<&EpisodeRecord> =
                trials.iter().filter(|record| !paired.contains(&place(record))).collect();
            let planned =
                (!alone.is_empty()).then(|| PlannedEpisodes::of(other.log, other.condition));
            let of_record = |planned: PlannedEpisodes<'_>| {
                let one = |record: &&EpisodeRecord| Unpaired {
                    case: record.case.clone(),
                    repetition: record.run,
                    finished_in: side,
                    absence: planned.absence(record),
                };
                alone.iter().map(one).collect::<Vec<_>>()
            };
            planned.map(of_record).unwrap_or_default()
        };
        let mut without_partner = unpaired((&trials[0], ComparedSide::A), &b);
        without_partner.extend(unpaired((&trials[1], ComparedSide::B), &a));
        let cases = by_case(pairs.iter().copied());
        Some(Self {
            episodes: trials.each_ref().map(Trials::count),
            unpaired: without_partner,
            sr: difference(&cases, PairedCase::success_rates, Interval::POINTS)?,
            spl: difference(&cases, PairedCase::path_weighted, Interval::SHARE_DIFFERENCE)?,
            counts: Counts::of(&cases),
            a,
            b,
            pairs,
        })
    }

    /// Two-sided p of the exact sign test on the cases with more successes under either side.
    pub fn p(&self) -> f64 {
        self.counts.p()
    }

    /// The differences of the success rates, in percentage points, and of SPL.
    pub const fn differences(&self) -> [FigureDifference; 2] {
        [self.sr, self.spl]
    }

    /// Cases of which there is a pair.
    pub fn cases(&self) -> usize {
        self.pairs.chunk_by(|[a, _], [b, _]| a.case == b.case).count()
    }

    /// The mean distance of the success rates of a case that has more successes under one side, in percentage points; 100 where
    /// there is no such case.
    fn points_of_unequal_case(&self) -> f64 {
        let cases = by_case(self.pairs.iter().copied());
        let distances = cases.iter().map(|case| {
            let [a, b] = case.success_rates();
            (a - b).abs()
        });
        match self.counts.unequal() {
            0 => 100.0,
            unequal => distances.sum::<f64>() / unequal as f64,
        }
    }

    /// The comparison, when no other is made with it.
    pub fn alone(self) -> Comparison {
        let p = self.p();
        self.conclude((1, p), &CorrectedSignTest::new(1))
    }

    /// The comparison as one of a family of so many, with its corrected p and the test that decides it.
    fn conclude(self, correction: (usize, f64), test: &CorrectedSignTest) -> Comparison {
        let cases = self.cases();
        let tested = Tested {
            counts: self.counts,
            cases,
            points: self.sr.mean,
            points_of_unequal_case: self.points_of_unequal_case(),
        };
        let conclusion = Conclusion::new(&tested, correction, test, self.robustness(test.factor));
        let [unpaired_a, unpaired_b] = self.episodes.map(|count| count - self.pairs.len());
        Comparison {
            p: self.p(),
            cases,
            episodes_a: self.episodes[0],
            episodes_b: self.episodes[1],
            pairs: self.pairs.len(),
            unpaired_a,
            unpaired_b,
            sr: self.sr,
            spl: self.spl,
            more_under_a: self.counts.more_under_a,
            more_under_b: self.counts.more_under_b,
            conclusion,
            a: self.a.name,
            b: self.b.name,
            unpaired: self.unpaired,
        }
    }

    /// What is concluded without each group, task, repetition and case.
    fn robustness(&self, factor: usize) -> Robustness {
        let world = &self.a.log.world;
        let group = |record: &'a EpisodeRecord| world.group_of(record.task);
        let each_case = self.pairs.chunk_by(|[a, _], [b, _]| a.case == b.case).map(|pairs| {
            let own = Counts::of(&by_case(pairs.iter().copied()));
            let is_last = pairs.len() == self.pairs.len();
            (pairs[0][0].case.clone(), (!is_last).then(|| self.counts.without(own)))
        });
        let changes = |rest: Vec<(String, Option<Counts>)>| LeftOut::of(self.counts, rest, factor);
        Robustness {
            groups: changes(self.without_each(group)),
            tasks: changes(self.without_each(|record| Some(record.task))),
            repetitions: changes(self.without_each(|record| Some(record.run))),
            cases: changes(each_case.collect()),
        }
    }

    /// The counts without each of the parts into which `part` divides the pairs; `None` where nothing remains.
    fn without_each<T: Ord + ToString>(
        &self,
        part: impl Fn(&'a EpisodeRecord) -> Option<T>,
    ) -> Vec<(String, Option<Counts>)> {
        let parts: BTreeSet<T> = self.pairs.iter().filter_map(|[record, _]| part(record)).collect();
        let without = |left_out: T| {
            let is_kept =
                |[record, _]: &[&'a EpisodeRecord; 2]| part(record).as_ref() != Some(&left_out);
            let rest = by_case(self.pairs.iter().copied().filter(is_kept));
            (left_out.to_string(), (!rest.is_empty()).then(|| Counts::of(&rest)))
        };
        parts.into_iter().map(without).collect()
    }
}

/// The case and repetition of an episode.
fn place(record: &EpisodeRecord) -> (&str, u32) {
    (&record.case, record.run)
}

/// The pairs of each case, in the order of their ids.
fn by_case<'a>(pairs: impl Iterator<Item = [&'a EpisodeRecord; 2]>) -> Vec<PairedCase> {
    let mut cases: BTreeMap<&str, PairedCase> = BTreeMap::new();
    for pair in pairs {
        cases.entry(&pair[0].case).or_default().add(pair);
    }
    cases.into_values().collect()
}

/// The comparisons of `pairings`, which are made together: p is corrected for their number.
pub fn conclude(pairings: Vec<Pairing<'_>>) -> Vec<Comparison> {
    let p: Vec<f64> = pairings.iter().map(Pairing::p).collect();
    let family = pairings.len();
    // Most comparisons of a family have the same factor.
    let mut tests: BTreeMap<usize, CorrectedSignTest> = BTreeMap::new();
    let compared = pairings.into_iter().zip(factors(&p)).zip(holm(&p));
    let comparison = |((pairing, factor), corrected_p): ((Pairing<'_>, usize), f64)| {
        let test = tests.entry(factor).or_insert_with(|| CorrectedSignTest::new(factor));
        pairing.conclude((family, corrected_p), test)
    };
    compared.map(comparison).collect()
}

/// The difference of a figure, which lies in `range`; `None` without cases.
fn difference(
    cases: &[PairedCase],
    figure: fn(&PairedCase) -> [f64; 2],
    range: Interval,
) -> Option<FigureDifference> {
    let side = |side: usize| mean(cases.iter().map(|case| figure(case)[side]));
    let differences: Vec<f64> = cases
        .iter()
        .map(|case| {
            let [a, b] = figure(case);
            a - b
        })
        .collect();
    Some(FigureDifference {
        a: side(0)?,
        b: side(1)?,
        mean: mean(differences.iter().copied())?,
        interval: Units::alike(differences).interval(range),
    })
}
