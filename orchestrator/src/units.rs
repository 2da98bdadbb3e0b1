//! Units: the parts of a run that are executed by themselves, on any machine, in any order.
//!
//! A unit has consecutive episodes of the run; in streams, whole sequences. Episodes of a case follow each other, so a unit
//! renders the views of its cases once. It is a run with a run folder of its own.

use std::fs;
use std::io::{ErrorKind, Write};
use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Error, Result, anyhow, bail, ensure};
use conditions::PolicyKind;
use conditions::settings::RunSettings;
use run_log::{Manifest, PlannedFacts, UnitEpisode, UnitId};
use serde::{Deserialize, Serialize};

use crate::plan::PlannedEpisode;
use crate::selection::SelectedCases;
use crate::store::Shipment;

/// Changes when a plan means something else, such as other episodes of a unit.
const FORMAT: u32 = 2;

/// The advice about a file that is no plan, or no longer one.
const WRITE_IT: &str = "Write another with `memtransfer plan --out FILE`";

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
        let bytes = durable::input::read(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        Self::parse(&bytes, path)
    }

    /// The plan that the file `path` holds, whose content is `bytes`.
    ///
    /// # Errors
    /// When it is not a plan that this program can use.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<ReadPlan> {
        let text = String::from_utf8_lossy(bytes);
        let plan: Self = serde_json::from_slice(bytes).map_err(|error| {
            let line = text.lines().nth(error.line().saturating_sub(1)).unwrap_or_default().trim();
            anyhow!("{} is no plan: {error}: `{line}`. {WRITE_IT}", path.display())
        })?;
        ensure!(
            plan.format == FORMAT,
            "{} has the format {}, and this program reads {FORMAT}: write another with `memtransfer plan`, or use the build of \
             version {} that wrote it",
            path.display(),
            plan.format,
            plan.manifest.version
        );
        let checked = plan.check().and_then(|()| plan.check_text(&text));
        checked.map_err(|error| anyhow!("cannot use {}: {error:#}. {WRITE_IT}", path.display()))?;
        Ok(ReadPlan { plan, digest: blake3::hash(bytes).to_hex().to_string() })
    }

    /// Checks that it is a plan that [`UnitPlan::new`] makes, as far as that can be told without the world.
    fn check(&self) -> Result<()> {
        let Self { units, unit_episodes, manifest, .. } = self;
        let Manifest { episodes, settings, memories, .. } = manifest;
        ensure!(*unit_episodes > 0, "`unit_episodes` is 0");
        ensure!(*episodes > 0, "`episodes` is 0");
        let divided = episodes.div_ceil(*unit_episodes);
        ensure!(
            *units == divided,
            "`units` is {units}, and {episodes} episodes in units of {unit_episodes} are {divided}"
        );
        ensure!(
            manifest.format == run_log::FORMAT,
            "`format` of its manifest is {}, and this program has {}",
            manifest.format,
            run_log::FORMAT
        );
        ensure!(manifest.unit.is_none(), "`unit` is set, and a plan is no unit");
        ensure!(manifest.processes.is_empty(), "`processes` is set, and no process has begun");
        settings.check_size().map_err(Error::msg)?;
        settings::check_values(settings)?;
        for name in settings.external_names() {
            ensure!(memories.contains_key(&name), "the memory {name} is not among its `memories`");
        }
        ensure!(
            settings.policy != PolicyKind::Openai || settings.model.is_some(),
            "`policy` is openai, and there is no `model`"
        );
        settings::check(settings)
    }

    /// Checks that `text` is what [`UnitPlan::write`] writes: it has no fields, line ends or values that mean nothing.
    fn check_text(&self, text: &str) -> Result<()> {
        ensure!(!text.contains('\r'), "its line ends are those of Windows");
        let written = serde_json::to_string_pretty(self)?;
        let mut lines = (1..).zip(text.lines().zip(written.lines()));
        // A line before one that was added has another comma.
        let differ = |found: &str, written: &str| {
            found.trim_end_matches(',') != written.trim_end_matches(',')
        };
        match lines.find(|(_, (found, written))| differ(found, written)) {
            None => Ok(()),
            Some((number, (found, _))) => {
                bail!("line {number} is not as it was written: `{}`", found.trim())
            }
        }
    }

    /// Writes it into the file `path`, all of it or nothing.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut draft = path.as_os_str().to_owned();
        draft.push(".new");
        let write = || {
            // A link in the draft's place goes, and not what it points to.
            match fs::remove_file(&draft) {
                Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
                _ => {}
            }
            let mut file = durable::output::create(Path::new(&draft))?;
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
        let book = selection.book();
        let numbered = (0_u32..).zip(episodes);
        numbered.map(move |(number, episode)| UnitEpisode {
            key: episode.key.to_string(),
            unit: number / size,
            facts: PlannedFacts {
                task: book.cases[episode.case_index].task,
                seed: episode.seed,
                reference: episode.expert(book).map_or(0, |expert| expert.length),
            },
        })
    }
}

