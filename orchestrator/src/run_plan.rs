//! A run before it is executed: its settings and the episodes that follow from them.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use build_commit::COMMIT;
use conditions::cost::ModelPrices;
use conditions::settings::RunSettings;
use domain::ExternalName;
use domain::representation::Trajectories;
use prompt::Template;
use run_log::{FORMAT, LOGS_FOLDER, Manifest, PROMPT_FILE, PROMPT_HASH, RunFolder, UnitId};
use shm_types::description::Scope;
use shm_types::message::{MAX_SOURCES, WIRE_VERSION};

use crate::books::Books;
use crate::command_files::command_files;
use crate::external_memory::{self, ExternalMemory, StartedMemories};
use crate::invocation::Invocation;
use crate::launch;
use crate::plan::PlannedEpisode;
use crate::progress::{ProgressDisplay, say};
use crate::run_documents::{DocumentSupply, RecordDocuments, RunDocuments};
use crate::selection::SelectedCases;

/// What a plan of a run is made for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// It is executed now. External memories write their logs into its folder.
    Execution,
    /// It is executed later, in units. External memories tell their names, and end.
    Units,
    /// It is described. No program is started.
    DryRun,
}

/// Which of the episodes that the settings select a plan has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Selected {
    /// All.
    All,
    /// Those of this range, as a unit does.
    Range(Range<usize>),
    /// Those of this repetition, from 1.
    Repetition(u32),
}

impl Selected {
    fn of(&self, episodes: &mut dyn Iterator<Item = PlannedEpisode>) -> Vec<PlannedEpisode> {
        match self {
            Self::All => episodes.collect(),
            Self::Range(range) => episodes.skip(range.start).take(range.len()).collect(),
            Self::Repetition(repetition) => {
                episodes.filter(|episode| episode.key.run == *repetition).collect()
            }
        }
    }
}

/// A run before it starts.
#[derive(Debug)]
pub struct RunPlan {
    /// Its settings, with the names of its external memories.
    pub settings: RunSettings,
    /// What the world tells about its cases.
    pub books: Books,
    /// Its episodes, in their order.
    pub episodes: Vec<PlannedEpisode>,
    /// The unit of a plan that it is.
    pub unit: Option<UnitId>,
    /// The file of embeddings that came with the plan.
    pub shipped_embeddings: Option<PathBuf>,
    /// The prices of its model.
    pub prices: Option<ModelPrices>,
    /// The user's template of its prompts.
    pub prompt: Option<Template>,
    /// Its external memories; `None` without any.
    pub started: Option<StartedMemories>,
}

impl RunPlan {
    /// The plan of a run with `settings` that has those of its episodes that are `selected`, once its external memories have told
    /// their names. `None` when asked to stop meanwhile.
    ///
    /// # Errors
    /// When the settings cannot be used together, select no episode, or name a file that cannot be read; when an external memory
    /// cannot take part.
    pub fn new(
        mut settings: RunSettings,
        selected: &Selected,
        purpose: Purpose,
        invocation: &Invocation<'_>,
    ) -> Result<Option<Self>> {
        // What can be wrong without the names of external memories is said before these start.
        if let Some(model) = &settings.model {
            ensure!(
                model.max_cost.is_none() || model.prices.is_some(),
                "--max-cost needs prices: give --prices FILE (docs/costs.md describes it)"
            );
        }
        let prompt = settings.model.as_ref().and_then(|model| model.prompt.as_deref());
        let prompt = prompt.map(Template::read).transpose()?;
        let selection = SelectedCases::of(&settings)?;
        check_banks(&settings)?;
        let mut started = None;
        if purpose == Purpose::DryRun {
            name_memories_of_folder(&mut settings)?;
        } else {
            started = start_memories(&mut settings, purpose, invocation)?;
            if settings.has_external_memories() && started.is_none() {
                return Ok(None);
            }
        }
        if let Selected::Repetition(repetition) = selected {
            let most = settings.runs().iter().map(|(_, runs)| *runs).max().unwrap_or(0);
            ensure!(
                (1..=most).contains(repetition),
                "there is no repetition {repetition}: --runs is {most}"
            );
        }
        let episodes = selection.with_episodes(&settings, |episodes| selected.of(episodes));
        let without = selection.without_blocked_route(&settings);
        if without > 0 {
            say(&format!(
                "{without} of {} cases have no blocked route: their episodes on it are left out",
                selection.cases.len()
            ));
        }
        if episodes.is_empty() {
            bail!("no episode is left");
        }
        let priced =
            settings.model.as_ref().and_then(|model| Some((model, model.prices.as_ref()?)));
        let prices =
            priced.map(|(model, file)| ModelPrices::read(file, &model.model)).transpose()?;
        let SelectedCases { books, .. } = selection;
        Ok(Some(Self {
            settings,
            books,
            episodes,
            unit: None,
            shipped_embeddings: None,
            prices,
            prompt,
            started,
        }))
    }

