//! The serve loop against scripted peers: an orchestrator, a simulator and a memory in this process.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::any::Any;
use std::fs;
use std::path::PathBuf;
use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bytemuck::Zeroable;
use domain::{
    Action, Feedback, Heading, Outcome, Pose,
    prompt_log::{Entry, Exchange, Message, Part, entries_file, hex, session_folder},
};
use peer::{
    Answer, Answers, Decider, Decision, Policy, Request, RequestId, ServeError, Usage, serve,
};
use policy_proc::random::Random;
use shm_types::documents::Content;
use shm_types::message::{
    self, ErrorReport, ErrorReportKind, Eviction, FrameId, Handshake, NO_ACTION, NO_FRAME,
    Observation, PolicyEpisodeConfig, Recall, Role, ShutdownReport, Stop, TrajectoryStep, WirePose,
    read_text, write_text,
};
use shm_types::{
    Attach, Bus, DocumentPublisher, FramePublisher, FrameSize, FrameStore, Notifier, Receiver,
    RunDir, Sender,
};
use tempfile::TempDir;

const PATIENCE: Duration = Duration::from_secs(60);

/// Everybody but the policy. Fields are dropped in order: the run before its folder.
struct Peers {
    orchestrator: Bus,
    configs: Sender<PolicyEpisodeConfig>,
    observations: Sender<Observation>,
    recalls: Sender<Recall>,
    evictions: Sender<Eviction>,
    stops: Sender<Stop>,
    decisions: Receiver<message::Decision>,
    error_reports: Receiver<ErrorReport>,
    shutdown_reports: Receiver<ShutdownReport>,
    policy: Notifier,
    frames: FramePublisher,
    documents: DocumentPublisher,
    /// Receivers that must be there for anything to be delivered.
    _others: Box<dyn Any>,
    handshake: Handshake,
    serving: JoinHandle<Result<(), ServeError>>,
    _run: RunDir,
    _base: TempDir,
}

impl Peers {
    /// A run of four lanes in which `policy` is serving.
    fn new(policy: impl Decider + Send + 'static) -> Self {
        Self::logging(policy, None)
    }

    /// The same, with prompts logged in a folder.
    fn logging(policy: impl Decider + Send + 'static, prompts: Option<PathBuf>) -> Self {
        let base = tempfile::Builder::new().prefix("mt").tempdir_in("/tmp").unwrap();
        let run = RunDir::create(base.path()).unwrap();
        let frame = FrameSize { width: 64, height: 64 };
        let attach = Attach { frame, frame_capacity: 32, lanes: 4, prompts, ..run.attach() };
        attach.write(run.path()).unwrap();
        let bus = |role| Bus::join(attach.clone(), role).unwrap();
        let (orchestrator, sim, memory) =
            (bus(Role::Orchestrator), bus(Role::Sim), bus(Role::Memory));
        let handshakes = orchestrator.receiver::<Handshake>().unwrap();
        let (decisions, error_reports, shutdown_reports) = (
            orchestrator.receiver().unwrap(),
            orchestrator.receiver().unwrap(),
            orchestrator.receiver().unwrap(),
        );
        let others = (
            orchestrator.receiver::<Observation>().unwrap(),
            memory.receiver::<Observation>().unwrap(),
            FrameStore::new(&memory).unwrap(),
            memory.receiver::<Stop>().unwrap(),
            sim.receiver::<Stop>().unwrap(),
        );
        let path = run.path().to_owned();
        let mut policy = policy;
        let serving = thread::spawn(move || serve(&mut policy, &path));
        let handshake = within_patience(&orchestrator, || handshakes.next().unwrap());
        Self {
            configs: orchestrator.sender().unwrap(),
            observations: sim.sender().unwrap(),
            recalls: memory.sender().unwrap(),
            evictions: sim.sender().unwrap(),
            stops: orchestrator.sender().unwrap(),
            decisions,
            error_reports,
            shutdown_reports,
            policy: orchestrator.notifier(Role::Policy).unwrap(),
            frames: FramePublisher::new(&sim).unwrap(),
            documents: DocumentPublisher::new(&memory).unwrap(),
            _others: Box::new((others, sim, memory)),
            handshake,
            serving,
            _run: run,
            _base: base,
            orchestrator,
        }
    }

    /// A frame of one grey.
    fn publish(&mut self, grey: u8) -> FrameId {
        let mut slot = self.frames.loan().unwrap();
        slot.pixels_mut().fill(grey);
        self.frames.publish(slot, [grey; 16]).unwrap()
    }

