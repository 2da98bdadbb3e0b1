//! Draws a warehouse from a seed: the floor plan and what stands on its racks, as the texts of `layout.toml` and
//! `catalogue.toml`.
//!
//! The plan follows the rules of the shipped one: banks of racks with parallel corridors, a cross-aisle between any two banks,
//! an aisle along the south and the north end, and a rack behind each of these. Every aisle is [`AISLE`] cells wide. The
//! categories are those of the shipped catalogue, or some of them; which one stands where is drawn.

use std::fmt::Write as _;
use std::ops::RangeInclusive;

use domain::{Cell, Heading};

use crate::draw::Draw;
use crate::generate::GenerateError;
use crate::layout::{Layout, MAX_SIDE, Square};
use crate::world::{
    CATALOGUE_FILE, LAYOUT_FILE, MAX_CATEGORY, SHIPPED_CATALOGUE, SHIPPED_LAYOUT, Warehouse,
    are_neighbours, groups,
};

/// Smallest side of a generated warehouse, in cells.
pub const MIN_SIDE: usize = 12;

/// Width of every aisle, in cells.
const AISLE: usize = 2;

/// Depth that banks of racks aim at, in cells along their corridors.
const BANK_DEPTHS: [usize; 5] = [8, 9, 10, 11, 12];

/// Number of bays for each category, unless all categories are used.
const BAYS_PER_CATEGORY: usize = 11;

/// Types of a category that may be missing from no stock, and their least number of items.
const LEAST_OF_TYPE: usize = 2;

/// How much farther along the rack a category goes before it takes a bay of another face, in cells.
const TURNED_CELLS: u32 = 8;

/// The streams of the seed. Cases draw from streams with a task type in the upper half, so these are apart.
const LAYOUT_STREAM: u64 = 1 << 56;
const STOCK_STREAM: u64 = 2 << 56;

/// A warehouse drawn from a seed, and the two texts that it is read from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GeneratedWorld {
    /// The text of `layout.toml`.
    pub layout: String,
    /// The text of `catalogue.toml`.
    pub catalogue: String,
    /// What the texts say.
    pub warehouse: Warehouse,
}

/// The numbers of corridors that a bank of a warehouse `width` cells wide can have.
pub fn corridors(width: usize) -> RangeInclusive<usize> {
    // Two rack columns between corridors, one at a side: `most * AISLE + 2 * (most - 1) + 1 <= width`.
    width.div_ceil(12).max(2)..=(width + 1) / (AISLE + 2)
}

impl GeneratedWorld {
    /// Draws a warehouse of `width` columns and `height` rows with `corridors` corridors in each bank, or a number that suits
    /// the width.
    ///
    /// # Errors
    /// A side outside [`MIN_SIDE`] to [`MAX_SIDE`], or more or fewer corridors than [`corridors`] allows.
    pub fn generate(
        seed: u64,
        width: usize,
        height: usize,
        corridors: Option<usize>,
    ) -> Result<Self, GenerateError> {
        Self::stocked(seed, [width, height], corridors, None)
    }

    /// Draws a warehouse of the size of `other`, with its categories.
    ///
    /// # Errors
    /// A side that is too short or too long, or a category that the shipped warehouse has not.
    pub(crate) fn like(other: &Warehouse, seed: u64) -> Result<Self, GenerateError> {
        let size = [other.layout.width(), other.layout.height()].map(usize::from);
        let categories = other.catalogue.categories.iter();
        let names: Vec<&str> = categories.map(|category| category.name.as_str()).collect();
        Self::stocked(seed, size, None, Some(&names))
    }

