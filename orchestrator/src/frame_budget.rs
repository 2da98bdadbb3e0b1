//! How many frames may be resident: as many as are useful, as far as shared memory and the machine have room.

use std::collections::{BTreeMap, BTreeSet};

use domain::{Cell, Pose, representation::Trajectories};
use shm_types::Attach;
use warehouse::{CaseSet, History, Warehouse};

use crate::plan::Episode;
use results::conditions::Route;

/// Free shared memory that is left to others.
const HEADROOM_BYTES: u64 = 64 << 20;

/// Share of the memory that programs can still have which frames may take beyond the least.
const SHARE_OF_MEMORY: f64 = 0.5;

/// What a run can use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Demand {
    /// Frames without which it cannot run: the views that live lanes refer to, and what the memory of one
    /// episode holds of its demonstrations.
    pub least: u32,
    /// Frames beyond which more are of no use: in addition every view of every world that is walked.
    pub most: u32,
}

/// Not even the least fits.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the run needs room for {least} frames, that is {needed} MiB of shared memory, and {free} MiB are free: \
     use fewer --lanes or a smaller --frame-size, or make it larger (in Docker with --shm-size)"
)]
pub struct NoRoom {
    least: u32,
    needed: u64,
    free: u64,
}

/// What `episodes` can use in lanes as `attach` has them, with a budget of `keyframes` for full-context
/// memory.
pub fn demand(
    attach: &Attach,
    warehouse: &Warehouse,
    cases: &CaseSet,
    episodes: &[Episode],
    keyframes: u32,
) -> Demand {
    let live = attach.lanes * (attach.window + 2);
    let mut views_of = BTreeMap::new();
    let remembered = episodes.iter().map(|episode| {
        let condition = episode.key.condition;
        let mut views = || {
            let set = (episode.case_index, condition.demonstrations);
            *views_of.entry(set).or_insert_with(|| {
                let histories = cases.histories(set.0, set.1).into_iter();
                let replay = |History { case, start }| cases.cases[case].replay(warehouse, start);
                let views: BTreeSet<Pose> = histories.flat_map(|h| replay(h).poses).collect();
                views.len() as u32
            })
        };
        match condition.memory.describe().trajectories {
            Trajectories::Nothing => 0,
            Trajectories::Whole => views().min(keyframes),
            Trajectories::Segment => views(),
        }
    });
    let remembered = remembered.max().unwrap_or(0);
    let blocked = episodes.iter().filter(|e| e.key.condition.route == Route::Blocked);
    let barricades: BTreeSet<&[Cell]> =
        blocked.map(|episode| &*cases.cases[episode.case_index].barricade).collect();
    let worlds = 1 + barricades.len() as u32;
    Demand { least: live + remembered, most: live + worlds * every_view(warehouse) }
}

/// Views of the unchanged warehouse.
pub fn every_view(warehouse: &Warehouse) -> u32 {
    4 * warehouse.layout.free_cells().count() as u32
}

/// The largest useful number of frames that fits into `free` bytes of shared memory and, beyond the least, into its
/// share of the `available` bytes of memory.
///
/// # Errors
/// When the least does not fit.
pub fn choose(attach: &Attach, demand: Demand, free: u64, available: u64) -> Result<u32, NoRoom> {
    let needed = |frames| Attach { frame_capacity: frames, ..attach.clone() }.shared_memory_bytes();
    let room = free.saturating_sub(HEADROOM_BYTES);
    let Demand { least, most } = demand;
    if needed(least) > room {
        let (needed, free) = ((needed(least) + HEADROOM_BYTES).div_ceil(1 << 20), free >> 20);
        return Err(NoRoom { least, needed, free });
    }
    let room = room.min((SHARE_OF_MEMORY * available as f64) as u64);
    // `fits` holds throughout; what is above `too_many` does not fit or is of no use.
    let (mut fits, mut too_many) = (least, most.max(least) + 1);
    while fits + 1 < too_many {
        let middle = fits + (too_many - fits) / 2;
        if needed(middle) <= room { fits = middle } else { too_many = middle }
    }
    Ok(fits)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use shm_types::message::{Role, WIRE_VERSION};
    use shm_types::{FrameControl, FrameSize, Wait};

    use super::*;
    use crate::plan::plan;

    fn attach() -> Attach {
        Attach {
            wire_version: WIRE_VERSION,
            prefix: "mt0_".to_owned(),
            generation: 1,
            orchestrator_pid: 1,
            participants: Role::CHILDREN.to_vec(),
            lanes: 4,
            window: 6,
            frame: FrameSize::DEFAULT,
            frame_capacity: 1,
            wait: Wait::default(),
            frame_control: FrameControl::Rendered,
            prompts: None,
            spans: None,
            root: PathBuf::new(),
        }
    }

    #[test]
    fn as_many_frames_as_are_useful_and_fit() {
        let demand = Demand { least: 100, most: 1000 };
        let bytes = |frames| Attach { frame_capacity: frames, ..attach() }.shared_memory_bytes();
        for frames in [100, 101, 500, 999, 1000] {
            let free = bytes(frames) + HEADROOM_BYTES;
            assert_eq!(choose(&attach(), demand, free, u64::MAX), Ok(frames));
            assert_eq!(choose(&attach(), demand, u64::MAX, 2 * bytes(frames)), Ok(frames));
        }
        assert_eq!(choose(&attach(), demand, u64::MAX, u64::MAX), Ok(1000));
        assert_eq!(choose(&attach(), demand, u64::MAX, 0), Ok(100), "the least it must have");
        let error = choose(&attach(), demand, 64 << 20, u64::MAX).unwrap_err().to_string();
        assert!(error.starts_with("the run needs room for 100 frames, that is"), "{error}");
    }

    #[test]
    fn what_an_episode_s_memory_holds_counts() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let needed = |conditions: &[&str]| {
            let is_blocked = conditions.iter().any(|written| written.contains("blocked"));
            let conditions: Vec<_> =
                conditions.iter().map(|written| (written.parse().unwrap(), 1)).collect();
            let ids: Vec<&str> = cases.cases.iter().map(|case| case.id.as_str()).collect();
            let episodes = plan(&conditions, &[0, 60], &ids, 1);
            let Demand { least, most } = demand(&attach(), &warehouse, &cases, &episodes, 40);
            // The two cases close different passages.
            let worlds = if is_blocked { 3 } else { 1 };
            assert_eq!(most, 32 + worlds * every_view(&warehouse));
            least - 32
        };
        let views = |set| needed(&[&format!("episodic/new/unchanged/{set}")]);
        assert_eq!(needed(&[]), 0);
        assert_eq!(needed(&["working/new/unchanged/none", "hybrid/new/unchanged/4"]), 0);
        assert_eq!(needed(&["full-context/new/unchanged/4"]), 40);
        assert_eq!(needed(&["full-context/new/blocked/4"]), 40);
        assert!(views("original") > 10 && views("original") < views("4"));
        assert!(views("4") > 40 && views("confusable") > views("original"));
        let all = ["episodic/new/unchanged/4", "full-context/new/unchanged/4"];
        assert_eq!(needed(&all), views("4"));
    }
}
