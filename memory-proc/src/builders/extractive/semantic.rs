//! General knowledge, in three steps: facts are extracted from each demonstration, consolidated over all of them, and
//! refined. Places become regions, and what was seen or done only once is left out.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use domain::Cell;
use plates::Plate;

use super::super::floor::{Floor, Stretch};
use super::super::names::{CatalogueNames, PlateLabel};
use super::super::survey::{Survey, SurveyedBay};
use super::super::transcript::{Transcript, TranscriptStep};
use super::category_digits;

/// Minimum number of frames or demonstrations that support a fact.
const LEAST_SUPPORT: u32 = 2;

/// Minimum length of a corridor or an aisle, in cells.
const LEAST_LENGTH: u8 = 5;

/// Maximum distance between neighbouring standpoints of a region, in columns or rows.
const REGION_GAP: u8 = 3;

/// Facts as they are found.
#[derive(Debug, Default)]
pub(super) struct FoundFacts {
    names: CatalogueNames,
    survey: Survey,
    floor: Floor,
    /// Steps to the first sub-goal, for each demonstration that completed one.
    first_completions: Vec<usize>,
    /// The steps that completed a sub-goal.
    completions: Vec<TranscriptStep>,
}

/// Facts after consolidation.
#[derive(Debug)]
pub(super) struct RefinedFacts {
    corridors: Vec<Stretch>,
    aisles: Vec<Stretch>,
    kinds: Vec<Kind>,
    /// Whether items of one category stand side by side.
    neighbours: bool,
    /// Whether sub-goals were completed facing away from the item.
    heading_is_free: bool,
    /// Steps to the first sub-goal: median and maximum.
    first_completion: Option<(usize, usize)>,
}

/// A region in which items of one category stand.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Kind {
    /// The category's name; empty if no instruction mentions it.
    name: String,
    /// The category's digits on plates.
    digits: String,
    /// West, east, south and north bound of the standpoints.
    region: [u8; 4],
    /// The types seen there.
    types: BTreeSet<String>,
}

impl FoundFacts {
    /// Extracts the facts of one demonstration.
    pub(super) fn extract(&mut self, transcript: &Transcript) {
        let steps = &transcript.steps;
        self.names.add(&transcript.instruction);
        steps.iter().for_each(|step| self.survey.add(step));
        self.floor.add(steps.iter().map(|step| step.pose.cell));
        self.first_completions.extend(steps.iter().position(|step| step.completed > 0));
        let completing = steps.windows(2).filter(|pair| pair[1].completed > pair[0].completed);
        self.completions.extend(completing.map(|pair| pair[1].clone()));
    }

    /// Combines the facts and drops those with too little support.
    pub(super) fn consolidate(mut self) -> RefinedFacts {
        let stretches = self.floor.stretches(LEAST_SUPPORT);
        let (corridors, aisles) = stretches
            .into_iter()
            .filter(|stretch| stretch.cells() >= LEAST_LENGTH)
            .partition(|stretch| matches!(stretch, Stretch::Column { .. }));
        let bays: Vec<SurveyedBay> =
            self.survey.bays().filter(|bay| bay.support >= LEAST_SUPPORT).collect();
        let unfaced = self.completions.iter().filter(|step| !self.faces_an_item(step)).count();
        self.first_completions.sort_unstable();
        let middle = self.first_completions.get(self.first_completions.len() / 2);
        RefinedFacts {
            corridors,
            aisles,
            kinds: kinds(&self.names, &bays),
            neighbours: stand_side_by_side(&bays),
            heading_is_free: unfaced as u32 >= LEAST_SUPPORT,
            first_completion: middle.copied().zip(self.first_completions.last().copied()),
        }
    }

    /// Whether the expert faces an item that it stands in front of, or stands in front of none.
    fn faces_an_item(&self, step: &TranscriptStep) -> bool {
        let mut here =
            self.survey.bays().filter(|bay| bay.landmark.standpoint == step.pose.cell).peekable();
        here.peek().is_none() || here.any(|bay| bay.landmark.face == step.pose.heading)
    }
}

/// The bays of each category.
fn by_category(bays: &[SurveyedBay]) -> BTreeMap<[u8; 3], Vec<SurveyedBay>> {
    let mut categories = BTreeMap::<_, Vec<SurveyedBay>>::new();
    for &bay in bays {
        let [a, b, c, ..] = bay.landmark.plate.0;
        categories.entry([a, b, c]).or_default().push(bay);
    }
    categories
}

