//! The item catalogue: categories, types, and what each looks like. Also reads the stock plan, which says where items stand.

use plates::code;
use serde::Deserialize;

use crate::asset::{Problem, toml};

/// What an item looks like. The renderer has one mesh for each shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shape {
    /// A steel drum with hoops.
    Barrel,
    /// A cardboard box with a strip of tape.
    Carton,
    /// A long box with a handle on top.
    Toolbox,
    /// A slim bottle with a nozzle and a hose.
    FireExtinguisher,
    /// A traffic cone on a square foot, with a white band.
    Cone,
    /// A tyre, hole towards the aisle.
    Tyre,
    /// An open bucket, wider at the top, with a bail.
    Bucket,
    /// A hard hat.
    Helmet,
    /// An open crate of slats.
    Crate,
    /// A flat can with a handle and a spout.
    Jerrycan,
    /// A tall bottle with a round shoulder and a valve.
    GasCylinder,
    /// A wooden drum on its side, wound with cable.
    CableReel,
}

impl Shape {
    /// All shapes, in the order of their meshes.
    pub const ALL: [Self; 12] = [
        Self::Barrel,
        Self::Carton,
        Self::Toolbox,
        Self::FireExtinguisher,
        Self::Cone,
        Self::Tyre,
        Self::Bucket,
        Self::Helmet,
        Self::Crate,
        Self::Jerrycan,
        Self::GasCylinder,
        Self::CableReel,
    ];

    /// The outline of the mesh on the shelf, in centimetres: half the width and half the depth of a rectangle around its middle,
    /// and by how much each corner is cut off, as far on both sides.
    pub const fn outline_cm(self) -> [i32; 3] {
        match self {
            Self::Barrel => [21, 21, 12],
            Self::Carton => [28, 20, 0],
            Self::Toolbox => [27, 14, 0],
            Self::FireExtinguisher => [18, 11, 7],
            Self::Cone => [20, 20, 0],
            Self::Tyre => [24, 10, 0],
            Self::Bucket => [21, 20, 13],
            Self::Helmet => [21, 24, 12],
            Self::Crate => [26, 18, 0],
            Self::Jerrycan => [19, 10, 0],
            Self::GasCylinder => [15, 16, 9],
            Self::CableReel => [26, 26, 17],
        }
    }
}

/// A family of types, for example "barrels".
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Category {
    /// Plural name, as in instructions and on plates.
    pub name: String,
    /// The shape that all its types share.
    pub shape: Shape,
}

/// A type of item, for example "blue barrel".
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ItemType {
    /// Singular name, as in instructions and on plates.
    pub name: String,
    /// Index of its category in [`Catalogue::categories`].
    pub category: usize,
    /// Its category's shape.
    pub shape: Shape,
    /// Main colour, sRGB.
    pub colour: [u8; 3],
}

/// All categories and types.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Catalogue {
    /// Categories, in the order of the file.
    pub categories: Vec<Category>,
    /// Types, by category and then in the order of the file.
    pub types: Vec<ItemType>,
}

impl Catalogue {
    /// The index of the type called `name`.
    pub fn type_named(&self, name: &str) -> Option<usize> {
        self.types.iter().position(|item_type| item_type.name == name)
    }

    /// The index of the category called `name`.
    pub fn category_named(&self, name: &str) -> Option<usize> {
        self.categories.iter().position(|category| category.name == name)
    }

    /// The indices of the types in `category`.
    pub fn types_in(&self, category: usize) -> impl Iterator<Item = usize> + '_ {
        (0..self.types.len()).filter(move |&index| self.types[index].category == category)
    }
}

/// The stock plan: rows from the north, each entry a type index where a bay holds an item.
#[derive(Debug)]
pub(crate) struct Stock {
    pub(crate) rows: Vec<Vec<StockCell>>,
}

