//! A scripted external memory: the protocol, and every field that a malicious one could use.

mod learning;

use std::time::Duration;

use bytemuck::Zeroable;
use domain::Representation::Working;
use domain::{Demonstrations, Pose};
use shm_types::MemoryDescription;
use shm_types::description::Scope;
use shm_types::message::{
    AnswerItem, AnswerSource, EXTERNAL, ExternalAnswer, ExternalBuilt, ExternalEpisode,
    ExternalQuery, ExternalStore, ItemKind, NO_ACTION, NO_FRAME,
};
use shm_types::notes::NoteHeader;
use shm_types::{BankContent, Note};
use warehouse::TrajectoryKind;

use super::super::*;
use super::rig::{Rig, Script, pose_of};
use crate::external::{ExternalLimits, ExternalMemories};

const SECOND: u64 = 1_000_000_000;

/// A run with the external memory 2.
struct ExternalRig {
    rig: Rig,
    banks: Vec<(u64, BankContent)>,
    taken_back: Vec<u64>,
    episodes: Vec<ExternalEpisode>,
    queries: Vec<ExternalQuery>,
    stores: Vec<ExternalStore>,
    now_ns: u64,
}

fn description(scope: Scope, embeddings: bool, frames: bool) -> MemoryDescription {
    let name = "test".to_owned();
    MemoryDescription { name, scope, embeddings, frames, ..MemoryDescription::default() }
}

impl ExternalRig {
    fn new(lanes: u32, room: usize, description: MemoryDescription) -> Self {
        let limits =
            ExternalLimits { answer: Duration::from_secs(30), build: Duration::from_secs(600) };
        let other = description.clone();
        let externals = ExternalMemories::new([(2, description), (5, other)].into(), limits);
        Self::with(Rig::with_externals(lanes, room, externals))
    }

    fn with(rig: Rig) -> Self {
        Self {
            rig,
            banks: Vec::new(),
            taken_back: Vec::new(),
            episodes: Vec::new(),
            queries: Vec::new(),
            stores: Vec::new(),
            now_ns: SECOND,
        }
    }

    fn script(&self, lane: u32, id: u64, case: u32) -> Script {
        let mut script = self.rig.script(lane, id, case, TrajectoryKind::Test, Working);
        script.config.representation = EXTERNAL;
        script.config.external = 2;
        script
    }

    /// Announces an episode and makes its first observation.
    fn begin(&mut self, lane: u32, id: u64, case: u32) -> Script {
        let script = self.script(lane, id, case);
        self.rig.engine.config(&script.config).unwrap();
        self.rig.observe(script.observations[0]).unwrap();
        script
    }

    /// Does everything that can be done without the memory; returns the recalls.
    fn settle(&mut self) -> Vec<(Recall, RecallTrace)> {
        let mut recalls = Vec::new();
        loop {
            let now_ns = self.now_ns;
            let answers = self.rig.engine.answers(|| now_ns, &mut self.rig.documents);
            recalls.extend(answers.unwrap().into_iter().map(|answer| *answer));
            for (index, message) in self.rig.engine.take_external_messages() {
                assert_eq!(index, 2);
                match message {
                    ToExternal::Bank(id, content) => self.banks.push((id, content)),
                    ToExternal::TakeBack(id) => self.taken_back.push(id),
                    ToExternal::Episode(episode) => self.episodes.push(*episode),
                    ToExternal::Query(query) => self.queries.push(*query),
                    ToExternal::Store(store) => self.stores.push(*store),
                }
            }
            if !self.rig.work(0) {
                return recalls;
            }
        }
    }

    fn built(&mut self, bank: u64) {
        let message = ExternalBuilt { bank, store_bytes: 77, ..Zeroable::zeroed() };
        self.rig.engine.external_built(2, &message).unwrap();
    }

