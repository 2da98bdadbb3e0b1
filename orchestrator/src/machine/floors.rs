//! The floors of a machine: figures that no program on it can beat.
//!
//! Each is measured without any other code of the project.

use std::hint::{black_box, spin_loop};
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Instant;

use serde::{Deserialize, Serialize};
use shm_types::FrameSize;

/// The machine's floors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Floors {
    /// Nanoseconds that a cache line takes from one core to another: half a round trip between two threads that only
    /// poll.
    pub cache_line_ns: f64,
    /// Nanoseconds to copy a frame of 448 x 448 pixels in memory.
    pub frame_copy_ns: f64,
    /// Bytes per second that one thread reads from memory.
    pub read_one_thread: f64,
    /// Bytes per second that all cores read from memory together.
    pub read_all_cores: f64,
}

/// How much is measured.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Round trips of a cache line.
    pub trips: u64,
    /// Copies of a frame.
    pub copies: u32,
    /// Bytes that are read: several times what caches hold.
    pub bytes: usize,
    /// How often they are read; the fastest pass counts.
    pub passes: u32,
}

impl Effort {
    /// For figures: about two seconds.
    pub const FULL: Self = Self { trips: 300_000, copies: 500, bytes: 1 << 30, passes: 3 };
    /// For tests.
    pub const TINY: Self = Self { trips: 1000, copies: 3, bytes: 8 << 20, passes: 1 };
}

/// Measures all of them.
///
/// # Errors
/// When the system starts no more threads.
pub fn measure(effort: Effort) -> io::Result<Floors> {
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let [read_one_thread, read_all_cores] =
        read_bandwidth([1, cores], effort.bytes, effort.passes)?;
    Ok(Floors {
        cache_line_ns: cache_line_ns(effort.trips)?,
        frame_copy_ns: frame_copy_ns(effort.copies),
        read_one_thread,
        read_all_cores,
    })
}

/// A counter on a cache line of its own, and on the one beside it, which processors fetch along with it.
#[repr(align(128))]
struct CacheLine(AtomicU64);

/// Half the time in which a line goes to another thread and an answer comes back, over `trips` round trips.
///
/// # Errors
/// When the system starts no more threads.
pub fn cache_line_ns(trips: u64) -> io::Result<f64> {
    let (there, back) = (CacheLine(AtomicU64::new(0)), CacheLine(AtomicU64::new(0)));
    let await_value = |line: &CacheLine, value: u64| {
        while line.0.load(Ordering::Acquire) != value {
            spin_loop();
        }
    };
    thread::scope(|scope| {
        thread::Builder::new().spawn_scoped(scope, || {
            for trip in 1..=trips {
                await_value(&there, trip);
                back.0.store(trip, Ordering::Release);
            }
        })?;
        let mut began = Instant::now();
        // The first trips are not counted: the other thread has to be running.
        let warm = trips / 10;
        for trip in 1..=trips {
            if trip == warm + 1 {
                began = Instant::now();
            }
            there.0.store(trip, Ordering::Release);
            await_value(&back, trip);
        }
        Ok(began.elapsed().as_nanos() as f64 / (trips - warm) as f64 / 2.0)
    })
}

/// The median time to copy a frame, source and destination both warm.
pub fn frame_copy_ns(copies: u32) -> f64 {
    let source = vec![7_u8; FrameSize::DEFAULT.bytes()];
    let mut destination = vec![0_u8; source.len()];
    let mut times: Vec<f64> = (0..copies.max(1))
        .map(|_| {
            let began = Instant::now();
            black_box(&mut destination).copy_from_slice(black_box(&source));
            black_box(&destination);
            began.elapsed().as_nanos() as f64
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// The bandwidth of reading with each of these numbers of threads, in bytes per second: the fastest of `passes` over
/// `bytes`.
///
/// # Errors
/// When the system starts no more threads.
pub fn read_bandwidth<const N: usize>(
    threads: [usize; N],
    bytes: usize,
    passes: u32,
) -> io::Result<[f64; N]> {
    // Not zero, so that every page is mapped.
    let data = vec![1_u64; bytes / size_of::<u64>()];
    let mut fastest = [0.0_f64; N];
    for (fastest, threads) in fastest.iter_mut().zip(threads) {
        let share = data.len().div_ceil(threads.max(1)).max(1);
        for _ in 0..passes.max(1) {
            let began = Instant::now();
            thread::scope(|scope| {
                data.chunks(share).try_for_each(|part| {
                    let sum = move || black_box(sum(part));
                    thread::Builder::new().spawn_scoped(scope, sum).map(drop)
                })
            })?;
            let bytes = size_of_val(data.as_slice()) as f64;
            *fastest = fastest.max(bytes / began.elapsed().as_secs_f64());
        }
    }
    Ok(fastest)
}

/// A sum in eight lanes, which the compiler turns into wide loads with nothing to wait for but memory.
fn sum(words: &[u64]) -> u64 {
    let mut lanes = [0_u64; 8];
    let (chunks, rest) = words.as_chunks::<8>();
    for chunk in chunks {
        for (lane, word) in lanes.iter_mut().zip(chunk) {
            *lane = lane.wrapping_add(*word);
        }
    }
    lanes.iter().chain(rest).fold(0, |sum, word| sum.wrapping_add(*word))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_include_every_word() {
        for len in [0, 1, 7, 8, 9, 40] {
            let words: Vec<u64> = (1..=len).collect();
            assert_eq!(sum(&words), len * (len + 1) / 2);
        }
    }

    #[test]
    fn every_floor_is_a_positive_number() {
        let Floors { cache_line_ns, frame_copy_ns, read_one_thread, read_all_cores } =
            measure(Effort::TINY).unwrap();
        for figure in [cache_line_ns, frame_copy_ns, read_one_thread, read_all_cores] {
            assert!(figure.is_finite() && figure > 0.0, "{figure}");
        }
    }
}
