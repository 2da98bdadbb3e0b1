//! Which views are resident: what must stay, what may go, what is to be drawn.
//!
//! A view is named by what it shows ([`ViewKey`]) and, once it is drawn, by its frame. It is *pinned* while
//! it is among the last views of a running lane or memory holds it; views that are not pinned stay for as
//! long as there is room and go in the order in which they were let go of. Everything here is bookkeeping:
//! nothing draws, sends or waits.

use std::collections::{BTreeMap, VecDeque};

use domain::Pose;
use rustc_hash::FxHashMap;
use shm_types::message::FrameId;

/// What a frame shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ViewKey {
    /// The world in a variant (as in [`StepCommand`](shm_types::message::StepCommand)) from a pose.
    World {
        /// The variant.
        variant: u32,
        /// The pose.
        pose: Pose,
    },
    /// Uniform grey.
    Blank,
}

/// More views are needed at once than may be resident.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{needed} views are in use at once and the frame store has room for {capacity}: raise --frame-budget or \
     lower --lanes"
)]
pub struct Overfull {
    /// Views in use.
    pub needed: usize,
    /// Views that may be resident.
    pub capacity: usize,
}

/// A release of a frame that is not held.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("frame {0} is released, but it is not held")]
pub struct NotHeld(pub FrameId);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Picture {
    /// In a queue to be drawn.
    Missing,
    /// Handed out to be drawn.
    Drawing,
    Resident(FrameId),
}

#[derive(Debug)]
struct Entry {
    picture: Picture,
    /// How often the view occurs among the last views of lanes.
    shown: u32,
    /// How often memory holds it.
    holds: u32,
    /// When it was let go of, while it is not pinned.
    let_go: u64,
}

impl Entry {
    fn is_pinned(&self) -> bool {
        self.shown + self.holds > 0
    }
}

/// Every view that is resident or about to be.
#[derive(Debug)]
pub struct Views {
    capacity: usize,
    /// Views that a lane keeps.
    kept: usize,
    entries: FxHashMap<ViewKey, Entry>,
    keys: FxHashMap<FrameId, ViewKey>,
    /// Resident and not pinned, by when they were let go of.
    idle: BTreeMap<u64, ViewKey>,
    clock: u64,
    /// The last views of each lane, oldest first.
    lanes: Vec<VecDeque<ViewKey>>,
    /// To be drawn: what lanes wait for, then what memory waits for. May name views that no longer are.
    urgent: VecDeque<ViewKey>,
    later: VecDeque<ViewKey>,
}

impl Views {
    /// Room for `capacity` views; each of `lanes` lanes keeps its last `window` + 2: what the next request
    /// shows, and one more for the request that is still being answered.
    pub fn new(capacity: usize, lanes: usize, window: usize) -> Self {
        Self {
            capacity,
            kept: window + 2,
            entries: FxHashMap::default(),
            keys: FxHashMap::default(),
            idle: BTreeMap::new(),
            clock: 0,
            lanes: vec![VecDeque::new(); lanes],
            urgent: VecDeque::new(),
            later: VecDeque::new(),
        }
    }

    /// `lane` looks at `view` now.
    pub fn show(&mut self, lane: usize, view: ViewKey) {
        self.pin(view).shown += 1;
        if self.entries[&view].picture == Picture::Missing {
            self.urgent.push_back(view);
        }
        self.lanes[lane].push_back(view);
        if self.lanes[lane].len() > self.kept
            && let Some(oldest) = self.lanes[lane].pop_front()
        {
            self.unpin(oldest, |entry| entry.shown -= 1);
        }
    }

    /// The episode in `lane` is over: none of its views is needed any more.
    pub fn forget(&mut self, lane: usize) {
        for view in std::mem::take(&mut self.lanes[lane]) {
            self.unpin(view, |entry| entry.shown -= 1);
        }
    }

    /// Memory wants `view` until it has released it as often as it was held.
    pub fn hold(&mut self, view: ViewKey) {
        self.pin(view).holds += 1;
        if self.entries[&view].picture == Picture::Missing {
            self.later.push_back(view);
        }
    }

    /// Memory no longer wants `frame`.
    ///
    /// # Errors
    /// When it is not held.
    pub fn release(&mut self, frame: FrameId) -> Result<(), NotHeld> {
        let view = *self.keys.get(&frame).ok_or(NotHeld(frame))?;
        if self.entries[&view].holds == 0 {
            return Err(NotHeld(frame));
        }
        self.unpin(view, |entry| entry.holds -= 1);
        Ok(())
    }

