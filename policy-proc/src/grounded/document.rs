//! Documents: demonstrated routes, cells from which items were reached, and cells that are floor.
//!
//! Reads a summary in the grammar of `docs/documents.md`, and of a model's free text the lines that name an item and give a
//! cell, and those that give a column or row of floor.

use domain::{Action, Cell, Heading, Pose};
use plates::ItemName;

use super::geometry::{PathStep, after};
use super::instruction::NavigationGoal;

/// The longest row of the same action that is read.
const LONGEST_ROW: usize = 400;

/// A parsed document.
#[derive(Debug, Default)]
pub(super) struct ParsedDocument {
    routes: Vec<DocumentedRoute>,
    /// Lines of free text that give cells, in lower case.
    notes: Vec<(String, Vec<Cell>)>,
    /// Cells that can be walked on, sorted.
    pub(super) floor: Vec<Cell>,
}

/// A demonstrated route.
#[derive(Debug)]
struct DocumentedRoute {
    instruction: String,
    /// It ends with a step without an action.
    path: Vec<PathStep>,
    /// Sub-goals: number, of how many, and where it was completed.
    sub_goals: Vec<(usize, usize, Cell)>,
}

impl ParsedDocument {
    pub(super) fn parse(text: &str) -> Self {
        let mut document = Self::default();
        let mut instruction = None;
        for line in text.lines() {
            if line.starts_with('#') {
                instruction = line.split('"').nth(1);
            } else if !instruction.is_some_and(|of| document.parse_route(of, line)) {
                document.parse_note(line.to_lowercase());
            }
        }
        let walked = document.routes.iter().flat_map(|route| &route.path);
        document.floor.extend(walked.map(|step| step.pose.cell));
        document.floor.sort_unstable();
        document.floor.dedup();
        document
    }

    /// A line of a route, such as `- start: You are in column 3, row 12, and face north.`, then `- move forward 3, turn left`,
    /// then `- sub-goal 1 of 2: You are in ...`. Tells whether it is one.
    fn parse_route(&mut self, instruction: &str, line: &str) -> bool {
        let Some(line) = line.strip_prefix("- ") else { return false };
        let state = line.split_once(": ").and_then(|(label, state)| Some((label, pose(state)?)));
        if let Some(("start", pose)) = state {
            let path = vec![PathStep { pose, action: None }];
            let instruction = instruction.to_owned();
            self.routes.push(DocumentedRoute { instruction, path, sub_goals: Vec::new() });
            return true;
        }
        let route = self.routes.last_mut().filter(|route| route.instruction == instruction);
        let Some(route) = route else { return false };
        if let Some((label, pose)) = state {
            let numbers = label.strip_prefix("sub-goal ").and_then(|of| of.split_once(" of "));
            if let Some((Ok(number), Ok(total))) = numbers.map(|(a, b)| (a.parse(), b.parse())) {
                route.sub_goals.push((number, total, pose.cell));
            }
            return true;
        }
        let rows: Option<Vec<_>> = line.split(", ").map(actions_in_a_row).collect();
        let Some(rows) = rows else { return false };
        for action in
            rows.into_iter().flat_map(|(action, times)| std::iter::repeat_n(action, times))
        {
            let Some(last) = route.path.last_mut() else { break };
            let Some(pose) = after(last.pose, action) else { break };
            last.action = Some(action);
            route.path.push(PathStep { pose, action: None });
        }
        true
    }

    fn parse_note(&mut self, line: String) {
        let stretches = stretches(&line);
        let (cells, floor): (Vec<_>, Vec<_>) = stretches.into_iter().partition(|of| of.len() == 1);
        self.floor.extend(floor.into_iter().flatten());
        let mut cells = cells.concat();
        cells.extend(pairs(&line));
        if !cells.is_empty() {
            self.notes.push((line, cells));
        }
    }

    /// Cells from which items of the target kind can be reached.
    pub(super) fn standpoints(&self, target: ItemName<'_>) -> Vec<Cell> {
        let (ItemName::Type(name) | ItemName::Category(name)) = target;
        let name = name.to_lowercase();
        let noted = self.notes.iter().filter(|(line, _)| line.contains(&name));
        let reached = self.routes.iter().flat_map(|route| route.reached(target));
        noted.flat_map(|(_, cells)| cells.iter().copied()).chain(reached).collect()
    }

