//! Full, read-only and foreign disks, in a mount namespace of its own: the run folder, the cache, and shared memory.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use memtransfer_tests::Ended;

use crate::Extent;
use crate::report::Report;
use crate::runs::{Run, Sandbox};

const TITLE: &str = "Full disks, and files that are not what they should be";
const TEXT: &str = "The run folder, the cache and shared memory lie in small file systems (tmpfs, 1 to 64 MiB) in a mount namespace of \
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

pub(crate) fn drill(extent: &Extent) -> Result<Report, String> {
    if std::env::var_os(INSIDE).is_some() {
        return inside(extent);
    }
    let mut report = Report::new(TITLE, TEXT);
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
        return Ok(report);
    }
    let here = std::env::current_exe().map_err(|error| error.to_string())?;
    let args: Vec<String> = std::env::args().skip(1).collect();
    let status = unshare(&here, &args).status().map_err(|error| error.to_string())?;
    // It has written its report.
    std::process::exit(status.code().unwrap_or(2))
}

fn inside(extent: &Extent) -> Result<Report, String> {
    let mut report = Report::new(TITLE, TEXT);
    let mut sandbox = Sandbox::one()?;
    let small = sandbox.folder().join("small");
    fs::create_dir(&small).map_err(|error| error.to_string())?;
    let left: &[u64] = if extent.is_quick { &LEFT[2..3] } else { &LEFT };
    for &kib in left {
        if extent.is_over(&report) {
            return Ok(report);
        }
        let outcome = full_run_folder(&sandbox, &small, kib);
        let what = format!("a run folder with {kib} KiB left");
        conclude(&mut report, "run folder full", &what, outcome);
    }
    for &kib in left {
        if extent.is_over(&report) {
            return Ok(report);
        }
        let outcome = full_cache(&mut sandbox, kib);
        conclude(&mut report, "cache full", &format!("a cache with {kib} KiB left"), outcome);
    }
    let shared: &[u64] = if extent.is_quick { &[8] } else { &[1, 8, 24] };
    for mib in shared {
        let outcome = small_shared_memory(&mut sandbox, &format!("{mib}m"));
        let what = format!("{mib} MiB of shared memory");
        conclude(&mut report, "shared memory too small", &what, outcome);
    }
    let times = [100, 250, 400, 600, 800].map(|ms| Some(Duration::from_millis(ms)));
    let moments: &[Option<Duration>] = if extent.is_quick { &[] } else { &times };
    for &moment in [None].iter().chain(moments) {
        if extent.is_over(&report) {
            return Ok(report);
        }
        let outcome = shared_memory_fills(&mut sandbox, moment);
        let what = moment.map_or("the first episode, and the policy killed".to_owned(), |moment| {
            format!("{} ms", moment.as_millis())
        });
        let what = format!("shared memory full after {what}");
        conclude(&mut report, "shared memory fills up", &what, outcome);
    }
    let outcome = read_only(&sandbox, &small);
    conclude(&mut report, "read-only folder", "a read-only folder", outcome);
    for name in ["manifest.json", "episodes.jsonl", "timings.jsonl", "sessions.jsonl", "logs"] {
        for (class, is_link) in
            [("a folder or a file of the wrong kind", false), ("symbolic link", true)]
        {
            if extent.is_quick && name != "episodes.jsonl" {
                continue;
            }
            let outcome = wrong_kind(&mut sandbox, name, is_link);
            conclude(&mut report, class, &format!("{class} at {name}"), outcome);
        }
    }
    other_user(&mut report, &mut sandbox);
    if !extent.is_quick {
        out_of_memory(&mut report, &mut sandbox);
    }
    Ok(report)
}

fn conclude(report: &mut Report, class: &str, what: &str, outcome: Result<(), String>) {
    report.fault(class);
    report.add("cells", 1.0);
    report.outcome(what, outcome);
}

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
    let run = sandbox.run_in(small.join("run"));
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

fn small_shared_memory(sandbox: &mut Sandbox, size: &str) -> Result<(), String> {
    mounted(Path::new("/dev/shm"), &format!("size={size}"), || {
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
        let run = sandbox.run_in(small.join("run"));
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
fn other_user(report: &mut Report, sandbox: &mut Sandbox) {
    let is_root = rustix::process::getuid().is_root();
    let setpriv = Command::new("setpriv").arg("--version").output();
    if !is_root || !setpriv.is_ok_and(|output| output.status.success()) {
        report.skip("files of other users, which needs root and setpriv");
        return;
    }
    let outcome = as_nobody(sandbox);
    conclude(report, "files of another user", "a run as another user", outcome);
}

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

/// The kernel kills a process of the run when the memory of their group is used up.
fn out_of_memory(report: &mut Report, sandbox: &mut Sandbox) {
    let groups = Path::new("/sys/fs/cgroup");
    // Groups of the first kind have a hierarchy for each resource.
    let (groups, limit) = match groups.join("memory").is_dir() {
        true => (groups.join("memory"), "memory.limit_in_bytes"),
        false => (groups.to_owned(), "memory.max"),
    };
    let group = groups.join(format!("memtransfer-drill-{}", std::process::id()));
    let made = fs::create_dir(&group);
    let limit = group.join(limit);
    let is_there = made.is_ok() && fs::write(&limit, "2000000000").is_ok();
    if !is_there {
        let _ = fs::remove_dir(&group);
        report.skip("kills for want of memory, which needs a memory cgroup");
        return;
    }
    for mib in [60u64, 120, 180] {
        let outcome = with_little_memory(sandbox, &group, &limit, mib);
        conclude(report, "little memory", &format!("{mib} MiB of memory"), outcome);
    }
    let deadline = Instant::now() + Duration::from_secs(60);
    while fs::remove_dir(&group).is_err() && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn with_little_memory(
    sandbox: &mut Sandbox,
    group: &Path,
    limit: &Path,
    mib: u64,
) -> Result<(), String> {
    let run = sandbox.run();
    fs::write(limit, (mib << 20).to_string()).map_err(|error| error.to_string())?;
    let command = sandbox.command(&run.args);
    let mut shell = Command::new("/bin/sh");
    shell.args(["-c", "echo $$ > \"$GROUP\" && exec \"$@\"", "sh"]);
    shell.arg(command.get_program()).args(command.get_args());
    sandbox.in_sandbox(&mut shell);
    shell.env("GROUP", PathBuf::from(group).join("cgroup.procs"));
    let ended = Ended::of(shell.spawn().map_err(|error| error.to_string())?);
    // The orchestrator itself may be the one that the kernel kills.
    let was_killed = ended.status.is_none();
    if ended.status != Some(0) && !was_killed {
        expect_error(&ended, &["signal 9", "memory"])?;
    }
    sandbox.check_recovery(&run, &ended, was_killed)
}
