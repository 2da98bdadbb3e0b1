//! Runs with a model whose server fails in many ways: nothing is lost or counted twice, and the log is the same as with
//! a server that never fails.

use std::collections::hash_map::DefaultHasher;
use std::fs;
use std::hash::{Hash, Hasher};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::SeqCst};
use std::time::{Duration, Instant};

use memtransfer_tests::{Bench, Ended, eventually, records, sorted_log, wait_for_episodes};
use rigs::chat_server::{Reaction, Received, Server, completion};
use serde_json::{Value, json};

/// Lanes, and the limit of concurrent requests.
const LANES: u64 = 4;

/// Cases times memories.
const EPISODES: usize = 6;

/// How long a request of [`runs_keep_to_one_limit_of_their_server`] may wait for another one.
const PATIENCE: Duration = Duration::from_secs(240);

/// The server's reply, which depends on the request alone: an action and token counts.
fn reply(request: &Received) -> Value {
    let messages = request.body["messages"].to_string();
    let mut hasher = DefaultHasher::new();
    messages.hash(&mut hasher);
    let action = ["move forward", "Turn left.", "{\"action\": \"turn right\"}", "no idea"]
        [(hasher.finish() % 4) as usize];
    let mut reply = completion(action);
    let (prompt, answer) = (100 + messages.len() as u64 % 1000, 1 + hasher.finish() % 9);
    reply["usage"] = json!({"prompt_tokens": prompt, "completion_tokens": answer});
    reply
}

/// Totals of the complete replies of a server.
#[derive(Default)]
struct ReplyTotals {
    tokens: AtomicU64,
    replies: AtomicU64,
}

impl ReplyTotals {
    fn answer(&self, request: &Received) -> Reaction {
        let reply = reply(request);
        let tokens = |what: &str| reply["usage"][what].as_u64().unwrap();
        self.tokens.fetch_add(tokens("prompt_tokens") + tokens("completion_tokens"), SeqCst);
        self.replies.fetch_add(1, SeqCst);
        Reaction::json(200, &reply)
    }
}

/// A server that never fails.
fn reliable() -> Server {
    let given = ReplyTotals::default();
    Server::concurrent(move |request| given.answer(request)).unwrap()
}

/// A failure of a server that answers with status 200: `change` is made to the choice of a reply that has no tokens.
fn hidden(change: impl FnOnce(&mut Value)) -> Reaction {
    let mut reply = completion("mov");
    reply["usage"] = json!({"prompt_tokens": 5, "completion_tokens": 0});
    change(&mut reply["choices"][0]);
    Reaction::json(200, &reply)
}

/// A server that fails almost every second request, in many ways.
fn faulty(given: Arc<ReplyTotals>) -> Server {
    let count = AtomicU64::new(0);
    Server::concurrent(move |request| {
        let error = json!({"error": {"message": "not now"}});
        match count.fetch_add(1, SeqCst) % 31 {
            0 => Reaction::json(429, &error).with("Retry-After: 0"),
            2 => Reaction::json(500, &error),
            4 => Reaction::Half(reply(request).to_string()),
            6 => Reaction::json(200, &json!({"choices": []})),
            8 => Reaction::Close,
            10 => Reaction::json(503, &error).with("Retry-After: 0.1"),
            12 => Reaction::Answer { status: 502, headers: Vec::new(), body: "<html>".to_owned() },
            14 => Reaction::Hang,
            16 => Reaction::Trickle(reply(request).to_string()),
            18 => {
                hidden(|choice| choice["error"] = json!({"code": 502, "message": "upstream died"}))
            }
            20 => hidden(|choice| choice["finish_reason"] = json!("abort")),
            22 => hidden(|choice| choice["finish_reason"] = json!("error")),
            24 => hidden(|choice| choice["message"] = Value::Null),
            26 => hidden(|choice| choice["message"]["content"] = json!("")),
            28 => hidden(|choice| choice["error"] = json!({"code": 429, "message": "not now"})),
            _ => given.answer(request),
        }
    })
    .unwrap()
}