    /// The memory answers all banks, and the test its queries.
    fn queries(&mut self) -> Vec<ExternalQuery> {
        self.settle();
        for (bank, _) in std::mem::take(&mut self.banks) {
            self.built(bank);
        }
        self.settle();
        std::mem::take(&mut self.queries)
    }

    fn answer(&mut self, message: &ExternalAnswer) -> Result<(), String> {
        self.rig.engine.external_answer(2, message, self.now_ns)
    }

    fn note(&mut self, id: u64, lane: u32, episode: u64, bytes: &[u8]) {
        let header = NoteHeader { id, episode, lane, reserved: 0 };
        self.rig.engine.external_note(2, Note { header, bytes: Ok(bytes.to_vec()) }).unwrap();
    }

    /// What the failed episodes of the last calls failed for.
    fn failures(&mut self) -> Vec<(u64, String)> {
        let failures = self.rig.engine.take_failures().into_iter();
        let read = |EpisodeFailure { episode, why, is_overdue, .. }: EpisodeFailure| {
            assert_eq!(is_overdue, why.contains(" within "), "{why}");
            (episode, why)
        };
        failures.map(read).collect()
    }
}

/// An answer to `query` without items.
fn answer_to(query: &ExternalQuery) -> ExternalAnswer {
    let &ExternalQuery { lane, episode, step, .. } = query;
    ExternalAnswer { lane, episode, step, ..Zeroable::zeroed() }
}

/// An answer with two steps of the original demonstration.
fn steps_answer(query: &ExternalQuery) -> ExternalAnswer {
    let mut answer = answer_to(query);
    answer.items_len = 1;
    answer.items[0] = AnswerItem {
        kind: ItemKind::Steps as u8,
        demonstration: 0,
        first_step: 3,
        steps: 2,
        views: 1,
        actions: 1,
        distance: 0.25,
        ..Zeroable::zeroed()
    };
    answer
}

#[test]
fn an_episode_is_built_announced_asked_and_ended() {
    let mut rig = ExternalRig::new(2, 1000, description(Scope::Case, true, true));
    let script = rig.begin(0, 7, 3);
    rig.settle();
    let [(bank, content)] = &rig.banks[..] else { panic!("{:?}", rig.banks) };
    let poses: Vec<Pose> = content.steps.iter().map(|step| pose_of(&step.state)).collect();
    assert_eq!(content.demonstrations.len(), 4);
    for (step, pose) in content.steps.iter().zip(&poses) {
        assert_eq!(rig.rig.frames[step.frame as usize - 1], *pose);
        assert_ne!(step.content_hash, [0; 16]);
    }
    assert!(content.embeddings.len() > content.steps.len() && content.text.starts_with("Find"));
    assert!(rig.episodes.is_empty() && rig.queries.is_empty(), "it is not built yet");
    let bank = *bank;
    rig.built(bank);
    assert!(rig.settle().is_empty());
    let (episode, query) = (rig.episodes[0], rig.queries[0]);
    assert_eq!((episode.episode, episode.lane, episode.bank), (7, 0, bank));
    assert_eq!((episode.image_budget, episode.text_budget), (60, 65536));
    assert_eq!((query.step, query.last, query.embedding_len > 0), (0, 0, true));
    assert_eq!(rig.rig.frames[query.frame as usize - 1], script.poses[0]);

    rig.now_ns += 5;
    rig.answer(&ExternalAnswer { received_ns: 1, sent_ns: 3, tokens: 9, ..steps_answer(&query) })
        .unwrap();
    let [(recall, trace)] = &rig.settle()[..] else { panic!() };
    assert_eq!((recall.items_len, recall.steps_len), (1, 2));
    let frame = recall.steps[0].frame;
    assert_eq!(rig.rig.frames[frame as usize - 1], poses[3]);
    assert_eq!((trace.method_ns, trace.tokens, trace.store_bytes), (2, 9, 77));
    assert_eq!((trace.searched_ns - trace.embedded_ns, trace.images), (5, 2));
    let source = trace.sources[0];
    assert_eq!((source.case, source.demonstration, source.first), (3, 0, 3));

    rig.rig.observe(Observation { last: 1, ..script.observations[1] }).unwrap();
    rig.settle();
    let last = rig.queries[1];
    assert_eq!((last.step, last.last, last.frame), (1, 1, NO_FRAME));
    assert_eq!(rig.rig.pins, rig.rig.releases);
    // The same case again: nothing is built.
    rig.begin(1, 8, 3);
    rig.settle();
    assert_eq!((rig.banks.len(), rig.episodes.len(), rig.queries.len()), (1, 2, 3));
    assert!(rig.failures().is_empty());
}

