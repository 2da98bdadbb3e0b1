//! Embeddings cached by image content: in memory, and in a database file for later runs.
//!
//! Each [encoder fingerprint](crate::encoder::EncoderFacts::fingerprint) has a file of its own, so embeddings of
//! another model, preprocessing, runtime or execution provider are never mixed. Several processes may read and write a
//! file at the same time. A file that is damaged is set aside under another name and started anew: its images are
//! embedded again.
//!
//! New embeddings are written in batches. A process that is killed loses those of the last second. What another process has
//! written meanwhile is found by [`EmbeddingCache::find_stored`].

use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, ensure};
use domain::hex;
use redb::{
    ConcurrencyMode, Database, DatabaseError, ReadableDatabase, ReadableTable, StorageError,
    TableDefinition, TableError,
};
use search::{ContentHash, Embedding};
use shm_types::clock::Instant;

/// Content hash to the embedding's numbers, little-endian.
const EMBEDDINGS: TableDefinition<'_, &[u8; 16], &[u8]> = TableDefinition::new("embeddings");

/// First bytes of a file of embeddings for other machines. The encoder's model follows, then content and numbers of each.
const SHIPPED: &[u8] = b"memtransfer embeddings 1\n";

/// File name extension of a database.
const EXTENSION: &str = "redb";

/// A batch is due when it has this many embeddings, or when this much time has passed since the last one.
const BATCH: usize = 32;
const BATCH_INTERVAL: Duration = Duration::from_secs(1);

/// Size of the database's page cache. Small, because every embedding that is read stays in memory.
const PAGE_CACHE_BYTES: usize = 4 << 20;

/// The database cannot be used. The embeddings stay in memory.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} the embedding cache {path}: {cause}")]
pub struct CacheError {
    action: &'static str,
    path: PathBuf,
    cause: Box<redb::Error>,
}

/// Embeddings by image content.
#[derive(Debug)]
pub struct EmbeddingCache {
    known: HashMap<ContentHash, Embedding>,
    file: Option<CacheFile>,
    /// Why the file could not be read, until it is reported.
    failure: Option<CacheError>,
}

#[derive(Debug)]
struct CacheFile {
    database: Database,
    path: PathBuf,
    dimension: usize,
    pending: Vec<(ContentHash, Embedding)>,
    last_written: Instant,
}

impl EmbeddingCache {
    /// A cache without a file.
    pub fn in_memory() -> Self {
        Self { known: HashMap::new(), file: None, failure: None }
    }

    /// Opens the file for `fingerprint` in `folder` and reads it; creates it if it is missing.
    ///
    /// # Errors
    /// When the folder or the file cannot be created or read.
    pub fn open(
        folder: &Path,
        fingerprint: &[u8; 32],
        dimension: usize,
    ) -> Result<Self, CacheError> {
        let path = folder.join(hex(fingerprint)).with_extension(EXTENSION);
        let failed = |action| {
            let path = path.clone();
            move |cause: redb::Error| CacheError { action, path, cause: cause.into() }
        };
        std::fs::create_dir_all(folder).map_err(|error| failed("create")(error.into()))?;
        let database = match open_database(&path) {
            Err(error) if is_damage(&error) => {
                let aside = path.with_extension("damaged");
                tracing::warn!(
                    "the embedding cache {} is damaged ({error}): moved to {}, starting anew",
                    path.display(),
                    aside.display()
                );
                std::fs::rename(&path, &aside)
                    .map_err(|error| failed("set aside")(error.into()))?;
                open_database(&path)
            }
            opened => opened,
        };
        let database = database.map_err(|error| failed("open")(error.into()))?;
        let known = read(&database, dimension).map_err(failed("read"))?.into_iter().collect();
        let (pending, last_written) = (Vec::new(), Instant::now());
        let file = CacheFile { database, path, dimension, pending, last_written };
        Ok(Self { known, file: Some(file), failure: None })
    }

    /// The embedding of an image, if it is known.
    pub fn get(&self, content: &ContentHash) -> Option<&Embedding> {
        self.known.get(content)
    }

