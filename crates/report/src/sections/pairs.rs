//! The comparisons that the paper's questions ask for, paired by case and repetition.

use conditions::Condition;
use domain::{MemoryKind, Representation};
use scores::compare::pair_conditions;
use scores::{Pairing, conclude};

use super::comparisons::{ComparedRow, ComparedRows};
use crate::document::ReportBlock;
use crate::sections::conditions::setting;
use crate::view::{ScoredRun, name};

/// A condition without its memory: start and route, demonstrations.
type Setting = (&'static str, &'static str);

/// What is compared, then the first setting and the second.
const COMPARED: [(&str, Setting, Setting); 5] = [
    (
        "new − original start (1 demo)",
        ("new/unchanged", "original"),
        ("original/unchanged", "original"),
    ),
    ("4 − 1 demos (new start)", ("new/unchanged", "4"), ("new/unchanged", "original")),
    ("blocked − unchanged (4 demos)", ("new/blocked", "4"), ("new/unchanged", "4")),
    ("irrelevant − 4 relevant", ("new/unchanged", "irrelevant"), ("new/unchanged", "4")),
    ("confusable − 4 relevant", ("new/unchanged", "confusable"), ("new/unchanged", "4")),
];

/// A pair of conditions that were both run, with the labels of its row.
struct LabelledPair<'a> {
    group: String,
    label: String,
    pairing: Pairing<'a>,
}

impl<'a> LabelledPair<'a> {
    /// `None` where one of them was not run, or they have no pair.
    fn of(view: &ScoredRun<'a>, group: &str, label: &str, [a, b]: [&str; 2]) -> Option<Self> {
        let pairing = pair_conditions((view.log, a), (view.log, b)).ok()?;
        Some(Self { group: group.to_owned(), label: label.to_owned(), pairing })
    }
}

/// The comparisons of the section are made together.
pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let mut labels = Vec::new();
    let mut pairings = Vec::new();
    let asked = asked(view);
    let count_asked = asked.len();
    for LabelledPair { group, label, pairing } in asked.into_iter().chain(against_others(view)) {
        labels.push((group, label));
        pairings.push(pairing);
    }
    let compared = conclude(pairings);
    let labelled = labels.into_iter().zip(&compared);
    let rows: Vec<ComparedRow<'_>> = labelled
        .map(|((group, label), comparison)| ComparedRow { group: Some(group), label, comparison })
        .collect();
    let (first, others) = rows.split_at(count_asked);
    let [first, others] = [first, others].map(<[ComparedRow<'_>]>::to_vec);
    let stubs = &["Memory", "Comparison"];
    let all = ComparedRows { stubs, rows };
    ReportBlock::tables([
        ComparedRows { stubs: &["Representation", "Comparison"], rows: first }.figures(
            view.id("pairs"),
            "Pairs of conditions on the same cases and repetitions, and first minus second, SR in percent, with 95 % intervals over \
             cases. Episodes: finished under each of both, and those of the same case and repetition, of which alone the figures are."
                .to_owned(),
        ),
        ComparedRows { stubs, rows: others }.figures(
            view.id("external-pairs"),
            "Each external memory against the other memories of the run, in the same setting and on the same cases and \
             repetitions: first minus second, as above."
                .to_owned(),
        ),
        all.conclusions(view.id("pairs-conclusions")),
        all.unpaired(view.id("pairs-unpaired")),
    ])
}

/// Those that the paper's questions ask for.
fn asked<'a>(view: &ScoredRun<'a>) -> Vec<LabelledPair<'a>> {
    let of_memory = |representation: MemoryKind| {
        let of = |(rest, demonstrations): Setting| name(representation, rest, demonstrations);
        let group = view.label(representation);
        let mut pairs: Vec<_> = COMPARED
            .iter()
            .map(|&(label, a, b)| (label, of(a), of(b)))
            // Working memory has no demonstrations, so some of these are the same condition twice.
            .filter(|(_, a, b)| a != b)
            .collect();
        if representation.uses_demonstrations() {
            let baseline = name(Representation::Working.into(), "new/unchanged", "none");
            let label = "memory − working memory (4 demos)";
            pairs.push((label, of(("new/unchanged", "4")), baseline));
        }
        let labelled = move |(label, a, b): (&str, String, String)| {
            LabelledPair::of(view, &group, label, [&a, &b])
        };
        pairs.into_iter().filter_map(labelled).collect::<Vec<_>>()
    };
    view.memories().into_iter().flat_map(of_memory).collect()
}

/// Each external memory against every other memory of the run, in each setting that both have.
fn against_others<'a>(view: &ScoredRun<'a>) -> Vec<LabelledPair<'a>> {
    let memories = view.memories();
    let mut pairs = Vec::new();
    for name in view.external_memories() {
        let memory = MemoryKind::External(name);
        let own = view.scores.conditions.iter().map(|score| score.condition);
        for condition in own.filter(|condition| condition.memory == memory) {
            // Two external memories are compared once.
            for &other in memories.iter().filter(|other| **other < memory) {
                let Condition { start, route, demonstrations, variation, arm, .. } = condition;
                let other = Condition::new(other, start, route, demonstrations, variation);
                pairs.extend(other.and_then(|other| {
                    let other = other.with_mismatch(condition.mismatch).with_arm(arm);
                    let label = format!("{name} − {} ({})", other.memory, setting(&condition));
                    let names = [condition.to_string(), other.to_string()];
                    LabelledPair::of(
                        view,
                        name.as_str(),
                        &label,
                        names.each_ref().map(|name| &**name),
                    )
                }));
            }
        }
    }
    pairs
}
