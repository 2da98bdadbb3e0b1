//! The action in what a model writes.
//!
//! A model is asked for one action word and often writes more: a sentence, markdown, JSON, a synonym. All that
//! is read. What is never done is guessing: where a text names two actions, or could, there is none in it, and
//! [`Unread`] says why. The rules, which `docs/prompt.md` gives with examples:
//!
//! 1. Reasoning between `<think>` and `</think>` is no part of the answer.
//! 2. A JSON object that has a field `action` (or another of the words in `marker`) means what this field says.
//!    Else a marker (`Action:`) rules out what stands before the first one.
//! 3. In what is left, every phrase that names an action counts, in any of its forms (`phrase`), unless it is
//!    denied, doubted, or part of a question. A word that could be part of a description ("on the left") does
//!    not count; a direction that stands by itself ("left") stands for every action it could mean.
//! 4. There is an action when all that counts agrees on exactly one.
//! 5. A text that was cut off has to say it in its first whole line or sentence.

mod clauses;
mod marker;
mod phrase;
mod words;

use std::fmt;

use domain::Action;

use crate::Answer;
use clauses::{Sentence, sentences};
use phrase::{Actions, Mention};

/// Why no action was read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Unread {
    /// There is nothing to read.
    Empty,
    /// The model refused, and named no action.
    Refused,
    /// Nothing in it is like an action.
    Nothing,
    /// It names several actions, these.
    Several(Vec<Action>),
    /// What it names could be several actions, or is none that can be taken: these words of it.
    Unclear(String),
    /// It names these actions only to deny or doubt them.
    Doubtful(Vec<Action>),
    /// It was cut off before it was clear.
    CutOff,
}

impl Unread {
    /// The policy's answer for this.
    pub const fn answer(&self) -> Answer {
        match self {
            Self::Empty => Answer::Empty,
            Self::Refused => Answer::Refused,
            Self::Nothing
            | Self::Several(_)
            | Self::Unclear(_)
            | Self::Doubtful(_)
            | Self::CutOff => Answer::Unreadable,
        }
    }
}

impl fmt::Display for Unread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |actions: &[Action]| {
            actions.iter().map(|action| action.words()).collect::<Vec<_>>().join(", ")
        };
        match self {
            Self::Empty => write!(f, "the answer is empty"),
            Self::Refused => write!(f, "the model refused"),
            Self::Nothing => write!(f, "nothing in it is like an action"),
            Self::Several(actions) => write!(f, "it names several actions: {}", list(actions)),
            Self::Unclear(words) => write!(f, "\"{words}\" is not clearly one of the actions"),
            Self::Doubtful(actions) => {
                write!(f, "it only denies or doubts: {}", list(actions))
            }
            Self::CutOff => write!(f, "it was cut off before an action was clear"),
        }
    }
}

/// The action that a whole answer names.
///
/// # Errors
/// When it does not name exactly one; the error says why.
pub fn read_answer(text: &str) -> Result<Action, Unread> {
    let text = marker::without_reasoning(text).ok_or(Unread::CutOff)?;
    match marker::field(&text) {
        Some(value) => read(&value, &sentences(&value)),
        None => read(&text, &marker::after_marker(sentences(&text))),
    }
}

/// The action that the beginning of an answer names, whose rest did not come (rule 5).
///
/// # Errors
/// As [`read_answer`]; [`Unread::CutOff`] where the rest could change what is there.
pub fn read_cut_off(text: &str) -> Result<Action, Unread> {
    let text = marker::without_reasoning(text).ok_or(Unread::CutOff)?;
    if text.trim().is_empty() {
        return Err(Unread::Empty);
    }
    let sentences = marker::after_marker(sentences(&text));
    match sentences.as_slice() {
        [first, ..] if first.ended => {
            let alone = read(&text, std::slice::from_ref(first));
            let within = read(&text, &sentences);
            alone.and(within).map_err(|_| Unread::CutOff)
        }
        _ => Err(Unread::CutOff),
    }
}

/// The action in `sentences`, which are those of `text` that count.
fn read(text: &str, sentences: &[Sentence]) -> Result<Action, Unread> {
    if text.trim().is_empty() {
        return Err(Unread::Empty);
    }
    if let Some(letter) = phrase::single_letter(sentences) {
        return letter;
    }
    let mentions = phrase::mentions(sentences);
    let (counted, doubted): (Vec<&Mention>, Vec<&Mention>) =
        mentions.iter().partition(|mention| !mention.doubted);
    let common = counted.iter().fold(Actions::ALL, |common, mention| common.and(mention.actions));
    let union = |mentions: &[&Mention]| {
        mentions.iter().fold(Actions::NONE, |all, mention| all.or(mention.actions)).list()
    };
    match (counted.as_slice(), common.list().as_slice()) {
        ([_, ..], [action]) => Ok(*action),
        ([], _) if phrase::is_refusal(sentences, !doubted.is_empty()) => Err(Unread::Refused),
        ([], _) if doubted.is_empty() => Err(Unread::Nothing),
        ([], _) => Err(Unread::Doubtful(union(&doubted))),
        (counted, _) => {
            Err(match counted.iter().find(|mention| mention.actions.list().len() != 1) {
                Some(unclear) if counted.iter().all(|other| other.text == unclear.text) => {
                    Unread::Unclear(unclear.text.clone())
                }
                Some(impossible) if impossible.actions == Actions::NONE => {
                    Unread::Unclear(impossible.text.clone())
                }
                _ => Unread::Several(union(counted)),
            })
        }
    }
}

#[cfg(test)]
mod tests;
