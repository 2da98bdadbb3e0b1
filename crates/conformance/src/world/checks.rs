//! The checks of a world, in the order in which they run.

use bytemuck::Zeroable;
use case_book::CaseFacts;
use case_book::act::{
    ActAnswer, ActRequest, ActedEpisode, DemonstrationsRequest, EpisodeParts, EpisodeRequest,
};
use domain::{ActionCode, Demonstrations, FeedbackCode, Route, Start, State};
use shm_types::message::{
    EpisodeEnd, NO_FRAME, RequestId, StepCommand, ViewRequest, WorldEpisodeConfig,
};

use super::books::{self, WorldBooks};
use super::{Begin, Seen, TestedWorld, WorldRole, command};
use crate::LANES;
use crate::checks::{Check, clear_away};
use crate::subject::{CheckResult, Trouble, next, wrong};

type WorldKit<'a> = crate::Kit<'a, WorldRole>;

/// Checks without which the others make no sense.
pub(crate) const REQUIRED_CHECKS: usize = 2;

/// A step limit that no reference reaches.
const MANY_STEPS: u32 = 100_000;

/// Steps of a short episode.
const FEW_STEPS: u32 = 3;

/// All checks. If one of the first [`REQUIRED_CHECKS`] fails, the others are skipped.
pub(crate) const CHECKS: &[Check<WorldRole>] = &[
    Check {
        name: "writes its case book",
        expected: "`book --request FILE --out DIR` writes a valid declaration, cases with references from the original and \
                   the new start, and demonstrations with consistent lists; the same text for the same request",
        advice: "with an SDK, correct what the message names; without an SDK, write case-book.json and demonstrations.json \
                 without times and without an order that changes",
        run: writes_its_book,
    },
    Check {
        name: "joins",
        expected: "`serve --demonstrations FILE` joins the run in $MEMTRANSFER_ATTACH and sends a handshake: role, wire \
                   version, name",
        advice: "with an SDK, give the program's arguments to `program::run`; loading may take as long as --start-timeout",
        run: |kit| Ok(kit.subject()?.introduction.clone()),
    },
    Check {
        name: "begins as its case book says",
        expected: "for each case, start and variant of the case book: the observation of step 0 has the state of the case \
                   book, the first feedback, and a frame",
        advice: "set the state that `case`, `start` and `variant` of the config name, and begin nowhere else",
        run: begins_as_said,
    },
    Check {
        name: "begins the same again",
        expected: "the same config in two lanes leads to the same state, state hash and pixels; skipped for a world that says \
                   that it is not deterministic",
        advice: "draw everything at random from the config's `seed`, keep nothing from earlier episodes; otherwise declare \
                 `is_deterministic` false",
        run: begins_the_same_again,
    },
    Check {
        name: "completes its references",
        expected: "the actions of each reference complete all sub-goals after as many steps as the case book says",
        advice: "execute actions exactly as for the case book; an episode ends once all sub-goals are complete",
        run: completes_references,
    },
    Check {
        name: "begins anew only when asked",
        expected: "a command after the end of an episode is reported and not executed; the next config begins as before",
        advice: "never reset by yourself: an episode that has ended stays so until the next config of its lane",
        run: ends_and_begins_anew,
    },
    Check {
        name: "stops at the step limit",
        expected: "an episode ends after `max_steps` steps: `ended` is the step limit, `last` 1, and there is no frame",
        advice: "compare the number of steps with `max_steps` of the config",
        run: stops_at_the_limit,
    },
    Check {
        name: "stays without an action",
        expected: "a step without an action changes neither state nor picture, and has the last feedback",
        advice: "do not step the simulator for a command whose `kind` is 1",
        run: stays,
    },
    Check {
        name: "shows what changes",
        expected: "frames of the run's size, opaque, with the hash of their pixels; not all frames of an episode are equal if \
                   states change",
        advice: "draw the state after the action into red, green, blue and alpha, alpha 255; equal state hashes mean equal \
                 pictures",
        run: shows_changes,
    },
    Check {
        name: "blocks the way",
        expected: "in the blocked variant of a case, actions of its expert lead elsewhere or show something else than in the \
                   unchanged world; skipped if no case has one",
        advice: "apply the variant of the config: `variant` 0 is the unchanged world, 1 + case that in which the case's way is \
                 blocked",
        run: blocks_the_way,
    },
    Check {
        name: "shows memory what lanes see",
        expected: "the views of three steps of a demonstration that memory asks for are those that a lane sees there",
        advice: "render what memory asks for as what agents see: the same camera, size and variant",
        run: shows_memory_the_same,
    },
    Check {
        name: "survives invalid messages",
        expected: "an error report for each invalid message and nothing else; its lane and all others go on",
        advice: "check lane, case, variant, action, episode and step before use; send an `ErrorReport`, drop the message, go on",
        run: invalid_messages,
    },
    Check {
        name: "acts out episodes",
        expected: "`act` acts out references and demonstrations with the states of the case book",
        advice: "answer each line of stdin with a line on stdout, by the same simulator as in a run",
        run: acts_out,
    },
    Check {
        name: "can be restarted",
        expected: "after a kill in the middle of an episode, it takes part in the next generation and begins as before",
        advice: "leave nothing behind that prevents a second start: no lock file, no fixed port",
        run: restart,
    },
    Check::STOPS,
    Check::ENDS_WITH_THE_ORCHESTRATOR,
    Check::REFUSES_ANOTHER_WIRE_VERSION,
];

