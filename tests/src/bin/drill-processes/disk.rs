//! Full, read-only and foreign disks, in a mount namespace of its own: the run folder, the cache, and shared memory.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use memtransfer_tests::Ended;

use crate::Extent;
use crate::harness::{Run, Sandbox, Trial, execute};
use crate::report::Report;

pub(crate) const TEXT: &str = "The run folder, the cache and shared memory lie in small file systems (tmpfs, 1 to 64 MiB) in a mount namespace of \
     their own, which are filled to a few KiB before or during a run. A run that cannot go on must say what is full, and the \
     same command after making room must end with the log of an undisturbed run. The same holds for read-only folders, \
     folders of other users, symbolic links and folders where a file is expected, and a limit on memory.";

/// Set in the process that is in the namespace.
const INSIDE: &str = "DRILL_NAMESPACE";

/// KiB that a full file system has left.
const LEFT: [u64; 6] = [0, 4, 12, 24, 40, 64];

/// How often to ask for all of the space that is left.
const ATTEMPTS_TO_FILL: u32 = 1000;

/// The name of the file that fills a file system.
const BALLAST: &str = "ballast";

pub(crate) fn drill(extent: &Extent, report: &mut Report) -> Result<(), String> {
    if std::env::var_os(INSIDE).is_some() {
        let sandbox = Sandbox::one()?;
        let trials = trials(extent, report, &sandbox)?;
        execute(extent, report, vec![sandbox], u64::MAX, trials.into_iter());
        return Ok(());
    }
    let unshare = |program: &Path, args: &[String]| {
        let mut command = Command::new("unshare");
        command.args(["--mount", "--propagation", "private"]);
        if !rustix::process::getuid().is_root() {
            command.args(["--user", "--map-root-user"]);
        }
        command.arg(program).args(args).env(INSIDE, "yes");
        command
    };
    let mut probe = unshare(
        Path::new("/bin/sh"),
        &["-c".to_owned(), "mount -t tmpfs -o size=1m tmpfs /mnt".to_owned()],
    );
    let probe = probe.output();
    if !probe.as_ref().is_ok_and(|output| output.status.success()) {
        let why = match probe {
            Ok(output) => String::from_utf8_lossy(&output.stderr).trim().to_owned(),
            Err(error) => error.to_string(),
        };
        report.skip(&format!("full disks, as a mount namespace is not to be had ({why})"));
        return Ok(());
    }
    let here = std::env::current_exe().map_err(|error| error.to_string())?;
    let args: Vec<String> = std::env::args().skip(1).collect();
    let status = unshare(&here, &args).status().map_err(|error| error.to_string())?;
    // It has written its report.
    std::process::exit(status.code().unwrap_or(2))
}

