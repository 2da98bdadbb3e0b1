//! The action in a model's answer.
//!
//! Where the server can restrict answers to the world's actions, an answer is one of them. Otherwise models write around it.
//!
//! 1. Reasoning between tags is no answer ([`split_reasoning`]).
//! 2. An action is named by its own words, one after the other. Moves and turns, where the world has them, can also be a verb
//!    and a direction ("rotate to the left", "strafe right"), or a word that leaves no choice ("forward", "clockwise", "advance").
//!    "Left" alone and "go left" could be a move or a turn, and name nothing, nor does what is seen ("the path forward").
//! 3. An action that is denied ("do not turn left", "moving forward is blocked") does not count, nor one that is said of the
//!    expert, of the memory or of an earlier step ("the expert moved forward").
//! 4. Where the rest name several actions, the first of these [`RANKS`] decides whose mentions all name the same one: those after
//!    a label or key (`action:`), those that are a sentence or a line of their own, conclusions ("so I turn left", of which the last
//!    one counts), intentions ("I should turn left"), quoted ones, and all but possibilities, reasons and later steps.
//! 5. Where none decides, the answer is ambiguous.

use domain::{ActionCode, reasoning::split_reasoning};
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
    /// Several actions are named, and nothing says which one is chosen.
    #[error("the answer names several actions and chooses none")]
    Ambiguous,
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
            Self::NoAction | Self::Ambiguous => Answer::Unreadable,
            Self::CutOff => Answer::CutOff,
        }
    }
}

/// Phrases of refusals.
const REFUSALS: [&str; 7] =
    ["sorry", "cant assist", "cannot assist", "cant help", "cannot help", "as an ai", "i refuse"];

/// Words that deny the action after them.
const NEGATIONS: [&str; 18] = [
    "not", "no", "nor", "neither", "dont", "doesnt", "shouldnt", "wont", "mustnt", "wouldnt",
    "cannot", "cant", "unable", "never", "avoid", "without", "than", "over",
];

/// Words that deny the action before them, after a form of "be" or a colon.
const DENIALS: [&str; 7] = ["not", "no", "blocked", "closed", "impossible", "unsafe", "wrong"];

/// Words between a verb and its direction, and between a negation and its verb.
const FILLERS: [&str; 17] = [
    "able", "to", "the", "my", "your", "one", "a", "1", "cell", "step", "by", "90", "degree",
    "degrees", "quarter", "in", "place",
];

/// Nouns that a direction describes: "the path forward".
const SEEN: [&str; 10] =
    ["the", "way", "path", "route", "view", "aisle", "corridor", "passage", "space", "area"];

/// Words of what others or earlier steps did.
const OTHERS: [&str; 14] = [
    "expert",
    "experts",
    "demonstration",
    "demonstrations",
    "demonstrator",
    "memory",
    "memories",
    "remembered",
    "retrieved",
    "previous",
    "previously",
    "earlier",
    "last",
    "history",
];

/// Words after which the example of others is followed.
const FOLLOWING: [&str; 10] =
    ["follow", "following", "like", "as", "based", "according", "per", "copy", "repeat", "what"];

/// Words that introduce what others say.
const SAYING: [&str; 10] = [
    "say",
    "says",
    "suggest",
    "suggests",
    "show",
    "shows",
    "showed",
    "recommends",
    "indicates",
    "implies",
];

/// Words before the colon or the form of "be" that the chosen action follows.
const LABELS: [&str; 12] = [
    "action",
    "answer",
    "decision",
    "choice",
    "output",
    "conclusion",
    "command",
    "response",
    "final",
    "next",
    "move",
    "step",
];

/// Words that begin a conclusion.
const THEREFORE: [&str; 5] = ["so", "therefore", "thus", "hence", "consequently"];

/// Words of a choice.
const CHOICES: [&str; 8] =
    ["final", "best", "choose", "chose", "decide", "decided", "select", "selected"];

/// Words of an intention.
const INTENTIONS: [&str; 12] = [
    "will", "ill", "id", "should", "must", "let", "lets", "need", "needs", "better", "going", "now",
];

/// Words of possibilities, which end a conclusion or an intention.
const POSSIBILITIES: [&str; 7] =
    ["can", "could", "might", "may", "would", "considered", "considering"];

/// Words of reasons.
const REASONS: [&str; 4] = ["because", "since", "while", "when"];

/// Words of later steps.
const LATER: [&str; 8] =
    ["then", "later", "afterwards", "afterward", "after", "before", "until", "finally"];

