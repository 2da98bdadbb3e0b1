//! Views that one process has rendered, kept in files for others.
//!
//! The units of a run execute in processes of their own and need many of the same views. Only views of the CPU backend are
//! kept, whose pixels are the same on every machine. A folder belongs to one renderer: this program's bytes, the settings and
//! the halls. A file belongs to one view of it: what stands on the shelves, the look, the closed passages and the pose.
//!
//! A file that is missing, damaged or cannot be written costs time only: the view is rendered.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use anyhow::{Context, Result};
use lz4_flex::block::{compress_into, decompress_into, get_maximum_output_size};
use peer::world::{RenderTask, RenderWorker, WorldFailure};

use crate::renderer::RenderSettings;
use crate::world::WarehousePicture;
use crate::worlds::Worlds;

/// Bytes of a hash: the first half of BLAKE3.
const HASH: usize = 16;

/// Bytes before the compressed pixels: their hash, and the hash of the pixels.
const HEADER: usize = 2 * HASH;

/// Folders of other renderers that have gained nothing for this long are removed.
const UNUSED: Duration = Duration::from_secs(14 * 24 * 3600);

/// A folder of views of one renderer.
#[derive(Debug)]
pub struct ViewFolder {
    folder: PathBuf,
    /// Whether a file could not be written: then no other is tried.
    is_full: AtomicBool,
}

impl ViewFolder {
    /// The folder in `root` for views of `worlds` with `settings`, made if it is not there.
    ///
    /// # Errors
    /// When this program cannot be read, or the folder not be made.
    pub fn open(root: &Path, worlds: &Worlds, settings: &RenderSettings) -> Result<Self> {
        let mut hasher = blake3::Hasher::new();
        let program = fs::File::open("/proc/self/exe");
        let hashed = program.and_then(|program| hasher.update_reader(program).map(|_| ()));
        hashed.context("cannot read this program")?;
        let parts = format!("{:?} {:?}", worlds.halls(), settings);
        hasher.update(parts.as_bytes());
        let folder = root.join(&hasher.finalize().to_hex()[..2 * HASH]);
        if !folder.exists() {
            fs::create_dir_all(&folder)
                .with_context(|| format!("cannot make {}", folder.display()))?;
            remove_unused(root);
        }
        Ok(Self { folder, is_full: AtomicBool::new(false) })
    }

    fn file(&self, task: &RenderTask<'_, WarehousePicture>) -> PathBuf {
        let WarehousePicture { stock, look, variant, pose } = task.picture;
        let view = format!("{stock} {look} {:?} {pose:?}", variant.closed());
        self.folder.join(&blake3::hash(view.as_bytes()).to_hex()[..2 * HASH])
    }

    /// Fills the slot of `task` from its file. Returns whether it is there and whole.
    fn read(&self, task: &mut RenderTask<'_, WarehousePicture>) -> bool {
        let Ok(file) = durable::read(&self.file(task)) else { return false };
        let Some((header, packed)) = file.split_at_checked(HEADER) else { return false };
        let (expected, content) = header.split_at(HASH);
        let is_whole = checksum(content, packed) == expected
            && decompress_into(packed, task.slot.pixels_mut())
                .is_ok_and(|bytes| bytes == task.slot.pixels().len());
        task.content_hash = if is_whole { content.try_into().ok() } else { None };
        is_whole
    }

    /// Writes the pixels of `task`, whose hash is `content`, into its file, all of them or nothing.
    fn write(&self, task: &RenderTask<'_, WarehousePicture>, content: [u8; HASH], draft: &Path) {
        if self.is_full.load(Relaxed) {
            return;
        }
        let pixels = task.slot.pixels();
        let mut file = vec![0; HEADER + get_maximum_output_size(pixels.len())];
        let Ok(bytes) = compress_into(pixels, &mut file[HEADER..]) else { return };
        file.truncate(HEADER + bytes);
        file[HASH..HEADER].copy_from_slice(&content);
        let sum = checksum(&content, &file[HEADER..]);
        file[..HASH].copy_from_slice(&sum);
        let written = durable::write_file(draft, &file)
            .and_then(|()| durable::rename(draft, &self.file(task)));
        if let Err(error) = written {
            self.is_full.store(true, Relaxed);
            let folder = self.folder.display();
            tracing::warn!(%error, %folder, "views cannot be kept: other processes render them again");
        }
    }
}

fn checksum(content: &[u8], packed: &[u8]) -> [u8; HASH] {
    first_half(*blake3::Hasher::new().update(content).update(packed).finalize().as_bytes())
}

fn first_half(hash: [u8; 2 * HASH]) -> [u8; HASH] {
    std::array::from_fn(|at| hash[at])
}

/// Removes the folders of views in `root` that are [`UNUSED`]; what cannot be removed stays.
fn remove_unused(root: &Path) {
    for entry in fs::read_dir(root).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let is_ours =
            name.len() == 2 * HASH && name.as_encoded_bytes().iter().all(u8::is_ascii_hexdigit);
        if !is_ours {
            continue;
        }
        let changed = entry.metadata().and_then(|facts| facts.modified()).ok();
        if changed.and_then(|at| at.elapsed().ok()).is_some_and(|age| age > UNUSED) {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

/// A render worker that looks for every view in a folder first, and keeps there what it has rendered.
pub struct KeepingWorker {
    renderer: Box<dyn RenderWorker<WarehousePicture> + Send>,
    folder: Arc<ViewFolder>,
    /// The name of files that are being written: no other worker has it.
    draft: PathBuf,
}

impl KeepingWorker {
    /// The worker number `number` of this process.
    pub fn new(
        renderer: Box<dyn RenderWorker<WarehousePicture> + Send>,
        folder: Arc<ViewFolder>,
        number: usize,
    ) -> Self {
        let draft = folder.folder.join(format!("draft-{}-{number}", std::process::id()));
        Self { renderer, folder, draft }
    }
}

impl RenderWorker<WarehousePicture> for KeepingWorker {
    fn render_into(
        &mut self,
        tasks: &mut [RenderTask<'_, WarehousePicture>],
    ) -> Result<u64, WorldFailure> {
        let mut copied = 0;
        for task in tasks {
            if !self.folder.read(task) {
                copied += self.renderer.render_into(std::slice::from_mut(task))?;
                let content = first_half(*blake3::hash(task.slot.pixels()).as_bytes());
                self.folder.write(task, content, &self.draft);
                task.content_hash = Some(content);
            }
        }
        Ok(copied)
    }
}

impl Drop for KeepingWorker {
    fn drop(&mut self) {
        // It is there only if writing it failed.
        let _ = fs::remove_file(&self.draft);
    }
}

#[cfg(test)]
mod tests {
    use std::time::SystemTime;

    use super::*;

    #[test]
    fn only_folders_of_views_are_removed_when_they_are_old() {
        let root = tempfile::tempdir().unwrap();
        let old = SystemTime::now() - 2 * UNUSED;
        let folder = |name: &str| root.path().join(name);
        let (views, recent) = (folder(&"0a".repeat(HASH)), folder(&"0b".repeat(HASH)));
        let holiday = folder("holiday");
        for (path, is_old) in [(&views, true), (&recent, false), (&holiday, true)] {
            fs::create_dir(path).unwrap();
            if is_old {
                fs::File::open(path).unwrap().set_modified(old).unwrap();
            }
        }
        remove_unused(root.path());
        assert!(!views.exists() && recent.exists() && holiday.exists());
    }
}
