//! A polled round trip between two processes: through our wire types, and through iceoryx2's interface as iceoryx2's
//! benchmark uses it.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use bytemuck::Zeroable;
use iceoryx2::config::Config;
use iceoryx2::node::{Node, NodeBuilder};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{FileName, PortFactory as _, SemanticString, SignalHandlingMode, ipc};
use shm_types::message::{Role, StepCommand, StepReport};
use shm_types::process::SHARED_MEMORY;
use shm_types::{Attach, Bus, Receiver, RunDir, Sender};

use crate::processes::BenchProcess;
use crate::{Bench, BenchSession, Measurement, Target};

/// The bench.
pub const BENCH: Bench =
    Bench { name: "hop", about: "a polled hop between two processes, beside iceoryx2 alone", run };

/// Round trips in a batch. The figure is the median of batch means, so that a preemption does not show.
const BATCH: u32 = 100;

/// Longest wait for an answer before the other process counts as gone.
const PATIENCE: Duration = Duration::from_secs(20);

fn run(session: &BenchSession<'_>) -> Result<Vec<Measurement>> {
    let batches = session.size.pick(2, 3000);
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for _ in 0..session.rounds {
        ours.push(wire(session, batches)?);
        theirs.push(iceoryx2(session, batches)?);
    }
    Ok(vec![
        Measurement::new("hop.one-way", "a polled hop: half a round trip", "ns", ours)
            .beside("iceoryx2 0.10", theirs)
            .target(Target::RatioAtMost(1.5))
            .parameter("bytes there", size_of::<StepCommand>())
            .parameter("bytes back", size_of::<StepReport>()),
    ])
}

/// Half of the median round-trip time, in nanoseconds. `trip` makes one round trip.
fn one_way(batches: u32, mut trip: impl FnMut() -> Result<()>) -> Result<f64> {
    let mut means = Vec::new();
    // The first batch is a warm-up: connections are made in it.
    for batch in 0..=batches {
        let began = Instant::now();
        for _ in 0..BATCH {
            trip()?;
        }
        if batch > 0 {
            means.push(began.elapsed().as_nanos() as f64 / f64::from(BATCH) / 2.0);
        }
    }
    means.sort_by(f64::total_cmp);
    means.get(means.len() / 2).copied().context("no batch")
}

/// Calls `look` until it returns something.
fn poll<T>(mut look: impl FnMut() -> Result<Option<T>>) -> Result<T> {
    let mut deadline = None;
    loop {
        // The clock is read rarely, because reading it is not what is measured.
        for _ in 0..1 << 16 {
            if let Some(found) = look()? {
                return Ok(found);
            }
        }
        let deadline = *deadline.get_or_insert_with(|| Instant::now() + PATIENCE);
        ensure!(Instant::now() < deadline, "no answer in {} s", PATIENCE.as_secs());
    }
}

/// The kind of the command after which the other end ends.
const LAST: u8 = u8::MAX;

/// Round trips through our wire types with another process.
fn wire(session: &BenchSession<'_>, batches: u32) -> Result<f64> {
    let run = RunDir::create(session.registry())?;
    let attach = Attach { participants: vec![Role::Sim], ..run.attach() };
    attach.write(run.path())?;
    let bus = Bus::join(attach, Role::Orchestrator)?;
    let answers: Receiver<StepReport> = bus.receiver()?;
    let commands: Sender<StepCommand> = bus.sender()?;
    let other = BenchProcess::start(session, "wire-echo", &[run.path().display().to_string()])?;
    commands.wait_for_receivers(PATIENCE)?;
    let mut command = StepCommand::zeroed();
    let found = one_way(batches, || {
        command.episode += 1;
        commands.send(&command)?;
        let answer = poll(|| Ok(answers.next()?))?;
        ensure!(answer.episode == command.episode, "an answer to another message");
        Ok(())
    })?;
    commands.send(&StepCommand { kind: LAST, ..command })?;
    other.finish()?;
    Ok(found)
}

/// The other end of [`wire`].
pub(crate) fn wire_echo(arguments: &[String]) -> Result<()> {
    let [folder] = arguments else { bail!("the run folder is missing") };
    let bus = Bus::join(Attach::read(Path::new(folder))?, Role::Sim)?;
    let commands: Receiver<StepCommand> = bus.receiver()?;
    let answers: Sender<StepReport> = bus.sender()?;
    let mut answer = StepReport::zeroed();
    loop {
        let command = poll(|| Ok(commands.next()?))?;
        if command.kind == LAST {
            return Ok(());
        }
        answer.episode = command.episode;
        answers.send(&answer)?;
    }
}

