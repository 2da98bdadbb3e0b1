//! External memories before a run: started, and asked for their names.
//!
//! A run plans with the names of its memories, and an external one tells its name itself, in a file that it writes before
//! it joins the run. So the processes are started first, and wait until the run begins.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::command_files::command_files;
use anyhow::{Context, Result, bail};
use conditions::settings::RunSettings;
use domain::ExternalName;
use run_log::ExternalMemoryFacts;
use shm_types::description::{DESCRIPTION_FILE, Scope, memory_folder};
use shm_types::{ATTACH_VARIABLE, MemoryDescription, RunDir, registry};
use supervise::{Children, Launch};

/// Time between two looks for descriptions.
const INTERVAL: Duration = Duration::from_millis(20);

/// An external memory of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExternalMemory {
    /// Its index on the wire.
    pub index: u8,
    /// Its name.
    pub name: ExternalName,
    /// What it tells about itself.
    pub description: MemoryDescription,
    /// The command that starts it; `None` if the user does.
    pub command: Option<String>,
}

/// External memories that have told their names and wait for the run.
///
/// The fields are dropped in order: the processes end before their folder is removed.
#[derive(Debug)]
pub struct StartedMemories {
    /// The processes that were started here.
    pub children: Children,
    /// The memories, by index.
    pub memories: Vec<ExternalMemory>,
    /// The folder of the run that they join.
    pub run: RunDir,
}

impl ExternalMemory {
    /// The process to start, if it is started here.
    ///
    /// # Errors
    /// When the command is none.
    pub fn launch(&self) -> Result<Option<Launch>> {
        launch(self.index, self.command.as_deref())
    }

    /// What the manifest says about it.
    ///
    /// # Errors
    /// When a file that its command names cannot be read.
    pub fn facts(&self) -> Result<ExternalMemoryFacts> {
        let MemoryDescription {
            name: _,
            version,
            scope,
            embeddings,
            frames,
            deterministic,
            learns,
            sdk,
            code,
        } = self.description.clone();
        let files = self.command.as_deref().map(command_files).transpose()?.unwrap_or_default();
        Ok(ExternalMemoryFacts {
            index: self.index,
            version,
            command: self.command.clone(),
            scope: match scope {
                Scope::Case => "case".to_owned(),
                Scope::All => "all".to_owned(),
            },
            embeddings,
            frames,
            deterministic,
            learns,
            sdk,
            code,
            files,
        })
    }
}

impl StartedMemories {
    /// Those of a run without any: its folder. `note` receives what the user has to know.
    ///
    /// # Errors
    /// When the folder of all runs cannot be used.
    pub fn none(note: &mut dyn FnMut(&str)) -> Result<Self> {
        let base = registry::default_base();
        registry::clean(&base)?.notes().iter().for_each(|one| note(one));
        let run = RunDir::create(&base)?;
        Ok(Self { children: Children::default(), memories: Vec::new(), run })
    }
}

fn launch(index: u8, command: Option<&str>) -> Result<Option<Launch>> {
    command.map(|command| Launch::external_memory(index, command)).transpose()
}

