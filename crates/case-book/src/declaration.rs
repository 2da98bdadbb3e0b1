//! What a world says of itself to every process of a run: `world.json`.

use std::collections::HashSet;

use domain::{ActionCode, FeedbackCode, MAX_ACTIONS, MAX_STATE, State, UnknownCode};
use serde::{Deserialize, Serialize};

use crate::file::Check;

/// What agents do, are told and see in a world, in words. It holds nothing about cases, so every process may know it. The
/// default is none that a world could have.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub struct WorldDeclaration {
    /// The name: small letters, digits and hyphens.
    pub name: String,
    /// The version of its rules. Runs of different versions are not compared.
    pub version: String,
    /// The first part of a model's prompt: what the agent is, how the world works, what its actions do, what feedback means.
    /// How memory is used and how to answer is said by the harness.
    pub rules: String,
    /// The actions, at most [`MAX_ACTIONS`].
    pub actions: Vec<ActionDeclaration>,
    /// The numbers of a state, at most [`MAX_STATE`].
    pub state: Vec<StateField>,
    /// A state in a sentence of the prompt. `{name}` stands for a number of that name, in words.
    pub state_sentence: String,
    /// What an agent is told after an action, in sentences. The first is that of the beginning of an episode, the last that of an
    /// answer that could not be read.
    pub feedback: Vec<String>,
    /// Whether the same actions lead from the same start to the same states and views, always and everywhere.
    pub is_deterministic: bool,
}

/// An action.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionDeclaration {
    /// The letter for it in logs; not `?`.
    pub letter: char,
    /// The words for it in prompts and answers: small letters and digits, such as `turn left`.
    pub words: String,
}

/// A number of a state.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StateField {
    /// The name.
    pub name: String,
    /// The words for 0, 1, 2 and so on, if it is a choice among some.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub words: Vec<String>,
    /// Digits after the point in prompts, where it is a number.
    #[serde(default)]
    pub digits: u8,
}

/// Numbers that are not a state of the world.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("this is no state of the world {world}: {problem}")]
pub struct ForeignState {
    /// The name of the world.
    pub world: String,
    /// What is wrong with it.
    pub problem: String,
}

/// The name of the world that is part of this program.
pub const WAREHOUSE: &str = "warehouse";

/// The letter of a step without an action.
pub const NO_LETTER: char = '?';

/// Most feedback sentences of a world.
const MAX_FEEDBACK: usize = 64;

/// Longest text of a declaration, in bytes.
const LONGEST_RULES: usize = 32 * 1024;

impl WorldDeclaration {
    /// The codes of all actions.
    pub fn action_codes(&self) -> impl Iterator<Item = ActionCode> + use<> {
        (0..self.actions.len() as u8).map(ActionCode)
    }

    /// The action with this code on the wire or in a file, if there is one.
    pub fn action(&self, code: u8) -> Option<ActionCode> {
        (usize::from(code) < self.actions.len()).then_some(ActionCode(code))
    }

    /// The words for an action; `none` for a code that the world does not declare.
    pub fn action_words(&self, ActionCode(code): ActionCode) -> &str {
        self.actions.get(usize::from(code)).map_or("none", |action| &action.words)
    }

    /// The action with these words.
    pub fn action_named(&self, words: &str) -> Option<ActionCode> {
        let code = self.actions.iter().position(|action| action.words == words);
        code.map(|code| ActionCode(code as u8))
    }

    /// The letter of an action in logs; [`NO_LETTER`] without one.
    pub fn letter(&self, action: Option<ActionCode>) -> char {
        let declared = action.and_then(|ActionCode(code)| self.actions.get(usize::from(code)));
        declared.map_or(NO_LETTER, |action| action.letter)
    }

    /// The letters of actions.
    pub fn letters(&self, actions: impl IntoIterator<Item = Option<ActionCode>>) -> String {
        actions.into_iter().map(|action| self.letter(action)).collect()
    }

    /// The action of a letter; `None` for [`NO_LETTER`], and where no action has it.
    pub fn action_of(&self, letter: char) -> Option<ActionCode> {
        let code = self.actions.iter().position(|action| action.letter == letter);
        code.map(|code| ActionCode(code as u8))
    }

