//! Joining a run, and one typed queue for each kind of message.
//!
//! Each message type has a service of its own, with the senders and receivers that [`Message`] names. A queue holds
//! everything that the protocol can put into it ([`Traffic`](crate::message::Traffic)), so a full queue is a bug and
//! [`BusError::Full`] reports it at once: queues never overflow, and sending never blocks.
//!
//! # Starting
//! A message reaches the receivers that exist when it is sent, and no later ones. Therefore: join, create every
//! receiver, then send. In a run all receivers exist once the orchestrator has every [`Handshake`]; without one,
//! [`Sender::wait_for_receivers`] waits for them.
//!
//! # Leaving
//! Messages outlive the [`Bus`] that sent them only for receivers that are connected, that is, that have looked at
//! their queue since the sender was created. So that the last messages of a process always arrive, it creates the
//! senders for them when it joins, and the process that gets its [`Handshake`] connects all its own receivers
//! ([`HandshakeReceiver`]).
//!
//! Everything here is thread-safe. A process normally keeps it on one thread and passes
//! [`Frame`](crate::frames::Frame)s to others.

use std::any::Any;
use std::collections::HashMap;
use std::fmt::Debug;
use std::fs::File;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;

use iceoryx2::node::{Node, NodeBuilder};
use iceoryx2::prelude::{LogLevel, SignalHandlingMode, set_log_level_from_env_or};

use crate::attach::{Attach, AttachError};
use crate::clock::{self, Instant};
use crate::events::{Listener, Notifier};
use crate::message::{ErrorReport, Handshake, Message, Role, ShutdownReport, Stop};
pub use crate::ports::PortedMessage;
use crate::ports::{Connect, ReceiverPort, SenderPort, is_private};
use crate::process::ProcessWatch;
use crate::registry::{self, Sweeper};
pub use crate::transport::BusError;
use crate::transport::{Ipc, config, delivered, service_name};

/// Time between two looks at whether all receivers exist.
const TIME_BETWEEN_LOOKS: Duration = Duration::from_millis(1);

