//! Demonstration views that the simulator keeps resident for this process.
//!
//! A view is held once, however many lanes need it, and let go when the last of them is done. What is
//! held always fits into the room this process was given: lanes are admitted whole, so they cannot block
//! each other with half of their views each.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use domain::Pose;
use shm_types::message::{FrameId, NO_FRAME, ViewRequest, ViewRequestKind};

use crate::embedding::ContentHash;

/// A view that is resident; `P` is what gives its pixels.
#[derive(Debug, Clone)]
pub(crate) struct Resident<P> {
    pub(crate) frame: FrameId,
    pub(crate) content: ContentHash,
    pub(crate) picture: P,
}

#[derive(Debug)]
struct Held<P> {
    /// Lanes that need it. 0 only while it was asked for and is no longer wanted.
    users: u32,
    /// Whether one of them compares views.
    embedded: bool,
    resident: Option<Resident<P>>,
}

/// What became of a view that arrived.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Arrival {
    /// A lane needs it.
    Needed {
        /// Its embedding, too.
        embedded: bool,
    },
    /// It is no longer needed and was let go again.
    Dismissed,
    /// Nobody had asked for it.
    Unexpected,
}

/// The held views, by pose.
#[derive(Debug)]
pub(crate) struct HeldViews<P> {
    room: usize,
    views: HashMap<Pose, Held<P>>,
    requests: Vec<ViewRequest>,
}

impl<P> HeldViews<P> {
    /// For at most `room` views.
    pub(crate) fn new(room: usize) -> Self {
        Self { room, views: HashMap::new(), requests: Vec::new() }
    }

    /// How many views may be held.
    pub(crate) fn room(&self) -> usize {
        self.room
    }

    /// How many are held.
    pub(crate) fn len(&self) -> usize {
        self.views.len()
    }

    /// Holds all of `poses`, each of which is named once, or none of them. Says whether there was room.
    /// `embedded`: their embeddings are needed, too.
    pub(crate) fn try_hold(&mut self, poses: &[Pose], embedded: bool) -> bool {
        let missing = poses.iter().filter(|pose| !self.views.contains_key(pose)).count();
        if self.views.len() + missing > self.room {
            return false;
        }
        for &pose in poses {
            match self.views.entry(pose) {
                Entry::Occupied(entry) => {
                    let held = entry.into_mut();
                    held.users += 1;
                    held.embedded |= embedded;
                }
                Entry::Vacant(entry) => {
                    entry.insert(Held { users: 1, embedded, resident: None });
                    self.requests.push(request(ViewRequestKind::Pin, NO_FRAME, pose));
                }
            }
        }
        true
    }

    /// Lets go of what [`Self::try_hold`] held for one lane.
    pub(crate) fn release(&mut self, poses: &[Pose]) {
        for &pose in poses {
            let Some(held) = self.views.get_mut(&pose) else { continue };
            held.users = held.users.saturating_sub(1);
            // One that has not arrived yet is let go when it does: only then its frame has a name.
            if let (0, Some(resident)) = (held.users, &held.resident) {
                self.requests.push(request(ViewRequestKind::Release, resident.frame, pose));
                self.views.remove(&pose);
            }
        }
    }

    /// A view is resident now.
    pub(crate) fn arrived(&mut self, pose: Pose, resident: Resident<P>) -> Arrival {
        let Some(held) = self.views.get_mut(&pose).filter(|held| held.resident.is_none()) else {
            return Arrival::Unexpected;
        };
        if held.users == 0 {
            self.requests.push(request(ViewRequestKind::Release, resident.frame, pose));
            self.views.remove(&pose);
            return Arrival::Dismissed;
        }
        held.resident = Some(resident);
        Arrival::Needed { embedded: held.embedded }
    }

    /// The view from `pose`, if it is resident.
    pub(crate) fn resident(&self, pose: Pose) -> Option<&Resident<P>> {
        self.views.get(&pose)?.resident.as_ref()
    }

