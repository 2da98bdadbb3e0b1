//! The memory process in a run whose other roles are scripted. Needs the files that `cargo xtask setup` fetches.

#![expect(clippy::unwrap_used, reason = "test helpers fail loudly")]

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use bytemuck::Zeroable;
use case_book::{BookFile, BookRequest, DEMONSTRATIONS_FILE, DemonstrationBook, WorldDeclaration};
use documents::{BuildAccount, DocumentFile, DocumentFolder, Provenance};
use domain::{Demonstrations, DocumentKind, Representation, SegmentContent, State};
use memory_proc::embedding_cache::stored;
use memory_proc::paths::CacheFolder;
use peer::memory::{
    Memory, MemoryDescription, MemoryError, MemoryItem, MemoryMethod, Query, Source, Views, serve,
};
use rigs::process::MemoryRig;
use shm_types::Attach;
use shm_types::description::memory_folder;
use shm_types::documents::Content;
use shm_types::message::{
    EXTERNAL, ErrorReportKind, ItemKind, MemoryEpisodeConfig, NO_ACTION, NO_FRAME, Observation,
    Role,
};
use tempfile::TempDir;
use warehouse::case_book::write_books;
use warehouse::{Case, CaseSet, Replay, TrajectoryKind, Warehouse};

/// The index of the external memory.
const INDEX: u8 = 1;

/// An external memory that answers the first step with a text and two steps. The next one it fails in lane 0; in other
/// lanes it hangs until the test ends.
#[derive(Clone, Default)]
struct Scripted {
    ended: Arc<AtomicBool>,
}

impl MemoryMethod for Scripted {
    fn describe(&self) -> MemoryDescription {
        MemoryDescription { name: "scripted".to_owned(), ..MemoryDescription::default() }
    }

    fn create(&self, _world: &Arc<WorldDeclaration>) -> Box<dyn Memory + '_> {
        Box::new(self.clone())
    }
}

impl Memory for Scripted {
    fn recall(&mut self, query: &Query<'_>) -> Result<Vec<MemoryItem>, MemoryError> {
        let source = Source { demonstration: 0, first: query.now.step + 1, count: 2 };
        match query.now.step {
            0 => Ok(vec![
                MemoryItem::Text { text: query.instruction.into(), sources: vec![source] },
                MemoryItem::Steps { source, views: Views::All, actions: true, distance: None },
            ]),
            _ => {
                while query.now.lane > 0 && !self.ended.load(Relaxed) {
                    std::thread::sleep(Duration::from_millis(1));
                }
                Err(MemoryError::new("out of credit"))
            }
        }
    }
}

/// Memory with an encoder and this cache folder, among its neighbours.
fn memory(cache: &Path) -> MemoryRig {
    memory_with(&["--cache".as_ref(), cache.as_os_str()])
}

/// Memory with these arguments, among its neighbours.
fn memory_with(arguments: &[&OsStr]) -> MemoryRig {
    let change = |attach: &mut Attach| (attach.frame_capacity, attach.lanes) = (400, 2);
    let book = write_books(&BookRequest::default()).unwrap().demonstrations;
    let mut rig = MemoryRig::in_process(change, |folder| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_memory-proc"));
        command.arg("serve").arg("--attach").arg(folder).args(arguments);
        command.arg("--demonstrations").arg(written_into(folder, &book));
        command
    });
    rig.neighbours.demonstrations = states_of(book);
    rig
}

/// Writes the demonstrations into `folder`. Returns the file.
fn written_into(folder: &Path, book: &DemonstrationBook) -> PathBuf {
    let file = folder.join(DEMONSTRATIONS_FILE);
    fs::write(&file, BookFile::new(book).unwrap().text).unwrap();
    file
}

fn states_of(book: DemonstrationBook) -> Vec<Vec<State>> {
    book.demonstrations.into_iter().map(|of| of.states).collect()
}

/// The states of a replay.
fn states(replay: &Replay) -> Vec<State> {
    replay.poses.iter().copied().map(State::from).collect()
}

