//! The extractive builder: deterministic and offline. It writes instructions, states, actions, feedback and sub-goals of
//! demonstrations in the words of the world's declaration. It knows nothing of what they mean and reads no view.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;

use anyhow::{Result, bail};
use case_book::{Demonstration, WorldDeclaration};
use documents::BuildAccount;
use domain::{DocumentKind, State};

use super::{BuiltText, DocumentBuilder};

/// Minimum number of demonstrations that pass a state of general knowledge.
const LEAST_SUPPORT: usize = 2;

/// Maximum number of states that are listed as passed by several demonstrations.
const MOST_STATES: usize = 40;

/// Writes documents by rules. [`documents::EXTRACTIVE_VERSION`] changes whenever the same demonstrations give another text.
#[derive(Debug, Clone, Copy, Default)]
pub struct Extractive;

impl DocumentBuilder for Extractive {
    fn build(
        &mut self,
        kind: DocumentKind,
        world: &WorldDeclaration,
        demonstrations: &[&Demonstration],
        _steps: &Path,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<BuiltText> {
        let text = match kind {
            DocumentKind::Summary => summary(world, demonstrations),
            DocumentKind::Semantic => semantic(world, demonstrations),
            DocumentKind::Trajectories | DocumentKind::Note => {
                bail!("a document of kind {} is not built", kind.word())
            }
        };
        progress(demonstrations.len(), demonstrations.len());
        Ok(BuiltText { text, account: BuildAccount::default() })
    }
}

/// Each demonstration: its task, its start, its actions up to each sub-goal, and the states there.
fn summary(world: &WorldDeclaration, demonstrations: &[&Demonstration]) -> String {
    let mut text = "# Summary of the demonstrations\n\
                    A number after an action says how often in a row it was taken.\n"
        .to_owned();
    for of in demonstrations {
        // Writing to a string cannot fail, here and below.
        let _ = writeln!(text, "\n## \"{}\"", of.instruction);
        let _ = writeln!(text, "- start: {}", world.sentence(&of.states[0]));
        let mut taken: Vec<(String, u32)> = Vec::new();
        for (step, (&action, states)) in of.actions.iter().zip(of.states.windows(2)).enumerate() {
            let (step, has_effect) = (step + 1, states[0] != states[1]);
            let words = world.action_words(action);
            let words = match has_effect {
                true => words.to_owned(),
                false => format!("{words} (\"{}\")", world.feedback_sentence(of.feedback[step])),
            };
            match taken.last_mut() {
                Some((last, times)) if *last == words => *times += 1,
                _ => taken.push((words, 1)),
            }
            let completed = of.sub_goals.iter().filter(|at| **at as usize <= step).count();
            let label = match step == of.actions.len() {
                true => "end".to_owned(),
                false if of.sub_goals.contains(&(step as u32)) => {
                    format!("sub-goal {completed} of {}", of.sub_goals.len())
                }
                false => continue,
            };
            let _ = writeln!(text, "- {}", in_a_row(std::mem::take(&mut taken)));
            let _ = writeln!(text, "- {label}: {}", world.sentence(&states[1]));
        }
    }
    text
}

/// Actions in the order in which they were taken, those in a row as one.
fn in_a_row(taken: Vec<(String, u32)>) -> String {
    let run = |(words, times)| match times {
        1 => words,
        _ => format!("{words} {times}"),
    };
    taken.into_iter().map(run).collect::<Vec<_>>().join(", ")
}

/// What all occurrences of an action have in common.
#[derive(Debug, Default)]
struct ActionFacts {
    taken: u32,
    /// By the index of a field: how often it was another after the action.
    changes: BTreeMap<usize, u32>,
    /// By what was told: how often the state was the same after the action.
    without_effect: BTreeMap<String, u32>,
}

/// What demonstrations have in common: what actions change, where tasks end, and where several of them pass.
fn semantic(world: &WorldDeclaration, demonstrations: &[&Demonstration]) -> String {
    let mut actions = BTreeMap::<_, ActionFacts>::new();
    let mut ends = BTreeMap::<&str, Vec<&State>>::new();
    let mut passed = BTreeMap::<String, usize>::new();
    for of in demonstrations {
        let steps = of.actions.iter().zip(of.states.windows(2)).zip(&of.feedback[1..]);
        for ((action, states), told) in steps {
            let facts = actions.entry(action.0).or_default();
            facts.taken += 1;
            if states[0] == states[1] {
                let told = world.feedback_sentence(*told).to_owned();
                *facts.without_effect.entry(told).or_default() += 1;
            }
            let numbers = states[0].numbers().iter().zip(states[1].numbers()).enumerate();
            for (field, _) in numbers.filter(|(_, (before, after))| before != after) {
                *facts.changes.entry(field).or_default() += 1;
            }
        }
        ends.entry(&of.instruction).or_default().extend(of.states.last());
        let states: BTreeSet<String> =
            of.states.iter().map(|state| world.sentence(state)).collect();
        states.into_iter().for_each(|state| *passed.entry(state).or_default() += 1);
    }
    let all = demonstrations.len();
    let mut text = format!("# Knowledge of the world {}\n", world.name);
    text.push_str("\n## What actions change\n");
    for (action, ActionFacts { taken, changes, without_effect }) in &actions {
        let words = &world.actions[usize::from(*action)].words;
        let changed =
            changes.iter().map(|(field, n)| format!("{} {n} times", world.state[*field].name));
        let nothing =
            without_effect.iter().map(|(told, n)| format!("nothing {n} times (\"{told}\")"));
        let effects: Vec<String> = changed.chain(nothing).collect();
        let _ = writeln!(text, "- {words}, taken {taken} times: {}", effects.join(", "));
    }
    text.push_str("\n## Where tasks end\n");
    for (instruction, states) in &ends {
        let (count, common) = (states.len(), common(world, states));
        let _ = writeln!(text, "- \"{instruction}\" ({count} of {all}): {common}");
    }
    text.push_str("\n## Where several demonstrations pass\n");
    let mut passed: Vec<_> =
        passed.into_iter().filter(|(_, count)| *count >= LEAST_SUPPORT).collect();
    passed.sort_by_key(|(_, count)| Reverse(*count));
    for (state, count) in passed.iter().take(MOST_STATES) {
        let _ = writeln!(text, "- {count} of {all}: {state}");
    }
    text
}

/// What `states` have in common: the sentence of all of them, or the fields that are the same in all.
fn common(world: &WorldDeclaration, states: &[&State]) -> String {
    let sentences: BTreeSet<String> = states.iter().map(|state| world.sentence(state)).collect();
    if let (Some(sentence), 1) = (sentences.first(), sentences.len()) {
        return sentence.clone();
    }
    let mut words = states.iter().map(|state| world.state_words(state));
    let mut same = words.next().unwrap_or_default();
    words.for_each(|other| same.retain(|field| other.contains(field)));
    let same: Vec<String> = same.iter().map(|(name, text)| format!("{name} {text}")).collect();
    match same.is_empty() {
        true => "in different states".to_owned(),
        false => format!("{} in all of them", same.join(", ")),
    }
}

#[cfg(test)]
#[path = "extractive/tests.rs"]
mod tests;
