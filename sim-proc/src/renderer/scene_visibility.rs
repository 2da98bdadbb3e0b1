//! What a scene shows from each pose, computed once per pose without rendering.

use std::collections::HashMap;
use std::sync::Arc;

use domain::Pose;
use domain::camera::CameraSetup;
use raster::Placement;
use warehouse::{Layout, Variant};

use super::camera::Camera;
use super::job::ViewSpec;
use super::scene::{Scene, barricade_sides};
use super::visibility::VisibleSet;

/// Visible sets that are kept with other stocks than the first. With 8 KiB each they stay below 10 MiB.
const KEPT_SETS: usize = 1024;

/// A scene, and the visible sets of poses asked for so far: with the first stock all, with others the last ones.
#[derive(Clone)]
pub struct SceneVisibility {
    scene: Arc<Scene>,
    layout: Layout,
    camera: CameraSetup,
    size_px: [u32; 2],
    sets: HashMap<Pose, VisibleSet>,
    other_sets: HashMap<(u32, Pose), VisibleSet>,
}

/// Which changes of a world may be visible from a pose. Without those that are not, the view is the same, byte for byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VisibleChanges {
    /// Bays that hold something else than with the first stock.
    pub stock: bool,
    /// Barricades.
    pub barricades: bool,
}

impl SceneVisibility {
    /// For frames of this width and height.
    pub(super) fn new(
        scene: Scene,
        layout: Layout,
        camera: CameraSetup,
        size_px: [u32; 2],
    ) -> Self {
        let (sets, other_sets) = (HashMap::new(), HashMap::new());
        Self { scene: Arc::new(scene), layout, camera, size_px, sets, other_sets }
    }

    pub(super) fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Where the barricades of `variant` stand.
    pub(super) fn barricades(&self, variant: &Variant) -> Vec<Placement> {
        barricade_sides(&self.layout, variant)
    }

    /// The scene, the camera at `pose`, and what it sees with stock `stock`.
    pub(super) fn at_pose(&mut self, stock: u32, pose: Pose) -> (&Scene, Camera, &VisibleSet) {
        let camera = Camera::new(self.camera, pose, self.size_px);
        let scene = &*self.scene;
        let new = || VisibleSet::new(scene, &scene.stocks[stock as usize], &camera);
        let set = if stock == 0 {
            self.sets.entry(pose).or_insert_with(new)
        } else {
            if self.other_sets.len() >= KEPT_SETS {
                self.other_sets.clear();
            }
            self.other_sets.entry((stock, pose)).or_insert_with(new)
        };
        (scene, camera, set)
    }

    /// Which changes may be visible. Where none is, the frame equals that of the first stock without barricades:
    /// barricades cast no shadow, bays that have not changed are the same objects, and hidden triangles change no pixel.
    pub fn changes(&mut self, ViewSpec { pose, variant, stock }: ViewSpec<'_>) -> VisibleChanges {
        let shows_stock = stock != 0 && self.shows_stock(stock, pose);
        if variant.closed().is_empty() {
            return VisibleChanges { stock: shows_stock, barricades: false };
        }
        let sides = self.barricades(variant);
        let stock = if shows_stock { stock } else { 0 };
        let (scene, camera, set) = self.at_pose(stock, pose);
        let barricades =
            sides.into_iter().any(|side| set.may_show(&scene.barricade_at(side), &camera));
        VisibleChanges { stock: shows_stock, barricades }
    }

    /// Whether an object that only one of stock 0 and `stock` has may be visible with it.
    fn shows_stock(&mut self, stock: u32, pose: Pose) -> bool {
        let [first, other] = [0, stock].map(|stock| self.at_pose(stock, pose).2.objects.clone());
        let stocks = &self.scene.stocks;
        let pairs = stocks[0].objects.iter().zip(&stocks[stock as usize].objects);
        pairs
            .filter(|(before, after)| before != after)
            .any(|(before, after)| first.contains(before) || other.contains(after))
    }
}
