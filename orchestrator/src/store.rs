//! What the workers of a plan need beside the programs, in a store that all of them reach: the encoder and its runtime,
//! documents, and embeddings that are known.
//!
//! A store is a folder, given as a path or as file://PATH. Each file in it is named by the BLAKE3 hash of its bytes, so several
//! plans share it and nothing in it ever changes. The plan lists what it needs. A worker copies what its cache folder lacks,
//! checks it against the hash, and gives it its name only then.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, bail, ensure};
use conditions::settings::RunSettings;
use documents::{DocumentFile, DocumentFolder, DocumentName, Provenance};
use domain::{RUNTIME_FILE, RUNTIME_SHA256, hex};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use shm_types::message::Role;
use supervise::Launch;

use crate::launch::encoder_flags;
use crate::scratch::{self, ScratchFolder};

/// The folder in the cache folder of embeddings that came with plans.
const EMBEDDINGS: &str = "shipped-embeddings";

/// The first bytes of such a file, as `memory-proc embeddings` writes them.
const EMBEDDINGS_START: &[u8] = b"memtransfer embeddings 1\n";

/// The folders in the cache folder whose files a plan may bring. The others are not a plan's to write: programs, and
/// what runs compute.
const FOLDERS: [&str; 3] = ["documents", "models", EMBEDDINGS];

/// A file of a store.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoredFile {
    /// Its place in the cache folder.
    pub path: String,
    /// BLAKE3 of its bytes, as hexadecimal digits.
    pub hash: String,
    /// Its size.
    pub bytes: u64,
}

/// What a plan's workers need, and where it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shipment {
    /// The store, as [`Store::open`] takes it.
    pub store: String,
    /// The files.
    pub files: Vec<StoredFile>,
    /// The one of them that has the embeddings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub embeddings: Option<String>,
}

/// Files by their hash.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// The store `place`: a folder or its file:// address.
    ///
    /// # Errors
    /// When it is an address of another kind.
    pub fn open(place: &str) -> Result<Self> {
        let folder = match place.split_once("://") {
            None => std::path::absolute(place).with_context(|| place.to_owned())?,
            Some(("file", path)) if path.starts_with('/') => path.into(),
            Some(_) => bail!(
                "the store {place} is neither a folder nor file:///PATH: mount a bucket as a folder (rclone mount, s3fs, gcsfuse)"
            ),
        };
        Ok(Self { folder })
    }

    /// Its address.
    pub fn address(&self) -> String {
        format!("file://{}", self.folder.display())
    }

    /// Copies `file` into the store, unless it is there. `path` is its place in the cache folder.
    fn add(&self, file: &Path, path: String) -> Result<StoredFile> {
        let (hash, bytes) = hash_of(file)?;
        self.put(file, &hash).with_context(|| format!("cannot write {}/{hash}", self.address()))?;
        Ok(StoredFile { path, hash, bytes })
    }

    /// Copies `file`, whose hash is known, unless a file with that hash is there.
    fn put(&self, file: &Path, hash: &str) -> Result<()> {
        let stored = self.folder.join(hash);
        if hash_of(&stored).is_ok_and(|(found, _)| found == hash) {
            return Ok(());
        }
        fs::create_dir_all(&self.folder)?;
        write_checked(&stored, |draft| copy_file(file, draft), |draft| check_hash(draft, hash))
    }

    /// Copies `file` to its place in the folder `cache`, unless there is one. Returns whether it was copied.
    fn fetch(&self, file: &StoredFile, cache: &Path) -> Result<bool> {
        ensure!(
            may_come_with_a_plan(&file.path),
            "the plan brings {:?}, and a plan may only bring {RUNTIME_FILE} and files in {} of the cache folder, in documents \
             only .json files: write the plan again, with `memtransfer plan --store`",
            file.path,
            FOLDERS.join(", ")
        );
        let hash = &file.hash;
        let is_hash = hash.len() == 64 && hash.bytes().all(|byte| byte.is_ascii_hexdigit());
        ensure!(is_hash, "the plan names {hash:?}, which is no hash: write the plan again");
        let to = cache.join(&file.path);
        if to.exists() {
            let is_damaged = is_embeddings(&file.path) && check_hash(&to, hash).is_err();
            ensure!(!is_damaged, "{} is not what the plan brings: remove it", to.display());
            return Ok(false);
        }
        let folder = to.parent().unwrap_or(cache);
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let check = |draft: &Path| {
            check_hash(draft, hash)?;
            match file.path.strip_prefix("models/") {
                Some(model) => check_model(model, draft),
                None if file.path == RUNTIME_FILE => check_runtime(draft),
                None => check_data(&file.path, hash, draft),
            }
        };
        write_checked(&to, |draft| copy_file(&self.folder.join(hash), draft), check).with_context(
            || {
                format!(
                    "cannot get {} from {}/{hash}; `memtransfer plan --store` puts it there",
                    file.path,
                    self.address()
                )
            },
        )?;
        Ok(true)
    }
}

