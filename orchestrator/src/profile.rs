//! How long an access to memory takes: what `memtransfer profile` measures, keeps and shows.
//!
//! An access begins when the simulator has published an observation and is over when the policy has the recall that
//! answers it. [`recorder`] takes it apart, step by step, while real episodes are walked through the four processes;
//! [`search`] has the memory process measure its search by itself, at sizes that no case reaches; beside both stand the
//! machine's [floors](crate::machine::floors). What is measured is kept as a [`Profile`] (`profile.json`,
//! `profile.csv`), from which alone the page and the [`summary`] are made (`page.rs`).

mod page;
pub mod recorder;
pub mod search;
pub mod summary;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use crate::machine::Machine;
use crate::machine::floors::Floors;
use recorder::Latency;
use results::names::named;
use search::Search;

/// The version of the format.
pub const SCHEMA: u32 = 1;

named! {
    /// Whether memory has met the views before.
    Mode, "mode" {
        /// It has not: each is drawn, embedded and remembered for the first time.
        Cold = "cold",
        /// It has: their embeddings are in the cache folder, and they were drawn before the first step.
        Warm = "warm",
    }
}

/// Everything that was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// [`SCHEMA`] of the writer.
    pub schema: u32,
    /// The program's version.
    pub version: String,
    /// Its commit.
    pub commit: Option<String>,
    /// When it began, in seconds since 1970.
    pub unix_s: u64,
    /// Where.
    pub machine: Machine,
    /// What that can do at best.
    pub floors: Floors,
    /// The encoder.
    pub encoder: String,
    /// Episodes that were walked.
    pub walks: Vec<Walk>,
    /// Searches that were measured by themselves.
    pub searches: Vec<Search>,
    /// What could not be measured, and why.
    pub problems: Vec<String>,
}

/// Episodes that were walked in one way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Walk {
    /// Whether memory had met the views before.
    pub mode: Mode,
    /// Episodes at once.
    pub lanes: u32,
    /// Microseconds for which a process looks before it sleeps: 0 is blocking.
    pub spin_us: u32,
    /// Episodes.
    pub episodes: u32,
    /// Steps.
    pub steps: u64,
    /// Seconds from the first command to the last decision.
    pub seconds: f64,
    /// How long accesses took.
    pub latencies: Vec<Latency>,
}

impl Walk {
    /// How it was walked, in words.
    pub fn name(&self) -> String {
        let wait = match self.spin_us {
            0 => "blocking".to_owned(),
            spin => format!("polling for {spin} us"),
        };
        let lanes =
            if self.lanes == 1 { "1 lane".to_owned() } else { format!("{} lanes", self.lanes) };
        format!("{}, {lanes}, {wait}", self.mode)
    }
}

