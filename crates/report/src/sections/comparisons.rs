//! Tables of comparisons that are made together: their figures, what they show, and what is not paired.

use conditions::{Condition, Route, Start};
use domain::Arm;
use scores::{
    AskedComparison, Comparison, ComparisonVerdict, FigureDifference, Question, Robustness, p_value,
};

use crate::document::{ReportBlock, RowGroup, Table, TableCell, TableColumn, TableRow};
use crate::view::{ScoredRun, signed, with_interval};

/// A comparison as a row.
#[derive(Debug, Clone)]
pub(crate) struct ComparedRow<'a> {
    /// What it shares with its neighbours, if rows are grouped.
    pub(crate) group: Option<String>,
    /// Its own label.
    pub(crate) label: String,
    pub(crate) comparison: &'a Comparison,
}

/// Rows of comparisons, and the headings of their label columns.
#[derive(Debug)]
pub(crate) struct ComparedRows<'a> {
    pub(crate) stubs: &'static [&'static str],
    pub(crate) rows: Vec<ComparedRow<'a>>,
}

/// What every table of conclusions says about them.
const CONCLUSIONS: &str = "Cases that succeed more often (better) or less often (worse) under the first; p: exact two-sided \
     sign test on these two counts, McNemar's exact test where every case has one pair. Better or worse where p, corrected for all comparisons that were made together, is below 5 %: of \
     all such families at most 5 % find a difference where there is none (Holm 1979). Otherwise: the difference that would have \
     been shown with a probability of 80 %, and about how many more cases it would take to show the one observed. Holds: whether \
     the conclusion stays when a part is left out, one at a time: a group of tasks, a task, a repetition, a case.";

impl ComparedRows<'_> {
    fn table(
        &self,
        (id, caption): (String, String),
        columns: Vec<TableColumn>,
        cells: impl Fn(&Comparison) -> Option<Vec<TableCell>>,
    ) -> Option<Table> {
        let groups = self.rows.chunk_by(|a, b| a.group == b.group).map(|rows| RowGroup {
            label: rows.first().and_then(|row| row.group.clone()),
            rows: rows
                .iter()
                .filter_map(|row| Some(TableRow::new(row.label.clone(), cells(row.comparison)?)))
                .collect(),
        });
        let stubs = self.stubs.iter().map(|stub| (*stub).to_owned()).collect();
        let groups = groups.filter(|group: &RowGroup| !group.rows.is_empty()).collect();
        Table { id, caption, stubs, columns, groups }.pruned()
    }

    /// The figures of both sides, and their differences.
    pub(crate) fn figures(&self, id: String, caption: String) -> Option<Table> {
        let mut columns =
            ["first", "second", "paired"].map(|name| TableColumn::under("Episodes", name)).to_vec();
        for over in ["SR %", "SPL"] {
            columns.extend(
                ["first", "second", "difference"].map(|name| TableColumn::under(over, name)),
            );
        }
        self.table((id, caption), columns, |compared| Some(figures(compared)))
    }

    /// What the comparisons show.
    pub(crate) fn conclusions(&self, id: String) -> Option<Table> {
        let family = self.rows.first()?.comparison.conclusion.family;
        let made = match family {
            1 => "One comparison was made.".to_owned(),
            family => format!("{family} comparisons were made together."),
        };
        let columns = ["Cases", "Better", "Worse", "p", "Corrected p", "Conclusion", "Holds"];
        let columns = columns.map(TableColumn::new).to_vec();
        let cells = |compared: &Comparison| {
            let Comparison { cases, more_under_a, more_under_b, p, conclusion, .. } = compared;
            let cells = [
                cases.to_string(),
                more_under_a.to_string(),
                more_under_b.to_string(),
                p_value(*p),
                p_value(conclusion.corrected_p),
                conclusion.sentence.clone(),
                holds(&conclusion.robustness),
            ];
            Some(cells.map(TableCell::Value).to_vec())
        };
        let table = self.table((id, format!("{made} {CONCLUSIONS}")), columns, cells)?;
        Some(table.with_text(&["Conclusion", "Holds"]))
    }

    /// What the comparisons show, in columns that are narrow enough for a terminal.
    pub(crate) fn verdicts(&self) -> Option<Table> {
        let columns = ["Verdict", "Points", "Corrected p", "Shown", "More", "Changes without"];
        let columns = columns.map(TableColumn::new).to_vec();
        let cells = |compared: &Comparison| Some(verdict(compared).map(TableCell::Value).to_vec());
        let table = self.table((String::new(), String::new()), columns, cells)?;
        Some(table.with_text(&["Verdict", "Changes without"]))
    }

    /// What is not paired, and why; `None` where everything is.
    pub(crate) fn unpaired(&self, id: String) -> Option<Table> {
        let caption = "Episodes that one side has finished and the other has not: they enter no figure of the comparison. The \
                       first of each kind are named; `memtransfer score --json` lists all."
            .to_owned();
        let cells = |compared: &Comparison| {
            let text = compared.unpaired_in_words(["the first", "the second"]);
            (!text.is_empty()).then(|| vec![TableCell::Value(text)])
        };
        let table = self.table((id, caption), vec![TableColumn::new("Not paired")], cells)?;
        Some(table.with_text(&["Not paired"]))
    }

    /// All three tables; the ids of the others follow from that of the first.
    pub(crate) fn blocks(&self, id: &str, caption: String) -> Vec<ReportBlock> {
        ReportBlock::tables([
            self.figures(id.to_owned(), caption),
            self.conclusions(format!("{id}-conclusions")),
            self.unpaired(format!("{id}-unpaired")),
        ])
    }
}

