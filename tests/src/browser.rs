//! A headless Chromium, driven through its DevTools protocol over pipes: real clicks and keys, and every error that a page
//! reports.

use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::fs::{CWD, FileType, Mode, mknodat};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{KilledOnDrop, WATCHDOG, eventually, needs};

/// A browser with one page.
pub struct Browser {
    _child: KilledOnDrop,
    commands: File,
    answers: BufReader<File>,
    sent: u64,
    session: Option<String>,
    problems: Vec<String>,
    /// The requests of the page that wait for [`Self::answer_held`].
    held: Vec<Value>,
    /// Its profile, removed last.
    _profile: TempDir,
}

impl Browser {
    /// Starts one whose page is `width` by `height` pixels.
    pub fn start(width: u32, height: u32) -> Self {
        let profile = tempfile::tempdir().expect("a folder");
        let [commands, answers] = ["commands", "answers"].map(|name| profile.path().join(name));
        for pipe in [&commands, &answers] {
            mknodat(CWD, pipe, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).expect("a pipe");
        }
        // Chromium reads commands from descriptor 3 and answers on descriptor 4.
        let child = Command::new("sh")
            .args(["-c", "exec \"$@\" 3<\"$0/commands\" 4>\"$0/answers\""])
            .arg(profile.path())
            .arg(needs::chromium())
            .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run"])
            .args(["--remote-debugging-pipe", "--disable-dev-shm-usage"])
            .args(["--disable-background-networking", "--disable-component-update"])
            .arg("--disable-sync")
            .arg(format!("--window-size={width},{height}"))
            .arg(format!("--user-data-dir={}", profile.path().display()))
            // It is killed, and leaves its temporary files there.
            .env("TMPDIR", profile.path())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("Chromium starts");
        let commands = File::options().write(true).open(commands).expect("its commands");
        let answers = BufReader::new(File::open(answers).expect("its answers"));
        let (sent, session, problems, held) = (0, None, Vec::new(), Vec::new());
        let mut browser = Self {
            _child: KilledOnDrop(child),
            commands,
            answers,
            sent,
            session,
            problems,
            held,
            _profile: profile,
        };
        let target = browser.send("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let attached = browser.send("Target.attachToTarget", attach);
        browser.session = attached["sessionId"].as_str().map(str::to_owned);
        for domain in ["Page.enable", "Runtime.enable", "Log.enable"] {
            browser.send(domain, json!({}));
        }
        browser.resize(width, height);
        browser
    }

    /// Gives the page another size.
    pub fn resize(&mut self, width: u32, height: u32) {
        let size =
            json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        self.send("Emulation.setDeviceMetricsOverride", size);
    }

    /// Sends a command and returns its result; notes the problems that the page reports meanwhile.
    pub fn send(&mut self, method: &str, params: Value) -> Value {
        self.sent += 1;
        let mut command = json!({ "id": self.sent, "method": method, "params": params });
        if let Some(session) = &self.session {
            command["sessionId"] = session.as_str().into();
        }
        self.commands.write_all(format!("{command}\0").as_bytes()).expect("Chromium listens");
        loop {
            let mut answer = Vec::new();
            self.answers.read_until(0, &mut answer).expect("Chromium answers");
            answer.pop();
            let answer: Value = serde_json::from_slice(&answer).expect("Chromium ended early");
            if answer["id"] == self.sent {
                assert!(answer.get("error").is_none(), "{method}: {}", answer["error"]);
                return answer["result"].clone();
            }
            self.note(&answer);
        }
    }

    fn note(&mut self, event: &Value) {
        let params = &event["params"];
        if event["method"] == "Fetch.requestPaused" {
            self.held.push(params["requestId"].clone());
        }
        let is_problem = match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => true,
            Some("Runtime.consoleAPICalled") => params["type"] == "error",
            Some("Log.entryAdded") => params["entry"]["level"] == "error",
            _ => false,
        };
        if is_problem {
            self.problems.push(params.to_string());
        }
    }

    /// Goes to `url`.
    pub fn open(&mut self, url: &str) {
        self.send("Page.navigate", json!({ "url": url }));
    }

    /// Holds every request of the page whose address fits `pattern`, until [`Self::answer_held`].
    pub fn hold(&mut self, pattern: &str) {
        self.send("Fetch.enable", json!({ "patterns": [{ "urlPattern": pattern }] }));
    }

