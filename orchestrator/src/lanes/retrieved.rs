//! What memory retrieved in an episode: sources and distances for the record, and which sources are stale.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use domain::{Arm, DemonstrationKind};
use run_log::EpisodeRecord;
use run_log::source::distance_word;
use shm_types::message::{EXPERIENCE, RecalledSource};

use super::Context;
use crate::plan::PlannedEpisode;

/// What memory has retrieved in an episode so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Retrieved {
    /// As [`EpisodeRecord::retrieved`].
    sources: String,
    has_sources: bool,
    /// As [`EpisodeRecord::distances`].
    distances: String,
    has_distances: bool,
    /// The first distance of each request that has one.
    first_distances: Vec<f64>,
    /// Whether a source is stale, by case or position and by demonstration.
    stale: BTreeMap<(u32, u16), bool>,
}

impl Retrieved {
    /// Adds where the items of one step come from.
    ///
    /// # Errors
    /// When a source does not exist.
    pub(super) fn add(
        &mut self,
        context: &Context<'_>,
        episode: &PlannedEpisode,
        record: &mut EpisodeRecord,
        variant: u32,
        sources: &[RecalledSource],
    ) -> Result<(), String> {
        self.count_stale(context, episode, record, variant, sources)?;
        let mut words = String::new();
        for &RecalledSource { case, demonstration, first, .. } in sources {
            if !words.is_empty() {
                words.push('+');
            }
            if demonstration == EXPERIENCE {
                // Writing to a string cannot fail.
                let _ = write!(words, "e{case}:{first}");
                continue;
            }
            let found = context.book().cases.get(case as usize);
            let kind = DemonstrationKind::from_code(demonstration);
            let Some((found, kind)) = found.zip(kind) else {
                return Err(format!("case {case}, demonstration {demonstration}"));
            };
            if case as usize != episode.case_index {
                words.push_str(&found.id);
                words.push(':');
            }
            words.push(kind.letter());
            // Writing to a string cannot fail.
            let _ = write!(words, "{first}");
        }
        let told: Vec<String> =
            sources.iter().map(|source| distance_word(source.distance)).collect();
        for (words, word) in [(&mut self.sources, words), (&mut self.distances, told.join("+"))] {
            if !words.is_empty() {
                words.push(' ');
            }
            words.push_str(if word.is_empty() { "-" } else { &word });
        }
        self.has_sources |= !sources.is_empty();
        let distances = sources.iter().map(|source| f64::from(source.distance));
        let mut distances = distances.filter(|distance| distance.is_finite());
        let first = distances.next();
        self.has_distances |= first.is_some();
        self.first_distances.extend(first);
        Ok(())
    }

    /// Writes into `record` what the episode retrieved.
    pub(super) fn complete(self, record: &mut EpisodeRecord) {
        let Self { sources, has_sources, distances, has_distances, first_distances, .. } = self;
        if !first_distances.is_empty() {
            let mean = first_distances.iter().sum::<f64>() / first_distances.len() as f64;
            record.distance = Some((mean * 1e6).round() / 1e6);
        }
        record.retrieved = has_sources.then_some(sources);
        record.distances = has_distances.then_some(distances);
    }

    /// Counts the sources of an episode in a stream or on a blocked route, and those that are stale: their trajectory
    /// completes its task in the world that it was recorded in, and not in this one, which is `variant`.
    ///
    /// # Errors
    /// When a source does not exist.
    fn count_stale(
        &mut self,
        context: &Context<'_>,
        episode: &PlannedEpisode,
        record: &mut EpisodeRecord,
        variant: u32,
        sources: &[RecalledSource],
    ) -> Result<(), String> {
        let EpisodeRecord { stream, blocked, .. } = record;
        let (retrievals, stale) = match (stream, blocked) {
            (Some(stream), _) => (&mut stream.retrievals, &mut stream.stale),
            (None, Some(blocked)) => (&mut blocked.retrievals, &mut blocked.stale),
            (None, None) => return Ok(()),
        };
        let own = episode.part.and_then(|part| context.experience.get(&part.sequence));
        for &RecalledSource { case, demonstration, .. } in sources {
            // What took place in another warehouse was never true of this one.
            if demonstration == DemonstrationKind::Elsewhere as u16 {
                continue;
            }
            let known = self.stale.get(&(case, demonstration)).copied();
            let is_stale = match known {
                Some(is_stale) => is_stale,
                None if demonstration == EXPERIENCE => {
                    let source = own.and_then(|own| own.get(&case));
                    let source = source.ok_or_else(|| format!("experience of position {case}"))?;
                    source.is_complete && !source.completes_in.contains(&variant)
                }
                None => {
                    let of = demonstration_of(context, case, demonstration);
                    let of =
                        of.ok_or_else(|| format!("case {case}, demonstration {demonstration}"))?;
                    // The oracle's demonstrations take place in this world.
                    episode.key.condition.arm != Arm::Oracle && context.book().is_stale(variant, of)
                }
            };
            self.stale.insert((case, demonstration), is_stale);
            *retrievals += 1;
            *stale += u32::from(is_stale);
        }
        Ok(())
    }
}

/// The index of a case's demonstration.
fn demonstration_of(context: &Context<'_>, case: u32, code: u16) -> Option<u32> {
    let listed = context.books.demonstrations.book.cases.get(case as usize)?;
    match DemonstrationKind::from_code(code)? {
        DemonstrationKind::After => listed.after,
        DemonstrationKind::Elsewhere => listed.elsewhere,
        DemonstrationKind::New => listed.new,
        DemonstrationKind::Blocked => listed.blocked,
        kind => listed.own.get(kind as usize).copied(),
    }
}