    /// Looks for an embedding that is not known in the file, where another process may have written it. Returns whether it
    /// is known now. If the file cannot be read, it is not used again, and [`Self::write_if_due`] returns the error.
    pub fn find_stored(&mut self, content: &ContentHash) -> bool {
        match self.file.as_ref().map(|file| file.find(content)) {
            Some(Ok(Some(embedding))) => self.known.insert(*content, embedding).is_none(),
            Some(Ok(None)) | None => false,
            Some(Err(cause)) => {
                self.failure = Some(self.abandon("read", cause));
                false
            }
        }
    }

    /// Writes all known embeddings of the encoder `model` to `out`, in the order of their content, for other machines.
    ///
    /// # Errors
    /// When `out` fails.
    pub fn ship(&self, model: &[u8; 32], out: &mut impl Write) -> std::io::Result<()> {
        out.write_all(SHIPPED)?;
        out.write_all(model)?;
        for (content, embedding) in self.known.iter().collect::<BTreeMap<_, _>>() {
            out.write_all(content)?;
            for number in embedding.as_slice() {
                out.write_all(&number.to_le_bytes())?;
            }
        }
        out.flush()
    }

    /// Takes the embeddings of the encoder `model` from a file that [`Self::ship`] wrote. They are used instead of this
    /// machine's own, and not written to its file. Returns how many they are.
    ///
    /// # Errors
    /// When the file cannot be read or is of another encoder.
    pub fn add_shipped(
        &mut self,
        file: &Path,
        model: &[u8; 32],
        dimension: usize,
    ) -> anyhow::Result<usize> {
        let shown = file.display();
        let bytes =
            durable::input::read_large(file).with_context(|| format!("cannot read {shown}"))?;
        let rest =
            bytes.strip_prefix(SHIPPED).with_context(|| format!("{shown} has no embeddings"))?;
        let rest = rest.strip_prefix(model).with_context(|| {
            format!("the embeddings in {shown} are of another encoder: write the plan again")
        })?;
        let records = rest.chunks_exact(size_of::<ContentHash>() + 4 * dimension);
        ensure!(records.remainder().is_empty(), "{shown} is cut off: remove it");
        for record in records.clone() {
            let (content, numbers) = record.split_at(size_of::<ContentHash>());
            let numbers = numbers.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
            let embedding = Embedding::restored(numbers.collect());
            let embedding = embedding.with_context(|| format!("{shown} is damaged: remove it"))?;
            self.known.insert(content.try_into()?, embedding);
        }
        Ok(records.len())
    }

    /// Number of known embeddings.
    pub fn len(&self) -> usize {
        self.known.len()
    }

    /// Whether no embedding is known.
    pub fn is_empty(&self) -> bool {
        self.known.is_empty()
    }

    /// Adds an embedding, and writes the current batch if it is full.
    ///
    /// # Errors
    /// When the batch cannot be written. The embeddings stay in memory, and the file is not used again.
    pub fn insert(&mut self, content: ContentHash, embedding: Embedding) -> Result<(), CacheError> {
        let is_new = self.known.insert(content, embedding.clone()).is_none();
        if let Some(file) = self.file.as_mut().filter(|_| is_new) {
            file.pending.push((content, embedding));
            if file.pending.len() >= BATCH {
                return self.flush();
            }
        }
        Ok(())
    }

    /// Writes the current batch if it is due.
    ///
    /// # Errors
    /// As [`Self::insert`]; and when the file could not be read.
    pub fn write_if_due(&mut self) -> Result<(), CacheError> {
        match &self.file {
            None => self.failure.take().map_or(Ok(()), Err),
            Some(file) if file.is_due() => self.flush(),
            _ => Ok(()),
        }
    }

    /// Writes the current batch.
    ///
    /// # Errors
    /// As [`Self::insert`].
    pub fn flush(&mut self) -> Result<(), CacheError> {
        let Some(file) = &mut self.file else { return Ok(()) };
        let written = file.write();
        written.map_err(|cause| self.abandon("write", cause))
    }