/// BLAKE3 of a file, as hexadecimal digits, and its size.
fn hash_of(file: &Path) -> Result<(String, u64)> {
    let read = || {
        let mut hasher = blake3::Hasher::new();
        let bytes = io::copy(&mut durable::input::open(file)?, &mut hasher)?;
        Ok::<_, io::Error>((hasher.finalize().to_hex().to_string(), bytes))
    };
    read().with_context(|| format!("cannot read {}", file.display()))
}

fn copy_file(from: &Path, draft: &mut File) -> Result<()> {
    io::copy(&mut durable::input::open(from)?, draft)?;
    Ok(())
}

/// Whether a plan may bring a file for this place in the cache folder.
fn may_come_with_a_plan(path: &str) -> bool {
    // One spelling only: the checks of models go by the text of the path.
    let in_folder = |folder: &str| {
        let name = path.strip_prefix(folder).and_then(|rest| rest.strip_prefix('/'));
        name.is_some_and(|name| !matches!(name, "" | "." | "..") && !name.contains('/'))
    };
    // The folder of documents also has the lock and the drafts of those who build them.
    let is_of_its_kind = !in_folder("documents") || path.ends_with(".json");
    path == RUNTIME_FILE || is_of_its_kind && FOLDERS.into_iter().any(in_folder)
}

/// Checks the hash of a file of a store.
fn check_hash(file: &Path, hash: &str) -> Result<()> {
    let (found, bytes) = hash_of(file)?;
    ensure!(found == hash, "its {bytes} bytes have the hash {found} instead of {hash}: remove it");
    Ok(())
}

/// Checks that a file is a library that set-up fetches: it is code that memory loads, and the plan, which names its hash, may be
/// another user's.
fn check_runtime(file: &Path) -> Result<()> {
    let sha256 = sha256_of(file)?;
    ensure!(
        RUNTIME_SHA256.contains(&&*sha256),
        "it is not the ONNX Runtime that set-up fetches, and would be loaded as code (its SHA-256 is {sha256}). Run `cargo xtask \
         setup` on this machine instead"
    );
    Ok(())
}

/// Checks that a file with the name of a model that set-up fetches is that model: it would stay in the cache folder, and end later
/// runs. Other models are the user's own.
fn check_model(name: &str, file: &Path) -> Result<()> {
    let known: KnownModels = toml::from_str(include_str!("../../assets/models.toml"))?;
    let named = known.models.iter().find(|model| model.file.as_deref() == Some(name));
    let Some(expected) = named.and_then(|model| model.sha256.as_deref()) else { return Ok(()) };
    let sha256 = sha256_of(file)?;
    ensure!(
        sha256 == expected,
        "it is not the model {name} that set-up fetches (its SHA-256 is {sha256}, not {expected}). Run `cargo xtask setup` on this \
         machine instead"
    );
    Ok(())
}

