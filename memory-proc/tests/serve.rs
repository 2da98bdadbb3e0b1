//! The memory process in a run whose other roles are scripted. Needs the files that `cargo xtask setup` fetches.

#![expect(clippy::unwrap_used, reason = "test helpers fail loudly")]

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ffi::OsStr;
use std::path::Path;
use std::process::{Child, Command, ExitStatus};
use std::time::{Duration, Instant};

use bytemuck::Zeroable;
use documents::{BuildAccount, DocumentFile, DocumentFolder, Provenance};
use domain::{DocumentKind, SegmentContent};
use domain::{Pose, Representation};
use memory_proc::embedding_cache::stored;
use memory_proc::paths::CacheFolder;
use shm_types::documents::Content;
use shm_types::message::{
    DocumentId, ErrorReport, FrameId, Handshake, MAX_SEGMENT, MemoryEpisodeConfig, NO_ACTION,
    NO_FRAME, NOT_MEASURED, Observation, Recall, RecallTrace, Role, ShutdownReport, Stop, View,
    ViewRequest, ViewRequestKind, read_text,
};
use shm_types::{
    Attach, Bus, DocumentStore, FramePublisher, FrameSize, FrameStore, Receiver, RunDir, Sender,
};
use tempfile::TempDir;
use warehouse::{Case, CaseSet, Demonstrations, Replay, Start, Warehouse};

/// A wait that takes this long hangs.
const LONG: Duration = Duration::from_secs(120);

const ORIGINAL: u32 = 0b0001;

/// The scripted roles and the memory process. Fields are dropped in order: the child first.
struct Bench {
    memory: Kill,
    configs: Sender<MemoryEpisodeConfig>,
    stop: Sender<Stop>,
    observations: Sender<Observation>,
    views: Sender<View>,
    requests: Receiver<ViewRequest>,
    recalls: Receiver<Recall>,
    traces: Receiver<RecallTrace>,
    handshakes: Receiver<Handshake>,
    error_reports: Receiver<ErrorReport>,
    shutdown_reports: Receiver<ShutdownReport>,
    publisher: FramePublisher,
    documents: DocumentStore,
    /// The pose of each frame.
    shown: HashMap<FrameId, Pose>,
    released: usize,
    _idle: Idle,
    orchestrator: Bus,
    sim: Bus,
    _policy: Bus,
    _run: RunDir,
    _base: TempDir,
}

/// Unused receivers: a send fails if one of its receivers is missing.
struct Idle {
    _observations: [Receiver<Observation>; 2],
    _stops: [Receiver<Stop>; 2],
    _frames: FrameStore,
}

struct Kill(Child);

impl Drop for Kill {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Bench {
    /// Memory with an encoder and this cache folder.
    fn new(cache: &Path) -> Self {
        Self::with(&["--cache".as_ref(), cache.as_os_str()])
    }

    /// Memory with these arguments.
    fn with(arguments: &[&OsStr]) -> Self {
        let base = tempfile::Builder::new().prefix("mt").tempdir_in("/tmp").unwrap();
        let run = RunDir::create(base.path()).unwrap();
        let frame = FrameSize { width: 64, height: 64 };
        let attach = Attach { frame, frame_capacity: 400, lanes: 2, ..run.attach() };
        attach.write(run.path()).unwrap();
        let [orchestrator, sim, policy] = [Role::Orchestrator, Role::Sim, Role::Policy]
            .map(|role| Bus::join(attach.clone(), role).unwrap());
        let idle = Idle {
            _observations: [&orchestrator, &policy].map(|bus| bus.receiver().unwrap()),
            _stops: [&sim, &policy].map(|bus| bus.receiver().unwrap()),
            _frames: FrameStore::new(&policy).unwrap(),
        };
        // Memory starts last, so that its first messages find their receivers.
        let handshakes = orchestrator.receiver().unwrap();
        let error_reports = orchestrator.receiver().unwrap();
        let shutdown_reports = orchestrator.receiver().unwrap();
        let documents = DocumentStore::new(&policy).unwrap();
        let memory = Command::new(env!("CARGO_BIN_EXE_memory-proc"))
            .arg("serve")
            .arg("--attach")
            .arg(run.path())
            .args(arguments)
            .spawn()
            .unwrap();
        Self {
            memory: Kill(memory),
            configs: orchestrator.sender().unwrap(),
            stop: orchestrator.sender().unwrap(),
            observations: sim.sender().unwrap(),
            views: sim.sender().unwrap(),
            requests: sim.receiver().unwrap(),
            recalls: policy.receiver().unwrap(),
            traces: orchestrator.receiver().unwrap(),
            handshakes,
            error_reports,
            shutdown_reports,
            publisher: FramePublisher::new(&sim).unwrap(),
            documents,
            shown: HashMap::new(),
            released: 0,
            _idle: idle,
            orchestrator,
            sim,
            _policy: policy,
            _run: run,
            _base: base,
        }
    }

