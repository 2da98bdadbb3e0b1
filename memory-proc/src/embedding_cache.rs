//! Embeddings kept by image content, in memory and in a file.
//!
//! One file holds the embeddings of one [encoder fingerprint](crate::encoder::EncoderFacts), which is in
//! its name and in its header, so embeddings of another model, preprocessing or runtime are never read by
//! mistake. After the header come records of one size: content hash, vector, checksum.
//!
//! The file is only ever appended to, under a lock that other processes respect, and it is a cache: what is
//! wrong in it costs a computation and nothing else.
//! - A torn write (killed process, full disk) leaves a tail shorter than a record: ignored when reading,
//!   cut off before the next append.
//! - A record whose checksum is wrong is skipped; its image is embedded and appended anew.
//! - A header that is not the expected one: the file is started anew.
//!
//! Records are not synced to the device: a power cut loses recent ones or leaves rubbish, which the checksums
//! find.

use std::collections::{BTreeMap, HashMap};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::embedding::{ContentHash, Embedding};

const MAGIC: &[u8; 8] = b"MTembed1";
const HEADER_BYTES: usize = MAGIC.len() + 32 + 4;
const CONTENT_BYTES: usize = size_of::<ContentHash>();
const CHECKSUM_BYTES: usize = 8;

/// The file cannot be used; embeddings are kept in memory all the same.
#[derive(Debug, thiserror::Error)]
#[error("cannot {what} the embedding cache {path}: {source}")]
pub struct CacheError {
    what: &'static str,
    path: PathBuf,
    source: io::Error,
}

/// What was found in a cache's file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Found {
    /// Embeddings read.
    pub embeddings: usize,
    /// Records skipped because their checksum is wrong.
    pub damaged: usize,
    /// Bytes of an unfinished record at the end.
    pub torn_bytes: usize,
    /// Whether the file had another header and was started anew.
    pub restarted: bool,
}

/// Embeddings by image content.
#[derive(Debug)]
pub struct EmbeddingCache {
    known: HashMap<ContentHash, Embedding>,
    file: Option<RecordFile>,
}

impl EmbeddingCache {
    /// A cache without a file.
    pub fn in_memory() -> Self {
        Self { known: HashMap::new(), file: None }
    }

    /// Reads the file for `fingerprint` in `folder`, or begins it.
    ///
    /// # Errors
    /// When the folder or the file cannot be created, locked or read.
    pub fn open(
        folder: &Path,
        fingerprint: &[u8; 32],
        dimension: usize,
    ) -> Result<(Self, Found), CacheError> {
        let name: String = fingerprint[..8].iter().map(|byte| format!("{byte:02x}")).collect();
        let path = folder.join(format!("{name}.embeddings"));
        let failed = |what| {
            let path = path.clone();
            move |source| CacheError { what, path, source }
        };
        std::fs::create_dir_all(folder).map_err(failed("create"))?;
        let mut options = OpenOptions::new();
        let file = options.read(true).write(true).create(true).truncate(false).open(&path);
        let file = file.map_err(failed("open"))?;
        let mut file = RecordFile { file, path: path.clone(), dimension };
        let (known, found) = file.load(fingerprint).map_err(failed("read"))?;
        Ok((Self { known, file: Some(file) }, found))
    }

    /// The embedding of an image, if it is known.
    pub fn get(&self, content: &ContentHash) -> Option<&Embedding> {
        self.known.get(content)
    }

    /// How many are known.
    pub fn len(&self) -> usize {
        self.known.len()
    }

    /// Whether none is known.
    pub fn is_empty(&self) -> bool {
        self.known.is_empty()
    }

    /// Keeps an embedding.
    ///
    /// # Errors
    /// When it cannot be written. It is kept in memory all the same, and the file is not tried again.
    pub fn insert(&mut self, content: ContentHash, embedding: Embedding) -> Result<(), CacheError> {
        let written = match &mut self.file {
            Some(file) if !self.known.contains_key(&content) => file.append(&content, &embedding),
            _ => Ok(()),
        };
        self.known.insert(content, embedding);
        written.map_err(|source| {
            let path = self.file.take().map(|file| file.path).unwrap_or_default();
            CacheError { what: "write", path, source }
        })
    }
}

/// All embeddings of `dimension` that one encoder's file in `folder` holds, in the order of their content: of the
/// encoder that has most. None when there is no such file, or none that can be read.
pub fn stored(folder: &Path, dimension: usize) -> Vec<Embedding> {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = files.map(|file| file.path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "embeddings"));
    paths.sort();
    let mut most = Vec::new();
    for path in paths {
        let Ok(bytes) = std::fs::read(path) else { continue };
        let Some((header, records)) = bytes.split_at_checked(HEADER_BYTES) else { continue };
        if &header[..8] != MAGIC || header[40..] != (dimension as u32).to_le_bytes() {
            continue;
        }
        let size = CONTENT_BYTES + 4 * dimension + CHECKSUM_BYTES;
        let known: BTreeMap<ContentHash, Embedding> =
            records.chunks_exact(size).filter_map(decode).collect();
        if known.len() > most.len() {
            most = known.into_values().collect();
        }
    }
    most
}

