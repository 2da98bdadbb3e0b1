//! Settings, manifests and records for tests.
//!
//! The tests of `run-log` itself include this file, because what this crate links is not the crate that is tested.

use std::collections::BTreeMap;

use case_book::{FailureKind, WorldFacts};
use conditions::settings::{ModelSettings, RunSettings, StreamSettings};
use conditions::{Condition, Demonstrations, Start, Variation};
use domain::{Arm, FeedbackLevel, Outcome, Representation, StreamOrder};
use run_log::{
    DocumentFacts, Ending, EpisodeRecord, EpisodeTimings, ExternalMemoryFacts, FORMAT, Manifest,
    RecallTotals, RequestRecord, RunLog, Stages, StreamRecord,
};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// The manifest of a run with every setting at its default.
pub fn manifest() -> Manifest {
    Manifest {
        format: FORMAT,
        version: "1.2.3".to_owned(),
        wire_version: 4,
        commit: None,
        settings: settings(),
        hashes: BTreeMap::from([("layout".to_owned(), "00".to_owned())]),
        tasks: BTreeMap::new(),
        documents: BTreeMap::new(),
        memories: BTreeMap::new(),
        policy_files: BTreeMap::new(),
        world_files: BTreeMap::new(),
        world_varies: false,
        prices: None,
        episodes: 4,
        unit: None,
        processes: BTreeMap::new(),
    }
}

/// The settings of a model called `name`, with every value at its default.
pub fn model_settings(name: &str) -> ModelSettings {
    made(json!({
        "model": name,
        "image-format": "png",
        "image-budget": 50,
        "answer-tokens": 30,
        "max-connections": 16,
        "max-retries": 5,
        "request-timeout": 120,
        "response-cache": "off",
    }))
}

/// A document by a builder that asks no model, `extractive`.
pub fn script_document() -> DocumentFacts {
    made(json!({ "sha256": "00", "builder": "extractive", "bytes": 2_000, "words": 300 }))
}

/// A document that a run had the model `name` write in 5 requests with 1,000 tokens of prompts and 100 of answers.
pub fn model_document(name: &str) -> DocumentFacts {
    made(json!({
        "sha256": "11",
        "builder": "model",
        "model": name,
        "usage": { "requests": 5, "prompt_tokens": 1_000, "completion_tokens": 100 },
        "built": true,
        "bytes": 2_000,
        "words": 300,
    }))
}

/// What `json` says, where nothing is said as in a log of a run with defaults.
fn made<T: DeserializeOwned>(json: Value) -> T {
    serde_json::from_value(json).unwrap()
}

/// The settings of a suite like `quick`, with every value at its default.
pub fn settings() -> RunSettings {
    made(json!({
        "suite": "quick",
        "policy": "grounded",
        "group": [{
            "memory": Representation::ALL,
            "starts": Start::ALL,
            "routes": ["unchanged"],
            "demos": ["original"],
            "window": [6],
            "segment": ["actions"],
            "hint": ["on"],
            "runs": 1,
        }],
        "cases": ["all"],
        "seed": 1,
        "max-steps": 200,
        "horizon": 6,
        "keyframes": 40,
        "documents": "extractive",
        "frame-size": 448,
        "frames": "rendered",
        "encoder": "dinov2-s14",
        "out": "runs/quick-grounded",
        "lanes": 16,
        "spin-us": 0,
        "step-timeout": 120,
        "start-timeout": 300,
    }))
}

/// The lines of a journal without their checksums, as earlier versions wrote them. What is edited then, is not damaged.
pub fn without_checksums(text: &str) -> String {
    let line = |line: &str| match line.rsplit_once(",\"checksum\":\"") {
        Some((object, _)) => format!("{object}}}\n"),
        None => format!("{line}\n"),
    };
    text.lines().map(line).collect()
}

/// The record of `case` under episodic memory: a success is 10 steps for a reference of 8, a failure 200.
pub fn record(case: &str, success: bool) -> EpisodeRecord {
    let steps: u8 = if success { 10 } else { 200 };
    let mut record = keyed(made(json!({
        "key": "",
        "memory": "episodic",
        "start": "original",
        "route": "unchanged",
        "demonstrations": Demonstrations::ORIGINAL,
        "run": 1,
        "case": case,
        "task": 1,
        "seed": 0,
        "ending": if success { Ending::Complete } else { Ending::OutOfSteps },
        "steps": steps,
        "reference": 8,
        "actions": "f".repeat(steps.into()),
        "sub_goals": if success { vec![10] } else { vec![] },
        "required": 1,
        "requests": steps,
        "images": u64::from(steps) * 14,
        "world": {
            "start_pose": "1,2,N",
            "final_pose": format!("1,{},N", 2 + steps),
            "visits": [],
            "first_seen": {},
            "blocked_moves": [],
        },
    })));
    if !success {
        tell_failure(&mut record, "never-saw", steps.into());
    }
    record
}

