//! The flat tables of a report: a row for each episode, and a row for each condition with every figure.

use std::collections::BTreeSet;

use case_book::WorldFacts;
use conditions::Condition;
use conditions::key::EpisodeKey;
use run_log::{EpisodeRecord, EpisodeTimings, RecallTotals, RunLog, Stages, StreamRecord};
use scores::{
    Comparison, ConditionScore, ControlScore, Derived, Estimate, FailurePoints, Spread,
    StreamScore, Successes, failure_of, path_weight,
};

use serde_json::Value;

use super::frame::{DataFrame, FrameBuilder};
use super::view::ScoredRun;

/// An episode of a run. One that was given up has an error, and no record.
#[derive(Debug)]
struct EpisodeRow<'a> {
    log: &'a RunLog,
    key: &'a str,
    /// The key in its parts; `None` for one that cannot be read.
    parts: Option<EpisodeKey>,
    record: Option<&'a EpisodeRecord>,
    timings: Option<&'a EpisodeTimings>,
    /// Since when it failed; `None` for a success.
    points: Option<FailurePoints>,
    error: Option<&'a str>,
}

/// A row for each episode of the runs, whose failures are compared with the successes beside them. There is a column for each of
/// `facts`, which worlds tell. An episode that was given up has the ending `given-up`, its key, its condition and its error, and no
/// other figure.
pub fn episodes_frame<'a>(
    runs: &[(&'a RunLog, &Successes)],
    facts: &'a BTreeSet<String>,
) -> DataFrame<'a> {
    let mut rows = Vec::new();
    for &(log, successes) in runs {
        let timings = log.timings_by_key();
        rows.extend(log.episodes.iter().map(|record| EpisodeRow {
            log,
            key: &record.key,
            parts: Some(record.own_key()),
            record: Some(record),
            timings: timings.get(record.key.as_str()).copied(),
            points: FailurePoints::of(record, successes),
            error: None,
        }));
        rows.extend(log.errors.iter().map(|error| EpisodeRow {
            log,
            key: &error.key,
            parts: EpisodeKey::read(&error.key),
            record: None,
            timings: None,
            points: None,
            error: Some(&error.error),
        }));
    }
    let mut frame = FrameBuilder::new(rows);
    add_run(&mut frame, |row| row.log);
    frame.text("key", |row| Some(row.key.to_owned()));
    add_condition(&mut frame, |row| Some(row.parts.as_ref()?.condition));
    frame.whole("run", |row| Some(row.parts.as_ref()?.run));
    frame.text("case", |row| Some(row.parts.as_ref()?.case.clone()));
    frame.whole("task", |row| Some(row.record?.task));
    frame.word("group", |row| Some(row.log.world.group_of(row.record?.task)?.to_owned()));
    frame.natural("seed", |row| Some(row.record?.seed));
    frame.word("ending", |row| {
        Some(row.record.map_or("given-up".to_owned(), |record| record.ending.to_string()))
    });
    frame.flag("success", |row| Some(row.record?.is_success()));
    frame.real("spl", |row| Some(path_weight(row.record?)));
    frame.text("error", |row| row.error.map(str::to_owned));
    frame.word("failure", move |row| Some(failure_of(row.record?, &row.log.world)?.kind));
    frame.whole("last_progress", |row| Some(row.points.as_ref()?.last_progress));
    frame.whole("first_repetition", |row| row.points.as_ref()?.first_repetition());
    let divergence = |row: &EpisodeRow<'_>| row.points.as_ref()?.divergence.clone();
    frame.whole("unlike_success_at", move |row| Some(divergence(row)?.step));
    frame.text("unlike_success", move |row| Some(divergence(row)?.success));
    frame.whole("steps", |row| Some(row.record?.steps));
    frame.whole("reference", |row| Some(row.record?.reference));
    frame.whole("sub_goals_met", |row| Some(row.record?.sub_goals.len()));
    frame.whole("sub_goals", |row| Some(row.record?.required));
    frame.flag("conflict", |row| row.record?.had_conflict());
    frame.text("actions", |row| Some(row.record?.actions.clone()));
    frame.whole("requests", |row| row.record?.requests);
    frame.whole("images", |row| row.record?.images);
    frame.whole("images_dropped", |row| Some(row.record?.images_dropped));
    frame.whole("prompt_tokens", |row| row.record?.prompt_tokens);
    frame.whole("completion_tokens", |row| row.record?.completion_tokens);
    frame.whole("memory_tokens", |row| row.record?.memory_tokens);
    frame.whole("unread", |row| Some(row.record?.unread.total()));
    frame.whole("unreadable", |row| Some(row.record?.unread.unreadable));
    frame.whole("empty", |row| Some(row.record?.unread.empty));
    frame.whole("refused", |row| Some(row.record?.unread.refused));
    frame.whole("cut_off", |row| Some(row.record?.unread.cut_off));
    frame.text("retrieved", |row| row.record?.retrieved.clone());
    frame.real("distance", |row| row.record?.distance);
    frame.whole("memory_items_dropped", |row| Some(row.record?.memory_items_dropped));
    frame.whole("memory_images_dropped", |row| Some(row.record?.memory_images_dropped));
    frame.whole("memory_text_dropped", |row| Some(row.record?.memory_text_dropped));
    fn recalls(row: &EpisodeRow<'_>) -> Option<RecallTotals> {
        Some(row.timings?.recalls).filter(|recalls| !recalls.is_none())
    }
    frame.whole("recalls", |row| Some(recalls(row)?.requests));
    frame.whole("recalled_items", |row| Some(recalls(row)?.items));
    frame.whole("recalled_images", |row| Some(recalls(row)?.images));
    frame.whole("recalled_text", |row| Some(recalls(row)?.text));
    frame.whole("store_bytes", |row| recalls(row)?.store_bytes);
    frame.whole("method_ns", |row| recalls(row)?.method_ns);
    frame.whole("answer_ns", |row| recalls(row)?.answer_ns);
    frame.whole("model_tokens_of_memory", |row| recalls(row)?.tokens);
    frame.whole("original_invalidated", |row| Some(i64::from(row.record?.blocked?.invalidated)));
    frame.whole("sources_blocked", |row| Some(row.record?.blocked?.retrievals));
    frame.whole("stale_blocked", |row| Some(row.record?.blocked?.stale));
    add_stream(&mut frame, |row| row.record?.stream.as_ref());
    add_world(&mut frame, facts);
    for (index, stage) in Stages::NAMES.into_iter().enumerate() {
        frame.real(format!("{stage}_us"), move |row| {
            Some(row.timings?.stages.values()[index] as f64 / 1000.0)
        });
    }
    frame.finish()
}

