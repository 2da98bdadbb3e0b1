//! Folders with finished units of a plan, and whether they belong to it.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::MergeError;
use crate::folder::LEARNED_FACTS;
use crate::manifest::MANIFEST_FILE;
use crate::{Difference, LogError, Manifest, UnitId, system};

/// Facts that a process reports and that may change pixels or embeddings in the last bits: role and name.
const FACTS: [(&str, &str); 6] = [
    ("sim", "backend"),
    ("sim", "adapter"),
    ("memory", "encoder_sha256"),
    ("memory", "encoder_provider"),
    ("memory", "onnxruntime"),
    ("machine", "processor"),
];

/// A fact that says where embeddings were computed.
const EMBEDS: (&str, &str) = ("memory", "encoder_sha256");

/// A machine's part in the run differs from another's in a fact that may change results in the last bits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FactDifference {
    /// Role and name of the fact.
    pub fact: (&'static str, &'static str),
    /// The values, each with the folder of a unit that has it.
    pub values: Vec<(String, PathBuf)>,
}

impl fmt::Display for FactDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (role, name) = self.fact;
        write!(f, "{role}, {name}:")?;
        self.values
            .iter()
            .try_for_each(|(value, dir)| write!(f, "\n  {value} in {}", dir.display()))
    }
}

/// The name of the folder of a finished unit.
pub fn unit_folder(unit: u32) -> String {
    format!("unit-{unit:06}")
}

/// Makes the run folder `part` the finished folder `whole` of a unit: everything in it is on the disk before it has its name.
/// If the unit was finished elsewhere meanwhile, `part` is removed.
///
/// # Errors
/// When the system refuses.
pub fn finish_unit(part: &Path, whole: &Path) -> Result<(), LogError> {
    sync_all(part).map_err(system("flush", part))?;
    if let Err(error) = fs::rename(part, whole) {
        if !whole.exists() {
            return Err(system("rename", part)(error));
        }
        if part.exists() {
            fs::remove_dir_all(part).map_err(system("remove", part))?;
        }
    }
    durable::sync_name(whole).map_err(system("flush", whole))
}

pub(super) fn sync_all(dir: &Path) -> io::Result<()> {
    for entry in fs::read_dir(dir)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync_all(&entry.path())?;
        } else {
            File::open(entry.path())?.sync_all()?;
        }
    }
    File::open(dir)?.sync_all()
}

/// Folders with finished units.
#[derive(Debug, Clone)]
pub struct UnitFolders(pub Vec<PathBuf>);

impl UnitFolders {
    /// The folders of the executions of a unit.
    pub fn of(&self, unit: u32) -> Vec<PathBuf> {
        let name = unit_folder(unit);
        self.0.iter().map(|dir| dir.join(&name)).filter(|dir| dir.is_dir()).collect()
    }

    /// The units below `units` that have no folder.
    pub fn missing(&self, units: u32) -> Vec<u32> {
        (0..units).filter(|&unit| self.of(unit).is_empty()).collect()
    }

    /// Checks that all units below `units` are of the plan with the hash `plan` and the manifest `of_plan`. Adds to that what
    /// processes reported about themselves and returns in what machines differ. No unit is missing.
    ///
    /// # Errors
    /// When a unit is of another plan, or has no manifest that can be read.
    pub fn check(
        &self,
        units: u32,
        plan: &str,
        of_plan: &mut Manifest,
    ) -> Result<Vec<FactDifference>, MergeError> {
        let mut values: BTreeMap<(&str, &str), Vec<(String, PathBuf)>> = BTreeMap::new();
        for number in 0..units {
            for dir in self.of(number) {
                let unit = Manifest::read(&dir).map_err(|error| match error {
                    LogError::BrokenManifest { problem, .. } => MergeError::Broken {
                        dir: dir.clone(),
                        problem: format!("{MANIFEST_FILE}: {problem}"),
                    },
                    error => error.into(),
                })?;
                let id = UnitId { plan: plan.to_owned(), number };
                let differs = unit_difference(&unit, &id, of_plan);
                if let Some(problem) = differs {
                    return Err(MergeError::OtherPlan { dir, number, problem });
                }
                let fact = |(role, name): (&str, &str)| unit.processes.get(role)?.get(name);
                for of_machine in FACTS {
                    let Some(value) = fact(of_machine) else { continue };
                    let known = values.entry(of_machine).or_default();
                    let matters = of_machine.0 != "machine" || fact(EMBEDS).is_some();
                    if matters && known.iter().all(|(known, _)| known != value) {
                        known.push((value.clone(), dir.clone()));
                    }
                }
                for (role, facts) in unit.processes {
                    let known = of_plan.processes.entry(role).or_default();
                    facts.into_iter().for_each(|(name, value)| {
                        let is_learned = LEARNED_FACTS.contains(&name.as_str());
                        let joined = known.entry(name).or_insert_with(|| value.clone());
                        // A policy's requests may have met different servers.
                        if is_learned && !joined.contains(&value) {
                            *joined += &format!("; in other units {value}");
                        }
                    });
                }
            }
        }
        let differing = values.into_iter().filter(|(_, values)| values.len() > 1);
        Ok(differing.map(|(fact, values)| FactDifference { fact, values }).collect())
    }
}

/// In what a unit's manifest is not that of the unit `id` of a plan.
fn unit_difference(unit: &Manifest, id: &UnitId, plan: &Manifest) -> Option<String> {
    match &unit.unit {
        None => return Some("it is a run of its own".to_owned()),
        Some(own) if own != id => {
            return Some(format!("it is unit {} of the plan {}", own.number, own.plan));
        }
        Some(_) => {}
    }
    let as_plan = Manifest { unit: None, ..unit.clone() };
    let differences: Vec<Difference> = as_plan.differences(plan);
    (!differences.is_empty())
        .then(|| differences.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))
}
