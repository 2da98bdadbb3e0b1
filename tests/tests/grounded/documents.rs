//! Small documents in the extractive builder's grammar, from what demonstrations show and do.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use shm_types::plate::{self, Plate};
use shm_types::{Cell, Heading};
use warehouse::{CaseSet, Start, Variant, Warehouse};

use crate::views::Views;

/// What can be gathered from the demonstrations of all cases.
struct Survey {
    floor: BTreeSet<Cell>,
    plates: BTreeMap<(Cell, Heading), Plate>,
    routes: Vec<String>,
    categories: Vec<String>,
    types: Vec<String>,
}

impl Survey {
    fn of(warehouse: &Warehouse, cases: &CaseSet, views: &mut Views, starts: &[Start]) -> Self {
        let instructions: Vec<String> =
            cases.cases.iter().map(|case| case.task.instruction(&warehouse.catalogue)).collect();
        let is_asked = |name: &&String| instructions.iter().any(|text| text.contains(*name));
        let catalogue = &warehouse.catalogue;
        let categories = catalogue.categories.iter().map(|category| &category.name);
        let types = catalogue.types.iter().map(|item_type| &item_type.name);
        let mut survey = Self {
            floor: BTreeSet::new(),
            plates: BTreeMap::new(),
            routes: Vec::new(),
            categories: categories.filter(is_asked).cloned().collect(),
            types: types.filter(is_asked).cloned().collect(),
        };
        for (case, instruction) in cases.cases.iter().zip(&instructions) {
            for &start in starts {
                let replay = case.replay(warehouse, start);
                let first = replay.poses[0];
                let mut route =
                    format!("- \"{instruction}\" from {} facing {}:", first.cell, first.heading);
                for (before, pose) in replay.poses.iter().zip(&replay.poses[1..]) {
                    if before.cell != pose.cell {
                        write!(route, " to {},", pose.cell).unwrap();
                    }
                }
                survey.routes.push(route);
                for pose in replay.poses {
                    survey.floor.insert(pose.cell);
                    let picture = views.of(pose, &Variant::UNCHANGED);
                    let frame = picture.frame();
                    for sighting in plate::read(frame.width, frame.height, frame.pixels) {
                        let landmark = sighting.seen_from(pose).unwrap();
                        survey.plates.insert((landmark.standpoint, landmark.face), landmark.plate);
                    }
                }
            }
        }
        survey
    }

    /// "column 3: rows 1-14" for each stretch of floor.
    fn passages(&self) -> String {
        let mut text = String::new();
        for x in 0..=u8::MAX {
            let rows: Vec<u8> =
                self.floor.iter().filter(|cell| cell.x == x).map(|cell| cell.y).collect();
            for run in rows.chunk_by(|a, b| a + 1 == *b) {
                writeln!(text, "- column {x}: rows {}-{}", run[0], run[run.len() - 1]).unwrap();
            }
        }
        text
    }

    fn name_of(&self, plate: Plate) -> Option<&String> {
        self.types.iter().find(|name| plate.is_type(name))
    }
}

/// Where items of a category stand, and of which types those are.
#[derive(Default)]
struct Region {
    columns: BTreeSet<u8>,
    rows: BTreeSet<u8>,
    types: BTreeSet<String>,
}

fn digits(code: &[u8]) -> String {
    code.iter().map(u8::to_string).collect()
}

/// A summary: items with standpoints, passages, routes.
pub(crate) fn summary(
    warehouse: &Warehouse,
    cases: &CaseSet,
    views: &mut Views,
    starts: &[Start],
) -> String {
    let survey = Survey::of(warehouse, cases, views, starts);
    let mut text = "# Summary of the demonstrations\n\n## Items\n".to_owned();
    for ((standpoint, face), plate) in &survey.plates {
        let name = survey.name_of(*plate).map_or("item", String::as_str);
        let (category, item_type) = (digits(&plate.0[..3]), digits(&plate.0[3..]));
        writeln!(
            text,
            "- {name} [plate {category}-{item_type}]: stand at {standpoint} facing {face}"
        )
        .unwrap();
    }
    write!(text, "\n## Passages\n{}\n## Routes\n", survey.passages()).unwrap();
    survey.routes.iter().for_each(|route| writeln!(text, "{route}").unwrap());
    text
}

/// Semantic knowledge: corridors, and in which stretch of which corridor which kinds stand.
pub(crate) fn semantic(
    warehouse: &Warehouse,
    cases: &CaseSet,
    views: &mut Views,
    starts: &[Start],
) -> String {
    let survey = Survey::of(warehouse, cases, views, starts);
    let mut text = format!(
        "# Knowledge of the warehouse\n## Layout\n{}\n## Where kinds of items stand\n",
        survey.passages()
    );
    let mut regions: BTreeMap<([u8; 3], u8), Region> = BTreeMap::new();
    for ((standpoint, _), plate) in &survey.plates {
        let category = [plate.0[0], plate.0[1], plate.0[2]];
        let region = regions.entry((category, standpoint.x / 3)).or_default();
        region.columns.insert(standpoint.x);
        region.rows.insert(standpoint.y);
        region.types.extend(survey.name_of(*plate).cloned());
    }
    for ((category, _), Region { columns, rows, types }) in regions {
        let is_it = |name: &&String| plate::code(name) == category;
        let name = survey.categories.iter().find(is_it).map_or("items", String::as_str);
        let (left, right) = (columns.first().unwrap(), columns.last().unwrap());
        let (low, high) = (rows.first().unwrap(), rows.last().unwrap());
        let seen = types.into_iter().collect::<Vec<_>>().join(", ");
        let plate = digits(&category);
        writeln!(
            text,
            "- {name} [plate {plate}]: columns {left}-{right}, rows {low}-{high}; seen there: {seen}"
        )
        .unwrap();
    }
    text
}