    /// The external memories.
    fn memories(&self) -> &[ExternalMemory] {
        self.started.as_ref().map_or(&[], |started| &started.memories)
    }

    /// The keys of all episodes.
    pub fn keys(&self) -> BTreeSet<String> {
        self.episodes.iter().map(|episode| episode.key.to_string()).collect()
    }

    /// The types of the tasks of all cases, if the run has banks.
    fn tasks(&self) -> BTreeMap<String, u8> {
        let conditions = self.settings.runs().into_iter();
        let mut sizes = conditions.map(|(condition, _)| condition.demonstrations.bank_size());
        if !sizes.any(|size| size.is_some()) {
            return BTreeMap::new();
        }
        let cases = self.books.cases.book.cases.iter();
        cases.map(|case| (case.id.clone(), case.task)).collect()
    }

    /// The run's manifest, without its documents.
    ///
    /// # Errors
    /// When a file that a command names cannot be read.
    pub fn manifest(&self) -> Result<Manifest> {
        let memories = self.memories().iter();
        let memories = memories.map(|memory| Ok((memory.name, memory.facts()?)));
        let policy_cmd = self.settings.policy_cmd.as_deref();
        let world_cmd = self.settings.world_cmd.as_deref();
        let mut hashes = self.books.hashes();
        let prompt = self.prompt.iter();
        hashes.extend(prompt.map(|prompt| (PROMPT_HASH.to_owned(), prompt.hash().to_owned())));
        Ok(Manifest {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            wire_version: WIRE_VERSION,
            commit: COMMIT.map(str::to_owned),
            settings: self.settings.clone(),
            hashes,
            tasks: self.tasks(),
            documents: BTreeMap::new(),
            memories: memories.collect::<Result<_>>()?,
            policy_files: policy_cmd.map(command_files).transpose()?.unwrap_or_default(),
            world_files: world_cmd.map(command_files).transpose()?.unwrap_or_default(),
            world_varies: !self.books.cases.book.world.declaration.is_deterministic,
            prices: self.prices.clone(),
            episodes: self.episodes.len() as u32,
            unit: self.unit.clone(),
            processes: BTreeMap::new(),
        })
    }

    /// Writes what the world tells and the user's template into the folder of the run: each beside the earlier file, and renamed.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn write(&self, folder: &Path) -> Result<()> {
        self.books.write(folder)?;
        let Some(prompt) = &self.prompt else { return Ok(()) };
        let path = folder.join(PROMPT_FILE);
        durable::replace(&path, &path.with_extension("toml.new"), prompt.file().as_bytes())
            .with_context(|| format!("cannot write {}", path.display()))
    }

    /// The documents of the run, built if they are missing. `record` is that of [`RunDocuments::supply`].
    ///
    /// # Errors
    /// As [`RunDocuments::supply`].
    pub fn documents(
        &self,
        invocation: &Invocation<'_>,
        record: &mut RecordDocuments<'_>,
    ) -> Result<DocumentSupply> {
        let documents = RunDocuments::of(&self.settings, &self.books, invocation.fresh);
        documents.supply(self, invocation, record)
    }

    /// Whether a memory of the run matches views.
    pub fn matches_views(&self) -> bool {
        launch::matches_views(&self.settings, self.memories())
    }
}

/// Checks that every memory can name the demonstrations of its bank.
fn check_banks(settings: &RunSettings) -> Result<()> {
    for condition in settings.conditions() {
        let size = condition.demonstrations.bank_size().unwrap_or(0);
        let info = condition.memory.describe();
        let is_whole = info.is_some_and(|info| info.trajectories == Trajectories::Whole);
        ensure!(
            !is_whole || usize::from(size) <= MAX_SOURCES,
            "{condition}: {} memory names every demonstration at every step, and an answer has at most {MAX_SOURCES} sources: \
             give it a bank of its own in a [[group]]",
            condition.memory
        );
    }
    Ok(())
}