#[test]
fn a_memory_of_texts_pins_no_view_but_those_that_it_names() {
    let mut rig = ExternalRig::new(1, 10, description(Scope::Case, false, false));
    let script = rig.begin(0, 7, 3);
    let query = rig.queries()[0];
    assert_eq!((rig.rig.pins, query.embedding_len), (0, 0));
    rig.note(1, 0, 7, "left, then right".as_bytes());
    let mut answer = ExternalAnswer { note: 1, ..steps_answer(&query) };
    answer.items_len = 2;
    answer.items[1] = AnswerItem { bytes: 4, ..Zeroable::zeroed() };
    answer.sources_len = 1;
    answer.sources[0] = AnswerSource { item: 1, demonstration: 2, first_step: 0, steps: 9 };
    rig.answer(&answer).unwrap();
    let [(recall, trace)] = &rig.settle()[..] else { panic!() };
    assert_eq!((rig.rig.pins, rig.rig.releases), (2, 0));
    assert_eq!(
        rig.rig.documents.published[0].1,
        shm_types::documents::Content::Note("Find an orange cone.left".into())
    );
    assert_eq!((recall.items[1].bytes, trace.text, trace.sources_len), (4, 4, 2));
    assert_eq!((trace.sources[1].demonstration, trace.sources[1].steps), (2, 9));

    // Another step, other views: those of the first are released.
    rig.rig.observe(script.observations[1]).unwrap();
    let query = rig.queries()[0];
    let mut answer = steps_answer(&query);
    answer.items[0].first_step = 10;
    rig.answer(&answer).unwrap();
    assert_eq!(rig.settle().len(), 1);
    assert_eq!((rig.rig.pins, rig.rig.releases), (4, 2));

    // More views than there is room for.
    rig.rig.observe(script.observations[2]).unwrap();
    let query = rig.queries()[0];
    let mut answer = steps_answer(&query);
    (answer.items[0].first_step, answer.items[0].steps) = (0, 17);
    rig.answer(&answer).unwrap();
    let recalls = rig.settle();
    let failures = rig.failures();
    assert!(recalls.is_empty(), "{recalls:?}");
    assert!(failures[0].1.contains("there is room for 10: raise --frame-budget"), "{failures:?}");
}

#[test]
fn a_plan_takes_actions_from_several_demonstrations_and_of_its_own() {
    let mut rig = ExternalRig::new(1, 10, description(Scope::Case, false, false));
    rig.begin(0, 7, 3);
    let query = rig.queries()[0];
    // An own action within the steps of a source divides them.
    rig.note(1, 0, 7, &[NO_ACTION, 5, NO_ACTION, NO_ACTION, NO_ACTION, 4]);
    let mut answer = ExternalAnswer { note: 1, items_len: 1, sources_len: 2, ..answer_to(&query) };
    answer.items[0] = AnswerItem { kind: ItemKind::Plan as u8, bytes: 6, ..Zeroable::zeroed() };
    answer.sources[0] = AnswerSource { item: 0, demonstration: 2, first_step: 3, steps: 2 };
    answer.sources[1] = AnswerSource { item: 0, demonstration: 0, first_step: 1, steps: 2 };
    rig.answer(&answer).unwrap();
    let [(recall, trace)] = &rig.settle()[..] else { panic!() };
    assert_eq!((rig.rig.pins, trace.images, trace.text, trace.items), (0, 0, 0, 1));
    let plan = recall.items[0];
    assert_eq!((plan.kind, plan.steps, plan.instructions), (ItemKind::Plan as u8, 6, 3));
    let sources = trace.sources[..trace.sources_len as usize].iter();
    let sources: Vec<_> = sources.map(|of| (of.demonstration, of.first, of.steps)).collect();
    assert_eq!(sources, [(2, 3, 1), (2, 4, 1), (0, 1, 2)]);
    let documents = rig.rig.documents.published.iter();
    let steps = documents.filter_map(|(_, content)| match content {
        shm_types::documents::Content::Trajectories(steps) => Some(steps),
        _ => None,
    });
    let own: Vec<_> = steps.flatten().map(|step| (step.trajectory, step.own)).collect();
    assert_eq!(own, [(0, 0), (1, 1), (2, 0), (3, 0), (3, 0), (4, 1)]);
    assert!(rig.failures().is_empty());
}

