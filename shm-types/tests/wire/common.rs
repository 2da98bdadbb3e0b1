//! A run of its own for each test, and a watchdog for what could hang.

use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::Duration;

use shm_types::message::Role;
use shm_types::{Attach, Bus, FrameSize, RunDir};
use tempfile::TempDir;

/// Longer than any step of a test takes; a wait that lasts this long hangs.
pub(crate) const LONG: Duration = Duration::from_secs(60);

/// A run in a folder of its own. Fields are dropped in order: the run before its folder.
pub(crate) struct Run {
    pub(crate) attach: Attach,
    pub(crate) dir: RunDir,
    pub(crate) base: TempDir,
    _watchdog: Sender<()>,
}

/// A run with small frames.
pub(crate) fn run() -> Run {
    let base = tempfile::Builder::new().prefix("mt").tempdir_in("/dev/shm").unwrap();
    let dir = RunDir::create(base.path()).unwrap();
    let attach = attach(&dir);
    Run { attach, dir, base, _watchdog: watchdog() }
}

/// Four lanes, 32 small frames.
pub(crate) fn attach(dir: &RunDir) -> Attach {
    let frame = FrameSize { width: 64, height: 64 };
    Attach { frame, frame_capacity: 32, lanes: 4, ..dir.attach() }
}

/// Joins the run of `attach`.
pub(crate) fn bus(attach: &Attach, role: Role) -> Bus {
    Bus::join(attach.clone(), role).unwrap()
}

/// Ends the process if the returned sender is not dropped in time.
fn watchdog() -> Sender<()> {
    let (alive, watched): (_, Receiver<()>) = channel();
    let test = thread::current().name().unwrap_or("a test").to_owned();
    thread::spawn(move || {
        if watched.recv_timeout(2 * LONG) == Err(RecvTimeoutError::Timeout) {
            eprintln!("{test} hangs");
            std::process::abort();
        }
    });
    alive
}

/// Bytes of shared memory that files starting with `prefix` really use, and how many files there are.
pub(crate) fn shared_memory(prefix: &str) -> (u64, usize) {
    let files = std::fs::read_dir("/dev/shm").unwrap().filter_map(Result::ok);
    let ours = files.filter(|file| file.file_name().to_string_lossy().starts_with(prefix));
    ours.fold((0, 0), |(bytes, files), file| (bytes + used(&file.path()), files + 1))
}

fn used(path: &Path) -> u64 {
    use std::os::unix::fs::MetadataExt;
    path.metadata().map_or(0, |about| about.blocks() * 512)
}
