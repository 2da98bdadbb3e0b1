//! A run's scores as people read them. Only layout: every figure comes from [`score`](crate::score).

use comfy_table::{Cell, CellAlignment, LineStyle, Table, TableStyle};

use crate::conditions::{Frames, PolicyKind};
use crate::log::RunLog;
use crate::score::{ConditionScore, Scores, Spread, score};

/// What stands where nothing was measured.
const ABSENT: &str = "-";

/// Lines above, below the header, and below: nothing between rows.
const LINES: TableStyle = TableStyle::new()
    .top_border(LineStyle::none().fill('─').junction('─'))
    .header_separator(LineStyle::none().fill('─').junction('─'))
    .bottom_border(LineStyle::none().fill('─').junction('─'));

/// The stages that the table of time names; the others are the way between processes.
const WORK: [&str; 5] = ["dynamics", "render", "embed", "search", "decide"];

/// Everything that is printed at the end of a run, from its log alone.
pub fn report(log: &RunLog) -> String {
    let scores = score(log);
    let mut text = results(&scores).to_string();
    text.push('\n');
    if let Some(times) = times(&scores) {
        text += &format!("\nMean time of a step by stage, in microseconds\n{times}\n");
    }
    text.push('\n');
    for line in remarks(log, &scores) {
        text += &line;
        text.push('\n');
    }
    text
}

fn results(scores: &Scores) -> Table {
    let blocked = scores.conditions.iter().any(|score| score.tried_closed.is_some());
    let mut header =
        vec!["memory", "start", "route", "demos", "episodes", "SR %", "SPL", "steps", "images/req"];
    if blocked {
        header.extend(["F %", "C %"]);
    }
    let mut table = table(&header, 4);
    for score in &scores.conditions {
        let ConditionScore { condition, .. } = score;
        let mut row = vec![
            condition.memory.to_string(),
            condition.start.to_string(),
            condition.route.to_string(),
            condition.demonstrations.to_string(),
            score.episodes.to_string(),
            spread(Some(score.sr), 1),
            spread(Some(score.spl), 3),
            figure(score.mean_steps, 1),
            figure(score.images_per_request, 1),
        ];
        if blocked {
            row.extend([spread(score.tried_closed, 1), figure(score.recovered, 1)]);
        }
        table.add_row(row);
    }
    table
}

/// `None` when nothing was timed.
fn times(scores: &Scores) -> Option<Table> {
    let header: Vec<&str> = ["memory", "start", "route", "demos"]
        .into_iter()
        .chain(WORK)
        .chain(["between", "sum"])
        .collect();
    let mut table = table(&header, 4);
    for score in &scores.conditions {
        let Some(times) = &score.stage_us else { continue };
        let condition = score.condition;
        let work = WORK.map(|stage| times.of(stage));
        let between = times.sum - work.iter().flatten().sum::<f64>();
        let mut row = vec![
            condition.memory.to_string(),
            condition.start.to_string(),
            condition.route.to_string(),
            condition.demonstrations.to_string(),
        ];
        row.extend(work.map(|us| figure(us, 0)));
        row.extend([between, times.sum].map(|us| figure(Some(us), 0)));
        table.add_row(row);
    }
    (table.row_count() > 0).then_some(table)
}

fn remarks(log: &RunLog, scores: &Scores) -> Vec<String> {
    let settings = &log.manifest.settings;
    let mut lines = vec![match settings.policy {
        PolicyKind::Grounded => {
            "Policy: grounded, a scripted stand-in. It tests the harness; its numbers are \
                                 no claim about any model."
                .to_owned()
        }
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
    if let Some(rate) = scores.steps_per_s {
        lines.push(format!("Speed: {rate:.0} steps/s with {} lanes.", settings.lanes));
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
    lines
}

/// A table whose columns from `numbers` on are aligned to the right.
pub(crate) fn table(header: &[&str], numbers: usize) -> Table {
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
        Some(Spread { mean, std: None }) => format!("{mean:.digits$}"),
        Some(Spread { mean, std: Some(std) }) => format!("{mean:.digits$} ± {std:.digits$}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conditions::Demonstrations;
    use crate::log::testing::{manifest, record, timings};
    use crate::plan::EpisodeKey;
    use shm_types::Representation;

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
            errors: Vec::new(),
            sessions: Vec::new(),
        };
        insta::assert_snapshot!(report(&log));
    }
}
