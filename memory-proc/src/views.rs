//! Demonstration views that are pinned in the frame store for this process.
//!
//! A view is pinned once, however many lanes need it, and released by the last of them. Pinned views always fit into the
//! room that this process has. A lane gets all its views or none, so lanes cannot block each other with half of their
//! views each.

use bytemuck::Zeroable;
use std::collections::HashMap;
use std::collections::hash_map::Entry;

use shm_types::message::{FrameId, NO_FRAME, ViewRequest, ViewRequestKind};

use search::ContentHash;

use crate::demonstrations::ViewId;

/// A view in the frame store; `I` is a source of its pixels.
#[derive(Debug, Clone)]
pub(crate) struct PinnedView<I> {
    pub(crate) frame: FrameId,
    pub(crate) content: ContentHash,
    pub(crate) image: I,
}

#[derive(Debug)]
struct PinState<I> {
    /// Lanes that need it. 0 only while it has been requested and is no longer needed.
    users: u32,
    /// Whether one of them matches views.
    embedded: bool,
    resident: Option<PinnedView<I>>,
}

/// What happens to a view that arrives.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Arrival {
    /// A lane needs it.
    Needed {
        /// Whether it has to be embedded.
        embedded: bool,
    },
    /// It is no longer needed and has been released.
    Dismissed,
    /// It was not requested.
    Unexpected,
}

/// The pinned views.
#[derive(Debug)]
pub(crate) struct PinnedViews<I> {
    room: usize,
    views: HashMap<ViewId, PinState<I>>,
    requests: Vec<ViewRequest>,
}

impl<I> PinnedViews<I> {
    /// Room for `room` views.
    pub(crate) fn new(room: usize) -> Self {
        Self { room, views: HashMap::new(), requests: Vec::new() }
    }

    /// Number of views that may be pinned.
    pub(crate) fn room(&self) -> usize {
        self.room
    }

    /// Number of views that are pinned.
    pub(crate) fn len(&self) -> usize {
        self.views.len()
    }

    /// Pins the views of all `view_ids`, each named once, or of none. Returns whether there was room. `embedded`: they have
    /// to be embedded.
    pub(crate) fn try_pin(&mut self, view_ids: &[ViewId], embedded: bool) -> bool {
        let missing = view_ids.iter().filter(|of| !self.views.contains_key(of)).count();
        if self.views.len() + missing > self.room {
            return false;
        }
        for &view_id in view_ids {
            match self.views.entry(view_id) {
                Entry::Occupied(entry) => {
                    let held = entry.into_mut();
                    held.users += 1;
                    held.embedded |= embedded;
                }
                Entry::Vacant(entry) => {
                    entry.insert(PinState { users: 1, embedded, resident: None });
                    self.requests.push(request(ViewRequestKind::Pin, NO_FRAME, view_id));
                }
            }
        }
        true
    }

    /// Releases the views that [`Self::try_pin`] pinned for one lane.
    pub(crate) fn release(&mut self, view_ids: &[ViewId]) {
        for &view_id in view_ids {
            let Some(held) = self.views.get_mut(&view_id) else { continue };
            held.users = held.users.saturating_sub(1);
            // A view that has not arrived is released when it does: until then its frame is unknown.
            if let (0, Some(resident)) = (held.users, &held.resident) {
                self.requests.push(request(ViewRequestKind::Release, resident.frame, view_id));
                self.views.remove(&view_id);
            }
        }
    }

    /// Takes a view that is in the frame store now.
    pub(crate) fn arrived(&mut self, view_id: ViewId, resident: PinnedView<I>) -> Arrival {
        let Some(held) = self.views.get_mut(&view_id).filter(|held| held.resident.is_none()) else {
            return Arrival::Unexpected;
        };
        if held.users == 0 {
            self.requests.push(request(ViewRequestKind::Release, resident.frame, view_id));
            self.views.remove(&view_id);
            return Arrival::Dismissed;
        }
        held.resident = Some(resident);
        Arrival::Needed { embedded: held.embedded }
    }

    /// A view, if it is in the frame store.
    pub(crate) fn get(&self, view_id: ViewId) -> Option<&PinnedView<I>> {
        self.views.get(&view_id)?.resident.as_ref()
    }