    /// Draws a warehouse with these categories, or with some.
    fn stocked(
        seed: u64,
        [width, height]: [usize; 2],
        corridors: Option<usize>,
        categories: Option<&[&str]>,
    ) -> Result<Self, GenerateError> {
        let sides = MIN_SIDE..=MAX_SIDE;
        if !sides.contains(&width) || !sides.contains(&height) {
            return Err(GenerateError(format!(
                "{width}x{height} cells; each side must be {MIN_SIDE} to {MAX_SIDE}"
            )));
        }
        let allowed = self::corridors(width);
        if let Some(asked) = corridors.filter(|asked| !allowed.contains(asked)) {
            return Err(GenerateError(format!(
                "{asked} aisles in each bank; a warehouse {width} cells wide has {} to {}",
                allowed.start(),
                allowed.end()
            )));
        }
        let layout = layout_text(&mut Draw::new(seed, LAYOUT_STREAM), width, height, corridors);
        let invalid = |problem| GenerateError(format!("{LAYOUT_FILE} of seed {seed}: {problem}"));
        let floor = Layout::parse(&layout).map_err(invalid)?;
        let catalogue = catalogue_text(&mut Draw::new(seed, STOCK_STREAM), &floor, categories)?;
        let warehouse =
            Warehouse::parse(LAYOUT_FILE.into(), &layout, CATALOGUE_FILE.into(), &catalogue)
                .map_err(|error| GenerateError(format!("seed {seed}: {error}")))?;
        Ok(Self { layout, catalogue, warehouse })
    }
}

/// An aisle as listed in the file.
struct NamedAisle {
    mark: char,
    name: String,
    runs: &'static str,
}

impl NamedAisle {
    fn crossing(mark: char, name: impl Into<String>) -> Self {
        Self { mark, name: name.into(), runs: "east-west" }
    }
}

/// The text of `layout.toml`.
fn layout_text(draw: &mut Draw, width: usize, height: usize, corridors: Option<usize>) -> String {
    let depth = draw.pick(&BANK_DEPTHS);
    // The ends take two rows of racks and two aisles.
    let banks = ((height - 2 - AISLE) / (depth + AISLE)).max(2);
    let depths = shares(draw, height - 2 - (banks + 1) * AISLE, &vec![1; banks]);
    let allowed = self::corridors(width);
    let corridors = corridors.unwrap_or_else(|| {
        let (few, many) = (width / 6, width / 5);
        (few + draw.below(many - few + 1)).clamp(*allowed.start(), *allowed.end())
    });
    // Corridors line up, or every other bank is shifted so that they do not, like in the shipped warehouse.
    let shifted = draw.below(3) > 0;
    let first = draw.below(2);
    let mut names = AisleNames::new(banks, corridors);
    let mut aisles = vec![NamedAisle::crossing('s', "South aisle")];
    let end = format!("%{}%", "#".repeat(width - 2));
    // Rows from the south.
    let mut rows = vec![end.clone()];
    rows.extend(vec!["s".repeat(width); AISLE]);
    for (bank, depth) in depths.into_iter().enumerate() {
        if bank > 0 {
            let (mark, name) = if banks == 2 {
                ('x', "Cross-aisle".to_owned())
            } else {
                (char::from(b'0' + bank as u8), format!("Cross-aisle {bank}"))
            };
            rows.extend(vec![mark.to_string().repeat(width); AISLE]);
            aisles.push(NamedAisle::crossing(mark, name));
        }
        let side = shifted.then_some((bank + first) % 2);
        let mut row = String::new();
        for (number, racks) in rack_widths(draw, width, corridors, side).into_iter().enumerate() {
            if number > 0 {
                let (mark, name) = names.next(bank, number);
                row.extend([mark; AISLE]);
                aisles.push(NamedAisle { mark, name, runs: "north-south" });
            }
            row.push_str(&"#".repeat(racks));
        }
        rows.extend(vec![row; depth]);
    }
    rows.extend(vec!["n".repeat(width); AISLE]);
    rows.push(end);
    aisles.push(NamedAisle::crossing('n', "North aisle"));

    rows.reverse();
    let mut text = format!("{}plan = \"\"\"\n{}\n\"\"\"\n", head(SHIPPED_LAYOUT), rows.join("\n"));
    for NamedAisle { mark, name, runs } in aisles {
        let _ =
            write!(text, "\n[[aisle]]\nmark = \"{mark}\"\nname = \"{name}\"\nruns = \"{runs}\"\n");
    }
    text
}