#[derive(Debug)]
struct RecordFile {
    file: File,
    path: PathBuf,
    dimension: usize,
}

type Known = HashMap<ContentHash, Embedding>;

impl RecordFile {
    fn record_bytes(&self) -> usize {
        CONTENT_BYTES + 4 * self.dimension + CHECKSUM_BYTES
    }

    /// Reads everything; writes the header of a file that has none, or another.
    fn load(&mut self, fingerprint: &[u8; 32]) -> io::Result<(Known, Found)> {
        let mut header = [0; HEADER_BYTES];
        header[..8].copy_from_slice(MAGIC);
        header[8..40].copy_from_slice(fingerprint);
        header[40..].copy_from_slice(&(self.dimension as u32).to_le_bytes());

        let lock = Lock::take(&self.file)?;
        let mut bytes = Vec::new();
        (&self.file).read_to_end(&mut bytes)?;
        if bytes.get(..HEADER_BYTES) != Some(&header[..]) {
            self.file.set_len(0)?;
            (&self.file).rewind()?;
            (&self.file).write_all(&header)?;
            let found = Found { restarted: !bytes.is_empty(), ..Found::default() };
            return Ok((Known::new(), found));
        }
        drop(lock);

        let mut records = bytes[HEADER_BYTES..].chunks_exact(self.record_bytes());
        let (mut known, mut found) = (Known::new(), Found::default());
        for record in &mut records {
            match decode(record) {
                Some((content, embedding)) => _ = known.insert(content, embedding),
                None => found.damaged += 1,
            }
        }
        found.embeddings = known.len();
        found.torn_bytes = records.remainder().len();
        Ok((known, found))
    }

    /// Adds a record behind the last whole one, in one write.
    fn append(&mut self, content: &ContentHash, embedding: &Embedding) -> io::Result<()> {
        let record = encode(content, embedding);
        let _lock = Lock::take(&self.file)?;
        let end = (&self.file).seek(SeekFrom::End(0))?;
        let records = end.saturating_sub(HEADER_BYTES as u64);
        let torn = records % self.record_bytes() as u64;
        if torn > 0 {
            self.file.set_len(end - torn)?;
            (&self.file).seek(SeekFrom::Start(end - torn))?;
        }
        (&self.file).write_all(&record)
    }
}

/// The file's lock, while it lives.
struct Lock<'a>(&'a File);

impl<'a> Lock<'a> {
    fn take(file: &'a File) -> io::Result<Self> {
        file.lock()?;
        Ok(Self(file))
    }
}

impl Drop for Lock<'_> {
    fn drop(&mut self) {
        // The lock ends with the file at the latest.
        let _ = self.0.unlock();
    }
}

fn encode(content: &ContentHash, embedding: &Embedding) -> Vec<u8> {
    let mut record = content.to_vec();
    record.extend(embedding.as_slice().iter().flat_map(|value| value.to_le_bytes()));
    record.extend(checksum(&record));
    record
}

fn decode(record: &[u8]) -> Option<(ContentHash, Embedding)> {
    let (body, sum) = record.split_at_checked(record.len().checked_sub(CHECKSUM_BYTES)?)?;
    if checksum(body) != sum {
        return None;
    }
    let (content, vector) = body.split_first_chunk::<CONTENT_BYTES>()?;
    let values = vector.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    Some((*content, Embedding::restored(values)?))
}

