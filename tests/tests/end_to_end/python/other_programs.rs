//! The package in Inspect, the data sets that it writes, and its Gymnasium environment.

use std::fs;
use std::io;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use memtransfer_tests::browser::Browser;
use memtransfer_tests::{Bench, Ended, KilledOnDrop, eventually, needs, program, records};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};

use super::{SITE_PACKAGES, finish, package, script, scripted};

/// Starts the Python of Inspect with short episodes.
fn start_inspect(bench: &Bench, args: &[&str]) -> Child {
    inspect_python(bench, args, "5").spawn().expect("Python starts")
}

/// The Python of Inspect. What is temporary is in the folder `tmp`.
fn inspect_python(bench: &Bench, args: &[&str], max_steps: &str) -> Command {
    let programs = program("memtransfer").with_file_name("");
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    fs::create_dir_all(bench.out("tmp")).unwrap();
    let mut command = Command::new(needs::inspect_python());
    command
        .args(args)
        .current_dir(bench.folder.path())
        .env("PYTHONPATH", SITE_PACKAGES.as_path())
        .env("PATH", path)
        .env("TMPDIR", bench.out("tmp"))
        .env("MEMTRANSFER_RUN_DIR", bench.registry.path())
        .env("MEMTRANSFER_MAX_STEPS", max_steps)
        .env("MEMTRANSFER_FRAME_SIZE", "64")
        .env("INSPECT_LOG_DIR", bench.out("logs"))
        .env("XDG_DATA_HOME", bench.out("data"))
        // Without a network, and without what an earlier run may have downloaded.
        .env("HTTPS_PROXY", "http://127.0.0.1:9")
        .env("TIKTOKEN_CACHE_DIR", bench.out("tiktoken"))
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// `inspect eval` with a mock model.
fn eval<'a>(task: &'a str, args: &[&'a str]) -> Vec<&'a str> {
    let fixed = ["-m", "inspect_ai", "eval", task, "--model", "mockllm/model", "--display", "none"];
    [&fixed[..], args].concat()
}

/// Evaluates, and returns the log.
fn evaluated(bench: &Bench, task: &str, args: &[&str]) -> Value {
    Ended::of(start_inspect(bench, &eval(task, args))).expect(0);
    let print = "from inspect_ai.log import list_eval_logs, read_eval_log; \
                 print(read_eval_log(list_eval_logs()[0]).model_dump_json())";
    let printed = Ended::of(start_inspect(bench, &["-c", print])).expect(0).stdout;
    fs::remove_dir_all(bench.out("logs")).unwrap();
    serde_json::from_str(&printed).unwrap()
}

/// What is left of the runs of an evaluation.
fn left_of(bench: &Bench) -> Vec<String> {
    let temporary = fs::read_dir(bench.out("tmp")).unwrap();
    let temporary = temporary.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    // Inspect has files of its own there.
    let runs = temporary.filter(|name| name.starts_with("memtransfer"));
    bench.leftovers().into_iter().chain(runs).collect()
}

#[test]
fn an_episode_that_a_limit_of_inspect_stops_counts_as_failed() {
    let bench = Bench::new();
    for (limit, value) in [("message", "2"), ("token", "500"), ("turn", "2"), ("time", "2")] {
        let flag = format!("--{limit}-limit");
        // A time limit ends the sample whenever it comes: while the run starts, too.
        let log =
            evaluated(&bench, "memtransfer/rq1", &["--limit", "2", "--epochs", "1", &flag, value]);
        assert_eq!(log["status"], "success", "{limit}: {}", log["error"]);
        for sample in log["samples"].as_array().unwrap() {
            if limit == "time" && sample["limit"].is_null() {
                continue;
            }
            assert_eq!(sample["limit"]["type"], limit);
            let score = &sample["scores"]["episode_scorer"];
            assert_eq!(score["value"]["success"], 0.0);
            assert_eq!(score["value"]["spl"], 0.0);
            let explanation = score["explanation"].as_str().unwrap().to_lowercase();
            assert!(
                explanation.contains("was not finished, and counts as failed"),
                "{explanation}"
            );
            assert!(explanation.contains(&format!("{limit} limit")), "{explanation}");
        }
        assert_eq!(left_of(&bench), Vec::<String>::new(), "{limit}");
    }
}

/// Epochs are repetitions of one run: the warehouse elsewhere, which the run's seed gives, is the same in all.
#[test]
fn epochs_of_inspect_are_repetitions() {
    let bench = Bench::new();
    let suite = "memory = [\"episodic\"]\nstarts = [\"original\"]\nroutes = [\"unchanged\"]\ndemos = [\"elsewhere\"]\nruns = 2\n";
    fs::write(bench.out("elsewhere.toml"), suite).unwrap();
    let out = format!("out={}", bench.out("runs").display());
    let args = ["-T", "name=elsewhere.toml", "-T", &out, "--limit", "1"];
    let log = evaluated(&bench, "memtransfer/suite", &args);
    assert_eq!(log["status"], "success", "{}", log["error"]);
    let samples = log["samples"].as_array().unwrap();
    let keys: Vec<_> = samples
        .iter()
        .map(|sample| sample["metadata"]["episode"]["key"].as_str().unwrap())
        .collect();
    assert_eq!(
        keys,
        [
            "episodic/original/unchanged/elsewhere/run1/t01-01",
            "episodic/original/unchanged/elsewhere/run2/t01-01"
        ]
    );
    let read = |epoch: u64, file: &str| {
        let run = format!("t01-01.episodic.original.unchanged.elsewhere.{epoch}");
        fs::read(bench.out("runs").join(run).join(file)).unwrap()
    };
    assert_eq!(read(1, "elsewhere.json"), read(2, "elsewhere.json"));
    assert_ne!(read(1, "episodes.jsonl"), read(2, "episodes.jsonl"));
    let ended = bench.run(&["run", "--runs", "2", "--repetition", "3", "--out", "never"]).expect(2);
    assert!(ended.stderr.contains("there is no repetition 3: --runs is 2"), "{}", ended.stderr);
}

#[test]
fn nothing_is_left_of_an_evaluation_of_inspect_that_is_killed() {
    let bench = Bench::new();
    for signal in [Signal::TERM, Signal::KILL] {
        let args = eval("memtransfer/rq1", &["--limit", "3", "--epochs", "1"]);
        let child = inspect_python(&bench, &args, "10000").spawn().unwrap();
        eventually("an episode to run", || {
            let runs = fs::read_dir(bench.out("tmp")).unwrap().flatten();
            let mut logs = runs.map(|run| run.path().join("sessions.jsonl"));
            logs.any(|log| fs::read_to_string(log).is_ok_and(|log| log.contains("ready")))
                .then_some(())
        });
        kill_process(Pid::from_raw(child.id().cast_signed()).unwrap(), signal).unwrap();
        Ended::of(child);
        eventually("the runs to end", || left_of(&bench).is_empty().then_some(()));
    }
}

/// Two samples of a suite with a model of Inspect that always turns left.
#[test]
fn a_suite_runs_in_inspect_and_its_log_can_be_read() {
    let bench = Bench::new();
    let start = |args: &[&str]| start_inspect(&bench, args);
    let inspect = |args: &[&str]| Ended::of(start(args)).expect(0).stdout;
    // From the command line.
    inspect(&eval("memtransfer/rq1", &["--limit", "1", "--epochs", "1"]));
    let [log] = &fs::read_dir(bench.out("logs")).unwrap().collect::<Vec<_>>()[..] else { panic!() };
    let log = log.as_ref().unwrap().path();

    let script = package().join("tests/inspect_suite.py");
    let dumps = inspect(&[script.to_str().unwrap()]);
    let dumps: Vec<Value> = dumps.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let [dump, from_command_line] = &dumps[..] else { panic!("{} logs", dumps.len()) };
    assert_eq!(dump["eval"]["task_registry_name"], "memtransfer/rq1");
    let samples = dump["samples"].as_array().unwrap();
    let mut ids: Vec<_> = samples.iter().map(|sample| sample["id"].as_str().unwrap()).collect();
    ids.sort_unstable();
    assert_eq!(
        ids,
        ["t01-01.working.new.unchanged.none", "t01-01.working.original.unchanged.none"]
    );
    for sample in samples {
        assert_eq!(sample["input"], "Find a yellow fire extinguisher.");
        let score = &sample["scores"]["episode_scorer"];
        assert_eq!(score["value"], json!({"success": 0.0, "spl": 0.0, "steps": 5.0}));
        assert_eq!(sample["metadata"]["episode"]["actions"], "LLLLL");
        let calls = sample["events"].as_array().unwrap().iter();
        assert_eq!(calls.filter(|event| event["event"] == "model").count(), 5);
        let [system, user, reply] = &sample["messages"].as_array().unwrap()[..] else { panic!() };
        assert!(
            system["content"].as_str().unwrap().contains("You control a robot in a warehouse.")
        );
        let images = user["content"].as_array().unwrap().iter();
        assert_eq!(images.filter(|part| part["type"] == "image").count(), 5);
        assert_eq!(reply["role"], "assistant");
        // The run is kept, and is one of the harness.
        let run = bench.out("runs").join(format!("{}.1", sample["id"].as_str().unwrap()));
        assert_eq!(records(&run).len(), 1);
    }

    let dump = from_command_line;
    assert_eq!(dump["status"], "success", "{}", dump["error"]);
    let [sample] = &dump["samples"].as_array().unwrap()[..] else { panic!() };
    assert_eq!(sample["metadata"]["episode"]["steps"], 5);
    assert!(sample["model_usage"]["mockllm/model"]["input_tokens"].as_u64().unwrap() > 100);

    // The same log in Inspect View.
    let (view, address) = loop {
        let port =
            TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port().to_string();
        let view = ["-m", "inspect_ai", "view", "start", "--host", "127.0.0.1", "--port", &port];
        let mut view = KilledOnDrop(start(&view));
        let address = format!("127.0.0.1:{port}");
        let status = eventually("Inspect View", || match view.0.try_wait().unwrap() {
            None => TcpStream::connect(&address).is_ok().then_some(None),
            status => Some(status),
        });
        let Some(status) = status else { break (view, address) };
        // Another program was faster to take the port.
        let errors = io::read_to_string(view.0.stderr.take().unwrap()).unwrap();
        assert!(errors.contains("address already in use"), "{status}: {errors}");
    };
    let mut browser = Browser::start(1200, 800);
    let name = log.file_name().unwrap().to_str().unwrap().to_owned();
    browser.open(&format!("http://{address}/#/logs/{name}"));
    let shows = |text: &str| format!("!!document.body?.innerText.includes({text:?})");
    browser.wait_for(&shows("Find a yellow fire extinguisher."));
    assert_eq!(browser.value(&shows("mockllm/model")), true);
    drop((browser, view));
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// Runs `export` with `flags` and then the script that opens what it wrote, for four episodes of a
/// case and its demonstration.
fn export_and_open(python: &Path, flags: &[(&str, &str)], opener: &str) {
    let bench = Bench::new();
    let policy = scripted("every_answer");
    let mut args = vec!["run", "--policy-cmd", &policy, "--cases", "t01-01"];
    args.extend(["--starts", "original,new", "--memory", "working,full-context"]);
    args.extend(["--frame-size", "64", "--max-steps", "20", "--lanes", "4", "--out", "run"]);
    let mut command = bench.command(&args);
    command.env("PYTHONPATH", package());
    finish(command).expect(0);
    let run = bench.out("run").display().to_string();
    let call = |args: &[&str]| {
        let mut command = Command::new(python);
        command
            .args(args)
            .current_dir(bench.folder.path())
            .env("PYTHONPATH", package())
            .env("MINARI_DATASETS_PATH", bench.out("minari"))
            .env("HF_HOME", bench.out("hugging-face"))
            .env("HF_HUB_OFFLINE", "1")
            .env("HOME", bench.folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        Ended::of(command.spawn().expect("Python starts"))
    };
    if flags.iter().any(|(flag, _)| *flag == "--minari") {
        // A bad name is refused before anything is written.
        let named = call(&["-m", "memtransfer.export", &run, "--minari", "test"]).expect(2);
        assert!(named.stderr.contains("with a version"), "{}", named.stderr);
        assert!(!bench.out("minari").exists());
    }
    let mut export = vec!["-m", "memtransfer.export", &run, "--demonstrations"];
    export.extend(flags.iter().flat_map(|(flag, place)| [flag, place]));
    call(&export).expect(0);
    let refused = call(&export).expect(2);
    assert!(refused.stderr.contains("name another"), "{}", refused.stderr);
    let opener = package().join("tests").join(opener);
    let mut open = vec![opener.to_str().unwrap(), &run];
    open.extend(flags.iter().map(|(_, place)| place));
    call(&open).expect(0);
}

#[test]
fn data_sets_are_opened_by_the_readers_of_their_formats() {
    let flags = [
        ("--minari", "memtransfer/test-v0"),
        ("--rrd", "out/test.rrd"),
        ("--croissant", "out/tables"),
    ];
    export_and_open(&needs::datasets_python(), &flags, "open_datasets.py");
}

#[test]
#[ignore = "LeRobot takes 8 GB: `cargo xtask setup --lerobot`, then `cargo xtask test -- --ignored lerobot`"]
fn a_lerobot_data_set_is_opened_by_lerobot() {
    export_and_open(&needs::lerobot_python(), &[("--lerobot", "out/lerobot")], "open_lerobot.py");
}

/// A policy steps the environment beside the run, and compares pixels, pose, instruction and feedback.
#[test]
fn the_gymnasium_environment_shows_what_a_run_shows() {
    let bench = Bench::new();
    let cases = [
        ("t01-01", "original", "unchanged"),
        ("t03-07", "new", "unchanged"),
        ("t07-02", "new", "blocked"),
    ];
    for (case, start, route) in cases {
        let compared = bench.out(&format!("{case}.txt"));
        let arguments = format!("{} {case} {start} {route}", compared.display());
        let policy = script("tests/policies/environment.py", &arguments);
        let mut args = vec!["run", "--policy-cmd", &policy, "--cases", case, "--starts", start];
        args.extend(["--routes", route, "--memory", "working", "--frame-size", "128"]);
        args.extend(["--max-steps", "60", "--backend", "cpu", "--out", case]);
        let mut command = bench.command(&args);
        command.env("PYTHONPATH", package());
        finish(command).expect(0);
        assert_eq!(fs::read_to_string(compared).unwrap(), "60", "{case}");
    }
}
