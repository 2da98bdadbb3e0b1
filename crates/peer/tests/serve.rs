//! The serve loop against scripted neighbours: orchestrator, simulator and memory in this process.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::fs;
use std::path::PathBuf;
use std::sync::mpsc;
use std::time::Duration;

use conformance::messages::{
    config, item, observation, recall, scripted_world, supplied, supply, text as whole_text,
};
use domain::hex;
use domain::prompt_log::{
    PromptLogEntry, RecordedExchange, RecordedItem, RecordedMessage, RecordedPart, entries_file,
    session_folder,
};
use domain::{Action, ActionCode, Feedback, Outcome};
use peer::{
    Answer, Answers, Batch, CaptionedView, Decider, Decision, FrameView, Item, Policy, Request,
    RequestId, ServeError, StepsView, Usage, serve,
};
use rigs::process::{LONG, PolicyRig};
use shm_types::documents::Content;
use shm_types::message::{
    self, ErrorReportKind, Handshake, ItemKind, NO_ACTION, NO_FRAME, Observation, Recall,
    RecalledInstruction, RecalledItem, Role, TrajectoryStep,
};
use shm_types::{Attach, Bus};

/// A run of four lanes in which `policy` serves, and the policy's handshake.
fn serving(policy: impl Decider + Send + 'static) -> (PolicyRig, Handshake) {
    serving_with_prompt_log(policy, None)
}

fn serving_with_prompt_log(
    mut policy: impl Decider + Send + 'static,
    prompts: Option<PathBuf>,
) -> (PolicyRig, Handshake) {
    let change = |attach: &mut Attach| (attach.frame_capacity, attach.prompts) = (32, prompts);
    let mut rig = PolicyRig::in_thread(change, move |folder| Ok(serve(&mut policy, folder)?));
    let handshake = rig.handshake();
    (rig, handshake)
}

fn id(lane: u32, episode: u64, step: u32) -> RequestId {
    RequestId { lane, episode, step }
}

#[test]
fn a_policy_takes_the_place_of_one_that_is_just_ending() {
    let (finished, _) = mpsc::channel();
    let mut rig = PolicyRig::in_thread(
        |_| {},
        |folder| {
            let ending = Bus::join(Attach::read(folder)?, Role::Policy)?;
            std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(100));
                drop(ending);
            });
            Ok(serve(&mut Recorder(finished), folder)?)
        },
    );
    rig.handshake();
    rig.stop();
}

/// Describes its requests, and refuses.
struct Recorder(mpsc::Sender<String>);

impl Policy for Recorder {
    fn name(&self) -> &str {
        "recorder"
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        vec![("sees", "all".to_owned())]
    }

    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision> {
        let grey = |frame: FrameView<'_>| {
            assert!(frame.pixels.iter().all(|&byte| byte == frame.pixels[0]));
            assert_eq!(frame.pixels.len(), 64 * 64 * 4);
            frame.pixels[0]
        };
        for request in batch {
            let window: Vec<_> = request
                .window
                .iter()
                .map(|past| (grey(past.frame), past.action, past.feedback))
                .collect();
            let items: Vec<_> = request.items.iter().map(|item| told(item, grey)).collect();
            let Request { lane, step, episode_seed, instruction, state, feedback, .. } = request;
            let hint = if request.starts_as_demonstrated { ", hinted" } else { "" };
            let frame = grey(request.frame);
            self.0
                .send(format!(
                    "lane {lane} step {step} seed {episode_seed} {instruction:?} at {state} \
                     {feedback:?} sees {frame} after {window:?} remembers [{}]{hint}",
                    items.join(", ")
                ))
                .unwrap();
        }
        batch
            .iter()
            .map(|request| Decision {
                answer: Answer::Refused,
                images: request.images(),
                usage: Some(Usage {
                    prompt_tokens: Some(100 + request.lane),
                    completion_tokens: Some(3),
                    attempts: 1,
                    ..Usage::default()
                }),
            })
            .collect()
    }

    fn reset(&mut self, lane: u32) {
        self.0.send(format!("reset {lane}")).unwrap();
    }
}

