//! Checks a warehouse and its cases against every constraint (specification, sections 2 to 4 and section 6), by replay.
//!
//! Only the last constraint uses the generator, to check that it generates the same cases again.

mod histories;
mod report;

use std::collections::BTreeSet;
use std::fmt;

use domain::{Cell, MAX_STEPS, Pose};
use plates::Plate;

use crate::case::{Case, CaseSet, TrajectoryKind};
use crate::constraints::{
    FloorEdge, MAX_DETOUR_PERCENT, completes_task, edges, enters, faces_targets, is_distant,
    is_near_optimal, is_nearby, is_of_similar_length, is_opposite, shares_at_least_half,
    shares_at_most_half, target_in_view, target_on,
};
use crate::dynamics::Variant;
use crate::layout::{Axis, Layout, Square};
use crate::plan::{Planner, Prices};
use crate::trajectory::Replay;
use crate::world::{Item, Warehouse, groups};

use crate::task_type::TaskType;
pub use report::{ConstraintResult, CountRange, HistoryStatistics, ValidationReport};
use report::{at_least, ensure, equal};

// The constraints below contain these numbers.
const _: () = assert!(MAX_STEPS == 200 && MAX_DETOUR_PERCENT == 150);

/// Checks all constraints.
pub fn validate(warehouse: &Warehouse, cases: &CaseSet) -> ValidationReport {
    let mut report = check(warehouse, cases);
    regeneration(&mut report, warehouse, cases);
    report
}

/// Checks all constraints except regeneration.
pub(crate) fn check(warehouse: &Warehouse, cases: &CaseSet) -> ValidationReport {
    let mut report = ValidationReport { lines: Vec::new(), mixtures: Vec::new() };
    floor(&mut report, &warehouse.layout);
    items(&mut report, warehouse);
    set(&mut report, cases);
    let replayed: Vec<Replayed<'_>> =
        cases.cases.iter().map(|case| Replayed::new(warehouse, case)).collect();
    trajectories(&mut report, warehouse, &replayed);
    demonstrations(&mut report, warehouse, &replayed);
    tests(&mut report, warehouse, &replayed);
    histories::check(&mut report, warehouse, cases);
    report
}

fn floor(report: &mut ValidationReport, layout: &Layout) {
    let running = |axis| layout.aisles().iter().filter(|aisle| aisle.runs == axis).count();
    report.push(
        "at least two aisles run north-south and at least two east-west",
        [
            at_least("aisles north-south", running(Axis::NorthSouth), 2),
            at_least("aisles east-west", running(Axis::EastWest), 2),
        ],
    );

    let parts = parts(layout, &[]).len();
    report.push("all free cells are connected", [equal("separate parts", parts, 1)]);

    report.push(
        "two routes join any two aisles: closing one passage separates none",
        layout.passages().iter().map(|closed| {
            let aisles = |part: &Vec<Cell>| {
                let all = part.iter().filter_map(|&cell| layout.aisle_index(cell));
                all.collect::<BTreeSet<usize>>().len()
            };
            let joined = self::parts(layout, closed).iter().map(aisles).max();
            ensure(joined == Some(layout.aisles().len()), || {
                format!("closing {} separates two aisles", list(closed))
            })
        }),
    );
}

/// The separate parts of the free floor when `closed` is closed.
fn parts(layout: &Layout, closed: &[Cell]) -> Vec<Vec<Cell>> {
    let mut open: BTreeSet<Cell> = layout.free_cells().collect();
    open.retain(|cell| !closed.contains(cell));
    let mut parts = Vec::new();
    while let Some(&first) = open.first() {
        let part = layout.reachable(first, closed);
        open.retain(|cell| part.binary_search(cell).is_err());
        parts.push(part);
    }
    parts
}