    fn config(&self, lane: u32, episode: u64, instruction: &str) {
        let mut config =
            PolicyEpisodeConfig { lane, episode, seed: u64::from(lane), ..Zeroable::zeroed() };
        config.instruction_len = write_text(&mut config.instruction, instruction);
        self.configs.send(&config).unwrap();
    }

    fn notify(&self) {
        self.policy.notify().unwrap();
    }

    fn decisions(&self, count: usize) -> Vec<message::Decision> {
        let mut all = Vec::new();
        within_patience(&self.orchestrator, || {
            all.extend(self.decisions.drain().unwrap());
            (all.len() >= count).then_some(())
        });
        all
    }

    /// Stops the policy; returns how serving ended and what it said at the end.
    fn stop(self) -> (Result<(), ServeError>, ShutdownReport) {
        self.stops.send(&Stop::zeroed()).unwrap();
        self.notify();
        let shutdown_report =
            within_patience(&self.orchestrator, || self.shutdown_reports.next().unwrap());
        (self.serving.join().unwrap(), shutdown_report)
    }
}

/// What `look` finds, sooner or later.
fn within_patience<T>(bus: &Bus, mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < deadline, "nothing came");
        bus.listener().wait(Duration::from_millis(100)).unwrap();
    }
}

fn observation(lane: u32, episode: u64, step: u32, frame: FrameId) -> Observation {
    let pose = WirePose::from(Pose::new(3, 4, Heading::E));
    let (feedback, action) = (Feedback::Moved as u8, Action::Forward as u8);
    Observation { lane, episode, step, frame, pose, feedback, action, ..Zeroable::zeroed() }
}

fn recall(lane: u32, episode: u64, step: u32) -> Recall {
    Recall { lane, episode, step, distance: f32::NAN, ..Zeroable::zeroed() }
}

/// Tells what it was asked, and refuses.
struct Witness(mpsc::Sender<String>);

