//! The warehouse: floor plan and catalogue together, with every item in its bay.

use std::path::Path;
use std::sync::LazyLock;

use domain::{Cell, Heading};

use crate::asset::{AssetError, Problem, invalid, read};
use crate::catalogue::{self, Catalogue, Stock, StockCell};
use crate::layout::{Layout, Square};

/// The name of the floor plan's file in an assets folder.
pub const LAYOUT_FILE: &str = "layout.toml";

/// The name of the catalogue's file in an assets folder.
pub const CATALOGUE_FILE: &str = "catalogue.toml";

pub(crate) const SHIPPED_LAYOUT: &str = include_str!("../../../assets/layout.toml");
pub(crate) const SHIPPED_CATALOGUE: &str = include_str!("../../../assets/catalogue.toml");

/// Maximum number of items of one category, because planning searches all visit orders.
pub(crate) const MAX_CATEGORY: usize = 16;

/// One item in its bay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Item {
    /// The index in [`Warehouse::items`].
    pub id: u16,
    /// The index of its type in [`Catalogue::types`].
    pub item_type: usize,
    /// Its rack square.
    pub rack: Cell,
    /// Its side of the rack: the direction from the rack to the standpoint.
    pub face: Heading,
    /// The free cell in front of it. An agent there has reached the item.
    pub standpoint: Cell,
}

impl Item {
    /// The heading in which an agent on the standpoint faces the item.
    pub fn viewing_heading(&self) -> Heading {
        self.face.opposite()
    }
}

/// The floor plan, the catalogue and the items. No two items share a standpoint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warehouse {
    /// The floor plan.
    pub layout: Layout,
    /// Categories and types.
    pub catalogue: Catalogue,
    /// All items by id: by standpoint, row by row from the south-west corner.
    pub items: Vec<Item>,
}

impl Warehouse {
    /// The warehouse that is compiled in.
    pub fn shipped() -> Self {
        static SHIPPED: LazyLock<Warehouse> = LazyLock::new(|| {
            let (layout, catalogue) = (LAYOUT_FILE.into(), CATALOGUE_FILE.into());
            match Warehouse::parse(layout, SHIPPED_LAYOUT, catalogue, SHIPPED_CATALOGUE) {
                Ok(warehouse) => warehouse,
                Err(error) => unreachable!("the shipped warehouse is tested: {error}"),
            }
        });
        SHIPPED.clone()
    }

    /// Reads `layout.toml` and `catalogue.toml` in the folder `assets`.
    ///
    /// # Errors
    /// A file that cannot be read or is invalid.
    pub fn load(assets: &Path) -> Result<Self, AssetError> {
        let (layout, catalogue) = (assets.join(LAYOUT_FILE), assets.join(CATALOGUE_FILE));
        Self::parse(
            layout.display().to_string(),
            &read(&layout)?,
            catalogue.display().to_string(),
            &read(&catalogue)?,
        )
    }

    /// Parses the two texts. The file names are for messages.
    pub(crate) fn parse(
        layout_file: String,
        layout_text: &str,
        catalogue_file: String,
        catalogue_text: &str,
    ) -> Result<Self, AssetError> {
        let layout = Layout::parse(layout_text).map_err(invalid(layout_file))?;
        catalogue::parse(catalogue_text)
            .and_then(|(catalogue, stock)| {
                let items = place(&layout, &stock)?;
                let warehouse = Self { layout, catalogue, items };
                warehouse.check_sizes()?;
                Ok(warehouse)
            })
            .map_err(invalid(catalogue_file))
    }

    /// Checks that every type has an item and no category has too many.
    pub(crate) fn check_sizes(&self) -> Result<(), Problem> {
        for (index, item_type) in self.catalogue.types.iter().enumerate() {
            if self.instances(index).next().is_none() {
                return Err(format!(
                    "no {} in the stock plan; add one or remove the type",
                    item_type.name
                ));
            }
        }
        for (index, category) in self.catalogue.categories.iter().enumerate() {
            let count = self.items_in(index).count();
            if count > MAX_CATEGORY {
                return Err(format!(
                    "{count} {} in the stock plan; at most {MAX_CATEGORY}",
                    category.name
                ));
            }
        }
        Ok(())
    }