/// Words that make all of a sentence a possibility.
const CONDITIONS: [&str; 8] =
    ["if", "unless", "whether", "either", "otherwise", "else", "option", "options"];

/// Words after an action of what it would lead to.
const OUTCOMES: [&str; 11] = [
    "would", "could", "might", "will", "leads", "lead", "hits", "faces", "brings", "takes", "means",
];

/// Reads the action in `text`, which was cut off at the bound on its tokens: a possibility may have been weighed in what follows.
///
/// # Errors
/// When there is none.
pub fn read_cut_off_answer(
    world: &WorldDeclaration,
    text: &str,
) -> Result<ActionCode, UnreadAnswer> {
    match read(world, text) {
        Ok(mention) if !mention.marks.possible => Ok(mention.action),
        Err(UnreadAnswer::Refused) => Err(UnreadAnswer::Refused),
        _ => Err(UnreadAnswer::CutOff),
    }
}

/// Reads the action in `text`.
///
/// # Errors
/// When none is named, or several and none of them is chosen.
pub fn read_answer(world: &WorldDeclaration, text: &str) -> Result<ActionCode, UnreadAnswer> {
    read(world, text).map(|mention| mention.action)
}

fn read(world: &WorldDeclaration, text: &str) -> Result<Mention, UnreadAnswer> {
    let tokens = tokens(split_reasoning(text).1);
    if tokens.iter().all(ends_clause) {
        return Err(UnreadAnswer::Empty);
    }
    let mentions = mentions(world, &tokens);
    let decided = RANKS.iter().find_map(|rank| {
        let mut ranked = mentions.iter().filter(|mention| rank(&mention.marks)).rev();
        let last = ranked.next()?;
        let is_decided = last.marks.concluded || ranked.all(|other| other.action == last.action);
        is_decided.then_some(*last)
    });
    let is_chosen = |mention: &Mention| !mention.marks.of_others;
    decided.filter(is_chosen).ok_or_else(|| {
        let text: Vec<&str> = tokens.iter().map(|token| token.word.as_str()).collect();
        let text = text.join(" ");
        match () {
            () if mentions.iter().any(is_chosen) => UnreadAnswer::Ambiguous,
            () if REFUSALS.iter().any(|phrase| text.contains(phrase)) => UnreadAnswer::Refused,
            () => UnreadAnswer::NoAction,
        }
    })
}

/// An action that is named in an answer.
#[derive(Debug, Clone, Copy)]
struct Mention {
    action: ActionCode,
    marks: Marks,
}

/// What is said of an action that is named.
#[derive(Debug, Clone, Copy, Default)]
struct Marks {
    labelled: bool,
    /// It is a line or a sentence of its own.
    alone: bool,
    concluded: bool,
    intended: bool,
    quoted: bool,
    /// It is a possibility, a reason or a later step.
    possible: bool,
    /// It is what others do, or what an earlier step did.
    of_others: bool,
}

/// Which mentions decide, in this order.
const RANKS: [fn(&Marks) -> bool; 7] = [
    |marks| marks.labelled,
    |marks| marks.alone,
    |marks| marks.concluded,
    |marks| marks.intended,
    |marks| marks.quoted,
    |marks| !marks.possible && !marks.of_others,
    |_| true,
];

/// A word, or what separates words.
struct Token {
    /// A word in lower case; `:` for a colon or `=`, `,` for what ends a clause, `.`, `?` or `\n` for what ends a sentence, `or`
    /// for a slash.
    word: String,
    /// Whether a quotation mark or emphasis is before it.
    opens: bool,
    /// Whether one is after it.
    closes: bool,
}

/// The tokens of a text, with camelCase and snake_case split and apostrophes left out.
fn tokens(text: &str) -> Vec<Token> {
    let mut tokens: Vec<Token> = Vec::new();
    let (mut before, mut is_within) = (' ', false);
    for c in text.chars() {
        let separator = match c {
            ':' | '=' => ":",
            ',' | '(' | ')' => ",",
            '.' | ';' | '!' | '{' | '}' => ".",
            '?' => "?",
            '\n' => "\n",
            '/' | '|' => "or",
            _ => "",
        };
        let is_apostrophe = matches!(c, '\'' | '’') && is_within;
        if c.is_alphanumeric() {
            if !is_within || c.is_uppercase() && before.is_lowercase() {
                let opens = is_quote(before);
                tokens.push(Token { word: String::new(), opens, closes: false });
            }
            if let Some(token) = tokens.last_mut() {
                token.word.extend(c.to_lowercase());
            }
        } else if !separator.is_empty() {
            tokens.push(Token { word: separator.to_owned(), opens: false, closes: false });
        }
        if is_quote(c)
            && !before.is_whitespace()
            && let Some(token) = tokens.iter_mut().rev().find(|token| !ends_clause(token))
        {
            token.closes = true;
        }
        is_within = c.is_alphanumeric() || is_apostrophe;
        before = c;
    }
    tokens
}

