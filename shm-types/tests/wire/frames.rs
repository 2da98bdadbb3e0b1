//! Frames: written once, read by all consumers, unchanged while pinned, and memory near the budget.

use std::collections::HashSet;
use std::sync::Arc;
use std::thread;

use shm_types::message::{Eviction, FrameId, Role};
use shm_types::{Attach, Bus, Frame, FrameError, FramePublisher, FrameSize, FrameStore, Sender};

use crate::common::{Run, bus, run, shared_memory};

/// A simulator and both consumers in one process.
struct Store {
    publisher: FramePublisher,
    evictions: Sender<Eviction>,
    consumers: [FrameStore; 2],
    /// Kept for the ports above.
    _buses: [Bus; 3],
}

fn store(attach: &Attach) -> Store {
    let [sim, memory, policy] = [Role::Sim, Role::Memory, Role::Policy].map(|r| bus(attach, r));
    let consumers = [&memory, &policy].map(|bus| FrameStore::new(bus).unwrap());
    let (publisher, evictions) = (FramePublisher::new(&sim).unwrap(), sim.sender().unwrap());
    Store { publisher, evictions, consumers, _buses: [sim, memory, policy] }
}

impl Store {
    /// Publishes a frame full of `value`; returns its id and where it lies.
    fn publish(&mut self, value: u8) -> (FrameId, usize) {
        let mut slot = self.publisher.loan().unwrap();
        let address = slot.as_mut_ptr() as usize;
        slot.pixels_mut().fill(value);
        (self.publisher.publish(slot, [value; 16]).unwrap(), address)
    }

    fn evict(&self, frame: FrameId) {
        self.evictions.send(&Eviction { frame }).unwrap();
    }
}

fn is_full_of(frame: &Frame, value: u8) -> bool {
    frame.content_hash() == [value; 16] && frame.pixels().iter().all(|&byte| byte == value)
}

#[test]
fn every_consumer_reads_the_same_frame() {
    // 64 x 65 ends in the middle of a page.
    for frame in [FrameSize::DEFAULT, FrameSize { width: 64, height: 65 }] {
        let Run { attach, .. } = &run();
        let mut store = store(&Attach { frame, ..attach.clone() });
        let (first, address) = store.publish(1);
        let (second, _) = store.publish(2);
        assert_eq!(address % 4096, 0);
        assert_ne!(first, second);
        for consumer in &mut store.consumers {
            let seen = consumer.get(second).unwrap().unwrap();
            assert_eq!((seen.id(), seen.size()), (second, frame));
            assert_eq!(seen.pixels().len(), frame.bytes());
            assert!(is_full_of(seen, 2));
            assert!(is_full_of(consumer.get(first).unwrap().unwrap(), 1));
            assert!(
                consumer.get(0).unwrap().is_none() && consumer.get(second + 1).unwrap().is_none()
            );
            assert_eq!((consumer.len(), consumer.received()), (2, 2));
        }
    }
}

#[test]
fn a_pinned_frame_does_not_change_and_memory_stays_near_the_budget() {
    let Run { attach, dir, .. } = &run();
    let mut store = store(attach);
    let (held, _) = store.publish(255);
    let held: Vec<Arc<Frame>> =
        store.consumers.iter_mut().map(|c| c.get(held).unwrap().unwrap().clone()).collect();
    store.evict(held[0].id());

    let capacity = attach.frame_capacity as usize;
    let (mut resident, mut addresses) = (Vec::new(), HashSet::new());
    for n in 0..10 * capacity {
        if resident.len() == capacity {
            // The oldest, and now and then one that a consumer has never looked up.
            store.evict(resident.remove(if n % 3 == 0 { capacity - 1 } else { 0 }));
        }
        let value = (n % 251) as u8;
        let (id, address) = store.publish(value);
        resident.push(id);
        addresses.insert(address);
        // Memory looks at every frame, the policy at a few; both apply evictions now and then.
        assert!(is_full_of(store.consumers[0].get(id).unwrap().unwrap(), value));
        if n % 5 == 0 {
            for consumer in &mut store.consumers {
                consumer.apply_evictions().unwrap();
            }
        }
    }
    assert!(held.iter().all(|frame| is_full_of(frame, 255)));
    // What is resident, what is pinned, and the lag of evictions; not the 10 x capacity that were published.
    let alive = capacity + 1 + 5 + 1;
    assert!(addresses.len() <= alive, "{} distinct chunks", addresses.len());
    let chunk = (attach.frame.pages() + 1) * 4096;
    let (bytes, _) = shared_memory(&dir.prefix());
    let messages = 4 << 20;
    assert!(bytes <= (alive * chunk + messages) as u64, "{bytes} bytes for {alive} frames");
    assert!(bytes <= attach.shared_memory_bytes());

    for id in resident {
        store.evict(id);
    }
    for consumer in &mut store.consumers {
        consumer.apply_evictions().unwrap();
        assert_eq!(consumer.len(), 0);
    }
}

