//! Starts a generation: processes, services, and the handshake of each.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::sync::atomic::Ordering;

use anyhow::{Context, bail};
use case_book::{BookFile, LEARNED_FILE, LearnedEpisode, WORLD_FILE, WorldDeclaration};
use domain::ExternalName;
use shm_types::clock::Instant;
use shm_types::description::{DESCRIPTION_FILE, memory_folder};
use shm_types::message::{Handshake, Role, WIRE_VERSION, read_text};
use shm_types::process::{ProcessWatch, check_shared_memory, monotonic_ns};
use shm_types::{
    ATTACH_VARIABLE, Attach, Bus, MemoryDescription, NoteReceiver, WORLD_INDEX_VARIABLE,
};
use supervise::{Children, Launch};

use super::generation::{Generation, Inbox, TICK, WorldSenders, role};
use super::vital_signs::VitalSigns;
use super::{Facts, Failure, Participant, PipelineOptions, PipelineRun};
use crate::external_memory::ExternalMemory;
use crate::frame_budget;

impl Generation {
    /// Starts the processes and waits until all are ready. `None` when asked to stop meanwhile.
    pub(super) fn start(
        attach: &Attach,
        run: &mut PipelineRun<'_, '_>,
    ) -> Result<Option<Self>, Failure> {
        // Another program may have filled it since the last generation: this process, too, would end on SIGBUS.
        check_shared_memory(frame_budget::bytes(attach, 0))?;
        let launches = memory_launches(attach, run)?;
        let bus = Bus::join(attach.clone(), Role::Orchestrator)?;
        let inbox = Inbox {
            reports: bus.receiver()?,
            facts: NoteReceiver::of_facts(&bus)?,
            traces: bus.receiver()?,
            snapshots: bus.receiver()?,
            heartbeats: bus.receiver()?,
            decisions: bus.receiver()?,
            handshakes: bus.handshake_receiver()?,
            error_reports: bus.receiver()?,
            shutdown_reports: bus.receiver()?,
        };
        let takes_part = |role| attach.participants.contains(&role);
        let memory_configs = takes_part(Role::Memory).then(|| bus.sender()).transpose()?;
        let policy_configs = takes_part(Role::Policy).then(|| bus.sender()).transpose()?;
        let (mut notifiers, mut worlds) = (BTreeMap::<Participant, _>::new(), Vec::new());
        for &role in attach.participants.iter().filter(|role| **role != Role::Sim) {
            notifiers.insert(role.into(), bus.notifier(role)?);
        }
        for index in 0..attach.worlds {
            notifiers.insert(Participant::world(index), bus.notifier_of(Role::Sim, index)?);
            let (configs, commands) = (bus.sender_to(index)?, bus.sender_to(index)?);
            worlds.push(WorldSenders { configs, commands, is_due: false });
        }
        for memory in memories(attach, run.options) {
            notifiers
                .insert(memory.name.into(), bus.notifier_of(Role::ExternalMemory, memory.index)?);
        }
        let stops = bus.sender()?;
        write_world(&attach.root, run.lanes.declaration())?;
        write_learned(&attach.root, &run.lanes.learned_episodes())?;
        // Only now may others join: this process creates every service that it uses, and so depends on none that another
        // process is killed while creating.
        attach.write(&attach.root)?;
        let children = start_processes(attach, launches, run)?;
        let mut generation = Self {
            children,
            external: Vec::new(),
            memory_configs,
            policy_configs,
            worlds,
            stops,
            inbox,
            vital_signs: VitalSigns::new(attach.worlds, monotonic_ns()),
            decided_ns: 0,
            facts: Vec::new(),
            shutdown_reports: BTreeMap::new(),
            recalled_ns: BTreeMap::new(),
            notifiers,
            bus,
        };
        let Some(facts) = generation.wait_until_ready(run)? else { return Ok(None) };
        let now = monotonic_ns();
        generation.vital_signs = VitalSigns::new(attach.worlds, now);
        for memory in memories(attach, run.options) {
            generation.recalled_ns.insert(memory.name, now);
        }
        run.observer.ready(&facts)?;
        Ok(Some(generation))
    }

