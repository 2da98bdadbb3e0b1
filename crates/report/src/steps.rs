//! The flat table of steps: where the agent was, what it did, and what that cost.

use std::collections::{BTreeMap, BTreeSet};

use case_book::WorldDeclaration;
use run_log::{RequestRecord, RunLog};
use world_client::{EpisodeTimeline, TimelineStep};

use super::data::add_run;
use super::frame::{DataFrame, FrameBuilder};

/// A moment of an episode.
struct StepRow<'a> {
    log: &'a RunLog,
    timeline: &'a EpisodeTimeline<'a>,
    moment: &'a TimelineStep<'a>,
    request: Option<&'a RequestRecord>,
}

/// A word of the log; `-` stands for none.
fn word(word: Option<&str>) -> Option<String> {
    word.filter(|word| *word != "-").map(str::to_owned)
}

/// A row for each moment of these episodes of `log`: the start, and after every step. `docs/exports.md` describes the columns.
pub fn steps_frame<'a>(
    log: &'a RunLog,
    world: &'a WorldDeclaration,
    episodes: &'a [EpisodeTimeline<'a>],
) -> DataFrame<'a> {
    let asked: BTreeSet<&str> = episodes.iter().map(|one| one.record.key.as_str()).collect();
    // The last one of a step: requests of attempts that were given up come before those of the finished one.
    let requests: BTreeMap<(&str, u32), &RequestRecord> = log
        .requests
        .iter()
        .filter(|request| asked.contains(request.key.as_str()))
        .map(|request| ((request.key.as_str(), request.step), request))
        .collect();
    let requests = &requests;
    let rows = episodes.iter().flat_map(|timeline| {
        timeline.steps.iter().map(move |moment| {
            let request = requests.get(&(timeline.record.key.as_str(), moment.step)).copied();
            StepRow { log, timeline, moment, request }
        })
    });
    let rows: Vec<StepRow<'_>> = rows.collect();
    let mut frame = FrameBuilder::new(rows);
    add_run(&mut frame, |row| row.log);
    frame.text("key", |row| Some(row.timeline.record.key.clone()));
    frame.word("memory", |row| Some(row.timeline.record.memory.to_string()));
    frame.text("case", |row| Some(row.timeline.record.case.clone()));
    frame.whole("run", |row| Some(row.timeline.record.run));
    frame.whole("step", |row| Some(row.moment.step));
    let first = frame.len();
    for (place, field) in world.state.iter().enumerate() {
        if field.words.is_empty() {
            frame.real(&field.name, move |row| {
                Some(row.moment.state.numbers().get(place)?).copied().map(f64::from)
            });
        } else {
            frame.word(&field.name, move |row| {
                let words = world.state_words(&row.moment.state);
                words.into_iter().nth(place).map(|(_, word)| word)
            });
        }
    }
    frame.word("feedback", |row| Some(row.moment.feedback.clone()));
    frame.word("action", |row| row.moment.action.clone());
    frame.flag("is_last", |row| Some(row.moment.step == row.timeline.record.steps));
    frame.whole("sub_goals_met", |row| Some(row.moment.sub_goals));
    frame.whole("sub_goals", |row| Some(row.timeline.record.required));
    frame.flag("conflict", |row| {
        row.timeline.record.had_conflict()?;
        Some(row.timeline.record.conflict_at == Some(row.moment.step))
    });
    frame.text("sources", |row| word(row.moment.retrieved));
    frame.text("distances", |row| word(row.moment.distances));
    frame.word("outcome", |row| Some(row.request?.outcome.word().to_owned()));
    frame.whole("latency_us", |row| row.request?.latency_us);
    frame.whole("images", |row| row.request?.images);
    frame.whole("prompt_tokens", |row| row.request?.prompt_tokens);
    frame.whole("completion_tokens", |row| row.request?.completion_tokens);
    frame.whole("memory_tokens", |row| row.request?.memory_tokens);
    let mut frame = frame.finish();
    for column in first..first + world.state.len() {
        // A field may have the name of another column.
        while frame.columns.iter().filter(|one| one.name == frame.columns[column].name).count() > 1
        {
            frame.columns[column].name.insert_str(0, "state_");
        }
    }
    frame
}