    /// Routes that were demonstrated for exactly this instruction.
    pub(super) fn routes(&self, instruction: &str) -> impl Iterator<Item = Vec<PathStep>> {
        let routes = self.routes.iter();
        let routes =
            routes.filter(move |route| route.instruction.eq_ignore_ascii_case(instruction));
        routes.map(|route| route.path.clone())
    }
}

impl DocumentedRoute {
    /// Where sub-goals were completed that may have been visits to an item of this kind.
    fn reached(&self, target: ItemName<'_>) -> Vec<Cell> {
        let Some(goal) = NavigationGoal::read(&self.instruction) else { return Vec::new() };
        let sub_goals = self.sub_goals.iter();
        let visits = sub_goals
            .filter(|(number, total, _)| goal.completed_at(*number, *total).contains(&target));
        visits.map(|(.., cell)| *cell).collect()
    }
}

/// `move forward 3`; `move forward ("Something blocks the way: you did not move.")` led nowhere.
fn actions_in_a_row(text: &str) -> Option<(Action, usize)> {
    let (words, is_vain) = match text.split_once(" (") {
        Some((words, _)) => (words, true),
        None => (text, false),
    };
    let counted = words.rsplit_once(' ').and_then(|(words, n)| Some((words, n.parse().ok()?)));
    let (words, times) = counted.unwrap_or((words, 1));
    let action = Action::ALL.into_iter().find(|action| action.words() == words)?;
    Some((action, if is_vain { 0 } else { LONGEST_ROW.min(times) }))
}

/// The pose in a sentence such as `You are in column 3, row 12, and face north.`
fn pose(sentence: &str) -> Option<Pose> {
    let cell = *stretches(sentence).first()?.first()?;
    let heading = words(sentence)
        .find_map(|word| Heading::ALL.into_iter().find(|heading| heading.word() == word))?;
    Some(Pose { cell, heading })
}

/// Cells written as `(column, row)`.
fn pairs(line: &str) -> impl Iterator<Item = Cell> {
    line.split('(').skip(1).filter_map(|text| {
        let (x, y) = text.split_once(')')?.0.split_once(',')?;
        Some(Cell::new(x.trim().parse().ok()?, y.trim().parse().ok()?))
    })
}

/// Cells written as a column with rows or a row with columns: `column 3: rows 1-14`, `row 15 (columns 0-15)`, `column 3, row
/// 12`.
fn stretches(line: &str) -> Vec<Vec<Cell>> {
    let (mut columns, mut rows, mut stretches) = (None, None, Vec::new());
    for (word, next) in words(line).zip(words(line).skip(1)) {
        match word {
            "column" | "columns" => columns = range(next),
            "row" | "rows" => rows = range(next),
            _ => continue,
        }
        if let (Some((west, east)), Some((south, north))) = (columns, rows) {
            if west == east || south == north {
                let column = |x| (south..=north).map(move |y| Cell::new(x, y));
                stretches.push((west..=east).flat_map(column).collect());
            }
            (columns, rows) = (None, None);
        }
    }
    stretches
}

fn words(line: &str) -> impl Iterator<Item = &str> {
    let words = line.split(|c: char| !c.is_ascii_alphanumeric() && c != '-');
    words.filter(|word| !word.is_empty())
}