    /// Closes the file for good. Returns the error that says why.
    fn abandon(&mut self, action: &'static str, cause: redb::Error) -> CacheError {
        let path = self.file.take().map(|file| file.path.clone()).unwrap_or_default();
        CacheError { action, path, cause: cause.into() }
    }
}

impl CacheFile {
    fn is_due(&self) -> bool {
        !self.pending.is_empty() && self.last_written.elapsed() >= BATCH_INTERVAL
    }

    fn find(&self, content: &ContentHash) -> Result<Option<Embedding>, redb::Error> {
        let transaction = self.database.begin_read()?;
        let table = match transaction.open_table(EMBEDDINGS) {
            Err(TableError::TableDoesNotExist(_)) => return Ok(None),
            table => table?,
        };
        let found = table.get(content)?;
        Ok(found.and_then(|bytes| restored(bytes.value(), self.dimension)))
    }

    fn write(&mut self) -> Result<(), redb::Error> {
        self.last_written = Instant::now();
        if self.pending.is_empty() {
            return Ok(());
        }
        let transaction = self.database.begin_write()?;
        {
            let mut table = transaction.open_table(EMBEDDINGS)?;
            for (content, embedding) in &self.pending {
                let numbers = embedding.as_slice().iter();
                let bytes: Vec<u8> = numbers.flat_map(|number| number.to_le_bytes()).collect();
                table.insert(content, &*bytes)?;
            }
        }
        transaction.commit()?;
        self.pending.clear();
        Ok(())
    }
}

impl Drop for EmbeddingCache {
    fn drop(&mut self) {
        if let Err(error) = self.flush() {
            tracing::warn!("{error}; its last embeddings are computed again in the next run");
        }
    }
}

/// The embeddings of `dimension` in the file in `folder` that has most of them, in the order of their content. A file
/// that cannot be read is skipped with a warning.
pub fn stored(folder: &Path, dimension: usize) -> Vec<Embedding> {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = files.map(|file| file.path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == EXTENSION));
    paths.sort();
    let mut most = Vec::new();
    for path in paths {
        let opened = open_database(&path).map_err(redb::Error::from);
        match opened.and_then(|database| read(&database, dimension)) {
            Ok(found) if found.len() > most.len() => most = found,
            Ok(_) => {}
            Err(error) => {
                tracing::warn!("cannot read the embedding cache {}: {error}", path.display())
            }
        }
    }
    most.into_iter().map(|(_, embedding)| embedding).collect()
}

/// Opens a database for this and other processes at once, after checking every page of it.
fn open_database(path: &Path) -> Result<Database, DatabaseError> {
    let mut builder = Database::builder();
    builder
        .set_concurrency_mode(ConcurrencyMode::MultiWriter)
        .set_check_integrity_on_open(true)
        .set_cache_size(PAGE_CACHE_BYTES);
    builder.create(path)
}

/// Whether a file is not a database, or not any more.
fn is_damage(error: &DatabaseError) -> bool {
    match error {
        DatabaseError::Storage(StorageError::Corrupted(_)) | DatabaseError::UpgradeRequired(_) => {
            true
        }
        DatabaseError::Storage(StorageError::Io(error)) => {
            matches!(
                error.kind(),
                std::io::ErrorKind::InvalidData | std::io::ErrorKind::UnexpectedEof
            )
        }
        _ => false,
    }
}

/// All embeddings of `dimension`, in the order of their content.
fn read(
    database: &Database,
    dimension: usize,
) -> Result<Vec<(ContentHash, Embedding)>, redb::Error> {
    let transaction = database.begin_read()?;
    let table = match transaction.open_table(EMBEDDINGS) {
        Err(TableError::TableDoesNotExist(_)) => return Ok(Vec::new()),
        table => table?,
    };
    let mut found = Vec::new();
    for entry in table.iter()? {
        let (content, bytes) = entry?;
        let embedding = restored(bytes.value(), dimension);
        found.extend(embedding.map(|embedding| (*content.value(), embedding)));
    }
    Ok(found)
}