/// The trials in a mount namespace of their own.
fn trials(extent: &Extent, report: &mut Report, sandbox: &Sandbox) -> Result<Vec<Trial>, String> {
    let small = sandbox.folder().join("small");
    fs::create_dir(&small).map_err(|error| error.to_string())?;
    let mut trials = Vec::new();
    let mut add = |class: &str, name: String, disturb: Disturb| {
        let disturb = move |sandbox: &mut Sandbox| disturb(sandbox).map(|()| true);
        trials.push(Trial::new(name, class, disturb));
    };
    let left: &[u64] = if extent.is_quick { &LEFT[2..3] } else { &LEFT };
    for &kib in left {
        let folder = small.clone();
        let disturb = move |sandbox: &mut Sandbox| full_run_folder(sandbox, &folder, kib);
        add("run folder full", format!("a run folder with {kib} KiB left"), Box::new(disturb));
        let disturb = move |sandbox: &mut Sandbox| full_cache(sandbox, kib);
        add("cache full", format!("a cache with {kib} KiB left"), Box::new(disturb));
    }
    let shared: &[u64] = if extent.is_quick { &[8] } else { &[1, 8, 24] };
    for &mib in shared {
        let disturb = move |sandbox: &mut Sandbox| small_shared_memory(sandbox, mib);
        let name = format!("{mib} MiB of shared memory");
        add("shared memory too small", name, Box::new(disturb));
    }
    let moments: &[u64] = if extent.is_quick { &[] } else { &[100, 250, 400, 600, 800] };
    for ms in [None].into_iter().chain(moments.iter().copied().map(Some)) {
        let moment = ms.map(Duration::from_millis);
        let disturb = move |sandbox: &mut Sandbox| shared_memory_fills(sandbox, moment);
        let after = ms
            .map_or("the first episode, and the policy killed".to_owned(), |ms| format!("{ms} ms"));
        let name = format!("shared memory full after {after}");
        add("shared memory fills up", name, Box::new(disturb));
    }
    let disturb = move |sandbox: &mut Sandbox| read_only(sandbox, &small);
    add("read-only folder", "a read-only folder".to_owned(), Box::new(disturb));
    let files: &[&'static str] = match extent.is_quick {
        true => &["episodes.jsonl"],
        false => &["manifest.json", "episodes.jsonl", "timings.jsonl", "sessions.jsonl", "logs"],
    };
    for &name in files {
        for (class, is_link) in
            [("a folder or a file of the wrong kind", false), ("symbolic link", true)]
        {
            let disturb = move |sandbox: &mut Sandbox| wrong_kind(sandbox, name, is_link);
            add(class, format!("{class} at {name}"), Box::new(disturb));
        }
    }
    let is_root = rustix::process::getuid().is_root();
    let setpriv = Command::new("setpriv").arg("--version").output();
    if is_root && setpriv.is_ok_and(|output| output.status.success()) {
        add("files of another user", "a run as another user".to_owned(), Box::new(as_nobody));
    } else {
        report.skip("files of other users, which needs root and setpriv");
    }
    if extent.is_quick {
        return Ok(trials);
    }
    match MemoryGroup::create() {
        None => report.skip("kills for want of memory, which needs a memory cgroup"),
        Some(group) => {
            let group = Arc::new(group);
            for mib in [60, 120, 180] {
                let group = group.clone();
                let disturb = move |sandbox: &mut Sandbox| with_little_memory(sandbox, &group, mib);
                add("little memory", format!("{mib} MiB of memory"), Box::new(disturb));
            }
        }
    }
    Ok(trials)
}

/// Disturbs a run, and checks that it recovers.
type Disturb = Box<dyn FnOnce(&mut Sandbox) -> Result<(), String> + Send>;

/// Does `disturb` while a file system of this size is mounted on `folder`.
fn mounted(
    folder: &Path,
    options: &str,
    disturb: impl FnOnce() -> Result<(), String>,
) -> Result<(), String> {
    command(Command::new("mount").args(["-t", "tmpfs", "-o", options, "tmpfs"]).arg(folder))?;
    let outcome = disturb();
    command(Command::new("umount").arg("--lazy").arg(folder))?;
    outcome
}

fn command(command: &mut Command) -> Result<(), String> {
    let output = command.output().map_err(|error| format!("{command:?}: {error}"))?;
    match output.status.success() {
        true => Ok(()),
        false => Err(format!("{command:?}: {}", String::from_utf8_lossy(&output.stderr))),
    }
}

/// Fills the file system of `folder` up to `kib` KiB, also while others write to it.
fn fill(folder: &Path, kib: u64) -> Result<(), String> {
    let failed = |error: std::io::Error| format!("cannot fill {}: {error}", folder.display());
    let file = fs::File::create(folder.join(BALLAST)).map_err(failed)?;
    let mut filled = 0;
    for _ in 0..ATTEMPTS_TO_FILL {
        let space = rustix::fs::statvfs(folder).map_err(|error| failed(error.into()))?;
        let bytes = (space.f_bavail * space.f_frsize).saturating_sub(kib << 10);
        if bytes == 0 {
            break;
        }
        match rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), filled, bytes) {
            Ok(()) => filled += bytes,
            // Another process was faster.
            Err(rustix::io::Errno::NOSPC) => {}
            Err(error) => return Err(failed(error.into())),
        }
    }
    Ok(())
}

fn make_room(folder: &Path) -> Result<(), String> {
    fs::remove_file(folder.join(BALLAST)).map_err(|error| error.to_string())
}

fn start(sandbox: &Sandbox, run: &Run) -> Result<Ended, String> {
    Ok(Ended::of(sandbox.start(run, &[])?))
}

