//! The words MemTransfer's processes exchange, and the shared memory they travel through.
//!
//! Every process links this crate and none links another process, so whatever two of them must agree
//! on is here: what a pose and an action are ([`pose`]), the messages ([`message`]), how an item's
//! label plate spells its type in coloured bands ([`plate`]) and how the camera maps metres to pixels
//! ([`camera`]).
//!
//! What is not here: the map, the tasks, anything that decides.

pub mod camera;
pub mod message;
pub mod plate;
pub mod pose;

pub use pose::{Action, Cell, Feedback, Heading, Pose};