#[test]
fn a_consumer_that_keeps_frames_is_named_and_memory_stays_bounded() {
    let Run { attach, .. } = &run();
    let mut store = store(attach);
    let ids: Vec<FrameId> = (0..attach.frame_chunks()).map(|n| store.publish(n as u8).0).collect();
    for &id in &ids {
        store.evict(id);
    }
    store.consumers[0].apply_evictions().unwrap();
    let error = store.publisher.loan().unwrap_err();
    assert!(matches!(error, FrameError::NoChunk { chunks } if chunks == attach.frame_chunks()));
    assert_eq!(store.consumers[1].apply_evictions().unwrap(), ids.len());
    store.publish(1);
}

#[test]
fn slots_are_few_and_a_dropped_one_is_free_again() {
    let Run { attach, .. } = &run();
    let store = store(attach);
    let most = shm_types::attach::MAX_LOANED_FRAMES as usize;
    for _ in 0..2 {
        let slots: Vec<_> = (0..most).map(|_| store.publisher.loan().unwrap()).collect();
        assert!(matches!(store.publisher.loan(), Err(FrameError::TooManySlots)));
        assert_eq!(slots.len(), most);
    }
}

#[test]
fn pixels_are_read_on_other_threads_after_the_eviction() {
    let Run { attach, .. } = &run();
    let mut store = store(attach);
    let (id, _) = store.publish(9);
    let frame = store.consumers[0].get(id).unwrap().unwrap().clone();
    store.evict(id);
    store.consumers.iter_mut().for_each(|c| assert_eq!(c.apply_evictions().unwrap(), 1));
    let readers: Vec<_> = (0..2)
        .map(|_| {
            let frame = frame.clone();
            thread::spawn(move || is_full_of(&frame, 9))
        })
        .collect();
    drop(frame);
    assert!(readers.into_iter().all(|reader| reader.join().unwrap()));
}

#[test]
fn an_invalid_frame_is_refused_once() {
    let Run { attach, .. } = &run();
    let memory = bus(attach, Role::Memory);
    let policy = bus(attach, Role::Policy);
    let mut consumer = FrameStore::new(&memory).unwrap();
    let _other = FrameStore::new(&policy).unwrap();
    let simulator = |attach: &Attach| {
        let mut publisher = FramePublisher::new(&bus(attach, Role::Sim)).unwrap();
        let slot = publisher.loan().unwrap();
        let id = publisher.publish(slot, [0; 16]).unwrap();
        (publisher, id)
    };

    let (kept, id) = simulator(attach);
    assert!(consumer.get(id).unwrap().is_some());
    drop(kept);
    // A simulator that starts again within a generation would use the same ids again.
    let (kept, id) = simulator(attach);
    assert!(matches!(consumer.get(id + 1), Err(FrameError::Id { id: again }) if again == id));
    assert!(consumer.get(id + 1).unwrap().is_none());
    drop(kept);

    let frame = FrameSize { width: 128, height: 64 };
    let (_kept, id) = simulator(&Attach { frame, ..attach.clone() });
    let error = consumer.get(id + 1).unwrap_err().to_string();
    assert!(error.ends_with("is 128 x 64 in 8 pages instead of 64 x 64 in 4"), "{error}");
    assert!(consumer.get(id + 1).unwrap().is_none());
}

#[test]
fn only_the_simulator_publishes_and_only_consumers_receive() {
    let Run { attach, .. } = &run();
    assert!(FramePublisher::new(&bus(attach, Role::Memory)).is_err());
    assert!(FrameStore::new(&bus(attach, Role::Orchestrator)).is_err());
}