/// The widths of the racks of a bank, from the west: before the first corridor, between corridors, after the last. On `side` (0
/// west, 1 east) a corridor runs along the wall; without one there are racks on both sides.
fn rack_widths(draw: &mut Draw, width: usize, corridors: usize, side: Option<usize>) -> Vec<usize> {
    // Racks at a side are as deep as one of the two that stand back to back between corridors.
    let mut weights = vec![2; corridors + 1];
    weights[0] = usize::from(side != Some(0));
    weights[corridors] = usize::from(side != Some(1));
    let racks = width - corridors * AISLE;
    if racks < weights.iter().sum() {
        // So narrow that there is only room for racks on one side.
        weights[draw.below(2) * corridors] = 0;
    }
    shares(draw, racks, &weights)
}

/// `total` in whole parts proportional to `weights`, none less than its weight. What is left over goes to parts that are drawn.
fn shares(draw: &mut Draw, total: usize, weights: &[usize]) -> Vec<usize> {
    let sum: usize = weights.iter().sum();
    let mut parts: Vec<usize> = weights.iter().map(|weight| total / sum * weight).collect();
    let positive = (0..parts.len()).filter(|&part| weights[part] > 0).collect();
    let order = draw.shuffled(positive);
    let left = total - parts.iter().sum::<usize>();
    order.iter().cycle().take(left).for_each(|&part| parts[part] += 1);
    parts
}

/// Marks and names of corridors: `Aisle A` and on, or bank and number, `Aisle A1` and on, where the letters do not suffice.
struct AisleNames {
    marks: Box<dyn Iterator<Item = char>>,
    numbered: bool,
}

impl AisleNames {
    fn new(banks: usize, corridors: usize) -> Self {
        let taken = |mark: &char| !['n', 's', 'x'].contains(mark);
        let marks = ('A'..='Z').chain('a'..='z').filter(taken).chain('\u{c0}'..='\u{17f}');
        Self { marks: Box::new(marks), numbered: banks * corridors > 26 }
    }

    /// For corridor `number` of `bank`, counted from 1 and from 0.
    fn next(&mut self, bank: usize, number: usize) -> (char, String) {
        let mark = self.marks.next().unwrap_or('?');
        let name = if self.numbered {
            format!("Aisle {}{number}", char::from(b'A' + bank as u8))
        } else {
            format!("Aisle {mark}")
        };
        (mark, name)
    }
}

/// The text of `catalogue.toml`, with the categories of these names, or as many as there is room for.
fn catalogue_text(
    draw: &mut Draw,
    layout: &Layout,
    names: Option<&[&str]>,
) -> Result<String, GenerateError> {
    let shipped: Vec<&str> = SHIPPED_CATALOGUE.split("[[category]]").skip(1).collect();
    let bays: Vec<Bay> = layout.free_cells().filter_map(|cell| bay(layout, cell)).collect();
    let mut chosen = match names {
        None => draw.shuffled((0..shipped.len()).collect()),
        Some(names) => {
            let listed = |name: &&str| {
                let line = format!("name = {name:?}");
                shipped
                    .iter()
                    .position(|block| block.lines().any(|found| found == line))
                    .ok_or_else(|| {
                        GenerateError(format!(
                            "{name} are not among the categories that can be generated"
                        ))
                    })
            };
            let listed: Result<_, _> = names.iter().map(listed).collect();
            draw.shuffled(listed?)
        }
    };
    let room = bays.len() / BAYS_PER_CATEGORY;
    let count = if names.is_some() { chosen.len() } else { room.clamp(1, shipped.len()) };
    chosen.truncate(count);
    let mut stock: Vec<(Cell, String)> = Vec::new();
    for (category, stretch) in chosen.iter().zip(stretches(draw, &bays, count)) {
        let block = shipped[*category];
        let mark = block.split('"').nth(1).unwrap_or_default();
        let types = block.matches("colour").count();
        let least = LEAST_OF_TYPE * types;
        let goal = MAX_CATEGORY - draw.below(5);
        let cells = thinned(draw, stretch, goal);
        let mut kinds: Vec<usize> = (0..least).map(|item| item % types).collect();
        kinds.resize_with(cells.len().max(least), || draw.below(types));
        let kinds = draw.shuffled(kinds);
        stock.extend(
            cells.into_iter().zip(kinds).map(|(cell, kind)| (cell, format!("{mark}{}", kind + 1))),
        );
    }

    let row = |y: u8| {
        let tokens = (0..layout.width()).map(|x| {
            let cell = Cell::new(x, y);
            let item = stock.iter().find(|(standpoint, _)| *standpoint == cell);
            match item {
                Some((_, token)) => token.as_str(),
                None if layout.is_free(cell) => "..",
                None => "##",
            }
        });
        tokens.collect::<Vec<_>>().join(" ")
    };
    let rows: Vec<String> = (0..layout.height()).rev().map(row).collect();
    chosen.sort_unstable();
    let categories: String = chosen
        .iter()
        .map(|&category| format!("\n[[category]]{}\n", shipped[category].trim_end()))
        .collect();
    Ok(format!(
        "{}stock = \"\"\"\n{}\n\"\"\"\n{categories}",
        head(SHIPPED_CATALOGUE),
        rows.join("\n")
    ))
}

