//! The process groups of this program's children.
//!
//! Each child has a group of its own. The kernel does not end a group with the program that started it, so a shell that leads
//! the group does ([`Watchdog`]); and [`kill_all`] ends the groups of a program that is about to end without calling its
//! destructors.

use std::io::{self, Read};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdout, Command, ExitStatus, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

/// Time between two looks whether a command has ended or is to be stopped.
const TIME_BETWEEN_LOOKS: Duration = Duration::from_millis(10);

/// Waits until this program closes the pipe or ends, then kills its own group. A member may send the group other signals.
const WATCHDOG: &str = "trap '' HUP INT QUIT TERM USR1 USR2; read -r _; kill -s KILL 0";

/// The groups that were started and not waited for, and their children. No other group or process can have their ids.
static GROUPS: Mutex<Vec<(Pid, Pid)>> = Mutex::new(Vec::new());

fn groups() -> MutexGuard<'static, Vec<(Pid, Pid)>> {
    GROUPS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A child that has a process group of its own.
#[derive(Debug)]
pub struct Group {
    child: Child,
    watchdog: Option<Watchdog>,
    /// Its status, once it was waited for. From then on its process id may be another process's.
    status: Option<ExitStatus>,
}

impl Group {
    /// Starts `command`.
    ///
    /// # Errors
    /// When the system refuses.
    pub(crate) fn start(command: &mut Command) -> io::Result<Self> {
        Self::start_in(command, None)
    }

    /// Starts `command`. The group is also killed when this program ends in any way, `kill -9` included.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn start_watched(command: &mut Command) -> io::Result<Self> {
        let watchdog = Watchdog::start()?;
        Self::start_in(command, Some(watchdog))
    }

    fn start_in(command: &mut Command, watchdog: Option<Watchdog>) -> io::Result<Self> {
        let mut groups = groups();
        // The child is in the watchdog's group from its first instruction on.
        let leader = watchdog.as_ref().map_or(0, |watchdog| watchdog.id().as_raw_pid());
        let child = command.process_group(leader).spawn()?;
        let group = Self { child, watchdog, status: None };
        groups.push((group.id(), Pid::from_child(&group.child)));
        Ok(group)
    }

    /// Its id: the process id of its leader.
    fn id(&self) -> Pid {
        self.watchdog.as_ref().map_or_else(|| Pid::from_child(&self.child), Watchdog::id)
    }

    /// The child's output, if it is piped and was not taken before.
    pub fn take_stdout(&mut self) -> Option<ChildStdout> {
        self.child.stdout.take()
    }

    /// Whether the child runs. Does not reap it, so that its process id stays its own.
    pub fn is_alive(&self) -> bool {
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        let child = WaitId::Pid(Pid::from_child(&self.child));
        self.status.is_none() && matches!(waitid(child, options), Ok(None))
    }

    /// Kills what still runs of it, and waits for the child. Later calls return the same status.
    ///
    /// # Errors
    /// When the system cannot wait for it.
    pub fn end(&mut self) -> io::Result<ExitStatus> {
        if let Some(status) = self.status {
            return Ok(status);
        }
        let mut groups = groups();
        let id = self.id();
        // Before the wait: until then no other group can have this id. The group may be empty.
        let _ = kill_process_group(id, Signal::KILL);
        let status = self.child.wait()?;
        self.watchdog = None;
        groups.retain(|&(group, _)| group != id);
        Ok(*self.status.insert(status))
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        if let Err(error) = self.end() {
            tracing::warn!(%error, "cannot wait for a process");
        }
    }
}

/// A shell that leads a process group and kills it when this program ends. Dropping it ends the shell.
#[derive(Debug)]
struct Watchdog(Child);

impl Watchdog {
    fn start() -> io::Result<Self> {
        Command::new("/bin/sh")
            .args(["-c", WATCHDOG])
            .env_clear()
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .process_group(0)
            .spawn()
            .map(Self)
    }

    fn id(&self) -> Pid {
        Pid::from_child(&self.0)
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        let ended = self.0.kill().and_then(|()| self.0.wait());
        if let Err(error) = ended {
            tracing::warn!(%error, "cannot end the shell that watches a process group");
        }
    }
}

/// Kills all children and what they have started, and waits until they have ended. No further one can be started: call this when
/// the program is about to end.
pub fn kill_all() {
    let groups = groups();
    for &(group, _) in groups.iter() {
        let _ = kill_process_group(group, Signal::KILL);
    }
    for &(_, child) in groups.iter() {
        let _ = waitid(WaitId::Pid(child), WaitIdOptions::EXITED | WaitIdOptions::NOWAIT);
    }
    std::mem::forget(groups);
}

