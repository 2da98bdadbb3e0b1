//! Plates that are read from rendered views, compared with the catalogue.

use plates::{self, Landmark, Plate};
use warehouse::every_pose;
use warehouse::sight::shows_face;
use warehouse::{Item, Variant, Warehouse};

use super::views::Views;

/// Every how many poses one is tested. Coprime to the number of headings, so that all headings occur.
const EVERY: usize = 7;

/// The farthest standpoint, in cells ahead, whose plate has to be read.
const NEAR: u8 = 5;

fn landmark(warehouse: &Warehouse, item: &Item) -> Landmark {
    let category = &warehouse.catalogue.categories[warehouse.category_of(item)];
    let item_type = &warehouse.catalogue.types[item.item_type];
    let plate = Plate::new(&category.name, &item_type.name);
    Landmark { standpoint: item.standpoint, face: item.viewing_heading(), plate }
}

#[test]
fn plates_in_rendered_views_agree_with_the_catalogue() {
    let warehouse = Warehouse::shipped();
    let mut views = Views::new(&warehouse);
    let items: Vec<_> =
        warehouse.items.iter().map(|item| (item, landmark(&warehouse, item))).collect();
    let (mut near, mut found) = (0, 0);
    for pose in every_pose(&warehouse.layout).step_by(EVERY) {
        let image = views.of(pose, &Variant::UNCHANGED);
        let frame = image.frame();
        let read: Vec<_> = plates::read(frame.width, frame.height, frame.pixels)
            .into_iter()
            .map(|sighting| sighting.seen_from(pose).expect("a plate off the grid"))
            .collect();
        for landmark in &read {
            let is_true = items.iter().any(|(_, truth)| truth == landmark);
            assert!(is_true, "from {pose}: {landmark:?} is not there");
        }
        for (item, landmark) in &items {
            let ahead = match pose.heading.vector() {
                (0, _) => item.standpoint.y.abs_diff(pose.cell.y),
                _ => item.standpoint.x.abs_diff(pose.cell.x),
            };
            if ahead <= NEAR && shows_face(&warehouse.layout, pose, item) {
                near += 1;
                found += usize::from(read.contains(landmark));
            }
        }
    }
    // `shows_face` also counts items of which only a sliver is visible beside a rack.
    assert!(near > 400, "only {near} plates to read");
    assert!(100 * found >= 95 * near, "{found} of {near} plates were read");
}
