//! Since when an episode failed: its last progress, the loop that it stayed in, and where it first acts unlike a success of the
//! same case (specification, section 7).

use std::cmp::Reverse;
use std::collections::BTreeMap;

use case_book::{LoopFact, WorldFacts};
use conditions::{Condition, Route, Start};
use domain::{Arm, MemoryKind, Mismatch};
use run_log::{Ending, EpisodeRecord, RunLog};
use serde::Serialize;

use super::failure::failure_of;

/// The points of a failed episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FailurePoints {
    /// The step at which the last sub-goal was completed; 0 if none was.
    pub last_progress: u32,
    /// The loops after that, in order. `None`: the record tells none, because an earlier version wrote it, or its world does not know
    /// them.
    pub loops: Option<Vec<LoopFact>>,
    /// Where it first acts unlike a success; `None` if no episode of the same test succeeded.
    pub divergence: Option<Divergence>,
}

/// Where an episode first acts unlike one that succeeded.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Divergence {
    /// The number of steps that both take alike: their next actions differ.
    pub step: u32,
    /// The key of the success.
    pub success: String,
}

impl FailurePoints {
    /// The points of `record`, which is compared with `successes`; `None` for a success.
    pub fn of(record: &EpisodeRecord, successes: &Successes) -> Option<Self> {
        if record.is_success() {
            return None;
        }
        let last_progress = record.sub_goals.last().copied().unwrap_or(0);
        let after = |found: &LoopFact| found.from > last_progress;
        let loops = record.shared_facts().loops;
        Some(Self {
            last_progress,
            loops: loops.map(|loops| loops.into_iter().filter(after).collect()),
            divergence: successes.divergence(record),
        })
    }

    /// The step of the first repetition of the first loop after the last progress; `None` if there is no such loop, or none is told.
    pub fn first_repetition(&self) -> Option<u32> {
        Some(self.loops.as_ref()?.first()?.from)
    }
}

/// The number of steps at their begin that `actions` and `others`, a letter for each, have in common.
pub fn steps_alike(actions: &str, others: &str) -> u32 {
    actions.chars().zip(others.chars()).take_while(|(one, other)| one == other).count() as u32
}

/// The successes of a run, by what they were tested on.
#[derive(Debug, Default)]
pub struct Successes {
    by_test: BTreeMap<Test, Vec<Success>>,
}

/// What is the same for episodes that can be compared action by action: the id of the case, start and route, in a stream the state
/// of the world, and a mismatch that changes the world.
type Test = (String, Start, Route, Option<u32>, Option<Mismatch>);

#[derive(Debug)]
struct Success {
    key: String,
    condition: Condition,
    actions: String,
    /// The hash of the state in which it began, if the record has it.
    begin: Option<String>,
}

fn test_of(record: &EpisodeRecord) -> Test {
    let world = record.stream.as_ref().map(|stream| stream.world);
    let mismatch = Some(record.mismatch).filter(|mismatch| mismatch.changes_world());
    (record.case.clone(), record.start, record.route, world, mismatch)
}

fn begin_of(record: &EpisodeRecord) -> Option<&String> {
    record.state_hashes.as_ref().map(|[begin, _]| begin)
}

impl<'a> FromIterator<&'a EpisodeRecord> for Successes {
    fn from_iter<I: IntoIterator<Item = &'a EpisodeRecord>>(records: I) -> Self {
        let mut successes = Self::default();
        successes.extend(records);
        successes
    }
}

impl<'a> Extend<&'a EpisodeRecord> for Successes {
    fn extend<I: IntoIterator<Item = &'a EpisodeRecord>>(&mut self, records: I) {
        for record in records.into_iter().filter(|record| record.is_success()) {
            self.by_test.entry(test_of(record)).or_default().push(Success {
                key: record.key.clone(),
                condition: record.condition(),
                actions: record.actions.clone(),
                begin: begin_of(record).cloned(),
            });
        }
    }
}

