//! The demonstrations of a case, and which of them a memory is built from: as text and as bits on the wire.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::Route;

/// A demonstration of a case (specification, section 4). Its number is its code on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DemonstrationKind {
    /// From the case's start.
    Original = 0,
    /// From the same cell, facing the other way.
    Opposite = 1,
    /// From 2 to 4 cells along the same aisle, with the same heading.
    Nearby = 2,
    /// From another aisle, with the heading turned by 90 degrees.
    Distant = 3,
    /// From the case's start with its passage closed, by an expert who knows.
    After = 6,
    /// The same task in another warehouse.
    Elsewhere = 7,
    /// The test reference from the new start, which only the arm `oracle` holds.
    New = 8,
    /// The test reference from there on the blocked route, which only the arm `oracle` holds.
    Blocked = 9,
}

impl DemonstrationKind {
    /// The four that every case has.
    pub const OWN: [Self; 4] = [Self::Original, Self::Opposite, Self::Nearby, Self::Distant];

    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Original,
        Self::Opposite,
        Self::Nearby,
        Self::Distant,
        Self::After,
        Self::Elsewhere,
        Self::New,
        Self::Blocked,
    ];

    /// Whether it is a test reference, which is a demonstration in the arm `oracle` only.
    pub const fn is_reference(self) -> bool {
        matches!(self, Self::New | Self::Blocked)
    }

    /// The test reference from the new start on `route`.
    pub const fn reference(route: Route) -> Self {
        match route {
            Route::Unchanged => Self::New,
            Route::Blocked => Self::Blocked,
        }
    }

    /// The kind with this code on the wire, if there is one.
    pub fn from_code(code: u16) -> Option<Self> {
        Self::ALL.into_iter().find(|&kind| kind as u16 == code)
    }

    /// The name in files and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Original => "original",
            Self::Opposite => "opposite",
            Self::Nearby => "nearby",
            Self::Distant => "distant",
            Self::After => "after",
            Self::Elsewhere => "elsewhere",
            Self::New => "new",
            Self::Blocked => "blocked",
        }
    }

    /// The letter in the log's column of sources.
    pub const fn letter(self) -> char {
        match self {
            Self::Original => 'o',
            Self::Opposite => 'p',
            Self::Nearby => 'n',
            Self::Distant => 'd',
            Self::After => 'a',
            Self::Elsewhere => 'w',
            Self::New => 't',
            Self::Blocked => 'b',
        }
    }
}

/// The kind of demonstrations of other tasks that a case is tested with (specification, section 6).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Mixture {
    /// They share no pose with the test reference.
    Irrelevant,
    /// They share poses with it and continue differently from there.
    Confusable,
}

impl Mixture {
    /// Both kinds.
    pub const ALL: [Self; 2] = [Self::Irrelevant, Self::Confusable];

    /// The name in files and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Irrelevant => "irrelevant",
            Self::Confusable => "confusable",
        }
    }
}

/// Some of the case's own four demonstrations; two of them and two of other cases (specification, section 6); one from before
/// and one from after an event; one of another warehouse; or a bank of many.
///
/// Written `original`, `original+nearby`, `4` for all own, or `none`; and
///
/// - `irrelevant`, `confusable`: original, opposite, and the case's two histories of that kind;
/// - `after`: one demonstration by an expert who knows the case's closed passage; `before-after`, `after-before`: original and
///   that one, in this order;
/// - `elsewhere`: the case's task demonstrated in another warehouse;
/// - `bank-N`: N demonstrations of the case and of others, of which each bank holds those of the smaller ones.
///
/// Memories of the control arms hold [other sets](Self::is_control), which no condition names: `new-reference` and
/// `blocked-reference`, a test reference of the case; `wrong-1` and `wrong-2`, so many of its irrelevant histories.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Demonstrations(Selection);

/// What [`Demonstrations`] are selected. Ordered as the [bits](Demonstrations::bits) are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
enum Selection {
    /// Some of the case's own: a bit for the number of each.
    Own(u8),
    /// Original, opposite, and the case's two histories of other tasks of one kind.
    Mixed(Mixture),
    /// The one after the case's passage has closed.
    After,
    /// Original, then that one.
    BeforeAfter,
    /// That one, then original.
    AfterBefore,
    /// The one of another warehouse.
    Elsewhere,
    /// The test reference from the new start on this route.
    Reference(Route),
    /// So many of the case's irrelevant histories.
    Wrong(WrongCount),
    /// A bank with so many, at least one.
    Bank(u16),
}