    /// Waits for every process's [`Handshake`]. In the first generation a process that exits with an error, or is not
    /// ready in time, ends the run: it would do so again. One that was killed is started again.
    fn wait_until_ready(
        &mut self,
        run: &mut PipelineRun<'_, '_>,
    ) -> Result<Option<BTreeMap<Participant, Facts>>, Failure> {
        let mut deadline = Instant::now() + run.options.start_timeout;
        let is_first = self.bus.attach().generation == 1;
        let failed = |why: String| {
            if is_first { Failure::Fatal(anyhow::Error::msg(why)) } else { Failure::Retry(why) }
        };
        let mut facts = BTreeMap::new();
        let mut is_announced = false;
        while facts.len() < self.notifiers.len() {
            if run.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            run.observer.progress(0);
            self.bus.listener().wait(TICK)?;
            for handshake in self.inbox.handshakes.drain()? {
                let Some((sender, said)) = read_handshake(&handshake, run.options)? else {
                    run.observer.problem(&of_unknown_sender(&handshake));
                    continue;
                };
                if facts.contains_key(&sender) || !self.notifiers.contains_key(&sender) {
                    let why = unexpected(sender);
                    return Err(match sender.memory {
                        Some(_) => Failure::of(sender, run.options, why),
                        None => failed(why),
                    });
                }
                if is_started_by_user(sender, run.options) {
                    // One that cannot be watched counts as gone when an answer is overdue.
                    let watch = ProcessWatch::new(handshake.pid).ok();
                    self.external.extend(watch.map(|watch| (sender, watch)));
                }
                if let Some(name) = sender.memory {
                    self.check_description(name, run)?;
                }
                if sender.role == Role::Sim {
                    check_alike(sender, &said, &facts).map_err(failed)?;
                }
                facts.insert(sender, said);
            }
            // A process that cannot start reports an error and exits: it is reported once, here.
            if let Some(exit) = self.children.exited() {
                if exit.role == Role::ExternalMemory {
                    return Err(Failure::of_exit(&exit, run.options));
                }
                let advice = exit.command.as_deref().map(advice_on).unwrap_or_default();
                let why = format!("{exit}{advice}");
                let was_killed = exit.status.signal().is_some();
                return Err(if was_killed { Failure::Retry(why) } else { failed(why) });
            }
            let missing = self.notifiers.keys().copied().filter(|one| !facts.contains_key(one));
            let (awaited, mut late): (Vec<Participant>, Vec<Participant>) =
                missing.partition(|&one| is_started_by_user(one, run.options));
            if !awaited.is_empty() {
                // It may be waiting for those, too, to show them every view.
                late.retain(|one| one.role != Role::Sim);
                if late.is_empty() {
                    deadline = Instant::now() + run.options.start_timeout;
                }
            }
            if late.is_empty() && !is_announced {
                is_announced = true;
                for one in awaited {
                    let command = command_of(one, self.bus.attach(), run.options);
                    run.observer.awaiting(one, &command);
                }
            }
            if !late.is_empty() && Instant::now() > deadline {
                let why = not_ready(&late, run.options);
                return Err(match late[..] {
                    [one] if one.memory.is_some() => Failure::of(one, run.options, why),
                    _ => failed(why),
                });
            }
        }
        Ok(Some(facts))
    }

    /// Checks that a memory that was started again tells the same as before: the run was planned with it.
    fn check_description(
        &self,
        name: ExternalName,
        run: &PipelineRun<'_, '_>,
    ) -> Result<(), Failure> {
        let failed = |why| Failure::of(name.into(), run.options, why);
        let Some(memory) = run.options.memories.iter().find(|memory| memory.name == name) else {
            return Ok(());
        };
        let folder = memory_folder(&self.bus.attach().root, memory.index);
        let now = MemoryDescription::read(&folder)
            .map_err(|error| failed(format!("the external memory {name}: {error}")))?;
        let changes = memory.description.changes(&now);
        if changes.is_empty() {
            return Ok(());
        }
        Err(failed(format!(
            "the external memory {name} describes itself otherwise than when the run began: {changes}"
        )))
    }
}

/// Writes what the world says of itself, which every process reads.
fn write_world(folder: &Path, world: &WorldDeclaration) -> anyhow::Result<()> {
    let path = folder.join(WORLD_FILE);
    fs::write(&path, BookFile::new(world)?.text)
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Writes the episodes that memories have learned from before, whose views they may ask for, if there are any.
fn write_learned(folder: &Path, episodes: &[LearnedEpisode]) -> anyhow::Result<()> {
    if episodes.is_empty() {
        return Ok(());
    }
    let path = folder.join(LEARNED_FILE);
    fs::write(&path, serde_json::to_vec(episodes)?)
        .with_context(|| format!("cannot write {}", path.display()))
}

/// The external memories that take part.
fn memories<'a>(
    attach: &'a Attach,
    options: &'a PipelineOptions,
) -> impl Iterator<Item = &'a ExternalMemory> {
    options.memories.iter().filter(|memory| attach.external_memories.contains(&memory.index))
}

/// The external memories that a generation has to start, each with a folder in which it is to describe itself again. The
/// first generation finds them started.
fn memory_launches(attach: &Attach, run: &PipelineRun<'_, '_>) -> Result<Vec<Launch>, Failure> {
    let mut launches = Vec::new();
    if !run.started.is_empty() {
        return Ok(launches);
    }
    for memory in memories(attach, run.options) {
        let Some(launch) = memory.launch()? else { continue };
        let folder = memory_folder(&attach.root, memory.index);
        fs::create_dir_all(&folder)?;
        match fs::remove_file(folder.join(DESCRIPTION_FILE)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error.into()),
            _ => launches.push(launch),
        }
    }
    Ok(launches)
}

