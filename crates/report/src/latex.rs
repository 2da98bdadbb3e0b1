//! Tables as LaTeX, for a paper: `booktabs` rules, a caption that names the policy, and a label.

use crate::document::{Missing, Table, TableCell, TableColumn};

/// The table as a `table` environment, labelled `tab:ID`. A document needs `\usepackage{booktabs}`.
pub(super) fn table(table: &Table) -> String {
    let alignment = alignment(table);
    let mut lines = vec![
        r"% Needs \usepackage{booktabs}.".to_owned(),
        r"\begin{table}".to_owned(),
        r"\centering".to_owned(),
        format!(r"\caption{{{}}}", escaped(&table.caption)),
        format!(r"\label{{tab:{}}}", table.id),
        r"\small".to_owned(),
        format!(r"\begin{{tabular}}{{{alignment}}}"),
        r"\toprule".to_owned(),
    ];
    lines.extend(shared_headings(table));
    let headings = table.stubs.iter().chain(table.columns.iter().map(|column| &column.name));
    lines.push(row(headings.map(|heading| escaped(heading))));
    for group in &table.groups {
        lines.push(r"\midrule".to_owned());
        for (place, of_group) in group.rows.iter().enumerate() {
            let group_label = group.label.iter().map(|label| match place {
                0 => escaped(label),
                _ => String::new(),
            });
            let labels = group_label.chain([escaped(&of_group.label)]);
            lines.push(row(labels.chain(of_group.cells.iter().map(cell))));
        }
    }
    lines.push(r"\bottomrule".to_owned());
    lines.push(r"\end{tabular}".to_owned());
    for note in table.notes() {
        lines.push(format!(r"\\ \footnotesize {}", escaped(&note)));
    }
    lines.push(r"\end{table}".to_owned());
    lines.join("\n") + "\n"
}

/// The characters that fit in a line of small print.
const LINE: usize = 90;

/// The characters of a column of text above which its lines are broken, where the table is wider than a line.
const LONG_TEXT: usize = 24;