fn kinds(names: &CatalogueNames, bays: &[SurveyedBay]) -> Vec<Kind> {
    let mut kinds = Vec::new();
    for bays in by_category(bays).into_values() {
        for region in regions(bays) {
            let plates = || region.iter().map(|bay| bay.landmark.plate);
            let Some(plate) = plates().next() else { continue };
            let cells = || region.iter().map(|bay| bay.landmark.standpoint);
            let (columns, rows) = (range(cells().map(|c| c.x)), range(cells().map(|c| c.y)));
            let typed = |plate: Plate| match names.label(plate) {
                PlateLabel::Type(name) => Some(name.to_owned()),
                PlateLabel::Category(_) | PlateLabel::Unnamed => None,
            };
            kinds.push(Kind {
                name: names.category(plate).unwrap_or_default().to_owned(),
                digits: category_digits(plate),
                region: [columns.0, columns.1, rows.0, rows.1],
                types: plates().filter_map(typed).collect(),
            });
        }
    }
    // Named categories first.
    kinds.sort_by(|a, b| (a.name.is_empty(), a).cmp(&(b.name.is_empty(), b)));
    kinds
}

fn range(places: impl Iterator<Item = u8>) -> (u8, u8) {
    places.fold((u8::MAX, 0), |(low, high), place| (low.min(place), high.max(place)))
}

/// Groups bays with those near them.
fn regions(bays: Vec<SurveyedBay>) -> Vec<Vec<SurveyedBay>> {
    let mut regions: Vec<Vec<SurveyedBay>> = Vec::new();
    for bay in bays {
        let (mut joined, others): (Vec<_>, Vec<_>) = regions
            .into_iter()
            .partition(|region| region.iter().any(|other| gap(&bay, other) <= REGION_GAP));
        joined.push(vec![bay]);
        regions = others;
        regions.push(joined.concat());
    }
    regions
}

/// The distance between two standpoints: columns or rows, whichever is greater.
fn gap(a: &SurveyedBay, b: &SurveyedBay) -> u8 {
    let (Cell { x, y }, other) = (a.landmark.standpoint, b.landmark.standpoint);
    x.abs_diff(other.x).max(y.abs_diff(other.y))
}

/// Whether at least three in four items have one of their own category beside them.
fn stand_side_by_side(bays: &[SurveyedBay]) -> bool {
    let categories = by_category(bays);
    let has_neighbour = |own: &[SurveyedBay], bay: &SurveyedBay| {
        own.iter().any(|other| other.landmark != bay.landmark && gap(bay, other) <= 1)
    };
    let beside: usize = categories
        .values()
        .map(|own| own.iter().filter(|bay| has_neighbour(own, bay)).count())
        .sum();
    !bays.is_empty() && 4 * beside >= 3 * bays.len()
}

impl fmt::Display for RefinedFacts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "# Knowledge of the warehouse\n\
             Positions are (column, row): columns grow east, rows grow north.\n\n## Layout\n",
        )?;
        write_stretches(f, "North-south corridors", &self.corridors)?;
        write_stretches(f, "East-west aisles", &self.aisles)?;
        f.write_str("\n## Where kinds of items stand\n")?;
        for Kind { name, digits, region, types } in &self.kinds {
            let name = if name.is_empty() { "items" } else { name };
            let [west, east, south, north] = region;
            write!(f, "- {name} [plate {digits}]: columns {west}-{east}, rows {south}-{north}")?;
            if !types.is_empty() {
                let types: Vec<&str> = types.iter().map(String::as_str).collect();
                write!(f, "; seen there: {}", types.join(", "))?;
            }
            f.write_str("\n")?;
        }
        f.write_str("\n## Navigation\n")?;
        if self.neighbours {
            f.write_str(
                "- Items of one kind stand in neighbouring bays: having found one, look beside it.\n",
            )?;
        }
        if self.heading_is_free {
            f.write_str(
                "- Standing on the cell in front of an item reaches it, whichever way one faces.\n",
            )?;
        }
        if !self.aisles.is_empty() && self.corridors.len() > 1 {
            let rows = self.aisles.iter().filter_map(|aisle| match aisle {
                Stretch::Row { y, .. } => Some(y.to_string()),
                Stretch::Column { .. } => None,
            });
            let rows: BTreeSet<String> = rows.collect();
            let mut rows: Vec<String> = rows.into_iter().collect();
            rows.sort_by_key(|row| (row.len(), row.clone()));
            writeln!(f, "- To change corridors use an east-west aisle: rows {}.", rows.join(", "))?;
        }
        if let Some((middle, most)) = self.first_completion {
            writeln!(
                f,
                "- The first target was reached within {middle} steps in half of the demonstrations, within {most} in all."
            )?;
        }
        Ok(())
    }
}

fn write_stretches(f: &mut fmt::Formatter<'_>, what: &str, stretches: &[Stretch]) -> fmt::Result {
    if stretches.is_empty() {
        return Ok(());
    }
    let words = stretches.iter().map(|stretch| match stretch {
        Stretch::Column { x, from, to } => format!("column {x} (rows {from}-{to})"),
        Stretch::Row { y, from, to } => format!("row {y} (columns {from}-{to})"),
    });
    writeln!(f, "- {what}: {}", words.collect::<Vec<_>>().join(", "))
}
