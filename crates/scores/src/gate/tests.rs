use domain::Representation;
use rigs::records::{keyed, log, record, settings, stream_log, stream_record, under};
use run_log::{EpisodeRecord, UnitId};

use super::*;
use crate::score;

const EPISODIC: &str = "episodic/original/unchanged/original";

/// A run of `cases` cases under the condition of `record`, of which the first `successes` succeed.
fn run(name: &str, successes: usize, cases: usize) -> RunLog {
    let records = (0..cases).map(|case| record(&format!("c{case:03}"), case < successes));
    named(name, log(records.collect()))
}

/// The run with this name, and settings that have its conditions alone.
fn named(name: &str, mut log: RunLog) -> RunLog {
    log.name = name.to_owned();
    let conditions: BTreeSet<Condition> =
        log.episodes.iter().map(EpisodeRecord::condition).collect();
    let [group] = &mut log.manifest.settings.groups[..] else { panic!("one group") };
    group.memory = vec![Representation::Episodic.into()];
    group.starts = conditions.iter().map(|condition| condition.start).collect();
    group.routes = conditions.iter().map(|condition| condition.route).take(1).collect();
    log
}

#[track_caller]
fn check(log: &RunLog, gate: &str) -> GateResult {
    let gate: Gate = gate.parse().unwrap();
    gate.check(log, &score(log)).unwrap()
}

#[test]
fn the_whole_interval_decides_also_at_its_ends() {
    // 50 of 50: the interval is [94.216..., 100], of 0 of 50 [0, 5.783...]: see `interval.rs`.
    let (all, none) = (run("all", 50, 50), run("none", 0, 50));
    for (log, required, verdict) in [
        (&all, "sr >= 94.2", "passed"),
        (&all, "sr > 94.2", "passed"),
        (&all, "sr >= 94.3", "undecided"),
        (&all, "sr >= 100", "undecided"),
        (&all, "sr < 100", "undecided"),
        (&all, "sr <= 94.3", "undecided"),
        (&all, "sr <= 94.2", "failed"),
        (&none, "sr > 0", "undecided"),
        (&none, "sr <= 0", "undecided"),
        (&none, "sr < 5.8", "passed"),
        (&none, "sr < 5.7", "undecided"),
        (&none, "sr >= 5.8", "failed"),
        // Each success has 0.8: five cases would reach from 0.3 on, fifty from 0.7.
        (&all, "spl >= 0.7", "passed"),
        (&all, "spl >= 0.8", "undecided"),
        (&all, "spl >= 0.9", "failed"),
    ] {
        let result = check(log, &format!("{EPISODIC}: {required}"));
        assert_eq!(result.verdict.name(), verdict, "{}: {required}: {result:?}", log.name);
        assert_eq!(result.reason, None);
        assert_eq!(result.gate(), format!("{EPISODIC}: {required}"));
        assert_eq!(result.cases, 50);
    }
}

#[test]
fn what_was_not_measured_in_full_is_undecided() {
    let undecided = |log: &RunLog, required: &str| {
        let result = check(log, &format!("{EPISODIC}: {required}"));
        assert_eq!(result.verdict, Verdict::Undecided, "{result:?}");
        result.reason.unwrap()
    };
    let mut whole = run("run", 50, 50);
    assert_eq!(check(&whole, &format!("{EPISODIC}: sr >= 50")).verdict, Verdict::Passed);
    // The one condition of the run has all its episodes.
    whole.manifest.episodes = 60;
    insta::assert_snapshot!(undecided(&whole, "sr >= 50"), @"10 of 60 episodes are missing");
    // Neither is one failed that would fail.
    insta::assert_snapshot!(undecided(&whole, "sr < 50"), @"10 of 60 episodes are missing");
    whole.manifest.episodes = 50;
    whole.manifest.unit = Some(UnitId { plan: "00".to_owned(), number: 0 });
    insta::assert_snapshot!(undecided(&whole, "sr >= 50"), @"the run is a unit of a plan: merge the units first");
    insta::assert_snapshot!(undecided(&run("run", 1, 1), "sr >= 2"), @"it has no interval");
    insta::assert_snapshot!(undecided(&run("run", 5, 5), "follow >= 2"), @"of blocked routes only");

    let blocked = "episodic/new/blocked/original".parse().unwrap();
    let log = log((0..9).map(|case| under(blocked, record(&format!("c{case}"), true))).collect());
    let result = check(&named("run", log), "episodic/new/blocked/original: retention >= 0.5");
    insta::assert_snapshot!(result.reason.unwrap(), @"it was not measured or is not defined");

    // A condition of the settings that has no episode yet.
    let mut begun = run("run", 5, 5);
    begun.manifest.settings = settings();
    let result = check(&begun, "working/new/unchanged/none: sr >= 2");
    insta::assert_snapshot!(result.reason.unwrap(), @"no episode is finished");
}