    /// The requests that have arisen since the last call.
    pub(crate) fn take_requests(&mut self) -> Vec<ViewRequest> {
        std::mem::take(&mut self.requests)
    }
}

fn request(kind: ViewRequestKind, frame: FrameId, of: ViewId) -> ViewRequest {
    let ViewId { sequence, number, step } = of;
    let kind = kind as u8;
    ViewRequest { frame, sequence, demonstration: number, step, kind, ..Zeroable::zeroed() }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOLD: u8 = ViewRequestKind::Pin as u8;
    const RELEASE: u8 = ViewRequestKind::Release as u8;

    /// The views of these steps of the first demonstration.
    fn steps(steps: impl IntoIterator<Item = u32>) -> Vec<ViewId> {
        let view_id = |step| ViewId { sequence: 0, number: 0, step };
        steps.into_iter().map(view_id).collect()
    }

    /// (kind, step) of each new request.
    fn requests(views: &mut PinnedViews<()>) -> Vec<(u8, u32)> {
        views.take_requests().iter().map(|request| (request.kind, request.step)).collect()
    }

    fn arrive(views: &mut PinnedViews<()>, of: impl IntoIterator<Item = u32>) {
        for view_id in steps(of) {
            let step = view_id.step;
            let frame = 100 + u64::from(step);
            let resident = PinnedView { frame, content: [step as u8; 16], image: () };
            assert_eq!(views.arrived(view_id, resident), Arrival::Needed { embedded: true });
        }
    }

    #[test]
    fn a_view_is_requested_once_and_released_by_its_last_user() {
        let mut views = PinnedViews::new(10);
        assert!(views.try_pin(&steps(0..3), true) && views.try_pin(&steps(1..4), true));
        assert_eq!(requests(&mut views), [(HOLD, 0), (HOLD, 1), (HOLD, 2), (HOLD, 3)]);
        arrive(&mut views, 0..4);
        views.release(&steps(0..3));
        assert_eq!(requests(&mut views), [(RELEASE, 0)]);
        assert!(views.get(steps([1])[0]).is_some() && views.get(steps([0])[0]).is_none());
        views.release(&steps(1..4));
        assert_eq!(requests(&mut views), [(RELEASE, 1), (RELEASE, 2), (RELEASE, 3)]);
        assert!(views.views.is_empty());
    }

    #[test]
    fn a_view_is_embedded_if_one_of_its_users_matches_views() {
        let mut views = PinnedViews::new(10);
        assert!(views.try_pin(&steps(0..3), false) && views.try_pin(&steps(2..4), true));
        for (step, expected) in [(0, false), (1, false), (2, true), (3, true)] {
            let resident = PinnedView { frame: 1, content: [0; 16], image: () };
            let arrival = views.arrived(steps([step])[0], resident);
            assert_eq!(arrival, Arrival::Needed { embedded: expected }, "step {step}");
        }
    }

    #[test]
    fn a_lane_gets_all_its_views_or_none() {
        let mut views = PinnedViews::new(4);
        assert!(views.try_pin(&steps(0..3), true));
        assert!(!views.try_pin(&steps(2..5), true));
        assert!(views.try_pin(&steps(2..4), true));
        assert_eq!(requests(&mut views).len(), 4);
    }

    #[test]
    fn a_late_view_is_released_unless_it_is_needed_again() {
        let mut views = PinnedViews::new(4);
        assert!(views.try_pin(&steps(0..2), true));
        views.release(&steps(0..2));
        assert!(views.try_pin(&steps([1]), true));
        assert_eq!(requests(&mut views), [(HOLD, 0), (HOLD, 1)]);
        let resident = PinnedView { frame: 7, content: [0; 16], image: () };
        assert_eq!(views.arrived(steps([0])[0], resident.clone()), Arrival::Dismissed);
        assert_eq!(views.take_requests()[0].frame, 7);
        arrive(&mut views, [1]);
        assert_eq!(views.arrived(steps([1])[0], resident.clone()), Arrival::Unexpected);
        assert_eq!(views.arrived(steps([9])[0], resident), Arrival::Unexpected);
        assert!(requests(&mut views).is_empty());
    }
}
