//! Child processes of a run: started, watched, stopped.
//!
//! A child is a program beside the running one, or an external command. Each has a process group of its own, so that
//! Ctrl-C reaches the orchestrator alone; when a child has ended, its whole group is killed, including everything that
//! it started. Children end with the orchestrator: the kernel kills the project's own programs when the thread that started
//! them ends (see `shm_types::process::die_with_parent`), and a shell kills the group of an external command or builder. The output of
//! a child goes to a log file, whose last lines are part of the message when it fails; of a long log the middle is left out.

mod log_file;

mod groups;

use std::ffi::OsString;
use std::fmt::Debug;
use std::fs::DirBuilder;
use std::io::{self, Read, Seek, SeekFrom};
use std::os::unix::fs::DirBuilderExt;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result};
use rustix::io::Errno;
use shm_types::clock::{Instant, sleep};
use shm_types::description::memory_folder;
use shm_types::message::Role;
use shm_types::{ATTACH_VARIABLE, WORLD_INDEX_VARIABLE};

pub use groups::{Group, kill_all, output, output_until};
use log_file::{LogFile, LogLimits, LogPosition};

/// Lines of the log shown when a child has ended.
const TAIL_LINES: usize = 12;

/// Most bytes of the end of a log that are read.
const TAIL_BYTES: u64 = 64 << 10;

/// How long the rest of a process's output is awaited when it has ended.
const LOG_WAIT: Duration = Duration::from_secs(2);

/// A variable for programs that render: without a desktop session, one of Mesa's Vulkan layers otherwise prints errors.
pub const QUIET_DRIVER: (&str, &str) = ("NODEVICE_SELECT", "1");

/// A process to start.
#[derive(Debug, Clone)]
pub struct Launch {
    /// Its role in the run.
    pub role: Role,
    /// Index of a world or an external memory; 0 for other roles.
    pub index: u8,
    /// The program.
    pub program: PathBuf,
    /// Its arguments.
    pub args: Vec<OsString>,
    /// The command line as the user gave it, if the program is external.
    pub command: Option<String>,
    /// Additional environment variables.
    pub env: Vec<(OsString, OsString)>,
    /// Whether it gets the keys of the environment: it asks a model, or is a program of the user's that may.
    pub needs_keys: bool,
}

/// Takes the keys of the environment from a program that asks no model.
pub fn without_keys(command: &mut Command) -> &mut Command {
    domain::KEY_VARIABLES.iter().fold(command, |command, variable| command.env_remove(variable))
}

impl Launch {
    /// The program `name` beside the running one, as `role`.
    ///
    /// # Errors
    /// When there is no such file.
    pub fn sibling(role: Role, name: &str, args: Vec<OsString>) -> Result<Self> {
        let env = vec![(QUIET_DRIVER.0.into(), QUIET_DRIVER.1.into())];
        let program = sibling(name)?;
        Ok(Self { role, index: 0, program, args, command: None, env, needs_keys: false })
    }

    /// An external command line, split into words as a shell does. No shell runs it.
    ///
    /// # Errors
    /// When a quote is not closed, or the command is empty.
    pub fn command(role: Role, command: &str) -> Result<Self> {
        let words = shlex::split(command).with_context(|| {
            format!("an unclosed quote, or a backslash at the end, in the command: {command}")
        })?;
        let mut words = words.into_iter();
        let program = words.next().context("the command is empty")?.into();
        let args = words.map(OsString::from).collect();
        let command = Some(command.to_owned());
        Ok(Self { role, index: 0, program, args, command, env: Vec::new(), needs_keys: true })
    }

    /// As [`Self::command`], for the external memory with this index.
    ///
    /// # Errors
    /// As [`Self::command`].
    pub fn external_memory(index: u8, command: &str) -> Result<Self> {
        Ok(Self { index, ..Self::command(Role::ExternalMemory, command)? })
    }

