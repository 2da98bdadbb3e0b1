//! A key of a model's server is sent to that server, and is nowhere else: in no file, no output and no list of processes.

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
    let written = files(bench.folder.path());
    for file in &written {
        let content = fs::read(file).unwrap();
        let leaks = content.windows(KEY.len()).any(|part| part == KEY.as_bytes());
        assert!(!leaks, "{} holds the key", file.display());
    }
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
