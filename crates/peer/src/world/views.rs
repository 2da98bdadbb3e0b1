//! The cache of rendered views: which are resident, which must stay, and which are to be rendered next.
//!
//! A view is identified by the world's name for what it shows and, once rendered, by its frame. It is *pinned* while it is among
//! the last views of a running lane or memory has pinned it. Unpinned views stay as long as there is room and are evicted
//! in the order in which they were unpinned. This is bookkeeping only: nothing here renders, sends or waits.

use std::collections::{BTreeMap, VecDeque};
use std::fmt::Debug;
use std::hash::Hash;

use rustc_hash::FxHashMap;
use shm_types::message::FrameId;

/// More views are in use at once than fit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{needed} views are in use at once and the frame store has room for {capacity}: raise --frame-budget or \
     lower --lanes"
)]
pub(super) struct CacheFull {
    /// Views in use.
    pub(super) needed: usize,
    /// The most views that may be resident.
    pub(super) capacity: usize,
}

/// A frame was released that is not pinned.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("frame {0} is released, but it is not pinned")]
pub(super) struct NotPinned(pub(super) FrameId);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ViewState {
    /// Waits to be rendered.
    Missing,
    /// A worker renders it.
    Rendering,
    Resident(FrameId),
}

#[derive(Debug)]
struct CachedView {
    state: ViewState,
    /// How often it occurs among the last views of lanes.
    lane_pins: u32,
    /// How often memory has pinned it.
    memory_pins: u32,
    /// When it was unpinned last.
    unpinned_at: u64,
}

impl CachedView {
    fn is_pinned(&self) -> bool {
        self.lane_pins + self.memory_pins > 0
    }
}

/// All views that are resident or waiting to be rendered.
#[derive(Debug)]
pub(super) struct ViewCache<V> {
    capacity: usize,
    /// Last views of a lane that stay pinned.
    pinned_per_lane: usize,
    views: FxHashMap<V, CachedView>,
    keys: FxHashMap<FrameId, V>,
    /// Resident views without a pin, by when they were unpinned.
    idle: BTreeMap<u64, V>,
    clock: u64,
    /// The last views of each lane, oldest first.
    lanes: Vec<VecDeque<V>>,
    /// To be rendered: what lanes wait for, then what memory waits for. May hold keys of views that have been dropped.
    urgent: VecDeque<V>,
    later: VecDeque<V>,
}

impl<V: Copy + Eq + Hash + Debug> ViewCache<V> {
    /// A cache of at most `capacity` views. Each of `lanes` lanes pins its last `window` + 2 views: those of the next
    /// request, and one more for the request that is still being answered.
    pub(super) fn new(capacity: usize, lanes: usize, window: usize) -> Self {
        Self {
            capacity,
            pinned_per_lane: window + 2,
            views: FxHashMap::default(),
            keys: FxHashMap::default(),
            idle: BTreeMap::new(),
            clock: 0,
            lanes: vec![VecDeque::new(); lanes],
            urgent: VecDeque::new(),
            later: VecDeque::new(),
        }
    }

    /// Makes `view` the current view of `lane`.
    pub(super) fn show(&mut self, lane: usize, view: V) {
        self.pin(view).lane_pins += 1;
        if self.views[&view].state == ViewState::Missing {
            self.urgent.push_back(view);
        }
        self.lanes[lane].push_back(view);
        if self.lanes[lane].len() > self.pinned_per_lane
            && let Some(oldest) = self.lanes[lane].pop_front()
        {
            self.unpin(oldest, |view| view.lane_pins -= 1);
        }
    }

    /// Unpins all views of `lane`, whose episode has ended.
    pub(super) fn clear_lane(&mut self, lane: usize) {
        for view in std::mem::take(&mut self.lanes[lane]) {
            self.unpin(view, |view| view.lane_pins -= 1);
        }
    }

