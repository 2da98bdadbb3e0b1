//! Results beside earlier ones: by ratio, and a change is called one only where it shows above the noise.

use crate::figure::{Better, Summary};
use crate::results::Results;

/// Rounds that both sides need before their ranges mean something.
const ENOUGH_ROUNDS: usize = 3;

/// A figure, then and now.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// The figure's id.
    pub id: String,
    /// What it is.
    pub what: String,
    /// In what.
    pub unit: String,
    /// What it was.
    pub before: Summary,
    /// What it is.
    pub now: Summary,
    /// Now divided by before, of the medians.
    pub ratio: f64,
    /// The same of the peer: what the machine did meanwhile.
    pub peer_ratio: Option<f64>,
    /// What can be said.
    pub verdict: Verdict,
}

/// What a comparison comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Every round is better than every round before.
    Better,
    /// Every round is worse than every round before.
    Worse,
    /// The ranges overlap.
    NotToldApart,
    /// Too few rounds to say.
    TooFewRounds,
}

impl Verdict {
    /// In words.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Better => "better",
            Self::Worse => "WORSE",
            Self::NotToldApart => "not told apart",
            Self::TooFewRounds => "too few rounds to say",
        }
    }
}

/// Every figure that both have, in the order of `now`.
pub fn compare(before: &Results, now: &Results) -> Vec<Change> {
    let change = |new: &crate::results::Measured| {
        let old = before.figures().find(|old| {
            // Measured otherwise, it is another figure.
            old.figure.id == new.figure.id
                && old.figure.unit == new.figure.unit
                && old.figure.parameters == new.figure.parameters
        })?;
        let (was, is) = (old.summary?, new.summary?);
        let peers = old.peer_summary.zip(new.peer_summary);
        let rounds = old.figure.ours.len().min(new.figure.ours.len());
        Some(Change {
            id: new.figure.id.clone(),
            what: new.figure.what.clone(),
            unit: new.figure.unit.clone(),
            before: was,
            now: is,
            ratio: is.median / was.median,
            peer_ratio: peers.map(|(was, is)| is.median / was.median),
            verdict: verdict(was, is, new.figure.better, rounds),
        })
    };
    now.figures().filter_map(change).collect()
}

fn verdict(before: Summary, now: Summary, better: Better, rounds: usize) -> Verdict {
    if rounds < ENOUGH_ROUNDS {
        return Verdict::TooFewRounds;
    }
    let (higher, lower) = (now.min > before.max, now.max < before.min);
    match better {
        _ if !higher && !lower => Verdict::NotToldApart,
        Better::Higher if higher => Verdict::Better,
        Better::Lower if lower => Verdict::Better,
        Better::Higher | Better::Lower => Verdict::Worse,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::Figure;
    use crate::results::Outcome;

    fn results(better: Better, ours: &[f64], bytes: u32) -> Results {
        let figure = Figure::new("f", "f", "us", better)
            .ours(ours)
            .peer("peer", "1", [2.0, 2.0, 2.0])
            .parameter("bytes", bytes);
        let mut results = Results::here();
        results.add(Outcome {
            name: "b".to_owned(),
            about: String::new(),
            began: String::new(),
            commit: None,
            seconds: 0.0,
            error: None,
            figures: vec![figure.into()],
        });
        results
    }

    #[test]
    fn a_change_shows_only_where_no_round_of_one_is_among_those_of_the_other() {
        let verdict = |better, before: &[f64], now: &[f64]| {
            let changes = compare(&results(better, before, 1), &results(better, now, 1));
            changes.first().map(|change| change.verdict)
        };
        let (low, mixed, high) = ([1.0, 1.1, 1.2], [1.1, 1.5, 1.9], [2.0, 2.1, 2.2]);
        assert_eq!(verdict(Better::Higher, &low, &high), Some(Verdict::Better));
        assert_eq!(verdict(Better::Lower, &low, &high), Some(Verdict::Worse));
        assert_eq!(verdict(Better::Lower, &high, &low), Some(Verdict::Better));
        assert_eq!(verdict(Better::Lower, &low, &mixed), Some(Verdict::NotToldApart));
        assert_eq!(verdict(Better::Lower, &low[..2], &high), Some(Verdict::TooFewRounds));
    }

    #[test]
    fn what_was_measured_otherwise_is_not_compared() {
        let of = |bytes| results(Better::Lower, &[1.0, 1.0, 1.0], bytes);
        assert_eq!(compare(&of(1), &of(2)), []);
        let same = compare(&of(1), &of(1));
        assert_eq!((same[0].ratio, same[0].peer_ratio), (1.0, Some(1.0)));
    }
}