/// The embedding with these numbers; `None` if it has not `dimension` of them, or no length of 1.
fn restored(bytes: &[u8], dimension: usize) -> Option<Embedding> {
    let numbers = bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
    let numbers: Vec<f32> = numbers.collect();
    (numbers.len() == dimension).then(|| Embedding::restored(numbers)).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    const DIMENSION: usize = 5;
    const FINGERPRINT: [u8; 32] = [7; 32];

    fn embedding(seed: u8) -> Embedding {
        let raw: Vec<f32> = (0..DIMENSION).map(|i| f32::from(seed) + i as f32 + 1.0).collect();
        Embedding::normalised(&raw).unwrap()
    }

    fn open(folder: &Path) -> EmbeddingCache {
        EmbeddingCache::open(folder, &FINGERPRINT, DIMENSION).unwrap()
    }

    /// A folder whose cache holds the embeddings of `0..count`, and the path of its file.
    fn filled(count: u8) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let mut cache = open(folder.path());
        for seed in 0..count {
            cache.insert([seed; 16], embedding(seed)).unwrap();
        }
        let path = cache.file.as_ref().unwrap().path.clone();
        (folder, path)
    }

    fn assert_holds(cache: &EmbeddingCache, seeds: impl IntoIterator<Item = u8>) {
        let seeds: Vec<u8> = seeds.into_iter().collect();
        assert_eq!(cache.len(), seeds.len());
        for seed in seeds {
            assert_eq!(cache.get(&[seed; 16]), Some(&embedding(seed)), "{seed}");
        }
    }

    #[test]
    fn embeddings_are_restored_bit_for_bit() {
        let (folder, _) = filled(90);
        assert_holds(&open(folder.path()), 0..90);
    }

    #[test]
    fn shipped_embeddings_come_before_a_machines_own() {
        let (folder, _) = filled(5);
        let file = folder.path().join("shipped");
        let model = [3; 32];
        let mut shipped = EmbeddingCache::in_memory();
        shipped.insert([1; 16], embedding(40)).unwrap();
        shipped.insert([90; 16], embedding(90)).unwrap();
        let mut bytes = Vec::new();
        shipped.ship(&model, &mut bytes).unwrap();
        std::fs::write(&file, &bytes).unwrap();

        let mut cache = open(folder.path());
        assert_eq!(cache.add_shipped(&file, &model, DIMENSION).unwrap(), 2);
        assert_eq!((cache.len(), cache.get(&[1; 16])), (6, Some(&embedding(40))));
        assert_eq!(cache.get(&[90; 16]), Some(&embedding(90)));
        drop(cache);
        assert_holds(&open(folder.path()), 0..5);

        let mut cache = EmbeddingCache::in_memory();
        let mut refused =
            |model| cache.add_shipped(&file, &model, DIMENSION).unwrap_err().to_string();
        assert!(refused([4; 32]).contains("of another encoder"));
        std::fs::write(&file, &bytes[..bytes.len() - 1]).unwrap();
        assert!(refused(model).contains("cut off"));
        std::fs::write(&file, "text").unwrap();
        assert!(refused(model).contains("no embeddings"));
    }

    #[test]
    fn a_batch_is_readable_by_others_while_the_file_is_open() {
        let folder = tempfile::tempdir().unwrap();
        let mut cache = open(folder.path());
        for seed in 0..BATCH as u8 {
            cache.insert([seed; 16], embedding(seed)).unwrap();
        }
        assert_holds(&open(folder.path()), 0..BATCH as u8);
    }

    #[test]
    fn another_encoder_has_another_file() {
        let (folder, _) = filled(3);
        let other = EmbeddingCache::open(folder.path(), &[8; 32], DIMENSION).unwrap();
        assert!(other.is_empty());
        assert_holds(&open(folder.path()), 0..3);
    }

    #[test]
    fn a_damaged_file_is_set_aside_and_started_anew() {
        let whole = {
            let (_folder, path) = filled(40);
            std::fs::read(path).unwrap()
        };
        let flipped = |byte: usize| {
            let mut bytes = whole.clone();
            bytes[byte] ^= 0x10;
            bytes
        };
        let place = whole.windows(16).position(|window| window == [9; 16]).unwrap();
        for damaged in
            [b"no database".to_vec(), whole[..whole.len() / 2].to_vec(), flipped(place + 20)]
        {
            let (folder, path) = filled(3);
            std::fs::write(&path, damaged).unwrap();
            let mut cache = open(folder.path());
            assert!(cache.is_empty());
            assert!(path.with_extension("damaged").is_file());
            cache.insert([4; 16], embedding(4)).unwrap();
            drop(cache);
            assert_holds(&open(folder.path()), [4]);
        }
    }

    #[test]
    fn stored_embeddings_come_from_the_file_that_has_most_of_the_dimension() {
        let (folder, _) = filled(3);
        let mut other = EmbeddingCache::open(folder.path(), &[8; 32], DIMENSION).unwrap();
        other.insert([9; 16], embedding(9)).unwrap();
        let mut wide = EmbeddingCache::open(folder.path(), &[9; 32], 2).unwrap();
        for seed in 0..9 {
            wide.insert([seed; 16], Embedding::normalised(&[1.0, 2.0]).unwrap()).unwrap();
        }
        drop((other, wide));
        assert_eq!(stored(folder.path(), DIMENSION), [0, 1, 2].map(embedding));
        assert!(stored(folder.path(), 3).is_empty());
        assert!(stored(&folder.path().join("none"), DIMENSION).is_empty());
    }

    #[test]
    fn what_another_process_has_written_is_found() {
        let (folder, path) = filled(3);
        let mut cache = open(folder.path());
        let writer = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "embedding_cache::tests::writer_process"])
            .env("EMBEDDING_CACHE_WRITER", format!("1 {}", folder.path().display()))
            .output();
        assert!(writer.unwrap().status.success());
        assert!(cache.find_stored(&[5; 16]) && !cache.find_stored(&[6; 16]));
        assert_holds(&cache, [0, 1, 2, 5]);

        std::fs::write(&path, "no database").unwrap();
        assert!(!cache.find_stored(&[9; 16]), "a file that cannot be read any more");
        let error = cache.write_if_due().unwrap_err().to_string();
        assert!(error.starts_with("cannot read the embedding cache"), "{error}");
        assert!(cache.write_if_due().is_ok() && !cache.find_stored(&[9; 16]));
    }

    /// A writer for tests, in a process of its own: file locks do not tell threads apart.
    #[test]
    fn writer_process() {
        let Ok(word) = std::env::var("EMBEDDING_CACHE_WRITER") else { return };
        let (writer, folder) = word.split_once(' ').unwrap();
        let writer: u8 = writer.parse().unwrap();
        let mut cache = open(Path::new(folder));
        for seed in (0..200).filter(|seed| seed % 4 == writer) {
            cache.insert([seed; 16], embedding(seed)).unwrap();
            cache.flush().unwrap();
        }
    }

    #[test]
    fn processes_that_write_at_once_lose_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let writers: Vec<_> = (0..4)
            .map(|writer| {
                std::process::Command::new(std::env::current_exe().unwrap())
                    .args(["--exact", "embedding_cache::tests::writer_process"])
                    .env("EMBEDDING_CACHE_WRITER", format!("{writer} {}", folder.path().display()))
                    .stdout(std::process::Stdio::null())
                    .spawn()
                    .unwrap()
            })
            .collect();
        for mut writer in writers {
            assert!(writer.wait().unwrap().success());
        }
        assert_holds(&open(folder.path()), 0..200);
    }

    #[test]
    fn without_a_folder_there_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let blocked = folder.path().join("file");
        std::fs::write(&blocked, "").unwrap();
        let error =
            EmbeddingCache::open(&blocked, &FINGERPRINT, DIMENSION).unwrap_err().to_string();
        assert!(error.contains("cannot create the embedding cache"), "{error}");
    }
}
