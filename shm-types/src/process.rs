//! What a process of a run asks of the system: the clock, its parent, other processes, room in shared memory.

use std::io;
use std::os::fd::OwnedFd;
use std::path::Path;

use rustix::event::{PollFd, PollFlags, poll};
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open};
use rustix::time::{ClockId, clock_gettime};

use crate::attach::Attach;

/// Where shared memory lives.
pub const SHARED_MEMORY: &str = "/dev/shm";

/// Nanoseconds of CLOCK_MONOTONIC: one scale over all processes of the machine, never 0.
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    (now.tv_sec as u64).wrapping_mul(1_000_000_000).wrapping_add(now.tv_nsec as u64)
}

/// Makes the system end this process when the one that started it dies. `parent` is the starter's id,
/// against the case that it died before this call.
///
/// The system watches the *thread* that started this process: start children from a thread that lives on.
///
/// # Errors
/// When the parent is somebody else, so has died already, or the system refuses.
pub fn die_with_parent(parent: u32) -> io::Result<()> {
    rustix::process::set_parent_process_death_signal(Some(Signal::KILL))?;
    let now = rustix::process::getppid().map(Pid::as_raw_nonzero);
    if now.is_none_or(|now| now.get() as u32 != parent) {
        return Err(io::Error::other(format!("process {parent}, which started this one, is gone")));
    }
    Ok(())
}

/// Whether `pid` is the process that started this one.
pub fn is_parent(pid: u32) -> bool {
    rustix::process::getppid().is_some_and(|parent| parent.as_raw_nonzero().get() as u32 == pid)
}

/// Watches a process that need not be a child of this one. The number may be given to somebody else when the
/// process has ended; who watches it is not taken in by that.
#[derive(Debug)]
pub struct Watch {
    process: OwnedFd,
}

impl Watch {
    /// Watches process `pid`.
    ///
    /// # Errors
    /// When there is no such process, or the system has no way to watch it.
    pub fn over(pid: u32) -> io::Result<Self> {
        let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
        let pid = pid.ok_or_else(|| io::Error::from(rustix::io::Errno::SRCH))?;
        Ok(Self { process: pidfd_open(pid, PidfdFlags::empty())? })
    }

    /// Whether the process has ended.
    pub fn has_ended(&self) -> bool {
        let mut ends = [PollFd::new(&self.process, PollFlags::IN)];
        matches!(poll(&mut ends, Some(&Default::default())), Ok(ready) if ready > 0)
    }
}

/// The run does not fit into shared memory.
#[derive(Debug, thiserror::Error)]
pub enum SharedMemoryError {
    /// Not enough room.
    #[error(
        "the run can need {needed} MiB of shared memory and {SHARED_MEMORY} has {free} MiB free (of \
         {total}): lower --frame-budget, or make it larger (in Docker with --shm-size)"
    )]
    TooSmall {
        /// MiB needed.
        needed: u64,
        /// MiB free.
        free: u64,
        /// MiB there are.
        total: u64,
    },
    /// The system does not say.
    #[error("cannot tell how much room {SHARED_MEMORY} has: {0}")]
    Unknown(io::Error),
}

/// Checks that shared memory has room for what `attach` can come to use, since writing past its end
/// kills a process without a word.
///
/// # Errors
/// When there is too little, or the system does not say how much there is.
pub fn check_shared_memory(attach: &Attach) -> Result<(), SharedMemoryError> {
    let (free, total) = shared_memory_space().map_err(SharedMemoryError::Unknown)?;
    room(attach.shared_memory_bytes(), free, total)
}

/// Bytes of shared memory that are free, and that there are in all.
///
/// # Errors
/// When the system does not say.
pub fn shared_memory_space() -> io::Result<(u64, u64)> {
    let space = rustix::fs::statvfs(Path::new(SHARED_MEMORY))?;
    Ok((space.f_bavail * space.f_frsize, space.f_blocks * space.f_frsize))
}

fn room(needed: u64, free: u64, total: u64) -> Result<(), SharedMemoryError> {
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
    fn the_clock_runs() {
        let first = monotonic_ns();
        assert!(first > 0 && monotonic_ns() >= first);
    }

    #[test]
    fn a_process_is_watched_until_it_ends() {
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let watch = Watch::over(child.id()).unwrap();
        assert!(!watch.has_ended() && !is_parent(child.id()));
        child.kill().unwrap();
        // Not waited for yet: its number is still taken.
        while !watch.has_ended() {
            std::thread::yield_now();
        }
        child.wait().unwrap();
        assert!(watch.has_ended() && Watch::over(child.id()).is_err());
    }

    #[test]
    fn too_little_room_names_what_to_do() {
        let error = room(100 << 20, 64 << 20, 64 << 20).unwrap_err().to_string();
        assert_eq!(
            error,
            "the run can need 100 MiB of shared memory and /dev/shm has 64 MiB free (of 64): \
             lower --frame-budget, or make it larger (in Docker with --shm-size)"
        );
        assert!(room(1, 1, 1).is_ok());
    }
}