impl Policy for Witness {
    fn name(&self) -> &str {
        "witness"
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        vec![("sees", "all".to_owned())]
    }

    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision> {
        let grey = |frame: peer::FrameView<'_>| {
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
            let segment = request.segment.map(|segment| {
                let views: Vec<_> =
                    segment.steps.iter().map(|view| (grey(view.frame), view.action)).collect();
                (segment.distance, views)
            });
            let Request { lane, step, episode_seed, instruction, pose, feedback, .. } = request;
            let documents: Vec<_> = request.documents.iter().map(|d| (d.kind, d.text)).collect();
            let trajectories: Vec<Vec<_>> = request
                .trajectories
                .iter()
                .map(|t| t.steps.iter().map(|step| (step.frame.map(grey), step.action)).collect())
                .collect();
            let hint = request.starts_as_demonstrated;
            if !documents.is_empty() || !trajectories.is_empty() || hint {
                let told =
                    format!("hint {hint} documents {documents:?} trajectories {trajectories:?}");
                self.0.send(told).unwrap();
            }
            let frame = grey(request.frame);
            self.0
                .send(format!(
                    "lane {lane} step {step} seed {episode_seed} {instruction:?} at {pose} \
                     {feedback:?} sees {frame} after {window:?} remembers {segment:?}"
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

#[test]
fn documents_and_demonstrations_reach_the_policy_with_their_keyframes() {
    let (say, heard) = mpsc::channel();
    let mut peers = Peers::new(Witness(say));
    let frame = peers.publish(10);
    let keyframe = peers.publish(40);
    let mut config =
        PolicyEpisodeConfig { episode: 9, starts_as_demonstrated: 1, ..Zeroable::zeroed() };
    config.instruction_len = write_text(&mut config.instruction, "Find a cone.");
    peers.configs.send(&config).unwrap();
    let step =
        |trajectory, frame, action| TrajectoryStep { frame, action, trajectory, reserved: [0; 6] };
    let walks = vec![
        step(0, keyframe, Action::Forward as u8),
        step(0, NO_FRAME, NO_ACTION),
        step(1, frame, NO_ACTION),
    ];
    let summary =
        peers.documents.publish(None, &Content::Summary("a cone at (1, 2)".into())).unwrap();
    let walks = peers.documents.publish(Some((0, 9)), &Content::Trajectories(walks)).unwrap();
    let mut recall = recall(0, 9, 0);
    recall.documents[..2].copy_from_slice(&[summary, walks]);
    recall.documents_len = 2;
    peers.recalls.send(&recall).unwrap();
    peers.observations.send(&observation(0, 9, 0, frame)).unwrap();
    peers.notify();

    let decision = peers.decisions(1)[0];
    assert_eq!(decision.images, 3, "the current view and two keyframes");
    assert_eq!(heard.recv().unwrap(), "reset 0");
    assert_eq!(
        heard.recv().unwrap(),
        "hint true documents [(Summary, \"a cone at (1, 2)\")] trajectories [[(Some(40), \
         Some(Forward)), (None, None)], [(Some(10), None)]]"
    );

    // A document that nobody published: said so, and the step stays open.
    recall.documents[1] = walks + 7;
    recall.step = 1;
    peers.recalls.send(&recall).unwrap();
    peers.observations.send(&observation(0, 9, 1, frame)).unwrap();
    peers.notify();
    let error_report = within_patience(&peers.orchestrator, || peers.error_reports.next().unwrap());
    let text = read_text(&error_report.text, error_report.text_len).unwrap();
    assert!(text.contains("was never published"), "{text}");
    peers.stop().0.unwrap();
}

/// Hands its tickets and the way back to somebody else.
struct Elsewhere(mpsc::Sender<(RequestId, Answers)>);

impl Decider for Elsewhere {
    fn name(&self) -> &str {
        "elsewhere"
    }

    fn take(&mut self, batch: &[Request<'_>], answers: &Answers) -> Result<(), ServeError> {
        batch.iter().for_each(|r| self.0.send((r.id(), answers.clone())).unwrap());
        Ok(())
    }
}

#[test]
fn answers_may_come_later_in_any_order_from_any_thread_or_not_at_all() {
    let (hand_over, taken) = mpsc::channel();
    let mut peers = Peers::new(Elsewhere(hand_over));
    let frame = peers.publish(10);
    for lane in 0..4 {
        peers.config(lane, 50 + u64::from(lane), "Find a cone.");
        peers.observations.send(&observation(lane, 50 + u64::from(lane), 0, frame)).unwrap();
        peers.recalls.send(&recall(lane, 50 + u64::from(lane), 0)).unwrap();
    }
    peers.notify();
    let taken: Vec<(RequestId, Answers)> =
        (0..4).map(|_| taken.recv_timeout(PATIENCE).unwrap()).collect();
    let decision = |action| Decision { answer: Answer::Act(action), images: 1, usage: None };
    let say = |lane: usize, action| taken[lane].1.decide(taken[lane].0, decision(action));

    say(3, Action::Right);
    assert_eq!(peers.decisions(1)[0].lane, 3);
    // Lane 2 begins another episode: what was taken for the one before is late.
    peers.config(2, 62, "Find a barrel.");
    peers.notify();
    let elsewhere = RequestId { lane: 77, ..taken[0].0 };
    taken[0].1.decide(elsewhere, decision(Action::Left));
    taken[1].1.fail(taken[1].0, "status 400: too many images");
    let error_report = within_patience(&peers.orchestrator, || peers.error_reports.next().unwrap());
    let text = read_text(&error_report.text, error_report.text_len).unwrap();
    assert_eq!(
        (error_report.kind, error_report.lane, error_report.episode, text),
        (ErrorReportKind::Episode as u32, 1, 51, "status 400: too many images")
    );
    say(2, Action::Left);
    say(3, Action::Left);
    say(0, Action::Backward);
    let answered = peers.decisions(1);
    assert_eq!(answered.len(), 1, "late and repeated answers are dropped: {answered:?}");
    assert_eq!((answered[0].lane, answered[0].action), (0, Action::Backward as u8));

    taken[0].1.halt("the server is gone");
    let error_report = within_patience(&peers.orchestrator, || peers.error_reports.next().unwrap());
    assert_eq!(error_report.kind, ErrorReportKind::Run as u32);
    peers.stop().0.unwrap();
}

#[test]
fn prompts_are_logged_where_asked_for_and_a_log_that_cannot_be_kept_stops_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let session = session_folder(folder.path(), 2);
    let (hand_over, taken) = mpsc::channel();
    let mut peers = Peers::logging(Elsewhere(hand_over), Some(session.clone()));
    let frames = [peers.publish(10), peers.publish(40)];
    let text = "a cone at (1, 2)".to_owned();
    let summary = peers.documents.publish(None, &Content::Summary(text.clone())).unwrap();
    let ask = |peers: &Peers, step: u32| {
        let mut recall = Recall { window_len: step.min(1), ..recall(0, 9, step) };
        recall.window[0].frame = frames[0];
        (recall.documents[0], recall.documents_len) = (summary, 1);
        peers.recalls.send(&recall).unwrap();
        let seen = observation(0, 9, step, frames[step as usize % 2]);
        peers.observations.send(&seen).unwrap();
        peers.notify();
    };
    peers.config(0, 9, "Find a cone.");
    ask(&peers, 0);
    let (ticket, answers) = taken.recv_timeout(PATIENCE).unwrap();
    let say = |step, usage| {
        let ticket = RequestId { step, ..ticket };
        answers.record(ticket, || Exchange {
            messages: vec![Message {
                role: "user".to_owned(),
                parts: vec![Part::Text("x".repeat(5000)), Part::Image(hex([10; 16]))],
            }],
            reply: Some("go on".to_owned()),
            unread: None,
        });
        answers.decide(ticket, Decision { answer: Answer::Act(Action::Forward), images: 1, usage });
    };
    let usage = Usage { prompt_tokens: Some(7), attempts: 1, ..Usage::default() };
    say(0, Some(usage));
    peers.decisions(1);
    ask(&peers, 1);
    taken.recv_timeout(PATIENCE).unwrap();
    say(1, None);
    peers.decisions(1);

    let lines = fs::read_to_string(entries_file(&session, 1)).unwrap();
    let entries: Vec<Entry> =
        lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let [first, second] = &entries[..] else { panic!("{lines}") };
    assert_eq!((first.episode, first.step, second.step), (9, 0, 1));
    assert_eq!(
        (first.request.instruction.as_str(), &second.request.window[0].frame),
        ("Find a cone.", &hex([10; 16]))
    );
    assert_eq!(first.usage.unwrap().prompt_tokens, Some(7));
    assert_eq!(second.usage, None);
    let answer = first.answer.as_ref().unwrap();
    assert_eq!(
        (answer.outcome.as_str(), answer.action.as_deref()),
        ("acted", Some("move forward"))
    );
    let names = |sub: &str| fs::read_dir(folder.path().join(sub)).unwrap().count();
    assert_eq!((names("images"), names("documents")), (2, 2), "everything once");
    let stored = folder.path().join(format!("documents/{}.txt", first.request.documents[0].text));
    assert_eq!(fs::read_to_string(stored).unwrap(), text);
    let exchange = second.exchange.as_ref().unwrap();
    assert!(matches!(&exchange.messages[0].parts[..], [Part::Stored(_), Part::Image(_)]));

    // A view that cannot be kept: nothing is asked any more, and the run is told to stop.
    fs::remove_dir_all(folder.path().join("images")).unwrap();
    let unseen = peers.publish(70);
    peers.recalls.send(&recall(0, 9, 2)).unwrap();
    peers.observations.send(&observation(0, 9, 2, unseen)).unwrap();
    peers.notify();
    let error_report = within_patience(&peers.orchestrator, || peers.error_reports.next().unwrap());
    let text = read_text(&error_report.text, error_report.text_len).unwrap();
    assert_eq!(error_report.kind, ErrorReportKind::Run as u32);
    assert!(text.starts_with("cannot keep the prompt log: "), "{text}");
    peers.stop().0.unwrap();
    assert!(taken.try_recv().is_err());
}

#[test]
fn a_policy_sees_its_requests_and_nothing_else() {
    let (say, heard) = mpsc::channel();
    let mut peers = Peers::new(Witness(say));
    let facts = read_text(&peers.handshake.facts, peers.handshake.facts_len).unwrap();
    assert_eq!(facts, r#"{"policy":"witness","sees":"all"}"#);

    let greys = [10, 20, 30].map(|grey| peers.publish(grey));
    peers.config(2, 71, "Find a blue barrel.");
    peers.config(0, 72, "Find a red barrel.");
    let mut full = Recall { window_len: 2, segment_len: 2, distance: 0.25, ..recall(2, 71, 2) };
    full.window[0].frame = greys[1];
    full.window[0].action = NO_ACTION;
    full.window[0].feedback = Feedback::NotUnderstood as u8;
    full.window[1].frame = greys[2];
    full.window[1].action = Action::Left as u8;
    full.window[1].feedback = Feedback::Blocked as u8;
    full.segment[0].frame = greys[0];
    full.segment[0].action = Action::TurnAround as u8;
    full.segment[1].frame = greys[1];
    full.segment[1].action = NO_ACTION;
    peers.recalls.send(&full).unwrap();
    peers.observations.send(&observation(2, 71, 2, greys[0])).unwrap();
    peers.observations.send(&observation(0, 72, 0, greys[2])).unwrap();
    peers.recalls.send(&recall(0, 72, 0)).unwrap();
    peers.notify();

    let mut decisions = peers.decisions(2);
    decisions.sort_by_key(|decision| decision.lane);
    let told: Vec<_> = decisions
        .iter()
        .map(|d| (d.lane, d.episode, d.step, d.images, d.prompt_tokens, d.completion_tokens))
        .collect();
    assert_eq!(told, [(0, 72, 0, 1, 100, 3), (2, 71, 2, 5, 102, 3)]);
    for decision in &decisions {
        assert_eq!((decision.outcome, decision.action), (Outcome::Refused as u8, NO_ACTION));
        assert!(decision.received_ns <= decision.started_ns);
        assert!(decision.started_ns <= decision.decided_ns);
    }

    // The last step of an episode is nobody's to decide, and an evicted frame is let go of.
    let last = Observation { last: 1, ..observation(0, 72, 1, message::NO_FRAME) };
    peers.observations.send(&last).unwrap();
    peers.evictions.send(&Eviction { frame: greys[1] }).unwrap();
    peers.observations.send(&observation(2, 71, 3, greys[0])).unwrap();
    let mut gone = Recall { window_len: 1, ..recall(2, 71, 3) };
    gone.window[0].frame = greys[2];
    peers.recalls.send(&gone).unwrap();
    peers.notify();
    assert_eq!(peers.decisions(1)[0].step, 3);

    let (served, shutdown_report) = peers.stop();
    served.unwrap();
    assert_eq!((shutdown_report.role, shutdown_report.error_reports), (Role::Policy as u32, 0));
    assert_eq!((shutdown_report.frames_received, shutdown_report.pixel_bytes_copied), (3, 0));
    let mut heard: Vec<_> = heard.iter().collect();
    heard.sort();
    insta::assert_snapshot!(heard.join("\n"), @r#"
    lane 0 step 0 seed 0 "Find a red barrel." at 3,4,E Moved sees 30 after [] remembers None
    lane 2 step 2 seed 2 "Find a blue barrel." at 3,4,E Moved sees 10 after [(20, None, NotUnderstood), (30, Some(Left), Blocked)] remembers Some((0.25, [(10, Some(TurnAround)), (20, None)]))
    lane 2 step 3 seed 2 "Find a blue barrel." at 3,4,E Moved sees 10 after [(30, Some(Forward), Start)] remembers None
    reset 0
    reset 2
    "#);
}

#[test]
fn rubbish_is_complained_about_and_the_rest_is_answered() {
    let mut peers = Peers::new(Random);
    let frame = peers.publish(1);
    peers.config(1, 5, "Find a blue barrel.");
    peers.config(9, 6, "Find a blue barrel.");
    let mut bad_pose = observation(1, 5, 0, frame);
    bad_pose.pose.0[2] = 200;
    peers.observations.send(&bad_pose).unwrap();
    peers.recalls.send(&Recall { window_len: 99, ..recall(1, 5, 0) }).unwrap();
    let mut no_such_frame = Recall { window_len: 1, ..recall(1, 5, 1) };
    no_such_frame.window[0].frame = 12_345;
    peers.observations.send(&observation(1, 5, 1, frame)).unwrap();
    peers.recalls.send(&no_such_frame).unwrap();
    peers.notify();
    let mut texts = Vec::new();
    within_patience(&peers.orchestrator, || {
        texts.extend(peers.error_reports.drain().unwrap());
        (texts.len() >= 4).then_some(())
    });
    let texts: Vec<_> =
        texts.iter().map(|c| read_text(&c.text, c.text_len).unwrap().to_owned()).collect();
    insta::assert_snapshot!(texts.join("\n"), @r#"
    policy brief for lane 9: the run has 4
    observation for lane 1, step 0: 200 is not a heading (0 N, 1 E, 2 S, 3 W)
    recall for lane 1, step 0: 99 past steps, at most 32 fit
    lane 1, step 1: frame 12345 is not in the store, so it was evicted too early or never published
    "#);

    peers.observations.send(&observation(1, 5, 2, frame)).unwrap();
    peers.recalls.send(&recall(1, 5, 2)).unwrap();
    peers.notify();
    let decisions = peers.decisions(1);
    assert_eq!((decisions.len(), decisions[0].step), (1, 2));
    assert!(Action::try_from(decisions[0].action).is_ok());
    let (served, shutdown_report) = peers.stop();
    served.unwrap();
    assert_eq!(shutdown_report.error_reports, 4);
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
    let mut peers = Peers::new(Mute);
    let frame = peers.publish(1);
    peers.config(0, 1, "Find a blue barrel.");
    peers.observations.send(&observation(0, 1, 0, frame)).unwrap();
    peers.recalls.send(&recall(0, 1, 0)).unwrap();
    peers.notify();
    let error = peers.serving.join().unwrap().unwrap_err();
    assert_eq!(error.to_string(), "policy mute answered 0 of 1 requests: it must answer each once");
}
