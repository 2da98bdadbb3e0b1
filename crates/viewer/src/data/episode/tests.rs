use conditions::Route;
use rigs::records::{log, record, tell, tell_failure};
use run_log::Ending;
use serde_json::Value;
use warehouse::{CaseSet, TrajectoryKind, Variant, Warehouse};

use super::*;
use crate::testing::built_in;

/// The data of an episode of the first case that takes these actions and retrieves `retrieved`, with other `changes`.
fn episode(
    actions: &str,
    retrieved: Option<&str>,
    changes: impl FnOnce(&mut EpisodeRecord),
) -> EpisodeData {
    compared(actions, retrieved, &Successes::default(), changes)
}

/// The same, compared with `successes`.
fn compared(
    actions: &str,
    retrieved: Option<&str>,
    successes: &Successes,
    changes: impl FnOnce(&mut EpisodeRecord),
) -> EpisodeData {
    let cases = CaseSet::shipped();
    let mut record = record(&cases.cases[0].id, false);
    tell(&mut record, "start_pose", cases.cases[0].test.start.to_string());
    record.actions = actions.to_owned();
    record.steps = actions.len() as u32;
    let steps = record.steps;
    tell_failure(&mut record, "never-saw", steps);
    record.retrieved = retrieved.map(str::to_owned);
    changes(&mut record);
    let world = RunWorld::new(&log(Vec::new()), &built_in()).unwrap();
    let episode = LoggedEpisode {
        record: &record,
        timings: None,
        requests: Vec::new(),
        horizon: 6,
        prompts: false,
    };
    EpisodeData::new(&world, &episode, successes, |_| None).unwrap()
}

/// An episode on the blocked route that tries to enter the closed passage at step 2.
fn data(retrieved: Option<&str>) -> Value {
    let data = episode("LR", retrieved, |record| {
        (record.route, record.conflict_at) = (Route::Blocked, Some(2));
        record.distances = retrieved.map(|_| "- 0.0132".to_owned());
    });
    serde_json::to_value(data).unwrap()
}

/// The first step at which the original demonstration of the first case is in its barricade.
fn entered() -> u64 {
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
    let case = &cases.cases[0];
    let closed = Variant::closing(case.barricade.iter().copied());
    let poses = case.replay(&warehouse, TrajectoryKind::Original).poses;
    poses.iter().position(|pose| closed.is_closed(pose.cell)).unwrap() as u64
}

#[test]
fn what_leads_into_a_closed_passage_is_named_with_its_step() {
    let entered = entered();
    let from = entered.saturating_sub(3);
    let shown = data(Some(&format!("- o{from}")));
    let demonstrations = shown["demonstrations"].as_array().unwrap();
    let original =
        demonstrations.iter().position(|one| one["title"] == "original demonstration").unwrap();
    assert_eq!(shown["demonstrations"][original]["stale"], true);
    assert_eq!(shown["supplied"], serde_json::json!([[], [[original, from, 0.0132]]]));
    assert_eq!(shown["led"]["from"], from);
    assert_eq!(shown["led"]["enters"], entered);
    // Beyond the supplied steps, or without sources.
    assert_eq!(data(Some(&format!("o{from} -")))["led"], Value::Null);
    assert_eq!(data(None)["led"]["from"], Value::Null);
    assert_eq!(data(None)["led"]["enters"], entered);
}

#[test]
fn views_of_what_was_supplied_are_the_last_to_be_left_out() {
    let mut data = episode("L", Some("o4"), |_| ());
    let kept = |data: &EpisodeData| -> Vec<(usize, usize)> {
        let demonstrations = data.demonstrations.iter().enumerate();
        let views = demonstrations.flat_map(|(index, one)| {
            one.views.iter().enumerate().map(move |(step, view)| (index, step, view))
        });
        let kept = views.filter(|(_, _, view)| !view.is_empty());
        kept.map(|(index, step, _)| (index, step)).collect()
    };
    let all = kept(&data).len();
    data.limit_demonstration_views(all);
    assert_eq!(kept(&data).len(), all);
    let supplied = data.supplied[0][0].0;
    data.limit_demonstration_views(7);
    let mut expected: Vec<_> = (4..10).map(|step| (supplied, step)).chain([(0, 0)]).collect();
    expected.sort_unstable();
    assert_eq!(kept(&data), expected);
    assert!(data.demonstrations[supplied].views[4].ends_with("-small.jpg"));
}

#[test]
fn every_step_has_a_pose_a_view_of_its_world_and_what_came_into_view() {
    let shown = data(None);
    for list in ["poses", "views", "seen", "feedback"] {
        assert_eq!(shown[list].as_array().unwrap().len(), 3, "{list}");
    }
    assert!(shown["views"][0].as_str().unwrap().starts_with("1-"));
    assert!(!shown["closed"].as_array().unwrap().is_empty());
    let seen: Vec<u64> = serde_json::from_value(shown["seen"][0].clone()).unwrap();
    let again: Vec<u64> = serde_json::from_value(shown["seen"][2].clone()).unwrap();
    assert!(!seen.is_empty() && again.is_empty());
    assert_eq!(shown["failure"]["step"], 2);
}

#[test]
fn a_failure_has_the_points_since_when_it_failed() {
    let points = |actions: &str, successes: &[EpisodeRecord], told: bool| -> Value {
        let data = compared(actions, None, &successes.iter().collect(), |record| {
            if told {
                tell(record, "loops", serde_json::json!([{"from": 1, "to": 3}]));
            }
        });
        serde_json::to_value(data).unwrap()["points"].take()
    };
    let cases = CaseSet::shipped();
    let mut success = record(&cases.cases[0].id, true);
    success.actions = "LLR".to_owned();
    let successes = [success.clone()];
    assert_eq!(
        points("LLLL", &successes, true),
        serde_json::json!({
            "lastProgress": 0,
            "loops": [[1, 3]],
            "unlikeSuccess": [2, success.key],
            "unlikeReference": null,
        })
    );
    // Without a success the reference, of which it takes two steps, and then another than the third.
    let reference = &cases.cases[0].trajectory(TrajectoryKind::Original).actions;
    let mut letters: Vec<char> = reference.iter().map(|action| action.letter()).collect();
    letters[2] = if letters[2] == 'L' { 'R' } else { 'L' };
    let alone = points(&letters.iter().collect::<String>(), &[], false);
    assert_eq!(
        (&alone["loops"], &alone["unlikeSuccess"], &alone["unlikeReference"]),
        (&Value::Null, &Value::Null, &2.into())
    );
    let success = episode("LLR", None, |record| record.ending = Ending::Complete);
    assert_eq!(serde_json::to_value(success).unwrap()["points"], Value::Null);
}

#[test]
fn a_source_that_its_case_does_not_have_is_left_out() {
    let shown =
        serde_json::to_value(episode("LLL", Some("w2 t99-01:o1 t01-02:a3"), |_| ())).unwrap();
    let titles = shown["demonstrations"].as_array().unwrap().iter().map(|one| &one["title"]);
    let titles: Vec<&Value> = titles.collect();
    assert_eq!(titles, ["original demonstration", "after demonstration of t01-02"]);
    assert_eq!(shown["supplied"], serde_json::json!([[], [], [[1, 3, null]]]));
}
