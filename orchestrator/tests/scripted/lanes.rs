//! Lanes against a scripted simulator, memory and policy: no process, no shared memory.

use bytemuck::Zeroable;
use case_book::{CaseBook, CaseInState, StreamsFacts};
use conformance::messages::{self, recall_trace};
use conformance::scripted::{ScriptedSim, request};
use domain::{
    Action, Arm, Feedback, FeedbackLevel, Mixture, Outcome, Pose, Representation, StreamOrder,
};
use orchestrator::lanes::{AnswerError, EpisodeOpening, FinishedEpisode, Lanes, Rules, Turn};
use orchestrator::plan::{PlannedEpisode, StreamPart, sequence_id};
use orchestrator::streams::{Remaining, Streams};
use results::conditions::{Condition, Demonstrations, Route, Start, Variation};
use results::key::{EpisodeKey, StreamPlace};
use results::log::Ending;
use shm_types::message::{
    Decision, EXPERIENCE, MemoryEpisodeConfig, NOT_MEASURED, Observation, RecallTrace,
    RecalledSource, Role, SnapshotReport,
};
use warehouse::stream::{Block, Stream};
use warehouse::{CaseSet, History, StreamSet, Variant, Warehouse, WorldChange, step};

use crate::common;

const RULES: Rules = Rules { max_steps: 200, ..common::RULES };

fn world() -> (CaseBook, Warehouse, CaseSet) {
    (common::book(), Warehouse::shipped(), CaseSet::shipped())
}

fn episode(cases: &CaseSet, case_index: usize, start: Start, route: Route) -> PlannedEpisode {
    let demonstrations = Demonstrations::ORIGINAL;
    let variation = Variation::STANDARD;
    let memory = Representation::Episodic.into();
    let condition = Condition { memory, start, route, demonstrations, variation, arm: Arm::Frozen };
    let case = cases.cases[case_index].id.clone();
    PlannedEpisode {
        key: EpisodeKey { condition, run: 1, place: None, case },
        case_index,
        seed: 7,
        part: None,
    }
}

/// The simulator: the same dynamics, from the commands alone.
fn sim(
    warehouse: &Warehouse,
    cases: &CaseSet,
) -> ScriptedSim<impl FnMut(u32, Pose, Action) -> (Pose, Feedback)> {
    ScriptedSim::new(move |variant, pose, action| {
        let closed = variant.checked_sub(1).map(|case| &cases.cases[case as usize].barricade);
        let variant = Variant::closing(closed.into_iter().flatten().copied());
        step(&warehouse.layout, &variant, pose, action)
    })
}

fn trace(of: &Observation) -> RecallTrace {
    recall_trace(request(of))
}

fn decision(of: &Observation, action: Action) -> Decision {
    Decision { images: 3, images_asked: 3, ..messages::decision(request(of), action) }
}

/// Runs one episode to its end; the policy answers by step number, `None` for an unreadable answer.
fn run(
    rules: Rules,
    start: Start,
    route: Route,
    case: usize,
    answer: impl Fn(usize) -> Option<Action>,
) -> FinishedEpisode {
    let (_, _, cases) = world();
    run_with_recall(rules, episode(&cases, case, start, route), answer, trace)
}

/// The same, with what memory recalls at each observation.
fn run_with_recall(
    rules: Rules,
    episode: PlannedEpisode,
    answer: impl Fn(usize) -> Option<Action>,
    recall: impl Fn(&Observation) -> RecallTrace,
) -> FinishedEpisode {
    let (book, warehouse, cases) = world();
    let mut lanes = Lanes::new(&book, (&warehouse, &cases), rules, 1);
    let opening = lanes.begin(0, episode);
    let mut sim = sim(&warehouse, &cases);
    let mut command = opening.command;
    loop {
        let observation = sim.observe(&command);
        match lanes.observed(&observation).unwrap() {
            Turn::Finished(finished) => return *finished,
            Turn::Command(next) => {
                command = next;
                continue;
            }
            Turn::Wait => {}
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
            Turn::Command(next) => command = next,
            turn => panic!("{turn:?}"),
        }
    }
}