/// The names of the facts that worlds tell of these episodes.
pub fn world_facts<'a>(records: impl IntoIterator<Item = &'a EpisodeRecord>) -> BTreeSet<String> {
    let mut facts = BTreeSet::new();
    for fact in records.into_iter().flat_map(|record| record.world.keys()) {
        if !facts.contains(fact) {
            facts.insert(fact.clone());
        }
    }
    facts
}

/// A column for each fact that the worlds tell of episodes: texts as they are, anything else as JSON.
fn add_world<'a>(frame: &mut FrameBuilder<'a, EpisodeRow<'a>>, facts: &'a BTreeSet<String>) {
    for fact in facts {
        frame.text(format!("world_{fact}"), move |row| {
            Some(match row.record?.world.get(fact)? {
                Value::String(text) => text.clone(),
                value => value.to_string(),
            })
        });
    }
}

/// A row for each episode of the runs: when and where it ran, and the nanoseconds of all its steps in each stage.
pub fn timings_frame(logs: &[RunLog]) -> DataFrame<'_> {
    let rows: Vec<(&RunLog, &EpisodeTimings)> =
        logs.iter().flat_map(|log| log.timings.iter().map(move |timings| (log, timings))).collect();
    let mut frame = FrameBuilder::new(rows);
    add_run(&mut frame, |(log, _)| log);
    frame.text("key", |(_, timings)| Some(timings.key.clone()));
    frame.whole("session", |(_, timings)| Some(timings.session));
    frame.whole("attempt", |(_, timings)| Some(timings.attempt));
    frame.whole("lane", |(_, timings)| Some(timings.lane));
    frame.whole("started_ns", |(_, timings)| Some(timings.started_ns));
    frame.whole("ended_ns", |(_, timings)| Some(timings.ended_ns));
    frame.whole("steps", |(_, timings)| Some(timings.steps));
    for (index, stage) in Stages::NAMES.into_iter().enumerate() {
        frame
            .whole(format!("{stage}_ns"), move |(_, timings)| Some(timings.stages.values()[index]));
    }
    frame.finish()
}

