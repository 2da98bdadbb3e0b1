use rigs::records::log;
use scores::score;

use super::*;
use crate::testing::{made_up, paper_conditions};

fn paper() -> Published {
    Published::paper().unwrap()
}

#[test]
fn every_figure_of_the_paper_is_listed_once() {
    let published = paper();
    let count = |figure: fn(&PublishedCondition) -> bool| {
        published.conditions.iter().filter(|condition| figure(condition)).count()
    };
    // tab:main has 6 + 6 + 4 + 5 rates (working once for one and four), tab:transfer 15 more, Design Choices 3.
    assert_eq!(count(|c| c.sr.is_some()), 6 + 6 + 4 + 5 + 15 + 3);
    assert_eq!(count(|c| c.spl.is_some()), 6 + 6 + 4 + 5 + 15);
    // Mtok: working, five with one demonstration, four with four.
    assert_eq!(count(|c| c.mtok.is_some()), 10);
    // tab:rq2 has five rows; tab:tasks five rows, unchanged and blocked.
    for figure in [
        |c: &PublishedCondition| c.follow.is_some(),
        |c: &PublishedCondition| c.recovery.is_some(),
        |c: &PublishedCondition| c.change.is_some(),
        |c: &PublishedCondition| c.retention.is_some(),
    ] {
        assert_eq!(count(figure), 5);
    }
    assert_eq!(count(|c| c.groups.len() == 4), 10);
    assert_eq!(count(|c| !c.groups.is_empty()), 10);
    assert_eq!(count(|c| c.from_others.is_some()), 2);
    let runs = |name: &str| published.runs(published.of(name).unwrap());
    assert_eq!(runs("summary/original/unchanged/original"), Some(5));
    assert_eq!(runs("episodic/new/unchanged/4"), Some(3));
    assert_eq!(published.cases(&published.conditions[0]), Some(100));
}

#[test]
fn derived_figures_follow_from_the_printed_rates() {
    let published = paper();
    let rate = |name: &str| published.of(name).unwrap().sr.unwrap().mean;
    let baseline = rate("working/new/blocked/none") - rate("working/new/unchanged/none");
    for blocked in published.conditions.iter().filter(|c| c.change.is_some()) {
        let (after, before) =
            (rate(&blocked.name), rate(&blocked.name.replace("blocked", "unchanged")));
        // The paper rounds both.
        assert!((blocked.change.unwrap().mean - (after - before - baseline)).abs() < 0.11);
        assert!((blocked.retention.unwrap().mean - after / before).abs() < 0.0051);
    }
}

const SMALL: &str =
    "title = \"t\"\npolicy = \"p\"\n[[condition]]\nname = \"episodic/new/unchanged/4\"\n";

#[test]
fn a_figure_is_a_number_or_has_a_deviation() {
    let text = format!(
        "{SMALL}runs = 5\nsr = 66\nspl = {{ mean = 0.25, std = 0.01 }}\ngroups = {{ revisit = 93 }}\n"
    );
    let found = Published::parse("f.toml", &text).unwrap();
    let condition = &found.conditions[0];
    assert_eq!(condition.sr, Some(PublishedFigure { mean: 66.0, std: None }));
    assert_eq!(condition.spl, Some(PublishedFigure { mean: 0.25, std: Some(0.01) }));
    assert_eq!(condition.group("revisit").unwrap().mean, 93.0);
    assert_eq!((found.runs(condition), found.cases(condition)), (Some(5), None));
    assert!(!found.is_paper);
}

#[test]
fn what_is_wrong_with_a_file_is_named_with_its_line() {
    let error = |text: &str| Published::parse("f.toml", text).unwrap_err().to_string();
    let with = |line: &str| error(&format!("{SMALL}{line}\n"));
    let configured =
        |line: &str| error(&SMALL.replace("[[", &format!("[configuration]\nruns = 3\n{line}\n[[")));
    let errors = [
        error(""),
        error("title = \"t\"\npolicy = \"p\"\ncondition = []\n"),
        with("sr = \"high\""),
        with("sr = 660"),
        with("sr = { mean = 66.0, std = -1.0 }"),
        with("sr = { mean = 66.0, sd = 1.0 }"),
        with("spl = 29.5"),
        with("retention = nan"),
        with("groups = { revisit = 930 }"),
        with("succes = 66.0"),
        with("runs = 0"),
        error(&SMALL.replace("/new/", "/newer/")),
        with("sr = 1\n\n[[condition]]\nname = \"episodic/new/unchanged/4\""),
        configured("max-step = 200"),
        configured("cases = \"all\""),
        configured("plates = [1]"),
    ];
    insta::assert_snapshot!(errors.join("\n\n"));
}

#[test]
fn a_missing_file_is_named() {
    let error = Published::read(Path::new("/nowhere/figures.toml")).unwrap_err().to_string();
    assert!(error.starts_with("cannot read /nowhere/figures.toml: No such file"), "{error}");
}

#[test]
fn a_run_is_written_exactly() {
    let log = made_up(&paper_conditions(), &[1, 3, 9]);
    let scores = score(&log);
    let text = of_run(&log, &scores).unwrap();
    let read = Published::parse("published.toml", &text).unwrap();
    assert_eq!(read.policy, "grounded, scripted stand-in");
    assert_eq!(read.conditions.len(), scores.conditions.len());
    for (published, score) in read.conditions.iter().zip(&scores.conditions) {
        assert_eq!(published.name, score.condition.to_string());
        let sr = published.sr.unwrap();
        assert_eq!((sr.mean, sr.std), (score.sr.mean, score.sr.std));
        assert_eq!(
            published.retention.map(|found| found.mean),
            score.blocked.and_then(|found| Some(found.retention?.value))
        );
        assert_eq!(published.groups.len(), score.groups.len());
    }
    let begin: Vec<&str> = text.lines().take_while(|line| !line.starts_with("[[")).collect();
    insta::assert_snapshot!(begin.join("\n"));
    assert_eq!(of_run(&log_of_nothing(), &score(&log_of_nothing())), None);
}

fn log_of_nothing() -> run_log::RunLog {
    log(vec![])
}