/// A service, and the index of the world or external memory at its other end, or 0.
type PortKey = (&'static str, u8);

/// A process's membership in a run.
#[derive(Debug)]
pub struct Bus {
    attach: Attach,
    role: Role,
    /// Index of a world or an external memory; otherwise 0.
    index: u8,
    listener: Listener,
    /// The senders created so far.
    ports: Mutex<HashMap<PortKey, Arc<dyn Any + Send + Sync>>>,
    receivers: Arc<AllReceivers>,
    node: Node<Ipc>,
    /// Without an owner of the run, a process that the user started would wait for ever for a segment that a killed process left
    /// without a size; `None` in other roles, which end with the owner.
    _sweeper: Option<Sweeper>,
    /// Locked while the process takes part, so that no cleaner removes the run. The last field: it is dropped
    /// after everything else.
    _membership: File,
}

impl Bus {
    /// Joins a run as `role`, and removes what dead processes of the run left behind.
    ///
    /// # Errors
    /// When a value of `attach` is invalid, the folder's path is too long for sockets, the folder does not exist,
    /// or iceoryx2 cannot create its node or the role's listener.
    pub fn join(attach: Attach, role: Role) -> Result<Self, BusError> {
        Self::join_as(attach, role, 0)
    }

    /// As [`Self::join`], for the world or external memory with this index.
    ///
    /// # Errors
    /// As [`Self::join`], and when the run has none with this index.
    pub fn join_as(attach: Attach, role: Role, index: u8) -> Result<Self, BusError> {
        attach.check()?;
        if role == Role::Sim && index >= attach.worlds {
            return Err(BusError::from(AttachError::Value {
                field: "worlds",
                value: attach.worlds.to_string(),
                expected: format!("more than {index}, the index of this world"),
            }));
        }
        if role == Role::ExternalMemory && !attach.external_memories.contains(&index) {
            return Err(BusError::from(AttachError::Value {
                field: "external_memories",
                value: format!("{:?}", attach.external_memories),
                expected: format!("a list with {index}: the run goes on without this memory"),
            }));
        }
        let not_a_member = |cause| {
            let path = attach.root.display().to_string();
            BusError::Membership { path, cause }
        };
        let membership = registry::lock_shared(&attach.root).map_err(not_a_member)?;
        let outlives_owner = matches!(role, Role::Sim | Role::Policy | Role::ExternalMemory);
        let sweeper = (outlives_owner && !clock::is_simulated()).then(|| {
            // Beside an owner that cannot be watched it does no harm.
            Sweeper::start(attach.root.clone(), ProcessWatch::new(attach.orchestrator_pid).ok())
        });
        let sweeper = sweeper.transpose().map_err(not_a_member)?;
        let config = config(&attach)?;
        // iceoryx2 logs to stderr by itself; what it warns of is returned as an error here.
        set_log_level_from_env_or(LogLevel::Error);
        let node = NodeBuilder::new()
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .config(&config)
            .create::<Ipc>()
            .map_err(|e| BusError::open("cannot create a node in the run", e))?;
        let listener = Listener::new(&node, &attach, (role, index))?;
        let (ports, receivers) = (Mutex::default(), Arc::default());
        let bus = Self {
            attach,
            role,
            index,
            listener,
            ports,
            receivers,
            node,
            _sweeper: sweeper,
            _membership: membership,
        };
        if role != Role::Orchestrator {
            bus.sender::<Handshake>()?;
            bus.sender::<ErrorReport>()?;
            bus.sender::<ShutdownReport>()?;
        }
        Ok(bus)
    }

    /// The settings the run was joined with.
    pub fn attach(&self) -> &Attach {
        &self.attach
    }

    /// This process's role.
    pub fn role(&self) -> Role {
        self.role
    }

    /// The index of a world or an external memory; 0 for other roles.
    pub fn index(&self) -> u8 {
        self.index
    }

    /// This process's own listener. It exists before any receiver, so that a message that is received can also be
    /// notified.
    pub fn listener(&self) -> &Listener {
        &self.listener
    }

    /// A notifier for this process itself, or for the first neighbour with the role `of`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn notifier(&self, of: Role) -> Result<Notifier, BusError> {
        self.notifier_of(of, if of == self.role { self.index } else { 0 })
    }

    /// A notifier for the world or external memory with this index.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn notifier_of(&self, role: Role, index: u8) -> Result<Notifier, BusError> {
        Notifier::new(&self.node, &self.attach, (role, index))
    }

    /// The sender of `M`; every call returns the same one.
    ///
    /// # Errors
    /// When this role does not send `M`, or the service cannot be opened.
    pub fn sender<M: PortedMessage>(&self) -> Result<Sender<M>, BusError> {
        self.sender_to(self.index)
    }

    /// The sender of `M` to a world or an external memory.
    ///
    /// # Errors
    /// As [`Self::sender`].
    pub fn sender_to<M: PortedMessage>(&self, index: u8) -> Result<Sender<M>, BusError> {
        self.allowed(M::FROM, M::SERVICE, "send")?;
        let mut ports = self.ports.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (M::SERVICE, index);
        let known = ports.get(&key).cloned();
        if let Some(port) = known.and_then(|port| port.downcast().ok()) {
            return Ok(Sender { port });
        }
        let receivers = if is_private::<M>() { 1 } else { self.attach.count(M::TO) };
        let required = if is_private::<M>() { 1 } else { self.attach.count_required(M::TO) };
        let sender = M::open_sender(&self.node, &self.attach, index)?;
        let port = Arc::new(Port { sender, receivers, required });
        ports.insert(key, port.clone());
        Ok(Sender { port })
    }

    /// A receiver of `M`.
    ///
    /// # Errors
    /// When this role does not receive `M`, or the service cannot be opened.
    pub fn receiver<M: PortedMessage>(&self) -> Result<Receiver<M>, BusError> {
        self.receiver_from(self.index)
    }

    /// A receiver of `M` from an external memory.
    ///
    /// # Errors
    /// As [`Self::receiver`].
    pub fn receiver_from<M: PortedMessage>(&self, index: u8) -> Result<Receiver<M>, BusError> {
        self.allowed(M::TO, M::SERVICE, "receive")?;
        let port = M::open_receiver(&self.node, &self.attach, index)?;
        self.receivers.add(port.clone());
        let senders = if is_private::<M>() { 1 } else { self.attach.places(M::FROM) };
        let most = self.attach.queue_len(M::TRAFFIC) * senders;
        Ok(Receiver { port, most })
    }

    /// The receiver of handshakes.
    ///
    /// # Errors
    /// As [`Self::receiver`].
    pub fn handshake_receiver(&self) -> Result<HandshakeReceiver, BusError> {
        Ok(HandshakeReceiver { receiver: self.receiver()?, all: self.receivers.clone() })
    }

    /// Checks that this process has one of `roles`, which may `verb` on the service.
    pub(crate) fn allowed(
        &self,
        roles: &[Role],
        service: &'static str,
        verb: &'static str,
    ) -> Result<(), BusError> {
        let role = self.role;
        roles.contains(&role).then_some(()).ok_or(BusError::WrongRole { service, role, verb })
    }

    /// A builder for this generation's service `name`.
    pub(crate) fn builder(
        &self,
        name: &str,
    ) -> Result<iceoryx2::service::builder::Builder<Ipc>, BusError> {
        Ok(self.node.service_builder(&service_name(&self.attach, name)?))
    }
}

/// Sends messages of type `M`.
#[derive(Debug)]
pub struct Sender<M: Message> {
    port: Arc<Port<M>>,
}

/// The sending port of one service, shared by all [`Sender`]s of the process.
#[derive(Debug)]
struct Port<M: Message> {
    sender: Box<dyn SenderPort<M>>,
    /// Receivers that take part in the run.
    receivers: usize,
    /// Those without which a message is not delivered.
    required: usize,
}

