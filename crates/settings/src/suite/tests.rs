use conditions::Condition;
use conditions::settings::RunSettings;

use super::*;
use crate::resolve::merge;

#[test]
fn shipped_suites_can_be_read() {
    for (name, _) in SHIPPED_SUITES {
        load_suite(&name.parse().unwrap(), None).unwrap();
    }
    let error = load_suite(&"quik".parse().unwrap(), None).unwrap_err();
    insta::assert_snapshot!(error, @"unknown suite `quik`: did you mean `quick`? (known: quick, rq1, rq2, rq3, design, paper, stream, growth, conflict, transfer, mismatch); a file is named by its path, for example ./my-suite.toml");
}

#[test]
fn a_folder_of_assets_can_contain_its_own_suites() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("suites")).unwrap();
    std::fs::write(dir.path().join("suites/mine.toml"), "runs = 7").unwrap();
    let layer = load_suite(&"mine".parse().unwrap(), Some(dir.path())).unwrap();
    assert_eq!(layer, Layer::suite("mine", "runs = 7").unwrap());
}

#[test]
fn assets_do_not_replace_a_shipped_suite() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("suites/quick.toml");
    std::fs::create_dir(dir.path().join("suites")).unwrap();
    let load = |suite: &SuiteName| load_suite(suite, Some(dir.path()));
    std::fs::write(&file, "runs = 7").unwrap();
    let error = load(&SuiteName::quick()).unwrap_err().to_string();
    let path = file.to_str().unwrap();
    assert!(error.contains(&format!("--suite {path}")) && error.contains("shipped"), "{error}");
    assert_eq!(load(&path.parse().unwrap()).unwrap(), Layer::suite("", "runs = 7").unwrap());
    // The others are not concerned, and a copy is no other suite.
    assert_eq!(
        load(&"rq1".parse().unwrap()).unwrap(),
        load_suite(&"rq1".parse().unwrap(), None).unwrap()
    );
    let shipped = SHIPPED_SUITES.iter().find(|(name, _)| *name == "quick").unwrap().1;
    std::fs::write(&file, shipped).unwrap();
    assert_eq!(load(&SuiteName::quick()).unwrap(), load_suite(&SuiteName::quick(), None).unwrap());
}

fn shipped(name: &str) -> RunSettings {
    let suite = load_suite(&name.parse().unwrap(), None).unwrap();
    merge([Layer::defaults().unwrap(), suite]).unwrap().settings
}

/// The conditions of all `settings`, each once, with the largest number of runs, sorted.
fn union<'a>(settings: impl IntoIterator<Item = &'a RunSettings>) -> Vec<(Condition, u32)> {
    let mut conditions: Vec<_> = settings.into_iter().flat_map(RunSettings::runs).collect();
    conditions.sort_by_key(|&(condition, runs)| (condition, std::cmp::Reverse(runs)));
    conditions.dedup_by_key(|(condition, _)| *condition);
    conditions
}

#[test]
fn the_suite_paper_contains_all_questions() {
    let paper = shipped("paper");
    let parts = ["rq1", "rq2", "rq3", "design"].map(shipped);
    let conditions = |runs: &[(Condition, u32)]| runs.iter().map(|of| of.0).collect::<Vec<_>>();
    let (all, of_parts) = (union([&paper]), union(&parts));
    assert_eq!(conditions(&all), conditions(&of_parts));
    let more = all.iter().zip(&of_parts).filter(|(one, other)| one != other);
    let more: Vec<String> =
        more.map(|(one, other)| format!("{} {} {}", one.0, one.1, other.1)).collect();
    let original = "original/unchanged/original 5 3";
    assert_eq!(more, [format!("summary/{original}"), format!("semantic/{original}")]);
    let quick = RunSettings { limit: None, ..shipped("quick") };
    let all = paper.conditions();
    assert!(quick.conditions().iter().all(|condition| all.contains(condition)));
    for part in parts.into_iter().chain([quick]) {
        let (suite, groups) = (paper.suite.clone(), paper.groups.clone());
        let out = paper.out.clone();
        assert_eq!(RunSettings { suite, groups, out, ..part }, paper, "they differ in groups only");
    }
}

#[test]
fn the_paper_runs_these_conditions() {
    let conditions = shipped("paper").runs();
    let episodes: u32 = conditions.iter().map(|(_, runs)| 100 * runs).sum();
    let mut shown: Vec<String> =
        conditions.iter().map(|(condition, runs)| format!("{condition} x{runs}")).collect();
    shown.push(format!("{} conditions, {episodes} episodes", conditions.len()));
    insta::assert_snapshot!(shown.join("\n"), @"
    working/original/unchanged/none x5
    working/new/unchanged/none x3
    full-context/original/unchanged/original x5
    full-context/new/unchanged/original x3
    summary/original/unchanged/original x5
    summary/new/unchanged/original x3
    semantic/original/unchanged/original x5
    semantic/new/unchanged/original x3
    hybrid/original/unchanged/original x3
    hybrid/new/unchanged/original x3
    episodic/original/unchanged/original x5
    episodic/new/unchanged/original x3
    full-context/original/unchanged/opposite x3
    full-context/original/unchanged/nearby x3
    full-context/original/unchanged/distant x3
    summary/original/unchanged/opposite x3
    summary/original/unchanged/nearby x3
    summary/original/unchanged/distant x3
    semantic/original/unchanged/opposite x3
    semantic/original/unchanged/nearby x3
    semantic/original/unchanged/distant x3
    hybrid/original/unchanged/opposite x3
    hybrid/original/unchanged/nearby x3
    hybrid/original/unchanged/distant x3
    episodic/original/unchanged/opposite x3
    episodic/original/unchanged/nearby x3
    episodic/original/unchanged/distant x3
    working/new/blocked/none x3
    full-context/new/unchanged/4 x3
    full-context/new/blocked/4 x3
    summary/new/unchanged/4 x3
    summary/new/blocked/4 x3
    semantic/new/unchanged/4 x3
    semantic/new/blocked/4 x3
    hybrid/new/unchanged/4 x3
    hybrid/new/blocked/4 x3
    episodic/new/unchanged/4 x3
    episodic/new/blocked/4 x3
    full-context/new/unchanged/irrelevant x3
    full-context/new/unchanged/confusable x3
    summary/new/unchanged/irrelevant x3
    summary/new/unchanged/confusable x3
    semantic/new/unchanged/irrelevant x3
    semantic/new/unchanged/confusable x3
    hybrid/new/unchanged/irrelevant x3
    hybrid/new/unchanged/confusable x3
    episodic/new/unchanged/irrelevant x3
    episodic/new/unchanged/confusable x3
    working/original/unchanged/none/h0 x5
    working/original/unchanged/none/h20 x5
    episodic/original/unchanged/original/images x5
    full-context/original/unchanged/original/no-hint x5
    episodic/original/unchanged/original/no-hint x5
    53 conditions, 17900 episodes
    ");
}
