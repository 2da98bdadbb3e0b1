//! A run divided into units, executed in any order and killed on the way, is the run of one machine.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use memtransfer_tests::{Bench, Ended, episodes, program, repository, sorted_log, words};
use rigs::records::without_checksums;

/// Three memories from two starts, small.
const SMALL: &str = r#"
memory = ["working", "summary", "episodic"]
starts = ["original", "new"]
routes = ["unchanged"]
demos = ["original"]
limit = 8
max-steps = 40
"#;

const STREAMS: &str = r#"
memory = ["working", "adaptive"]
arms = ["frozen", "learning"]
starts = ["new"]
max-steps = 40

[stream]
streams = 1
blocks = 2
cases-per-block = 2
events = ["swap"]
rounds = 1
orders = ["drawn", "reversed"]
feedback = "success"
"#;

struct Units {
    bench: Bench,
    count: usize,
}

impl Units {
    /// The plan `plan.json` of `suite` in units of `unit_episodes`, and the run folder `whole` of one lane.
    fn new(suite: &str, policy: &str, unit_episodes: &str, more: &[&str]) -> Self {
        let bench = Bench::new();
        fs::write(bench.out("suite.toml"), suite).unwrap();
        let settings = [&["--suite", "./suite.toml", "--policy", policy], more].concat();
        let run = [&["run"], &*settings, &["--out", "whole", "--lanes", "1"]].concat();
        bench.run(&run).expect(0);
        let plan = ["--out", "plan.json", "--unit-episodes", unit_episodes];
        bench.run(&[&["plan"], &*settings, &plan].concat()).expect(0);
        let plan = fs::read_to_string(bench.out("plan.json")).unwrap();
        let plan: serde_json::Value = serde_json::from_str(&plan).unwrap();
        let count = plan["units"].as_u64().unwrap() as usize;
        Self { bench, count }
    }

    fn work<'a>(&self, unit: &'a str, out: &'a str) -> Vec<&'a str> {
        vec!["work", "--plan", "plan.json", "--unit", unit, "--out", out, "--lanes", "4"]
    }

    fn execute(&self, unit: usize, out: &str) -> Ended {
        self.bench.run(&self.work(&unit.to_string(), out))
    }

    /// Executes a unit and kills it after `time`, and again after twice the time, until it has ended by itself.
    fn execute_with_kills(&self, unit: usize, out: &str, mut time: Duration) {
        loop {
            let mut child = self.bench.start(&self.work(&unit.to_string(), out));
            let start = Instant::now();
            while child.try_wait().unwrap().is_none() && start.elapsed() < time {
                std::thread::sleep(Duration::from_millis(5));
            }
            if self.bench.kill_run(child).status.is_some() {
                return;
            }
            time *= 2;
        }
    }

    fn merge(&self, folders: &[&str], out: &str) -> Ended {
        let merge = ["merge", "--plan", "plan.json", "--out", out];
        self.bench.run(&[&merge, folders].concat())
    }

    /// Executes all units in another order than theirs, some of them killed, and merges them.
    fn execute_all(&self) {
        for index in 0..self.count {
            // 7 and the number of units have no common divisor: every unit once.
            assert!(!self.count.is_multiple_of(7));
            let unit = index * 7 % self.count;
            match index % 3 {
                0 => self.execute_with_kills(unit, "one", Duration::from_millis(700)),
                1 => drop(self.execute(unit, "one").expect(0)),
                _ => drop(self.execute(unit, "two").expect(0)),
            }
        }
        self.merge(&["one", "two"], "merged").expect(0);
        let again = self.merge(&["one", "two"], "merged").expect(0);
        assert!(again.stderr.contains("merged before"), "{}", again.stderr);
    }

    fn out(&self, name: &str) -> std::path::PathBuf {
        self.bench.out(name)
    }
}

