//! What a document says: where things stand, what is floor, and routes that were walked.
//!
//! Read line by line and without trust. A line counts for what can be found in it: cells written `(column,
//! row)`, stretches of columns and rows, label plates, names. The extractive builder's lines are read
//! exactly; of a model's free text, whatever line names a thing and gives a cell is a hint where to stand.

mod line;

use domain::{Cell, Heading};

use super::instruction::{Rank, Want};
pub(super) use line::Rect;
use line::Spelled;

/// Largest rectangle that is taken for floor, in cells.
const LARGEST_PASSAGE: usize = 1024;

/// A document, taken apart.
#[derive(Debug, Default)]
pub(super) struct Atlas {
    places: Vec<Place>,
    /// Stretches of floor.
    pub(super) passages: Vec<Rect>,
    routes: Vec<Route>,
}

/// A line that says where something is.
#[derive(Debug)]
struct Place {
    /// The line, in lower case.
    text: String,
    plates: Vec<Spelled>,
    /// Cells to stand on.
    cells: Vec<Cell>,
    /// Where to look.
    regions: Vec<Rect>,
}

/// A route that was walked for an instruction.
#[derive(Debug)]
pub(super) struct Route {
    /// In lower case.
    instruction: String,
    /// The way faced at its start.
    pub(super) facing: Option<Heading>,
    /// Its start and where it bends, up to its end.
    pub(super) corners: Vec<Cell>,
}

impl Atlas {
    /// What `text` says.
    pub(super) fn parse(text: &str) -> Self {
        let mut atlas = Self::default();
        let mut is_about_floor = false;
        for line in text.lines() {
            let line = line.to_lowercase();
            if line.starts_with('#') {
                is_about_floor = speaks_of_floor(&line);
                continue;
            }
            atlas.read(line, is_about_floor);
        }
        atlas
    }

    fn read(&mut self, line: String, is_about_floor: bool) {
        if let Some(route) = self.read_route(&line) {
            self.routes.push(route);
            return;
        }
        let cells = line::cells(&line);
        let rects = line::rects(&line);
        if cells.is_empty() && rects.is_empty() {
            return;
        }
        if cells.is_empty() && (is_about_floor || speaks_of_floor(&line)) {
            let is_passage = |rect: &Rect| rect.cells().count() <= LARGEST_PASSAGE;
            self.passages.extend(rects.into_iter().filter(is_passage));
            return;
        }
        let is_told = line.contains("stand at ");
        let told = cells.into_iter().filter(|&(word, _)| !is_told || word == "at");
        let cells = told.map(|(_, cell)| cell).collect();
        self.places.push(Place { plates: line::plates(&line), cells, regions: rects, text: line });
    }

    /// `"Find a blue barrel." from (14, 11) facing S: south 3 to (14, 8); reached blue barrel at (14, 8).`
    fn read_route(&mut self, line: &str) -> Option<Route> {
        let (_, quoted) = line.split_once('"')?;
        let (instruction, walk) = quoted.split_once('"')?;
        let walk = walk.trim_start().strip_prefix("from ")?;
        for reached in walk.split("reached ").skip(1) {
            let Some(&(_, cell)) = line::cells(reached).first() else { continue };
            let text = reached.split('(').next().unwrap_or_default().to_owned();
            let plates = line::plates(&text);
            self.places.push(Place { text, plates, cells: vec![cell], regions: Vec::new() });
        }
        let facing = walk.split("facing ").nth(1).and_then(|word| {
            let is_first =
                |heading: &Heading| word.starts_with(heading.letter().to_ascii_lowercase());
            Heading::ALL.into_iter().find(is_first)
        });
        let mut corners: Vec<Cell> = line::cells(walk).into_iter().map(|(_, cell)| cell).collect();
        corners.dedup();
        (!corners.is_empty()).then(|| Route {
            instruction: instruction.to_owned(),
            facing,
            corners,
        })
    }

    /// Cells to stand on to reach what is wanted.
    pub(super) fn standpoints<'a>(&'a self, want: Want<'a>) -> impl Iterator<Item = Cell> + 'a {
        self.about(want).flat_map(|place| place.cells.iter().copied())
    }

    /// Where to look for what is wanted.
    pub(super) fn regions<'a>(&'a self, want: Want<'a>) -> impl Iterator<Item = Rect> + 'a {
        self.about(want).flat_map(|place| place.regions.iter().copied())
    }

    /// Routes that were walked for `instruction`.
    pub(super) fn routes(&self, instruction: &str) -> impl Iterator<Item = &Route> {
        let instruction = instruction.to_lowercase();
        self.routes.iter().filter(move |route| route.instruction == instruction)
    }

    /// Cells that somebody walked over.
    pub(super) fn walked(&self) -> impl Iterator<Item = Cell> {
        self.routes.iter().flat_map(Route::cells)
    }

    fn about<'a>(&'a self, want: Want<'a>) -> impl Iterator<Item = &'a Place> {
        let name = want.name.to_lowercase();
        self.places.iter().filter(move |place| place.is_about(want, &name))
    }
}

impl Place {
    /// Plates decide where they are told, names elsewhere.
    fn is_about(&self, want: Want<'_>, name: &str) -> bool {
        let spells = |plate: &Spelled| match want.rank {
            Rank::Type => plate.item_type.map(|code| code == want.code),
            Rank::Category => Some(plate.category == want.code),
        };
        let mut spelled = self.plates.iter().filter_map(spells).peekable();
        match spelled.peek() {
            Some(_) => spelled.any(|is_it| is_it),
            None => names(&self.text, name),
        }
    }
}

impl Route {
    /// The cells from corner to corner, as far as they lie in straight lines.
    pub(super) fn cells(&self) -> Vec<Cell> {
        let mut cells: Vec<Cell> = self.corners.first().copied().into_iter().collect();
        for leg in self.corners.windows(2) {
            let (from, to) = (leg[0], leg[1]);
            let Some(heading) = straight(from, to) else { break };
            let steps = std::iter::successors(from.step(heading), |cell| cell.step(heading));
            cells.extend(steps.take(from.distance(to) as usize));
        }
        cells
    }
}

/// The heading that leads straight from one cell to another.
pub(super) fn straight(from: Cell, to: Cell) -> Option<Heading> {
    match (to.x.cmp(&from.x) as i8, to.y.cmp(&from.y) as i8) {
        (0, 1) => Some(Heading::N),
        (1, 0) => Some(Heading::E),
        (0, -1) => Some(Heading::S),
        (-1, 0) => Some(Heading::W),
        _ => None,
    }
}

fn speaks_of_floor(text: &str) -> bool {
    ["passage", "corridor", "aisle", "layout", "walkable"].iter().any(|word| text.contains(word))
}

/// Whether `text` has `name` as words of its own, or a plural of it.
fn names(text: &str, name: &str) -> bool {
    let begins = |at: usize| !text[..at].ends_with(char::is_alphanumeric);
    let ends = |at: usize| {
        let after = &text[at + name.len()..];
        !after.strip_prefix('s').unwrap_or(after).starts_with(char::is_alphanumeric)
    };
    !name.is_empty() && text.match_indices(name).any(|(at, _)| begins(at) && ends(at))
}

#[cfg(test)]
mod tests;
