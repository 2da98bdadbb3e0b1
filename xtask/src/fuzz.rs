//! The drill `fuzz`: builds the fuzz targets with libFuzzer and coverage counters, runs them, and writes what they found.
//!
//! The compiler's own coverage pass is enough, so the toolchain of the build serves. The programs have a target folder of
//! their own, `target/fuzz`, which also keeps the inputs that reached something new: the next run begins with them.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, bail, ensure};
use clap::Parser;
use serde_json::json;

use crate::workspace::{Workspace, succeeds};

/// The flags of the compiler that libFuzzer needs. Comparisons are not traced: that halves the inputs per second, and finds
/// no more in the same time.
const COVERAGE: &[&str] = &[
    "-Cpasses=sancov-module",
    "-Cllvm-args=-sanitizer-coverage-level=4",
    "-Cllvm-args=-sanitizer-coverage-inline-8bit-counters",
    "-Cllvm-args=-sanitizer-coverage-pc-table",
    "-Ccodegen-units=1",
];

/// The variable that names the target to `drill-fuzz`.
const TARGET_VARIABLE: &str = "MEMTRANSFER_FUZZ_TARGET";

/// Memory that a target may use, in MiB.
const MEMORY_MIB: u32 = 2048;

/// Seconds that one input may take.
const INPUT_SECONDS: u32 = 20;

/// What to run, and how long.
#[derive(Parser)]
#[command(name = "cargo xtask drill fuzz --", no_binary_name = true)]
struct FuzzArguments {
    /// Number of inputs to each target
    #[arg(long, value_name = "N", default_value_t = 20_000)]
    inputs: u64,
    /// Only this target; can be repeated [default: all of them]
    #[arg(long, value_name = "NAME")]
    target: Vec<String>,
    /// Most minutes for each target
    #[arg(long, value_name = "M")]
    minutes: Option<u64>,
    /// Go on where earlier runs stopped: their inputs count, too
    #[arg(long)]
    go_on: bool,
}

/// What one target did.
#[derive(Debug, Default, PartialEq, Eq)]
struct Fuzzed {
    inputs: u64,
    /// Edges of the program that were reached.
    edges: u64,
    /// The file of the input that failed.
    failure: Option<String>,
}

/// Builds the programs, runs the targets as the command line's `flags` say, and writes the results to `out`. Returns whether
/// everything held. A wrong flag ends the program.
pub(crate) fn run(flags: &[String], out: &Path, workspace: &Workspace) -> anyhow::Result<bool> {
    let arguments = FuzzArguments::parse_from(flags);
    let command = format!("cargo xtask drill fuzz -- {}", flags.join(" "));
    let folder = workspace.root().join("target/fuzz");
    let Some(program) = build(workspace, &folder)? else { return Ok(false) };
    let corpus = workspace.root().join("tests/fuzz/corpus");
    let known = targets(&corpus)?;
    if let Some(unknown) = arguments.target.iter().find(|name| !known.contains(name)) {
        bail!("there is no target `{unknown}` (known: {})", known.join(", "));
    }
    let chosen: Vec<&String> = known
        .iter()
        .filter(|name| arguments.target.is_empty() || arguments.target.contains(name))
        .collect();
    let mut all = if arguments.go_on { earlier(out)? } else { BTreeMap::new() };
    for name in chosen {
        let before = all.get(name).map_or(0, |fuzzed: &Fuzzed| fuzzed.inputs);
        // One at least, which shows how many edges the inputs so far reach.
        let runs = arguments.inputs.saturating_sub(before).max(1);
        let mut fuzzed = fuzz(&program, &folder, &corpus, name, runs, arguments.minutes)?;
        fuzzed.inputs += before;
        eprintln!("{name}: {} inputs, {} edges", fuzzed.inputs, fuzzed.edges);
        if let Some(failure) = &fuzzed.failure {
            eprintln!("{name} FAILED: {failure}");
        }
        all.insert(name.clone(), fuzzed);
        // Also what is known if the drill is ended early.
        write(out, &all, command.trim_end_matches(" -- "))?;
    }
    eprintln!("wrote {}", out.display());
    Ok(all.values().all(|fuzzed| fuzzed.failure.is_none()))
}

