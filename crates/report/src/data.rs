//! The flat tables of a report: a row for each episode, and a row for each condition with every figure.

use std::collections::BTreeMap;

use results::conditions::Condition;
use results::key::EpisodeKey;
use results::log::{
    EpisodeError, EpisodeRecord, EpisodeTimings, RecallTotals, RunLog, Stages, StreamRecord,
};
use results::score::{
    ConditionScore, Derived, Estimate, Failure, Spread, StreamScore, group_of, path_weight,
};

use super::frame::{DataFrame, FrameBuilder};
use super::view::ScoredRun;

/// An episode of a run: finished, or given up.
#[derive(Debug)]
enum EpisodeTableRow<'a> {
    Finished(&'a EpisodeRecord, Option<&'a EpisodeTimings>),
    GivenUp(&'a EpisodeError),
}

impl<'a> EpisodeTableRow<'a> {
    fn record(&self) -> Option<&'a EpisodeRecord> {
        match self {
            Self::Finished(record, _) => Some(record),
            Self::GivenUp(_) => None,
        }
    }

    fn key(&self) -> &'a str {
        match self {
            Self::Finished(record, _) => &record.key,
            Self::GivenUp(error) => &error.key,
        }
    }

    /// Which repetition of which case.
    fn run_and_case(&self) -> Option<(u32, String)> {
        match self {
            Self::Finished(record, _) => Some((record.run, record.case.clone())),
            Self::GivenUp(error) => EpisodeKey::read(&error.key).map(|key| (key.run, key.case)),
        }
    }

    fn condition(&self) -> Option<Condition> {
        match self {
            Self::Finished(record, _) => Some(record.condition()),
            Self::GivenUp(error) => Some(EpisodeKey::read(&error.key)?.condition),
        }
    }
}

/// A count of an episode.
type Count = fn(&EpisodeRecord) -> u64;