impl Successes {
    /// Where `record` first acts unlike the success of its test with which it has most steps in common. Of equals, one under the same
    /// condition comes first, then one of the same memory, the shorter, and the first by its key. `None` if there is no success that
    /// began in the same state.
    fn divergence(&self, record: &EpisodeRecord) -> Option<Divergence> {
        let condition = record.condition();
        let began_alike = |success: &&Success| match (begin_of(record), &success.begin) {
            (Some(one), Some(other)) => one == other,
            _ => true,
        };
        let candidates = self.by_test.get(&test_of(record))?.iter().filter(began_alike);
        let nearest = candidates.max_by_key(|success| {
            let alike = steps_alike(&record.actions, &success.actions);
            let same_condition = success.condition == condition;
            let same_memory = success.condition.memory == condition.memory;
            let length = Reverse(success.actions.len());
            (alike, same_condition, same_memory, length, Reverse(&success.key))
        })?;
        Some(Divergence {
            step: steps_alike(&record.actions, &nearest.actions),
            success: nearest.key.clone(),
        })
    }
}

/// The points of the failed episodes of a memory.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PointScore {
    /// The memory; `None` for all together.
    pub memory: Option<MemoryKind>,
    /// Failed episodes.
    pub failed: usize,
    /// The median step of the last progress.
    pub last_progress: f64,
    /// Failed episodes whose steps ran out and whose kind names no event after the last progress: nothing decided them before.
    pub undecided: usize,
    /// Their loops; `None` if no record tells any.
    pub loops: Option<LoopScore>,
    /// How they compare with successes; `None` if none can be compared.
    pub divergence: Option<DivergenceScore>,
}

/// The loops of failed episodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LoopScore {
    /// Failed episodes whose record tells their loops.
    pub recorded: usize,
    /// Those of them with a loop after the last progress.
    pub looped: usize,
    /// The median step of its first repetition; `None` if none has a loop.
    pub first_repetition: Option<f64>,
    /// Those with a loop among [`PointScore::undecided`].
    pub undecided: usize,
}

/// Where failed episodes first act unlike a success.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct DivergenceScore {
    /// Failed episodes with a success of the same test.
    pub compared: usize,
    /// The median step.
    pub step: f64,
    /// Those that completed no sub-goal after it.
    pub without_progress: usize,
}

/// The points of the failed episodes of `log` outside of streams: for each memory of which an episode failed, then for all. Empty if
/// none failed.
pub fn point_scores(log: &RunLog) -> Vec<PointScore> {
    let successes: Successes = log.episodes.iter().collect();
    let mut by_memory: BTreeMap<MemoryKind, Vec<FailedEpisode>> = BTreeMap::new();
    // What control arms remember is no memory that is tested.
    let is_tested = |record: &&EpisodeRecord| record.stream.is_none() && record.arm == Arm::Frozen;
    for record in log.episodes.iter().filter(is_tested) {
        if let Some(points) = FailurePoints::of(record, &successes) {
            let is_undecided = is_undecided(record, &log.world, points.last_progress);
            let failed = FailedEpisode { points, is_undecided };
            by_memory.entry(record.memory).or_default().push(failed);
        }
    }
    let mut scores: Vec<PointScore> = by_memory
        .iter()
        .filter_map(|(memory, failed)| PointScore::of(Some(*memory), failed))
        .collect();
    let all: Vec<FailedEpisode> = by_memory.into_values().flatten().collect();
    scores.extend(PointScore::of(None, &all));
    scores
}

struct FailedEpisode {
    points: FailurePoints,
    is_undecided: bool,
}

fn is_undecided(record: &EpisodeRecord, world: &WorldFacts, last_progress: u32) -> bool {
    record.ending == Ending::OutOfSteps
        && failure_of(record, world)
            .is_some_and(|failure| [last_progress, record.steps].contains(&failure.step))
}

