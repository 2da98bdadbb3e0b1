//! Starts a generation: processes, services, and the handshake of each.

use std::collections::BTreeMap;
use std::os::unix::process::ExitStatusExt;
use std::sync::atomic::Ordering;
use std::time::Instant;

use anyhow::Context;
use shm_types::message::{Handshake, Role, WIRE_VERSION, read_text};
use shm_types::process::ProcessWatch;
use shm_types::{Attach, Bus, BusError};
use supervise::{Children, Launch};

use super::generation::{Generation, Inbox, TICK, role};
use super::{Facts, Failure, PipelineOptions, PipelineRun};

impl Generation {
    /// Starts the processes and waits until all are ready. `None` when asked to stop meanwhile.
    pub(super) fn start(
        attach: &Attach,
        run: &mut PipelineRun<'_, '_>,
    ) -> Result<Option<Self>, Failure> {
        attach.write(&attach.root)?;
        let bus = Bus::join(attach.clone(), Role::Orchestrator)?;
        let inbox = Inbox {
            observations: bus.receiver()?,
            traces: bus.receiver()?,
            heartbeats: bus.receiver()?,
            decisions: bus.receiver()?,
            handshakes: bus.receiver()?,
            error_reports: bus.receiver()?,
            shutdown_reports: bus.receiver()?,
        };
        let takes_part = |role| attach.participants.contains(&role);
        let memory_configs = takes_part(Role::Memory).then(|| bus.sender()).transpose()?;
        let policy_configs = takes_part(Role::Policy).then(|| bus.sender()).transpose()?;
        let notifiers = attach.participants.iter().map(|&role| Ok((role, bus.notifier(role)?)));
        let notifiers = notifiers.collect::<Result<_, BusError>>()?;
        let (commands, stops) = (bus.sender()?, bus.sender()?);
        let launches = run.options.launches.iter();
        let launches: Vec<Launch> =
            launches.map(|launch| launch.clone().attached_to(&attach.root)).collect();
        let children = Children::start(&launches, &run.options.logs)?;
        let mut generation = Self {
            children,
            external_policy: None,
            memory_configs,
            policy_configs,
            commands,
            stops,
            inbox,
            embedded: 0,
            memory_busy_ns: 0,
            decided_ns: 0,
            notifiers,
            bus,
        };
        let Some(facts) = generation.wait_until_ready(run)? else { return Ok(None) };
        run.observer.ready(&facts)?;
        Ok(Some(generation))
    }

    /// Waits for every process's [`Handshake`]. In the first generation a process that exits with an error, or is not
    /// ready in time, ends the run: it would do so again. One that was killed is started again.
    fn wait_until_ready(
        &mut self,
        run: &mut PipelineRun<'_, '_>,
    ) -> Result<Option<BTreeMap<Role, Facts>>, Failure> {
        let deadline = Instant::now() + run.options.start_timeout;
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
                let (role, said) = read_handshake(&handshake)?;
                if facts.contains_key(&role) || !self.notifiers.contains_key(&role) {
                    return Err(failed(unexpected(role)));
                }
                if role == Role::Policy && run.options.external_policy {
                    // One that cannot be watched counts as gone when an answer is overdue.
                    self.external_policy = ProcessWatch::new(handshake.pid).ok();
                }
                facts.insert(role, said);
            }
            // A process that cannot start reports an error and exits: it is reported once, here.
            if let Some(exit) = self.children.exited() {
                let advice = exit.command.as_deref().map(advice_on).unwrap_or_default();
                let why = format!("{exit}{advice}");
                let was_killed = exit.status.signal().is_some();
                return Err(if was_killed { Failure::Retry(why) } else { failed(why) });
            }
            let is_awaited = |role| !(run.options.external_policy && role == Role::Policy);
            let missing = self.notifiers.keys().copied().filter(|role| !facts.contains_key(role));
            let late: Vec<Role> = missing.filter(|&role| is_awaited(role)).collect();
            if late.is_empty() && facts.len() < self.notifiers.len() && !is_announced {
                is_announced = true;
                run.observer.awaiting_policy(&self.bus.attach().root);
            }
            if !late.is_empty() && Instant::now() > deadline {
                return Err(failed(not_ready(&late, run.options)));
            }
        }
        Ok(Some(facts))
    }
}

/// The message about processes that did not get ready in time.
fn not_ready(late: &[Role], options: &PipelineOptions) -> String {
    let names: Vec<&str> = late.iter().map(|role| role.word()).collect();
    let policy = options.launches.iter().find(|launch| launch.role == Role::Policy);
    let command = policy.and_then(|launch| launch.command.as_deref());
    let advice = command.filter(|_| late.contains(&Role::Policy)).map(advice_on);
    format!(
        "the {} process was not ready after {} s: see its log in {}, or raise --start-timeout{}",
        names.join(" and the "),
        options.start_timeout.as_secs(),
        options.logs.display(),
        advice.unwrap_or_default()
    )
}

/// The message about a handshake that is not awaited.
pub(super) fn unexpected(role: Role) -> String {
    format!(
        "a second {} process attached, or one that the run does not use: does a program attach twice, or in the \
         wrong role?",
        role.word()
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

/// The sender of a handshake, and what it reports about itself.
pub(super) fn read_handshake(handshake: &Handshake) -> Result<(Role, Facts), Failure> {
    let role = role(handshake.role)?;
    if handshake.wire_version != WIRE_VERSION {
        return Err(Failure::Fatal(anyhow::anyhow!(
            "the {} process uses wire version {} and this program {WIRE_VERSION}: use programs of the same build",
            role.word(),
            handshake.wire_version
        )));
    }
    let facts = read_text(&handshake.facts, handshake.facts_len)?;
    let facts = serde_json::from_str(facts).with_context(|| {
        format!("the {} process's handshake has the facts {facts:?}", role.word())
    })?;
    Ok((role, facts))
}