fn is_quote(c: char) -> bool {
    matches!(c, '"' | '\'' | '’' | '‘' | '`' | '*' | '“' | '”' | '[' | ']' | '<' | '>' | '{' | '}')
}

fn ends_sentence(token: &Token) -> bool {
    matches!(token.word.as_str(), "." | "?" | "\n")
}

fn ends_clause(token: &Token) -> bool {
    ends_sentence(token) || matches!(token.word.as_str(), "," | ":")
}

/// The actions that are named and not denied, in order.
fn mentions(world: &WorldDeclaration, tokens: &[Token]) -> Vec<Mention> {
    let words: Vec<&str> = tokens.iter().map(|token| token.word.as_str()).collect();
    let mut mentions: Vec<Mention> = Vec::new();
    let mut context = Context::default();
    let mut at = 0;
    while at < words.len() {
        let Some(named) = named_at(world, &words, at) else {
            context.read(&words, at);
            at += 1;
            continue;
        };
        let end = at + named.length;
        if !is_denied_before(tokens, at) && !is_denied_after(&words[end..]) {
            let sentence_end = tokens[end..].iter().find(|token| ends_sentence(token));
            let is_asked = sentence_end.is_some_and(|token| token.word == "?");
            let leads_to = words.get(end).is_some_and(|word| OUTCOMES.contains(word));
            let before = tokens[..at].iter().rposition(ends_sentence).map_or(0, |end| end + 1);
            let is_alone =
                is_heading(&words[before..at]) && tokens.get(end).is_none_or(ends_sentence);
            let marks = Marks {
                of_others: context.next.of_others || named.is_past,
                alone: is_alone,
                quoted: tokens[at].opens && tokens[end - 1].closes,
                ..context.marks()
            };
            let marks = marks.consistent(is_asked || leads_to);
            mentions.push(Mention { action: named.action, marks });
            context.named(marks);
        }
        at = end;
    }
    mentions
}

impl Marks {
    /// One kind of marks: what others do is no choice, what is chosen no possibility, unless it is only weighed.
    fn consistent(self, is_weighed: bool) -> Self {
        let is_chosen = self.labelled || self.concluded || self.intended;
        match self {
            Self { of_others: true, .. } => Self { of_others: true, ..Self::default() },
            _ if is_weighed || self.possible && !is_chosen => {
                Self { possible: true, ..Self::default() }
            }
            _ => Self { possible: false, ..self },
        }
    }
}

/// Whether nothing is before an action in its sentence, or a few words and a colon.
fn is_heading(words: &[&str]) -> bool {
    words.is_empty() || words.len() <= 5 && words.ends_with(&[":"])
}

/// What the words before an action say of it.
#[derive(Debug, Default)]
struct Context {
    /// The marks of the next action.
    next: Marks,
    /// All of the sentence is a possibility.
    is_condition: bool,
    /// The clause is of a later step.
    is_later: bool,
    /// The clause follows the example of others.
    is_following: bool,
    /// The clause has what others say.
    is_saying: bool,
    /// The marks of the last action of the sentence.
    last: Option<Marks>,
}

impl Context {
    fn marks(&self) -> Marks {
        match self.is_later {
            true => Marks { possible: true, ..Marks::default() },
            false => Marks { possible: self.next.possible || self.is_condition, ..self.next },
        }
    }

    /// An action was named.
    fn named(&mut self, marks: Marks) {
        self.last = Some(marks);
        let Marks { possible, of_others, .. } = self.next;
        self.next = Marks { possible, of_others, ..Marks::default() };
    }

