//! Demonstrations: what the expert saw, did and had achieved, step by step (SPEC section 4).
//!
//! A demonstration is stored as actions and replayed here by the warehouse's own dynamics. Its frames are
//! named by pose: demonstrations are walked in the unchanged world, where a pose has one view.

use shm_types::{Action, Pose};
use warehouse::{Case, Start, Warehouse};

/// One demonstration, acted out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Demonstration {
    /// Which of its case's demonstrations: 0 original, 1 opposite, 2 nearby, 3 distant.
    pub number: u16,
    /// Where the expert was after `t` steps.
    pub poses: Vec<Pose>,
    /// Sub-goals completed after `t` steps.
    pub stages: Vec<u32>,
    /// Action `t` leads from pose `t` to pose `t + 1`: one fewer than poses.
    pub actions: Vec<Action>,
}

/// The demonstrations of `case` that the bits of `selection` choose (bit i: number i), in order.
///
/// `None` when a bit stands for no demonstration.
pub fn selected(warehouse: &Warehouse, case: &Case, selection: u32) -> Option<Vec<Demonstration>> {
    if selection >> Start::DEMONSTRATIONS.len() != 0 {
        return None;
    }
    let chosen = (0..).zip(Start::DEMONSTRATIONS).filter(|(bit, _)| selection >> bit & 1 == 1);
    let demonstrations = chosen.map(|(number, start)| {
        let replay = case.replay(warehouse, start);
        Demonstration {
            number,
            poses: replay.poses,
            stages: replay.stages,
            actions: case.trajectory(start).actions.clone(),
        }
    });
    Some(demonstrations.collect())
}
