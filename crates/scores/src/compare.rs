//! Comparisons of conditions and runs by name.
//!
//! The statistics are those of [`Pairing`] and [`conclude()`].

use std::collections::BTreeSet;

use conditions::Condition;
use domain::names::UnknownName;
use domain::shell_word;
use serde::Serialize;

use crate::comparison::{Comparison, Pairing, Side, conclude};
use crate::trial::Trials;
use run_log::{Difference, EpisodeRecord, LEARNED_FACTS, Manifest, RunLog};

/// Why two configurations cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// No condition of the run has the name.
    #[error(transparent)]
    Unknown(#[from] UnknownName),
    /// The runs have no condition in common.
    #[error(
        "{a} and {b} have no condition in common: {a} has {of_a}, {b} has {of_b}. `--compare A B` compares a condition A of \
         {a} with a condition B of {b}"
    )]
    NoCommonCondition {
        /// One run.
        a: String,
        /// The other.
        b: String,
        /// Its conditions.
        of_a: String,
        /// Those of the other.
        of_b: String,
    },
    /// There is nothing to compare.
    #[error(
        "{a} and {b} have finished no case in the same repetition: {a} has {of_a}, {b} has {of_b}{hint}"
    )]
    NoCommonCase {
        /// One side.
        a: String,
        /// The other.
        b: String,
        /// Its cases and repetitions.
        of_a: String,
        /// Those of the other.
        of_b: String,
        /// What can be done, after a semicolon; empty for two conditions of one run.
        hint: &'static str,
    },
    /// Episodes of streams are not independent of each other, so their cases are no pairs.
    #[error(
        "{run} consists of streams, whose episodes cannot be paired case by case; `memtransfer score {}` compares its \
         conditions by stream",
        shell_word(run)
    )]
    OfStreams {
        /// The run's folder.
        run: String,
    },
    /// The same case ids mean different things.
    #[error(
        "{a} and {b} were run on different {what}, so their cases cannot be paired; run one of them again \
         with the other's --assets"
    )]
    OtherWorld {
        /// One run's folder.
        a: String,
        /// The other's.
        b: String,
        /// The content that differs: layout, catalogue or cases.
        what: String,
    },
    /// The runs are of worlds with other names.
    #[error(
        "{a} was run in the world {world_of_a} and {b} in the world {world_of_b}, so their cases cannot be paired"
    )]
    OtherWorldName {
        /// One run's folder.
        a: String,
        /// The other's.
        b: String,
        /// The name of its world.
        world_of_a: String,
        /// That of the other's.
        world_of_b: String,
    },
    /// Cases have the same id and differ in task, instruction, start or reference.
    #[error(
        "{a} and {b} call other cases by the same ids, so their cases cannot be paired: {} of the {shared} in both differ ({})",
        differing.len(),
        in_short(differing)
    )]
    OtherCases {
        /// One run's folder.
        a: String,
        /// The other's.
        b: String,
        /// The ids of the cases that differ.
        differing: Vec<String>,
        /// The number of ids that both have.
        shared: usize,
    },
    /// Both sides are the same.
    #[error("{side} cannot be compared with itself")]
    Same {
        /// The run's folder, or the condition.
        side: String,
    },
}

/// The number of names in a message; of more, the rest is a count.
const NAMED: usize = 4;

/// Names in a sentence: `a, b, c, d and 8 more`.
pub fn in_short(names: &[String]) -> String {
    match names.len().checked_sub(NAMED) {
        None | Some(0) => names.join(", "),
        Some(more) => format!("{} and {more} more", names[..NAMED].join(", ")),
    }
}

/// Pairs two conditions, each by its name in the log, of one run or of two.
///
/// # Errors
/// When a name is not a condition of its run, or the two have no case in common.
pub fn pair_conditions<'a>(
    a: (&'a RunLog, &str),
    b: (&'a RunLog, &str),
) -> Result<Pairing<'a>, CompareError> {
    can_be_paired(a.0, b.0)?;
    let is_same_run = a.0.is_same_run(b.0);
    if is_same_run && a.1 == b.1 {
        return Err(CompareError::Same { side: a.1.to_owned() });
    }
    let side = |(log, name): (&'a RunLog, &str)| -> Result<Side<'a>, UnknownName> {
        let conditions = finished_conditions(log);
        let found = conditions.iter().find(|condition| condition.to_string() == name);
        let condition = *found.ok_or_else(|| {
            let known = conditions.iter().map(ToString::to_string);
            UnknownName::new("condition of the run", name, known)
        })?;
        let name = if is_same_run { name.to_owned() } else { format!("{}: {name}", log.name) };
        Ok(Side { name, log, condition })
    };
    let (a, b) = (side(a)?, side(b)?);
    Pairing::of(a.clone(), b.clone()).ok_or_else(|| CompareError::NoCommonCase {
        of_a: places(Trials::of(a.log, &a.condition, |_| true).iter()),
        of_b: places(Trials::of(b.log, &b.condition, |_| true).iter()),
        hint: if is_same_run { "" } else { OTHER_CASES },
        a: a.name,
        b: b.name,
    })
}

/// What can be done about runs of different cases.
const OTHER_CASES: &str = "; run one of them with the other's --cases, --limit and --runs";

/// The conditions of which two runs have episodes, paired.
#[derive(Debug)]
pub struct PairedRuns<'a> {
    /// Those with a pair, in the order of the first run: at least one.
    pub pairings: Vec<Pairing<'a>>,
    /// The others.
    pub left_out: LeftOutConditions,
}

