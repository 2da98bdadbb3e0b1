//! Each violation is reported for the constraint that it breaks.

use domain::{Action, Heading, Pose};

use super::*;
use crate::catalogue::Shape;

/// The result for the constraint that begins with these words.
fn line<'r>(report: &'r ValidationReport, constraint: &str) -> &'r ConstraintResult {
    let mut lines = report.lines.iter().filter(|line| line.constraint.starts_with(constraint));
    let line = lines.next().unwrap_or_else(|| panic!("no line begins with {constraint:?}"));
    assert!(lines.next().is_none(), "two lines begin with {constraint:?}");
    line
}

/// Asserts that `report` finds the constraint broken that corruption number `row` breaks.
fn assert_broken(report: &ValidationReport, constraint: &str, row: usize) {
    assert!(!report.is_clean(), "corruption {row}");
    assert!(!line(report, constraint).violations.is_empty(), "corruption {row}\n{report}");
}

#[test]
fn a_corrupted_case_breaks_the_line_about_it() {
    let warehouse = Warehouse::shipped();
    let shipped = CaseSet::shipped();
    type Corruption = fn(&mut Case, &Case);
    let table: [(Corruption, &str); 22] = [
        (|case, _| _ = case.original.actions.remove(1), "every trajectory completes its task"),
        (
            |case, _| case.test.actions.splice(0..0, into_solid(case)).for_each(drop),
            "every trajectory completes its task",
        ),
        (|case, _| case.blocked.actions.truncate(3), "every trajectory completes its task"),
        (
            |case, _| case.nearby.actions.extend([Action::TurnLeft; 3]),
            "every trajectory completes its task",
        ),
        (
            |case, _| case.distant.actions.splice(0..0, [Action::TurnLeft; 40]).for_each(drop),
            "every trajectory takes at most 150 %",
        ),
        (|case, _| remove_last_turn(case), "every trajectory faces each target"),
        (|case, other| case.task = other.task, "every trajectory completes its task"),
        (|case, _| case.distant.start = at_target(case), "no trajectory starts in front"),
        (|case, _| case.original.start = at_target(case), "original: no target in the first view"),
        (|case, _| case.opposite.start = case.original.start, "opposite: the original's cell"),
        (|case, other| case.nearby = other.distant.clone(), "nearby: 2 to 4 cells"),
        (
            |case, _| case.nearby.start.heading = case.nearby.start.heading.left(),
            "nearby: 2 to 4 cells",
        ),
        (
            |case, other| case.nearby.actions = other.distant.actions.clone(),
            "nearby: at least half",
        ),
        (|case, _| case.distant = case.nearby.clone(), "distant: 6 or more cells"),
        (|case, _| case.distant = case.original.clone(), "distant: at most half"),
        (|case, _| case.test = case.distant.clone(), "test: starts at another pose"),
        (|case, _| case.test.start = at_target(case), "test: no target in the first view"),
        (
            |case, _| case.test.actions.splice(0..0, [Action::TurnAround; 60]).for_each(drop),
            "test: 75 to 135 %",
        ),
        (
            |case, _| case.blocked.start = case.original.start,
            "blocked: starts where the test starts",
        ),
        (|case, _| _ = case.barricade.pop(), "blocked: a passage is closed"),
        (
            |case, _| case.barricade = vec![Cell::new(15, 27), Cell::new(15, 28)],
            "blocked: the test reference and",
        ),
        (|case, _| case.barricade = vec![case.test.start.cell], "blocked: neither the start nor"),
    ];
    for index in [8, 54] {
        let (case, other) = (&shipped.cases[index], &shipped.cases[(index + 30) % 100]);
        let set = |case: &Case| CaseSet { seed: 1, cases: vec![case.clone()], elsewhere: None };
        let before = check(&warehouse, &set(case));
        for (row, (corrupt, constraint)) in table.iter().enumerate() {
            let mut corrupted = case.clone();
            corrupt(&mut corrupted, other);
            assert_ne!(corrupted, *case, "corruption {row} changes nothing");
            assert_eq!(line(&before, constraint).violations, [""; 0]);
            assert_broken(&check(&warehouse, &set(&corrupted)), constraint, row);
        }
    }
}

/// Leaves out the turn towards the last target, in a trajectory that ends with one.
fn remove_last_turn(case: &mut Case) {
    let all = [
        &mut case.original,
        &mut case.opposite,
        &mut case.nearby,
        &mut case.distant,
        &mut case.test,
        &mut case.blocked,
    ];
    let is_turn = |action: &Action| action.turn_quarters().is_some();
    let found = all.into_iter().find(|trajectory| trajectory.actions.last().is_some_and(is_turn));
    found.unwrap().actions.pop();
}

/// Steps into what is beside the test start. Aisles are two cells wide, so something is.
fn into_solid(case: &Case) -> Vec<Action> {
    let layout = Warehouse::shipped().layout;
    let Pose { cell, heading } = case.test.start;
    let moves = [Action::Forward, Action::Right, Action::Backward, Action::Left];
    let blocked = |action: &Action| {
        let direction = heading.turned(action.move_direction().unwrap());
        layout.free_neighbour(cell, direction).is_none()
    };
    moves.into_iter().filter(blocked).collect()
}

/// The pose that faces the case's first target.
fn at_target(case: &Case) -> Pose {
    let warehouse = Warehouse::shipped();
    let item = case.task.targets(&warehouse)[0];
    Pose { cell: item.standpoint, heading: item.viewing_heading() }
}

