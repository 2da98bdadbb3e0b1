//! Other programs to compare with: Python scripts in `benches/baselines`, with the packages pinned in
//! `benches/baselines/requirements.txt`.
//!
//! A baseline reads JSON objects, one per line, on standard input and answers each with one on standard output. An
//! answer with the key `error` is a failure. Its standard error goes to a file and is quoted when it fails.

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result, bail};
use rustix::process::{Pid, Signal, kill_process_group};
use serde_json::Value;

/// A running baseline, killed on drop.
#[derive(Debug)]
pub struct Baseline {
    name: String,
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
    log: PathBuf,
}

impl Baseline {
    /// Starts `script` with the interpreter `python`, and its log in the folder `logs`.
    ///
    /// # Errors
    /// When it cannot be started.
    pub fn start(python: &Path, script: &str, logs: &Path) -> Result<Self> {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("baselines").join(script);
        let log = logs.join(format!("{script}.log"));
        let errors =
            File::create(&log).with_context(|| format!("cannot create {}", log.display()))?;
        let mut child = Command::new(python)
            // No bytecode in the tree, no packages from the user's site folder.
            .args(["-B", "-s"])
            .arg(&path)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(errors)
            // Its own group, so that its children are killed with it.
            .process_group(0)
            .spawn()
            .with_context(|| format!("cannot start {}", python.display()))?;
        let requests = child.stdin.take().context("the baseline has no input")?;
        let answers = BufReader::new(child.stdout.take().context("the baseline has no output")?);
        Ok(Self { name: script.to_owned(), child, requests, answers, log })
    }

    /// Sends a request and waits for the answer.
    ///
    /// # Errors
    /// When the baseline has ended, answers with invalid JSON, or reports a failure.
    pub fn ask(&mut self, request: &Value) -> Result<Value> {
        let sent = writeln!(self.requests, "{request}").and_then(|()| self.requests.flush());
        let mut line = String::new();
        let read = sent.and_then(|()| self.answers.read_line(&mut line));
        if !matches!(read, Ok(bytes) if bytes > 0) {
            bail!(
                "the baseline {} has ended; the end of its log:\n{}",
                self.name,
                self.end_of_log()
            );
        }
        let answer: Value = serde_json::from_str(&line)
            .with_context(|| format!("the baseline {} answered {line:?}", self.name))?;
        match answer.get("error") {
            Some(error) => {
                bail!("the baseline {} failed: {error}\n{}", self.name, self.end_of_log())
            }
            None => Ok(answer),
        }
    }

    /// Sends a request and returns the number under `key` of the answer.
    ///
    /// # Errors
    /// As [`Baseline::ask`], and when the answer has no such number.
    pub fn ask_number(&mut self, request: &Value, key: &str) -> Result<f64> {
        let answer = self.ask(request)?;
        answer.get(key).and_then(Value::as_f64).with_context(|| {
            format!("the baseline {} answered {answer}, without a {key}", self.name)
        })
    }

    fn end_of_log(&self) -> String {
        let log = fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<&str> = log.lines().collect();
        lines[lines.len().saturating_sub(12)..].join("\n")
    }
}

impl Drop for Baseline {
    fn drop(&mut self) {
        // Both fail when it has already ended, which is fine.
        let _ = kill_process_group(Pid::from_child(&self.child), Signal::KILL);
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// A baseline whose interpreter is a shell script.
    fn baseline(folder: &Path, script: &str) -> Baseline {
        use std::os::unix::fs::PermissionsExt;
        let python = folder.join("python");
        fs::write(&python, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&python, fs::Permissions::from_mode(0o755)).unwrap();
        Baseline::start(&python, "a.py", folder).unwrap()
    }

    #[test]
    fn a_failing_baseline_reports_its_error_and_the_end_of_its_log() {
        let folder = tempfile::tempdir().unwrap();
        let script = "read line; echo \"$line\"; read line; echo '{\"error\": \"no\"}'; \
                      read line; echo gone >&2";
        let mut baseline = baseline(folder.path(), script);
        assert_eq!(baseline.ask_number(&json!({"seconds": 1.5}), "seconds").unwrap(), 1.5);
        let failed = baseline.ask(&json!({})).unwrap_err().to_string();
        assert!(failed.starts_with("the baseline a.py failed: \"no\""), "{failed}");
        let gone = baseline.ask(&json!({})).unwrap_err().to_string();
        assert_eq!(gone, "the baseline a.py has ended; the end of its log:\ngone");
    }
}
