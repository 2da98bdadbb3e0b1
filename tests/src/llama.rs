//! llama.cpp's own HTTP server with a small text-only model.
//!
//! The answers make little sense. The tests check that a server from another project understands the requests and that
//! its answers can be read.

use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;

use tempfile::TempDir;

use crate::{WATCHDOG, needs};

/// The name under which the model is served.
pub const MODEL: &str = "smollm2-135m";

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/python/llama_server.py");

/// A running server, which ends when the value is dropped or this process ends.
pub struct LlamaServer {
    process: Child,
    base_url: String,
    folder: TempDir,
}

impl LlamaServer {
    /// Starts a server for `parallel` concurrent requests of at most `context` tokens, answers included.
    pub fn start(context: u32, parallel: u32) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let log = File::create(folder.path().join("log")).expect("a log");
        let mut process = Command::new(needs::python())
            .args(["-B", SCRIPT])
            .arg(needs::language_model())
            .args([MODEL, &context.to_string(), &parallel.to_string()])
            // The server exits when this process closes the pipe.
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .expect("Python starts");
        let output = process.stdout.take().expect("a pipe");
        let mut server = Self { process, base_url: String::new(), folder };

        let (found, ready) = mpsc::channel();
        std::thread::spawn(move || {
            let mut line = String::new();
            let read = BufReader::new(output).read_line(&mut line);
            // After the time-out there is no receiver.
            let _ = found.send(read.map(|_| line));
        });
        let line = ready.recv_timeout(WATCHDOG).expect("the server is ready in time");
        server.base_url = line.expect("its output can be read").trim().to_owned();
        assert!(!server.base_url.is_empty(), "the server did not start:\n{}", server.log());
        server
    }

    /// The base URL, up to `/v1`.
    pub fn base_url(&self) -> &str {
        &self.base_url
    }

    /// The server's standard error so far.
    pub fn log(&self) -> String {
        fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }
}

impl Drop for LlamaServer {
    fn drop(&mut self) {
        // It may have ended already.
        drop(self.process.kill());
        drop(self.process.wait());
    }
}