/// The comments before the first key of a shipped file.
fn head(text: &str) -> String {
    let comments = text.split_inclusive('\n').take_while(|line| !line.contains(" = "));
    comments.collect()
}

/// A place for an item.
#[derive(Clone, Copy)]
struct Bay {
    standpoint: Cell,
    /// The direction from the standpoint to the rack.
    towards: Heading,
}

/// The bay in front of `cell`, if there is one rack beside it.
fn bay(layout: &Layout, cell: Cell) -> Option<Bay> {
    let is_rack = |heading: &Heading| {
        cell.step(*heading).is_some_and(|next| layout.square(next) == Square::Rack)
    };
    let mut racks = Heading::ALL.into_iter().filter(is_rack);
    let bay = Bay { standpoint: cell, towards: racks.next()? };
    racks.next().is_none().then_some(bay)
}

/// The standpoints of a stretch of neighbouring bays for each of `count` categories. They start far apart and grow by turns,
/// each by the nearest bay to where it started, along the rack rather than across the aisle.
fn stretches(draw: &mut Draw, bays: &[Bay], count: usize) -> Vec<Vec<Cell>> {
    let mut free = draw.shuffled(bays.to_vec());
    let mut starts: Vec<Bay> = Vec::new();
    for _ in 0..count {
        let room = |bay: &Bay| starts.iter().map(|s| s.standpoint.distance(bay.standpoint)).min();
        let Some(at) = (0..free.len()).max_by_key(|&at| room(&free[at])) else { break };
        starts.push(free.remove(at));
    }
    let mut stretches: Vec<Vec<Cell>> = starts.iter().map(|bay| vec![bay.standpoint]).collect();
    let longest = (bays.len() / count).min(2 * MAX_CATEGORY);
    for _ in 1..longest {
        for (start, stretch) in starts.iter().zip(&mut stretches) {
            let is_next = |bay: &Bay| stretch.iter().any(|&at| are_neighbours(at, bay.standpoint));
            let away = |bay: &Bay| {
                let turned = if bay.towards == start.towards { 0 } else { TURNED_CELLS };
                bay.standpoint.distance(start.standpoint) + turned
            };
            let next = (0..free.len()).filter(|&at| is_next(&free[at]));
            let nearest = next.min_by_key(|&at| away(&free[at]));
            stretch.extend(nearest.map(|at| free.remove(at).standpoint));
        }
    }
    stretches
}