/// Conditions of two runs that are not compared, by name.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct LeftOutConditions {
    /// The first run alone has a finished episode.
    pub only_a: Vec<String>,
    /// The second run alone has one.
    pub only_b: Vec<String>,
    /// Both have one, but none of the same case and repetition.
    pub without_pair: Vec<String>,
}

impl LeftOutConditions {
    /// A sentence for each kind, with the names of the runs; of many conditions the first are named.
    pub fn sentences(&self, a: &str, b: &str) -> Vec<String> {
        let told = |names: &[String], what: String| {
            (!names.is_empty()).then(|| format!("Not compared, {what}: {}.", in_short(names)))
        };
        let found = [
            told(&self.only_a, format!("only {a} has an episode of them")),
            told(&self.only_b, format!("only {b} has an episode of them")),
            told(&self.without_pair, "no case in the same repetition in both runs".to_owned()),
        ];
        found.into_iter().flatten().collect()
    }
}

/// Pairs every condition that both runs have.
///
/// # Errors
/// When they have none in common, or no case of one.
pub fn pair_runs<'a>(a: &'a RunLog, b: &'a RunLog) -> Result<PairedRuns<'a>, CompareError> {
    are_two_runs(a, b)?;
    let (of_a, of_b) = (finished_conditions(a), finished_conditions(b));
    let names = |conditions: &BTreeSet<Condition>| -> Vec<String> {
        conditions.iter().map(ToString::to_string).collect()
    };
    let common = &of_a & &of_b;
    if common.is_empty() {
        return Err(CompareError::NoCommonCondition {
            a: a.name.clone(),
            b: b.name.clone(),
            of_a: in_short(&names(&of_a)),
            of_b: in_short(&names(&of_b)),
        });
    }
    let side = |log: &'a RunLog, condition: Condition| {
        let name = format!("{}: {condition}", log.name);
        Side { name, log, condition }
    };
    let (mut pairings, mut without_pair) = (Vec::new(), Vec::new());
    for condition in &common {
        match Pairing::of(side(a, *condition), side(b, *condition)) {
            Some(pairing) => pairings.push(pairing),
            None => without_pair.push(condition.to_string()),
        }
    }
    if pairings.is_empty() {
        return Err(CompareError::NoCommonCase {
            a: a.name.clone(),
            b: b.name.clone(),
            of_a: places(a.episodes.iter()),
            of_b: places(b.episodes.iter()),
            hint: OTHER_CASES,
        });
    }
    let (only_a, only_b) = (names(&(&of_a - &common)), names(&(&of_b - &common)));
    Ok(PairedRuns { pairings, left_out: LeftOutConditions { only_a, only_b, without_pair } })
}

/// Compares every condition that both runs have, in the order of the first. All are made together.
///
/// # Errors
/// As [`pair_runs`].
pub fn compare_runs(a: &RunLog, b: &RunLog) -> Result<Vec<Comparison>, CompareError> {
    pair_runs(a, b).map(|paired| conclude(paired.pairings))
}

/// The conditions of `log` that have a finished episode.
fn finished_conditions(log: &RunLog) -> BTreeSet<Condition> {
    log.episodes.iter().map(EpisodeRecord::condition).collect()
}

/// The cases and repetitions of episodes in words.
fn places<'a>(records: impl Iterator<Item = &'a EpisodeRecord> + Clone) -> String {
    let cases: BTreeSet<&str> = records.clone().map(|record| record.case.as_str()).collect();
    let repetitions: BTreeSet<u32> = records.map(|record| record.run).collect();
    let cases: Vec<String> = cases.into_iter().map(str::to_owned).collect();
    let repetitions: Vec<String> = repetitions.iter().map(ToString::to_string).collect();
    let repetition = if repetitions.len() == 1 { "repetition" } else { "repetitions" };
    format!("{} in {repetition} {}", in_short(&cases), in_short(&repetitions))
}