#[cfg(test)]
mod tests {
    use conditions::Route;
    use domain::{FeedbackCode, State};

    use super::*;
    use crate::TableFormat;
    use rigs::records::{log, record, world};
    use world_client::frames::ViewKey;

    #[test]
    fn a_state_that_is_called_as_another_column_has_another_name() {
        let mut world = world().declaration;
        world.state[1].name = "step".to_owned();
        let log = log(Vec::new());
        let frame = steps_frame(&log, &world, &[]);
        let names = frame.columns.iter().map(|column| column.name.as_str());
        let names: Vec<&str> = names.filter(|name| name.ends_with("step")).collect();
        assert_eq!(names, ["step", "state_step"]);
    }

    #[test]
    fn every_moment_has_a_row_and_the_last_one_no_action() {
        let mut one = record("t01-01", false);
        (one.actions, one.steps) = ("fR?f".to_owned(), 4);
        one.sub_goals = vec![1];
        one.retrieved = Some("o3 - n1+o2 o4".to_owned());
        one.distances = Some("0.0132 - 0+- -".to_owned());
        (one.route, one.conflict_at) = (Route::Blocked, Some(4));
        let [retrieved, distances] =
            [&one.retrieved, &one.distances].map(|words| words.as_deref().unwrap().split(' '));
        let memory = retrieved.map(Some).zip(distances.map(Some)).chain([(None, None)]);
        let world = world().declaration;
        let words = |action| world.action_words(action).to_owned();
        let actions = one.actions.chars().map(|letter| world.action_of(letter).map(words));
        let actions = actions.chain([None]);
        let states = [
            ([5.0, 0.0, 0.0], FeedbackCode::START),
            ([5.0, 1.0, 0.0], FeedbackCode(1)),
            ([5.0, 1.0, 1.0], FeedbackCode(2)),
            ([5.0, 1.0, 1.0], world.not_understood()),
            ([5.0, 1.0, 1.0], FeedbackCode(3)),
        ];
        let moments = (0..).zip(states).zip(actions).zip(memory);
        let steps = moments.map(|(((step, (numbers, code)), action), (retrieved, distances))| {
            let state = State::new(&numbers).unwrap();
            TimelineStep {
                step,
                state,
                state_text: world.state_text(&state),
                feedback: world.feedback_sentence(code).to_owned(),
                feedback_code: code,
                action,
                sub_goals: usize::from(step > 0),
                retrieved,
                distances,
                view: ViewKey::State(0, state),
            }
        });
        let timeline = EpisodeTimeline {
            record: &one,
            instruction: String::new(),
            variant: 0,
            steps: steps.collect(),
            events: Vec::new(),
            failure: None,
            points: None,
            unlike_reference_at: None,
            reference: None,
            scenery: None,
        };
        let mut csv = Vec::new();
        let log = log(vec![one.clone()]);
        steps_frame(&log, &world, &[timeline]).write(TableFormat::Csv, &mut csv).unwrap();
        let text =
            String::from_utf8(csv).unwrap().replace("episodic/original/unchanged/original/", "");
        insta::assert_snapshot!(text, @"
        log,policy,policy_role,key,memory,case,run,step,column,row,heading,feedback,action,is_last,sub_goals_met,sub_goals,conflict,sources,distances,outcome,latency_us,images,prompt_tokens,completion_tokens,memory_tokens
        run,grounded,scripted stand-in,run1/t01-01,episodic,t01-01,1,0,5,0,north,The episode has just begun.,move forward,false,0,1,false,o3,0.0132,,,,,,
        run,grounded,scripted stand-in,run1/t01-01,episodic,t01-01,1,1,5,1,north,You moved.,turn right,false,1,1,false,,,,,,,,
        run,grounded,scripted stand-in,run1/t01-01,episodic,t01-01,1,2,5,1,east,You turned.,,false,1,1,false,n1+o2,0+-,,,,,,
        run,grounded,scripted stand-in,run1/t01-01,episodic,t01-01,1,3,5,1,east,Your last answer was not understood: you did not move.,move forward,false,1,1,false,o4,,,,,,,
        run,grounded,scripted stand-in,run1/t01-01,episodic,t01-01,1,4,5,1,east,Something blocks the way: you did not move.,,true,1,1,true,,,,,,,,
        ");
    }
}
