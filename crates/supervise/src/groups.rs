//! The process groups of this program's children.
//!
//! Each child leads a group of its own. The kernel does not end a group with the program that started it, so a shell does
//! ([`Watchdog`]); and [`kill_all`] ends the groups of a program that is about to end without calling its destructors.

use std::collections::BTreeSet;
use std::io::{self, Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

/// Time between two looks whether a command has ended or is to be stopped.
const TIME_BETWEEN_LOOKS: Duration = Duration::from_millis(10);

/// Reads the leader of a group, then waits until this program closes the pipe or ends.
const WATCHDOG: &str = r#"read -r group && { read -r _; kill -s KILL -- "-$group"; }"#;

/// The leaders of the groups that were started and not waited for. No other process can have their ids.
static LEADERS: Mutex<BTreeSet<i32>> = Mutex::new(BTreeSet::new());

fn leaders() -> MutexGuard<'static, BTreeSet<i32>> {
    LEADERS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A child that leads a process group.
#[derive(Debug)]
pub(crate) struct Group {
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
        let mut leaders = leaders();
        let child = command.process_group(0).spawn()?;
        leaders.insert(Pid::from_child(&child).as_raw_pid());
        Ok(Self { child, watchdog: None, status: None })
    }

    /// As [`Self::start`]; the group is also killed when this program ends in any way, `kill -9` included.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub(crate) fn start_watched(command: &mut Command) -> io::Result<Self> {
        // First, so that there is no time without one.
        let mut watchdog = Watchdog::start()?;
        let mut group = Self::start(command)?;
        watchdog.watch(group.id())?;
        group.watchdog = Some(watchdog);
        Ok(group)
    }

    fn id(&self) -> Pid {
        Pid::from_child(&self.child)
    }

    /// Whether its leader runs. Does not reap it, so that its process id stays its own.
    pub(crate) fn is_alive(&self) -> bool {
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        self.status.is_none() && matches!(waitid(WaitId::Pid(self.id()), options), Ok(None))
    }

    /// Kills what still runs of it, and waits for its leader. Later calls return the same status.
    ///
    /// # Errors
    /// When the system cannot wait for it.
    pub(crate) fn end(&mut self) -> io::Result<ExitStatus> {
        if let Some(status) = self.status {
            return Ok(status);
        }
        let mut leaders = leaders();
        // Before the wait: until then no other group can have this id. The group may be empty.
        let _ = kill_process_group(self.id(), Signal::KILL);
        self.watchdog = None;
        let status = self.child.wait()?;
        leaders.remove(&self.id().as_raw_pid());
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

/// A shell that kills a process group when this program ends. Dropping it ends the shell.
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

    fn watch(&mut self, group: Pid) -> io::Result<()> {
        let pipe = self.0.stdin.as_mut().ok_or(io::ErrorKind::BrokenPipe)?;
        pipe.write_all(format!("{}\n", group.as_raw_pid()).as_bytes())
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
    let leaders = leaders();
    let pids: Vec<Pid> = leaders.iter().filter_map(|&pid| Pid::from_raw(pid)).collect();
    for &pid in &pids {
        let _ = kill_process_group(pid, Signal::KILL);
    }
    for &pid in &pids {
        let _ = waitid(WaitId::Pid(pid), WaitIdOptions::EXITED | WaitIdOptions::NOWAIT);
    }
    std::mem::forget(leaders);
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
        drop(group.watchdog.as_mut().unwrap().0.stdin.take());
        let pid = fs::read_to_string(&file).unwrap();
        wait_until(|| !group.is_alive() && !runs(pid.trim()));
        assert_eq!(group.end().unwrap().code(), None);
    }
}
