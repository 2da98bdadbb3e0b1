//! The `openai` policy between scripted peers on the bus and a scripted chat server, over real sockets.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Condvar, Mutex};

use conformance::messages::{self, config, observation, recall, supply};
use domain::{Action, Feedback, ImageFormat, Outcome, Reasoning};
use llm::{ChatClient, ChatSettings, Endpoint, ReplyCache};
use peer::serve;
use policy_proc::openai::{Openai, OpenaiSettings};
use prompt::Template;

use rigs::chat_server::{Reaction, Received, Server, completion};
use rigs::process::{LONG, PolicyRig};
use serde_json::{Value, json};
use shm_types::Attach;
use shm_types::documents::Content;
use shm_types::message::{
    self, ErrorReportKind, FrameId, NOT_MEASURED, Observation, PolicyEpisodeConfig, RecalledItem,
    RequestId, read_text,
};

const LANES: u32 = 8;

/// A run of eight lanes whose policy asks a server.
struct Bench {
    rig: PolicyRig,
    facts: Value,
    server: Server,
}

impl Deref for Bench {
    type Target = PolicyRig;

    fn deref(&self) -> &PolicyRig {
        &self.rig
    }
}

impl DerefMut for Bench {
    fn deref_mut(&mut self) -> &mut PolicyRig {
        &mut self.rig
    }
}

/// The settings of most tests.
fn settings() -> OpenaiSettings {
    OpenaiSettings { image_format: ImageFormat::Png, image_budget: 50, answer_tokens: 30 }
}

fn chat_settings() -> ChatSettings {
    ChatSettings {
        request_timeout: LONG,
        max_retries: 0,
        max_connections: LANES,
        ..ChatSettings::new("m")
    }
}

impl Bench {
    fn new(server: Server, settings: OpenaiSettings) -> Self {
        Self::with_cache(server, settings, None)
    }

    fn with_cache(server: Server, settings: OpenaiSettings, cache: Option<ReplyCache>) -> Self {
        Self::with_template(server, Template::BUILT_IN_FILE, settings, cache)
    }

    fn with_template(
        server: Server,
        template: &str,
        settings: OpenaiSettings,
        cache: Option<ReplyCache>,
    ) -> Self {
        let endpoint = Endpoint::new(&server.base_url(), None).unwrap();
        let template = Arc::new(Template::parse(template).unwrap());
        let mut policy =
            Openai::new(ChatClient::new(endpoint, chat_settings(), cache), template, settings);
        let change = |attach: &mut Attach| attach.lanes = LANES;
        let mut rig = PolicyRig::in_thread(change, move |folder| Ok(serve(&mut policy, folder)?));
        let handshake = rig.handshake();
        let facts = read_text(&handshake.facts, handshake.facts_len).unwrap();
        Self { facts: serde_json::from_str(facts).unwrap(), rig, server }
    }

    /// An episode without a window in `lane`; the instruction contains the lane's number.
    fn begin_lane(&self, lane: u32) {
        self.begin(&PolicyEpisodeConfig { window: 0, ..lane_config(lane) });
    }

    /// Sends a step of `lane` with a recall of these views and documents. Does not notify.
    fn ask_lane(
        &self,
        lane: u32,
        step: u32,
        frame: FrameId,
        segment: &[FrameId],
        texts: &[RecalledItem],
    ) {
        let id = RequestId { lane, episode: episode(lane), step };
        let mut recall = recall(id, segment);
        texts.iter().for_each(|&text| supply(&mut recall, text, &[]));
        self.ask(&observation(id, frame), &recall);
    }

    /// Wakes the policy; the next `count` decisions by lane.
    fn decide(&mut self, count: usize) -> Vec<message::Decision> {
        self.notify();
        let mut decisions = self.decisions(count);
        decisions.sort_by_key(|decision| decision.lane);
        decisions
    }
}

fn episode(lane: u32) -> u64 {
    100 + u64::from(lane)
}

fn lane_config(lane: u32) -> PolicyEpisodeConfig {
    config(lane, episode(lane), &format!("Find item {lane}."))
}

/// The lane that a request is about.
fn lane_of(request: &Received) -> u32 {
    let body = request.body.to_string();
    let (_, after) = body.split_once("Find item ").unwrap();
    after[..1].parse().unwrap()
}

/// The URLs of a request's images.
fn images_of(request: &Received) -> Vec<String> {
    match &request.body["messages"][1]["content"] {
        Value::Array(parts) => parts
            .iter()
            .filter_map(|part| Some(part.pointer("/image_url/url")?.as_str()?.to_owned()))
            .collect(),
        _ => Vec::new(),
    }
}

