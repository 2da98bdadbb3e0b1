//! The runs of this user, one folder each, and how to tell a live run from the remains of a dead one.
//!
//! A run's folder holds `attach.json`, iceoryx2's files and sockets, and a file `lock`. Every process of the run
//! keeps a shared lock on that file, which the kernel releases when the process ends in any way. A process that can
//! lock the file exclusively knows that the run is dead, and may remove the run's shared memory (all names with its
//! prefix) and its folder. Processes in other languages that do not lock the file are found as iceoryx2 nodes.
//!
//! # Segments without a size
//! A segment of shared memory is created by one system call and given its size by another. A process that is killed between
//! the two, or whose second call fails, leaves a segment without a size, and iceoryx2 waits without end for the size of a
//! segment that it opens. A thread of the run's owner removes such segments while the run goes on; when the owner is gone, a
//! thread of each policy and external memory does.
//!
//! # The counter of nodes
//! The first node of a prefix creates a segment that counts nodes, and iceoryx2 lets every user write to that one, whatever the
//! umask. A run's owner creates it before there is a node, for itself only; nodes open the one they find.

use std::ffi::OsStr;
use std::fs::{self, DirBuilder, File, Permissions, TryLockError};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use iceoryx2::node::{Node, NodeState};
use iceoryx2::prelude::{CallbackProgression, Config};

use crate::attach::{Attach, MAX_ROOT_BYTES, prefix};
use crate::clock::{self, Instant};
use crate::process::{ProcessWatch, SHARED_MEMORY, with_full_inodes};
use crate::transport::{Ipc, run_config};

/// The file that every process of a run keeps locked.
const LOCK_FILE: &str = "lock";

/// How long [`RunDir`]'s drop waits for the run's last processes before it leaves the run to a later [`clean`]. (A
/// process that is being started holds its parent's locks for a moment.) Long, because a process that the user has started may have
/// little of the machine's time; no run whose processes end waits for it.
const EXIT_TIMEOUT: Duration = Duration::from_secs(10);

/// Time between two searches of a live run for segments without a size.
const SWEEP_INTERVAL: Duration = Duration::from_millis(250);

/// The name of iceoryx2's counter of nodes after the run's prefix: the SHA-1 of the type's name, and the version.
const NODE_COUNTER: &str = "9204dd183d1c4d8e1ff592a30766ffa6765aa8b5_node.0_10_0.global_mgmt";

/// A new counter of nodes: iceoryx2's version (major, minor and patch have 16 bits each), and no node yet.
const NEW_NODE_COUNTER: [u64; 2] = [10 << 16, 0];

/// How often to look whether a process has an unfinished segment open, and the time between two looks.
const LOOKS_AT_UNFINISHED: u32 = 100;
const TIME_BETWEEN_LOOKS: Duration = Duration::from_millis(2);

/// How long to wait for another process that cleans the same node.
const CLEANER_TIMEOUT: Duration = Duration::from_secs(5);

/// Why a run's folder cannot be created or removed.
#[derive(Debug, thiserror::Error)]
pub enum RegistryError {
    /// An operation failed.
    #[error("{doing} {}: {cause}", path.display())]
    System {
        /// What was tried.
        doing: &'static str,
        /// The path.
        path: PathBuf,
        /// The operating system's error.
        cause: io::Error,
    },
    /// What has the name of the folder of all runs belongs to another user, or is no folder.
    #[error(
        "{} {}, so your runs cannot be registered there. Name another folder in every shell that you use this program in; \
         it is made where it is missing: export {RUN_DIR_VARIABLE}=~/.mt",
        path.display(), if *owner == own_user() { "is no folder".to_owned() } else { format!("belongs to user {owner}") }
    )]
    NotOurs {
        /// The path.
        path: PathBuf,
        /// The id of the user it belongs to.
        owner: u32,
    },
    /// Other users may write to the folder of all runs.
    #[error("other users may write to {0}, where your runs are registered: chmod 700 {0}", path.display())]
    OthersWrite {
        /// The folder.
        path: PathBuf,
    },
    /// The path is too long for the names of sockets.
    #[error(
        "the path {} is too long: names of sockets in it leave room for under {} bytes; choose another folder",
        path.display(), MAX_ROOT_BYTES - RUN_NAME_BYTES
    )]
    TooLong {
        /// The folder.
        path: PathBuf,
    },
}