/// How many irrelevant histories a memory of the arm `wrong` holds: a case has two.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
enum WrongCount {
    One,
    Two,
}

/// A text that names no [`Demonstrations`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown demonstrations `{given}`: did you mean `{nearest}`? (known: 4 for a case's own four, some of \
     {own} joined by +, 1 for the first of them, irrelevant, confusable, after, before-after, after-before, elsewhere, \
     bank-N, none)",
    own = OWN.map(DemonstrationKind::name).join(", ")
)]
pub struct UnknownDemonstrations {
    /// The unknown word.
    pub given: String,
    /// The known word nearest to it.
    pub nearest: &'static str,
}

const OWN: [DemonstrationKind; 4] = DemonstrationKind::OWN;

/// Sets with a name. A set is displayed with the first name that fits.
const WORDS: [(&str, Demonstrations); 17] = [
    ("none", Demonstrations::NONE),
    ("original", Demonstrations::ORIGINAL),
    ("1", Demonstrations::ORIGINAL),
    ("opposite", Demonstrations(Selection::Own(1 << DemonstrationKind::Opposite as u8))),
    ("nearby", Demonstrations(Selection::Own(1 << DemonstrationKind::Nearby as u8))),
    ("distant", Demonstrations(Selection::Own(1 << DemonstrationKind::Distant as u8))),
    ("4", Demonstrations::ALL),
    ("irrelevant", Demonstrations::IRRELEVANT),
    ("confusable", Demonstrations::CONFUSABLE),
    ("after", Demonstrations::AFTER),
    ("before-after", Demonstrations::BEFORE_AFTER),
    ("after-before", Demonstrations::AFTER_BEFORE),
    ("elsewhere", Demonstrations::ELSEWHERE),
    ("new-reference", Demonstrations::NEW_REFERENCE),
    ("blocked-reference", Demonstrations::BLOCKED_REFERENCE),
    ("wrong-1", Demonstrations::WRONG_1),
    ("wrong-2", Demonstrations::WRONG_2),
];

impl Demonstrations {
    /// No demonstrations, as for working memory.
    pub const NONE: Self = Self(Selection::Own(0));
    /// Only the case's original demonstration.
    pub const ORIGINAL: Self = Self(Selection::Own(1 << DemonstrationKind::Original as u8));
    /// The case's own four.
    pub const ALL: Self = Self(Selection::Own(0b1111));
    /// Original, opposite, and the case's two irrelevant histories.
    pub const IRRELEVANT: Self = Self(Selection::Mixed(Mixture::Irrelevant));
    /// Original, opposite, and the case's two confusable histories.
    pub const CONFUSABLE: Self = Self(Selection::Mixed(Mixture::Confusable));
    /// One demonstration by an expert who knows the case's closed passage.
    pub const AFTER: Self = Self(Selection::After);
    /// Original, then [`AFTER`](Self::AFTER).
    pub const BEFORE_AFTER: Self = Self(Selection::BeforeAfter);
    /// The same the other way round.
    pub const AFTER_BEFORE: Self = Self(Selection::AfterBefore);
    /// The case's task demonstrated in another warehouse.
    pub const ELSEWHERE: Self = Self(Selection::Elsewhere);

    /// The test reference from the new start, on the unchanged route.
    pub const NEW_REFERENCE: Self = Self(Selection::Reference(Route::Unchanged));
    /// The test reference from the new start, on the blocked route.
    pub const BLOCKED_REFERENCE: Self = Self(Selection::Reference(Route::Blocked));
    /// The first of the case's irrelevant histories.
    pub const WRONG_1: Self = Self(Selection::Wrong(WrongCount::One));
    /// Both of the case's irrelevant histories.
    pub const WRONG_2: Self = Self(Selection::Wrong(WrongCount::Two));

    /// A bank of `size` demonstrations; none if that is 0.
    pub const fn bank(size: u16) -> Self {
        if size == 0 { Self::NONE } else { Self(Selection::Bank(size)) }
    }

    /// The size of the bank, if it is one.
    pub const fn bank_size(self) -> Option<u16> {
        match self.0 {
            Selection::Bank(size) => Some(size),
            _ => None,
        }
    }