/// The settings, contents and versions in which two runs differ beside their policies and their lists of episodes.
/// Any of them can be why their figures differ.
pub fn differing_settings(a: &RunLog, b: &RunLog) -> Vec<Difference> {
    let mut differences = b.manifest.differences(&a.manifest);
    differences.retain(|one| !["policy", "policy-cmd", "model"].contains(&one.key.as_str()));
    differences.extend(LEARNED_FACTS.into_iter().filter_map(|fact| learned_difference(a, b, fact)));
    for other in author_differences(&a.manifest, &b.manifest) {
        // Other authors write other texts.
        differences.retain(|one| one.key != format!("document {}", other.key));
        differences.push(Difference { key: format!("author of document {}", other.key), ..other });
    }
    differences
}

/// The documents of two runs that have other authors, by name.
fn author_differences(a: &Manifest, b: &Manifest) -> Vec<Difference> {
    let both = a.documents.iter().filter_map(|(name, of_a)| {
        let (there, here) = (a.document_author(of_a), b.document_author(b.documents.get(name)?));
        let (key, differ) = (name.clone(), there != here);
        differ.then(|| Difference { key, there: there.to_string(), here: here.to_string() })
    });
    both.collect()
}

/// What the policies of two runs learned differently of their servers, which refuse fields or ignore them.
fn learned_difference(a: &RunLog, b: &RunLog, fact: &str) -> Option<Difference> {
    let learned = |log: &RunLog| log.manifest.processes.get("policy")?.get(fact).cloned();
    let (there, here) = (learned(a), learned(b));
    // A policy that is no model has none of them.
    let is_of_models = [a, b].iter().all(|log| log.manifest.settings.model.is_some());
    (is_of_models && there != here).then(|| {
        let shown = |fact: Option<String>| fact.unwrap_or_else(|| "as asked".to_owned());
        Difference { key: fact.to_owned(), there: shown(there), here: shown(here) }
    })
}

/// Whether cases with the same id are the same in both runs, and each episode stands for itself.
pub(super) fn can_be_paired(a: &RunLog, b: &RunLog) -> Result<(), CompareError> {
    if let Some(log) = [a, b].into_iter().find(|log| log.manifest.settings.stream.is_some()) {
        return Err(CompareError::OfStreams { run: folder(log) });
    }
    let hash = |log: &RunLog, what: &str| log.manifest.hashes.get(what).cloned();
    for what in ["layout", "catalogue", "cases"] {
        if hash(a, what) != hash(b, what) {
            let [a, b] = [a, b].map(folder);
            return Err(CompareError::OtherWorld { a, b, what: what.to_owned() });
        }
    }
    // The name is empty before the world has told it.
    let [world_of_a, world_of_b] = [a, b].map(|log| log.world.declaration.name.clone());
    if world_of_a != world_of_b && !world_of_a.is_empty() && !world_of_b.is_empty() {
        let [a, b] = [a, b].map(folder);
        return Err(CompareError::OtherWorldName { a, b, world_of_a, world_of_b });
    }
    let shared = || a.cases.iter().filter_map(|(id, case)| Some((id, case, b.cases.get(id)?)));
    let differing = shared().filter(|(_, of_a, of_b)| !of_a.is_same_case(of_b));
    let differing: Vec<String> = differing.map(|(id, _, _)| id.clone()).collect();
    if !differing.is_empty() {
        let shared = shared().count();
        let [a, b] = [a, b].map(folder);
        return Err(CompareError::OtherCases { a, b, differing, shared });
    }
    Ok(())
}

/// Whether the two are different runs that can be paired.
pub(super) fn are_two_runs(a: &RunLog, b: &RunLog) -> Result<(), CompareError> {
    if a.is_same_run(b) {
        return Err(CompareError::Same { side: folder(a) });
    }
    can_be_paired(a, b)
}

fn folder(log: &RunLog) -> String {
    log.dir.display().to_string()
}

#[cfg(test)]
mod tests {
    use case_book::{CaseFacts, Reference};
    use conditions::{Route, Start};
    use domain::State;

    use super::*;
    use rigs::records::{
        log, model_document, model_settings, record, script_document, stream_log, stream_record,
    };

