//! Whether a record agrees with itself.
//!
//! A record states most facts more than once (the number of steps and the actions, the final pose and the path to it),
//! so a damaged or edited record contradicts itself.

use std::collections::BTreeSet;
use std::path::Path;

use domain::{Action, Arm, ExternalName};

use super::known::KnownFacts;
use super::{BlockedRecord, Ending, EpisodeRecord, LogError, Manifest, StreamRecord};
use conditions::{Condition, Route};

/// More blocks than any stream has.
const MOST_BLOCKS: u32 = 1 << 16;

/// Checks that records agree with themselves and with their run: its memories, its seed and, where they are known, its
/// cases; and that none occurs twice.
///
/// # Errors
/// When the case book in the run's folder `dir` cannot be used.
pub(super) fn check_records(
    dir: &Path,
    manifest: &Manifest,
) -> Result<impl FnMut(&EpisodeRecord) -> Result<(), String> + use<>, LogError> {
    let max_steps = manifest.settings.max_steps;
    let memories: BTreeSet<ExternalName> = manifest.memories.keys().copied().collect();
    let mut seen = BTreeSet::new();
    let known = KnownFacts::of(dir, manifest)?;
    Ok(move |record: &EpisodeRecord| {
        record.check(max_steps)?;
        known.check(record)?;
        if let Some(name) = record.memory.external()
            && !memories.contains(&name)
        {
            return Err(format!("the run has no memory called {name}"));
        }
        let is_new = seen.insert(record.key.clone());
        if is_new { Ok(()) } else { Err(format!("{} occurs twice", record.key)) }
    })
}

impl EpisodeRecord {
    /// Checks the record against itself and against the step limit of its run.
    ///
    /// # Errors
    /// Names the first contradiction.
    pub fn check(&self, max_steps: u32) -> Result<(), String> {
        self.check_key()?;
        self.check_steps(max_steps)?;
        self.check_path()?;
        self.check_events()?;
        self.check_blocked()?;
        self.check_stream()
    }

    fn check_key(&self) -> Result<(), String> {
        ensure(self.task_type().is_some(), || {
            format!("\"task\" is {}, and there are the types 1 to 10", self.task)
        })?;
        ensure(self.run > 0, || "\"run\" is counted from 1".to_owned())?;
        let Condition { memory, start, route, demonstrations, variation, arm } = self.condition();
        let condition = Condition::new(memory, start, route, demonstrations, variation);
        let condition = condition.map(|condition| condition.with_arm(arm));
        let condition = condition.filter(|condition| *condition == self.condition());
        let key = condition.map(|_| self.own_key().to_string());
        ensure(key.as_ref() == Some(&self.key), || {
            format!("its fields make the key {}", key.as_deref().unwrap_or("of no condition"))
        })
    }

    fn check_steps(&self, max_steps: u32) -> Result<(), String> {
        let actions = self.actions.chars().count();
        ensure(actions == self.steps as usize, || {
            format!("\"steps\" is {}, and \"actions\" has {actions}", self.steps)
        })?;
        let unread = self.actions.chars().filter(|letter| *letter == '?').count();
        ensure(unread == self.unread.total() as usize, || {
            format!("\"unread\" counts {}, and \"actions\" has {unread} `?`", self.unread.total())
        })?;
        let bad = self.actions.chars().find(|&c| c != '?' && Action::from_letter(c).is_none());
        ensure(bad.is_none(), || format!("\"actions\" has the letter {:?}", bad.unwrap_or(' ')))?;
        let is_complete = self.sub_goals.len() == self.required as usize;
        ensure(is_complete == (self.ending == Ending::Complete), || {
            let (met, required) = (self.sub_goals.len(), self.required);
            format!("\"ending\" is {}, with {met} of {required} sub-goals", self.ending)
        })?;
        let is_over = if is_complete { self.steps <= max_steps } else { self.steps == max_steps };
        ensure(is_over, || {
            format!("it ends {} after {} of {max_steps} steps", self.ending, self.steps)
        })
    }

