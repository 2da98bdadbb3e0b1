//! The sections of a report about one run: a file for each of the paper's tables, and for what the paper leaves out.

mod blocked;
mod comparisons;
mod conditions;
mod conflict;
mod controls;
mod cost;
mod design;
mod documents;
mod elsewhere;
mod failures;
mod groups;
mod growth;
mod main_table;
mod method;
mod missing;
mod mixed;
mod overview;
mod pairs;
mod provenance;
mod ranking;
mod reproduction;
mod runs;
mod sensitivity;
mod streams;
mod supplied;
mod time;
mod transfer;

pub(super) use method::method;
pub(super) use ranking::ranking;
pub(super) use reproduction::section as reproduction;
pub(super) use runs::runs;

use blocked::{blocked_table, other_blocked_table};

use super::document::{ReportBlock, ReportSection};
use super::view::ScoredRun;

pub(super) use blocked::all_blocked_table;
pub(super) use comparisons::{VERDICTS, asked_rows, verdict};
pub(super) use conditions::conditions_table;
pub(super) use conflict::conflict_table;
pub(super) use controls::{certified_table, controls_table};
pub(super) use cost::requests_table;
pub(super) use elsewhere::left_out;
pub(super) use failures::{failures_table, points_table, worst_table};
pub(super) use growth::growth_table;
pub(super) use overview::{notices, steps_per_second};
pub(super) use sensitivity::sensitivity_table;
pub(super) use streams::{
    adaptation_table, differences_table, incomplete, necessity_table, orders_table, success_table,
    transfer_table,
};
pub(super) use supplied::supplied_table;
pub(super) use time::time_table;

/// A section's name in links, its heading, and the function that makes its content.
type SectionEntry = (&'static str, &'static str, fn(&ScoredRun<'_>) -> Vec<ReportBlock>);

const PARTS: [SectionEntry; 17] = [
    ("overview", "What was run", overview::blocks),
    ("conditions", "All conditions", conditions::blocks),
    ("main", "Success across the three questions", main_table::blocks),
    ("transfer", "RQ1: demonstrations from other starts", transfer::blocks),
    ("blocked", "RQ2: a blocked route", |view| {
        ReportBlock::tables([blocked_table(view), other_blocked_table(view)])
    }),
    ("mixed", "RQ3: histories of other tasks", mixed::blocks),
    ("controls", "Controls: right and wrong content", controls::blocks),
    ("conflict", "Demonstrations from before and after an event", conflict::blocks),
    ("growth", "Banks of different sizes", growth::blocks),
    ("sensitivity", "Mismatch of demonstration and test", |view| {
        ReportBlock::tables([sensitivity_table(view)])
    }),
    ("groups", "Task groups", groups::blocks),
    ("design", "Design choices", design::blocks),
    ("failures", "Why episodes failed", failures::blocks),
    ("cost", "Images, tokens, unreadable answers", cost::blocks),
    ("supplied", "What memory supplied", |view| ReportBlock::tables([supplied_table(view)])),
    ("time", "Time by stage", time::blocks),
    ("pairs", "Paired comparisons", pairs::blocks),
];

/// Parts in which figures that the paper prints stand beside the run's.
const BESIDE_PUBLISHED: [&str; 6] = ["main", "transfer", "blocked", "mixed", "groups", "design"];

/// Parts that the paper does not have: they are not named where they were not run.
const BEYOND_THE_PAPER: [&str; 4] = ["controls", "conflict", "growth", "sensitivity"];

/// All sections about the run. Those of the paper without any figure of the run are named in one line of the first section,
/// except where all its episodes are of streams.
pub(super) fn sections(view: &ScoredRun<'_>) -> Vec<ReportSection> {
    let mut sections = Vec::new();
    let mut not_run = Vec::new();
    for (id, title, blocks) in PARTS {
        let mut blocks = blocks(view);
        if blocks
            .iter()
            .any(|block| matches!(block, ReportBlock::Table(_) | ReportBlock::Figure(_)))
        {
            if BESIDE_PUBLISHED.contains(&id)
                && view.published.is_paper
                && let Some(sentence) = overview::had_plates(&view.log.manifest)
            {
                blocks.insert(0, ReportBlock::Text(sentence));
            }
            sections.push(ReportSection::new(view.id(&format!("s-{id}")), title, blocks));
        } else if !BEYOND_THE_PAPER.contains(&id) {
            not_run.push(title);
        }
    }
    let is_of_streams = view.scores.streams.is_some() && view.scores.conditions.is_empty();
    let is_silent = not_run.is_empty() || is_of_streams;
    if let (Some(first), false) = (sections.first_mut(), is_silent) {
        let text = match view.log.episodes.is_empty() {
            true => "No episode of this run is finished.".to_owned(),
            false => format!(
                "Sections without a figure of this run are left out: {}.",
                not_run.join("; ")
            ),
        };
        first.blocks.push(ReportBlock::Text(text));
    }
    sections.extend(elsewhere::section(view));
    // After the overview.
    let at = sections.len().min(1);
    sections.splice(at..at, streams::sections(view));
    sections
}

/// The section about the origin of the run's figures.
pub(super) fn provenance(view: &ScoredRun<'_>) -> ReportSection {
    let title = match view.prefix.as_str() {
        "" => "Provenance".to_owned(),
        _ => format!("Provenance of {}", view.log.name),
    };
    ReportSection::new(view.id("s-provenance"), title, provenance::blocks(view))
}
