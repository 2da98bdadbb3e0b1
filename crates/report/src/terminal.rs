//! The tables of a report in a terminal.

use std::fmt::Write;

use domain::shell_word;
use run_log::RunLog;
use scores::compare::{LeftOutConditions, differing_settings};
use scores::{Comparison, FigureDifference, Question, p_value, score};

use super::document::{Table, TableCell};
use super::published::Published;
use super::sections::{
    VERDICTS, adaptation_table, all_blocked_table, asked_rows, certified_table, conditions_table,
    conflict_table, controls_table, differences_table, failures_table, growth_table, incomplete,
    left_out, necessity_table, notices, orders_table, points_table, requests_table,
    sensitivity_table, steps_per_second, success_table, supplied_table, time_table, transfer_table,
    verdict, worst_table,
};
use super::view::{ScoredRun, interval_text, pair_stubs, signed};
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
    let asked = |question| asked_rows(&view, question)?.verdicts();
    let elsewhere = asked(Question::Elsewhere);
    let verdicts = view.scores.comparisons.iter().map(|asked| {
        let count = asked.comparisons.len();
        let about = match asked.question {
            Question::Conflict => "from before and after",
            Question::Elsewhere => "here and elsewhere",
        };
        format!("{count} comparisons of demonstrations {about} were made together. {VERDICTS}")
    });
    let verdicts: Vec<String> = verdicts.collect();
    let left_out = elsewhere.as_ref().and_then(|_| left_out(log.manifest.settings.policy));
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
        ("Demonstrations from before and after, compared", asked(Question::Conflict)),
        ("Demonstrations here and elsewhere, compared", elsewhere),
        ("Controls: success, and paired differences in percentage points", controls_table(&view)),
        ("Controls: cases that need memory", certified_table(&view)),
        ("Banks of different sizes", growth_table(&view)),
        ("What a mismatch of demonstration and test costs", sensitivity_table(&view)),
        ("Failed episodes by kind", failures_table(&view)),
        ("Since when they failed", points_table(&view)),
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
    let notes = notices(&view).into_iter().chain(incomplete(&view)).chain(left_out);
    for line in notes.chain(verdicts).chain(closing(&view)) {
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
    if !view.scores.controls.is_empty() {
        lines.push(
            "Controls: oracle holds the test reference, wrong holds demonstrations of other tasks. Content: memory − wrong; 0 \
             but for chance where the policy leaves the memory out. Headroom: oracle − memory. Certified: fails with working memory, \
             succeeds with the oracle."
                .to_owned(),
        );
    }
    if let Some(streams) = &view.scores.streams {
        if streams.tested_differences > 0 {
            lines.push(format!(
                "Differences of streams: p of Student's t test over streams, and in parentheses corrected for the {} differences \
                 that have one (Holm 1979).",
                streams.tested_differences
            ));
        }
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

/// Two runs compared: settings that differ, then the conditions that both have, then those that were left out.
pub fn compared_runs(
    a: &RunLog,
    b: &RunLog,
    compared: &[Comparison],
    left_out: &LeftOutConditions,
) -> String {
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
    for sentence in left_out.sentences(&a.name, &b.name) {
        text += &wrapped(&sentence);
    }
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

/// The number of comparisons whose unpaired episodes are named.
const UNPAIRED: usize = 5;

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
    let mut rates = table(
        &["condition", "cases", "A SR", "B SR", "A−B", "95 % CI", "A:B", "p", "corrected\np"],
        1,
    );
    let mut lengths = table(
        &[
            "condition",
            "episodes\nof A",
            "episodes\nof B",
            "pairs",
            "A SPL",
            "B SPL",
            "A−B",
            "95 % CI",
        ],
        1,
    );
    let mut verdicts = table(
        &["condition", "verdict", "A−B", "corrected\np", "shown", "more", "changes without"],
        2,
    );
    verdicts.set_text(6);
    let mut unpaired = Vec::new();
    for one in compared {
        let Comparison { cases, pairs, sr, spl, more_under_a, more_under_b, p, conclusion, .. } =
            one;
        rates.add_row([
            label(one),
            cases.to_string(),
            format!("{:.1}", sr.a),
            format!("{:.1}", sr.b),
            signed(sr.mean, 1),
            interval(sr, 1),
            format!("{more_under_a}:{more_under_b}"),
            p_value(*p),
            p_value(conclusion.corrected_p),
        ]);
        lengths.add_row([
            label(one),
            one.episodes_a.to_string(),
            one.episodes_b.to_string(),
            pairs.to_string(),
            format!("{:.3}", spl.a),
            format!("{:.3}", spl.b),
            signed(spl.mean, 3),
            interval(spl, 3),
        ]);
        verdicts.add_row([label(one)].into_iter().chain(verdict(one)));
        let alone = one.unpaired_in_words(["A", "B"]);
        if !alone.is_empty() {
            let of = if compared.len() > 1 { format!(", {}", label(one)) } else { String::new() };
            unpaired.push(format!("Not paired{of}: {alone}."));
        }
    }
    let more = unpaired.len().saturating_sub(UNPAIRED);
    unpaired.truncate(UNPAIRED);
    if more > 0 {
        unpaired
            .push(format!("Not paired: episodes of {more} more comparisons; --json lists all."));
    }
    let unpaired: String = unpaired.iter().map(|line| wrapped(line)).collect();
    let notes = "Pairs: episodes of the same case and repetition, finished on both sides; all figures are of these. Means \
                 over cases, SR in percent. CI: 95 % interval over cases. A:B: cases that succeed more often under A and \
                 under B; p: exact two-sided sign test on these counts (McNemar's exact test where every case has one \
                 pair).";
    let (answer, made) = match compared {
        [one] => (sentence(one), "One comparison was made.".to_owned()),
        _ => (String::new(), format!("{} comparisons were made together.", compared.len())),
    };
    let notes = [&*sides, &made, VERDICTS, notes].map(wrapped).concat();
    format!("{rates}\n\n{lengths}\n\n{verdicts}\n\n{answer}{unpaired}{notes}")
}

/// What a comparison shows, as a paragraph.
fn sentence(compared: &Comparison) -> String {
    let conclusion = &compared.conclusion;
    let holds = conclusion.robustness.in_words();
    wrapped(&format!("{} {holds}", conclusion.sentence)) + "\n"
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
    use conditions::Route;
    use rigs::records::{keyed, log, record, under};
    use run_log::{BlockedRecord, EpisodeRecord};

    use super::*;
    use crate::testing::{made_up, paper_conditions};

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
        let compared = scores::compare::compare_runs(&log, &other).unwrap();
        let text = compared_runs(&log, &other, &compared, &LeftOutConditions::default());
        assert!(text.contains("max-steps differs: 200 in made-up, 60 in made-up"), "{text}");
        is_narrow(&text);
    }

    #[test]
    fn what_a_suite_asks_is_compared_in_tables_that_fit() {
        let conditions = [
            "full-context/new/blocked/original",
            "full-context/new/blocked/after",
            "full-context/new/blocked/before-after",
            "full-context/new/blocked/after-before",
            "full-context/new/unchanged/elsewhere",
            "full-context/new/unchanged/4",
            "working/new/unchanged/none",
        ];
        let conditions = conditions.map(|name| (name.parse().unwrap(), 2));
        let mut log = made_up(&conditions, &[1, 2, 9]);
        for record in log.episodes.iter_mut().filter(|record| record.route == Route::Blocked) {
            record.blocked = Some(BlockedRecord { invalidated: true, ..BlockedRecord::default() });
        }
        let text = summary(&log);
        is_narrow(&text);
        for expected in [
            "3 comparisons of demonstrations from before and after were made together.",
            "2 comparisons of demonstrations here and elsewhere were made together.",
            "The policy grounded leaves memories of another warehouse out",
            "4 demos here − elsewhere",
        ] {
            assert!(text.contains(expected), "{expected}: {text}");
        }
    }

    #[test]
    fn two_runs_are_named_once_and_two_conditions_in_each_row() {
        // Three cases in three repetitions; the second run has two more repetitions of each.
        let cases = ["t01-01", "t01-02", "t01-03"];
        let run = |repetitions, success: fn(&str, u32) -> bool| {
            let episode = |run| {
                move |case: &&str| keyed(EpisodeRecord { run, ..record(case, success(case, run)) })
            };
            log((1..=repetitions).flat_map(|run| cases.iter().map(episode(run))).collect())
        };
        let mut a = run(3, |case, run| case == "t01-01" && run > 1);
        let mut b = run(5, |_, _| true);
        (a.name, b.name) = ("r1".to_owned(), "r2".to_owned());
        let compared = scores::compare::compare_runs(&a, &b).unwrap();
        insta::assert_snapshot!(compared_conditions(&compared));
        let mut one = compared[0].clone();
        (one.a, one.b) = ("one".to_owned(), "two".to_owned());
        let text = comparison(&log(vec![]), &[one]);
        assert!(text.contains("A: one") && text.contains("B: two"), "{text}");
        assert!(text.contains("Policy: grounded, scripted stand-in."), "{text}");
    }
}