    /// The frame that shows `view`, if it is resident.
    pub fn frame(&self, view: ViewKey) -> Option<FrameId> {
        match self.entries.get(&view)?.picture {
            Picture::Resident(frame) => Some(frame),
            Picture::Missing | Picture::Drawing => None,
        }
    }

    /// Views that are resident.
    pub fn resident(&self) -> usize {
        self.keys.len()
    }

    /// Views that are needed and not resident yet.
    pub fn missing(&self) -> usize {
        self.entries.len() - self.keys.len()
    }

    /// Views that may be resident.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Takes up to `most` views that are to be drawn, those first that lanes wait for. Each must be
    /// [filled](Views::fill).
    pub fn take_missing(&mut self, most: usize) -> Vec<ViewKey> {
        let mut taken = Vec::new();
        while taken.len() < most
            && let Some(view) = self.urgent.pop_front().or_else(|| self.later.pop_front())
        {
            if let Some(entry) = self.entries.get_mut(&view)
                && entry.picture == Picture::Missing
            {
                entry.picture = Picture::Drawing;
                taken.push(view);
            }
        }
        taken
    }

    /// `view`, which was taken to be drawn, is resident as `frame`.
    pub fn fill(&mut self, view: ViewKey, frame: FrameId) {
        let Some(entry) = self.entries.get_mut(&view) else { return };
        entry.picture = Picture::Resident(frame);
        self.keys.insert(frame, view);
        if !entry.is_pinned() {
            self.unpin(view, |_| {});
        }
    }

    /// Evicts until everything fits, what is to be drawn included; returns the frames to let go of.
    ///
    /// # Errors
    /// When it does not fit even so.
    pub fn make_room(&mut self) -> Result<Vec<FrameId>, Overfull> {
        let mut evicted = Vec::new();
        while self.entries.len() > self.capacity {
            let Some((_, view)) = self.idle.pop_first() else {
                return Err(Overfull { needed: self.entries.len(), capacity: self.capacity });
            };
            if let Some(Entry { picture: Picture::Resident(frame), .. }) =
                self.entries.remove(&view)
            {
                self.keys.remove(&frame);
                evicted.push(frame);
            }
        }
        Ok(evicted)
    }

    /// The view's entry, made if there is none, and no longer among the idle ones.
    fn pin(&mut self, view: ViewKey) -> &mut Entry {
        let entry = self.entries.entry(view).or_insert(Entry {
            picture: Picture::Missing,
            shown: 0,
            holds: 0,
            let_go: 0,
        });
        self.idle.remove(&entry.let_go);
        entry
    }

