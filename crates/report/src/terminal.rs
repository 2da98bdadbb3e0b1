//! The tables of a report in a terminal.

use std::fmt::Write;

use domain::shell_word;
use run_log::RunLog;
use scores::compare::differing_settings;
use scores::{Comparison, FigureDifference, score};

use super::document::{Table, TableCell};
use super::published::Published;
use super::sections::{
    adaptation_table, all_blocked_table, conditions_table, conflict_table, differences_table,
    failures_table, growth_table, incomplete, necessity_table, notices, orders_table,
    requests_table, sensitivity_table, steps_per_second, success_table, supplied_table, time_table,
    transfer_table, worst_table,
};
use super::view::{ScoredRun, interval_text, p_value, pair_stubs, signed};
use crate::table::{TextTable, table};

/// Number of cases in the table of those that fail most.
const WORST: usize = 5;
/// The rows of the table of times; the other stages are transport between processes.
const TIMES: [&str; 7] = ["dynamics", "render", "embed", "search", "assemble", "decide", "sum"];

/// The scores of a run as text, at most 100 columns wide.
pub fn summary(log: &RunLog) -> String {
    let (published, scores) = (Published::default(), score(log));
    let view = ScoredRun { log, scores, published: &published, prefix: String::new() };
    let mut time = time_table(&view);
    for group in time.iter_mut().flat_map(|table| &mut table.groups) {
        group.rows.retain(|row| TIMES.contains(&row.label.as_str()));
    }
    let mut text = String::new();
    for (title, table) in [
        ("", conditions_table(&view).pruned()),
        ("Streams: success of learning episodes, %", success_table(&view)),
        ("Streams: paired differences, percentage points", differences_table(&view)),
        (
            "Streams: average success, backward and forward transfer, forgetting",
            transfer_table(&view),
        ),
        (
            "Streams: adaptation lag in episodes, blocks adapted, stale sources, t-nDTW",
            adaptation_table(&view),
        ),
        ("Streams: orders", orders_table(&view)),
        ("Streams: cases that need memory", necessity_table(&view)),
        (
            "Blocked routes: change against working memory, retention, follow, recovery",
            all_blocked_table(&view),
        ),
        (
            "Blocked routes: demonstrations from before and after the way was blocked",
            conflict_table(&view),
        ),
        ("Banks of different sizes", growth_table(&view)),
        ("What a mismatch of demonstration and test costs", sensitivity_table(&view)),
        ("Failed episodes by kind", failures_table(&view)),
        ("Cases that fail most", worst_table(&view, WORST)),
        ("Requests to the model, those of repeated episodes included", requests_table(&view)),
        ("What memory supplied, means of an answer", supplied_table(&view)),
        ("Mean time of a step by stage, in microseconds; the sum has the transport, too", time),
    ] {
        if let Some(table) = table {
            let title = if title.is_empty() { String::new() } else { format!("{title}\n") };
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{title}{}\n", in_text(&table));
        }
    }
    for line in notices(&view).into_iter().chain(incomplete(&view)).chain(closing(&view)) {
        text += &wrapped(&line);
    }
    text
}

fn closing(view: &ScoredRun<'_>) -> Vec<String> {
    let mut lines = Vec::new();
    if !view.scores.conditions.is_empty() {
        lines.push(
            "N: finished episodes. SR: mean ± sample standard deviation over runs; CI: 95 % interval over cases."
                .to_owned(),
        );
    }
    if view.scores.streams.is_some() {
        lines.push(
            "Streams: means over the sequences of a stream, then over streams; brackets: 95 % intervals over streams. \
             docs/streams.md defines the figures."
                .to_owned(),
        );
    }
    if let Some(rate) = view.scores.steps_per_s {
        let lanes = view.log.manifest.settings.lanes;
        let lanes = if lanes == 1 { "1 lane".to_owned() } else { format!("{lanes} lanes") };
        lines.push(format!("Speed: {} steps/s with {lanes}.", steps_per_second(rate)));
    }
    lines.push(format!("Run: {}", view.log.dir.display()));
    lines.push(format!("More: memtransfer report {}", shell_word(&view.log.dir)));
    lines
}

