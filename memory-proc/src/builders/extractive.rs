//! The extractive builder: deterministic and offline. It writes instructions, states, actions, feedback and sub-goals of
//! demonstrations in the words of the world's declaration. It knows nothing of what they mean and reads no view.
//!
//! `docs/documents.md` has the grammar of its texts.

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashSet};
use std::fmt::{self, Write};
use std::path::Path;

use anyhow::{Result, bail};
use case_book::{Demonstration, WorldDeclaration};
use documents::BuildAccount;
use domain::DocumentKind;

use super::{BuiltText, DocumentBuilder};

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

/// The demonstrations under their instructions, equal ones once.
fn summary(world: &WorldDeclaration, demonstrations: &[&Demonstration]) -> String {
    let mut text = "# Summary of the demonstrations\n\
                    A number after an action says how often in a row it was taken.\n"
        .to_owned();
    let (mut told, mut instruction) = (HashSet::new(), None);
    for of in demonstrations {
        let lines = retold(world, of);
        if !told.insert((&of.instruction, lines.clone())) {
            continue;
        }
        if instruction.replace(&of.instruction) != Some(&of.instruction) {
            // Writing to a string cannot fail, here and below.
            let _ = writeln!(text, "\n## \"{}\"", of.instruction);
        }
        text.push_str(&lines);
    }
    text
}

/// A demonstration: its start, its actions up to each sub-goal, and the states there.
fn retold(world: &WorldDeclaration, of: &Demonstration) -> String {
    let mut text = format!("- start: {}\n", world.sentence(&of.states[0]));
    let (total, mut begin) = (of.sub_goals.len(), 0);
    for (number, end) in (1..).zip(ends(of)) {
        let mut taken: Vec<(String, u32)> = Vec::new();
        for step in begin..end {
            let (words, told) = (world.action_words(of.actions[step]), of.feedback[step + 1]);
            let words = match of.states[step] == of.states[step + 1] {
                true => format!("{words} (\"{}\")", world.feedback_sentence(told)),
                false => words.to_owned(),
            };
            match taken.last_mut() {
                Some((last, times)) if *last == words => *times += 1,
                _ => taken.push((words, 1)),
            }
        }
        if !taken.is_empty() {
            let _ = writeln!(text, "- {}", in_a_row(taken));
        }
        let label = match total {
            0 => "end".to_owned(),
            _ => format!("sub-goal {number} of {total}"),
        };
        let _ = writeln!(text, "- {label}: {}", world.sentence(&of.states[end]));
        begin = end;
    }
    text
}

/// The steps at which sub-goals were completed; the last step where there are none. What comes after the last sub-goal is not
/// part of the task.
fn ends(of: &Demonstration) -> Vec<usize> {
    match of.sub_goals.is_empty() {
        true => vec![of.actions.len()],
        false => of.sub_goals.iter().map(|step| *step as usize).collect(),
    }
}

/// Actions in the order in which they were taken, those in a row as one.
fn in_a_row(taken: Vec<(String, u32)>) -> String {
    let run = |(words, times)| match times {
        1 => words,
        _ => format!("{words} {times}"),
    };
    taken.into_iter().map(run).collect::<Vec<_>>().join(", ")
}

/// What demonstrations have in common that may hold elsewhere, too. It has no states.
fn semantic(world: &WorldDeclaration, demonstrations: &[&Demonstration]) -> String {
    let mut facts = GeneralFacts::default();
    demonstrations.iter().for_each(|of| facts.add(world, of));
    format!(
        "# General knowledge of the world {}\n\
         Numbers of actions are medians over {} demonstrations, with the least and the most in brackets.\n{facts}",
        world.name,
        demonstrations.len()
    )
}

/// How often something happened, by its words.
type Counts = BTreeMap<String, u32>;

/// What actions change, how they follow each other, and how many of them tasks take.
#[derive(Debug, Default)]
struct GeneralFacts {
    /// By the words of the action.
    actions: BTreeMap<String, ActionFacts>,
    /// The actions that completed sub-goals.
    completions: Counts,
    /// By their number of sub-goals: the actions that the first one took, and each other one.
    tasks: BTreeMap<usize, [Vec<usize>; 2]>,
}

/// What the occurrences of an action have in common.
#[derive(Debug, Default)]
struct ActionFacts {
    taken: u32,
    /// Fields that were another afterwards, and what was told if none was.
    effects: Counts,
    /// How often in a row it was taken.
    rows: Vec<usize>,
    /// The actions after such a row.
    next: Counts,
}

