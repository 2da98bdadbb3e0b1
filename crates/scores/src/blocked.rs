//! What a blocked route does (specification, section 7; paper, equations `eq:change_retention` and
//! `eq:follow_recovery`): follow, recovery, change relative to working memory, retention.

use serde::Serialize;

use super::interval::Interval;
use super::mean::percentage;
use super::spread::Spread;
use run_log::EpisodeRecord;

/// The figures that exist on a blocked route only.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BlockedScore {
    /// F in percent, over runs.
    pub follow: Option<Spread>,
    /// C in percent, over the runs in which it is defined; `None` when it is in none.
    pub recovery: Option<Spread>,
    /// Percentage of the retrieved sources that are stale, over runs; absent where nothing was retrieved.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stale: Option<Spread>,
    /// Delta_r in percentage points. `None` when the unchanged route or working memory was not run on these cases.
    pub change: Option<Derived>,
    /// R_r, a fraction. `None` when the unchanged route was not run on these cases, or nothing succeeds there.
    pub retention: Option<Derived>,
}

/// A figure made of the success rates of several conditions on the cases that all of them have.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Derived {
    /// The figure, from the mean success rates over runs.
    pub value: f64,
    /// Its 95 % interval over the cases. `None` for a single case, for Delta of working memory, which is 0 by definition, and
    /// for R where so little succeeds on the unchanged route that it may be arbitrarily large.
    pub interval: Option<Interval>,
}

/// `F = 100 / N * sum b_i` of one run: the episodes that tried to enter a newly closed cell.
pub(super) fn follow(records: &[&EpisodeRecord]) -> Option<f64> {
    percentage(records.iter().filter_map(|record| record.had_conflict()))
}

/// `C = 100 * sum b_i s_i / sum b_i` of one run: the successes among those. Undefined, not zero, when no b_i is 1.
pub(super) fn recovery(records: &[&EpisodeRecord]) -> Option<f64> {
    let tried = records.iter().filter(|record| record.had_conflict() == Some(true));
    percentage(tried.map(|record| record.is_success()))
}

/// The percentage of the sources retrieved in one run that are stale: replayed on the blocked route, they do not complete their
/// task.
pub(super) fn stale(records: &[&EpisodeRecord]) -> Option<f64> {
    let blocked = records.iter().filter_map(|record| record.blocked);
    let (stale, all) = blocked.fold((0_u64, 0_u64), |(stale, all), blocked| {
        (stale + u64::from(blocked.stale), all + u64::from(blocked.retrievals))
    });
    (all > 0).then(|| 100.0 * stale as f64 / all as f64)
}

/// `Delta_r = (S_{r,blocked} - S_{r,unchanged}) - (S_{w,blocked} - S_{w,unchanged})`, where S are mean success
/// rates and w is working memory: negative when blocking costs more than it costs the baseline.
pub(super) fn change([blocked, unchanged, baseline_blocked, baseline_unchanged]: [f64; 4]) -> f64 {
    (blocked - unchanged) - (baseline_blocked - baseline_unchanged)
}

/// `R_r = S_{r,blocked} / S_{r,unchanged}`: the part of the success rate that is left. Undefined when there was
/// none.
pub(super) fn retention(blocked: f64, unchanged: f64) -> Option<f64> {
    (unchanged > 0.0).then(|| blocked / unchanged)
}