#[test]
fn requests_of_all_lanes_are_in_flight_at_once() {
    // No answer before all lanes have asked; then from the last lane to the first.
    let turn = Arc::new((Mutex::new((0, LANES)), Condvar::new()));
    let server = Server::concurrent(move |request| {
        let lane = lane_of(request);
        let (state, changed) = &*turn;
        let mut state = state.lock().unwrap();
        state.0 += 1;
        changed.notify_all();
        let late = |state: &mut (u32, u32)| state.0 < LANES || state.1 != lane + 1;
        let (mut state, waited) = changed.wait_timeout_while(state, LONG, late).unwrap();
        assert!(!waited.timed_out(), "lane {lane} waits for the others");
        state.1 = lane;
        changed.notify_all();
        Reaction::says(Action::ALL[lane as usize % 7].words())
    })
    .unwrap();
    let mut bench = Bench::new(server, settings());
    let frame = bench.publish(9);
    for lane in 0..LANES {
        bench.begin_lane(lane);
        bench.ask_lane(lane, 0, frame, &[], &[]);
    }
    let decisions = bench.decide(LANES as usize);
    for (decision, lane) in decisions.iter().zip(0..) {
        assert_eq!((decision.lane, decision.episode), (lane, episode(lane)));
        assert_eq!(decision.outcome, Outcome::Acted as u8);
        assert_eq!(u32::from(decision.action), lane % 7);
        assert_eq!((decision.images_asked, decision.images), (1, 1));
        assert_eq!((decision.prompt_tokens, decision.completion_tokens), (10, 5));
        assert_eq!((decision.memory_tokens, decision.image_tokens), (0, NOT_MEASURED));
        assert_eq!((decision.attempts, decision.replayed), (1, 0));
        assert_eq!(decision.reasoning, Reasoning::Off as u8);
        let [finish_reason, model] = [
            read_text(&decision.finish_reason, decision.finish_reason_len.into()),
            read_text(&decision.model, decision.model_len.into()),
        ];
        assert_eq!((finish_reason, model), (Ok("stop"), Ok("scripted")));
        assert!(decision.started_ns <= decision.prompted_ns);
        assert!(decision.prompted_ns <= decision.sent_ns);
        assert!(decision.sent_ns <= decision.decided_ns);
    }
    let received = bench.server.received();
    assert_eq!(received.len(), LANES as usize);
    for request in &received {
        assert_eq!(request.body["model"], "m");
        assert_eq!(
            (&request.body["temperature"], &request.body["max_tokens"]),
            (&json!(0.0), &json!(30))
        );
        let first = &received[0].body["messages"][0];
        assert_eq!((&request.body["messages"][0], &first["role"]), (first, &json!("system")));
    }
    bench.rig.stop();
}

#[test]
fn answers_without_an_action_have_different_outcomes() {
    let server = Server::concurrent(|request| {
        let length = |text| {
            let mut body = completion(text);
            body["choices"][0]["finish_reason"] = json!("length");
            Reaction::json(200, &body)
        };
        match lane_of(request) {
            0 => Reaction::says("left or right, who knows"),
            1 => Reaction::says(""),
            2 => Reaction::says("I'm sorry, but I can't assist with that."),
            3 => length("I can see a warehouse with"),
            4 => length("Turn left. I can see"),
            5 => Reaction::json(400, &json!({"error": {"message": "at most 1 image"}})),
            _ => Reaction::says("**Turn around!**"),
        }
    })
    .unwrap();
    let mut bench = Bench::new(server, settings());
    let frame = bench.publish(9);
    for lane in 0..7 {
        bench.begin_lane(lane);
        bench.ask_lane(lane, 0, frame, &[], &[]);
    }
    let outcomes: Vec<_> = bench.decide(6).iter().map(|d| (d.lane, d.outcome)).collect();
    let expected = [
        (0, Outcome::Unreadable),
        (1, Outcome::Empty),
        (2, Outcome::Refused),
        (3, Outcome::CutOff),
        (4, Outcome::Acted),
        (6, Outcome::Acted),
    ];
    assert_eq!(outcomes, expected.map(|(lane, outcome)| (lane, outcome as u8)));
    // Once all have answered, the facts for the manifest are these, whatever the order of the replies.
    let last =
        r#"{"answers":"free text","reasoning":"off, as far as replies show","temperature":"0"}"#;
    while bench.learned_facts() != last {}
    // A refused request does not count against the model.
    let (report, text) = bench.error_report();
    assert_eq!((report.kind, report.lane), (ErrorReportKind::Episode as u32, 5));
    assert!(text.contains("status 400: at most 1 image"), "{text}");
    bench.rig.stop();
}