impl ReadPlan {
    /// Checks that the plan, in the file `path`, has as many episodes as its settings select; not in another world than the
    /// plan's.
    ///
    /// # Errors
    /// When it has more or fewer.
    pub fn check_episodes(&self, selection: &SelectedCases, path: &Path) -> Result<()> {
        let Manifest { episodes, settings, hashes, .. } = &self.plan.manifest;
        if selection.books.world_hashes().iter().any(|(name, hash)| hashes.get(name) != Some(hash))
        {
            return Ok(());
        }
        let selected = selection.count(settings);
        ensure!(
            selected == *episodes as usize,
            "cannot use {}: `episodes` is {episodes}, and its settings select {selected}. {WRITE_IT}",
            path.display()
        );
        Ok(())
    }

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
    use rigs::records::manifest;

    use super::*;
    use crate::testing::select;
    use settings::{Layer, resolve};

    fn settings(flags: &[(&str, &str)]) -> RunSettings {
        resolve([Layer::flags(flags.iter().copied()).unwrap()]).unwrap().settings
    }

    /// The plan of a run, and the keys of each of its units, as `merge` divides them.
    fn divided(settings: RunSettings, unit_episodes: u32) -> (ReadPlan, Vec<Vec<String>>) {
        let selection = select(&settings);
        let episodes = selection.count(&settings) as u32;
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
            select(&settings).with_episodes(&settings, keys)
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
        UnitPlan { format: 1, ..plan }.write(&path).unwrap();
        let error = UnitPlan::read(&path).unwrap_err().to_string();
        assert!(error.contains("reads 2: write another with `memtransfer plan`"), "{error}");
    }

    #[test]
    fn an_edit_is_named_with_the_file_the_field_and_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plan.json");
        let settings = settings(&[("limit", "2"), ("memory", "working"), ("starts", "new")]);
        let selection = select(&settings);
        let hashes = selection.books.hashes();
        let manifest = Manifest { settings, hashes, episodes: 2, ..manifest() };
        UnitPlan::new(manifest, 1).write(&path).unwrap();
        let written = fs::read_to_string(&path).unwrap();
        let read = || UnitPlan::parse(&fs::read(&path).unwrap(), Path::new("plan.json"));
        read().unwrap().check_episodes(&selection, &path).unwrap();
        let mut said = Vec::new();
        for (from, to) in [
            ("\"units\": 2", "\"units\": 4000000000"),
            ("\"units\": 2", "\"units\": -2"),
            ("\"units\": 2,", ""),
            ("\"units\": 2", "\"units\": 2,\n  \"unit_size\": 3"),
            ("\"unit_episodes\": 1", "\"unit_episodes\": 0"),
            ("\"lanes\": 16", "\"lanes\": 0"),
            ("\"lanes\": 16", "\"lames\": 16,\n      \"lanes\": 16"),
            ("\"working\"", "\"wrking\""),
            ("\"working\"", ""),
            ("\"policy\": \"grounded\"", "\"policy\": \"openai\""),
            ("\"processes\": {}", "\"processes\": {\"sim\": {}}"),
            ("\"processes\": {}", "\"processes\": {},\n    \"colour\": 3"),
            ("\n", "\r\n"),
        ] {
            assert!(written.contains(from), "{from}");
            fs::write(&path, written.replacen(from, to, 1)).unwrap();
            said.push(read().unwrap_err().to_string());
        }
        insta::assert_snapshot!(said.join("\n"), @r#"
        cannot use plan.json: `units` is 4000000000, and 2 episodes in units of 1 are 2. Write another with `memtransfer plan --out FILE`
        plan.json is no plan: invalid value: integer `-2`, expected u32 at line 3 column 13: `"units": -2,`. Write another with `memtransfer plan --out FILE`
        plan.json is no plan: missing field `units` at line 75 column 1: `}`. Write another with `memtransfer plan --out FILE`
        cannot use plan.json: line 4 is not as it was written: `"unit_size": 3,`. Write another with `memtransfer plan --out FILE`
        cannot use plan.json: `unit_episodes` is 0. Write another with `memtransfer plan --out FILE`
        cannot use plan.json: lanes: 0 is not a whole number from 1 to 1024. Write another with `memtransfer plan --out FILE`
        cannot use plan.json: line 57 is not as it was written: `"lames": 16,`. Write another with `memtransfer plan --out FILE`
        cannot use plan.json: the memory wrking is not among its `memories`. Write another with `memtransfer plan --out FILE`
        cannot use plan.json: no memory is left: `--memory none` is for a memory of your own (--memory-cmd, or `external` in --memory). Write another with `memtransfer plan --out FILE`
        cannot use plan.json: `policy` is openai, and there is no `model`. Write another with `memtransfer plan --out FILE`
        cannot use plan.json: `processes` is set, and no process has begun. Write another with `memtransfer plan --out FILE`
        cannot use plan.json: line 74 is not as it was written: `"colour": 3`. Write another with `memtransfer plan --out FILE`
        cannot use plan.json: its line ends are those of Windows. Write another with `memtransfer plan --out FILE`
        "#);
        for (from, to) in [("\"limit\": 2", "\"limit\": 1"), ("\"limit\": 2", "\"limit\": 3")] {
            fs::write(&path, written.replacen(from, to, 1)).unwrap();
            let edited = read().unwrap();
            let selection = select(&edited.plan.manifest.settings);
            let error = edited.check_episodes(&selection, Path::new("plan.json")).unwrap_err();
            assert!(
                error.to_string().contains("plan.json: `episodes` is 2, and its settings select"),
                "{error}"
            );
        }
        fs::write(&path, "{}").unwrap();
        assert!(read().unwrap_err().to_string().contains("is no plan"));
    }
}