/// A row for each condition of the runs, with every figure and the published ones.
pub(super) fn conditions<'a>(views: &'a [ScoredRun<'a>]) -> DataFrame<'a> {
    let rows: Vec<(&ScoredRun<'_>, &ConditionScore)> = views
        .iter()
        .flat_map(|view| view.scores.conditions.iter().map(move |score| (view, score)))
        .collect();
    let mut frame = FrameBuilder::new(rows);
    add_run(&mut frame, |(view, _)| view.log);
    frame.word("frames", |(view, _)| Some(view.log.manifest.settings.frames.to_string()));
    frame.text("condition", |(_, score)| Some(score.condition.to_string()));
    add_condition(&mut frame, |(_, score)| Some(score.condition));
    frame.text("memory_label", |(view, score)| Some(view.label(score.condition.memory)));
    frame.whole("episodes", |(_, score)| Some(score.episodes));
    frame.whole("planned", |(_, score)| Some(score.planned));
    frame.real("sr_if_missing_fail", |(_, score)| Some(score.bounds?.sr.low));
    frame.real("sr_if_missing_succeed", |(_, score)| Some(score.bounds?.sr.high));
    frame.whole("runs", |(_, score)| Some(score.runs));
    frame.whole("cases", |(_, score)| Some(score.cases));
    type OfSpread = fn(&ConditionScore) -> Option<Spread>;
    let spreads: [(&str, OfSpread); 9] = [
        ("sr", |score| Some(score.sr)),
        ("spl", |score| Some(score.spl)),
        ("follow", |score| score.blocked?.follow),
        ("stale", |score| score.blocked?.stale),
        ("recovery", |score| score.blocked?.recovery),
        ("images_per_request", |score| score.images_per_request),
        ("tokens_per_100", |score| score.tokens_per_100),
        ("unread", |score| score.unread),
        ("from_other_tasks", |score| score.from_other_cases),
    ];
    for (name, spread) in spreads {
        frame.real(name, move |(_, score)| Some(spread(score)?.mean));
        frame.real(format!("{name}_std"), move |(_, score)| spread(score)?.std);
        frame.whole(format!("{name}_runs"), move |(_, score)| Some(spread(score)?.runs));
        if matches!(name, "sr" | "spl" | "follow" | "recovery") {
            frame.interval(name, move |(_, score)| spread(score)?.interval);
        }
    }
    type OfDerived = fn(&ConditionScore) -> Option<Derived>;
    let derived: [(&str, OfDerived); 2] = [
        ("change", |score| score.blocked?.change),
        ("retention", |score| score.blocked?.retention),
    ];
    for (name, derived) in derived {
        frame.real(name, move |(_, score)| Some(derived(score)?.value));
        frame.interval(name, move |(_, score)| derived(score)?.interval);
    }
    let control = |view: &&ScoredRun<'_>, score: &&ConditionScore| {
        let is_it = |one: &&ControlScore| one.condition == score.condition;
        view.scores.controls.iter().find(is_it).cloned()
    };
    type OfControl = fn(&ControlScore) -> Option<&Comparison>;
    let differences: [(&str, OfControl); 2] =
        [("content", |one| one.content.as_ref()), ("headroom", |one| one.headroom.as_ref())];
    for (name, difference) in differences {
        frame.real(name, move |(view, score)| Some(difference(&control(view, score)?)?.sr.mean));
        frame.interval(name, move |(view, score)| difference(&control(view, score)?)?.sr.interval);
    }
    frame.whole("necessity_cases", move |(view, score)| {
        Some(control(view, score)?.necessity?.cases)
    });
    frame.whole("certified", move |(view, score)| Some(control(view, score)?.necessity?.certified));
    frame.real("sr_certified", move |(view, score)| {
        let necessity = control(view, score)?.necessity?;
        let mut success = necessity.success.iter();
        let own = success.find(|success| success.condition == score.condition)?;
        Some(own.certified?.mean)
    });
    for group in names(views, |world| world.groups.iter().map(|group| &group.name).collect()) {
        let of = |score: &ConditionScore| {
            score.groups.iter().find(|found| found.group == *group).map(|found| found.sr)
        };
        let name = format!("sr_{}", group.replace([' ', '-'], "_"));
        frame.real(name.clone(), move |(_, score)| Some(of(score)?.mean));
        frame.real(format!("{name}_std"), move |(_, score)| of(score)?.std);
    }
    frame.real("mean_steps", |(_, score)| score.mean_steps);
    for kind in names(views, |world| world.failures.iter().map(|kind| &kind.name).collect()) {
        let name = format!("failed_{}", kind.replace('-', "_"));
        frame.whole(name, move |(_, score)| {
            Some(score.failures.iter().find(|(found, _)| found == kind)?.1)
        });
    }
    for stage in Stages::NAMES {
        frame.real(format!("{stage}_us"), move |(_, score)| score.stage_us.as_ref()?.stage(stage));
    }
    let published = |view: &ScoredRun<'_>, score: &ConditionScore| {
        view.published.of(&score.condition.to_string()).cloned()
    };
    frame.real("published_sr", move |(view, score)| Some(published(view, score)?.sr?.mean));
    frame.real("published_sr_std", move |(view, score)| published(view, score)?.sr?.std);
    frame.real("published_spl", move |(view, score)| Some(published(view, score)?.spl?.mean));
    frame.real("published_tokens_per_100", move |(view, score)| {
        Some(published(view, score)?.mtok?.mean * 1e6)
    });
    frame.text("published_source", move |(view, score)| {
        Some(published(view, score)?.source).filter(|source| !source.is_empty())
    });
    frame.finish()
}

