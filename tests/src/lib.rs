//! Helpers of the end-to-end tests: running `memtransfer` in a sandbox.
//!
//! Each [`Bench`] has its own folders, so that what its runs leave behind is not mistaken for another run's.
//! Every wait has a limit.

#![expect(clippy::expect_used, clippy::missing_panics_doc, reason = "a test may panic")]

pub mod browser;
pub mod example_memories;
pub mod llama;
pub mod needs;
pub mod proxy;

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use shm_types::{ATTACH_VARIABLE, WORLD_INDEX_VARIABLE, registry};
use tempfile::TempDir;

/// What the program `misbehaving-world` does once, in place of an answer, where a drill asks for it.
pub const STRAY_FAULTS: [&str; 11] = [
    "exits",
    "hangs",
    "floods",
    "another-lane",
    "no-such-lane",
    "another-size",
    "nan-state",
    "unknown-feedback",
    "unknown-ending",
    "two-ends",
    "unknown-frame",
];

/// How long a command may take before it is killed because it hangs: longer than the longest, a build of the wheel, takes on a slow
/// machine, and short enough for CI to show which one hung.
pub const WATCHDOG: Duration = Duration::from_secs(60 * 60);

/// The path of the program `name`, which was built beside the running test or program.
pub fn program(name: &str) -> PathBuf {
    let here = std::env::current_exe().expect("the path of the running program");
    let folder = here.parent().expect("a program is in a folder");
    // Tests are in target/release/deps, programs one level above.
    let release = if folder.ends_with("deps") { folder.parent() } else { Some(folder) };
    let program = release.expect("target/release").join(name);
    assert!(
        program.is_file(),
        "{} is missing: run the tests with `cargo xtask test`, which builds the programs first",
        program.display()
    );
    program
}

/// Writes a program or script. Another process makes the file: what this one has open for writing is open for a moment in every process
/// that another test starts, and cannot be executed meanwhile.
pub fn write_program(path: &Path, bytes: impl AsRef<[u8]>) {
    let mut shell = Command::new("/bin/sh");
    shell.args(["-c", "cat > \"$0\" && chmod 755 \"$0\""]).arg(path).stdin(Stdio::piped());
    let mut shell = shell.spawn().expect("a shell starts");
    let mut written = shell.stdin.take().expect("it has a pipe");
    written.write_all(bytes.as_ref()).expect("the shell reads");
    drop(written);
    assert!(shell.wait().expect("it ends").success(), "{} cannot be written", path.display());
}

/// A file or folder of the repository.
pub fn repository(path: &str) -> PathBuf {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    PathBuf::from(root).join(path).canonicalize().expect("a file or folder of the repository")
}

/// Folders to run the program in.
pub struct Bench {
    /// Holds the run folders.
    pub folder: TempDir,
    /// Where live runs are registered: in memory, as without `MEMTRANSFER_RUN_DIR`. The path is short because it is part of
    /// socket names.
    pub registry: TempDir,
}

impl Bench {
    /// New empty folders.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let registry =
            tempfile::Builder::new().prefix("mt").tempdir_in("/dev/shm").expect("a folder");
        Self { folder, registry }
    }

    /// The command `memtransfer` with `args`.
    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(program("memtransfer"));
        command
            .args(args)
            .current_dir(self.folder.path())
            .env("MEMTRANSFER_RUN_DIR", self.registry.path())
            // Failures are expected, and to print where they come from takes longer than most of them.
            .env_remove("RUST_BACKTRACE")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    /// Runs `memtransfer` with `args` and waits for it.
    pub fn run(&self, args: &[&str]) -> Ended {
        Ended::of(self.start(args))
    }

    /// Starts `memtransfer` with `args`.
    pub fn start(&self, args: &[&str]) -> Child {
        self.command(args).spawn().expect("memtransfer starts")
    }

    /// Kills a run that was [started](Self::start), as `kill -9` does, and waits until no process of any run here is left.
    pub fn kill_run(&self, child: Child) -> Ended {
        kill(child.id());
        let ended = Ended::of(child);
        eventually("the child processes to end", || {
            processes_of(self.registry.path()).is_empty().then_some(())
        });
        ended
    }

    /// The run folder `name`.
    pub fn out(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The names of all registered runs, live or dead.
    pub fn runs(&self) -> Vec<String> {
        fs::read_dir(self.registry.path())
            .expect("the registry can be read")
            .map(|entry| entry.expect("an entry").path())
            .filter(|path| path.is_dir())
            .filter_map(|path| Some(path.file_name()?.to_str()?.to_owned()))
            .collect()
    }

    /// What runs left behind: folders in the registry, shared memory, processes.
    pub fn leftovers(&self) -> Vec<String> {
        let runs = self.runs();
        let mut left = shared_memory_of(&runs);
        left.extend(runs);
        left.extend(processes_of(self.registry.path()).iter().map(|pid| format!("process {pid}")));
        left
    }
}

