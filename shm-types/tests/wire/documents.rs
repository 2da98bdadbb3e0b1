//! Documents: published once, kept while a message can name them.

use domain::Action;
use shm_types::documents::{Content, MAX_DOCUMENT_BYTES};
use shm_types::message::{NO_ACTION, Role, TrajectoryStep};
use shm_types::{DocumentError, DocumentPublisher, DocumentStore};

use crate::common::{Run, bus, run};

fn step(trajectory: u8, frame: u64, action: u8) -> TrajectoryStep {
    TrajectoryStep { frame, action, trajectory, own: 0, reserved: [0; 5] }
}

#[test]
fn documents_of_any_length_are_read_as_published() {
    let Run { attach, .. } = &run();
    let [memory, policy] = [Role::Memory, Role::Policy].map(|role| bus(attach, role));
    let mut store = DocumentStore::new(&policy).unwrap();
    let mut publisher = DocumentPublisher::new(&memory).unwrap();
    let forward = Action::Forward as u8;
    let contents = [
        Content::Summary("a barrel at (3, 7)".repeat(10_000)),
        Content::Semantic(String::new()),
        Content::Trajectories(vec![
            step(0, 7, forward),
            step(0, 0, NO_ACTION),
            step(1, 9, NO_ACTION),
        ]),
        Content::Summary("ü".repeat(MAX_DOCUMENT_BYTES / 2)),
    ];
    let ids = contents.each_ref().map(|content| publisher.publish(None, content).unwrap());
    for (id, content) in ids.into_iter().zip(contents) {
        let document = store.get(id).unwrap().unwrap();
        assert!(document.content == content && document.id == id && document.episode == 0);
    }
    assert!(store.get(ids[3] + 1).unwrap().is_none());
    let long = Content::Semantic("x".repeat(MAX_DOCUMENT_BYTES + 1));
    assert!(matches!(publisher.publish(None, &long), Err(DocumentError::TooLong { .. })));
}

#[test]
fn a_document_of_an_episode_is_dropped_with_it() {
    let Run { attach, .. } = &run();
    let [memory, policy] = [Role::Memory, Role::Policy].map(|role| bus(attach, role));
    let mut store = DocumentStore::new(&policy).unwrap();
    let mut publisher = DocumentPublisher::new(&memory).unwrap();
    let mut publish =
        |episode| publisher.publish(episode, &Content::Trajectories(Vec::new())).unwrap();
    store.begin(1, 8);
    store.begin(2, 4);
    // The ids of a lane's episodes have no order, and documents of the one after the next arrive early.
    let ids = [None, Some((1, 8)), Some((1, 6)), Some((1, 9)), Some((2, 4))].map(&mut publish);
    let there = |store: &mut DocumentStore| ids.map(|id| store.get(id).unwrap().is_some());
    assert_eq!(there(&mut store), [true; 5]);
    store.begin(1, 6);
    assert_eq!(there(&mut store), [true, false, true, true, true]);
    store.begin(2, 7);
    assert_eq!(there(&mut store), [true, false, true, true, false]);
    store.begin(1, 9);
    assert_eq!(there(&mut store), [true, false, false, true, false]);
    let late = publish(Some((1, 8)));
    assert!(store.get(late).unwrap().is_none());
    assert_eq!(store.len(), 2);
}

#[test]
fn an_invalid_trajectory_is_reported_once_and_dropped() {
    let Run { attach, .. } = &run();
    let [memory, policy] = [Role::Memory, Role::Policy].map(|role| bus(attach, role));
    let mut store = DocumentStore::new(&policy).unwrap();
    let mut publisher = DocumentPublisher::new(&memory).unwrap();
    for (steps, what) in [
        (vec![step(0, 1, 99)], "99"),
        (vec![step(1, 1, NO_ACTION), step(0, 1, NO_ACTION)], "a mixture of trajectories"),
    ] {
        let id = publisher.publish(None, &Content::Trajectories(steps)).unwrap();
        let error = store.get(id).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
        assert!(store.get(id).unwrap().is_none());
    }
}