    /// Serves view requests until `next` returns something.
    fn until<T>(&mut self, mut next: impl FnMut(&mut Self) -> Option<T>) -> T {
        let deadline = Instant::now() + LONG;
        loop {
            for request in self.requests.drain().unwrap() {
                if request.kind == ViewRequestKind::Pin as u8 {
                    let frame = self.publish(Pose::try_from(request.pose).unwrap());
                    self.views.send(&View { frame, pose: request.pose, reserved: 0 }).unwrap();
                    self.sim.notifier(Role::Memory).unwrap().notify().unwrap();
                } else {
                    assert_eq!(Pose::try_from(request.pose), Ok(self.shown[&request.frame]));
                    self.released += 1;
                }
            }
            // Checked first, so that messages sent before the process ended are found.
            let ended = self.memory.0.try_wait().unwrap();
            if let Some(found) = next(self) {
                return found;
            }
            assert!(
                ended.is_none() && Instant::now() < deadline,
                "memory does not answer: {ended:?}"
            );
            self.sim.listener().wait(Duration::from_millis(2)).unwrap();
        }
    }

    /// Publishes a frame for `pose`, with stripes that no other pose has.
    fn publish(&mut self, pose: Pose) -> FrameId {
        let mut slot = self.publisher.loan().unwrap();
        let seed = *blake3::hash(pose.to_string().as_bytes()).as_bytes();
        for (index, byte) in slot.pixels_mut().iter_mut().enumerate() {
            let (column, row) = (index / 4 % 64, index / 256);
            *byte = seed[(column / 8 + 3 * (row / 8)) % 32] ^ (index % 4) as u8;
        }
        let hash = *blake3::hash(slot.pixels()).as_bytes().first_chunk().unwrap();
        let id = self.publisher.publish(slot, hash).unwrap();
        self.shown.insert(id, pose);
        id
    }

    /// The facts in memory's handshake.
    fn handshake(&mut self) -> BTreeMap<String, String> {
        let handshake = self.until(|bench| {
            // A process that cannot start reports an error instead.
            if let Some(error_report) = bench.error_reports.next().unwrap() {
                panic!("{}", read_text(&error_report.text, error_report.text_len).unwrap());
            }
            bench.handshakes.next().unwrap()
        });
        handshake.facts().unwrap()
    }

    /// The documents that a recall names, in order, and their episodes; 0 stands for the run.
    fn named(&mut self, recall: &Recall) -> Vec<(DocumentId, u64, Content)> {
        let ids = &recall.documents[..recall.documents_len as usize];
        let mut named = |&id: &DocumentId| {
            let document = self.documents.get(id).unwrap().expect("published before it is named");
            (id, document.episode, document.content.clone())
        };
        ids.iter().map(&mut named).collect()
    }

    fn config(&self, config: MemoryEpisodeConfig) {
        self.configs.send(&config).unwrap();
        self.orchestrator.notifier(Role::Memory).unwrap().notify().unwrap();
    }

    fn observe(&mut self, seen: Observation) -> FrameId {
        let frame = if seen.last == 1 { 0 } else { self.publish(seen.pose.try_into().unwrap()) };
        self.observations.send(&Observation { frame, ..seen }).unwrap();
        self.sim.notifier(Role::Memory).unwrap().notify().unwrap();
        frame
    }

