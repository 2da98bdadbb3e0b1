//! The Python package: its own tests, its types, its installation, and its examples on the benchmark.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use llm::scripted::{Server, Turn};
use memtransfer_tests::{
    Bench, Ended, episodes, eventually, kill, needs, processes_with, records, sorted_log,
};
use prompt::read_answer;

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
    assert!(place.join("memtransfer/_prompt.json").is_file());
    let look = "import memtransfer, pathlib; print(pathlib.Path(memtransfer.__file__).parent)";
    let ended = python(&["-P", "-c", look], &[("PYTHONPATH", place.to_str().unwrap())]).expect(0);
    assert_eq!(ended.stdout.trim(), place.join("memtransfer").to_str().unwrap());
}

/// What the harness's parser reads in `text`, in the words of the package.
fn read(text: &str) -> String {
    match read_answer(text) {
        Ok(action) => action.words().replace("move ", "").replace(' ', "_"),
        Err(why) => format!("{:?}", why.answer().outcome()).to_lowercase(),
    }
}

/// Texts of words that matter to the parser, drawn from `seed`.
fn drawn(mut seed: u64) -> String {
    const WORDS: [&str; 64] = [
        "turn",
        "move",
        "go",
        "step",
        "walk",
        "take",
        "make",
        "rotate",
        "strafe",
        "head",
        "left",
        "right",
        "forward",
        "back",
        "backward",
        "around",
        "straight",
        "ahead",
        "clockwise",
        "counter",
        "u",
        "about",
        "face",
        "half",
        "quarter",
        "90",
        "180",
        "45",
        "2",
        "degrees",
        "°",
        "to",
        "the",
        "my",
        "a",
        "on",
        "is",
        "by",
        "one",
        "cell",
        "and",
        "or",
        "then",
        "not",
        "don't",
        "maybe",
        "if",
        "instead",
        "rack",
        "now",
        "way",
        "all",
        "corner",
        "action",
        ":",
        ",",
        ".",
        "?",
        "\n",
        "/",
        "<think>",
        "</think>",
        "{\"action\":\"",
        "\"}",
    ];
    let mut draw = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as usize
    };
    let length = 1 + draw() % 8;
    (0..length).map(|_| WORDS[draw() % WORDS.len()]).collect::<Vec<_>>().join(" ")
}

#[test]
fn the_package_reads_answers_as_the_harness_does() {
    let bench = Bench::new();
    let table = fs::read_to_string(package().join("tests/answers.json")).unwrap();
    let table: Vec<(String, String)> = serde_json::from_str(&table).unwrap();
    assert!(table.len() > 150);
    for (text, expected) in &table {
        assert_eq!(&read(text), expected, "{text:?}");
    }
    let drawn: Vec<(String, String)> =
        (0..20_000).map(|seed| (drawn(seed), read(&drawn(seed)))).collect();
    let actions = drawn.iter().filter(|(_, read)| read != "unreadable").count();
    assert!(actions > 1000, "{actions} texts hold an action");
    let path = bench.out("drawn.json");
    fs::write(&path, serde_json::to_string(&drawn).unwrap()).unwrap();
    let compare = "import json, sys; from memtransfer.prompt import read_answer; \
        table = json.load(open(sys.argv[1])); \
        wrong = [(text, there, here) for text, there in table \
                 if (here := read_answer(text).name.lower()) != there]; \
        sys.exit(str(wrong[:9]) if wrong else 0)";
    python(&["-c", compare, path.to_str().unwrap()], &[]).expect(0);
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

#[test]
fn the_endpoint_example_asks_a_server() {
    let bench = Bench::new();
    let server = Server::start(|_| Turn::says("Action: turn left")).unwrap();
    let policy = format!("{} scripted", example("endpoint_policy.py"));
    let more = ["--memory", "working", "--max-steps", "5", "--log-prompts"];
    let mut command = slice(&bench, "endpoint", &policy, &more);
    command.env("OPENAI_BASE_URL", server.base_url()).env("OPENAI_API_KEY", "none");
    walk(command);
    let walked = records(&bench.out("endpoint"));
    assert_eq!(walked.len(), 3);
    for record in &walked {
        assert_eq!(record["actions"], "LLLLL");
        assert_eq!(
            (&record["prompt_tokens"], &record["completion_tokens"]),
            (&50.into(), &25.into())
        );
    }
    let received = server.received();
    assert_eq!(received.len(), 15);
    let system = &received[0].body["messages"][0]["content"];
    assert!(system.as_str().unwrap().contains("You control a robot in a warehouse."));
    // The package keeps prompt logs as the harness does.
    let case = walked[0]["case"].as_str().unwrap();
    let shown = bench.run(&["show", "endpoint", case, "2"]).expect(0).stdout;
    for part in
        ["Message of role user", "  [image ", "Reply\n  Action: turn left", "acted: turn left"]
    {
        assert!(shown.contains(part), "no {part:?} in {shown}");
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