#[test]
fn a_memory_of_all_cases_has_embeddings_and_pins_few_views() {
    let mut rig = ExternalRig::new(2, 100, description(Scope::All, true, true));
    let mut script = rig.script(0, 7, 3);
    script.config.demonstrations = Demonstrations::ORIGINAL.bits();
    rig.rig.engine.config(&script.config).unwrap();
    rig.rig.observe(script.observations[0]).unwrap();
    rig.settle();
    let [(_, content)] = &rig.banks[..] else { panic!() };
    assert_eq!(content.demonstrations.len(), 100, "one of each case");
    assert!(
        content.steps.iter().all(|step| step.frame == NO_FRAME && step.content_hash != [0; 16])
    );
    assert_eq!(content.embeddings.len() % content.steps.len(), 0);
    assert_eq!(rig.rig.pins, rig.rig.releases, "none is pinned any more");
    let query = rig.queries()[0];
    let mut answer = steps_answer(&query);
    answer.items[0].demonstration = 41;
    rig.answer(&answer).unwrap();
    let [(_, trace)] = &rig.settle()[..] else { panic!() };
    assert_eq!((trace.sources[0].case, rig.rig.pins - rig.rig.releases), (41, 2));
}

#[test]
fn a_memory_that_cannot_be_built_fails_its_episodes() {
    let mut rig = ExternalRig::new(2, 1000, description(Scope::Case, false, false));
    rig.begin(0, 7, 3);
    rig.settle();
    let bank = rig.banks[0].0;
    rig.note(4, u32::MAX, 0, "no model".as_bytes());
    let message = ExternalBuilt { bank, failure: 4, ..Zeroable::zeroed() };
    rig.rig.engine.external_built(2, &message).unwrap();
    rig.settle();
    let expected = "external memory test cannot be built: no model".to_owned();
    assert_eq!(rig.failures(), [(7, expected.clone())]);
    rig.begin(1, 8, 3);
    rig.settle();
    assert_eq!(rig.failures(), [(8, expected)]);
    for (index, bank) in [(2, bank), (2, 99), (5, bank)] {
        let message = ExternalBuilt { bank, ..Zeroable::zeroed() };
        let error = rig.rig.engine.external_built(index, &message).unwrap_err().to_string();
        assert!(error.contains("which it was not asked for"), "{error}");
    }
}

#[test]
fn reasons_that_come_before_the_failures_that_name_them_are_kept() {
    let mut rig = ExternalRig::new(2, 1000, description(Scope::Case, false, false));
    rig.begin(0, 7, 3);
    rig.begin(1, 8, 13);
    rig.settle();
    let banks: Vec<u64> = rig.banks.iter().map(|bank| bank.0).collect();
    // It has two banks, so of three reasons the first is dropped.
    for (id, reason) in [(3, "none"), (4, "no model"), (5, "no memory")] {
        rig.note(id, u32::MAX, 0, reason.as_bytes());
    }
    for (&bank, failure) in banks.iter().zip([4, 5]) {
        let message = ExternalBuilt { bank, failure, ..Zeroable::zeroed() };
        rig.rig.engine.external_built(2, &message).unwrap();
    }
    rig.settle();
    let why = |reason| format!("external memory test cannot be built: {reason}");
    assert_eq!(rig.failures(), [(7, why("no model")), (8, why("no memory"))]);
}