/// What earlier runs did, by target.
fn earlier(out: &Path) -> anyhow::Result<BTreeMap<String, Fuzzed>> {
    let text = fs::read_to_string(out).with_context(|| {
        format!("cannot read {}, where earlier runs would be: leave out --go-on", out.display())
    })?;
    let page: serde_json::Value =
        serde_json::from_str(&text).with_context(|| format!("{} is not JSON", out.display()))?;
    let numbers = |field: &str| {
        serde_json::from_value::<BTreeMap<String, u64>>(page[field].clone())
            .with_context(|| format!("{} has no `{field}` by target", out.display()))
    };
    let edges = numbers("edges")?;
    let fuzzed = |(name, inputs)| {
        let edges = edges.get(&name).copied().unwrap_or_default();
        (name, Fuzzed { inputs, edges, failure: None })
    };
    Ok(numbers("faults")?.into_iter().map(fuzzed).collect())
}

/// Builds `drill-fuzz` in `folder`. `None` when it does not compile.
fn build(workspace: &Workspace, folder: &Path) -> anyhow::Result<Option<PathBuf>> {
    // With a named platform the flags do not concern build scripts and macros.
    let platform = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    eprintln!("building the fuzz targets");
    let mut command = workspace.cargo(&["build", "--release", "--locked", "--package"]);
    command.args(["memtransfer-fuzz", "--features", "libfuzzer", "--bin", "drill-fuzz"]);
    command.args(["--target", &platform]).arg("--target-dir").arg(folder);
    command.env("RUSTFLAGS", COVERAGE.join(" "));
    command.env("CARGO_PROFILE_RELEASE_DEBUG_ASSERTIONS", "true");
    // redb asserts that a file is sound before it finds out that it is not.
    command.args(["--config", "profile.release.package.redb.debug-assertions=false"]);
    // The targets spend their time in packages whose speed hardly matters elsewhere.
    for package in packages_optimised_less(workspace)? {
        command.arg("--config").arg(format!("profile.release.package.{package}.opt-level=3"));
    }
    let built = succeeds(&mut command)?;
    Ok(built.then(|| folder.join(platform).join("release/drill-fuzz")))
}

/// The packages with an optimisation level of their own in the workspace's release profile.
fn packages_optimised_less(workspace: &Workspace) -> anyhow::Result<Vec<String>> {
    let path = workspace.root().join("Cargo.toml");
    let text =
        fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let manifest: toml::Table =
        toml::from_str(&text).with_context(|| format!("{} is not TOML", path.display()))?;
    let release = manifest.get("profile").and_then(|profiles| profiles.get("release"));
    let packages = release.and_then(|profile| profile.get("package")?.as_table());
    let less =
        packages.into_iter().flatten().filter(|(_, profile)| profile.get("opt-level").is_some());
    Ok(less.map(|(name, _)| name.clone()).collect())
}

