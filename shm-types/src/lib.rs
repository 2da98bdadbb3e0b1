//! The words MemTransfer's processes exchange, and the shared memory they travel through.
//!
//! Every process links this crate and none links another process, so whatever two of them must agree
//! on is here:
//!
//! - the words: poses and actions ([`pose`]), messages and their routes ([`message`]), the memory
//!   representations ([`representation`]), label plates ([`plate`]), the camera ([`camera`]);
//! - the shared memory: what a process needs to join a run ([`attach`]), its place in one ([`bus`]),
//!   sleeping and waking ([`doorbell`]), views written once and held by all ([`frames`]), what memory
//!   supplies that is longer than a message ([`documents`]), what could not be used ([`complaints`]);
//! - what a policy keeps of its requests, for `memtransfer show` ([`prompts`]);
//! - what all of that looks like, byte by byte, for those who read it in another language ([`layout`]);
//! - the machine: runs, living and dead ([`registry`]), clock, parent and room ([`process`]), the cache folder
//!   ([`cache_folder`]).
//!
//! iceoryx2 is used here and nowhere else. What is not here: the map, the tasks, anything that decides.

pub mod attach;
pub mod bus;
pub mod complaints;
pub mod documents;
pub mod doorbell;
pub mod frames;
mod hello;
pub mod layout;
pub mod message;
pub mod process;
pub mod pulses;
pub mod registry;
pub mod spans;

pub use attach::{ATTACH_VARIABLE, Attach, AttachError, FrameControl, FrameSize, Wait};
pub use bus::{Bus, BusError, Receiver, Sender};
pub use complaints::Complaints;
pub use documents::{Document, DocumentError, DocumentPublisher, DocumentStore};
pub use domain::{
    Action, Cell, Feedback, Heading, NoCacheFolder, Pose, Representation, cache_folder, camera,
    pose, prompt_log as prompts, representation,
};
pub use doorbell::{Bell, Doorbell};
pub use frames::{Frame, FrameError, FramePublisher, FrameSlot, FrameStore};
pub use hello::FactsTooLong;
pub use pulses::Pulses;
pub use registry::RunDir;
pub use spans::Spans;