    /// The requests that have come up since the last call.
    pub(crate) fn take_requests(&mut self) -> Vec<ViewRequest> {
        std::mem::take(&mut self.requests)
    }
}

fn request(kind: ViewRequestKind, frame: FrameId, pose: Pose) -> ViewRequest {
    ViewRequest { frame, pose: pose.into(), kind: kind as u8, reserved: [0; 3] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use domain::Heading;

    const HOLD: u8 = ViewRequestKind::Pin as u8;
    const RELEASE: u8 = ViewRequestKind::Release as u8;

    fn poses(cells: impl IntoIterator<Item = u8>) -> Vec<Pose> {
        cells.into_iter().map(|x| Pose::new(x, 0, Heading::N)).collect()
    }

    /// (kind, column of the pose) of each new request.
    fn requests(views: &mut HeldViews<()>) -> Vec<(u8, u8)> {
        views.take_requests().iter().map(|request| (request.kind, request.pose.0[0])).collect()
    }

    fn arrive(views: &mut HeldViews<()>, cells: impl IntoIterator<Item = u8>) {
        for pose in poses(cells) {
            let frame = 100 + u64::from(pose.cell.x);
            let resident = Resident { frame, content: [pose.cell.x; 16], picture: () };
            assert_eq!(views.arrived(pose, resident), Arrival::Needed { embedded: true });
        }
    }

    #[test]
    fn a_view_is_asked_for_once_and_let_go_by_its_last_user() {
        let mut views = HeldViews::new(10);
        assert!(views.try_hold(&poses(0..3), true) && views.try_hold(&poses(1..4), true));
        assert_eq!(requests(&mut views), [(HOLD, 0), (HOLD, 1), (HOLD, 2), (HOLD, 3)]);
        arrive(&mut views, 0..4);
        views.release(&poses(0..3));
        assert_eq!(requests(&mut views), [(RELEASE, 0)]);
        assert!(views.resident(poses([1])[0]).is_some() && views.resident(poses([0])[0]).is_none());
        views.release(&poses(1..4));
        assert_eq!(requests(&mut views), [(RELEASE, 1), (RELEASE, 2), (RELEASE, 3)]);
        assert!(views.views.is_empty());
    }

    #[test]
    fn a_view_is_to_be_embedded_when_one_of_its_users_compares() {
        let mut views = HeldViews::new(10);
        assert!(views.try_hold(&poses(0..3), false) && views.try_hold(&poses(2..4), true));
        for (column, expected) in [(0, false), (1, false), (2, true), (3, true)] {
            let resident = Resident { frame: 1, content: [0; 16], picture: () };
            let arrival = views.arrived(poses([column])[0], resident);
            assert_eq!(arrival, Arrival::Needed { embedded: expected }, "column {column}");
        }
    }

    #[test]
    fn a_lane_gets_all_its_views_or_none() {
        let mut views = HeldViews::new(4);
        assert!(views.try_hold(&poses(0..3), true));
        assert!(!views.try_hold(&poses(2..5), true));
        assert!(views.try_hold(&poses(2..4), true));
        assert_eq!(requests(&mut views).len(), 4);
    }

    #[test]
    fn a_view_that_comes_too_late_is_let_go_and_one_wanted_again_is_kept() {
        let mut views = HeldViews::new(4);
        assert!(views.try_hold(&poses(0..2), true));
        views.release(&poses(0..2));
        assert!(views.try_hold(&poses([1]), true));
        assert_eq!(requests(&mut views), [(HOLD, 0), (HOLD, 1)]);
        let resident = Resident { frame: 7, content: [0; 16], picture: () };
        assert_eq!(views.arrived(poses([0])[0], resident.clone()), Arrival::Dismissed);
        assert_eq!(views.take_requests()[0].frame, 7);
        arrive(&mut views, [1]);
        assert_eq!(views.arrived(poses([1])[0], resident.clone()), Arrival::Unexpected);
        assert_eq!(views.arrived(poses([9])[0], resident), Arrival::Unexpected);
        assert!(requests(&mut views).is_empty());
    }
}