fn system<'a>(doing: &'static str, path: &'a Path) -> impl FnOnce(io::Error) -> RegistryError + 'a {
    move |cause| {
        let cause = with_full_inodes(cause, path);
        RegistryError::System { doing, path: path.to_owned(), cause }
    }
}

/// Bytes of a slash and a run's name.
const RUN_NAME_BYTES: usize = 9;

/// The environment variable that names the folder of all runs.
pub const RUN_DIR_VARIABLE: &str = "MEMTRANSFER_RUN_DIR";

/// The folder of all runs of this user: `/dev/shm/memtransfer-<uid>`, unless `MEMTRANSFER_RUN_DIR` names one. It is in memory,
/// as what the runs share is: iceoryx2 flushes each of the many small files that it makes there.
pub fn default_base() -> PathBuf {
    std::env::var_os(RUN_DIR_VARIABLE).filter(|folder| !folder.is_empty()).map_or_else(
        || PathBuf::from(format!("/dev/shm/memtransfer-{}", own_user())),
        PathBuf::from,
    )
}

fn own_user() -> u32 {
    rustix::process::getuid().as_raw()
}

/// The folders of the runs that this process owns.
static OWN_RUNS: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn own_runs() -> MutexGuard<'static, Vec<PathBuf>> {
    OWN_RUNS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes what the runs of this process have in shared memory, and their folders, whatever is still in use: for a program that is
/// about to end without calling its destructors. Its child processes have to be ended before.
///
/// # Errors
/// The first of the operations that failed; the others are done.
pub fn abandon_own_runs() -> Result<(), RegistryError> {
    let mut outcome = Ok(());
    for run in own_runs().iter() {
        outcome = outcome.and(remove_names(run)).and(match fs::remove_dir_all(run) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                Err(system("cannot remove", run)(error))
            }
            _ => Ok(()),
        });
    }
    outcome
}

/// A run's folder, owned by the process that created it. Dropping it removes the run, unless a process of the run is
/// still alive.
#[derive(Debug)]
pub struct RunDir {
    path: PathBuf,
    lock: File,
    /// Removes segments without a size; `None` in a simulation, which schedules all threads itself.
    sweeper: Option<Sweeper>,
}

impl RunDir {
    /// Creates the folder of a new run below `base`, and `base` itself if it is missing.
    ///
    /// # Errors
    /// When `base` belongs to another user, its path is too long, or the system refuses.
    pub fn create(base: &Path) -> Result<Self, RegistryError> {
        let _base_lock = lock_base(base)?;
        loop {
            let name = format!("{:08x}", RandomState::new().build_hasher().finish() as u32);
            let path = base.join(&name);
            if !names_with_prefix(&prefix(&path))?.is_empty() {
                continue;
            }
            match make_private_folder(&path) {
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists => continue,
                outcome => outcome.map_err(system("cannot make", &path))?,
            }
            let file = path.join(LOCK_FILE);
            let lock = File::create_new(&file)
                .and_then(|lock| lock.lock_shared().map(|()| lock))
                .map_err(system("cannot lock", &file))?;
            create_node_counter(&prefix(&path))?;
            let sweeper = (!clock::is_simulated()).then(|| Sweeper::start(path.clone(), None));
            let sweeper = sweeper.transpose().map_err(system("cannot watch", &path))?;
            own_runs().push(path.clone());
            return Ok(Self { path, lock, sweeper });
        }
    }