fn is_embeddings(path: &str) -> bool {
    Path::new(path).starts_with(EMBEDDINGS)
}

/// Checks that a file for `path` with the hash `hash` is what its place in the cache folder says: it would stay there, and end later
/// runs.
fn check_data(path: &str, hash: &str, file: &Path) -> Result<()> {
    if is_embeddings(path) {
        ensure!(path == format!("{EMBEDDINGS}/{hash}"), "its name is not the hash of its bytes");
        let mut start = Vec::new();
        let embeddings = durable::input::open(file)?;
        embeddings.take(EMBEDDINGS_START.len() as u64).read_to_end(&mut start)?;
        ensure!(start == EMBEDDINGS_START, "it has no embeddings");
        return Ok(());
    }
    let document = DocumentFile::load(file)?;
    let Provenance { kind, demonstrations, .. } = document.provenance;
    let (name, folder) = (DocumentName { kind, demonstrations }, DocumentFolder::new("documents"));
    let names = [folder.file(name, &document.provenance.address()), folder.run_copy(name)];
    ensure!(
        names.iter().any(|name| name == Path::new(path)),
        "it is the document {name}, under another name"
    );
    Ok(())
}

/// What the shipped manifest of encoders says about their files.
#[derive(Deserialize)]
struct KnownModels {
    #[serde(rename = "model")]
    models: Vec<KnownModel>,
}

#[derive(Deserialize)]
struct KnownModel {
    file: Option<String>,
    sha256: Option<String>,
}

/// SHA-256 of a file, as hexadecimal digits.
fn sha256_of(file: &Path) -> Result<String> {
    let read = || {
        let (mut file, mut hasher, mut part) =
            (durable::input::open(file)?, Sha256::new(), vec![0; 1 << 16]);
        loop {
            match file.read(&mut part)? {
                0 => return Ok::<_, io::Error>(hex(&hasher.finalize())),
                bytes => hasher.update(&part[..bytes]),
            }
        }
    };
    read().with_context(|| format!("cannot read {}", file.display()))
}

/// Writes the file `to`, which appears only when all of it is there and `check` accepts it.
fn write_checked(
    to: &Path,
    write: impl FnOnce(&mut File) -> Result<()>,
    check: impl FnOnce(&Path) -> Result<()>,
) -> Result<()> {
    let folder = to.parent().context("a file without a folder")?;
    for draft in scratch::abandoned_drafts(folder)? {
        scratch::remove(&draft)?;
    }
    let mut draft = scratch::draft_in(folder)?;
    write(draft.as_file_mut())?;
    draft.as_file().sync_all()?;
    check(draft.path())?;
    draft.persist(to)?;
    Ok(())
}

impl Shipment {
    /// Puts what the workers of a run with `settings` need into `store`: `documents`, and with `encoder` what memories that
    /// match views need. `cache` is the cache folder. `None` when `stop` was set.
    ///
    /// # Errors
    /// When something cannot be read or written.
    pub fn pack(
        store: &Store,
        cache: &Path,
        settings: &RunSettings,
        documents: &[PathBuf],
        encoder: bool,
        stop: &AtomicBool,
    ) -> Result<Option<Self>> {
        let mut files = Vec::new();
        // Documents of another folder than the cache's travel with that folder.
        for document in documents {
            if let Ok(path) = document.strip_prefix(cache) {
                files.push(store.add(document, path.display().to_string())?);
            }
        }
        let mut embeddings = None;
        if encoder {
            let folder = ScratchFolder::new().context("cannot make a temporary folder")?;
            let written = folder.path().join("embeddings");
            let Some(encoder_files) = encoder_files(settings, &written, stop)? else {
                return Ok(None);
            };
            for file in encoder_files {
                if stop.load(Ordering::Relaxed) {
                    return Ok(None);
                }
                // A model or runtime of the user's own is named on every machine.
                let Ok(path) = file.strip_prefix(cache) else { continue };
                let path = path.display().to_string();
                let is_known = path != RUNTIME_FILE || check_runtime(&file).is_ok();
                if is_known && may_come_with_a_plan(&path) {
                    files.push(store.add(&file, path)?);
                }
            }
            let (hash, _) = hash_of(&written)?;
            let path = format!("{EMBEDDINGS}/{hash}");
            files.push(store.add(&written, path.clone())?);
            embeddings = Some(path);
        }
        Ok(Some(Self { store: store.address(), files, embeddings }))
    }