impl GeneralFacts {
    fn add(&mut self, world: &WorldDeclaration, of: &Demonstration) {
        for (step, (action, states)) in (1..).zip(of.actions.iter().zip(of.states.windows(2))) {
            let words = world.action_words(*action);
            let facts = self.actions.entry(words.to_owned()).or_default();
            facts.taken += 1;
            let numbers = states[0].numbers().iter().zip(states[1].numbers());
            let changed = world.state.iter().zip(numbers).filter(|(_, (was, is))| was != is);
            changed.for_each(|(field, _)| count(&mut facts.effects, &field.name));
            if states[0] == states[1] {
                let told = world.feedback_sentence(of.feedback[step]);
                count(&mut facts.effects, &format!("nothing (\"{told}\")"));
            }
            if of.sub_goals.contains(&(step as u32)) {
                count(&mut self.completions, words);
            }
        }
        let rows: Vec<_> = of.actions.chunk_by(|a, b| a == b).collect();
        for (place, row) in rows.iter().enumerate() {
            let facts = self.actions.entry(world.action_words(row[0]).to_owned()).or_default();
            facts.rows.push(row.len());
            if let Some(next) = rows.get(place + 1) {
                count(&mut facts.next, world.action_words(next[0]));
            }
        }
        let [first, further] = self.tasks.entry(of.sub_goals.len()).or_default();
        let ends = ends(of);
        first.push(ends[0]);
        further.extend(ends.windows(2).map(|pair| pair[1] - pair[0]));
    }
}

impl fmt::Display for GeneralFacts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { actions, completions, tasks } = self;
        let all: u32 = actions.values().map(|facts| facts.taken).sum();
        f.write_str("\n## What actions change\n")?;
        for (words, ActionFacts { taken, effects, .. }) in actions {
            writeln!(f, "- {words}, {taken} of {all} actions: {}", shares(effects, *taken))?;
        }
        f.write_str("\n## How actions follow each other\n")?;
        for (words, ActionFacts { rows, next, .. }) in actions {
            write!(f, "- {words}: {} in a row", typical(rows))?;
            match next.is_empty() {
                true => writeln!(f)?,
                false => writeln!(f, ", then {}", shares(next, next.values().sum()))?,
            }
        }
        f.write_str("\n## How tasks go\n")?;
        if !completions.is_empty() {
            writeln!(
                f,
                "- actions that complete sub-goals: {}",
                shares(completions, completions.values().sum())
            )?;
        }
        let all: usize = tasks.values().map(|[first, _]| first.len()).sum();
        for (sub_goals, [first, further]) in tasks {
            let (count, plural) = (first.len(), if *sub_goals == 1 { "" } else { "s" });
            write!(f, "- {sub_goals} sub-goal{plural}, {count} of {all} demonstrations: ")?;
            write!(f, "{} actions", typical(first))?;
            match further.is_empty() {
                true => writeln!(f)?,
                false => writeln!(f, " to the first, {} to each further one", typical(further))?,
            }
        }
        Ok(())
    }
}

fn count(counts: &mut Counts, words: &str) {
    *counts.entry(words.to_owned()).or_default() += 1;
}

/// Counts as shares of `all` in percent, the largest first.
fn shares(counts: &Counts, all: u32) -> String {
    let mut counts: Vec<_> = counts.iter().collect();
    counts.sort_by_key(|(_, count)| Reverse(**count));
    let share = |(words, count): (&String, &u32)| {
        format!("{words} {:.0} %", 100.0 * f64::from(*count) / f64::from(all))
    };
    counts.into_iter().map(share).collect::<Vec<_>>().join(", ")
}

/// The median of numbers, of two in the middle the greater, and the least and the most if they differ: `5 (1 to 14)`.
fn typical(numbers: &[usize]) -> String {
    let mut numbers = numbers.to_vec();
    numbers.sort_unstable();
    let median = numbers.get(numbers.len() / 2).map_or_else(String::new, usize::to_string);
    match (numbers.first(), numbers.last()) {
        (Some(least), Some(most)) if least < most => format!("{median} ({least} to {most})"),
        _ => median,
    }
}

#[cfg(test)]
#[path = "extractive/tests.rs"]
mod tests;
