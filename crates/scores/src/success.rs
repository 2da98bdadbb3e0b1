//! Success rate and success weighted by path length (specification, section 7; paper, equation `eq:sr_spl`), over
//! all tasks and for each group of them.

use domain::{TaskGroup, TaskType};
use serde::Serialize;

use super::mean::{mean, percentage};
use super::spread::Spread;
use super::trial::{Trials, path_weight};
use run_log::EpisodeRecord;

/// `SR = 100 / N * sum s_i`, in percent, of the `N` finished episodes of one run.
pub(super) fn success_rate(records: &[&EpisodeRecord]) -> Option<f64> {
    percentage(records.iter().map(|record| record.is_success()))
}

/// `SPL = 1 / N * sum s_i * l_i / max(p_i, l_i)`, from 0 to 1, of the `N` finished episodes of one run.
///
/// `p_i` is the number of steps taken, `l_i` the length of the reference from the episode's start on its route; a
/// failure adds 0. A success adds 1 if it is not longer than the reference, which need not be the shortest way: with
/// strafing there are ways as short as 1 / 1.56 of a reference.
pub(super) fn path_weighted(records: &[&EpisodeRecord]) -> Option<f64> {
    mean(records.iter().map(|record| path_weight(record)))
}

/// The success rate of the tasks of one group (paper, table `tab:tasks`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GroupScore {
    /// The group.
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
            let of_group =
                run.iter().filter(|record| record.task_type().map(TaskType::group) == Some(group));
            percentage(of_group.map(|record| record.is_success()))
        })
    };
    let scored = |group: TaskGroup| Some(GroupScore { group, sr: rate(group)? });
    TaskGroup::ALL.into_iter().filter_map(scored).collect()
}