    /// The run's first generation, with default settings.
    pub fn attach(&self) -> Attach {
        Attach::new(&self.path)
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The prefix of the names that the run has in shared memory.
    pub fn prefix(&self) -> String {
        prefix(&self.path)
    }

    /// The run's name: the folder's last part.
    pub fn name(&self) -> String {
        self.path.file_name().map(OsStr::to_string_lossy).unwrap_or_default().into_owned()
    }

    fn remove(&self) -> Result<bool, RegistryError> {
        let _base_lock = self.path.parent().map(lock_base).transpose()?;
        let deadline = Instant::now() + EXIT_TIMEOUT;
        loop {
            match self.lock.try_lock() {
                Ok(()) => return remove_if_dead(&self.path),
                Err(TryLockError::WouldBlock) if Instant::now() < deadline => {
                    clock::sleep(Duration::from_millis(5));
                }
                Err(TryLockError::WouldBlock) => return Ok(false),
                Err(TryLockError::Error(cause)) => {
                    return Err(system("cannot lock", &self.path)(cause));
                }
            }
        }
    }
}

impl Drop for RunDir {
    fn drop(&mut self) {
        self.sweeper = None;
        match self.remove() {
            Ok(true) => {}
            Ok(false) => tracing::warn!(
                "a process of run {} is still alive; when it has ended, `memtransfer clean` removes the run",
                self.name()
            ),
            Err(error) => tracing::warn!(%error, "run {} could not be removed", self.name()),
        }
        own_runs().retain(|run| *run != self.path);
    }
}

/// The result of [`clean`].
#[derive(Debug, Default)]
pub struct Cleaned {
    /// Folders of dead runs, which were removed.
    pub removed: Vec<PathBuf>,
    /// Folders of living runs, which were not touched.
    pub alive: Vec<PathBuf>,
    /// Why folders of dead runs could not be removed.
    pub failed: Vec<RegistryError>,
}

impl Cleaned {
    /// What a user has to know before another run starts.
    pub fn notes(&self) -> Vec<String> {
        let removed = self.removed.iter();
        let removed =
            removed.map(|run| format!("removed what a killed run left in {}", run.display()));
        let failed = self.failed.iter().map(|error| format!("an earlier run stays: {error}"));
        removed.chain(failed).collect()
    }
}

/// A run found by [`list`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListedRun {
    /// Its folder.
    pub path: PathBuf,
    /// Whether a process of it is alive.
    pub alive: bool,
}

/// All runs below `base`, by name.
///
/// # Errors
/// When `base` belongs to another user or the system refuses.
pub fn list(base: &Path) -> Result<Vec<ListedRun>, RegistryError> {
    if !base.exists() {
        return Ok(Vec::new());
    }
    let _base_lock = lock_base(base)?;
    let dead = |path: &Path| Ok(lock_dead(path)?.is_some() && !has_living_node(path));
    run_folders(base)?
        .into_iter()
        .map(|path| Ok(ListedRun { alive: !dead(&path)?, path }))
        .collect()
}

/// Removes what dead runs below `base` left: shared memory, sockets, folders. Does not touch living runs, and goes on after
/// one that cannot be removed.
///
/// # Errors
/// When `base` belongs to another user or cannot be listed.
pub fn clean(base: &Path) -> Result<Cleaned, RegistryError> {
    let mut cleaned = Cleaned::default();
    if !base.exists() {
        return Ok(cleaned);
    }
    let _base_lock = lock_base(base)?;
    for path in run_folders(base)? {
        let dead = lock_dead(&path).and_then(|lock| match lock {
            Some(_lock) => remove_if_dead(&path),
            None => Ok(false),
        });
        match dead {
            Ok(true) => cleaned.removed.push(path),
            Ok(false) => cleaned.alive.push(path),
            Err(error) => cleaned.failed.push(error),
        }
    }
    Ok(cleaned)
}

/// Whether a process of the run in `root` is alive: its orchestrator, at least.
pub fn is_alive(root: &Path) -> bool {
    // Locked for a moment if no other process has a lock.
    File::open(root.join(LOCK_FILE))
        .is_ok_and(|lock| matches!(lock.try_lock(), Err(TryLockError::WouldBlock)))
}

/// Locks the run in `root` until the returned file is dropped: no cleaner removes it in the meantime.
pub(crate) fn lock_shared(root: &Path) -> io::Result<File> {
    let lock = File::open(root.join(LOCK_FILE))?;
    // Does not wait long: only a cleaner locks exclusively, for a moment or until it has removed the run.
    lock.lock_shared()?;
    // If a cleaner was first, the locked file no longer has a name.
    fs::metadata(root.join(LOCK_FILE)).map(|_| lock)
}

