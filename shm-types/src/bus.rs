//! Joining a run, and one typed queue for each kind of message.
//!
//! Each message type has a service of its own, with the senders and receivers that
//! [`Message`] names. Queues are as long as the traffic on them can be
//! ([`Traffic`](crate::message::Traffic)), so a full one is a bug and reported as [`BusError::Full`] at once: nothing overflows and nothing blocks.
//!
//! # Starting up
//! A message reaches the receivers that exist when it is sent, and no later ones. Therefore: join,
//! create every receiver, then send. The first send on a service waits, for a bounded time, until all its
//! receivers are there; so processes may start in any order.
//!
//! # Leaving
//! What was sent outlives the sending [`Bus`] only for receivers that are connected: that have looked at
//! their queue since the sender was first made. So that last words always arrive, a process makes the
//! senders for them when it joins, and whoever receives its [`Hello`] connects all its own receivers. A
//! receiver keeps what 16 senders left that are gone: more than can be in a generation, whose processes join
//! once each.
//!
//! All of this is thread-safe; a process normally keeps it on one thread and hands
//! [`Frame`](crate::frames::Frame)s to others.

use std::any::{Any, TypeId};
use std::collections::HashMap;
use std::fmt::{Debug, Display};
use std::fs::File;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::config::Config;
use iceoryx2::node::{Node, NodeBuilder};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::{ConnectionFailure, UpdateConnections};
use iceoryx2::port::{BackpressureAction, SendError};
use iceoryx2::prelude::{
    FileName, LogLevel, SemanticString, ServiceName, SignalHandlingMode, ipc_threadsafe,
    set_log_level_from_env_or,
};
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use crate::attach::{Attach, AttachError, MAX_ROOT_BYTES};
use crate::doorbell::{Bell, Doorbell};
use crate::message::{Complaint, Farewell, Hello, Message, Role};
use crate::registry;

/// The kind of iceoryx2 service everything uses.
pub(crate) type Ipc = ipc_threadsafe::Service;

/// How long the first send on a service waits for its receivers.
const RECEIVERS_PATIENCE: Duration = Duration::from_secs(60);

/// Senders that may be gone and have left messages in the same receiver. Every look at a queue goes over a place
/// for each, so a large number makes every look slow. Four times as many as a generation has processes.
const GONE_SENDERS: usize = 4 * Role::ALL.len();

/// Why the bus cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The run cannot be attached to.
    #[error(transparent)]
    Attach(#[from] AttachError),
    /// The run's folder has too long a path.
    #[error(
        "the run's folder {path} has a path of {} bytes, but socket names leave room for {MAX_ROOT_BYTES}: \
         choose a shorter folder", path.len()
    )]
    PathTooLong {
        /// The folder.
        path: String,
    },
    /// The run's folder cannot be held: it is gone, or belongs to somebody else.
    #[error("cannot join the run in {path}: {cause}")]
    Membership {
        /// The folder.
        path: String,
        /// What the system said.
        cause: std::io::Error,
    },
    /// Another living process has the role.
    #[error(
        "the run has a {} already: only one can take part, so end one of the two, or give this one a run of \
         its own", role.word()
    )]
    Taken {
        /// The role.
        role: Role,
    },
    /// Something could not be created or opened.
    #[error("{what}: {cause}")]
    Open {
        /// What.
        what: String,
        /// What iceoryx2 said.
        cause: String,
    },
    /// This process has no business on the service.
    #[error("{service} is not for the {} to {verb}", role.word())]
    WrongRole {
        /// The service.
        service: &'static str,
        /// The process's role.
        role: Role,
        /// Send or receive.
        verb: &'static str,
    },
    /// A receiver's queue is full. Queues are as long as the protocol can fill them, so this is a bug in
    /// one of the two, or the receiver has died or hangs.
    #[error("{service}: a receiver's queue is full, it hangs or the protocol is broken")]
    Full {
        /// The service.
        service: &'static str,
    },
    /// Fewer receivers got the message than it is for.
    #[error(
        "{service}: reached {found} of {expected} receivers, the others are gone or have never looked"
    )]
    Deserted {
        /// The service.
        service: &'static str,
        /// How many there should be.
        expected: usize,
        /// How many got it.
        found: usize,
    },
    /// The transport failed.
    #[error("{what}: {cause}")]
    Transport {
        /// What was tried.
        what: &'static str,
        /// What iceoryx2 said.
        cause: String,
    },
}

