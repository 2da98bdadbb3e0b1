//! Units: the parts of a run that are executed by themselves, on any machine, in any order.
//!
//! A unit has consecutive episodes of the run; in streams, whole sequences. Episodes of a case follow each other, so a unit
//! renders the views of its cases once. It is a run with a run folder of its own.

use std::fs;
use std::io::Write;
use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Error, Result, bail, ensure};
use replay::World;
use results::log::{Manifest, UnitEpisode, UnitId};
use results::settings::RunSettings;
use serde::{Deserialize, Serialize};

use crate::plan::PlannedEpisode;
use crate::selection::SelectedCases;
use crate::store::Shipment;

/// Changes when a plan means something else, such as other episodes of a unit.
const FORMAT: u32 = 2;

/// Episodes of a unit, where nothing is said.
pub const UNIT_EPISODES: u32 = 500;

/// A run that is divided into units, as its file holds it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnitPlan {
    /// [`FORMAT`] of the file.
    format: u32,
    /// Number of units.
    pub units: u32,
    /// Episodes of every unit but the last.
    unit_episodes: u32,
    /// The manifest of the whole run.
    pub manifest: Manifest,
    /// What workers get from a store; `None` without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shipment: Option<Shipment>,
}

/// A plan, and the hash of its file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReadPlan {
    /// The plan.
    pub plan: UnitPlan,
    /// BLAKE3 of the file, as hexadecimal digits.
    pub digest: String,
}

impl UnitPlan {
    /// The run that `manifest` describes, in units of `unit_episodes`; in streams, of as many whole sequences as fit, at least
    /// one.
    pub fn new(manifest: Manifest, unit_episodes: u32) -> Self {
        let sequence = manifest.settings.stream.as_ref().map_or(1, |s| s.sequence_episodes());
        let sequence = (sequence as u32).max(1);
        let unit_episodes = (unit_episodes / sequence).max(1) * sequence;
        let units = manifest.episodes.div_ceil(unit_episodes);
        Self { format: FORMAT, units, unit_episodes, manifest, shipment: None }
    }

    /// Reads the plan in `path`.
    ///
    /// # Errors
    /// When the file cannot be read, or is no plan of this format.
    pub fn read(path: &Path) -> Result<ReadPlan> {
        let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::parse(&bytes, path)
    }

    /// The plan that the file `path` holds, whose content is `bytes`.
    ///
    /// # Errors
    /// When it is not a plan that this program can use.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<ReadPlan> {
        let plan: Self = serde_json::from_slice(bytes).with_context(|| {
            format!("{} is no plan: `memtransfer plan --out FILE` writes one", path.display())
        })?;
        ensure!(
            plan.format == FORMAT,
            "{} has the format {}, and this program reads {FORMAT}: write it again with `memtransfer plan`, or use the build of \
             version {} that wrote it",
            path.display(),
            plan.format,
            plan.manifest.version
        );
        ensure!(
            plan.unit_episodes > 0 && plan.units > 0,
            "{} has no units: write the plan again",
            path.display()
        );
        let size = plan.manifest.settings.check_size();
        size.map_err(Error::msg).with_context(|| format!("cannot use {}", path.display()))?;
        Ok(ReadPlan { plan, digest: blake3::hash(bytes).to_hex().to_string() })
    }

    /// Writes it into the file `path`, all of it or nothing.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut draft = path.as_os_str().to_owned();
        draft.push(".new");
        let write = || {
            let mut file = fs::File::create(&draft)?;
            serde_json::to_writer_pretty(&mut file, self)?;
            file.write_all(b"\n")?;
            file.sync_all()?;
            fs::rename(&draft, path)
        };
        write().with_context(|| format!("cannot write {}", path.display()))
    }

    /// Whether `other` has the same units and store. The embeddings that were known when a plan was written may differ.
    pub fn is_of_same_units(&self, other: &Self) -> bool {
        let store = |plan: &Self| plan.shipment.as_ref().map(|shipment| shipment.store.clone());
        let without = |plan: &Self| Self { shipment: None, ..plan.clone() };
        without(self) == without(other) && store(self) == store(other)
    }

    /// The units of `episodes`, which are all of the run in their order, of what `selection` has.
    pub fn assign(
        &self,
        selection: &SelectedCases,
        episodes: impl Iterator<Item = PlannedEpisode>,
    ) -> impl Iterator<Item = UnitEpisode> {
        let size = self.unit_episodes;
        let World { warehouse, cases, .. } = &selection.world;
        let numbered = (0_u32..).zip(episodes);
        numbered.map(move |(number, episode)| UnitEpisode {
            key: episode.key.to_string(),
            unit: number / size,
            task: cases.cases[episode.case_index].task.number(),
            seed: episode.seed,
            reference: episode.reference_length(warehouse, cases, selection.streams.as_ref()),
        })
    }
}