/// Creates the counter of nodes of the run with this prefix.
fn create_node_counter(prefix: &str) -> Result<(), RegistryError> {
    let path = Path::new(SHARED_MEMORY).join(format!("{prefix}{NODE_COUNTER}"));
    File::options()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(&path)
        .and_then(|mut counter| counter.write_all(bytemuck::bytes_of(&NEW_NODE_COUNTER)))
        .map_err(system("cannot create", &path))
}

/// Makes a folder for this user only. iceoryx2 changes the umask of the process while it makes a socket in another thread.
fn make_private_folder(path: &Path) -> io::Result<()> {
    DirBuilder::new().mode(0o700).create(path)?;
    fs::set_permissions(path, Permissions::from_mode(0o700))
}

/// Creates, checks and locks the folder of all runs: runs are created and cleaned one at a time.
fn lock_base(base: &Path) -> Result<File, RegistryError> {
    if base.as_os_str().len() > MAX_ROOT_BYTES - RUN_NAME_BYTES {
        return Err(RegistryError::TooLong { path: base.to_owned() });
    }
    match make_private_folder(base) {
        Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
        outcome => outcome.map_err(system("cannot make", base))?,
    }
    let about = fs::symlink_metadata(base).map_err(system("cannot look at", base))?;
    if !about.is_dir() || about.uid() != own_user() {
        return Err(RegistryError::NotOurs { path: base.to_owned(), owner: about.uid() });
    }
    if about.mode() & 0o022 != 0 {
        return Err(RegistryError::OthersWrite { path: base.to_owned() });
    }
    let lock = File::open(base).map_err(system("cannot open", base))?;
    lock.lock().map_err(system("cannot lock", base))?;
    Ok(lock)
}

/// The folders below `base` whose names are those of runs.
fn run_folders(base: &Path) -> Result<Vec<PathBuf>, RegistryError> {
    let is_run = |name: &str| {
        name.len() == 8 && name.bytes().all(|b| b.is_ascii_hexdigit() && !b.is_ascii_uppercase())
    };
    let mut folders = Vec::new();
    for entry in fs::read_dir(base).map_err(system("cannot list", base))? {
        let entry = entry.map_err(system("cannot list", base))?;
        if entry.file_type().is_ok_and(|kind| kind.is_dir())
            && entry.file_name().to_str().is_some_and(is_run)
        {
            folders.push(entry.path());
        }
    }
    folders.sort();
    Ok(folders)
}

/// The run's lock, taken exclusively; `None` while a process of the run is alive.
fn lock_dead(run: &Path) -> Result<Option<File>, RegistryError> {
    let file = run.join(LOCK_FILE);
    // Creates the file for a run that died before it had one: runs are created under the lock of the base.
    let lock = File::options().create(true).append(true).open(&file);
    let lock = lock.map_err(system("cannot open", &file))?;
    match lock.try_lock() {
        Ok(()) => Ok(Some(lock)),
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(cause)) => Err(system("cannot lock", &file)(cause)),
    }
}

/// The iceoryx2 configuration of the run in `path`.
fn config(path: &Path) -> Option<Config> {
    run_config(&prefix(path), path).ok()
}

fn has_living_node(run: &Path) -> bool {
    let mut alive = false;
    let Some(config) = config(run) else { return false };
    let outcome = Node::<Ipc>::list(&config, |node| {
        alive |= matches!(node, NodeState::Alive(_));
        CallbackProgression::Continue
    });
    if let Err(error) = outcome {
        tracing::debug!(?error, run = %run.display(), "its nodes cannot be listed");
    }
    alive
}