/// Sets the fact that an episode failed in this way, by an event at step `step`.
pub fn tell_failure(record: &mut EpisodeRecord, kind: &str, step: u32) {
    tell(record, "failure", json!({"kind": kind, "step": step}));
}

/// Sets a fact that the world tells of an episode.
pub fn tell(record: &mut EpisodeRecord, fact: &str, value: impl Into<Value>) {
    record.world.insert(fact.to_owned(), value.into());
}

/// A world with the declaration, groups, tasks and kinds of failure of the warehouse.
pub fn world() -> WorldFacts {
    let actions = [
        ('f', "move forward"),
        ('b', "move backward"),
        ('l', "move left"),
        ('r', "move right"),
        ('L', "turn left"),
        ('R', "turn right"),
        ('U', "turn around"),
    ];
    let declaration = json!({
        "name": "warehouse",
        "version": "1",
        "rules": "Move about in a warehouse.",
        "actions": actions.map(|(letter, words)| json!({"letter": letter, "words": words})),
        "state": [
            {"name": "column"},
            {"name": "row"},
            {"name": "heading", "words": ["north", "east", "south", "west"]},
        ],
        "state_sentence": "You are in column {column}, row {row}, and face {heading}.",
        "feedback": [
            "The episode has just begun.",
            "You moved.",
            "You turned.",
            "Something blocks the way: you did not move.",
            "Your last answer was not understood: you did not move.",
        ],
        "is_deterministic": true,
    });
    let groups = [
        ("basic", "Basic (T1–T2)", &[1, 2][..]),
        ("multi-object", "Multi-object (T3–T6)", &[3, 4, 5, 6]),
        ("return loops", "Return loops (T7, T8, T10)", &[7, 8, 10]),
        ("revisit", "Revisit (T9)", &[9]),
    ];
    let tasks = groups.iter().flat_map(|(group, _, numbers)| {
        numbers.iter().map(move |number| json!({"number": number, "name": format!("task {number}"), "group": group}))
    });
    let failures = [
        ("unreadable", "in at least half of the answers no action could be read"),
        (
            "blocked",
            "tried to enter a closed cell, then met no requirement and hardly went anywhere new",
        ),
        ("looped", "at least 5 times in the same state within the last 60 steps"),
        ("wrong-order", "stood before B ahead of A, and not again after it"),
        ("no-return", "everything done except the return to the origin"),
        ("no-revisit", "everything done except visiting the same instance again"),
        ("missed-instance", "visited some of the instances and not all"),
        ("never-saw", "the target that was next was never in view"),
        ("saw-and-left", "the target that was next was in view and was never reached"),
        ("out-of-steps", "none of the other kinds"),
    ];
    made(json!({
        "declaration": declaration,
        "hashes": {},
        "views": 0,
        "elsewhere_views": 0,
        "groups": groups.map(|(name, heading, _)| json!({"name": name, "heading": heading})),
        "tasks": tasks.collect::<Vec<_>>(),
        "failures": failures.map(FailureKind::new),
    }))
}

/// The record with the key that its fields make, and the seed of that in a run with the master seed of [`settings`].
pub fn keyed(record: EpisodeRecord) -> EpisodeRecord {
    let key = record.own_key();
    EpisodeRecord { key: key.to_string(), seed: key.seed(1), ..record }
}

/// The record, of an episode under `condition`.
pub fn under(condition: Condition, record: EpisodeRecord) -> EpisodeRecord {
    let Condition { memory, start, route, demonstrations, variation, mismatch, arm } = condition;
    let Variation { window, segment, hint } = variation;
    keyed(EpisodeRecord {
        memory,
        start,
        route,
        demonstrations,
        window,
        segment,
        hint,
        mismatch,
        arm,
        ..record
    })
}

/// The record of `case` as a learning episode: stream 2, reversed, position 17, in a block that events have changed.
pub fn stream_record(case: &str, success: bool) -> EpisodeRecord {
    let stream = StreamRecord {
        stream: 2,
        order: StreamOrder::Reversed,
        position: 17,
        block: 3,
        place: 1,
        after: 1,
        round: Some(2),
        feedback: FeedbackLevel::Success,
        world: 1,
        invalidated: true,
        reference_actions: "f".repeat(8),
        retrievals: 2,
        stale: 1,
        snapshot: Some("0123456789abcdef".repeat(2)),
        store_bytes: Some(1000),
    };
    let mut record = EpisodeRecord {
        start: Start::New,
        arm: Arm::Learning,
        stream: Some(stream),
        ..record(case, success)
    };
    tell(&mut record, "completes_in", json!([0]));
    keyed(record)
}