/// Starts the processes of a generation, with the external memories of `launches`.
fn start_processes(
    attach: &Attach,
    launches: Vec<Launch>,
    run: &mut PipelineRun<'_, '_>,
) -> Result<Children, Failure> {
    let all = run.options.launches.iter().cloned().chain(launches);
    let each = all.flat_map(|launch| {
        let processes = if launch.role == Role::Sim { attach.worlds } else { 1 };
        (0..processes).map(move |place| Launch { index: launch.index + place, ..launch.clone() })
    });
    let launches: Vec<Launch> = each.map(|launch| launch.attached_to(&attach.root)).collect();
    let mut children = Children::start_with(&*run.options.launcher, &launches, &run.options.logs)?;
    children.adopt(std::mem::take(&mut run.started));
    Ok(children)
}

/// Whether a process is started by the user, at any time.
pub(super) fn is_started_by_user(one: Participant, options: &PipelineOptions) -> bool {
    match one.memory {
        Some(name) => {
            options.memories.iter().any(|memory| memory.name == name && memory.command.is_none())
        }
        None => match one.role {
            Role::Policy => options.external_policy,
            Role::Sim => options.external_world.is_some(),
            _ => false,
        },
    }
}

/// How the user starts a process.
fn command_of(one: Participant, attach: &Attach, options: &PipelineOptions) -> String {
    let mut command = format!("{ATTACH_VARIABLE}={}", attach.root.display());
    if one.role == Role::Sim && attach.worlds > 1 {
        command += &format!(" {WORLD_INDEX_VARIABLE}={}", one.world);
    }
    command += " your-program";
    if let (Role::Sim, Some(demonstrations)) = (one.role, &options.external_world) {
        command += &format!(" serve --demonstrations {}", demonstrations.display());
    }
    command
}

/// Checks that a world tells the same of itself as those that were ready before: all render the same pictures.
///
/// # Errors
/// The first fact in which two differ.
fn check_alike(
    world: Participant,
    said: &Facts,
    others: &BTreeMap<Participant, Facts>,
) -> Result<(), String> {
    let Some((other, theirs)) = others.iter().find(|(other, _)| other.role == Role::Sim) else {
        return Ok(());
    };
    let differs = |name: &&String| said.get(*name) != theirs.get(*name);
    let Some(name) = said.keys().chain(theirs.keys()).find(differs) else { return Ok(()) };
    let fact = |facts: &Facts| facts.get(name).cloned().unwrap_or_else(|| "none".to_owned());
    Err(format!(
        "the worlds of a run have to be alike: {} has the {name} {}, and {} {}",
        world.in_words(),
        fact(said),
        other.in_words(),
        fact(theirs)
    ))
}

/// The message about a handshake from a process that the run does not have.
pub(super) fn of_unknown_sender(handshake: &Handshake) -> String {
    let Handshake { role, index, .. } = handshake;
    format!("a handshake with role {role} and index {index}, which the run does not have: ignored")
}

/// The message about processes that did not get ready in time.
fn not_ready(late: &[Participant], options: &PipelineOptions) -> String {
    let names: Vec<String> = late.iter().map(Participant::in_words).collect();
    let policy = options.launches.iter().find(|launch| launch.role == Role::Policy);
    let command = policy.and_then(|launch| launch.command.as_deref());
    let advice = command.filter(|_| late.contains(&Role::Policy.into())).map(advice_on);
    format!(
        "{} was not ready after {} s: see its log in {}, or raise --start-timeout{}",
        names.join(" and "),
        options.start_timeout.as_secs(),
        options.logs.display(),
        advice.unwrap_or_default()
    )
}

/// The message about a handshake that is not awaited.
pub(super) fn unexpected(sender: Participant) -> String {
    format!(
        "{} attached a second time, or the run does not use it: does a program attach twice, or in the wrong role?",
        sender.in_words()
    )
}

/// Advice on the user's own program: what it has to do, and how to check it.
fn advice_on(command: &str) -> String {
    format!(
        "\nA policy attaches to the run in the folder $MEMTRANSFER_ATTACH, sends its handshake, and runs until it \
         is asked to stop (docs/external-policies.md). To see what this one does:\n  memtransfer conformance \
         --policy-cmd {}",
        shlex::try_quote(command).unwrap_or_default()
    )
}

/// The sender of a handshake, and what it reports about itself; `None` for one that the run does not have.
pub(super) fn read_handshake(
    handshake: &Handshake,
    options: &PipelineOptions,
) -> Result<Option<(Participant, Facts)>, Failure> {
    let Ok(role) = role(handshake.role) else { return Ok(None) };
    let Some(sender) = options.participant(role, handshake.index) else { return Ok(None) };
    let facts = read_facts(handshake, sender).map_err(|error| match sender.memory {
        Some(_) => Failure::of(sender, options, format!("{error:#}")),
        None => Failure::Fatal(error),
    })?;
    Ok(Some((sender, facts)))
}

fn read_facts(handshake: &Handshake, sender: Participant) -> anyhow::Result<Facts> {
    let sender = sender.in_words();
    if handshake.wire_version != WIRE_VERSION {
        bail!(
            "{sender} uses wire version {} and this program {WIRE_VERSION}: use programs of the same build",
            handshake.wire_version
        );
    }
    let facts = read_text(&handshake.facts, handshake.facts_len)?;
    serde_json::from_str(facts)
        .with_context(|| format!("the handshake of {sender} has the facts {facts:?}"))
}