    /// Pins `view` for memory, which has to release it as often.
    pub(super) fn pin_for_memory(&mut self, view: V) {
        self.pin(view).memory_pins += 1;
        if self.views[&view].state == ViewState::Missing {
            self.later.push_back(view);
        }
    }

    /// Takes back one pin of memory.
    ///
    /// # Errors
    /// When memory has not pinned `frame`.
    pub(super) fn release(&mut self, frame: FrameId) -> Result<(), NotPinned> {
        let view = *self.keys.get(&frame).ok_or(NotPinned(frame))?;
        if self.views[&view].memory_pins == 0 {
            return Err(NotPinned(frame));
        }
        self.unpin(view, |view| view.memory_pins -= 1);
        Ok(())
    }

    /// The frame of `view`, if it is resident.
    pub(super) fn frame(&self, view: V) -> Option<FrameId> {
        match self.views.get(&view)?.state {
            ViewState::Resident(frame) => Some(frame),
            ViewState::Missing | ViewState::Rendering => None,
        }
    }

    /// The number of resident views.
    pub(super) fn resident(&self) -> usize {
        self.keys.len()
    }

    /// The number of views that are needed and not resident yet.
    pub(super) fn missing(&self) -> usize {
        self.views.len() - self.keys.len()
    }

    /// The most views that may be resident.
    pub(super) fn capacity(&self) -> usize {
        self.capacity
    }

    /// The view to be rendered next; those that lanes wait for come first.
    pub(super) fn next_missing(&mut self) -> Option<V> {
        loop {
            let queue = if self.urgent.is_empty() { &mut self.later } else { &mut self.urgent };
            let view = *queue.front()?;
            if self.views.get(&view).is_some_and(|entry| entry.state == ViewState::Missing) {
                return Some(view);
            }
            queue.pop_front();
        }
    }

    /// Marks a missing view as being rendered. It must be [inserted](ViewCache::insert) afterwards.
    pub(super) fn start_rendering(&mut self, view: V) {
        if let Some(entry) = self.views.get_mut(&view) {
            entry.state = ViewState::Rendering;
        }
    }

    /// Makes a view that was being rendered resident as `frame`.
    pub(super) fn insert(&mut self, view: V, frame: FrameId) {
        let Some(entry) = self.views.get_mut(&view) else { return };
        entry.state = ViewState::Resident(frame);
        self.keys.insert(frame, view);
        if !entry.is_pinned() {
            self.unpin(view, |_| {});
        }
    }

    /// Evicts unpinned views until everything fits, views to be rendered included, or until only views are left that are
    /// pinned or being rendered. Returns the evicted frames.
    ///
    /// # Errors
    /// When the pinned views alone do not fit.
    pub(super) fn make_room(&mut self) -> Result<Vec<FrameId>, CacheFull> {
        let mut evicted = Vec::new();
        while self.views.len() > self.capacity {
            let Some((_, view)) = self.idle.pop_first() else {
                // A view that has lost its last pin while it is being rendered can be evicted once it is there.
                let needed = self.views.values().filter(|view| view.is_pinned()).count();
                let Self { capacity, .. } = *self;
                return if needed > capacity {
                    Err(CacheFull { needed, capacity })
                } else {
                    Ok(evicted)
                };
            };
            if let Some(CachedView { state: ViewState::Resident(frame), .. }) =
                self.views.remove(&view)
            {
                self.keys.remove(&frame);
                evicted.push(frame);
            }
        }
        Ok(evicted)
    }

    /// The entry of a view, created if there is none, and no longer idle.
    fn pin(&mut self, view: V) -> &mut CachedView {
        let entry = self.views.entry(view).or_insert(CachedView {
            state: ViewState::Missing,
            lane_pins: 0,
            memory_pins: 0,
            unpinned_at: 0,
        });
        self.idle.remove(&entry.unpinned_at);
        entry
    }