/// A row for each episode of the runs. An episode that was given up has the ending `given-up`, its key, its condition
/// and its error, and no other figure.
pub fn episodes_frame(logs: &[RunLog]) -> DataFrame {
    let mut rows = Vec::new();
    for log in logs {
        let timings: BTreeMap<&str, &EpisodeTimings> =
            log.timings.iter().map(|timings| (timings.key.as_str(), timings)).collect();
        let name = log.name.clone();
        let finished = log.episodes.iter().map(|record| {
            EpisodeTableRow::Finished(record, timings.get(record.key.as_str()).copied())
        });
        let given_up = log.errors.iter().map(EpisodeTableRow::GivenUp);
        rows.extend(finished.chain(given_up).map(|episode| (name.clone(), episode)));
    }
    fn of<'a>((_, episode): &(String, EpisodeTableRow<'a>)) -> Option<&'a EpisodeRecord> {
        episode.record()
    }
    let mut frame = FrameBuilder::new(&rows);
    frame.text("log", |(log, _)| Some(log.clone()));
    frame.text("key", |(_, episode)| Some(episode.key().to_owned()));
    add_condition(&mut frame, |(_, episode)| episode.condition());
    frame.whole("run", |(_, episode)| Some(episode.run_and_case()?.0.into()));
    frame.text("case", |(_, episode)| Some(episode.run_and_case()?.1));
    frame.whole("task", |row| Some(of(row)?.task.into()));
    frame.text("group", |row| Some(group_of(of(row)?.task).name().to_owned()));
    frame.text("seed", |row| Some(of(row)?.seed.to_string()));
    frame.text("ending", |row| {
        Some(of(row).map_or("given-up".to_owned(), |record| record.ending.to_string()))
    });
    frame.flag("success", |row| Some(of(row)?.is_success()));
    frame.real("spl", |row| Some(path_weight(of(row)?)));
    frame.text("error", |(_, episode)| match episode {
        EpisodeTableRow::Finished(..) => None,
        EpisodeTableRow::GivenUp(error) => Some(error.error.clone()),
    });
    frame.text("failure", |row| Some(Failure::of(of(row)?)?.name().to_owned()));
    frame.whole("steps", |row| Some(of(row)?.steps.into()));
    frame.whole("reference", |row| Some(of(row)?.reference.into()));
    frame.whole("sub_goals_met", |row| Some(of(row)?.sub_goals.len() as i64));
    frame.whole("sub_goals", |row| Some(of(row)?.required.into()));
    frame.flag("tried_closed", |row| of(row)?.tried_closed);
    frame.whole("blocked_moves", |row| Some(of(row)?.blocked_moves.len() as i64));
    frame.text("start_pose", |row| Some(of(row)?.start_pose.to_string()));
    frame.text("final_pose", |row| Some(of(row)?.final_pose.to_string()));
    frame.text("actions", |row| Some(of(row)?.actions.clone()));
    frame.whole("requests", |row| of(row)?.requests.map(i64::from));
    frame.whole("images", |row| of(row)?.images.map(|images| images as i64));
    frame.whole("images_dropped", |row| Some(of(row)?.images_dropped as i64));
    frame.whole("prompt_tokens", |row| of(row)?.prompt_tokens.map(|tokens| tokens as i64));
    frame.whole("completion_tokens", |row| of(row)?.completion_tokens.map(|tokens| tokens as i64));
    frame.whole("memory_tokens", |row| of(row)?.memory_tokens.map(|tokens| tokens as i64));
    frame.whole("unread", |row| Some(of(row)?.unread.total().into()));
    frame.whole("unreadable", |row| Some(of(row)?.unread.unreadable.into()));
    frame.whole("empty", |row| Some(of(row)?.unread.empty.into()));
    frame.whole("refused", |row| Some(of(row)?.unread.refused.into()));
    frame.text("retrieved", |row| of(row)?.retrieved.clone());
    frame.real("distance", |row| of(row)?.distance);
    let dropped: [(&str, Count); 3] = [
        ("memory_items_dropped", |record| record.memory_items_dropped),
        ("memory_images_dropped", |record| record.memory_images_dropped),
        ("memory_text_dropped", |record| record.memory_text_dropped),
    ];
    for (name, count) in dropped {
        frame.whole(name, |row| i64::try_from(count(of(row)?)).ok());
    }
    type Recalled = fn(&RecallTotals) -> Option<u64>;
    let recalled: [(&str, Recalled); 8] = [
        ("recalls", |recalls| Some(recalls.requests.into())),
        ("recalled_items", |recalls| Some(recalls.items)),
        ("recalled_images", |recalls| Some(recalls.images)),
        ("recalled_text", |recalls| Some(recalls.text)),
        ("store_bytes", |recalls| recalls.store_bytes),
        ("method_ns", |recalls| recalls.method_ns),
        ("answer_ns", |recalls| recalls.answer_ns),
        ("model_tokens_of_memory", |recalls| recalls.tokens),
    ];
    for (name, count) in recalled {
        frame.whole(name, |(_, episode)| match episode {
            EpisodeTableRow::Finished(_, Some(timings)) if !timings.recalls.is_none() => {
                i64::try_from(count(&timings.recalls)?).ok()
            }
            _ => None,
        });
    }
    frame.whole("original_invalidated", |row| Some(of(row)?.blocked?.invalidated.into()));
    frame.whole("sources_blocked", |row| Some(of(row)?.blocked?.retrievals.into()));
    frame.whole("stale_blocked", |row| Some(of(row)?.blocked?.stale.into()));
    add_stream(&mut frame, |row| of(row)?.stream.as_ref());
    for (index, stage) in Stages::NAMES.into_iter().enumerate() {
        frame.real(format!("{stage}_us"), |(_, episode)| match episode {
            EpisodeTableRow::Finished(_, Some(timings)) => {
                Some(timings.stages.values()[index] as f64 / 1000.0)
            }
            _ => None,
        });
    }
    frame.finish()
}

/// A row for each episode of the runs: when and where it ran, and the nanoseconds of all its steps in each stage.
pub fn timings_frame(logs: &[RunLog]) -> DataFrame {
    let rows: Vec<(String, &EpisodeTimings)> = logs
        .iter()
        .flat_map(|log| log.timings.iter().map(move |timings| (log.name.clone(), timings)))
        .collect();
    let mut frame = FrameBuilder::new(&rows);
    frame.text("log", |(log, _)| Some(log.clone()));
    frame.text("key", |(_, timings)| Some(timings.key.clone()));
    type Count = fn(&EpisodeTimings) -> u64;
    let counts: [(&str, Count); 6] = [
        ("session", |timings| timings.session.into()),
        ("attempt", |timings| timings.attempt.into()),
        ("lane", |timings| timings.lane.into()),
        ("started_ns", |timings| timings.started_ns),
        ("ended_ns", |timings| timings.ended_ns),
        ("steps", |timings| timings.steps.into()),
    ];
    for (name, count) in counts {
        frame.whole(name, |(_, timings)| i64::try_from(count(timings)).ok());
    }
    for (index, stage) in Stages::NAMES.into_iter().enumerate() {
        frame.whole(format!("{stage}_ns"), |(_, timings)| {
            i64::try_from(timings.stages.values()[index]).ok()
        });
    }
    frame.finish()
}

