//! What must hold for the images of both backends: nothing visible is left out, neither the frame path nor the batch
//! changes a byte, label plates have exact colours, barricades are visible.

use std::path::Path;

use domain::camera::{CAMERA_HEIGHT_M, focal_length_px};
use domain::{Heading, Pose};
use plates::Plate;
use warehouse::{CaseSet, Variant};

use super::camera::Camera;
use super::visibility::{VisibleSet, nearest_first};
use super::*;

const SIDE_PX: u32 = 448;

fn renderer(warehouse: &Warehouse, settings: RenderSettings) -> Renderer {
    match Renderer::new(warehouse, settings) {
        Ok(renderer) => renderer,
        Err(error) => panic!("{error}"),
    }
}

/// A renderer with each backend.
fn both(warehouse: &Warehouse) -> [Renderer; 2] {
    [Backend::Cpu, Backend::Wgpu].map(|backend| {
        let backend = Some(backend);
        renderer(warehouse, RenderSettings { backend, ..RenderSettings::default() })
    })
}

fn poses(warehouse: &Warehouse) -> Vec<Pose> {
    let cells = warehouse.layout.free_cells();
    cells.flat_map(|cell| Heading::ALL.map(|heading| Pose { cell, heading })).collect()
}

/// Draws these objects instead of the visible set.
fn draw_objects(
    renderer: &mut Renderer,
    camera: &Camera,
    objects: &[u32],
    triangles: Triangles,
) -> RgbaImage {
    let list = draw_list(renderer.visibility.scene(), camera, objects, triangles);
    let clip_from_world = camera.clip_from_world().into();
    renderer.draw_image(PreparedView { clip_from_world, list, barricades: Vec::new() }).unwrap()
}

/// How many pixels differ. With DIFF_DIR set, an image there shows which.
fn differing(pose: Pose, a: &RgbaImage, b: &RgbaImage) -> usize {
    let count = a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count();
    if let (true, Ok(folder)) = (count > 0, std::env::var("DIFF_DIR")) {
        let mut shown = a.clone();
        for (shown, (a, b)) in
            shown.as_bytes_mut().as_chunks_mut().0.iter_mut().zip(a.pixels().zip(b.pixels()))
        {
            let [r, g, b] = if a == b { [a[0] / 3, a[1] / 3, a[2] / 3] } else { [255, 255, 0] };
            *shown = [r, g, b, 255];
        }
        shown.write(&Path::new(&folder).join(format!("{pose}.png"))).unwrap();
    }
    count
}

/// Every 29th pose; `POSE_STEP=1` tests all of them.
#[test]
fn culling_changes_no_pixel_and_the_hall_has_no_holes() {
    let warehouse = Warehouse::shipped();
    let step = std::env::var("POSE_STEP").map_or(29, |step| step.parse().unwrap());
    for mut renderer in both(&warehouse) {
        let wrong = losses(&warehouse, &mut renderer, step);
        let backend = renderer.report().backend;
        assert!(wrong.is_empty(), "wrong with {backend}:\n{}", wrong.join("\n"));
    }
}

/// What is wrong with every `step`th pose.
fn losses(warehouse: &Warehouse, renderer: &mut Renderer, step: usize) -> Vec<String> {
    let mut wrong = Vec::new();
    for pose in poses(warehouse).into_iter().step_by(step) {
        let camera = Camera::new(pose, SIDE_PX, SIDE_PX);
        let all = nearest_first(renderer.visibility.scene(), &camera, |_| true);
        let backwards: Vec<u32> = all.iter().rev().copied().collect();
        let culled = VisibleSet::new(renderer.visibility.scene(), &camera).objects;
        assert!(culled.len() < all.len() / 2, "{pose}: culling left out too little");
        let culled = draw_objects(renderer, &camera, &culled, Triangles::Facing);
        let whole = draw_objects(renderer, &camera, &all, Triangles::All);
        let lost = differing(pose, &culled, &whole);
        if lost > 0 {
            wrong.push(format!("{pose}: {lost} pixels lost"));
        }
        // Coplanar surfaces would differ here. Single pixels are edges that meet.
        let whole_backwards = draw_objects(renderer, &camera, &backwards, Triangles::All);
        let fighting = differing(pose, &whole, &whole_backwards);
        if fighting > 12 {
            wrong.push(format!("{pose}: {fighting} pixels depend on the order of drawing"));
        }
        // A hole in the hall would show the background, as a few samples at distant corners do.
        let background = std::mem::replace(&mut renderer.background, [0.0; 3]);
        let holes = draw_objects(renderer, &camera, &all, Triangles::All);
        renderer.background = background;
        let holes = differing(pose, &whole, &holes);
        if holes > 4 {
            wrong.push(format!("{pose}: {holes} pixels show nothing"));
        }
    }
    wrong
}

/// Whole pages for `frames` frames, in memory that may be imported.
struct Pages {
    memory: Vec<u8>,
    offset: usize,
    stride: usize,
}

