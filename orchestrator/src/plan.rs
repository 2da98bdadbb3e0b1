//! Which episodes a run consists of: conditions x runs x cases, or the sequences of its streams, each episode with a stable
//! key and its own seed.
//!
//! Pure: the same settings and cases give the same list on every machine. Which of them are finished is in the
//! run folder ([`run_log`]).

use case_book::{CaseBook, CaseVariant, StreamFacts, StreamsFacts};
use conditions::key::{EpisodeKey, StreamPlace};
use conditions::settings::StreamSettings;
use conditions::{Condition, Route};
use domain::{ActionCode, Arm, Demonstrations, FeedbackLevel, State, StreamOrder};
use shm_types::message::SnapshotId;

/// One episode of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlannedEpisode {
    /// Names it in the log: unique in a run.
    pub key: EpisodeKey,
    /// Index of its case in the case file.
    pub case_index: usize,
    /// The seed for random choices of the policy.
    pub seed: u64,
    /// Its part in a stream.
    pub part: Option<StreamPart>,
}

/// The part of an episode in its sequence: one stream in one order under one condition and repetition. The episodes of a
/// sequence share one memory and run strictly one after the other, in the order of their positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamPart {
    /// Identifies the sequence; never 0.
    pub sequence: u64,
    /// The block that its case belongs to, as drawn.
    pub block: u32,
    /// The place of that block in the sequence's order.
    pub place: u32,
    /// Blocks that were learned from before.
    pub after: u32,
    /// The learning round, from 1; `None` for an evaluation.
    pub round: Option<u32>,
    /// The index of the block's world state.
    pub world: u32,
    /// What a memory that learns is told at the end.
    pub feedback: FeedbackLevel,
    /// The snapshot that its memory continues from; zeros if it is built anew.
    pub snapshot: SnapshotId,
}

impl PlannedEpisode {
    /// The sequence that it belongs to.
    pub fn sequence(&self) -> Option<u64> {
        self.part.map(|part| part.sequence)
    }

    /// What the expert does in it, as `book` has it.
    pub fn expert<'b>(&self, book: &'b CaseBook) -> Option<Expert<'b>> {
        if let Some(part) = self.part {
            let found = book.streams.as_ref()?.case(part.world, self.case_index as u32)?;
            return Some(Expert {
                begin: found.begin,
                actions: &found.actions,
                length: found.length,
            });
        }
        let Condition { start, route, .. } = self.key.condition;
        let found = book.cases.get(self.case_index)?.reference(start, route)?;
        Some(Expert { begin: found.begin, actions: &found.actions, length: found.length })
    }

    /// The demonstrations that its memory holds; in a stream, those that the arm's memory is built from.
    pub fn demonstrations(&self) -> Demonstrations {
        let condition = self.key.condition;
        let control = condition.control_set().filter(|_| self.part.is_none());
        control.unwrap_or(condition.demonstrations)
    }

    /// The number of the variant that it takes place in.
    pub fn variant(&self, book: &CaseBook) -> u32 {
        match self.part {
            Some(part) => book.streams.as_ref().and_then(|of| of.variant(part.world)).unwrap_or(0),
            None => {
                let Condition { route, mismatch, .. } = self.key.condition;
                let (case, is_blocked) = (self.case_index as u32, route == Route::Blocked);
                CaseVariant { case, is_blocked, mismatch }.number()
            }
        }
    }

    /// Whether its memory learns from it.
    pub fn learns(&self) -> bool {
        self.key.condition.arm == Arm::Learning
            && self.part.is_some_and(|part| part.round.is_some())
    }
}

/// The expert's trajectory of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Expert<'b> {
    /// The state in which it begins.
    pub begin: State,
    /// The actions. They may go on after the task is complete.
    pub actions: &'b [ActionCode],
    /// The steps in which they complete the task, l_i.
    pub length: u32,
}

