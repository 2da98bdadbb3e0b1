//! Whether a long run grows: the memory of every process and the shared memory, while thirty thousand short episodes are
//! walked. Every view is drawn before, or shared memory would fill for as long as new ones are seen.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::Child;
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use shm_types::process::SHARED_MEMORY;

use crate::Bench;
use crate::figure::{Better, Bound, Figure};
use crate::runs::Walk;
use crate::session::{Session, Size};

/// This bench.
pub const BENCH: Bench = Bench {
    name: "growth",
    about: "memory of all processes and shared memory, while 30,000 episodes are walked",
    run,
};

/// How often it is looked.
const PACE: Duration = Duration::from_millis(50);

/// Part of the episodes before which nothing counts: caches fill, views are drawn.
const WARM_UP: f64 = 0.4;

/// Bytes an episode below which nothing grows: a megabyte over the whole run.
const NOTHING: f64 = 100.0;

/// What is looked at. Private memory of each process; what they share is counted once, where it lies.
const PLACES: [(&str, &str); 5] = [
    ("memtransfer", "private memory of the orchestrator"),
    ("sim-proc", "private memory of the simulator"),
    ("memory-proc", "private memory of the memory process"),
    ("policy-proc", "private memory of the policy process"),
    ("shared-memory", "shared memory"),
];

fn run(session: &mut Session<'_>) -> Result<Vec<Figure>> {
    let (slopes, episodes) = {
        let mut slopes: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        let mut episodes = 0;
        // Long, and without a peer to be measured beside: twice is enough to see a trend from chance.
        for round in 1..=session.rounds().min(2) {
            session.say(format_args!("round {round}"));
            let samples = walk(session)?;
            episodes = samples.last().map_or(0, |sample| sample.episodes);
            for (place, _) in PLACES {
                slopes.entry(place).or_default().push(slope(&samples, |sample| {
                    sample.bytes.get(place).copied().unwrap_or_default()
                })?);
            }
            let total = |sample: &Sample| sample.bytes.values().sum::<u64>();
            slopes.entry("total").or_default().push(slope(&samples, total)?);
        }
        (slopes, episodes)
    };
    let figure = |id: &str, what: &str| {
        Figure::new(format!("growth.{id}"), what, "bytes/episode", Better::Lower)
            .ours(slopes.get(id).cloned().unwrap_or_default())
            .parameter("episodes", episodes)
            .parameter("from", format!("{:.0} %", WARM_UP * 100.0))
    };
    let mut figures = vec![
        figure("total", "growth of all processes and shared memory together")
            .target(Bound::Value(NOTHING), "no growth: under 100 bytes an episode")
            .note("the slope of a line through samples every 50 ms"),
    ];
    figures.extend(PLACES.iter().map(|(id, what)| figure(id, &format!("growth of {what}"))));
    Ok(figures)
}

/// What was seen at a moment.
#[derive(Debug, Clone)]
struct Sample {
    /// Episodes finished.
    episodes: u64,
    /// By place.
    bytes: BTreeMap<&'static str, u64>,
}

fn walk(session: &Session<'_>) -> Result<Vec<Sample>> {
    let policy = ["--suite", "quick", "--policy", "random", "--starts", "original,new"];
    let size: &[&str] = match session.size {
        Size::Tiny => {
            &["--memory", "working", "--limit", "10", "--max-steps", "4", "--frame-size", "64"]
        }
        Size::Full => &[
            "--memory",
            "working,full-context,episodic",
            "--max-steps",
            "8",
            "--cases",
            "all",
            "--warm-views",
        ],
    };
    // Fifty cases from two starts with three memories, each so often: a little more than thirty thousand.
    let walk = Walk::new(
        session.size.pick(4, 32),
        session.size.pick(10, 102),
        &[&policy[..], size].concat(),
    );
    let (mut command, folder) = walk.command(session, "growth")?;
    let log = session.scratch().join("growth.log");
    let mut child =
        command.stderr(File::create(&log)?).spawn().context("cannot start memtransfer")?;
    let looked = look(session, &mut child, &folder.join("episodes.jsonl"));
    if looked.is_err() {
        // It may be over already.
        let _ = child.kill();
    }
    let status = child.wait().context("cannot wait for memtransfer")?;
    if !status.success() {
        bail!("memtransfer failed ({status}):\n{}", fs::read_to_string(&log).unwrap_or_default());
    }
    looked
}

