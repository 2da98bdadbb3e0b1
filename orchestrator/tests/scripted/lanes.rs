//! Lanes against a scripted simulator, memory and policy: no process, no shared memory.

use std::collections::BTreeSet;

use bytemuck::Zeroable;
use case_book::{CaseInState, StreamBlock, StreamFacts, StreamsFacts};
use conditions::key::{EpisodeKey, StreamPlace};
use conditions::{Condition, Demonstrations, Mismatch, Route, Start, Variation};
use conformance::messages::{self, recall_trace};
use domain::events::{Requirement, Visit};
use domain::{Action, Arm, Cell, FeedbackLevel, Mixture, Outcome, Representation, StreamOrder};
use orchestrator::books::Books;
use orchestrator::lanes::{AnswerError, EpisodeOpening, FinishedEpisode, Lanes, Rules, Turn};
use orchestrator::plan::{PlannedEpisode, StreamPart, plan, sequence_id};
use orchestrator::streams::Remaining;
use rigs::scripted::{ScriptedSim, ScriptedStep, request};
use run_log::Ending;
use serde_json::{Value, json};
use shm_types::message::{
    Decision, EXPERIENCE, EpisodeEnd, MemoryEpisodeConfig, NO_FRAME, NOT_MEASURED, Observation,
    RecallTrace, RecalledSource, Role, SnapshotReport, StepReport,
};
use shm_types::notes::{Note, NoteHeader};
use warehouse::{CaseSet, History};

use crate::common::{self, books};

const RULES: Rules = Rules { max_steps: 200, ..common::RULES };

fn episode(books: &Books, case_index: usize, start: Start, route: Route) -> PlannedEpisode {
    let demonstrations = Demonstrations::ORIGINAL;
    let variation = Variation::STANDARD;
    let memory = Representation::Episodic.into();
    let (mismatch, arm) = (Mismatch::None, Arm::Frozen);
    let condition = Condition { memory, start, route, demonstrations, variation, mismatch, arm };
    let case = books.cases.book.cases[case_index].id.clone();
    PlannedEpisode {
        key: EpisodeKey { condition, run: 1, place: None, case },
        case_index,
        seed: 7,
        part: None,
    }
}

/// Tells the lanes the answer of the simulator, changed by `change`.
fn report(
    lanes: &mut Lanes<'_>,
    step: &ScriptedStep,
    change: impl FnOnce(&mut ScriptedStep),
) -> Result<Turn, AnswerError> {
    let mut step = step.clone();
    change(&mut step);
    let ScriptedStep { mut report, facts, .. } = step;
    let notes: Vec<Note> = facts
        .iter()
        .map(|facts| {
            let header = NoteHeader { id: 7, ..NoteHeader::zeroed() };
            Note { header, bytes: Ok(serde_json::to_vec(facts).unwrap()) }
        })
        .collect();
    report.facts = 7;
    lanes.reported(&report, &notes)
}

fn trace(of: &Observation) -> RecallTrace {
    recall_trace(request(of))
}

fn decision(of: &Observation, action: Action) -> Decision {
    Decision { images: 3, images_asked: 3, ..messages::decision(request(of), action) }
}

/// Runs one episode to its end; the policy answers by step number, `None` for an unreadable answer; memory recalls at each
/// observation, and `change` changes what the simulator says.
fn run(
    rules: Rules,
    episode: PlannedEpisode,
    answer: impl Fn(usize) -> Option<Action>,
    recall: impl Fn(&Observation) -> RecallTrace,
    change: impl Fn(&mut ScriptedStep),
) -> FinishedEpisode {
    let books = books();
    let mut lanes = Lanes::new(&books, rules, 1);
    let mut sim = ScriptedSim::default();
    let mut step = sim.begin(&lanes.begin(0, episode).world);
    loop {
        let observation = step.observation;
        match report(&mut lanes, &step, &change).unwrap() {
            Turn::Finished(finished) => return *finished,
            Turn::Command(next) => {
                step = sim.step(&next);
                continue;
            }
            turn => assert!(matches!(turn, Turn::Wait), "{turn:?}"),
        }
        lanes.recalled(&recall(&observation)).unwrap();
        let answer = match answer(observation.step as usize) {
            Some(action) => decision(&observation, action),
            None => Decision {
                outcome: Outcome::Unreadable as u8,
                ..decision(&observation, Action::Forward)
            },
        };
        match lanes.decided(&answer).unwrap() {
            Turn::Command(next) => step = sim.step(&next),
            turn => panic!("{turn:?}"),
        }
    }
}