    /// Whether an action is a turn: its words begin with `turn`.
    pub fn is_turn(&self, action: ActionCode) -> bool {
        self.action_words(action).split(' ').next() == Some("turn")
    }

    /// The feedback with this code on the wire or in a file, if there is one.
    pub fn feedback(&self, code: u8) -> Option<FeedbackCode> {
        (usize::from(code) < self.feedback.len()).then_some(FeedbackCode(code))
    }

    /// The feedback with this code.
    ///
    /// # Errors
    /// When the world declares none.
    pub fn read_feedback(&self, code: u8) -> Result<FeedbackCode, UnknownCode> {
        let unknown = || UnknownCode::new(code, "a feedback of this world");
        self.feedback(code).ok_or_else(unknown)
    }

    /// The same action, if the world declares it.
    ///
    /// # Errors
    /// When it does not.
    pub fn read_action(
        &self,
        action: Option<ActionCode>,
    ) -> Result<Option<ActionCode>, UnknownCode> {
        let unknown = |ActionCode(code)| UnknownCode::new(code, "an action of this world");
        action.map(|action| self.action(action.0).ok_or_else(|| unknown(action))).transpose()
    }

    /// The sentence of a feedback; empty for a code that the world does not declare.
    pub fn feedback_sentence(&self, FeedbackCode(code): FeedbackCode) -> &str {
        self.feedback.get(usize::from(code)).map_or("", String::as_str)
    }

    /// The feedback to an answer that could not be read.
    pub fn not_understood(&self) -> FeedbackCode {
        FeedbackCode(self.feedback.len().saturating_sub(1) as u8)
    }

    /// The state of these numbers: first those of the world's fields, then zeros.
    ///
    /// # Errors
    /// When they are not a state of this world.
    pub fn read_state(&self, numbers: &[f32; MAX_STATE]) -> Result<State, ForeignState> {
        let (fields, padding) = numbers.split_at(self.state.len().min(MAX_STATE));
        if padding.iter().any(|number| *number != 0.0) {
            return Err(self.foreign(format!("it has more than {} numbers", self.state.len())));
        }
        let state = State::new(fields).map_err(|error| self.foreign(error.to_string()))?;
        self.check_state(&state)?;
        Ok(state)
    }

    /// Checks that `state` has a number for each field, and that choices are among the words.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn check_state(&self, state: &State) -> Result<(), ForeignState> {
        let (count, declared) = (state.numbers().len(), self.state.len());
        if count != declared {
            return Err(self.foreign(format!("it has {count} numbers in place of {declared}")));
        }
        for (StateField { name, words, .. }, number) in self.state.iter().zip(state.numbers()) {
            if !words.is_empty() && choice(words, *number).is_none() {
                return Err(self
                    .foreign(format!("{name} is {number}, not one of 0 to {}", words.len() - 1)));
            }
        }
        Ok(())
    }

    /// What is wrong with a trajectory, if it has states, actions or feedback that the world does not declare.
    pub(crate) fn trajectory_problem(
        &self,
        states: &[State],
        actions: &[ActionCode],
        feedback: &[FeedbackCode],
    ) -> Option<String> {
        let state = || states.iter().find_map(|state| self.check_state(state).err());
        let action = || actions.iter().find_map(|action| self.read_action(Some(*action)).err());
        let feedback = || feedback.iter().find_map(|code| self.read_feedback(code.0).err());
        let code = || action().or_else(feedback).map(|unknown| unknown.to_string());
        state().map(|foreign| foreign.to_string()).or_else(code)
    }

    fn foreign(&self, problem: String) -> ForeignState {
        ForeignState { world: self.name.clone(), problem }
    }

    /// Each number of a state with its name, in words.
    pub fn state_words<'a>(&'a self, state: &State) -> Vec<(&'a str, String)> {
        let fields = self.state.iter().zip(state.numbers());
        let in_words = |(field, number): (&'a StateField, &f32)| {
            let text = match choice(&field.words, *number) {
                Some(word) => word.to_owned(),
                None => format!("{number:.*}", usize::from(field.digits)),
            };
            (field.name.as_str(), text)
        };
        fields.map(in_words).collect()
    }

    /// A state in a sentence, as prompts have it.
    pub fn sentence(&self, state: &State) -> String {
        let words = self.state_words(state);
        let values: Vec<_> = words.iter().map(|(name, text)| (*name, text.as_str())).collect();
        fill(&self.state_sentence, &values)
    }

    /// A state in short, for tables: its numbers in words, with commas between them.
    pub fn state_text(&self, state: &State) -> String {
        let words: Vec<String> =
            self.state_words(state).into_iter().map(|(_, text)| text).collect();
        words.join(",")
    }
}

