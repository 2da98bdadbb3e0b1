//! What must hold for the images of both backends: nothing visible is left out, neither the frame path nor the batch
//! changes a byte, label plates have exact colours, barricades are visible.

use std::path::Path;

use domain::camera::{CAMERA_HEIGHT_M, CameraSetup, focal_length_px};
use domain::{Appearance, Cell, Heading, Pose};
use plates::Plate;
use warehouse::{CaseSet, StockChange, Variant, WorldChange, WorldState, every_pose};

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

/// Settings with which everything is drawn that there is.
fn with_plates() -> RenderSettings {
    RenderSettings { appearance: Appearance::WITH_PLATES, ..RenderSettings::default() }
}

/// A renderer with each backend.
fn both(warehouse: &Warehouse) -> [Renderer; 2] {
    [Backend::Cpu, Backend::Wgpu].map(|backend| {
        let backend = Some(backend);
        renderer(warehouse, RenderSettings { backend, ..with_plates() })
    })
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
    for pose in every_pose(&warehouse.layout).step_by(step) {
        let camera = Camera::new(CameraSetup::STANDARD, pose, [SIDE_PX; 2]);
        let scene = renderer.visibility.scene();
        let stock = &scene.stocks[0];
        let all = nearest_first(scene, stock, &camera, |_| true);
        let backwards: Vec<u32> = all.iter().rev().copied().collect();
        let culled = VisibleSet::new(scene, stock, &camera).objects;
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
    let settings = RenderSettings { width_px: 192, height_px: 128, ..with_plates() };
    let settings = RenderSettings { backend: Some(Backend::Wgpu), ..settings };
    let mut direct = renderer(&warehouse, settings.clone());
    let mut copied = renderer(&warehouse, RenderSettings { force_copy: true, ..settings });
    assert!(matches!(copied.report().frame_path, FramePath::Copied { .. }));
    let open = Variant::UNCHANGED;
    let blocked = Variant::closing(CaseSet::shipped().cases[0].barricade.iter().copied());
    let views: Vec<ViewSpec<'_>> = every_pose(&warehouse.layout)
        .step_by(47)
        .zip([&open, &blocked].into_iter().cycle())
        .map(|(pose, variant)| ViewSpec { pose, variant, stock: 0 })
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
        let image = renderer
            .render_image(ViewSpec { pose, variant: &Variant::UNCHANGED, stock: 0 })
            .unwrap();
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
                    renderer
                        .visibility
                        .changes(ViewSpec { pose, variant: &closed, stock: 0 })
                        .barricades,
                    "{pose}"
                );
                let image =
                    renderer.render_image(ViewSpec { pose, variant: &closed, stock: 0 }).unwrap();
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
        for pose in every_pose(&warehouse.layout).filter(|pose| !variant.is_closed(pose.cell)) {
            views += 1;
            if !both[0].visibility.changes(ViewSpec { pose, variant, stock: 0 }).barricades {
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
                let blocked = renderer.render_image(ViewSpec { pose, variant, stock: 0 }).unwrap();
                let open = ViewSpec { pose, variant: &Variant::UNCHANGED, stock: 0 };
                let open = renderer.render_image(open).unwrap();
                let differing = differing(pose, &open, &blocked);
                assert_eq!(differing, 0, "{pose} with {:?} closed", variant.closed());
            }
        }
    }
}

/// Whether the middle of `cell` lies in the field of view, on an empty floor.
fn is_ahead(pose: Pose, cell: Cell) -> bool {
    let camera = Camera::new(CameraSetup::STANDARD, pose, [SIDE_PX; 2]);
    let (x, y) = cell.centre();
    let to = nalgebra::Vector3::new(x - camera.position.x, y - camera.position.y, 0.0);
    to.dot(&camera.right).abs() <= to.dot(&camera.ahead)
}

/// The shipped warehouse, and the same after `stock` has changed.
fn stocks(stock: Vec<StockChange>) -> [Warehouse; 2] {
    let base = Warehouse::shipped();
    let mut stock = stock;
    stock.sort_by_key(|change| change.standpoint);
    let state = WorldState::new(&base, &WorldChange { closed: Vec::new(), stock }).unwrap();
    [base, state.warehouse]
}

fn put(standpoint: Cell, item_type: Option<usize>) -> StockChange {
    StockChange { standpoint, item_type }
}

/// Standpoints of bays that are empty.
fn empty_bays(warehouse: &Warehouse) -> Vec<Cell> {
    let change = |cell| WorldChange { closed: Vec::new(), stock: vec![put(cell, None)] };
    let cells = warehouse.layout.free_cells();
    let empty = cells.filter(|&cell| warehouse.item_at(cell).is_none());
    empty.filter(|&cell| WorldState::new(warehouse, &change(cell)).is_ok()).collect()
}

/// The plate of the item that stands at `standpoint`, as it is read in a view from there.
fn plate_read(renderer: &mut Renderer, warehouse: &Warehouse, stock: u32, at: Cell) -> Vec<Plate> {
    let heading = Heading::ALL.into_iter().find(|&heading| {
        let rack = at.step(heading);
        rack.is_some_and(|rack| warehouse.layout.square(rack) == warehouse::Square::Rack)
    });
    let pose = Pose { cell: at, heading: heading.unwrap() };
    let view = ViewSpec { pose, variant: &Variant::UNCHANGED, stock };
    let image = renderer.render_image(view).unwrap();
    let sightings = plates::read(SIDE_PX, SIDE_PX, image.as_bytes());
    let ahead = sightings.iter().filter(|s| (s.ahead, s.right, s.face) == (0, 0, 0));
    ahead.map(|sighting| sighting.plate).collect()
}