#[test]
fn the_expert_completes_every_case_from_every_start_with_the_reference_s_length() {
    let rules = Rules { expert: true, ..RULES };
    let (_, _, cases) = world();
    for case in 0..cases.cases.len() {
        for (start, route) in [
            (Start::Original, Route::Unchanged),
            (Start::New, Route::Unchanged),
            (Start::New, Route::Blocked),
        ] {
            let record = run(rules, start, route, case, |_| None).record;
            assert_eq!(record.ending, Ending::Complete, "{}", record.key);
            assert_eq!(record.steps, record.reference, "{}", record.key);
            assert_eq!(record.tried_closed, (route == Route::Blocked).then_some(false));
            assert_eq!((record.requests, record.images), (None, None));
            assert_eq!(record.sub_goals.len() as u32, record.required);
            assert_eq!(record.blocked_moves, Vec::<u32>::new());
            let visited: Vec<u32> = record.visits.iter().map(|visit| visit.step).collect();
            // Only a return is no visit: it may lead to any cell.
            let returns = u32::from(cases.cases[case].task.returns_to_origin());
            let met = &record.sub_goals[..(record.required - returns) as usize];
            assert!(met.iter().all(|step| visited.contains(step)), "{}: {visited:?}", record.key);
            // What is reached facing it was seen; the step that completes the task shows nothing any more.
            assert!(!record.first_seen.is_empty(), "{}", record.key);
        }
    }
}

#[test]
fn an_episode_ends_at_the_limit_and_counts_what_happened() {
    let turning = |step| (step != 4).then_some(Action::TurnLeft);
    let rules = Rules { max_steps: 9, ..RULES };
    let finished = run(rules, Start::Original, Route::Unchanged, 0, turning);
    let record = finished.record;
    assert_eq!((record.ending, record.steps), (Ending::OutOfSteps, 9));
    assert_eq!(record.actions, "LLLL?LLLL");
    assert_eq!(record.start_pose, record.final_pose);
    assert_eq!((record.requests, record.images), (Some(9), Some(27)));
    assert_eq!((record.prompt_tokens, record.unread.unreadable), (None, 1));
    assert_eq!((record.retrieved, record.distance), (None, None));
    assert_eq!((record.required, record.visits, record.blocked_moves), (1, vec![], vec![]));
}

#[test]
fn the_log_says_whose_demonstration_each_match_is_of() {
    let (_, _, cases) = world();
    let mut episode = episode(&cases, 20, Start::New, Route::Unchanged);
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
        let record = run_with_recall(rules, episode.clone(), turning, recall).record;
        let [one, two] = cases.cases[20]
            .mixed(mixture)
            .map(|History { case, kind }| format!("{}:{}7", cases.cases[case].id, kind.letter()));
        assert_eq!(record.retrieved, Some(format!("o7 p7 {one} {two} -")));
        assert_eq!(record.distances.as_deref(), Some("0 0.25 - 0.75 -"));
        assert_eq!(record.distance, Some(0.333_333));
    }
}

#[test]
fn a_try_to_enter_the_barricade_is_recorded() {
    let (_, _, cases) = world();
    // The unblocked reference runs into the passage that was closed on it.
    for (index, case) in cases.cases.iter().enumerate() {
        let actions = &case.test.actions;
        let answer = |step: usize| actions.get(step).copied().or(Some(Action::TurnLeft));
        let rules = Rules { max_steps: actions.len() as u32, ..RULES };
        let record = run(rules, Start::New, Route::Blocked, index, answer).record;
        assert!(!record.blocked_moves.is_empty(), "{}", record.key);
        assert_eq!(record.tried_closed, Some(true), "{}", record.key);
    }
}