/// Runs `command` and returns what it has printed. `None` if it was killed because `stop` was set. It does not outlive this
/// program.
///
/// # Errors
/// When it cannot be started, or what it prints cannot be read.
pub fn output(command: &mut Command, stop: &AtomicBool) -> io::Result<Option<Output>> {
    output_until(command.stdin(Stdio::null()), || stop.load(Ordering::Relaxed))
}

/// As [`output`], with the stdin that `command` has. `None` if it was killed because `is_over` became true.
///
/// # Errors
/// As [`output`].
pub fn output_until(
    command: &mut Command,
    is_over: impl Fn() -> bool,
) -> io::Result<Option<Output>> {
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut group = Group::start_watched(command)?;
    let (stdout, stderr) = (group.child.stdout.take(), group.child.stderr.take());
    thread::scope(|scope| {
        let read = |pipe: Option<Box<dyn Read + Send>>| {
            thread::Builder::new().spawn_scoped(scope, move || {
                let mut bytes = Vec::new();
                pipe.map_or(Ok(0), |mut pipe| pipe.read_to_end(&mut bytes)).map(|_| bytes)
            })
        };
        let stdout = read(stdout.map(|pipe| Box::new(pipe) as _))?;
        let stderr = match read(stderr.map(|pipe| Box::new(pipe) as _)) {
            Ok(thread) => thread,
            Err(error) => {
                // Otherwise the scope would wait for the other thread, and that for the process.
                group.end()?;
                return Err(error);
            }
        };
        while group.is_alive() && !is_over() {
            thread::sleep(TIME_BETWEEN_LOOKS);
        }
        let is_stopped = group.is_alive();
        let status = group.end()?;
        let text = |thread: thread::ScopedJoinHandle<'_, io::Result<Vec<u8>>>| {
            thread.join().map_err(|_| io::Error::other("a thread that reads a pipe panicked"))?
        };
        let (stdout, stderr) = (text(stdout)?, text(stderr)?);
        Ok((!is_stopped).then_some(Output { status, stdout, stderr }))
    })
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use rustix::process::getpgid;

    use super::*;

    /// Waits for what others do in their own time.
    fn wait_until(is_true: impl Fn() -> bool) {
        while !is_true() {
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// Whether the process runs: a zombie has ended.
    fn runs(pid: &str) -> bool {
        let stat = fs::read_to_string(Path::new("/proc").join(pid).join("stat"));
        stat.is_ok_and(|stat| !stat.contains(") Z "))
    }

    /// A shell that starts another process, whose id it writes into the file, and waits for it.
    fn with_child(file: &Path) -> Command {
        let mut command = Command::new("sh");
        let script =
            format!("sleep 3600 & echo $! > {0}.new; mv {0}.new {0}; wait", file.display());
        command.args(["-c", &script]);
        command
    }

    #[test]
    fn a_command_is_stopped_with_what_it_started() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("pid");
        let stop = AtomicBool::new(false);
        let found = thread::scope(|scope| {
            let command = scope.spawn(|| output(&mut with_child(&file), &stop));
            wait_until(|| file.exists());
            stop.store(true, Ordering::Relaxed);
            command.join().unwrap()
        });
        assert!(found.unwrap().is_none());
        let pid = fs::read_to_string(&file).unwrap();
        wait_until(|| !runs(pid.trim()));
        let both = ["-c", "echo out; echo err >&2; exit 3"];
        let ended = output(Command::new("sh").args(both), &AtomicBool::new(false));
        let ended = ended.unwrap().unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        assert_eq!((text(&ended.stdout), text(&ended.stderr)), ("out\n".into(), "err\n".into()));
        assert_eq!(ended.status.code(), Some(3));
    }

    /// The pipe is closed as by the end of this program.
    #[test]
    fn a_group_ends_with_the_program_that_started_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("pid");
        let mut group = Group::start_watched(&mut with_child(&file)).unwrap();
        wait_until(|| file.exists());
        assert!(group.is_alive());
        assert_eq!(getpgid(Some(Pid::from_child(&group.child))).unwrap(), group.id());
        drop(group.watchdog.as_mut().unwrap().0.stdin.take());
        let pid = fs::read_to_string(&file).unwrap();
        wait_until(|| !group.is_alive() && !runs(pid.trim()));
        assert_eq!(group.end().unwrap().code(), None);
    }
}