impl BusError {
    pub(crate) fn open(what: impl Display, cause: impl Display) -> Self {
        Self::Open { what: what.to_string(), cause: cause.to_string() }
    }

    pub(crate) fn transport(what: &'static str, cause: impl Display) -> Self {
        Self::Transport { what, cause: cause.to_string() }
    }
}

/// One process's place in a run.
#[derive(Debug)]
pub struct Bus {
    attach: Attach,
    role: Role,
    doorbell: Doorbell,
    /// Every sender that was asked for, by service.
    ports: Mutex<HashMap<&'static str, Arc<dyn Any + Send + Sync>>>,
    receivers: Arc<Siblings>,
    node: Node<Ipc>,
    /// Locked for as long as the process takes part, so that nobody cleans the run away. Last, so that
    /// everything else is gone when the lock is.
    _membership: File,
}

impl Bus {
    /// Joins a run as `role`. What dead processes of the run left behind is cleaned on the way.
    ///
    /// # Errors
    /// When a value of `attach` cannot be, the folder's path is too long for sockets, the folder is
    /// gone, or iceoryx2 cannot create its node and the role's doorbell.
    pub fn join(attach: Attach, role: Role) -> Result<Self, BusError> {
        attach.check()?;
        let membership = registry::hold(&attach.root).map_err(|cause| BusError::Membership {
            path: attach.root.display().to_string(),
            cause,
        })?;
        let config = config(&attach)?;
        // iceoryx2 writes to stderr by itself. What it warns of comes back as an error here, in words.
        set_log_level_from_env_or(LogLevel::Error);
        let node = NodeBuilder::new()
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .config(&config)
            .create::<Ipc>()
            .map_err(|e| BusError::open("cannot create a node in the run", e))?;
        let doorbell = Doorbell::new(&node, &attach, role)?;
        let (ports, receivers) = (Mutex::default(), Arc::default());
        let bus = Self { attach, role, doorbell, ports, receivers, node, _membership: membership };
        if role != Role::Orchestrator {
            bus.sender::<Hello>()?;
            bus.sender::<Complaint>()?;
            bus.sender::<Farewell>()?;
        }
        Ok(bus)
    }

    /// What the run was joined with.
    pub fn attach(&self) -> &Attach {
        &self.attach
    }

    /// The role joined as.
    pub fn role(&self) -> Role {
        self.role
    }

    /// This process's own doorbell. It exists from [`Bus::join`] on, before any receiver, so a message
    /// that reaches a receiver also finds a bell to ring.
    pub fn doorbell(&self) -> &Doorbell {
        &self.doorbell
    }