fn told(item: &Item<'_>, grey: impl Fn(FrameView<'_>) -> u8) -> String {
    match item {
        Item::Text(text) => format!("{:?} {:?}", text.kind, text.text),
        Item::Frame(CaptionedView { frame, caption, instruction }) => {
            format!("{} {caption:?} of {instruction:?}", grey(*frame))
        }
        Item::Steps(StepsView { distance, is_whole, instruction, steps }) => {
            let steps = steps.iter().map(|step| (step.frame.map(&grey), step.action));
            let what = if *is_whole { "whole" } else { "part" };
            format!("{what} of {instruction:?} at {distance:?} {:?}", steps.collect::<Vec<_>>())
        }
        Item::Plan(plan) => {
            let parts = plan.parts.iter();
            let parts = parts.map(|part| format!("{:?} {:?}", part.instruction, part.actions));
            format!("plan: {}", parts.collect::<Vec<_>>().join("; "))
        }
    }
}

#[test]
fn items_of_every_kind_reach_the_policy() {
    let (say, heard) = mpsc::channel();
    let (mut rig, _) = serving(Recorder(say));
    let (frame, view) = (rig.publish(10), rig.publish(40));
    let hinted = config(0, 9, "Find a cone.");
    let hinted = message::PolicyEpisodeConfig { starts_as_demonstrated: 1, ..hinted };
    rig.begin(&hinted);
    let step = |trajectory, frame, action| TrajectoryStep {
        frame,
        action,
        trajectory,
        own: 0,
        reserved: [0; 5],
    };
    let steps = vec![
        step(0, view, Action::Forward as u8),
        step(0, NO_FRAME, NO_ACTION),
        step(1, frame, NO_ACTION),
    ];
    let summary = rig.publish_document(&Content::Summary("a cone at (1, 2)".into()));
    let documents = &mut rig.neighbours.documents;
    let note = documents.publish(Some((0, 9)), &Content::Note("Zurück!".into())).unwrap();
    let steps = documents.publish(Some((0, 9)), &Content::Trajectories(steps)).unwrap();
    let foreign = Content::Trajectories(vec![step(0, view, 7)]);
    let foreign = documents.publish(Some((0, 9)), &foreign).unwrap();
    let own =
        |trajectory, own, action| TrajectoryStep { own, ..step(trajectory, NO_FRAME, action) };
    let planned = vec![
        own(0, 1, 4),
        own(0, 1, 0),
        own(1, 0, 2),
        own(2, 0, 2),
        own(3, 2, 0),
        own(4, 0, NO_ACTION),
    ];
    let planned = documents.publish(Some((0, 9)), &Content::Trajectories(planned)).unwrap();
    let plan = |first_step, steps_len, instructions| RecalledItem {
        document: planned,
        first_step,
        steps: steps_len,
        instructions,
        ..item(ItemKind::Plan)
    };
    let text = |document, first_byte, bytes| RecalledItem {
        document,
        first_byte,
        bytes,
        ..item(ItemKind::Text)
    };
    let trajectory = |first_step, steps_len, whole| RecalledItem {
        document: steps,
        first_step,
        steps: steps_len,
        whole,
        instructions: if steps_len == 3 { 2 } else { 1 },
        ..item(ItemKind::Trajectory)
    };
    let mut first = recall(id(0, 9, 0), &[view, frame]);
    supply(&mut first, text(summary, 0, 16), &[]);
    supply(&mut first, trajectory(0, 3, 1), &[]);
    let caption = RecalledItem { kind: ItemKind::Frame as u8, instructions: 1, ..text(note, 1, 6) };
    supply(&mut first, caption, &[supplied(view, None)]);
    supply(&mut first, item(ItemKind::Frame), &[supplied(frame, None)]);
    supply(&mut first, trajectory(1, 1, 0), &[]);
    let left = supplied(NO_FRAME, Some(Action::Left));
    supply(&mut first, RecalledItem { whole: 1, ..item(ItemKind::Steps) }, &[left; 2]);
    supply(&mut first, plan(0, 4, 2), &[]);
    // Of the segment, the two demonstrations, and the view with a caption; the others have none.
    let named = [(5, 8), (0, 5), (5, 8), (0, 5)];
    let tasks = Content::Note("Halt.Zurück!".into());
    let tasks = rig.neighbours.documents.publish(Some((0, 9)), &tasks).unwrap();
    for (instruction, (first_byte, bytes)) in first.instructions.iter_mut().zip(named) {
        *instruction = RecalledInstruction { document: tasks, first_byte, bytes };
    }
    // Of the demonstrations of the plan, the second has an instruction.
    first.instructions[8] = RecalledInstruction { document: tasks, first_byte: 0, bytes: 5 };
    rig.step(&observation(id(0, 9, 0), frame), &first);

    let decision = rig.decisions(1)[0];
    assert_eq!(decision.images, 7, "the current view, two retrieved, two keyframes, two captioned");
    assert_eq!(heard.recv().unwrap(), "reset 0");
    let told = heard.recv().unwrap().replace("], ", "],\n");
    insta::assert_snapshot!(told, @r#"
    lane 0 step 0 seed 0 "Find a cone." at 3,4,1 FeedbackCode(0) sees 10 after [] remembers [part of "Zurück!" at Some(0.125) [(Some(40), Some(ActionCode(4))), (Some(10), None)],
    Summary "a cone at (1, 2)", whole of "Halt." at None [(Some(40), Some(ActionCode(0))), (None, None)],
    whole of "Zurück!" at None [(Some(10), None)],
    40 "urück" of "Halt.", 10 "" of "", part of "" at None [(None, None)],
    whole of "" at None [(None, Some(ActionCode(2))), (None, Some(ActionCode(2)))],
    plan: None [ActionCode(4), ActionCode(0)]; Some("") [ActionCode(2)]; Some("Halt.") [ActionCode(2)]],
    hinted
    "#);

    // What a document does not have is reported, and the step stays open.
    let cases = [
        text(steps + 7, 0, 1),
        text(steps, 0, 1),
        text(note, 4, 1),
        text(note, 0, 99),
        text(note, u32::MAX, u32::MAX),
        RecalledItem { kind: ItemKind::Frame as u8, steps: 1, instructions: 1, ..text(note, 4, 9) },
        trajectory(2, 2, 1),
        RecalledItem { document: note, ..trajectory(0, 1, 1) },
        RecalledItem { document: foreign, ..trajectory(0, 1, 1) },
        RecalledItem { instructions: 1, ..trajectory(0, 3, 1) },
        RecalledItem { first_instruction: 9, ..trajectory(0, 1, 1) },
        plan(0, 4, 3),
        plan(0, 0, 0),
        plan(4, 1, 0),
        plan(5, 1, 1),
    ];
    let mut reports = Vec::new();
    for (step, bad) in (1..).zip(cases) {
        let mut next = Recall { step, items_len: 1, ..first };
        next.items[0] = bad;
        rig.step(&observation(id(0, 9, step), frame), &next);
        reports.extend(rig.error_texts(1));
    }
    insta::assert_snapshot!(reports.join("\n"), @r"
    recall for lane 0, step 1: item 0 names document 1099511627786, which was never published
    recall for lane 0, step 2: item 0 has text of document 1099511627779, which is of kind trajectories
    recall for lane 0, step 3: item 0 has the bytes 4..5 of document 1099511627778, which has 8 and no characters that begin and end there
    recall for lane 0, step 4: item 0 has the bytes 0..99 of document 1099511627778, which has 8 and no characters that begin and end there
    recall for lane 0, step 5: item 0 has the bytes 4294967295..8589934590 of document 1099511627778, which has 8 and no characters that begin and end there
    recall for lane 0, step 6: item 0 has the bytes 4..13 of document 1099511627778, which has 8 and no characters that begin and end there
    recall for lane 0, step 7: item 0 has the steps 2..4 of document 1099511627779 with 3
    recall for lane 0, step 8: item 0 has steps of document 1099511627778, which is of kind note
    recall for lane 0, step 9: item 0 has steps of document 1099511627780: 7 is not an action of this world
    recall for lane 0, step 10: item 0 has 1 instructions, expected 2
    recall for lane 0, step 11: item 0 has the instructions 9..10 of a message with 9
    recall for lane 0, step 12: item 0 has 3 instructions, expected 2
    recall for lane 0, step 13: item 0 has no steps
    recall for lane 0, step 14: item 0 has steps of document 1099511627781: 2 is not a flag (0 no, 1 yes)
    recall for lane 0, step 15: item 0 is a plan that has a step without action
    ");
    rig.stop();
}

/// Passes its requests to the test, which answers them.
struct Deferred(mpsc::Sender<(RequestId, Answers)>);

impl Decider for Deferred {
    fn name(&self) -> &str {
        "deferred"
    }

    fn take(&mut self, batch: &Batch<'_>, answers: &Answers) -> Result<(), ServeError> {
        batch.iter().for_each(|r| self.0.send((r.id(), answers.clone())).unwrap());
        Ok(())
    }
}

#[test]
fn answers_may_come_later_in_any_order_from_any_thread_or_not_at_all() {
    let (hand_over, taken) = mpsc::channel();
    let (mut rig, _) = serving(Deferred(hand_over));
    let frame = rig.publish(10);
    for lane in 0..4 {
        let first = id(lane, 50 + u64::from(lane), 0);
        rig.begin(&config(lane, first.episode, "Find a cone."));
        rig.step(&observation(first, frame), &recall(first, &[]));
    }
    let mut taken: Vec<(RequestId, Answers)> =
        (0..4).map(|_| taken.recv_timeout(LONG).unwrap()).collect();
    taken.sort_by_key(|(id, _)| id.lane);
    let decision = |action| Decision { answer: Answer::Act(action), images: 1, usage: None };
    let decide = |lane: usize, action| taken[lane].1.decide(taken[lane].0, decision(action));

    decide(3, Action::Right.into());
    assert_eq!(rig.decisions(1)[0].lane, 3);
    // Lane 2 begins another episode: the answer to the earlier one is late.
    rig.begin(&config(2, 62, "Find a barrel."));
    rig.notify();
    let no_such_lane = RequestId { lane: 77, ..taken[0].0 };
    taken[0].1.decide(no_such_lane, decision(Action::Left.into()));
    taken[1].1.fail(taken[1].0, "status 400: too many images");
    let (report, text) = rig.error_report();
    assert_eq!(
        (report.kind, report.lane, report.episode, text.as_str()),
        (ErrorReportKind::Episode as u32, 1, 51, "status 400: too many images")
    );
    decide(2, Action::Left.into());
    decide(3, Action::Left.into());
    decide(0, Action::Backward.into());
    let answered = rig.decisions(1);
    assert_eq!(answered.len(), 1, "late and repeated answers are dropped: {answered:?}");
    assert_eq!((answered[0].lane, answered[0].action), (0, Action::Backward as u8));

    taken[0].1.stop_run("the server is down");
    assert_eq!(rig.error_report().0.kind, ErrorReportKind::Run as u32);
    rig.stop();
}

#[test]
fn an_action_that_the_world_does_not_have_fails_its_episode_alone() {
    let (hand_over, taken) = mpsc::channel();
    let (mut rig, _) = serving(Deferred(hand_over));
    let frame = rig.publish(10);
    let world = scripted_world();
    let past_the_last = ActionCode(world.actions.len() as u8);
    for (lane, action) in [(0, past_the_last), (1, ActionCode(u8::MAX)), (2, ActionCode(0))] {
        let first = id(lane, 50 + u64::from(lane), 0);
        rig.begin(&config(lane, first.episode, "Find a cone."));
        rig.step(&observation(first, frame), &recall(first, &[]));
        let (id, answers) = taken.recv_timeout(LONG).unwrap();
        answers.decide(id, Decision { answer: Answer::Act(action), images: 1, usage: None });
        if world.read_action(Some(action)).is_ok() {
            assert_eq!(rig.decisions(1)[0].lane, lane, "no decision was sent for the lanes before");
            continue;
        }
        let (report, text) = rig.error_report();
        assert_eq!(
            (report.kind, report.lane, report.episode),
            (ErrorReportKind::Episode as u32, lane, first.episode)
        );
        let ActionCode(code) = action;
        assert_eq!(text, format!("the policy's answer: {code} is not an action of this world"));
    }
    rig.stop();
}

#[test]
fn more_failures_than_fit_into_the_queue_are_all_reported_and_a_run_is_stopped_once() {
    const LANES: u32 = 400;
    let (hand_over, taken) = mpsc::channel();
    let mut policy = Deferred(hand_over);
    let change = |attach: &mut Attach| (attach.frame_capacity, attach.lanes) = (1000, LANES);
    let mut rig = PolicyRig::in_thread(change, move |folder| Ok(serve(&mut policy, folder)?));
    rig.handshake();
    let frame = rig.publish(10);
    for lane in 0..LANES {
        let first = id(lane, u64::from(lane), 0);
        rig.begin(&config(lane, first.episode, "Find a cone."));
        rig.step(&observation(first, frame), &recall(first, &[]));
    }
    let taken: Vec<(RequestId, Answers)> =
        (0..LANES).map(|_| taken.recv_timeout(LONG).unwrap()).collect();
    taken.iter().for_each(|(id, answers)| answers.fail(*id, "no server"));
    let mut failed: Vec<u32> = (0..LANES).map(|_| rig.error_report().0.lane).collect();
    failed.sort_unstable();
    assert_eq!(failed, Vec::from_iter(0..LANES));
    taken.iter().for_each(|(_, answers)| answers.stop_run("the server is down"));
    assert_eq!(rig.error_report().0.kind, ErrorReportKind::Run as u32);
    rig.stop();
}

#[test]
fn prompts_are_logged_and_a_log_that_cannot_be_written_stops_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let session = session_folder(folder.path(), 2);
    let (hand_over, taken) = mpsc::channel();
    let (mut rig, _) = serving_with_prompt_log(Deferred(hand_over), Some(session.clone()));
    let frames = [rig.publish(10), rig.publish(40)];
    let text = "a cone at (1, 2)".to_owned();
    let summary = rig.publish_document(&Content::Summary(text.clone()));
    let ask = |rig: &PolicyRig, step: u32| {
        let mut recall = recall(id(0, 9, step), &[]);
        supply(&mut recall, whole_text(summary, text.len()), &[]);
        rig.step(&observation(id(0, 9, step), frames[step as usize % 2]), &recall);
    };
    rig.begin(&config(0, 9, "Find a cone."));
    ask(&rig, 0);
    let (first, answers) = taken.recv_timeout(LONG).unwrap();
    let decide = |step, usage| {
        let request = RequestId { step, ..first };
        answers.record(request, || RecordedExchange {
            messages: vec![RecordedMessage {
                role: "user".to_owned(),
                parts: vec![
                    RecordedPart::Text("x".repeat(5000)),
                    RecordedPart::Image(hex(&[10; 16])),
                    RecordedPart::Png(b"not really".to_vec()),
                ],
            }],
            reply: Some("go on".to_owned()),
            unread: None,
        });
        let answer = Answer::Act(Action::Forward.into());
        answers.decide(request, Decision { answer, images: 1, usage });
    };
    let usage = Usage { prompt_tokens: Some(7), attempts: 1, ..Usage::default() };
    decide(0, Some(usage));
    rig.decisions(1);
    ask(&rig, 1);
    taken.recv_timeout(LONG).unwrap();
    decide(1, None);
    rig.decisions(1);

    let lines = fs::read_to_string(entries_file(&session, 1)).unwrap();
    let entries: Vec<PromptLogEntry> =
        lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let [first, second] = &entries[..] else { panic!("{lines}") };
    assert_eq!((first.episode, first.step, second.step), (9, 0, 1));
    assert_eq!(
        (first.request.instruction.as_str(), &second.request.window[0].frame),
        ("Find a cone.", &hex(&[10; 16]))
    );
    assert_eq!(first.usage.as_ref().unwrap().prompt_tokens, Some(7));
    assert_eq!(second.usage, None);
    let answer = first.answer.as_ref().unwrap();
    assert_eq!(
        (answer.outcome.as_str(), answer.action.as_deref()),
        ("acted", Some("move forward"))
    );
    let files = |sub: &str| fs::read_dir(folder.path().join(sub)).unwrap().count();
    assert_eq!((files("images"), files("documents")), (3, 2), "everything is stored once");
    let [RecordedItem::Text { text: hash, .. }] = &first.request.items[..] else {
        panic!("{lines}")
    };
    let stored = folder.path().join(format!("documents/{hash}.txt"));
    assert_eq!(fs::read_to_string(stored).unwrap(), text);
    let exchange = second.exchange.as_ref().unwrap();
    assert!(matches!(
        &exchange.messages[0].parts[..],
        [RecordedPart::Stored(_), RecordedPart::Image(_), RecordedPart::Image(_)]
    ));

    // A view that cannot be stored: no request reaches the policy any more, and the run is asked to stop.
    fs::remove_dir_all(folder.path().join("images")).unwrap();
    let unseen = rig.publish(70);
    rig.step(&observation(id(0, 9, 2), unseen), &recall(id(0, 9, 2), &[]));
    let (report, text) = rig.error_report();
    assert_eq!(report.kind, ErrorReportKind::Run as u32);
    assert!(text.starts_with("cannot write the prompt log: "), "{text}");
    rig.stop();
    assert!(taken.try_recv().is_err());
}

#[test]
fn a_policy_gets_its_requests_with_window_and_segment() {
    let (say, heard) = mpsc::channel();
    let (mut rig, handshake) = serving(Recorder(say));
    assert_eq!(
        handshake.facts().unwrap().into_iter().collect::<Vec<_>>(),
        [("policy", "recorder"), ("sees", "all")].map(|(a, b)| (a.to_owned(), b.to_owned()))
    );
    let greys = [10, 20, 30].map(|grey| rig.publish(grey));
    rig.begin(&config(2, 71, "Find a blue barrel."));
    rig.begin(&config(0, 72, "Find a red barrel."));
    rig.step(&observation(id(0, 72, 0), greys[2]), &recall(id(0, 72, 0), &[]));
    rig.step(&observation(id(2, 71, 0), greys[1]), &recall(id(2, 71, 0), &[]));
    rig.decisions(2);
    let not_understood = Observation {
        action: NO_ACTION,
        feedback: Feedback::NotUnderstood as u8,
        ..observation(id(2, 71, 1), greys[2])
    };
    rig.step(&not_understood, &recall(id(2, 71, 1), &[]));
    rig.decisions(1);
    let blocked = Observation {
        action: Action::Left as u8,
        feedback: Feedback::Blocked as u8,
        ..observation(id(2, 71, 2), greys[0])
    };
    rig.step(&blocked, &recall(id(2, 71, 2), &[greys[0], greys[1]]));
    let decision = rig.decisions(1)[0];
    assert_eq!((decision.lane, decision.episode, decision.step), (2, 71, 2));
    assert_eq!((decision.images, decision.images_asked), (5, 5));
    assert_eq!((decision.prompt_tokens, decision.completion_tokens), (102, 3));
    assert_eq!((decision.outcome, decision.action), (Outcome::Refused as u8, NO_ACTION));
    assert!(decision.received_ns <= decision.started_ns);
    assert!(decision.started_ns <= decision.decided_ns);

    // The last observation is not answered, and an evicted frame is dropped.
    rig.neighbours
        .observe(&Observation { last: 1, frame: NO_FRAME, ..observation(id(0, 72, 1), 1) })
        .unwrap();
    rig.neighbours.evict(greys[1]).unwrap();
    rig.notify();

    let report = rig.stop();
    assert_eq!((report.role, report.error_reports), (Role::Policy as u32, 0));
    assert_eq!((report.frames_received, report.pixel_bytes_copied), (3, 0));
    let mut heard: Vec<_> = heard.iter().collect();
    heard.sort();
    insta::assert_snapshot!(heard.join("\n"), @r#"
    lane 0 step 0 seed 0 "Find a red barrel." at 3,4,1 FeedbackCode(0) sees 30 after [] remembers []
    lane 2 step 0 seed 2 "Find a blue barrel." at 3,4,1 FeedbackCode(0) sees 20 after [] remembers []
    lane 2 step 1 seed 2 "Find a blue barrel." at 3,4,1 FeedbackCode(4) sees 30 after [(20, None, FeedbackCode(4))] remembers []
    lane 2 step 2 seed 2 "Find a blue barrel." at 3,4,1 FeedbackCode(3) sees 10 after [(20, None, FeedbackCode(4)), (30, Some(ActionCode(2)), FeedbackCode(3))] remembers [part of "" at Some(0.125) [(Some(10), Some(ActionCode(4))), (Some(20), None)]]
    reset 0
    reset 2
    "#);
}

#[test]
fn invalid_messages_are_reported_and_the_others_answered() {
    let (say, _heard) = mpsc::channel();
    let (mut rig, _) = serving(Recorder(say));
    let frame = rig.publish(1);
    rig.begin(&config(1, 5, "Find a blue barrel."));
    rig.begin(&config(9, 6, "Find a blue barrel."));
    let mut bad_state = observation(id(1, 5, 0), frame);
    bad_state.state[2] = 200.0;
    rig.step(&bad_state, &Recall { items_len: 99, ..recall(id(1, 5, 0), &[]) });
    let mut texts = rig.error_texts(3);
    rig.step(&observation(id(1, 5, 0), frame), &recall(id(1, 5, 0), &[12_345]));
    texts.extend(rig.error_texts(1));
    insta::assert_snapshot!(texts.join("\n"), @r#"
    episode config for lane 9: the run has 4 lanes
    observation for lane 1, step 0: this is no state of the world scripted: heading is 200, not one of 0 to 3
    recall for lane 1, step 0: 99 items, but at most 8 fit
    lane 1, step 0: frame 12345 is not in the store: it was evicted too early or never published
    "#);

    rig.step(&observation(id(1, 5, 1), frame), &recall(id(1, 5, 1), &[]));
    let decisions = rig.decisions(1);
    assert_eq!((decisions.len(), decisions[0].step), (1, 1));
    let report = rig.stop();
    assert_eq!(report.error_reports, 4);
}

/// Keeps the frames of its requests.
struct Hoarder(Vec<std::sync::Arc<peer::PinnedStep>>);

impl Decider for Hoarder {
    fn name(&self) -> &str {
        "hoarder"
    }

    fn take(&mut self, batch: &Batch<'_>, answers: &Answers) -> Result<(), ServeError> {
        for (step, request) in batch.steps().iter().zip(batch.iter()) {
            self.0.push(step.clone());
            answers.decide(step.id(), Decision::act(request, Action::Forward));
        }
        Ok(())
    }
}

#[test]
fn a_policy_that_keeps_evicted_frames_stops_the_run() {
    let (mut rig, _) = serving(Hoarder(Vec::new()));
    let spare = rig.neighbours.attach().spare_frames();
    let window = message::PolicyEpisodeConfig { window: 0, ..config(0, 3, "Find a cone.") };
    rig.begin(&window);
    for step in 0..=spare / 2 {
        let frame = rig.publish(step as u8);
        rig.step(&observation(id(0, 3, step), frame), &recall(id(0, 3, step), &[]));
        rig.decisions(1);
        rig.neighbours.evict(frame).unwrap();
    }
    rig.notify();
    let (report, text) = rig.error_report();
    assert_eq!(report.kind, ErrorReportKind::Run as u32);
    assert!(text.contains("frames that were evicted"), "{text}");
    rig.stop();
}

/// Answers nothing.
struct Mute;

impl Policy for Mute {
    fn name(&self) -> &str {
        "mute"
    }

    fn act(&mut self, _: &[Request<'_>]) -> Vec<Decision> {
        Vec::new()
    }
}

#[test]
fn a_policy_that_does_not_answer_ends_the_process() {
    let (mut rig, _) = serving(Mute);
    let frame = rig.publish(1);
    rig.begin(&config(0, 1, "Find a blue barrel."));
    rig.step(&observation(id(0, 1, 0), frame), &recall(id(0, 1, 0), &[]));
    let error = rig.end().unwrap_err();
    assert_eq!(error.to_string(), "policy mute returned 0 decisions for 1 requests");
}