/// Makes the simulator say that the task, which has one sub-goal, is complete after `steps` steps.
fn complete_after(step: &mut ScriptedStep, steps: u32) {
    if step.report.step >= steps {
        (step.report.sub_goals, step.report.ended) = (1, EpisodeEnd::Complete as u8);
    }
}

#[test]
fn the_expert_takes_the_steps_of_the_reference() {
    let books = books();
    for (start, route) in [
        (Start::Original, Route::Unchanged),
        (Start::New, Route::Unchanged),
        (Start::New, Route::Blocked),
    ] {
        let reference = books.cases.book.cases[3].reference(start, route).unwrap();
        let rules = Rules { expert: true, max_steps: reference.length, ..RULES };
        let limit = |step: &mut ScriptedStep| complete_after(step, reference.length);
        let record = run(rules, episode(&books, 3, start, route), |_| None, trace, limit).record;
        assert_eq!((record.ending, record.steps), (Ending::Complete, record.reference));
        let world = &books.cases.book.world.declaration;
        let taken: Vec<_> = record.actions.chars().filter_map(|c| world.action_of(c)).collect();
        assert_eq!(taken, reference.actions[..reference.length as usize]);
        assert_eq!(record.had_conflict(), (route == Route::Blocked).then_some(false));
        assert_eq!((record.requests, record.images), (None, None));
        assert_eq!(record.sub_goals, [record.steps]);
    }
}

#[test]
fn the_record_has_what_the_world_tells() {
    let books = books();
    let rules = Rules { max_steps: 6, ..RULES };
    let blocked = episode(&books, 3, Start::New, Route::Blocked);
    let visit = Visit { step: 2, requirement: Requirement::A, cell: Cell::new(3, 4) };
    let told = |step: &mut ScriptedStep| {
        step.report.conflict = u8::from([2, 4].contains(&step.report.step));
        step.report.required = 2;
        step.report.sub_goals = u16::from(step.report.step >= 3);
        if let Some(facts) = &mut step.facts {
            facts.visits = vec![visit];
            facts.first_seen = [(Requirement::A, 1)].into();
        }
    };
    let forward = |_| Some(Action::Forward);
    let record = run(rules, blocked, forward, trace, told).record;
    assert_eq!((record.had_conflict(), record.conflict_at), (Some(true), Some(2)));
    assert_eq!((record.sub_goals, record.required), (vec![3], 2));
    let expected = json!({
        "start_pose": "3,4,E",
        "final_pose": "3,4,E",
        "visits": ["2A@3,4"],
        "first_seen": {"A": 1},
        "blocked_moves": [1, 2, 3, 4, 5, 6],
    });
    assert_eq!(Value::from(record.world), expected);
}

#[test]
fn an_episode_ends_at_the_limit_and_counts_what_happened() {
    let turning = |step| (step != 4).then_some(Action::TurnLeft);
    let rules = Rules { max_steps: 9, ..RULES };
    let episode = episode(&books(), 0, Start::Original, Route::Unchanged);
    let finished = run(rules, episode, turning, trace, |_| ());
    let record = finished.record;
    assert_eq!((record.ending, record.steps), (Ending::OutOfSteps, 9));
    assert_eq!(record.actions, "LLLL?LLLL");
    assert_eq!((record.requests, record.images), (Some(9), Some(27)));
    assert_eq!((record.prompt_tokens, record.unread.unreadable), (None, 1));
    assert_eq!((record.retrieved, record.distance), (None, None));
    assert_eq!((record.required, &record.world["blocked_moves"]), (1, &json!([])));
}

