//! Memory growth over a long run: private memory of every process and shared memory during thirty thousand short
//! episodes. Every view is rendered beforehand, because shared memory fills as long as new views appear.

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
use crate::figure::{Better, FigureBound, Measurement};
use crate::runs::BenchRun;
use crate::session::{BenchSession, Size};

/// The bench.
pub const BENCH: Bench = Bench {
    name: "growth",
    about: "memory of all processes and shared memory, during 30,000 episodes",
    run,
};

/// Sampling interval.
const PACE: Duration = Duration::from_millis(50);

/// Share of the episodes that count as warm-up, while caches fill.
const WARM_UP: f64 = 0.4;

/// Largest slope, in bytes per episode, that counts as no growth: a megabyte over the whole run.
const NOTHING: f64 = 100.0;

/// What is sampled: private memory of each process, and shared memory once.
const PLACES: [(&str, &str); 5] = [
    ("memtransfer", "private memory of the orchestrator"),
    ("sim-proc", "private memory of the simulator"),
    ("memory-proc", "private memory of the memory process"),
    ("policy-proc", "private memory of the policy process"),
    ("shared-memory", "shared memory"),
];

fn run(session: &mut BenchSession<'_>) -> Result<Vec<Measurement>> {
    let (slopes, episodes) = {
        let mut slopes: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        let mut episodes = 0;
        // A long bench without a baseline: two rounds show whether a trend repeats.
        for round in 1..=session.rounds().min(2) {
            session.say(format_args!("round {round}"));
            let samples = execute(session)?;
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
        Measurement::new(format!("growth.{id}"), what, "bytes/episode", Better::Lower)
            .ours(slopes.get(id).cloned().unwrap_or_default())
            .parameter("episodes", episodes)
            .parameter("samples from", format!("{:.0} %", WARM_UP * 100.0))
    };
    let mut figures = vec![
        figure("total", "growth of all processes and shared memory together")
            .target(FigureBound::Value(NOTHING), "no growth: under 100 bytes per episode")
            .note("slope of a line through samples taken every 50 ms"),
    ];
    figures.extend(PLACES.iter().map(|(id, what)| figure(id, &format!("growth of {what}"))));
    Ok(figures)
}

/// A sample.
#[derive(Debug, Clone)]
struct Sample {
    /// Finished episodes.
    episodes: u64,
    /// Bytes by place.
    bytes: BTreeMap<&'static str, u64>,
}

fn execute(session: &BenchSession<'_>) -> Result<Vec<Sample>> {
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
    // Fifty cases, two starts, three memories, repeated: a little more than thirty thousand episodes.
    let bench_run = BenchRun::new(
        session.size.pick(4, 32),
        session.size.pick(10, 102),
        &[&policy[..], size].concat(),
    );
    let (mut command, folder) = bench_run.command(session, "growth")?;
    let log = session.scratch().join("growth.log");
    let mut child =
        command.stderr(File::create(&log)?).spawn().context("cannot start memtransfer")?;
    let samples = sample_until_the_end(session, &mut child, &folder.join("episodes.jsonl"));
    if samples.is_err() {
        // Fails when it has already ended, which is fine.
        let _ = child.kill();
    }
    let status = child.wait().context("cannot wait for memtransfer")?;
    if !status.success() {
        bail!("memtransfer failed ({status}):\n{}", fs::read_to_string(&log).unwrap_or_default());
    }
    samples
}

/// Samples until the run ends.
fn sample_until_the_end(
    session: &BenchSession<'_>,
    child: &mut Child,
    journal: &Path,
) -> Result<Vec<Sample>> {
    let mut samples = Vec::new();
    let (mut file, mut episodes) = (None, 0);
    let mut children = BTreeMap::new();
    loop {
        if child.try_wait().context("cannot query the process of memtransfer")?.is_some() {
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
            // Processes end one after another.
            if bytes.len() == PLACES.len() {
                samples.push(Sample { episodes, bytes });
            }
        }
        thread::sleep(session.size.pick(PACE / 10, PACE));
    }
}

/// Process ids of a run by name: the program and its children.
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

/// Private memory of a process in bytes; `None` when it has ended.
fn private_bytes(pid: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    Some(line.trim().strip_suffix(" kB")?.parse::<u64>().ok()? << 10)
}

/// Shared memory in bytes of the runs registered in `registry`.
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
    // Allocated blocks rather than reserved size; a file may disappear meanwhile.
    Ok(ours.filter_map(|entry| Some(entry.metadata().ok()?.blocks() * 512)).sum())
}

/// Bytes per episode: the slope of a least-squares line after the warm-up.
fn slope(samples: &[Sample], bytes: impl Fn(&Sample) -> u64) -> Result<f64> {
    let last = samples.last().context("the run ended before it was sampled")?.episodes;
    let after = |sample: &&Sample| sample.episodes as f64 >= WARM_UP * last as f64;
    let points: Vec<(f64, f64)> =
        samples.iter().filter(after).map(|s| (s.episodes as f64, bytes(s) as f64)).collect();
    ensure!(points.len() >= 2, "only {} samples after the warm-up", points.len());
    Ok(crate::curves::fitted_slope(&points).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_during_the_warm_up_does_not_count() {
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
