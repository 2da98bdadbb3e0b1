//! The figures of `memtransfer profile` as data (`profile.json`, `profile.csv`), from which page and [`summary`] are made.

mod page;
pub(crate) mod summary;

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use domain::MemoryKind;
use domain::names::named;
use domain::search_profile::SearchMeasurement;
use orchestrator::machine::Machine;
use orchestrator::machine::floors::Floors;
use orchestrator::profile::recorder::AccessLatency;
use serde::{Deserialize, Serialize};

/// The version of the format.
pub(crate) const SCHEMA: u32 = 4;

named! {
    /// Whether the caches know the views.
    CacheState, "cache state" {
        /// No: each view is rendered and embedded for the first time.
        Cold = "cold",
        /// Yes: embeddings are in the cache folder, and views were rendered before the first step.
        Warm = "warm",
    }
}

/// Everything that was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Profile {
    /// [`SCHEMA`] of the writer.
    pub(crate) schema: u32,
    /// The program's version.
    pub(crate) version: String,
    /// Its commit.
    pub(crate) commit: Option<String>,
    /// When the measurement began, in seconds since 1970.
    pub(crate) unix_s: u64,
    /// The machine.
    pub(crate) machine: Machine,
    /// The machine's floors.
    pub(crate) floors: Floors,
    /// The encoder.
    pub(crate) encoder: String,
    /// Accesses in episodes, by the way in which these ran.
    pub(crate) runs: Vec<AccessRun>,
    /// Searches alone.
    pub(crate) searches: Vec<SearchMeasurement>,
    /// What could not be measured, and why.
    pub(crate) problems: Vec<String>,
}

/// Accesses in episodes that ran in one way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct AccessRun {
    /// Whether the caches knew the views.
    pub(crate) caches: CacheState,
    /// Episodes at a time.
    pub(crate) lanes: u32,
    /// Microseconds for which a process polled before it slept; 0 is blocking.
    pub(crate) spin_us: u32,
    /// Number of episodes.
    pub(crate) episodes: u32,
    /// Number of steps.
    pub(crate) steps: u64,
    /// Seconds from the first command to the last decision.
    pub(crate) seconds: f64,
    /// The latencies.
    pub(crate) latencies: Vec<AccessLatency>,
}

impl AccessRun {
    /// A description: `warm, 4 lanes, blocking`.
    pub(crate) fn name(&self) -> String {
        let wait = match self.spin_us {
            0 => "blocking".to_owned(),
            spin => format!("polling for {spin} us"),
        };
        let lanes =
            if self.lanes == 1 { "1 lane".to_owned() } else { format!("{} lanes", self.lanes) };
        format!("{}, {lanes}, {wait}", self.caches)
    }

    /// The memories that were accessed, built-in ones first.
    pub(crate) fn memories(&self) -> BTreeSet<MemoryKind> {
        self.latencies.iter().map(|latency| latency.memory).collect()
    }
}

impl Profile {
    /// Writes `profile.json`, `profile.csv` and `profile.html` into the folder `dir`, replacing earlier ones. Returns
    /// the path of the page.
    ///
    /// # Errors
    /// When the system refuses.
    pub(crate) fn write(&self, dir: &Path) -> Result<PathBuf> {
        fs::create_dir_all(dir).with_context(|| format!("cannot make {}", dir.display()))?;
        let save = |name: &str, content: Vec<u8>| {
            let path = dir.join(name);
            let written = durable::output::write(&path, content);
            written.with_context(|| format!("cannot write {}", path.display())).map(|()| path)
        };
        save("profile.json", serde_json::to_vec_pretty(self)?)?;
        save("profile.csv", self.csv()?)?;
        save("profile.html", report::page(&page::document(self)?)?.into_bytes())
    }

