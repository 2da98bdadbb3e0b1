//! What an agent is shown in place of what it would see: the controls that prove results come from pixels.

use std::collections::HashMap;

use domain::{Heading, Pose};
use shm_types::FrameControl;
use warehouse::{Layout, Variant};

use crate::views::ViewKey;

/// Chooses the view that an observation shows.
#[derive(Debug)]
pub enum Control {
    /// What the agent sees.
    Rendered,
    /// Nothing.
    Blank,
    /// What it would see at the pose that follows its own in one cycle through all poses.
    Swapped(HashMap<Pose, Pose>),
}

impl Control {
    /// The control `kind` on the floor of `layout`.
    pub fn new(kind: FrameControl, layout: &Layout) -> Self {
        match kind {
            FrameControl::Rendered => Self::Rendered,
            FrameControl::Blank => Self::Blank,
            FrameControl::Swapped => Self::Swapped(successors(layout)),
        }
    }

    /// The view that an agent at `pose` is shown in world variant `number`, which is `variant`.
    pub fn shown(&self, number: u32, variant: &Variant, pose: Pose) -> ViewKey {
        let pose = match self {
            Self::Blank => return ViewKey::Blank,
            Self::Rendered => pose,
            Self::Swapped(successors) => {
                // Nobody can stand in a barricade, and nobody is shown the view from inside one.
                let next = |pose: &Pose| successors.get(pose).copied();
                let mut others = std::iter::successors(next(&pose), next);
                others.find(|other| !variant.is_closed(other.cell)).unwrap_or(pose)
            }
        };
        ViewKey::World { variant: number, pose }
    }
}

/// Every pose that an agent can have on an open floor.
pub fn every_pose(layout: &Layout) -> impl Iterator<Item = Pose> + '_ {
    layout.free_cells().flat_map(|cell| Heading::ALL.map(|heading| Pose { cell, heading }))
}

/// One cycle through every pose, in an order that has nothing to do with where poses lie: so no pose
/// follows itself.
fn successors(layout: &Layout) -> HashMap<Pose, Pose> {
    let mut order: Vec<(u64, Pose)> = (0..).map(scatter).zip(every_pose(layout)).collect();
    order.sort_unstable();
    let next = order.iter().cycle().skip(1);
    order.iter().zip(next).map(|(&(_, pose), &(_, next))| (pose, next)).collect()
}

/// A bijection on 64 bits that leaves nothing of the order (SplitMix64's finaliser).
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
    fn controls_show_the_view_nothing_or_another_view() {
        let Warehouse { layout, .. } = Warehouse::shipped();
        let shown = |kind, pose| Control::new(kind, &layout).shown(0, &Variant::UNCHANGED, pose);
        let pose = poses(&layout)[5];
        assert_eq!(shown(FrameControl::Rendered, pose), ViewKey::World { variant: 0, pose });
        assert_eq!(shown(FrameControl::Blank, pose), ViewKey::Blank);
        assert_ne!(shown(FrameControl::Swapped, pose), ViewKey::World { variant: 0, pose });
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
    fn nobody_is_shown_the_inside_of_a_barricade() {
        let Warehouse { layout, .. } = Warehouse::shipped();
        let control = Control::new(FrameControl::Swapped, &layout);
        for (case, number) in CaseSet::shipped().cases.iter().zip(1..) {
            let variant = Variant::closing(case.barricade.iter().copied());
            for pose in poses(&layout) {
                let ViewKey::World { variant: of, pose: other } =
                    control.shown(number, &variant, pose)
                else {
                    panic!("a view of the world")
                };
                assert!(of == number && other != pose && !variant.is_closed(other.cell));
            }
        }
    }
}
