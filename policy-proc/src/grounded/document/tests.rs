use proptest::prelude::*;

use super::*;
use crate::grounded::instruction::Goal;

const SUMMARY: &str = r#"# Summary of the demonstrations
Positions are (column, row): columns grow east, rows grow north.

## Items
- blue barrel [plate 061-611]: stand at (3, 7) facing E; stand at (3, 9) facing E
- barrels item [plate 554-113]: stand at (12, 4) facing W
- item [plate 222-113]: stand at (12, 5) facing W

## Passages
- column 3: rows 1-14
- row 15: columns 0-15

## Routes
- "Find a blue barrel." from (14, 11) facing S: south 3 to (14, 8), west 5 to (9, 8); reached blue barrel at (9, 8).
"#;

const SEMANTIC: &str = "# Knowledge of the warehouse
## Layout
- North-south corridors: column 3 (rows 1-14), column 6 (rows 1-14)
- East-west aisles: row 0 (columns 0-15), row 15 (columns 0-15)
## Where kinds of items stand
- barrels [plate 554]: columns 2-5, rows 6-9; seen there: blue barrel, red barrel
## Navigation
- To change corridors use an east-west aisle: rows 0, 15, 29.
";

fn standpoints(text: &str, instruction: &str) -> Vec<(u8, u8)> {
    let goal = Goal::parse(instruction).unwrap();
    let atlas = Atlas::parse(text);
    let cells =
        goal.wants().into_iter().flat_map(|want| atlas.standpoints(want).collect::<Vec<_>>());
    cells.map(|cell| (cell.x, cell.y)).collect()
}

#[test]
fn items_are_found_by_plate_and_routes_say_what_they_reached() {
    // The plate of a blue barrel ends in 611, that of barrels begins with 554.
    assert_eq!(standpoints(SUMMARY, "Find a blue barrel."), [(3, 7), (3, 9), (9, 8)]);
    let category = "Find any item of the category barrels.";
    assert_eq!(standpoints(SUMMARY, category), [(12, 4)]);
    assert_eq!(standpoints(SUMMARY, "Find a red barrel."), []);
}

#[test]
fn passages_and_routes_are_floor() {
    let atlas = Atlas::parse(SUMMARY);
    let cells: usize = atlas.passages.iter().map(|rect| rect.cells().count()).sum();
    assert_eq!(cells, 14 + 16);
    let route = atlas.routes("Find a blue barrel.").next().unwrap();
    assert_eq!(route.facing, Some(Heading::S));
    assert_eq!(route.cells().len(), 1 + 3 + 5);
    assert_eq!(route.cells().last(), Some(&Cell::new(9, 8)));
    assert_eq!(atlas.routes("Find a red barrel.").count(), 0);
}

#[test]
fn regions_say_where_to_look() {
    let atlas = Atlas::parse(SEMANTIC);
    assert_eq!(atlas.passages.len(), 4);
    let look = |instruction: &str| {
        let goal = Goal::parse(instruction).unwrap();
        atlas.regions(goal.wants()[0]).collect::<Vec<_>>()
    };
    let region = Rect { columns: (2, 5), rows: (6, 9) };
    assert_eq!(look("Find any item of the category barrels."), [region]);
    assert_eq!(look("Find a red barrel."), [region]);
    assert_eq!(look("Find a green cone."), []);
}

#[test]
fn of_free_text_a_line_that_names_a_thing_and_a_cell_is_a_hint() {
    let text = "I saw two Blue Barrels, at (3, 7) and (3, 9).\nA bluer barrel-like thing: (1, 1).\n\
                The blue barreling: (2, 2). Cones stand at (9, 9).";
    assert_eq!(standpoints(text, "Find a blue barrel."), [(3, 7), (3, 9)]);
}

proptest! {
    #[test]
    fn any_text_is_read(text: String, around in 0..6_usize) {
        let frames = [
            "{}", "- blue barrel: stand at ({}, {})", "- \"{}\" from ({}, 3) facing {}: reached {} at (3, {})",
            "## Layout {}\ncolumn {}: rows {}-{}", "plate {}-{}", "(1, 2) {} (255, 256) columns 0-255 rows 0-255 {}",
        ];
        let text = frames[around].replace("{}", &text);
        let atlas = Atlas::parse(&text);
        let instruction = "Visit a blue barrel and an orange cone, in any order.";
        for want in Goal::parse(instruction).unwrap().wants() {
            let _ = (atlas.standpoints(want).count(), atlas.regions(want).count());
        }
        let _ = (atlas.walked().count(), atlas.routes(&text).count());
    }

    #[test]
    fn numbers_of_any_size_are_read(numbers in prop::collection::vec(any::<u64>(), 6)) {
        let n = |i: usize| numbers[i] % 300;
        let text = format!(
            "- column {}: rows {}-{}\n- \"find\" from ({}, {}) facing n: east {} to ({}, {}).",
            n(0), n(1), n(2), n(3), n(4), numbers[5], n(5), n(4),
        );
        prop_assert!(Atlas::parse(&text).walked().count() <= 512);
    }
}