#[test]
fn the_log_says_whose_demonstration_each_match_is_of() {
    let cases = CaseSet::shipped();
    let mut episode = episode(&books(), 20, Start::New, Route::Unchanged);
    for (demonstrations, mixture) in [
        (Demonstrations::IRRELEVANT, Mixture::Irrelevant),
        (Demonstrations::CONFUSABLE, Mixture::Confusable),
    ] {
        episode.key.condition.demonstrations = demonstrations;
        let histories = cases.histories(20, demonstrations);
        let recall = |of: &Observation| match histories.get(of.step as usize) {
            Some(&History { case, kind }) => {
                let mut trace = trace(of);
                trace.sources_len = 1;
                trace.sources[0] = RecalledSource {
                    case: case as u32,
                    demonstration: kind as u16,
                    distance: if of.step == 2 { f32::NAN } else { 0.25 * of.step as f32 },
                    first: 7,
                    steps: 1,
                    ..Zeroable::zeroed()
                };
                trace
            }
            None => trace(of),
        };
        let rules = Rules { max_steps: 5, ..RULES };
        let turning = |_| Some(Action::TurnLeft);
        let record = run(rules, episode.clone(), turning, recall, |_| ()).record;
        let [one, two] = cases.cases[20]
            .mixed(mixture)
            .map(|History { case, kind }| format!("{}:{}7", cases.cases[case].id, kind.letter()));
        assert_eq!(record.retrieved, Some(format!("o7 p7 {one} {two} -")));
        assert_eq!(record.distances.as_deref(), Some("0 0.25 - 0.75 -"));
        assert_eq!(record.distance, Some(0.333_333));
    }
}

#[test]
fn an_episode_config_follows_from_its_condition() {
    let books = books();
    let mut lanes = Lanes::new(&books, RULES, 1);
    let mut told = |condition: &str| {
        let condition: Condition = condition.parse().unwrap();
        let case = books.cases.book.cases[3].id.clone();
        let key = EpisodeKey { condition, run: 1, place: None, case };
        let opening = lanes.begin(0, PlannedEpisode { key, case_index: 3, seed: 7, part: None });
        lanes.give_up(0);
        let MemoryEpisodeConfig { representation, demonstrations, horizon, .. } = opening.memory;
        let MemoryEpisodeConfig { keyframes, segment, case, .. } = opening.memory;
        assert_eq!((case, horizon, keyframes), (3, 6, 40));
        let window = opening.policy.window;
        let hinted = opening.policy.starts_as_demonstrated;
        let representation = Representation::try_from(representation).unwrap();
        format!(
            "{representation} of {demonstrations:06b}, h {window}, segment {segment}, hint {hinted}"
        )
    };
    for (condition, expected) in [
        ("working/original/unchanged/none", "working of 000000, h 6, segment 0, hint 0"),
        ("working/original/unchanged/none/h0", "working of 000000, h 0, segment 0, hint 0"),
        ("episodic/original/unchanged/original", "episodic of 000001, h 6, segment 0, hint 1"),
        (
            "episodic/original/unchanged/original/h20/images/no-hint",
            "episodic of 000001, h 20, segment 1, hint 0",
        ),
        (
            "full-context/original/unchanged/original",
            "full-context of 000001, h 6, segment 0, hint 1",
        ),
        (
            "full-context/original/unchanged/nearby",
            "full-context of 000100, h 6, segment 0, hint 0",
        ),
        ("full-context/new/unchanged/original", "full-context of 000001, h 6, segment 0, hint 0"),
        ("summary/original/unchanged/original", "summary of 000001, h 6, segment 0, hint 0"),
        ("hybrid/new/blocked/4", "hybrid of 001111, h 6, segment 0, hint 0"),
        ("episodic/new/unchanged/irrelevant", "episodic of 010011, h 6, segment 0, hint 0"),
        ("episodic/new/unchanged/confusable", "episodic of 100011, h 6, segment 0, hint 0"),
    ] {
        assert_eq!(told(condition), expected, "{condition}");
    }
}

/// Two lanes with an episode each; the first answer of the simulator to lane 0.
fn two_lanes(books: &Books) -> (Lanes<'_>, EpisodeOpening, ScriptedStep) {
    let mut lanes = Lanes::new(books, RULES, 2);
    let opening = lanes.begin(0, episode(books, 0, Start::Original, Route::Unchanged));
    lanes.begin(1, episode(books, 1, Start::Original, Route::Unchanged));
    let step = ScriptedSim::default().begin(&opening.world);
    (lanes, opening, step)
}