#[test]
fn time_limits_cost_the_episodes_that_wait() {
    let mut rig = ExternalRig::new(3, 1000, description(Scope::Case, false, false));
    rig.begin(0, 7, 3);
    rig.begin(1, 8, 3);
    let queries = rig.queries();
    rig.now_ns += 20 * SECOND;
    rig.answer(&answer_to(&queries[1])).unwrap();
    assert_eq!(rig.settle().len(), 1);
    rig.now_ns += 11 * SECOND;
    rig.settle();
    let unanswered = |episode| {
        [(episode, "external memory test has not answered step 0 within 30 s".to_owned())]
    };
    assert_eq!(rig.failures(), unanswered(7));
    let late = rig.answer(&answer_to(&queries[0])).unwrap_err().to_string();
    assert!(
        late.ends_with("after it was answered or given up") && rig.failures().is_empty(),
        "{late}"
    );
}

#[test]
fn a_memory_that_builds_has_time_to_answer_and_to_build_the_next_bank_afterwards() {
    let mut rig = ExternalRig::new(3, 1000, description(Scope::Case, false, false));
    rig.begin(0, 7, 3);
    rig.queries();
    for (lane, episode) in [(1, 8), (2, 9)] {
        rig.begin(lane, episode, 3 + lane);
    }
    rig.settle();
    let unbuilt = |episode| (episode, "external memory test was not built within 600 s".to_owned());
    for (seconds, expected) in
        [(599, vec![]), (2, vec![unbuilt(8)]), (599, vec![]), (2, vec![unbuilt(9)])]
    {
        rig.now_ns += seconds * SECOND;
        rig.settle();
        assert_eq!(rig.failures(), expected);
    }
    rig.now_ns += 31 * SECOND;
    rig.settle();
    assert_eq!(rig.failures()[0].0, 7, "it was asked before, and is answered in 30 s after");
}

#[test]
fn a_bank_that_comes_later_does_not_extend_the_time_for_an_answer() {
    let mut rig = ExternalRig::new(3, 1000, description(Scope::Case, false, false));
    rig.begin(0, 7, 3);
    rig.queries();
    rig.now_ns += 2 * SECOND;
    rig.begin(1, 8, 4);
    rig.now_ns += 29 * SECOND;
    rig.settle();
    let expected = "external memory test has not answered step 0 within 30 s".to_owned();
    assert_eq!(rig.failures(), [(7, expected)], "it has sent nothing since, so it builds nothing");
}

#[test]
fn an_answer_that_took_too_long_is_late_although_a_bank_may_have_been_built_meanwhile() {
    let mut rig = ExternalRig::new(3, 1000, description(Scope::Case, false, false));
    rig.begin(0, 7, 3);
    let asked = rig.queries();
    rig.begin(1, 8, 4);
    rig.settle();
    rig.now_ns += 31 * SECOND;
    rig.settle();
    assert_eq!(rig.failures(), [], "it may be building");
    let late = ExternalAnswer { received_ns: 1, sent_ns: 30 * SECOND + 2, ..answer_to(&asked[0]) };
    rig.answer(&late).unwrap();
    let expected = "external memory test has not answered step 0 within 30 s".to_owned();
    assert_eq!(rig.failures(), [(7, expected)]);
}

#[test]
fn a_memory_that_cannot_be_reached_fails_its_episode() {
    let mut rig = ExternalRig::new(1, 1000, description(Scope::Case, false, false));
    rig.begin(0, 7, 3);
    rig.queries();
    let query = ExternalQuery { lane: 0, episode: 7, ..Zeroable::zeroed() };
    let message = ToExternal::Query(Box::new(query));
    rig.rig.engine.external_unreachable(2, &message, "its queue is full");
    assert_eq!(rig.failures(), [(7, "external memory test: its queue is full".to_owned())]);
}

