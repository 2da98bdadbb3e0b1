//! `memory-proc profile`: how long a search of a memory takes, against the memory's size.
//!
//! Every line that is printed is one measurement: a kind of search, a size, and so many queries asked at once.
//! Nothing is compared with anything here, and nothing is asserted.

use std::io::Write;
use std::num::NonZeroUsize;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use hdrhistogram::Histogram;
use serde::Serialize;

use crate::embedding::Embedding;
use crate::index::{Approximate, Builder, Effort, Entry, Index, Nearest, Query};
pub use search::vectors::Vectors;

/// Queries at once, of the two measurements of each size.
const BATCHES: [usize; 2] = [1, 64];

/// Vectors that are made at once while a memory is filled.
const FILLED: usize = 16_384;

/// What to measure.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Sizes of the memory.
    pub entries: Vec<u32>,
    /// Whether to measure the exact search.
    pub exact: bool,
    /// Whether to measure the approximate one.
    pub approximate: bool,
    /// How the graph of the approximate search is built.
    pub effort: Effort,
    /// Nodes that are kept in sight while it is walked: one measurement each.
    pub searching: Vec<usize>,
    /// Most queries of a measurement.
    pub queries: usize,
    /// Longest that a measurement takes, in seconds.
    pub seconds: f64,
    /// Most threads of a search.
    pub threads: NonZeroUsize,
}

/// One measurement.
#[derive(Debug, Clone, Serialize)]
pub struct Line {
    /// Size of the memory.
    pub entries: u32,
    /// Numbers of a vector.
    pub dimension: usize,
    /// How many of the entries are embeddings of pictures.
    pub real: u32,
    /// `exact` or `approximate`.
    pub search: &'static str,
    /// Nodes of a graph that were kept in sight; absent where there is no graph.
    pub searching: Option<usize>,
    /// Queries asked at once.
    pub batch: usize,
    /// Threads of the search.
    pub threads: usize,
    /// Seconds that it took to make the memory ready, its vectors given.
    pub build_s: f64,
    /// Bytes that the memory takes.
    pub bytes: usize,
    /// Queries that were asked.
    pub queries: usize,
    /// How long a batch took, in nanoseconds.
    pub latency_ns: Latency,
    /// Queries answered in a second.
    pub queries_per_s: f64,
    /// Bytes read from end to end in a second; absent where a search does not read from end to end.
    pub bytes_per_s: Option<f64>,
    /// Share of queries whose nearest entry was found.
    pub recall_at_1: f64,
    /// Share of the queries' ten nearest entries that were found.
    pub recall_at_10: f64,
}

/// How long something took.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Latency {
    /// The median.
    pub p50: u64,
    /// Of a hundred, ten took longer.
    pub p90: u64,
    /// Of a hundred, one took longer.
    pub p99: u64,
    /// Of a thousand, one took longer.
    pub p999: u64,
    /// The longest.
    pub max: u64,
}

/// Measures, and writes a JSON object a line as soon as it is there.
///
/// # Errors
/// When a memory does not fit into the machine's, or nothing can be written.
pub fn run(settings: &Settings, vectors: &Vectors, out: &mut impl Write) -> anyhow::Result<()> {
    for &entries in &settings.entries {
        fits(entries, vectors.dimension())?;
        let begun = Instant::now();
        let index = fill(entries, vectors, settings.threads).with_threads(settings.threads);
        tracing::info!(entries, seconds = begun.elapsed().as_secs_f64(), "filled");
        let wanted = settings.queries.min(QUERIES);
        let queries: Vec<Embedding> =
            (0..wanted).map(|number| vectors.query(number, entries)).collect();
        let size = Size { settings, vectors, entries, index: &index, queries: &queries };
        if settings.exact {
            size.exact(out)?;
        }
        if settings.approximate {
            size.approximate(out)?;
        }
    }
    Ok(())
}

/// What is measured of a memory of one size.
struct Size<'a> {
    settings: &'a Settings,
    vectors: &'a Vectors,
    entries: u32,
    index: &'a Index,
    queries: &'a [Embedding],
}