/// The names of the targets: those of the corpora.
fn targets(corpus: &Path) -> anyhow::Result<Vec<String>> {
    let listed =
        fs::read_dir(corpus).with_context(|| format!("cannot list {}", corpus.display()))?;
    let mut names = Vec::new();
    for entry in listed {
        names.push(entry?.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}

fn fuzz(
    program: &Path,
    folder: &Path,
    corpus: &Path,
    name: &str,
    runs: u64,
    minutes: Option<u64>,
) -> anyhow::Result<Fuzzed> {
    let found = folder.join("corpus").join(name);
    let failures = folder.join("failures");
    // In memory: most targets write small files for every input.
    let scratch = Path::new("/dev/shm").join(format!("memtransfer-fuzz-{}", std::process::id()));
    let scratch = if Path::new("/dev/shm").is_dir() { scratch } else { folder.join("scratch") };
    for dir in [&found, &failures, &scratch] {
        fs::create_dir_all(dir).with_context(|| format!("cannot create {}", dir.display()))?;
    }
    let log = folder.join(format!("{name}.log"));
    let output =
        fs::File::create(&log).with_context(|| format!("cannot create {}", log.display()))?;
    let mut command = Command::new(program);
    command
        .arg(format!("-runs={runs}"))
        .arg(format!("-max_total_time={}", minutes.unwrap_or(0) * 60))
        .arg(format!("-rss_limit_mb={MEMORY_MIB}"))
        .arg(format!("-timeout={INPUT_SECONDS}"))
        .arg(format!("-artifact_prefix={}/{name}-", failures.display()))
        .args(["-print_final_stats=1", "-max_len=16384"])
        .args([&found, &corpus.join(name)])
        .env(TARGET_VARIABLE, name)
        .env("TMPDIR", &scratch)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(output);
    let status = command.status();
    let status = status.with_context(|| format!("cannot start {}", program.display()));
    fs::remove_dir_all(&scratch).with_context(|| format!("cannot remove {}", scratch.display()))?;
    let status = status?;
    let text = fs::read(&log).with_context(|| format!("cannot read {}", log.display()))?;
    let mut fuzzed = read(&String::from_utf8_lossy(&text));
    if !status.success() && fuzzed.failure.is_none() {
        fuzzed.failure = Some(format!("it ended with {status}; see {}", log.display()));
    }
    ensure!(
        fuzzed.inputs > 0 || fuzzed.failure.is_some(),
        "{name} read no input: see {}",
        log.display()
    );
    Ok(fuzzed)
}

/// What libFuzzer printed.
fn read(log: &str) -> Fuzzed {
    let mut fuzzed = Fuzzed::default();
    for line in log.lines() {
        let after = |mark: &str| line.split_once(mark).map(|(_, rest)| rest.trim());
        let number = |text: &str| text.split(' ').next().and_then(|word| word.parse().ok());
        if let Some(edges) = after(" cov: ").and_then(number) {
            fuzzed.edges = edges;
        }
        // A failure ends the program before its statistics: then the last line that begins with a number counts.
        if let Some((count, _)) = line.strip_prefix('#').and_then(|rest| rest.split_once('\t')) {
            fuzzed.inputs = count.trim().parse().unwrap_or(fuzzed.inputs);
        }
        if let Some(count) = after("stat::number_of_executed_units:").and_then(number) {
            fuzzed.inputs = count;
        }
        if let Some(file) = after("Test unit written to ") {
            fuzzed.failure = Some(file.to_owned());
        }
    }
    fuzzed
}

fn write(out: &Path, all: &BTreeMap<String, Fuzzed>, command: &str) -> anyhow::Result<()> {
    let inputs: BTreeMap<&String, u64> =
        all.iter().map(|(name, fuzzed)| (name, fuzzed.inputs)).collect();
    let edges: BTreeMap<&String, u64> =
        all.iter().map(|(name, fuzzed)| (name, fuzzed.edges)).collect();
    let violations: Vec<String> = all
        .iter()
        .filter_map(|(name, fuzzed)| Some(format!("{name}: {}", fuzzed.failure.as_ref()?)))
        .collect();
    let page = json!({
        "title": "Fuzzing",
        "command": command,
        "text": "Inputs to everything that reads bytes, made by libFuzzer and guided by coverage. What must hold: an answer \
                 or an error, no panic, 2 GiB and 20 seconds at most, and what is written is read back equal.",
        "faults": inputs,
        "columns": ["target", "inputs"],
        "figures": {
            "targets": all.len(),
            "inputs": inputs.values().sum::<u64>(),
            "edges": edges.values().sum::<u64>(),
        },
        "edges": edges,
        "violations": violations,
    });
    let text = serde_json::to_string_pretty(&page)? + "\n";
    fs::write(out, text).with_context(|| format!("cannot write {}", out.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drill_goes_on_where_the_last_one_stopped() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("fuzz.json");
        assert!(earlier(&out).is_err());
        let png = Fuzzed { inputs: 7, edges: 3, failure: None };
        write(&out, &BTreeMap::from([("png".to_owned(), png)]), "").unwrap();
        let before = earlier(&out).unwrap();
        assert_eq!((before.len(), before["png"].inputs, before["png"].edges), (1, 7, 3));
    }

    #[test]
    fn counts_and_failures_are_read_from_what_libfuzzer_prints() {
        let finished = "#2\tINITED cov: 80 ft: 81 corp: 1/1b exec/s: 0 rss: 40Mb\n\
                        #4096\tpulse  cov: 114 ft: 300 corp: 9/1Kb\n\
                        stat::number_of_executed_units: 5000\nstat::average_exec_per_sec: 9\n";
        assert_eq!(read(finished), Fuzzed { inputs: 5000, edges: 114, failure: None });
        let failed = "#77\tNEW    cov: 90 ft: 91\n==1== ERROR: libFuzzer: deadly signal\n\
                      artifact_prefix='/f/png-'; Test unit written to /f/png-crash-00\n";
        let failure = Some("/f/png-crash-00".to_owned());
        assert_eq!(read(failed), Fuzzed { inputs: 77, edges: 90, failure });
        assert_eq!(read("no such option"), Fuzzed::default());
    }
}
