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

use crate::bank::Viewpoint;

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

/// The pinned views, by viewpoint.
#[derive(Debug)]
pub(crate) struct PinnedViews<I> {
    room: usize,
    views: HashMap<Viewpoint, PinState<I>>,
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

    /// Pins the views of all `viewpoints`, each named once, or of none. Returns whether there was room. `embedded`: they have
    /// to be embedded.
    pub(crate) fn try_pin(&mut self, viewpoints: &[Viewpoint], embedded: bool) -> bool {
        let missing = viewpoints.iter().filter(|of| !self.views.contains_key(of)).count();
        if self.views.len() + missing > self.room {
            return false;
        }
        for &viewpoint in viewpoints {
            match self.views.entry(viewpoint) {
                Entry::Occupied(entry) => {
                    let held = entry.into_mut();
                    held.users += 1;
                    held.embedded |= embedded;
                }
                Entry::Vacant(entry) => {
                    entry.insert(PinState { users: 1, embedded, resident: None });
                    self.requests.push(request(ViewRequestKind::Pin, NO_FRAME, viewpoint));
                }
            }
        }
        true
    }

    /// Releases the views that [`Self::try_pin`] pinned for one lane.
    pub(crate) fn release(&mut self, viewpoints: &[Viewpoint]) {
        for &viewpoint in viewpoints {
            let Some(held) = self.views.get_mut(&viewpoint) else { continue };
            held.users = held.users.saturating_sub(1);
            // A view that has not arrived is released when it does: until then its frame is unknown.
            if let (0, Some(resident)) = (held.users, &held.resident) {
                self.requests.push(request(ViewRequestKind::Release, resident.frame, viewpoint));
                self.views.remove(&viewpoint);
            }
        }
    }

    /// Takes a view that is in the frame store now.
    pub(crate) fn arrived(&mut self, viewpoint: Viewpoint, resident: PinnedView<I>) -> Arrival {
        let Some(held) = self.views.get_mut(&viewpoint).filter(|held| held.resident.is_none())
        else {
            return Arrival::Unexpected;
        };
        if held.users == 0 {
            self.requests.push(request(ViewRequestKind::Release, resident.frame, viewpoint));
            self.views.remove(&viewpoint);
            return Arrival::Dismissed;
        }
        held.resident = Some(resident);
        Arrival::Needed { embedded: held.embedded }
    }

    /// The view from a viewpoint, if it is in the frame store.
    pub(crate) fn get(&self, viewpoint: Viewpoint) -> Option<&PinnedView<I>> {
        self.views.get(&viewpoint)?.resident.as_ref()
    }

    /// The requests that have arisen since the last call.
    pub(crate) fn take_requests(&mut self) -> Vec<ViewRequest> {
        std::mem::take(&mut self.requests)
    }
}

fn request(kind: ViewRequestKind, frame: FrameId, of: Viewpoint) -> ViewRequest {
    let Viewpoint { variant, pose } = of;
    ViewRequest { frame, pose: pose.into(), variant, kind: kind as u8, ..Zeroable::zeroed() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use domain::{Heading, Pose};

    const HOLD: u8 = ViewRequestKind::Pin as u8;
    const RELEASE: u8 = ViewRequestKind::Release as u8;

    fn poses(cells: impl IntoIterator<Item = u8>) -> Vec<Viewpoint> {
        let viewpoint = |x| Viewpoint { variant: 0, pose: Pose::new(x, 0, Heading::N) };
        cells.into_iter().map(viewpoint).collect()
    }

    /// (kind, column of the pose) of each new request.
    fn requests(views: &mut PinnedViews<()>) -> Vec<(u8, u8)> {
        views.take_requests().iter().map(|request| (request.kind, request.pose.0[0])).collect()
    }

    fn arrive(views: &mut PinnedViews<()>, cells: impl IntoIterator<Item = u8>) {
        for viewpoint in poses(cells) {
            let pose = viewpoint.pose;
            let frame = 100 + u64::from(pose.cell.x);
            let resident = PinnedView { frame, content: [pose.cell.x; 16], image: () };
            assert_eq!(views.arrived(viewpoint, resident), Arrival::Needed { embedded: true });
        }
    }

    #[test]
    fn a_view_is_requested_once_and_released_by_its_last_user() {
        let mut views = PinnedViews::new(10);
        assert!(views.try_pin(&poses(0..3), true) && views.try_pin(&poses(1..4), true));
        assert_eq!(requests(&mut views), [(HOLD, 0), (HOLD, 1), (HOLD, 2), (HOLD, 3)]);
        arrive(&mut views, 0..4);
        views.release(&poses(0..3));
        assert_eq!(requests(&mut views), [(RELEASE, 0)]);
        assert!(views.get(poses([1])[0]).is_some() && views.get(poses([0])[0]).is_none());
        views.release(&poses(1..4));
        assert_eq!(requests(&mut views), [(RELEASE, 1), (RELEASE, 2), (RELEASE, 3)]);
        assert!(views.views.is_empty());
    }

    #[test]
    fn a_view_is_embedded_if_one_of_its_users_matches_views() {
        let mut views = PinnedViews::new(10);
        assert!(views.try_pin(&poses(0..3), false) && views.try_pin(&poses(2..4), true));
        for (column, expected) in [(0, false), (1, false), (2, true), (3, true)] {
            let resident = PinnedView { frame: 1, content: [0; 16], image: () };
            let arrival = views.arrived(poses([column])[0], resident);
            assert_eq!(arrival, Arrival::Needed { embedded: expected }, "column {column}");
        }
    }

    #[test]
    fn a_lane_gets_all_its_views_or_none() {
        let mut views = PinnedViews::new(4);
        assert!(views.try_pin(&poses(0..3), true));
        assert!(!views.try_pin(&poses(2..5), true));
        assert!(views.try_pin(&poses(2..4), true));
        assert_eq!(requests(&mut views).len(), 4);
    }

    #[test]
    fn a_late_view_is_released_unless_it_is_needed_again() {
        let mut views = PinnedViews::new(4);
        assert!(views.try_pin(&poses(0..2), true));
        views.release(&poses(0..2));
        assert!(views.try_pin(&poses([1]), true));
        assert_eq!(requests(&mut views), [(HOLD, 0), (HOLD, 1)]);
        let resident = PinnedView { frame: 7, content: [0; 16], image: () };
        assert_eq!(views.arrived(poses([0])[0], resident.clone()), Arrival::Dismissed);
        assert_eq!(views.take_requests()[0].frame, 7);
        arrive(&mut views, [1]);
        assert_eq!(views.arrived(poses([1])[0], resident.clone()), Arrival::Unexpected);
        assert_eq!(views.arrived(poses([9])[0], resident), Arrival::Unexpected);
        assert!(requests(&mut views).is_empty());
    }
}
