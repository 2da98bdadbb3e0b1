//! The control `swapped`: from every pose the view of another is shown.

use std::collections::HashMap;

use domain::{Heading, Pose};

use crate::dynamics::Variant;
use crate::layout::Layout;

pub use case_book::GREY_VARIANT;

/// For every pose, the one whose view is shown instead: the next in a fixed cycle through all poses.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SwappedPoses(HashMap<Pose, Pose>);

impl SwappedPoses {
    /// The cycle through the poses on the floor of `layout`, in an order unrelated to where they lie. No pose follows itself.
    pub fn new(layout: &Layout) -> Self {
        let mut order: Vec<(u64, Pose)> = (0..).map(scatter).zip(every_pose(layout)).collect();
        order.sort_unstable();
        let next = order.iter().cycle().skip(1);
        Self(order.iter().zip(next).map(|(&(_, pose), &(_, next))| (pose, next)).collect())
    }

    /// The pose whose view a lane at `pose` is shown in a world with the closed passages `variant`. No agent can stand inside a
    /// barricade, so views from there are skipped.
    pub fn shown(&self, variant: &Variant, pose: Pose) -> Pose {
        let next = |pose: &Pose| self.0.get(pose).copied();
        let mut others = std::iter::successors(next(&pose), next);
        others.find(|other| !variant.is_closed(other.cell)).unwrap_or(pose)
    }
}

/// Every pose that an agent can have in the unchanged world.
pub fn every_pose(layout: &Layout) -> impl Iterator<Item = Pose> + '_ {
    layout.free_cells().flat_map(|cell| Heading::ALL.map(|heading| Pose { cell, heading }))
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

    use super::*;
    use crate::case::CaseSet;
    use crate::world::Warehouse;

    #[test]
    fn swapping_is_a_permutation_without_fixed_points_and_far_apart() {
        let Warehouse { layout, .. } = Warehouse::shipped();
        let SwappedPoses(successors) = SwappedPoses::new(&layout);
        let poses: Vec<Pose> = every_pose(&layout).collect();
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
        let swapped = SwappedPoses::new(&layout);
        for case in &CaseSet::shipped().cases {
            let variant = Variant::closing(case.barricade.iter().copied());
            for pose in every_pose(&layout) {
                let other = swapped.shown(&variant, pose);
                assert!(other != pose && !variant.is_closed(other.cell));
            }
        }
    }
}