    /// Reads a word, or what separates words.
    fn read(&mut self, words: &[&str], at: usize) {
        let (word, before) = (words[at], &words[..at]);
        let next = words.get(at + 1).copied().unwrap_or_default();
        match word {
            "." | "?" | "\n" => {
                let next = Marks { labelled: self.next.labelled, ..Marks::default() };
                *self = Self { next, ..Self::default() };
            }
            "," if before.last().is_some_and(|word| LATER.contains(word)) => {}
            "," | "but" | "however" => self.end_clause(),
            ":" if ends_with_label(before) => self.next.labelled = true,
            "or" => self.next = self.last.unwrap_or(self.next),
            "and" => self.next.possible |= self.last.is_some(),
            "i" | "im" | "my" | "me" | "we" | "us" => {
                self.next.of_others &= self.is_saying;
                self.next.intended |= next == "would";
            }
            "is" | "should" | "will" | "would" if ends_with_label(before) => {
                self.next.concluded = true;
            }
            "would" if self.next.intended => {}
            "so" if matches!(next, "that" | "far" | "as" | "many") => self.next.possible = true,
            _ if THEREFORE.contains(&word) => {
                self.end_clause();
                self.next.concluded = true;
            }
            _ if CHOICES.contains(&word) => self.next.concluded = true,
            _ if INTENTIONS.contains(&word) => {
                self.next.intended |= before.last() != Some(&"would")
            }
            _ if POSSIBILITIES.contains(&word) => {
                let of_others = self.next.of_others;
                self.next = Marks { possible: true, of_others, ..Marks::default() };
            }
            _ if REASONS.contains(&word) => self.next.possible = true,
            _ if LATER.contains(&word) => self.is_later = true,
            _ if CONDITIONS.contains(&word) => self.is_condition = true,
            _ if FOLLOWING.contains(&word) => self.is_following = true,
            _ if SAYING.contains(&word) => self.is_saying = true,
            _ if OTHERS.contains(&word) => self.next.of_others |= !self.is_following,
            _ => {}
        }
    }

    fn end_clause(&mut self) {
        self.next.of_others = false;
        self.next.possible = false;
        self.is_later = false;
        self.is_following = false;
        self.is_saying = false;
    }
}

/// Whether the words end with a label, or with one and a form of "be".
fn ends_with_label(words: &[&str]) -> bool {
    let mut words = words
        .iter()
        .rev()
        .filter(|word| !matches!(**word, "is" | "be" | "should" | "will" | "would"));
    words.next().is_some_and(|word| LABELS.contains(word))
}

/// Whether the words before an action deny it.
fn is_denied_before(tokens: &[Token], at: usize) -> bool {
    let clause = tokens[..at].iter().rev().take_while(|token| !ends_clause(token));
    let words: Vec<&str> = clause.map(|token| token.word.as_str()).collect();
    let words: Vec<&str> =
        words.into_iter().filter(|word| !FILLERS.contains(word)).take(2).collect();
    words.first().is_some_and(|word| is_form_of(word, &["look", "fac", "see"]))
        || words.iter().any(|word| NEGATIONS.contains(word))
        || words.starts_with(&["of", "instead"])
}

/// Whether the words after an action say that it is impossible.
fn is_denied_after(words: &[&str]) -> bool {
    let words = words.iter().copied().filter(|word| !FILLERS.contains(word));
    let words: Vec<&str> =
        words.take_while(|word| !matches!(*word, "." | "\n" | "," | "?")).take(3).collect();
    match words[..] {
        [":", word, ..] => DENIALS.contains(&word),
        ["isnt" | "wasnt" | "wont" | "cant" | "cannot" | "wouldnt" | "doesnt" | "blocked", ..] => {
            true
        }
        ["is" | "was" | "seems" | "looks" | "would" | "will" | "does" | "be", word, ..]
            if DENIALS.contains(&word) =>
        {
            true
        }
        ["would" | "will" | "seems" | "looks", "be" | "to", word, ..] => DENIALS.contains(&word),
        _ => false,
    }
}

/// An action that is named by the words from some position.
struct Named {
    action: ActionCode,
    /// Number of words.
    length: usize,
    /// Whether it is said to have been done.
    is_past: bool,
}

/// The action that begins with the word `at`: one that is named by its own words, or in another way.
fn named_at(world: &WorldDeclaration, all: &[&str], at: usize) -> Option<Named> {
    let words = &all[at..];
    let named = world.action_codes().filter_map(|action| {
        let mut rest = words.iter();
        let mut own = world.action_words(action).split(' ');
        own.all(|word| rest.next() == Some(&word)).then_some((words.len() - rest.len(), action))
    });
    // Where one action's words begin another's, the longer ones count.
    let longest = named.max_by_key(|(length, _)| *length);
    if let Some((length, action)) = longest {
        return Some(Named { action, length, is_past: false });
    }
    let (paraphrase, length, is_past) = paraphrased(words)?;
    let before = at.checked_sub(1).map(|before| all[before]);
    let is_noun = length == 1 && before.is_some_and(|word| SEEN.contains(&word) || word == "in");
    let action = world.action_named(paraphrase)?;
    (!is_noun).then_some(Named { action, length, is_past })
}

