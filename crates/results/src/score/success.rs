//! Success rate and success weighted by path length (SPEC section 7; paper, equation `eq:sr_spl`), over all
//! tasks and for each group of them.

use serde::Serialize;
use warehouse::TaskGroup;

use super::spread::{Spread, mean, percentage};
use super::trial::{Trial, Trials};

/// `SR = 100 / N * sum s_i`, in percent, of the `N` episodes of one run.
pub(super) fn success_rate(trials: &[&Trial<'_>]) -> Option<f64> {
    percentage(trials.iter().map(|trial| trial.is_success()))
}

/// `SPL = 1 / N * sum s_i * l_i / max(p_i, l_i)`, from 0 to 1, of the `N` episodes of one run. `p_i` are the
/// steps taken, `l_i` the length of the reference from the episode's start on its route; a failure adds 0.
pub(super) fn path_weighted(trials: &[&Trial<'_>]) -> Option<f64> {
    mean(trials.iter().map(|trial| trial.path_weight()))
}

/// The success rate of the tasks of one group (paper, table `tab:tasks`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GroupScore {
    /// The group's name.
    #[serde(serialize_with = "by_name")]
    pub group: TaskGroup,
    /// Success rate in percent over runs, of the group's episodes alone.
    pub sr: Spread,
}

fn by_name<S: serde::Serializer>(group: &TaskGroup, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(group.name())
}

/// The groups that have an episode.
pub(super) fn groups(trials: &Trials<'_>) -> Vec<GroupScore> {
    let rate = |group: TaskGroup| {
        trials.over_runs(|run| {
            let of = |trial: &&&Trial<'_>| trial.task.map(group_of) == Some(group);
            percentage(run.iter().filter(of).map(|trial| trial.is_success()))
        })
    };
    let scored = |group: TaskGroup| Some(GroupScore { group, sr: rate(group)? });
    TaskGroup::ALL.into_iter().filter_map(scored).collect()
}

/// The group of task `number` (SPEC section 3).
pub const fn group_of(number: u8) -> TaskGroup {
    match number {
        1 | 2 => TaskGroup::Basic,
        7 | 8 | 10 => TaskGroup::ReturnLoop,
        9 => TaskGroup::Revisit,
        _ => TaskGroup::MultiObject,
    }
}