    /// Item `id`.
    ///
    /// # Panics
    /// When there is no such item.
    pub fn item(&self, id: u16) -> &Item {
        &self.items[usize::from(id)]
    }

    /// The item whose standpoint is `cell`.
    pub fn item_at(&self, cell: Cell) -> Option<&Item> {
        self.items.iter().find(|item| item.standpoint == cell)
    }

    /// The instances of type `item_type`, by id.
    pub fn instances(&self, item_type: usize) -> impl Iterator<Item = &Item> + '_ {
        self.items.iter().filter(move |item| item.item_type == item_type)
    }

    /// The items of `category`, by id.
    pub fn items_in(&self, category: usize) -> impl Iterator<Item = &Item> + '_ {
        self.items.iter().filter(move |item| self.category_of(item) == category)
    }

    /// The category of `item`.
    pub fn category_of(&self, item: &Item) -> usize {
        self.catalogue.types[item.item_type].category
    }
}

/// The items of the stock plan.
fn place(layout: &Layout, stock: &Stock) -> Result<Vec<Item>, Problem> {
    let (width, height) = (usize::from(layout.width()), usize::from(layout.height()));
    if stock.rows.len() != height {
        return Err(format!("stock has {} lines and the floor plan {height}", stock.rows.len()));
    }
    let mut items = Vec::new();
    for (y, (line, row)) in stock.rows.iter().enumerate().rev().enumerate() {
        if row.len() != width {
            return Err(format!(
                "stock line {} has {} cells and the floor plan {width} columns",
                line + 1,
                row.len()
            ));
        }
        for (x, &content) in row.iter().enumerate() {
            let cell = Cell::new(x as u8, y as u8);
            let place = format!("stock line {}, column {} (cell {cell})", line + 1, x + 1);
            match (layout.is_free(cell), content) {
                (true, StockCell::Empty) | (false, StockCell::Solid) => {}
                (true, StockCell::Solid) => {
                    return Err(format!("{place}: the floor plan has floor there; write .."));
                }
                (false, _) => {
                    return Err(format!("{place}: the floor plan has no floor there; write ##"));
                }
                (true, StockCell::Item(item_type)) => {
                    let (rack, face) =
                        faced_bay(layout, cell).map_err(|problem| format!("{place}: {problem}"))?;
                    items.push(Item {
                        id: items.len() as u16,
                        item_type,
                        rack,
                        face,
                        standpoint: cell,
                    });
                }
            }
        }
    }
    Ok(items)
}

/// `standpoints` in groups whose bays are neighbours: beside each other, one apart, or around the corner of a rack.
pub(crate) fn groups(standpoints: Vec<Cell>) -> Vec<Vec<Cell>> {
    let mut rest = standpoints;
    let mut groups = Vec::new();
    while let Some(first) = rest.pop() {
        let mut group = vec![first];
        let mut next = 0;
        while let Some(&cell) = group.get(next) {
            next += 1;
            group.extend(rest.extract_if(.., |other| are_neighbours(cell, *other)));
        }
        groups.push(group);
    }
    groups
}

/// Whether the bays with these standpoints are neighbours.
pub(crate) fn are_neighbours(one: Cell, other: Cell) -> bool {
    one.distance(other) <= 2
}

