//! What every message type tells: its service, its route and what bounds its queue.

use bytemuck::Pod;
use iceoryx2::prelude::ZeroCopySend;

use super::Role;
use crate::layout::Struct;

/// A message type, which has a service of its own. Implemented for the messages of the table only.
pub trait Message: ZeroCopySend + Pod + core::fmt::Debug {
    /// Last part of the service's name, after the generation.
    const SERVICE: &'static str;
    /// The roles that send it.
    const FROM: &'static [Role];
    /// The roles that receive it: each receives every message.
    const TO: &'static [Role];
    /// How many can wait for a receiver.
    const TRAFFIC: Traffic;
}

/// What bounds the number of waiting messages, and so the length of the queue
/// ([`Attach::queue_len`](crate::Attach::queue_len)).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Traffic {
    /// Two for each lane: the last of one episode and the first of the next.
    Lanes,
    /// Two for each frame of the store: a request and a release, or a view and an eviction.
    Frames,
    /// A few per run.
    Few,
}

/// A message's layout and route.
#[derive(Debug, Clone, Copy)]
pub struct Description {
    /// The layout.
    pub layout: Struct,
    /// As [`Message::SERVICE`].
    pub service: &'static str,
    /// As [`Message::FROM`].
    pub from: &'static [Role],
    /// As [`Message::TO`].
    pub to: &'static [Role],
    /// As [`Message::TRAFFIC`].
    pub traffic: Traffic,
}
