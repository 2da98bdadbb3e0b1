//! The Python package: its own tests, its types, its installation, and its examples on the benchmark.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use memtransfer_tests::{
    Bench, Ended, episodes, eventually, kill, needs, processes_with, records, sorted_log,
};

fn package() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../python").canonicalize().expect("the package")
}

/// Runs the tests' Python in the package's folder.
fn python(args: &[&str], variables: &[(&str, &str)]) -> Ended {
    let mut command = Command::new(needs::python());
    command
        .args(args)
        .current_dir(package())
        .envs(variables.iter().copied())
        // Leave no bytecode in the tree.
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    Ended::of(command.spawn().expect("it starts"))
}

#[test]
fn the_package_passes_its_own_tests() {
    let _bench = Bench::new();
    python(&["-m", "pytest"], &[]).expect(0);
}

#[test]
fn the_package_is_typed() {
    let bench = Bench::new();
    let cache = bench.out("mypy");
    let cache = cache.to_str().unwrap();
    python(&["-m", "mypy", "--cache-dir", cache, "memtransfer"], &[]).expect(0);
}

/// As `pip install ./python` does it, but with what is on this machine.
#[test]
fn the_package_can_be_installed_from_the_checkout() {
    let bench = Bench::new();
    let place = bench.out("installed");
    let mut args = vec!["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
    args.extend(["--no-index", "--no-deps", "--no-build-isolation", "--no-compile", "--target"]);
    args.extend([place.to_str().unwrap(), "."]);
    python(&args, &[]).expect(0);
    assert!(place.join("memtransfer/py.typed").is_file());
    let look = "import memtransfer, pathlib; print(pathlib.Path(memtransfer.__file__).parent)";
    let ended = python(&["-P", "-c", look], &[("PYTHONPATH", place.to_str().unwrap())]).expect(0);
    assert_eq!(ended.stdout.trim(), place.join("memtransfer").to_str().unwrap());
}

/// The command that starts an example.
fn example(name: &str) -> String {
    let script = package().join("examples").join(name);
    format!("{} {}", needs::python().display(), script.display())
}

/// `memtransfer run` over three cases with a policy command, not started yet.
fn slice(bench: &Bench, out: &str, policy: &str, more: &[&str]) -> Command {
    let mut args = vec!["run", "--policy-cmd", policy, "--limit", "3", "--starts", "original"];
    args.extend(["--out", out]);
    args.extend(more);
    let mut command = bench.command(&args);
    command.env("PYTHONPATH", package()).env("PYTHONDONTWRITEBYTECODE", "1");
    command
}

fn walk(mut command: Command) -> Ended {
    Ended::of(command.spawn().expect("it starts")).expect(0)
}

#[test]
fn the_random_example_walks_and_a_kill_leaves_no_trace_in_the_log() {
    let bench = Bench::new();
    let random = example("random_policy.py");
    let more = ["--memory", "working,full-context,episodic", "--lanes", "4"];
    walk(slice(&bench, "whole", &random, &more));
    let whole = sorted_log(&bench.out("whole"));
    assert_eq!(whole.len(), 9);

    let child = slice(&bench, "killed", &random, &more).spawn().unwrap();
    let marker = package().join("examples/random_policy.py");
    let marker = marker.as_os_str().as_encoded_bytes();
    let policy = eventually("an episode and its policy", || {
        // The orchestrator has the script's name in its arguments, too.
        let policy = processes_with(marker).into_iter().find(|&pid| pid != child.id())?;
        (!episodes(&bench.out("killed")).is_empty()).then_some(policy)
    });
    kill(policy);
    let ended = Ended::of(child).expect(0);
    assert!(ended.stderr.contains("ended on signal 9"), "{}", ended.stderr);
    assert_eq!(sorted_log(&bench.out("killed")), whole);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn the_pixels_example_sees_where_it_goes() {
    let bench = Bench::new();
    let pixels = example("pixels_policy.py");
    walk(slice(&bench, "pixels", &pixels, &["--memory", "working", "--max-steps", "30"]));
    let walked = records(&bench.out("pixels"));
    assert_eq!(walked.len(), 3);
    let (mut moves, mut blocked) = (0, 0);
    for record in &walked {
        moves += record["actions"].as_str().unwrap().matches('f').count();
        blocked += record["blocked_moves"].as_array().map_or(0, Vec::len);
    }
    assert!(moves > 30 && blocked * 10 < moves, "{blocked} of {moves} moves were blocked");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