/// The kinds of the columns. Where the table is wider than a line, its columns of long text share what the others leave.
fn alignment(table: &Table) -> String {
    let rows = || table.groups.iter().flat_map(|group| &group.rows);
    let longest = |index: usize| {
        let cells = rows().filter_map(|row| row.cells.get(index)).map(length);
        cells.chain([table.columns[index].name.chars().count()]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..table.columns.len()).map(longest).collect();
    let labels = rows().map(|row| row.label.chars().count()).max().unwrap_or(0);
    let group_labels = table.groups.iter().filter_map(|group| group.label.as_ref());
    let group_labels = group_labels.map(|label| label.chars().count()).max().unwrap_or(0);
    let is_long = |index: usize| table.columns[index].is_text && widths[index] > LONG_TEXT;
    let long: usize =
        (0..widths.len()).filter(|index| is_long(*index)).map(|index| widths[index]).sum();
    let gaps = 2 * (table.stubs.len() + widths.len());
    let others = labels + group_labels + gaps + widths.iter().sum::<usize>() - long;
    let is_wide = others + long > LINE;
    let kind = |(index, column): (usize, &TableColumn)| {
        if is_wide && is_long(index) {
            // Columns of figures alone may fill a line; text still needs room.
            let left = LINE.saturating_sub(others).max(LINE / 3);
            let share = left as f64 / LINE as f64 * widths[index] as f64 / long as f64;
            format!(r"p{{{share:.2}\linewidth}}")
        } else if column.is_text {
            "l".to_owned()
        } else {
            "r".to_owned()
        }
    };
    let stubs = "l".repeat(table.stubs.len());
    stubs + &table.columns.iter().enumerate().map(kind).collect::<String>()
}

/// The characters of a cell; those of an interval are smaller.
fn length(cell: &TableCell) -> usize {
    match cell {
        TableCell::Value(value) => value.chars().count(),
        TableCell::Sure { figure, interval } => {
            figure.chars().count() + 3 * interval.chars().count() / 4
        }
        TableCell::Missing(missing) => missing.mark().chars().count(),
    }
}

/// The line of headings that columns share, with rules below them; none where no columns share one.
fn shared_headings(table: &Table) -> Vec<String> {
    if !table.has_spans() {
        return Vec::new();
    }
    let mut cells: Vec<String> = table.stubs.iter().map(|_| String::new()).collect();
    let mut rules = String::new();
    let mut first = table.stubs.len() + 1;
    for (over, count) in table.spans() {
        if over.is_empty() {
            cells.extend((0..count).map(|_| String::new()));
        } else {
            cells.push(format!(r"\multicolumn{{{count}}}{{c}}{{{}}}", escaped(over)));
            rules += &format!(r"\cmidrule(lr){{{first}-{}}}", first + count - 1);
        }
        first += count;
    }
    vec![row(cells.into_iter()), rules]
}

fn row(cells: impl Iterator<Item = String>) -> String {
    cells.collect::<Vec<_>>().join(" & ") + r" \\"
}

fn cell(cell: &TableCell) -> String {
    match cell {
        TableCell::Value(value) => escaped(value),
        TableCell::Sure { figure, interval } => {
            format!(r"{} {{\scriptsize {}}}", escaped(figure), escaped(interval))
        }
        TableCell::Missing(Missing::NotReported(_)) => "---".to_owned(),
        TableCell::Missing(missing) => escaped(missing.mark()),
    }
}

/// The text with what LaTeX reads as a command written out.
fn escaped(text: &str) -> String {
    let mut shown = String::new();
    for character in text.chars() {
        match character {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => {
                shown.push('\\');
                shown.push(character);
            }
            '\\' => shown.push_str(r"\textbackslash{}"),
            '~' => shown.push_str(r"\textasciitilde{}"),
            '^' => shown.push_str(r"\textasciicircum{}"),
            '<' => shown.push_str("$<$"),
            '>' => shown.push_str("$>$"),
            '≤' => shown.push_str(r"$\leq$"),
            '≥' => shown.push_str(r"$\geq$"),
            '−' => shown.push_str("$-$"),
            '±' => shown.push_str(r"$\pm$"),
            '×' => shown.push_str(r"$\times$"),
            'Δ' => shown.push_str(r"$\Delta$"),
            '—' => shown.push_str("---"),
            '–' => shown.push_str("--"),
            '“' => shown.push_str("``"),
            '”' => shown.push_str("''"),
            // A bracket after the end of a row would be read as its argument.
            '[' => shown.push_str("{[}"),
            _ => shown.push(character),
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::{RowGroup, TableRow};

    #[test]
    fn a_table_has_groups_shared_headings_and_no_stray_command() {
        let rows = vec![
            TableRow::new(
                "100 % & more",
                vec![
                    TableCell::Sure {
                        figure: "−3.2 ± 0.1".to_owned(),
                        interval: "[−4.0, 1.5]".to_owned(),
                    },
                    TableCell::Value("my_memory".to_owned()),
                ],
            ),
            TableRow::new(
                "b",
                vec![
                    TableCell::Missing(Missing::NotReported("it is a figure")),
                    TableCell::Missing(Missing::NotRun),
                ],
            ),
        ];
        let shown = table(&Table {
            id: "pairs".to_owned(),
            caption: "Success in %. Policy: grounded.".to_owned(),
            stubs: vec!["Memory".to_owned(), "Setting".to_owned()],
            columns: vec![TableColumn::under("SR", "mean"), TableColumn::text("Name")],
            groups: vec![RowGroup { label: Some("Episodic".to_owned()), rows }],
        });
        insta::assert_snapshot!(shown, @r"
        % Needs \usepackage{booktabs}.
        \begin{table}
        \centering
        \caption{Success in \%. Policy: grounded.}
        \label{tab:pairs}
        \small
        \begin{tabular}{llrl}
        \toprule
         &  & \multicolumn{1}{c}{SR} &  \\
        \cmidrule(lr){3-3}
        Memory & Setting & mean & Name \\
        \midrule
        Episodic & 100 \% \& more & $-$3.2 $\pm$ 0.1 {\scriptsize {[}$-$4.0, 1.5]} & my\_memory \\
         & b & --- & not run \\
        \bottomrule
        \end{tabular}
        \\ \footnotesize ---, not published: it is a figure
        \end{table}
        ");
    }

    #[test]
    fn long_text_is_broken_where_the_table_is_wider_than_a_line() {
        let table_with_text = |length: usize| Table {
            id: "t".to_owned(),
            caption: String::new(),
            stubs: vec!["Condition".to_owned()],
            columns: vec![TableColumn::new("p"), TableColumn::text("Conclusion")],
            groups: vec![RowGroup {
                label: None,
                rows: vec![TableRow::new(
                    "0123456789",
                    vec![
                        TableCell::Value("0.500".to_owned()),
                        TableCell::Value("x".repeat(length)),
                    ],
                )],
            }],
        };
        // 10 + 5 + 3 gaps of 2 leave 69 of 90.
        assert_eq!(alignment(&table_with_text(69)), "lrl");
        assert_eq!(alignment(&table_with_text(70)), r"lrp{0.77\linewidth}");
    }
}
