//! Measures how long an access to memory takes, for `memtransfer profile`, which stores and shows the figures.
//!
//! An access begins when the simulator has published an observation, and ends when the policy has the recall that
//! answers it. [`recorder`] splits it into its parts, step by step, while episodes run through the four processes;
//! [`search`] has the memory process measure its search alone, in memories larger than any case has; the machine's
//! [floors](crate::machine::floors) are measured beside both.

pub mod recorder;
pub mod search;