/// A whole sequence: an evaluation of all `blocks`, and for each one round of learning and another evaluation. A block is
/// its number as drawn and its cases. `outcome` says which episodes succeed.
pub fn sequence(
    (condition, run): (Condition, u32),
    (stream, order): (u32, StreamOrder),
    blocks: &[(u32, &[&str])],
    rounds: u32,
    outcome: impl Fn(&StreamRecord, &str) -> bool,
) -> Vec<EpisodeRecord> {
    let mut episodes = Vec::new();
    let mut add = |place: usize, after: usize, round: Option<u32>| {
        let (block, cases) = blocks[place];
        for case in cases {
            let learns = condition.arm == Arm::Learning && round.is_some();
            let place = StreamRecord {
                stream,
                order,
                position: episodes.len() as u32,
                block,
                place: place as u32,
                after: after as u32,
                round,
                feedback: FeedbackLevel::Success,
                world: block,
                invalidated: block > 0,
                reference_actions: "f".repeat(8),
                retrievals: 2,
                stale: u32::from(block > 0),
                snapshot: learns.then(|| "0123456789abcdef".repeat(2)),
                store_bytes: Some(1000 * (1 + after as u64)),
            };
            let success = outcome(&place, case);
            let mut record = record(case, success);
            // Two cells, or 192, further than the end of a reference of nine.
            let distance_m = if success { 3.0 } else { 18_528.0 };
            tell(&mut record, "path", json!({"distance_m": distance_m, "length": 9}));
            if learns {
                tell(&mut record, "completes_in", json!([0]));
            }
            episodes.push(under(condition, EpisodeRecord { run, stream: Some(place), ..record }));
        }
    };
    (0..blocks.len()).for_each(|place| add(place, 0, None));
    for learned in 0..blocks.len() {
        (1..=rounds).for_each(|round| add(learned, learned, Some(round)));
        (0..blocks.len()).for_each(|place| add(place, learned + 1, None));
    }
    episodes
}

/// The log of a run of streams, each of `blocks` blocks with `cases` cases, each learned `rounds` times.
pub fn stream_log(episodes: Vec<EpisodeRecord>, [blocks, cases, rounds]: [u32; 3]) -> RunLog {
    let streams = episodes.iter().filter_map(|record| Some(record.stream.as_ref()?.stream + 1));
    let stream = StreamSettings {
        streams: streams.max().unwrap_or(0),
        blocks,
        cases_per_block: cases,
        rounds,
        events: Vec::new(),
        orders: StreamOrder::ALL.to_vec(),
        feedback: FeedbackLevel::Success,
        evaluate: true,
    };
    let mut log = log(episodes);
    log.manifest.settings.stream = Some(stream);
    log
}

/// Timings that go with `record`: every step spends 1 us in each stage.
pub fn timings(record: &EpisodeRecord) -> EpisodeTimings {
    let each = u64::from(record.steps) * 1000;
    EpisodeTimings {
        key: record.key.clone(),
        session: 1,
        generation: 1,
        episode: 1,
        attempt: 1,
        lane: 0,
        started_ns: 0,
        ended_ns: 2_000_000_000,
        steps: record.steps,
        invalid_messages: 0,
        stages: made(Stages::NAMES.map(|stage| (stage, json!(each))).into_iter().collect()),
        recalls: RecallTotals::default(),
    }
}

/// An external memory in this version of its own.
pub fn external_memory(version: &str) -> ExternalMemoryFacts {
    ExternalMemoryFacts {
        index: 0,
        version: version.to_owned(),
        command: Some("python mine.py".to_owned()),
        scope: "case".to_owned(),
        embeddings: true,
        frames: false,
        deterministic: true,
        learns: false,
        sdk: "memtransfer 1".to_owned(),
        code: String::new(),
        files: BTreeMap::new(),
    }
}

/// An answered request: 1000 prompt tokens, 300 of them memory, 200 cached, and 3 completion tokens.
pub fn request(key: &str, step: u32) -> RequestRecord {
    RequestRecord {
        key: key.to_owned(),
        step,
        session: 1,
        outcome: Outcome::Acted,
        attempts: Some(1),
        replayed: false,
        latency_us: Some(500_000),
        images_asked: Some(7),
        images: Some(7),
        prompt_tokens: Some(1000),
        completion_tokens: Some(3),
        cached_tokens: Some(200),
        image_tokens: Some(400),
        memory_tokens: Some(300),
        reusable_tokens: Some(250),
        finish_reason: None,
        reasoned: None,
        model: None,
    }
}

/// The log of a run of which `episodes` are finished.
pub fn log(episodes: Vec<EpisodeRecord>) -> RunLog {
    RunLog {
        dir: "run".into(),
        name: "run".to_owned(),
        manifest: Manifest { episodes: episodes.len() as u32, ..manifest() },
        world: world(),
        cases: BTreeMap::new(),
        timings: episodes.iter().map(timings).collect(),
        episodes,
        requests: Vec::new(),
        errors: Vec::new(),
        sessions: Vec::new(),
        damaged: Vec::new(),
    }
}
