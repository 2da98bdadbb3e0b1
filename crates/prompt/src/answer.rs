//! The action in a model's answer.
//!
//! Where the server can restrict answers to the world's actions, an answer is one of them. Otherwise models write around it,
//! and the first action in the text counts:
//!
//! 1. Reasoning up to `</think>` is skipped, and so is everything before the first `action:` or `answer:`, also as a key
//!    of JSON.
//! 2. An action is its own words, one after the other. Moves and turns, where the world has them, can also be a verb and a
//!    direction ("rotate to the left", "strafe right"), or a direction that leaves no choice ("forward", "u-turn"). "Left"
//!    alone and "go left" could be a move or a turn, and count as nothing, and so does what is seen ("the path ahead",
//!    "looking forward").
//! 3. An action right after a negation ("do not turn left", "no way forward") or before one ("moving forward is not
//!    possible") does not count.

use domain::ActionCode;
use peer::{Answer, WorldDeclaration};

/// Why no action was read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum UnreadAnswer {
    /// The answer has no text.
    #[error("the answer is empty")]
    Empty,
    /// The model refused, and named no action.
    #[error("the model refused")]
    Refused,
    /// No action is named.
    #[error("the answer names no action")]
    NoAction,
    /// The answer was cut off before it named an action.
    #[error("the answer was cut off at the bound on its tokens before it named an action")]
    CutOff,
}

impl UnreadAnswer {
    /// The policy's answer to the request.
    pub const fn answer(self) -> Answer {
        match self {
            Self::Empty => Answer::Empty,
            Self::Refused => Answer::Refused,
            Self::NoAction => Answer::Unreadable,
            Self::CutOff => Answer::CutOff,
        }
    }
}

/// Words that deny the action after them.
const NEGATIONS: [&str; 10] =
    ["not", "no", "dont", "cannot", "cant", "unable", "never", "avoid", "without", "instead"];

/// Words that deny the action before them, after a form of "be".
const DENIALS: [&str; 5] = ["not", "no", "blocked", "closed", "impossible"];

/// Words between a verb and its direction, and between a negation and its verb.
const FILLERS: [&str; 11] =
    ["able", "to", "the", "my", "your", "one", "1", "cell", "step", "90", "degrees"];

/// Phrases of refusals.
const REFUSALS: [&str; 7] =
    ["sorry", "cant assist", "cannot assist", "cant help", "cannot help", "as an ai", "i refuse"];

/// Reads the first action in `text`, which was cut off at the bound on its tokens: in what follows, there may have been one.
///
/// # Errors
/// When there is none.
pub fn read_cut_off_answer(
    world: &WorldDeclaration,
    text: &str,
) -> Result<ActionCode, UnreadAnswer> {
    read_answer(world, text).map_err(|why| match why {
        UnreadAnswer::Refused => UnreadAnswer::Refused,
        UnreadAnswer::Empty | UnreadAnswer::NoAction | UnreadAnswer::CutOff => UnreadAnswer::CutOff,
    })
}

/// Reads the first action in `text`.
///
/// # Errors
/// When there is none.
pub fn read_answer(world: &WorldDeclaration, text: &str) -> Result<ActionCode, UnreadAnswer> {
    let tokens = tokens(without_reasoning(text));
    let words: Vec<&str> = tokens.iter().map(String::as_str).collect();
    if words.iter().all(|word| is_boundary(word)) {
        return Err(UnreadAnswer::Empty);
    }
    let marker = words.windows(2).position(|two| matches!(two, ["action" | "answer", ":"]));
    let announced = marker.and_then(|at| first_action(world, &words[at + 2..]));
    announced.or_else(|| first_action(world, &words)).ok_or_else(|| {
        let text = words.join(" ");
        let refused = REFUSALS.iter().any(|phrase| text.contains(phrase));
        if refused { UnreadAnswer::Refused } else { UnreadAnswer::NoAction }
    })
}

/// The text after `</think>`, or before a `<think>` that never ends.
fn without_reasoning(text: &str) -> &str {
    let text = match text.rsplit_once("</think>") {
        Some((before, after)) if after.trim().is_empty() => before,
        Some((_, after)) => after,
        None => text,
    };
    text.split_once("<think>").map_or(text, |(before, _)| before)
}

/// The words of a text in lower case, with camelCase and snake_case split and apostrophes left out. Colons and `=` become
/// `:`, other punctuation that ends a clause `.`.
fn tokens(text: &str) -> Vec<String> {
    let mut tokens = vec![String::new()];
    let mut after_lower = false;
    for c in text.chars() {
        let boundary = match c {
            ':' | '=' => ":",
            '.' | ',' | ';' | '!' | '?' | '\n' | '{' | '}' => ".",
            _ => "",
        };
        let in_word = c.is_alphanumeric() && !(c.is_uppercase() && after_lower);
        if !boundary.is_empty() {
            tokens.extend([boundary.to_owned(), String::new()]);
        } else if !in_word && !matches!(c, '\'' | '’') {
            tokens.push(String::new());
        }
        if let Some(word) = tokens.last_mut()
            && c.is_alphanumeric()
        {
            word.extend(c.to_lowercase());
        }
        after_lower = c.is_lowercase();
    }
    tokens.retain(|token| !token.is_empty());
    tokens
}