    /// The set on the wire. Bits 0 to 3 stand for the case's own demonstrations, bit 4 for its irrelevant histories, bit 5 for its
    /// confusable ones, bit 6 for the one after the event and bit 7 for that one being first, bit 8 for the one of another
    /// warehouse, bit 9 for the test reference on the unchanged and bit 10 on the blocked route, bit 11 for one of the irrelevant
    /// histories alone and bit 12 for both alone, bits 16 to 31 for the size of a bank.
    pub const fn bits(self) -> u32 {
        match self.0 {
            Selection::Own(bits) => bits as u32,
            Selection::Mixed(Mixture::Irrelevant) => 0b1_0011,
            Selection::Mixed(Mixture::Confusable) => 0b10_0011,
            Selection::After => 0b100_0000,
            Selection::BeforeAfter => 0b100_0001,
            Selection::AfterBefore => 0b1100_0001,
            Selection::Elsewhere => 1 << 8,
            Selection::Reference(Route::Unchanged) => 1 << 9,
            Selection::Reference(Route::Blocked) => 1 << 10,
            Selection::Wrong(WrongCount::One) => 1 << 11,
            Selection::Wrong(WrongCount::Two) => 1 << 12,
            Selection::Bank(size) => (size as u32) << 16,
        }
    }

    /// The set with these [`bits`](Self::bits), if there is one.
    pub fn from_bits(bits: u32) -> Option<Self> {
        let own = u8::try_from(bits).ok().filter(|bits| *bits <= 0b1111);
        let own = own.map(|bits| Self(Selection::Own(bits)));
        let named = WORDS.iter().map(|(_, set)| *set);
        let bank = Self::bank((bits >> 16) as u16);
        own.into_iter().chain(named).chain([bank]).find(|set| set.bits() == bits)
    }

    /// The case's own demonstrations in the set, in order.
    pub fn own(self) -> impl Iterator<Item = DemonstrationKind> {
        let bits = match self.0 {
            Selection::Own(bits) => bits,
            Selection::Mixed(_) => 0b11,
            Selection::BeforeAfter | Selection::AfterBefore => 0b1,
            Selection::After
            | Selection::Elsewhere
            | Selection::Reference(_)
            | Selection::Wrong(_)
            | Selection::Bank(_) => 0,
        };
        OWN.into_iter().filter(move |&kind| bits & (1 << kind as u8) != 0)
    }

    /// Whether the demonstration after the event is in the set.
    pub const fn take_place_after(self) -> bool {
        matches!(self.0, Selection::After | Selection::BeforeAfter | Selection::AfterBefore)
    }

    /// Whether the set takes place in another warehouse.
    pub const fn take_place_elsewhere(self) -> bool {
        matches!(self.0, Selection::Elsewhere)
    }

    /// The route of the test reference that the set holds, if it is one.
    pub const fn reference(self) -> Option<Route> {
        match self.0 {
            Selection::Reference(route) => Some(route),
            _ => None,
        }
    }

    /// How many of the case's irrelevant histories the set consists of; `None` for a set that has others, too.
    pub const fn wrong(self) -> Option<usize> {
        match self.0 {
            Selection::Wrong(WrongCount::One) => Some(1),
            Selection::Wrong(WrongCount::Two) => Some(2),
            _ => None,
        }
    }

    /// Whether only the memories of the control arms `oracle` and `wrong` hold it.
    pub const fn is_control(self) -> bool {
        self.reference().is_some() || self.wrong().is_some()
    }

    /// The number of demonstrations in the set.
    pub fn count(self) -> usize {
        match self.0 {
            Selection::Own(_) => self.own().count(),
            Selection::Mixed(_) => 4,
            Selection::BeforeAfter | Selection::AfterBefore => 2,
            Selection::After | Selection::Elsewhere | Selection::Reference(_) => 1,
            Selection::Wrong(WrongCount::One) => 1,
            Selection::Wrong(WrongCount::Two) => 2,
            Selection::Bank(size) => size.into(),
        }
    }

    /// The set in words, as what a case lacks.
    pub fn in_words(self) -> String {
        match self.0 {
            Selection::Reference(Route::Unchanged) => {
                "test reference among its demonstrations, which the arm `oracle` holds".to_owned()
            }
            Selection::Reference(Route::Blocked) => {
                "test reference of the blocked route among its demonstrations, which the arm `oracle` holds"
                    .to_owned()
            }
            Selection::Wrong(_) => "`irrelevant` histories, which the arm `wrong` holds".to_owned(),
            _ => format!("demonstrations `{self}`"),
        }
    }

    /// The kind of histories of other cases in the set, if any.
    pub const fn mixture(self) -> Option<Mixture> {
        match self.0 {
            Selection::Mixed(mixture) => Some(mixture),
            _ => None,
        }
    }
}