/// The command failed with a message that has one of `said`.
fn expect_error(ended: &Ended, said: &[&str]) -> Result<(), String> {
    let is_error = matches!(ended.status, Some(1 | 2));
    if is_error && said.iter().any(|said| ended.stderr.contains(said)) {
        return Ok(());
    }
    let (status, stderr) = (ended.status, &ended.stderr);
    Err(format!("ended with {status:?} where an error with one of {said:?} was due: {stderr}"))
}

/// The system's words for a full disk.
const FULL: [&str; 2] = ["No space left on device", "os error 28"];

fn full_run_folder(sandbox: &Sandbox, small: &Path, kib: u64) -> Result<(), String> {
    let run = Sandbox::run_in(small.join("run"));
    mounted(small, "size=2m", || full(sandbox, &run, small, kib))
}

/// Executes a run while the file system of `folder` is full.
fn full(sandbox: &Sandbox, run: &Run, folder: &Path, kib: u64) -> Result<(), String> {
    fill(folder, kib)?;
    let ended = start(sandbox, run)?;
    if ended.status != Some(0) {
        expect_error(&ended, &FULL)?;
    }
    make_room(folder)?;
    sandbox.check_recovery(run, &ended, false)
}

/// A full cache costs time, but no result.
fn full_cache(sandbox: &mut Sandbox, kib: u64) -> Result<(), String> {
    let embeddings = sandbox.cache().join("embeddings");
    fs::create_dir_all(&embeddings).map_err(|error| error.to_string())?;
    let run = sandbox.run();
    mounted(&embeddings, "size=1m", || full(sandbox, &run, &embeddings, kib))
}

fn small_shared_memory(sandbox: &mut Sandbox, mib: u64) -> Result<(), String> {
    mounted(Path::new("/dev/shm"), &format!("size={mib}m"), || {
        let run = sandbox.run();
        let ended = start(sandbox, &run)?;
        if ended.status != Some(0) {
            expect_error(&ended, &["enlarge it", "make it larger"])?;
        }
        command(Command::new("mount").args(["-o", "remount,size=4g", "/dev/shm"]))?;
        sandbox.check_recovery(&run, &ended, false)
    })
}

/// Another program takes all of shared memory while a run uses it: processes end on SIGBUS. Without a `moment`, after the
/// first episode; then the policy is killed, so that the orchestrator has to see it before it starts the processes again.
fn shared_memory_fills(sandbox: &mut Sandbox, moment: Option<Duration>) -> Result<(), String> {
    let shared = Path::new("/dev/shm");
    mounted(shared, "size=256m", || {
        let run = sandbox.run();
        let child = sandbox.start(&run, &[])?;
        match moment {
            Some(moment) => std::thread::sleep(moment),
            None => wait_for_an_episode(&run)?,
        }
        let filled = fill(shared, 0);
        if moment.is_none() {
            sandbox.kill_program("policy-proc");
        }
        let ended = Ended::of(child);
        filled?;
        if ended.status != Some(0) {
            expect_error(&ended, &["/dev/shm", "shared memory"])?;
        }
        make_room(shared)?;
        sandbox.check_recovery(&run, &ended, false)
    })
}

