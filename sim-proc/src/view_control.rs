//! The frame controls: what lanes are shown instead of their true view, to prove that results come from pixels.

use std::collections::HashMap;

use domain::{Heading, Pose};
use shm_types::FrameControl;
use warehouse::{Layout, Variant};

use crate::view_cache::FrameKey;
use crate::worlds::WorldParts;

/// Chooses the view of an observation.
#[derive(Debug)]
pub enum ViewControl {
    /// The true view.
    Rendered,
    /// Uniform grey.
    Blank,
    /// The view from the next pose in a fixed cycle through all poses.
    Swapped(HashMap<Pose, Pose>),
}

impl ViewControl {
    /// The control `kind` on the floor of `layout`.
    pub fn new(kind: FrameControl, layout: &Layout) -> Self {
        match kind {
            FrameControl::Rendered => Self::Rendered,
            FrameControl::Blank => Self::Blank,
            FrameControl::Swapped => Self::Swapped(successors(layout)),
        }
    }

    /// The view that a lane at `pose` gets in `world`, whose closed passages are `variant`.
    pub fn view(&self, world: WorldParts, variant: &Variant, pose: Pose) -> FrameKey {
        let pose = match self {
            Self::Blank => return FrameKey::Blank,
            Self::Rendered => pose,
            Self::Swapped(successors) => {
                // No agent can stand inside a barricade, so views from there are skipped.
                let next = |pose: &Pose| successors.get(pose).copied();
                let mut others = std::iter::successors(next(&pose), next);
                others.find(|other| !variant.is_closed(other.cell)).unwrap_or(pose)
            }
        };
        FrameKey::WorldParts { world, pose }
    }
}

/// Every pose that an agent can have in the unchanged world.
pub fn every_pose(layout: &Layout) -> impl Iterator<Item = Pose> + '_ {
    layout.free_cells().flat_map(|cell| Heading::ALL.map(|heading| Pose { cell, heading }))
}

/// One cycle through all poses, in an order unrelated to where they lie. No pose follows itself.
fn successors(layout: &Layout) -> HashMap<Pose, Pose> {
    let mut order: Vec<(u64, Pose)> = (0..).map(scatter).zip(every_pose(layout)).collect();
    order.sort_unstable();
    let next = order.iter().cycle().skip(1);
    order.iter().zip(next).map(|(&(_, pose), &(_, next))| (pose, next)).collect()
}

/// A bijection on 64 bits that destroys the order (SplitMix64's finaliser).
fn scatter(index: u64) -> u64 {
    let mut z = index.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use warehouse::{CaseSet, Warehouse};

    use super::*;

    fn poses(layout: &Layout) -> Vec<Pose> {
        every_pose(layout).collect()
    }

    #[test]
    fn controls_choose_the_true_view_grey_or_another_view() {
        let Warehouse { layout, .. } = Warehouse::shipped();
        let shown = |kind, pose| {
            ViewControl::new(kind, &layout).view(WorldParts::UNCHANGED, &Variant::UNCHANGED, pose)
        };
        let pose = poses(&layout)[5];
        assert_eq!(
            shown(FrameControl::Rendered, pose),
            FrameKey::WorldParts { world: WorldParts::UNCHANGED, pose }
        );
        assert_eq!(shown(FrameControl::Blank, pose), FrameKey::Blank);
        assert_ne!(
            shown(FrameControl::Swapped, pose),
            FrameKey::WorldParts { world: WorldParts::UNCHANGED, pose }
        );
    }

    #[test]
    fn swapping_is_a_permutation_without_fixed_points_and_far_apart() {
        let Warehouse { layout, .. } = Warehouse::shipped();
        let successors = successors(&layout);
        let poses = poses(&layout);
        assert_eq!(successors.len(), poses.len());
        assert_eq!(successors.values().collect::<HashSet<_>>().len(), poses.len());
        assert!(successors.iter().all(|(pose, next)| pose != next));
        let near =
            successors.iter().filter(|(pose, next)| pose.cell.distance(next.cell) < 3).count();
        assert!(near * 10 < poses.len(), "{near} of {} stay near", poses.len());
    }

    #[test]
    fn no_view_is_from_inside_a_barricade() {
        let Warehouse { layout, .. } = Warehouse::shipped();
        let control = ViewControl::new(FrameControl::Swapped, &layout);
        for (case, closing) in CaseSet::shipped().cases.iter().zip(1..) {
            let world = WorldParts { stock: 0, closing };
            let variant = Variant::closing(case.barricade.iter().copied());
            for pose in poses(&layout) {
                let FrameKey::WorldParts { world: of, pose: other } =
                    control.view(world, &variant, pose)
                else {
                    panic!("a view of the world")
                };
                assert!(of == world && other != pose && !variant.is_closed(other.cell));
            }
        }
    }
}
