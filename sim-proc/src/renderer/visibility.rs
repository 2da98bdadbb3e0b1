//! The set of objects that a camera may see. It is conservative: leaving the rest out changes no pixel.
//!
//! All cameras are below the racks' top, and the racks' panels reach from the floor to that top. So
//! whether an object no taller than a rack is hidden is a question about the floor plan. Panels are drawn into a
//! one-dimensional depth buffer over the image's columns, and an object is left out when it lies behind the buffer in
//! every column that it could touch. Taller objects are only tested against the edges of the image.

use std::ops::Range;

use raster::DrawList;

use super::camera::Camera;
use super::mesh::rack::RACK_HEIGHT_M;
use super::scene::{Occluder, Scene, SceneObject, StockObjects};

/// Columns of the depth buffer: several per pixel at common sizes.
const COLUMNS: usize = 2048;

/// Columns by which an object is widened on each side, because a panel that covers the middle of a column counts for all
/// of it.
const MARGIN_COLUMNS: usize = 2;

/// Everything nearer than this, in metres, counts as visible.
const NEAR_M: f32 = 0.1;

/// Objects at least this far ahead, in metres, are drawn with less detail.
const FAR_M: f32 = 3.2;

/// The sine of the angle below which a triangle is seen nearly edge-on. Whether such a triangle shows its front is left
/// to the backend, which rounds its corners to a grid.
const EDGE_ON: f32 = 0.005;

/// How far panels are extended at their ends, so that rounding opens no gap between two that meet.
const JOINT_M: f32 = 0.002;

/// What a camera may see.
#[derive(Clone)]
pub(super) struct VisibleSet {
    /// Indices of the scene's objects, nearest first.
    pub(super) objects: Vec<u32>,
    columns: Columns,
}

impl VisibleSet {
    /// What `camera` may see of `scene` with one of its stocks.
    pub(super) fn new(scene: &Scene, stock: &StockObjects, camera: &Camera) -> Self {
        let columns = Columns::new(&stock.occluders, camera);
        let objects =
            nearest_first(scene, stock, camera, |object| columns.may_show(object, camera));
        Self { objects, columns }
    }

    /// Whether `camera`, for which this set was computed, may see an object that is not part of the scene.
    pub(super) fn may_show(&self, object: &SceneObject, camera: &Camera) -> bool {
        self.columns.may_show(object, camera)
    }
}

/// Indices of the objects of `stock` that `keep` accepts, nearest first. Of two surfaces at exactly the same depth the first
/// one drawn wins, so the order must not depend on what is kept.
pub(super) fn nearest_first(
    scene: &Scene,
    stock: &StockObjects,
    camera: &Camera,
    keep: impl Fn(&SceneObject) -> bool,
) -> Vec<u32> {
    let objects = stock.objects.iter().map(|&index| (index, &scene.objects[index as usize]));
    let mut keyed: Vec<(f32, usize, u32)> = objects
        .enumerate()
        .filter(|(_, (_, object))| keep(object))
        .map(|(place, (index, object))| {
            let depths = footprint(object, camera).map(|corner| corner[1]);
            (depths.into_iter().fold(f32::INFINITY, f32::min), place, index)
        })
        .collect();
    keyed.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    keyed.into_iter().map(|(_, _, index)| index).collect()
}

/// The corners of an object's bounds on the floor plan, in camera space.
fn footprint(object: &SceneObject, camera: &Camera) -> [[f32; 2]; 4] {
    let (min, max) = (object.min, object.max);
    [[min[0], min[1]], [max[0], min[1]], [max[0], max[1]], [min[0], max[1]]]
        .map(|corner| in_camera(camera, corner))
}

/// Which triangles of the objects to draw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Triangles {
    /// All of them. The backend culls those that show their back.
    #[cfg(test)]
    All,
    /// Those that do not show their back, about half.
    Facing,
}

/// The triangles of `objects`, in their order.
pub(super) fn draw_list(
    scene: &Scene,
    camera: &Camera,
    objects: &[u32],
    triangles: Triangles,
) -> DrawList {
    let objects = objects.iter().map(|&index| &scene.objects[index as usize]);
    draw_list_of(scene, camera, objects, triangles)
}

/// As [`draw_list`], for objects whose triangles are among those of the scene.
pub(super) fn draw_list_of<'o>(
    scene: &Scene,
    camera: &Camera,
    objects: impl Iterator<Item = &'o SceneObject>,
    triangles: Triangles,
) -> DrawList {
    let geometry = &scene.geometry;
    let mut list = DrawList::default();
    for object in objects {
        let depths = footprint(object, camera).map(|corner| corner[1]);
        let nearest = depths.into_iter().fold(f32::INFINITY, f32::min);
        let solid = if nearest < FAR_M { object.near.clone() } else { object.far.clone() };
        match triangles {
            #[cfg(test)]
            Triangles::All => list.solid.extend_from_slice(&geometry.solid.indices[solid]),
            Triangles::Facing => {
                add_facing(&mut list.solid, scene, camera, solid, reach(object, camera));
            }
        }
        list.plate.extend_from_slice(&geometry.plate.indices[object.plate.clone()]);
        list.text.extend_from_slice(&geometry.text.indices[object.text.clone()]);
    }
    list
}

/// Adds those of the lit triangles `solid`, all within `reach` metres, that do not show their back.
fn add_facing(
    list: &mut Vec<u32>,
    scene: &Scene,
    camera: &Camera,
    solid: Range<usize>,
    reach: f32,
) {
    let [x, y, z]: [f32; 3] = camera.position.into();
    let limit = -EDGE_ON * reach;
    let planes = &scene.planes[solid.start / 3..solid.end / 3];
    for (corners, plane) in scene.geometry.solid.indices[solid].chunks_exact(3).zip(planes) {
        if plane[0] * x + plane[1] * y + plane[2] * z - plane[3] > limit {
            list.extend_from_slice(corners);
        }
    }
}

