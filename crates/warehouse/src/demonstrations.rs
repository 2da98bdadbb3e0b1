//! Which demonstrations a memory is built from, as text and as bits on the wire. [`CaseSet::histories`] lists them for a
//! case.

use std::collections::HashSet;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::case::{CaseSet, History, Mixture, Start};
use crate::draw::Draw;

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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Demonstrations(u32);

/// A text that names no [`Demonstrations`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown demonstrations `{given}`: did you mean `{nearest}`? (known: 4 for a case's own four, some of \
     {own} joined by +, 1 for the first of them, irrelevant, confusable, after, before-after, after-before, elsewhere, \
     bank-N, none)",
    own = OWN.map(Start::name).join(", ")
)]
pub struct UnknownDemonstrations {
    /// The unknown word.
    pub given: String,
    /// The known word nearest to it.
    pub nearest: &'static str,
}

const OWN: [Start; 4] = Start::DEMONSTRATIONS;

/// The bits of the case's own four.
const OWN_BITS: u32 = 0b1111;

/// The bits of a bank's size begin here.
const BANK_SHIFT: u32 = 16;

/// Sets with a name. A set is displayed with the first name that fits.
const WORDS: [(&str, Demonstrations); 13] = [
    ("none", Demonstrations::NONE),
    ("original", Demonstrations::ORIGINAL),
    ("1", Demonstrations::ORIGINAL),
    ("opposite", Demonstrations(1 << Start::Opposite as u32)),
    ("nearby", Demonstrations(1 << Start::Nearby as u32)),
    ("distant", Demonstrations(1 << Start::Distant as u32)),
    ("4", Demonstrations::ALL),
    ("irrelevant", Demonstrations::IRRELEVANT),
    ("confusable", Demonstrations::CONFUSABLE),
    ("after", Demonstrations::AFTER),
    ("before-after", Demonstrations::BEFORE_AFTER),
    ("after-before", Demonstrations::AFTER_BEFORE),
    ("elsewhere", Demonstrations::ELSEWHERE),
];

impl Demonstrations {
    /// No demonstrations, as for working memory.
    pub const NONE: Self = Self(0);
    /// Only the case's original demonstration.
    pub const ORIGINAL: Self = Self(1);
    /// The case's own four.
    pub const ALL: Self = Self(OWN_BITS);
    /// Original, opposite, and the case's two irrelevant histories.
    pub const IRRELEVANT: Self = Self(0b01_0011);
    /// Original, opposite, and the case's two confusable histories.
    pub const CONFUSABLE: Self = Self(0b10_0011);

    /// One demonstration by an expert who knows the case's closed passage.
    pub const AFTER: Self = Self(1 << 6);
    /// Original, then [`AFTER`](Self::AFTER).
    pub const BEFORE_AFTER: Self = Self(1 << 6 | 1);
    /// The same the other way round.
    pub const AFTER_BEFORE: Self = Self(1 << 7 | 1 << 6 | 1);
    /// The case's task demonstrated in another warehouse.
    pub const ELSEWHERE: Self = Self(1 << 8);

    /// A bank of `size` demonstrations; none if that is 0.
    pub const fn bank(size: u16) -> Self {
        Self((size as u32) << BANK_SHIFT)
    }

    /// The size of the bank, if it is one.
    pub const fn bank_size(self) -> Option<u16> {
        match self.0 >> BANK_SHIFT {
            0 => None,
            size => Some(size as u16),
        }
    }

    /// Bits 0 to 3 stand for the case's own demonstrations, bit 4 for its irrelevant histories, bit 5 for its confusable
    /// ones, bit 6 for the one after the event and bit 7 for that one being first, bit 8 for the one of another warehouse, bits
    /// 16 to 31 for the size of a bank.
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// The set with these [`bits`](Self::bits), if there is one.
    pub fn from_bits(bits: u32) -> Option<Self> {
        let set = Self(bits);
        let is_bank = bits & ((1 << BANK_SHIFT) - 1) == 0;
        let is_named = WORDS.iter().any(|&(_, named)| named == set);
        (bits <= OWN_BITS || is_bank || is_named).then_some(set)
    }