#[test]
fn a_template_of_the_users_words_the_prompt_and_is_named() {
    let server = Server::concurrent(|_| Reaction::says("move forward")).unwrap();
    let template = Template::BUILT_IN_FILE
        .replace("\"prompt/2\"", "\"mine/1\"")
        .replace("{rules}", "Ahoy. {rules}");
    let mut bench = Bench::with_template(server, &template, settings(), None);
    assert_eq!(bench.facts["prompt"], "mine/1");
    let hash = Template::parse(&template).unwrap().hash()[..16].to_owned();
    assert_eq!(bench.facts["prompt_hash"], hash);
    let frame = bench.publish(1);
    bench.begin_lane(0);
    bench.ask_lane(0, 0, frame, &[], &[]);
    bench.decide(1);
    let system = &bench.server.received()[0].body["messages"][0]["content"];
    assert!(system.as_str().unwrap().starts_with("Ahoy. "), "{system}");
    bench.rig.stop();
}

#[test]
fn images_are_kept_to_the_budget() {
    let server = Server::concurrent(|_| {
        let mut body = completion("move forward");
        body["usage"]["prompt_tokens"] = json!(2000);
        Reaction::json(200, &body)
    })
    .unwrap();
    let budget = OpenaiSettings { image_budget: 3, image_format: ImageFormat::Jpeg, ..settings() };
    let mut bench = Bench::new(server, budget);
    let frames = [10, 20, 30, 40].map(|grey| bench.publish(grey));
    for lane in 0..2 {
        bench.begin(&PolicyEpisodeConfig { window: 2, ..lane_config(lane) });
    }
    for step in 0..2 {
        (0..2).for_each(|lane| bench.ask_lane(lane, step, frames[step as usize], &[], &[]));
        bench.decide(2);
    }
    (0..2).for_each(|lane| bench.ask_lane(lane, 2, frames[3], &[frames[2], frames[0]], &[]));
    for decision in bench.decide(2) {
        assert_eq!((decision.images_asked, decision.images), (5, 3));
        // All retrieved views are left out, so memory is a share of the text alone.
        assert!((50..400).contains(&decision.memory_tokens), "{}", decision.memory_tokens);
    }
    let received = bench.server.received();
    // The first steps of both lanes come before.
    let received = &received[received.len() - 2..];
    let [one, other] = [&received[0], &received[1]].map(images_of);
    assert_eq!(one.len(), 3);
    assert!(one.iter().all(|url| url.starts_with("data:image/jpeg;base64,")));
    assert_eq!(one, other);
    let body = received[0].body.to_string();
    assert_eq!(body.matches("[view not shown]").count(), 2);
    bench.rig.stop();
}

#[test]
fn without_images_a_model_gets_plain_text_and_memory_its_share() {
    let server = Server::concurrent(|_| {
        let mut body = completion("move forward");
        body["usage"] = json!({
            "prompt_tokens": 1000, "completion_tokens": 2,
            "prompt_tokens_details": {"cached_tokens": 600},
        });
        Reaction::json(200, &body)
    })
    .unwrap();
    let mut bench = Bench::new(server, OpenaiSettings { image_budget: 0, ..settings() });
    let frame = bench.publish(1);
    // As much text as the rest of the prompt, and more.
    let text = "- blue barrel: stand at (1, 2)\n".repeat(60);
    let item = messages::text(0, text.len());
    let document = bench.publish_document(&Content::Summary(text));
    bench.begin_lane(3);
    bench.ask_lane(3, 0, frame, &[], &[RecalledItem { document, ..item }]);
    let decision = bench.decide(1)[0];
    assert_eq!((decision.images_asked, decision.images), (1, 0));
    assert_eq!((decision.prompt_tokens, decision.cached_tokens), (1000, 600));
    assert!((500..900).contains(&decision.memory_tokens), "{}", decision.memory_tokens);
    let content = &bench.server.received()[0].body["messages"][1]["content"];
    let text = content.as_str().unwrap();
    assert!(text.starts_with("<memory>\n<document"), "{text}");
    assert!(text.contains("You see:\n[view not shown]\n"), "{text}");
    bench.rig.stop();
}