/// `7` or `3-14`.
fn range(word: &str) -> Option<(u8, u8)> {
    let (from, to) = word.split_once('-').unwrap_or((word, word));
    let (from, to) = (from.parse().ok()?, to.parse().ok()?);
    Some((u8::min(from, to), u8::max(from, to)))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SUMMARY: &str = r#"# Summary of the demonstrations
A number after an action says how often in a row it was taken.

## "Visit a blue barrel, then an orange cone, then return to the cell where you started."
- start: You are in column 14, row 11, and face south.
- move forward 3, turn right, move forward, move forward ("Something blocks the way: you did not move."), move left 2
- sub-goal 1 of 3: You are in column 13, row 6, and face west.
- move backward
- sub-goal 2 of 3: You are in column 14, row 6, and face west.
- move right 5
- sub-goal 3 of 3: You are in column 14, row 11, and face west.
- start: You are in column 14, row 6, and face west.
- move forward
- sub-goal 1 of 3: You are in column 13, row 6, and face west.

## "Visit a blue barrel and a red crate, in any order."
- start: You are in column 1, row 1, and face north.
- move forward
- sub-goal 1 of 2: You are in column 1, row 2, and face north.

## "Find a green cone."
- start: You are in column 5, row 1, and face north.
- move forward 2
- end: You are in column 5, row 3, and face north.
"#;

    fn standpoints(text: &str, instruction: &str) -> Vec<(u8, u8)> {
        let goal = NavigationGoal::read(instruction).unwrap();
        let cells = ParsedDocument::parse(text).standpoints(goal.targets[0]);
        cells.into_iter().map(|cell| (cell.x, cell.y)).collect()
    }

    #[test]
    fn items_were_reached_where_sub_goals_were_completed() {
        // In any order: it may have been the barrel or the crate.
        assert_eq!(standpoints(SUMMARY, "Find a blue barrel."), [(13, 6), (13, 6), (1, 2)]);
        assert_eq!(standpoints(SUMMARY, "Find a red crate."), [(1, 2)]);
        assert_eq!(standpoints(SUMMARY, "Find an orange cone."), [(14, 6)]);
        assert_eq!(standpoints(SUMMARY, "Find a red barrel."), []);
    }

    #[test]
    fn routes_have_the_demonstrated_actions_and_are_floor() {
        let document = ParsedDocument::parse(SUMMARY);
        let instruction =
            "Visit a blue barrel, then an orange cone, then return to the cell where you started.";
        let routes: Vec<_> = document.routes(instruction).collect();
        let letters = |path: &[PathStep]| -> String {
            path.iter().filter_map(|step| step.action).map(Action::letter).collect()
        };
        assert_eq!(
            routes.iter().map(|path| letters(path)).collect::<Vec<_>>(),
            ["fffRfllbrrrrr", "f"]
        );
        let ends = [Pose::new(14, 11, Heading::W), Pose::new(13, 6, Heading::W)];
        for (path, end) in routes.iter().zip(ends) {
            assert_eq!(path.last(), Some(&PathStep { pose: end, action: None }));
        }
        let to_the_cone = document.routes("Find a green cone.").map(|path| letters(&path));
        assert_eq!(to_the_cone.collect::<Vec<_>>(), ["ff"]);
        assert_eq!(document.routes("Find a red barrel.").count(), 0);
        assert_eq!(document.floor.len(), 6 + 3 + 2 + 3, "of columns 14, 13, 1 and 5");
    }

    #[test]
    fn in_free_text_a_line_with_a_name_and_a_cell_is_a_place() {
        let text = "I saw two Blue Barrels, at (3, 7) and in column 3, row 9.\n\
                    A blue cone: (1, 1). Cones stand at (9, 9).";
        let mut found = standpoints(text, "Find a blue barrel.");
        found.sort_unstable();
        assert_eq!(found, [(3, 7), (3, 9)]);
    }

    #[test]
    fn in_free_text_columns_and_rows_are_floor() {
        for (line, expected) in [
            ("- column 3: rows 1-14", 14),
            ("- row 15: columns 0-15", 16),
            ("- corridors: column 3 (rows 1-14), column 6 (rows 2-13)", 14 + 12),
            ("barrels: columns 2-5, rows 6-9; seen", 0),
            ("change corridors in an aisle: rows 0, 15, 29.", 0),
            ("columns 2-5 hold 12 things; rows 999", 0),
        ] {
            assert_eq!(ParsedDocument::parse(line).floor.len(), expected, "{line}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_parsed(text: String, template in 0..6_usize) {
            let templates = [
                "{}",
                "- blue barrel: stand at ({}, {})",
                "## \"Find a {}.\"\n- start: You are in column 0, row {}, and face north.\n- {}",
                "## \"Find a {}.\"\n- start: column 0, row 255, north\n- move left 99999, {}\n- \
                 sub-goal {} of 2: column 3, row 3, north",
                "## Layout {}\ncolumn {}: rows {}-{}",
                "(1, 2) {} (255, 256) columns 0-255 rows 0-255 {}",
            ];
            let text = templates[template].replace("{}", &text);
            let document = ParsedDocument::parse(&text);
            let instruction = "Visit a blue barrel and an orange cone, in any order.";
            for target in NavigationGoal::read(instruction).unwrap().targets {
                let _ = document.standpoints(target);
            }
            let _ = document.routes(&text).count();
        }
    }
}
