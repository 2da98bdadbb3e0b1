//! What a scene shows from each pose, computed once per pose without rendering.

use std::collections::HashMap;
use std::sync::Arc;

use domain::Pose;
use raster::Placement;
use warehouse::{Layout, Variant};

use super::camera::Camera;
use super::job::ViewSpec;
use super::scene::{Scene, barricade_sides};
use super::visibility::VisibleSet;

/// A scene, and the visible set of every pose asked for so far.
#[derive(Clone)]
pub struct SceneVisibility {
    scene: Arc<Scene>,
    layout: Layout,
    size_px: [u32; 2],
    sets: HashMap<Pose, VisibleSet>,
}

impl SceneVisibility {
    /// For frames of this width and height.
    pub(super) fn new(scene: Scene, layout: Layout, size_px: [u32; 2]) -> Self {
        Self { scene: Arc::new(scene), layout, size_px, sets: HashMap::new() }
    }

    pub(super) fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Where the barricades of `variant` stand.
    pub(super) fn barricades(&self, variant: &Variant) -> Vec<Placement> {
        barricade_sides(&self.layout, variant)
    }

    /// The scene, the camera at `pose`, and what it sees.
    pub(super) fn at_pose(&mut self, pose: Pose) -> (&Scene, Camera, &VisibleSet) {
        let [width_px, height_px] = self.size_px;
        let camera = Camera::new(pose, width_px, height_px);
        let scene = &*self.scene;
        let set = self.sets.entry(pose).or_insert_with(|| VisibleSet::new(scene, &camera));
        (scene, camera, set)
    }

    /// Whether a barricade may be visible. Where none is, the frame equals that of the unchanged world, byte for byte:
    /// barricades cast no shadow, and hidden triangles change no pixel.
    pub fn may_show_barricade(&mut self, ViewSpec { pose, variant }: ViewSpec<'_>) -> bool {
        if variant.closed().is_empty() {
            return false;
        }
        let sides = self.barricades(variant);
        let (scene, camera, set) = self.at_pose(pose);
        sides.into_iter().any(|side| set.may_show(&scene.barricade_at(side), &camera))
    }
}
