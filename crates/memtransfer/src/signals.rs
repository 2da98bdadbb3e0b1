//! SIGINT and SIGTERM: the first one asks to stop, a second one ends the program at once. SIGHUP, which a closed terminal
//! sends, asks to stop; it is sent more than once, so no later one ends the program.
//!
//! A second signal counts only some time after the first: `timeout` sends its signal to the process and to its group, and a
//! terminal's reaches both a program and the one that started it, which may pass it on.

use std::fs;
use std::io;
use std::process;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use shm_types::registry;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator;

/// Time after the first signal in which others are the same request.
const SAME_REQUEST: Duration = Duration::from_millis(500);

/// The signals received since [`Signals::listen`].
#[derive(Debug, Clone)]
pub(crate) struct Signals {
    stop: Arc<AtomicBool>,
    received: Arc<AtomicUsize>,
}

impl Signals {
    /// Starts to listen, on a thread of its own.
    ///
    /// # Errors
    /// When the system refuses.
    pub(crate) fn listen() -> io::Result<Self> {
        let mut listened = vec![SIGINT, SIGTERM];
        // Under nohup, the run is to go on without the terminal.
        if !is_ignored(SIGHUP) {
            listened.push(SIGHUP);
        }
        let mut arriving = iterator::Signals::new(listened)?;
        let signals = Self { stop: Arc::default(), received: Arc::default() };
        let own = signals.clone();
        thread::Builder::new().name("signals".to_owned()).spawn(move || {
            let mut first: Option<Instant> = None;
            loop {
                let arrived = arriving.wait();
                // Those that arrive together are one request, however long each takes.
                let now = Instant::now();
                for signal in arrived {
                    own.received.store(signal as usize, Ordering::Relaxed);
                    own.stop.store(true, Ordering::Relaxed);
                    if is_another_request(signal, *first.get_or_insert(now), now) {
                        end_at_once(signal);
                    }
                }
            }
        })?;
        Ok(signals)
    }

    /// Set once a signal asks to stop.
    pub(crate) fn stop(&self) -> &AtomicBool {
        &self.stop
    }

    /// The last signal, if there was one.
    pub(crate) fn received(&self) -> Option<u8> {
        u8::try_from(self.received.load(Ordering::Relaxed)).ok().filter(|&signal| signal != 0)
    }
}

/// Whether the signal is not the same request as the first one.
fn is_another_request(signal: i32, first: Instant, now: Instant) -> bool {
    signal != SIGHUP && now.duration_since(first) >= SAME_REQUEST
}

/// Ends the program: the children first, so that nothing of a run is left. Not by the signal itself, which the kernel ignores
/// where this is the first process of a container.
fn end_at_once(signal: i32) -> ! {
    let signal = u8::try_from(signal).unwrap_or_default();
    say!("ended at once by a second {}", name(signal));
    supervise::kill_all();
    if let Err(error) = registry::abandon_own_runs() {
        say!("`memtransfer clean` removes the rest of the run: {error}");
    }
    process::exit(i32::from(128_u8.saturating_add(signal)))
}

/// The name of a signal that [`Signals`] listens to.
pub(crate) fn name(signal: u8) -> &'static str {
    match i32::from(signal) {
        SIGHUP => "SIGHUP",
        SIGINT => "SIGINT",
        SIGTERM => "SIGTERM",
        _ => "a signal",
    }
}

/// Whether this process ignores the signal, as a program does that `nohup` started.
fn is_ignored(signal: i32) -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_later_signal_is_another_request_and_a_hangup_never() {
        let first = Instant::now();
        for (signal, after_ms, is_another) in [
            (SIGTERM, 0, false),
            (SIGINT, 499, false),
            (SIGINT, 500, true),
            (SIGTERM, 60_000, true),
            (SIGHUP, 60_000, false),
        ] {
            let now = first + Duration::from_millis(after_ms);
            assert_eq!(
                is_another_request(signal, first, now),
                is_another,
                "{signal}, {after_ms} ms"
            );
        }
    }
}
