//! Whether the rule of [`warehouse::sight`] agrees with what is drawn.

use domain::camera::CameraSetup;
use domain::{Appearance, Cell, Heading, Mismatch, Pose};
use warehouse::{CaseSet, Elsewhere, GeneratedWorld, Item, Shape, Warehouse, sight};

use super::mesh::builder::Detail;
use super::mesh::items::item;
use super::{Backend, RenderSettings, Renderer};
use crate::first_views::{FirstView, first_views, shown_targets};
use warehouse::every_pose;

fn renderer(warehouse: &Warehouse) -> Renderer {
    Renderer::new(warehouse, settings()).unwrap()
}

fn settings() -> RenderSettings {
    RenderSettings {
        backend: Some(Backend::Cpu),
        appearance: Appearance::WITH_PLATES,
        ..RenderSettings::default()
    }
}

#[test]
fn items_beside_racks_and_behind_their_corners_are_drawn_where_the_rule_says() {
    let warehouse = Warehouse::shipped();
    let mut renderer = renderer(&warehouse);
    for (pose, standpoint, drawn, why) in [
        (Pose::new(12, 26, Heading::W), (12, 25), true, "through open bays, at the left border"),
        (Pose::new(1, 26, Heading::E), (4, 28), true, "past the corner of a rack, at the border"),
        (Pose::new(15, 13, Heading::N), (12, 20), false, "almost through open bays"),
        (Pose::new(12, 26, Heading::E), (12, 25), false, "behind one's back"),
        (Pose::new(12, 25, Heading::W), (12, 25), true, "in front of it"),
    ] {
        let item = warehouse.item_at(Cell::new(standpoint.0, standpoint.1)).unwrap();
        let pixels = renderer.pixels_of(pose, &[item]).unwrap();
        assert_eq!(pixels > 0, drawn, "{pose}, {why}: {pixels} pixels");
        let sees = sight::sees(&warehouse, CameraSetup::STANDARD, pose, item);
        assert_eq!(sees, drawn, "{pose}: {why}");
    }
}

/// Every 13th pose; `POSE_STEP=1` tests all of them and prints how many of the items in view are drawn.
#[test]
fn an_item_that_is_not_in_view_is_in_no_pixel() {
    let step = std::env::var("POSE_STEP").map_or(13, |step| step.parse().unwrap());
    let drawn = GeneratedWorld::generate(5, 20, 24, None).unwrap().warehouse;
    let cameras = [
        (Warehouse::shipped(), Mismatch::None),
        (Warehouse::shipped(), Mismatch::CameraHeight),
        (Warehouse::shipped(), Mismatch::FieldOfView),
        (drawn, Mismatch::None),
    ];
    for (warehouse, mismatch) in cameras {
        let camera = CameraSetup::of(mismatch);
        let mut renderer = Renderer::new(&warehouse, settings().with_mismatch(mismatch)).unwrap();
        let (mut in_view, mut drawn, mut fewest) = (0, 0, usize::MAX);
        for pose in every_pose(&warehouse.layout).step_by(step) {
            let (seen, unseen): (Vec<&Item>, Vec<&Item>) = warehouse
                .items
                .iter()
                .partition(|item| sight::sees(&warehouse, camera, pose, item));
            let pixels = renderer.pixels_of(pose, &unseen).unwrap();
            assert_eq!(pixels, 0, "{pose} shows an item that is not in view, {mismatch}");
            for item in seen.into_iter().filter(|_| step == 1) {
                let pixels = renderer.pixels_of(pose, &[item]).unwrap();
                (in_view, drawn) = (in_view + 1, drawn + usize::from(pixels > 0));
                fewest = if pixels > 0 { fewest.min(pixels) } else { fewest };
            }
        }
        if step == 1 {
            println!("{in_view} items in view, {drawn} drawn, the least in {fewest} pixels");
        }
    }
}

#[test]
fn every_mesh_fills_its_outline() {
    for shape in Shape::ALL {
        let [half_width, half_depth, cut] = shape.outline_cm().map(|cm| cm as f32 / 100.0);
        for detail in Detail::ALL {
            let mesh = item(shape, [200, 40, 40], detail);
            let most = |of: fn(f32, f32) -> f32| {
                let across = mesh.vertices.iter().map(|v| of(v.position.x, v.position.y));
                across.map(f32::abs).fold(0.0, f32::max)
            };
            // Corners may be rounder than the outline says.
            for (found, outline, slack) in [
                (most(|x, _| x), half_width, 0.02),
                (most(|_, y| y), half_depth, 0.02),
                (most(|x, y| x.abs() + y.abs()), half_width + half_depth - cut, 0.06),
            ] {
                let fits = found < outline + 1e-4;
                let fills = detail == Detail::Far || found > outline - slack;
                assert!(fits && fills, "{shape:?} {detail:?}: {found} of {outline}");
            }
        }
    }
}

/// 200 of the shipped cases, and 240 of worlds that are drawn, with the halls in which their tasks are demonstrated.
#[test]
fn no_first_view_shows_a_target() {
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
    let views = first_views(&warehouse, &cases);
    assert_eq!(views.len(), 200);
    assert_eq!(shown_targets(&warehouse, &views).unwrap(), [""; 0]);
    let mut count = 0;
    for (seed, width, height) in [(1, 16, 30), (2, 14, 16), (3, 24, 14), (4, 32, 32)] {
        let drawn = GeneratedWorld::generate(seed, width, height, None).unwrap().warehouse;
        let cases = CaseSet::generate(&drawn, seed, 20).unwrap();
        let other = Elsewhere::generate(&drawn, &cases, seed).unwrap();
        let elsewhere = (0..cases.cases.len()).filter_map(|case| {
            let (task, trajectory) = other.demonstration(case)?;
            let targets = task.targets(other.warehouse());
            Some(FirstView { of: format!("elsewhere {case}"), pose: trajectory.start, targets })
        });
        for (warehouse, views) in [
            (&drawn, first_views(&drawn, &cases)),
            (other.warehouse(), elsewhere.collect::<Vec<_>>()),
        ] {
            count += views.len();
            assert_eq!(shown_targets(warehouse, &views).unwrap(), [""; 0], "seed {seed}");
        }
    }
    assert_eq!(count, 240);
}