impl PointScore {
    fn of(memory: Option<MemoryKind>, failed: &[FailedEpisode]) -> Option<Self> {
        let points = || failed.iter().map(|failed| &failed.points);
        let has_loop = |failed: &&FailedEpisode| failed.points.first_repetition().is_some();
        let undecided = || failed.iter().filter(|failed| failed.is_undecided);
        let recorded = points().filter(|points| points.loops.is_some()).count();
        let loops = (recorded > 0).then(|| LoopScore {
            recorded,
            looped: failed.iter().filter(has_loop).count(),
            first_repetition: median(points().filter_map(FailurePoints::first_repetition)),
            undecided: undecided().filter(has_loop).count(),
        });
        let compared =
            || points().filter_map(|points| Some((points.divergence.as_ref()?.step, points)));
        let divergence = median(compared().map(|(step, _)| step)).map(|step| DivergenceScore {
            compared: compared().count(),
            step,
            without_progress: compared()
                .filter(|(step, points)| points.last_progress <= *step)
                .count(),
        });
        Some(Self {
            memory,
            failed: failed.len(),
            last_progress: median(points().map(|points| points.last_progress))?,
            undecided: undecided().count(),
            loops,
            divergence,
        })
    }
}

/// The median: of an even number of steps the mean of the two in the middle. `None` of none.
fn median(steps: impl Iterator<Item = u32>) -> Option<f64> {
    let mut steps: Vec<u32> = steps.collect();
    steps.sort_unstable();
    let upper = *steps.get(steps.len() / 2)?;
    let lower = steps[(steps.len() - 1) / 2];
    Some(f64::midpoint(f64::from(lower), f64::from(upper)))
}

#[cfg(test)]
mod tests {
    use domain::Representation;
    use rigs::records::{keyed, log, record, stream_record, tell, tell_failure};
    use serde_json::json;

    use super::*;

    /// An episode of case `a` with these actions, of which the last completes the task if it is a success.
    fn episode(actions: &str, success: bool) -> EpisodeRecord {
        let mut episode = record("a", success);
        (episode.actions, episode.steps) = (actions.to_owned(), actions.len() as u32);
        episode.sub_goals = if success { vec![episode.steps] } else { Vec::new() };
        episode
    }

    fn of_memory(memory: Representation, run: u32, record: EpisodeRecord) -> EpisodeRecord {
        keyed(EpisodeRecord { memory: memory.into(), run, ..record })
    }

    /// Where `record` parts from which of `others`.
    fn divergence(record: &EpisodeRecord, others: &[EpisodeRecord]) -> Option<(u32, String)> {
        let points = FailurePoints::of(record, &others.iter().collect()).unwrap();
        points.divergence.map(|found| (found.step, found.success))
    }

    #[test]
    fn an_episode_is_compared_with_the_success_that_it_follows_longest() {
        use Representation::{Episodic, FullContext, Summary};
        let failed = episode("ffLfR?ffff", false);
        let short = of_memory(Episodic, 2, episode("fff", true));
        let long = of_memory(Summary, 1, episode("ffLfRf", true));
        let nothing = of_memory(FullContext, 1, episode("ffLfR?f", false));
        let both = [short.clone(), long.clone(), nothing];
        assert_eq!(divergence(&failed, &both), Some((5, long.key.clone())));
        assert_eq!(divergence(&failed, &both[..1]), Some((2, short.key.clone())));
        assert_eq!(divergence(&failed, &both[2..]), None, "no success");
        // Of equals: another repetition of the condition, then another condition of the memory, then the shorter.
        let again = of_memory(Episodic, 2, episode("ffLfRff", true));
        let elsewhere = keyed(EpisodeRecord { window: 20, ..again.clone() });
        let longer = of_memory(FullContext, 1, episode("ffLfRff", true));
        let mut equals = [longer, long, elsewhere, again].to_vec();
        while let Some(expected) = equals.last().map(|best| best.key.clone()) {
            let mut others = equals.clone();
            others.reverse();
            assert_eq!(divergence(&failed, &equals), Some((5, expected.clone())));
            assert_eq!(divergence(&failed, &others), Some((5, expected)));
            equals.pop();
        }
    }