/// The ports of iceoryx2's ping-pong: services as its benchmark creates them.
struct Raw {
    there: Publisher<ipc::Service, StepCommand, ()>,
    back: Subscriber<ipc::Service, StepReport, ()>,
    _node: Node<ipc::Service>,
}

/// Removes the small files that iceoryx2 leaves in shared memory under a prefix after its nodes are gone.
struct Cleaner<'a>(&'a str);

impl Drop for Cleaner<'_> {
    fn drop(&mut self) {
        for entry in std::fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten() {
            if entry.file_name().as_encoded_bytes().starts_with(self.0.as_bytes()) {
                // Another process may have removed it.
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }
}

/// Converts an error of iceoryx2.
fn iceoryx2_error(error: impl std::fmt::Debug) -> anyhow::Error {
    anyhow::anyhow!("iceoryx2: {error:?}")
}

fn raw_node(prefix: &str, folder: &Path) -> Result<Node<ipc::Service>> {
    let mut config = Config::default();
    config.global.prefix = FileName::new(prefix.as_bytes()).map_err(iceoryx2_error)?;
    let root = folder.display().to_string();
    let root = iceoryx2::prelude::Path::new(root.as_bytes()).map_err(iceoryx2_error)?;
    config.global.set_root_path(&root);
    NodeBuilder::new()
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .config(&config)
        .create::<ipc::Service>()
        .map_err(iceoryx2_error)
}

/// Creates or opens a service with one publisher and one subscriber.
macro_rules! raw_service {
    ($node:expr, $name:literal, $message:ty) => {
        $node
            .service_builder(&$name.try_into()?)
            .publish_subscribe::<$message>()
            .max_publishers(1)
            .max_subscribers(1)
            .history_size(0)
            .subscriber_max_buffer_size(1)
            .enable_safe_overflow(true)
            .open_or_create()
            .map_err(iceoryx2_error)?
    };
}

/// Round trips through iceoryx2 alone with another process.
fn iceoryx2(session: &BenchSession<'_>, batches: u32) -> Result<f64> {
    let prefix = format!("mtb{}_", std::process::id());
    let _cleaner = Cleaner(&prefix);
    let node = raw_node(&prefix, session.registry())?;
    let (there, back) =
        (raw_service!(node, "there", StepCommand), raw_service!(node, "back", StepReport));
    let raw = Raw {
        back: back.subscriber_builder().create().map_err(iceoryx2_error)?,
        there: there.publisher_builder().create().map_err(iceoryx2_error)?,
        _node: node,
    };
    let folder = session.registry().display().to_string();
    let mut other = BenchProcess::start(session, "iceoryx2-echo", &[prefix.clone(), folder])?;
    // A message sent before the other end is connected would be lost.
    let deadline = Instant::now() + PATIENCE;
    while there.dynamic_config().number_of_subscribers() == 0
        || back.dynamic_config().number_of_publishers() == 0
    {
        other.check()?;
        ensure!(Instant::now() < deadline, "the other process did not connect");
        std::thread::sleep(Duration::from_millis(1));
    }
    let mut command = StepCommand::zeroed();
    let send = |command: StepCommand| -> Result<()> {
        let sample = raw.there.loan_uninit().map_err(iceoryx2_error)?;
        let sent = sample.write_payload(command).send();
        sent.map(drop).map_err(iceoryx2_error)
    };
    let found = one_way(batches, || {
        command.episode += 1;
        send(command)?;
        let answer = poll(|| raw.back.receive().map_err(iceoryx2_error))?;
        ensure!(answer.episode == command.episode, "an answer to another message");
        Ok(())
    })?;
    send(StepCommand { kind: LAST, ..command })?;
    other.finish()?;
    Ok(found)
}

/// The other end of [`iceoryx2`].
pub(crate) fn iceoryx2_echo(arguments: &[String]) -> Result<()> {
    let [prefix, folder] = arguments else { bail!("prefix and folder are missing") };
    let node = raw_node(prefix, Path::new(folder))?;
    let (there, back) =
        (raw_service!(node, "there", StepCommand), raw_service!(node, "back", StepReport));
    let commands = there.subscriber_builder().create().map_err(iceoryx2_error)?;
    let answers = back.publisher_builder().create().map_err(iceoryx2_error)?;
    let mut answer = StepReport::zeroed();
    loop {
        let command = poll(|| commands.receive().map_err(iceoryx2_error))?;
        if command.kind == LAST {
            return Ok(());
        }
        answer.episode = command.episode;
        drop(command);
        let sample = answers.loan_uninit().map_err(iceoryx2_error)?;
        sample.write_payload(answer).send().map_err(iceoryx2_error)?;
    }
}
