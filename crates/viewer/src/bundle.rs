//! A site as a folder of files that a browser opens from the disk.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use case_book::{ELSEWHERE_VARIANT, GREY_VARIANT};
use domain::State;
use durable::{FolderDraft, KnownNames};
use world_client::Selection;
use world_client::frames::ViewKey;

use crate::data::image_hashes;
use crate::file::File;
use crate::site::{FRONT_END, RunPages, Site, folder_of, image};
use crate::view_file::ViewFile;

/// What was written.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Bundle {
    /// The page to open.
    pub page: PathBuf,
    /// Episodes.
    pub episodes: usize,
    /// Those with views.
    pub shown: usize,
    /// Files of views.
    pub views: usize,
    /// Bytes of all files.
    pub bytes: u64,
    /// Images of prompts that the run folder does not have, and that are left out.
    pub missing: Vec<PathBuf>,
}

/// A file that only bundles have, so that a folder is known as one.
const MARK: &str = "runs.js";

/// Writes `site` as the folder `dir`, in place of an earlier bundle: a kill at any moment leaves one or the other. The
/// selected episodes have views and prompts, all others a page without them.
///
/// # Errors
/// When the folder holds something else, a run cannot be read, the renderer fails, or the system refuses.
pub fn write_bundle(site: &mut Site, dir: &Path, selection: Selection) -> Result<Bundle> {
    let cannot = || format!("cannot write {}", dir.display());
    if let Some(other) = others_in(dir).with_context(cannot)?.first() {
        let other = dir.join(other);
        bail!(
            "{} is no part of a run's pages, and is not removed: choose another --out",
            other.display()
        );
    }
    let draft = FolderDraft::new(dir).with_context(cannot)?;
    let mut folder = BundleFolder { dir: draft.path(), bundle: Bundle::default() };
    for name in FRONT_END.iter().map(|(name, _)| *name).chain([MARK]) {
        let file = site.file(name)?.with_context(|| format!("there is no {name}"))?;
        folder.write(name, &file)?;
    }
    let mut keys = BTreeSet::new();
    for (place, run) in (1..).zip(&mut site.runs) {
        let chosen = selection.choose(&run.log, &keys);
        keys.extend(chosen.iter().map(|&index| run.log.episodes[index].key.clone()));
        folder.run(&folder_of(place), run, &chosen)?;
    }
    let bundle = Bundle { page: dir.join("index.html"), ..folder.bundle };
    draft.finish().with_context(cannot)?;
    Ok(bundle)
}

/// The names in the folder of a bundle, as regular expressions.
const PAGES: [&str; 8] = [
    "(index\\.html|style\\.css|(app|run-page|episode-page|map|runs)\\.js)",
    "run[0-9]+/(run\\.js|report\\.html)?",
    "run[0-9]+/(prompts|episodes|images|maps|views)/",
    "run[0-9]+/(prompts|episodes)/[0-9]+\\.js",
    "run[0-9]+/images/[0-9a-fA-F]{32}\\.jpg",
    "run[0-9]+/maps/[0-9]+\\.svg",
    "run[0-9]+/views/[0-9a-f]{32}(-small)?\\.jpg",
    // Bundles of earlier versions have the letters of headings.
    "run[0-9]+/views/[0-9]+-[-0-9._NESW]+(-small)?\\.jpg",
];

/// What is in the folder `dir` and no part of a bundle. A symbolic link is replaced, not what it points to.
fn others_in(dir: &Path) -> io::Result<Vec<PathBuf>> {
    match fs::symlink_metadata(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Ok(found) if found.is_symlink() => return Ok(Vec::new()),
        _ => {}
    }
    let is_bundle =
        durable::read(&dir.join(MARK)).is_ok_and(|mark| mark.starts_with(b"memtransfer.receive("));
    // Without the mark, the files are someone else's, whatever their names are.
    let names = match is_bundle {
        true => KnownNames::new(PAGES),
        false => KnownNames::new([]),
    };
    names?.others_in(dir)
}

/// The most thumbnails of demonstrations that an episode has, so that one of 40 steps stays below 1 MB.
const DEMONSTRATION_VIEWS: usize = 72;

/// The folder that is written into.
struct BundleFolder<'a> {
    dir: &'a Path,
    bundle: Bundle,
}