    /// Copies what the cache folder `cache` lacks from the plan's store, or from `store`. Workers of one machine wait for each
    /// other, so that each file is copied once. Returns how many were. Where nothing is missing, nothing is written.
    ///
    /// # Errors
    /// When a file is missing or damaged.
    pub fn fetch(&self, store: Option<&str>, cache: &Path) -> Result<usize> {
        let is_brought = |path: &String| self.files.iter().any(|file| file.path == *path);
        ensure!(
            self.embeddings.iter().all(is_brought),
            "the plan does not bring the embeddings that it names: write the plan again"
        );
        let is_there = |file: &StoredFile| {
            let path = cache.join(&file.path);
            let is_checked = !is_embeddings(&file.path) || check_hash(&path, &file.hash).is_ok();
            may_come_with_a_plan(&file.path) && path.exists() && is_checked
        };
        if self.files.iter().all(is_there) {
            return Ok(0);
        }
        let store = Store::open(store.unwrap_or(&self.store))?;
        let path = cache.join("fetch.lock");
        let failed = || format!("cannot lock {}", path.display());
        fs::create_dir_all(cache).with_context(failed)?;
        let lock = durable::output::open_lock(&path).with_context(failed)?;
        lock.lock().with_context(failed)?;
        let mut fetched = 0;
        for file in &self.files {
            fetched += usize::from(store.fetch(file, cache)?);
        }
        Ok(fetched)
    }

    /// The file of the embeddings in the cache folder `cache`.
    pub fn embeddings_in(&self, cache: &Path) -> Option<PathBuf> {
        self.embeddings.as_ref().map(|path| cache.join(path))
    }
}