    /// The button to a neighbour's doorbell.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn bell(&self, of: Role) -> Result<Bell, BusError> {
        Bell::new(&self.node, &self.attach, of)
    }

    /// The sending end for `M`: always the same one, however often it is asked for.
    ///
    /// # Errors
    /// When `M` is not for this role to send, or the service cannot be opened.
    pub fn sender<M: Message>(&self) -> Result<Sender<M>, BusError> {
        self.allowed(M::FROM, M::SERVICE, "send")?;
        let mut ports = self.ports.lock().unwrap_or_else(PoisonError::into_inner);
        let known = ports.get(M::SERVICE).cloned();
        if let Some(port) = known.and_then(|port| port.downcast().ok()) {
            return Ok(Sender { port });
        }
        let service = self.service::<M>()?;
        let publisher = service
            .publisher_builder()
            .max_loaned_samples(1)
            .set_backpressure_handler(|_| BackpressureAction::DiscardDataAndFail)
            .create()
            .map_err(|e| BusError::open(format_args!("cannot send on {}", M::SERVICE), e))?;
        let receivers = self.attach.count(M::TO);
        let port = Arc::new(Port { publisher, service, receivers, complete: false.into() });
        ports.insert(M::SERVICE, port.clone());
        Ok(Sender { port })
    }

    /// The receiving end for `M`.
    ///
    /// # Errors
    /// When `M` is not for this role to receive, or the service cannot be opened.
    pub fn receiver<M: Message>(&self) -> Result<Receiver<M>, BusError> {
        self.allowed(M::TO, M::SERVICE, "receive")?;
        let subscriber = self
            .service::<M>()?
            .subscriber_builder()
            .create()
            .map_err(|e| BusError::open(format_args!("cannot receive on {}", M::SERVICE), e))?;
        let subscriber = Arc::new(subscriber);
        self.receivers.add(subscriber.clone());
        let most = M::TRAFFIC.queue_len(&self.attach) * M::FROM.len();
        Ok(Receiver { subscriber, most, siblings: self.receivers.clone() })
    }

    fn allowed(
        &self,
        roles: &[Role],
        service: &'static str,
        verb: &'static str,
    ) -> Result<(), BusError> {
        let role = self.role;
        roles.contains(&role).then_some(()).ok_or(BusError::WrongRole { service, role, verb })
    }

    fn service<M: Message>(&self) -> Result<PortFactory<Ipc, M, ()>, BusError> {
        self.builder(M::SERVICE)?
            .publish_subscribe::<M>()
            .enable_safe_overflow(false)
            .history_size(0)
            .max_publishers(M::FROM.len())
            .max_subscribers(M::TO.len())
            .max_nodes(M::FROM.len() + M::TO.len())
            .subscriber_max_borrowed_samples(1)
            .subscriber_max_buffer_size(M::TRAFFIC.queue_len(&self.attach))
            .open_or_create()
            .map_err(|e| BusError::open(format_args!("cannot open {}", M::SERVICE), e))
    }

    /// A builder for this generation's service `name`.
    pub(crate) fn builder(
        &self,
        name: &str,
    ) -> Result<iceoryx2::service::builder::Builder<Ipc>, BusError> {
        Ok(self.node.service_builder(&service_name(&self.attach, name)?))
    }
}

/// The name of a service in this generation.
pub(crate) fn service_name(attach: &Attach, name: &str) -> Result<ServiceName, BusError> {
    let full = format!("{}/{name}", attach.generation);
    ServiceName::new(&full).map_err(|e| BusError::open(format_args!("service name {full}"), e))
}

/// The run's own iceoryx2 settings; nothing is read from anywhere.
pub(crate) fn config(attach: &Attach) -> Result<Config, BusError> {
    let mut config = raw_config(&attach.prefix, &attach.root)?;
    // For frames, iceoryx2 takes as many as a consumer can hold instead, and says so where warnings are asked for.
    config.defaults.publish_subscribe.subscriber_expired_connection_buffer = GONE_SENDERS;
    Ok(config)
}

/// The settings that say which run: a prefix in shared memory and a folder.
pub(crate) fn raw_config(prefix: &str, root: &Path) -> Result<Config, BusError> {
    let path = root.display().to_string();
    if path.len() > MAX_ROOT_BYTES {
        return Err(BusError::PathTooLong { path });
    }
    let mut config = Config::default();
    config.global.prefix = FileName::new(prefix.as_bytes())
        .map_err(|e| BusError::open(format_args!("prefix {prefix}"), e))?;
    let root = iceoryx2::prelude::Path::new(path.as_bytes())
        .map_err(|e| BusError::open(format_args!("folder {path}"), e))?;
    config.global.set_root_path(&root);
    Ok(config)
}

/// The sending end of `M`'s service.
#[derive(Debug)]
pub struct Sender<M: Message> {
    port: Arc<Port<M>>,
}

/// What all senders of a process for one service share.
#[derive(Debug)]
struct Port<M: Message> {
    publisher: Publisher<Ipc, M, ()>,
    service: PortFactory<Ipc, M, ()>,
    /// How many receivers take part in the run.
    receivers: usize,
    /// Whether all receivers have been waited for.
    complete: AtomicBool,
}