impl BundleFolder<'_> {
    fn write(&mut self, path: &str, file: &File) -> Result<()> {
        let target = self.dir.join(path);
        let write = || {
            if let Some(parent) = target.parent() {
                fs::create_dir_all(parent)?;
            }
            fs::write(&target, &file.bytes)
        };
        write().with_context(|| format!("cannot write {}", target.display()))?;
        self.bundle.bytes += file.bytes.len() as u64;
        Ok(())
    }

    fn run(&mut self, name: &str, run: &mut RunPages, chosen: &BTreeSet<usize>) -> Result<()> {
        self.write(&format!("{name}/run.js"), &run.run(name, |index| chosen.contains(&index))?)?;
        self.write(&format!("{name}/report.html"), &run.report()?)?;
        let looks = self.views(name, run, chosen)?;
        let (mut images, mut grounds) = (BTreeMap::new(), BTreeSet::new());
        for index in 0..run.log.episodes.len() {
            let is_chosen = chosen.contains(&index);
            let mut data = run.episode(index)?;
            data.limit_demonstration_views(DEMONSTRATION_VIEWS);
            data.rename_views(|view| {
                is_chosen.then(|| looks.get(view).cloned().unwrap_or_else(|| view.to_owned()))
            });
            if is_chosen && run.has_prompts() {
                let prompts = run.prompts(index)?;
                images.extend(image_hashes(&prompts));
                let file = RunPages::prompts_file(name, index, &prompts)?;
                self.write(&format!("{name}/prompts/{index}.js"), &file)?;
            } else {
                data.prompts = false;
            }
            if run.has_map() {
                grounds.insert(data.ground);
            }
            let file = RunPages::episode_file(name, index, &data)?;
            self.write(&format!("{name}/episodes/{index}.js"), &file)?;
        }
        for (hash, path) in images {
            match image(&run.log.dir, &path)? {
                Some(file) => self.write(&format!("{name}/images/{hash}.jpg"), &file)?,
                None => self.bundle.missing.push(path),
            }
        }
        for ground in grounds {
            let map = run.map(ground)?.with_context(|| format!("there is no world {ground}"))?;
            self.write(&format!("{name}/maps/{ground}.svg"), &map)?;
        }
        self.bundle.episodes += run.log.episodes.len();
        self.bundle.shown += chosen.len();
        Ok(())
    }

    /// Writes the views of the chosen episodes, each picture once. Returns the file of each view that has another's: one that
    /// looks the same.
    fn views(
        &mut self,
        name: &str,
        run: &mut RunPages,
        chosen: &BTreeSet<usize>,
    ) -> Result<BTreeMap<String, String>> {
        let mut wanted = BTreeSet::new();
        for &index in chosen {
            let mut data = run.episode(index)?;
            data.limit_demonstration_views(DEMONSTRATION_VIEWS);
            wanted.extend(data.view_names().into_iter().filter_map(ViewFile::of_name));
        }
        // World after world in each state, the unchanged one first: another's view is left out where it looks the same.
        let mut views: BTreeSet<(Option<State>, u32, ViewKey)> = BTreeSet::new();
        for ViewFile { view, .. } in &wanted {
            let ViewKey::State(variant, state) = view else {
                views.insert((None, 0, view.clone()));
                continue;
            };
            views.insert((Some(*state), *variant, view.clone()));
            if ![ELSEWHERE_VARIANT, GREY_VARIANT].contains(variant) {
                views.insert((Some(*state), 0, ViewKey::State(0, *state)));
            }
        }
        let views: Vec<ViewKey> = views.into_iter().map(|(.., view)| view).collect();
        let (mut unchanged, mut same) = (None, BTreeMap::new());
        let mut written = BTreeSet::new();
        run.render(&views, |view, rgba| {
            let pixels = blake3::hash(rgba);
            let shown = match view {
                ViewKey::State(0, state) => {
                    unchanged = Some((*state, pixels));
                    view.clone()
                }
                ViewKey::State(_, state) if unchanged == Some((*state, pixels)) => {
                    ViewKey::State(0, *state)
                }
                ViewKey::State(..) => view.clone(),
                // Many steps look alike, and the names of long episodes are longer than those of files may be.
                ViewKey::Steps(_) => ViewKey::Steps(pixels.to_hex()[..32].into()),
            };
            for is_small in [false, true] {
                let file = ViewFile { view: view.clone(), is_small };
                let target = ViewFile { view: shown.clone(), is_small };
                if !wanted.contains(&file) {
                    continue;
                }
                if shown != *view {
                    same.insert(file.name(), target.name());
                }
                if !written.contains(&target) {
                    let content = target.encode(rgba)?;
                    self.write(&format!("{name}/views/{}", target.name()), &content)?;
                    self.bundle.views += 1;
                    written.insert(target);
                }
            }
            Ok(())
        })?;
        Ok(same)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_files_of_a_bundle_have_known_names() {
        use domain::State;

        let names = KnownNames::new(PAGES).unwrap();
        for (name, _) in FRONT_END.into_iter().chain([(MARK, &[][..])]) {
            assert!(names.has(Path::new(name)), "{name}");
        }
        for numbers in [&[12.0, 0.0, 3.0][..], &[-0.25]] {
            let state = State::new(numbers).unwrap();
            for (is_small, variant) in [(true, GREY_VARIANT), (false, ELSEWHERE_VARIANT)] {
                let view = ViewKey::State(variant, state);
                let name = format!("run2/views/{}", ViewFile { view, is_small }.name());
                assert!(names.has(Path::new(&name)), "{name}");
            }
        }
    }

    #[test]
    fn pages_replace_pages_and_nothing_else() {
        let base = tempfile::tempdir().unwrap();
        let dir = base.path().join("pages");
        let may = || others_in(&dir).unwrap().is_empty();
        assert!(may(), "it is missing");
        fs::create_dir(&dir).unwrap();
        assert!(may(), "it is empty");
        fs::write(dir.join(MARK), "window.runs = [];").unwrap();
        assert!(!may(), "a script of someone else");
        fs::write(dir.join(MARK), "memtransfer.receive(\"runs\",{});\n").unwrap();
        fs::create_dir(dir.join("run1")).unwrap();
        fs::write(dir.join("index.html"), "").unwrap();
        assert!(may());
        for other in ["notes.txt", "run1/notes.txt"] {
            fs::write(dir.join(other), "").unwrap();
            assert_eq!(others_in(&dir).unwrap(), [Path::new(other)]);
            fs::remove_file(dir.join(other)).unwrap();
        }
        fs::remove_dir_all(&dir).unwrap();
        std::os::unix::fs::symlink("/etc", &dir).unwrap();
        assert!(may(), "the link is replaced");
    }
}