/// A manifest without what may differ between machines.
fn manifest(run: &Path) -> serde_json::Value {
    let text = fs::read_to_string(run.join("manifest.json")).unwrap();
    let mut manifest: serde_json::Value = serde_json::from_str(&text).unwrap();
    for key in ["out", "lanes"] {
        manifest["settings"][key].take();
    }
    manifest["processes"]["memory"]["encoder_threads"].take();
    manifest
}

#[test]
fn units_in_any_order_and_killed_are_the_run_of_one_machine() {
    let units = Units::new(SMALL, "grounded", "4", &[]);
    units.execute_all();
    // The same bytes in the same order: one lane runs the episodes in the order of the plan.
    assert_eq!(episodes(&units.out("merged")), episodes(&units.out("whole")));
    assert_eq!(manifest(&units.out("merged")), manifest(&units.out("whole")));
    let documents = |run: &str| {
        let folder = units.out(run).join("documents");
        let files = fs::read_dir(folder).into_iter().flatten().map(|file| file.unwrap());
        let mut files: Vec<_> =
            files.map(|file| (file.file_name(), fs::read(file.path()).unwrap())).collect();
        files.sort();
        files
    };
    assert_eq!(documents("merged"), documents("whole"));
    let score = |run: &str| units.bench.run(&["score", run]).expect(0);
    assert!(score("merged").stdout.contains("SR"));
    assert_eq!(units.bench.leftovers(), [""; 0]);
}

#[test]
fn a_stream_is_executed_whole() {
    let units = Units::new(STREAMS, "grounded", "1", &[]);
    // Three conditions in two orders.
    assert_eq!(units.count, 6);
    units.execute_all();
    assert_eq!(sorted_log(&units.out("merged")), sorted_log(&units.out("whole")));
    assert_eq!(manifest(&units.out("merged")), manifest(&units.out("whole")));
    // The merged run can be resumed: its snapshots are there.
    let suite = ["run", "--suite", "./suite.toml", "--out", "merged"];
    units.bench.run(&suite).expect(0);
}

/// A machine with nothing but the programs: its cache folder is empty.
#[test]
fn a_worker_gets_what_it_needs_from_the_plans_store() {
    let bench = Bench::new();
    fs::write(bench.out("suite.toml"), SMALL).unwrap();
    let settings =
        words("--suite ./suite.toml --policy grounded --memory summary,episodic --limit 3");
    // The first machine knows documents and embeddings after this.
    bench.run(&[&["run"], &settings[..], &["--out", "whole", "--lanes", "1"]].concat()).expect(0);
    let plan = ["--out", "plan.json", "--unit-episodes", "100", "--store", "store"];
    bench.run(&[&["plan"], &settings[..], &plan].concat()).expect(0);
    // Encoder, runtime, embeddings and the summary.
    assert_eq!(fs::read_dir(bench.out("store")).unwrap().count(), 4);

    let elsewhere = tempfile::tempdir().unwrap();
    let cache = elsewhere.path().join("cache");
    fs::rename(bench.out("store"), elsewhere.path().join("mounted")).unwrap();
    let mounted = elsewhere.path().join("mounted");
    let work = ["work", "--plan", "plan.json", "--unit", "0", "--out", "units", "--lanes", "4"];
    let worker = |more: &[&str]| {
        let mut command = bench.command(&[&work, more].concat());
        Ended::run(command.env("MEMTRANSFER_CACHE", &cache))
    };
    let ended = worker(&[]).expect(2);
    assert!(ended.stderr.contains("cannot get "), "{}", ended.stderr);
    worker(&["--store", mounted.to_str().unwrap()]).expect(0);
    bench.run(&["merge", "--plan", "plan.json", "units", "--out", "merged"]).expect(0);
    assert_eq!(sorted_log(&bench.out("merged")), sorted_log(&bench.out("whole")));
    // The worker has computed no embedding: its own file has none.
    let own = elsewhere.path().join("own");
    let mut list = Command::new(program("memory-proc"));
    list.arg("embeddings").arg("--out").arg(&own).env("MEMTRANSFER_CACHE", &cache);
    assert!(list.stdout(Stdio::null()).status().unwrap().success());
    assert!(fs::read(own).unwrap().len() < 100);
}