impl fmt::Display for Demonstrations {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let word = WORDS.iter().find(|(_, set)| set == self);
        match (word, self.bank_size()) {
            (Some((word, _)), _) => f.pad(word),
            (None, Some(size)) => f.pad(&format!("bank-{size}")),
            (None, None) => {
                f.pad(&self.own().map(DemonstrationKind::name).collect::<Vec<_>>().join("+"))
            }
        }
    }
}

impl FromStr for Demonstrations {
    type Err = UnknownDemonstrations;

    fn from_str(text: &str) -> Result<Self, UnknownDemonstrations> {
        if let Some(&(_, set)) = WORDS.iter().find(|(word, _)| *word == text) {
            return Ok(set);
        }
        if let Some(size) = text.strip_prefix("bank-").and_then(|size| size.parse().ok())
            && size > 0
        {
            return Ok(Self::bank(size));
        }
        let own = |word: &str| OWN.into_iter().find(|start| start.name() == word);
        let mut bits = 0;
        for word in text.split('+') {
            let start = own(word).ok_or_else(|| UnknownDemonstrations::new(word))?;
            bits |= 1 << start as u8;
        }
        Ok(Self(Selection::Own(bits)))
    }
}

impl UnknownDemonstrations {
    fn new(given: &str) -> Self {
        let distance = |&(word, _): &(&'static str, _)| strsim::levenshtein(word, given);
        // `min_by_key` keeps the first of equals.
        let named = WORDS.iter().filter(|(_, set)| !set.is_control());
        let nearest = named.min_by_key(|entry| distance(entry));
        Self { given: given.to_owned(), nearest: nearest.map_or("none", |(word, _)| word) }
    }
}

impl TryFrom<String> for Demonstrations {
    type Error = UnknownDemonstrations;

    fn try_from(text: String) -> Result<Self, UnknownDemonstrations> {
        text.parse()
    }
}

impl From<Demonstrations> for String {
    fn from(demonstrations: Demonstrations) -> Self {
        demonstrations.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_written_as_they_are_read() {
        for (text, bits, shown) in [
            ("original", 0b0001, "original"),
            ("1", 0b0001, "original"),
            ("distant", 0b1000, "distant"),
            ("4", 0b1111, "4"),
            ("distant+opposite", 0b1010, "opposite+distant"),
            ("original+opposite+nearby+distant", 0b1111, "4"),
            ("none", 0, "none"),
            ("irrelevant", 0b01_0011, "irrelevant"),
            ("confusable", 0b10_0011, "confusable"),
            ("after", 0b0100_0000, "after"),
            ("before-after", 0b0100_0001, "before-after"),
            ("after-before", 0b1100_0001, "after-before"),
            ("elsewhere", 1 << 8, "elsewhere"),
            ("new-reference", 1 << 9, "new-reference"),
            ("blocked-reference", 1 << 10, "blocked-reference"),
            ("wrong-1", 1 << 11, "wrong-1"),
            ("wrong-2", 1 << 12, "wrong-2"),
            ("bank-1", 1 << 16, "bank-1"),
            ("bank-10000", 10_000 << 16, "bank-10000"),
        ] {
            let set: Demonstrations = text.parse().unwrap();
            assert_eq!((set.bits(), set.to_string().as_str()), (bits, shown));
            assert_eq!(set.to_string().parse(), Ok(set));
        }
        let sets: Vec<Demonstrations> =
            (0..2 << 16).filter_map(Demonstrations::from_bits).collect();
        assert_eq!(sets.len(), 16 + 2 + 4 + 4 + 1);
        for &set in &sets {
            assert_eq!(set.to_string().parse(), Ok(set));
            assert_eq!(Demonstrations::from_bits(set.bits()), Some(set));
        }
        assert!(sets.is_sorted());
    }

    #[test]
    fn another_word_is_refused_with_the_nearest() {
        for (text, given, nearest) in [
            ("origin", "origin", "original"),
            ("original+near", "near", "nearby"),
            ("confusible", "confusible", "confusable"),
            ("original+irrelevant", "irrelevant", "irrelevant"),
            ("5", "5", "1"),
            ("bank-0", "bank-0", "none"),
            ("bank-70000", "bank-70000", "none"),
        ] {
            let error = text.parse::<Demonstrations>().unwrap_err();
            assert_eq!((error.given.as_str(), error.nearest), (given, nearest), "{text}");
        }
        insta::assert_snapshot!(
            "origin".parse::<Demonstrations>().unwrap_err(),
            @"unknown demonstrations `origin`: did you mean `original`? (known: 4 for a case's own four, some of original, opposite, nearby, distant joined by +, 1 for the first of them, irrelevant, confusable, after, before-after, after-before, elsewhere, bank-N, none)"
        );
    }
}
