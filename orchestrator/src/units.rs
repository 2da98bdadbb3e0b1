//! Units: the parts of a run that are executed by themselves, on any machine, in any order.
//!
//! A unit has consecutive episodes of one condition; in streams, whole sequences. It is a run with a run folder of its own.
//! Which unit an episode belongs to follows from the settings and the size of units, so a plan lists neither.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use domain::MemoryKind;
use results::conditions::Condition;
use results::log::{Manifest, UnitEpisode, UnitId};
use results::settings::{Group, RunSettings};
use serde::{Deserialize, Serialize};

use crate::plan::PlannedEpisode;

/// Changes when programs that read the old plans cannot read the new ones.
const FORMAT: u32 = 1;

/// Episodes of a unit, where nothing is said.
pub const UNIT_EPISODES: u32 = 100;

/// A run that is divided into units, as its file holds it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnitPlan {
    /// [`FORMAT`] of the file.
    format: u32,
    /// Number of units.
    pub units: u32,
    /// Most episodes of a unit, unless a sequence has more.
    pub unit_episodes: u32,
    /// The selected cases.
    cases: u32,
    /// The manifest of the whole run.
    pub manifest: Manifest,
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
    /// The run that `manifest` describes, with so many selected cases, in units of `unit_episodes`.
    pub fn new(manifest: Manifest, cases: usize, unit_episodes: u32) -> Self {
        let cases = cases as u32;
        let units = Division::of(&manifest.settings, cases, unit_episodes).units();
        Self { format: FORMAT, units, unit_episodes, cases, manifest }
    }

    /// Reads the plan in `path`.
    ///
    /// # Errors
    /// When the file cannot be read, or is no plan of this format.
    pub fn read(path: &Path) -> Result<ReadPlan> {
        let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        let plan: Self = serde_json::from_slice(&bytes).with_context(|| {
            format!("{} is no plan: `memtransfer plan --out FILE` writes one", path.display())
        })?;
        ensure!(
            plan.format == FORMAT,
            "{} has the format {}, and this program reads {FORMAT}: use the version {} of memtransfer",
            path.display(),
            plan.format,
            plan.manifest.version
        );
        Ok(ReadPlan { plan, digest: blake3::hash(&bytes).to_hex().to_string() })
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

    /// How the run is divided.
    pub fn division(&self) -> Division {
        Division::of(&self.manifest.settings, self.cases, self.unit_episodes)
    }
}

impl ReadPlan {
    /// The id of a unit.
    pub fn unit_id(&self, number: u32) -> UnitId {
        UnitId { plan: self.digest.clone(), number }
    }

    /// The settings of the run that a unit is: those of the plan with its condition alone, and with the external memory
    /// that the condition needs, if it needs one.
    ///
    /// # Errors
    /// When there is no such unit.
    pub fn unit_settings(&self, number: u32) -> Result<(RunSettings, Range<usize>)> {
        let UnitPlan { manifest, units, .. } = &self.plan;
        let Some((&(condition, runs), episodes)) = self.plan.division().unit(number) else {
            bail!("the plan has the units 0 to {}, and no unit {number}", units - 1);
        };
        let (memory, memory_cmd) = match condition.memory {
            MemoryKind::BuiltIn(_) => (vec![condition.memory], Vec::new()),
            // It tells its name when it starts.
            MemoryKind::External(name) => {
                let facts = manifest.memories.get(&name);
                (Vec::new(), facts.and_then(|facts| facts.command.clone()).into_iter().collect())
            }
        };
        let group = Group {
            name: None,
            memory,
            starts: vec![condition.start],
            routes: vec![condition.route],
            demos: vec![condition.demonstrations],
            window: vec![condition.variation.window],
            segment: vec![condition.variation.segment],
            hint: vec![condition.variation.hint],
            arms: vec![condition.arm],
            runs,
        };
        let settings = RunSettings {
            groups: vec![group],
            memory_cmd,
            learning_memories: Default::default(),
            ..manifest.settings.clone()
        };
        Ok((settings, episodes))
    }
}

/// How the episodes of a run are divided into units.
#[derive(Debug, Clone)]
pub struct Division {
    /// Episodes of every unit but the last of a condition.
    size: u64,
    parts: Vec<DividedCondition>,
}

/// The units of a condition.
#[derive(Debug, Clone, Copy)]
struct DividedCondition {
    condition: (Condition, u32),
    episodes: u64,
    first_unit: u32,
}

impl Division {
    /// A run with `settings` and so many cases, in units of `unit_episodes`, or more where a sequence has more.
    fn of(settings: &RunSettings, cases: u32, unit_episodes: u32) -> Self {
        let unit_episodes = u64::from(unit_episodes.max(1));
        let (size, each) = match &settings.stream {
            Some(stream) => {
                let sequence = (stream.sequence_episodes() as u64).max(1);
                ((unit_episodes / sequence).max(1) * sequence, stream.all_episodes() as u64)
            }
            None => (unit_episodes, u64::from(cases)),
        };
        let mut first_unit = 0;
        let parts = settings.runs().into_iter().map(|condition| {
            let episodes = each * u64::from(condition.1);
            let part = DividedCondition { condition, episodes, first_unit };
            first_unit += episodes.div_ceil(size) as u32;
            part
        });
        Self { parts: parts.collect(), size }
    }