impl Size<'_> {
    fn exact(&self, out: &mut impl Write) -> anyhow::Result<()> {
        let begun = Instant::now();
        self.index.prepare();
        let build_s = begun.elapsed().as_secs_f64();
        for batch in BATCHES {
            let taken = Taken::of(batch, self.settings, self.queries, |queries| {
                std::hint::black_box(self.index.nearest_of_many(queries, 1));
                Ok(())
            })?;
            let scanned = self.index.scanned_bytes(batch) as f64;
            let line = taken.line(Line {
                bytes_per_s: Some(scanned * taken.batches_per_s()),
                threads: self.index.threads(batch),
                build_s,
                bytes: self.index.bytes(),
                ..Line::of(self.entries, self.vectors)
            });
            print(&line, out)?;
        }
        Ok(())
    }

    fn approximate(&self, out: &mut impl Write) -> anyhow::Result<()> {
        let threads = self.settings.threads;
        let begun = Instant::now();
        let mut graph = Approximate::new(self.index, self.settings.effort, threads)?;
        let build_s = begun.elapsed().as_secs_f64();
        for &searching in &self.settings.searching {
            graph.set_searching(searching);
            let (recall_at_1, recall_at_10) = self.recall(&graph)?;
            for batch in BATCHES {
                let taken = Taken::of(batch, self.settings, self.queries, |queries| {
                    std::hint::black_box(graph.nearest_of_many(queries, 1)?);
                    Ok(())
                })?;
                let line = taken.line(Line {
                    search: "approximate",
                    searching: Some(searching),
                    threads: if batch == 1 { 1 } else { threads.get() },
                    build_s,
                    bytes: self.index.bytes() + graph.bytes(),
                    recall_at_1,
                    recall_at_10,
                    ..Line::of(self.entries, self.vectors)
                });
                print(&line, out)?;
            }
        }
        Ok(())
    }

    /// The shares of the nearest view and of the ten nearest views that a graph finds, over some queries.
    fn recall(&self, graph: &Approximate<'_>) -> anyhow::Result<(f64, f64)> {
        let queries: Vec<Query<'_>> = self.queries.iter().take(RECALLED).map(query).collect();
        let exact = self.index.nearest_of_many(&queries, 10);
        let (ones, tens) =
            (graph.nearest_of_many(&queries, 1)?, graph.nearest_of_many(&queries, 10)?);
        let found = |mostly: &[Vec<Nearest>], wanted: usize| {
            let both = exact.iter().zip(mostly);
            let share = |(exact, mostly): (&Vec<Nearest>, &Vec<Nearest>)| {
                let exact = &exact[..exact.len().min(wanted)];
                let found = exact.iter().filter(|near| mostly.contains(near)).count();
                found as f64 / exact.len().max(1) as f64
            };
            both.map(share).sum::<f64>() / queries.len().max(1) as f64
        };
        Ok((found(&ones, 1), found(&tens, 10)))
    }
}

fn print(line: &Line, out: &mut impl Write) -> anyhow::Result<()> {
    serde_json::to_writer(&mut *out, line)?;
    writeln!(out)?;
    out.flush().context("cannot write")
}

fn query(embedding: &Embedding) -> Query<'_> {
    Query { embedding, stage: 0, elapsed: 0 }
}

/// Writes the vectors of a memory of `entries` and of some queries, as little-endian numbers.
///
/// # Errors
/// When nothing can be written.
pub fn write(
    vectors: &Vectors,
    entries: u32,
    queries: usize,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    let mut put = |vector: &Embedding| {
        vector.as_slice().iter().try_for_each(|number| out.write_all(&number.to_le_bytes()))
    };
    for number in 0..entries {
        put(&vectors.entry(number)).context("cannot write")?;
    }
    for number in 0..queries {
        put(&vectors.query(number, entries)).context("cannot write")?;
    }
    out.flush().context("cannot write")
}

/// Different queries of a measurement; after these it begins again.
const QUERIES: usize = 4096;

/// Queries over which recall is taken.
const RECALLED: usize = 1000;

/// Checks that a memory has room before the system finds that it has none.
fn fits(entries: u32, dimension: usize) -> anyhow::Result<()> {
    // Besides the numbers: codes, a scale and a half length, a place in the order, an entry, twice while it is built.
    let each = dimension.next_multiple_of(16) * 4 + dimension.next_multiple_of(64) + 8 + 4 + 2 * 12;
    let needed = entries as usize * each;
    let read = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = read.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let Some(free) = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse().ok())
    else {
        return Ok(());
    };
    let free: usize = free;
    if needed > free * 1024 / 20 * 19 {
        let gib = |bytes: usize| bytes as f64 / f64::from(1 << 30);
        bail!(
            "a memory of {entries} vectors of {dimension} takes {:.1} GiB, and {:.1} GiB are free; ask for fewer --entries",
            gib(needed),
            gib(free * 1024)
        );
    }
    Ok(())
}

