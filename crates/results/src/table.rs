//! A run's scores as people read them in a terminal. Only layout: every figure comes from
//! [`score`](crate::score).

use std::collections::BTreeMap;

use comfy_table::{Cell, CellAlignment, LineStyle, Table, TableStyle};

use crate::conditions::{Frames, PolicyKind, Variation};
use crate::log::RunLog;
use crate::score::{
    Comparison, ConditionScore, Difference, Failure, Interval, RequestScore, Scores, Spread,
    StageTimes, score,
};
use crate::settings::RunSettings;
use domain::Representation;

/// What stands where nothing was measured, or nothing is defined.
const ABSENT: &str = "-";

/// Lines above, below the header, and below: nothing between rows.
const LINES: TableStyle = TableStyle::new()
    .top_border(LineStyle::none().fill('─').junction('─'))
    .header_separator(LineStyle::none().fill('─').junction('─'))
    .bottom_border(LineStyle::none().fill('─').junction('─'));

/// The stages that a table of time names; the others are the way between processes.
pub const WORK: [&str; 5] = ["dynamics", "render", "embed", "search", "decide"];

/// With more conditions than these the table of results has gaps.
const LONG: usize = 12;

/// Everything that is printed at the end of a run, from its log alone.
pub fn report(log: &RunLog) -> String {
    let scores = score(log);
    let mut text = format!("{}\n", results(&scores));
    let mut add = |title: &str, table: Option<Table>| {
        if let Some(table) = table {
            text += &format!("\n{title}\n{table}\n");
        }
    };
    add("Blocked routes: who ran into the barricade, and what blocking costs", blocked(&scores));
    add("Failed episodes by kind", failures(&scores));
    add("Questions to the model, those of episodes walked again included", requests(log));
    add("Mean time of a step by stage, in microseconds", times(log));
    text.push('\n');
    for line in remarks(log, &scores) {
        text += &line;
        text.push('\n');
    }
    text
}

fn results(scores: &Scores) -> Table {
    let varies = |score: &ConditionScore| score.condition.variation != Variation::STANDARD;
    let varied = scores.conditions.iter().any(varies);
    let mut header = vec!["memory", "start", "route", "demos"];
    header.extend(varied.then_some("varied"));
    let words = header.len();
    header.extend(["episodes", "SR %", "95 % CI", "SPL", "steps", "images/req"]);
    let mut table = table(&header, words);
    let mut last = None;
    for score in &scores.conditions {
        let condition = score.condition;
        // A long table needs air between the memories.
        if scores.conditions.len() > LONG && last.is_some_and(|last| last != condition.memory) {
            table.add_row([""]);
        }
        last = Some(condition.memory);
        let mut row = vec![
            condition.memory.to_string(),
            condition.start.to_string(),
            condition.route.to_string(),
            condition.demonstrations.to_string(),
        ];
        row.extend(varied.then(|| match condition.variation.to_string() {
            standard if standard.is_empty() => ABSENT.to_owned(),
            varied => varied.trim_start_matches('/').to_owned(),
        }));
        row.extend([
            score.episodes.to_string(),
            spread(Some(score.sr), 1),
            interval(score.sr.interval, 1),
            figure(Some(score.spl.mean), 3),
            figure(score.mean_steps, 1),
            figure(score.images_per_request.map(|spread| spread.mean), 1),
        ]);
        table.add_row(row);
    }
    table
}

/// `None` when no route was blocked.
fn blocked(scores: &Scores) -> Option<Table> {
    let header =
        ["memory", "demos", "follow F %", "recovery C %", "change Δ", "95 % CI", "retention R"];
    let mut table = table(&header, 2);
    for score in &scores.conditions {
        let Some(found) = &score.blocked else { continue };
        table.add_row([
            score.condition.memory.to_string(),
            score.condition.demonstrations.to_string(),
            spread(found.follow, 1),
            spread(found.recovery, 1),
            found.change.map_or_else(|| ABSENT.to_owned(), |change| difference(change.value, 1)),
            interval(found.change.and_then(|change| change.interval), 1),
            figure(found.retention.map(|retention| retention.value), 2),
        ]);
    }
    (table.row_count() > 0).then_some(table)
}

