//! Time of a step by stage. Not a result: times depend on machine, lanes and chance.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use domain::MemoryKind;
use run_log::{EpisodeTimings, RunLog, Stages};

/// Mean time of a step by stage, in microseconds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageTimes {
    /// All stages together: from a command to the next one.
    pub sum: f64,
    /// The stages that there are, in order, by the names of [`Stages::NAMES`].
    pub stages: Vec<(&'static str, f64)>,
}

impl StageTimes {
    /// Means over all steps of the episodes, of the stages that `exists` names. `None` when nothing was timed.
    pub fn of<'a>(
        timings: impl IntoIterator<Item = &'a EpisodeTimings>,
        exists: impl Fn(&str) -> bool,
    ) -> Option<Self> {
        let (mut steps, mut sum) = (0_u64, Stages::default());
        for timings in timings {
            steps += u64::from(timings.steps);
            sum += timings.stages;
        }
        let means = sum.values().map(|ns| ns as f64 / 1000.0 / steps as f64);
        let named = Stages::NAMES.into_iter().zip(means);
        (steps > 0).then(|| Self {
            sum: means.iter().sum(),
            stages: named.filter(|(stage, _)| exists(stage)).collect(),
        })
    }

    /// The means of each memory that was timed, over all its conditions.
    pub fn by_memory(log: &RunLog) -> Vec<(MemoryKind, Self)> {
        let timings = log.timings_by_key();
        let of = |memory: MemoryKind| {
            let records = || log.episodes.iter().filter(move |record| record.memory == memory);
            let timed = records().filter_map(|record| timings.get(record.key.as_str()).copied());
            let asked = records().any(|record| record.requests.is_some());
            Some((memory, Self::of(timed, |stage| exists(stage, memory, asked))?))
        };
        let memories: BTreeSet<MemoryKind> =
            log.episodes.iter().map(|record| record.memory).collect();
        memories.into_iter().filter_map(of).collect()
    }

    /// The stage called `name`; `None` when the episodes have no such stage.
    pub fn stage(&self, name: &str) -> Option<f64> {
        self.stages.iter().find(|(stage, _)| *stage == name).map(|(_, us)| *us)
    }
}

/// Whether a step under `memory` has the stage. Where no policy is `asked` (the expert) there is nothing to
/// wait for after the view; where no view is looked up, nothing is embedded and searched.
pub(super) fn exists(stage: &str, memory: MemoryKind, asked: bool) -> bool {
    match stage {
        "command" | "dynamics" | "render" | "publish" => true,
        "embed" | "search" => asked && memory.retrieves(),
        _ => asked,
    }
}

/// Steps over running time, which is for each session from its first episode's start to its last one's end.
pub(super) fn steps_per_s(timings: &[EpisodeTimings]) -> Option<f64> {
    let mut sessions: BTreeMap<u32, (u64, u64)> = BTreeMap::new();
    for timings in timings {
        let (start, end) = sessions.entry(timings.session).or_insert((u64::MAX, 0));
        *start = timings.started_ns.min(*start);
        *end = timings.ended_ns.max(*end);
    }
    let running = sessions.values().map(|(start, end)| end.saturating_sub(*start));
    let ns = running.fold(0, u64::saturating_add);
    let steps: u64 = timings.iter().map(|timings| u64::from(timings.steps)).sum();
    (ns > 0).then(|| steps as f64 * 1e9 / ns as f64)
}
