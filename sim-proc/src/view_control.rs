//! The frame controls: what lanes are shown instead of their true view, to prove that results come from pixels.

use domain::Pose;
use shm_types::FrameControl;
use warehouse::{Layout, SwappedPoses, Variant};

pub use warehouse::every_pose;

use crate::view_cache::FrameKey;
use crate::worlds::WorldParts;

/// Chooses the views of observations, and those that memory asks for.
#[derive(Debug)]
pub enum ViewControl {
    /// The true view.
    Rendered,
    /// Uniform grey.
    Blank,
    /// Uniform grey, for memory as well.
    BlankAll,
    /// The view from another pose.
    Swapped(SwappedPoses),
}

impl ViewControl {
    /// The control `kind` on the floor of `layout`.
    pub fn new(kind: FrameControl, layout: &Layout) -> Self {
        match kind {
            FrameControl::Rendered => Self::Rendered,
            FrameControl::Blank => Self::Blank,
            FrameControl::BlankAll => Self::BlankAll,
            FrameControl::Swapped => Self::Swapped(SwappedPoses::new(layout)),
        }
    }

    /// The view that a lane at `pose` gets in `world`, whose closed passages are `variant`.
    pub fn view(&self, world: WorldParts, variant: &Variant, pose: Pose) -> FrameKey {
        match self {
            Self::Blank | Self::BlankAll => FrameKey::Blank,
            Self::Rendered => FrameKey::WorldParts { world, pose },
            Self::Swapped(swapped) => {
                FrameKey::WorldParts { world, pose: swapped.shown(variant, pose) }
            }
        }
    }

    /// The view from `pose` in `world` that memory gets.
    pub fn view_for_memory(&self, world: WorldParts, pose: Pose) -> FrameKey {
        match self {
            Self::BlankAll => FrameKey::Blank,
            Self::Rendered | Self::Blank | Self::Swapped(_) => FrameKey::WorldParts { world, pose },
        }
    }
}

#[cfg(test)]
mod tests {
    use warehouse::Warehouse;

    use super::*;

    #[test]
    fn controls_choose_the_true_view_grey_or_another_view() {
        let Warehouse { layout, .. } = Warehouse::shipped();
        let pose = every_pose(&layout).nth(5).unwrap();
        let world = WorldParts::UNCHANGED;
        let shown = |kind| {
            let control = ViewControl::new(kind, &layout);
            let seen = control.view(world, &Variant::UNCHANGED, pose);
            (seen, control.view_for_memory(world, pose))
        };
        let real = FrameKey::WorldParts { world, pose };
        assert_eq!(shown(FrameControl::Rendered), (real, real));
        assert_eq!(shown(FrameControl::Blank), (FrameKey::Blank, real));
        assert_eq!(shown(FrameControl::BlankAll), (FrameKey::Blank, FrameKey::Blank));
        let (seen, supplied) = shown(FrameControl::Swapped);
        assert!(seen != real && seen != FrameKey::Blank && supplied == real);
    }
}