/// `text` with each `{name}` of `values` replaced. Names inside values are not replaced, and other braces stay.
pub fn fill(text: &str, values: &[(&str, &str)]) -> String {
    let mut filled = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find('{') {
        let (before, from_brace) = rest.split_at(at);
        filled.push_str(before);
        let replacement = values.iter().find_map(|&(name, value)| {
            let after = from_brace[1..].strip_prefix(name)?.strip_prefix('}')?;
            Some((value, after))
        });
        match replacement {
            Some((value, after)) => {
                filled.push_str(value);
                rest = after;
            }
            None => {
                filled.push('{');
                rest = &from_brace[1..];
            }
        }
    }
    filled.push_str(rest);
    filled
}

/// The word for a number that is a choice.
fn choice(words: &[String], number: f32) -> Option<&str> {
    let is_index = number.fract() == 0.0 && number >= 0.0;
    is_index.then(|| words.get(number as usize).map(String::as_str)).flatten()
}

impl Check for WorldDeclaration {
    fn problem(&self) -> Option<String> {
        let is_name = |text: &str| {
            let is_allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
            (1..=64).contains(&text.len()) && text.chars().all(is_allowed)
        };
        if !is_name(&self.name) {
            return Some(
                "its \"name\" is not one to 64 small letters, digits and hyphens".to_owned(),
            );
        }
        if self.rules.len() > LONGEST_RULES || self.rules.trim().is_empty() {
            return Some(format!("its \"rules\" are empty or longer than {LONGEST_RULES} bytes"));
        }
        if !(1..=MAX_ACTIONS).contains(&self.actions.len()) {
            return Some(format!("it has {} actions, not 1 to {MAX_ACTIONS}", self.actions.len()));
        }
        if !(1..=MAX_STATE).contains(&self.state.len()) {
            return Some(format!("a state has {} numbers, not 1 to {MAX_STATE}", self.state.len()));
        }
        if !(2..=MAX_FEEDBACK).contains(&self.feedback.len()) {
            let count = self.feedback.len();
            return Some(format!("it has {count} sentences of feedback, not 2 to {MAX_FEEDBACK}"));
        }
        let mut used = HashSet::new();
        for ActionDeclaration { letter, words } in &self.actions {
            if !letter.is_ascii_alphanumeric() || !used.insert(letter.to_string()) {
                return Some(format!(
                    "the letter {letter:?} of an action is not an ASCII letter or digit that no other action has"
                ));
            }
            let is_word = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == ' ';
            let is_tidy = words.trim() == words && !words.contains("  ") && words.len() >= 2;
            if !is_tidy || !words.chars().all(is_word) || !used.insert(words.clone()) {
                return Some(format!(
                    "the words {words:?} of an action are not lowercase, too short, or those of another action"
                ));
            }
        }
        let mut names = HashSet::new();
        for StateField { name, .. } in &self.state {
            if !names.insert(name.as_str()) {
                return Some(format!("a state has {name:?} twice"));
            }
        }
        let named = self.state_sentence.split('{').skip(1).filter_map(|from| from.split_once('}'));
        let foreign = named.map(|(name, _)| name).find(|name| !names.contains(name));
        foreign.map(|name| {
            format!("its \"state_sentence\" names {name:?}, which is no field of its states")
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::BookFile;

    /// A world of doors.
    pub(crate) fn doors() -> WorldDeclaration {
        let action = |letter, words: &str| ActionDeclaration { letter, words: words.to_owned() };
        let words = ["east", "south"].map(str::to_owned).to_vec();
        WorldDeclaration {
            name: "doors".to_owned(),
            version: "1".to_owned(),
            rules: "You open doors.".to_owned(),
            actions: vec![action('o', "open"), action('t', "turn left")],
            state: vec![
                StateField { name: "height".to_owned(), words: Vec::new(), digits: 2 },
                StateField { name: "heading".to_owned(), words, digits: 0 },
            ],
            state_sentence: "You are at {height} and face {heading}.".to_owned(),
            feedback: ["Go.", "Done.", "What?"].map(str::to_owned).to_vec(),
            is_deterministic: true,
        }
    }

    #[test]
    fn codes_letters_and_words_belong_together() {
        let world = doors();
        for code in world.action_codes() {
            assert_eq!(world.action_named(world.action_words(code)), Some(code));
            assert_eq!(world.action_of(world.letter(Some(code))), Some(code));
            assert_eq!(world.action(code.0), Some(code));
        }
        assert_eq!(world.action(2), None);
        assert_eq!((world.letter(None), world.action_of(NO_LETTER)), (NO_LETTER, None));
        assert_eq!(world.letters([Some(ActionCode(1)), None, Some(ActionCode(0))]), "t?o");
        assert_eq!(world.feedback_sentence(world.not_understood()), "What?");
        assert_eq!(world.feedback(3), None);
    }

    #[test]
    fn states_are_read_and_worded_by_their_fields() {
        let world = doors();
        let padded = |numbers: &[f32]| {
            let mut all = [0.0; MAX_STATE];
            all[..numbers.len()].copy_from_slice(numbers);
            all
        };
        let state = world.read_state(&padded(&[1.005, 1.0])).unwrap();
        assert_eq!(state.numbers(), [1.005, 1.0]);
        let words = [("height", "1.00".to_owned()), ("heading", "south".to_owned())];
        assert_eq!(world.state_words(&state), words);
        assert_eq!(world.state_text(&state), "1.00,south");
        assert_eq!(world.sentence(&state), "You are at 1.00 and face south.");
        for (numbers, problem) in [
            (&[1.0, 2.0][..], "heading is 2, not one of 0 to 1"),
            (&[1.0, 0.5], "heading is 0.5, not one of 0 to 1"),
            (&[f32::NAN, 0.0], "number 0 of a state is not finite"),
            (&[1.0, 0.0, 1.0], "it has more than 2 numbers"),
        ] {
            let error = world.read_state(&padded(numbers)).unwrap_err().to_string();
            assert_eq!(error, format!("this is no state of the world doors: {problem}"));
        }
    }

    #[test]
    fn names_are_replaced_once_and_other_braces_stay() {
        let values = [("a", "{b}"), ("b", "B")];
        for (text, filled) in [
            ("{a} and {b}", "{b} and B"),
            ("{c} {a", "{c} {a"),
            ("{{b}}", "{B}"),
            ("é{a}é", "é{b}é"),
            ("", ""),
        ] {
            assert_eq!(fill(text, &values), filled);
        }
    }

    #[test]
    fn what_a_world_may_not_declare_is_named() {
        type Breaks = fn(&mut WorldDeclaration);
        let broken: [(Breaks, &str); 9] = [
            (|world| world.name = "Doors".to_owned(), "\"name\""),
            (|world| world.rules = " ".to_owned(), "\"rules\""),
            (|world| world.actions.clear(), "0 actions"),
            (|world| world.actions[1].letter = 'o', "letter 'o'"),
            (|world| world.actions[1].letter = '?', "letter '?'"),
            (|world| world.actions[0].words = "Open".to_owned(), "words \"Open\""),
            (|world| world.feedback.truncate(1), "1 sentences"),
            (|world| world.state[1].name = "height".to_owned(), "\"height\" twice"),
            (|world| world.state_sentence = "At {height} and {x}.".to_owned(), "names \"x\""),
        ];
        assert_eq!(doors().problem(), None);
        for (breaks, expected) in broken {
            let mut world = doors();
            breaks(&mut world);
            let text = BookFile::new(world).unwrap().text;
            let error = BookFile::<WorldDeclaration>::parse(text, "world.json").unwrap_err();
            assert!(error.to_string().contains(expected), "{error}");
        }
    }
}