/// A table of a report for a terminal: without published rows, `-` where there is no figure.
fn in_text(from: &Table) -> TextTable {
    let is_paired = from.stubs == pair_stubs();
    let stubs = if is_paired { &from.stubs[..1] } else { &from.stubs[..] };
    let columns = from.columns.iter().map(|column| match column.over.as_str() {
        "" => column.name.clone(),
        over => format!("{over}\n{}", column.name),
    });
    let header: Vec<String> = stubs.iter().cloned().chain(columns).collect();
    let mut to = table(&header, stubs.len());
    for (index, _) in from.columns.iter().enumerate().filter(|(_, column)| column.is_text) {
        to.set_text(stubs.len() + index);
    }
    for group in &from.groups {
        for (index, row) in group.rows.iter().filter(|row| !row.published).enumerate() {
            let label = group.label.as_ref().map(|label| if index == 0 { label } else { "" });
            let own = (!is_paired).then_some(row.label.as_str());
            let cells = row.cells.iter().map(|cell| match cell {
                TableCell::Value(value) => value.clone(),
                TableCell::Sure { figure, interval } => format!("{figure}\n{interval}"),
                TableCell::Missing(_) => "-".to_owned(),
            });
            to.add_row(label.into_iter().chain(own).map(str::to_owned).chain(cells));
        }
    }
    to
}

/// Two runs compared: settings that differ, then the conditions that both have.
pub fn compared_runs(a: &RunLog, b: &RunLog, compared: &[Comparison]) -> String {
    let mut text = String::new();
    for one in differing_settings(a, b) {
        text += &wrapped(&format!(
            "Note: {} differs: {} in {}, {} in {}.",
            one.key, one.there, a.name, one.here, b.name
        ));
    }
    if !text.is_empty() {
        text += "The differences below may come from that.\n\n";
    }
    text += &compared_conditions(compared);
    for log in [a, b] {
        let subject = format!("Policy of {}", log.name);
        text += &wrapped(&log.manifest.policy_label().sentence(&subject));
    }
    text
}

/// Comparisons of conditions of one run, a row each.
pub fn comparison(log: &RunLog, compared: &[Comparison]) -> String {
    compared_conditions(compared) + &wrapped(&log.manifest.policy_label().sentence("Policy"))
}

fn compared_conditions(compared: &[Comparison]) -> String {
    let shared: Option<Vec<_>> = compared.iter().map(shared_condition).collect();
    let sides = match shared.as_deref() {
        Some([(a, b, _), ..]) => format!("A: {a}, B: {b}."),
        _ => String::new(),
    };
    let label = |one: &Comparison| match (&shared, shared_condition(one)) {
        (Some(_), Some((_, _, condition))) => condition.to_owned(),
        _ => format!("A: {}\nB: {}", one.a, one.b),
    };
    let interval = |one: &FigureDifference, digits| {
        one.interval.map_or("-".to_owned(), |interval| interval_text(interval, digits))
    };
    let mut rates =
        table(&["condition", "cases", "pairs", "A SR", "B SR", "A−B", "95 % CI", "A:B", "p"], 1);
    let mut lengths =
        table(&["condition", "cases", "pairs", "A SPL", "B SPL", "A−B", "95 % CI"], 1);
    for one in compared {
        let Comparison { cases, pairs, sr, spl, more_under_a, more_under_b, p, .. } = one;
        rates.add_row([
            label(one),
            cases.to_string(),
            pairs.to_string(),
            format!("{:.1}", sr.a),
            format!("{:.1}", sr.b),
            signed(sr.mean, 1),
            interval(sr, 1),
            format!("{more_under_a}:{more_under_b}"),
            p_value(*p),
        ]);
        lengths.add_row([
            label(one),
            cases.to_string(),
            pairs.to_string(),
            format!("{:.3}", spl.a),
            format!("{:.3}", spl.b),
            signed(spl.mean, 3),
            interval(spl, 3),
        ]);
    }
    let unpaired = |count: fn(&Comparison) -> usize| compared.iter().map(count).sum::<usize>();
    let left_out = match (unpaired(|one| one.unpaired_a), unpaired(|one| one.unpaired_b)) {
        (0, 0) => String::new(),
        (a, b) => format!(
            "Left out, because the other side lacks the case or repetition: episodes of A {a}, of B {b}."
        ),
    };
    let notes = "Pairs: episodes of the same case and repetition, finished on both sides; all figures are of these. Means \
                 over cases, SR in percent. CI: 95 % interval over cases. A:B: cases that succeed more often under A and \
                 under B; p: exact two-sided sign test on these counts (McNemar's exact test where every case has one \
                 pair), not corrected for the number of rows.";
    format!("{rates}\n\n{lengths}\n\n{}{}{}", wrapped(&sides), wrapped(&left_out), wrapped(notes))
}