/// Counts for each memory, of the kinds that there are; `None` when nothing failed.
fn failures(scores: &Scores) -> Option<Table> {
    let mut counts: BTreeMap<Representation, BTreeMap<Failure, usize>> = BTreeMap::new();
    for score in &scores.conditions {
        let of_memory = counts.entry(score.condition.memory).or_default();
        for (kind, count) in score.failures.iter().filter(|(_, count)| *count > 0) {
            *of_memory.entry(kind).or_default() += count;
        }
    }
    let there = |kind: &&Failure| counts.values().any(|counts| counts.contains_key(kind));
    let kinds: Vec<Failure> = Failure::ALL.iter().filter(there).copied().collect();
    let header: Vec<&str> =
        ["memory"].into_iter().chain(kinds.iter().map(|kind| kind.name())).chain(["all"]).collect();
    let mut table = table(&header, 1);
    for (memory, counts) in &counts {
        let count = |kind: &Failure| counts.get(kind).copied().unwrap_or(0);
        let all: usize = counts.values().sum();
        table.add_row(
            [memory.to_string()]
                .into_iter()
                .chain(kinds.iter().map(|kind| count(kind).to_string()))
                .chain([all.to_string()]),
        );
    }
    (!kinds.is_empty()).then_some(table)
}

/// A row for each memory, and one for the run; `None` when no model was asked.
fn requests(log: &RunLog) -> Option<Table> {
    let currency = log.manifest.prices.as_ref().map(|prices| prices.currency.as_str());
    let cost = format!("cost {}", currency.unwrap_or_default());
    let mut header =
        vec!["memory", "requests", "kept", "retries", "tokens/req", "memory %", "cached %"];
    header.extend([
        "images left out",
        "unreadable",
        "empty",
        "refused",
        "p50 ms",
        "p90 ms",
        "Mtok",
    ]);
    header.extend(currency.map(|_| cost.trim_end()));
    let mut table = table(&header, 1);
    let mut add = |name: String, found: &RequestScore| {
        let spent = &found.spent;
        let mut row = vec![
            name,
            spent.requests.to_string(),
            spent.replayed.to_string(),
            spent.attempts.saturating_sub(spent.requests).to_string(),
            figure(found.prompt_tokens_each, 0),
            figure(found.memory_share, 1),
            figure(found.cached_share, 1),
            found.images_dropped.to_string(),
            found.unread.unreadable.to_string(),
            found.unread.empty.to_string(),
            found.unread.refused.to_string(),
            figure(found.latency_p50_ms, 0),
            figure(found.latency_p90_ms, 0),
            figure((spent.unknown == 0).then(|| spent.tokens() as f64 / 1e6), 3),
        ];
        row.extend(
            currency.map(|_| found.cost.map_or_else(|| ABSENT.to_owned(), |cost| cost.to_string())),
        );
        table.add_row(row);
    };
    let by_memory = RequestScore::by_memory(log);
    by_memory.iter().for_each(|(memory, found)| add(memory.to_string(), found));
    add("all".to_owned(), &RequestScore::of_run(log)?);
    Some(table)
}

/// A row for each memory: start and route make no difference. `None` when nothing was timed.
fn times(log: &RunLog) -> Option<Table> {
    let header: Vec<&str> = ["memory"].into_iter().chain(WORK).chain(["between", "sum"]).collect();
    let mut table = table(&header, 1);
    for (memory, times) in StageTimes::by_memory(log) {
        let work = WORK.map(|stage| times.stage(stage));
        let between = times.sum - work.iter().flatten().sum::<f64>();
        let figures = work.into_iter().chain([between, times.sum].map(Some));
        table.add_row([memory.to_string()].into_iter().chain(figures.map(|us| figure(us, 0))));
    }
    (table.row_count() > 0).then_some(table)
}

