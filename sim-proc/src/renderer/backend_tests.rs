//! The two backends draw the same images but for rounding, and the CPU draws the same bytes with every vector width.

use domain::Appearance;
use raster::Level;
use warehouse::{CaseSet, Variant, Warehouse};

use super::*;
use warehouse::every_pose;

/// With plates, so that all three ways of colouring are compared.
fn renderer(warehouse: &Warehouse, settings: &RenderSettings, backend: Backend) -> Renderer {
    let (backend, appearance) = (Some(backend), Appearance::WITH_PLATES);
    Renderer::new(warehouse, RenderSettings { backend, appearance, ..settings.clone() }).unwrap()
}

/// Every 29th pose; `POSE_STEP=1` tests all of them. With `DIFF_DIR` set, both images are written there.
#[test]
fn both_backends_draw_the_same_images() {
    let warehouse = Warehouse::shipped();
    let step = std::env::var("POSE_STEP").map_or(29, |step| step.parse().unwrap());
    let mut wrong = Vec::new();
    for samples in [Samples::One, Samples::Four] {
        let settings = RenderSettings { samples, ..RenderSettings::default() };
        let mut cpu = renderer(&warehouse, &settings, Backend::Cpu);
        let mut wgpu = renderer(&warehouse, &settings, Backend::Wgpu);
        let mut worst = 0;
        for pose in every_pose(&warehouse.layout).step_by(step) {
            let view = ViewSpec { pose, variant: &Variant::UNCHANGED, stock: 0 };
            let (cpu, wgpu) = (cpu.render_image(view).unwrap(), wgpu.render_image(view).unwrap());
            let is_off =
                |(a, b): &([u8; 4], [u8; 4])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 8);
            let differ = cpu.pixels().zip(wgpu.pixels()).filter(is_off).count();
            worst = worst.max(differ);
            if differ > 800 {
                wrong.push(format!("{} samples, {pose}: {differ} pixels", samples.count()));
            }
            if let Ok(folder) = std::env::var("DIFF_DIR") {
                for (image, backend) in [(cpu, "cpu"), (wgpu, "wgpu")] {
                    let name = format!("{}-{pose}-{backend}.png", samples.count());
                    image.write(&std::path::Path::new(&folder).join(name)).unwrap();
                }
            }
        }
        println!("{} samples: at most {worst} pixels differ", samples.count());
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// All vector widths of this processor.
fn levels() -> Vec<Level> {
    let mut levels = vec![Level::baseline(), Level::new()];
    #[cfg(target_arch = "x86_64")]
    levels.extend(Level::new().as_avx2().map(Level::Avx2));
    levels
}

#[test]
fn neither_the_vector_width_nor_earlier_views_change_a_byte() {
    let warehouse = Warehouse::shipped();
    let blocked = Variant::closing(CaseSet::shipped().cases[0].barricade.iter().copied());
    let open = Variant::UNCHANGED;
    for samples in [Samples::One, Samples::Four] {
        let settings =
            RenderSettings { samples, width_px: 192, height_px: 126, ..RenderSettings::default() };
        let views: Vec<ViewSpec<'_>> = every_pose(&warehouse.layout)
            .step_by(61)
            .flat_map(|pose| [&open, &blocked].map(|variant| ViewSpec { pose, variant, stock: 0 }))
            .filter(|view| !view.variant.is_closed(view.pose.cell))
            .collect();
        let draw = |level: Level, views: &mut dyn Iterator<Item = &ViewSpec<'_>>| {
            let mut renderer = renderer(&warehouse, &settings, Backend::Cpu).with_level(level);
            views.map(|&view| renderer.render_image(view).unwrap()).collect::<Vec<RgbaImage>>()
        };
        let expected = draw(Level::new(), &mut views.iter());
        for level in levels() {
            let mut backwards = draw(level, &mut views.iter().rev());
            backwards.reverse();
            for ((view, expected), actual) in views.iter().zip(&expected).zip(&backwards) {
                assert!(expected == actual, "{} with {level:?}", view.pose);
            }
        }
    }
}