impl<M: Message> Sender<M> {
    /// Puts `message` into every receiver's queue. Rings nobody.
    ///
    /// The first call waits until all receivers are there; later ones return at once.
    ///
    /// # Errors
    /// [`BusError::Full`] when a receiver's queue is full (the others have got the message),
    /// [`BusError::Deserted`] when a receiver is missing, otherwise a failed transport.
    pub fn send(&self, message: &M) -> Result<(), BusError> {
        if !self.port.complete.load(Relaxed) {
            self.wait_for_receivers();
        }
        self.send_now(message)
    }

    fn wait_for_receivers(&self) {
        let deadline = Instant::now() + RECEIVERS_PATIENCE;
        while !self.is_complete() && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
        self.port.complete.store(true, Relaxed);
    }

    /// Whether every receiver is there.
    pub fn is_complete(&self) -> bool {
        self.port.service.dynamic_config().number_of_subscribers() >= self.port.receivers
    }

    /// As [`Sender::send`], without waiting for anybody.
    pub(crate) fn send_now(&self, message: &M) -> Result<(), BusError> {
        delivered(M::SERVICE, self.port.receivers, self.port.publisher.send_copy(*message))
    }
}

/// Whether a delivery reached every receiver.
pub(crate) fn delivered(
    service: &'static str,
    expected: usize,
    outcome: Result<usize, SendError>,
) -> Result<(), BusError> {
    match outcome {
        Ok(found) if found < expected => Err(BusError::Deserted { service, expected, found }),
        Ok(_) => Ok(()),
        Err(SendError::UnableToDeliver) => Err(BusError::Full { service }),
        Err(e) => Err(BusError::transport(service, e)),
    }
}

/// The receiving end of `M`'s service.
#[derive(Debug)]
pub struct Receiver<M: Message> {
    subscriber: Arc<Subscriber<Ipc, M, ()>>,
    /// Messages that can wait at once: a queue for each sender.
    most: usize,
    siblings: Arc<Siblings>,
}

impl<M: Message> Receiver<M> {
    /// The next message that waits, if one does. Never blocks.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn next(&self) -> Result<Option<M>, BusError> {
        let sample = self.subscriber.receive().map_err(|e| BusError::transport(M::SERVICE, e))?;
        // Known when this is compiled, unlike whether two names are equal.
        if sample.is_some() && TypeId::of::<M>() == TypeId::of::<Hello>() {
            self.siblings.connect()?;
        }
        Ok(sample.map(|sample| *sample))
    }

    /// Every message that waits, in order. No more than can wait at once, so a sender that never stops
    /// cannot keep this process here.
    ///
    /// # Errors
    /// As [`Receiver::next`].
    pub fn drain(&self) -> Result<Vec<M>, BusError> {
        self.drain_some(self.most)
    }

    /// The same, of the first `most` messages that wait.
    ///
    /// # Errors
    /// As [`Receiver::next`].
    pub fn drain_some(&self, most: usize) -> Result<Vec<M>, BusError> {
        std::iter::from_fn(|| self.next().transpose()).take(most.min(self.most)).collect()
    }

    /// Has `look` look at the next message where it lies, if one waits. For large messages.
    ///
    /// # Errors
    /// As [`Receiver::next`].
    pub fn next_with<R>(&self, look: impl FnOnce(&M) -> R) -> Result<Option<R>, BusError> {
        let sample = self.subscriber.receive().map_err(|e| BusError::transport(M::SERVICE, e))?;
        Ok(sample.map(|sample| look(&sample)))
    }
}

/// All receivers of a process, without keeping them.
#[derive(Debug, Default)]
struct Siblings(Mutex<Vec<Weak<dyn Connect>>>);

/// Something that can connect to the senders there are.
trait Connect: Debug + Send + Sync {
    fn connect(&self) -> Result<(), ConnectionFailure>;
}

impl<M: Message> Connect for Subscriber<Ipc, M, ()> {
    fn connect(&self) -> Result<(), ConnectionFailure> {
        self.update_connections()
    }
}

impl Siblings {
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
            .map_err(|e| BusError::transport("connecting to a process that said hello", e))
    }
}