impl Pages {
    fn new(renderer: &Renderer, frames: usize) -> Self {
        let stride = renderer.frame_bytes().next_multiple_of(4096);
        let memory = vec![0; stride * frames + 4096];
        let offset = memory.as_ptr().align_offset(4096);
        Self { memory, offset, stride }
    }

    fn slots(&mut self) -> impl Iterator<Item = &mut [u8]> {
        self.memory[self.offset..].chunks_exact_mut(self.stride)
    }
}

#[test]
fn neither_the_frame_path_nor_the_batch_changes_a_byte() {
    let warehouse = Warehouse::shipped();
    let settings = RenderSettings { width_px: 192, height_px: 128, ..RenderSettings::default() };
    let settings = RenderSettings { backend: Some(Backend::Wgpu), ..settings };
    let mut direct = renderer(&warehouse, settings.clone());
    let mut copied = renderer(&warehouse, RenderSettings { force_copy: true, ..settings });
    assert!(matches!(copied.report().frame_path, FramePath::Copied { .. }));
    let open = Variant::UNCHANGED;
    let blocked = Variant::closing(CaseSet::shipped().cases[0].barricade.iter().copied());
    let views: Vec<ViewSpec<'_>> = poses(&warehouse)
        .into_iter()
        .step_by(47)
        .zip([&open, &blocked].into_iter().cycle())
        .map(|(pose, variant)| ViewSpec { pose, variant })
        .collect();
    let frame = direct.frame_bytes();
    let alone: Vec<RgbaImage> =
        views.iter().map(|&view| direct.render_image(view).unwrap()).collect();
    let copied_before = direct.report().bytes_copied;
    assert_eq!(copied_before as usize, frame * views.len(), "ordinary memory is copied once");

    // All at once, in another order, each into its slot.
    for renderer in [&mut direct, &mut copied] {
        let mut pages = Pages::new(renderer, views.len());
        let mut jobs: Vec<RenderJob<'_>> = views
            .iter()
            .rev()
            .zip(pages.slots())
            .map(|(&view, slot)| RenderJob { view, destination: Destination::Slot(slot) })
            .collect();
        renderer.render(&mut jobs).unwrap();
        for ((view, expected), slot) in views.iter().zip(&alone).rev().zip(pages.slots()) {
            assert!(slot[..frame] == *expected.as_bytes(), "{} differs", view.pose);
        }
        renderer.forget_imports();
    }
    if direct.report().frame_path == FramePath::Direct {
        assert_eq!(direct.report().bytes_copied, copied_before, "slots are not copied to");
    }
    assert_eq!(copied.report().bytes_copied as usize, frame * views.len());
}

#[test]
fn a_nearby_plate_has_exact_colours() {
    let warehouse = Warehouse::shipped();
    for mut renderer in both(&warehouse) {
        check_plates(&warehouse, &mut renderer);
    }
}

fn check_plates(warehouse: &Warehouse, renderer: &mut Renderer) {
    for item in warehouse.items.iter().step_by(5) {
        let kind = &warehouse.catalogue.types[item.item_type];
        let category = &warehouse.catalogue.categories[kind.category];
        let bands = Plate::new(&category.name, &kind.name).0;
        let pose = Pose { cell: item.standpoint, heading: item.viewing_heading() };
        let image = renderer.render_image(ViewSpec { pose, variant: &Variant::UNCHANGED }).unwrap();
        let scale = focal_length_px(SIDE_PX) / (0.5 - plates::FACE_OFFSET_M);
        let rgb = |right: f32, up: f32| {
            let centre = SIDE_PX as f32 / 2.0;
            let (x, y) = (centre + right * scale, centre - (up - CAMERA_HEIGHT_M) * scale);
            let [[r, g, b, _]] = *image.crop(x as u32, y as u32, 1, 1).as_bytes().as_chunks().0
            else {
                panic!("one pixel")
            };
            [r, g, b]
        };
        let inner = plates::SIZE_M - 2.0 * plates::FRAME_M;
        let top = plates::CENTRE_HEIGHT_M + inner / 2.0;
        for (row, band) in bands.into_iter().enumerate() {
            let expected = plates::BAND_RGB[usize::from(band)];
            for across in [-0.45, 0.0, 0.45] {
                for down in [0.1, 0.5, 0.9] {
                    let up = top - (row as f32 + down) * inner / plates::BANDS as f32;
                    assert_eq!(rgb(across * inner, up), expected, "{pose}: band {row}");
                }
            }
        }
        for side in [-1.0, 1.0] {
            let middle = side * (inner + plates::FRAME_M) / 2.0;
            assert_eq!(rgb(middle, plates::CENTRE_HEIGHT_M), plates::FRAME_RGB, "{pose}: frame");
        }
    }
}