/// The tables of the comparisons of the run that answer `question`; none without any.
pub(super) fn asked_blocks(
    view: &ScoredRun<'_>,
    question: Question,
    id: &str,
    caption: &str,
) -> Vec<ReportBlock> {
    asked_rows(view, question)
        .map_or_else(Vec::new, |rows| rows.blocks(&view.id(id), caption.to_owned()))
}

/// The comparisons of the run that answer `question`, by memory.
pub(crate) fn asked_rows<'a>(
    view: &'a ScoredRun<'_>,
    question: Question,
) -> Option<ComparedRows<'a>> {
    let asked = view.scores.comparisons.iter().find(|asked| asked.question == question)?;
    let row = |asked: &'a AskedComparison| ComparedRow {
        group: Some(view.label(asked.memory) + &aside(&asked.condition)),
        label: asked.label.clone(),
        comparison: &asked.comparison,
    };
    let rows = asked.comparisons.iter().map(row).collect();
    Some(ComparedRows { stubs: &["Memory", "Comparison"], rows })
}

/// What distinguishes a condition beside its memory and demonstrations, where it is not the usual one.
fn aside(condition: &Condition) -> String {
    let Condition { start, route, arm, .. } = condition;
    let start = (*start != Start::New).then(|| format!(", {start} start"));
    let route = (*route != Route::Unchanged).then(|| format!(", {route}"));
    let arm = (*arm != Arm::Frozen).then(|| format!(", {}", arm.word()));
    let deviations = condition.deviations().replace('/', ", ");
    [start, route, Some(deviations), arm].into_iter().flatten().collect()
}

/// Whether the conclusion stays when a part is left out.
fn holds(robustness: &Robustness) -> String {
    let changing = robustness.changing();
    match (changing.is_empty(), robustness.cases.parts) {
        (false, _) => format!("except without {changing}"),
        (true, 0) => "-".to_owned(),
        (true, _) => "yes".to_owned(),
    }
}

/// Verdict, difference, corrected p, the difference that would be shown, more cases, and without what the verdict is another.
pub(crate) fn verdict(compared: &Comparison) -> [String; 6] {
    let Comparison { sr, conclusion, .. } = compared;
    let none = || "-".to_owned();
    let changing = conclusion.robustness.changing();
    [
        match conclusion.verdict {
            ComparisonVerdict::NoDifferenceShown => "not shown".to_owned(),
            shown => shown.words().to_owned(),
        },
        signed(sr.mean, 1),
        p_value(conclusion.corrected_p),
        conclusion.detectable.map_or_else(none, |points| format!("{points:.1}")),
        conclusion.more_cases.map_or_else(none, |cases| cases.to_string()),
        if changing.is_empty() { none() } else { changing },
    ]
}

/// What a table of [`verdict`]s says about them.
pub(crate) const VERDICTS: &str = "Better or worse where p, corrected for all comparisons that were made together, is below 5 % (Holm \
     1979); otherwise no difference is shown. Points: the difference of SR. Shown: the smallest difference that would be shown with \
     a probability of 80 % in as many cases; more: about how many more cases it would take to show this one. Changes without: the \
     verdict is another when this is left out, of each group of tasks, task, repetition and case by itself. A dash: none.";

fn figures(compared: &Comparison) -> Vec<TableCell> {
    let Comparison { episodes_a, episodes_b, pairs, sr, spl, .. } = compared;
    let three = |FigureDifference { a, b, mean, interval }: &FigureDifference, digits: usize| {
        [
            TableCell::Value(format!("{a:.digits$}")),
            TableCell::Value(format!("{b:.digits$}")),
            with_interval(signed(*mean, digits), *interval, digits),
        ]
    };
    let counts = [episodes_a, episodes_b, pairs];
    let mut cells = counts.map(|count| TableCell::Value(count.to_string())).to_vec();
    cells.extend(three(sr, 1).into_iter().chain(three(spl, 3)));
    cells
}
