//! llama.cpp's own HTTP server with a small model: text only, or one that sees the colours of images.
//!
//! The answers make little sense. The tests check that a server from another project understands the requests and that
//! its answers can be read.

use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;

use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;

use crate::{WATCHDOG, needs};

/// The name under which the text-only model is served.
pub const MODEL: &str = "smollm2-135m";

/// The name under which the model that sees is served.
pub const SEEING_MODEL: &str = "smollm2-colours";

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/python/llama_server.py");

/// A running server, which ends when the value is dropped or this process ends.
pub struct LlamaServer {
    /// The script's arguments before the port.
    model: Vec<String>,
    /// The encoder of images.
    encoder: Option<PathBuf>,
    process: Child,
    base_url: String,
    folder: TempDir,
}

impl LlamaServer {
    /// Starts a server of [`MODEL`] for `parallel` concurrent requests of at most `context` tokens, answers included.
    pub fn start(context: u32, parallel: u32) -> Self {
        Self::serve(needs::language_model(), MODEL, None, context, parallel)
    }

    /// Starts a server of [`SEEING_MODEL`], as [`start`](Self::start) does.
    pub fn seeing(context: u32, parallel: u32) -> Self {
        let encoder = Some(needs::vision_encoder());
        Self::serve(needs::short_language_model(), SEEING_MODEL, encoder, context, parallel)
    }

    fn serve(
        file: PathBuf,
        name: &str,
        encoder: Option<PathBuf>,
        context: u32,
        parallel: u32,
    ) -> Self {
        let file = file.to_str().expect("a path in UTF-8").to_owned();
        let model = vec![file, name.to_owned(), context.to_string(), parallel.to_string()];
        let folder = tempfile::tempdir().expect("a folder");
        let (process, base_url) = spawn(&model, encoder.as_ref(), "0", &folder);
        Self { model, encoder, process, base_url, folder }
    }

    /// The base URL, up to `/v1`.
    pub fn base_url(&self) -> &str {
        &self.base_url
    }

    /// The host and port.
    pub fn address(&self) -> &str {
        self.base_url.trim_start_matches("http://").trim_end_matches("/v1")
    }

    /// The server's standard error so far.
    pub fn log(&self) -> String {
        log(&self.folder)
    }

    /// Kills the server as `kill -9` does, and waits until it is gone.
    pub fn kill(&mut self) {
        // It may have ended already.
        drop(self.process.kill());
        drop(self.process.wait());
    }

    /// Starts the server again at the same address, after [`kill`](Self::kill).
    pub fn restart(&mut self) {
        let (_, port) = self.address().split_once(':').expect("a port");
        (self.process, self.base_url) =
            spawn(&self.model, self.encoder.as_ref(), port, &self.folder);
    }

    /// Sends `signal` to the server.
    pub fn signal(&self, signal: Signal) {
        let pid = i32::try_from(self.process.id()).ok().and_then(Pid::from_raw);
        kill_process(pid.expect("a process id"), signal).expect("the server is there");
    }
}

/// Starts the script and waits until the server is ready. Returns its process and base URL.
fn spawn(
    model: &[String],
    encoder: Option<&PathBuf>,
    port: &str,
    folder: &TempDir,
) -> (Child, String) {
    let log_file = File::options().create(true).append(true).open(folder.path().join("log"));
    let mut process = Command::new(needs::python())
        .args(["-B", SCRIPT])
        .args(model)
        .arg(port)
        .args(encoder)
        // The server exits when this process closes the pipe.
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(log_file.expect("a log"))
        .spawn()
        .expect("Python starts");
    let output = process.stdout.take().expect("a pipe");
    let (found, ready) = mpsc::channel();
    std::thread::spawn(move || {
        let mut line = String::new();
        let read = BufReader::new(output).read_line(&mut line);
        // After the time-out there is no receiver.
        let _ = found.send(read.map(|_| line));
    });
    let line = ready.recv_timeout(WATCHDOG).expect("the server is ready in time");
    let base_url = line.expect("its output can be read").trim().to_owned();
    assert!(!base_url.is_empty(), "the server did not start:\n{}", log(folder));
    (process, base_url)
}

fn log(folder: &TempDir) -> String {
    fs::read_to_string(folder.path().join("log")).unwrap_or_default()
}

impl Drop for LlamaServer {
    fn drop(&mut self) {
        self.kill();
    }
}