/// A row for each condition of the runs, with every figure and the published ones.
pub(super) fn conditions(views: &[ScoredRun<'_>]) -> DataFrame {
    let rows: Vec<(&ScoredRun<'_>, &ConditionScore)> = views
        .iter()
        .flat_map(|view| view.scores.conditions.iter().map(move |score| (view, score)))
        .collect();
    let mut frame = FrameBuilder::new(&rows);
    frame.text("log", |(view, _)| Some(view.log.name.clone()));
    frame.text("policy", |(view, _)| Some(view.log.manifest.settings.policy.to_string()));
    frame.text("frames", |(view, _)| Some(view.log.manifest.settings.frames.to_string()));
    frame.text("condition", |(_, score)| Some(score.condition.to_string()));
    add_condition(&mut frame, |(_, score)| Some(score.condition));
    frame.whole("episodes", |(_, score)| Some(score.episodes as i64));
    frame.whole("planned", |(_, score)| Some(score.planned as i64));
    frame.real("sr_if_missing_fail", |(_, score)| Some(score.bounds?.sr.low));
    frame.real("sr_if_missing_succeed", |(_, score)| Some(score.bounds?.sr.high));
    frame.whole("runs", |(_, score)| Some(score.runs as i64));
    frame.whole("cases", |(_, score)| Some(score.cases as i64));
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
        frame.real(name, |(_, score)| Some(spread(score)?.mean));
        frame.real(format!("{name}_std"), |(_, score)| spread(score)?.std);
        frame.whole(format!("{name}_runs"), |(_, score)| Some(spread(score)?.runs.into()));
        if matches!(name, "sr" | "spl" | "follow" | "recovery") {
            frame.real(format!("{name}_low"), |(_, score)| Some(spread(score)?.interval?.low));
            frame.real(format!("{name}_high"), |(_, score)| Some(spread(score)?.interval?.high));
        }
    }
    type OfDerived = fn(&ConditionScore) -> Option<Derived>;
    let derived: [(&str, OfDerived); 2] = [
        ("change", |score| score.blocked?.change),
        ("retention", |score| score.blocked?.retention),
    ];
    for (name, derived) in derived {
        frame.real(name, |(_, score)| Some(derived(score)?.value));
        frame.real(format!("{name}_low"), |(_, score)| Some(derived(score)?.interval?.low));
        frame.real(format!("{name}_high"), |(_, score)| Some(derived(score)?.interval?.high));
    }
    for group in warehouse::TaskGroup::ALL {
        let of = move |score: &ConditionScore| {
            score.groups.iter().find(|found| found.group == group).map(|found| found.sr)
        };
        let name = format!("sr_{}", group.name().replace([' ', '-'], "_"));
        frame.real(name.clone(), |(_, score)| Some(of(score)?.mean));
        frame.real(format!("{name}_std"), |(_, score)| of(score)?.std);
    }
    frame.real("mean_steps", |(_, score)| score.mean_steps);
    for (index, kind) in Failure::ALL.iter().enumerate() {
        let name = format!("failed_{}", kind.name().replace('-', "_"));
        frame.whole(name, |(_, score)| Some(score.failures.iter().nth(index)?.1 as i64));
    }
    for stage in Stages::NAMES {
        frame.real(format!("{stage}_us"), |(_, score)| score.stage_us.as_ref()?.stage(stage));
    }
    let published = |view: &ScoredRun<'_>, score: &ConditionScore| {
        view.published.of(&score.condition.to_string()).cloned()
    };
    frame.real("published_sr", |(view, score)| Some(published(view, score)?.sr?.mean));
    frame.real("published_sr_std", |(view, score)| published(view, score)?.sr?.std);
    frame.real("published_spl", |(view, score)| published(view, score)?.spl);
    frame.real("published_tokens_per_100", |(view, score)| {
        Some(published(view, score)?.mtok? * 1e6)
    });
    frame.text("published_source", |(view, score)| Some(published(view, score)?.source));
    frame.finish()
}