fn is_boundary(token: &str) -> bool {
    matches!(token, ":" | ".")
}

fn first_action(world: &WorldDeclaration, words: &[&str]) -> Option<ActionCode> {
    (0..words.len()).find_map(|at| {
        let before = words[..at].iter().rev().take_while(|word| !is_boundary(word));
        let mut before = before.filter(|word| !FILLERS.contains(word)).take(2).peekable();
        let is_seen = before.peek().is_some_and(|word| is_form_of(word, &["look", "fac", "see"]));
        let denied = before.any(|word| NEGATIONS.contains(word));
        action_at(world, &words[at..])
            .filter(|_| !is_seen && !denied && !is_denied_after(&words[at..]))
    })
}

/// Whether the clause that begins with an action, of one or two words, says of that action that it is impossible.
fn is_denied_after(words: &[&str]) -> bool {
    let clause = words.iter().copied().take_while(|word| !is_boundary(word));
    let clause: Vec<&str> = clause.filter(|word| !FILLERS.contains(word)).take(4).collect();
    clause.windows(2).skip(1).any(|two| {
        two[0] == "isnt" || matches!(two[0], "is" | "seems" | "looks") && DENIALS.contains(&two[1])
    })
}

/// The action that begins with the first of `words`: one that is named by its own words, or in another way.
fn action_at(world: &WorldDeclaration, words: &[&str]) -> Option<ActionCode> {
    let named = world.action_codes().filter(|code| {
        let mut rest = words.iter();
        world.action_words(*code).split(' ').all(|word| rest.next() == Some(&word))
    });
    // Where one action's words begin another's, the longer ones count.
    let longest = named.max_by_key(|code| world.action_words(*code).len());
    longest.or_else(|| world.action_named(paraphrased(words)?))
}

/// The words of the action of moving or turning that begins with the first of `words`.
fn paraphrased(words: &[&str]) -> Option<&'static str> {
    let (&first, rest) = words.split_first()?;
    let next = *rest.iter().find(|word| !FILLERS.contains(word)).unwrap_or(&".");
    match (first, next) {
        ("forward" | "forwards", _) => Some("move forward"),
        ("backward" | "backwards", _) => Some("move backward"),
        ("uturn", _) | ("u", "turn") => Some("turn around"),
        (verb, "left") if is_turn(verb) => Some("turn left"),
        (verb, "right") if is_turn(verb) => Some("turn right"),
        (verb, "around" | "back" | "180") if is_turn(verb) => Some("turn around"),
        ("left", "turn") => Some("turn left"),
        ("right", "turn") => Some("turn right"),
        (verb, "left") if is_move(verb) => Some("move left"),
        (verb, "right") if is_move(verb) => Some("move right"),
        (verb, "back") if is_move(verb) || is_walk(verb) => Some("move backward"),
        (verb, "straight") if is_move(verb) || is_walk(verb) => Some("move forward"),
        // "Go ahead" begins many sentences.
        (verb, "ahead") if verb != "go" && (is_move(verb) || is_walk(verb)) => Some("move forward"),
        _ => None,
    }
}

/// Whether a word is a form of one of `verbs`, which are given without endings.
fn is_form_of(word: &str, verbs: &[&str]) -> bool {
    verbs.iter().any(|verb| {
        word.strip_prefix(verb)
            .is_some_and(|ending| matches!(ending, "" | "s" | "e" | "es" | "ing"))
    })
}

fn is_turn(word: &str) -> bool {
    is_form_of(word, &["turn", "rotat", "pivot", "spin", "spinn"])
}

/// Verbs that keep the heading.
fn is_move(word: &str) -> bool {
    is_form_of(word, &["mov", "step", "stepp", "straf", "sidestep", "sidestepp", "shift", "slid"])
}

/// Verbs that say nothing about the heading.
fn is_walk(word: &str) -> bool {
    is_form_of(word, &["go", "walk", "continu", "proceed", "head"])
}

#[cfg(test)]
mod tests {
    use domain::Action;
    use warehouse::declaration;

    use super::UnreadAnswer::{CutOff, Empty, NoAction, Refused};
    use super::*;
    use crate::tests::doors;

    #[test]
    fn every_action_is_read_in_every_form() {
        let world = declaration();
        for action in Action::ALL {
            let words = action.words();
            let (first, second) = words.split_once(' ').unwrap();
            let title = second[..1].to_uppercase() + &second[1..];
            for text in [
                words.to_owned(),
                words.to_uppercase(),
                format!("{first}{title}"),
                format!("**{first}_{second}!**\n"),
                format!("I'll {first} {second} now, since the rack on my left is empty."),
                format!("Next action: {first}s {second}"),
                format!("{{\"thought\": \"turn left or move right\", \"action\": \"{words}\"}}"),
                format!("{{\"nextAction\": \"{first}_{second}\"}}"),
                format!("<think>turn left? no, turn right</think>\n{words}"),
                format!("{words}</think>"),
                format!("I cannot go there. Do not turn left, {words}."),
                format!("The path ahead? Blocked. Answer = {words}"),
            ] {
                assert_eq!(read_answer(&world, &text), Ok(action.into()), "{text:?}");
            }
        }
    }