#[test]
fn answers_out_of_turn_are_errors_and_change_nothing() {
    let books = books();
    let (mut lanes, opening, step) = two_lanes(&books);
    let observation = step.observation;
    let answer = decision(&observation, Action::Forward);
    let ahead = Decision { step: 1, ..answer };
    assert!(matches!(
        lanes.decided(&ahead),
        Err(AnswerError::Unexpected { role: Role::Policy, .. })
    ));
    assert!(matches!(lanes.reported(&step.report, &[]), Ok(Turn::Wait)));
    assert!(matches!(
        lanes.reported(&step.report, &[]),
        Err(AnswerError::Unexpected { role: Role::Sim, .. })
    ));
    assert!(matches!(lanes.decided(&ahead), Err(AnswerError::Unexpected { step: 1, .. })));
    assert_eq!(
        lanes.pending(0).last().map(|answer| (answer.lane, answer.role)),
        Some((1, Role::Sim))
    );
    lanes.recalled(&trace(&observation)).unwrap();
    assert!(matches!(lanes.recalled(&trace(&observation)), Err(AnswerError::Unexpected { .. })));
    assert!(matches!(lanes.decided(&ahead), Err(AnswerError::Unexpected { step: 1, .. })));
    let elsewhere = Decision { lane: 2, ..answer };
    assert!(matches!(
        lanes.decided(&elsewhere),
        Err(AnswerError::NoSuchLane { lane: 2, lanes: 2, .. })
    ));
    let late = Decision { episode: opening.world.episode + 100, ..answer };
    assert!(matches!(lanes.decided(&late), Ok(Turn::Wait)), "another episode");
    assert!(matches!(lanes.decided(&answer), Ok(Turn::Command(_))));
}

#[test]
fn progress_of_memory_restarts_the_wait_for_it() {
    let books = books();
    let (mut lanes, _, step) = two_lanes(&books);
    lanes.reported(&step.report, &[]).unwrap();
    let busy_ns = lanes.pending(0)[0].since_ns + 1_000_000_000_000;
    let [memory, sim] = lanes.pending(busy_ns)[..] else { panic!("both lanes wait") };
    assert_eq!((memory.role, memory.lane, memory.since_ns), (Role::Memory, 0, busy_ns));
    assert_eq!((sim.role, sim.since_ns < busy_ns), (Role::Sim, true));
}

#[test]
fn an_answer_may_overtake_what_it_answers() {
    let books = books();
    let (mut lanes, _, step) = two_lanes(&books);
    let observation = step.observation;
    let (answer, trace) = (decision(&observation, Action::Forward), trace(&observation));
    assert!(matches!(lanes.decided(&answer), Ok(Turn::Wait)));
    assert!(lanes.has_early_decision());
    assert!(
        matches!(lanes.decided(&answer), Err(AnswerError::Unexpected { .. })),
        "one answer a step"
    );
    assert!(matches!(lanes.recalled(&trace), Ok(Turn::Wait)));
    assert!(matches!(lanes.reported(&step.report, &[]), Ok(Turn::Command(_))));
    assert!(!lanes.has_early_decision());
    let [stamps] = lanes.take_stepped().collect::<Vec<_>>()[..] else { panic!("one step") };
    assert_eq!((stamps.lane, stamps.step), (0, 0));
}

#[test]
fn the_cost_of_an_answer_is_counted_once() {
    let books = books();
    let (mut lanes, _, step) = two_lanes(&books);
    let observation = step.observation;
    let asked = Decision {
        attempts: 2,
        prompt_tokens: 900,
        completion_tokens: 3,
        memory_tokens: NOT_MEASURED,
        images_asked: 5,
        ..decision(&observation, Action::TurnLeft)
    };
    lanes.reported(&step.report, &[]).unwrap();
    lanes.decided(&asked).unwrap();
    assert!(lanes.take_answered().is_empty(), "not counted before memory's trace");
    lanes.recalled(&trace(&observation)).unwrap();
    assert!(lanes.decided(&asked).is_err());
    let answered = lanes.take_answered();
    assert_eq!((answered.len(), answered[0].decision), (1, asked));
    assert!(answered[0].key.ends_with("/run1/t01-01") && lanes.take_answered().is_empty());
}

