//! Made-up runs of the whole paper suite and of streams, as plausible as a hash of names can make them.

use conditions::key::EpisodeKey;
use conditions::settings::{Group, RunSettings};
use conditions::{Condition, Demonstrations, Route, SegmentContent, Start};
use domain::{Action, Arm, MemoryKind, Representation, StreamOrder};
use rigs::records::{
    external_memory, log, record, script_document, sequence, settings, stream_log, tell,
    tell_failure, under, world,
};
use run_log::{Ending, EpisodeRecord, RecallTotals, RunLog, StreamRecord, Unread};

/// Every condition of the shipped suite `paper`, each with its number of runs.
pub(crate) fn paper_conditions() -> Vec<(Condition, u32)> {
    let suite: toml::Table = include_str!("../../../assets/suites/paper.toml").parse().unwrap();
    let default = toml::Value::try_from(settings().groups.remove(0)).unwrap();
    let group = |group: &toml::Value| -> Group {
        let mut table = default.as_table().unwrap().clone();
        let group = group.as_table().unwrap();
        for (key, value) in suite.iter().chain(group) {
            if key == "name" || table.contains_key(key) {
                table.insert(key.clone(), value.clone());
            }
        }
        table.try_into().unwrap()
    };
    let groups = suite["group"].as_array().unwrap().iter().map(group).collect();
    RunSettings { groups, ..settings() }.runs()
}

/// A run of `conditions` on ten cases of each of `tasks`.
pub(crate) fn made_up(conditions: &[(Condition, u32)], tasks: &[u8]) -> RunLog {
    let mut episodes = Vec::new();
    for &(condition, runs) in conditions {
        for run in 1..=runs {
            for &task in tasks {
                for number in 1..=10 {
                    let case = format!("t{task:02}-{number:02}");
                    episodes.push(episode(EpisodeKey { condition, run, place: None, case }, task));
                }
            }
        }
    }
    episodes.sort_by(|a, b| a.key.cmp(&b.key));
    let mut log = log(episodes);
    (log.dir, log.name) = ("runs/made-up".into(), "made-up".to_owned());
    for name in conditions.iter().filter_map(|(condition, _)| condition.memory.external()) {
        log.manifest.memories.entry(name).or_insert_with(|| external_memory("1"));
    }
    for (condition, _) in conditions {
        let kinds = condition.memory.describe().map_or(&[][..], |info| info.documents).iter();
        let names = kinds.map(|kind| format!("{}/{}", kind.word(), condition.demonstrations));
        log.manifest.documents.extend(names.map(|name| (name, script_document())));
    }
    for (timings, record) in log.timings.iter_mut().zip(&log.episodes) {
        let requests = record.steps;
        timings.recalls = RecallTotals {
            requests,
            items: u64::from(requests),
            images: u64::from(requests) * 7,
            ..RecallTotals::default()
        };
        if record.memory.external().is_some() {
            let each = u64::from(requests) * 1000;
            (timings.recalls.method_ns, timings.recalls.answer_ns) =
                (Some(40 * each), Some(90 * each));
            timings.recalls.store_bytes = Some(123_456);
        }
        let stages = &mut timings.stages;
        (stages.render, stages.decide) = (stages.render * 900, stages.decide * 2500);
        if record.memory == Representation::Episodic {
            (stages.embed, stages.search) = (stages.embed * 40_000, stages.search * 60);
        }
    }
    log
}

/// One episode. Its outcome follows from a hash of its key; the probability depends on its condition.
fn episode(key: EpisodeKey, task: u8) -> EpisodeRecord {
    // The same chance for the same case under every condition, so that comparisons are paired.
    let luck = hash(&key, |key| key.condition.memory = Representation::Working.into()) % 60;
    let chance = (luck + hash(&key, |_| {}) % 40) as i64;
    let condition = key.condition;
    let world = world();
    let group = world.group_of(task).unwrap();
    let less = if group == "revisit" { 20 } else { 0 };
    let success = chance < likely(&condition) - less;
    let record = EpisodeRecord { run: key.run, task, ..record(&key.case, success) };
    let mut record = under(condition, record);
    record.steps = if success { 20 + chance as u32 } else { 200 };
    (record.reference, record.required) = (18, if group == "basic" { 1 } else { 3 });
    record.requests = Some(record.steps);
    record.images = Some(u64::from(record.steps) * u64::from(settings().images(&condition)));
    record.sub_goals =
        if success { vec![record.steps; record.required as usize] } else { Vec::new() };
    record.actions = Action::Forward.letter().to_string().repeat(record.steps as usize);
    let tried = condition.route == Route::Blocked && chance % 5 != 0;
    record.conflict_at = (condition.route == Route::Blocked && tried).then_some(20);
    if condition.memory == Representation::Episodic {
        let other = condition.demonstrations.mixture().is_some();
        record.retrieved = Some(if other { "o1 p2 t03-07:o4" } else { "o1 o2 o3" }.to_owned());
        record.distance = Some(0.25);
    }
    if !success {
        fail(&mut record, chance, group == "basic");
    }
    record
}