/// The words of the action of moving or turning that begins with the first of `words`, the number of words that name it, and
/// whether it is past.
fn paraphrased(words: &[&str]) -> Option<(&'static str, usize, bool)> {
    let (&first, rest) = words.split_first()?;
    let skipped = rest.iter().position(|word| !FILLERS.contains(word)).unwrap_or(rest.len());
    let next = rest.get(skipped).copied().unwrap_or(".");
    let after = rest.get(skipped + 1).copied().unwrap_or(".");
    let is_turn = is_form_of(first, &["turn", "rotat", "pivot", "spin", "spinn"]);
    // Verbs that keep the heading, and verbs that say nothing about it.
    let is_move = is_form_of(
        first,
        &["mov", "step", "stepp", "straf", "sidestep", "sidestepp", "shift", "slid"],
    );
    let is_walk = is_form_of(first, &["go", "went", "walk", "continu", "proceed", "head"]);
    let two = skipped + 2;
    let (action, length) = match (first, next) {
        ("forward" | "forwards", _) => ("move forward", 1),
        ("backward" | "backwards", _) => ("move backward", 1),
        (_, "forward" | "forwards") if is_move || is_walk => ("move forward", two),
        (_, "backward" | "backwards") if is_move || is_walk => ("move backward", two),
        ("uturn", _) => ("turn around", 1),
        ("u", "turn") => ("turn around", two),
        ("clockwise", _) => ("turn right", 1),
        ("counterclockwise" | "anticlockwise", _) => ("turn left", 1),
        ("counter" | "anti", "clockwise") => ("turn left", two),
        (_, "180") if is_turn => {
            let direction = |word: &&&str| FILLERS.contains(word) || word.ends_with("clockwise");
            ("turn around", two + rest[skipped + 1..].iter().take_while(direction).count())
        }
        (_, "around" | "back") if is_turn => ("turn around", two),
        (_, "left" | "counterclockwise" | "anticlockwise") if is_turn => ("turn left", two),
        (_, "counter" | "anti") if is_turn && after == "clockwise" => ("turn left", two + 1),
        (_, "right" | "clockwise") if is_turn => ("turn right", two),
        ("left", "turn") => ("turn left", two),
        ("right", "turn") => ("turn right", two),
        (_, "left") if is_move => ("move left", two),
        (_, "right") if is_move => ("move right", two),
        (_, "back") if is_move || is_walk => ("move backward", two),
        (_, "straight") if is_move || is_walk => ("move forward", two),
        // "Go ahead" begins many sentences.
        (_, "ahead") if first != "go" && (is_move || is_walk) => ("move forward", two),
        _ if is_form_of(first, &["advanc"]) => ("move forward", 1),
        _ => return None,
    };
    let is_past = first == "went" || first.ends_with("ed") && first != "proceed";
    Some((action, length, is_past))
}

/// Whether a word is a form of one of `verbs`, which are given without endings.
fn is_form_of(word: &str, verbs: &[&str]) -> bool {
    verbs.iter().any(|verb| {
        word.strip_prefix(verb)
            .is_some_and(|ending| matches!(ending, "" | "s" | "e" | "es" | "ing" | "ed"))
    })
}

#[cfg(test)]
mod tests {
    use domain::Action;
    use warehouse::declaration;

    use super::UnreadAnswer::{Ambiguous, CutOff, Empty, NoAction, Refused};
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
    fn the_chosen_action_counts() {
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
            ("turn left, or move forward?", Err(Ambiguous)),
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
            ("The expert's action was open door. So I open door 2 slowly.", Ok(open_slowly)),
            ("I could open door or open door 2 slowly.", Err(Ambiguous)),
            ("I could open door.\nopen door 2 slowly", Ok(open_slowly)),
            ("The expert's action: open door", Err(NoAction)),
            ("clockwise, advance", Err(NoAction)),
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
            ("I could turn left to s", Err(CutOff)),
            ("The options are turn left and move forw", Err(CutOff)),
            ("The expert moved forward, then turned", Err(CutOff)),
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