/// Plays two episodes of one external memory at once; `spoil` changes its answer for the first. Returns what became of
/// the first: the reason of its failure, or the reason why the message was dropped.
fn spoilt(spoil: &dyn Fn(&mut ExternalRig, &mut ExternalAnswer)) -> String {
    let mut rig = ExternalRig::new(3, 1000, description(Scope::Case, true, false));
    rig.begin(0, 7, 3);
    rig.begin(1, 8, 4);
    let other = rig.rig.script(2, 9, 5, TrajectoryKind::Test, Working);
    rig.rig.engine.config(&other.config).unwrap();
    let queries = rig.queries();
    let mut bad = steps_answer(&queries[0]);
    spoil(&mut rig, &mut bad);
    let dropped = rig.answer(&bad).err().map(|unusable| unusable.to_string());
    assert!(rig.settle().is_empty(), "nothing of it is supplied");
    let failed = rig.failures();
    // The other episode of the same memory goes on, and so does another memory's.
    rig.answer(&steps_answer(&queries[1])).unwrap();
    let recalls = rig.settle();
    assert!(recalls.len() == 1 && recalls[0].0.episode == 8, "{recalls:?}");
    rig.rig.observe(other.observations[0]).unwrap();
    assert_eq!(rig.settle().len(), 1);
    assert!(rig.failures().is_empty());
    match (dropped, &failed[..]) {
        (None, [(7, why)]) => why.clone(),
        (Some(why), []) => {
            rig.now_ns += 31 * SECOND;
            rig.settle();
            let [(7, given_up)] = &rig.failures()[..] else { panic!("episode 7 is given up") };
            assert!(given_up.contains("has not answered step 0 within 30 s"), "{given_up}");
            why
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_field_of_a_malicious_answer_costs_its_own_episode_only() {
    let text = |first_byte, bytes| AnswerItem { first_byte, bytes, ..Zeroable::zeroed() };
    let check = |expected: &str, spoil: &dyn Fn(&mut ExternalRig, &mut ExternalAnswer)| {
        let why = spoilt(spoil);
        assert!(why.contains(expected), "{why}\nexpected: {expected}");
    };
    let item = |expected: &str, spoil: &dyn Fn(&mut AnswerItem)| {
        check(expected, &|_, answer| spoil(&mut answer.items[0]));
    };
    item("item 0 names demonstration 4, but the bank has 4", &|item| item.demonstration = 4);
    item("item 0 names demonstration 4294967295", &|item| item.demonstration = u32::MAX);
    item("item 0 names 2 steps from step 4294967295", &|item| item.first_step = u32::MAX);
    item("item 0 names 4294967295 steps from step 3", &|item| item.steps = u32::MAX);
    item("item 0 names 0 steps", &|item| item.steps = 0);
    item("item 0 has no valid kind: 9 is not an item kind", &|item| item.kind = 9);
    item("item 0 is a trajectory", &|item| item.kind = ItemKind::Trajectory as u8);
    item("item 0 is a captioned frame of 2 steps", &|item| item.kind = ItemKind::Frame as u8);
    item("item 0 has the code 3 for its views", &|item| item.views = 3);
    item("item 0 has the code 2 for its actions", &|item| item.actions = 2);
    item("item 0 supplies neither", &|item| (item.views, item.actions) = (0, 0));
    item("item 0 has the distance inf", &|item| item.distance = f32::INFINITY);
    item("item 0 names 4 bytes from byte 0 of a note of 0 bytes", &|item| {
        (item.views, item.bytes) = (2, 4);
    });
    let noted = |expected: &str, bytes: &'static [u8], item: AnswerItem| {
        check(expected, &|rig, answer| {
            rig.note(6, 0, 7, bytes);
            (answer.note, answer.items[0]) = (6, item);
        });
    };
    noted("item 0 names 9 bytes from byte 0 of a note of 4 bytes", b"text", text(0, 9));
    noted("item 0 names 2 bytes from byte 4294967295", b"text", text(u32::MAX, 2));
    noted("item 0 names 4294967295 bytes", b"text", text(2, u32::MAX));
    noted("item 0 holds a text that is not UTF-8", b"\xff\xff", text(0, 2));
    noted("item 0 holds a text that is not UTF-8", "ä".as_bytes(), text(1, 1));
    let keyframes = |bytes| AnswerItem {
        kind: ItemKind::Steps as u8,
        steps: 2,
        views: 2,
        bytes,
        ..Zeroable::zeroed()
    };
    noted("item 0 names its keyframes in 3 bytes", b"\0\0\0\0", keyframes(3));
    noted("item 0 shows step 7, which is not", b"\x07\0\0\0", keyframes(4));
    check("it names note 6, which was not published", &|_, answer| answer.note = 6);
    check(
        "it names note 6, but the last note of its lane is note 5 of episode 7",
        &|rig, answer| {
            rig.note(5, 0, 7, b"text");
            answer.note = 6;
        },
    );
    check("the last note of its lane is note 6 of episode 99", &|rig, answer| {
        rig.note(6, 0, 99, b"text");
        answer.note = 6;
    });
    check("it names note 6, which was not published", &|rig, answer| {
        rig.note(6, 1, 7, b"text");
        answer.note = 6;
    });
    check("it has 9 items, and at most 8", &|_, answer| answer.items_len = 9);
    check("it has 4294967295 items", &|_, answer| answer.items_len = u32::MAX);
    check("it has 17 sources, and at most 16", &|_, answer| answer.sources_len = 17);
    check("a source is that of item 0, which is no text", &|_, answer| answer.sources_len = 1);
    check("a source is that of item 7, which is no text", &|_, answer| {
        (answer.sources_len, answer.sources[0].item) = (1, 7);
    });
    let sourced = |expected: &str, source: AnswerSource| {
        check(expected, &|_, answer| {
            answer.items[0] = text(0, 0);
            (answer.sources_len, answer.sources[0]) = (1, source);
        });
    };
    let source = AnswerSource { item: 0, demonstration: 0, first_step: 0, steps: 1 };
    sourced("item 0 names demonstration 4", AnswerSource { demonstration: 4, ..source });
    sourced("item 0 names 900 steps", AnswerSource { steps: 900, ..source });
    sourced(
        "item 0 names 1 steps from step 4294967295",
        AnswerSource { first_step: u32::MAX, ..source },
    );
    // A plan of an own action and of the actions at the steps that `source` names.
    let planned = |expected: &str, codes: &'static [u8], source: AnswerSource| {
        check(expected, &|rig, answer| {
            rig.note(6, 0, 7, codes);
            answer.note = 6;
            answer.items[0] =
                AnswerItem { kind: ItemKind::Plan as u8, ..text(0, codes.len() as u32) };
            (answer.sources_len, answer.sources[0]) = (1, source);
        });
    };
    const TWO: &[u8] = &[4, NO_ACTION, NO_ACTION];
    let two = AnswerSource { steps: 2, ..source };
    planned(
        "item 0 names demonstration 4, but the bank has 4",
        TWO,
        AnswerSource { demonstration: 4, ..two },
    );
    planned(
        "item 0 names 2 steps from step 4294967295",
        TWO,
        AnswerSource { first_step: u32::MAX, ..two },
    );
    planned("item 0 plans the expert's actions at 2 steps, and its 1 sources name 1", TWO, source);
    planned(
        "item 0 plans the expert's actions at 2 steps, and its 1 sources name 4294967295",
        TWO,
        AnswerSource { steps: u32::MAX, ..two },
    );
    planned("its 1 sources name 0", &[4], AnswerSource { steps: 0, ..two });
    planned("item 0 plans action 7, but the world has 7", &[7, NO_ACTION, NO_ACTION], two);
    planned("item 0 plans 1025 actions, and at most 1024", &[4; 1025], two);
    check("item 0 is a plan without actions", &|_, answer| {
        answer.items[0] = AnswerItem { kind: ItemKind::Plan as u8, ..text(0, 0) };
    });
    check("`failed` is 2, expected 0 or 1", &|_, answer| answer.failed = 2);
    check("step 0: it gives no reason", &|_, answer| answer.failed = 1);
    check("step 0: out of credit", &|rig, answer| {
        rig.note(6, 0, 7, b"out of credit");
        (answer.failed, answer.note) = (1, 6);
    });
    check("it answers step 1, and the last question was step 0", &|_, answer| answer.step = 1);
    check("it answers step 4294967295", &|_, answer| answer.step = u32::MAX);
    for (episode, lane) in [(8, 0), (7, 1), (7, 3), (7, u32::MAX), (99, 0), (9, 2)] {
        check("which is no running episode of it", &|_, answer| {
            (answer.episode, answer.lane) = (episode, lane);
        });
    }
}

#[test]
fn a_late_answer_leaves_the_note_of_the_episode_after_it() {
    let mut rig = ExternalRig::new(1, 10, description(Scope::Case, false, false));
    rig.begin(0, 7, 3);
    let given_up = rig.queries()[0];
    rig.begin(0, 8, 3);
    let query = rig.queries()[0];
    rig.note(2, 0, 8, b"left");
    rig.answer(&ExternalAnswer { note: 1, ..answer_to(&given_up) }).unwrap_err();
    let mut answer = ExternalAnswer { note: 2, ..steps_answer(&query) };
    answer.items_len = 2;
    answer.items[1] = AnswerItem { bytes: 4, ..Zeroable::zeroed() };
    rig.answer(&answer).unwrap();
    assert_eq!((rig.settle().len(), rig.failures()), (1, vec![]));
}

#[test]
fn another_external_memory_cannot_answer_and_a_second_answer_is_refused() {
    let mut rig = ExternalRig::new(2, 1000, description(Scope::Case, false, false));
    let script = rig.begin(0, 7, 3);
    let query = rig.queries()[0];
    let foreign = rig.rig.engine.external_answer(5, &answer_to(&query), 9);
    assert!(foreign.unwrap_err().to_string().contains("which is no running episode of it"));
    rig.answer(&answer_to(&query)).unwrap();
    assert_eq!(rig.settle().len(), 1);
    // The episode goes on; the answer to its first step comes again.
    rig.rig.observe(script.observations[1]).unwrap();
    rig.queries();
    rig.answer(&answer_to(&query)).unwrap();
    let why = "external memory test, step 0: it answers step 0, and the last question was step 1";
    assert_eq!(rig.failures(), [(7, why.to_owned())]);
    let header = NoteHeader { id: 1, episode: 7, lane: 2, reserved: 0 };
    let note = Note { header, bytes: Ok(Vec::new()) };
    let error = rig.rig.engine.external_note(2, note).unwrap_err().to_string();
    assert_eq!(error, "note of external memory test: lane 2 of 2");
}

#[test]
fn banks_that_no_episode_has_used_for_long_are_taken_back() {
    let mut rig = ExternalRig::new(1, 1000, description(Scope::Case, false, false));
    for case in 0..70 {
        let script = rig.begin(0, u64::from(case) + 1, case);
        rig.queries();
        rig.rig.observe(Observation { last: 1, ..script.observations[1] }).unwrap();
    }
    rig.settle();
    assert_eq!(rig.taken_back, [1, 2, 3, 4, 5, 6]);
    rig.begin(0, 100, 0);
    rig.settle();
    assert_eq!(rig.banks.len(), 1, "it is built again, under another id");
    assert_eq!(rig.banks[0].0, 71);
}