#[test]
fn a_corrupted_set_breaks_the_line_about_it() {
    let warehouse = Warehouse::shipped();
    let shipped = CaseSet::shipped();
    type Corruption = fn(&mut CaseSet);
    let table: [(Corruption, &str); 5] = [
        (|set| drop(set.cases.remove(40)), "all ten types"),
        (|set| set.cases.swap(3, 4), "case ids differ"),
        (|set| set.cases[4].id = set.cases[3].id.clone(), "case ids differ"),
        (
            |set| {
                let id = std::mem::take(&mut set.cases[4].id);
                set.cases[4] = Case { id, ..set.cases[3].clone() };
            },
            "no two cases share",
        ),
        (|set| set.cases.clear(), "case ids differ"),
    ];
    for (row, (corrupt, constraint)) in table.into_iter().enumerate() {
        let mut cases = shipped.clone();
        corrupt(&mut cases);
        let report = check(&warehouse, &cases);
        if cases.cases.is_empty() {
            assert!(!report.is_clean() && line(&report, constraint).checked == 0);
        } else {
            assert_broken(&report, constraint, row);
        }
    }
}

#[test]
fn cases_that_their_seed_does_not_give_are_found() {
    let warehouse = Warehouse::shipped();
    let mut cases = CaseSet::generate(&warehouse, 3, 40).unwrap();
    assert!(validate(&warehouse, &cases).is_clean());
    cases.seed = 10;
    assert_broken(&validate(&warehouse, &cases), "the cases are regenerated", 0);
    cases.seed = 3;
    cases.cases[2].distant.actions.push(Action::TurnLeft);
    assert_broken(&validate(&warehouse, &cases), "the cases are regenerated", 1);
}

#[test]
fn a_corrupted_item_breaks_the_line_about_it() {
    let shipped = Warehouse::shipped();
    let none = CaseSet { seed: 0, cases: Vec::new(), elsewhere: None };
    type Corruption = fn(&mut Warehouse);
    let table: [(Corruption, &str); 8] = [
        (|w| w.items.clear(), "at least two categories"),
        (|w| w.catalogue.categories.truncate(1), "at least two categories"),
        (|w| w.items[5].standpoint = w.items[6].standpoint, "every item stands on a rack face"),
        (|w| w.items[5].face = Heading::W, "every item stands on a rack face"),
        (|w| w.items[5].id = 6, "every item stands on a rack face"),
        (
            |w| {
                let cone = w
                    .items
                    .iter()
                    .position(|item| w.catalogue.types[item.item_type].shape == Shape::Cone);
                w.items[cone.unwrap()].item_type = 0;
            },
            "items of a category stand in neighbouring bays",
        ),
        (
            |w| w.catalogue.types[1].name = w.catalogue.types[0].name.clone(),
            "any two types and any two categories",
        ),
        (
            |w| w.catalogue.categories[1].name = "barrels".into(),
            "any two types and any two categories",
        ),
    ];
    for (row, (corrupt, constraint)) in table.into_iter().enumerate() {
        let mut warehouse = shipped.clone();
        corrupt(&mut warehouse);
        let mut report = ValidationReport { lines: Vec::new(), mixtures: Vec::new() };
        if warehouse.catalogue.categories.len() == 1 {
            warehouse.catalogue.types.truncate(3);
            warehouse.items.retain(|item| item.item_type < 3);
        }
        items(&mut report, &warehouse);
        set(&mut report, &none);
        assert_broken(&report, constraint, row);
    }
}

#[test]
fn a_corrupted_floor_breaks_the_line_about_it() {
    let text = include_str!("../../../../assets/layout.toml");
    let first = text.lines().position(|line| line.starts_with("plan")).unwrap() + 1;
    // The text with some rows, counted from the south, replaced or left out.
    let change = |rows: &[(usize, Option<&'static str>)]| {
        let lines = text.lines().enumerate().filter_map(|(at, line)| {
            let row = rows.iter().find(|(row, _)| first + 29 - row == at);
            row.map_or(Some(line), |(_, to)| *to)
        });
        lines.collect::<Vec<_>>().join("\n")
    };
    let one_way = [(15, Some("######xx########")), (14, Some("##xxxxxx########"))];
    let crossing = text.replace("north-south", "east-west");
    let layouts = [
        (crossing, "at least two aisles run"),
        (change(&one_way), "two routes join any two aisles"),
    ];
    for (row, (layout, constraint)) in layouts.into_iter().enumerate() {
        let layout = Layout::parse(&layout).unwrap();
        let mut report = ValidationReport { lines: Vec::new(), mixtures: Vec::new() };
        floor(&mut report, &layout);
        assert_broken(&report, constraint, row);
    }
}

#[test]
fn a_report_prints_a_line_for_each_constraint_and_the_first_violations() {
    let line = |constraint, checked, violations: &[&str]| ConstraintResult {
        constraint,
        checked,
        violations: violations.iter().map(|v| (*v).to_owned()).collect(),
    };
    let report = ValidationReport {
        lines: vec![
            line("good things are good", 100, &[]),
            line("bad things are few", 7, &["one", "two", "three", "four", "five"]),
            line("something is there", 0, &[]),
        ],
        mixtures: Vec::new(),
    };
    assert!(!report.is_clean());
    assert_eq!(report.violations(), 5);
    insta::assert_snapshot!(report, @"
    ok     100 checked    0 violated  good things are good
    FAIL     7 checked    5 violated  bad things are few
               one
               two
               three
               and 2 more
    FAIL     0 checked    0 violated  something is there
    ");
}