/// The columns that say under which condition a row is.
fn add_condition<T>(frame: &mut FrameBuilder<'_, T>, of: impl Fn(&T) -> Option<Condition>) {
    frame.text("memory", |row| Some(of(row)?.memory.to_string()));
    frame.text("start", |row| Some(of(row)?.start.to_string()));
    frame.text("route", |row| Some(of(row)?.route.to_string()));
    frame.text("demonstrations", |row| Some(of(row)?.demonstrations.to_string()));
    frame.whole("window", |row| Some(of(row)?.variation.window.into()));
    frame.text("segment", |row| Some(of(row)?.variation.segment.to_string()));
    frame.text("hint", |row| Some(of(row)?.variation.hint.to_string()));
    frame.text("arm", |row| Some(of(row)?.arm.word().to_owned()));
}

/// The columns that say where in a stream an episode stands, all absent outside of streams.
fn add_stream<T>(frame: &mut FrameBuilder<'_, T>, of: impl Fn(&T) -> Option<&StreamRecord>) {
    frame.whole("stream", |row| Some(of(row)?.stream.into()));
    frame.text("order", |row| Some(of(row)?.order.word().to_owned()));
    frame.text("feedback", |row| Some(of(row)?.feedback.word().to_owned()));
    type Count = fn(&StreamRecord) -> Option<u64>;
    let counts: [(&str, Count); 9] = [
        ("position", |stream| Some(stream.position.into())),
        ("block", |stream| Some(stream.block.into())),
        ("place", |stream| Some(stream.place.into())),
        ("blocks_learned", |stream| Some(stream.after.into())),
        ("round", |stream| stream.round.map(u64::from)),
        ("world", |stream| Some(stream.world.into())),
        ("retrievals", |stream| Some(stream.retrievals.into())),
        ("stale", |stream| Some(stream.stale.into())),
        ("stored_bytes", |stream| stream.store_bytes),
    ];
    for (name, count) in counts {
        frame.whole(name, |row| i64::try_from(count(of(row)?)?).ok());
    }
    frame.flag("invalidated", |row| Some(of(row)?.invalidated));
    frame.text("snapshot", |row| of(row)?.snapshot.clone());
}

/// A row for each condition of the runs' streams, with every figure.
pub(super) fn streams(views: &[ScoredRun<'_>]) -> DataFrame {
    let rows: Vec<(&ScoredRun<'_>, &StreamScore)> = views
        .iter()
        .filter_map(|view| Some((view, view.scores.streams.as_ref()?)))
        .flat_map(|(view, streams)| streams.conditions.iter().map(move |score| (view, score)))
        .collect();
    let mut frame = FrameBuilder::new(&rows);
    frame.text("log", |(view, _)| Some(view.log.name.clone()));
    frame.text("policy", |(view, _)| Some(view.log.manifest.settings.policy.to_string()));
    frame.text("condition", |(_, score)| Some(score.condition.to_string()));
    add_condition(&mut frame, |(_, score)| Some(score.condition));
    frame.whole("streams", |(_, score)| Some(score.streams as i64));
    frame.whole("sequences", |(_, score)| Some(score.sequences as i64));
    frame.whole("planned", |(_, score)| Some(score.planned as i64));
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
        frame.real(name, |(_, score)| Some(figure(score)?.mean));
        frame.real(format!("{name}_low"), |(_, score)| Some(figure(score)?.interval?.low));
        frame.real(format!("{name}_high"), |(_, score)| Some(figure(score)?.interval?.high));
        frame.whole(format!("{name}_streams"), |(_, score)| Some(figure(score)?.streams as i64));
    }
    let most = rows.iter().map(|(_, score)| score.matrix.len()).max().unwrap_or(0);
    for learned in 0..most {
        for block in 1..most {
            frame.real(format!("r_{learned}_{block}"), |(_, score)| {
                *score.matrix.get(learned)?.get(block - 1)?
            });
        }
    }
    frame.finish()
}