    /// Passes it those of `flags` that have a value.
    pub fn with_flags(
        mut self,
        flags: impl IntoIterator<Item = (&'static str, Option<String>)>,
    ) -> Self {
        for (flag, value) in flags {
            self.args.extend(value.into_iter().flat_map(|value| [flag.into(), value.into()]));
        }
        self
    }

    /// Tells the process which run to join: the project's own programs by an argument, external ones by a variable. An
    /// external memory receives its own folder in the run's, a world its index.
    pub fn attached_to(mut self, run: &Path) -> Self {
        if self.role == Role::Sim {
            self.env.push((WORLD_INDEX_VARIABLE.into(), self.index.to_string().into()));
        }
        match self.command {
            None => self.args.extend(["--attach".into(), run.into()]),
            Some(_) if self.role == Role::ExternalMemory => {
                let folder = memory_folder(run, self.index);
                self.env.push((ATTACH_VARIABLE.into(), folder.into()));
            }
            Some(_) => self.env.push((ATTACH_VARIABLE.into(), run.into())),
        }
        self
    }

    /// Why the process did not start, and what to do.
    fn not_started(&self, error: &io::Error) -> String {
        let Some(command) = &self.command else {
            let program = self.program.display();
            return match error.kind() {
                io::ErrorKind::NotFound => format!(
                    "cannot start {program}: build all programs with `cargo build --release --workspace`"
                ),
                _ => format!("cannot start {program}"),
            };
        };
        let program = self.program.display();
        let advice = match error.kind() {
            io::ErrorKind::NotFound => format!(
                "there is no program `{program}` in $PATH or, if it is a path, relative to the working folder"
            ),
            io::ErrorKind::PermissionDenied => {
                format!("`{program}` is not executable: start its interpreter, or `chmod +x` it")
            }
            _ if error.raw_os_error() == Some(Errno::NOEXEC.raw_os_error()) => format!(
                "`{program}` is neither a program nor a script whose first line names its interpreter"
            ),
            _ => format!("`{program}` does not start"),
        };
        format!("cannot start the {} command `{command}`: {advice}", self.role.word())
    }
}

/// Starts processes.
pub trait Launcher: Debug + Send + Sync {
    /// Starts the process of `launch`, which prints to the file `log`.
    ///
    /// # Errors
    /// When it cannot be started, or its log cannot be opened.
    fn start(&self, launch: &Launch, log: &Path) -> Result<Box<dyn Process>>;
}

/// A process that was started.
pub trait Process: Debug + Send {
    /// Whether it runs.
    fn is_alive(&self) -> bool;

    /// Kills it, if it still runs, and everything that it has started, and waits until it has ended. Later calls return the
    /// same status.
    ///
    /// # Errors
    /// When the system cannot wait for it.
    fn end(&mut self) -> io::Result<ExitStatus>;
}

/// Starts processes of the operating system.
#[derive(Debug, Clone, Copy, Default)]
pub struct System;

/// A process of the operating system.
#[derive(Debug)]
struct SystemProcess {
    group: Group,
    /// Disconnected once everything that it has printed is in its log; `None` once that was awaited.
    written: Option<Receiver<()>>,
}

/// A child that ended without being asked to.
#[derive(Debug)]
pub struct ChildExit {
    /// Its role.
    pub role: Role,
    /// Index of a world or an external memory; 0 for other roles.
    pub index: u8,
    /// Its exit status.
    pub status: ExitStatus,
    /// The last lines of its log.
    pub log_tail: String,
    /// Its log file.
    pub log: PathBuf,
    /// The command line, if the program is external.
    pub command: Option<String>,
}

impl ChildExit {
    /// The exit status in words, and the last lines of the log.
    pub fn how(&self) -> String {
        match self.log_tail.as_str() {
            "" => format!("{} and printed nothing", self.status_in_words()),
            tail => format!("{}; the last lines of its log:\n{tail}", self.status_in_words()),
        }
    }

    fn status_in_words(&self) -> String {
        match (self.status.code(), self.status.signal()) {
            (Some(code), _) => format!("with exit status {code}"),
            (None, Some(signal)) => format!("on signal {signal}"),
            (None, None) => "with an unknown status".to_owned(),
        }
    }
}

impl std::fmt::Display for ChildExit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "the {} process ", self.role.word())?;
        if self.role == Role::Sim && self.index > 0 {
            write!(f, "{} ", self.index)?;
        }
        if let Some(command) = &self.command {
            write!(f, "(`{command}`) ")?;
        }
        write!(f, "ended {}", self.status_in_words())?;
        if self.log_tail.is_empty() {
            return write!(f, " and printed nothing ({})", self.log.display());
        }
        write!(f, "; the last lines of {}:\n{}", self.log.display(), self.log_tail)
    }
}

/// Child processes. Dropping them kills those that still run.
#[derive(Debug, Default)]
pub struct Children {
    processes: Vec<ChildProcess>,
}