/// The names of two runs and the condition under which they are compared, if it is one.
fn shared_condition(compared: &Comparison) -> Option<(&str, &str, &str)> {
    let (run_a, a) = compared.a.rsplit_once(": ")?;
    let (run_b, b) = compared.b.rsplit_once(": ")?;
    (a == b).then_some((run_a, run_b, a))
}

/// A paragraph in lines of at most 100 characters; nothing for no text.
fn wrapped(text: &str) -> String {
    let (mut lines, mut length) = (String::new(), 0);
    for word in text.split(' ').filter(|word| !word.is_empty()) {
        let more = word.chars().count() + 1;
        if length > 0 && length + more > crate::table::WIDTH + 1 {
            lines.push('\n');
            length = 0;
        } else if length > 0 {
            lines.push(' ');
        }
        lines += word;
        length += more;
    }
    if lines.is_empty() { lines } else { lines + "\n" }
}

#[cfg(test)]
mod tests {
    use rigs::records::{log, record, under};
    use run_log::EpisodeRecord;

    use super::*;
    use crate::testing::{made_up, paper_conditions};
    use scores::Interval;

    fn is_narrow(text: &str) {
        let wide = text.lines().find(|line| line.chars().count() > 100 && !line.contains("Run:"));
        assert_eq!(wide, None);
    }

    #[test]
    fn the_summary_of_a_run() {
        let mut episodes = vec![record("t01-01", true), record("t01-02", false)];
        let without = EpisodeRecord { images: Some(1400), ..record("t01-01", false) };
        episodes.push(under("working/original/unchanged/none".parse().unwrap(), without));
        insta::assert_snapshot!(summary(&log(episodes)));
    }

    #[test]
    fn every_table_fits_a_hundred_columns() {
        let mut log = made_up(&paper_conditions(), &[1, 2, 3]);
        let request = rigs::records::request(&log.episodes[0].key, 1);
        log.requests = vec![request];
        let text = summary(&log);
        assert!(text.contains("Requests to the model") && text.contains("Blocked routes"));
        is_narrow(&text);
        let mut other = log.clone();
        other.manifest.settings.max_steps = 60;
        let text =
            compared_runs(&log, &other, &scores::compare::compare_runs(&log, &other).unwrap());
        assert!(text.contains("max-steps differs: 200 in made-up, 60 in made-up"), "{text}");
        is_narrow(&text);
    }

    #[test]
    fn two_runs_are_named_once_and_two_conditions_in_each_row() {
        let of = |a: &str, b: &str| Comparison {
            a: a.to_owned(),
            b: b.to_owned(),
            cases: 3,
            pairs: 9,
            unpaired_a: 0,
            unpaired_b: 6,
            sr: FigureDifference {
                a: 50.0,
                b: 100.0,
                mean: -50.0,
                interval: Some(Interval { low: -90.0, high: 0.0 }),
            },
            spl: FigureDifference { a: 0.5, b: 0.5, mean: 0.0, interval: None },
            more_under_a: 0,
            more_under_b: 9,
            p: 0.0004,
        };
        let pair = "working/new/unchanged/none";
        insta::assert_snapshot!(compared_conditions(&[of(
            &format!("r1: {pair}"),
            &format!("r2: {pair}")
        )]));
        let text = comparison(&log(vec![]), &[of("one", "two")]);
        assert!(text.contains("A: one") && text.contains("B: two"), "{text}");
        assert!(text.contains("Policy: grounded, scripted stand-in."), "{text}");
    }
}
