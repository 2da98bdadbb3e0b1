//! The Python package: its own tests, its types, its installation, and policies in Python in real runs.

mod deaths;
mod examples;
mod other_programs;
mod pages;
mod wheel;

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;

use memtransfer_tests::{
    Bench, Ended, episodes, eventually, kill, needs, process_of_world, program, records,
    repository, sorted_log, wait_for_episodes, words,
};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};

/// The package's folder, with the extension that `cargo xtask test` builds.
pub(crate) fn package() -> PathBuf {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../python")
        .canonicalize()
        .expect("the package");
    let extension = package.join("memtransfer/_native.abi3.so");
    assert!(
        extension.is_file(),
        "{} is missing: run the tests with `cargo xtask test`, which builds it",
        extension.display()
    );
    package
}

/// Starts the tests' Python in the package's folder.
fn start_python(args: &[&str], variables: &[(&str, &str)]) -> Child {
    let mut command = Command::new(needs::python());
    command
        .args(args)
        .current_dir(package())
        .env("PYTHONPATH", package())
        .env_remove("MEMTRANSFER_ATTACH")
        .envs(variables.iter().copied())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command.spawn().expect("Python starts")
}

fn python(args: &[&str], variables: &[(&str, &str)]) -> Ended {
    Ended::of(start_python(args, variables))
}

/// The command that starts a script of the package with `arguments`.
fn script(path: &str, arguments: &str) -> String {
    format!("{} {} {arguments}", needs::python().display(), package().join(path).display())
}

/// The command that starts the test policy with one trait.
fn scripted(policy_trait: &str) -> String {
    script("tests/policies/scripted.py", policy_trait)
}

/// `memtransfer run` of three cases with a policy command, not started yet.
fn slice(bench: &Bench, out: &str, policy: &str, more: &[&str]) -> Command {
    let mut args = vec!["run", "--policy-cmd", policy, "--limit", "3", "--starts", "original"];
    args.extend(["--out", out]);
    args.extend(more);
    let mut command = bench.command(&args);
    command.env("PYTHONPATH", package());
    command
}

/// Short episodes on small frames.
const SHORT: [&str; 8] =
    ["--memory", "working", "--frame-size", "64", "--max-steps", "7", "--lanes", "3"];

fn finish(mut command: Command) -> Ended {
    Ended::of(command.spawn().expect("memtransfer starts"))
}

