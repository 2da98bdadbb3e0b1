//! `policy-proc probe` and `policy-proc cache` as a user runs them.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::process::{Child, Command, Output, Stdio};

use llm::{ChatClient, ChatRequest, ChatSettings, Endpoint, ReplyCache};
use rigs::chat_server::{Reaction, Server, completion};
use serde_json::{Value, json};

const KEY: &str = "sk-very-secret";

/// `policy-proc ARGUMENTS`, with the key as its only setting from the environment.
fn policy_proc(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_policy-proc"));
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    for variable in ["OPENAI_BASE_URL", "OPENAI_API_BASE", "MEMTRANSFER_CACHE", "XDG_CACHE_HOME"] {
        command.env_remove(variable);
    }
    command.env("OPENAI_API_KEY", KEY).env("RUST_LOG", "trace");
    command
}

/// The output, which must not contain the key.
fn ended(child: Child) -> Output {
    let output = child.wait_with_output().unwrap();
    let printed = [&output.stdout[..], &output.stderr[..]].concat();
    assert!(
        !String::from_utf8_lossy(&printed).contains("very-secret"),
        "the output contains the key"
    );
    output
}

fn run(arguments: &[&str]) -> Output {
    ended(policy_proc(arguments).spawn().unwrap())
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn value(output: &Output) -> Value {
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn stored_replies_can_be_listed_and_removed() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(|_| Reaction::says("North.")).unwrap();
    let endpoint = Endpoint::new(&server.base_url(), None).unwrap();
    let cache = ReplyCache::at(folder.path());
    let client = ChatClient::new(endpoint, ChatSettings::new("m"), Some(cache));
    for i in 0..20 {
        client.ask(&ChatRequest::text(format!("Question {i}?"), 9), 0).unwrap();
    }
    let here = folder.path().to_str().unwrap();
    let listing = value(&run(&["cache", "ls", "--json", "--response-cache", here]));
    assert_eq!((&listing["entries"], &listing["broken"]), (&json!(20), &json!(0)));
    assert_eq!(listing["models"][0]["model"], "m");
    let plain = stdout(&run(&["cache", "ls", "--response-cache", here]));
    assert!(plain.starts_with(&format!("{here}: 20 replies (")), "{plain}");

    let bytes = listing["bytes"].as_u64().unwrap();
    let half = (bytes / 2).to_string();
    let prune = ["cache", "prune", "--json", "--response-cache", here, "--max-bytes", &half];
    let left = value(&run(&prune))["left"]["entries"].as_u64().unwrap();
    assert!(matches!(left, 9..=10), "{left}");
    let prune = ["cache", "prune", "--json", "--response-cache", here, "--older-than", "1d"];
    assert_eq!(value(&run(&prune))["removed"]["entries"], 0);
    let prune = ["cache", "prune", "--response-cache", here, "--unusable", "--dry-run"];
    assert!(stdout(&run(&prune)).starts_with("would remove 0 replies (0 B); left "));
    let plain = stdout(&run(&["cache", "clear", "--response-cache", here]));
    assert!(plain.starts_with(&format!("removed {left} replies (")), "{plain}");
    assert_eq!(run(&["cache", "prune", "--response-cache", here]).status.code(), Some(2));
}

#[test]
fn the_folder_is_in_the_cache_that_the_environment_names() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = policy_proc(&["cache", "ls"]);
    let output = ended(command.env("MEMTRANSFER_CACHE", folder.path()).spawn().unwrap());
    let expected = folder.path().join("responses");
    assert_eq!(stdout(&output), format!("{}: 0 replies (0 B)\n", expected.display()));
}

#[test]
fn a_probe_ends_with_a_status_and_hides_the_key() {
    let server = Server::start(|request| match &*request.line {
        "GET /v1/models HTTP/1.1" => Reaction::json(200, &json!({"data": [{"id": "m"}]})),
        line if line.starts_with("GET") => Reaction::json(404, &json!({"detail": "Not Found"})),
        _ => match request.body.pointer("/messages/0/content") {
            Some(Value::String(_)) => Reaction::says(&format!("42 {KEY}")),
            _ => Reaction::json(400, &json!({"error": {"message": format!("not for {KEY}")}})),
        },
    })
    .unwrap();
    let base_url = server.base_url();
    let arguments =
        ["probe", "--model", "m", "--base-url", &base_url, "--together", "2", "--frame-size", "64"];
    let output = run(&arguments);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let plain = stdout(&output);
    assert!(plain.contains("NOT YET  images: the server takes none: not for [key]. "), "{plain}");
    assert!(plain.contains("ok       temperature 0: "), "{plain}");

    let output = run(&[&arguments[..], &["--json"]].concat());
    assert_eq!(output.status.code(), Some(1));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["run_sized"], Value::Null);
}

/// Headers come in a variable, since other users see the arguments of a process.
#[test]
fn a_header_of_the_environment_reaches_the_server_and_no_output() {
    let server = Server::start(|request| {
        let header = request.headers.iter().any(|header| header == "x-team: sk-team-secret");
        let message = format!("no sk-team-secret, header: {header}");
        Reaction::json(401, &json!({"error": {"message": message}}))
    })
    .unwrap();
    let base_url = server.base_url();
    for (variable, expected) in
        [("X-Team: sk-team-secret", "no [key], header: true"), ("", "header: false")]
    {
        let mut command = policy_proc(&["probe", "--model", "m", "--base-url", &base_url]);
        let output = ended(command.env("MEMTRANSFER_HEADER", variable).spawn().unwrap());
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        assert!(stdout(&output).contains(expected), "{output:?}");
    }
}

/// The probe sends the run's own prompt with its images, and reports with how many images it is refused.
#[test]
fn a_probe_sends_a_request_of_the_runs_size() {
    let server = Server::start(|request| {
        if request.line.starts_with("GET") {
            return Reaction::json(200, &json!({"data": [{"id": "m"}]}));
        }
        let body = request.body.to_string();
        if !body.contains("You may be given a memory of") {
            return Reaction::says(if body.contains("square") { "red or blue" } else { "42" });
        }
        let images = body.matches("data:image/png;base64,").count();
        let mut reply = completion("move forward");
        reply["usage"]["prompt_tokens"] = json!(1000 + 64 * images);
        match images {
            0..=12 => Reaction::json(200, &reply),
            _ => {
                Reaction::json(400, &json!({"error": {"message": "context length is 8192 tokens"}}))
            }
        }
    })
    .unwrap();
    let base_url = server.base_url();
    let output = run(&["probe", "--model", "m", "--base-url", &base_url, "--frame-size", "64"]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let plain = stdout(&output);
    let expected = "NOT YET  request of the run's size: 13 images are refused: context length is 8192 tokens. 12 images took";
    assert!(plain.contains(expected) && plain.contains("--image-budget 12"), "{plain}");
}

#[test]
fn a_probe_without_an_endpoint_says_how_to_name_one() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = policy_proc(&["probe", "--model", "m"]);
    let output = ended(command.current_dir(folder.path()).spawn().unwrap());
    assert_eq!(output.status.code(), Some(2));
    let printed = String::from_utf8_lossy(&output.stderr);
    assert!(printed.contains("pass --base-url or set OPENAI_BASE_URL"), "{printed}");
}