/// The shared memory objects of the runs with these names.
pub fn shared_memory_of(runs: &[String]) -> Vec<String> {
    let prefixes: Vec<String> = runs.iter().map(|run| format!("mt{run}_")).collect();
    fs::read_dir("/dev/shm")
        .expect("shared memory can be listed")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .filter(|name| prefixes.iter().any(|prefix| name.starts_with(prefix)))
        .collect()
}

/// What tests kill would stay in shared memory, where every process of later tests lists it.
impl Drop for Bench {
    fn drop(&mut self) {
        if let Err(error) = registry::clean(self.registry.path()) {
            eprintln!("killed runs are not cleaned: {error}");
        }
    }
}

impl Default for Bench {
    fn default() -> Self {
        Self::new()
    }
}

/// A finished run of the program.
pub struct Ended {
    /// Exit status; `None` if a signal ended it.
    pub status: Option<i32>,
    /// Its standard output.
    pub stdout: String,
    /// Its standard error.
    pub stderr: String,
}

impl Ended {
    /// Runs a command, whose output is captured, and waits for it.
    pub fn run(command: &mut Command) -> Self {
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Self::of(command.spawn().expect("the program starts"))
    }

    /// Waits for `child`, and kills it after [`WATCHDOG`].
    pub fn of(child: Child) -> Self {
        let pid = child.id();
        let (done, over) = std::sync::mpsc::channel::<()>();
        let watchdog = std::thread::spawn(move || {
            if over.recv_timeout(WATCHDOG) == Err(std::sync::mpsc::RecvTimeoutError::Timeout) {
                kill(pid);
            }
        });
        let Output { status, stdout, stderr } = child.wait_with_output().expect("it ends");
        drop(done);
        watchdog.join().expect("the watchdog ends");
        let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
        Self { status: status.code(), stdout: text(&stdout), stderr: text(&stderr) }
    }

    /// Panics with the output unless the run ended with `status`.
    pub fn expect(self, status: i32) -> Self {
        assert_eq!(self.status, Some(status), "stdout:\n{}\nstderr:\n{}", self.stdout, self.stderr);
        self
    }
}

/// A process that is killed when this is dropped, also by a test that fails.
pub struct KilledOnDrop(pub Child);