    /// Number of units.
    pub fn units(&self) -> u32 {
        let units = |part: &DividedCondition| part.episodes.div_ceil(self.size) as u32;
        self.parts.iter().map(units).sum()
    }

    /// The condition of a unit with its repetitions, and which of that condition's episodes the unit has.
    fn unit(&self, number: u32) -> Option<(&(Condition, u32), Range<usize>)> {
        let part = self.parts.iter().rev().find(|part| part.first_unit <= number)?;
        let start = u64::from(number - part.first_unit) * self.size;
        let end = (start + self.size).min(part.episodes);
        (start < end).then_some((&part.condition, start as usize..end as usize))
    }

    /// The units of `episodes`, which are all of the run in their order.
    pub fn assign<'a>(
        &'a self,
        episodes: impl Iterator<Item = PlannedEpisode> + 'a,
    ) -> impl Iterator<Item = UnitEpisode> + 'a {
        let parts = (0..).zip(&self.parts).map(|(index, part)| (part.condition.0, (index, part)));
        let parts: BTreeMap<Condition, (usize, &DividedCondition)> = parts.collect();
        let mut counts = vec![0; self.parts.len()];
        episodes.filter_map(move |episode| {
            let &(condition, part) = parts.get(&episode.key.condition)?;
            let unit = part.first_unit + (counts[condition] / self.size) as u32;
            counts[condition] += 1;
            Some(UnitEpisode { key: episode.key.to_string(), unit, condition })
        })
    }
}

#[cfg(test)]
mod tests {
    use results::log::testing::manifest;

    use super::*;
    use crate::selection::Selection;
    use crate::settings::{Layer, resolve};

    fn settings(flags: &[(&str, &str)]) -> RunSettings {
        resolve([Layer::flags(flags.iter().copied()).unwrap()]).unwrap().settings
    }

    /// The plan of a run, and the keys of each of its units, as `merge` divides them.
    fn divided(settings: RunSettings, unit_episodes: u32) -> (ReadPlan, Vec<Vec<String>>) {
        let selection = Selection::of(&settings).unwrap();
        let manifest = Manifest { settings, ..manifest() };
        let plan = UnitPlan::new(manifest, selection.cases.len(), unit_episodes);
        let (division, settings) = (plan.division(), &plan.manifest.settings);
        let mut units = vec![Vec::new(); plan.units as usize];
        selection.with_episodes(settings, |episodes| {
            division
                .assign(episodes)
                .for_each(|episode| units[episode.unit as usize].push(episode.key))
        });
        (ReadPlan { plan, digest: String::new() }, units)
    }

    /// The keys of each unit, as `work` selects them.
    fn selected(plan: &ReadPlan) -> Vec<Vec<String>> {
        let unit = |number| {
            let (settings, range) = plan.unit_settings(number).unwrap();
            let keys = |episodes: &mut dyn Iterator<Item = PlannedEpisode>| {
                let keys = episodes.map(|episode| episode.key.to_string());
                keys.skip(range.start).take(range.len()).collect()
            };
            Selection::of(&settings).unwrap().with_episodes(&settings, keys)
        };
        (0..plan.plan.units).map(unit).collect()
    }

    #[test]
    fn a_worker_and_the_merge_divide_a_run_alike() {
        let settings = settings(&[("suite", "rq2"), ("limit", "7"), ("runs", "2")]);
        let (plan, units) = divided(settings, 5);
        assert_eq!(units.len(), 12 * 3);
        assert_eq!(units.iter().map(Vec::len).sum::<usize>(), 12 * 7 * 2);
        assert!(units[..3].iter().map(Vec::len).eq([5, 5, 4]));
        let condition = |key: &String| key.split("/run").next().map(str::to_owned);
        assert!(
            units.iter().all(|keys| keys.iter().all(|key| condition(key) == condition(&keys[0])))
        );
        assert_eq!(selected(&plan), units);
        let error = plan.unit_settings(36).unwrap_err().to_string();
        insta::assert_snapshot!(error, @"the plan has the units 0 to 35, and no unit 36");
    }

    #[test]
    fn sequences_are_not_divided() {
        let flags =
            [("suite", "stream"), ("streams", "2"), ("orders", "drawn"), ("memory", "working")];
        let settings = settings(&flags);
        let sequence = settings.stream.as_ref().unwrap().sequence_episodes();
        for (unit_episodes, sequences) in
            [(1, 1), (sequence as u32, 1), (2 * sequence as u32 + 1, 2)]
        {
            let (plan, units) = divided(settings.clone(), unit_episodes);
            assert!(units.iter().all(|keys| keys.len() == sequences * sequence), "{unit_episodes}");
            assert_eq!(selected(&plan), units);
        }
    }

    #[test]
    fn a_plan_is_read_as_it_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plan.json");
        let plan = UnitPlan::new(manifest(), 100, 30);
        plan.write(&path).unwrap();
        let read = UnitPlan::read(&path).unwrap();
        assert_eq!(read.plan, plan);
        let hash = blake3::hash(&fs::read(&path).unwrap());
        assert_eq!(read.unit_id(3), UnitId { plan: hash.to_hex().to_string(), number: 3 });
        fs::write(&path, "{}").unwrap();
        assert!(UnitPlan::read(&path).unwrap_err().to_string().contains("is no plan"));
    }
}
