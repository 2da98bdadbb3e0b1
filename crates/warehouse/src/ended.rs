//! The facts of an episode that has ended.

use std::collections::BTreeSet;

use case_book::{EpisodeFacts, looped_at, loops};
use domain::Pose;

use crate::event_recorder::EventRecorder;
use crate::failure::FailedEpisode;
use crate::path::path_fact;
use crate::task::Task;

/// An episode that has ended.
#[derive(Debug)]
pub struct EndedEpisode<'a> {
    /// The task.
    pub task: &'a Task,
    /// The poses, the begin first.
    pub poses: &'a [Pose],
    /// The steps at which sub-goals were completed, in order.
    pub sub_goals: &'a [u32],
    /// Sub-goals of the whole task.
    pub required: u32,
    /// Visits and first sights.
    pub events: EventRecorder,
    /// The steps at which a move was blocked.
    pub blocked_moves: Vec<u32>,
    /// On the case's blocked route: the first step that tried to enter a closed cell.
    pub conflict_at: Option<u32>,
    /// In a stream: the poses of the reference; empty elsewhere.
    pub reference: &'a [Pose],
    /// For an episode that is learned from: the variants in which its actions complete its task.
    pub completes_in: Option<BTreeSet<u32>>,
}

impl EndedEpisode<'_> {
    /// Its facts. `None` for one without poses.
    pub fn facts(self) -> Option<EpisodeFacts> {
        let Self { task, poses, sub_goals, required, events, conflict_at, .. } = self;
        let EventRecorder { visits, first_seen, .. } = events;
        let failed = FailedEpisode {
            task: task.task_type(),
            poses,
            sub_goals,
            required,
            visits: &visits,
            first_seen: &first_seen,
            conflict_at,
        };
        let completed = |step: u32| sub_goals.partition_point(|&met| met <= step);
        let situations: Vec<(usize, Pose)> =
            (0..).zip(poses).map(|(step, pose)| (completed(step), *pose)).collect();
        let is_complete = sub_goals.len() == required as usize;
        let failure = if is_complete { None } else { failed.failure() };
        Some(EpisodeFacts {
            start_pose: *poses.first()?,
            final_pose: *poses.last()?,
            visits,
            first_seen,
            blocked_moves: self.blocked_moves,
            failure,
            looped_at: looped_at(poses),
            loops: Some(loops(&situations)),
            path: path_fact(poses, self.reference),
            completes_in: self.completes_in,
        })
    }
}
