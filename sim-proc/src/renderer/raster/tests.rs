//! The processor's pictures: a card's but for rounding, and the same bytes with vectors of every width.

use domain::{Heading, Pose};
use fearless_simd::Level;
use image::RgbaImage;
use warehouse::{CaseSet, Variant, Warehouse};

use super::super::{Hand, PROCESSOR, Renderer, View};
use super::*;

fn poses(warehouse: &Warehouse) -> Vec<Pose> {
    let cells = warehouse.layout.free_cells();
    cells.flat_map(|cell| Heading::ALL.map(|heading| Pose { cell, heading })).collect()
}

fn renderer(warehouse: &Warehouse, settings: &RenderSettings, adapter: &str) -> Renderer {
    let adapter = Some(adapter.to_owned());
    Renderer::new(warehouse, RenderSettings { adapter, ..settings.clone() }).unwrap()
}

/// Every 29th pose; `POSE_STEP=1` looks at all of them. With `DIFF_DIR` set, both pictures are kept there.
#[test]
fn pictures_are_those_of_a_card() {
    let warehouse = Warehouse::shipped();
    let step = std::env::var("POSE_STEP").map_or(29, |step| step.parse().unwrap());
    let mut wrong = Vec::new();
    for samples in [Samples::One, Samples::Four] {
        let settings = RenderSettings { samples, ..RenderSettings::default() };
        let mut ours = renderer(&warehouse, &settings, PROCESSOR);
        let mut theirs = renderer(&warehouse, &settings, "");
        let mut worst = 0;
        for pose in poses(&warehouse).into_iter().step_by(step) {
            let view = View { pose, variant: &Variant::UNCHANGED };
            let (ours, theirs) =
                (ours.render_image(view).unwrap(), theirs.render_image(view).unwrap());
            let off = |(a, b): (&image::Rgba<u8>, &image::Rgba<u8>)| {
                (0..4).map(|i| a[i].abs_diff(b[i])).max().unwrap() > 8
            };
            let differ = ours.pixels().zip(theirs.pixels()).filter(|&pair| off(pair)).count();
            worst = worst.max(differ);
            if differ > 800 {
                wrong.push(format!("{} samples, {pose}: {differ} pixels", samples.count()));
            }
            if let Ok(folder) = std::env::var("DIFF_DIR") {
                let name = |what| format!("{folder}/{}-{pose}-{what}.png", samples.count());
                ours.save(name("ours")).unwrap();
                theirs.save(name("theirs")).unwrap();
            }
        }
        println!("{} samples: at most {worst} pixels differ", samples.count());
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Vectors of every width that this processor has.
fn levels() -> Vec<Level> {
    let mut levels = vec![Level::baseline(), Level::new()];
    #[cfg(target_arch = "x86_64")]
    levels.extend(Level::new().as_avx2().map(Level::Avx2));
    levels
}

#[test]
fn neither_instructions_nor_what_was_drawn_before_change_a_byte() {
    let warehouse = Warehouse::shipped();
    let blocked = Variant::closing(CaseSet::shipped().cases[0].barricade.iter().copied());
    let open = Variant::UNCHANGED;
    for samples in [Samples::One, Samples::Four] {
        let settings =
            RenderSettings { samples, width_px: 192, height_px: 126, ..RenderSettings::default() };
        let views: Vec<View<'_>> = poses(&warehouse)
            .into_iter()
            .step_by(61)
            .flat_map(|pose| [&open, &blocked].map(|variant| View { pose, variant }))
            .filter(|view| !view.variant.is_closed(view.pose.cell))
            .collect();
        let drawn = |level: Level, views: &mut dyn Iterator<Item = &View<'_>>| {
            let mut renderer = renderer(&warehouse, &settings, PROCESSOR);
            let Hand::Raster(raster) = &mut renderer.hand else { panic!("not the processor") };
            raster.level = level;
            views.map(|&view| renderer.render_image(view).unwrap()).collect::<Vec<RgbaImage>>()
        };
        let expected = drawn(Level::new(), &mut views.iter());
        for level in levels() {
            let mut backwards = drawn(level, &mut views.iter().rev());
            backwards.reverse();
            for ((view, expected), actual) in views.iter().zip(&expected).zip(&backwards) {
                assert!(expected == actual, "{} with {level:?}", view.pose);
            }
        }
    }
}