#[test]
fn an_episode_config_follows_from_its_condition() {
    let (book, warehouse, cases) = world();
    let mut lanes = Lanes::new(&book, (&warehouse, &cases), RULES, 1);
    let mut told = |condition: &str| {
        let condition: Condition = condition.parse().unwrap();
        let case = cases.cases[3].id.clone();
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

/// Two lanes with an episode each; the first observation of lane 0.
fn two_lanes<'w>(
    book: &'w CaseBook,
    warehouse: &'w Warehouse,
    cases: &'w CaseSet,
) -> (Lanes<'w>, EpisodeOpening, Observation) {
    let mut lanes = Lanes::new(book, (warehouse, cases), RULES, 2);
    let opening = lanes.begin(0, episode(cases, 0, Start::Original, Route::Unchanged));
    lanes.begin(1, episode(cases, 1, Start::Original, Route::Unchanged));
    let mut sim = sim(warehouse, cases);
    let observation = sim.observe(&opening.command);
    (lanes, opening, observation)
}

#[test]
fn answers_out_of_turn_are_errors_and_change_nothing() {
    let (book, warehouse, cases) = world();
    let (mut lanes, opening, observation) = two_lanes(&book, &warehouse, &cases);
    let answer = decision(&observation, Action::Forward);
    let ahead = Decision { step: 1, ..answer };
    assert!(matches!(
        lanes.decided(&ahead),
        Err(AnswerError::Unexpected { role: Role::Policy, .. })
    ));
    assert!(matches!(lanes.observed(&observation), Ok(Turn::Wait)));
    assert!(matches!(
        lanes.observed(&observation),
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
    let late = Decision { episode: opening.command.episode + 100, ..answer };
    assert!(matches!(lanes.decided(&late), Ok(Turn::Wait)), "another episode");
    assert!(matches!(lanes.decided(&answer), Ok(Turn::Command(_))));
}

#[test]
fn progress_of_memory_restarts_the_wait_for_it() {
    let (book, warehouse, cases) = world();
    let (mut lanes, _, observation) = two_lanes(&book, &warehouse, &cases);
    lanes.observed(&observation).unwrap();
    let busy_ns = lanes.pending(0)[0].since_ns + 1_000_000_000_000;
    let [memory, sim] = lanes.pending(busy_ns)[..] else { panic!("both lanes wait") };
    assert_eq!((memory.role, memory.lane, memory.since_ns), (Role::Memory, 0, busy_ns));
    assert_eq!((sim.role, sim.since_ns < busy_ns), (Role::Sim, true));
}

#[test]
fn an_answer_may_overtake_what_it_answers() {
    let (book, warehouse, cases) = world();
    let (mut lanes, _, observation) = two_lanes(&book, &warehouse, &cases);
    let (answer, trace) = (decision(&observation, Action::Forward), trace(&observation));
    assert!(matches!(lanes.decided(&answer), Ok(Turn::Wait)));
    assert!(lanes.has_early_decision());
    assert!(
        matches!(lanes.decided(&answer), Err(AnswerError::Unexpected { .. })),
        "one answer a step"
    );
    assert!(matches!(lanes.recalled(&trace), Ok(Turn::Wait)));
    assert!(matches!(lanes.observed(&observation), Ok(Turn::Command(_))));
    assert!(!lanes.has_early_decision());
    let [stamps] = lanes.take_stepped().collect::<Vec<_>>()[..] else { panic!("one step") };
    assert_eq!((stamps.lane, stamps.step), (0, 0));
}

#[test]
fn the_cost_of_an_answer_is_counted_once() {
    let (book, warehouse, cases) = world();
    let (mut lanes, _, observation) = two_lanes(&book, &warehouse, &cases);
    let asked = Decision {
        attempts: 2,
        prompt_tokens: 900,
        completion_tokens: 3,
        memory_tokens: NOT_MEASURED,
        images_asked: 5,
        ..decision(&observation, Action::TurnLeft)
    };
    lanes.observed(&observation).unwrap();
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
    let (book, warehouse, cases) = world();
    let (mut lanes, _, observation) = two_lanes(&book, &warehouse, &cases);
    let unmeasured = Decision {
        attempts: NOT_MEASURED,
        images: NOT_MEASURED,
        images_asked: NOT_MEASURED,
        ..decision(&observation, Action::TurnLeft)
    };
    lanes.observed(&observation).unwrap();
    lanes.recalled(&trace(&observation)).unwrap();
    assert!(matches!(lanes.decided(&unmeasured), Ok(Turn::Command(_))));
    assert!(lanes.take_answered().is_empty(), "no model was asked, as far as is known");
}

#[test]
fn an_invalid_answer_costs_its_own_episode_and_no_other() {
    let (book, warehouse, cases) = world();
    let (mut lanes, _, observation) = two_lanes(&book, &warehouse, &cases);
    lanes.observed(&observation).unwrap();
    lanes.recalled(&trace(&observation)).unwrap();
    let good = decision(&observation, Action::Forward);
    for invalid in [Decision { action: 99, ..good }, Decision { outcome: 9, ..good }] {
        assert!(matches!(lanes.decided(&invalid), Err(AnswerError::Invalid { lane: 0, .. })));
    }
    assert_eq!(lanes.give_up(0).map(|episode| episode.case_index), Some(0));
    assert_eq!((lanes.busy(), lanes.free()), (1, Some(0)));
    let again = lanes.begin(0, episode(&cases, 0, Start::Original, Route::Unchanged));
    assert!(again.command.episode > observation.episode, "ids are not used twice");
    assert!(matches!(lanes.decided(&good), Ok(Turn::Wait)), "the old answer is late");
}

#[test]
fn a_simulator_that_disagrees_is_found() {
    let (book, warehouse, cases) = world();
    let (_, opening, observation) = two_lanes(&book, &warehouse, &cases);
    let elsewhere = Pose::try_from(opening.command.start).unwrap();
    let elsewhere = Pose { heading: elsewhere.heading.right(), ..elsewhere };
    for wrong in [
        Observation { pose: elsewhere.into(), ..observation },
        Observation { step: 1, ..observation },
        Observation { feedback: Feedback::Moved as u8, ..observation },
        Observation { frame: 0, ..observation },
    ] {
        let (mut lanes, _, _) = two_lanes(&book, &warehouse, &cases);
        assert!(matches!(lanes.observed(&wrong), Err(AnswerError::Disagrees { .. })), "{wrong:?}");
    }
}

/// A stream of one case in two worlds: unchanged, and with its own barricade.
fn streams(warehouse: &Warehouse, cases: &CaseSet, case: usize) -> Streams {
    let closed = cases.cases[case].barricade.clone();
    let block = |world| Block { world, cases: vec![case as u32], events: Vec::new() };
    let set = StreamSet {
        seed: 1,
        worlds: vec![WorldChange::default(), WorldChange { closed, stock: Vec::new() }],
        streams: vec![Stream { blocks: vec![block(0), block(1)] }],
    };
    Streams::new(warehouse, cases, set).unwrap()
}

/// A learning episode of that stream: its position is also that of its block.
fn learning(cases: &CaseSet, case_index: usize, position: u32) -> PlannedEpisode {
    let mut episode = episode(cases, case_index, Start::New, Route::Unchanged);
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

/// Runs an episode of the stream in which the policy follows the reference and memory recalls `sources` at every step.
fn learn(
    lanes: &mut Lanes<'_>,
    streams: &Streams,
    episode: PlannedEpisode,
    sources: &[RecalledSource],
    snapshot: [u8; 16],
) -> FinishedEpisode {
    let (_, warehouse, _) = world();
    let part = episode.part.unwrap();
    let actions = streams.case(part.world, episode.case_index).reference.actions.clone();
    let opening = lanes.begin(0, episode);
    assert_eq!((opening.memory.learns, opening.memory.sequence), (1, part.sequence));
    assert_eq!(opening.memory.variant, if part.world == 0 { 0 } else { 1 + 100 + part.world });
    assert_eq!(opening.memory.variant, opening.command.variant);
    let variant = streams.state(part.world).variant.clone();
    let mut sim =
        ScriptedSim::new(move |_, pose, action| step(&warehouse.layout, &variant, pose, action));
    let report = SnapshotReport {
        episode: opening.command.episode,
        snapshot,
        store_bytes: 99,
        ..Zeroable::zeroed()
    };
    assert!(matches!(lanes.learned(&report), Err(AnswerError::Unexpected { .. })), "too early");
    let mut command = opening.command;
    loop {
        let observation = sim.observe(&command);
        assert!(matches!(lanes.observed(&observation).unwrap(), Turn::Wait), "memory has to learn");
        if command.last != 0 {
            assert_eq!(lanes.pending(0)[0].role, Role::Memory);
            return match lanes.learned(&report).unwrap() {
                Turn::Finished(finished) => *finished,
                turn => panic!("{turn:?}"),
            };
        }
        let mut trace = trace(&observation);
        trace.sources_len = sources.len() as u32;
        trace.sources[..sources.len()].copy_from_slice(sources);
        lanes.recalled(&trace).unwrap();
        let answer = decision(&observation, actions[observation.step as usize]);
        match lanes.decided(&answer).unwrap() {
            Turn::Command(next) => command = next,
            turn => panic!("{turn:?}"),
        }
    }
}

#[test]
fn an_episode_of_a_stream_takes_place_in_its_world_and_ends_with_its_snapshot() {
    let (mut book, warehouse, cases) = world();
    // A case whose original demonstration and test reference both use the passage.
    let case = (0..cases.cases.len())
        .find(|&index| {
            let streams = streams(&warehouse, &cases, index);
            let found = &cases.cases[index];
            streams.case(1, index).invalidated
                && !streams.state(1).completes(&found.test, &found.task)
        })
        .unwrap();
    let streams = streams(&warehouse, &cases, case);
    let of_world = |world| CaseInState {
        begin: streams.case(world, case).reference.start,
        actions: streams.case(world, case).reference.actions.clone(),
        length: streams.case(world, case).length,
        invalidated: streams.case(world, case).invalidated,
    };
    book.streams = Some(StreamsFacts {
        hash: String::new(),
        streams: Vec::new(),
        variants: vec![0, 102],
        states: [0, 1].map(|world| [(case as u32, of_world(world))].into()).into(),
    });
    let mut lanes = Lanes::new(&book, (&warehouse, &cases), RULES, 1).in_streams(&streams);
    let own = source(case as u32, 0);
    let first = learn(&mut lanes, &streams, learning(&cases, case, 0), &[own], [1; 16]);
    let record = &first.record;
    assert_eq!(record.check(200), Ok(()));
    assert!(record.is_success() && record.steps == record.reference);
    let stream = record.stream.as_ref().unwrap();
    assert_eq!((stream.retrievals, stream.stale, stream.invalidated), (record.steps, 0, false));
    assert_eq!(stream.snapshot, Some("01".repeat(16)));
    assert_eq!((stream.store_bytes, first.episode.part.unwrap().snapshot), (Some(99), [1; 16]));

    // In the closed world the demonstration and the own experience are stale.
    let sources = [own, source(0, EXPERIENCE)];
    let second = learn(&mut lanes, &streams, learning(&cases, case, 1), &sources, [2; 16]);
    let record = &second.record;
    assert_eq!(record.check(200), Ok(()));
    assert_eq!(record.reference, streams.case(1, case).length);
    assert!(record.is_success() && record.reference > first.record.reference);
    let stream = record.stream.as_ref().unwrap();
    assert_eq!((stream.retrievals, stream.stale), (2 * record.steps, 2 * record.steps));
    assert!(stream.invalidated && stream.after == 1 && stream.world == 1);
    assert!(record.retrieved.as_ref().unwrap().starts_with("o3+e0:3 o3+e0:3"));

    // The same from the log, in another session.
    let planned = [learning(&cases, case, 0), learning(&cases, case, 1)];
    let remaining = Remaining::of(&planned, std::slice::from_ref(&first.record)).unwrap();
    assert_eq!(remaining.missing.len(), 1);
    assert_eq!(remaining.missing[0].part.unwrap().snapshot, [1; 16]);
    let mut resumed = Lanes::new(&book, (&warehouse, &cases), RULES, 1).in_streams(&streams);
    for (sequence, position, experience) in remaining.learned {
        resumed.remember(sequence, position, experience);
    }
    let again = learn(&mut resumed, &streams, remaining.missing[0].clone(), &sources, [2; 16]);
    assert_eq!(again.record, second.record);
    let error = Remaining::of(&planned, &[second.record]).unwrap_err().to_string();
    let first = "the log lacks adaptive/new/unchanged/original/learning/run1/s0-drawn-000/";
    assert!(error.starts_with(first), "{error}");
}