/// Checks that the memories of the arm `wrong` are of one case each.
fn check_wrong(settings: &RunSettings, memories: &[ExternalMemory]) -> Result<()> {
    let conditions = settings.conditions();
    let wrong = conditions
        .iter()
        .filter(|condition| settings.demonstrations_of(condition).wrong().is_some());
    for memory in wrong.filter_map(|condition| condition.memory.external()) {
        let is_of_all =
            |of: &&ExternalMemory| of.name == memory && of.description.scope == Scope::All;
        ensure!(
            !memories.iter().any(|of| is_of_all(&of)),
            "memory {memory} is one memory of the demonstrations of all cases (its scope is `all`), and no history is wrong for \
             all of them: leave `wrong` out of --arms, or run it in a [[group]] without that arm"
        );
    }
    Ok(())
}

/// Adds the names of the external memories of a dry run to the settings, as far as the run's folder has them: their programs, which
/// would tell them, are not started.
fn name_memories_of_folder(settings: &mut RunSettings) -> Result<()> {
    if settings.has_external_memories() {
        let recorded = match settings.out.join("manifest.json").exists() {
            true => Manifest::read(&settings.out)?.memories,
            false => BTreeMap::new(),
        };
        let named: Vec<(ExternalName, bool)> = recorded
            .iter()
            .filter(|(_, facts)| match &facts.command {
                Some(command) => settings.memory_cmd.contains(command),
                None => settings.external_memory,
            })
            .map(|(name, facts)| (*name, facts.learns))
            .collect();
        let all = settings.memory_cmd.len() + usize::from(settings.external_memory);
        settings.add_external_memories(&named);
        if named.len() < all {
            let reason = "a dry run starts no program, and a memory of your own tells its name when it starts";
            ensure!(
                !settings.conditions().is_empty(),
                "{reason}: without it no condition is left to list"
            );
            say(&format!("{reason}: its conditions are not listed"));
        }
    }
    settings::check(settings)
}

/// Starts the external memories of a run and adds their names to the settings. `None` without any, and when asked to stop.
fn start_memories(
    settings: &mut RunSettings,
    purpose: Purpose,
    invocation: &Invocation<'_>,
) -> Result<Option<StartedMemories>> {
    let mut progress = ProgressDisplay::new(invocation.verbosity);
    let mut logs = None;
    if purpose == Purpose::Execution {
        RunFolder::check(&settings.out)?;
        if invocation.fresh {
            RunFolder::remove_memory_logs(&settings.out)?;
        }
        logs = Some(settings.out.join(LOGS_FOLDER));
    }
    let note = &mut |note: &str| progress.note(note);
    let started = external_memory::start(settings, logs, invocation.stop, note)?;
    if let Some(started) = &started {
        let told = started.memories.iter().map(|memory| (memory.name, memory.description.learns));
        settings.add_external_memories(&told.collect::<Vec<_>>());
    }
    // With the names all conditions are known.
    settings::check(settings)?;
    check_wrong(settings, started.as_ref().map_or(&[], |started| &started.memories))?;
    Ok(started)
}

#[cfg(test)]
mod tests {
    use settings::{Layer, resolve};
    use shm_types::MemoryDescription;

    use super::*;
    use crate::plan::plan;

    #[test]
    fn a_plan_has_the_selected_episodes() {
        let conditions = [("working/new/unchanged/none".parse().unwrap(), 3)];
        let keys = |selected: Selected| {
            let all = &mut plan(&conditions, &[0, 1], &["a", "b"], 1);
            let episodes = selected.of(all).into_iter();
            episodes
                .map(|of| format!("{}{}", of.key.case, of.key.run))
                .collect::<Vec<_>>()
                .join(" ")
        };
        assert_eq!(keys(Selected::All), "a1 a2 a3 b1 b2 b3");
        assert_eq!(keys(Selected::Range(2..4)), "a3 b1");
        assert_eq!(keys(Selected::Repetition(2)), "a2 b2");
    }

    #[test]
    fn a_memory_of_all_cases_has_no_wrong_content() {
        let refused = |arms, scope| {
            let flags = [("memory", "none"), ("memory-cmd", "m"), ("arms", arms)];
            let mut settings = resolve([Layer::flags(flags).unwrap()]).unwrap().settings;
            let name: ExternalName = "mine".parse().unwrap();
            settings.add_external_memories(&[(name, false)]);
            let description = MemoryDescription { scope, ..MemoryDescription::default() };
            let memory = ExternalMemory { index: 0, name, description, command: None };
            check_wrong(&settings, &[memory]).err().map(|error| error.to_string())
        };
        assert_eq!(refused("frozen,oracle,wrong", Scope::Case), None);
        assert_eq!(refused("frozen,oracle", Scope::All), None);
        insta::assert_snapshot!(refused("wrong", Scope::All).unwrap(), @"memory mine is one memory of the demonstrations of all cases (its scope is `all`), and no history is wrong for all of them: leave `wrong` out of --arms, or run it in a [[group]] without that arm");
    }
}