#[test]
fn what_is_missing_disagrees_or_differs_is_named() {
    let assets = repository("assets");
    let units = Units::new(SMALL, "random", "6", &["--assets", assets.to_str().unwrap()]);
    assert_eq!(units.count, 3);
    units.execute(2, "one").expect(0);
    units.execute(0, "one").expect(0);
    let missing = units.merge(&["one"], "merged").expect(3);
    assert_eq!(missing.stdout, "1\n");
    assert!(!units.out("merged").exists());

    units.execute(1, "one").expect(0);
    units.execute(1, "two").expect(0);
    // A finished unit is left as it is.
    let log = units.out("two/unit-000001/episodes.jsonl");
    let text = fs::read_to_string(&log).unwrap();
    let edited = without_checksums(&text);
    let (before, after) = edited.split_once("\"reference\":").unwrap();
    fs::write(&log, format!("{before}\"reference\":1{after}")).unwrap();
    units.execute(1, "two").expect(0);
    let refused = units.merge(&["one", "two"], "merged").expect(2);
    for part in ["one/unit-000001 and two/unit-000001 disagree about random", "run1/"] {
        let part = part.replace(" random", "");
        assert!(refused.stderr.contains(&part), "{}", refused.stderr);
    }
    fs::write(&log, text).unwrap();
    units.merge(&["one", "two"], "merged").expect(0);
    assert_eq!(sorted_log(&units.out("merged")), sorted_log(&units.out("whole")));

    // A unit from a machine whose pixels may differ in their last bits.
    let path = units.out("two/unit-000001/manifest.json");
    let text = fs::read_to_string(&path).unwrap();
    let mut other: serde_json::Value = serde_json::from_str(&text).unwrap();
    other["processes"]["sim"]["backend"] = "wgpu".into();
    fs::write(&path, other.to_string()).unwrap();
    let merge = ["merge", "--plan", "plan.json", "one", "two", "--out", "mixed"];
    let refused = units.bench.run(&[&merge[..], &["--strict"]].concat()).expect(2);
    for part in ["--strict: ", "backend", "wgpu"] {
        assert!(refused.stderr.contains(part), "{}", refused.stderr);
    }
    assert!(!units.out("mixed").exists());
    let warned = units.bench.run(&merge).expect(0);
    assert!(
        warned.stderr.contains("warning: pixels and embeddings may differ"),
        "{}",
        warned.stderr
    );

    // Other assets, or another plan's unit.
    let other = units.out("other-assets");
    fs::create_dir(&other).unwrap();
    for file in ["layout.toml", "catalogue.toml", "cases.toml", "models.toml"] {
        fs::copy(assets.join(file), other.join(file)).unwrap();
    }
    let layout = fs::read_to_string(other.join("layout.toml")).unwrap();
    fs::write(other.join("layout.toml"), format!("{layout}\n# changed\n")).unwrap();
    let mut work = units.work("0", "three");
    work.extend(["--assets", other.to_str().unwrap()]);
    let refused = units.bench.run(&work).expect(2);
    assert!(refused.stderr.contains("contents of layout:"), "{}", refused.stderr);
    let plan = fs::read_to_string(units.out("plan.json")).unwrap();
    fs::write(units.out("plan.json"), format!("{plan}\n")).unwrap();
    let refused = units.execute(0, "one").expect(2);
    assert!(refused.stderr.contains("is a unit of another plan"), "{}", refused.stderr);
    let refused = units.merge(&["one", "two"], "again").expect(2);
    assert!(refused.stderr.contains("is not unit 0 of this plan"), "{}", refused.stderr);
}