    #[test]
    fn the_first_action_counts() {
        let world = declaration();
        for (text, expected) in [
            ("move one step forward, then turn left", Ok(Action::Forward)),
            ("Rotating to the left by 90 degrees", Ok(Action::TurnLeft)),
            ("make a right turn", Ok(Action::TurnRight)),
            ("Rotate 180 degrees", Ok(Action::TurnAround)),
            ("strafing right", Ok(Action::Right)),
            ("go back", Ok(Action::Backward)),
            ("Backward.", Ok(Action::Backward)),
            ("go straight", Ok(Action::Forward)),
            ("turn left instead of moving forward", Ok(Action::TurnLeft)),
            ("Don't move forward. Turn around", Ok(Action::TurnAround)),
            ("turn left\n\nThe barrel is on the le", Ok(Action::TurnLeft)),
            ("The path ahead is blocked, so turn left.", Ok(Action::TurnLeft)),
            ("The barrel is straight ahead; move right", Ok(Action::Right)),
            ("There is no way forward. Turn around.", Ok(Action::TurnAround)),
            ("Looking forward, I see a rack. turn right", Ok(Action::TurnRight)),
            ("I cannot move one step forward, turn right", Ok(Action::TurnRight)),
            ("I am not able to move forward, so I turn left", Ok(Action::TurnLeft)),
            ("Moving forward is not possible; turn left", Ok(Action::TurnLeft)),
            ("unable to move forward, turn left", Ok(Action::TurnLeft)),
            ("The way forward is blocked. Turn left.", Ok(Action::TurnLeft)),
            ("Moving forward isn't possible, turn left", Ok(Action::TurnLeft)),
            ("Turn left because the path is blocked.", Ok(Action::TurnLeft)),
            ("turn right since forward is blocked", Ok(Action::TurnRight)),
            ("move ahead", Ok(Action::Forward)),
            ("Go ahead and turn left", Ok(Action::TurnLeft)),
            ("Moving forward is the best choice.", Ok(Action::Forward)),
            ("left", Err(NoAction)),
            ("go left", Err(NoAction)),
            ("The barrel is on the left.", Err(NoAction)),
            ("never move forward", Err(NoAction)),
            ("north", Err(NoAction)),
            ("{\"action\": null}", Err(NoAction)),
            ("I'm sorry, but I can't assist with that.", Err(Refused)),
            ("I'm sorry, I turn left", Ok(Action::TurnLeft)),
            ("", Err(Empty)),
            (" \n...", Err(Empty)),
            ("<think>turn left", Err(Empty)),
        ] {
            let expected = expected.map(ActionCode::from);
            assert_eq!(read_answer(&world, text), expected, "{text:?}");
        }
    }

    #[test]
    fn actions_of_another_world_are_read_by_their_own_words() {
        let world = doors();
        let [open, open_slowly] = [0, 1].map(ActionCode);
        for (text, expected) in [
            ("open door", Ok(open)),
            ("Open_Door!", Ok(open)),
            ("open door 2 slowly", Ok(open_slowly)),
            ("I should open door 2 slowly, not open door.", Ok(open_slowly)),
            ("{\"thought\": \"open door?\", \"action\": \"open door 2 slowly\"}", Ok(open_slowly)),
            ("Do not open door 2 slowly; open door", Ok(open)),
            // Words of an action that do not follow each other, and moves and turns, which this world does not have.
            ("open the door", Err(NoAction)),
            ("open", Err(NoAction)),
            ("move forward", Err(NoAction)),
            ("turn left", Err(NoAction)),
            ("u-turn", Err(NoAction)),
            ("", Err(Empty)),
        ] {
            assert_eq!(read_answer(&world, text), expected, "{text:?}");
        }
    }

    #[test]
    fn an_answer_that_was_cut_off_may_name_an_action() {
        for (text, expected) in [
            ("Turn left. I can s", Ok(Action::TurnLeft)),
            ("I can see a wareh", Err(CutOff)),
            ("", Err(CutOff)),
            ("<think>turn left", Err(CutOff)),
            ("I'm sorry, but I can't assist with th", Err(Refused)),
        ] {
            let expected = expected.map(ActionCode::from);
            assert_eq!(read_cut_off_answer(&declaration(), text), expected, "{text:?}");
        }
    }

    proptest::proptest! {
        #[test]
        fn no_text_causes_a_panic(text in proptest::prelude::any::<String>()) {
            let _ = read_answer(&declaration(), &text);
            let _ = read_answer(&doors(), &text);
        }
    }
}
