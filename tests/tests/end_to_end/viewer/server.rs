//! `memtransfer view --serve`.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;

use memtransfer_tests::browser::Browser;
use memtransfer_tests::{Bench, Ended, KilledOnDrop, hold, resume, wait_for_episodes, words};

use super::{EPISODE, assert_no_problem, blocked};

/// `memtransfer view` as a server.
struct Served {
    _child: KilledOnDrop,
    url: String,
}

impl Served {
    fn start(bench: &Bench, args: &[&str]) -> Self {
        let mut child = bench.start(args);
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        Self { _child: KilledOnDrop(child), url: line.trim().to_owned() }
    }

    fn host(&self) -> &str {
        self.url.strip_prefix("http://").unwrap().split('/').next().unwrap()
    }

    /// The status and the text of the answer to a raw request.
    fn ask(&self, line: &str, host: &str) -> (u16, String) {
        let port = self.host().rsplit(':').next().unwrap();
        let mut stream = TcpStream::connect(format!("127.0.0.1:{port}")).unwrap();
        write!(stream, "{line} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let answer = String::from_utf8_lossy(&answer).into_owned();
        (answer.split(' ').nth(1).unwrap().parse().unwrap(), answer)
    }
}

#[test]
fn a_server_shows_every_view_and_gives_nothing_else_away() {
    let bench = Bench::new();
    let run = blocked(&bench, "r", "episodic", &["--cases", "t02-02"]);
    let run = run.to_str().unwrap();
    let served = Served::start(&bench, &["view", run, "--serve"]);
    let mut browser = Browser::start(1300, 1000);
    browser.open(&served.url);
    browser.click("td a.mark");
    browser.wait_for("document.querySelector('img.view') && document.querySelector('img.view').naturalWidth === 320");
    browser.wait_for("document.querySelector('.map > img').naturalWidth > 100");
    browser.open(&format!("{}#tables=1", served.url));
    browser.wait_for("document.querySelector('iframe') !== null");
    assert_no_problem(&mut browser);
    drop(browser);

    let host = served.host();
    assert_eq!(served.ask("GET /", host).0, 200);
    let (_, page) = served.ask("GET /index.html", host);
    for header in ["content-security-policy: default-src 'none'", "x-content-type-options: nosniff"]
    {
        assert!(page.contains(header), "{page}");
    }
    for path in [
        "/../../../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/run1/../../etc/passwd",
        "/run1/images/../manifest.json",
        "/run1/manifest.json",
        "/run1/views/0-5-8-N.jpg",
        "/run1/views/9999-1-1-N.jpg",
        "/run1/episodes/99999999999999999999.js",
        "/run2/run.js",
        "//etc/passwd",
    ] {
        assert_eq!(served.ask(&format!("GET {path}"), host).0, 404, "{path}");
    }
    assert_eq!(served.ask("POST /", host).0, 405);
    // A browser opens several connections at once and keeps them: every one is answered.
    let mut kept: Vec<TcpStream> = (0..32).map(|_| TcpStream::connect(host).unwrap()).collect();
    for stream in &mut kept {
        write!(stream, "GET /app.js HTTP/1.1\r\nHost: {host}\r\n\r\n").unwrap();
    }
    for stream in &mut kept {
        let mut start = [0; 15];
        stream.read_exact(&mut start).unwrap();
        assert_eq!(&start, b"HTTP/1.1 200 OK");
    }
    // A page of another site that reaches this server under its own name.
    assert_eq!(served.ask("GET /", "example.org").0, 403);
    // `ssh -L` and `kubectl port-forward` choose the port that a browser writes.
    for forwarded in ["localhost:1", "localhost", "127.0.0.1:1", "[::1]:1"] {
        assert_eq!(served.ask("GET /run1/run.js", forwarded).0, 200, "{forwarded}");
    }

    let open = Served::start(&bench, &["view", run, "--serve", "0.0.0.0:0"]);
    assert_eq!(open.ask("GET /run1/run.js", open.host()).0, 403);
    let (status, answer) = open.ask(&format!("GET /?{}", open.url.split('?').nth(1).unwrap()), "x");
    assert!(status == 303 && answer.contains("HttpOnly"), "{answer}");
    let port = open.host().rsplit(':').next().unwrap();
    assert!(answer.contains(&format!("set-cookie: memtransfer-token-{port}=")), "{answer}");
}

#[test]
fn an_episode_that_arrives_late_does_not_replace_the_page_opened_since() {
    let bench = Bench::new();
    let run = blocked(&bench, "r", "working", &["--cases", "t02-02"]);
    let served = Served::start(&bench, &["view", run.to_str().unwrap(), "--serve"]);
    let mut browser = Browser::start(1000, 800);
    browser.open(&served.url);
    browser.wait_for("document.querySelectorAll('td a.mark').length > 0");
    let name = browser.value(
        "(() => { const key = new URLSearchParams(document.querySelector('td a.mark').hash.slice(1)).get('key'); \
         return `run1/episodes/${memtransfer.runs[0].episodes.findIndex((one) => one[0] === key)}`; })()",
    );
    browser.hold("*/episodes/*");
    browser.click("td a.mark");
    browser.wait_for_held();
    browser.value("location.hash = 'sort=steps'");
    let sorted = "document.querySelector('select[name=sort]').value === 'steps'";
    browser.wait_for(sorted);
    browser.answer_held();
    // The episode arrives, and everything that waited for it goes on.
    browser.wait_for(&format!(
        "memtransfer.load({name}).then(() => new Promise((done) => setTimeout(() => done(true))))"
    ));
    assert_eq!(
        browser.value(&format!("document.querySelector('.transport') === null && {sorted}")),
        true
    );
    assert_eq!(browser.value("location.hash"), "#sort=steps");
    // Loaded now, it is shown at once.
    browser.click("td a.mark");
    browser.wait_for(EPISODE);
    assert_no_problem(&mut browser);
}

#[test]
fn new_episodes_of_a_run_in_progress_appear() {
    let bench = Bench::new();
    let line =
        "run --suite quick --limit 30 --policy grounded --lanes 1 --step-timeout 3600 --out r";
    let running = bench.start(&words(line));
    let run = bench.out("r");
    wait_for_episodes(&run, 1);
    assert!(hold(running.id()));
    let served = Served::start(&bench, &["view", run.to_str().unwrap(), "--serve"]);
    let mut browser = Browser::start(1000, 800);
    browser.open(&served.url);
    browser.wait_for("document.querySelectorAll('td a.mark').length > 0");
    let first = browser.value("memtransfer.runs[0].episodes.length").as_u64().unwrap();
    resume(running.id());
    Ended::of(running).expect(0);
    browser.wait_for("document.querySelectorAll('td a.mark').length === 360");
    assert!(first < 360, "{first}");
    assert_eq!(browser.value("new Set(memtransfer.runs[0].episodes.map((e) => e[0])).size"), 360);
    // One of those that came later.
    browser.click("tbody tr:last-child td:last-child a.mark");
    browser.wait_for(EPISODE);
    assert_no_problem(&mut browser);
}
