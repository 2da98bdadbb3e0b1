//! Whether a record agrees with itself.
//!
//! A record states most facts more than once (the number of steps and the actions, the ending and the sub-goals), so a damaged or
//! edited record contradicts itself. What only the world understands is checked by acting out the episode
//! (`memtransfer validate RUN`).

use std::collections::BTreeSet;

use case_book::SharedFacts;
use domain::{Arm, ExternalName};

use super::known::KnownFacts;
use super::{BlockedRecord, Ending, EpisodeRecord, Manifest, StreamRecord};
use conditions::{Condition, Route};

/// More blocks than any stream has.
const MOST_BLOCKS: u32 = 1 << 16;

/// Checks that records agree with themselves and with their run, and that none occurs twice.
pub(super) fn check_records(
    known: KnownFacts,
    manifest: &Manifest,
) -> impl FnMut(&EpisodeRecord) -> Result<(), String> + use<> {
    let check = check_each_record(known, manifest);
    let mut seen = BTreeSet::new();
    move |record: &EpisodeRecord| {
        check(record)?;
        // Half of the hash of each key, because millions are kept.
        let is_new = seen
            .insert(blake3::hash(record.key.as_bytes()).as_bytes().first_chunk::<16>().copied());
        if is_new { Ok(()) } else { Err(occurs_twice(&record.key)) }
    }
}

/// What is wrong with a second record of the episode `key`.
pub(super) fn occurs_twice(key: &str) -> String {
    format!("{key} occurs twice")
}

/// Checks that a record agrees with itself and with its run: its memories, its seed and, where they are known, its cases.
pub(super) fn check_each_record(
    known: KnownFacts,
    manifest: &Manifest,
) -> impl Fn(&EpisodeRecord) -> Result<(), String> + use<> {
    let max_steps = manifest.settings.max_steps;
    let memories: BTreeSet<ExternalName> = manifest.memories.keys().copied().collect();
    move |record: &EpisodeRecord| {
        record.check(max_steps)?;
        known.check(record)?;
        if let Some(name) = record.memory.external()
            && !memories.contains(&name)
        {
            return Err(format!("the run has no memory called {name}"));
        }
        Ok(())
    }
}

impl EpisodeRecord {
    /// Checks the record against itself and against the step limit of its run.
    ///
    /// # Errors
    /// Names the first contradiction.
    pub fn check(&self, max_steps: u32) -> Result<(), String> {
        self.check_key()?;
        self.check_steps(max_steps)?;
        self.check_events()?;
        self.check_blocked()?;
        self.check_stream()
    }

    /// Checks those of the world's facts that are not for the world alone.
    ///
    /// # Errors
    /// Names what is wrong.
    pub fn check_world(&self) -> Result<(), String> {
        let facts = SharedFacts::of(&self.world).map_err(|error| format!("\"world\": {error}"))?;
        let told = [facts.failure.map(|failure| failure.step), facts.looped_at];
        let loops = facts.loops.unwrap_or_default();
        ensure(loops.iter().all(|one| one.from <= one.to), || {
            "\"world\" has a loop that ends before it begins".to_owned()
        })?;
        let mut told = told.into_iter().flatten().chain(loops.iter().map(|one| one.to));
        ensure(told.all(|at| at <= self.steps), || "\"world\" has a step after the end".to_owned())
    }

    fn check_key(&self) -> Result<(), String> {
        ensure(self.run > 0, || "\"run\" is counted from 1".to_owned())?;
        let own = self.condition();
        let Condition { memory, start, route, demonstrations, variation, mismatch, arm } = own;
        let condition = Condition::new(memory, start, route, demonstrations, variation);
        let condition = condition.map(|condition| condition.with_mismatch(mismatch).with_arm(arm));
        let condition = condition.filter(|condition| *condition == own);
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
        let is_complete = self.sub_goals.len() == self.required as usize;
        ensure(is_complete == (self.ending == Ending::Complete), || {
            let (met, required) = (self.sub_goals.len(), self.required);
            format!("\"ending\" is {}, with {met} of {required} sub-goals", self.ending)
        })?;
        let is_over = match self.ending {
            Ending::Complete | Ending::Failed => self.steps <= max_steps,
            Ending::OutOfSteps => self.steps == max_steps,
        };
        ensure(is_over, || {
            format!("it ends {} after {} of {max_steps} steps", self.ending, self.steps)
        })
    }

    fn check_events(&self) -> Result<(), String> {
        let steps = self.steps;
        ensure(self.sub_goals.is_sorted() && self.sub_goals.iter().all(|at| *at <= steps), || {
            "\"sub_goals\" are out of order or after the end".to_owned()
        })?;
        ensure(self.conflict_at.is_none() || self.route == Route::Blocked, || {
            "\"conflict_at\" is of blocked routes, and its route is unchanged".to_owned()
        })?;
        ensure(self.conflict_at.is_none_or(|at| (1..=steps).contains(&at)), || {
            format!("\"conflict_at\" is {:?}, of {steps} steps", self.conflict_at)
        })?;
        self.check_world()?;
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
            return ensure(self.arm != Arm::Learning, || {
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
    use domain::StreamOrder;
    use serde_json::json;

    use super::*;
    use crate::records::{keyed, record, stream_record, tell};

    #[test]
    fn a_valid_record_passes_and_every_edit_is_noticed() {
        for success in [true, false] {
            assert_eq!(record("t01-01", success).check(200), Ok(()));
        }
        let edits: [fn(&mut EpisodeRecord); 13] = [
            |record| record.steps = 931,
            |record| record.case = "t01-02".to_owned(),
            |record| record.run = 2,
            |record| *record = keyed(EpisodeRecord { run: 0, ..record.clone() }),
            |record| record.ending = Ending::OutOfSteps,
            |record| record.actions = "fffffffff?".to_owned(),
            |record| record.conflict_at = Some(3),
            |record| drop(record.world.insert("looped_at".to_owned(), 11.into())),
            |record| tell(record, "loops", json!([{"from": 3, "to": 11}])),
            |record| tell(record, "loops", json!([{"from": 6, "to": 5}])),
            |record| drop(record.world.insert("failure".to_owned(), "fell".into())),
            |record| record.requests = Some(9),
            |record| {
                record.retrieved = Some("o1+o2 -".to_owned());
                record.distances = Some("0.5 -".to_owned());
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