/// A rate as people read it: a slow one with a digit after the point.
pub fn steps_per_second(rate: f64) -> String {
    if rate < 10.0 { format!("{rate:.1}") } else { format!("{rate:.0}") }
}

/// What makes the difference between a result and a test of the harness.
pub fn standing(settings: &RunSettings) -> Vec<String> {
    let mut lines = vec![match settings.policy {
        PolicyKind::Grounded => {
            "Policy: grounded, a scripted stand-in. It tests the harness; its numbers are \
                                 no claim about any model."
                .to_owned()
        }
        PolicyKind::Openai => {
            let model = settings.model.as_ref().map_or("?", |model| model.model.as_str());
            format!("Policy: {model}, asked through an OpenAI-compatible endpoint.")
        }
        PolicyKind::External => match &settings.policy_cmd {
            Some(command) => format!("Policy: a program of its own, `{command}`."),
            None => "Policy: a program of its own.".to_owned(),
        },
        PolicyKind::Random => "Policy: random, the lower bound of the scale.".to_owned(),
        PolicyKind::Expert => {
            "Policy: expert, which replays the reference: the upper bound of the scale.".to_owned()
        }
    }];
    match settings.frames {
        Frames::Rendered => {}
        control => lines.push(format!(
            "Control: observed frames were {control}, so these are no results of the benchmark."
        )),
    }
    lines
}

fn remarks(log: &RunLog, scores: &Scores) -> Vec<String> {
    let settings = &log.manifest.settings;
    let mut lines = standing(settings);
    lines.push(
        "SR: mean ± standard deviation over runs; CI: bootstrap over cases and runs.".to_owned(),
    );
    if let Some(rate) = scores.steps_per_s {
        lines.push(format!(
            "Speed: {} steps/s with {} lanes.",
            steps_per_second(rate),
            settings.lanes
        ));
    }
    let left = scores.planned.saturating_sub(scores.finished + scores.errored);
    if left > 0 {
        lines.push(format!(
            "Not complete: {left} of {} episodes are missing; the same command goes on.",
            scores.planned
        ));
    }
    if scores.errored > 0 {
        lines.push(format!(
            "Faults: {} episodes were given up and count as not successful (errors.jsonl says why); the \
             same command tries them again.",
            scores.errored
        ));
    }
    lines.push(format!("Run: {}", log.dir.display()));
    lines.push(format!("More: memtransfer report {}", log.dir.display()));
    lines
}

/// Paired comparisons, a row each, under the names of their two sides.
pub fn comparisons(compared: &[Comparison]) -> String {
    // Two runs under the same conditions: the runs' names once, below.
    let shared: Option<Vec<_>> = compared.iter().map(shared_condition).collect();
    let mut header = if shared.is_some() { vec!["condition"] } else { vec!["A", "B"] };
    let words = header.len();
    let figures = ["SR A-B", "95 % CI", "SPL A-B", "95 % CI", "A better", "B better", "p"];
    header.extend(["cases"].into_iter().chain(figures));
    let mut table = table(&header, words);
    for one in compared {
        let Comparison { a, b, cases, sr, spl, more_under_a, more_under_b, p } = one;
        let signed = |one: &Difference, digits: usize| difference(one.mean, digits);
        let names = match shared_condition(one).filter(|_| shared.is_some()) {
            Some((_, _, condition)) => vec![condition.to_owned()],
            None => vec![a.clone(), b.clone()],
        };
        table.add_row(names.into_iter().chain([
            cases.to_string(),
            signed(sr, 1),
            interval(sr.interval, 1),
            signed(spl, 3),
            interval(spl.interval, 3),
            more_under_a.to_string(),
            more_under_b.to_string(),
            p_value(*p),
        ]));
    }
    let sides =
        shared.and_then(|shared| shared.first().map(|(a, b, _)| format!("A: {a}, B: {b}.\n")));
    format!(
        "{table}\n\n{}Differences are means over the cases that both have (SR in percentage points); CI: bootstrap, \
         cases paired.\nA better, B better: cases that succeed more often there; p: exact two-sided sign test on \
         these counts\n(McNemar's exact test where there is one run each), not corrected for the number of rows.\n",
        sides.unwrap_or_default()
    )
}