#[test]
fn figures_that_a_policy_does_not_measure_are_not_counted() {
    let books = books();
    let (mut lanes, _, step) = two_lanes(&books);
    let observation = step.observation;
    let unmeasured = Decision {
        attempts: NOT_MEASURED,
        images: NOT_MEASURED,
        images_asked: NOT_MEASURED,
        ..decision(&observation, Action::TurnLeft)
    };
    lanes.reported(&step.report, &[]).unwrap();
    lanes.recalled(&trace(&observation)).unwrap();
    assert!(matches!(lanes.decided(&unmeasured), Ok(Turn::Command(_))));
    assert!(lanes.take_answered().is_empty(), "no model was asked, as far as is known");
}

#[test]
fn an_invalid_answer_costs_its_own_episode_and_no_other() {
    let books = books();
    let (mut lanes, _, step) = two_lanes(&books);
    let observation = step.observation;
    lanes.reported(&step.report, &[]).unwrap();
    lanes.recalled(&trace(&observation)).unwrap();
    let good = decision(&observation, Action::Forward);
    for invalid in [Decision { action: 99, ..good }, Decision { outcome: 9, ..good }] {
        assert!(matches!(lanes.decided(&invalid), Err(AnswerError::Invalid { lane: 0, .. })));
    }
    assert_eq!(lanes.give_up(0).map(|episode| episode.case_index), Some(0));
    assert_eq!((lanes.busy(), lanes.free()), (1, Some(0)));
    let again = lanes.begin(0, episode(&books, 0, Start::Original, Route::Unchanged));
    assert_ne!(again.world.episode, observation.episode, "ids are not used twice");
    assert!(matches!(lanes.decided(&good), Ok(Turn::Wait)), "the old answer is late");
}

#[test]
fn ids_of_episodes_have_no_order_and_depend_on_seed_and_episode_only() {
    let books = books();
    let conditions = [("working/original/unchanged/none".parse().unwrap(), 1)];
    let ids = books.cases.book.ids();
    let planned = |seed| plan(&conditions, &[0, 1, 2, 3, 4, 5, 6, 7], &ids, seed);
    let begun = |episodes: &mut dyn Iterator<Item = PlannedEpisode>, free: usize| {
        let mut lanes = Lanes::new(&books, RULES, 2);
        let of = |episode: PlannedEpisode| {
            let key = episode.key.to_string();
            let EpisodeOpening { memory, policy, world } = lanes.begin(free, episode);
            lanes.give_up(free as u32);
            assert_eq!([memory.episode, policy.episode], [world.episode; 2]);
            (key, world.episode)
        };
        episodes.map(of).collect::<Vec<_>>()
    };
    let first = begun(&mut planned(1), 0);
    let in_order: Vec<u64> = first.iter().map(|(_, id)| *id).collect();
    assert!(!in_order.is_sorted() && !in_order.iter().rev().is_sorted());
    // The same for every order and lane, other ones for another seed, for another attempt, and in another lane.
    let reversed: Vec<_> = planned(1).collect();
    let mut again = begun(&mut reversed.into_iter().rev(), 1);
    again.reverse();
    assert_eq!(again, first);
    let attempts = begun(&mut planned(1).chain(planned(1)).chain(planned(1)), 0);
    assert_eq!(attempts[..8], first);
    let all = attempts.into_iter().chain(begun(&mut planned(2), 0)).map(|(_, id)| id);
    assert_eq!(all.collect::<BTreeSet<_>>().len(), 4 * 8);
}