    /// Waits until a request is held.
    pub fn wait_for_held(&mut self) {
        let start = Instant::now();
        while self.held.is_empty() {
            assert!(start.elapsed() < WATCHDOG, "the page sends no request");
            self.value("0");
            sleep(Duration::from_millis(5));
        }
    }

    /// Lets the requests that are held go on, and holds no more.
    pub fn answer_held(&mut self) {
        for request in std::mem::take(&mut self.held) {
            self.send("Fetch.continueRequest", json!({ "requestId": request }));
        }
        self.send("Fetch.disable", json!({}));
    }

    /// The value of a JavaScript expression.
    pub fn value(&mut self, expression: &str) -> Value {
        let params =
            json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let result = self.send("Runtime.evaluate", params);
        assert!(result.get("exceptionDetails").is_none(), "{expression}: {result}");
        result["result"]["value"].clone()
    }

    /// Waits until a JavaScript expression is true.
    pub fn wait_for(&mut self, expression: &str) {
        let start = Instant::now();
        while self.value(expression) != true {
            if start.elapsed() > WATCHDOG {
                let page = "[location.href, document.readyState, document.visibilityState, document.body.innerText]";
                let page = self.value(page);
                panic!("timed out waiting for {expression}\n{page}\n{:?}", self.problems);
            }
            sleep(Duration::from_millis(5));
        }
    }

    /// The text of the first element that `selector` finds; waits for it.
    pub fn text(&mut self, selector: &str) -> String {
        self.wait_for(&format!("document.querySelector({selector:?}) !== null"));
        let text = self.value(&format!("document.querySelector({selector:?}).textContent"));
        text.as_str().unwrap_or_default().to_owned()
    }

    /// Clicks the middle of the first element that `selector` finds; waits until it is there, stands still and is not covered.
    pub fn click(&mut self, selector: &str) {
        self.wait_for(&format!("document.querySelector({selector:?}) !== null"));
        let place = format!(
            "(async () => {{ \
               const e = document.querySelector({selector:?}); \
               if (e === null) return null; \
               e.scrollIntoView({{block: 'center'}}); \
               const before = e.getBoundingClientRect(); \
               await new Promise((resolve) => setTimeout(resolve, 50)); \
               const r = e.getBoundingClientRect(); \
               const [x, y] = [r.x + r.width / 2, r.y + r.height / 2]; \
               const stands = e.isConnected && r.x === before.x && r.y === before.y; \
               return stands && e.contains(document.elementFromPoint(x, y)) ? [x, y] : null; \
             }})()"
        );
        let middle = eventually(&format!("a place to click {selector}"), || {
            let middle = self.value(&place);
            (!middle.is_null()).then_some(middle)
        });
        for (kind, buttons) in [("mousePressed", 1), ("mouseReleased", 0)] {
            let click = json!({
                "type": kind, "x": middle[0], "y": middle[1], "button": "left", "buttons": buttons, "clickCount": 1
            });
            self.send("Input.dispatchMouseEvent", click);
        }
    }

    /// Presses a key, by its name in JavaScript: `ArrowRight`, `n`.
    pub fn press(&mut self, key: &str) {
        let code = match key {
            "Tab" => 9,
            "Enter" => 13,
            " " => 32,
            "End" => 35,
            "Home" => 36,
            "ArrowLeft" => 37,
            "ArrowUp" => 38,
            "ArrowRight" => 39,
            "ArrowDown" => 40,
            letter => u32::from(letter.to_ascii_uppercase().as_bytes()[0]),
        };
        for kind in ["keyDown", "keyUp"] {
            let mut press = json!({ "type": kind, "key": key, "windowsVirtualKeyCode": code });
            if kind == "keyDown" && (key.len() == 1 || key == "Enter") {
                press["text"] = if key == "Enter" { "\r" } else { key }.into();
            }
            self.send("Input.dispatchKeyEvent", press);
        }
    }

    /// Chooses `value` in the list that `selector` finds, as a user does.
    pub fn choose(&mut self, selector: &str, value: &str) {
        self.wait_for(&format!("document.querySelector({selector:?}) !== null"));
        self.value(&format!(
            "(() => {{ const e = document.querySelector({selector:?}); e.value = {value:?}; \
             e.dispatchEvent(new Event('change', {{bubbles: true}})); }})()"
        ));
    }

    /// Every error that the page has reported: exceptions, and messages in the console.
    pub fn problems(&mut self) -> &[String] {
        // Events before this answer have arrived.
        self.value("0");
        &self.problems
    }
}
