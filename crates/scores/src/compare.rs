//! Comparisons of conditions and runs by name.
//!
//! The statistics are [`compare()`](crate::compare())'s.

use domain::names::UnknownName;
use domain::shell_word;

use crate::comparison::{Comparison, compare};
use crate::trial::Trials;
use run_log::{Difference, LEARNED_FACTS, Manifest, RunLog};

/// Why two configurations cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// No condition of the run has the name.
    #[error(transparent)]
    Unknown(#[from] UnknownName),
    /// There is nothing to compare.
    #[error("{a} and {b} have no finished case in common")]
    NoCommonCase {
        /// One side.
        a: String,
        /// The other.
        b: String,
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
}

/// Compares two conditions, each by its name in the log, of one run or of two.
///
/// # Errors
/// When a name is not a condition of its run, or the two have no case in common.
pub fn compare_conditions(
    a: (&RunLog, &str),
    b: (&RunLog, &str),
) -> Result<Comparison, CompareError> {
    can_be_paired(a.0, b.0)?;
    let (first, second) = (trials(a)?, trials(b)?);
    let same_run = std::ptr::eq(a.0, b.0);
    let name = |(log, name): (&RunLog, &str)| {
        if same_run { name.to_owned() } else { format!("{}: {name}", log.name) }
    };
    let (a, b) = (name(a), name(b));
    compare((&a, &first), (&b, &second)).ok_or(CompareError::NoCommonCase { a, b })
}

fn trials<'a>((log, name): (&'a RunLog, &str)) -> Result<Trials<'a>, UnknownName> {
    let mut trials = Trials::by_condition(log);
    let condition = trials.keys().find(|condition| condition.to_string() == name).copied();
    condition.and_then(|condition| trials.remove(&condition)).ok_or_else(|| {
        UnknownName::new("condition of the run", name, trials.keys().map(ToString::to_string))
    })
}

/// Compares every condition that both runs have, in the order of the first.
///
/// # Errors
/// When they have none in common.
pub fn compare_runs(a: &RunLog, b: &RunLog) -> Result<Vec<Comparison>, CompareError> {
    can_be_paired(a, b)?;
    let (name_a, name_b) = (a.name.clone(), b.name.clone());
    let (trials_a, trials_b) = (Trials::by_condition(a), Trials::by_condition(b));
    let compared = trials_a.iter().filter_map(|(condition, first)| {
        let names = [&name_a, &name_b].map(|run| format!("{run}: {condition}"));
        compare((&names[0], first), (&names[1], trials_b.get(condition)?))
    });
    let compared: Vec<Comparison> = compared.collect();
    if compared.is_empty() {
        return Err(CompareError::NoCommonCase { a: name_a, b: name_b });
    }
    Ok(compared)
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
        return Err(CompareError::OfStreams { run: log.dir.display().to_string() });
    }
    let hash = |log: &RunLog, what: &str| log.manifest.hashes.get(what).cloned();
    for what in ["layout", "catalogue", "cases"] {
        if hash(a, what) != hash(b, what) {
            let (a, b) = (a.dir.display().to_string(), b.dir.display().to_string());
            return Err(CompareError::OtherWorld { a, b, what: what.to_owned() });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
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
}