fn items(report: &mut ValidationReport, warehouse: &Warehouse) {
    let Warehouse { layout, catalogue, items } = warehouse;
    let most = (0..catalogue.types.len()).map(|index| warehouse.instances(index).count()).max();
    report.push(
        "at least two categories, and a type with at least two items",
        [
            at_least("categories", catalogue.categories.len(), 2),
            at_least("items of a type", most.unwrap_or(0), 2),
        ],
    );

    report.push(
        "every item stands on a rack face, at a free standpoint of its own",
        items.iter().enumerate().map(|(index, item)| {
            let alone = items.iter().filter(|i| i.standpoint == item.standpoint).count() == 1;
            let faces = item.rack.step(item.face) == Some(item.standpoint);
            let stands = layout.square(item.rack) == Square::Rack && faces;
            ensure(
                usize::from(item.id) == index && alone && stands && layout.is_free(item.standpoint),
                || format!("item {index}: {item:?}"),
            )
        }),
    );

    report.push(
        "items of a category stand in neighbouring bays",
        catalogue.categories.iter().enumerate().map(|(index, category)| {
            let cells = warehouse.items_in(index).map(|item| item.standpoint).collect();
            equal(&format!("groups of {}", category.name), groups(cells).len(), 1)
        }),
    );

    let plate = |index: usize| {
        let item_type = &catalogue.types[index];
        Plate::new(&catalogue.categories[item_type.category].name, &item_type.name)
    };
    report.push(
        "any two types and any two categories have different plates",
        (0..catalogue.types.len()).flat_map(|b| (0..b).map(move |a| (a, b))).map(|(a, b)| {
            let (one, other) = (&catalogue.types[a], &catalogue.types[b]);
            let (plate_a, plate_b) = (plate(a), plate(b));
            let same_category = plate_a.0[..3] == plate_b.0[..3];
            ensure(
                plate_a.0[3..] != plate_b.0[3..]
                    && same_category == (one.category == other.category),
                || format!("{} and {}", one.name, other.name),
            )
        }),
    );
}

/// Constraints on the set as a whole.
fn set(report: &mut ValidationReport, CaseSet { cases, .. }: &CaseSet) {
    report.push(
        "all ten types have equally many cases, or the first ones one more",
        TaskType::ALL.into_iter().map(|task_type| {
            let number = task_type.number();
            let found = cases.iter().filter(|case| case.task.task_type() == task_type).count();
            let due = (cases.len() + 10 - usize::from(number)) / 10;
            equal(&format!("cases of type {number}"), found, due)
        }),
    );

    let sorted = cases.iter().enumerate().map(|(index, case)| {
        let before = index.checked_sub(1).map(|before| &cases[before]);
        ensure(before.is_none_or(|before| before.id < case.id), || {
            format!("{} comes after {}", case.id, before.map_or("", |before| &before.id))
        })
    });
    report.push("case ids differ and are sorted", sorted);

    let distinct = cases.iter().enumerate().map(|(index, case)| {
        let same =
            |other: &&Case| other.task == case.task && other.original.start == case.original.start;
        match cases[..index].iter().find(same) {
            Some(other) => Err(format!("{} repeats {}", case.id, other.id)),
            None => Ok(()),
        }
    });
    report.push("no two cases share task and start", distinct);
}

/// A case with its six trajectories replayed.
struct Replayed<'a> {
    case: &'a Case,
    targets: Vec<&'a Item>,
    replays: Vec<(TrajectoryKind, Replay)>,
}

impl<'a> Replayed<'a> {
    fn new(warehouse: &'a Warehouse, case: &'a Case) -> Self {
        let replays = TrajectoryKind::ALL
            .into_iter()
            .map(|start| (start, case.replay(warehouse, start)))
            .collect();
        Self { case, targets: case.task.targets(warehouse), replays }
    }

    fn replay(&self, start: TrajectoryKind) -> &Replay {
        &self.replays[start as usize].1
    }

    fn edges(&self, start: TrajectoryKind) -> Vec<FloorEdge> {
        edges(&self.replay(start).poses)
    }

    fn start(&self, start: TrajectoryKind) -> domain::Pose {
        self.case.trajectory(start).start
    }

    /// A violation by one of the case's trajectories.
    fn at(&self, start: TrajectoryKind, violation: impl fmt::Display) -> String {
        format!("{} {}: {violation}", self.case.id, start.name())
    }
}