/// The observation at `step` of a case's trajectory of this kind.
fn observation(replay: &Replay, case: &Case, kind: TrajectoryKind, step: usize) -> Observation {
    let actions = &case.trajectory(kind).actions;
    Observation {
        step: step as u32,
        state: State::from(replay.poses[step]).padded(),
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
    let mut rig = memory(cache.path());
    let facts = rig.handshake().facts().unwrap();
    assert_eq!((&*facts["encoder"], &*facts["encoder_trained"]), ("dinov2-s14", "true"));
    assert!(facts["encoder_sha256"].len() == 64 && !facts["onnxruntime"].is_empty());

    // The case whose original demonstration has the fewest views to embed.
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped().cases);
    let length = |case: &Case| case.original.actions.len();
    let index = (0..cases.len()).min_by_key(|&index| length(&cases[index])).unwrap();
    let (case, replay) = (&cases[index], cases[index].replay(&warehouse, TrajectoryKind::Original));
    let config = MemoryEpisodeConfig {
        case: index as u32,
        horizon: 3,
        ..config(Representation::Episodic, 0, 11, Demonstrations::ORIGINAL)
    };
    rig.begin(&config);
    rig.begin(&MemoryEpisodeConfig {
        episode: 12,
        lane: 1,
        representation: Representation::Working as u8,
        ..config
    });
    let seen = |step| observation(&replay, case, TrajectoryKind::Original, step);
    for step in 0..4 {
        rig.observe(Observation { episode: 11, ..seen(step) });
        let (recall, trace) = rig.recall();
        assert_eq!((recall.episode, recall.step), (11, step as u32));
        let (item, source) = (recall.items[0], trace.sources[0]);
        assert_eq!((recall.items_len, trace.sources_len, item.distance), (1, 1, 0.0));
        assert_eq!((item.kind, source.kind), (ItemKind::Steps as u8, ItemKind::Steps as u8));
        assert_eq!((source.case, source.demonstration), (index as u32, 0));
        assert_eq!([trace.images_asked, trace.images, source.steps.into()], [recall.steps_len; 3]);
        assert!(trace.store_bytes > 0);
        let matched = usize::from(source.first);
        let shown = rig.segment(&recall);
        let until = (matched + 3).min(length(case));
        assert_eq!(shown, states(&replay)[matched..=until]);
        assert_eq!(shown[0], states(&replay)[step]);
    }

    rig.observe(Observation { episode: 12, lane: 1, ..seen(0) });
    let (recall, trace) = rig.recall();
    assert_eq!((recall.lane, recall.items_len, trace.sources_len), (1, 0, 0));
    assert_eq!(rig.segment(&recall), []);

    rig.observe(Observation { episode: 99, ..seen(0) });
    assert_eq!(rig.error_report().1, "observation of unknown episode 99 in lane 0");
    rig.begin(&MemoryEpisodeConfig { episode: 13, case: 4000, ..config });
    assert!(rig.error_report().1.starts_with("config of episode 13: case 4000"));
    rig.observe_as(Observation { episode: 11, frame: 1 << 50, ..seen(4) });
    assert!(rig.error_report().1.contains("is not in the store"));

    rig.observe(Observation { episode: 11, last: 1, ..seen(4) });
    let mut views = replay.poses.clone();
    views.sort_unstable();
    views.dedup();
    rig.until(|neighbours| (neighbours.released == views.len()).then_some(()));

    let views_shown = rig.neighbours.shown.len() as u64;
    let shutdown_report = rig.stop();
    assert_eq!((shutdown_report.role, shutdown_report.error_reports), (Role::Memory as u32, 3));
    assert_eq!(shutdown_report.pixel_bytes_copied, 0);
    assert_eq!(shutdown_report.frames_received, views_shown);

    // Embeddings are on disk: each distinct view once.
    assert_eq!(stored(&cache.path().join("embeddings"), 384).len(), views.len());
}

#[test]
fn a_missing_model_is_reported_with_the_command_that_fetches_it() {
    let empty = tempfile::tempdir().unwrap();
    let mut rig = memory(empty.path());
    let said = rig.error_report().1;
    assert_eq!(rig.end().unwrap_err().to_string(), "exit status: 2");
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
        text_budget: 65536,
        image_budget: 40,
        hits: 1,
        repeat: 1,
        ..Zeroable::zeroed()
    }
}