#[test]
fn a_simulator_that_contradicts_itself_is_found() {
    let books = books();
    let (_, _, step) = two_lanes(&books);
    let good = step.report;
    for wrong in [
        StepReport { frame: NO_FRAME, ..good },
        StepReport { ended: 9, ..good },
        StepReport { ended: EpisodeEnd::Complete as u8, ..good },
        StepReport { ended: EpisodeEnd::Complete as u8, frame: NO_FRAME, ..good },
        StepReport { conflict: 2, ..good },
        StepReport { sub_goals: 3, ..good },
    ] {
        let (mut lanes, ..) = two_lanes(&books);
        let error = lanes.reported(&wrong, &[]).unwrap_err();
        assert!(matches!(error, AnswerError::Invalid { role: Role::Sim, .. }), "{error}");
    }
    let (mut lanes, ..) = two_lanes(&books);
    let later = StepReport { step: 1, ..good };
    assert!(matches!(lanes.reported(&later, &[]), Err(AnswerError::Unexpected { .. })));
}

/// A stream of one case in two worlds: unchanged, and with another variant, in which its original demonstration is stale.
fn in_streams(mut books: Books, case: usize) -> Books {
    let book = &mut books.cases.book;
    let reference = book.cases[case].reference(Start::New, Route::Unchanged).unwrap().clone();
    let block = |world| StreamBlock { world, cases: vec![case as u32] };
    let state = |invalidated| CaseInState {
        begin: reference.begin,
        actions: reference.actions.clone(),
        length: reference.length,
        invalidated,
    };
    let states = [false, true].map(|invalidated| [(case as u32, state(invalidated))].into());
    book.streams = Some(StreamsFacts {
        hash: String::new(),
        streams: vec![StreamFacts { blocks: vec![block(0), block(1)], shuffled: vec![1, 0] }],
        variants: vec![0, 102],
        states: states.into(),
    });
    let own = books.demonstrations.book.cases[case].own[0];
    book.stale = [(0, [].into()), (102, [own].into())].into();
    books
}

/// A learning episode of that stream: its position is also that of its block.
fn learning(books: &Books, case_index: usize, position: u32) -> PlannedEpisode {
    let mut episode = episode(books, case_index, Start::New, Route::Unchanged);
    episode.key.condition.memory = Representation::Adaptive.into();
    episode.key.condition.arm = Arm::Learning;
    episode.key.place = Some(StreamPlace { stream: 0, order: StreamOrder::Drawn, position });
    let part = StreamPart {
        sequence: sequence_id(&episode.key.sequence().unwrap()),
        block: position,
        place: position,
        after: position,
        round: Some(1),
        world: position,
        feedback: FeedbackLevel::Success,
        snapshot: [0; 16],
    };
    PlannedEpisode { part: Some(part), ..episode }
}

fn source(case: u32, demonstration: u16) -> RecalledSource {
    RecalledSource { case, demonstration, first: 3, steps: 1, ..Zeroable::zeroed() }
}

/// Runs an episode of the stream, whose task is complete after `steps` steps; memory recalls `sources` at every one. In world 1
/// its actions do not complete its task if they took place in world 0.
fn learn(
    lanes: &mut Lanes<'_>,
    (episode, steps): (PlannedEpisode, u32),
    sources: &[RecalledSource],
    snapshot: [u8; 16],
) -> FinishedEpisode {
    let part = episode.part.unwrap();
    let opening = lanes.begin(0, episode);
    assert_eq!((opening.memory.learns, opening.memory.sequence), (1, part.sequence));
    assert_eq!(opening.memory.variant, if part.world == 0 { 0 } else { 102 });
    assert_eq!((opening.world.variant, opening.world.learns), (opening.memory.variant, 1));
    assert_eq!((opening.world.sequence, opening.world.start), (part.sequence, 1));
    let mut sim = ScriptedSim::default();
    let of = SnapshotReport {
        episode: opening.world.episode,
        snapshot,
        store_bytes: 99,
        ..Zeroable::zeroed()
    };
    assert!(matches!(lanes.learned(&of), Err(AnswerError::Unexpected { .. })), "too early");
    let limited = shm_types::message::WorldEpisodeConfig { max_steps: steps, ..opening.world };
    let mut step = sim.begin(&limited);
    loop {
        let completes = |step: &mut ScriptedStep| {
            complete_after(step, steps);
            if let Some(facts) = &mut step.facts {
                let reached = if part.world == 0 { vec![0] } else { vec![0, 102] };
                facts.completes_in = Some(reached.into_iter().collect());
            }
        };
        let turn = report(lanes, &step, completes).unwrap();
        assert!(matches!(turn, Turn::Wait), "memory has to recall, or to learn");
        if step.report.step == steps {
            assert_eq!(lanes.pending(0)[0].role, Role::Memory);
            return match lanes.learned(&of).unwrap() {
                Turn::Finished(finished) => *finished,
                turn => panic!("{turn:?}"),
            };
        }
        let mut trace = trace(&step.observation);
        trace.sources_len = sources.len() as u32;
        trace.sources[..sources.len()].copy_from_slice(sources);
        lanes.recalled(&trace).unwrap();
        match lanes.decided(&decision(&step.observation, Action::TurnLeft)).unwrap() {
            Turn::Command(next) => step = sim.step(&next),
            turn => panic!("{turn:?}"),
        }
    }
}