#[test]
fn a_request_that_hangs_delays_no_other_lane() {
    let server = Server::concurrent(|request| match lane_of(request) {
        0 => Reaction::Hang,
        _ => Reaction::says("turn right"),
    })
    .unwrap();
    let mut bench = Bench::new(server, settings());
    let frame = bench.publish(9);
    (0..LANES).for_each(|lane| bench.begin_lane(lane));
    bench.ask_lane(0, 0, frame, &[], &[]);
    for step in 0..5 {
        (1..LANES).for_each(|lane| bench.ask_lane(lane, step, frame, &[], &[]));
        let decisions = bench.decide(LANES as usize - 1);
        assert!(decisions.iter().all(|d| d.lane != 0 && d.step == step));
    }
    bench.rig.stop();
}

#[test]
fn a_stored_reply_costs_nothing_and_each_repetition_has_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::concurrent(|_| Reaction::says("turn right")).unwrap();
    let cache = ReplyCache::at(folder.path());
    let mut bench = Bench::with_cache(server, settings(), Some(cache));
    let frame = bench.publish(9);
    bench.begin_lane(1);
    // The same request at every step.
    let ask = |bench: &Bench, id| {
        let (feedback, action) = (Feedback::Moved as u8, Action::Forward as u8);
        let same = Observation { feedback, action, ..observation(id, frame) };
        bench.ask(&same, &recall(id, &[]));
    };
    for step in 0..2 {
        ask(&bench, RequestId { lane: 1, episode: episode(1), step });
        let decision = bench.decide(1)[0];
        let known = step == 1;
        assert_eq!((decision.replayed == 1, decision.attempts), (known, u32::from(!known)));
        assert_eq!(decision.sent_ns == 0, known);
        assert_eq!(decision.action, Action::TurnRight as u8);
    }
    bench.begin(&PolicyEpisodeConfig { episode: 999, repeat: 2, window: 0, ..lane_config(1) });
    ask(&bench, RequestId { lane: 1, episode: 999, step: 0 });
    assert_eq!(bench.decide(1)[0].replayed, 0);
    assert_eq!(bench.server.received().len(), 2);
    bench.rig.stop();
}

#[test]
fn a_server_that_refuses_the_key_stops_the_run() {
    let server = Server::concurrent(|_| Reaction::json(401, &json!({"error": "no"}))).unwrap();
    let mut bench = Bench::new(server, settings());
    let frame = bench.publish(9);
    bench.begin_lane(0);
    bench.ask_lane(0, 0, frame, &[], &[]);
    bench.notify();
    let (report, text) = bench.error_report();
    assert_eq!(report.kind, ErrorReportKind::Run as u32, "{text}");
    assert!(text.contains("401"), "{text}");
    bench.rig.stop();
}

/// While the server is gone, the policy reports it to the orchestrator; the decision comes when it is back.
#[test]
fn waiting_for_the_server_is_reported() {
    let unavailable = Reaction::json(503, &json!({"error": "loading the model"}));
    let says = || Reaction::says("turn right");
    let server = Server::turns([says(), unavailable.clone(), unavailable, says()]).unwrap();
    let mut bench = Bench::new(server, settings());
    let frame = bench.publish(9);
    bench.begin_lane(0);
    for step in 0..2 {
        bench.ask_lane(0, step, frame, &[], &[]);
        let decision = bench.decide(1)[0];
        assert_eq!(decision.action, Action::TurnRight as u8);
        if step == 1 {
            // The latency is that of the attempt that was answered.
            let waited_ns = decision.sent_ns - decision.prompted_ns;
            assert!(waited_ns > decision.decided_ns - decision.sent_ns, "{decision:?}");
        }
    }
    let reports = [(); 3].map(|()| bench.error_report());
    assert!(reports.iter().all(|(report, _)| report.kind == ErrorReportKind::Waiting as u32));
    assert!(reports[0].1.contains("loading the model); waiting up to 600 s"), "{reports:?}");
    assert_eq!(reports[2].1, "");
    bench.rig.stop();
}

#[test]
fn facts_for_the_manifest_are_what_decides_results() {
    let server = Server::turns([]).unwrap();
    let jpeg = OpenaiSettings { image_format: ImageFormat::Jpeg, ..settings() };
    let mut bench = Bench::new(server, jpeg);
    let facts = &mut bench.facts;
    let hash = facts["prompt_hash"].take();
    let endpoint = facts["endpoint"].take();
    assert!(endpoint.as_str().unwrap().ends_with("/v1/chat/completions"));
    assert_eq!(hash.as_str().unwrap().len(), 16);
    insta::assert_snapshot!(facts, @r#"{"answer_tokens":"30","endpoint":null,"image_budget":"50","image_format":"jpeg 90","model":"m","policy":"openai","prompt":"prompt/2","prompt_hash":null}"#);
    bench.rig.stop();
}