    /// Takes a pin off; without any, a resident view becomes idle and one that nobody has begun to draw is
    /// forgotten.
    fn unpin(&mut self, view: ViewKey, take_off: impl FnOnce(&mut Entry)) {
        let Some(entry) = self.entries.get_mut(&view) else { return };
        take_off(entry);
        if entry.is_pinned() {
            return;
        }
        match entry.picture {
            Picture::Resident(_) => {
                self.clock += 1;
                entry.let_go = self.clock;
                self.idle.insert(self.clock, view);
            }
            Picture::Missing => {
                self.entries.remove(&view);
            }
            Picture::Drawing => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use domain::Heading;
    use proptest::prelude::*;

    use super::*;

    fn view(n: u8) -> ViewKey {
        ViewKey::World { variant: 0, pose: Pose::new(n, 0, Heading::N) }
    }

    /// Draws everything that is missing; frames are numbered from `first`.
    fn draw(views: &mut Views, first: FrameId) {
        for (n, view) in views.take_missing(usize::MAX).into_iter().enumerate() {
            views.fill(view, first + n as FrameId);
        }
    }

    #[test]
    fn what_lanes_wait_for_is_drawn_first_and_once() {
        let mut views = Views::new(9, 2, 6);
        views.hold(view(1));
        views.hold(view(2));
        views.show(0, view(3));
        views.show(1, view(2));
        assert_eq!(views.take_missing(2), [view(3), view(2)]);
        assert_eq!(views.take_missing(2), [view(1)]);
        assert_eq!(views.take_missing(2), []);
    }

    #[test]
    fn a_lane_keeps_its_window_and_two_more() {
        let mut views = Views::new(3, 1, 1);
        for n in 1..=4 {
            views.show(0, view(n));
            let evicted = views.make_room().unwrap();
            assert_eq!(evicted, if n == 4 { vec![1] } else { vec![] });
            draw(&mut views, n.into());
        }
        assert_eq!([1, 2, 3, 4].map(|n| views.frame(view(n))), [None, Some(2), Some(3), Some(4)]);
        views.forget(0);
        views.hold(view(9));
        assert_eq!(views.make_room(), Ok(vec![2]));
    }

    #[test]
    fn a_held_view_stays_until_it_is_released_as_often() {
        let mut views = Views::new(1, 1, 0);
        views.hold(view(1));
        views.hold(view(1));
        draw(&mut views, 7);
        assert_eq!(views.release(8), Err(NotHeld(8)));
        assert_eq!(views.release(7), Ok(()));
        views.hold(view(2));
        let error = views.make_room().unwrap_err();
        assert_eq!(error, Overfull { needed: 2, capacity: 1 });
        assert!(error.to_string().contains("raise --frame-budget or lower --lanes"));
        assert_eq!(views.release(7), Ok(()));
        assert_eq!(views.release(7), Err(NotHeld(7)));
        assert_eq!(views.make_room(), Ok(vec![7]));
        assert_eq!(views.frame(view(1)), None);
    }

    #[test]
    fn a_view_that_nobody_waits_for_any_more_is_not_drawn() {
        let mut views = Views::new(1, 1, 0);
        views.show(0, view(1));
        views.forget(0);
        assert_eq!(views.take_missing(9), []);
        // And one that is let go of while it is drawn can be evicted afterwards.
        views.show(0, view(2));
        assert_eq!(views.take_missing(9), [view(2)]);
        views.forget(0);
        views.fill(view(2), 5);
        views.hold(view(3));
        assert_eq!(views.make_room(), Ok(vec![5]));
    }

    #[derive(Debug, Clone)]
    enum Op {
        Show(usize, u8),
        Forget(usize),
        Hold(u8),
        Release(u8),
        Draw(usize),
    }

    fn op() -> impl Strategy<Value = Op> {
        prop_oneof![
            6 => (0..3_usize, 0..20_u8).prop_map(|(lane, n)| Op::Show(lane, n)),
            1 => (0..3_usize).prop_map(Op::Forget),
            2 => (0..20_u8).prop_map(Op::Hold),
            2 => (0..20_u8).prop_map(Op::Release),
            3 => (1..4_usize).prop_map(Op::Draw),
        ]
    }

    proptest! {
        /// Against a model that recounts everything from scratch.
        #[test]
        fn only_idle_views_go_the_longest_idle_first_and_no_more_than_needed(
            capacity in 1..20_usize, window in 0..3_usize, ops in proptest::collection::vec(op(), 0..200)
        ) {
            let mut views = Views::new(capacity, 3, window);
            let mut lanes = [const { Vec::<u8>::new() }; 3];
            let mut holds = [0_u32; 20];
            let mut frames = [None::<FrameId>; 20];
            let mut idle = Vec::<u8>::new();
            let mut next = 0;
            for op in ops {
                let before = pinned(&lanes, &holds);
                match op {
                    Op::Show(lane, n) => {
                        views.show(lane, view(n));
                        lanes[lane].push(n);
                        if lanes[lane].len() > window + 2 {
                            lanes[lane].remove(0);
                        }
                    }
                    Op::Forget(lane) => {
                        views.forget(lane);
                        // Let go of oldest first; a view that is there twice goes with the last.
                        while !lanes[lane].is_empty() {
                            let n = lanes[lane].remove(0);
                            if !pinned(&lanes, &holds).contains(&n) && frames[usize::from(n)].is_some() {
                                idle.push(n);
                            }
                        }
                    }
                    Op::Hold(n) => {
                        views.hold(view(n));
                        holds[usize::from(n)] += 1;
                    }
                    Op::Release(n) => {
                        let Some(frame) = frames[usize::from(n)] else { continue };
                        let held = holds[usize::from(n)] > 0;
                        prop_assert_eq!(views.release(frame).is_ok(), held);
                        holds[usize::from(n)] -= u32::from(held);
                    }
                    Op::Draw(most) => {
                        for drawn in views.take_missing(most) {
                            let ViewKey::World { pose, .. } = drawn else { unreachable!() };
                            let n = usize::from(pose.cell.x);
                            prop_assert!(frames[n].is_none());
                            next += 1;
                            frames[n] = Some(next);
                            views.fill(drawn, next);
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
                    prop_assert_eq!(views.frame(view(n as u8)), *frame);
                }
            }
        }
    }

    fn pinned(lanes: &[Vec<u8>; 3], holds: &[u32; 20]) -> BTreeSet<u8> {
        let held = holds.iter().zip(0..).filter(|(holds, _)| **holds > 0).map(|(_, n)| n);
        lanes.iter().flatten().copied().chain(held).collect()
    }
}
