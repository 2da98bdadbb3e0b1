//! What a process of a run asks of the system: the clock, its parent, room in shared memory.

use std::io;
use std::path::Path;

use rustix::process::{Pid, Signal};
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