    /// The case's own demonstrations in the set, in order.
    pub fn own(self) -> impl Iterator<Item = Start> {
        OWN.into_iter().filter(move |&start| self.0 & (1 << start as u32) != 0)
    }

    /// Whether the demonstration after the event is in the set.
    pub const fn take_place_after(self) -> bool {
        self.0 & Self::AFTER.0 != 0
    }

    /// Whether the set takes place in another warehouse.
    pub const fn take_place_elsewhere(self) -> bool {
        self.0 & Self::ELSEWHERE.0 != 0
    }

    /// The kind of histories of other cases in the set, if any.
    pub const fn mixture(self) -> Option<Mixture> {
        match self {
            Self::IRRELEVANT => Some(Mixture::Irrelevant),
            Self::CONFUSABLE => Some(Mixture::Confusable),
            _ => None,
        }
    }
}

impl CaseSet {
    /// The `demonstrations` of case number `case`: its own in the order of [`Start`], then its histories of other cases. Empty if
    /// there is no such case, and for a bank of more than [`largest_bank`](Self::largest_bank).
    ///
    /// A bank of N demonstrations holds the first N - 1 of an order of all demonstrations of all cases, which is drawn from the
    /// seed, and the case's original one; the N-th if that is among them. So a larger bank holds the smaller ones, and cases
    /// whose original demonstration comes early have the same bank.
    pub fn histories(&self, case: usize, demonstrations: Demonstrations) -> Vec<History> {
        let Some(listed) = self.cases.get(case) else { return Vec::new() };
        if let Some(size) = demonstrations.bank_size() {
            let own = History { case, start: Start::Original };
            let mut bank = self.common_bank(size);
            if let (false, Some(last)) = (bank.contains(&own), bank.last_mut()) {
                *last = own;
            }
            return if usize::from(size) > self.largest_bank() { Vec::new() } else { bank };
        }
        let own = demonstrations.own().map(|start| History { case, start });
        let others = demonstrations.mixture().map(|mixture| listed.mixed(mixture));
        if demonstrations.take_place_elsewhere() {
            return vec![History { case, start: Start::Elsewhere }];
        }
        let after =
            demonstrations.take_place_after().then_some(History { case, start: Start::After });
        let mut found: Vec<History> =
            own.chain(others.into_iter().flatten()).chain(after).collect();
        if demonstrations == Demonstrations::AFTER_BEFORE {
            found.reverse();
        }
        found
    }

    /// The `demonstrations` of all cases, each once, in the order of the cases.
    pub fn histories_of_all(&self, demonstrations: Demonstrations) -> Vec<History> {
        let mut known = HashSet::new();
        let all = (0..self.cases.len()).flat_map(|case| self.histories(case, demonstrations));
        all.filter(|history| known.insert(*history)).collect()
    }

    /// The first `size` of the order of banks: what the bank of each case holds whose original demonstration is among them.
    pub fn common_bank(&self, size: u16) -> Vec<History> {
        let mut order = self.bank_order();
        order.truncate(size.into());
        order
    }

    /// The size of the largest bank: all demonstrations that the cases have.
    pub fn largest_bank(&self) -> usize {
        Start::DEMONSTRATIONS.len() * self.cases.len()
    }

    /// The demonstrations of all cases in the order in which they join banks, drawn from the seed.
    fn bank_order(&self) -> Vec<History> {
        let of = |case| Start::DEMONSTRATIONS.map(|start| History { case, start });
        let all = (0..self.cases.len()).flat_map(of).collect();
        Draw::new(self.seed, BANK_STREAM).shuffled(all)
    }
}

/// Marks the draws of [`CaseSet::bank_order`].
const BANK_STREAM: u64 = 3 << 56;