/// The episodes of a run, in the order in which they are started.
///
/// Case by case, all runs and conditions of a case next to each other: so any beginning of the list is a fair comparison of
/// conditions, and the views of a case are used while they are resident and belong to few [units](crate::units).
///
/// Each condition comes with the number of its runs. `cases` are indices into `ids`, the ids of all cases.
pub fn plan<'a>(
    conditions: &'a [(Condition, u32)],
    cases: &'a [usize],
    ids: &'a [&'a str],
    master_seed: u64,
) -> impl Iterator<Item = PlannedEpisode> + 'a {
    let most_runs = conditions.iter().map(|(_, runs)| *runs).max().unwrap_or(0);
    let places = cases.iter().flat_map(move |&case| (1..=most_runs).map(move |run| (run, case)));
    places.flat_map(move |(run, case_index)| {
        let repeated = conditions.iter().filter(move |(_, runs)| run <= *runs);
        repeated.map(move |&(condition, _)| {
            let case = ids[case_index].to_owned();
            let key = EpisodeKey { condition, run, place: None, case };
            let seed = key.seed(master_seed);
            PlannedEpisode { key, case_index, seed, part: None }
        })
    })
}

/// The episodes of a run that consists of `streams`, sequence by sequence: for every run, stream and order the
/// conditions next to each other, so any beginning of the list compares them on the same streams.
///
/// A sequence evaluates the cases of every block, if evaluations are asked for; then, block by block in its order, it learns
/// from the block's cases in `rounds` rounds and evaluates every block again. Positions are the same in all arms, also in
/// those that do not learn.
pub fn plan_streams<'a>(
    conditions: &'a [(Condition, u32)],
    streams: &'a StreamsFacts,
    settings: &'a StreamSettings,
    ids: &'a [&'a str],
    master_seed: u64,
) -> impl Iterator<Item = PlannedEpisode> + 'a {
    let most_runs = conditions.iter().map(|(_, runs)| *runs).max().unwrap_or(0);
    let mut orders: Vec<StreamOrder> = Vec::new();
    for &order in &settings.orders {
        if !orders.contains(&order) {
            orders.push(order);
        }
    }
    let visits = (1..=most_runs).flat_map(move |run| {
        let orders = orders.clone();
        let of_run =
            move |stream| orders.clone().into_iter().map(move |order| (run, stream, order));
        (0..).zip(&streams.streams).flat_map(of_run)
    });
    visits.flat_map(move |(run, (stream, facts), order)| {
        let steps = steps(facts, settings, order);
        let repeated = conditions.iter().filter(move |(_, runs)| run <= *runs);
        repeated.flat_map(move |&(condition, _)| {
            let sequence = (0..).zip(&steps).map(|(position, &(case, part))| {
                let case_index = case as usize;
                let place = Some(StreamPlace { stream, order, position });
                let key = EpisodeKey { condition, run, place, case: ids[case_index].to_owned() };
                let sequence = key.sequence().map_or(0, |name| sequence_id(&name));
                let part = Some(StreamPart { sequence, ..part });
                let seed = key.seed(master_seed);
                PlannedEpisode { key, case_index, seed, part }
            });
            sequence.collect::<Vec<_>>()
        })
    })
}

/// The case and the part of every episode of a sequence; parts lack the id of the sequence.
fn steps(
    stream: &StreamFacts,
    settings: &StreamSettings,
    order: StreamOrder,
) -> Vec<(u32, StreamPart)> {
    let order = stream.order(order);
    let mut steps = Vec::new();
    let mut visit = |place: usize, after: usize, round: Option<u32>| {
        let block = order[place];
        let drawn = &stream.blocks[block as usize];
        let part = StreamPart {
            sequence: 0,
            block,
            place: place as u32,
            after: after as u32,
            round,
            world: drawn.world,
            feedback: settings.feedback,
            snapshot: SnapshotId::default(),
        };
        steps.extend(drawn.cases.iter().map(|&case| (case, part)));
    };
    for after in 0..=order.len() {
        if settings.evaluate {
            (0..order.len()).for_each(|place| visit(place, after, None));
        }
        if after < order.len() {
            (1..=settings.rounds).for_each(|round| visit(after, after, Some(round)));
        }
    }
    steps
}