    /// One line for each latency, in microseconds.
    fn csv(&self) -> Result<Vec<u8>> {
        let mut csv = csv::Writer::from_writer(Vec::new());
        csv.write_record([
            "measurement",
            "caches",
            "lanes",
            "spin_us",
            "what",
            "step",
            "part",
            "entries",
            "batch",
            "threads",
            "count",
            "mean_us",
            "p50_us",
            "p90_us",
            "p99_us",
            "p999_us",
            "max_us",
        ])?;
        for run in &self.runs {
            for AccessLatency { memory, step, part, times } in &run.latencies {
                csv.serialize((
                    ("run", run.caches.to_string(), run.lanes, run.spin_us),
                    (memory.name(), step.to_string(), part.to_string()),
                    (None::<u32>, None::<u32>, None::<u32>),
                    (times.count, times.mean_us, times.p50_us, times.p90_us),
                    (times.p99_us, times.p999_us, times.max_us),
                ))?;
            }
        }
        for search in &self.searches {
            let times = &search.latency_ns;
            let us = |ns: u64| ns as f64 / 1e3;
            csv.serialize((
                ("search", None::<String>, None::<u32>, None::<u32>),
                ("search", None::<String>, None::<String>),
                (search.entries, search.batch, search.threads),
                (search.queries, None::<f64>, us(times.p50), us(times.p90)),
                (us(times.p99), us(times.p999), us(times.max)),
            ))?;
        }
        csv.into_inner().map_err(|error| io::Error::other(error.to_string()).into())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use domain::Representation;
    use orchestrator::profile::recorder::{AccessPart, StepClass};
    use run_log::latency::LatencySummary;

    use super::*;

    /// A profile with one of everything.
    pub(crate) fn profile() -> Profile {
        let times = LatencySummary {
            count: 3,
            mean_us: 21.5,
            p50_us: 20.0,
            p90_us: 30.0,
            p99_us: 40.0,
            p999_us: 50.0,
            max_us: 60.0,
        };
        let latencies = |representation: &Representation| {
            let memory = MemoryKind::BuiltIn(*representation);
            let times = times.clone();
            AccessPart::ALL.iter().flat_map(move |&part| {
                [StepClass::First, StepClass::Later].map(|step| AccessLatency {
                    memory,
                    step,
                    part,
                    times: times.clone(),
                })
            })
        };
        let run = |caches, lanes, spin_us| AccessRun {
            caches,
            lanes,
            spin_us,
            episodes: 3,
            steps: 12,
            seconds: 0.5,
            latencies: Representation::ALL.iter().flat_map(latencies).collect(),
        };
        let search = "{\"entries\": 10, \"dimension\": 4, \"real\": 5, \"batch\": 1, \
                      \"threads\": 2, \"build_s\": 0.1, \"bytes\": 160, \"queries\": 7, \"latency_ns\": {\"p50\": 1, \
                      \"p90\": 2, \"p99\": 3, \"p999\": 4, \"max\": 5}, \"queries_per_s\": 9.0, \"bytes_per_s\": 1e9}";
        let search: SearchMeasurement = serde_json::from_str(search).unwrap();
        Profile {
            schema: SCHEMA,
            version: "0".to_owned(),
            commit: None,
            unix_s: 1,
            machine: Machine::default(),
            floors: Floors {
                cache_line_ns: 100.0,
                frame_copy_ns: 4e4,
                read_one_thread: 1e10,
                read_all_cores: 2e10,
            },
            encoder: "e".to_owned(),
            runs: vec![
                run(CacheState::Cold, 1, 0),
                run(CacheState::Warm, 1, 0),
                run(CacheState::Warm, 1, 200),
                run(CacheState::Warm, 16, 0),
            ],
            searches: vec![search],
            problems: vec!["something & nothing".to_owned()],
        }
    }

    #[test]
    fn the_files_contain_every_measurement() {
        let dir = tempfile::tempdir().unwrap();
        let page = profile().write(dir.path()).unwrap();
        let text = |name: &str| fs::read_to_string(dir.path().join(name)).unwrap();
        assert_eq!(serde_json::from_str::<Profile>(&text("profile.json")).unwrap(), profile());
        let csv = text("profile.csv");
        let mut lines = csv.lines();
        let columns = lines.next().unwrap().split(',').count();
        assert!(csv.lines().all(|line| line.split(',').count() == columns), "{csv}");
        let latencies: usize = profile().runs.iter().map(|run| run.latencies.len()).sum();
        assert_eq!(lines.count(), latencies + 1);
        let page = fs::read_to_string(page).unwrap();
        for said in ["something &#38; nothing", "<svg", "episodic", "1.0"] {
            assert!(page.contains(said), "{said}");
        }
    }

    #[test]
    fn a_run_is_named_by_the_way_it_ran() {
        let names: Vec<String> = profile().runs.iter().map(AccessRun::name).collect();
        assert_eq!(
            names,
            [
                "cold, 1 lane, blocking",
                "warm, 1 lane, blocking",
                "warm, 1 lane, polling for 200 us",
                "warm, 16 lanes, blocking"
            ]
        );
    }
}