impl<M: Message> Sender<M> {
    /// Puts `message` into the queue of every receiver that exists, without notifying. Never blocks.
    ///
    /// # Errors
    /// [`BusError::Full`] when a receiver's queue is full (the others got the message),
    /// [`BusError::Deserted`] when a receiver is missing, otherwise a failed transport. An external memory among other
    /// receivers may be missing: the memory process notices that it does not answer.
    pub fn send(&self, message: &M) -> Result<(), BusError> {
        clock::pause();
        if clock::is_simulated_queue_full(M::SERVICE) {
            return Err(BusError::Full { service: M::SERVICE });
        }
        delivered(M::SERVICE, self.port.required, self.port.sender.send(message))
    }

    /// Waits until all receivers exist.
    ///
    /// # Errors
    /// [`BusError::Deserted`] when one is still missing after `timeout`.
    pub fn wait_for_receivers(&self, timeout: Duration) -> Result<(), BusError> {
        let deadline = Instant::now() + timeout;
        while !self.is_complete() {
            if Instant::now() >= deadline {
                let (expected, found) = (self.port.receivers, self.port.sender.receivers());
                return Err(BusError::Deserted { service: M::SERVICE, expected, found });
            }
            clock::sleep(TIME_BETWEEN_LOOKS);
        }
        Ok(())
    }

    /// Whether all receivers exist.
    pub fn is_complete(&self) -> bool {
        self.port.sender.receivers() >= self.port.receivers
    }
}

/// Receives messages of type `M`.
#[derive(Debug)]
pub struct Receiver<M: Message> {
    port: Arc<dyn ReceiverPort<M>>,
    /// Maximum number of messages that can wait at the same time: a queue for each sender.
    most: usize,
}

impl Receiver<Stop> {
    /// Whether the run has been stopped and `error` comes from that: other processes left before they got a message.
    ///
    /// # Errors
    /// As [`Receiver::next`].
    pub fn explains(&self, error: &BusError) -> Result<bool, BusError> {
        Ok(matches!(error, BusError::Deserted { .. }) && self.next()?.is_some())
    }
}

impl<M: Message> Receiver<M> {
    /// The next waiting message, if there is one. Never blocks.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn next(&self) -> Result<Option<M>, BusError> {
        self.next_with(|message| *message)
    }

    /// All waiting messages, in order. At most as many as the queue holds, so that a sender that never stops cannot
    /// keep this process here.
    ///
    /// # Errors
    /// As [`Receiver::next`].
    pub fn drain(&self) -> Result<Vec<M>, BusError> {
        self.drain_some(self.most)
    }

    /// As [`Receiver::drain`], but at most `most` messages.
    ///
    /// # Errors
    /// As [`Receiver::next`].
    pub fn drain_some(&self, most: usize) -> Result<Vec<M>, BusError> {
        std::iter::from_fn(|| self.next().transpose()).take(most.min(self.most)).collect()
    }

    /// Passes the next waiting message to `look` without copying it.
    ///
    /// # Errors
    /// As [`Receiver::next`].
    pub fn next_with<R>(&self, look: impl FnOnce(&M) -> R) -> Result<Option<R>, BusError> {
        clock::pause();
        let (mut look, mut result) = (Some(look), None);
        self.port.receive(&mut |message| result = look.take().map(|look| look(message)))?;
        Ok(result)
    }
}

/// Receives handshakes, and connects all receivers of this process to a process that sent one, so that the last messages of
/// that process arrive.
#[derive(Debug)]
pub struct HandshakeReceiver {
    receiver: Receiver<Handshake>,
    all: Arc<AllReceivers>,
}

impl HandshakeReceiver {
    /// The next waiting handshake, if there is one. Never blocks.
    ///
    /// # Errors
    /// When the transport fails, or a receiver of this process cannot connect.
    pub fn next(&self) -> Result<Option<Handshake>, BusError> {
        let handshake = self.receiver.next()?;
        if handshake.is_some() {
            self.all.connect()?;
        }
        Ok(handshake)
    }

    /// All waiting handshakes, in order.
    ///
    /// # Errors
    /// As [`HandshakeReceiver::next`].
    pub fn drain(&self) -> Result<Vec<Handshake>, BusError> {
        let handshakes = self.receiver.drain()?;
        if !handshakes.is_empty() {
            self.all.connect()?;
        }
        Ok(handshakes)
    }
}

/// Weak references to all receivers of a process.
#[derive(Debug, Default)]
struct AllReceivers(Mutex<Vec<Weak<dyn Connect>>>);

impl AllReceivers {
    fn add(&self, receiver: Arc<dyn Connect>) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|other| other.strong_count() > 0);
        all.push(Arc::downgrade(&receiver));
    }

    fn connect(&self) -> Result<(), BusError> {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.iter()
            .filter_map(Weak::upgrade)
            .try_for_each(|receiver| receiver.connect())
            .map_err(|e| BusError::transport("connecting to a new process", e))
    }
}