/// The arguments of a short run with a model, into the folder `out`.
fn slice<'a>(base_url: &'a str, out: &'a str, cache: &'a str) -> Vec<&'a str> {
    let mut args = vec!["run", "--policy", "openai", "--model", "m", "--base-url", base_url];
    args.extend(["--cases", "t01-01,t03-02,t07-01", "--starts", "new", "--demos", "original"]);
    args.extend(["--memory", "working,full-context", "--frame-size", "64", "--max-steps", "8"]);
    args.extend(["--lanes", "4", "--max-connections", "4", "--max-retries", "12"]);
    // Much longer than a reply takes that is counted: the client must not give one up.
    args.extend(["--request-timeout", "5", "--response-cache", cache, "--out", out]);
    args
}

fn requests(run: &Path) -> Vec<Value> {
    let text = fs::read_to_string(run.join("requests.jsonl")).unwrap();
    // A kill may leave an incomplete line.
    text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

fn tokens(record: &Value) -> u64 {
    let count = |what: &str| record[what].as_u64().unwrap();
    count("prompt_tokens") + count("completion_tokens")
}

/// Kills a run, repeats the command, both with a faulty server, and checks the log and the totals.
fn check_kill_and_resume(bench: &Bench, reference: &[String], out: &str, cache: &str) {
    let given = Arc::<ReplyTotals>::default();
    let server = faulty(given.clone());
    let base_url = server.base_url();
    let args = slice(&base_url, out, cache);
    let run = bench.out(out);
    let child = bench.start(&args);
    wait_for_episodes(&run, 1);
    bench.kill_run(child);
    bench.run(&args).expect(0);

    assert_eq!(sorted_log(&run), reference, "{out}");
    let asked = requests(&run);
    let (kept, sent): (Vec<&Value>, Vec<&Value>) =
        asked.iter().partition(|request| request["replayed"] == true);
    // Only requests in flight at the kill may be missing.
    let (replies, counted) = (given.replies.load(SeqCst), sent.len() as u64);
    assert!(counted <= replies && replies <= counted + LANES, "{counted} of {replies}");
    let total: u64 = sent.iter().map(|request| tokens(request)).sum();
    let most = given.tokens.load(SeqCst);
    assert!(total <= most && most - total <= LANES * 1200, "{total} of {most}");
    assert!(
        sent.iter().any(|request| request["attempts"].as_u64() > Some(1)),
        "no request was retried"
    );
    assert_eq!(kept.is_empty(), cache == "off");
    // Each step of each finished episode has a request.
    let steps: u64 = records(&run).iter().map(|episode| episode["steps"].as_u64().unwrap()).sum();
    assert!(asked.len() as u64 >= steps);
}

#[test]
fn failures_of_the_server_change_neither_the_log_nor_the_totals() {
    let bench = Bench::new();
    let server = reliable();
    bench.run(&slice(&server.base_url(), "reference", "off")).expect(0);
    let reference = sorted_log(&bench.out("reference"));
    assert_eq!(reference.len(), EPISODES);
    let spent: u64 = records(&bench.out("reference")).iter().map(tokens).sum();
    assert_eq!(spent, requests(&bench.out("reference")).iter().map(tokens).sum::<u64>());

    check_kill_and_resume(&bench, &reference, "again", "off");
    check_kill_and_resume(&bench, &reference, "kept", "./replies");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// A server whose model spends all tokens of an answer on reasoning that it does not show.
fn cutting_off() -> Server {
    Server::concurrent(|_| {
        let mut reply = completion("");
        reply["choices"][0]["finish_reason"] = json!("length");
        reply["usage"] = json!({"prompt_tokens": 100, "completion_tokens": 30,
            "completion_tokens_details": {"reasoning_tokens": 30}});
        Reaction::json(200, &reply)
    })
    .unwrap()
}

#[test]
fn a_run_whose_answers_are_all_cut_off_says_so_and_stops() {
    let bench = Bench::new();
    let server = cutting_off();
    let base_url = server.base_url();
    let run = |out: &str, limit: &str, status: i32| {
        let mut args = slice(&base_url, out, "off");
        args.extend(["--stop-without-action", limit]);
        bench.run(&args).expect(status)
    };
    let steps = 8 * EPISODES;
    let described = format!(
        "{steps} of {steps} answers have no action: {steps} were cut off at 30 tokens. The model reasons"
    );
    // Complete, but without an action: not a success.
    let ended = run("silent", "100", 1);
    let in_one_line = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(in_one_line(&ended.stdout).contains(&described), "{}", ended.stdout);
    assert!(ended.stderr.contains("10 of 10 answers have no action"), "{}", ended.stderr);
    assert!(ended.stderr.contains("the run measures nothing"), "{}", ended.stderr);
    let told = "policy: reasoning: on: replies show it, although it was asked to be off";
    assert_eq!(ended.stderr.matches(told).count(), 1, "{}", ended.stderr);
    let silent = bench.out("silent");
    for request in requests(&silent) {
        assert_eq!(
            (&request["outcome"], &request["finish_reason"]),
            (&"cut-off".into(), &"length".into())
        );
        assert_eq!((&request["reasoned"], &request["model"]), (&true.into(), &"scripted".into()));
    }
    for record in records(&silent) {
        assert_eq!(
            record["unread"],
            json!({"unreadable": 0, "empty": 0, "refused": 0, "cut_off": 8})
        );
    }
    let manifest: Value =
        serde_json::from_str(&fs::read_to_string(silent.join("manifest.json")).unwrap()).unwrap();
    let reasoning = manifest["processes"]["policy"]["reasoning"].as_str().unwrap();
    assert_eq!(reasoning, "on: replies show it, although it was asked to be off");

    // Stopped early, and resumed by someone who wants it: the log is the same.
    let ended = run("stopped", "20", 1);
    assert!(ended.stderr.contains("--stop-without-action 0"), "{}", ended.stderr);
    assert!(records(&bench.out("stopped")).len() < EPISODES);
    run("stopped", "0", 0);
    assert_eq!(sorted_log(&bench.out("stopped")), sorted_log(&silent));
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn an_image_limit_of_the_server_is_reported_and_an_image_budget_respects_it() {
    let bench = Bench::new();
    let server = Server::concurrent(|request| {
        let images = request.body["messages"].to_string().matches("image_url").count() / 2;
        match images {
            0..=2 => Reaction::json(200, &reply(request)),
            _ => Reaction::json(400, &json!({"error": {"message": "at most 2 images"}})),
        }
    })
    .unwrap();
    let base_url = server.base_url();
    let ended: Ended = bench.run(&slice(&base_url, "refused", "off")).expect(1);
    assert!(ended.stderr.contains("at most 2 images"), "{}", ended.stderr);
    assert_eq!(records(&bench.out("refused")), Vec::<Value>::new(), "an episode was scored");
    let errors = fs::read_to_string(bench.out("refused").join("errors.jsonl")).unwrap();
    assert_eq!(errors.matches("at most 2 images").count(), EPISODES, "{errors}");

    let mut args = slice(&base_url, "bounded", "off");
    args.extend(["--image-budget", "2"]);
    bench.run(&args).expect(0);
    for episode in records(&bench.out("bounded")) {
        let count = |what: &str| episode[what].as_u64().unwrap();
        assert!(count("images") <= 2 * count("requests"), "{episode}");
        assert!(count("images_dropped") > 0, "{episode}");
    }
}

#[test]
fn a_server_that_is_down_stops_the_run_and_the_same_command_continues_it() {
    let bench = Bench::new();
    // A port that no other test is given.
    let base_url = "http://127.0.0.1:9/v1";
    let args = slice(base_url, "run", "off");
    let mut few: Vec<&str> = args.iter().map(|arg| if *arg == "12" { "1" } else { arg }).collect();
    let ended = bench.run(&few).expect(1);
    assert!(ended.stderr.contains("stopped: policy: "), "{}", ended.stderr);
    assert!(ended.stderr.contains("doctor --policy openai"), "{}", ended.stderr);
    assert!(records(&bench.out("run")).is_empty());

    let server = reliable();
    let elsewhere = server.base_url();
    few.iter_mut().filter(|arg| **arg == base_url).for_each(|arg| *arg = &elsewhere);
    bench.run(&few).expect(0);
    assert_eq!(records(&bench.out("run")).len(), EPISODES);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// Two runs share one server and its limit of two requests. The first run's two requests hang until it is killed, and
/// meanwhile the second sends none; then the slots of the dead run are free, and the second run has two in flight.
#[test]
fn runs_keep_to_one_limit_of_their_server() {
    const LIMIT: u64 = 2;
    let bench = Bench::new();
    let hangs = Arc::new(AtomicBool::new(true));
    let [hanging, second, most] = [(); 3].map(|()| Arc::new(AtomicU64::new(0)));
    let server = {
        let (hangs, hanging) = (hangs.clone(), hanging.clone());
        let (second, most) = (second.clone(), most.clone());
        let in_flight = AtomicU64::new(0);
        Server::concurrent(move |request| {
            if request.body["model"] == "first" {
                if hangs.load(SeqCst) {
                    hanging.fetch_add(1, SeqCst);
                    return Reaction::Hang;
                }
                return Reaction::json(200, &reply(request));
            }
            second.fetch_add(1, SeqCst);
            most.fetch_max(1 + in_flight.fetch_add(1, SeqCst), SeqCst);
            // The first request waits for a second one, so that both are in flight. If none comes, the test fails below.
            let deadline = Instant::now() + PATIENCE;
            while most.load(SeqCst) < LIMIT && Instant::now() < deadline {
                std::thread::sleep(Duration::from_millis(1));
            }
            in_flight.fetch_sub(1, SeqCst);
            Reaction::json(200, &reply(request))
        })
        .unwrap()
    };
    let base_url = server.base_url();
    let patience = PATIENCE.as_secs().to_string();
    let limited = |name| {
        let mut args = slice(&base_url, name, "off");
        let mut set = |flag: &str, value| {
            let at = args.iter().position(|arg| *arg == flag).unwrap();
            args[at + 1] = value;
        };
        set("--model", name);
        // A request that hangs is not given up: its slot is free when the run is dead, and no sooner.
        set("--request-timeout", &patience);
        args.extend(["--endpoint-limit", "2", "--endpoint-limit-folder", "limits"]);
        bench.command(&args)
    };
    let mut first = limited("first").spawn().unwrap();
    eventually("two requests of the first run", || (hanging.load(SeqCst) == LIMIT).then_some(()));
    let other = limited("second").spawn().unwrap();
    let sessions = bench.out("second").join("sessions.jsonl");
    eventually("the second run to be ready", || {
        let events = fs::read_to_string(&sessions).unwrap_or_default();
        events.contains("\"ready\"").then_some(())
    });
    assert_eq!((hanging.load(SeqCst), second.load(SeqCst)), (LIMIT, 0));
    hangs.store(false, SeqCst);
    memtransfer_tests::kill(first.id());
    first.wait().unwrap();
    Ended::of(other).expect(0);
    assert_eq!(records(&bench.out("second")).len(), EPISODES);
    assert_eq!(most.load(SeqCst), LIMIT);
    Ended::run(&mut limited("first")).expect(0);
    assert_eq!(records(&bench.out("first")).len(), EPISODES);
}

fn count_images(body: &Value) -> usize {
    body.to_string().matches("data:image/png;base64,").count()
}

/// `doctor` sends each server one request of the run's size, and says how long it took.
#[test]
fn doctor_sends_every_server_a_request_of_the_runs_size_and_times_it() {
    let bench = Bench::new();
    let server = Server::concurrent(|request| {
        if request.line.starts_with("GET") {
            return Reaction::json(200, &json!({"data": [{"id": "m"}]}));
        }
        let body = request.body.to_string();
        let text = match () {
            () if body.contains("You control a robot") => "move forward",
            () if body.contains("square") => "red or blue",
            () => "42",
        };
        // Images cost tokens: a server that drops them would be reported.
        let mut reply = completion(text);
        reply["usage"]["prompt_tokens"] = json!(10 + 50 * count_images(&request.body));
        Reaction::json(200, &reply)
    })
    .unwrap();
    let mut command = bench.command(&["doctor", "--json", "--policy", "openai", "--model", "m"]);
    command.env("OPENAI_BASE_URL", format!("{0},{0}", server.base_url()));
    command.env("MEMTRANSFER_FRAME_SIZE", "64");
    command.env("MEMTRANSFER_IMAGE_BUDGET", "9").env("MEMTRANSFER_MEMORY", "full-context");
    let ended = Ended::run(&mut command);
    let findings: Value = serde_json::from_str(&ended.stdout).unwrap();
    let reports = findings.as_array().unwrap().iter().filter(|f| f["what"] == "endpoint");
    let sized = Vec::from_iter(reports.map(|report| &report["data"]["run_sized"]));
    assert_eq!(sized.len(), 2, "{findings:#}");
    for sized in sized {
        assert_eq!(sized["images"], 9, "{findings:#}");
        assert!(sized["seconds"].as_f64() > Some(0.0), "{sized}");
    }
    let prompts: Vec<Received> = server.received();
    let of_run = prompts
        .iter()
        .filter(|r| r.body.to_string().contains("Answer with one action and nothing else"));
    assert_eq!(of_run.map(|request| count_images(&request.body)).max(), Some(9));
}
