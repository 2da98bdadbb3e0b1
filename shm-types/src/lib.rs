//! The wire: messages between MemTransfer's processes, and the shared memory they travel through.
//!
//! Every process links this crate and no process links another. It defines
//!
//! - the messages, their services and their layout in memory ([`message`], [`layout`]);
//! - joining a run ([`attach`], [`bus`]), and sleeping until a neighbour has sent something ([`events`]);
//! - frames, written once and shared by all processes ([`frames`]), and documents ([`documents`]);
//! - what an external memory is given and supplies ([`banks`], [`notes`]), and its [`description`];
//! - run folders ([`registry`]), the clock ([`clock`]) and what a process asks of the operating system ([`process`]);
//! - what every process reports: its handshake, heartbeats, errors ([`error_reports`]) and spans ([`spans`]).
//!
//! iceoryx2 is used here and nowhere else. This crate knows neither the map nor the tasks.

pub mod attach;
pub mod banks;
pub mod bus;
pub mod clock;
pub mod description;
pub mod documents;
pub mod error_reports;
pub mod events;
pub mod frames;
#[doc(hidden)]
pub mod fuzzing;
mod handshake;
pub mod heartbeats;
pub mod layout;
pub mod message;
pub mod notes;
mod panics;
mod ports;
pub mod process;
pub mod registry;
pub mod spans;
mod transport;

pub use attach::{
    ATTACH_VARIABLE, Attach, AttachError, FrameControl, FrameSize, WORLD_INDEX_VARIABLE, Wait,
};
pub use banks::{Bank, BankContent, BankPublisher, BankReceiver};
pub use bus::{Bus, BusError, HandshakeReceiver, PortedMessage, Receiver, Sender};
pub use description::MemoryDescription;
pub use documents::{Document, DocumentError, DocumentPublisher, DocumentStore};
pub use error_reports::ErrorReporter;
pub use events::{Listener, Notifier};
pub use frames::{Frame, FrameError, FramePublisher, FrameSlot, FrameStore};
pub use handshake::FactsTooLong;
pub use heartbeats::Heartbeats;
pub use notes::{Note, NotePublisher, NoteReceiver, NoteTooLong};
pub use registry::RunDir;
pub use spans::Spans;