/// Writes a run's copy of a document into `folder`.
fn write_document(folder: &Path, kind: DocumentKind, set: Demonstrations) {
    let provenance = Provenance {
        kind,
        demonstrations: set,
        builder: "test".to_owned(),
        builder_version: "1".to_owned(),
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
    let mut rig =
        memory_with(&["--no-encoder".as_ref(), "--documents".as_ref(), folder.path().as_os_str()]);
    assert_eq!(rig.handshake().facts(), Ok(BTreeMap::new()));

    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped().cases);
    let replay = cases[0].replay(&warehouse, TrajectoryKind::Original);
    let seen = |step| observation(&replay, &cases[0], TrajectoryKind::Original, step);
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
        rig.begin(&config(representation, 0, episode, original));
        for step in 0..2 {
            rig.observe(Observation { episode, ..seen(step) });
            let (recall, trace) = rig.recall();
            assert_eq!((rig.segment(&recall), trace.sources_len), (vec![], 0));
            let named = rig.documents(&recall);
            assert!(named.iter().all(|(_, owner, _)| *owner == 0), "for the whole run");
            assert_eq!(named.iter().map(|named| &named.2).collect::<Vec<_>>(), texts);
            ids.extend(named.into_iter().map(|named| named.0));
        }
    }
    assert_eq!(ids.len(), 2, "each is published once");

    // Two lanes, with different trajectories.
    for (lane, episode, set) in [(0, 6, original), (1, 7, Demonstrations::ALL)] {
        rig.begin(&config(Representation::FullContext, lane, episode, set));
        rig.observe(Observation { episode, lane, ..seen(0) });
        let (recall, _) = rig.recall();
        let named = rig.documents(&recall);
        let [(_, owner, Content::Trajectories(steps))] = &named[..] else {
            panic!("{named:?} for {set}")
        };
        assert_eq!((*owner, recall.items_len, recall.items[0].whole), (episode, 1, 1));
        let mut rest = &steps[..];
        for start in TrajectoryKind::DEMONSTRATIONS.into_iter().take(if lane == 0 { 1 } else { 4 })
        {
            let walk = cases[0].replay(&warehouse, start);
            let (these, others) = rest.split_at(walk.poses.len());
            let actions = cases[0].trajectory(start).actions.iter().map(|&action| action as u8);
            let actions: Vec<u8> = actions.chain([NO_ACTION]).collect();
            assert_eq!(these.iter().map(|step| step.action).collect::<Vec<_>>(), actions);
            for (step, state) in these.iter().zip(states(&walk)) {
                assert!(step.frame == NO_FRAME || rig.neighbours.shown[&step.frame] == state);
            }
            assert!(these[0].frame != NO_FRAME && these[these.len() - 1].frame != NO_FRAME);
            rest = others;
        }
        assert_eq!(rest, []);
        let keyframes = steps.iter().filter(|step| step.frame != NO_FRAME).count();
        assert_eq!(keyframes, steps.len().min(40));
    }

    rig.begin(&config(Representation::Episodic, 0, 8, original));
    let said = rig.error_report().1;
    assert!(said.starts_with("config of episode 8: episodic memory matches views"), "{said}");
    rig.stop();
}

/// An empty memory would be measured as if it were the representation, so the run ends.
#[test]
fn a_missing_document_ends_the_run_and_is_reported_with_the_command_that_builds_it() {
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped().cases);
    let replay = cases[0].replay(&warehouse, TrajectoryKind::Original);
    let seen = observation(&replay, &cases[0], TrajectoryKind::Original, 0);
    let folder = tempfile::tempdir().unwrap();
    // The document of another set does not count.
    write_document(folder.path(), DocumentKind::Summary, Demonstrations::ORIGINAL);
    let documents = ["--documents".as_ref(), folder.path().as_os_str()];
    for (arguments, expected) in [
        (&documents[..], "`memtransfer memory build --kind summary --demos 4`"),
        (&[], "memory-proc was started without --documents DIR"),
    ] {
        let mut rig = memory_with(&[&["--no-encoder".as_ref()], arguments].concat());
        rig.handshake();
        rig.begin(&config(Representation::Summary, 0, 1, Demonstrations::ALL));
        rig.observe(Observation { episode: 1, ..seen });
        let said = rig.error_report().1;
        assert!(said.starts_with("the memory process failed: summary memory: "), "{said}");
        assert!(said.contains(expected), "{said}");
        assert_eq!(rig.end().unwrap_err().to_string(), "exit status: 2");
    }
}

