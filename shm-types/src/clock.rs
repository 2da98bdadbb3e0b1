//! The clock of a run's processes, and waiting.
//!
//! The processes of a run measure time limits and wait with what is here, and not with the standard library. A drill
//! can therefore execute all of them in one program, one at a time, in an order and with a clock of its own
//! ([`Simulation`]). Everywhere else this is CLOCK_MONOTONIC and the operating system's scheduler.

use std::ops::Add;
use std::sync::OnceLock;
use std::thread;
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

use crate::message::Role;

/// The process whose listener waits: its role and, for a world or an external memory, its index.
pub type Waiter = (Role, u8);

/// Takes the place of the operating system's clock and scheduler for some threads of this program.
pub trait Simulation: Send + Sync {
    /// Nanoseconds of its clock; `None` on a thread that it does not schedule.
    fn now_ns(&self) -> Option<u64>;

    /// Called before a message or notification is sent or received: another process may run first.
    fn pause(&self);

    /// Whether the queue that a message is about to be sent to counts as full.
    fn is_queue_full(&self, service: &'static str) -> bool;

    /// Waits until its clock has advanced by `time`, or until `waiter` is notified. Returns `false`, without waiting, on a
    /// thread that it does not schedule.
    fn wait(&self, waiter: Option<Waiter>, time: Duration) -> bool;

    /// Ends the waiting of `waiter`.
    fn notify(&self, waiter: Waiter);
}

static SIMULATION: OnceLock<Box<dyn Simulation>> = OnceLock::new();

/// Lets `simulation` schedule threads of this program from now on. Returns `false` if another one does already.
pub fn simulate(simulation: Box<dyn Simulation>) -> bool {
    SIMULATION.set(simulation).is_ok()
}

/// Nanoseconds of CLOCK_MONOTONIC: one scale over all processes of the machine, never 0.
pub fn monotonic_ns() -> u64 {
    if let Some(now_ns) = SIMULATION.get().and_then(|simulation| simulation.now_ns()) {
        return now_ns;
    }
    let now = clock_gettime(ClockId::Monotonic);
    (now.tv_sec as u64).wrapping_mul(1_000_000_000).wrapping_add(now.tv_nsec as u64)
}

/// Waits for `time`.
pub fn sleep(time: Duration) {
    if !SIMULATION.get().is_some_and(|simulation| simulation.wait(None, time)) {
        thread::sleep(time);
    }
}

/// Called before a message or notification is sent or received; does nothing outside a simulation.
pub(crate) fn pause() {
    if let Some(simulation) = SIMULATION.get() {
        simulation.pause();
    }
}

/// Whether a simulation schedules the calling thread.
pub fn is_simulated() -> bool {
    SIMULATION.get().is_some_and(|simulation| simulation.now_ns().is_some())
}

/// Whether a simulation lets the queue of `service` count as full.
pub(crate) fn is_simulated_queue_full(service: &'static str) -> bool {
    SIMULATION.get().is_some_and(|simulation| simulation.is_queue_full(service))
}

/// In a simulation, waits as [`Simulation::wait`] does. Elsewhere returns `false` at once.
pub(crate) fn simulated_wait(waiter: Waiter, time: Duration) -> bool {
    SIMULATION.get().is_some_and(|simulation| simulation.wait(Some(waiter), time))
}

/// In a simulation, ends the waiting of `waiter`.
pub(crate) fn simulated_notify(waiter: Waiter) {
    if let Some(simulation) = SIMULATION.get() {
        simulation.notify(waiter);
    }
}

/// A point in time, as [`std::time::Instant`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Instant {
    ns: u64,
}

impl Instant {
    /// The present.
    pub fn now() -> Self {
        Self { ns: monotonic_ns() }
    }

    /// The time since then; zero if it is in the future.
    pub fn elapsed(self) -> Duration {
        Duration::from_nanos(monotonic_ns().saturating_sub(self.ns))
    }
}

impl Add<Duration> for Instant {
    type Output = Self;

    fn add(self, time: Duration) -> Self {
        let ns = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        Self { ns: self.ns.saturating_add(ns) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_runs() {
        let first = monotonic_ns();
        assert!(first > 0 && monotonic_ns() >= first);
        assert!(!is_simulated() && !is_simulated_queue_full("x"));
        let (then, time) = (Instant::now(), Duration::from_millis(1));
        sleep(time);
        assert!(then.elapsed() >= time && then + time <= Instant::now());
        assert_eq!((Instant::now() + Duration::MAX).elapsed(), Duration::ZERO);
    }
}