/// The names that `of` finds in the worlds of the runs, each once, in their order.
fn names<'a>(
    views: &'a [ScoredRun<'_>],
    of: impl Fn(&'a WorldFacts) -> Vec<&'a String>,
) -> Vec<&'a String> {
    let mut found = Vec::new();
    for name in views.iter().flat_map(|view| of(&view.log.world)) {
        if !found.contains(&name) {
            found.push(name);
        }
    }
    found
}

/// The columns that say of which run a row is, and whose figures it holds.
pub(super) fn add_run<'a, T: 'a>(
    frame: &mut FrameBuilder<'a, T>,
    of: impl Fn(&T) -> &RunLog + Copy + 'a,
) {
    frame.text("log", move |row| Some(of(row).name.clone()));
    frame.word("policy", move |row| Some(of(row).manifest.settings.policy.to_string()));
    frame.word("policy_role", move |row| Some(of(row).manifest.policy_role()?.to_string()));
}

/// The columns that say under which condition a row is.
fn add_condition<'a, T: 'a>(
    frame: &mut FrameBuilder<'a, T>,
    of: impl Fn(&T) -> Option<Condition> + Copy + 'a,
) {
    frame.word("memory", move |row| Some(of(row)?.memory.to_string()));
    frame.word("start", move |row| Some(of(row)?.start.to_string()));
    frame.word("route", move |row| Some(of(row)?.route.to_string()));
    frame.word("demonstrations", move |row| Some(of(row)?.demonstrations.to_string()));
    frame.whole("window", move |row| Some(of(row)?.variation.window));
    frame.word("segment", move |row| Some(of(row)?.variation.segment.to_string()));
    frame.word("hint", move |row| Some(of(row)?.variation.hint.to_string()));
    frame.word("mismatch", move |row| Some(of(row)?.mismatch.to_string()));
    frame.word("arm", move |row| Some(of(row)?.arm.word().to_owned()));
}