    fn recall(&mut self) -> (Recall, RecallTrace) {
        let recall = self.until(|bench| bench.recalls.next().unwrap());
        let trace = self.until(|bench| bench.traces.next().unwrap());
        assert_eq!(
            (recall.episode, recall.lane, recall.step),
            (trace.episode, trace.lane, trace.step)
        );
        let times =
            [trace.received_ns, trace.embedded_ns, trace.searched_ns, trace.sent_ns, u64::MAX];
        assert!(times.is_sorted() && times[0] > 0);
        (recall, trace)
    }

    fn error_report(&mut self) -> String {
        let error_report = self.until(|bench| bench.error_reports.next().unwrap());
        read_text(&error_report.text, error_report.text_len).unwrap().to_owned()
    }

    fn exit(&mut self) -> ExitStatus {
        let deadline = Instant::now() + LONG;
        loop {
            if let Some(status) = self.memory.0.try_wait().unwrap() {
                return status;
            }
            assert!(Instant::now() < deadline, "memory does not end");
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// The observation at `step` of a case's trajectory from `start`.
fn observation(replay: &Replay, case: &Case, start: Start, step: usize) -> Observation {
    let actions = &case.trajectory(start).actions;
    Observation {
        step: step as u32,
        pose: replay.poses[step].into(),
        feedback: replay.feedback[step] as u8,
        action: if step == 0 { NO_ACTION } else { actions[step - 1] as u8 },
        ..Zeroable::zeroed()
    }
}

/// A cache folder with the files that setup fetched, and no embeddings.
fn fresh_cache() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let setup = CacheFolder::from_environment().unwrap();
    for part in ["models", "onnxruntime"] {
        std::os::unix::fs::symlink(setup.root().join(part), folder.path().join(part)).unwrap();
    }
    folder
}

#[test]
fn a_run_is_answered_with_reports_of_unusable_messages() {
    let cache = fresh_cache();
    let mut bench = Bench::new(cache.path());
    let facts = bench.handshake();
    assert_eq!((&*facts["encoder"], &*facts["encoder_trained"]), ("dinov2-s14", "true"));
    assert!(facts["encoder_sha256"].len() == 64 && !facts["onnxruntime"].is_empty());

    // The case whose original demonstration has the fewest views to embed.
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped().cases);
    let length = |case: &Case| case.original.actions.len();
    let index = (0..cases.len()).min_by_key(|&index| length(&cases[index])).unwrap();
    let (case, replay) = (&cases[index], cases[index].replay(&warehouse, Start::Original));
    let config = MemoryEpisodeConfig {
        episode: 11,
        lane: 0,
        case: index as u32,
        demonstrations: ORIGINAL,
        representation: Representation::Episodic as u8,
        horizon: 3,
        keyframes: 40,
        segment: SegmentContent::Actions as u8,
        reserved: [0; 8],
    };
    bench.config(config);
    bench.config(MemoryEpisodeConfig {
        episode: 12,
        lane: 1,
        representation: Representation::Working as u8,
        ..config
    });
    let seen = |step| observation(&replay, case, Start::Original, step);
    for step in 0..4 {
        bench.observe(Observation { episode: 11, ..seen(step) });
        let (recall, trace) = bench.recall();
        assert_eq!((recall.episode, recall.step, recall.distance), (11, step as u32, 0.0));
        assert_eq!((trace.case, trace.demonstration), (index as u32, 0));
        let matched = usize::from(trace.index);
        let segment = &recall.segment[..recall.segment_len as usize];
        let shown: Vec<Pose> = segment.iter().map(|entry| bench.shown[&entry.frame]).collect();
        let until = (matched + 3).min(length(case));
        assert_eq!(shown, replay.poses[matched..=until]);
        assert_eq!(shown[0], replay.poses[step]);
        assert!(segment.len() <= MAX_SEGMENT);
    }

    bench.observe(Observation { episode: 12, lane: 1, ..seen(0) });
    let (recall, trace) = bench.recall();
    assert_eq!((recall.lane, recall.segment_len, trace.case), (1, 0, NOT_MEASURED));
    assert!(recall.distance.is_nan() && trace.distance.is_nan());

    bench.observe(Observation { episode: 99, ..seen(0) });
    assert_eq!(bench.error_report(), "observation of unknown episode 99 in lane 0");
    bench.config(MemoryEpisodeConfig { episode: 13, case: 4000, ..config });
    assert!(bench.error_report().starts_with("config of episode 13: case 4000"));
    bench.observations.send(&Observation { episode: 11, frame: 1 << 50, ..seen(4) }).unwrap();
    bench.sim.notifier(Role::Memory).unwrap().notify().unwrap();
    assert!(bench.error_report().contains("is not in the store"));

    bench.observe(Observation { episode: 11, last: 1, ..seen(4) });
    let mut views = replay.poses.clone();
    views.sort_unstable();
    views.dedup();
    bench.until(|bench| (bench.released == views.len()).then_some(()));

    bench.stop.send(&Stop { reserved: 0 }).unwrap();
    bench.orchestrator.notifier(Role::Memory).unwrap().notify().unwrap();
    assert!(bench.exit().success());
    let shutdown_report = bench.shutdown_reports.next().unwrap().unwrap();
    assert_eq!((shutdown_report.role, shutdown_report.error_reports), (Role::Memory as u32, 3));
    assert_eq!(shutdown_report.pixel_bytes_copied, 0);
    assert_eq!(shutdown_report.frames_received, bench.shown.len() as u64);

    // Embeddings are on disk: each distinct view once.
    assert_eq!(stored(&cache.path().join("embeddings"), 384).len(), views.len());
}

#[test]
fn a_missing_model_is_reported_with_the_command_that_fetches_it() {
    let empty = tempfile::tempdir().unwrap();
    let mut bench = Bench::new(empty.path());
    let said = bench.error_report();
    assert_eq!(bench.exit().code(), Some(2));
    assert!(said.starts_with("the memory process failed: the encoder dinov2-s14 needs "), "{said}");
}

/// The standard settings.
fn config(
    representation: Representation,
    lane: u32,
    episode: u64,
    set: Demonstrations,
) -> MemoryEpisodeConfig {
    MemoryEpisodeConfig {
        episode,
        lane,
        case: 0,
        demonstrations: set.bits(),
        representation: representation as u8,
        horizon: 6,
        keyframes: 40,
        segment: SegmentContent::Actions as u8,
        reserved: [0; 8],
    }
}

/// Writes a run's copy of a document into `folder`.
fn write_document(folder: &Path, kind: DocumentKind, set: Demonstrations) {
    let provenance = Provenance {
        kind,
        demonstrations: set,
        builder: "test".to_owned(),
        builder_version: "1".to_owned(),
        inputs_sha256: String::new(),
        sources_sha256: String::new(),
        text_sha256: String::new(),
        trajectories: 100,
        views: 1,
        account: BuildAccount::default(),
    };
    let path = DocumentFolder::new(folder).run_copy(provenance.name());
    DocumentFile::new(provenance, format!("# {} of {set}", kind.word())).save(&path).unwrap();
}

#[test]
fn without_an_encoder_every_memory_but_episodic_is_served() {
    let folder = tempfile::tempdir().unwrap();
    let original = Demonstrations::ORIGINAL;
    for kind in [DocumentKind::Summary, DocumentKind::Semantic] {
        write_document(folder.path(), kind, original);
    }
    let mut bench =
        Bench::with(&["--no-encoder".as_ref(), "--documents".as_ref(), folder.path().as_os_str()]);
    assert_eq!(bench.handshake(), BTreeMap::new());

    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped().cases);
    let replay = cases[0].replay(&warehouse, Start::Original);
    let seen = |step| observation(&replay, &cases[0], Start::Original, step);
    let summary = Content::Summary("# summary of original".to_owned());
    let semantic = Content::Semantic("# semantic of original".to_owned());
    let mut ids = BTreeSet::new();
    for (episode, representation, texts) in [
        (1, Representation::Working, vec![]),
        (2, Representation::Summary, vec![&summary]),
        (3, Representation::Semantic, vec![&semantic]),
        (4, Representation::Hybrid, vec![&summary, &semantic]),
        (5, Representation::Summary, vec![&summary]),
    ] {
        bench.config(config(representation, 0, episode, original));
        for step in 0..2 {
            bench.observe(Observation { episode, ..seen(step) });
            let (recall, trace) = bench.recall();
            assert_eq!((recall.segment_len, trace.case), (0, NOT_MEASURED));
            let named = bench.named(&recall);
            assert!(named.iter().all(|(_, owner, _)| *owner == 0), "for the whole run");
            assert_eq!(named.iter().map(|named| &named.2).collect::<Vec<_>>(), texts);
            ids.extend(named.into_iter().map(|named| named.0));
        }
    }
    assert_eq!(ids.len(), 2, "each is published once");

