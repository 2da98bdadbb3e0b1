//! A conversation through `policy-proc ask`, which is where the project's HTTP is: lines of JSON to its
//! standard input, lines of JSON from its standard output.

use std::io::{self, BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use serde::Deserialize;

use super::chat::{Chat, ChatError, Reply, Request};

/// How often somebody who waits for an answer is told that it is still awaited.
const HEARTBEAT: Duration = Duration::from_secs(1);

/// What to start.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ask {
    /// The program `policy-proc`.
    pub program: PathBuf,
    /// Where the server is; `None`: where the environment says.
    pub base_url: Option<String>,
    /// The model, by the name that the server knows it by.
    pub model: String,
    /// Longest that one attempt may take, in seconds; `None`: the program's default.
    pub timeout_s: Option<u32>,
    /// How often a request that failed is sent again; `None`: the program's default.
    pub max_retries: Option<u32>,
}

/// A conversation with a child process, which is started by the first question. The child ends with this value,
/// and with the thread that asked first.
#[derive(Debug)]
pub struct Pipe {
    ask: Ask,
    running: Option<Running>,
}

#[derive(Debug)]
struct Running {
    child: Child,
    questions: ChildStdin,
    /// Its lines, from the thread that reads them until there are no more.
    answers: Receiver<io::Result<String>>,
}

/// A line of the child's.
#[derive(Deserialize)]
#[serde(untagged)]
enum Line {
    Replied(Reply),
    Failed { error: String },
}

impl Pipe {
    /// A conversation that has not begun.
    pub fn new(ask: Ask) -> Self {
        Self { ask, running: None }
    }

    fn command(&self) -> Command {
        let Ask { program, base_url, model, timeout_s, max_retries } = &self.ask;
        let mut command = Command::new(program);
        command.arg("ask").arg("--model").arg(model);
        command.arg("--parent").arg(std::process::id().to_string());
        if let Some(base_url) = base_url {
            command.arg("--base-url").arg(base_url);
        }
        if let Some(seconds) = timeout_s {
            command.arg("--timeout").arg(seconds.to_string());
        }
        if let Some(retries) = max_retries {
            command.arg("--max-retries").arg(retries.to_string());
        }
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        command
    }

    fn program(&self) -> String {
        self.ask.program.display().to_string()
    }

    fn start(&self) -> Result<Running, ChatError> {
        let failed = |cause| ChatError::Start { program: self.program(), cause };
        let mut child = self.command().spawn().map_err(failed)?;
        match (child.stdin.take(), child.stdout.take()) {
            (Some(questions), Some(output)) => {
                let (lines, answers) = mpsc::channel();
                thread::spawn(move || {
                    // When nobody listens any more, there is nobody to tell.
                    BufReader::new(output).lines().try_for_each(|line| lines.send(line))
                });
                Ok(Running { child, questions, answers })
            }
            _ => Err(failed(io::Error::other("it has no pipes"))),
        }
    }
}

impl Chat for Pipe {
    fn ask(&mut self, request: &Request, waiting: &mut dyn FnMut()) -> Result<Reply, ChatError> {
        let running = match self.running.take() {
            Some(running) => running,
            None => self.start()?,
        };
        let running = self.running.insert(running);
        let program = || self.ask.program.display().to_string();
        let unreadable = |e: serde_json::Error| ChatError::Unreadable {
            program: program(),
            problem: e.to_string(),
        };
        let question = serde_json::to_string(request).map_err(unreadable)?;
        let Some(line) = running.converse(&question, waiting) else {
            let status = running.status();
            self.running = None;
            return Err(ChatError::Ended { program: self.program(), status });
        };
        match serde_json::from_str(&line).map_err(unreadable)? {
            Line::Replied(reply) => Ok(reply),
            Line::Failed { error } => Err(ChatError::NoReply(error)),
        }
    }
}