/// The only rack square beside `cell`, and its side towards `cell`.
pub(crate) fn faced_bay(layout: &Layout, cell: Cell) -> Result<(Cell, Heading), Problem> {
    let mut bays = Heading::ALL.into_iter().filter_map(|heading| {
        let rack = cell.step(heading).filter(|&next| layout.square(next) == Square::Rack)?;
        Some((rack, heading.opposite()))
    });
    match (bays.next(), bays.next()) {
        (Some(bay), None) => Ok(bay),
        (None, _) => Err("no rack beside this cell for the item to stand on".into()),
        (Some(_), Some(_)) => {
            Err("two racks beside this cell, so the item's place is ambiguous; move the item"
                .into())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::Axis;

    const LAYOUT: &str = "plan = \"aaa\\naaa\\n###\"\n\
        [[aisle]]\nmark = \"a\"\nname = \"Aisle A\"\nruns = \"east-west\"\n";
    const CATALOGUE: &str = "stock = \"\"\"\n.. .. ..\nb1 .. b1\n## ## ##\n\"\"\"\n\
        [[category]]\nmark = \"b\"\nname = \"barrels\"\nshape = \"barrel\"\n\
        types = [{ name = \"blue barrel\", colour = \"#2a5bd0\" }]\n";

    fn parse(layout: &str, catalogue: &str) -> Result<Warehouse, AssetError> {
        Warehouse::parse("layout.toml".into(), layout, "catalogue.toml".into(), catalogue)
    }

    #[test]
    fn items_stand_on_the_rack_beside_their_mark() {
        let warehouse = parse(LAYOUT, CATALOGUE).unwrap();
        let bays = warehouse.items.iter().map(|i| (i.id, i.rack, i.face, i.standpoint));
        assert_eq!(
            bays.collect::<Vec<_>>(),
            [
                (0, Cell::new(0, 0), Heading::N, Cell::new(0, 1)),
                (1, Cell::new(2, 0), Heading::N, Cell::new(2, 1)),
            ]
        );
        assert_eq!(warehouse.item_at(Cell::new(2, 1)).map(|item| item.id), Some(1));
    }

    #[test]
    fn the_shipped_warehouse_parses_and_is_rich_enough() {
        let warehouse = Warehouse::shipped();
        let layout = &warehouse.layout;
        assert_eq!((layout.width(), layout.height()), (16, 30));
        let running = |axis| layout.aisles().iter().filter(|aisle| aisle.runs == axis).count();
        assert_eq!((running(Axis::NorthSouth), running(Axis::EastWest)), (6, 3));
        assert!(warehouse.catalogue.categories.len() >= 8);
        assert!(warehouse.catalogue.types.len() >= 24);
        assert!(warehouse.items.len() >= 150);
    }

    #[test]
    fn a_stock_plan_that_does_not_fit_the_floor_says_where() {
        for (from, to, expected) in [
            (
                "b1 .. b1",
                "b1 .. ##",
                "stock line 2, column 3 (cell (2, 1)): the floor plan has floor",
            ),
            ("## ## ##", "## .. ##", "the floor plan has no floor there"),
            ("b1 .. b1", "b1 ..", "stock line 2 has 2 cells"),
            (".. .. ..\n", "", "stock has 2 lines and the floor plan 3"),
            (".. .. ..", "b1 .. ..", "no rack beside this cell"),
        ] {
            let error = parse(LAYOUT, &CATALOGUE.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.starts_with("catalogue.toml: ") && error.contains(expected), "{error}");
        }
        let corner = LAYOUT.replace("aaa\\naaa", "aaa\\n#aa");
        let catalogue = CATALOGUE.replace("b1 .. b1", "## b1 ..");
        let error = parse(&corner, &catalogue).unwrap_err().to_string();
        assert!(error.contains("two racks beside this cell"), "{error}");
    }

    #[test]
    fn a_missing_asset_is_named() {
        let error = Warehouse::load(Path::new("no/such/folder")).unwrap_err().to_string();
        assert!(error.contains("no/such/folder/layout.toml"), "{error}");
    }

    proptest::proptest! {
        #[test]
        fn a_mangled_asset_is_refused_or_read_but_never_panics(
            layout in proptest::bool::ANY, at in 0..10_000_usize, to in "[ -~\\n]{0,2}",
        ) {
            let mangle = |text: &str| {
                let at = at % text.len();
                format!("{}{to}{}", &text[..at], &text[at + 1..])
            };
            let read = if layout {
                parse(&mangle(SHIPPED_LAYOUT), SHIPPED_CATALOGUE)
            } else {
                parse(SHIPPED_LAYOUT, &mangle(SHIPPED_CATALOGUE))
            };
            if let Ok(warehouse) = read {
                let none = crate::CaseSet { seed: 0, cases: Vec::new(), elsewhere: None };
                proptest::prop_assert!(!crate::validate::check(&warehouse, &none).lines.is_empty());
            }
        }
    }
}
