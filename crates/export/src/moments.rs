//! What the formats of episodes get: an episode moment by moment, and how steps are laid out in time.

use std::collections::BTreeMap;

use anyhow::Result;
use world_client::EpisodeTimeline;
use world_client::frames::ViewKey;

/// How steps, which have no duration, are laid out in time, and how large views are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timing {
    /// Steps a second.
    pub steps_per_s: u32,
    /// Width and height of a view, in pixels.
    pub edge: u16,
}

/// An episode to be written.
pub(crate) struct Moments<'a> {
    pub(crate) timeline: EpisodeTimeline<'a>,
    /// JPEG files of its views.
    pub(crate) images: BTreeMap<ViewKey, Vec<u8>>,
}

/// A file that episodes are written into.
pub(crate) trait EpisodeSink {
    fn episode(&mut self, moments: &Moments<'_>) -> Result<()>;
    fn finish(self: Box<Self>) -> Result<()>;
}