    // Two lanes, with different trajectories.
    for (lane, episode, set) in [(0, 6, original), (1, 7, Demonstrations::ALL)] {
        bench.config(config(Representation::FullContext, lane, episode, set));
        bench.observe(Observation { episode, lane, ..seen(0) });
        let (recall, _) = bench.recall();
        let named = bench.named(&recall);
        let [(_, owner, Content::Trajectories(steps))] = &named[..] else {
            panic!("{named:?} for {set}")
        };
        assert_eq!(*owner, episode);
        assert_eq!(recall.documents_len, 1);
        let mut rest = &steps[..];
        for start in Start::DEMONSTRATIONS.into_iter().take(if lane == 0 { 1 } else { 4 }) {
            let walk = cases[0].replay(&warehouse, start);
            let (these, others) = rest.split_at(walk.poses.len());
            let actions = cases[0].trajectory(start).actions.iter().map(|&action| action as u8);
            let actions: Vec<u8> = actions.chain([NO_ACTION]).collect();
            assert_eq!(these.iter().map(|step| step.action).collect::<Vec<_>>(), actions);
            for (step, pose) in these.iter().zip(&walk.poses) {
                assert!(step.frame == NO_FRAME || bench.shown[&step.frame] == *pose);
            }
            assert!(these[0].frame != NO_FRAME && these[these.len() - 1].frame != NO_FRAME);
            rest = others;
        }
        assert_eq!(rest, []);
        let keyframes = steps.iter().filter(|step| step.frame != NO_FRAME).count();
        assert_eq!(keyframes, steps.len().min(40));
    }