/// The distance from the camera to the farthest corner of an object's bounds, in metres.
fn reach(object: &SceneObject, camera: &Camera) -> f32 {
    let axis = |i: usize| {
        let at = camera.position[i];
        (at - object.min[i]).abs().max((object.max[i] - at).abs())
    };
    (0..3).map(|i| axis(i) * axis(i)).sum::<f32>().sqrt()
}

/// A point of the floor plan in camera space: to the right and ahead, in metres.
fn in_camera(camera: &Camera, [x, y]: [f32; 2]) -> [f32; 2] {
    let (dx, dy) = (x - camera.position.x, y - camera.position.y);
    let along = |axis: &nalgebra::Vector3<f32>| dx * axis.x + dy * axis.y;
    [along(&camera.right), along(&camera.ahead)]
}

/// What an object may cover: columns of the image (-1 to 1), from a depth on.
struct CoveredSpan {
    left: f32,
    right: f32,
    nearest: f32,
}

impl CoveredSpan {
    /// `None` when the object is outside the image.
    fn of(object: &SceneObject, camera: &Camera) -> Option<Self> {
        let (min, max) = (object.min, object.max);
        let corners = footprint(object, camera);
        let [across, up] = camera.half_extent;
        let nearest = corners.iter().map(|c| c[1]).fold(f32::INFINITY, f32::min);
        let farthest = corners.iter().map(|c| c[1]).fold(f32::NEG_INFINITY, f32::max);
        let outside = |side: f32| corners.iter().all(|c| side * c[0] > across * c[1]);
        // Above or below the image even at the object's far end.
        let (bottom, top) = (min[2] - camera.position.z, max[2] - camera.position.z);
        let beyond = bottom > up * farthest || top < -up * farthest;
        if farthest <= 0.0 || outside(1.0) || outside(-1.0) || beyond {
            return None;
        }
        if nearest < NEAR_M {
            return Some(Self { left: -1.0, right: 1.0, nearest });
        }
        let columns = corners.map(|[right, ahead]| right / ahead / across);
        Some(Self {
            left: columns.into_iter().fold(1.0, f32::min),
            right: columns.into_iter().fold(-1.0, f32::max),
            nearest,
        })
    }
}

/// The reciprocal of the depth of the nearest panel in each column; 0 where there is none.
#[derive(Clone)]
struct Columns(Vec<f32>);

impl Columns {
    fn new(occluders: &[Occluder], camera: &Camera) -> Self {
        let mut columns = Self(vec![0.0; COLUMNS]);
        for occluder in occluders {
            columns.add(occluder, camera);
        }
        columns
    }

    /// Adds a panel to the columns whose middle it covers.
    fn add(&mut self, occluder: &Occluder, camera: &Camera) {
        let mut ends = [occluder.from, occluder.to].map(|end| in_camera(camera, end));
        let along = [ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]];
        let length = along[0].hypot(along[1]);
        for (end, sign) in ends.iter_mut().zip([-1.0, 1.0]) {
            for axis in 0..2 {
                end[axis] += sign * JOINT_M * along[axis] / length;
            }
        }
        // Clip what is behind the camera.
        if ends[0][1] > ends[1][1] {
            ends.swap(0, 1);
        }
        let [near, far] = ends;
        if far[1] <= NEAR_M {
            return;
        }
        if near[1] < NEAR_M {
            let share = (NEAR_M - near[1]) / (far[1] - near[1]);
            ends[0] = [near[0] + (far[0] - near[0]) * share, NEAR_M];
        }
        // The reciprocal of the depth along a straight panel is linear across the image.
        let mut projected =
            ends.map(|[right, ahead]| [right / ahead / camera.half_extent[0], 1.0 / ahead]);
        if projected[0][0] > projected[1][0] {
            projected.swap(0, 1);
        }
        let [[x0, w0], [x1, w1]] = projected;
        let first = (column(x0) + 0.5).floor().max(0.0) as usize;
        let end = ((column(x1) + 0.5).floor().max(0.0) as usize).min(COLUMNS);
        let Some(covered) = self.0.get_mut(first..end) else { return };
        for (column, i) in covered.iter_mut().zip(first as u32..) {
            let x = (i as f32 + 0.5) / COLUMNS as f32 * 2.0 - 1.0;
            let w = w0 + (w1 - w0) * ((x - x0) / (x1 - x0)).clamp(0.0, 1.0);
            *column = column.max(w);
        }
    }

    /// Whether any part of `object` may be visible.
    fn may_show(&self, object: &SceneObject, camera: &Camera) -> bool {
        let Some(span) = CoveredSpan::of(object, camera) else { return false };
        object.max[2] > RACK_HEIGHT_M || !self.hide(&span)
    }

    /// Whether panels hide the whole span.
    fn hide(&self, span: &CoveredSpan) -> bool {
        if span.nearest < NEAR_M {
            return false;
        }
        let first = (column(span.left).floor().max(0.0) as usize).saturating_sub(MARGIN_COLUMNS);
        let end = ((column(span.right).ceil().max(0.0) as usize) + MARGIN_COLUMNS).min(COLUMNS);
        // A panel's depth at the middle of a column differs slightly from that at its edges.
        let limit = 1.0 / span.nearest * 1.01;
        first < end && self.0[first..end].iter().all(|&w| w > limit)
    }
}

/// The column, counted from the left edge, at `x` (-1 to 1).
fn column(x: f32) -> f32 {
    (x + 1.0) / 2.0 * COLUMNS as f32
}