fn writes_its_book(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    let books = books::write(kit)?;
    let world = &books.cases.world.declaration;
    let (cases, demonstrations) =
        (books.cases.cases.len(), books.demonstrations.demonstrations.len());
    let not = if world.is_deterministic { "" } else { "not " };
    let (name, version) = (&world.name, &world.version);
    Ok(format!(
        "{name} {version}: {cases} cases, {demonstrations} demonstrations, {not}deterministic"
    ))
}

/// Skips a check that compares what a world does with what it did before.
fn needs_determinism(books: &WorldBooks) -> CheckResult<()> {
    match books.is_deterministic() {
        true => Ok(()),
        false => Err(Trouble::NotApplicable("it says that it is not deterministic".to_owned())),
    }
}

/// Every reference of `cases`: how it begins, and the reference.
fn references<'a>(
    cases: &[(usize, &'a CaseFacts)],
) -> Vec<(Begin, &'a CaseFacts, &'a case_book::Reference)> {
    let of_case = |&(index, case): &(usize, &'a CaseFacts)| {
        case.references.iter().map(move |of| (Begin::of(index, of), case, of))
    };
    cases.iter().flat_map(of_case).collect()
}

fn begins_as_said(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    let books = WorldBooks::of(kit)?;
    let subject = kit.subject()?;
    let every: Vec<_> = books.cases.cases.iter().enumerate().collect();
    let begins = references(&every);
    for some in begins.chunks(LANES as usize) {
        let begun: CheckResult<Vec<RequestId>> = (0..LANES)
            .zip(some)
            .map(|(lane, (begin, ..))| subject.begin(lane, *begin, MANY_STEPS))
            .collect();
        let begun = begun?;
        subject.wait()?;
        for (&id, &(begin, case, reference)) in begun.iter().zip(some) {
            let words = begin.words(case);
            check_begin(&subject.answer(id)?, reference.begin)
                .or_else(|problem| wrong(format_args!("{words}: {problem}")))?;
        }
    }
    clear_away(subject)?;
    Ok(format!("{} begins", begins.len()))
}

fn check_begin(seen: &Seen, begin: State) -> Result<(), String> {
    let observation = &seen.observation;
    if observation.state != begin.padded() {
        return Err(format!(
            "it begins in {:?}, and the case book says {begin}",
            observation.state
        ));
    }
    if observation.feedback != FeedbackCode::START.0 {
        return Err(format!("its first feedback is {} in place of 0", observation.feedback));
    }
    match seen.is_last() {
        true => Err("the episode ends with its begin".to_owned()),
        false => Ok(()),
    }
}

fn begins_the_same_again(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    let books = WorldBooks::of(kit)?;
    needs_determinism(&books)?;
    let subject = kit.subject()?;
    for (begin, case, _) in references(&books.tested()) {
        let mut seen = Vec::new();
        // In the second lane, another episode has gone before.
        for lane in [5, 6] {
            seen.push(subject.begin_and_wait(lane, begin, MANY_STEPS)?.1);
        }
        let words = begin.words(case);
        if seen[0].perceived() != seen[1].perceived() {
            return wrong(format_args!("{words}: another state or picture in another lane"));
        }
        let hashes = [seen[0].state_hash(), seen[1].state_hash()];
        if hashes[0] != hashes[1] {
            return wrong(format_args!("{words}: the state hashes {hashes:?} in two lanes"));
        }
    }
    clear_away(subject)
}

/// Acts out a reference from its begin, to the end of the episode.
fn reference_episode(
    subject: &mut TestedWorld<'_>,
    lane: u32,
    begin: Begin,
    reference: &case_book::Reference,
) -> CheckResult<(RequestId, Vec<Seen>)> {
    subject.episode(lane, begin, &reference.actions, MANY_STEPS)
}

fn completes_references(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    let books = WorldBooks::of(kit)?;
    needs_determinism(&books)?;
    let subject = kit.subject()?;
    let tested = books.tested();
    let references = references(&tested);
    for (number, &(begin, case, reference)) in (0..).zip(&references) {
        let (_, seen) = reference_episode(subject, number % LANES, begin, reference)?;
        let (steps, ended) = (seen.len() - 1, seen.last().map_or(0, Seen::ended));
        let words = begin.words(case);
        if ended != EpisodeEnd::Complete as u8 {
            return wrong(format_args!(
                "{words}: the reference does not complete the task in {steps} steps"
            ));
        }
        if steps != reference.length as usize {
            return wrong(format_args!(
                "{words}: the reference completes the task in {steps} steps, and the case book says {}",
                reference.length
            ));
        }
    }
    clear_away(subject)?;
    Ok(format!("{} references of {} cases", references.len(), tested.len()))
}

/// The first case at its original start, with its reference.
fn first(books: &WorldBooks) -> CheckResult<(Begin, &case_book::Reference)> {
    let reference = books
        .cases
        .cases
        .first()
        .and_then(|case| case.reference(Start::Original, Route::Unchanged));
    reference.map_or_else(|| wrong("it has no cases"), |of| Ok((Begin::of(0, of), of)))
}

fn ends_and_begins_anew(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    let books = WorldBooks::of(kit)?;
    let (begin, reference) = first(&books)?;
    let subject = kit.subject()?;
    for by_limit in [true, false] {
        // Where the same actions may lead elsewhere, only the step limit is certain to end an episode.
        if !by_limit && !books.is_deterministic() {
            continue;
        }
        let most = if by_limit { 1 } else { MANY_STEPS };
        let (id, seen) = subject.episode(9, begin, &reference.actions, most)?;
        if !seen.last().is_some_and(Seen::is_last) {
            // Another check says so.
            continue;
        }
        let late = next(id);
        subject.expect_none(late);
        subject.neighbours.send(&command(late, Some(reference.actions[0])))?;
        subject.notify()?;
        wait_for_report(subject, "a command after the end of an episode")?;
        let (_, again) = subject.begin_and_wait(9, begin, MANY_STEPS)?;
        check_begin(&again, reference.begin).or_else(wrong)?;
        if books.is_deterministic() && again.perceived() != seen[0].perceived() {
            return wrong("the next episode of the lane begins otherwise");
        }
    }
    clear_away(subject)
}

/// Waits for an error report about a message.
fn wait_for_report(subject: &mut TestedWorld<'_>, message: &str) -> CheckResult<()> {
    subject.listen_until(subject.terms.answer_timeout, TestedWorld::has_errors, |_| {
        format!("no error report about {message}")
    })?;
    subject.take_errors();
    Ok(())
}

fn stops_at_the_limit(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    let books = WorldBooks::of(kit)?;
    let (begin, _) = first(&books)?;
    let subject = kit.subject()?;
    let (mut id, _) = subject.begin_and_wait(3, begin, FEW_STEPS)?;
    for _ in 1..FEW_STEPS {
        id = next(id);
        if subject.step(id, None)?.is_last() {
            let step = id.step;
            return wrong(format_args!("the episode ends at step {step} of {FEW_STEPS}"));
        }
    }
    let seen = subject.step(next(id), None)?;
    if seen.ended() != EpisodeEnd::StepLimit as u8 || seen.observation.frame != NO_FRAME {
        return wrong(format_args!(
            "after {FEW_STEPS} steps without an action, of {FEW_STEPS}: `ended` is {} and `last` {}",
            seen.ended(),
            seen.observation.last
        ));
    }
    clear_away(subject)
}

fn stays(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    let books = WorldBooks::of(kit)?;
    let (begin, reference) = first(&books)?;
    let last_feedback = books.cases.world.declaration.not_understood();
    let subject = kit.subject()?;
    let (mut id, mut before) = subject.begin_and_wait(4, begin, MANY_STEPS)?;
    for action in [None, Some(reference.actions[0]), None] {
        id = next(id);
        let seen = subject.step(id, action)?;
        if seen.is_last() {
            break;
        }
        if action.is_none() {
            let ((state, feedback, pixels), (was, _, drawn)) =
                (seen.perceived(), before.perceived());
            if state != was {
                return wrong("the state is another one after a step without an action");
            }
            if pixels != drawn {
                return wrong("the picture is another one after a step without an action");
            }
            if feedback != last_feedback.0 {
                return wrong(format_args!(
                    "the feedback to a step without an action is {feedback} in place of {}",
                    last_feedback.0
                ));
            }
        }
        before = seen;
    }
    clear_away(subject)
}

fn shows_changes(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    let books = WorldBooks::of(kit)?;
    let subject = kit.subject()?;
    let mut pictures = 0;
    for (begin, case, reference) in references(&books.tested()) {
        let (_, seen) = reference_episode(subject, 2, begin, reference)?;
        let words = begin.words(case);
        let shown: Vec<&Seen> = seen.iter().filter(|seen| seen.picture.is_some()).collect();
        let problem = shown.iter().find_map(|seen| seen.picture.as_ref()?.problem.as_ref());
        if let Some(problem) = problem {
            return wrong(format_args!("{words}: {problem}"));
        }
        let state = |seen: &Seen| seen.observation.state;
        let states_differ = shown.iter().any(|seen| state(seen) != state(shown[0]));
        if states_differ && shown.iter().all(|seen| seen.pixels() == shown[0].pixels()) {
            let count = shown.len();
            return wrong(format_args!("{words}: {count} frames are equal, and states are not"));
        }
        pictures += shown.len();
    }
    clear_away(subject)?;
    Ok(format!("{pictures} frames"))
}

fn blocks_the_way(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    let books = WorldBooks::of(kit)?;
    needs_determinism(&books)?;
    let tested = books.tested();
    let blocked =
        |&&(_, case): &&(usize, &CaseFacts)| case.reference(Start::New, Route::Blocked).is_some();
    let cases: Vec<&(usize, &CaseFacts)> = tested.iter().filter(blocked).collect();
    if cases.is_empty() {
        return Err(Trouble::NotApplicable("no case has a blocked variant".to_owned()));
    }
    let subject = kit.subject()?;
    for &&(index, case) in &cases {
        let begin = |is_blocked| Begin { case: index as u32, start: Start::New, is_blocked };
        let mut differs = false;
        // Some may lead past what has changed.
        for route in [Route::Unchanged, Route::Blocked] {
            let Some(reference) = case.reference(Start::New, route) else { continue };
            let mut perceived = Vec::new();
            for is_blocked in [false, true] {
                let (_, seen) = reference_episode(subject, 8, begin(is_blocked), reference)?;
                perceived.push(seen.iter().map(Seen::perceived).collect::<Vec<_>>());
            }
            differs |= perceived[0] != perceived[1];
        }
        if !differs {
            return wrong(format_args!(
                "case {}: at its new start, neither the reference nor that of the blocked route leads to another state, \
                 feedback or picture in the blocked variant than in the unchanged world",
                case.id
            ));
        }
    }
    clear_away(subject)?;
    Ok(format!("{} cases", cases.len()))
}

fn shows_memory_the_same(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    let books = WorldBooks::of(kit)?;
    needs_determinism(&books)?;
    let Some((number, demonstration)) = books.first_demonstration() else {
        return wrong("it has no demonstration at an original start");
    };
    let begin = Begin { case: demonstration.case, start: Start::Original, is_blocked: false };
    let subject = kit.subject()?;
    let (_, seen) = subject.episode(1, begin, &demonstration.actions, MANY_STEPS)?;
    let seen: Vec<&Seen> = seen.iter().filter(|seen| !seen.is_last()).collect();
    for step in [0, seen.len() / 2, seen.len().saturating_sub(1)] {
        let Some(shown) = seen.get(step) else { return wrong("the episode ends with its begin") };
        let picture = subject.remembered((number, step as u32))?;
        if let Some(problem) = picture.problem {
            return wrong(format_args!("step {step} of demonstration {number}: {problem}"));
        }
        if picture.hash != shown.pixels() {
            return wrong(format_args!(
                "step {step} of demonstration {number}: memory gets another picture than a lane"
            ));
        }
    }
    clear_away(subject)
}

/// What is wrong with a message, by what it makes of a valid one.
enum Invalid<'a> {
    Config(&'a dyn Fn(&mut WorldEpisodeConfig)),
    Command(&'a dyn Fn(&mut StepCommand)),
    View(ViewRequest),
}

fn invalid_messages(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    use Invalid::{Command, Config, View};
    let books = WorldBooks::of(kit)?;
    let (begin, reference) = first(&books)?;
    let first_action = Some(reference.actions[0]);
    let undeclared = books.cases.world.declaration.actions.len() as u8;
    let subject = kit.subject()?;
    let (mut running, _) = subject.begin_and_wait(21, begin, MANY_STEPS)?;
    let (mut other, _) = subject.begin_and_wait(22, begin, MANY_STEPS)?;
    let view = ViewRequest::zeroed();
    let messages: [(&str, Invalid<'_>); 11] = [
        ("a config for lane 64 of 64", Config(&|of| of.lane = LANES)),
        ("a config of case 4294967295", Config(&|of| of.case = u32::MAX)),
        ("a config of variant 4000000000", Config(&|of| of.variant = 4_000_000_000)),
        ("a config with start 7", Config(&|of| of.start = 7)),
        ("a command for lane 64 of 64", Command(&|of| of.lane = LANES)),
        ("a command of kind 7", Command(&|of| of.kind = 7)),
        ("an action that is not declared", Command(&|of| of.action = undeclared)),
        ("a command that leaves out a step", Command(&|of| of.step += 1)),
        ("a command for a step that was taken", Command(&|of| of.step -= 1)),
        (
            "a request for a view of demonstration 4294967295",
            View(ViewRequest { demonstration: u32::MAX, ..view }),
        ),
        ("a view request of kind 7", View(ViewRequest { kind: 7, ..view })),
    ];
    for (what, message) in messages {
        let after = |trouble| match trouble {
            Trouble::Wrong(why) => Trouble::Wrong(format!("after {what}: {why}")),
            trouble => trouble,
        };
        match message {
            Config(spoil) => {
                let mut config = subject.config(24, begin, MANY_STEPS);
                spoil(&mut config);
                subject.neighbours.send(&config)?;
            }
            Command(spoil) => {
                let mut command = command(next(running), first_action);
                spoil(&mut command);
                subject.neighbours.send(&command)?;
            }
            View(request) => subject.neighbours.send(&request)?,
        }
        subject.notify()?;
        wait_for_report(subject, what).map_err(after)?;
        // The lane is where it was, and the others go on.
        for lane in [&mut running, &mut other] {
            *lane = next(*lane);
            subject.step(*lane, None).map_err(after)?;
        }
    }
    // What belongs to an episode that is over comes late, and is dropped.
    let late = next(running);
    (running, _) = subject.begin_and_wait(21, begin, MANY_STEPS)?;
    subject.expect_none(late);
    subject.neighbours.send(&command(late, first_action))?;
    subject.notify()?;
    subject.step(next(running), first_action)?;
    subject.listen()?;
    subject.take_errors();
    clear_away(subject)
}

fn acts_out(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    let books = WorldBooks::of(kit)?;
    needs_determinism(&books)?;
    let tested = books.tested();
    let references = references(&tested);
    let mut requests = vec![ActRequest::World];
    requests.extend(references.iter().map(|(begin, case, reference)| {
        let actions = &reference.actions[..reference.length as usize];
        ActRequest::Episode(EpisodeRequest {
            case: case.id.clone(),
            variant: if begin.is_blocked { 1 + begin.case } else { 0 },
            reference: Some((reference.start, reference.route)),
            begin: None,
            actions: actions.iter().copied().map(Some).collect(),
            stream: None,
            parts: EpisodeParts::default(),
        })
    }));
    requests.extend(tested.iter().map(|(_, case)| {
        ActRequest::Demonstrations(DemonstrationsRequest {
            case: case.id.clone(),
            set: Demonstrations::ORIGINAL,
            more: Vec::new(),
            variant: 0,
            planned: false,
        })
    }));
    let answers = books::act(kit, &requests)?;
    let ActAnswer::World(description) = &answers[0] else {
        return wrong(format_args!("`world` is answered with {}", kind(&answers[0])));
    };
    if description.world.declaration != books.cases.world.declaration {
        return wrong("`act` describes another world than the case book");
    }
    let (episodes, demonstrations) = answers[1..].split_at(references.len());
    for (answer, (begin, case, reference)) in episodes.iter().zip(&references) {
        let words = begin.words(case);
        let ActAnswer::Episode(acted) = answer else {
            return wrong(format_args!("{words}: an episode is answered with {}", kind(answer)));
        };
        check_acted(acted, reference)
            .or_else(|problem| wrong(format_args!("{words}: {problem}")))?;
    }
    for (answer, &(index, case)) in demonstrations.iter().zip(&tested) {
        let ActAnswer::Demonstrations(acted) = answer else {
            let kind = kind(answer);
            return wrong(format_args!(
                "demonstrations of case {} are answered with {kind}",
                case.id
            ));
        };
        let is_same = |of: &case_book::Demonstration| {
            acted.len() == 1
                && (&acted[0].states[..], &acted[0].feedback[..]) == (&of.states, &of.feedback)
        };
        if !books.original(index).is_some_and(is_same) {
            return wrong(format_args!(
                "the demonstration of case {} has other states than in the case book",
                case.id
            ));
        }
    }
    Ok(format!("{} episodes, {} demonstrations", episodes.len(), demonstrations.len()))
}

fn check_acted(acted: &ActedEpisode, reference: &case_book::Reference) -> Result<(), String> {
    let (states, length) = (&acted.states, reference.length as usize);
    if states.first() != Some(&reference.begin) {
        return Err(format!("it begins elsewhere than in {}", reference.begin));
    }
    if states.len() != length + 1 || acted.sub_goals.len() != acted.required as usize {
        let (steps, done) = (states.len() - 1, acted.sub_goals.len());
        let required = acted.required;
        return Err(format!("{steps} of {length} steps complete {done} of {required} sub-goals"));
    }
    Ok(())
}

/// What an answer is, in a sentence.
fn kind(answer: &ActAnswer) -> String {
    match answer {
        ActAnswer::Error(problem) => format!("an error: {problem}"),
        _ => "something else".to_owned(),
    }
}

fn restart(kit: &mut WorldKit<'_>) -> CheckResult<String> {
    let books = WorldBooks::of(kit)?;
    let (begin, reference) = first(&books)?;
    let actions: &[ActionCode] = &reference.actions[..1];
    let subject = kit.subject()?;
    let (_, before) = subject.episode(0, begin, actions, MANY_STEPS)?;
    subject.begin(1, begin, MANY_STEPS)?;
    subject.notify()?;
    kit.kill_subject();
    let subject = kit.subject()?;
    let (_, after) = subject.episode(0, begin, actions, MANY_STEPS)?;
    check_begin(&after[0], reference.begin).or_else(wrong)?;
    let perceived = |seen: &[Seen]| seen.iter().map(Seen::perceived).collect::<Vec<_>>();
    if books.is_deterministic() && perceived(&before) != perceived(&after) {
        return wrong("after a restart, the same episode has other states or pictures");
    }
    clear_away(subject)
}
