//! What must hold for every picture: nothing visible is left out, the way out changes no byte, nor does
//! the batch, and label plates keep their colours.

use shm_types::Heading;

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

/// Draws these objects, instead of those that culling finds.
fn drawn_with(
    renderer: &mut Renderer,
    camera: &Camera,
    objects: &[u32],
    triangles: Triangles,
) -> image::RgbaImage {
    let list = DrawList::new(&renderer.scene, camera, objects, triangles);
    renderer.slots.clear();
    renderer.slots.push(&renderer.scene, &uniform(camera), &list, &[]);
    let mut image = image::RgbaImage::new(448, 448);
    renderer.draw(vec![&mut Destination::Memory(&mut image)]).unwrap();
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
    for pose in poses(&warehouse).into_iter().step_by(step).filter(|p| std::env::var("PX").map_or(true, |v| p.to_string() == v)) {
        let camera = Camera::new(pose, 448, 448);
        let all = visibility::nearest_first(&renderer.scene, &camera, |_| true);
        let backwards: Vec<u32> = all.iter().rev().copied().collect();
        let culled = visibility::visible(&renderer.scene, &camera);
        let culled = drawn_with(&mut renderer, &camera, &culled, Triangles::Facing);
        let whole = drawn_with(&mut renderer, &camera, &all, Triangles::All);
        if std::env::var("PX").is_ok() {
            let f = drawn_with(&mut renderer, &camera, &all, Triangles::Facing);
            println!("{pose} culled {:?} whole {:?} facing {:?}", culled.get_pixel(372, 248), whole.get_pixel(372, 248), f.get_pixel(372, 248));
            whole.save("/tmp/c/whole.png").unwrap();
        }
        let lost = differing(pose, &culled, &whole);
        if lost > 0 {
            wrong.push(format!("{pose}: {lost} pixels lost"));
        }
        // Surfaces in one plane would show here; single pixels are edges that meet.
        let whole_backwards = drawn_with(&mut renderer, &camera, &backwards, Triangles::All);
        let fighting = differing(pose, &whole, &whole_backwards);
        if fighting > 12 {
            wrong.push(format!("{pose}: {fighting} pixels depend on the order of drawing"));
        }
    }
    assert!(wrong.is_empty(), "views that are wrong:\n{}", wrong.join("\n"));
}

#[test]
#[ignore = "prints the scene's size"]
fn size_of_the_scene() {
    let warehouse = Warehouse::shipped();
    let scene = Scene::new(&warehouse);
    println!(
        "objects {} solid tris {} verts {}",
        scene.objects.len(),
        scene.solid.indices.len() / 3,
        scene.solid.vertices.len()
    );
    let (mut objects, mut tris, n) = (0, 0, poses(&warehouse).len());
    for pose in poses(&warehouse) {
        let seen = visibility::visible(&scene, &Camera::new(pose, 448, 448));
        objects += seen.len();
        tris += DrawList::new(&scene, &Camera::new(pose, 448, 448), &seen, Triangles::Facing)
            .solid
            .len()
            / 3;
    }
    let mut bins = [[0usize; 2]; 16];
    for pose in poses(&warehouse) {
        let camera = Camera::new(pose, 448, 448);
        for i in visibility::visible(&scene, &camera) {
            let o = &scene.objects[i as usize];
            let c = [(o.min[0] + o.max[0]) / 2.0 - camera.position.x, (o.min[1] + o.max[1]) / 2.0 - camera.position.y];
            let d = c[0] * camera.ahead.x + c[1] * camera.ahead.y;
            let t = DrawList::new(&scene, &camera, &[i], Triangles::Facing).solid.len() / 3;
            let b = &mut bins[(d / 2.0).max(0.0) as usize];
            b[usize::from(o.plate.is_empty())] += t;
        }
    }
    for (i, b) in bins.iter().enumerate() {
        println!("tris at {} m: stocked {} other {}", i * 2, b[0] / n, b[1] / n);
    }
    for shape in warehouse::Shape::ALL {
        let m = |d| crate::renderer::mesh::items::item(shape, [200; 3], d).indices.len() / 3;
        use crate::renderer::mesh::builder::Detail;
        println!("tris {shape:?}: {} {}", m(Detail::Near), m(Detail::Far));
    }
    println!("a view: objects {} tris {}", objects / n, tris / n);
}

fn cpu() -> f64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

#[test]
#[ignore = "experiment"]
fn where_time_goes() {
    let var = |name: &str| std::env::var(name).map_or(0, |v| v.parse::<u32>().unwrap());
    let (mode, size, samples) = (var("MODE"), var("SIZE"), var("SAMPLES"));
    let warehouse = Warehouse::shipped();
    let samples = if samples == 4 { Samples::Four } else { Samples::One };
    let mut r = renderer(&warehouse, RenderSettings { samples, width_px: size, height_px: size, ..Default::default() });
    let some: Vec<Pose> = poses(&warehouse).into_iter().step_by(7).collect();
    let mut memory = vec![0_u8; 802816 * 4 + 4096];
    let off = memory.as_ptr().align_offset(4096);
    let lists: Vec<_> = some.iter().map(|&pose| {
        let camera = Camera::new(pose, size, size);
        let mut seen = visibility::visible(&r.scene, &camera);
        match mode {
            0 => seen.clear(),
            1 => seen.retain(|&i| r.scene.objects[i as usize].plate.is_empty() && r.scene.objects[i as usize].max[2] < 0.1),
            2 => seen.retain(|&i| r.scene.objects[i as usize].plate.is_empty()),
            3 => seen.retain(|&i| !r.scene.objects[i as usize].plate.is_empty()),
            _ => {}
        }
        let mut list = DrawList::new(&r.scene, &camera, &seen, Triangles::Facing);
        match mode {
            5 => list.text.clear(),
            6 => { list.text.clear(); list.plate.clear() }
            7 => list.solid.clear(),
            8 => { list.solid.clear(); list.text.clear() }
            9 => { list.solid.clear(); list.plate.clear() }
            _ => {}
        }
        (camera, list)
    }).collect();
    let mut n = [0; 3];
    let rounds = 10;
    let start = cpu();
    for _ in 0..rounds {
    for (camera, list) in &lists {
        n[0] += list.solid.len() / 3; n[1] += list.plate.len() / 3; n[2] += list.text.len() / 3;
        r.slots.clear();
        r.slots.push(&r.scene, &uniform(camera), list, &[]);
        let l = r.frame_bytes();
        r.draw(vec![&mut Destination::Slot(&mut memory[off..off + l])]).unwrap();
    }
    }
    println!("samples {samples:?} size {size} mode {mode}: {:.2} ms {:?} x{}", (cpu() - start) * 1e3 / some.len() as f64 / rounds as f64, n.map(|n| n / some.len() / rounds), some.len() * rounds);
}
