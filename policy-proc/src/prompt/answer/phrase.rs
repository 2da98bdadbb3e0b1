//! The phrases of a text that name actions, in all the forms that models write them in.

use domain::Action;

use super::Unread;
use super::clauses::{COLON, Sentence};
use super::words::{
    A_TURN, AFTER_ADVERB, DEGREES, DENYING_AFTER, DESCRIBING_AFTER, DESCRIBING_BEFORE, DOUBTING,
    FILLING, GO, MOVE, NO_PLACE, POINTING, REFUSING, TAKE, TURN,
};

/// A set of actions: those that a phrase can mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Actions(u8);

impl Actions {
    pub(super) const NONE: Self = Self(0);
    pub(super) const ALL: Self = Self((1 << Action::ALL.len()) - 1);

    const fn of(actions: &[Action]) -> Self {
        let (mut bits, mut index) = (0, 0);
        while index < actions.len() {
            bits |= 1 << actions[index] as u8;
            index += 1;
        }
        Self(bits)
    }

    pub(super) const fn and(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    pub(super) const fn or(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    pub(super) fn list(self) -> Vec<Action> {
        let contains = |action: &Action| self.0 & (1 << *action as u8) != 0;
        Action::ALL.into_iter().filter(contains).collect()
    }
}

const LEFTWARD: Actions = Actions::of(&[Action::Left, Action::TurnLeft]);
const RIGHTWARD: Actions = Actions::of(&[Action::Right, Action::TurnRight]);
const BACK: Actions = Actions::of(&[Action::Backward, Action::TurnAround]);
const SIDEWAYS_TURN: Actions = Actions::of(&[Action::TurnLeft, Action::TurnRight]);

/// A phrase that names an action, or several that it may mean, or (none) what cannot be done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Mention {
    pub(super) actions: Actions,
    /// It is denied, in doubt, or part of a question.
    pub(super) doubted: bool,
    /// Its words.
    pub(super) text: String,
}

/// What may stand in "straight to the left".
const STRAIGHT_TO: [&str; 4] = ["to", "the", "my", "your"];

/// Longest phrase in words.
const LONGEST: usize = 9;

/// Every phrase in `sentences`, in order.
pub(super) fn mentions(sentences: &[Sentence]) -> Vec<Mention> {
    let mut found = Vec::new();
    for sentence in sentences {
        for clause in &sentence.clauses {
            let words: Vec<&str> = clause.iter().map(String::as_str).collect();
            let doubts = |word: &&str| DOUBTING.contains(word) || word.ends_with("n't");
            let clause_doubted = sentence.asks || words.iter().any(doubts);
            let denied_from = words.iter().position(|word| DENYING_AFTER.contains(word));
            let (mut at, mut before) = (0, 0);
            while at < words.len() {
                let Some((end, actions)) = phrase(&words, before, at) else {
                    at += 1;
                    continue;
                };
                let doubted = clause_doubted || denied_from.is_some_and(|from| from < at);
                let text = words[at..end].join(" ");
                found.push(Mention { actions, doubted, text });
                (at, before) = (end, end);
            }
        }
    }
    found
}

/// What a text of a single letter means, if it is one: those of [`Action::letter`] that stay clear when
/// capitals are not told from small letters.
pub(super) fn single_letter(sentences: &[Sentence]) -> Option<Result<Action, Unread>> {
    let mut words = sentences.iter().flat_map(|sentence| &sentence.clauses).flatten();
    let (word, None) = (words.next()?, words.next()) else { return None };
    match word.as_str() {
        "f" => Some(Ok(Action::Forward)),
        "b" => Some(Ok(Action::Backward)),
        "u" => Some(Ok(Action::TurnAround)),
        "l" | "r" => Some(Err(Unread::Unclear(word.clone()))),
        _ => None,
    }
}

/// Whether something in `sentences`, which name no action or only doubt some, is what models say when they
/// refuse.
pub(super) fn is_refusal(sentences: &[Sentence], doubts_some: bool) -> bool {
    let words: Vec<&str> =
        sentences.iter().flat_map(|s| &s.clauses).flatten().map(String::as_str).collect();
    if words.contains(&"sorry") && !doubts_some {
        return true;
    }
    let text = format!(" {} ", words.join(" "));
    REFUSING.iter().any(|refusing| text.contains(&format!(" {refusing} ")))
}

/// Where something leads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    Forward,
    /// "backward"; "back" is less clear.
    Backward,
    Back,
    Left,
    Right,
    /// "clockwise" and its opposite are turns and nothing else.
    Clockwise,
    Anticlockwise,
    Around,
}