#[derive(Debug)]
struct ChildProcess {
    role: Role,
    index: u8,
    command: Option<String>,
    process: Box<dyn Process>,
    log: PathBuf,
    /// Where the output of this process begins in the log.
    log_start: LogPosition,
}

impl Children {
    /// Starts all processes of `launches`, with their logs in `logs`.
    ///
    /// # Errors
    /// When one cannot be started or its log cannot be opened; the others are killed.
    pub fn start(launches: &[Launch], logs: &Path) -> Result<Self> {
        Self::start_with(&System, launches, logs)
    }

    /// As [`Self::start`], with processes that `launcher` starts.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn start_with(launcher: &dyn Launcher, launches: &[Launch], logs: &Path) -> Result<Self> {
        // What programs print may be private.
        let created = DirBuilder::new().recursive(true).mode(0o700).create(logs);
        created.with_context(|| format!("cannot create {}", logs.display()))?;
        let mut children = Self::default();
        for launch in launches {
            children.processes.push(ChildProcess::start(launcher, launch, logs)?);
        }
        Ok(children)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.processes.is_empty()
    }

    /// Adds the children of `other`.
    pub fn adopt(&mut self, mut other: Self) {
        self.processes.append(&mut other.processes);
    }

    /// A child that has ended, if any. External ones come first: when one ends, the processes that send to it may fail,
    /// too.
    pub fn exited(&mut self) -> Option<ChildExit> {
        let mut exits: Vec<ChildExit> =
            self.processes.iter_mut().filter_map(ChildProcess::exit).collect();
        let first = exits.iter().position(|exit| exit.role == Role::Policy);
        let memory = || exits.iter().position(|exit| exit.role == Role::ExternalMemory);
        let first = first.or_else(memory).unwrap_or(0);
        (!exits.is_empty()).then(|| exits.swap_remove(first))
    }

    /// The last lines that the external memory with this index has printed, and its log file.
    pub fn printed_by_memory(&self, index: u8) -> Option<(String, &Path)> {
        let is_it = |process: &&ChildProcess| {
            process.role == Role::ExternalMemory && process.index == index
        };
        let process = self.processes.iter().find(is_it)?;
        let tail = log_tail(&process.log, &process.log_start, process.role).unwrap_or_default();
        Some((tail, &process.log))
    }

    /// Waits at most `timeout` for all children to end, and kills the others.
    pub fn wait_or_kill(self, timeout: Duration) {
        let deadline = Instant::now() + timeout;
        while Instant::now() < deadline
            && self.processes.iter().any(|child| child.process.is_alive())
        {
            sleep(Duration::from_millis(2));
        }
    }
}

impl Drop for Children {
    fn drop(&mut self) {
        for child in &mut self.processes {
            tracing::debug!(role = child.role.word(), "ending its process group");
            child.end();
        }
    }
}

impl ChildProcess {
    fn start(launcher: &dyn Launcher, launch: &Launch, logs: &Path) -> Result<Self> {
        let log = logs.join(log_name(launch.role, launch.index));
        // Shortens what earlier processes printed, if need be, so that its end is known.
        LogFile::open(&log, LogLimits::STANDARD)
            .with_context(|| format!("cannot open {}", log.display()))?;
        let log_start = LogPosition::end_of(&log);
        let process = launcher.start(launch, &log)?;
        let (role, index, command) = (launch.role, launch.index, launch.command.clone());
        Ok(Self { role, index, command, process, log, log_start })
    }

    /// Kills it and everything that it has started. Returns its status, if the system knows it.
    fn end(&mut self) -> Option<ExitStatus> {
        let status = self.process.end().inspect_err(|error| {
            tracing::warn!(role = self.role.word(), %error, "cannot wait for the process");
        });
        status.ok()
    }

    fn exit(&mut self) -> Option<ChildExit> {
        if self.process.is_alive() {
            return None;
        }
        // Also the processes that it started.
        let status = self.end()?;
        let log_tail = log_tail(&self.log, &self.log_start, self.role).unwrap_or_default();
        let (log, command) = (self.log.clone(), self.command.clone());
        let Self { role, index, .. } = *self;
        Some(ChildExit { role, index, status, log_tail, log, command })
    }
}

