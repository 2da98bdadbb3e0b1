//! The processes of a run: started, watched, and never left behind.
//!
//! Each is a sibling of the running program, in a process group of its own, so that Ctrl-C reaches the
//! orchestrator alone and it decides what happens. They end with it whatever ends it: the system kills
//! them when the thread that started them dies (see `shm_types::process::die_with_parent`). What they print
//! goes to a file each, whose last lines stand in the message when one fails.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use shm_types::message::Role;

/// Lines of a dead process's log that are shown.
const LAST_LINES: usize = 12;

/// Set for whatever renders: one of Mesa's layers otherwise prints errors about a desktop session where
/// there is none.
pub const QUIET_DRIVER: (&str, &str) = ("NODEVICE_SELECT", "1");

/// A process to start.
#[derive(Debug, Clone)]
pub struct Launch {
    /// Its part in the run.
    pub role: Role,
    /// What to start.
    pub program: PathBuf,
    /// With which arguments.
    pub args: Vec<OsString>,
}

/// A process that ended although nobody asked it to.
#[derive(Debug)]
pub struct Death {
    /// Its part.
    pub role: Role,
    /// How it ended.
    pub status: ExitStatus,
    /// The last lines of its log.
    pub last_words: String,
    /// Its log.
    pub log: PathBuf,
}

impl std::fmt::Display for Death {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "the {} process ended ", self.role.word())?;
        match (self.status.code(), self.status.signal()) {
            (Some(code), _) => write!(f, "with exit status {code}")?,
            (None, Some(signal)) => write!(f, "on signal {signal}")?,
            (None, None) => write!(f, "in an unknown way")?,
        }
        if self.last_words.is_empty() {
            return write!(f, " without a word ({})", self.log.display());
        }
        write!(f, "; its last words ({}):\n{}", self.log.display(), self.last_words)
    }
}

/// The processes of one generation. Dropping it kills those that are left.
#[derive(Debug)]
pub struct Crew {
    members: Vec<Member>,
}

#[derive(Debug)]
struct Member {
    role: Role,
    child: Child,
    log: PathBuf,
    /// Where this process's part of the log begins.
    log_start: u64,
}

impl Crew {
    /// Starts every process of `launches`, with its log in `logs`.
    ///
    /// # Errors
    /// When one cannot be started or its log cannot be opened; those that were started are killed.
    pub fn start(launches: &[Launch], logs: &Path) -> Result<Self> {
        fs::create_dir_all(logs).with_context(|| format!("cannot make {}", logs.display()))?;
        let mut crew = Self { members: Vec::new() };
        for launch in launches {
            crew.members.push(Member::start(launch, logs)?);
        }
        Ok(crew)
    }

    /// The first process found dead, if one is.
    pub fn death(&mut self) -> Option<Death> {
        self.members.iter_mut().find_map(Member::death)
    }

    /// Waits until all have ended by themselves, at most for `patience`, and kills the rest.
    pub fn disband(mut self, patience: Duration) {
        let deadline = Instant::now() + patience;
        while Instant::now() < deadline && self.members.iter_mut().any(Member::is_alive) {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

impl Drop for Crew {
    fn drop(&mut self) {
        for member in &mut self.members {
            if member.is_alive() {
                tracing::debug!(role = member.role.word(), "killed");
                // It may end in between; then there is nothing to kill.
                let _ = member.child.kill();
            }
            if let Err(error) = member.child.wait() {
                tracing::warn!(role = member.role.word(), %error, "cannot wait for the process");
            }
        }
    }
}

impl Member {
    fn start(launch: &Launch, logs: &Path) -> Result<Self> {
        let Launch { role, program, args } = launch;
        let log = logs.join(format!("{}.log", role.word()));
        let file = File::options().create(true).append(true).open(&log);
        let file = file.with_context(|| format!("cannot open {}", log.display()))?;
        let log_start = file.metadata().map_or(0, |facts| facts.len());
        let output = file.try_clone().with_context(|| format!("cannot open {}", log.display()))?;
        let child = Command::new(program)
            .args(args)
            .env(QUIET_DRIVER.0, QUIET_DRIVER.1)
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(file)
            .process_group(0)
            .spawn()
            .with_context(|| {
                format!(
                    "cannot start {}: build all programs with `cargo build --release --workspace`",
                    program.display()
                )
            })?;
        Ok(Self { role: *role, child, log, log_start })
    }

    fn is_alive(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    fn death(&mut self) -> Option<Death> {
        let status = match self.child.try_wait() {
            Ok(None) => return None,
            Ok(Some(status)) => status,
            Err(error) => {
                tracing::warn!(role = self.role.word(), %error, "cannot ask for the process");
                return None;
            }
        };
        let last_words = last_words(&self.log, self.log_start, self.role).unwrap_or_default();
        Some(Death { role: self.role, status, last_words, log: self.log.clone() })
    }
}

/// What a process said last in `log`, from byte `start` on: the message it ended with if it did so by
/// itself, as `sim-proc: ...`, otherwise the last lines.
fn last_words(log: &Path, start: u64, role: Role) -> io::Result<String> {
    let bytes = fs::read(log)?;
    let text = String::from_utf8_lossy(bytes.get(start as usize..).unwrap_or_default());
    let lines: Vec<&str> = text.lines().collect();
    let farewell = format!("{}-proc: ", role.word());
    let from = lines.iter().rposition(|line| line.starts_with(&farewell));
    let from = from.unwrap_or(lines.len().saturating_sub(LAST_LINES));
    Ok(lines[from..].join("\n"))
}

/// The program `name` beside the running one.
///
/// # Errors
/// When it is not there.
pub fn sibling(name: &str) -> Result<PathBuf> {
    let here = std::env::current_exe().context("cannot tell where this program lies")?;
    let sibling = here.with_file_name(name);
    anyhow::ensure!(
        sibling.is_file(),
        "{} is missing: build all programs with `cargo build --release --workspace`",
        sibling.display()
    );
    Ok(sibling)
}