/// The way that `words[at]` tells, and how many words that takes.
fn way(words: &[&str], at: usize) -> Option<(usize, Way)> {
    let next = words.get(at + 1).copied().unwrap_or_default();
    let way = match *words.get(at)? {
        "forward" | "forwards" | "ahead" | "straight" => Way::Forward,
        "backward" | "backwards" => Way::Backward,
        "back" if matches!(next, "ward" | "wards" | "up") => return Some((2, Way::Backward)),
        "back" => Way::Back,
        "left" | "leftward" | "leftwards" => Way::Left,
        "right" | "rightward" | "rightwards" => Way::Right,
        "clockwise" => Way::Clockwise,
        "counterclockwise" | "anticlockwise" => Way::Anticlockwise,
        "counter" | "anti" if next == "clockwise" => return Some((2, Way::Anticlockwise)),
        "around" | "round" => Way::Around,
        _ => return None,
    };
    Some((1, way))
}

/// The phrase that begins at `at`, after one that ended at `before`: its end, and what it can mean.
fn phrase(words: &[&str], before: usize, at: usize) -> Option<(usize, Actions)> {
    let word = words[at];
    if let Some(action) = in_one_word(word) {
        return Some((at + 1, Actions::of(&[action])));
    }
    let next = words.get(at + 1).copied().unwrap_or_default();
    match (word, next) {
        ("u", "turn") | ("about", "face" | "turn") => {
            return Some((at + 2, Actions::of(&[Action::TurnAround])));
        }
        ("reverse", _) => return Some((at + 1, BACK)),
        // By how many is not understood.
        (unit, _) if DEGREES.contains(&unit) => return Some((at + 1, Actions::NONE)),
        _ => {}
    }
    if TURN.contains(&word) {
        return turn(words, at + 1, true);
    }
    // "left turn", "90 degrees to the right", "half turn".
    if angle(words, at).is_some_and(|(end, _)| end > at + 1)
        || (matches!(word, "left" | "right") && A_TURN.contains(&next))
    {
        return turn(words, at, false);
    }
    if TAKE.contains(&word) {
        return take(words, at + 1);
    }
    if MOVE.contains(&word) || GO.contains(&word) {
        return moved(words, at, MOVE.contains(&word));
    }
    bare(words, before, at)
}

/// An action written as one word: `turnleft`.
fn in_one_word(word: &str) -> Option<Action> {
    if word == "uturn" {
        return Some(Action::TurnAround);
    }
    let same = |action: &Action| {
        let words = action.words().split(' ');
        words.flat_map(str::bytes).eq(word.bytes())
    };
    Action::ALL.into_iter().find(same)
}

/// An angle: its end, and how many degrees. An unusual number is one only with its unit.
fn angle(words: &[&str], at: usize) -> Option<(usize, u32)> {
    let next = words.get(at + 1).copied().unwrap_or_default();
    match *words.get(at)? {
        "quarter" if A_TURN.contains(&next) => Some((at + 2, 90)),
        "half" if A_TURN.contains(&next) => Some((at + 2, 180)),
        word => {
            let degrees = word.parse().ok()?;
            let unit = DEGREES.contains(&next);
            let usual = matches!(degrees, 45 | 90 | 180 | 270 | 360);
            (unit || usual).then_some((at + 1 + usize::from(unit), degrees))
        }
    }
}

/// What a turn leads to, if it says: its verb stands before `from`, or follows ("left turn").
fn turn(words: &[&str], from: usize, verb_first: bool) -> Option<(usize, Actions)> {
    let mut has_verb = verb_first;
    let (mut at, mut end) = (from, None);
    let (mut to, mut by, mut unclear) = (None, None, false);
    while at < words.len().min(from + LONGEST) {
        if has_verb && !verb_first && by == Some(180) {
            // A half turn is the same both ways.
            break;
        }
        if let Some((after, degrees)) = angle(words, at)
            && by.is_none()
        {
            by = Some(degrees);
            (at, end) = (after, Some(after));
            // "half turn"
            has_verb |= A_TURN.contains(&words[after - 1]);
        } else if let Some((length, way)) = self::way(words, at)
            && (to.is_none() || way == Way::Around)
        {
            // "turn right around" is clear, "left turn all the way around" is not.
            unclear |= to.is_some() && !(end == Some(at) && verb_first);
            to = Some(way);
            at += length;
            end = Some(at);
        } else if A_TURN.contains(&words[at]) && !has_verb {
            has_verb = true;
            at += 1;
            end = Some(at);
        } else if FILLING.contains(&words[at])
            || matches!(words[at], COLON | "all" | "way" | "fully" | "completely" | "full")
        {
            at += 1;
        } else {
            break;
        }
    }
    let end = end?;
    let next = words.get(end).copied().unwrap_or_default();
    let place = matches!(next, "the" | "a" | "an" | "this" | "that" | "corner");
    let to = match to {
        None => SIDEWAYS_TURN.or(Actions::of(&[Action::TurnAround])),
        Some(Way::Left | Way::Anticlockwise) => Actions::of(&[Action::TurnLeft]),
        Some(Way::Right | Way::Clockwise) => Actions::of(&[Action::TurnRight]),
        // "turn around the corner"
        Some(Way::Around) if place => Actions::NONE,
        Some(Way::Around | Way::Back | Way::Backward) => Actions::of(&[Action::TurnAround]),
        Some(Way::Forward) => Actions::NONE,
    };
    let actions = match by {
        // "turn left 2 times": by how much is not understood.
        _ if unclear || next.starts_with(char::is_numeric) => Actions::NONE,
        None => to,
        Some(90) => to.and(SIDEWAYS_TURN),
        // Half a turn ends in the same heading both ways round.
        Some(180) if to != Actions::NONE => Actions::of(&[Action::TurnAround]),
        Some(_) => Actions::NONE,
    };
    Some((end, actions))
}