impl Profile {
    /// Writes `profile.json`, `profile.csv` and `profile.html` into the folder `dir`, which is made if need be; what an
    /// earlier profile wrote there is replaced. Returns the page.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn write(&self, dir: &Path) -> Result<PathBuf> {
        fs::create_dir_all(dir).with_context(|| format!("cannot make {}", dir.display()))?;
        let save = |name: &str, content: Vec<u8>| {
            let path = dir.join(name);
            let written = fs::write(&path, content);
            written.with_context(|| format!("cannot write {}", path.display())).map(|()| path)
        };
        save("profile.json", serde_json::to_vec_pretty(self)?)?;
        save("profile.csv", self.csv()?)?;
        save("profile.html", results::report::page(&page::document(self)?)?.into_bytes())
    }

    /// A line for each latency, walked and searched.
    fn csv(&self) -> Result<Vec<u8>> {
        let mut csv = csv::Writer::from_writer(Vec::new());
        csv.write_record([
            "measurement",
            "mode",
            "lanes",
            "spin_us",
            "what",
            "step",
            "part",
            "entries",
            "batch",
            "threads",
            "count",
            "mean_ns",
            "p50_ns",
            "p90_ns",
            "p99_ns",
            "p999_ns",
            "max_ns",
            "recall_at_1",
            "recall_at_10",
        ])?;
        for walk in &self.walks {
            for latency in &walk.latencies {
                let Latency { times, .. } = latency;
                csv.serialize((
                    ("walk", walk.mode.to_string(), walk.lanes, walk.spin_us),
                    (
                        latency.representation.name(),
                        latency.step.to_string(),
                        latency.part.to_string(),
                    ),
                    (None::<u32>, None::<u32>, None::<u32>),
                    (
                        times.count,
                        times.mean,
                        times.p50,
                        times.p90,
                        times.p99,
                        times.p999,
                        times.max,
                    ),
                    (None::<f64>, None::<f64>),
                ))?;
            }
        }
        for search in &self.searches {
            let times = &search.latency_ns;
            csv.serialize((
                ("search", None::<String>, None::<u32>, None::<u32>),
                (search.search.as_str(), None::<String>, None::<String>),
                (search.entries, search.batch, search.threads),
                (
                    search.queries,
                    None::<f64>,
                    times.p50,
                    times.p90,
                    times.p99,
                    times.p999,
                    times.max,
                ),
                (search.recall_at_1, search.recall_at_10),
            ))?;
        }
        csv.into_inner().map_err(|error| io::Error::other(error.to_string()).into())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use domain::Representation;

    use super::recorder::{Part, StepKind, Times};
    use super::*;

    /// A profile with one of everything.
    pub(crate) fn profile() -> Profile {
        let times = Times { count: 3, mean: 21.5, p50: 20, p90: 30, p99: 40, p999: 50, max: 60 };
        let latencies = |representation: &Representation| {
            let representation = *representation;
            Part::ALL.iter().flat_map(move |&part| {
                [StepKind::First, StepKind::Later].map(|step| Latency {
                    representation,
                    step,
                    part,
                    times,
                })
            })
        };
        let walk = |mode, lanes, spin_us| Walk {
            mode,
            lanes,
            spin_us,
            episodes: 3,
            steps: 12,
            seconds: 0.5,
            latencies: Representation::ALL.iter().flat_map(latencies).collect(),
        };
        let search = "{\"entries\": 10, \"dimension\": 4, \"real\": 5, \"search\": \"exact\", \"batch\": 1, \
                      \"threads\": 2, \"build_s\": 0.1, \"bytes\": 160, \"queries\": 7, \"latency_ns\": {\"p50\": 1, \
                      \"p90\": 2, \"p99\": 3, \"p999\": 4, \"max\": 5}, \"queries_per_s\": 9.0, \"bytes_per_s\": null, \
                      \"recall_at_1\": 1.0, \"recall_at_10\": 1.0}";
        let search: Search = serde_json::from_str(search).unwrap();
        let approximate =
            Search { search: "approximate".to_owned(), recall_at_10: 0.97, ..search.clone() };
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
            walks: vec![
                walk(Mode::Cold, 1, 0),
                walk(Mode::Warm, 1, 0),
                walk(Mode::Warm, 1, 200),
                walk(Mode::Warm, 16, 0),
            ],
            searches: vec![search, approximate],
            problems: vec!["something & nothing".to_owned()],
        }
    }

    #[test]
    fn what_is_written_says_all_that_was_measured() {
        let dir = tempfile::tempdir().unwrap();
        let page = profile().write(dir.path()).unwrap();
        let text = |name: &str| fs::read_to_string(dir.path().join(name)).unwrap();
        assert_eq!(serde_json::from_str::<Profile>(&text("profile.json")).unwrap(), profile());
        let csv = text("profile.csv");
        let mut lines = csv.lines();
        let columns = lines.next().unwrap().split(',').count();
        assert!(csv.lines().all(|line| line.split(',').count() == columns), "{csv}");
        let latencies: usize = profile().walks.iter().map(|walk| walk.latencies.len()).sum();
        assert_eq!(lines.count(), latencies + 2);
        let page = fs::read_to_string(page).unwrap();
        for said in ["something &#38; nothing", "<svg", "episodic", "exact"] {
            assert!(page.contains(said), "{said}");
        }
    }

    #[test]
    fn a_walk_is_named_by_how_it_was_walked() {
        let names: Vec<String> = profile().walks.iter().map(Walk::name).collect();
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