    /// Removes a pin. A view without pins becomes idle if it is resident, and is dropped if it waits to be rendered.
    fn unpin(&mut self, view: V, remove_pin: impl FnOnce(&mut CachedView)) {
        let Some(entry) = self.views.get_mut(&view) else { return };
        remove_pin(entry);
        if entry.is_pinned() {
            return;
        }
        match entry.state {
            ViewState::Resident(_) => {
                self.clock += 1;
                entry.unpinned_at = self.clock;
                self.idle.insert(self.clock, view);
            }
            ViewState::Missing => {
                self.views.remove(&view);
            }
            ViewState::Rendering => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    /// Starts to render up to `most` views.
    fn take_missing(views: &mut ViewCache<u8>, most: usize) -> Vec<u8> {
        let next = || {
            let view = views.next_missing()?;
            views.start_rendering(view);
            Some(view)
        };
        std::iter::from_fn(next).take(most).collect()
    }

    /// "Renders" everything that is missing; frames are numbered from `first`.
    fn render_missing(views: &mut ViewCache<u8>, first: FrameId) {
        for (n, view) in take_missing(views, usize::MAX).into_iter().enumerate() {
            views.insert(view, first + n as FrameId);
        }
    }

    #[test]
    fn views_of_lanes_are_rendered_first_and_once() {
        let mut views = ViewCache::new(9, 2, 6);
        views.pin_for_memory(1);
        views.pin_for_memory(2);
        views.show(0, 3);
        views.show(1, 2);
        assert_eq!(take_missing(&mut views, 2), [3, 2]);
        assert_eq!(take_missing(&mut views, 2), [1]);
        assert!(take_missing(&mut views, 2).is_empty());
    }

    #[test]
    fn a_lane_pins_its_window_and_two_more() {
        let mut views = ViewCache::new(3, 1, 1);
        for n in 1..=4 {
            views.show(0, n);
            let evicted = views.make_room().unwrap();
            assert_eq!(evicted, if n == 4 { vec![1] } else { vec![] });
            render_missing(&mut views, n.into());
        }
        assert_eq!([1, 2, 3, 4].map(|n| views.frame(n)), [None, Some(2), Some(3), Some(4)]);
        views.clear_lane(0);
        views.pin_for_memory(9);
        assert_eq!(views.make_room(), Ok(vec![2]));
    }

    #[test]
    fn a_pinned_view_stays_until_it_is_released_as_often() {
        let mut views = ViewCache::new(1, 1, 0);
        views.pin_for_memory(1);
        views.pin_for_memory(1);
        render_missing(&mut views, 7);
        assert_eq!(views.release(8), Err(NotPinned(8)));
        assert_eq!(views.release(7), Ok(()));
        views.pin_for_memory(2);
        let error = views.make_room().unwrap_err();
        assert_eq!(error, CacheFull { needed: 2, capacity: 1 });
        assert!(error.to_string().contains("raise --frame-budget or lower --lanes"));
        assert_eq!(views.release(7), Ok(()));
        assert_eq!(views.release(7), Err(NotPinned(7)));
        assert_eq!(views.make_room(), Ok(vec![7]));
        assert_eq!(views.frame(1), None);
    }

    #[test]
    fn a_view_without_pins_is_not_rendered() {
        let mut views = ViewCache::new(1, 1, 0);
        views.show(0, 1);
        views.clear_lane(0);
        assert!(take_missing(&mut views, 9).is_empty());
        // A view that is unpinned while it is rendered can be evicted afterwards.
        views.show(0, 2);
        assert_eq!(take_missing(&mut views, 9), [2]);
        views.clear_lane(0);
        views.pin_for_memory(3);
        assert_eq!(views.make_room(), Ok(vec![]));
        views.insert(2, 5);
        assert_eq!(views.make_room(), Ok(vec![5]));
    }

    #[derive(Debug, Clone)]
    enum Op {
        Show(usize, u8),
        ClearLane(usize),
        Pin(u8),
        Release(u8),
        Render(usize),
    }

    fn op() -> impl Strategy<Value = Op> {
        prop_oneof![
            6 => (0..3_usize, 0..20_u8).prop_map(|(lane, n)| Op::Show(lane, n)),
            1 => (0..3_usize).prop_map(Op::ClearLane),
            2 => (0..20_u8).prop_map(Op::Pin),
            2 => (0..20_u8).prop_map(Op::Release),
            3 => (1..4_usize).prop_map(Op::Render),
        ]
    }

    proptest! {
        /// Compares with a model that recounts everything from scratch.
        #[test]
        fn the_longest_idle_views_are_evicted_and_no_more_than_needed(
            capacity in 1..20_usize, window in 0..3_usize, ops in proptest::collection::vec(op(), 0..200)
        ) {
            let mut views = ViewCache::new(capacity, 3, window);
            let mut lanes = [const { Vec::<u8>::new() }; 3];
            let mut holds = [0_u32; 20];
            let mut frames = [None::<FrameId>; 20];
            let mut idle = Vec::<u8>::new();
            let mut next = 0;
            for op in ops {
                let before = pinned(&lanes, &holds);
                match op {
                    Op::Show(lane, n) => {
                        views.show(lane, n);
                        lanes[lane].push(n);
                        if lanes[lane].len() > window + 2 {
                            lanes[lane].remove(0);
                        }
                    }
                    Op::ClearLane(lane) => {
                        views.clear_lane(lane);
                        // Unpinned oldest first; a view that occurs twice is unpinned with the last.
                        while !lanes[lane].is_empty() {
                            let n = lanes[lane].remove(0);
                            if !pinned(&lanes, &holds).contains(&n) && frames[usize::from(n)].is_some() {
                                idle.push(n);
                            }
                        }
                    }
                    Op::Pin(n) => {
                        views.pin_for_memory(n);
                        holds[usize::from(n)] += 1;
                    }
                    Op::Release(n) => {
                        let Some(frame) = frames[usize::from(n)] else { continue };
                        let held = holds[usize::from(n)] > 0;
                        prop_assert_eq!(views.release(frame).is_ok(), held);
                        holds[usize::from(n)] -= u32::from(held);
                    }
                    Op::Render(most) => {
                        for taken in take_missing(&mut views, most) {
                            let n = usize::from(taken);
                            prop_assert!(frames[n].is_none());
                            next += 1;
                            frames[n] = Some(next);
                            views.insert(taken, next);
                        }
                    }
                }
                let after = pinned(&lanes, &holds);
                idle.retain(|n| !after.contains(n));
                for &n in before.difference(&after) {
                    if frames[usize::from(n)].is_some() && !idle.contains(&n) {
                        idle.push(n);
                    }
                }
                match views.make_room() {
                    Ok(evicted) => {
                        let needed = (after.len() + idle.len()).saturating_sub(capacity);
                        let gone: Vec<u8> = idle.drain(..needed).collect();
                        let expected: Vec<FrameId> =
                            gone.iter().filter_map(|&n| frames[usize::from(n)].take()).collect();
                        prop_assert_eq!(evicted, expected);
                        prop_assert!(after.len() + idle.len() <= capacity);
                    }
                    Err(overfull) => {
                        prop_assert!(after.len() > capacity);
                        prop_assert_eq!(overfull.needed, after.len());
                        // The run ends here.
                        return Ok(());
                    }
                }
                for (n, frame) in frames.iter().enumerate() {
                    prop_assert_eq!(views.frame(n as u8), *frame);
                }
            }
        }
    }

    fn pinned(lanes: &[Vec<u8>; 3], holds: &[u32; 20]) -> BTreeSet<u8> {
        let held = holds.iter().zip(0..).filter(|(holds, _)| **holds > 0).map(|(_, n)| n);
        lanes.iter().flatten().copied().chain(held).collect()
    }
}
