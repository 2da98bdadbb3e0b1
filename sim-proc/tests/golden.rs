//! Compares rendered views with reference images that a person has checked.
//!
//! `UPDATE_GOLDEN=1 cargo test --release -p sim-proc --test golden` writes new reference images; check them before
//! committing. Backends and drivers round differently, so small differences are allowed.

use std::path::{Path, PathBuf};

use domain::{Appearance, Heading, Pose};
use png_file::RgbaImage;
use sim_proc::renderer::{RenderSettings, Renderer, ViewSpec};
use warehouse::{CaseSet, Variant, Warehouse};

/// A pixel counts as different when a channel is off by more than this.
const CHANNEL_TOLERANCE: u8 = 24;

/// How many of a thousand pixels may differ.
const PIXELS_PER_MILLE: usize = 4;

/// Names and poses of the views with plates.
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
fn views_look_like_their_references() {
    let warehouse = Warehouse::shipped();
    let settings =
        RenderSettings { appearance: Appearance::WITH_PLATES, ..RenderSettings::default() };
    let mut renderer = Renderer::new(&warehouse, settings).unwrap();
    let mut wrong = Vec::new();
    for (name, pose) in VIEWS {
        let view = ViewSpec { pose: pose.parse().unwrap(), variant: &Variant::UNCHANGED, stock: 0 };
        let image = renderer.render_image(view).unwrap();
        wrong.extend(compare(name, &image));
    }
    // A barricade, seen from two cells away.
    let cases = CaseSet::shipped();
    let closed = Variant::closing(cases.cases[0].barricade.iter().copied());
    let pose = pose_before(&warehouse, &closed);
    let image = renderer.render_image(ViewSpec { pose, variant: &closed, stock: 0 }).unwrap();
    wrong.extend(compare("barricade", &image));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_appearance_looks_like_its_reference() {
    let warehouse = Warehouse::shipped();
    let (standard, plates) = (Appearance::STANDARD, Appearance::WITH_PLATES);
    let mut wrong = Vec::new();
    for (name, pose, appearance) in [
        ("standard", "9,15,S", standard),
        ("no-labels", "3,6,E", Appearance { labels: false, ..standard }),
        ("plates-no-labels", "9,15,S", Appearance { labels: false, ..plates }),
        ("seed-1", "9,15,S", Appearance { seed: 1, ..plates }),
        ("seed-4", "1,18,W", Appearance { seed: 4, ..plates }),
    ] {
        let settings = RenderSettings { appearance, ..RenderSettings::default() };
        let mut renderer = Renderer::new(&warehouse, settings).unwrap();
        let (pose, variant) = (pose.parse().unwrap(), &Variant::UNCHANGED);
        let image = renderer.render_image(ViewSpec { pose, variant, stock: 0 }).unwrap();
        wrong.extend(compare(name, &image));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The first pose, by cell and heading, that faces a closed cell from two cells away.
fn pose_before(warehouse: &Warehouse, closed: &Variant) -> Pose {
    for &cell in closed.closed() {
        for heading in Heading::ALL {
            let back = |cell| warehouse.layout.free_neighbour(cell, heading.opposite());
            let Some(before) = back(cell).filter(|&before| !closed.is_closed(before)) else {
                continue;
            };
            if let Some(cell) = back(before) {
                return Pose { cell, heading };
            }
        }
    }
    panic!("no pose faces the barricade");
}

/// What is wrong with the image called `name`, if anything.
fn compare(name: &str, actual: &RgbaImage) -> Option<String> {
    let path = folder().join(format!("{name}.png"));
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        save(actual, &path);
        return None;
    }
    let golden = match RgbaImage::read(&path) {
        Ok(golden) => golden,
        Err(error) => return Some(format!("{error}; UPDATE_GOLDEN=1 writes it")),
    };
    let (width, height) = (actual.width(), actual.height());
    if [golden.width(), golden.height()] != [width, height] {
        return Some(format!("{name}: {actual:?} instead of {golden:?}"));
    }
    let mut difference = RgbaImage::filled(width, height, [0, 0, 0, 255]);
    let mut count = 0;
    for (i, (a, b)) in (0..).zip(actual.pixels().zip(golden.pixels())) {
        let off = a.iter().zip(b).map(|(a, b)| a.abs_diff(b)).max().unwrap_or(0);
        count += usize::from(off > CHANNEL_TOLERANCE);
        *difference.pixel_mut(i % width, i / width) = [off, off, off, 255];
    }
    let allowed = (width * height) as usize * PIXELS_PER_MILLE / 1000;
    if count <= allowed {
        return None;
    }
    let out = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (shown, drawn) =
        (out.join(format!("{name}-difference.png")), out.join(format!("{name}.png")));
    save(&difference, &shown);
    save(actual, &drawn);
    Some(format!(
        "{name}: {count} pixels differ, {allowed} may; see {} and {}; if the new image is right, \
         UPDATE_GOLDEN=1 makes it the reference",
        drawn.display(),
        shown.display()
    ))
}

fn save(image: &RgbaImage, path: &Path) {
    if let Err(error) = image.write(path) {
        panic!("cannot write {error}");
    }
}