/// "make a left": what stands after the verb. "take the left aisle" is none of the actions.
fn take(words: &[&str], from: usize) -> Option<(usize, Actions)> {
    let at = from + usize::from(matches!(words.get(from), Some(&("a" | "the"))));
    let turned = match *words.get(at)? {
        "left" => Action::TurnLeft,
        "right" => Action::TurnRight,
        _ => return None,
    };
    let actions = match words.get(at + 1) {
        None | Some(&("at" | "here" | "now" | "and" | "then" | "into")) => Actions::of(&[turned]),
        Some(next) if A_TURN.contains(next) => return turn(words, at, false),
        Some(_) => Actions::NONE,
    };
    Some((at + 1, actions))
}

/// What a move leads to whose verb is `words[verb]`, if it says. With `keeps_heading` "left" is the move.
fn moved(words: &[&str], verb: usize, keeps_heading: bool) -> Option<(usize, Actions)> {
    let (mut at, mut found) = (verb + 1, None);
    // In "next move: left" and "the move is left" the verb is none.
    let (mut keeps_heading, mut points) = (keeps_heading, false);
    while at < words.len().min(verb + LONGEST) {
        let word = words[at];
        if let Some((length, way)) = self::way(words, at) {
            if way == Way::Around {
                break;
            }
            at += length;
            found = Some((at, way));
            if word == "straight" {
                let filled =
                    words[at..].iter().take_while(|word| STRAIGHT_TO.contains(word)).count();
                match self::way(words, at + filled) {
                    Some((length, Way::Forward)) => found = Some((at + filled + length, way)),
                    // "straight to the left"
                    Some(_) => return Some((at + filled + 1, Actions::NONE)),
                    None => {}
                }
            }
            break;
        }
        if matches!(word, COLON | "is" | "should" | "be" | "would") {
            keeps_heading = false;
        } else if POINTING.contains(&word) {
            points = true;
        } else if !(FILLING.contains(&word) || word.bytes().all(|byte| byte.is_ascii_digit())) {
            break;
        }
        at += 1;
    }
    let (end, way) = found?;
    let place = points && words.get(end).is_some_and(|next| !NO_PLACE.contains(next));
    let actions = match way {
        // "move to the left rack"
        _ if place && keeps_heading => Actions::NONE,
        Way::Forward => Actions::of(&[Action::Forward]),
        Way::Backward => Actions::of(&[Action::Backward]),
        Way::Back if keeps_heading => Actions::of(&[Action::Backward]),
        Way::Back => BACK,
        Way::Left if keeps_heading => Actions::of(&[Action::Left]),
        Way::Left => LEFTWARD,
        Way::Right if keeps_heading => Actions::of(&[Action::Right]),
        Way::Right => RIGHTWARD,
        Way::Clockwise | Way::Anticlockwise | Way::Around => Actions::NONE,
    };
    Some((end, actions))
}

/// A direction without a verb, unless it tells where something is.
fn bare(words: &[&str], before: usize, at: usize) -> Option<(usize, Actions)> {
    let (length, way) = way(words, at)?;
    let end = at + length;
    let before = words[before..at].last();
    let after = words.get(end).copied().unwrap_or_default();
    if before.is_some_and(|word| DESCRIBING_BEFORE.contains(word))
        || DESCRIBING_AFTER.contains(&after)
        || (words[at] == "right" && AFTER_ADVERB.contains(&after))
    {
        return None;
    }
    let actions = match way {
        Way::Forward => Actions::of(&[Action::Forward]),
        Way::Backward => Actions::of(&[Action::Backward]),
        Way::Back => BACK,
        Way::Left => LEFTWARD,
        Way::Right => RIGHTWARD,
        // Of a turn that was not understood.
        Way::Clockwise | Way::Anticlockwise => Actions::NONE,
        // It is a preposition more often than not.
        Way::Around => return None,
    };
    Some((end, actions))
}
