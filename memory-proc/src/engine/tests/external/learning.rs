//! An external memory that learns in a stream.

use bytemuck::Zeroable;
use domain::Demonstrations;
use shm_types::description::Scope;
use shm_types::message::{
    EXPERIENCE, ExternalQuery, ExternalStored, Learning, NOT_MEASURED, read_text,
};

use super::{ExternalRig, description, steps_answer};
use crate::embedding_cache::EmbeddingCache;
use crate::engine::Engine;
use crate::engine::tests::rig::{Rig, Script};
use crate::engine::tests::streams;
use crate::external::{ExternalLimits, ExternalMemories};
use crate::snapshots::SnapshotFolder;

/// Plays an episode of a stream, whose answers are steps 3 and 4 of the last demonstration; returns what the memory was
/// asked and the sources of the last recall.
fn stream_episode(
    rig: &mut ExternalRig,
    script: &Script,
    answer: u32,
) -> (Vec<ExternalQuery>, u16) {
    let mut asked = Vec::new();
    let mut source = 0;
    rig.rig.engine.config(&script.config).unwrap();
    for seen in &script.observations {
        rig.rig.observe(*seen).unwrap();
        let queries = rig.queries();
        for store in rig.stores.extract_if(.., |store| store.loads == 1).collect::<Vec<_>>() {
            let stored = ExternalStored { bank: store.bank, ..Zeroable::zeroed() };
            rig.rig.engine.external_stored(2, &stored).unwrap();
            asked.extend(rig.queries());
        }
        asked.extend(queries);
        let Some(query) = asked.last().filter(|query| query.last == 0) else { break };
        let mut steps = steps_answer(query);
        steps.items[0].demonstration = answer;
        rig.answer(&steps).unwrap();
        let recalls = rig.settle();
        source = recalls[0].1.sources[0].demonstration;
    }
    (asked, source)
}

#[test]
fn an_external_memory_learns_is_saved_and_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let start = || {
        let limits = ExternalLimits::default();
        let known = description(Scope::Case, true, false);
        let externals = ExternalMemories::new([(2, known)].into(), limits);
        let snapshots = SnapshotFolder::new(folder.path().to_owned());
        let embeddings = EmbeddingCache::in_memory();
        let library = streams::library();
        ExternalRig::with(Rig::with(Engine::new(
            library,
            2,
            300,
            embeddings,
            externals,
            Some(snapshots),
        )))
    };
    let in_stream = |rig: &ExternalRig, id, learns: bool, snapshot| {
        let mut script = rig.script(0, id, 3);
        script.config.demonstrations = Demonstrations::ORIGINAL.bits();
        (script.config.sequence, script.config.snapshot) = (77, snapshot);
        script.config.arm = domain::Arm::Learning as u8;
        script.config.learns = learns.into();
        script.config.feedback = domain::FeedbackLevel::SubGoals as u8;
        script
    };
    let mut rig = start();
    let lesson = in_stream(&rig, 1, true, [0; 16]);
    let (asked, source) = stream_episode(&mut rig, &lesson, 0);
    assert_eq!((asked.len(), source), (lesson.observations.len(), 0));
    let [begun] = rig.episodes[..] else { panic!("{:?}", rig.episodes) };
    assert_eq!(begun.learning, Learning::Learns as u32);
    let last = asked.last().unwrap();
    assert_eq!((last.last, last.outcome, last.demonstration), (1, 2, 3));
    let end = lesson.observations.len() as u32 - 1;
    assert!(last.sub_goals_len >= 1 && last.sub_goals_len != NOT_MEASURED);
    assert!(last.sub_goals[..last.sub_goals_len as usize].iter().all(|&at| u32::from(at) <= end));
    // It saves; only then is the episode over.
    let [save] = rig.stores[..] else { panic!("{:?}", rig.stores) };
    let path = read_text(&save.folder, save.folder_len).unwrap().to_owned();
    assert!(save.loads == 0 && rig.rig.engine.take_snapshot_reports().is_empty());
    std::fs::write(std::path::Path::new(&path).join("own"), "what it knows").unwrap();
    rig.stores.clear();
    let stored = ExternalStored { bank: save.bank, store_bytes: 9, ..Zeroable::zeroed() };
    assert!(rig.rig.engine.external_stored(5, &stored).is_err());
    rig.rig.engine.external_stored(2, &stored).unwrap();
    assert!(rig.rig.engine.external_stored(2, &stored).is_err(), "once");
    rig.settle();
    let [report] = rig.rig.engine.take_snapshot_reports()[..] else { panic!("no report") };
    assert_eq!((report.episode, report.store_bytes), (1, 9));
    // The next episode names its experience, and so does one after a restart.
    let next = in_stream(&rig, 2, false, report.snapshot);
    let (asked, source) = stream_episode(&mut rig, &next, 3);
    assert_eq!((asked.len(), source), (next.observations.len(), EXPERIENCE));
    assert_eq!((rig.episodes[1].learning, rig.episodes[1].bank), (2, begun.bank));
    let mut rig = start();
    assert_eq!(stream_episode(&mut rig, &next, 3).1, EXPERIENCE);
    // One that cannot save ends its episode without a result.
    let other = in_stream(&rig, 3, true, report.snapshot);
    stream_episode(&mut rig, &other, 0);
    let [save] = rig.stores[..] else { panic!("{:?}", rig.stores) };
    rig.note(4, u32::MAX, 0, b"disk full");
    let failed = ExternalStored { bank: save.bank, failure: 4, ..Zeroable::zeroed() };
    rig.rig.engine.external_stored(2, &failed).unwrap();
    rig.settle();
    let [(3, why)] = &rig.failures()[..] else { panic!("it fails") };
    assert!(why.contains("disk full"), "{why}");
    rig.settle();
    assert_eq!(rig.taken_back, [save.bank]);
}