/// Looks until the run is over.
fn look(session: &Session<'_>, child: &mut Child, journal: &Path) -> Result<Vec<Sample>> {
    let mut samples = Vec::new();
    let (mut file, mut episodes) = (None, 0);
    let mut children = BTreeMap::new();
    loop {
        if child.try_wait().context("cannot look after memtransfer")?.is_some() {
            return Ok(samples);
        }
        if file.is_none() {
            file = File::open(journal).ok();
        }
        if let Some(file) = &mut file {
            let mut new = Vec::new();
            file.read_to_end(&mut new)
                .with_context(|| format!("cannot read {}", journal.display()))?;
            episodes += new.iter().filter(|byte| **byte == b'\n').count() as u64;
        }
        if children.len() < PLACES.len() - 1 {
            children = processes(child.id());
        }
        if episodes > 0 && children.len() == PLACES.len() - 1 {
            let mut bytes: BTreeMap<_, _> = children
                .iter()
                .filter_map(|(name, pid)| Some((*name, private_bytes(*pid)?)))
                .collect();
            bytes.insert("shared-memory", shared_bytes(session.registry())?);
            // At its end processes go one after the other.
            if bytes.len() == PLACES.len() {
                samples.push(Sample { episodes, bytes });
            }
        }
        thread::sleep(session.size.pick(PACE / 10, PACE));
    }
}

/// The processes of a run by name: the program itself and its children.
fn processes(memtransfer: u32) -> BTreeMap<&'static str, u32> {
    let mut found = BTreeMap::from([(PLACES[0].0, memtransfer)]);
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse::<u32>().ok()) else {
            continue;
        };
        let status = fs::read_to_string(entry.path().join("status")).unwrap_or_default();
        let field = |name: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(name));
            line.map(str::trim).unwrap_or_default()
        };
        if field("PPid:") == memtransfer.to_string()
            && let Some((name, _)) = PLACES.iter().find(|(name, _)| *name == field("Name:"))
        {
            found.insert(*name, pid);
        }
    }
    found
}

/// Bytes of memory that are the process's own; `None` when it is gone.
fn private_bytes(pid: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    Some(line.trim().strip_suffix(" kB")?.parse::<u64>().ok()? << 10)
}

/// Bytes of shared memory of the runs registered in `registry`.
fn shared_bytes(registry: &Path) -> Result<u64> {
    let runs: Vec<String> = fs::read_dir(registry)
        .with_context(|| format!("cannot list {}", registry.display()))?
        .flatten()
        .map(|run| format!("mt{}_", run.file_name().to_string_lossy()))
        .collect();
    let entries = fs::read_dir(SHARED_MEMORY).context("cannot list shared memory")?.flatten();
    let ours = entries.filter(|entry| {
        let name = entry.file_name();
        runs.iter().any(|run| name.as_encoded_bytes().starts_with(run.as_bytes()))
    });
    // What is written, not what is reserved; a file may go while it is looked at.
    Ok(ours.filter_map(|entry| Some(entry.metadata().ok()?.blocks() * 512)).sum())
}

/// Bytes an episode: the slope of the line that fits best, after the warm-up.
fn slope(samples: &[Sample], bytes: impl Fn(&Sample) -> u64) -> Result<f64> {
    let last = samples.last().context("the run was over before it was looked at")?.episodes;
    let after = |sample: &&Sample| sample.episodes as f64 >= WARM_UP * last as f64;
    let points: Vec<(f64, f64)> =
        samples.iter().filter(after).map(|s| (s.episodes as f64, bytes(s) as f64)).collect();
    ensure!(points.len() >= 2, "the run was looked at {} times after its warm-up", points.len());
    Ok(crate::curves::fitted_slope(&points).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_grows_while_it_warms_up_does_not_count() {
        let sample =
            |episodes: u64, bytes| Sample { episodes, bytes: BTreeMap::from([("x", bytes)]) };
        let of = |sample: &Sample| sample.bytes["x"];
        let steady = [sample(1, 0), sample(30, 9000), sample(50, 9000), sample(100, 9000)];
        assert_eq!(slope(&steady, of).unwrap(), 0.0);
        let growing = [sample(1, 0), sample(50, 500), sample(75, 750), sample(100, 1000)];
        assert!((slope(&growing, of).unwrap() - 10.0).abs() < 1e-9);
        assert!(slope(&[], of).is_err());
    }
}
