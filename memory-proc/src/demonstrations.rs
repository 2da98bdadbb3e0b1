//! Demonstrations: what the expert saw, did and had achieved, step by step (SPEC section 4).
//!
//! A demonstration is stored as actions and replayed here by the warehouse's own dynamics. Its frames are
//! named by pose: demonstrations are walked in the unchanged world, where a pose has one view.

use shm_types::{Action, Pose};
use warehouse::{Case, Start, Warehouse};

/// One demonstration, acted out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Demonstration {
    /// Index of the case it belongs to.
    pub case: u32,
    /// Which of that case's demonstrations: 0 original, 1 opposite, 2 nearby, 3 distant.
    pub number: u16,
    /// Where the expert was after `t` steps.
    pub poses: Vec<Pose>,
    /// Sub-goals completed after `t` steps.
    pub stages: Vec<u32>,
    /// Action `t` leads from pose `t` to pose `t + 1`: one fewer than poses.
    pub actions: Vec<Action>,
}

/// The demonstrations of the case at `index` that the bits of `selection` choose (bit i: number i), in
/// order. `None` when there is no such case, or a bit stands for no demonstration.
pub fn selected(
    warehouse: &Warehouse,
    cases: &[Case],
    index: u32,
    selection: u32,
) -> Option<Vec<Demonstration>> {
    let case = cases.get(index as usize)?;
    if selection >> Start::DEMONSTRATIONS.len() != 0 {
        return None;
    }
    let chosen = (0..).zip(Start::DEMONSTRATIONS).filter(|(bit, _)| selection >> bit & 1 == 1);
    let demonstrations = chosen.map(|(number, start)| {
        let replay = case.replay(warehouse, start);
        Demonstration {
            case: index,
            number,
            poses: replay.poses,
            stages: replay.stages,
            actions: case.trajectory(start).actions.clone(),
        }
    });
    Some(demonstrations.collect())
}