/// The id of the sequence with this [name](EpisodeKey::sequence): the first 8 bytes, as a little-endian number, of the BLAKE3
/// hash of the name, and 1 instead of 0.
pub fn sequence_id(name: &str) -> u64 {
    let hash = blake3::hash(name.as_bytes());
    let first = hash.as_bytes().first_chunk::<8>();
    first.copied().map_or(0, u64::from_le_bytes).max(1)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use case_book::StreamBlock;

    use super::*;

    fn conditions() -> Vec<(Condition, u32)> {
        let written = [
            ("working/original/unchanged/none", 2),
            ("working/new/unchanged/none", 2),
            ("episodic/original/unchanged/original", 2),
            ("episodic/new/unchanged/original", 1),
        ];
        written.map(|(condition, runs)| (condition.parse().unwrap(), runs)).to_vec()
    }

    #[test]
    fn a_plan_goes_case_by_case_through_the_conditions() {
        let episodes: Vec<_> = plan(&conditions(), &[0, 2], &["a", "b", "c"], 1).collect();
        let keys: Vec<String> = episodes.iter().map(|e| e.key.to_string()).collect();
        insta::assert_snapshot!(keys[..5].join("\n"), @"
        working/original/unchanged/none/run1/a
        working/new/unchanged/none/run1/a
        episodic/original/unchanged/original/run1/a
        episodic/new/unchanged/original/run1/a
        working/original/unchanged/none/run2/a
        ");
        assert_eq!((keys.len(), keys.iter().filter(|key| key.contains("/run2/")).count()), (14, 6));
        let (mut unique, mut seeds) = (keys, episodes.iter().map(|e| e.seed).collect::<Vec<_>>());
        unique.sort();
        unique.dedup();
        seeds.sort();
        seeds.dedup();
        assert_eq!((unique.len(), seeds.len()), (14, 14));
    }

    #[test]
    fn seeds_follow_the_documented_formula() {
        let key = plan(&conditions(), &[0], &["t01-01"], 1).next().unwrap().key;
        let mut text = b"memtransfer episode seed v1\0".to_vec();
        text.extend(7_u64.to_le_bytes());
        text.extend(b"working/original/unchanged/none/run1/t01-01");
        let hash = blake3::hash(&text);
        assert_eq!(key.seed(7).to_le_bytes(), hash.as_bytes()[..8]);
        insta::assert_snapshot!(key.seed(7), @"7419264810186364379");
    }

    /// A stream of two blocks with one case each.
    fn streams() -> StreamsFacts {
        let block = |case| StreamBlock { world: case, cases: vec![case] };
        let stream = StreamFacts { blocks: vec![block(0), block(1)], shuffled: vec![1, 0] };
        let (variants, states) = (vec![2, 3], vec![BTreeMap::new(); 2]);
        StreamsFacts { hash: String::new(), streams: vec![stream], variants, states }
    }

    fn in_streams(
        conditions: &[&str],
        orders: &[StreamOrder],
        evaluate: bool,
    ) -> Vec<PlannedEpisode> {
        let settings = StreamSettings {
            streams: 1,
            blocks: 2,
            cases_per_block: 1,
            rounds: 2,
            events: Vec::new(),
            orders: orders.to_vec(),
            feedback: FeedbackLevel::Success,
            evaluate,
        };
        let conditions: Vec<(Condition, u32)> =
            conditions.iter().map(|written| (written.parse().unwrap(), 1)).collect();
        let episodes: Vec<_> =
            plan_streams(&conditions, &streams(), &settings, &["a", "b"], 1).collect();
        assert_eq!(episodes.len(), settings.all_episodes() * conditions.len());
        episodes
    }

    #[test]
    fn a_sequence_evaluates_and_learns_in_turn() {
        let episodes = in_streams(
            &["adaptive/new/unchanged/original/learning"],
            &[StreamOrder::Drawn, StreamOrder::Reversed, StreamOrder::Drawn],
            true,
        );
        let shown = episodes.iter().map(|episode| {
            let StreamPart { block, place, after, round, world, .. } = episode.part.unwrap();
            let key = episode.key.to_string().replace("adaptive/new/unchanged/original/", "");
            let round = round.map_or("evaluates".to_owned(), |round| format!("round {round}"));
            assert_eq!(episode.learns(), round != "evaluates");
            format!("{key} block {block} at {place} in world {world}, after {after}: {round}")
        });
        insta::assert_snapshot!(shown.collect::<Vec<_>>().join("\n"), @"
        learning/run1/s0-drawn-000/a block 0 at 0 in world 0, after 0: evaluates
        learning/run1/s0-drawn-001/b block 1 at 1 in world 1, after 0: evaluates
        learning/run1/s0-drawn-002/a block 0 at 0 in world 0, after 0: round 1
        learning/run1/s0-drawn-003/a block 0 at 0 in world 0, after 0: round 2
        learning/run1/s0-drawn-004/a block 0 at 0 in world 0, after 1: evaluates
        learning/run1/s0-drawn-005/b block 1 at 1 in world 1, after 1: evaluates
        learning/run1/s0-drawn-006/b block 1 at 1 in world 1, after 1: round 1
        learning/run1/s0-drawn-007/b block 1 at 1 in world 1, after 1: round 2
        learning/run1/s0-drawn-008/a block 0 at 0 in world 0, after 2: evaluates
        learning/run1/s0-drawn-009/b block 1 at 1 in world 1, after 2: evaluates
        learning/run1/s0-reversed-000/b block 1 at 0 in world 1, after 0: evaluates
        learning/run1/s0-reversed-001/a block 0 at 1 in world 0, after 0: evaluates
        learning/run1/s0-reversed-002/b block 1 at 0 in world 1, after 0: round 1
        learning/run1/s0-reversed-003/b block 1 at 0 in world 1, after 0: round 2
        learning/run1/s0-reversed-004/b block 1 at 0 in world 1, after 1: evaluates
        learning/run1/s0-reversed-005/a block 0 at 1 in world 0, after 1: evaluates
        learning/run1/s0-reversed-006/a block 0 at 1 in world 0, after 1: round 1
        learning/run1/s0-reversed-007/a block 0 at 1 in world 0, after 1: round 2
        learning/run1/s0-reversed-008/b block 1 at 0 in world 1, after 2: evaluates
        learning/run1/s0-reversed-009/a block 0 at 1 in world 0, after 2: evaluates
        ");
    }

    #[test]
    fn sequences_have_ids_of_their_own_and_equal_positions() {
        let conditions = ["working/new/unchanged/none", "episodic/new/unchanged/original/wrong"];
        let episodes = in_streams(&conditions, &[StreamOrder::Drawn], false);
        let (one, other) = episodes.split_at(4);
        assert_eq!(
            one[0].sequence(),
            Some(sequence_id("working/new/unchanged/none/run1/s0-drawn"))
        );
        assert!(one.iter().all(|episode| episode.sequence() == one[0].sequence()));
        assert_ne!(one[0].sequence(), other[0].sequence());
        let place = |episode: &PlannedEpisode| (episode.key.place, episode.case_index);
        assert!(one.iter().map(place).eq(other.iter().map(place)));
        assert!(!episodes.iter().any(PlannedEpisode::learns));
        let hash = blake3::hash(b"x");
        assert_eq!(sequence_id("x").to_le_bytes(), hash.as_bytes()[..8]);
    }
}