    bench.config(config(Representation::Episodic, 0, 8, original));
    let said = bench.error_report();
    assert!(said.starts_with("config of episode 8: episodic memory matches views"), "{said}");
    bench.stop.send(&Stop { reserved: 0 }).unwrap();
    bench.orchestrator.notifier(Role::Memory).unwrap().notify().unwrap();
    assert!(bench.exit().success());
}

/// An empty memory would be measured as if it were the representation, so the run ends.
#[test]
fn a_missing_document_ends_the_run_and_is_reported_with_the_command_that_builds_it() {
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped().cases);
    let replay = cases[0].replay(&warehouse, Start::Original);
    let seen = observation(&replay, &cases[0], Start::Original, 0);
    let folder = tempfile::tempdir().unwrap();
    // The document of another set does not count.
    write_document(folder.path(), DocumentKind::Summary, Demonstrations::ORIGINAL);
    let documents = ["--documents".as_ref(), folder.path().as_os_str()];
    for (arguments, expected) in [
        (&documents[..], "`memtransfer memory build --kind summary --demos 4`"),
        (&[], "memory-proc was started without --documents DIR"),
    ] {
        let mut bench = Bench::with(&[&["--no-encoder".as_ref()], arguments].concat());
        bench.handshake();
        bench.config(config(Representation::Summary, 0, 1, Demonstrations::ALL));
        bench.observe(Observation { episode: 1, ..seen });
        let said = bench.error_report();
        assert!(said.starts_with("the memory process failed: summary memory: "), "{said}");
        assert!(said.contains(expected), "{said}");
        assert_eq!(bench.exit().code(), Some(2));
    }
}
