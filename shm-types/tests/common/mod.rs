//! A run of its own for each test.

use shm_types::message::Role;
use shm_types::{Attach, Bus, FrameSize, RunDir};
use tempfile::TempDir;

/// A run in a folder of its own. Fields are dropped in order: the run before its folder.
pub(crate) struct Run {
    pub(crate) attach: Attach,
    pub(crate) dir: RunDir,
    pub(crate) base: TempDir,
}

/// A run with small frames.
pub(crate) fn run() -> Run {
    let base = tempfile::Builder::new().prefix("mt").tempdir_in("/tmp").unwrap();
    let dir = RunDir::create(base.path()).unwrap();
    let frame = FrameSize { width: 64, height: 64 };
    let attach = Attach { frame, frame_capacity: 32, lanes: 4, ..Attach::new(&dir) };
    Run { attach, dir, base }
}

/// A place in `attach`'s run.
pub(crate) fn bus(attach: &Attach, role: Role) -> Bus {
    Bus::join(attach.clone(), role).unwrap()
}