impl fmt::Display for Demonstrations {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match WORDS.iter().find(|(_, set)| set == self) {
            Some((word, _)) => f.pad(word),
            None if self.bank_size().is_some() => f.pad(&format!("bank-{}", self.0 >> BANK_SHIFT)),
            None => f.pad(&self.own().map(Start::name).collect::<Vec<_>>().join("+")),
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
            bits |= 1 << start as u32;
        }
        Ok(Self(bits))
    }
}

impl UnknownDemonstrations {
    fn new(given: &str) -> Self {
        let distance = |&(word, _): &(&'static str, _)| strsim::levenshtein(word, given);
        // `min_by_key` keeps the first of equals.
        let nearest = WORDS.iter().min_by_key(|entry| distance(entry));
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
            ("bank-1", 1 << 16, "bank-1"),
            ("bank-10000", 10_000 << 16, "bank-10000"),
        ] {
            let set: Demonstrations = text.parse().unwrap();
            assert_eq!((set.bits(), set.to_string().as_str()), (bits, shown));
            assert_eq!(set.to_string().parse(), Ok(set));
        }
        let sets: Vec<Demonstrations> =
            (0..2 << 16).filter_map(Demonstrations::from_bits).collect();
        assert_eq!(sets.len(), 16 + 2 + 4 + 1);
        for set in sets {
            assert_eq!(set.to_string().parse(), Ok(set));
            assert_eq!(Demonstrations::from_bits(set.bits()), Some(set));
        }
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

    #[test]
    fn a_mixed_set_keeps_original_and_opposite() {
        let set = CaseSet::shipped();
        let own = |start| History { case: 7, start };
        let histories = |demonstrations| set.histories(7, demonstrations);
        assert_eq!(histories(Demonstrations::NONE), []);
        assert_eq!(histories(Demonstrations::ALL), Start::DEMONSTRATIONS.map(own));
        let [first, second] = set.cases[7].irrelevant;
        assert_eq!(
            histories(Demonstrations::IRRELEVANT),
            [own(Start::Original), own(Start::Opposite), first, second]
        );
        let [first, second] = set.cases[7].confusable;
        assert_eq!(
            histories(Demonstrations::CONFUSABLE),
            [own(Start::Original), own(Start::Opposite), first, second]
        );
        assert_eq!(set.histories(set.cases.len(), Demonstrations::ALL), []);
        let after = own(Start::After);
        assert_eq!(histories(Demonstrations::AFTER), [after]);
        assert_eq!(histories(Demonstrations::ELSEWHERE), [own(Start::Elsewhere)]);
        assert_eq!(histories(Demonstrations::BEFORE_AFTER), [own(Start::Original), after]);
        assert_eq!(histories(Demonstrations::AFTER_BEFORE), [after, own(Start::Original)]);
    }

    #[test]
    fn a_bank_begins_with_the_smaller_ones_and_holds_the_same_others_for_all_cases() {
        let set = CaseSet::shipped();
        let bank = |case, size| set.histories(case, Demonstrations::bank(size));
        let all: HashSet<History> = bank(0, 400).into_iter().collect();
        assert_eq!(all.len(), 400);
        let mut small = HashSet::new();
        for case in 0..set.cases.len() {
            assert_eq!(bank(case, 400), bank(0, 400));
            let mut smaller = HashSet::new();
            for size in [1, 4, 16, 64, 256, 400] {
                let of: HashSet<History> = bank(case, size).into_iter().collect();
                assert_eq!(of.len(), usize::from(size));
                assert!(of.contains(&History { case, start: Start::Original }));
                assert!(smaller.is_subset(&of) && of.is_subset(&all));
                assert_eq!(bank(case, size)[..usize::from(size) - 1], set.common_bank(size - 1));
                smaller = of;
            }
            small.extend(bank(case, 16));
        }
        assert_eq!(bank(0, 401), []);
        assert_eq!(small, set.histories_of_all(Demonstrations::bank(16)).into_iter().collect());
        // Every case's own, and the first fifteen or sixteen of the order.
        assert!((100..=116).contains(&small.len()), "{}", small.len());
    }
}
