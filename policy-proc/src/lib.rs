//! The policy: turns an observation, a window and a recall into an action.
