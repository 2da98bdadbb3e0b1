//! What must hold for every picture: nothing visible is left out, the way out changes no byte, nor does
//! the batch, and label plates keep their colours.

use shm_types::{Heading, plate};

use super::*;

fn renderer(warehouse: &Warehouse, settings: RenderSettings) -> Renderer {
    match Renderer::new(warehouse, settings) {
        Ok(renderer) => renderer,
        Err(error) => panic!("{error}"),
    }
}

fn poses(warehouse: &Warehouse) -> Vec<Pose> {
    let cells = warehouse.layout.free_cells();
    cells.flat_map(|cell| Heading::ALL.map(|heading| Pose { cell, heading })).collect()
}

/// Draws a pose with the objects listed instead of those that culling finds.
fn drawn_with(renderer: &mut Renderer, pose: Pose, objects: Vec<u32>) -> image::RgbaImage {
    renderer.visible.insert(pose, objects);
    let image = renderer.render_image(View { pose, variant: &Variant::UNCHANGED }).unwrap();
    renderer.visible.remove(&pose);
    image
}

/// How many pixels differ. With DIFF_DIR set, the places are shown in a picture there.
fn differing(pose: Pose, a: &image::RgbaImage, b: &image::RgbaImage) -> usize {
    let count = a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count();
    if let (true, Ok(folder)) = (count > 0, std::env::var("DIFF_DIR")) {
        let mut shown = a.clone();
        for (shown, (a, b)) in shown.pixels_mut().zip(a.pixels().zip(b.pixels())) {
            let [r, g, b] = if a == b { [a[0] / 3, a[1] / 3, a[2] / 3] } else { [255, 255, 0] };
            *shown = image::Rgba([r, g, b, 255]);
        }
        shown.save(format!("{folder}/{pose}.png")).unwrap();
    }
    count
}

#[test]
fn leaving_out_what_is_hidden_changes_no_pixel_and_order_hardly_any() {
    let warehouse = Warehouse::shipped();
    let mut renderer = renderer(&warehouse, RenderSettings::default());
    let mut wrong = Vec::new();
    let step = std::env::var("POSE_STEP").map_or(13, |step| step.parse().unwrap());
    for pose in poses(&warehouse).into_iter().step_by(step) {
        let camera = Camera::new(pose, 448, 448);
        let all = visibility::nearest_first(&renderer.scene, &camera, |_| true);
        let backwards: Vec<u32> = all.iter().rev().copied().collect();
        let culled = visibility::visible(&renderer.scene, &camera);
        let culled = drawn_with(&mut renderer, pose, culled);
        let whole = drawn_with(&mut renderer, pose, all);
        let lost = differing(pose, &culled, &whole);
        if lost > 0 {
            wrong.push(format!("{pose}: {lost} pixels lost"));
        }
        // Surfaces in one plane would show here; single pixels are edges that meet.
        let whole_backwards = drawn_with(&mut renderer, pose, backwards);
        let fighting = differing(pose, &whole, &whole_backwards);
        if fighting > 12 {
            wrong.push(format!("{pose}: {fighting} pixels depend on the order of drawing"));
        }
    }
    assert!(wrong.is_empty(), "views that are wrong:\n{}", wrong.join("\n"));
}