impl Drop for KilledOnDrop {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Kills process `pid` as `kill -9` does.
pub fn kill(pid: u32) {
    signal(pid, Signal::KILL);
}

/// Stops process `pid` until it is killed or [resumed](resume).
pub fn stop(pid: u32) {
    signal(pid, Signal::STOP);
}

/// Lets process `pid`, which was [stopped](stop), go on.
pub fn resume(pid: u32) {
    signal(pid, Signal::CONT);
}

/// Stops process `pid`, and waits until it does nothing more. Returns whether it was there to be stopped.
pub fn hold(pid: u32) -> bool {
    stop(pid);
    eventually("a process to stop", || {
        let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        // The state follows the name, which may have brackets.
        let state = stat.rsplit_once(") ").and_then(|(_, rest)| rest.chars().next());
        match state {
            Some('T') => Some(true),
            None | Some('Z' | 'X') => Some(false),
            Some(_) => None,
        }
    })
}

/// Sends `signal` to process `pid`.
pub fn signal(pid: u32, signal: Signal) {
    if let Some(pid) = i32::try_from(pid).ok().and_then(Pid::from_raw) {
        // It may have ended already.
        let _ = kill_process(pid, signal);
    }
}

/// The processes with an argument or variable that names a run below `registry`.
pub fn processes_of(registry: &Path) -> BTreeSet<u32> {
    let path = registry.as_os_str().as_encoded_bytes();
    let attached = [format!("{ATTACH_VARIABLE}=").as_bytes(), path].concat();
    &processes_with(path) | &processes_where("environ", &attached)
}

/// The processes with `marker` in their arguments.
pub fn processes_with(marker: &[u8]) -> BTreeSet<u32> {
    processes_where("cmdline", marker)
}

/// The processes whose `file` in /proc contains `marker`. A zombie's files are empty.
fn processes_where(file: &str, marker: &[u8]) -> BTreeSet<u32> {
    let mut found = BTreeSet::new();
    for entry in fs::read_dir("/proc").expect("/proc").flatten() {
        let pid = entry.file_name().to_str().and_then(|name| name.parse::<u32>().ok());
        let Some(pid) = pid else { continue };
        let text = fs::read(entry.path().join(file)).unwrap_or_default();
        if text.windows(marker.len()).any(|window| window == marker) {
            found.insert(pid);
        }
    }
    found
}

/// The process that has `role` ("sim", "memory", "policy") in a run below `registry`; waits for it to start.
pub fn process_of(registry: &Path, role: &str) -> u32 {
    let name = format!("{role}-proc");
    eventually(&format!("the {name} process to start"), || {
        processes_of(registry).into_iter().find(|pid| {
            let exe = fs::read_link(format!("/proc/{pid}/exe")).unwrap_or_default();
            exe.file_name() == Some(OsStr::new(&name))
        })
    })
}

/// The world with this index in a run below `registry`; waits for it to start.
pub fn process_of_world(registry: &Path, index: u8) -> u32 {
    let marker = format!("{WORLD_INDEX_VARIABLE}={index}\0");
    eventually(&format!("world {index} to start"), || {
        let worlds = processes_where("environ", marker.as_bytes());
        processes_of(registry).intersection(&worlds).next().copied()
    })
}

/// Calls `look` until it returns something.
pub fn eventually<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(start.elapsed() < WATCHDOG, "timed out waiting for {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The sorted lines of a run's episode log, which must not depend on lanes or crashes.
pub fn sorted_log(run: &Path) -> Vec<String> {
    let mut lines: Vec<String> = episodes(run).lines().map(str::to_owned).collect();
    lines.sort();
    lines
}

/// The run's episode log so far; empty if there is none.
pub fn episodes(run: &Path) -> String {
    fs::read_to_string(run.join("episodes.jsonl")).unwrap_or_default()
}

/// Waits until the run has finished `count` episodes.
pub fn wait_for_episodes(run: &Path, count: usize) {
    eventually("episodes to be finished", || {
        (episodes(run).lines().count() >= count).then_some(())
    });
}

/// The arguments in a command line without quotes.
pub fn words(line: &str) -> Vec<&str> {
    line.split_whitespace().collect()
}

/// The records of a run's episode log.
pub fn records(run: &Path) -> Vec<serde_json::Value> {
    let parse = |line: &str| serde_json::from_str(line).expect("a line of JSON");
    episodes(run).lines().map(parse).collect()
}

/// What the process that has `role` ("sim", "memory", "policy") reported as its total `key` when the run stopped.
pub fn shutdown_total(run: &Path, role: &str, key: &str) -> u64 {
    let sessions = fs::read_to_string(run.join("sessions.jsonl")).expect("the run has sessions");
    let parse = |line| serde_json::from_str(line).expect("a line of JSON");
    let mut events = sessions.lines().map(parse);
    let ended = events.find(|event: &serde_json::Value| event["event"] == "ended");
    let reports = &ended.expect("a session ended")["shutdown_reports"];
    reports[role][key].as_u64().expect("a total")
}

/// The success rate, in percent, of the records that `select` accepts. Panics if there are none.
pub fn success_rate(
    records: &[serde_json::Value],
    select: impl Fn(&serde_json::Value) -> bool,
) -> f64 {
    let selected: Vec<bool> =
        records.iter().filter(|r| select(r)).map(|r| r["ending"] == "complete").collect();
    assert!(!selected.is_empty(), "no record was selected");
    100.0 * selected.iter().filter(|&&success| success).count() as f64 / selected.len() as f64
}
