//! A model that sees, behind a real server: llama.cpp's with a small language model and an encoder of images made by
//! set-up. Its answers mean nothing. A proxy in between and the server's own counts show that the run's log tells the
//! truth about what was sent and answered, and failures of the server lose nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::thread;
use std::time::Duration;

use domain::{Pose, State};
use memtransfer_tests::llama::{LlamaServer, SEEING_MODEL};
use memtransfer_tests::proxy::{LoggingProxy, MessagePart, PassedRequest, add_text, hash_of};
use memtransfer_tests::{Bench, Ended, eventually, hold, records, resume};
use png_file::RgbaImage;
use rustix::process::Signal;
use serde_json::Value;

/// Arguments of a run that asks the server at `base_url`, into the folder `out`.
fn run<'a>(base_url: &'a str, out: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let mut args = vec!["run", "--policy", "openai", "--model", SEEING_MODEL];
    args.extend(["--base-url", base_url, "--response-cache", "off", "--starts", "new"]);
    args.extend(["--quiet", "--out", out]);
    args.extend(more);
    args
}

/// The lines of a file of the run.
fn lines(path: &Path) -> Vec<Value> {
    let text = fs::read_to_string(path).unwrap_or_default();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The entries of a run's prompt log.
fn prompt_log(run: &Path) -> Vec<Value> {
    let sessions = fs::read_dir(run.join("prompts")).unwrap().map(|entry| entry.unwrap().path());
    let sessions = sessions
        .filter(|path| path.file_name().unwrap().as_encoded_bytes().starts_with(b"session-"));
    let files = sessions.flat_map(|session| fs::read_dir(session).unwrap());
    files.flat_map(|file| lines(&file.unwrap().path())).collect()
}

/// The messages of an entry of the prompt log, as the proxy writes them down.
fn logged_parts(run: &Path, entry: &Value) -> Vec<MessagePart> {
    let mut parts = Vec::new();
    for message in entry["exchange"]["messages"].as_array().unwrap() {
        let role = message["role"].as_str().unwrap();
        for part in message["parts"].as_array().unwrap() {
            if let Some(hash) = part["image"].as_str() {
                parts.push(MessagePart::Image(hash.to_owned()));
            } else if let Some(hash) = part["stored"].as_str() {
                let file = run.join(format!("prompts/documents/{hash}.txt"));
                add_text(&mut parts, role, &fs::read_to_string(file).unwrap());
            } else {
                add_text(&mut parts, role, part["text"].as_str().unwrap());
            }
        }
    }
    parts
}

/// Whether the reply that passed the proxy is the one that the entry has, with the same usage.
fn same_reply(entry: &Value, passed: &PassedRequest) -> bool {
    let (usage, counted) = (&entry["usage"], &passed.reply["usage"]);
    let text = passed.reply["choices"][0]["message"]["content"].as_str().unwrap_or_default();
    passed.status == 200
        && entry["exchange"]["reply"] == text.trim()
        && usage["prompt_tokens"] == counted["prompt_tokens"]
        && usage["completion_tokens"] == counted["completion_tokens"]
        && usage["cached_tokens"] == counted["prompt_tokens_details"]["cached_tokens"]
        && entry["answer"]["images"] == passed.images()
}

/// Checks that the requests that passed are exactly those of the prompt log: texts and pixels in the same order, replies
/// and usage. Returns the log.
fn compare(run: &Path, mut passed: Vec<PassedRequest>) -> Vec<Value> {
    let entries = prompt_log(run);
    for entry in &entries {
        let parts = logged_parts(run, entry);
        let same = passed.iter().position(|it| it.parts == parts && same_reply(entry, it));
        let Some(same) = same else {
            let asked: Vec<_> = passed.iter().filter(|it| it.parts == parts).collect();
            panic!("the proxy saw no such request: {entry:#}\nwith the same messages: {asked:#?}");
        };
        passed.swap_remove(same);
    }
    assert!(passed.is_empty(), "requests that the log does not have: {passed:#?}");
    entries
}

#[test]
fn the_log_has_what_the_server_got_and_said() {
    let bench = Bench::new();
    let server = LlamaServer::seeing(3072, 3);
    let proxy = LoggingProxy::start(server.address());
    let (base_url, out) = (proxy.base_url(), bench.out("run"));
    let slice = ["--suite", "quick", "--cases", "t05-01", "--demos", "4", "--max-steps", "4"];
    let how = ["--memory", "working,episodic,full-context", "--lanes", "3", "--log-prompts"];
    let small = ["--frame-size", "256"];
    bench.run(&run(&base_url, "run", &[&slice[..], &how, &small].concat())).expect(0);

    let entries = compare(&out, proxy.take());
    assert_eq!(entries.len(), 3 * 4);
    let mut most = BTreeMap::<String, u64>::new();
    for request in lines(&out.join("requests.jsonl")) {
        let memory = request["key"].as_str().unwrap().split('/').next().unwrap().to_owned();
        let images = most.entry(memory).or_default();
        *images = request["images"].as_u64().unwrap().max(*images);
    }
    let expected = [("episodic", 11), ("full-context", 44), ("working", 4)];
    assert_eq!(most, expected.map(|(memory, images)| (memory.to_owned(), images)).into());

    // The images are the renderer's views of the poses in the log.
    let pose = |request: &Value| {
        let state: State = serde_json::from_value(request["state"].clone()).unwrap();
        Pose::try_from(state).unwrap().to_string()
    };
    let views: BTreeMap<String, &str> = entries
        .iter()
        .map(|entry| &entry["request"])
        .map(|request| (pose(request), request["frame"].as_str().unwrap()))
        .collect();
    for (pose, hash) in views.into_iter().take(2) {
        bench.run(&["render", "--pose", &pose, "--size", "256", "--out", "view.png"]).expect(0);
        let rendered = RgbaImage::read(&bench.out("view.png")).unwrap();
        assert_eq!(hash_of(&rendered), hash, "{pose}");
    }
    assert!(bench.leftovers().is_empty(), "{:?}", bench.leftovers());
}

#[test]
fn sixteen_requests_in_flight_keep_their_own_images_and_replies() {
    let bench = Bench::new();
    let server = LlamaServer::seeing(1024, 16);
    let proxy = LoggingProxy::start(server.address());
    let base_url = proxy.base_url();
    let slice = ["--memory", "working", "--limit", "16", "--max-steps", "2", "--frame-size", "128"];
    let how = ["--lanes", "16", "--max-connections", "16", "--log-prompts"];
    bench.run(&run(&base_url, "run", &[&slice[..], &how].concat())).expect(0);
    let passed = proxy.take();
    assert_eq!(passed.iter().map(|request| request.in_flight).max(), Some(16));
    assert_eq!(compare(&bench.out("run"), passed).len(), 16 * 2);
}

#[test]
fn a_prompt_that_is_too_long_names_the_image_budget() {
    let bench = Bench::new();
    let server = LlamaServer::seeing(1792, 1);
    let slice = ["--cases", "t05-01", "--memory", "full-context", "--demos", "4"];
    let short = ["--max-steps", "2", "--lanes", "1", "--frame-size", "128"];
    let args = run(server.base_url(), "refused", &[&slice[..], &short].concat());
    let ended = bench.run(&args).expect(1);
    for part in ["exceeds the available context size", "41 images", "lower --image-budget"] {
        assert!(ended.stderr.contains(part), "no {part:?} in:\n{}", ended.stderr);
    }
    assert_eq!(records(&bench.out("refused")), Vec::<Value>::new(), "an episode was scored");

    let fewer = [&slice[..], &short, &["--image-budget", "3"]].concat();
    bench.run(&run(server.base_url(), "fewer", &fewer)).expect(0);
    assert_eq!(records(&bench.out("fewer"))[0]["images"], 6);
}

#[test]
fn a_killed_and_a_stopped_server_cost_no_episode() {
    let bench = Bench::new();
    let mut server = LlamaServer::seeing(1536, 2);
    let slice = ["--cases", "t01-01,t05-01", "--memory", "working", "--max-steps", "8"];
    let how = ["--lanes", "2", "--frame-size", "64", "--request-timeout", "20"];
    let base_url = server.base_url().to_owned();
    let args = run(&base_url, "run", &[&slice[..], &how].concat());
    let log = bench.out("run").join("requests.jsonl");
    let child = bench.start(&args);
    let answered = || fs::read_to_string(&log).unwrap_or_default().lines().count();
    let after = |more: usize| {
        let target = answered() + more;
        eventually("requests to be answered", || (answered() >= target).then_some(()));
    };
    after(4);
    server.kill();
    server.restart();
    after(4);
    server.signal(Signal::STOP);
    // Longer than an attempt may take.
    thread::sleep(Duration::from_secs(25));
    server.signal(Signal::CONT);
    Ended::of(child).expect(0);

    let out = bench.out("run");
    assert_eq!(records(&out).len(), 2);
    assert!(lines(&out.join("errors.jsonl")).is_empty());
    let requests = lines(&log);
    let steps: BTreeSet<String> =
        requests.iter().map(|it| format!("{} {}", it["key"], it["step"])).collect();
    assert_eq!((requests.len(), steps.len()), (16, 16), "a step was asked twice or lost");
    let retried = requests.iter().filter(|request| request["attempts"].as_u64() > Some(1));
    assert!(retried.count() >= 2, "the faults met no request");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// Two servers share the requests; one is killed, comes back, and is asked again.
#[test]
fn a_lost_server_leaves_its_requests_to_the_other() {
    let bench = Bench::new();
    let mut servers = [(); 2].map(|()| LlamaServer::seeing(1536, 2));
    let base_urls = servers.each_ref().map(LlamaServer::base_url).join(",");
    let slice = ["--cases", "t01-01,t03-01,t05-01,t07-01", "--memory", "working"];
    let how = ["--max-steps", "7", "--lanes", "4", "--frame-size", "64"];
    let args = run(&base_urls, "run", &[&slice[..], &how].concat());
    let child = bench.start(&args);
    let log = bench.out("run").join("requests.jsonl");
    let answered = || fs::read_to_string(&log).unwrap_or_default().lines().count();
    let until = |count: usize| {
        eventually("requests to be answered", || (answered() >= count).then_some(()));
    };
    let served = |server: &LlamaServer| server.log().matches("stop processing").count();
    until(6);
    let before = servers.each_ref().map(served);
    assert!(before.iter().all(|count| *count > 0), "{before:?}");
    servers[0].kill();
    until(12);
    // No request is sent while it loads its model: otherwise the other may have answered all by then.
    assert!(hold(child.id()));
    servers[0].restart();
    resume(child.id());
    Ended::of(child).expect(0);
    assert!(served(&servers[0]) > before[0], "the server that came back was not asked");
    assert_eq!((records(&bench.out("run")).len(), answered()), (4, 28));
    assert!(lines(&bench.out("run").join("errors.jsonl")).is_empty());
}
