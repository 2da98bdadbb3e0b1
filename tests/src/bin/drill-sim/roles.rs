//! What takes part in the simulated run: the real serve loops of simulator, memory, policy and external memory, with
//! stand-ins for what computes pixels, embeddings and decisions.

use std::fmt;
use std::fs::{self, File};
use std::io;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use case_book::{BookFile, DemonstrationBook};
use memory_proc::embedding_cache::EmbeddingCache;
use memory_proc::encoder::{Encoder, EncoderFacts, Image, Provider};
use memory_proc::external::ExternalLimits;
use memory_proc::serve::{ServeSettings, serve_with};
use peer::world::{
    RenderSetup, RenderTask, RenderWorker, Renderers, WorldFailure, serve_generation,
};
use peer::{ActionCode, Decision, FrameView, Item, Policy, Request};
use search::Embedding;
use shm_types::clock::{self, monotonic_ns};
use shm_types::message::Role;
use shm_types::{ATTACH_VARIABLE, Attach, Bus};
use sim_proc::renderer::{RenderSettings, VisibleChanges};
use sim_proc::view_folder::{KeepingWorker, ViewFolder};
use sim_proc::world::{WarehousePicture, WarehouseRendering, WarehouseWorld};
use sim_proc::worlds::Worlds;
use supervise::{Launch, Launcher, Process as Running};

use crate::faults::Process;
use crate::scheduler::Scheduler;
use crate::{Plant, external};

/// Numbers in an embedding.
const DIMENSION: usize = 8;

/// Starts the processes of a run as threads of the scheduler.
pub(crate) struct InProcess {
    pub(crate) scheduler: Arc<Scheduler>,
    pub(crate) worlds: Worlds,
    pub(crate) files: Files,
    pub(crate) plant: Option<Plant>,
}

/// The files that the processes of a run read.
#[derive(Clone)]
pub(crate) struct Files {
    pub(crate) assets: PathBuf,
    pub(crate) demonstrations: PathBuf,
    pub(crate) snapshots: Option<PathBuf>,
    /// Embeddings and views of earlier sessions.
    pub(crate) caches: PathBuf,
}

impl fmt::Debug for InProcess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("InProcess")
    }
}

impl Launcher for InProcess {
    fn start(&self, launch: &Launch, log: &Path) -> Result<Box<dyn Running>> {
        let (role, index) = (launch.role, launch.index);
        let own = launch.env.iter().find(|(name, _)| name == ATTACH_VARIABLE).map(|(_, own)| own);
        let root = own.or(launch.args.last()).context("no folder to attach to")?.into();
        let (worlds, files, plant) = (self.worlds.clone(), self.files.clone(), self.plant);
        let log = log.to_owned();
        let run = move || match take_part((role, index), root, worlds, &files, plant) {
            Ok(()) => ExitStatus::from_raw(0),
            Err(error) => {
                // The log tells the orchestrator why.
                let written = fs::write(&log, format!("{}-proc: {error:#}\n", role.word()));
                ExitStatus::from_raw(if written.is_ok() { 1 << 8 } else { 2 << 8 })
            }
        };
        let task = self.scheduler.start(Process::Child(role), run)?;
        Ok(Box::new(InProcessChild { scheduler: self.scheduler.clone(), task }))
    }
}

/// A process of [`InProcess`].
struct InProcessChild {
    scheduler: Arc<Scheduler>,
    task: usize,
}

impl fmt::Debug for InProcessChild {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "InProcessChild({})", self.task)
    }
}

impl Running for InProcessChild {
    fn is_alive(&self) -> bool {
        self.scheduler.is_alive(self.task)
    }

    fn end(&mut self) -> io::Result<ExitStatus> {
        self.scheduler.end(self.task)
    }
}

/// Serves in `role`, as the world with this index, in the run of `root`.
fn take_part(
    (role, index): (Role, u8),
    root: PathBuf,
    worlds: Worlds,
    files: &Files,
    plant: Option<Plant>,
) -> Result<()> {
    if plant == Some(Plant::LeftOpen) && role == Role::Memory {
        std::mem::forget(File::open("/dev/null")?);
    }
    if plant == Some(Plant::WaitsInVain) && role == Role::Memory {
        clock::sleep(Duration::from_secs(60));
    }
    match role {
        Role::Sim => {
            let bus = Bus::join_as(Attach::read(&root)?, Role::Sim, index)?;
            let views = ViewFolder::open(&files.caches, &worlds, &RenderSettings::default())?;
            let demonstrations = BookFile::<DemonstrationBook>::read(&files.demonstrations)?.book;
            let mut world = WarehouseWorld::new(bus.attach(), worlds, demonstrations)?;
            let open = |world: &mut WarehouseWorld| Ok(rendering(views).install(world));
            Ok(serve_generation(&bus, &mut world, false, open)?)
        }
        Role::Memory => {
            let settings = ServeSettings {
                attach: root,
                demonstrations: files.demonstrations.clone(),
                assets: Some(files.assets.clone()),
                documents: None,
                encoder: None,
                snapshots: files.snapshots.clone(),
                shipped_embeddings: None,
                limits: ExternalLimits::default(),
            };
            let bus = Bus::join(Attach::read(&settings.attach)?, Role::Memory)?;
            serve_with(&settings, &bus, |wake, _| {
                let encoder = Encoder::on_caller(encoder_facts(), embed, move || wake());
                let cache = EmbeddingCache::open(&files.caches, &[0; 32], DIMENSION)?;
                Ok((Some(encoder), cache))
            })
        }
        Role::Policy => Ok(peer::serve(&mut DigestPolicy { plant }, &root)?),
        Role::ExternalMemory => Ok(peer::memory::serve(&external::method(), &root)?),
        Role::Orchestrator => bail!("{} is not started", role.word()),
    }
}