impl Launcher for System {
    fn start(&self, launch: &Launch, log: &Path) -> Result<Box<dyn Process>> {
        let Launch { program, args, env, .. } = launch;
        let mut file = LogFile::open(log, LogLimits::STANDARD)
            .with_context(|| format!("cannot open {}", log.display()))?;
        let pipe = || {
            let (reader, output) = io::pipe()?;
            Ok((reader, output.try_clone()?, output))
        };
        let (reader, errors, output) = pipe()
            .map_err(|error: io::Error| anyhow::Error::from(error).context("cannot make a pipe"))?;
        // Ends when the process and all that it has started have closed their output.
        let (is_writing, written) = mpsc::channel();
        let write = move || {
            file.take(reader);
            drop(is_writing);
        };
        thread::Builder::new()
            .name("process-log".to_owned())
            .spawn(write)
            .context("cannot start a thread")?;
        let mut command = Command::new(program);
        if !launch.needs_keys {
            without_keys(&mut command);
        }
        command
            .args(args)
            .envs(env.iter().map(|(name, value)| (name, value)))
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(errors);
        // The project's own programs ask the kernel to end with this one.
        let group = match launch.command {
            None => Group::start(&mut command),
            Some(_) => Group::start_watched(&mut command),
        };
        let group = group.map_err(|error| {
            let why = launch.not_started(&error);
            anyhow::Error::from(error).context(why)
        })?;
        Ok(Box::new(SystemProcess { group, written: Some(written) }))
    }
}

impl Process for SystemProcess {
    fn is_alive(&self) -> bool {
        self.group.is_alive()
    }

    fn end(&mut self) -> io::Result<ExitStatus> {
        let status = self.group.end()?;
        // A process that has left the group may keep the output open.
        if let Some(written) = self.written.take() {
            let _ = written.recv_timeout(LOG_WAIT);
        }
        Ok(status)
    }
}

/// The name of a process's log file.
fn log_name(role: Role, index: u8) -> String {
    match role {
        Role::Sim if index == 0 => format!("{}.log", role.word()),
        Role::Sim | Role::ExternalMemory => format!("{}-{index}.log", role.word()),
        role => format!("{}.log", role.word()),
    }
}

/// The end of `log`, of which the process wrote from `start` on: from its final error message (`sim-proc: ...`) if
/// there is one, otherwise the last lines.
fn log_tail(log: &Path, start: &LogPosition, role: Role) -> io::Result<String> {
    let text = end_of(log, start.offset_in(&durable::open(log)?)?)?;
    let lines: Vec<&str> = text.lines().collect();
    let message = format!("{}-proc: ", role.word());
    let from = lines.iter().rposition(|line| line.starts_with(&message));
    let from = from.unwrap_or(lines.len().saturating_sub(TAIL_LINES));
    Ok(lines[from..].join("\n"))
}

/// The end of the file `log` from byte `start` on, at most [`TAIL_BYTES`]: a process may have printed any amount.
fn end_of(log: &Path, start: u64) -> io::Result<String> {
    let mut file = durable::open(log)?;
    let length = file.metadata()?.len();
    // A part of it may have been left out since.
    let start = if start > length { 0 } else { start };
    let start = start.max(length.saturating_sub(TAIL_BYTES));
    file.seek(SeekFrom::Start(start))?;
    let mut bytes = Vec::new();
    file.take(TAIL_BYTES).read_to_end(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// The last lines of `log` from byte `start` on.
///
/// # Errors
/// When the file cannot be read.
pub fn last_lines(log: &Path, start: u64) -> io::Result<String> {
    let text = end_of(log, start)?;
    let lines: Vec<&str> = text.lines().collect();
    Ok(lines[lines.len().saturating_sub(TAIL_LINES)..].join("\n"))
}

/// The program `name` beside the running one.
///
/// # Errors
/// When there is no such file.
pub fn sibling(name: &str) -> Result<PathBuf> {
    let here = std::env::current_exe().context("cannot find the path of the running program")?;
    let sibling = here.with_file_name(name);
    anyhow::ensure!(
        sibling.is_file(),
        "{} is missing: build all programs with `cargo build --release --workspace`",
        sibling.display()
    );
    Ok(sibling)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_reach_only_programs_that_may_ask_a_model() {
        let mut command = Command::new("x");
        let removed: Vec<_> = without_keys(&mut command).get_envs().collect();
        let expected = ["MEMTRANSFER_HEADER", "OPENAI_API_KEY"].map(|name| (name.as_ref(), None));
        assert_eq!(removed, expected);
        assert!(Launch::command(Role::Policy, "python policy.py").unwrap().needs_keys);
    }
}