/// Starts the external memories of a run, with their logs in `logs` or in the run's own folder, and waits for their
/// descriptions. `None` when asked to stop, or for a run without external memories. `note` receives what the user has to
/// know meanwhile.
///
/// # Errors
/// When a command cannot be started, ends, or has not described itself in time; when two have the same name.
pub fn start(
    settings: &RunSettings,
    logs: Option<PathBuf>,
    stop: &AtomicBool,
    note: &mut dyn FnMut(&str),
) -> Result<Option<StartedMemories>> {
    if !settings.has_external_memories() {
        return Ok(None);
    }
    let mut started = StartedMemories::none(note)?;
    let run = &started.run;
    let commands = settings.memory_cmd.iter().cloned().map(Some);
    let user_s = settings.external_memory.then_some(None);
    let commands: Vec<(u8, Option<String>)> = (0..).zip(commands.chain(user_s)).collect();
    let mut launches = Vec::new();
    for (index, command) in &commands {
        let folder = memory_folder(run.path(), *index);
        fs::create_dir(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        launches.extend(launch(*index, command.as_deref())?);
        if command.is_none() {
            note(&format!(
                "Start your memory, now or later:\n  {ATTACH_VARIABLE}={} your-program",
                folder.display()
            ));
        }
    }
    let launches: Vec<Launch> =
        launches.into_iter().map(|launch| launch.attached_to(run.path())).collect();
    let logs = logs.unwrap_or_else(|| run.path().join("logs"));
    started.children = Children::start(&launches, &logs)?;
    let StartedMemories { children, memories, run } = &mut started;
    let timeout = Duration::from_secs(settings.start_timeout.into());
    let deadline = Instant::now() + timeout;
    for (index, command) in commands {
        let folder = memory_folder(run.path(), index);
        while !folder.join(DESCRIPTION_FILE).exists() {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            if let Some(exit) = children.exited() {
                let advice = exit.command.as_deref().map(advice_on).unwrap_or_default();
                bail!("{exit}{advice}");
            }
            if let Some(command) = &command
                && Instant::now() > deadline
            {
                bail!("{}", not_described(index, command, timeout, children));
            }
            std::thread::sleep(INTERVAL);
        }
        let described = format!("the external memory {}", told_by(command.as_deref()));
        let description = MemoryDescription::read(&folder).with_context(|| {
            format!("{described} describes itself in a way that cannot be used")
        })?;
        let name: ExternalName = description.name.parse().with_context(|| described.clone())?;
        if let Some(other) = memories.iter().find(|other| other.name == name) {
            bail!(
                "{described} and the one {} are both called {name}: give one of them another name",
                told_by(other.command.as_deref())
            );
        }
        memories.push(ExternalMemory { index, name, description, command });
    }
    Ok(Some(started))
}

/// Which memory it is, before its name is known.
fn told_by(command: Option<&str>) -> String {
    command.map_or("that you started".to_owned(), |command| format!("`{command}`"))
}

/// The message about a memory that has not described itself in time.
fn not_described(index: u8, command: &str, timeout: Duration, children: &Children) -> String {
    let (tail, log) = children.printed_by_memory(index).unwrap_or((String::new(), Path::new("")));
    let log = log.display();
    let printed = match tail.as_str() {
        "" => format!(" and printed nothing ({log})"),
        tail => format!("; the last lines of {log}:\n{tail}"),
    };
    format!(
        "the external memory `{command}` has not described itself after {} s (--start-timeout){printed}{}",
        timeout.as_secs(),
        advice_on(command)
    )
}

/// What the user's own program has to do, and how to find out what it does instead.
pub fn advice_on(command: &str) -> String {
    format!(
        "\nA memory writes {DESCRIPTION_FILE} into the folder ${ATTACH_VARIABLE}, joins the run when it begins, and runs \
         until it is asked to stop; the SDK does all that (docs/memory.md). To see what this one does:\n  memtransfer \
         conformance --memory-cmd {}",
        shlex::try_quote(command).unwrap_or_default()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use settings::{Layer, resolve};

    /// The settings of a run with these external memories, each a script of a shell.
    fn settings(scripts: &[&str]) -> RunSettings {
        let commands: Vec<String> = scripts
            .iter()
            .map(|script| format!("/bin/sh -c {}", shlex::try_quote(script).unwrap()))
            .collect();
        let flags = commands.iter().map(|command| ("memory-cmd", command.as_str()));
        let layer = Layer::flags(flags.chain([("start-timeout", "20")])).unwrap();
        resolve([layer]).unwrap().settings
    }

    fn started(scripts: &[&str]) -> Result<StartedMemories> {
        let started = start(&settings(scripts), None, &AtomicBool::new(false), &mut |_| ());
        Ok(started?.unwrap())
    }

    fn describes(name: &str) -> String {
        format!(
            "cd \"$MEMTRANSFER_ATTACH\"; echo '{{\"name\": \"{name}\", \"version\": \"2\"}}' > d; \
             mv d description.json; exec sleep 100"
        )
    }

    #[test]
    fn memories_tell_their_names_and_wait_for_the_run() {
        let (a, b) = (describes("top-3"), describes("bm25"));
        let started = started(&[&a, &b]).unwrap();
        let found: Vec<_> = started
            .memories
            .iter()
            .map(|memory| (memory.index, memory.name.to_string(), memory.facts().unwrap().version))
            .collect();
        assert_eq!(found, [(0, "top-3".into(), "2".into()), (1, "bm25".into(), "2".into())]);
        let folder = started.run.path().to_owned();
        drop(started);
        assert!(!folder.exists(), "the folder goes with the processes");
    }

    #[test]
    fn a_memory_that_cannot_take_part_is_named_with_what_it_printed() {
        let error = |scripts: &[&str]| format!("{:#}", started(scripts).unwrap_err());
        let ended = error(&["echo no module named numpy; exit 3"]);
        for part in ["exit status 3", "no module named numpy", "memtransfer conformance"] {
            assert!(ended.contains(part), "{ended}");
        }
        let (a, b) = (describes("top-3"), describes("top-3"));
        assert!(error(&[&a, &b]).contains("are both called top-3: give one of them another name"));
        let built_in = error(&[&describes("episodic")]);
        assert!(built_in.contains("describes itself in a way that cannot be used"), "{built_in}");
        assert!(built_in.contains("episodic"), "{built_in}");
        let stopped = AtomicBool::new(true);
        let outcome = start(&settings(&["exec sleep 100"]), None, &stopped, &mut |_| ());
        assert!(outcome.unwrap().is_none());
    }
}
