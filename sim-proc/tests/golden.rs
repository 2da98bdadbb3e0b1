//! Pictures that have been looked at and found good, compared with what is drawn now.
//!
//! `UPDATE_GOLDEN=1 cargo test -p sim-proc --test golden` writes them anew; look at them before you
//! commit them. Drivers round differently, so a little difference is allowed.

use std::path::{Path, PathBuf};

use image::RgbaImage;
use sim_proc::renderer::{RenderSettings, Renderer, View};
use warehouse::{CaseSet, Variant, Warehouse};

/// A pixel counts as different when a channel is off by more than this.
const CHANNEL_TOLERANCE: u8 = 24;

/// So many of a thousand pixels may be different.
const PIXELS_PER_MILLE: usize = 4;

/// What the pictures are called, and where they are taken.
const VIEWS: [(&str, &str); 6] = [
    ("along-aisle-a", "2,8,N"),
    ("cross-aisle", "5,14,E"),
    ("cross-aisle-to-aisle-b", "9,15,S"),
    ("standpoint", "3,6,E"),
    ("gate", "1,18,W"),
    ("south-aisle", "12,1,W"),
];

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden")
}

#[test]
fn views_look_as_they_did() {
    let warehouse = Warehouse::shipped();
    let mut renderer = Renderer::new(&warehouse, RenderSettings::default()).unwrap();
    let mut wrong = Vec::new();
    for (name, pose) in VIEWS {
        let view = View { pose: pose.parse().unwrap(), variant: &Variant::UNCHANGED };
        let image = renderer.render_image(view).unwrap();
        wrong.extend(compare(name, &image));
    }
    // A barricade, seen from two cells before it.
    let cases = CaseSet::shipped();
    let closed = Variant::closing(cases.cases[0].barricade.iter().copied());
    let (pose, _) = standing_before(&warehouse, &closed);
    let image = renderer.render_image(View { pose, variant: &closed }).unwrap();
    wrong.extend(compare("barricade", &image));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The first pose, by cell and heading, that looks at a closed cell from two cells away.
fn standing_before(warehouse: &Warehouse, closed: &Variant) -> (domain::Pose, domain::Cell) {
    for &cell in closed.closed() {
        for heading in domain::Heading::ALL {
            let back = heading.opposite();
            let free = |cell| warehouse.layout.free_neighbour(cell, back);
            let Some(before) = free(cell).filter(|&before| !closed.is_closed(before)) else {
                continue;
            };
            if let Some(stand) = free(before) {
                return (domain::Pose { cell: stand, heading }, cell);
            }
        }
    }
    panic!("a barricade that cannot be stood before");
}

/// What is wrong with the picture called `name`, if anything.
fn compare(name: &str, actual: &RgbaImage) -> Option<String> {
    let path = folder().join(format!("{name}.png"));
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        save(actual, &path);
        return None;
    }
    let golden = match image::open(&path) {
        Ok(golden) => golden.to_rgba8(),
        Err(error) => {
            return Some(format!("{}: {error}; UPDATE_GOLDEN=1 writes it", path.display()));
        }
    };
    if golden.dimensions() != actual.dimensions() {
        return Some(format!(
            "{name}: {:?} instead of {:?}",
            actual.dimensions(),
            golden.dimensions()
        ));
    }
    let mut difference = RgbaImage::new(actual.width(), actual.height());
    let mut count = 0;
    for ((a, b), shown) in actual.pixels().zip(golden.pixels()).zip(difference.pixels_mut()) {
        let off = (0..4).map(|i| a[i].abs_diff(b[i])).max().unwrap_or(0);
        count += usize::from(off > CHANNEL_TOLERANCE);
        *shown = image::Rgba([off, off, off, 255]);
    }
    let allowed = (actual.width() * actual.height()) as usize * PIXELS_PER_MILLE / 1000;
    if count <= allowed {
        return None;
    }
    let out = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (shown, drawn) =
        (out.join(format!("{name}-difference.png")), out.join(format!("{name}.png")));
    save(&difference, &shown);
    save(actual, &drawn);
    Some(format!(
        "{name}: {count} pixels differ, {allowed} may; see {} and {}; if the new picture is right, \
         UPDATE_GOLDEN=1 keeps it",
        drawn.display(),
        shown.display()
    ))
}

fn save(image: &RgbaImage, path: &Path) {
    if let Err(error) = image.save(path) {
        panic!("cannot write {}: {error}", path.display());
    }
}
