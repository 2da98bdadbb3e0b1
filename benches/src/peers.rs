//! Programs of others to measure beside ours: Python scripts in `benches/peers`, with the packages that
//! `benches/peers/requirements.txt` pins.
//!
//! A peer reads a JSON object a line on its standard input and answers each with one on its standard output; an
//! answer with the key `error` is a failure. What it prints on standard error goes to a file, and into the message
//! when it fails.

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result, bail};
use rustix::process::{Pid, Signal, kill_process_group};
use serde_json::Value;

/// Where peers are found.
#[derive(Debug, Clone)]
pub struct Peers {
    /// A Python interpreter that has the peers' packages.
    pub python: PathBuf,
    /// The folder of their scripts.
    pub scripts: PathBuf,
}

impl Peers {
    /// With the scripts of this source tree.
    pub fn new(python: PathBuf) -> Self {
        Self { python, scripts: Path::new(env!("CARGO_MANIFEST_DIR")).join("peers") }
    }
}

/// A peer that runs. Dropping it ends it.
#[derive(Debug)]
pub struct Peer {
    name: String,
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
    log: PathBuf,
}

impl Peer {
    /// Starts `script`, with its log in the folder `logs`.
    ///
    /// # Errors
    /// When it cannot be started.
    pub fn start(peers: &Peers, script: &str, logs: &Path) -> Result<Self> {
        let path = peers.scripts.join(script);
        let log = logs.join(format!("{script}.log"));
        let errors =
            File::create(&log).with_context(|| format!("cannot make {}", log.display()))?;
        let mut child = Command::new(&peers.python)
            // No bytecode in the tree, nothing of the user's own packages.
            .args(["-B", "-s"])
            .arg(&path)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(errors)
            // What it starts ends with it.
            .process_group(0)
            .spawn()
            .with_context(|| format!("cannot start {}", peers.python.display()))?;
        let requests = child.stdin.take().context("the peer has no input")?;
        let answers = BufReader::new(child.stdout.take().context("the peer has no output")?);
        Ok(Self { name: script.to_owned(), child, requests, answers, log })
    }

    /// Asks, and waits for the answer.
    ///
    /// # Errors
    /// When the peer is gone, answers with what is no JSON, or says that it failed.
    pub fn ask(&mut self, request: &Value) -> Result<Value> {
        let sent = writeln!(self.requests, "{request}").and_then(|()| self.requests.flush());
        let mut line = String::new();
        let read = sent.and_then(|()| self.answers.read_line(&mut line));
        if !matches!(read, Ok(bytes) if bytes > 0) {
            bail!("the peer {} has ended; its last words:\n{}", self.name, self.last_words());
        }
        let answer: Value = serde_json::from_str(&line)
            .with_context(|| format!("the peer {} answered {line:?}", self.name))?;
        match answer.get("error") {
            Some(error) => bail!("the peer {} failed: {error}\n{}", self.name, self.last_words()),
            None => Ok(answer),
        }
    }

    /// Asks for a number: what the answer has under `key`.
    ///
    /// # Errors
    /// As [`Peer::ask`], and when there is no number.
    pub fn ask_number(&mut self, request: &Value, key: &str) -> Result<f64> {
        let answer = self.ask(request)?;
        answer
            .get(key)
            .and_then(Value::as_f64)
            .with_context(|| format!("the peer {} answered {answer}, without a {key}", self.name))
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    fn last_words(&self) -> String {
        let log = fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<&str> = log.lines().collect();
        lines[lines.len().saturating_sub(12)..].join("\n")
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = kill_process_group(Pid::from_child(&self.child), Signal::KILL);
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// A peer whose interpreter is a script of the shell, which sees what Python would be called with.
    fn peer(folder: &Path, script: &str) -> Peer {
        use std::os::unix::fs::PermissionsExt;
        let python = folder.join("python");
        fs::write(&python, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&python, fs::Permissions::from_mode(0o755)).unwrap();
        Peer::start(&Peers { python, scripts: folder.to_owned() }, "a.py", folder).unwrap()
    }

    #[test]
    fn a_peer_answers_until_it_fails_and_then_says_why() {
        let folder = tempfile::tempdir().unwrap();
        let script = "read line; echo \"$line\"; read line; echo '{\"error\": \"no\"}'; \
                      read line; echo gone >&2";
        let mut peer = peer(folder.path(), script);
        assert_eq!(peer.ask_number(&json!({"seconds": 1.5}), "seconds").unwrap(), 1.5);
        let failed = peer.ask(&json!({})).unwrap_err().to_string();
        assert!(failed.starts_with("the peer a.py failed: \"no\""), "{failed}");
        let gone = peer.ask(&json!({})).unwrap_err().to_string();
        assert_eq!(gone, "the peer a.py has ended; its last words:\ngone");
    }
}