/// The columns that say where in a stream an episode stands, all absent outside of streams.
fn add_stream<'a, T: 'a>(
    frame: &mut FrameBuilder<'a, T>,
    of: impl Fn(&T) -> Option<&StreamRecord> + Copy + 'a,
) {
    frame.whole("stream", move |row| Some(of(row)?.stream));
    frame.word("order", move |row| Some(of(row)?.order.word().to_owned()));
    frame.word("feedback", move |row| Some(of(row)?.feedback.word().to_owned()));
    frame.whole("position", move |row| Some(of(row)?.position));
    frame.whole("block", move |row| Some(of(row)?.block));
    frame.whole("place", move |row| Some(of(row)?.place));
    frame.whole("blocks_learned", move |row| Some(of(row)?.after));
    frame.whole("round", move |row| of(row)?.round);
    frame.whole("world", move |row| Some(of(row)?.world));
    frame.whole("retrievals", move |row| Some(of(row)?.retrievals));
    frame.whole("stale", move |row| Some(of(row)?.stale));
    frame.whole("stored_bytes", move |row| of(row)?.store_bytes);
    frame.flag("invalidated", move |row| Some(of(row)?.invalidated));
    frame.text("snapshot", move |row| of(row)?.snapshot.clone());
}

/// A row for each condition of the runs' streams, with every figure.
pub(super) fn streams<'a>(views: &'a [ScoredRun<'a>]) -> DataFrame<'a> {
    let rows: Vec<(&ScoredRun<'_>, &StreamScore)> = views
        .iter()
        .filter_map(|view| Some((view, view.scores.streams.as_ref()?)))
        .flat_map(|(view, streams)| streams.conditions.iter().map(move |score| (view, score)))
        .collect();
    let most = rows.iter().map(|(_, score)| score.matrix.len()).max().unwrap_or(0);
    let mut frame = FrameBuilder::new(rows);
    add_run(&mut frame, |(view, _)| view.log);
    frame.text("condition", |(_, score)| Some(score.condition.to_string()));
    add_condition(&mut frame, |(_, score)| Some(score.condition));
    frame.text("memory_label", |(view, score)| Some(view.label(score.condition.memory)));
    frame.whole("streams", |(_, score)| Some(score.streams));
    frame.whole("sequences", |(_, score)| Some(score.sequences));
    frame.whole("planned", |(_, score)| Some(score.planned));
    type Figure = fn(&StreamScore) -> Option<Estimate>;
    let figures: [(&str, Figure); 15] = [
        ("success", |score| score.success),
        ("before_events", |score| score.before),
        ("after_events", |score| score.after),
        ("acc", |score| score.average),
        ("bwt", |score| score.backward),
        ("fwt", |score| score.forward),
        ("forgetting", |score| score.forgetting),
        ("t_ndtw", |score| score.t_ndtw),
        ("regret", |score| score.regret),
        ("lag", |score| score.lag),
        ("adapted", |score| score.adapted),
        ("stale", |score| score.stale),
        ("stale_after_events", |score| score.stale_after),
        ("order_range", |score| score.order_spread),
        ("order_range_acc", |score| score.order_spread_average),
    ];
    for (name, figure) in figures {
        frame.real(name, move |(_, score)| Some(figure(score)?.mean));
        frame.interval(name, move |(_, score)| figure(score)?.interval);
        frame.whole(format!("{name}_streams"), move |(_, score)| Some(figure(score)?.streams));
    }
    for learned in 0..most {
        for block in 1..most {
            frame.real(format!("r_{learned}_{block}"), move |(_, score)| {
                *score.matrix.get(learned)?.get(block - 1)?
            });
        }
    }
    frame.finish()
}
