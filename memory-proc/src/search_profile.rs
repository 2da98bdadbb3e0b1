//! `memory-proc profile`: how long a search takes, by the size of the memory.
//!
//! Prints one measurement per line: a size of the memory, and a number of queries in one call.

use std::io::Write;
use std::num::NonZeroUsize;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use domain::search_profile::{SearchLatency, SearchMeasurement};
use hdrhistogram::Histogram;
use search::synthetic::SyntheticVectors;
use search::{Embedding, Index, IndexBuilder, SearchQuery, ViewEntry};

/// Queries in one call, for the two measurements of each size.
const BATCHES: [usize; 2] = [1, 64];

/// Distinct queries of a measurement; they are repeated.
const QUERIES: usize = 4096;

/// Vectors generated together while a memory is filled.
const FILL_CHUNK: usize = 16_384;

/// What to measure.
#[derive(Debug, Clone)]
pub struct ProfileSettings {
    /// Sizes of the memory.
    pub entries: Vec<u32>,
    /// Maximum number of queries in a measurement.
    pub queries: usize,
    /// Maximum duration of a measurement, in seconds.
    pub seconds: f64,
    /// Maximum number of threads of a search.
    pub threads: NonZeroUsize,
}

/// Measures, and writes each measurement as a line of JSON as soon as it is finished.
///
/// # Errors
/// When a memory does not fit into this machine's, or a line cannot be written.
pub fn run(
    settings: &ProfileSettings,
    vectors: &SyntheticVectors,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    for &entries in &settings.entries {
        check_memory(entries, vectors.dimension())?;
        let index = fill(entries, vectors, settings.threads)?.with_threads(settings.threads);
        let count = settings.queries.min(QUERIES);
        let queries: Vec<Embedding> =
            (0..count).map(|number| vectors.query(number, entries)).collect();
        let begun = Instant::now();
        index.prepare();
        let build_s = begun.elapsed().as_secs_f64();
        for batch in BATCHES {
            let (times, seconds) = time(settings, &index, &queries, batch)?;
            let calls = times.len() as f64;
            let at = |quantile| times.value_at_quantile(quantile);
            let measured = SearchMeasurement {
                entries,
                dimension: vectors.dimension(),
                real: vectors.real(entries),
                batch,
                threads: index.threads(batch),
                build_s,
                bytes: index.bytes(),
                queries: times.len() as usize * batch,
                latency_ns: SearchLatency {
                    p50: at(0.5),
                    p90: at(0.9),
                    p99: at(0.99),
                    p999: at(0.999),
                    max: times.max(),
                },
                queries_per_s: calls * batch as f64 / seconds,
                bytes_per_s: calls * index.scanned_bytes(batch) as f64 / seconds,
            };
            serde_json::to_writer(&mut *out, &measured)?;
            writeln!(out)?;
            out.flush().context("cannot write to standard output")?;
        }
    }
    Ok(())
}

/// Times searches of `batch` queries in one call: the times in nanoseconds, and their sum in seconds.
fn time(
    settings: &ProfileSettings,
    index: &Index,
    queries: &[Embedding],
    batch: usize,
) -> anyhow::Result<(Histogram<u64>, f64)> {
    let query = |embedding| SearchQuery { embedding, stage: 0, elapsed: 0 };
    let embeddings = queries.iter().map(Embedding::as_slice).cycle();
    let queries: Vec<SearchQuery<'_>> =
        embeddings.take(queries.len().max(batch)).map(query).collect();
    let batches = queries.chunks_exact(batch);
    let search = |batch| std::hint::black_box(index.nearest_of_many(batch, 1));
    let warm_up = Instant::now();
    for batch in batches.clone().take(100) {
        search(batch);
        if warm_up.elapsed().as_secs_f64() > settings.seconds / 10.0 {
            break;
        }
    }
    let mut times = Histogram::<u64>::new(3).context("cannot make a histogram")?;
    times.auto(true);
    let mut sum = Duration::ZERO;
    for batch in batches.cycle().take(settings.queries.div_ceil(batch)) {
        let begun = Instant::now();
        search(batch);
        let time = begun.elapsed();
        times
            .record(time.as_nanos() as u64)
            .context("a search took longer than the histogram can record")?;
        sum += time;
        if sum.as_secs_f64() > settings.seconds {
            break;
        }
    }
    Ok((times, sum.as_secs_f64().max(f64::MIN_POSITIVE)))
}

/// Writes the vectors of a memory of `entries`, then those of some queries, as little-endian numbers.
///
/// # Errors
/// When they cannot be written.
pub fn write_vectors(
    vectors: &SyntheticVectors,
    entries: u32,
    queries: usize,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    let entry_vectors = (0..entries).map(|number| vectors.entry(number));
    let query_vectors = (0..queries).map(|number| vectors.query(number, entries));
    for vector in entry_vectors.chain(query_vectors) {
        for number in vector.as_slice() {
            out.write_all(&number.to_le_bytes()).context("cannot write to standard output")?;
        }
    }
    out.flush().context("cannot write to standard output")
}

/// Checks that a memory fits before it is filled.
fn check_memory(entries: u32, dimension: usize) -> anyhow::Result<()> {
    // Beside the numbers: codes, a scale and a half norm, an index of the row, and an entry, twice while it is built.
    let each = dimension.next_multiple_of(16) * 4 + dimension.next_multiple_of(8) + 8 + 4 + 2 * 12;
    let needed = entries as usize * each;
    let meminfo = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let available = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse().ok());
    let Some(available) = available.map(|kib: usize| kib * 1024) else { return Ok(()) };
    if needed > available / 20 * 19 {
        let gib = |bytes: usize| bytes as f64 / f64::from(1 << 30);
        bail!(
            "a memory of {entries} vectors of {dimension} numbers needs {:.1} GiB, and {:.1} GiB are available: pass \
             smaller --entries",
            gib(needed),
            gib(available)
        );
    }
    Ok(())
}

/// A memory of `entries`, whose vectors are generated on several threads.
fn fill(entries: u32, vectors: &SyntheticVectors, threads: NonZeroUsize) -> anyhow::Result<Index> {
    let mut builder = IndexBuilder::with_capacity(vectors.dimension(), entries as usize);
    for first in (0..entries).step_by(FILL_CHUNK) {
        let numbers: Vec<u32> = (first..entries.min(first + FILL_CHUNK as u32)).collect();
        let share = numbers.len().div_ceil(threads.get());
        let generated = std::thread::scope(|scope| {
            let generate = |numbers: &[u32]| -> Vec<Embedding> {
                numbers.iter().map(|&number| vectors.entry(number)).collect()
            };
            let threads: Vec<_> = numbers
                .chunks(share)
                .map(|numbers| {
                    std::thread::Builder::new().spawn_scoped(scope, move || generate(numbers))
                })
                .collect::<std::io::Result<_>>()?;
            let join = |thread: std::thread::ScopedJoinHandle<'_, _>| match thread.join() {
                Ok(generated) => generated,
                Err(panic) => std::panic::resume_unwind(panic),
            };
            Ok::<_, std::io::Error>(threads.into_iter().flat_map(join).collect::<Vec<_>>())
        });
        let generated = generated.context("cannot start a thread")?;
        for (number, embedding) in numbers.into_iter().zip(generated) {
            let entry =
                ViewEntry { demonstration: (number >> 16) as u16, step: number as u16, stage: 0 };
            builder.add_distinct(entry, embedding.as_slice());
        }
    }
    Ok(builder.build())
}