/// One cell of the stock plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum StockCell {
    Solid,
    Empty,
    Item(usize),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CatalogueFile {
    stock: String,
    category: Vec<CategoryEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CategoryEntry {
    mark: char,
    name: String,
    shape: Shape,
    types: Vec<TypeEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypeEntry {
    name: String,
    colour: String,
}

/// Reads the text of a `catalogue.toml`.
///
/// # Errors
/// A name used twice, two names with the same plate code, an invalid colour or one near the magenta of plate frames, an
/// unknown mark in the stock plan. The message names the entry.
pub(crate) fn parse(text: &str) -> Result<(Catalogue, Stock), Problem> {
    let file: CatalogueFile = toml(text)?;
    let mut catalogue = Catalogue { categories: Vec::new(), types: Vec::new() };
    let mut marks: Vec<String> = Vec::new();
    for (index, entry) in file.category.iter().enumerate() {
        if !entry.mark.is_ascii_alphabetic()
            || file.category[..index].iter().any(|other| other.mark == entry.mark)
        {
            return Err(format!(
                "category {:?}: mark {:?} must be a letter that no other category uses",
                entry.name, entry.mark
            ));
        }
        catalogue.categories.push(Category { name: entry.name.clone(), shape: entry.shape });
        for (number, item_type) in entry.types.iter().enumerate() {
            marks.push(format!("{}{}", entry.mark, number + 1));
            catalogue.types.push(ItemType {
                name: item_type.name.clone(),
                category: index,
                shape: entry.shape,
                colour: parse_colour(&item_type.colour)
                    .map_err(|problem| format!("type {:?}: {problem}", item_type.name))?,
            });
        }
    }
    check_names("categories", catalogue.categories.iter().map(|c| c.name.as_str()))?;
    check_names("types", catalogue.types.iter().map(|t| t.name.as_str()))?;
    let stock = parse_stock(&file.stock, &marks)?;
    Ok((catalogue, stock))
}

fn parse_stock(plan: &str, marks: &[String]) -> Result<Stock, Problem> {
    let mut rows = Vec::new();
    for (line, text) in plan.lines().enumerate() {
        let mut row = Vec::new();
        for (x, token) in text.split_whitespace().enumerate() {
            row.push(match token {
                "##" => StockCell::Solid,
                ".." => StockCell::Empty,
                _ => {
                    StockCell::Item(marks.iter().position(|mark| mark == token).ok_or_else(|| {
                        format!(
                            "stock line {}, column {}: {token:?} is neither ## (rack or wall), .. (empty) \
                             nor a category's mark and a type's number, such as {:?}",
                            line + 1,
                            x + 1,
                            marks.first().map_or("b1", String::as_str)
                        )
                    })?)
                }
            });
        }
        rows.push(row);
    }
    Ok(Stock { rows })
}

/// Checks that names are lower-case words, and that names and their plates differ.
fn check_names<'a>(what: &str, names: impl Iterator<Item = &'a str>) -> Result<(), Problem> {
    let mut seen: Vec<&str> = Vec::new();
    for name in names {
        let plain = name.chars().all(|c| c.is_ascii_lowercase() || c == ' ' || c == '-');
        if !plain || name.is_empty() || name.trim() != name {
            return Err(format!(
                "{what}: {name:?} must be lower-case letters, spaces and hyphens only"
            ));
        }
        for &other in &seen {
            if other == name {
                return Err(format!("{what}: {name:?} is listed twice"));
            }
            if code(other) == code(name) {
                return Err(format!(
                    "{what}: {other:?} and {name:?} get the same plate {:?}; rename one of them",
                    code(name)
                ));
            }
        }
        seen.push(name);
    }
    if seen.is_empty() { Err(format!("{what}: there are none; add at least one")) } else { Ok(()) }
}

fn parse_colour(text: &str) -> Result<[u8; 3], Problem> {
    let digits = text.strip_prefix('#').filter(|d| d.len() == 6);
    let value = digits.and_then(|digits| u32::from_str_radix(digits, 16).ok());
    let Some(value) = value else {
        return Err(format!("colour {text:?} is not of the form \"#2a5bd0\""));
    };
    let [_, r, g, b] = value.to_be_bytes();
    if r.min(b) >= 96 && g <= r.min(b) / 2 {
        return Err(format!("colour {text:?} is too similar to the magenta of plate frames"));
    }
    Ok([r, g, b])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn catalogue(categories: &str) -> Result<(Catalogue, Stock), Problem> {
        parse(&format!("stock = \"## b1 ..\"\n{categories}"))
    }

    fn barrels(types: &str) -> String {
        format!(
            "[[category]]\nmark = \"b\"\nname = \"barrels\"\nshape = \"barrel\"\ntypes = [{types}]"
        )
    }

    #[test]
    fn a_small_catalogue() {
        let text = barrels("{ name = \"blue barrel\", colour = \"#2a5bd0\" }");
        let (catalogue, stock) = catalogue(&text).unwrap();
        assert_eq!(catalogue.types[0].colour, [0x2a, 0x5b, 0xd0]);
        assert_eq!(catalogue.type_named("blue barrel"), Some(0));
        assert_eq!(stock.rows, [[StockCell::Solid, StockCell::Item(0), StockCell::Empty]]);
    }

    #[test]
    fn a_broken_catalogue_says_which_entry() {
        let blue = "{ name = \"blue barrel\", colour = \"#2a5bd0\" }";
        for (text, expected) in [
            (barrels(&format!("{blue}, {blue}")), "\"blue barrel\" is listed twice"),
            (
                barrels("{ name = \"barrel\", colour = \"blue\" }"),
                "colour \"blue\" is not of the form",
            ),
            (barrels("{ name = \"barrel\", colour = \"#ff00ff\" }"), "too similar to the magenta"),
            (barrels("{ name = \"Blue\", colour = \"#0000ff\" }"), "lower-case letters"),
            (barrels("{ name = \"blue\", color = \"#0000ff\" }"), "color"),
            (
                // These two names have the same code.
                barrels(&format!(
                    "{blue}, {{ name = \"yellow barrel\", colour = \"#ffff00\" }}, {{ name = \"blue toolbox\", colour = \"#0000ff\" }}"
                )),
                "\"yellow barrel\" and \"blue toolbox\" get the same plate",
            ),
            (barrels(""), "types: there are none"),
            (barrels(blue).replace("\"b\"", "\"c\""), "stock line 1, column 2: \"b1\""),
            (barrels(blue).replace("\"barrel\"", "\"sphere\""), "sphere"),
        ] {
            let problem = catalogue(&text).unwrap_err();
            assert!(problem.contains(expected), "{text}\n{problem}");
        }
    }
}