/// Writes the embeddings that are known here to the file `written`; returns the files of the encoder. `None` when `stop` was set.
fn encoder_files(
    settings: &RunSettings,
    written: &Path,
    stop: &AtomicBool,
) -> Result<Option<Vec<PathBuf>>> {
    let launch = Launch::sibling(Role::Memory, "memory-proc", vec!["embeddings".into()])?;
    let out = [("--out", Some(written.display().to_string()))];
    let launch = launch.with_flags(encoder_flags(settings)).with_flags(out);
    let Launch { program, args, .. } = launch;
    let output = supervise::output(Command::new(&program).args(args), stop);
    let output = output.with_context(|| format!("cannot start {}", program.display()))?;
    let Some(output) = output else { return Ok(None) };
    ensure!(
        output.status.success(),
        "memory-proc could not write the embeddings that are known: {}",
        String::from_utf8_lossy(&output.stderr).trim()
    );
    let files = serde_json::from_slice(&output.stdout);
    files.context("memory-proc lists files that cannot be read").map(Some)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    /// A store with one file, and an empty cache folder.
    fn stored() -> (tempfile::TempDir, Store, StoredFile, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("model");
        fs::write(&file, "weights").unwrap();
        let store = Store::open(&format!("file://{}/store", folder.path().display())).unwrap();
        let stored = store.add(&file, "models/model".into()).unwrap();
        assert_eq!(store.add(&file, "models/model".into()).unwrap(), stored);
        let cache = folder.path().join("cache");
        (folder, store, stored, cache)
    }

    #[test]
    fn a_file_is_fetched_once_and_only_whole() {
        let (folder, store, file, cache) = stored();
        let shipment = Shipment { store: store.address(), files: vec![file], embeddings: None };
        assert_eq!(shipment.fetch(None, &cache).unwrap(), 1);
        assert_eq!(fs::read_to_string(cache.join("models/model")).unwrap(), "weights");
        fs::remove_file(cache.join("fetch.lock")).unwrap();
        assert_eq!(shipment.fetch(Some("/nowhere"), &cache).unwrap(), 0);
        assert!(!cache.join("fetch.lock").exists(), "where nothing is missing, nothing is written");

        fs::remove_file(cache.join("models/model")).unwrap();
        let object = folder.path().join("store").join(&shipment.files[0].hash);
        fs::write(&object, "weighty").unwrap();
        let error = format!("{:#}", shipment.fetch(None, &cache).unwrap_err());
        assert!(error.contains("instead of") && error.contains("remove it"), "{error}");
        assert_eq!(fs::read_dir(cache.join("models")).unwrap().count(), 0);
        fs::remove_file(object).unwrap();
        let error = format!("{:#}", shipment.fetch(None, &cache).unwrap_err());
        assert!(error.contains("cannot get models/model from"), "{error}");
    }

    #[test]
    fn other_users_can_read_a_file_and_a_damaged_one_is_replaced() {
        let (folder, store, file, _) = stored();
        let object = folder.path().join("store").join(&file.hash);
        let plain = folder.path().join("plain");
        fs::write(&plain, "").unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&object), mode(&plain), "as the umask lets them");
        fs::write(&object, "weighty").unwrap();
        store.add(&folder.path().join("model"), file.path).unwrap();
        assert_eq!(fs::read_to_string(object).unwrap(), "weights");
    }

    #[test]
    fn a_plan_brings_data_and_writes_nothing_outside_its_folders() {
        let (folder, store, file, cache) = stored();
        let inside = folder.path().join("x").display().to_string();
        for path in [
            "../x",
            "models/../../x",
            "models/./dinov2-s14.onnx",
            "models//dinov2-s14.onnx",
            "models/../x",
            "models",
            "",
            "documents/lock",
            "documents/summary-4.json.new",
            &inside,
            "python-tests/bin/python",
            "model-hashes/x",
            "responses/x",
            "onnxruntime/libonnxruntime_providers_shared.so",
        ] {
            let file = StoredFile { path: path.to_owned(), ..file.clone() };
            let error = store.fetch(&file, &cache).unwrap_err().to_string();
            assert!(error.contains("a plan may only bring"), "{error}");
            let files = vec![file];
            let shipment = Shipment { store: store.address(), files, embeddings: None };
            let error = shipment.fetch(None, &cache).unwrap_err().to_string();
            assert!(error.contains("a plan may only bring"), "{error}");
        }
        let file = StoredFile { hash: "../cache".into(), ..file };
        assert!(store.fetch(&file, &cache).unwrap_err().to_string().contains("no hash"));
    }

    #[test]
    fn a_plan_brings_no_code_but_the_known_runtime() {
        let (folder, store, _, cache) = stored();
        let library = folder.path().join("planted.so");
        fs::write(&library, "\x7fELF").unwrap();
        let planted = store.add(&library, RUNTIME_FILE.to_owned()).unwrap();
        let error = format!("{:#}", store.fetch(&planted, &cache).unwrap_err());
        assert!(error.contains("is not the ONNX Runtime that set-up fetches"), "{error}");
        let left = fs::read_dir(cache.join(RUNTIME_FILE).parent().unwrap()).unwrap();
        assert_eq!(left.count(), 0, "it was not written");
    }

    #[test]
    fn a_model_that_set_up_fetches_is_the_known_one() {
        let (folder, store, other, cache) = stored();
        let file = folder.path().join("planted");
        fs::write(&file, "0123456789").unwrap();
        let planted = store.add(&file, "models/dinov2-s14.onnx".to_owned()).unwrap();
        let error = format!("{:#}", store.fetch(&planted, &cache).unwrap_err());
        assert!(error.contains("is not the model dinov2-s14.onnx"), "{error}");
        assert_eq!(fs::read_dir(cache.join("models")).unwrap().count(), 0, "it was not written");
        assert!(store.fetch(&other, &cache).unwrap(), "a model of the user");
    }

    #[test]
    fn documents_and_embeddings_are_what_their_places_say() {
        let (folder, store, _, cache) = stored();
        let provenance = Provenance {
            kind: domain::DocumentKind::Summary,
            demonstrations: domain::Demonstrations::ALL,
            builder: "extractive".to_owned(),
            builder_version: "1".to_owned(),
            sources_sha256: String::new(),
            text_sha256: String::new(),
            trajectories: 1,
            views: 1,
            account: documents::BuildAccount::default(),
        };
        let file = folder.path().join("planted");
        let place = format!("documents/summary-4-{}.json", provenance.address());
        DocumentFile::new(provenance, "text".to_owned()).save(&file).unwrap();
        let document = store.add(&file, place.clone()).unwrap();
        let refused = |planted: &StoredFile| {
            let error = format!("{:#}", store.fetch(planted, &cache).unwrap_err());
            assert!(!cache.join(&planted.path).exists(), "{}", planted.path);
            error
        };
        for other in ["documents/semantic-4.json", "documents/lock.json", "documents/x.json"] {
            let error = refused(&StoredFile { path: other.to_owned(), ..document.clone() });
            assert!(error.contains("it is the document summary/4, under another name"), "{error}");
        }
        assert!(store.fetch(&document, &cache).unwrap());
        fs::remove_file(cache.join(&place)).unwrap();
        let text = fs::read_to_string(&file).unwrap();
        for damaged in [text.replace("\"text\": \"text\"", "\"text\": \"other\""), "{".to_owned()] {
            assert_ne!(damaged, text);
            fs::write(&file, damaged).unwrap();
            refused(&store.add(&file, place.clone()).unwrap());
        }

        fs::write(&file, [EMBEDDINGS_START, b"rest"].concat()).unwrap();
        let hash = hash_of(&file).unwrap().0;
        let embeddings = store.add(&file, format!("{EMBEDDINGS}/{hash}")).unwrap();
        let other = StoredFile { path: format!("{EMBEDDINGS}/0"), ..embeddings.clone() };
        assert!(refused(&other).contains("its name is not the hash"));
        fs::write(&file, "text").unwrap();
        let hash = hash_of(&file).unwrap().0;
        let text = store.add(&file, format!("{EMBEDDINGS}/{hash}")).unwrap();
        assert!(refused(&text).contains("it has no embeddings"));
        // Those that are there are compared, too: their name is all that the memory knows of them.
        let shipment = Shipment {
            store: store.address(),
            files: vec![embeddings.clone()],
            embeddings: Some(embeddings.path.clone()),
        };
        assert_eq!(shipment.fetch(None, &cache).unwrap(), 1);
        assert_eq!(shipment.fetch(None, &cache).unwrap(), 0);
        fs::write(cache.join(&embeddings.path), "wrong").unwrap();
        let error = format!("{:#}", shipment.fetch(None, &cache).unwrap_err());
        assert!(error.contains("is not what the plan brings: remove it"), "{error}");
    }

    #[test]
    fn a_pipe_in_place_of_a_lock_is_refused() {
        let (_folder, store, file, cache) = stored();
        fs::create_dir(&cache).unwrap();
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        rustix::fs::mkfifoat(rustix::fs::CWD, cache.join("fetch.lock"), mode).unwrap();
        let shipment = Shipment { store: store.address(), files: vec![file], embeddings: None };
        let error = format!("{:#}", shipment.fetch(None, &cache).unwrap_err());
        assert!(error.contains("fetch.lock") && error.contains("a pipe"), "{error}");
    }

    #[test]
    fn an_address_of_another_kind_is_refused() {
        let error = Store::open("s3://bucket").unwrap_err().to_string();
        assert!(error.contains("s3://bucket is neither a folder"), "{error}");
    }
}
