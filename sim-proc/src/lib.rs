//! The simulator: steps the world and renders what the agent sees into shared memory.
