//! The memory: embeds frames, builds the representations, retrieves.