/// Memory and an external memory that a thread serves, among their neighbours.
fn memory_with_external(method: Scripted, arguments: &[&str]) -> MemoryRig {
    let change = |attach: &mut Attach| {
        (attach.frame_capacity, attach.lanes) = (400, 2);
        attach.external_memories = vec![INDEX];
    };
    let book = write_books(&BookRequest::default()).unwrap().demonstrations;
    let mut rig = MemoryRig::in_process(change, |run| {
        let folder = memory_folder(run, INDEX);
        std::fs::create_dir(&folder).unwrap();
        let path = folder.clone();
        std::thread::spawn(move || serve(&method, &path));
        while MemoryDescription::read(&folder).is_err() {
            std::thread::sleep(Duration::from_millis(1));
        }
        let mut command = Command::new(env!("CARGO_BIN_EXE_memory-proc"));
        command.arg("serve").arg("--attach").arg(run).args(arguments);
        command.arg("--demonstrations").arg(written_into(run, &book));
        command
    });
    rig.neighbours.demonstrations = states_of(book);
    rig
}

#[test]
fn an_external_memory_supplies_what_it_names_and_fails_its_own_episodes_only() {
    let memory = Scripted::default();
    let arguments = ["--no-encoder", "--memory-timeout", "15"];
    let mut rig = memory_with_external(memory.clone(), &arguments);
    // Its own and that of the external memory, in any order.
    let facts = [rig.handshake(), rig.handshake()].map(|handshake| handshake.facts().unwrap());
    assert!(facts.iter().any(|facts| facts.get("memory").is_some_and(|name| name == "scripted")));

    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped().cases);
    let replay = cases[0].replay(&warehouse, TrajectoryKind::Original);
    let seen = |step| observation(&replay, &cases[0], TrajectoryKind::Original, step);
    let external = |lane, episode| MemoryEpisodeConfig {
        representation: EXTERNAL,
        external: INDEX,
        ..config(Representation::Working, lane, episode, Demonstrations::ORIGINAL)
    };
    rig.begin(&external(0, 1));
    rig.observe(Observation { episode: 1, ..seen(0) });
    let (recall, trace) = rig.recall();
    assert_eq!((recall.items_len, recall.steps_len, trace.sources_len), (2, 2, 2));
    let named = rig.documents(&recall);
    let instruction = cases[0].task.instruction(&warehouse.catalogue);
    let [(_, 1, Content::Note(text))] = &named[..] else { panic!("{named:?}") };
    assert_eq!(*text, instruction);
    assert_eq!(rig.segment(&recall), states(&replay)[1..3]);
    assert!(trace.method_ns > 0 && trace.embedded_ns + trace.method_ns <= trace.searched_ns);

    // It fails; then it hangs. Each costs its own episode, and the other lane goes on.
    let failure = |rig: &mut MemoryRig| {
        let (failed, why) = rig.error_report();
        (failed.kind, failed.episode, why)
    };
    rig.observe(Observation { episode: 1, ..seen(1) });
    let why = "external memory scripted, step 1: out of credit".to_owned();
    assert_eq!(failure(&mut rig), (ErrorReportKind::Episode as u32, 1, why));
    rig.begin(&external(1, 2));
    rig.begin(&config(Representation::Working, 0, 3, Demonstrations::ORIGINAL));
    rig.observe(Observation { episode: 2, lane: 1, ..seen(0) });
    assert_eq!(rig.recall().0.episode, 2);
    rig.observe(Observation { episode: 2, lane: 1, ..seen(1) });
    rig.observe(Observation { episode: 3, ..seen(0) });
    assert_eq!(rig.recall().0.episode, 3);
    let why = "external memory scripted has not answered step 1 within 15 s".to_owned();
    assert_eq!(failure(&mut rig), (ErrorReportKind::Overdue as u32, 2, why));
    memory.ended.store(true, Relaxed);
    rig.stop();
}
