//! What a run's settings select: the world, some of its cases, and the streams.

use anyhow::Result;
use results::settings::RunSettings;

use crate::plan::{PlannedEpisode, plan, plan_streams};
use crate::streams::Streams;
use replay::World;
use settings::select_cases;

/// The world of a run, and which of its cases take part.
#[derive(Debug)]
pub struct SelectedCases {
    /// The world.
    pub world: World,
    /// Indices of the cases.
    pub cases: Vec<usize>,
    /// The streams, for a run that consists of streams.
    pub streams: Option<Streams>,
}

impl SelectedCases {
    /// What `settings` select.
    ///
    /// # Errors
    /// When assets cannot be used, there is no such case, or no streams can be drawn.
    pub fn of(settings: &RunSettings) -> Result<Self> {
        let mut world = World::load(settings.assets.as_deref())?;
        if settings.demonstrates_elsewhere() {
            world.add_elsewhere(settings.elsewhere.as_deref(), settings.seed)?;
        }
        let cases = select_cases(&world.case_ids(), &settings.cases, settings.limit)?;
        let streams = match &settings.stream {
            Some(stream) => Some(Streams::draw(&world, stream, &cases, settings.seed)?),
            None => None,
        };
        Ok(Self { world, cases, streams })
    }

    /// The number of episodes of a run with `settings`.
    pub fn count(&self, settings: &RunSettings) -> usize {
        match self.streams {
            Some(_) => self.with_episodes(settings, |episodes| episodes.count()),
            None => {
                self.cases.len()
                    * settings.runs().iter().map(|(_, runs)| *runs as usize).sum::<usize>()
            }
        }
    }

    /// Calls `each` with the episodes of a run with `settings`, in their order.
    pub fn with_episodes<T>(
        &self,
        settings: &RunSettings,
        each: impl FnOnce(&mut dyn Iterator<Item = PlannedEpisode>) -> T,
    ) -> T {
        let (runs, ids) = (settings.runs(), self.world.case_ids());
        match self.streams.as_ref().zip(settings.stream.as_ref()) {
            Some((streams, stream)) => {
                each(&mut plan_streams(&runs, &streams.set, stream, &ids, settings.seed))
            }
            None => each(&mut plan(&runs, &self.cases, &ids, settings.seed)),
        }
    }
}