/// The names of two runs and the condition that they are compared under, if it is one.
fn shared_condition(compared: &Comparison) -> Option<(&str, &str, &str)> {
    let (run_a, a) = compared.a.rsplit_once(": ")?;
    let (run_b, b) = compared.b.rsplit_once(": ")?;
    (a == b).then_some((run_a, run_b, a))
}

/// A difference with its sign; none where it is nothing.
fn difference(value: f64, digits: usize) -> String {
    if value == 0.0 { format!("{value:.digits$}") } else { format!("{value:+.digits$}") }
}

/// A p value as it is printed: never as zero.
pub fn p_value(p: f64) -> String {
    if p < 0.001 { "<0.001".to_owned() } else { format!("{p:.3}") }
}

/// A table whose columns from `numbers` on are aligned to the right.
pub fn table(header: &[&str], numbers: usize) -> Table {
    let mut table = Table::new();
    table.load_style(LINES);
    table.set_header(header.iter().map(Cell::new));
    for column in table.column_iter_mut().skip(numbers) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

fn figure(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| ABSENT.to_owned(), |value| format!("{value:.digits$}"))
}

fn spread(spread: Option<Spread>, digits: usize) -> String {
    match spread {
        None => ABSENT.to_owned(),
        Some(Spread { mean, std: None, .. }) => format!("{mean:.digits$}"),
        Some(Spread { mean, std: Some(std), .. }) => format!("{mean:.digits$} ± {std:.digits$}"),
    }
}

fn interval(interval: Option<Interval>, digits: usize) -> String {
    interval.map_or_else(
        || ABSENT.to_owned(),
        |Interval { low, high }| format!("[{low:.digits$}, {high:.digits$}]"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conditions::Demonstrations;
    use crate::key::EpisodeKey;
    use crate::log::testing::{manifest, record, timings};
    use domain::Representation;

    #[test]
    fn two_runs_are_named_once_and_two_conditions_in_each_row() {
        let nothing = Difference { mean: 0.0, interval: None };
        let of = |a: &str, b: &str| Comparison {
            a: a.to_owned(),
            b: b.to_owned(),
            cases: 3,
            sr: Difference { mean: -50.0, interval: Some(Interval { low: -90.0, high: 0.0 }) },
            spl: nothing,
            more_under_a: 0,
            more_under_b: 9,
            p: 0.0004,
        };
        let pair = "working/new/unchanged/none";
        insta::assert_snapshot!(comparisons(&[of(&format!("r1: {pair}"), &format!("r2: {pair}"))]));
        let text = comparisons(&[of("one", "two")]);
        assert!(
            text.contains(" one ") && text.contains(" two ") && !text.contains("A: "),
            "{text}"
        );
    }

    #[test]
    fn a_report_says_what_ran_and_what_it_is_worth() {
        let mut episodes = vec![record("t01-01", true), record("t01-02", true)];
        let mut without = record("t01-01", false);
        (without.memory, without.demonstrations) = (Representation::Working, Demonstrations::NONE);
        without.images = Some(1400);
        without.key = EpisodeKey { condition: without.condition(), run: 1, case: "t01-01".into() }
            .to_string();
        episodes.push(without);
        let log = RunLog {
            dir: "runs/quick-grounded".into(),
            manifest: manifest(),
            timings: episodes.iter().map(timings).collect(),
            episodes,
            requests: Vec::new(),
            errors: Vec::new(),
            sessions: Vec::new(),
        };
        insta::assert_snapshot!(report(&log));
    }
}
