//! Top-down maps as SVG: the warehouse, or a case with its six routes, targets and barricade. North is up.

mod canvas;
mod floor;
mod glyph;
mod legend;
mod marks;
mod routes;

use crate::case::Case;
use crate::world::Warehouse;
use floor::Map;

/// A map of `warehouse` with the routes of `case`.
pub fn svg(warehouse: &Warehouse, case: &Case) -> String {
    let mut map = Map::new(&warehouse.layout, canvas::LEGEND);
    map.floor(warehouse, Some(case));
    map.aisle_names();
    map.items(warehouse, Some(case));
    map.routes(warehouse, case);
    map.case_legend(warehouse, case);
    map.canvas.finish()
}

/// The floor of `warehouse` with its items and without a legend, as the ground of other drawings.
pub fn ground_svg(warehouse: &Warehouse) -> String {
    let mut map = Map::new(&warehouse.layout, 0.0);
    map.floor(warehouse, None);
    map.aisle_names();
    map.items(warehouse, None);
    map.canvas.finish()
}

/// The side of a cell and the width of the border around the floor, in the units of every map.
pub const MEASURES: (f64, f64) = (canvas::CELL, canvas::MARGIN);

/// A map of `warehouse`.
pub fn floor_svg(warehouse: &Warehouse) -> String {
    let mut map = Map::new(&warehouse.layout, canvas::LEGEND);
    map.floor(warehouse, None);
    map.aisle_names();
    map.items(warehouse, None);
    map.floor_legend(warehouse);
    map.canvas.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::{CaseSet, TrajectoryKind};

    /// Checks that elements are nested and closed.
    fn check_nesting(svg: &str) {
        let mut open = Vec::new();
        for tag in svg.split('<').skip(1) {
            let name: String =
                tag.trim_start_matches('/').chars().take_while(|c| c.is_alphanumeric()).collect();
            if tag.starts_with('/') {
                assert_eq!(open.pop(), Some(name));
            } else if !tag.split('>').next().unwrap().ends_with('/') {
                open.push(name);
            }
        }
        assert_eq!(open, [""; 0]);
    }

    #[test]
    fn a_map_shows_every_aisle_item_and_route() {
        let warehouse = Warehouse::shipped();
        let cases = CaseSet::shipped();
        let floor = floor_svg(&warehouse);
        check_nesting(&floor);
        check_nesting(&ground_svg(&warehouse));
        for aisle in warehouse.layout.aisles() {
            assert!(floor.contains(&aisle.name.to_uppercase()));
        }
        assert!(floor.contains("160 items of 36 types"));
        for case in cases.cases.iter().step_by(9) {
            let map = svg(&warehouse, case);
            check_nesting(&map);
            assert!(map.contains(&format!("Case {}", case.id)));
            for start in TrajectoryKind::ALL {
                let length = case.replay(&warehouse, start).length.unwrap();
                assert!(map.contains(&format!(">{length} steps<")), "{} {}", case.id, start.name());
            }
            // Every target has its letter, and the legend explains each letter once.
            let targets = case.task.targets(&warehouse).len();
            let badges = ["A", "B", "C"].map(|l| map.matches(&format!(">{l}</text>")).count());
            let letters = badges.iter().filter(|&&count| count > 0).count();
            assert_eq!(badges.iter().sum::<usize>(), targets + letters, "{}", case.id);
        }
    }
}