/// Constraints on all six trajectories of a case.
fn trajectories(report: &mut ValidationReport, warehouse: &Warehouse, cases: &[Replayed<'_>]) {
    let all =
        || cases.iter().flat_map(|c| c.replays.iter().map(move |(s, replay)| (c, *s, replay)));

    report.push(
        "every trajectory completes its task within 200 steps, none blocked",
        all().map(|(c, start, replay)| {
            completes_task(replay).map(drop).map_err(|problem| c.at(start, problem))
        }),
    );
    report.push(
        "every trajectory faces each target when it reaches it",
        all().map(|(c, start, replay)| {
            faces_targets(warehouse, &c.case.task, replay).map_err(|problem| c.at(start, problem))
        }),
    );
    let unchanged = Planner::new(warehouse, Variant::UNCHANGED, Prices::STEPS);
    report.push(
        "every trajectory takes at most 150 % of its task's fewest steps",
        all().map(|(c, start, replay)| {
            let (from, task) = (c.start(start), &c.case.task);
            let fewest = match start {
                TrajectoryKind::Blocked => {
                    Planner::new(warehouse, c.case.variant(start), Prices::STEPS).cost(from, task)
                }
                _ => unchanged.cost(from, task),
            };
            let near = replay.length.zip(fewest).is_some_and(|(l, f)| is_near_optimal(l, f));
            ensure(near, || {
                let (taken, fewest) = (steps_text(replay.length), steps_text(fewest));
                c.at(start, format!("{taken} steps where {fewest} are enough"))
            })
        }),
    );
    report.push(
        "no trajectory starts in front of a target",
        all().map(|(c, start, _)| match target_on(&[c.start(start).cell], &c.targets) {
            Some(item) => Err(c.at(start, format!("starts in front of item {}", item.id))),
            None => Ok(()),
        }),
    );
}

/// Constraints on the demonstrations.
fn demonstrations(report: &mut ValidationReport, warehouse: &Warehouse, cases: &[Replayed<'_>]) {
    let layout = &warehouse.layout;
    let starts = |c: &Replayed<'_>, start, is_right: &dyn Fn(Pose, Pose) -> bool| {
        let (original, other) = (c.start(TrajectoryKind::Original), c.start(start));
        ensure(is_right(original, other), || {
            c.at(start, format!("starts at {other}, the original at {original}"))
        })
    };
    report.push(
        "original: no target in the first view",
        cases.iter().map(|c| unseen(warehouse, c, TrajectoryKind::Original)),
    );
    report.push(
        "opposite: the original's cell, facing the other way",
        cases.iter().map(|c| starts(c, TrajectoryKind::Opposite, &is_opposite)),
    );
    report.push(
        "nearby: 2 to 4 cells along the same aisle, same heading",
        cases.iter().map(|c| starts(c, TrajectoryKind::Nearby, &|a, b| is_nearby(layout, a, b))),
    );
    report.push(
        "nearby: at least half of the original's edges are shared",
        cases.iter().map(|c| {
            let (original, nearby) =
                (c.edges(TrajectoryKind::Original), c.edges(TrajectoryKind::Nearby));
            ensure(shares_at_least_half(&original, &nearby), || {
                c.at(TrajectoryKind::Nearby, "shares less than half")
            })
        }),
    );
    report.push(
        "distant: 6 or more cells away, another aisle, turned by 90 degrees",
        cases.iter().map(|c| starts(c, TrajectoryKind::Distant, &|a, b| is_distant(layout, a, b))),
    );
    report.push(
        "distant: at most half of the original's edges are shared",
        cases.iter().map(|c| {
            let (original, distant) =
                (c.edges(TrajectoryKind::Original), c.edges(TrajectoryKind::Distant));
            ensure(shares_at_most_half(&original, &distant), || {
                c.at(TrajectoryKind::Distant, "shares more than half")
            })
        }),
    );
}

/// Constraints on the test start and its blocked variant.
fn tests(report: &mut ValidationReport, warehouse: &Warehouse, cases: &[Replayed<'_>]) {
    let layout = &warehouse.layout;
    report.push(
        "test: starts at another pose than the four demonstrations",
        cases.iter().map(|c| {
            let test = c.start(TrajectoryKind::Test);
            let same =
                TrajectoryKind::DEMONSTRATIONS.into_iter().find(|&start| c.start(start) == test);
            ensure(same.is_none(), || {
                c.at(
                    TrajectoryKind::Test,
                    format!("starts like {}", same.map_or("", TrajectoryKind::name)),
                )
            })
        }),
    );
    report.push(
        "test: no target in the first view",
        cases.iter().map(|c| unseen(warehouse, c, TrajectoryKind::Test)),
    );
    report.push(
        "test: 75 to 135 % as long as the original demonstration",
        cases.iter().map(|c| {
            let lengths =
                (c.replay(TrajectoryKind::Original).length, c.replay(TrajectoryKind::Test).length);
            let similar = lengths.0.zip(lengths.1).is_some_and(|(o, t)| is_of_similar_length(o, t));
            ensure(similar, || {
                c.at(
                    TrajectoryKind::Test,
                    format!(
                        "{} steps, the original {}",
                        steps_text(lengths.1),
                        steps_text(lengths.0)
                    ),
                )
            })
        }),
    );
    report.push(
        "blocked: starts where the test starts",
        cases.iter().map(|c| {
            equal(
                &c.at(TrajectoryKind::Blocked, "start"),
                c.start(TrajectoryKind::Blocked),
                c.start(TrajectoryKind::Test),
            )
        }),
    );
    let passages = layout.passages();
    report.push(
        "blocked: a passage is closed across its full width",
        cases.iter().map(|c| {
            let closed = &c.case.barricade;
            ensure(passages.contains(closed), || {
                c.at(TrajectoryKind::Blocked, format!("{} is not a passage", list(closed)))
            })
        }),
    );
    report.push(
        "blocked: the test reference and a demonstration use that passage",
        cases.iter().map(|c| {
            let used = |start| enters(&c.replay(start).poses, &c.case.barricade);
            ensure(
                used(TrajectoryKind::Test) && TrajectoryKind::DEMONSTRATIONS.into_iter().any(used),
                || {
                    c.at(
                        TrajectoryKind::Blocked,
                        format!("{} is not used by both", list(&c.case.barricade)),
                    )
                },
            )
        }),
    );
    report.push(
        "blocked: neither the start nor a target's standpoint is closed",
        cases.iter().map(|c| {
            let closed = &c.case.barricade;
            let start = c.start(TrajectoryKind::Blocked).cell;
            ensure(!closed.contains(&start) && target_on(closed, &c.targets).is_none(), || {
                c.at(TrajectoryKind::Blocked, format!("{} closes one", list(closed)))
            })
        }),
    );
    report.push(
        "blocked: another route leads to every target",
        cases.iter().map(|c| {
            let reached =
                layout.reachable(c.start(TrajectoryKind::Blocked).cell, &c.case.barricade);
            let cut_off =
                c.targets.iter().find(|item| reached.binary_search(&item.standpoint).is_err());
            ensure(cut_off.is_none(), || {
                c.at(
                    TrajectoryKind::Blocked,
                    format!("item {} is cut off", cut_off.map_or(0, |item| item.id)),
                )
            })
        }),
    );
}

fn unseen(warehouse: &Warehouse, c: &Replayed<'_>, start: TrajectoryKind) -> Result<(), String> {
    match target_in_view(warehouse, c.start(start), &c.targets) {
        Some(item) => {
            Err(c.at(start, format!("item {} is in view from {}", item.id, c.start(start))))
        }
        None => Ok(()),
    }
}

fn regeneration(report: &mut ValidationReport, warehouse: &Warehouse, cases: &CaseSet) {
    let count = cases.cases.len();
    let results = match CaseSet::generate(warehouse, cases.seed, count) {
        Ok(again) => cases
            .cases
            .iter()
            .zip(again.cases)
            .map(|(case, again)| {
                ensure(*case == again, || {
                    format!("{} differs from what seed {} gives", case.id, cases.seed)
                })
            })
            .collect(),
        Err(error) => vec![Err(error.to_string())],
    };
    report.push("the cases are regenerated from their seed, bit for bit", results);
}

fn list(cells: &[Cell]) -> String {
    cells.iter().map(Cell::to_string).collect::<Vec<_>>().join(" ")
}

fn steps_text(steps: Option<u32>) -> String {
    steps.map_or_else(|| "no".into(), |steps| steps.to_string())
}

#[cfg(test)]
mod tests;
