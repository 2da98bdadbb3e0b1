//! The flat table of steps: where the agent was, what it did, and what that cost.

use std::collections::{BTreeMap, BTreeSet};
use std::iter::repeat;

use domain::{Action, Feedback, Pose};
use results::log::{EpisodeRecord, RequestRecord, RunLog};

use super::data::add_run;
use super::frame::{DataFrame, FrameBuilder};

/// A moment of an episode.
struct StepRow<'a> {
    log: &'a RunLog,
    record: &'a EpisodeRecord,
    step: u32,
    pose: Pose,
    feedback: Feedback,
    /// Empty where nothing was retrieved.
    sources: Option<&'a str>,
    /// Empty where none is known.
    distances: Option<&'a str>,
    /// What the agent did next; `None` at the end and for an answer without an action.
    action: Option<Action>,
    request: Option<&'a RequestRecord>,
}

/// The words of a column by request, without end; `None` for `-` and after the last.
fn words(column: &Option<String>) -> impl Iterator<Item = Option<&str>> {
    let words = column.as_deref().unwrap_or_default().split_whitespace();
    words.map(|word| Some(word).filter(|word| *word != "-")).chain(repeat(None))
}

/// A row for each moment of the finished episodes of `log`: the start, and after every step. `docs/exports.md` describes
/// the columns.
pub fn steps_frame(log: &RunLog) -> DataFrame {
    let asked: BTreeSet<&str> = log.episodes.iter().map(|record| record.key.as_str()).collect();
    // The last one of a step: requests of attempts that were given up come before those of the finished one.
    let requests: BTreeMap<(&str, u32), &RequestRecord> = log
        .requests
        .iter()
        .filter(|request| asked.contains(request.key.as_str()))
        .map(|request| ((request.key.as_str(), request.step), request))
        .collect();
    let rows: Vec<StepRow<'_>> = log
        .episodes
        .iter()
        .flat_map(|record| {
            let told = words(&record.retrieved).zip(words(&record.distances));
            let requests = &requests;
            let actions = record.actions.chars().map(Action::from_letter).chain(repeat(None));
            (0..).zip(record.replay()).zip(actions).zip(told).map(
                move |(((step, (pose, feedback)), action), (sources, distances))| StepRow {
                    log,
                    record,
                    step,
                    pose,
                    feedback,
                    sources,
                    distances,
                    action,
                    request: requests.get(&(record.key.as_str(), step)).copied(),
                },
            )
        })
        .collect();
    let mut frame = FrameBuilder::new(&rows);
    add_run(&mut frame, |row| row.log);
    frame.text("key", |row| Some(row.record.key.clone()));
    frame.text("memory", |row| Some(row.record.memory.to_string()));
    frame.text("case", |row| Some(row.record.case.clone()));
    frame.whole("run", |row| Some(row.record.run));
    frame.whole("step", |row| Some(row.step));
    frame.whole("x", |row| Some(row.pose.cell.x));
    frame.whole("y", |row| Some(row.pose.cell.y));
    frame.text("heading", |row| Some(row.pose.heading.letter().to_string()));
    frame.text("feedback", |row| Some(row.feedback.words().to_owned()));
    frame.text("action", |row| Some(row.action?.words().to_owned()));
    frame.flag("is_last", |row| Some(row.step == row.record.steps));
    frame.whole("sub_goals_met", |row| {
        Some(row.record.sub_goals.iter().filter(|met| **met <= row.step).count())
    });
    frame.whole("sub_goals", |row| Some(row.record.required));
    frame.flag("tried_closed", |row| {
        row.record.tried_closed?;
        Some(row.record.tried_closed_at == Some(row.step))
    });
    frame.text("sources", |row| row.sources.map(str::to_owned));
    frame.text("distances", |row| row.distances.map(str::to_owned));
    frame.text("outcome", |row| Some(row.request?.outcome.word().to_owned()));
    frame.whole("latency_us", |row| row.request?.latency_us);
    frame.whole("images", |row| row.request?.images);
    frame.whole("prompt_tokens", |row| row.request?.prompt_tokens);
    frame.whole("completion_tokens", |row| row.request?.completion_tokens);
    frame.whole("memory_tokens", |row| row.request?.memory_tokens);
    frame.finish()
}

#[cfg(test)]
mod tests {
    use domain::Heading;

    use super::*;
    use results::log::testing::{log, record};

    #[test]
    fn every_moment_has_a_row_and_the_last_one_no_action() {
        let mut one = record("t01-01", false);
        one.start_pose = Pose::new(5, 0, Heading::N);
        (one.actions, one.steps) = ("fR?f".to_owned(), 4);
        (one.blocked_moves, one.sub_goals) = (vec![4], vec![1]);
        one.retrieved = Some("o3 - n1+o2 o4".to_owned());
        one.distances = Some("0.0132 - 0+- -".to_owned());
        (one.tried_closed, one.tried_closed_at) = (Some(true), Some(4));
        let mut csv = Vec::new();
        steps_frame(&log(vec![one])).write_csv(&mut csv).unwrap();
        let text =
            String::from_utf8(csv).unwrap().replace("episodic/original/unchanged/original/", "");
        insta::assert_snapshot!(text, @"
        log,policy,policy_role,key,memory,case,run,step,x,y,heading,feedback,action,is_last,sub_goals_met,sub_goals,tried_closed,sources,distances,outcome,latency_us,images,prompt_tokens,completion_tokens,memory_tokens
        run,grounded,scripted stand-in,run1/t01-01,episodic,t01-01,1,0,5,0,N,The episode has just begun.,move forward,false,0,1,false,o3,0.0132,,,,,,
        run,grounded,scripted stand-in,run1/t01-01,episodic,t01-01,1,1,5,1,N,You moved.,turn right,false,1,1,false,,,,,,,,
        run,grounded,scripted stand-in,run1/t01-01,episodic,t01-01,1,2,5,1,E,You turned.,,false,1,1,false,n1+o2,0+-,,,,,,
        run,grounded,scripted stand-in,run1/t01-01,episodic,t01-01,1,3,5,1,E,Your last answer was not understood: you did not move.,move forward,false,1,1,false,o4,,,,,,,
        run,grounded,scripted stand-in,run1/t01-01,episodic,t01-01,1,4,5,1,E,Something blocks the way: you did not move.,,true,1,1,true,,,,,,,,
        ");
    }
}
