//! Queries to the operating system: the parent and other processes, free shared memory.

use std::io;
use std::os::fd::OwnedFd;
use std::path::Path;

use rustix::event::{PollFd, PollFlags, poll};
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open};

pub use crate::clock::monotonic_ns;

/// The file system of shared memory.
pub const SHARED_MEMORY: &str = "/dev/shm";

/// Names in shared memory that a run can need at its start: with the built-in memories it has about 90, and files in its folder.
const NAMES: u64 = 256;

/// Makes the kernel kill this process when its parent `parent` ends.
///
/// The kernel watches the *thread* that started this process: start children from a thread that outlives them.
///
/// # Errors
/// When the parent is another process, because `parent` ended before this call, or the system refuses.
pub fn die_with_parent(parent: u32) -> io::Result<()> {
    rustix::process::set_parent_process_death_signal(Some(Signal::KILL))?;
    let now = rustix::process::getppid().map(Pid::as_raw_nonzero);
    if now.is_none_or(|now| now.get() as u32 != parent) {
        return Err(io::Error::other(format!(
            "process {parent}, which started this one, has ended"
        )));
    }
    Ok(())
}

/// Whether `pid` is the process that started this one.
pub fn is_parent(pid: u32) -> bool {
    rustix::process::getppid().is_some_and(|parent| parent.as_raw_nonzero().get() as u32 == pid)
}

/// Watches a process that need not be a child of this one. Reuse of its process id does not confuse it.
#[derive(Debug)]
pub struct ProcessWatch {
    process: OwnedFd,
}

impl ProcessWatch {
    /// Watches process `pid`.
    ///
    /// # Errors
    /// When there is no such process, or the system cannot watch it.
    pub fn new(pid: u32) -> io::Result<Self> {
        let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
        let pid = pid.ok_or_else(|| io::Error::from(rustix::io::Errno::SRCH))?;
        Ok(Self { process: pidfd_open(pid, PidfdFlags::empty())? })
    }

    /// Whether the process has ended.
    pub fn has_ended(&self) -> bool {
        let mut ends = [PollFd::new(&self.process, PollFlags::IN)];
        matches!(poll(&mut ends, Some(&Default::default())), Ok(ready) if ready > 0)
    }

    /// Waits until the process has ended.
    pub fn wait(&self) {
        let mut ends = [PollFd::new(&self.process, PollFlags::IN)];
        // A signal interrupts the call.
        while !matches!(poll(&mut ends, None), Ok(ready) if ready > 0) {}
    }
}

/// The run does not fit into shared memory.
#[derive(Debug, thiserror::Error)]
pub enum SharedMemoryError {
    /// Too little is free.
    #[error(
        "the run can use {needed} MiB of shared memory, and {SHARED_MEMORY} has {free} MiB free of {total}: \
         enlarge it (in Docker: --shm-size)"
    )]
    TooSmall {
        /// MiB needed.
        needed: u64,
        /// MiB free.
        free: u64,
        /// MiB in total.
        total: u64,
    },
    /// Too few names are free.
    #[error(
        "a run can need {NAMES} names in {SHARED_MEMORY}, and {free} inodes are free of {total}: remove files there, or mount \
         it with a larger nr_inodes"
    )]
    NoNames {
        /// Inodes that are free.
        free: u64,
        /// Inodes in total.
        total: u64,
    },
    /// The system does not report how much is free.
    #[error("cannot read the free space of {SHARED_MEMORY}: {0}")]
    Unknown(io::Error),
}

/// Checks that `needed` bytes of shared memory are free, and the names of a run: writing past the end of shared memory kills a
/// process with SIGBUS.
///
/// # Errors
/// When too little is free, or the system does not report it.
pub fn check_shared_memory(needed: u64) -> Result<(), SharedMemoryError> {
    let (free, total) = shared_memory_space().map_err(SharedMemoryError::Unknown)?;
    check_space(needed, free, total)?;
    let names =
        rustix::fs::statvfs(SHARED_MEMORY).map_err(|e| SharedMemoryError::Unknown(e.into()))?;
    check_names(names.f_favail, names.f_files)
}

/// `total` is 0 on a file system that does not count names.
fn check_names(free: u64, total: u64) -> Result<(), SharedMemoryError> {
    if total == 0 || free >= NAMES {
        Ok(())
    } else {
        Err(SharedMemoryError::NoNames { free, total })
    }
}

/// `error`, with the reason where a file system is full of names rather than of bytes: the system has one code for both.
pub(crate) fn with_full_inodes(error: io::Error, path: &Path) -> io::Error {
    let folder = path.parent().unwrap_or(path);
    let is_full = error.raw_os_error() == Some(rustix::io::Errno::NOSPC.raw_os_error())
        && rustix::fs::statvfs(folder).is_ok_and(|about| about.f_files > 0 && about.f_favail == 0);
    match is_full {
        true => io::Error::other(format!(
            "{error}: the file system of {} has no inodes left; remove files there, or mount it with a larger nr_inodes",
            folder.display()
        )),
        false => error,
    }
}

/// Bytes of shared memory: free, and in total.
///
/// # Errors
/// When the system does not report them.
pub fn shared_memory_space() -> io::Result<(u64, u64)> {
    let space = rustix::fs::statvfs(Path::new(SHARED_MEMORY))?;
    Ok((space.f_bavail * space.f_frsize, space.f_blocks * space.f_frsize))
}

fn check_space(needed: u64, free: u64, total: u64) -> Result<(), SharedMemoryError> {
    if needed <= free {
        return Ok(());
    }
    let (needed, free, total) = (needed.div_ceil(1 << 20), free >> 20, total >> 20);
    Err(SharedMemoryError::TooSmall { needed, free, total })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_is_watched_until_it_ends() {
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let watch = ProcessWatch::new(child.id()).unwrap();
        assert!(!watch.has_ended() && !is_parent(child.id()));
        child.kill().unwrap();
        // Not waited for yet: its number is still taken.
        while !watch.has_ended() {
            std::thread::yield_now();
        }
        child.wait().unwrap();
        assert!(watch.has_ended() && ProcessWatch::new(child.id()).is_err());
    }

    #[test]
    fn too_little_room_names_what_to_do() {
        let error = check_space(100 << 20, 64 << 20, 64 << 20).unwrap_err().to_string();
        assert_eq!(
            error,
            "the run can use 100 MiB of shared memory, and /dev/shm has 64 MiB free of 64: enlarge it (in Docker: \
             --shm-size)"
        );
        assert!(check_space(1, 1, 1).is_ok());
        let error = check_names(3, 1000).unwrap_err().to_string();
        assert!(
            error.contains("3 inodes are free of 1000") && error.contains("nr_inodes"),
            "{error}"
        );
        assert!(check_names(NAMES, 1000).is_ok() && check_names(0, 0).is_ok());
    }
}
