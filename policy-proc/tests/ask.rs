//! `policy-proc ask` as another process sees it: lines in, lines out, a status.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::io::Write;
use std::process::{Command, Output, Stdio};

use policy_proc::chat::scripted::{Server, Turn};
use serde_json::{Value, json};

const QUESTION: &str = r#"{"messages":[{"role":"user","content":"Where?"}],"max_tokens":30}"#;

/// `policy-proc ask` without anything from the environment of the test.
fn ask() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_policy-proc"));
    command.arg("ask").stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    for variable in ["OPENAI_BASE_URL", "OPENAI_API_BASE", "OPENAI_API_KEY", "RUST_LOG"] {
        command.env_remove(variable);
    }
    command
}

fn run(command: &mut Command, input: &str) -> Output {
    let mut child = command.spawn().unwrap();
    // One that has ended with a complaint reads nothing.
    drop(child.stdin.take().unwrap().write_all(input.as_bytes()));
    child.wait_with_output().unwrap()
}

fn lines(output: &Output) -> Vec<Value> {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn every_line_is_answered_in_order() {
    let server = Server::turns([
        Turn::says("North."),
        Turn::json(
            200,
            &json!({"choices": [{"message": {"content": "So"}, "finish_reason": "length"}]}),
        ),
    ])
    .unwrap();
    let mut command = ask();
    command.args(["--model", "m", "--base-url", &server.base_url()]);
    let output = run(&mut command, &format!("{QUESTION}\n\n{QUESTION}\n"));
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert_eq!(
        lines(&output),
        [
            json!({"text": "North.", "outcome": "text", "model": "scripted", "prompt_tokens": 10, "completion_tokens": 5, "from_cache": false}),
            json!({"text": "So", "outcome": "length", "model": null, "prompt_tokens": null, "completion_tokens": null, "from_cache": false}),
        ]
    );
    assert_eq!(server.received()[0].body["model"], "m");
}

#[test]
fn a_question_without_a_reply_is_an_error_line_and_the_rest_goes_on() {
    let server = Server::turns([
        Turn::json(401, &json!({"error": {"message": "no sk-very-secret"}})),
        Turn::says("North."),
    ])
    .unwrap();
    let mut command = ask();
    command
        .args(["--model", "m"])
        .env("OPENAI_API_BASE", server.base_url() + "/")
        .env("OPENAI_API_KEY", "sk-very-secret")
        .env("RUST_LOG", "trace");
    let output = run(&mut command, &format!("{QUESTION}\n{{\n{QUESTION}"));
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    let lines = lines(&output);
    let errors: Vec<_> = lines.iter().filter_map(|line| line["error"].as_str()).collect();
    assert!(errors[0].contains("status 401: no [key]; check OPENAI_API_KEY"), "{errors:?}");
    assert!(errors[1].contains("this line is no question"), "{errors:?}");
    assert_eq!(lines[2]["text"], "North.");
    let printed = String::from_utf8_lossy(&output.stderr).into_owned() + &errors.concat();
    assert!(printed.contains("questions without a reply: 2") && !printed.contains("very-secret"));
}

#[test]
fn without_an_endpoint_it_says_how_to_name_one() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(ask().args(["--model", "m"]).current_dir(folder.path()), QUESTION);
    assert_eq!(output.status.code(), Some(2));
    let printed = String::from_utf8_lossy(&output.stderr);
    assert!(printed.contains("pass --base-url or set OPENAI_BASE_URL"), "{printed}");
}