fn checksum(body: &[u8]) -> [u8; CHECKSUM_BYTES] {
    let mut sum = [0; CHECKSUM_BYTES];
    sum.copy_from_slice(&blake3::hash(body).as_bytes()[..CHECKSUM_BYTES]);
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    const DIMENSION: usize = 5;
    const RECORD: usize = CONTENT_BYTES + 4 * DIMENSION + CHECKSUM_BYTES;
    const PRINT: [u8; 32] = [7; 32];

    fn embedding(seed: u8) -> Embedding {
        let raw: Vec<f32> = (0..DIMENSION).map(|i| f32::from(seed) + i as f32 + 1.0).collect();
        Embedding::normalised(&raw).unwrap()
    }

    fn open(folder: &Path) -> (EmbeddingCache, Found) {
        EmbeddingCache::open(folder, &PRINT, DIMENSION).unwrap()
    }

    /// A folder whose cache holds the embeddings of `0..count`, and the path of its file.
    fn filled(count: u8) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let (mut cache, found) = open(folder.path());
        assert_eq!(found, Found::default());
        for seed in 0..count {
            cache.insert([seed; 16], embedding(seed)).unwrap();
        }
        let path = cache.file.unwrap().path;
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
    fn what_was_kept_is_found_again_bit_for_bit() {
        let (folder, path) = filled(9);
        let (cache, found) = open(folder.path());
        assert_eq!(found, Found { embeddings: 9, ..Found::default() });
        assert_holds(&cache, 0..9);
        let length = std::fs::metadata(path).unwrap().len() as usize;
        assert_eq!(length, HEADER_BYTES + 9 * RECORD);
    }

    #[test]
    fn a_torn_write_at_any_byte_costs_that_record_only() {
        for cut in 1..RECORD {
            let (folder, path) = filled(3);
            let file = OpenOptions::new().write(true).open(&path).unwrap();
            file.set_len((HEADER_BYTES + 3 * RECORD - cut) as u64).unwrap();
            let (mut cache, found) = open(folder.path());
            let torn_bytes = RECORD - cut;
            assert_eq!(found, Found { embeddings: 2, torn_bytes, ..Found::default() });
            cache.insert([5; 16], embedding(5)).unwrap();
            let (cache, found) = open(folder.path());
            assert_eq!(found, Found { embeddings: 3, ..Found::default() });
            assert_holds(&cache, [0, 1, 5]);
        }
    }

    #[test]
    fn a_flipped_bit_anywhere_costs_that_record_only() {
        for byte in HEADER_BYTES + RECORD..HEADER_BYTES + 2 * RECORD {
            let (folder, path) = filled(3);
            let mut bytes = std::fs::read(&path).unwrap();
            bytes[byte] ^= 1 << (byte % 8);
            std::fs::write(&path, bytes).unwrap();
            let (mut cache, found) = open(folder.path());
            assert_eq!(found, Found { embeddings: 2, damaged: 1, ..Found::default() });
            assert_holds(&cache, [0, 2]);
            cache.insert([1; 16], embedding(1)).unwrap();
            assert_holds(&open(folder.path()).0, 0..3);
        }
    }

    #[test]
    fn another_encoder_has_another_file_and_a_foreign_header_is_not_believed() {
        let (folder, path) = filled(3);
        let (other, found) = EmbeddingCache::open(folder.path(), &[8; 32], DIMENSION).unwrap();
        assert!(other.is_empty() && found == Found::default());
        assert_holds(&open(folder.path()).0, 0..3);

        for byte in 0..HEADER_BYTES {
            let mut bytes = std::fs::read(&path).unwrap();
            bytes[byte] ^= 1;
            std::fs::write(&path, bytes).unwrap();
            let (mut cache, found) = open(folder.path());
            assert_eq!(found, Found { restarted: true, ..Found::default() }, "byte {byte}");
            cache.insert([4; 16], embedding(4)).unwrap();
            assert_holds(&open(folder.path()).0, [4]);
        }
    }

    #[test]
    fn what_is_stored_is_read_from_the_file_that_has_most_of_the_dimension() {
        let (folder, path) = filled(3);
        let (mut other, _) = EmbeddingCache::open(folder.path(), &[8; 32], DIMENSION).unwrap();
        other.insert([9; 16], embedding(9)).unwrap();
        let (mut wide, _) = EmbeddingCache::open(folder.path(), &[9; 32], 2).unwrap();
        for seed in 0..9 {
            wide.insert([seed; 16], Embedding::normalised(&[1.0, 2.0]).unwrap()).unwrap();
        }
        assert_eq!(stored(folder.path(), DIMENSION), [0, 1, 2].map(embedding));
        let file = OpenOptions::new().write(true).open(&path).unwrap();
        file.set_len((HEADER_BYTES + 2 * RECORD - 1) as u64).unwrap();
        assert_eq!(stored(folder.path(), DIMENSION).len(), 1);
        assert!(stored(folder.path(), 3).is_empty());
        assert!(stored(&folder.path().join("none"), DIMENSION).is_empty());
    }

    #[test]
    fn many_writers_at_once_lose_nothing() {
        let folder = tempfile::tempdir().unwrap();
        // An open file of its own is what the lock tells apart, so threads stand for processes.
        std::thread::scope(|scope| {
            for writer in 0..4_u8 {
                let folder = folder.path();
                scope.spawn(move || {
                    let (mut cache, _) = open(folder);
                    for seed in (0..200).filter(|seed| seed % 4 == writer) {
                        cache.insert([seed; 16], embedding(seed)).unwrap();
                    }
                });
            }
        });
        let (cache, found) = open(folder.path());
        assert_eq!(found, Found { embeddings: 200, ..Found::default() });
        assert_holds(&cache, 0..200);
    }

    #[test]
    fn without_a_place_to_write_there_is_an_error_and_memory_still_works() {
        let folder = tempfile::tempdir().unwrap();
        let blocked = folder.path().join("file");
        std::fs::write(&blocked, "").unwrap();
        let error = EmbeddingCache::open(&blocked, &PRINT, DIMENSION).unwrap_err().to_string();
        assert!(error.contains("cannot create the embedding cache"), "{error}");

        let (mut cache, _) = open(folder.path());
        // A file opened for reading only fails every append.
        let file = cache.file.as_mut().unwrap();
        file.file = File::open(&file.path).unwrap();
        assert!(cache.insert([1; 16], embedding(1)).is_err());
        cache.insert([2; 16], embedding(2)).unwrap();
        assert_holds(&cache, [1, 2]);
    }
}
