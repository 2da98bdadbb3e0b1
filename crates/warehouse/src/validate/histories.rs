//! Constraints on each case's histories of other tasks (specification, section 6), and their statistics.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use super::report::{CountRange, HistoryStatistics, ValidationReport, ensure};
use crate::case::{Case, CaseSet, History, Mixture, Start};
use crate::mixed::{MOST_SERVED, Overlap, in_common, target_ids};
use crate::world::Warehouse;

// A constraint below contains this number.
const _: () = assert!(MOST_SERVED == 4);

/// A history of a case.
struct Listed<'a> {
    index: usize,
    case: &'a Case,
    mixture: Mixture,
    history: History,
    /// The case that it is a demonstration of; the set may lack it.
    source: Option<&'a Case>,
}

impl Listed<'_> {
    fn overlap(&self, warehouse: &Warehouse, set: &CaseSet) -> Option<Overlap> {
        Overlap::of(warehouse, set, self.index, self.history)
    }

    /// A violation by this history.
    fn at(&self, violation: impl fmt::Display) -> String {
        let source = self.source.map_or("a case that is not in the set", |source| &source.id);
        let (id, kind, start) = (&self.case.id, self.mixture.name(), self.history.start.name());
        format!("{id} {kind}, {source} {start}: {violation}")
    }
}

pub(super) fn check(report: &mut ValidationReport, warehouse: &Warehouse, set: &CaseSet) {
    let listed: Vec<Listed<'_>> = set
        .cases
        .iter()
        .enumerate()
        .flat_map(|(index, case)| Mixture::ALL.map(|mixture| (index, case, mixture)))
        .flat_map(|(index, case, mixture)| {
            case.mixed(mixture).map(|history| {
                let source = set.cases.get(history.case);
                Listed { index, case, mixture, history, source }
            })
        })
        .collect();

    report.push(
        "mixed: two different histories of each kind, of other cases",
        listed.iter().map(|l| {
            let is_demonstration = Start::DEMONSTRATIONS.contains(&l.history.start);
            let is_foreign = l.source.is_some() && l.history.case != l.index;
            let [one, other] = l.case.mixed(l.mixture);
            ensure(is_demonstration && is_foreign && one != other, || {
                l.at("is not one of two demonstrations of other cases")
            })
        }),
    );
    report.push(
        "mixed: no item counts for the history's task and for the case's",
        listed.iter().filter_map(|l| {
            let [own, theirs] =
                [&l.case.task, &l.source?.task].map(|task| target_ids(warehouse, task));
            Some(
                in_common(&own, &theirs)
                    .map_or(Ok(()), |item| Err(l.at(format!("item {item} counts for both")))),
            )
        }),
    );
    let measured: Vec<(&Listed<'_>, Overlap)> =
        listed.iter().filter_map(|l| Some((l, l.overlap(warehouse, set)?))).collect();
    for (mixture, constraint) in [
        (Mixture::Irrelevant, "irrelevant: the history shares no pose with the test reference"),
        (Mixture::Confusable, "confusable: at a shared pose the history continues differently"),
    ] {
        let of_kind = measured.iter().filter(|(l, _)| l.mixture == mixture);
        report.push(
            constraint,
            of_kind.map(|(l, overlap)| {
                let Overlap { shared_poses, conflicts } = overlap;
                ensure(overlap.is(mixture), || {
                    l.at(format!("{shared_poses} poses are shared, {conflicts} in conflict"))
                })
            }),
        );
    }

    let mut served: BTreeMap<(Mixture, History), Vec<&Listed<'_>>> = BTreeMap::new();
    for l in &listed {
        served.entry((l.mixture, l.history)).or_default().push(l);
    }
    report.push(
        "mixed: no history serves more than four cases as one kind",
        served.values().map(|by| {
            ensure(by.len() <= MOST_SERVED, || by[0].at(format!("serves {} cases", by.len())))
        }),
    );
    report.mixtures = Mixture::ALL.into_iter().filter_map(|m| statistics(m, &measured)).collect();
}

/// `None` if there are no histories of this kind.
fn statistics(mixture: Mixture, measured: &[(&Listed<'_>, Overlap)]) -> Option<HistoryStatistics> {
    let of_kind = || measured.iter().filter(|(l, _)| l.mixture == mixture);
    let histories: BTreeSet<History> = of_kind().map(|(l, _)| l.history).collect();
    let cases: BTreeSet<usize> = histories.iter().map(|history| history.case).collect();
    Some(HistoryStatistics {
        mixture: mixture.name(),
        listed: of_kind().count(),
        different: histories.len(),
        cases: cases.len(),
        shared_poses: CountRange::of(of_kind().map(|(_, overlap)| overlap.shared_poses))?,
        conflicts: CountRange::of(of_kind().map(|(_, overlap)| overlap.conflicts))?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(set: &CaseSet) -> ValidationReport {
        let mut report = ValidationReport { lines: Vec::new(), mixtures: Vec::new() };
        check(&mut report, &Warehouse::shipped(), set);
        report
    }

    #[test]
    fn the_shipped_histories_are_counted() {
        let report = checked(&CaseSet::shipped());
        assert!(report.is_clean(), "{report}");
        insta::assert_snapshot!(report, @"
        ok     400 checked    0 violated  mixed: two different histories of each kind, of other cases
        ok     400 checked    0 violated  mixed: no item counts for the history's task and for the case's
        ok     200 checked    0 violated  irrelevant: the history shares no pose with the test reference
        ok     200 checked    0 violated  confusable: at a shared pose the history continues differently
        ok     364 checked    0 violated  mixed: no history serves more than four cases as one kind
        irrelevant: 200 histories, 200 different ones of 91 cases
                   shared poses 0, conflicts 0
        confusable: 200 histories, 164 different ones of 74 cases
                   shared poses 1 to 32 (median 11), conflicts 1 to 5 (median 3)
        ");
    }

    #[test]
    fn a_corrupted_history_breaks_the_line_about_it() {
        let shipped = CaseSet::shipped();
        type Corruption = fn(&mut [Case]);
        let table: [(Corruption, &str); 9] = [
            (|cases| cases[8].irrelevant[0].case = 8, "mixed: two different"),
            (|cases| cases[8].confusable[1].case = 100, "mixed: two different"),
            (|cases| cases[8].irrelevant[1].start = Start::Test, "mixed: two different"),
            (|cases| cases[8].confusable[0] = cases[8].confusable[1], "mixed: two different"),
            (
                |cases| cases[cases[8].irrelevant[0].case].task = cases[8].task,
                "mixed: no item counts",
            ),
            (|cases| cases[8].irrelevant = cases[8].confusable, "irrelevant: the history"),
            (|cases| cases[8].confusable = cases[8].irrelevant, "confusable: at a shared pose"),
            (
                |cases| {
                    cases[cases[8].confusable[0].case].distant = cases[8].test.clone();
                    cases[8].confusable[0].start = Start::Distant;
                },
                "confusable: at a shared pose",
            ),
            (
                |cases| {
                    let common = cases[50].irrelevant;
                    cases[..5].iter_mut().for_each(|case| case.irrelevant = common);
                },
                "mixed: no history serves",
            ),
        ];
        for (row, (corrupt, constraint)) in table.into_iter().enumerate() {
            let mut corrupted = shipped.clone();
            corrupt(&mut corrupted.cases);
            let report = checked(&corrupted);
            let line = report.lines.iter().find(|line| line.constraint.starts_with(constraint));
            let line = line.unwrap_or_else(|| panic!("no line begins with {constraint:?}"));
            assert!(!line.violations.is_empty(), "corruption {row}\n{report}");
        }
    }
}