    fn check_path(&self) -> Result<(), String> {
        let actions = self.actions.chars().map(Action::from_letter);
        let moves: Vec<bool> =
            actions.map(|action| action.is_some_and(|a| a.move_direction().is_some())).collect();
        let is_move =
            |step: u32| (step as usize).checked_sub(1).and_then(|at| moves.get(at)) == Some(&true);
        let blocked = &self.blocked_moves;
        let in_order = blocked.is_sorted_by(|a, b| a < b);
        ensure(in_order && blocked.iter().all(|&step| is_move(step)), || {
            "\"blocked_moves\" names a step that is not a move".to_owned()
        })?;
        let poses = self.poses();
        let end = poses.last().copied().unwrap_or(self.start_pose);
        ensure(end == self.final_pose, || {
            format!("its actions lead to {end}, and \"final_pose\" is {}", self.final_pose)
        })?;
        let misplaced = self
            .visits
            .iter()
            .find(|visit| poses.get(visit.step as usize).map(|pose| pose.cell) != Some(visit.cell));
        ensure(misplaced.is_none(), || {
            let visit = misplaced.map_or(String::new(), ToString::to_string);
            format!("the agent was elsewhere at the visit {visit}")
        })
    }

    fn check_events(&self) -> Result<(), String> {
        let steps = self.steps;
        ensure(self.sub_goals.is_sorted() && self.sub_goals.iter().all(|at| *at <= steps), || {
            "\"sub_goals\" are out of order or after the end".to_owned()
        })?;
        ensure(self.first_seen.values().all(|at| *at <= steps), || {
            "\"first_seen\" has a step after the end".to_owned()
        })?;
        ensure(self.tried_closed.is_some() == (self.route == Route::Blocked), || {
            "\"tried_closed\" is for blocked routes, and every one of them".to_owned()
        })?;
        let tried = self.tried_closed_at.is_none_or(|at| self.blocked_moves.contains(&at));
        let tried = tried && self.tried_closed_at.is_some() == (self.tried_closed == Some(true));
        ensure(tried, || "\"tried_closed_at\" is not one of \"blocked_moves\"".to_owned())?;
        let shape = |words: &str| words.split(' ').map(|word| word.split('+').count()).collect();
        let retrieved: Option<Vec<usize>> = self.retrieved.as_deref().map(shape);
        let distances: Option<Vec<usize>> = self.distances.as_deref().map(shape);
        ensure(distances.is_none() || distances == retrieved, || {
            "\"distances\" does not have one for each source of \"retrieved\"".to_owned()
        })?;
        ensure(self.requests.is_none_or(|requests| requests == steps), || {
            format!("{} requests, and {steps} steps", self.requests.unwrap_or(0))
        })
    }

    fn check_blocked(&self) -> Result<(), String> {
        let Some(BlockedRecord { retrievals, stale, .. }) = self.blocked else { return Ok(()) };
        ensure(self.route == Route::Blocked, || {
            "\"blocked\" is of blocked routes, and its route is unchanged".to_owned()
        })?;
        ensure(stale <= retrievals, || format!("{stale} of {retrievals} retrievals are stale"))
    }

    fn check_stream(&self) -> Result<(), String> {
        let Some(stream) = &self.stream else {
            return ensure(self.arm == Arm::Frozen, || {
                format!("the arm {} is of streams, and it has no \"stream\"", self.arm.word())
            });
        };
        let StreamRecord { block, place, after, round, invalidated, retrievals, stale, .. } =
            stream;
        ensure(*place < MOST_BLOCKS && *block < MOST_BLOCKS && *after <= MOST_BLOCKS, || {
            format!("it is in place {place} after {after} blocks, and no stream has {MOST_BLOCKS}")
        })?;
        ensure(*round != Some(0), || "\"round\" is counted from 1".to_owned())?;
        ensure(round.is_none() || after == place, || {
            format!("it learns in place {place} after {after} blocks")
        })?;
        ensure(!(*block == 0 && *invalidated), || {
            "no event precedes block 0, and \"invalidated\" is set".to_owned()
        })?;
        ensure(stale <= retrievals, || format!("{stale} of {retrievals} retrievals are stale"))?;
        let is_action = |letter| Action::from_letter(letter).is_some();
        ensure(stream.reference_actions.chars().all(is_action), || {
            "\"reference_actions\" has a letter that is no action".to_owned()
        })?;
        // Standpoints are reached by moves; a final turn towards the rack does not count.
        let is_move =
            |letter| Action::from_letter(letter).is_some_and(|it| it.move_direction().is_some());
        let moves = stream.reference_actions.rfind(is_move).map_or(0, |index| index + 1);
        ensure(stream.reference_actions.is_empty() || moves == self.reference as usize, || {
            format!(
                "\"reference\" is {}, and the last move of \"reference_actions\" is number {moves}",
                self.reference
            )
        })?;
        let learned = self.arm == Arm::Learning && stream.learns();
        ensure(stream.snapshot.is_some() == learned, || {
            "\"snapshot\" is for episodes that a memory learned from, and every one of them"
                .to_owned()
        })?;
        let is_hex = |id: &String| {
            id.len() == 32 && id.bytes().all(|c| matches!(c, b'0'..=b'9' | b'a'..=b'f'))
        };
        ensure(stream.snapshot.as_ref().is_none_or(is_hex), || {
            "\"snapshot\" is not 32 hexadecimal digits".to_owned()
        })
    }
}

