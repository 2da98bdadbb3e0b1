//! Sleeping until there is work, and waking a neighbour.
//!
//! Every role has one event service with one [`Listener`], its own, and a [`Notifier`] in each process that
//! sends to it. A process that has put messages into a neighbour's queues notifies it once, however many
//! messages there are.
//!
//! # Why no notification is lost
//! 1. A sender queues its messages *before* it notifies.
//! 2. A notification stays pending until [`Listener::wait`] takes it, and `wait` returns after taking one;
//!    notifications that arrive before that are merged into it.
//! 3. A process drains *all* its queues before its first wait and after every wait, whatever the wait returned.
//!
//! A message that was queued before its notification was taken is found by 3. One whose notification comes later
//! ends the next wait by 2. The listener exists before the process's first receiver
//! ([`Bus::join`](crate::Bus::join)), so no message can arrive before there is a listener to notify. A wait may also
//! return without a notification: it is only a hint to look at the queues.

use std::mem::ManuallyDrop;
use std::time::Duration;

use iceoryx2::node::Node;
use iceoryx2::port::listener::{ListenerCreateError, ListenerWaitError};
use iceoryx2::port::{listener, notifier};
use iceoryx2::service::port_factory::event::PortFactory;

use crate::attach::Attach;
use crate::clock::{self, Instant, Waiter};
use crate::message::Role;
use crate::panics;
use crate::transport::{BusError, Ipc, service_name};

/// Shortest sleep: the operating system takes a socket timeout of zero as "no timeout".
const SHORTEST_SLEEP: Duration = Duration::from_millis(1);

/// Receives the notifications for one role.
#[derive(Debug)]
pub struct Listener {
    port: ManuallyDrop<listener::Listener<Ipc>>,
    waiter: Waiter,
    spin: Duration,
}

impl Drop for Listener {
    fn drop(&mut self) {
        #[expect(
            unsafe_code,
            reason = "a destructor that may panic is called in a place of its own"
        )]
        // SAFETY: called once, and the port is not used afterwards.
        let was_removed =
            panics::caught(|| unsafe { ManuallyDrop::drop(&mut self.port) }).is_some();
        if !was_removed {
            tracing::warn!(
                "the {}'s socket could not be removed; it stays until the run is removed",
                self.waiter.0.word()
            );
        }
    }
}

impl Listener {
    pub(crate) fn new(node: &Node<Ipc>, attach: &Attach, waiter: Waiter) -> Result<Self, BusError> {
        panics::prepare();
        let role = waiter.0;
        let port = service(node, attach, waiter)?.listener_builder().create();
        let port = port.map_err(|error| match error {
            ListenerCreateError::ExceedsMaxSupportedListeners => BusError::Taken { role },
            e => BusError::open(format_args!("cannot listen to events of the {}", role.word()), e),
        })?;
        let port = ManuallyDrop::new(port);
        Ok(Self { port, waiter, spin: Duration::from_micros(attach.wait.spin_us.into()) })
    }

    /// Waits for a notification, about `timeout` at most, and takes all that are pending. Returns whether there was
    /// one; drain all queues either way. A signal ends the wait early.
    ///
    /// Polls for [`Wait::spin_us`](crate::attach::Wait::spin_us) before it sleeps.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn wait(&self, timeout: Duration) -> Result<bool, BusError> {
        let start = Instant::now();
        loop {
            if self.take(None)? {
                return Ok(true);
            }
            if start.elapsed() >= self.spin.min(timeout) {
                break;
            }
            std::hint::spin_loop();
        }
        match timeout.saturating_sub(start.elapsed()) {
            Duration::ZERO => Ok(false),
            rest if clock::simulated_wait(self.waiter, rest) => self.take(None),
            rest => self.take(Some(rest.max(SHORTEST_SLEEP))),
        }
    }

    fn take(&self, timeout: Option<Duration>) -> Result<bool, BusError> {
        let mut notified = false;
        let outcome = match timeout {
            None => self.port.try_wait(|_| notified = true),
            Some(timeout) => self.port.timed_wait(|_| notified = true, timeout),
        };
        match outcome {
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(notified),
            Err(e) => Err(BusError::transport("waiting for an event", e)),
        }
    }
}

/// Wakes one neighbour.
#[derive(Debug)]
pub struct Notifier {
    port: notifier::Notifier<Ipc>,
    of: Waiter,
}

impl Notifier {
    pub(crate) fn new(node: &Node<Ipc>, attach: &Attach, of: Waiter) -> Result<Self, BusError> {
        let port = service(node, attach, of)?.notifier_builder().create();
        let port = port.map_err(|e| {
            BusError::open(format_args!("cannot create a notifier for the {}", of.0.word()), e)
        })?;
        Ok(Self { port, of })
    }

    /// Wakes the neighbour. Call it once after a batch of messages. Does nothing where there is no such process:
    /// sending to it fails instead.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn notify(&self) -> Result<(), BusError> {
        clock::pause();
        self.port.notify().map_err(|e| BusError::transport("notifying", e))?;
        clock::simulated_notify(self.of);
        Ok(())
    }
}

fn service(
    node: &Node<Ipc>,
    attach: &Attach,
    (of, index): Waiter,
) -> Result<PortFactory<Ipc>, BusError> {
    let roles = attach.places(&Role::ALL);
    let name = match of.has_index() {
        true => format!("event/{}-{index}", of.word()),
        false => format!("event/{}", of.word()),
    };
    node.service_builder(&service_name(attach, &name)?)
        .event()
        .max_listeners(1)
        .max_notifiers(roles)
        // One more than there are roles, so that a second process in a role gets as far as `BusError::Taken`.
        .max_nodes(roles + 1)
        .event_id_max_value(0)
        .open_or_create()
        .map_err(|e| BusError::open(format_args!("cannot open the events of the {}", of.word()), e))
}