fn rendering(views: ViewFolder) -> WarehouseRendering {
    let worker = KeepingWorker::new(Box::new(PatternWorker), Arc::new(views), 0);
    WarehouseRendering {
        setup: RenderSetup {
            renderers: Renderers::Caller(Box::new(worker)),
            facts: vec![("backend", "pattern".to_owned())],
        },
        find_changes: Box::new(|_, view| VisibleChanges {
            stock: view.stock != 0,
            barricades: !view.variant.closed().is_empty(),
        }),
    }
}

/// Fills a frame with a pattern that names the view.
struct PatternWorker;

impl RenderWorker<WarehousePicture> for PatternWorker {
    fn render_into(
        &mut self,
        tasks: &mut [RenderTask<'_, WarehousePicture>],
    ) -> Result<u64, WorldFailure> {
        for RenderTask { picture, slot, .. } in tasks {
            let WarehousePicture { stock, variant, pose, .. } = picture;
            let name = format!("{stock} {pose:?} {:?}", variant.closed());
            let name = *blake3::hash(name.as_bytes()).as_bytes();
            slot.pixels_mut()
                .chunks_mut(name.len())
                .for_each(|row| row.copy_from_slice(&name[..row.len()]));
        }
        Ok(0)
    }
}

fn encoder_facts() -> EncoderFacts {
    EncoderFacts {
        model: "pattern".to_owned(),
        sha256: String::new(),
        trained: false,
        runtime: "none".to_owned(),
        provider: Provider::default(),
        threads: 1,
        dimension: DIMENSION,
        fingerprint: [0; 32],
        model_fingerprint: [0; 32],
    }
}

/// An embedding of the pattern.
fn embed(image: Image<'_>) -> Result<Embedding> {
    ensure!(image.rgba.len() > DIMENSION, "an empty image");
    let raw: Vec<f32> =
        image.rgba[..DIMENSION].iter().map(|&byte| f32::from(byte) - 127.5).collect();
    Embedding::normalised(&raw).context("an embedding of length zero")
}

/// Draws each action from everything that it was given, so that a wrong frame or a wrong item changes the episode.
struct DigestPolicy {
    plant: Option<Plant>,
}

impl Policy for DigestPolicy {
    fn name(&self) -> &str {
        "digest"
    }

    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision> {
        batch.iter().map(|request| Decision::act(request, self.action(request))).collect()
    }
}

impl DigestPolicy {
    fn action(&self, request: &Request<'_>) -> ActionCode {
        let mut hasher = blake3::Hasher::new();
        let mut add = |bytes: &[u8]| {
            hasher.update(&(bytes.len() as u64).to_le_bytes());
            hasher.update(bytes);
        };
        add(request.instruction.as_bytes());
        add(format!("{} {:?} {}", request.state, request.feedback, request.step).as_bytes());
        add(&pixels(&request.frame));
        for past in request.window {
            add(format!("{:?} {:?}", past.action, past.feedback).as_bytes());
            add(&pixels(&past.frame));
        }
        let mut shown = None;
        for item in request.items {
            match item {
                Item::Text(text) => add(text.text.as_bytes()),
                Item::Frame(view) => {
                    add(view.caption.as_bytes());
                    add(&pixels(&view.frame));
                }
                Item::Plan(plan) => {
                    shown = shown.or_else(|| plan.actions().next());
                    for part in plan.parts {
                        add(format!("{:?} {:?}", part.instruction, part.actions).as_bytes());
                    }
                }
                Item::Steps(steps) => {
                    add(&steps.distance.map_or(0, f32::to_bits).to_le_bytes());
                    for step in steps.steps {
                        shown = shown.or(step.action);
                        add(format!("{:?}", step.action).as_bytes());
                        add(&step.frame.map_or([0; 16], |frame| pixels(&frame)));
                    }
                }
            }
        }
        if self.plant == Some(Plant::OtherDecisions) {
            add(&(monotonic_ns() / 50_000_000).to_le_bytes());
        }
        let draw = usize::from(hasher.finalize().as_bytes()[0]);
        match shown {
            Some(action) if draw % 4 != 0 => action,
            _ => ActionCode((draw % request.world.actions.len()) as u8),
        }
    }
}

/// The hash of the pixels. A frame that was overwritten while it can be named is a bug.
pub(crate) fn pixels(frame: &FrameView<'_>) -> [u8; 16] {
    let mut hash = [0; 16];
    if !frame.pixels.is_empty() {
        hash.copy_from_slice(&blake3::hash(frame.pixels).as_bytes()[..16]);
        assert_eq!(hash, frame.content_hash, "frame {} was overwritten", frame.id);
    }
    hash
}
