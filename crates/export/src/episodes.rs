//! Episodes with their views, a moment after the other.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use case_book::act::EpisodeParts;
use run_log::RunLog;
use scores::Successes;
use world_client::frames::{ViewFormat, ViewKey, ViewRenderer, view_arguments};
use world_client::{EpisodeTimeline, RecordedRun, RunWorld, WorldProgram};

use crate::files::{is_file, write_whole};
use crate::moments::{EpisodeSink, Moments, Timing};
use crate::{mcap, video};

/// How views are encoded beyond their size, in percent.
const QUALITY: u8 = 85;

/// A format that shows episodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EpisodeFormat {
    /// Views, poses, events and decisions, for Foxglove and Rerun.
    Mcap,
    /// The views as a video.
    Mp4,
}

impl EpisodeFormat {
    /// The extension of its files.
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Mp4 => "mp4",
        }
    }
}

/// The episodes of a run with what is needed to show them.
#[derive(Debug)]
pub struct Episodes {
    log: RunLog,
    successes: Successes,
    world: RunWorld,
    timing: Timing,
    renderer: ViewRenderer,
}

impl Episodes {
    /// The episodes in the log of `run`; `program` renders their views.
    ///
    /// # Errors
    /// When the renderer does not start.
    pub fn new(run: RecordedRun, program: &WorldProgram, timing: Timing) -> Result<Self> {
        let RecordedRun { log, successes, world, .. } = run;
        let format = ViewFormat { edge: timing.edge, quality: QUALITY };
        let renderer = ViewRenderer::start(&program.of_run(&log)?, &view_arguments(&log), format)?;
        Ok(Self { log, successes, world, timing, renderer })
    }

    /// Writes the episodes, one after the other in one file if `out` has the extension of `format`, otherwise each into a
    /// file of its own in the folder `out`. Returns the files.
    ///
    /// # Errors
    /// When an episode does not fit the world, the renderer or ffmpeg fails, or the system refuses.
    pub fn write(&mut self, format: EpisodeFormat, out: &Path) -> Result<Vec<PathBuf>> {
        let all = 0..self.log.episodes.len();
        let files: Vec<(PathBuf, Vec<usize>)> = if is_file(out, format.extension()) {
            vec![(out.to_owned(), all.collect())]
        } else {
            let name = |index: usize| {
                let key = self.log.episodes[index].key.replace('/', "_");
                out.join(format!("{key}.{}", format.extension()))
            };
            all.map(|index| (name(index), vec![index])).collect()
        };
        let timing = self.timing;
        for (path, episodes) in &files {
            write_whole(path, |draft| {
                let mut sink: Box<dyn EpisodeSink> = match format {
                    EpisodeFormat::Mcap => {
                        Box::new(mcap::McapRecording::create(draft, &self.log, timing)?)
                    }
                    EpisodeFormat::Mp4 => {
                        let manifest = &self.log.manifest;
                        let comment = format!(
                            "MemTransfer, run {}, frames {}. {}",
                            self.log.name,
                            manifest.settings.frames,
                            manifest.policy_label().sentence("Policy")
                        );
                        Box::new(video::Video::create(draft, &comment, timing)?)
                    }
                };
                let written = || format!("cannot write {}", path.display());
                for &index in episodes {
                    let moments = self.moments(index)?;
                    sink.episode(&moments).with_context(written)?;
                }
                sink.finish().with_context(written)
            })?;
        }
        Ok(files.into_iter().map(|(path, _)| path).collect())
    }

    fn moments(&mut self, index: usize) -> Result<Moments<'_>> {
        let record = &self.log.episodes[index];
        let parts = EpisodeParts::default();
        let timeline = EpisodeTimeline::new(&self.world, record, &self.successes, parts)?;
        let views: BTreeSet<ViewKey> =
            timeline.steps.iter().map(|step| step.view.clone()).collect();
        let distinct: Vec<ViewKey> = views.into_iter().collect();
        let mut images = BTreeMap::new();
        self.renderer
            .render(&distinct, |view, bytes| {
                images.insert(view.clone(), bytes);
                Ok(())
            })
            .with_context(|| format!("cannot render the views of {}", record.key))?;
        Ok(Moments { timeline, images })
    }
}
