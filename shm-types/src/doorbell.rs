//! Sleeping until there is work, and waking others.
//!
//! Every role has one doorbell. A process that has put messages into a neighbour's queues rings its bell
//! once, however many messages there are.
//!
//! # Why no ring is lost
//! 1. A sender queues its messages *before* it rings.
//! 2. A ring stays pending until a [`Doorbell::wait`] takes it, and `wait` returns after taking one; rings
//!    that arrive before that are merged into it.
//! 3. A process looks through *all* its queues before its first wait and after every wait, whatever the
//!    wait's outcome.
//!
//! A message queued before its ring was taken is found by 3. One whose ring comes later wakes the next
//! wait by 2. The doorbell exists before the process's first receiver ([`Bus::join`](crate::Bus::join)), so a
//! message cannot get in without a bell to ring; a ring at a bell that is not there yet belongs to messages
//! that reached no receiver, or that the look before the first wait finds. A wait may also return without a
//! ring: treat it as a hint to look.

use std::time::{Duration, Instant};

use iceoryx2::node::Node;
use iceoryx2::port::listener::{Listener, ListenerCreateError, ListenerWaitError};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::service::port_factory::event::PortFactory;

use crate::attach::Attach;
use crate::bus::{BusError, Ipc, service_name};
use crate::message::Role;

/// Shortest sleep: the system takes a socket timeout of zero for "for ever".
const SHORTEST_SLEEP: Duration = Duration::from_millis(1);

/// What a process sleeps on.
#[derive(Debug)]
pub struct Doorbell {
    listener: Listener<Ipc>,
    spin: Duration,
}

impl Doorbell {
    pub(crate) fn new(node: &Node<Ipc>, attach: &Attach, role: Role) -> Result<Self, BusError> {
        let listener = service(node, attach, role)?.listener_builder().create();
        let listener = listener.map_err(|error| match error {
            ListenerCreateError::ExceedsMaxSupportedListeners => BusError::Taken { role },
            e => BusError::open(format_args!("cannot listen to the {}'s doorbell", role.word()), e),
        })?;
        Ok(Self { listener, spin: Duration::from_micros(attach.wait.spin_us.into()) })
    }

    /// Waits until somebody rings, for about `timeout` at most, and takes every ring there is. Returns
    /// whether anybody rang; look through all queues either way. A signal ends the wait early.
    ///
    /// Looks for [`Wait::spin_us`](crate::attach::Wait) without sleeping, then sleeps.
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
            rest => self.take(Some(rest.max(SHORTEST_SLEEP))),
        }
    }

    fn take(&self, timeout: Option<Duration>) -> Result<bool, BusError> {
        let mut rang = false;
        let outcome = match timeout {
            None => self.listener.try_wait(|_| rang = true),
            Some(timeout) => self.listener.timed_wait(|_| rang = true, timeout),
        };
        match outcome {
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(rang),
            Err(e) => Err(BusError::transport("waiting at the doorbell", e)),
        }
    }
}

/// Rings one neighbour's doorbell.
#[derive(Debug)]
pub struct Bell {
    notifier: Notifier<Ipc>,
}

impl Bell {
    pub(crate) fn new(node: &Node<Ipc>, attach: &Attach, of: Role) -> Result<Self, BusError> {
        let notifier = service(node, attach, of)?.notifier_builder().create().map_err(|e| {
            BusError::open(format_args!("cannot reach the {}'s doorbell", of.word()), e)
        })?;
        Ok(Self { notifier })
    }

    /// Wakes the neighbour. Call it once after a batch of messages. If the neighbour is not there, nothing
    /// happens: its messages are what would fail.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn ring(&self) -> Result<(), BusError> {
        self.notifier.notify().map(drop).map_err(|e| BusError::transport("ringing a doorbell", e))
    }
}

fn service(node: &Node<Ipc>, attach: &Attach, of: Role) -> Result<PortFactory<Ipc>, BusError> {
    let roles = Role::ALL.len();
    node.service_builder(&service_name(attach, &format!("doorbell/{}", of.word()))?)
        .event()
        .max_listeners(1)
        .max_notifiers(roles)
        // One more than there are roles: whoever comes to a role that is taken gets as far as being told so.
        .max_nodes(roles + 1)
        .event_id_max_value(0)
        .open_or_create()
        .map_err(|e| BusError::open(format_args!("cannot open the {}'s doorbell", of.word()), e))
}
