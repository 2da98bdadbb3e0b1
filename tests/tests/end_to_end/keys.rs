//! A key of a model's server is sent to that server, and is nowhere else: in no file, no output and no list of processes.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering::SeqCst};
use std::sync::{Arc, Mutex};

use memtransfer_tests::{Bench, Ended, processes_with, records};
use rigs::chat_server::{Reaction, Server, completion};
use serde_json::json;

const KEY: &str = "sk-4c1f0e8d-never-written";

/// What the server saw.
#[derive(Default)]
struct Seen {
    /// Requests, and how many of them had the key.
    requests: AtomicUsize,
    with_key: AtomicUsize,
    /// Processes with the key in their arguments.
    told: Mutex<Vec<u32>>,
}

/// A server that repeats the key wherever it can: in answers, in their headers, in errors.
fn repeating(seen: &Arc<Seen>) -> Server {
    let seen = Arc::clone(seen);
    Server::concurrent(move |request| {
        let number = seen.requests.fetch_add(1, SeqCst);
        if request.headers.iter().any(|header| header.contains(KEY)) {
            seen.with_key.fetch_add(1, SeqCst);
        }
        seen.told.lock().unwrap().extend(processes_with(KEY.as_bytes()));
        let error = json!({"error": {"message": format!("{KEY} has no quota now")}});
        match number % 5 {
            1 => Reaction::json(429, &error).with("Retry-After: 0"),
            3 => Reaction::json(500, &error),
            _ => {
                let mut reply = completion(&format!("move forward, {KEY}"));
                reply["model"] = KEY.into();
                Reaction::json(200, &reply).with(&format!("Server: {KEY}"))
            }
        }
    })
    .unwrap()
}

fn command(bench: &Bench, args: &[&str]) -> Ended {
    let mut command = bench.command(args);
    command.env("OPENAI_API_KEY", KEY).env("RUST_LOG", "trace").env("RUST_BACKTRACE", "1");
    let ended = Ended::run(&mut command);
    assert!(!ended.stdout.contains(KEY), "printed by {args:?}");
    assert!(!ended.stderr.contains(KEY), "printed by {args:?}");
    ended
}

/// Whether a file below `folder` holds `secret`.
fn is_written(secret: &str, folder: &Path) -> bool {
    let holds = |file: &PathBuf| {
        fs::read(file).unwrap().windows(secret.len()).any(|part| part == secret.as_bytes())
    };
    files(folder).iter().any(holds)
}

/// All files below `folder`.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    let below = |entry: fs::DirEntry| match entry.file_type().unwrap().is_dir() {
        true => files(&entry.path()),
        false => vec![entry.path()],
    };
    entries.flat_map(below).collect()
}

