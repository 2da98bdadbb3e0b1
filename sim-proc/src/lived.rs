//! The episodes that memories learn from: what is seen at each of their steps, which a memory may ask for later.

use std::collections::HashMap;
use std::io::ErrorKind;
use std::path::Path;

use anyhow::{Context, Result};
use case_book::{LEARNED_FILE, LearnedEpisode};
use domain::{Action, Pose};
use warehouse::step;

use crate::worlds::{WorldParts, Worlds};

/// The states of episodes that memories learn from, by sequence and position.
#[derive(Debug, Clone, Default)]
pub struct LivedEpisodes {
    episodes: HashMap<(u64, u32), LivedEpisode>,
}

#[derive(Debug, Clone)]
struct LivedEpisode {
    world: WorldParts,
    /// The pose after `t` steps.
    poses: Vec<Pose>,
}

impl LivedEpisodes {
    /// Those that memories have learned from before, in the folder `root` to which processes attach; none if it lists none.
    ///
    /// # Errors
    /// When the list cannot be read, or an episode cannot take place in `worlds`.
    pub fn read(root: &Path, worlds: &Worlds) -> Result<Self> {
        let path = root.join(LEARNED_FILE);
        let text = match durable::input::read_text(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Self::default()),
            text => text.with_context(|| format!("cannot read {}", path.display()))?,
        };
        let listed: Vec<LearnedEpisode> = serde_json::from_str(&text)
            .with_context(|| format!("{} is no list of episodes", path.display()))?;
        let mut lived = Self::default();
        for episode in listed {
            let LearnedEpisode { sequence, position, .. } = episode;
            lived.act_out(&episode, worlds).with_context(|| {
                format!("episode {position} of sequence {sequence} cannot take place in this world")
            })?;
        }
        Ok(lived)
    }

    /// Acts out an episode. `None` if it cannot take place in `worlds`.
    fn act_out(&mut self, episode: &LearnedEpisode, worlds: &Worlds) -> Option<()> {
        let &LearnedEpisode { sequence, position, case, start, variant, ref actions } = episode;
        let world = worlds.variant(variant)?;
        let mut pose = worlds.case(case)?.start(start, variant == 1 + case);
        self.begin((sequence, position), world, pose);
        for action in actions {
            if let Some(action) = *action {
                let action = Action::try_from(action).ok()?;
                (pose, _) = step(worlds.layout_of(world), worlds.closed(world), pose, action);
            }
            self.step((sequence, position), pose);
        }
        Some(())
    }

    /// An episode of a sequence, given by that and its position, begins; in place of an abandoned one.
    pub fn begin(&mut self, of: (u64, u32), world: WorldParts, pose: Pose) {
        self.episodes.insert(of, LivedEpisode { world, poses: vec![pose] });
    }

    /// An episode that has begun takes a step.
    pub fn step(&mut self, of: (u64, u32), pose: Pose) {
        if let Some(episode) = self.episodes.get_mut(&of) {
            episode.poses.push(pose);
        }
    }

    /// The world and the pose in which a step of an episode is seen, if there is such a step.
    pub fn view(&self, of: (u64, u32), step: u32) -> Option<(WorldParts, Pose)> {
        let LivedEpisode { world, poses } = self.episodes.get(&of)?;
        Some((*world, *poses.get(step as usize)?))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use domain::Start;
    use warehouse::{CaseSet, TrajectoryKind, Warehouse};

    use super::*;

    #[test]
    fn an_episode_of_an_earlier_session_is_acted_out_again() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let worlds = Worlds::new(&warehouse, &cases, Vec::new(), &[]);
        let replay = cases.cases[4].replay(&warehouse, TrajectoryKind::Original);
        let taken = cases.cases[4].original.actions.iter();
        let mut actions: Vec<_> = taken.map(|action| Some((*action).into())).collect();
        actions.insert(2, None);
        let learned = LearnedEpisode {
            sequence: 7,
            position: 3,
            case: 4,
            start: Start::Original,
            variant: 0,
            actions,
        };
        let folder = tempfile::tempdir().unwrap();
        let list = |learned: &[&LearnedEpisode]| {
            let path = folder.path().join(LEARNED_FILE);
            fs::write(path, serde_json::to_string(learned).unwrap()).unwrap();
            LivedEpisodes::read(folder.path(), &worlds)
        };
        assert!(LivedEpisodes::read(folder.path(), &worlds).unwrap().episodes.is_empty());
        let lived = list(&[&learned]).unwrap();
        let mut expected = replay.poses.clone();
        expected.insert(3, expected[2]);
        for (step, pose) in (0..).zip(&expected) {
            assert_eq!(lived.view((7, 3), step), Some((WorldParts::UNCHANGED, *pose)));
        }
        assert_eq!(lived.view((7, 3), expected.len() as u32), None);
        assert_eq!((lived.view((7, 2), 0), lived.view((8, 3), 0)), (None, None));
        let nowhere = LearnedEpisode { case: 1000, ..learned };
        let error = format!("{:#}", list(&[&nowhere]).unwrap_err());
        assert!(error.contains("episode 3 of sequence 7 cannot take place"), "{error}");
    }
}
