//! The processes of a run: started, watched, and never left behind.
//!
//! Each is a sibling of the running program, or a command that somebody gave. It has a process group of its
//! own, so that Ctrl-C reaches the orchestrator alone and it decides what happens; when a process is over, its
//! whole group is killed, so nothing stays that it had started itself. They end with the orchestrator whatever
//! ends it: the system kills them when the thread that started them dies (see
//! `shm_types::process::die_with_parent`, which a program of somebody else's gets from the policy SDK). What
//! they print goes to a file each, whose last lines stand in the message when one fails.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use rustix::io::Errno;
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};
use shm_types::ATTACH_VARIABLE;
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
    /// The command line as somebody gave it, where the process is not one of the project's own.
    pub command: Option<String>,
    /// What its environment has beside this process's.
    pub env: Vec<(OsString, OsString)>,
}

impl Launch {
    /// The program `name` beside the running one, as `role`.
    ///
    /// # Errors
    /// When it is not there.
    pub fn sibling(role: Role, name: &str, args: Vec<OsString>) -> Result<Self> {
        let env = vec![(QUIET_DRIVER.0.into(), QUIET_DRIVER.1.into())];
        Ok(Self { role, program: sibling(name)?, args, command: None, env })
    }

    /// A command line as somebody gave it, split into words as a shell does, but run by none.
    ///
    /// # Errors
    /// When a quote is not closed, or there is no word.
    pub fn command(role: Role, command: &str) -> Result<Self> {
        let words = shlex::split(command).with_context(|| {
            format!("a quote is not closed, or a last \\ ends nothing: {command}")
        })?;
        let mut words = words.into_iter();
        let program = words.next().context("the command is empty")?.into();
        let args = words.map(OsString::from).collect();
        Ok(Self { role, program, args, command: Some(command.to_owned()), env: Vec::new() })
    }

    /// The same, told which run to join: one of the project's own by an argument, any other by its environment.
    pub fn attached_to(mut self, run: &Path) -> Self {
        match self.command {
            None => self.args.extend(["--attach".into(), run.into()]),
            Some(_) => self.env.push((ATTACH_VARIABLE.into(), run.into())),
        }
        self
    }

    /// Why it did not start, and what to do.
    fn not_started(&self, error: &io::Error) -> String {
        let Some(command) = &self.command else {
            return format!(
                "cannot start {}: build all programs with `cargo build --release --workspace`",
                self.program.display()
            );
        };
        let program = self.program.display();
        let advice = match error.kind() {
            io::ErrorKind::NotFound => format!(
                "there is no program `{program}`, neither in $PATH nor, if that is a path, as seen from the \
                 working folder"
            ),
            io::ErrorKind::PermissionDenied => format!(
                "`{program}` is not executable: start it with its interpreter, or `chmod +x` it"
            ),
            _ if error.raw_os_error() == Some(Errno::NOEXEC.raw_os_error()) => format!(
                "`{program}` is neither a program nor a script that names its interpreter in its first line"
            ),
            _ => format!("`{program}` does not start"),
        };
        format!("cannot start the {} command `{command}`: {advice}", self.role.word())
    }
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
    /// The command line that somebody gave for it.
    pub command: Option<String>,
}

impl Death {
    /// How it ended, and its last words.
    pub fn how(&self) -> String {
        match self.last_words.as_str() {
            "" => format!("{} without a word", self.manner()),
            words => format!("{}; its last words:\n{words}", self.manner()),
        }
    }

    fn manner(&self) -> String {
        match (self.status.code(), self.status.signal()) {
            (Some(code), _) => format!("with exit status {code}"),
            (None, Some(signal)) => format!("on signal {signal}"),
            (None, None) => "in an unknown way".to_owned(),
        }
    }
}

impl std::fmt::Display for Death {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "the {} process ", self.role.word())?;
        if let Some(command) = &self.command {
            write!(f, "(`{command}`) ")?;
        }
        write!(f, "ended {}", self.manner())?;
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
    command: Option<String>,
    child: Child,
    /// How it ended, once it was waited for. Its number may be somebody else's from then on.
    ended: Option<ExitStatus>,
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

    /// A process that is dead, if one is. The policy's death explains that of others, which send to it; none
    /// explains the policy's.
    pub fn death(&mut self) -> Option<Death> {
        let mut deaths: Vec<Death> = self.members.iter_mut().filter_map(Member::death).collect();
        let at = deaths.iter().position(|death| death.role == Role::Policy).unwrap_or(0);
        (!deaths.is_empty()).then(|| deaths.swap_remove(at))
    }

    /// Waits until all have ended by themselves, at most for `patience`, and kills the rest.
    pub fn disband(self, patience: Duration) {
        let deadline = Instant::now() + patience;
        while Instant::now() < deadline && self.members.iter().any(Member::is_alive) {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

impl Drop for Crew {
    fn drop(&mut self) {
        for member in self.members.iter_mut().filter(|member| member.ended.is_none()) {
            tracing::debug!(role = member.role.word(), "its group is killed");
            // Before it is waited for: until then, nobody else can have the group's number. There may be nobody
            // left in it.
            let _ = kill_process_group(member.group(), Signal::KILL);
            if let Err(error) = member.child.wait() {
                tracing::warn!(role = member.role.word(), %error, "cannot wait for the process");
            }
        }
    }
}

impl Member {
    fn start(launch: &Launch, logs: &Path) -> Result<Self> {
        let Launch { role, program, args, command, env } = launch;
        let log = logs.join(format!("{}.log", role.word()));
        let file = File::options().create(true).append(true).open(&log);
        let file = file.with_context(|| format!("cannot open {}", log.display()))?;
        let log_start = file.metadata().map_or(0, |facts| facts.len());
        let output = file.try_clone().with_context(|| format!("cannot open {}", log.display()))?;
        let child = Command::new(program)
            .args(args)
            .envs(env.iter().map(|(name, value)| (name, value)))
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(file)
            .process_group(0)
            .spawn();
        let child = child.map_err(|error| {
            let why = launch.not_started(&error);
            anyhow::Error::from(error).context(why)
        })?;
        Ok(Self { role: *role, command: command.clone(), child, ended: None, log, log_start })
    }

    /// Its process group: the one it leads.
    fn group(&self) -> Pid {
        Pid::from_child(&self.child)
    }

    /// Whether it runs. Does not wait for one that has ended: [`Member::group`] stays its own.
    fn is_alive(&self) -> bool {
        if self.ended.is_some() {
            return false;
        }
        let look = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        matches!(waitid(WaitId::Pid(self.group()), look), Ok(None))
    }

    fn death(&mut self) -> Option<Death> {
        if self.is_alive() {
            return None;
        }
        let status = match self.ended {
            Some(status) => status,
            None => {
                // What it had started is of no use without it.
                let _ = kill_process_group(self.group(), Signal::KILL);
                let status = self.child.wait().inspect_err(|error| {
                    tracing::warn!(role = self.role.word(), %error, "cannot ask for the process");
                });
                *self.ended.insert(status.ok()?)
            }
        };
        let last_words = last_words(&self.log, self.log_start, self.role).unwrap_or_default();
        let (log, command) = (self.log.clone(), self.command.clone());
        Some(Death { role: self.role, status, last_words, log, command })
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