/// A thread that removes the segments of a run that stay without a size. Dropping it ends the thread.
#[derive(Debug)]
pub(crate) struct Sweeper {
    stop: Option<mpsc::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Sweeper {
    /// Starts the thread for the run in `root`. It does nothing while `owner` is alive.
    pub(crate) fn start(root: PathBuf, owner: Option<ProcessWatch>) -> io::Result<Self> {
        let (stop, stopped) = mpsc::channel();
        let thread = thread::Builder::new().name("sweeper".to_owned()).spawn(move || {
            while stopped.recv_timeout(SWEEP_INTERVAL) == Err(RecvTimeoutError::Timeout) {
                if owner.as_ref().is_some_and(|owner| !owner.has_ended()) {
                    continue;
                }
                if let Err(error) = remove_unfinished(&root) {
                    tracing::warn!(%error, "shared memory cannot be searched for segments without a size");
                }
            }
        })?;
        Ok(Self { stop: Some(stop), thread: Some(thread) })
    }
}

impl Drop for Sweeper {
    fn drop(&mut self) {
        self.stop = None;
        if self.thread.take().is_some_and(|thread| thread.join().is_err()) {
            tracing::warn!("the thread that removes segments without a size panicked");
        }
    }
}

/// Removes the segments of the run in `root` that have no size and that no process has open.
fn remove_unfinished(root: &Path) -> Result<(), RegistryError> {
    let folder = Path::new(SHARED_MEMORY);
    for path in names_with_prefix(&prefix(root))?.into_iter().map(|name| folder.join(name)) {
        if has_no_size(&path) && is_abandoned(&path) {
            tracing::debug!(segment = %path.display(), "removing a segment without a size");
            remove_segment(&path)?;
        }
    }
    Ok(())
}

fn has_no_size(segment: &Path) -> bool {
    fs::symlink_metadata(segment).is_ok_and(|about| about.is_file() && about.len() == 0)
}

/// Whether the process that created the segment without a size has ended or given up. It would have it open all the time,
/// and others that wait for its size have it open for a moment, again and again.
fn is_abandoned(segment: &Path) -> bool {
    for _ in 0..LOOKS_AT_UNFINISHED {
        if !has_no_size(segment) {
            return false;
        }
        if !is_open_somewhere(segment) {
            // Looked at again: it may have been given its size and closed meanwhile.
            return has_no_size(segment);
        }
        clock::sleep(TIME_BETWEEN_LOOKS);
    }
    false
}

/// Whether a process of this user has `file` open.
fn is_open_somewhere(file: &Path) -> bool {
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    processes
        .filter(|process| process.file_name().as_encoded_bytes().iter().all(u8::is_ascii_digit))
        .filter_map(|process| fs::read_dir(process.path().join("fd")).ok())
        .any(|open| {
            let mut targets = open.flatten().filter_map(|fd| fs::read_link(fd.path()).ok());
            targets.any(|target| target == file)
        })
}

fn remove_segment(path: &Path) -> Result<(), RegistryError> {
    match fs::remove_file(path) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        outcome => outcome.map_err(system("cannot remove", path)),
    }
}

/// Removes a run; the caller has its lock. Returns `false` when a process that does not lock is still alive.
fn remove_if_dead(run: &Path) -> Result<bool, RegistryError> {
    if has_living_node(run) {
        return Ok(false);
    }
    remove_unfinished(run)?;
    remove_dead_nodes(run);
    remove_names(run)?;
    fs::remove_dir_all(run).map_err(system("cannot remove", run))?;
    Ok(true)
}

/// Removes everything that the run has in shared memory.
fn remove_names(run: &Path) -> Result<(), RegistryError> {
    let names = names_with_prefix(&prefix(run))?;
    names.into_iter().try_for_each(|name| remove_segment(&Path::new(SHARED_MEMORY).join(name)))
}

/// Removes dead nodes through iceoryx2, which knows their resources. The caller removes the rest by name.
fn remove_dead_nodes(run: &Path) {
    let Some(config) = config(run) else { return };
    let outcome = Node::<Ipc>::list(&config, |node| {
        if let NodeState::Dead(node) = node
            && let Err(error) = node.blocking_remove_stale_resources(CLEANER_TIMEOUT)
        {
            tracing::debug!(?error, "a dead node is removed by name");
        }
        CallbackProgression::Continue
    });
    if let Err(error) = outcome {
        tracing::debug!(?error, "dead nodes are removed by name");
    }
}

/// Names in shared memory that start with `prefix`.
fn names_with_prefix(prefix: &str) -> Result<Vec<std::ffi::OsString>, RegistryError> {
    let folder = Path::new(SHARED_MEMORY);
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(system("cannot list", folder))? {
        let name = entry.map_err(system("cannot list", folder))?.file_name();
        if name.as_encoded_bytes().starts_with(prefix.as_bytes()) {
            names.push(name);
        }
    }
    Ok(names)
}
