//! Section Design Choices: the window, segments of images alone, the original-start hint.

use domain::{MemoryKind, Representation};

use crate::document::{ReportBlock, RowGroup, Table, TableRow};
use crate::sections::main_table::{rate_figure, rate_rows};
use crate::view::{OURS, ScoredRun, THEIRS, name, our_rates, rate_columns, their_rates};

const ORIGINAL: &str = "original/unchanged";

pub(super) fn blocks(view: &ScoredRun<'_>) -> Vec<ReportBlock> {
    let choices = choices(view);
    let row = |(choice, name): &(String, String)| {
        TableRow::new(choice, [our_rates(view, name), their_rates(view, name)].concat())
    };
    let group = |(heading, conditions): &(String, Vec<(String, String)>)| RowGroup {
        label: Some(heading.clone()),
        rows: conditions.iter().filter(|(_, name)| view.score(name).is_some()).map(row).collect(),
    };
    let table = Table {
        id: view.id("design"),
        caption: "Design choices, at the original start on the unchanged route with the original demonstration (the paper's section “Design Choices”)."
            .to_owned(),
        stubs: vec!["Representation".to_owned(), "Choice".to_owned()],
        columns: rate_columns(&[OURS, THEIRS]),
        groups: choices.iter().map(group).collect(),
    };
    let rows =
        choices.iter().flat_map(|(heading, conditions)| rate_rows(view, heading, conditions));
    let figure = rate_figure(
        view.id("design-figure"),
        "Success rate by design choice. Filled: this run with its 95 % interval. Open: published, mean ± standard \
         deviation where it is printed.",
        rows.collect(),
    );
    table.pruned().map(ReportBlock::Table).into_iter().chain(figure).collect()
}

/// The conditions by heading, each with what is varied and its name.
fn choices(view: &ScoredRun<'_>) -> Vec<(String, Vec<(String, String)>)> {
    let of = |memory: MemoryKind, choices: &[(&str, &str)]| {
        let standard = name(memory, ORIGINAL, "original");
        let named =
            |(choice, part): &(&str, &str)| ((*choice).to_owned(), format!("{standard}{part}"));
        (view.label(memory), choices.iter().map(named).collect())
    };
    let hint = [("hint on (standard)", ""), ("hint off", "/no-hint")];
    let mut choices = vec![
        of(
            Representation::Working.into(),
            &[("window h = 0", "/h0"), ("window h = 6 (standard)", ""), ("window h = 20", "/h20")],
        ),
        of(Representation::FullContext.into(), &hint),
        of(
            Representation::Episodic.into(),
            &[
                ("actions and images, hint on (standard)", ""),
                ("images alone", "/images"),
                ("hint off", "/no-hint"),
            ],
        ),
    ];
    let external = view.external_memories().into_iter();
    choices.extend(external.map(|memory| of(memory.into(), &hint)));
    choices
}