/// The lines of a JSON file in the folder of a run.
fn json_lines(path: &Path) -> Vec<Value> {
    let text = fs::read_to_string(path).expect("the file is there");
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The episodes of a run as `memtransfer.results` reads them.
fn read_run(run: &Path) -> Vec<Value> {
    let ended = python(&["tests/read_run.py", run.to_str().unwrap()], &[]).expect(0);
    serde_json::from_str(&ended.stdout).unwrap()
}

/// The entries of the prompt log of a run's first session.
fn prompt_log(run: &Path) -> Vec<Value> {
    json_lines(&run.join("prompts/session-1/generation-1.jsonl"))
}

/// The tests that start runs.
const EVALUATION_TESTS: &str = "tests/test_evaluation.py";

#[test]
fn the_package_passes_its_own_tests() {
    python(&["-m", "pytest", "--ignore", EVALUATION_TESTS], &[]).expect(0);
}

#[test]
fn the_package_evaluates_objects() {
    let listed = python(&["-m", "pytest", "--collect-only", EVALUATION_TESTS], &[]);
    let listed = listed.expect(0).stdout;
    let tests: Vec<&str> =
        listed.lines().filter(|line| line.starts_with(EVALUATION_TESTS)).collect();
    assert!(tests.len() > 10, "{listed}");
    let program = program("memtransfer");
    for test in tests {
        // Each has the time of one run.
        let variables = [("MEMTRANSFER_PROGRAM", program.to_str().unwrap())];
        python(&["-m", "pytest", test], &variables).expect(0);
    }
}

/// As `mypy.ini` and `pyrightconfig.json` say.
#[test]
fn the_package_and_its_examples_are_typed() {
    let bench = Bench::new();
    let cache = bench.out("mypy");
    let cache = ["--cache-dir", cache.to_str().unwrap()];
    let mypy = |paths: &[&str]| {
        python(&[&["-m", "mypy"][..], &cache, paths].concat(), &[]).expect(0);
    };
    mypy(&["memtransfer", "examples"]);
    // Modules of one name, so each alone. pyright's strict rules ask for types that the simulators do not have.
    for world in ["minigrid", "miniworld", "metaworld"] {
        mypy(&[repository(&format!("examples/worlds/{world}/world.py")).to_str().unwrap()]);
    }
    for memory in fs::read_dir(repository("examples/memories")).unwrap() {
        mypy(&[memory.unwrap().path().join("memory.py").to_str().unwrap()]);
    }
    let packages = needs::python();
    python(&["-m", "pyright", "--pythonpath", packages.to_str().unwrap()], &[]).expect(0);
}

/// The package as `pip install` installs it, in a folder. Inspect names the tasks of packages in folders of this name only.
static SITE_PACKAGES: LazyLock<PathBuf> = LazyLock::new(|| {
    let place = Path::new(env!("CARGO_TARGET_TMPDIR")).join("site-packages");
    if place.exists() {
        std::fs::remove_dir_all(&place).unwrap();
    }
    let wheel = wheel::WHEEL.to_str().unwrap();
    let target = ["--no-compile", "--target", place.to_str().unwrap()];
    python(&[&wheel::PIP_INSTALL[..], &target, &[wheel]].concat(), &[]).expect(0);
    place
});

#[test]
fn requests_match_the_prompt_log_and_their_pixels_are_shared_memory() {
    let bench = Bench::new();
    let seen = bench.out("seen.jsonl");
    let observer = script("tests/policies/observer.py", seen.to_str().unwrap());
    let more = ["--memory", "full-context,hybrid,episodic", "--lanes", "4", "--max-steps", "8"];
    let mut command = slice(&bench, "observed", &observer, &more);
    command.args(["--log-prompts", "--frame-size", "64"]);
    finish(command).expect(0);
    let run = bench.out("observed");
    let id = |entry: &Value| (entry["episode"].as_u64(), entry["step"].as_u64());
    let mut seen = json_lines(&seen);
    let mut recorded = prompt_log(&run);
    seen.sort_by_key(id);
    recorded.sort_by_key(id);
    assert_eq!(seen.len(), recorded.len());
    assert!(recorded.len() >= 72, "{} requests", recorded.len());
    let document = |hash: &Value, suffix: &str| {
        let name = format!("{}.{suffix}", hash.as_str().unwrap());
        fs::read_to_string(run.join("prompts/documents").join(name)).unwrap()
    };
    let (mut texts, mut demonstrations, mut segments) = (0, 0, 0);
    for (seen, recorded) in seen.iter().zip(&mut recorded) {
        let request = &mut recorded["request"];
        let mut seen = seen.clone();
        for item in request["items"].as_array_mut().unwrap() {
            if let Some(text) = item.get_mut("text") {
                text["text"] = document(&text["text"], "txt").into();
                texts += 1;
            } else if let Some(steps) = item.pointer_mut("/trajectory/steps") {
                *steps = serde_json::from_str(&document(steps, "json")).unwrap();
                demonstrations += 1;
            } else {
                segments += 1;
            }
        }
        for request in [&mut seen["request"], &mut *request] {
            for item in request["items"].as_array_mut().unwrap() {
                if let Some(distance) = item.pointer_mut("/segment/distance") {
                    // One has the digits of 32 bits, the other those of 64.
                    *distance = json!(distance.as_f64().unwrap() as f32);
                }
            }
        }
        assert_eq!(seen["request"], *request);
    }
    assert!(texts > 0 && demonstrations > 0 && segments > 0);
    let manifest = fs::read_to_string(run.join("manifest.json")).unwrap();
    let manifest: Value = serde_json::from_str(&manifest).unwrap();
    let facts = &manifest["processes"]["policy"];
    assert_eq!(
        (&facts["policy"], &facts["sdk"], &facts["model"]),
        (&json!("observer"), &json!("python"), &json!("none"))
    );
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn kept_pixels_stay_valid_and_evicted_frames_raise() {
    let bench = Bench::new();
    let seen = bench.out("seen.txt");
    let keeper = script("tests/policies/keeper.py", seen.to_str().unwrap());
    let more = ["--memory", "working", "--frame-size", "64", "--frame-budget", "64"];
    let mut command = slice(&bench, "kept", &keeper, &more);
    command.args(["--lanes", "2", "--runs", "3", "--max-steps", "100"]);
    finish(command).expect(0);
    let seen = fs::read_to_string(seen).expect("frames were evicted");
    assert!(seen.ends_with("frames are gone"), "{seen}");
}

#[test]
fn a_policy_that_keeps_too_many_pixels_stops_the_run() {
    let bench = Bench::new();
    let more = ["--memory", "working", "--frame-size", "64", "--frame-budget", "64"];
    let mut command = slice(&bench, "hoard", &scripted("hoards"), &more);
    command.args(["--lanes", "2", "--runs", "3", "--max-steps", "100"]);
    let ended = finish(command);
    assert_ne!(ended.status, Some(0), "{}", ended.stderr);
    assert!(ended.stderr.contains("frames that were evicted"), "{}", ended.stderr);
    assert!(ended.stderr.contains("copy the pixels"), "{}", ended.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn every_form_of_an_answer_arrives() {
    let bench = Bench::new();
    let mut command = slice(&bench, "answers", &scripted("every_answer"), &SHORT);
    command.arg("--log-prompts");
    finish(command).expect(0);
    let run = bench.out("answers");
    for record in records(&run) {
        assert_eq!(record["actions"], "U???b??");
        assert_eq!(record["unread"], json!({"unreadable": 2, "empty": 1, "refused": 2}));
    }
    let log = prompt_log(&run);
    let answers: Vec<_> =
        log.iter().filter(|entry| entry["episode"] == log[0]["episode"]).collect();
    assert_eq!(
        answers[4]["answer"],
        json!({"outcome": "acted", "action": "move backward", "images_asked": 5, "images": 0})
    );
    assert_eq!(
        answers[4]["usage"],
        json!({
            "prompt_tokens": 100,
            "completion_tokens": 3,
            "image_tokens": 0,
            "attempts": 2,
            "replayed": true
        })
    );
    assert_eq!(answers[4]["timing"]["prompted_ns"], 5);
    assert_eq!(answers[4]["timing"]["sent_ns"], 6);
    assert!(answers[0]["usage"].is_null());
    assert_eq!(answers[0]["answer"]["images"], 1);
}

#[test]
fn an_exception_costs_its_own_episode() {
    let bench = Bench::new();
    finish(slice(&bench, "one", &scripted("raises_in_lane_1"), &SHORT)).expect(1);
    let run = bench.out("one");
    assert_eq!(records(&run).len(), 2);
    let errors = json_lines(&run.join("errors.jsonl"));
    let said = "policy raises_in_lane_1 raised RuntimeError: cannot do lane 1";
    assert!(errors[0]["error"].as_str().unwrap().contains(said), "{errors:?}");
    let read = read_run(&run);
    assert_eq!(read.iter().filter(|row| row["success"].is_null()).count(), 1);
    let log = fs::read_to_string(run.join("logs/policy.log")).unwrap();
    assert!(log.contains("Traceback") && log.contains("in raises_in_lane_1"), "{log}");
}

#[test]
fn a_policy_that_always_raises_stops_the_run() {
    let bench = Bench::new();
    let mut command = slice(&bench, "always", &scripted("raises"), &SHORT[..6]);
    command.args(["--lanes", "1", "--runs", "4"]);
    let ended = finish(command);
    assert_ne!(ended.status, Some(0));
    assert!(ended.stderr.contains("exception 8 in a row"), "{}", ended.stderr);
}

#[test]
fn a_failure_outside_the_policy_abandons_its_episode() {
    let bench = Bench::new();
    finish(slice(&bench, "failed", &scripted("fails"), &SHORT)).expect(1);
    let errors = json_lines(&bench.out("failed/errors.jsonl"));
    assert_eq!(errors.len(), 3);
    assert!(errors[0]["error"].as_str().unwrap().contains("the server is down"), "{errors:?}");
}

#[test]
fn a_broken_contract_ends_the_policy_with_a_message() {
    let bench = Bench::new();
    for (policy_trait, said) in [
        ("no_answers", "policy no_answers answered 0 of 1 requests: it must answer each once"),
        ("returns_none", "policy returns_none returned None from act"),
        ("number", "policy number answered 7 (int): an answer is an Action, the number (0 to 6)"),
        ("acted", "policy acted answered <Outcome.ACTED: 0> (Outcome)"),
        ("negative", "does not fit into a message"),
        ("numbers", "policy numbers: its facts must be text"),
        ("raises_on_reset", "RuntimeError: cannot reset"),
    ] {
        let mut command = slice(&bench, policy_trait, &scripted(policy_trait), &SHORT[..6]);
        command.args(["--lanes", "1", "--cases", "t01-01"]);
        let ended = finish(command);
        assert_ne!(ended.status, Some(0), "{policy_trait}");
        let log = fs::read_to_string(bench.out(policy_trait).join("logs/policy.log"))
            .unwrap_or_else(|error| panic!("{policy_trait}: {error}\n{}", ended.stderr));
        assert!(log.contains(said), "{policy_trait}: {log}");
        assert_eq!(log.contains("Traceback"), policy_trait == "raises_on_reset", "{log}");
    }
}

/// The other processes cannot send to it from then on, and end at once.
#[test]
fn a_policy_that_takes_long_to_end_is_the_one_to_blame() {
    let bench = Bench::new();
    let mut command = slice(&bench, "slow", &scripted("leaves_slowly"), &SHORT[..6]);
    command.args(["--lanes", "8", "--cases", "t01-01,t03-02"]);
    let ended = finish(command).expect(1);
    let said = "the policy process";
    assert!(
        ended.stderr.contains(said) && !ended.stderr.contains("the sim process"),
        "{}",
        ended.stderr
    );
}

#[test]
fn a_conversation_is_logged_without_what_cannot_be_stored() {
    let bench = Bench::new();
    let mut command = slice(&bench, "asked", &scripted("asks"), &SHORT);
    command.arg("--log-prompts");
    finish(command).expect(0);
    let run = bench.out("asked");
    let entry = &prompt_log(&run)[0];
    let exchange = &entry["exchange"];
    assert_eq!(exchange["reply"], "no ? idea");
    assert_eq!(exchange["unread"], "no action in it");
    let messages = exchange["messages"].as_array().unwrap();
    let roles: Vec<_> = messages.iter().map(|message| &message["role"]).collect();
    assert_eq!(roles, ["system", "user", "assistant"]);
    // The long text of the rules is stored once.
    let rules = messages[0]["parts"][0]["stored"].as_str().unwrap();
    let rules = fs::read_to_string(run.join(format!("prompts/documents/{rules}.txt"))).unwrap();
    assert!(rules.contains("You control a robot in a warehouse."), "{rules}");
    let view = &entry["request"]["frame"];
    let parts = messages[1]["parts"].as_array().unwrap();
    let other = &parts[4]["image"];
    assert_ne!(other, view);
    for image in [view, other] {
        let file = run.join(format!("prompts/images/{}.png", image.as_str().unwrap()));
        assert!(fs::read(file).unwrap().starts_with(b"\x89PNG"));
    }
    assert_eq!(
        parts[..],
        [
            json!({"text": "look"}),
            json!({"image": view}),
            json!({"image": view}),
            json!({"image": view}),
            json!({"image": other}),
            json!({"text": "[an image (image/jpeg, 3 bytes) that is not kept]"}),
            json!({"text": "[an image (image/png) that is not valid base64]"}),
            json!({"text": "[the image at https://example.org/a.png]"}),
            json!({"text": format!("[the image at image:{}]", "0".repeat(32))}),
            json!({"text": r#"{"type":"strange","value":3}"#}),
        ]
    );
    assert_eq!(messages[2]["parts"], json!([{"text": r#"{"tool_calls":[{"id":"a"}]}"#}]));
}

/// A run that waits for a policy started by the test, and the folder that it names.
struct Waiting {
    run: Child,
    folder: String,
}

impl Waiting {
    fn new(bench: &Bench, out: &str) -> Self {
        let mut args = vec!["run", "--policy", "external", "--limit", "3", "--starts", "original"];
        args.extend(["--out", out, "--frame-size", "64", "--memory", "working"]);
        args.extend(["--runs", "200", "--warm-views"]);
        let mut run = bench.start(&args);
        let mut lines = BufReader::new(run.stderr.take().unwrap()).lines();
        let folder = lines.by_ref().find_map(|line| {
            let line = line.unwrap();
            let (_, folder) = line.split_once("MEMTRANSFER_ATTACH=")?;
            folder.split_whitespace().next().map(str::to_owned)
        });
        // The rest is read and dropped, so that the run can go on writing.
        std::thread::spawn(move || lines.for_each(drop));
        Self { run, folder: folder.expect("the run names its folder") }
    }

    /// Starts the random example and waits until it decides.
    fn policy(&self, bench: &Bench, out: &str) -> Child {
        let script = package().join("examples/random_policy.py");
        let variables = [("MEMTRANSFER_ATTACH", self.folder.as_str())];
        // A test in the background may inherit an ignored SIGINT; a policy at a terminal does not.
        let start = "import runpy, signal, sys; \
            signal.signal(signal.SIGINT, signal.default_int_handler); \
            runpy.run_path(sys.argv[1], run_name='__main__')";
        let policy = start_python(&["-c", start, script.to_str().unwrap()], &variables);
        let run = bench.out(out);
        eventually("an episode to be finished", || (!episodes(&run).is_empty()).then_some(()));
        policy
    }
}

fn send(process: u32, signal: Signal) {
    kill_process(Pid::from_raw(i32::try_from(process).unwrap()).unwrap(), signal).unwrap();
}

#[test]
fn signals_end_a_policy_quietly() {
    let bench = Bench::new();
    for (out, signal, status) in
        [("interrupted", Signal::INT, 130), ("terminated", Signal::TERM, 143)]
    {
        let mut waiting = Waiting::new(&bench, out);
        let policy = waiting.policy(&bench, out);
        send(policy.id(), signal);
        let ended = Ended::of(policy).expect(status);
        assert_eq!((ended.stdout.as_str(), ended.stderr.as_str()), ("", ""));
        send(waiting.run.id(), Signal::TERM);
        waiting.run.wait().unwrap();
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_policy_ends_when_the_orchestrator_is_gone() {
    let bench = Bench::new();
    let mut waiting = Waiting::new(&bench, "killed");
    let policy = waiting.policy(&bench, "killed");
    kill(waiting.run.id());
    waiting.run.wait().unwrap();
    let ended = Ended::of(policy).expect(0);
    assert!(ended.stderr.contains("ended without a stop message"), "{}", ended.stderr);
    bench.run(&["clean"]).expect(0);
}

#[test]
fn without_a_run_a_policy_names_the_command_that_starts_one() {
    let bench = Bench::new();
    let policy = "examples/random_policy.py";
    let ended = python(&[policy], &[]).expect(2);
    assert!(
        ended.stderr.starts_with("memtransfer: MEMTRANSFER_ATTACH is not set"),
        "{}",
        ended.stderr
    );
    assert!(ended.stderr.contains("memtransfer run --policy-cmd"), "{}", ended.stderr);
    let nowhere = bench.out("nowhere");
    let ended = python(&[policy], &[("MEMTRANSFER_ATTACH", nowhere.to_str().unwrap())]).expect(2);
    assert!(ended.stderr.contains("is not the folder of a run"), "{}", ended.stderr);
    fs::create_dir(&nowhere).unwrap();
    fs::write(nowhere.join("attach.json"), r#"{"wire_version": 999}"#).unwrap();
    let ended = python(&[policy], &[("MEMTRANSFER_ATTACH", nowhere.to_str().unwrap())]).expect(2);
    assert!(ended.stderr.contains("wire version 999"), "{}", ended.stderr);
    assert!(!ended.stderr.contains("Traceback"), "{}", ended.stderr);
    let classes = "import memtransfer as m\ntry: m.serve(None, 'x')\nexcept TypeError: pass\n\
        class P(m.Policy):\n  def act(self, batch): return []\n\
        try: m.serve(P(), '/nowhere')\nexcept m.AttachError as e: print(e)";
    let ended = python(&["-c", classes], &[]).expect(0);
    assert!(ended.stdout.starts_with("/nowhere is not the folder of a run"), "{}", ended.stdout);
}

#[test]
fn policies_and_memories_in_another_world_are_given_its_numbers_and_words() {
    let bench = Bench::new();
    let [world, policy, memory] = [
        ("examples/corridor_world.py", ""),
        ("tests/policies/any_world.py", "policy"),
        ("tests/policies/any_world.py", "memory"),
    ]
    .map(|(path, arguments)| script(path, arguments));
    let mut command = bench.command(&["run", "--world-cmd", &world, "--policy-cmd", &policy]);
    command.args(["--memory", "none", "--memory-cmd", &memory, "--cases", "reach-7,reach-8"]);
    command.args(["--frame-size", "64", "--out", "corridor"]).env("PYTHONPATH", package());
    finish(command).expect(0);
    let records = records(&bench.out("corridor"));
    let actions: Vec<_> =
        records.iter().map(|record| record["actions"].as_str().unwrap()).collect();
    assert!(
        actions.iter().all(|letters| letters.chars().all(|letter| letter == 'a')),
        "{actions:?}"
    );
    assert!(records.iter().all(|record| record["ending"] == "complete"), "{records:?}");
    assert_eq!(records.len(), 4);
}

/// `memtransfer run` in the corridor with a scripted policy, not started yet.
fn corridor(bench: &Bench, flags: &[&str], out: &str) -> Command {
    let mut command = bench.command(&["run", "--policy", "imitate", "--out", out]);
    command.args(words("--memory working,full-context,episodic,adaptive --lanes 6 --max-steps 30"));
    command.args(words("--runs 10 --routes unchanged,blocked --frame-size 64"));
    command.args(flags).env("PYTHONPATH", package());
    command
}

#[test]
fn several_processes_of_a_world_have_the_log_of_one_and_one_of_them_may_be_killed() {
    let bench = Bench::new();
    let world = script("examples/corridor_world.py", "");
    let started = |worlds: &str, out: &str| {
        corridor(&bench, &["--world-cmd", &world, "--worlds", worlds], out)
    };
    for worlds in ["1", "3"] {
        finish(started(worlds, worlds)).expect(0);
    }
    let reference = sorted_log(&bench.out("1"));
    assert_eq!(reference.len(), 4 * 3 * 4 * 10);
    assert_eq!(sorted_log(&bench.out("3")), reference);

    let child = started("3", "killed").spawn().unwrap();
    wait_for_episodes(&bench.out("killed"), 2);
    kill(process_of_world(bench.registry.path(), 1));
    let ended = Ended::of(child).expect(0);
    assert!(ended.stderr.contains("the sim process 1 (`"), "{}", ended.stderr);
    assert_eq!(sorted_log(&bench.out("killed")), reference);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_run_waits_for_worlds_that_the_user_starts_and_starts_again() {
    let bench = Bench::new();
    let world = script("examples/corridor_world.py", "");
    finish(corridor(&bench, &["--world-cmd", &world], "reference")).expect(0);
    let book = bench.out("book");
    let book = book.to_str().unwrap();
    python(&["examples/corridor_world.py", "book", "--out", book], &[]).expect(0);
    let flags = ["--world", "external", "--world-book", book, "--worlds", "2"];
    let mut run = corridor(&bench, &flags, "external").spawn().unwrap();
    // What it tells to start, word by word.
    let mut lines = BufReader::new(run.stderr.take().unwrap()).lines().map(Result::unwrap);
    let mut told = || lines.find(|line| line.contains("MEMTRANSFER_ATTACH=")).unwrap();
    let told = [told(), told()];
    std::thread::spawn(move || lines.for_each(drop));
    let start = |line: &String| {
        let words = words(line);
        let variables = words.iter().filter_map(|word| word.split_once('='));
        let arguments = words.iter().skip_while(|word| **word != "serve");
        let arguments = ["examples/corridor_world.py"].into_iter().chain(arguments.copied());
        start_python(&arguments.collect::<Vec<_>>(), &variables.collect::<Vec<_>>())
    };
    let [first, mut second] = [start(&told[0]), start(&told[1])];
    wait_for_episodes(&bench.out("external"), 2);
    kill(second.id());
    second.wait().unwrap();
    let second = start(&told[1]);
    assert_eq!(Ended::of(run).status, Some(0));
    for world in [first, second] {
        Ended::of(world).expect(0);
    }
    let log = sorted_log(&bench.out("external"));
    assert_eq!(log, sorted_log(&bench.out("reference")));
    // Its pages are those of another world, too.
    let mut view = bench.command(&["view", "external", "--out", "pages"]);
    view.env("MEMTRANSFER_WORLD_CMD", &world).env("PYTHONPATH", package());
    finish(view).expect(0);
    assert!(std::fs::read_dir(bench.out("pages/run1/views")).unwrap().count() > 10);
    bench.run(&["report", "external"]).expect(0);
    let page = std::fs::read_to_string(bench.out("external/report/report.html")).unwrap();
    assert!(page.contains("The world was started by the user."));
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