#[test]
fn a_nearby_barricade_is_visible() {
    let warehouse = Warehouse::shipped();
    let mut seen = 0;
    let mut both = both(&warehouse);
    for (number, case) in CaseSet::shipped().cases.iter().step_by(9).enumerate() {
        let renderer = &mut both[number % 2];
        let closed = Variant::closing(case.barricade.iter().copied());
        for &cell in closed.closed() {
            for heading in Heading::ALL {
                // Two cells in front of it, facing it.
                let back = heading.opposite();
                let before = warehouse.layout.free_neighbour(cell, back);
                let stand = before.and_then(|cell| warehouse.layout.free_neighbour(cell, back));
                let Some(stand) = stand.filter(|_| !closed.is_closed(before.unwrap())) else {
                    continue;
                };
                let pose = Pose { cell: stand, heading };
                assert!(
                    renderer.visibility.may_show_barricade(ViewSpec { pose, variant: &closed }),
                    "{pose}"
                );
                let image = renderer.render_image(ViewSpec { pose, variant: &closed }).unwrap();
                let is_red = |p: &[u8; 4]| p[0] > 120 && p[1] < 60 && p[2] < 60;
                let middle = image.crop(112, 150, 224, 200);
                let red = middle.pixels().filter(is_red).count();
                assert!(red > 2500, "{pose}: only {red} red pixels where a barricade stands");
                seen += 1;
            }
        }
    }
    assert!(seen > 10, "only {seen} views of barricades");
}

/// 40 pairs of a barricade and a pose whose field of view contains it, hidden behind racks, and 8 where it lies elsewhere.
/// `POSE_STEP=1` tests all pairs.
#[test]
fn a_barricade_that_is_hidden_changes_no_byte() {
    let warehouse = Warehouse::shipped();
    let mut both = both(&warehouse);
    let mut barricades: Vec<Variant> = Vec::new();
    for case in CaseSet::shipped().cases {
        let variant = Variant::closing(case.barricade);
        if !barricades.contains(&variant) {
            barricades.push(variant);
        }
    }
    let (mut ahead, mut elsewhere, mut views) = (Vec::new(), Vec::new(), 0);
    for (number, variant) in barricades.iter().enumerate() {
        for pose in poses(&warehouse).into_iter().filter(|pose| !variant.is_closed(pose.cell)) {
            views += 1;
            if !both[0].visibility.may_show_barricade(ViewSpec { pose, variant }) {
                let is_ahead = variant.closed().iter().any(|&cell| is_ahead(pose, cell));
                if is_ahead { &mut ahead } else { &mut elsewhere }.push((number, pose));
            }
        }
    }
    let hidden = ahead.len() + elsewhere.len();
    assert!(10 * hidden > 8 * views, "{hidden} of {views} views show no barricade");
    for (hidden, count) in [(ahead, 40), (elsewhere, 8)] {
        let step = hidden.len().div_ceil(count);
        let step = std::env::var("POSE_STEP").map_or(step, |step| step.parse().unwrap());
        for (number, pose) in hidden.into_iter().step_by(step) {
            let variant = &barricades[number];
            for renderer in &mut both {
                let blocked = renderer.render_image(ViewSpec { pose, variant }).unwrap();
                let open = ViewSpec { pose, variant: &Variant::UNCHANGED };
                let open = renderer.render_image(open).unwrap();
                let differing = differing(pose, &open, &blocked);
                assert_eq!(differing, 0, "{pose} with {:?} closed", variant.closed());
            }
        }
    }
}

/// Whether the middle of `cell` lies in the field of view, on an empty floor.
fn is_ahead(pose: Pose, cell: domain::Cell) -> bool {
    let camera = Camera::new(pose, SIDE_PX, SIDE_PX);
    let (x, y) = cell.centre();
    let to = nalgebra::Vector3::new(x - camera.position.x, y - camera.position.y, 0.0);
    to.dot(&camera.right).abs() <= to.dot(&camera.ahead)
}

#[test]
fn unusable_settings_are_refused_with_a_reason() {
    let warehouse = Warehouse::shipped();
    let refused = |settings| Renderer::new(&warehouse, settings).err().unwrap().to_string();
    let odd = RenderSettings { width_px: 450, ..RenderSettings::default() };
    assert!(refused(odd).contains("multiple of 64"));
    let named = RenderSettings { adapter: Some("abacus".into()), ..RenderSettings::default() };
    assert!(
        refused(named.clone())
            .contains("no Vulkan adapter's name contains \"abacus\"; there are: ")
    );
    let both = RenderSettings { backend: Some(Backend::Cpu), ..named };
    assert!(refused(both).contains("which --backend cpu does not use"));

    let mut renderer = renderer(&warehouse, RenderSettings::default());
    let view = ViewSpec { pose: Pose::new(2, 8, Heading::N), variant: &Variant::UNCHANGED };
    let destination = Destination::Memory(&mut [0; 12]);
    let error = renderer.render(&mut [RenderJob { view, destination }]).unwrap_err().to_string();
    assert_eq!(error, "a frame takes 802816 bytes, but the destination of view 2,8,N has 12");
}