fn ensure(holds: bool, problem: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(problem()) }
}

#[cfg(test)]
mod tests {
    use domain::{Heading, Pose, StreamOrder};

    use super::*;
    use crate::records::{keyed, record, stream_record};
    use domain::events::{Requirement, Visit};

    #[test]
    fn a_valid_record_passes_and_every_edit_is_noticed() {
        for success in [true, false] {
            assert_eq!(record("t01-01", success).check(200), Ok(()));
        }
        let edits: [fn(&mut EpisodeRecord); 16] = [
            |record| record.steps = 931,
            |record| record.case = "t01-02".to_owned(),
            |record| record.run = 2,
            |record| *record = keyed(EpisodeRecord { run: 0, ..record.clone() }),
            |record| record.task = 0,
            |record| record.task = 11,
            |record| record.ending = Ending::OutOfSteps,
            |record| record.actions = "fffffffff!".to_owned(),
            |record| record.actions = "fffffffff?".to_owned(),
            |record| record.actions = "ffffffffff".replace('f', "b"),
            |record| record.final_pose = Pose::new(1, 11, Heading::N),
            |record| record.blocked_moves = vec![3],
            |record| record.tried_closed = Some(false),
            |record| record.requests = Some(9),
            |record| {
                record.retrieved = Some("o1+o2 -".to_owned());
                record.distances = Some("0.5 -".to_owned());
            },
            |record| {
                let cell = record.start_pose.cell;
                record.visits = vec![Visit { step: 3, requirement: Requirement::A, cell }];
            },
        ];
        for (index, edit) in edits.iter().enumerate() {
            let mut record = record("t01-01", true);
            edit(&mut record);
            assert!(record.check(200).is_err(), "edit {index}");
        }
        let learned = |edit: fn(&mut EpisodeRecord, &mut StreamRecord)| {
            let mut record = stream_record("t01-01", true);
            let mut stream = record.stream.take().unwrap();
            edit(&mut record, &mut stream);
            EpisodeRecord { stream: Some(stream), ..record }.check(200)
        };
        assert_eq!(learned(|_, _| ()), Ok(()));
        let edits: [fn(&mut EpisodeRecord, &mut StreamRecord); 11] = [
            |record, _| record.arm = Arm::Frozen,
            |_, stream| stream.stream = 3,
            |_, stream| stream.order = StreamOrder::Drawn,
            |_, stream| stream.position = 18,
            |_, stream| stream.round = Some(0),
            |_, stream| stream.round = None,
            |_, stream| stream.after = 0,
            |_, stream| stream.block = 0,
            |_, stream| stream.stale = 3,
            |_, stream| stream.snapshot = None,
            |_, stream| stream.snapshot = Some("AB".repeat(16)),
        ];
        for (index, edit) in edits.into_iter().enumerate() {
            assert!(learned(edit).is_err(), "edit {index}");
        }
        let mut alone = stream_record("t01-01", true);
        alone.stream = None;
        alone.key = alone.key.replace("/s2-reversed-017", "");
        insta::assert_snapshot!(alone.check(200).unwrap_err(), @r#"the arm learning is of streams, and it has no "stream""#);
        assert!(record("t01-01", false).check(300).is_err(), "stopped before the limit");
        let mut edited = record("t01-01", true);
        edited.steps = 931;
        insta::assert_snapshot!(edited.check(1000).unwrap_err(), @r#""steps" is 931, and "actions" has 10"#);
    }
}