#[test]
fn a_gate_is_read_with_its_unit_and_what_is_wrong_is_named() {
    let blocked = "full-context/new/blocked/4/h20";
    for (text, expected) in [
        (format!("{EPISODIC}:sr>=60%"), "sr >= 60"),
        (format!(" {EPISODIC} : sr  <  60.5  % "), "sr < 60.5"),
        (format!("{blocked}: change > −20 points"), "change > -20"),
        (format!("{blocked}: retention <= 1.5"), "retention <= 1.5"),
        ("top-3/new/unchanged/4: spl >= .2".to_owned(), "spl >= 0.2"),
        (format!("{EPISODIC}: sr >= 0.6 %"), "sr >= 0.6"),
        (format!("{EPISODIC}: sr > 0"), "sr > 0"),
        // Delta is a difference of two differences.
        (format!("{blocked}: change >= -150"), "change >= -150"),
    ] {
        let Gate { figure, operator, bound, .. } = text.parse().unwrap();
        assert_eq!(format!("{figure} {operator} {bound}"), expected);
    }
    let errors = [
        "episodic/new/unchanged/4",
        "episodic/new/unchanged/4: sr",
        "episodic/new/unchanged/4: sr >=",
        "episodic/new/unchanged/4: sr >= sixty",
        "episodic/new/unchanged/4: sr => 60",
        "episodic/new/unchanged/4: sr = 60",
        "episodic/new/unchanged/4: sr >= 60 points",
        "episodic/new/unchanged/4: spl >= 60",
        "episodic/new/unchanged/4: spl >= 0.6 %",
        "episodic/new/unchanged/4: sr >= 160",
        "episodic/new/unchanged/4: sr >= nan",
        "episodic/new/unchanged/4: sr >= 1-2",
        "episodic/new/unchanged/4: recovry >= 60",
        "episodic/new/unchanged/4: img <= 7",
        "episodic/newer/unchanged/4: sr >= 60",
        "working/new/unchanged/4: sr >= 60",
    ]
    .map(|text| text.parse::<Gate>().unwrap_err().to_string());
    let unfit = [
        "sr >= 0.6",
        "recovery < 1",
        "sr >= 0",
        "sr <= 100",
        "sr > 100",
        "sr < 0",
        "retention >= 0",
    ];
    let unfit = unfit.map(|required| {
        format!("episodic/new/blocked/4: {required}").parse::<Gate>().unwrap_err().to_string()
    });
    insta::assert_snapshot!(unfit.join("\n"), @"
    sr is in percent: write `60 %`, or `0.6 %` if that is meant
    recovery is in percent: write `100 %`, or `1 %` if that is meant
    every value of sr is >= 0, so this requires nothing
    every value of sr is <= 100, so this requires nothing
    no value of sr is > 100, so this cannot be passed
    no value of sr is < 0, so this cannot be passed
    every value of retention is >= 0, so this requires nothing
    ");
    insta::assert_snapshot!(errors.join("\n"), @"
    `episodic/new/unchanged/4` is not a gate: write CONDITION: FIGURE OPERATOR NUMBER, for example `episodic/new/unchanged/4: sr >= 60`
    `episodic/new/unchanged/4: sr` is not a gate: write CONDITION: FIGURE OPERATOR NUMBER, for example `episodic/new/unchanged/4: sr >= 60`
    `episodic/new/unchanged/4: sr >=` is not a gate: write CONDITION: FIGURE OPERATOR NUMBER, for example `episodic/new/unchanged/4: sr >= 60`
    `sixty` is not a number
    unknown operator `=>` (known: >=, <=, >, <)
    unknown operator `=` (known: >=, <=, >, <)
    sr has the unit `%`, not `points`
    spl lies from 0 to 1, and the bound is 60
    spl has no unit, not `%`
    sr lies from 0 to 100, and the bound is 160
    `nan` is not a number
    `1-2` is not a number
    unknown figure with an interval `recovry`: did you mean `recovery`? (known: sr, spl, follow, recovery, change, retention)
    unknown figure with an interval `img` (known: sr, spl, follow, recovery, change, retention)
    unknown start `newer`: did you mean `new`? (known: original, new)
    there is no condition `working/new/unchanged/4`; its episodes are those of `working/new/unchanged/none`
    ");
}

#[test]
fn a_condition_that_the_run_lacks_is_an_error_and_so_is_a_run_of_streams() {
    let log = run("run", 5, 5);
    let error = |log: &RunLog, name: &str| {
        let gate: Gate = format!("{name}: sr >= 60").parse().unwrap();
        gate.check(log, &score(log)).unwrap_err().to_string()
    };
    insta::assert_snapshot!(error(&log, "episodic/original/unchanged/nearby"), @"unknown condition of the run `episodic/original/unchanged/nearby`: did you mean `episodic/original/unchanged/original`? (known: episodic/original/unchanged/original)");
    let streams = stream_log(vec![stream_record("a", true)], [1, 1, 1]);
    insta::assert_snapshot!(error(&streams, EPISODIC), @"run consists of streams, and gates are on figures of conditions without streams");
}

fn compared(a: &RunLog, b: &RunLog, margin: f64) -> Vec<GateResult> {
    no_worse_than((a, &score(a)), (b, &score(b)), margin).unwrap()
}

#[track_caller]
fn only(results: Vec<GateResult>) -> GateResult {
    let [result] = <[GateResult; 1]>::try_from(results).unwrap();
    result
}

#[test]
fn a_run_is_no_worse_than_itself_if_it_has_enough_cases() {
    // All differences are 0: 1.984 * sqrt(2 * 100^2 / (101 * 102)) = 2.76 points for 100 cases, and 5.51 for 50.
    for (cases, margin, verdict) in [
        (100, 5.0, "passed"),
        (100, 2.77, "passed"),
        (100, 2.76, "undecided"),
        (50, 5.0, "undecided"),
        (50, 5.52, "passed"),
        (1, 100.0, "undecided"),
    ] {
        let log = run("run", cases / 2, cases);
        let result = only(compared(&log, &log.clone(), margin));
        assert_eq!(result.verdict.name(), verdict, "{cases} {margin}: {result:?}");
        assert_eq!(result.value, Some(0.0));
    }
}

#[test]
fn the_whole_interval_of_the_difference_decides() {
    let (good, bad) = (run("good", 100, 100), run("bad", 0, 100));
    let result = only(compared(&bad, &good, 5.0));
    assert_eq!((result.verdict, result.value), (Verdict::Failed, Some(-100.0)));
    let result = only(compared(&good, &bad, 5.0));
    assert_eq!((result.verdict, result.value), (Verdict::Passed, Some(100.0)));
    // -10 with ten cases that lost: m = -1000 / 102 = -9.804, and the squares 10 * 90.196^2 + 90 * 9.804^2 + 109.804^2 +
    // 90.196^2 = 110196, so the half width is 1.984 * sqrt(110196 / (101 * 102)) = 6.489: [-16.29, -3.31].
    let less = run("less", 90, 100);
    for (margin, verdict) in [
        (16.3, "passed"),
        (16.2, "undecided"),
        (3.4, "undecided"),
        (3.3, "failed"),
        (0.0, "failed"),
    ] {
        let result = only(compared(&less, &good, margin));
        assert_eq!(result.verdict.name(), verdict, "{margin}: {result:?}");
    }
    let result = only(compared(&less, &good, 5.0));
    assert_eq!(result.gate(), format!("{EPISODIC}: sr minus good's > -5"));
}

#[test]
fn a_hundred_cases_of_which_few_change_are_enough_for_the_margin() {
    // With k cases that changed in each direction the half width is 1.984 * sqrt((2 k + 2) * 100^2 / (101 * 102)).
    for (changed, margin, verdict) in
        [(2, 5.0, "passed"), (3, 5.0, "undecided"), (12, 10.0, "passed"), (13, 10.0, "undecided")]
    {
        let before = run("before", 50, 100);
        let after = (0..100)
            .map(|case| record(&format!("c{case:03}"), (changed..50 + changed).contains(&case)));
        let result = only(compared(&named("after", log(after.collect())), &before, margin));
        assert_eq!(
            (result.verdict.name(), result.value),
            (verdict, Some(0.0)),
            "{changed}: {result:?}"
        );
    }
}

#[test]
fn runs_with_unequal_cases_are_compared_on_those_that_both_have() {
    // The cases that only one side has are the first ones, all of them lost there.
    let (more, fewer) = (run("more", 100, 140), run("fewer", 100, 100));
    let result = only(compared(&more, &fewer, 5.0));
    assert_eq!((result.verdict, result.cases, result.value), (Verdict::Passed, 100, Some(0.0)));
    let result = only(compared(&fewer, &more, 5.0));
    assert_eq!((result.verdict, result.cases, result.value), (Verdict::Passed, 100, Some(0.0)));
    let few = run("few", 20, 20);
    let result = only(compared(&few, &fewer, 5.0));
    assert_eq!((result.verdict, result.cases), (Verdict::Undecided, 20));

    let others = (0..9).map(|case| record(&format!("d{case}"), true)).collect();
    let result = only(compared(&named("others", log(others)), &fewer, 5.0));
    insta::assert_snapshot!(result.reason.unwrap(), @"no case and repetition in common");
    let mut stopped = run("stopped", 100, 100);
    stopped.manifest.episodes = 120;
    for [a, b] in [[&stopped, &fewer], [&fewer, &stopped]] {
        let result = only(compared(a, b, 5.0));
        assert_eq!(result.verdict, Verdict::Undecided);
        insta::allow_duplicates! {
            insta::assert_snapshot!(result.reason.unwrap(), @"20 of 120 episodes are missing in stopped");
        }
    }
}

#[test]
fn every_condition_of_the_other_run_is_required() {
    let other = under("episodic/new/unchanged/original".parse().unwrap(), record("c000", true));
    let in_run = |run: u32| {
        (0..100)
            .map(move |case| keyed(EpisodeRecord { run, ..record(&format!("c{case:03}"), true) }))
    };
    let mut records: Vec<EpisodeRecord> = in_run(1).collect();
    records.extend(
        (0..100).map(|case| under(other.condition(), record(&format!("c{case:03}"), true))),
    );
    let both = named("both", log(records));
    let one = run("one", 100, 100);
    let results = compared(&one, &both, 5.0);
    let verdicts: Vec<_> = results.iter().map(|one| (one.condition.clone(), one.verdict)).collect();
    assert_eq!(
        verdicts,
        [
            (EPISODIC.to_owned(), Verdict::Passed),
            (other.condition().to_string(), Verdict::Undecided),
        ]
    );
    assert_eq!(results[1].reason.as_deref(), Some("one does not have this condition"));
    // What only this run has requires nothing.
    assert_eq!(compared(&both, &one, 5.0).len(), 1);

    let mut other_world = one.clone();
    other_world.manifest.hashes.insert("layout".to_owned(), "11".to_owned());
    let error = no_worse_than((&one, &score(&one)), (&other_world, &score(&other_world)), 5.0);
    let error = error.unwrap_err().to_string();
    assert!(error.contains("were run on different layout"), "{error}");
    let mut empty = log(vec![]);
    empty.manifest.settings.groups.clear();
    let error = no_worse_than((&one, &score(&one)), (&empty, &score(&empty)), 5.0).unwrap_err();
    insta::assert_snapshot!(error, @"run has no condition, so it requires nothing");
}
