//! The iceoryx2 ports of messages, as trait objects.
//!
//! A port is generic in its message, and so is much of iceoryx2 below it. Behind a trait object that code is compiled
//! once, here; otherwise every crate that sends or receives a message would compile it again.

use std::fmt::Debug;
use std::sync::Arc;

use iceoryx2::node::Node;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::{ConnectionFailure, UpdateConnections};
use iceoryx2::port::{BackpressureAction, SendError};
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use crate::attach::Attach;
use crate::message::{self, Message, Role, message_table};
use crate::transport::{BusError, Ipc, receiver, service_name};

/// A message that this crate opens ports for: each of the table.
pub trait PortedMessage: Message {
    /// Opens its sender; `index` is that of the world or external memory at the other end of a private service.
    #[doc(hidden)]
    fn open_sender(
        node: &Node<Ipc>,
        attach: &Attach,
        index: u8,
    ) -> Result<Box<dyn SenderPort<Self>>, BusError>;

    /// Opens a receiver, as [`Self::open_sender`].
    #[doc(hidden)]
    fn open_receiver(
        node: &Node<Ipc>,
        attach: &Attach,
        index: u8,
    ) -> Result<Arc<dyn ReceiverPort<Self>>, BusError>;
}

/// Implements [`PortedMessage`] for the messages of the table, one by one: what is not generic is compiled in this crate.
macro_rules! implement_ports {
    ($($(#[doc = $doc:literal])* $name:ident, $type_name:literal, $service:literal, $size:literal bytes,
        [$($from:ident)*] to [$($to:ident)*], $traffic:ident { $($fields:tt)* })*) => {
        $(
            impl PortedMessage for message::$name {
                fn open_sender(
                    node: &Node<Ipc>,
                    attach: &Attach,
                    index: u8,
                ) -> Result<Box<dyn SenderPort<Self>>, BusError> {
                    open_sender(node, attach, index)
                }

                fn open_receiver(
                    node: &Node<Ipc>,
                    attach: &Attach,
                    index: u8,
                ) -> Result<Arc<dyn ReceiverPort<Self>>, BusError> {
                    open_receiver(node, attach, index)
                }
            }
        )*
    };
}

message_table!(implement_ports);

/// Sends messages to every receiver.
pub trait SenderPort<M>: Debug + Send + Sync {
    /// Sends a copy; returns how many receivers got it.
    ///
    /// # Errors
    /// When a queue is full or the transport fails.
    fn send(&self, message: &M) -> Result<usize, SendError>;

    /// The number of receivers that exist.
    fn receivers(&self) -> usize;
}

/// Receives messages.
pub trait ReceiverPort<M>: Connect {
    /// Calls `look` with the next waiting message, if there is one.
    ///
    /// # Errors
    /// When the transport fails.
    fn receive(&self, look: &mut dyn FnMut(&M)) -> Result<(), BusError>;
}

/// A receiver of any message.
pub trait Connect: Debug + Send + Sync {
    /// Connects to the senders that have been created since.
    ///
    /// # Errors
    /// When the transport fails.
    fn connect(&self) -> Result<(), ConnectionFailure>;
}

#[derive(Debug)]
struct OpenSender<M: Message> {
    publisher: Publisher<Ipc, M, ()>,
    service: PortFactory<Ipc, M, ()>,
}

impl<M: Message> SenderPort<M> for OpenSender<M> {
    fn send(&self, message: &M) -> Result<usize, SendError> {
        self.publisher.send_copy(*message)
    }

    fn receivers(&self) -> usize {
        self.service.dynamic_config().number_of_subscribers()
    }
}

impl<M: Message> ReceiverPort<M> for Subscriber<Ipc, M, ()> {
    fn receive(&self, look: &mut dyn FnMut(&M)) -> Result<(), BusError> {
        let sample = Self::receive(self).map_err(|e| BusError::transport(M::SERVICE, e))?;
        if let Some(sample) = sample {
            look(&sample);
        }
        Ok(())
    }
}

impl<M: Message> Connect for Subscriber<Ipc, M, ()> {
    fn connect(&self) -> Result<(), ConnectionFailure> {
        self.update_connections()
    }
}

fn open_sender<M: Message>(
    node: &Node<Ipc>,
    attach: &Attach,
    index: u8,
) -> Result<Box<dyn SenderPort<M>>, BusError> {
    let service = service::<M>(node, attach, index)?;
    let publisher = service
        .publisher_builder()
        .max_loaned_samples(1)
        // A full queue is reported, never waited for.
        .set_backpressure_handler(|_| BackpressureAction::DiscardDataAndFail)
        .create()
        .map_err(|e| BusError::open(format_args!("cannot send on {}", M::SERVICE), e))?;
    Ok(Box::new(OpenSender { publisher, service }))
}

fn open_receiver<M: Message>(
    node: &Node<Ipc>,
    attach: &Attach,
    index: u8,
) -> Result<Arc<dyn ReceiverPort<M>>, BusError> {
    let service = service::<M>(node, attach, index)?;
    Ok(Arc::new(receiver(&service, &format!("cannot receive on {}", M::SERVICE))?))
}

/// Whether each external memory, or each world that receives it, has its own service for `M`.
pub(crate) fn is_private<M: Message>() -> bool {
    [M::FROM, M::TO].contains(&[Role::ExternalMemory].as_slice()) || M::TO == [Role::Sim]
}

/// The service of `M`; `index` is that of the world or external memory, where each has its own.
fn service<M: Message>(
    node: &Node<Ipc>,
    attach: &Attach,
    index: u8,
) -> Result<PortFactory<Ipc, M, ()>, BusError> {
    let (name, senders, receivers) = if is_private::<M>() {
        (format!("{}-{index}", M::SERVICE), 1, 1)
    } else {
        (M::SERVICE.to_owned(), attach.places(M::FROM), attach.places(M::TO))
    };
    node.service_builder(&service_name(attach, &name)?)
        .publish_subscribe::<M>()
        .enable_safe_overflow(false)
        .history_size(0)
        .max_publishers(senders)
        .max_subscribers(receivers)
        .max_nodes(senders + receivers)
        .subscriber_max_borrowed_samples(1)
        .subscriber_max_buffer_size(attach.queue_len(M::TRAFFIC))
        .open_or_create()
        .map_err(|e| BusError::open(format_args!("cannot open {}", M::SERVICE), e))
}