#[test]
fn a_key_is_in_no_file_no_output_and_no_list_of_processes() {
    let bench = Bench::new();
    let seen = Arc::<Seen>::default();
    let server = repeating(&seen);
    let base_url = server.base_url();
    let run = |out: &str, retries: &str| {
        let mut args = vec!["run", "--policy", "openai", "--model", "m", "--base-url", &base_url];
        args.extend(["--cases", "t01-01", "--starts", "new", "--demos", "original"]);
        args.extend(["--memory", "working,full-context", "--frame-size", "64", "--max-steps", "6"]);
        args.extend(["--max-retries", retries, "--response-cache", "./replies", "--log-prompts"]);
        args.extend(["--trace", "trace.json", "--out", out]);
        command(&bench, &args)
    };
    let said = run("finished", "9").expect(0).stderr;
    let asked =
        format!("asking m at {base_url} (from the command line, with the key of the environment)");
    assert!(said.contains(&asked), "{said}");
    assert!(!records(&bench.out("finished")).is_empty());
    command(&bench, &["doctor", "--policy", "openai", "--model", "m", "--base-url", &base_url]);
    // Without retries the run ends with what the server said.
    drop(server);
    let refusing = Server::concurrent(|_| {
        Reaction::json(401, &json!({"error": {"message": format!("no user has the key {KEY}")}}))
    });
    let refusing = refusing.unwrap();
    let mut args = vec!["run", "--policy", "openai", "--model", "m", "--limit", "1"];
    let base_url = refusing.base_url();
    args.extend(["--base-url", &base_url, "--memory", "working", "--frame-size", "64"]);
    args.extend(["--max-retries", "0", "--response-cache", "off", "--out", "refused"]);
    let ended = command(&bench, &args);
    assert_ne!(ended.status, Some(0));
    assert!(ended.stderr.contains("[key]"), "{}", ended.stderr);
    for args in [
        &["score", "finished"][..],
        &["report", "finished"],
        &["view", "finished", "--out", "pages"],
        &["show", "finished", "t01-01", "0", "--condition", "working"],
        &["export", "finished", "--format", "csv", "--out", "tables"],
    ] {
        command(&bench, args).expect(0);
    }

    assert!(seen.with_key.load(SeqCst) > 10);
    assert_eq!(*seen.told.lock().unwrap(), [0; 0]);
    assert!(!is_written(KEY, bench.folder.path()));
    let written = files(bench.folder.path());
    // The answers were written, with a mask in the key's place.
    let masked = |name: &str| {
        let of =
            written.iter().filter(|file| file.components().any(|part| part.as_os_str() == name));
        of.filter(|file| String::from_utf8_lossy(&fs::read(file).unwrap()).contains("[key]"))
            .count()
    };
    assert!(masked("prompts") > 0 && masked("replies") > 0 && masked("pages") > 0);
    for private in ["finished/prompts", "finished/prompts/images", "finished/logs", "replies"] {
        let mode = fs::metadata(bench.out(private)).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o700, "{private} can be read by other users");
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// `memory build` has the flags of `run` about requests; a header is in no file and no output, and no other process has it
/// in its arguments.
#[test]
fn a_model_is_asked_for_documents_as_a_run_asks_it() {
    const SECRET: &str = "proxy-2b7d-never-written";
    let bench = Bench::new();
    let told = Arc::<Mutex<BTreeSet<u32>>>::default();
    let server = Server::concurrent({
        let told = Arc::clone(&told);
        move |_| {
            told.lock().unwrap().extend(processes_with(SECRET.as_bytes()));
            Reaction::says("# Text")
        }
    });
    let server = server.unwrap();
    let base_url = server.base_url();
    let build = |flags: &[&str], headers: &str| {
        let mut args = vec!["memory", "build", "--builder", "model", "--model", "m"];
        args.extend(["--demos", "original", "--kind", "semantic", "--frame-size", "64"]);
        args.extend(["--base-url", &base_url, "--out", "documents"]);
        let mut command = bench.command(&[&args, flags].concat());
        command.env("MEMTRANSFER_HEADER", headers).env("MEMTRANSFER_REASONING", "low");
        let ended = Ended::run(&mut command).expect(0);
        assert!(!ended.stdout.contains(SECRET) && !ended.stderr.contains(SECRET));
    };
    build(&[], &format!("X-Team: {SECRET}"));
    let header = format!("X-Proxy: {SECRET}");
    let body = r#"{"top_k": 7}"#;
    build(&["--extra-body", body, "--system-role", "user", "--header", &header], "X-Team: other");
    let received = server.received();
    let (first, last) = (received.first().unwrap(), received.last().unwrap());
    for request in [first, last] {
        assert_eq!(request.body["reasoning_effort"], "low");
        assert!(request.headers.iter().any(|header| header.contains(SECRET)));
    }
    assert_eq!(first.body["messages"][0]["role"], "system");
    assert_eq!(last.body["messages"][0]["role"], "user");
    assert_eq!((&first.body["top_k"], &last.body["top_k"]), (&json!(null), &json!(7)));
    // Two recipes, and so two documents.
    let documents = fs::read_dir(bench.out("documents")).unwrap();
    let paths = documents.map(|entry| entry.unwrap().path());
    assert_eq!(paths.filter(|path| path.extension().is_some_and(|it| it == "json")).count(), 2);
    // The command with the flag, and not the process that builds.
    assert_eq!(told.lock().unwrap().len(), 1);
    assert!(!is_written(SECRET, bench.folder.path()));
}
