//! Success rate and success weighted by path length (specification, section 7; paper, equation `eq:sr_spl`), over
//! all tasks and for each group of them.

use case_book::{TaskGroupFacts, WorldFacts};
use serde::Serialize;

use super::condition::{cases, succeeded};
use super::interval::Interval;
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
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GroupScore {
    /// The name of the group.
    pub group: String,
    /// Success rate in percent over runs, of the group's episodes alone.
    pub sr: Spread,
}

/// The groups of `world` that have an episode.
pub(super) fn groups(trials: &Trials<'_>, world: &WorldFacts) -> Vec<GroupScore> {
    let rate = |group: &str| {
        let is_of = |record: &EpisodeRecord| world.group_of(record.task) == Some(group);
        let rate = trials.over_runs(|run| {
            let of_group = run.iter().filter(|record| is_of(record));
            percentage(of_group.map(|record| record.is_success()))
        })?;
        let units = cases(trials, |record| is_of(record).then(|| succeeded(record)));
        Some(rate.within(units.interval(Interval::PERCENT)))
    };
    let scored = |TaskGroupFacts { name, .. }: &TaskGroupFacts| {
        Some(GroupScore { sr: rate(name)?, group: name.clone() })
    };
    world.groups.iter().filter_map(scored).collect()
}