#[test]
fn an_episode_of_a_stream_takes_place_in_its_world_and_ends_with_its_snapshot() {
    let case = 3;
    let books = in_streams(books(), case);
    let mut lanes = Lanes::new(&books, RULES, 1);
    let own = source(case as u32, 0);
    let steps = learning(&books, case, 0).expert(&books.cases.book).unwrap().length;
    let first = learn(&mut lanes, (learning(&books, case, 0), steps), &[own], [1; 16]);
    let record = &first.record;
    assert!(record.is_success() && record.steps == record.reference);
    let stream = record.stream.as_ref().unwrap();
    assert_eq!((stream.retrievals, stream.stale, stream.invalidated), (record.steps, 0, false));
    assert_eq!(stream.snapshot, Some("01".repeat(16)));
    assert_eq!(record.shared_facts().completes_in, Some([0].into()));
    assert_eq!((stream.store_bytes, first.episode.part.unwrap().snapshot), (Some(99), [1; 16]));
    let [learned] = &lanes.learned_episodes()[..] else { panic!("one episode") };
    assert_eq!((learned.position, learned.case, learned.variant), (0, case as u32, 0));
    assert_eq!(learned.start, Start::New);
    let world = &books.cases.book.world.declaration;
    assert_eq!(world.letters(learned.actions.iter().copied()), record.actions);

    // In the other world the demonstration and the own experience are stale.
    let sources = [own, source(0, EXPERIENCE)];
    let second = learn(&mut lanes, (learning(&books, case, 1), steps), &sources, [2; 16]);
    let record = &second.record;
    assert_eq!(record.reference, record.steps);
    let stream = record.stream.as_ref().unwrap();
    assert_eq!((stream.retrievals, stream.stale), (2 * record.steps, 2 * record.steps));
    assert!(stream.invalidated && stream.after == 1 && stream.world == 1);
    assert!(record.retrieved.as_ref().unwrap().starts_with("o3+e0:3 o3+e0:3"));

    // The same from the log, in another session.
    let planned = [learning(&books, case, 0), learning(&books, case, 1)];
    let book = &books.cases.book;
    let remaining = Remaining::of(book, &planned, std::slice::from_ref(&first.record)).unwrap();
    assert_eq!(remaining.missing.len(), 1);
    assert_eq!(remaining.missing[0].part.unwrap().snapshot, [1; 16]);
    let mut resumed = Lanes::new(&books, RULES, 1);
    for (sequence, position, experience) in remaining.learned {
        resumed.remember(sequence, position, experience);
    }
    let again = learn(&mut resumed, (remaining.missing[0].clone(), steps), &sources, [2; 16]);
    assert_eq!(again.record, second.record);
    let error = Remaining::of(book, &planned, &[second.record]).unwrap_err().to_string();
    let missing = "the log lacks adaptive/new/unchanged/original/learning/run1/s0-drawn-000/";
    assert!(error.starts_with(missing), "{error}");
    let mut earlier = first.record;
    earlier.world.remove("completes_in");
    let error = Remaining::of(book, &planned, &[earlier]).unwrap_err().to_string();
    assert!(error.contains("an earlier version has written it"), "{error}");
}