/// Makes the failure one of several kinds.
fn fail(record: &mut EpisodeRecord, chance: i64, is_basic: bool) {
    record.ending = Ending::OutOfSteps;
    if record.conflict_at.is_some() && chance % 3 == 0 {
        tell_failure(record, "blocked", 190);
        return;
    }
    match chance % 4 {
        0 => tell(record, "looped_at", 156),
        1 => tell_failure(record, "saw-and-left", 12),
        2 if !is_basic => {
            record.sub_goals = vec![9];
            tell_failure(record, "wrong-order", 3);
        }
        _ => record.unread = Unread { unreadable: chance as u32, empty: 0, refused: 1, cut_off: 0 },
    }
}

fn likely(condition: &Condition) -> i64 {
    use Representation::{Adaptive, Episodic, FullContext, Hybrid, Semantic, Summary, Working};
    let original = condition.start == Start::Original;
    let exact = original && condition.demonstrations == Demonstrations::ORIGINAL;
    match condition.arm {
        Arm::Oracle => return 90,
        Arm::Wrong => return 35,
        Arm::Frozen | Arm::Learning => {}
    }
    let MemoryKind::BuiltIn(representation) = condition.memory else {
        return 40 + condition.memory.name().len() as i64 * 3;
    };
    let base = match representation {
        Working => 25 + condition.variation.window as i64,
        FullContext if exact => 97,
        FullContext => 60,
        Summary => 55,
        Semantic => 32,
        Hybrid => 52,
        Episodic | Adaptive if exact => 120,
        Episodic | Adaptive => 70,
    };
    let blocked = if condition.route == Route::Blocked { 24 } else { 0 };
    let images = if condition.variation.segment == SegmentContent::Images { 60 } else { 0 };
    let mixed = if condition.demonstrations.mixture().is_some() { 12 } else { 0 };
    base - blocked - images - mixed
}

fn hash(key: &EpisodeKey, change: impl Fn(&mut EpisodeKey)) -> u64 {
    let mut key = key.clone();
    change(&mut key);
    let conditions = [Demonstrations::NONE, key.condition.demonstrations];
    key.condition.demonstrations =
        conditions[usize::from(key.condition.memory != Representation::Working)];
    (key.condition.start, key.condition.route) = (Start::New, Route::Unchanged);
    let hash = blake3::hash(key.to_string().as_bytes());
    u64::from_le_bytes(*hash.as_bytes().first_chunk().unwrap())
}

/// A made-up run of four streams in three orders: no memory, and the arms of Episodic and Adaptive.
pub(crate) fn made_up_streams() -> RunLog {
    const CASES: [&str; 4] = ["t01-01", "t02-03", "t03-07", "t09-02"];
    let blocks: Vec<(u32, &[&str])> = (0..4).map(|block| (block, &CASES[..])).collect();
    let order = |order| match order {
        StreamOrder::Drawn => blocks.clone(),
        StreamOrder::Reversed => blocks.iter().rev().copied().collect(),
        StreamOrder::Shuffled => [2, 0, 3, 1].map(|block| blocks[block]).to_vec(),
    };
    let mut conditions = vec!["working/new/unchanged/none".to_owned()];
    for memory in ["episodic", "adaptive"] {
        let learning = if memory == "adaptive" { "/learning" } else { "" };
        for arm in ["", learning, "/oracle", "/wrong"] {
            conditions.push(format!("{memory}/new/unchanged/original{arm}"));
        }
    }
    conditions.dedup();
    let mut episodes = Vec::new();
    for name in conditions {
        let condition = Condition::logged(&name).unwrap();
        for (stream, of) in (0..4).flat_map(|stream| StreamOrder::ALL.map(|of| (stream, of))) {
            let succeeds = |at: &StreamRecord, case: &str| {
                let place = format!("{stream} {} {case}", at.block);
                let luck = blake3::hash(place.as_bytes()).as_bytes()[0] % 60;
                let own = blake3::hash(format!("{name} {place} {}", at.position).as_bytes());
                let chance = i64::from(luck) + i64::from(own.as_bytes()[0] % 40);
                let learned = 8 * i64::from(at.after * 3 + at.round.unwrap_or(0));
                let changed = if at.block > 0 { 45 } else { 0 };
                chance
                    < match (condition.memory.uses_demonstrations(), condition.arm) {
                        (false, _) => 25,
                        (true, Arm::Frozen) => 85 - changed,
                        (true, Arm::Learning) => 85 - (changed - learned.min(40)).max(0),
                        (true, Arm::Oracle) => 92,
                        (true, Arm::Wrong) => 20,
                    }
            };
            episodes.extend(sequence((condition, 1), (stream, of), &order(of), 3, succeeds));
        }
    }
    for record in episodes.iter_mut().filter(|record| !record.memory.uses_demonstrations()) {
        let stream = record.stream.as_mut().unwrap();
        (stream.retrievals, stream.stale, stream.store_bytes) = (0, 0, None);
    }
    let mut log = stream_log(episodes, [4, 4, 3]);
    let group = &mut log.manifest.settings.groups[0];
    group.memory = vec![
        Representation::Working.into(),
        Representation::Episodic.into(),
        Representation::Adaptive.into(),
    ];
    (group.starts, group.arms) = (vec![Start::New], Arm::ALL.to_vec());
    (log.dir, log.name) = ("runs/made-up-streams".into(), "made-up-streams".to_owned());
    for (timings, record) in log.timings.iter_mut().zip(&log.episodes) {
        timings.recalls.requests = record.steps;
        timings.stages.search *= 20 + 3 * u64::from(record.stream.as_ref().unwrap().after);
    }
    log
}