    #[test]
    fn only_successes_of_the_same_test_are_compared() {
        let failed = episode("ffff", false);
        let success = episode("ff", true);
        let hashed = |record: &EpisodeRecord, begin: &str| EpisodeRecord {
            state_hashes: Some([begin.to_owned(), "0".to_owned()]),
            ..record.clone()
        };
        for other in [
            EpisodeRecord { case: "b".to_owned(), ..success.clone() },
            EpisodeRecord { start: Start::New, ..success.clone() },
            EpisodeRecord { route: Route::Blocked, ..success.clone() },
            EpisodeRecord { stream: stream_record("a", true).stream, ..success.clone() },
        ] {
            assert_eq!(divergence(&failed, &[keyed(other)]), None);
        }
        let one = hashed(&failed, "1");
        assert_eq!(divergence(&one, &[hashed(&success, "2")]), None);
        for other in [success.clone(), hashed(&success, "1")] {
            assert_eq!(divergence(&one, &[other]), Some((2, success.key.clone())));
        }
        assert_eq!(FailurePoints::of(&success, &Successes::default()), None);
    }

    #[test]
    fn loops_before_the_last_progress_are_left_behind() {
        let mut failed = episode(&"f".repeat(200), false);
        let points = |record: &EpisodeRecord| {
            let points = FailurePoints::of(record, &Successes::default()).unwrap();
            (points.last_progress, points.loops.is_some(), points.first_repetition())
        };
        assert_eq!(points(&failed), (0, false, None), "not recorded");
        tell(&mut failed, "loops", json!([]));
        assert_eq!(points(&failed), (0, true, None));
        let told = json!([{"from": 5, "to": 40}, {"from": 60, "to": 90}, {"from": 91, "to": 200}]);
        tell(&mut failed, "loops", told);
        assert_eq!(points(&failed), (0, true, Some(5)));
        failed.sub_goals = vec![41, 45];
        assert_eq!(points(&failed), (45, true, Some(60)));
    }

    #[test]
    fn points_are_counted_by_memory() {
        use Representation::{Episodic, Summary};
        let failed = |case: &str, actions: &str, (kind, step): (&str, u32)| {
            let mut record = record(case, false);
            record.actions = format!("{actions}{}", "b".repeat(200 - actions.len()));
            tell_failure(&mut record, kind, step);
            tell(&mut record, "loops", json!([]));
            record
        };
        let success = |case: &str| record(case, true);
        // Three failures under episodic memory: decided by no event, in a loop; by none, without; by an event, in a loop.
        let mut first = failed("a", "fff", ("no-return", 40));
        (first.sub_goals, first.required) = (vec![40], 2);
        tell(&mut first, "loops", json!([{"from": 50, "to": 200}]));
        let second = failed("b", "ff", ("never-saw", 200));
        let mut third = failed("c", "", ("saw-and-left", 7));
        tell(&mut third, "loops", json!([{"from": 22, "to": 80}, {"from": 100, "to": 150}]));
        // One under summary memory, of an earlier version, without a success to compare with.
        let old = of_memory(Summary, 1, record("d", false));
        let episodes = vec![
            first,
            second,
            third,
            old,
            of_memory(Summary, 1, success("a")),
            of_memory(Summary, 1, success("b")),
        ];
        let found = point_scores(&log(episodes));
        let loops =
            LoopScore { recorded: 3, looped: 2, first_repetition: Some(36.0), undecided: 1 };
        let divergence = DivergenceScore { compared: 2, step: 2.5, without_progress: 1 };
        let of =
            |memory: Option<MemoryKind>, failed, last_progress, undecided, loops, divergence| {
                PointScore { memory, failed, last_progress, undecided, loops, divergence }
            };
        let (episodic, summary) = (Episodic.into(), Summary.into());
        assert_eq!(
            found,
            [
                of(Some(summary), 1, 0.0, 1, None, None),
                of(Some(episodic), 3, 0.0, 2, Some(loops), Some(divergence)),
                // Last progress 0, 0, 0, 40; all as the records tell them.
                of(None, 4, 0.0, 3, Some(loops), Some(divergence)),
            ]
        );
        assert_eq!(point_scores(&log(vec![success("a"), stream_record("a", false)])), []);
        assert_eq!(median([3, 1, 2].into_iter()), Some(2.0));
        assert_eq!(median([3, 1].into_iter()), Some(2.0));
        assert_eq!(median([].into_iter()), None);
    }
}
