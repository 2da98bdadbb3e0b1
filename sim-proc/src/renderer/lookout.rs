//! What can be seen from where, found without drawing and kept.

use std::collections::HashMap;
use std::sync::Arc;

use domain::Pose;
use warehouse::{Layout, Variant};

use super::View;
use super::camera::Camera;
use super::scene::{Scene, barricade_sides};
use super::vertex::Placement;
use super::visibility::Sight;

/// Knows the scene, and what of it can be seen from each pose that has been asked about.
#[derive(Clone)]
pub struct Lookout {
    scene: Arc<Scene>,
    layout: Layout,
    width_px: u32,
    height_px: u32,
    sights: HashMap<Pose, Sight>,
}

impl Lookout {
    /// Over `scene`, in frames of this size.
    pub(super) fn new(scene: Scene, layout: Layout, (width_px, height_px): (u32, u32)) -> Self {
        Self { scene: Arc::new(scene), layout, width_px, height_px, sights: HashMap::new() }
    }

    /// What it looks over.
    pub(super) fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Where the barricades of `variant` stand.
    pub(super) fn barricades(&self, variant: &Variant) -> Vec<Placement> {
        barricade_sides(&self.layout, variant)
    }

    /// The scene, a camera at `pose`, and what that sees.
    pub(super) fn look(&mut self, pose: Pose) -> (&Scene, Camera, &Sight) {
        let camera = Camera::new(pose, self.width_px, self.height_px);
        let scene = &*self.scene;
        let sight = self.sights.entry(pose).or_insert_with(|| Sight::new(scene, &camera));
        (scene, camera, sight)
    }

    /// Whether a barricade may be in sight. Where none is, the view is that of the unchanged world, byte for
    /// byte: barricades cast no shadow, and what is hidden is drawn over nothing.
    pub fn may_show_barricade(&mut self, View { pose, variant }: View<'_>) -> bool {
        if variant.closed().is_empty() {
            return false;
        }
        let sides = self.barricades(variant);
        let (scene, camera, sight) = self.look(pose);
        sides.into_iter().any(|side| sight.may_show(&scene.barricade_at(side), &camera))
    }
}
