//! The memory process in a run whose other roles are scripted. Needs the files that `cargo xtask setup` fetches.

#![expect(clippy::unwrap_used, reason = "test helpers fail loudly")]

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use bytemuck::Zeroable;
use conformance::testing::MemoryRig;
use documents::{BuildAccount, DocumentFile, DocumentFolder, Provenance};
use domain::{DocumentKind, Representation, SegmentContent};
use memory_proc::embedding_cache::stored;
use memory_proc::paths::CacheFolder;
use shm_types::Attach;
use shm_types::documents::Content;
use shm_types::message::{
    MAX_SEGMENT, MemoryEpisodeConfig, NO_ACTION, NO_FRAME, NOT_MEASURED, Observation, Role,
};
use tempfile::TempDir;
use warehouse::{Case, CaseSet, Demonstrations, Replay, Start, Warehouse};

const ORIGINAL: u32 = 0b0001;

/// Memory with an encoder and this cache folder, among its neighbours.
fn memory(cache: &Path) -> MemoryRig {
    memory_with(&["--cache".as_ref(), cache.as_os_str()])
}

/// Memory with these arguments, among its neighbours.
fn memory_with(arguments: &[&OsStr]) -> MemoryRig {
    let change = |attach: &mut Attach| (attach.frame_capacity, attach.lanes) = (400, 2);
    MemoryRig::in_process(change, |folder| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_memory-proc"));
        command.arg("serve").arg("--attach").arg(folder).args(arguments);
        command
    })
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
    let mut rig = memory(cache.path());
    let facts = rig.handshake().facts().unwrap();
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
    rig.begin(&config);
    rig.begin(&MemoryEpisodeConfig {
        episode: 12,
        lane: 1,
        representation: Representation::Working as u8,
        ..config
    });
    let seen = |step| observation(&replay, case, Start::Original, step);
    for step in 0..4 {
        rig.observe(Observation { episode: 11, ..seen(step) });
        let (recall, trace) = rig.recall();
        assert_eq!((recall.episode, recall.step, recall.distance), (11, step as u32, 0.0));
        assert_eq!((trace.case, trace.demonstration), (index as u32, 0));
        let matched = usize::from(trace.index);
        let shown = rig.segment(&recall);
        let until = (matched + 3).min(length(case));
        assert_eq!(shown, replay.poses[matched..=until]);
        assert_eq!(shown[0], replay.poses[step]);
        assert!(shown.len() <= MAX_SEGMENT);
    }

    rig.observe(Observation { episode: 12, lane: 1, ..seen(0) });
    let (recall, trace) = rig.recall();
    assert_eq!((recall.lane, trace.case), (1, NOT_MEASURED));
    assert_eq!(rig.segment(&recall), []);
    assert!(recall.distance.is_nan() && trace.distance.is_nan());

    rig.observe(Observation { episode: 99, ..seen(0) });
    assert_eq!(rig.error_report().1, "observation of unknown episode 99 in lane 0");
    rig.begin(&MemoryEpisodeConfig { episode: 13, case: 4000, ..config });
    assert!(rig.error_report().1.starts_with("config of episode 13: case 4000"));
    rig.neighbours.send(&Observation { episode: 11, frame: 1 << 50, ..seen(4) }).unwrap();
    rig.notify();
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
    let mut rig =
        memory_with(&["--no-encoder".as_ref(), "--documents".as_ref(), folder.path().as_os_str()]);
    assert_eq!(rig.handshake().facts(), Ok(BTreeMap::new()));

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
        rig.begin(&config(representation, 0, episode, original));
        for step in 0..2 {
            rig.observe(Observation { episode, ..seen(step) });
            let (recall, trace) = rig.recall();
            assert_eq!((rig.segment(&recall), trace.case), (vec![], NOT_MEASURED));
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
        assert_eq!(*owner, episode);
        let mut rest = &steps[..];
        for start in Start::DEMONSTRATIONS.into_iter().take(if lane == 0 { 1 } else { 4 }) {
            let walk = cases[0].replay(&warehouse, start);
            let (these, others) = rest.split_at(walk.poses.len());
            let actions = cases[0].trajectory(start).actions.iter().map(|&action| action as u8);
            let actions: Vec<u8> = actions.chain([NO_ACTION]).collect();
            assert_eq!(these.iter().map(|step| step.action).collect::<Vec<_>>(), actions);
            for (step, pose) in these.iter().zip(&walk.poses) {
                assert!(step.frame == NO_FRAME || rig.neighbours.shown[&step.frame] == *pose);
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