impl Running {
    /// The line that answers the line `question`; `None` when the child has closed its pipes.
    fn converse(&mut self, question: &str, waiting: &mut dyn FnMut()) -> Option<String> {
        writeln!(self.questions, "{question}").and_then(|()| self.questions.flush()).ok()?;
        loop {
            match self.answers.recv_timeout(HEARTBEAT) {
                Ok(line) => return line.ok(),
                Err(RecvTimeoutError::Timeout) => waiting(),
                Err(RecvTimeoutError::Disconnected) => return None,
            }
        }
    }

    /// How the child ended, once it has closed its pipes: it is about to, if it has not yet.
    fn status(&mut self) -> String {
        match self.child.wait() {
            Ok(status) => status.to_string(),
            Err(error) => error.to_string(),
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Nobody waits for the answer that it may still be working on. That it has ended already is fine.
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Mutex, PoisonError};

    use super::super::chat::{Message, Speaker};
    use super::*;

    /// A file that is being written cannot be started, and a child of another test may hold it open.
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

    /// The outcome of two questions to a child that is a shell script.
    fn asked(script: &str) -> [Result<Reply, ChatError>; 2] {
        let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("policy-proc");
        std::fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        let mut mode = std::fs::metadata(&program).unwrap().permissions();
        std::os::unix::fs::PermissionsExt::set_mode(&mut mode, 0o755);
        std::fs::set_permissions(&program, mode).unwrap();
        let (base_url, model) = (Some("http://x/v1".to_owned()), "m".to_owned());
        let mut pipe =
            Pipe::new(Ask { program, base_url, model, timeout_s: Some(7), max_retries: None });
        let message = Message { role: Speaker::User, content: "Where?\n".into() };
        let request = Request { messages: vec![message], max_tokens: 3 };
        [pipe.ask(&request, &mut || {}), pipe.ask(&request, &mut || {})].map(|result| {
            result.map_err(|error| match error {
                ChatError::Ended { status, .. } => ChatError::Ended { program: "P".into(), status },
                ChatError::Unreadable { problem, .. } => {
                    ChatError::Unreadable { program: "P".into(), problem }
                }
                other => other,
            })
        })
    }

    #[test]
    fn the_child_is_told_what_to_ask_and_whom() {
        let answer = r#"read -r line; printf '{"text": "%s %s %s %s", "outcome": "text", "model": null, "prompt_tokens": %d, "completion_tokens": null}\n' $1 $3 $7 $9 "${#line}""#;
        let [first, second] = asked(&format!("{answer}; {answer}"));
        let first = first.unwrap();
        assert_eq!(first.text, "ask m http://x/v1 7");
        let question = r#"{"messages":[{"role":"user","content":"Where?\n"}],"max_tokens":3}"#;
        assert_eq!(first.prompt_tokens, Some(question.len() as u64));
        assert_eq!(second.unwrap(), first);
    }

    #[test]
    fn what_goes_wrong_is_told_apart() {
        for (script, expected) in [
            (r#"read -r line; echo '{"error": "status 401: who?"}'; cat"#, "status 401: who?"),
            (
                "read -r line; exit 2",
                "P has ended (exit status: 2) without an answer; what it said last is above",
            ),
            (
                "exec 0<&-; exit 3",
                "P has ended (exit status: 3) without an answer; what it said last is above",
            ),
        ] {
            let [first, _] = asked(script);
            assert_eq!(first.unwrap_err().to_string(), expected, "{script}");
        }
        let [first, _] = asked("read -r line; echo hello; cat");
        assert!(matches!(first, Err(ChatError::Unreadable { .. })), "{first:?}");
    }

    #[test]
    fn a_program_that_is_not_there_is_named() {
        let ask = Ask {
            program: "/nowhere/policy-proc".into(),
            base_url: None,
            model: "m".into(),
            timeout_s: None,
            max_retries: None,
        };
        let error = Pipe::new(ask)
            .ask(&Request { messages: vec![], max_tokens: 1 }, &mut || {})
            .unwrap_err();
        assert!(error.to_string().starts_with("cannot start /nowhere/policy-proc: "), "{error}");
    }
}