fn wait_for_an_episode(run: &Run) -> Result<(), String> {
    let deadline = Instant::now() + memtransfer_tests::WATCHDOG;
    while memtransfer_tests::episodes(&run.out).is_empty() {
        if Instant::now() > deadline {
            return Err("the run finishes no episode".to_owned());
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    Ok(())
}

fn read_only(sandbox: &Sandbox, small: &Path) -> Result<(), String> {
    mounted(small, "size=2m", || {
        command(Command::new("mount").args(["-o", "remount,ro"]).arg(small))?;
        let run = Sandbox::run_in(small.join("run"));
        let ended = start(sandbox, &run)?;
        expect_error(&ended, &["Read-only file system"])?;
        command(Command::new("mount").args(["-o", "remount,rw"]).arg(small))?;
        sandbox.check_recovery(&run, &ended, false)
    })
}

/// A finished run in whose folder another file is put in the place of `name`: a link to a file elsewhere, or a folder where
/// a file is expected, or a file where a folder is. The file elsewhere is not changed, and the run is as it was once its own
/// file is back.
fn wrong_kind(sandbox: &mut Sandbox, name: &str, is_link: bool) -> Result<(), String> {
    let failed = |error: std::io::Error| error.to_string();
    let run = sandbox.run();
    let first = start(sandbox, &run)?;
    if first.status != Some(0) {
        return Err(format!("an undisturbed run fails: {}", first.stderr));
    }
    let (place, elsewhere) = (run.out.join(name), sandbox.folder().join("elsewhere"));
    let own = sandbox.folder().join("own");
    fs::rename(&place, &own).map_err(failed)?;
    fs::write(&elsewhere, "mine\n").map_err(failed)?;
    match (is_link, name) {
        (true, _) => symlink(&elsewhere, &place).map_err(failed)?,
        (false, "logs") => fs::write(&place, "mine\n").map_err(failed)?,
        (false, _) => fs::create_dir(&place).map_err(failed)?,
    }
    let ended = start(sandbox, &run)?;
    let text = fs::read_to_string(&elsewhere).map_err(failed)?;
    if text != "mine\n" {
        return Err(format!("the file elsewhere now has {text:?}; status {:?}", ended.status));
    }
    if ended.status != Some(0) {
        expect_error(&ended, &[name])?;
    }
    let kind = fs::symlink_metadata(&place).map_err(failed)?;
    match kind.is_dir() {
        true => fs::remove_dir_all(&place).map_err(failed)?,
        false => fs::remove_file(&place).map_err(failed)?,
    }
    fs::rename(&own, &place).map_err(failed)?;
    sandbox.check_recovery(&run, &ended, false)
}

/// The run folder, the cache and the folder of live runs belong to another user.
fn as_nobody(sandbox: &mut Sandbox) -> Result<(), String> {
    let run = sandbox.run();
    let command = sandbox.command(&run.args);
    let mut other = Command::new("setpriv");
    other.args(["--reuid=65534", "--regid=65534", "--clear-groups"]);
    other.arg(command.get_program()).args(command.get_args());
    sandbox.in_sandbox(&mut other);
    let child = other.spawn().map_err(|error| error.to_string())?;
    let ended = Ended::of(child);
    expect_error(&ended, &["Permission denied", "other users may write to", "belongs to user"])?;
    sandbox.check_recovery(&run, &ended, false)
}

/// A memory cgroup of the drill's own.
struct MemoryGroup {
    folder: PathBuf,
    /// The file with the limit, in bytes.
    limit: PathBuf,
}

impl MemoryGroup {
    /// `None` where groups cannot be made.
    fn create() -> Option<Self> {
        let groups = Path::new("/sys/fs/cgroup");
        // Groups of the first kind have a hierarchy for each resource.
        let (groups, limit) = match groups.join("memory").is_dir() {
            true => (groups.join("memory"), "memory.limit_in_bytes"),
            false => (groups.to_owned(), "memory.max"),
        };
        let folder = groups.join(format!("memtransfer-drill-{}", std::process::id()));
        fs::create_dir(&folder).ok()?;
        let group = Self { limit: folder.join(limit), folder };
        fs::write(&group.limit, "2000000000").ok()?;
        Some(group)
    }
}

impl Drop for MemoryGroup {
    fn drop(&mut self) {
        let deadline = Instant::now() + Duration::from_secs(60);
        while fs::remove_dir(&self.folder).is_err() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// The kernel kills a process of the run when the memory of their group is used up.
fn with_little_memory(sandbox: &mut Sandbox, group: &MemoryGroup, mib: u64) -> Result<(), String> {
    let run = sandbox.run();
    fs::write(&group.limit, (mib << 20).to_string()).map_err(|error| error.to_string())?;
    let command = sandbox.command(&run.args);
    let mut shell = Command::new("/bin/sh");
    shell.args(["-c", "echo $$ > \"$GROUP\" && exec \"$@\"", "sh"]);
    shell.arg(command.get_program()).args(command.get_args());
    sandbox.in_sandbox(&mut shell);
    shell.env("GROUP", group.folder.join("cgroup.procs"));
    let ended = Ended::of(shell.spawn().map_err(|error| error.to_string())?);
    // The orchestrator itself may be the one that the kernel kills.
    let was_killed = ended.status.is_none();
    if ended.status != Some(0) && !was_killed {
        expect_error(&ended, &["signal 9", "memory"])?;
    }
    sandbox.check_recovery(&run, &ended, was_killed)
}