    #[test]
    fn settings_that_differ_are_named_with_both_values() {
        let (mut a, mut b) = (log(vec![record("a", true)]), log(vec![record("a", false)]));
        a.manifest.settings.seed = 3;
        (b.manifest.settings.max_steps, b.manifest.settings.frame_size) = (60, 224);
        (b.manifest.settings.keyframes, b.manifest.settings.limit) = (20, Some(5));
        let differing = differing_settings(&a, &b);
        let shown: Vec<String> = differing
            .iter()
            .map(|one| format!("{}: {} and {}", one.key, one.there, one.here))
            .collect();
        insta::assert_snapshot!(shown.join("\n"), @"
        frame-size: 448 and 224
        keyframes: 40 and 20
        max-steps: 200 and 60
        seed: 3 and 1
        ");
        for log in [&mut a, &mut b] {
            log.manifest.settings = rigs::records::manifest().settings;
            log.manifest.settings.model = Some(model_settings("m"));
        }
        let facts = [("fields".to_owned(), "the server refuses temperature".to_owned())];
        b.manifest.processes.insert("policy".to_owned(), facts.into());
        let [of_server] = &differing_settings(&a, &b)[..] else { panic!("one difference") };
        assert_eq!(
            [&*of_server.key, &*of_server.there, &*of_server.here],
            ["fields", "as asked", "the server refuses temperature"]
        );
        b.manifest.processes.clear();
        let in_both = ["semantic/4", "summary/4"];
        a.manifest.documents = in_both.map(|name| (name.to_owned(), script_document())).into();
        b.manifest.documents = in_both.map(|name| (name.to_owned(), model_document("m"))).into();
        let differing = differing_settings(&a, &b);
        let shown = differing.iter().map(|one| format!("{}: {}, {}", one.key, one.there, one.here));
        let expected =
            in_both.map(|name| format!("author of document {name}: extractive, the model m"));
        assert_eq!(shown.collect::<Vec<_>>(), expected);
        let compared = compare_runs(&a, &b).unwrap();
        assert_eq!((compared[0].sr.a, compared[0].sr.b, compared[0].sr.mean), (100.0, 0.0, 100.0));
        let streams = stream_log(vec![stream_record("a", true)], [2, 1, 2]);
        let error = compare_runs(&a, &streams).unwrap_err();
        insta::assert_snapshot!(error, @"run consists of streams, whose episodes cannot be paired case by case; `memtransfer score run` compares its conditions by stream");
    }

    fn case(id: &str, instruction: &str, length: u32) -> CaseFacts {
        let reference = Reference {
            start: Start::Original,
            route: Route::Unchanged,
            begin: State::new(&[0.0]).unwrap(),
            actions: Vec::new(),
            length,
        };
        CaseFacts {
            id: id.to_owned(),
            task: 1,
            instruction: instruction.to_owned(),
            paraphrase: None,
            references: vec![reference],
            invalidated_when_blocked: false,
        }
    }

    #[test]
    fn cases_that_share_only_their_ids_are_not_paired() {
        // Worlds of other programs hash nothing, and number their cases from 1.
        let run = |folder: &str, cases: &[CaseFacts]| {
            let mut log = log(vec![record("a", true), record("b", true)]);
            log.manifest.hashes.clear();
            log.dir = folder.into();
            log.cases = cases.iter().map(|case| (case.id.clone(), case.clone())).collect();
            log
        };
        let cases = [case("a", "Go to the door.", 9), case("b", "Open the drawer.", 7)];
        let first = run("first", &cases);
        let mut grown = run("grown", &[&cases[..], &[case("c", "Push.", 4)]].concat());
        assert_eq!(compare_runs(&first, &grown).unwrap()[0].pairs, 2);
        // A start that only one run tests makes no other case.
        grown.cases.get_mut("a").unwrap().references.clear();
        assert_eq!(compare_runs(&first, &grown).unwrap()[0].pairs, 2);
        let changed = [case("a", "Go to the window.", 9), case("b", "Open the drawer.", 8)];
        for (other, count) in [
            ([cases[0].clone(), changed[1].clone()], "1 of the 2"),
            (changed.clone(), "2 of the 2"),
        ] {
            let error = compare_runs(&first, &run("other", &other)).unwrap_err().to_string();
            let expected = "first and other call other cases by the same ids, so their cases cannot be paired: ";
            assert!(error.starts_with(&format!("{expected}{count} in both differ (")), "{error}");
        }
        let mut elsewhere = run("elsewhere", &cases);
        elsewhere.world.declaration.name = "kitchen".to_owned();
        let error = compare_runs(&first, &elsewhere).unwrap_err();
        insta::assert_snapshot!(error, @"first was run in the world warehouse and elsewhere in the world kitchen, so their cases cannot be paired");
    }

    #[test]
    fn nothing_is_compared_with_itself() {
        let run = log(vec![record("a", true)]);
        let error = compare_runs(&run, &run).unwrap_err();
        insta::assert_snapshot!(error, @"run cannot be compared with itself");
        let name = run.episodes[0].condition().to_string();
        let error = pair_conditions((&run, &name), (&run, &name)).unwrap_err();
        assert_eq!(error.to_string(), format!("{name} cannot be compared with itself"));
    }
}