#[test]
fn a_moved_item_is_seen_where_it_stands_now() {
    let base = Warehouse::shipped();
    let item = base.items[40];
    let to = empty_bays(&base)[7];
    let moved = stocks(vec![put(item.standpoint, None), put(to, Some(item.item_type))]);
    let kind = &base.catalogue.types[item.item_type];
    let plate = Plate::new(&base.catalogue.categories[kind.category].name, &kind.name);
    for backend in [Backend::Cpu, Backend::Wgpu] {
        let settings = RenderSettings { backend: Some(backend), ..with_plates() };
        let mut renderer = Renderer::with_stocks(&moved, settings).unwrap();
        let mut read = |stock, at| plate_read(&mut renderer, &base, stock, at);
        assert_eq!((read(0, item.standpoint), read(0, to)), (vec![plate], vec![]));
        assert_eq!((read(1, item.standpoint), read(1, to)), (vec![], vec![plate]));
    }
}

/// Every 29th pose, and those around the changes; `POSE_STEP=1` tests all of them.
#[test]
fn a_stock_looks_as_in_a_scene_of_its_own_and_nothing_else_changes() {
    let base = Warehouse::shipped();
    let (empty, items) = (empty_bays(&base), &base.items);
    let (a, b) = (items[10], items.iter().rev().find(|i| i.item_type != items[10].item_type));
    let b = *b.unwrap();
    let mut changes =
        vec![put(items[40].standpoint, None), put(empty[7], Some(items[40].item_type))];
    changes.extend([put(a.standpoint, Some(b.item_type)), put(b.standpoint, Some(a.item_type))]);
    // Bays at the ends of rows change how their neighbours end.
    let types = base.catalogue.types.len();
    let added = empty.iter().step_by(9).enumerate();
    changes.extend(added.map(|(n, &cell)| put(cell, Some(n * 5 % types))));
    changes.sort_by_key(|change| change.standpoint);
    changes.dedup_by_key(|change| change.standpoint);
    let near = |pose: &Pose| changes.iter().any(|c| c.standpoint.distance(pose.cell) <= 1);
    let step = std::env::var("POSE_STEP").map_or(29, |step| step.parse().unwrap());
    let all = every_pose(&base.layout).enumerate();
    let chosen: Vec<Pose> = all
        .filter(|(n, pose)| n % step == 0 || (n % 3 == 0 && near(pose)))
        .map(|(_, pose)| pose)
        .collect();
    let [base, changed] = stocks(changes.clone());
    let [_, other] = stocks(vec![put(items[3].standpoint, None), put(empty[2], Some(0))]);
    let with = |labels, stocks: &[Warehouse]| {
        let appearance = Appearance { labels, ..Appearance::WITH_PLATES };
        let backend = Some(Backend::Cpu);
        let settings = RenderSettings { backend, appearance, ..RenderSettings::default() };
        Renderer::with_stocks(stocks, settings).unwrap()
    };
    // Where text lies in the atlas changes its pixels a little, so a scene of its own has the same pixels without labels.
    let (base_alone, changed_alone) = ([base.clone()], [changed.clone()]);
    let mut one = with(true, &[base.clone(), changed.clone()]);
    let mut three = with(true, &[base.clone(), other, changed.clone()]);
    let mut unlabelled = with(false, &[base, changed]);
    let [mut base_alone, mut changed_alone] =
        [with(true, &base_alone), with(false, &changed_alone)];
    let (mut equal, mut different) = (0, 0);
    for &pose in &chosen {
        let image = |renderer: &mut Renderer, stock| {
            let view = ViewSpec { pose, variant: &Variant::UNCHANGED, stock };
            renderer.render_image(view).unwrap()
        };
        let (before, after) = (image(&mut one, 0), image(&mut one, 1));
        for (place, (a, b)) in [
            (&before, &image(&mut base_alone, 0)),
            (&after, &image(&mut three, 2)),
            (&image(&mut unlabelled, 1), &image(&mut changed_alone, 0)),
        ]
        .into_iter()
        .enumerate()
        {
            assert_eq!(differing(pose, a, b), 0, "{pose}: comparison {place}");
        }
        let view = ViewSpec { pose, variant: &Variant::UNCHANGED, stock: 1 };
        let pixels = differing(pose, &before, &after);
        if one.visibility.changes(view).stock {
            different += usize::from(pixels > 0);
        } else {
            assert_eq!(pixels, 0, "{pose} shows a change that was called invisible");
            equal += 1;
        }
    }
    println!("{equal} views are equal, {different} differ, of {}", chosen.len());
    assert!(equal > 5 && different > 20, "{equal} equal, {different} different");
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
    let view =
        ViewSpec { pose: Pose::new(2, 8, Heading::N), variant: &Variant::UNCHANGED, stock: 0 };
    let destination = Destination::Memory(&mut [0; 12]);
    let error = renderer.render(&mut [RenderJob { view, destination }]).unwrap_err().to_string();
    assert_eq!(error, "a frame takes 802816 bytes, but the destination of view 2,8,N has 12");
}