impl ReadPlan {
    /// The id of a unit.
    pub fn unit_id(&self, number: u32) -> UnitId {
        UnitId { plan: self.digest.clone(), number }
    }

    /// The settings of the run that a unit is, before its external memories tell their names, and which episodes of the whole
    /// run it has.
    ///
    /// # Errors
    /// When there is no such unit.
    pub fn unit(&self, number: u32) -> Result<(RunSettings, Range<usize>)> {
        let UnitPlan { manifest, units, unit_episodes, .. } = &self.plan;
        if number >= *units {
            bail!("the plan has the units 0 to {}, and no unit {number}", units - 1);
        }
        let mut settings = manifest.settings.clone();
        settings.learning_memories.clear();
        for group in &mut settings.groups {
            group.memory.retain(|memory| memory.external().is_none());
        }
        let start = number.saturating_mul(*unit_episodes);
        let end = start.saturating_add(*unit_episodes).min(manifest.episodes);
        Ok((settings, start as usize..end as usize))
    }
}

#[cfg(test)]
mod tests {
    use results::log::testing::manifest;

    use super::*;
    use settings::{Layer, resolve};

    fn settings(flags: &[(&str, &str)]) -> RunSettings {
        resolve([Layer::flags(flags.iter().copied()).unwrap()]).unwrap().settings
    }

    /// The plan of a run, and the keys of each of its units, as `merge` divides them.
    fn divided(settings: RunSettings, unit_episodes: u32) -> (ReadPlan, Vec<Vec<String>>) {
        let selection = SelectedCases::of(&settings).unwrap();
        let episodes = selection.with_episodes(&settings, |episodes| episodes.count()) as u32;
        let plan = UnitPlan::new(Manifest { settings, episodes, ..manifest() }, unit_episodes);
        let mut units = vec![Vec::new(); plan.units as usize];
        selection.with_episodes(&plan.manifest.settings, |episodes| {
            plan.assign(&selection, episodes)
                .for_each(|episode| units[episode.unit as usize].push(episode.key))
        });
        (ReadPlan { plan, digest: String::new() }, units)
    }

    /// The keys of each unit, as `work` selects them.
    fn selected(plan: &ReadPlan) -> Vec<Vec<String>> {
        let unit = |number| {
            let (settings, range) = plan.unit(number).unwrap();
            let keys = |episodes: &mut dyn Iterator<Item = PlannedEpisode>| {
                let keys = episodes.map(|episode| episode.key.to_string());
                keys.skip(range.start).take(range.len()).collect()
            };
            SelectedCases::of(&settings).unwrap().with_episodes(&settings, keys)
        };
        (0..plan.plan.units).map(unit).collect()
    }

    #[test]
    fn a_worker_and_the_merge_divide_a_run_alike() {
        let settings = settings(&[("suite", "rq2"), ("limit", "7"), ("runs", "2")]);
        let (plan, units) = divided(settings, 50);
        assert!(units.iter().map(Vec::len).eq([50, 50, 50, 18]));
        assert_eq!(selected(&plan), units);
        let error = plan.unit(4).unwrap_err().to_string();
        insta::assert_snapshot!(error, @"the plan has the units 0 to 3, and no unit 4");
    }

    #[test]
    fn sequences_are_not_divided() {
        let flags =
            [("suite", "stream"), ("streams", "2"), ("orders", "drawn"), ("memory", "working")];
        let settings = settings(&flags);
        let sequence = settings.stream.as_ref().unwrap().sequence_episodes();
        for (most, sequences) in [(1, 1), (sequence, 1), (2 * sequence + 1, 2)] {
            let (plan, units) = divided(settings.clone(), most as u32);
            assert!(units.iter().all(|keys| keys.len() == sequences * sequence), "{most}");
            assert_eq!(selected(&plan), units);
        }
    }

    #[test]
    fn a_plan_is_read_as_it_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plan.json");
        let plan = UnitPlan::new(manifest(), 30);
        plan.write(&path).unwrap();
        let read = UnitPlan::read(&path).unwrap();
        assert_eq!(read.plan, plan);
        let hash = blake3::hash(&fs::read(&path).unwrap());
        assert_eq!(read.unit_id(3), UnitId { plan: hash.to_hex().to_string(), number: 3 });
        fs::write(&path, "{}").unwrap();
        assert!(UnitPlan::read(&path).unwrap_err().to_string().contains("is no plan"));
        UnitPlan { format: 1, ..plan }.write(&path).unwrap();
        let error = UnitPlan::read(&path).unwrap_err().to_string();
        assert!(error.contains("reads 2: write it again with `memtransfer plan`"), "{error}");
    }
}