/// A memory of `entries`, its vectors made by several threads.
fn fill(entries: u32, vectors: &Vectors, threads: NonZeroUsize) -> Index {
    let mut builder = Builder::with_capacity(vectors.dimension(), entries as usize);
    for first in (0..entries).step_by(FILLED) {
        let numbers: Vec<u32> = (first..entries.min(first + FILLED as u32)).collect();
        let share = numbers.len().div_ceil(threads.get());
        let made = std::thread::scope(|scope| {
            let make = |numbers: &[u32]| -> Vec<Embedding> {
                numbers.iter().map(|&number| vectors.entry(number)).collect()
            };
            let threads: Vec<_> =
                numbers.chunks(share).map(|numbers| scope.spawn(move || make(numbers))).collect();
            let join = |thread: std::thread::ScopedJoinHandle<'_, _>| match thread.join() {
                Ok(made) => made,
                Err(panic) => std::panic::resume_unwind(panic),
            };
            threads.into_iter().flat_map(join).collect::<Vec<_>>()
        });
        for (number, embedding) in numbers.into_iter().zip(made) {
            builder.add_distinct(entry(number), embedding.as_slice());
        }
    }
    builder.build()
}

fn entry(number: u32) -> Entry {
    Entry { demonstration: (number >> 16) as u16, step: number as u16, stage: 0 }
}

/// How long batches took.
struct Taken {
    batch: usize,
    times: Histogram<u64>,
    sum: Duration,
}

impl Taken {
    /// Asks batches of queries until there were enough.
    fn of(
        batch: usize,
        settings: &Settings,
        queries: &[Embedding],
        mut ask: impl FnMut(&[Query<'_>]) -> anyhow::Result<()>,
    ) -> anyhow::Result<Self> {
        let mut times = Histogram::new(3).context("a histogram")?;
        times.auto(true);
        let mut taken = Self { batch, times, sum: Duration::ZERO };
        let queries: Vec<Query<'_>> =
            queries.iter().cycle().take(queries.len().max(batch)).map(query).collect();
        let batches = queries.chunks_exact(batch);
        let warm = Instant::now();
        for batch in batches.clone().take(100) {
            ask(batch)?;
            if warm.elapsed().as_secs_f64() > settings.seconds / 10.0 {
                break;
            }
        }
        let most = settings.queries.div_ceil(batch);
        for batch in batches.cycle().take(most) {
            let begun = Instant::now();
            ask(batch)?;
            let took = begun.elapsed();
            taken.times.record(took.as_nanos() as u64).context("a time beyond measure")?;
            taken.sum += took;
            if taken.sum.as_secs_f64() > settings.seconds {
                break;
            }
        }
        Ok(taken)
    }

    fn batches_per_s(&self) -> f64 {
        self.times.len() as f64 / self.sum.as_secs_f64().max(f64::MIN_POSITIVE)
    }

    fn line(&self, rest: Line) -> Line {
        let at = |quantile| self.times.value_at_quantile(quantile);
        Line {
            batch: self.batch,
            queries: self.times.len() as usize * self.batch,
            queries_per_s: self.batches_per_s() * self.batch as f64,
            latency_ns: Latency {
                p50: at(0.5),
                p90: at(0.9),
                p99: at(0.99),
                p999: at(0.999),
                max: self.times.max(),
            },
            ..rest
        }
    }
}

impl Line {
    /// Of an exact search that was not measured yet.
    fn of(entries: u32, vectors: &Vectors) -> Self {
        Self {
            entries,
            dimension: vectors.dimension(),
            real: vectors.real(entries),
            search: "exact",
            searching: None,
            batch: 0,
            threads: 1,
            build_s: 0.0,
            bytes: 0,
            queries: 0,
            latency_ns: Latency { p50: 0, p90: 0, p99: 0, p999: 0, max: 0 },
            queries_per_s: 0.0,
            bytes_per_s: None,
            recall_at_1: 1.0,
            recall_at_10: 1.0,
        }
    }
}
