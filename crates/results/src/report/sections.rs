//! What a report says about one run, section by section: each file makes the tables and figures of one of the
//! paper's, or of what the paper leaves out.

mod blocked;
mod conditions;
mod cost;
mod design;
mod failures;
mod groups;
mod main_table;
mod method;
mod mixed;
mod overview;
mod pairs;
mod provenance;
mod runs;
mod time;
mod transfer;

pub(super) use method::method;
pub(super) use runs::runs;

use super::document::{Block, Section};
use super::plot::PlotError;
use super::view::View;

/// A section's name in links, its heading, and what makes its contents.
type Part = (&'static str, &'static str, fn(&View<'_>) -> Result<Vec<Block>, PlotError>);

const PARTS: [Part; 12] = [
    ("overview", "What was run", overview::blocks),
    ("main", "Success across the three questions", main_table::blocks),
    ("transfer", "RQ1: another start than the demonstration's", transfer::blocks),
    ("blocked", "RQ2: a blocked route", blocked::blocks),
    ("mixed", "RQ3: histories of other tasks", mixed::blocks),
    ("groups", "Task groups", groups::blocks),
    ("design", "Design choices", design::blocks),
    ("failures", "Why episodes failed", failures::blocks),
    ("cost", "Images, tokens, unreadable answers", cost::blocks),
    ("time", "Time by stage", time::blocks),
    ("pairs", "Paired comparisons", pairs::blocks),
    ("conditions", "All conditions", conditions::blocks),
];

/// All sections about the run; `level` is that of their headings.
///
/// # Errors
/// When a figure cannot be drawn.
pub(super) fn sections(view: &View<'_>, level: u8) -> Result<Vec<Section>, PlotError> {
    let section = |&(id, title, blocks): &Part| {
        let blocks = blocks(view)?;
        Ok(Section { id: view.id(&format!("s-{id}")), level, title: title.to_owned(), blocks })
    };
    PARTS.iter().map(section).collect()
}

/// Where the run's figures come from.
pub(super) fn provenance(view: &View<'_>, level: u8) -> Section {
    Section {
        id: view.id("s-provenance"),
        level,
        title: "Provenance".to_owned(),
        blocks: provenance::blocks(view),
    }
}