/// At most `count` cells of `stretch`, still all neighbours; which bays in between are left empty is drawn. Where that is not
/// enough, the stretch is made shorter.
fn thinned(draw: &mut Draw, mut stretch: Vec<Cell>, count: usize) -> Vec<Cell> {
    loop {
        let mut kept = stretch.clone();
        for cell in draw.shuffled(stretch.clone()) {
            if kept.len() <= count {
                return kept;
            }
            let rest: Vec<Cell> = kept.iter().copied().filter(|&other| other != cell).collect();
            if groups(rest.clone()).len() == 1 {
                kept = rest;
            }
        }
        stretch.pop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The value of the first key of a file, a text over several lines.
    fn drawing(text: &str) -> &str {
        text.split("\"\"\"").nth(1).unwrap().trim()
    }

    #[test]
    fn a_small_world() {
        let world = GeneratedWorld::generate(1, 14, 15, None).unwrap();
        insta::assert_snapshot!(drawing(&world.layout), @"
        %############%
        nnnnnnnnnnnnnn
        nnnnnnnnnnnnnn
        ###CC#####DD##
        ###CC#####DD##
        ###CC#####DD##
        ###CC#####DD##
        xxxxxxxxxxxxxx
        xxxxxxxxxxxxxx
        ##AA#####BB###
        ##AA#####BB###
        ##AA#####BB###
        ssssssssssssss
        ssssssssssssss
        %############%
        ");
        insta::assert_snapshot!(drawing(&world.catalogue), @"
        ## ## ## ## ## ## ## ## ## ## ## ## ## ##
        .. r1 r1 r3 r3 h2 h1 h3 h1 h3 h1 h3 h2 ..
        r2 r2 r3 .. .. y2 y3 y1 h2 h2 .. .. .. ..
        ## ## ## r1 y1 ## ## ## ## ## h2 .. ## ##
        ## ## ## y3 y3 ## ## ## ## ## .. .. ## ##
        ## ## ## y2 y2 ## ## ## ## ## .. .. ## ##
        ## ## ## b2 y2 ## ## ## ## ## .. .. ## ##
        b3 b2 b1 .. .. y3 g1 g3 g2 g1 .. .. .. ..
        b1 b2 .. .. g2 g1 g3 g2 g3 .. .. .. .. ..
        ## ## b1 b3 ## ## ## ## ## g1 c2 ## ## ##
        ## ## k3 b3 ## ## ## ## ## g1 c1 ## ## ##
        ## ## k3 k3 ## ## ## ## ## c3 c2 ## ## ##
        k1 k1 .. .. k1 k2 l2 l3 c1 .. .. c2 c3 c3
        .. k2 k1 l2 l2 l1 l2 l1 l3 l1 c1 c3 c1 ..
        ## ## ## ## ## ## ## ## ## ## ## ## ## ##
        ");
        assert!(world.layout.starts_with("# The warehouse floor"));
        assert!(world.catalogue.starts_with("# What stands on the racks."));
    }

    #[test]
    fn categories_stand_elsewhere_with_another_seed() {
        let [one, two] = [1, 2].map(|seed| GeneratedWorld::generate(seed, 24, 40, None).unwrap());
        let first = |world: &GeneratedWorld, name: &str| {
            let category = world.warehouse.catalogue.category_named(name).unwrap();
            world.warehouse.items_in(category).next().unwrap().standpoint
        };
        let names = one.warehouse.catalogue.categories.iter().map(|category| &category.name);
        assert!(names.filter(|name| first(&one, name) == first(&two, name)).count() < 2);
    }

    #[test]
    fn every_size_has_a_world_with_every_number_of_corridors() {
        for (seed, width) in (MIN_SIDE..=MAX_SIDE).enumerate() {
            for number in corridors(width) {
                let height = MIN_SIDE + (7 * width + 11 * number) % (MAX_SIDE - MIN_SIDE + 1);
                let world = GeneratedWorld::generate(seed as u64, width, height, Some(number));
                let world = world.unwrap_or_else(|error| panic!("{width}x{height}: {error}"));
                let layout = &world.warehouse.layout;
                assert_eq!(
                    (usize::from(layout.width()), usize::from(layout.height())),
                    (width, height)
                );
                let categories = world.warehouse.catalogue.categories.len();
                for category in 0..categories {
                    let items = world.warehouse.items_in(category).count();
                    assert!((6..=MAX_CATEGORY).contains(&items), "{width}x{height}: {items}");
                }
                assert!(categories >= 4, "{width}x{height}: {categories} categories");
            }
        }
    }

    #[test]
    fn what_cannot_be_drawn_is_refused() {
        let refused = |width, height, number| {
            GeneratedWorld::generate(1, width, height, number).unwrap_err().to_string()
        };
        assert_eq!(refused(11, 40, None), "11x40 cells; each side must be 12 to 64");
        assert_eq!(refused(40, 65, None), "40x65 cells; each side must be 12 to 64");
        assert_eq!(
            refused(24, 40, Some(7)),
            "7 aisles in each bank; a warehouse 24 cells wide has 2 to 6"
        );
    }
}
