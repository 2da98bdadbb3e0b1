//! The lanes: which episode each runs, where its agent stands, and how commands change that.

use domain::UnknownCode;
use domain::{Action, Feedback, Pose};
use shm_types::message::{StepCommand, StepKind};
use warehouse::step;

use crate::worlds::{WorldParts, Worlds};

/// The outcome of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stepped {
    /// The lane.
    pub lane: usize,
    /// World of its episode.
    pub world: WorldParts,
    /// The agent's pose.
    pub pose: Pose,
    /// The response to the action.
    pub feedback: Feedback,
    /// Whether an episode has begun.
    pub begins: bool,
    /// Whether the episode has ended.
    pub ends: bool,
}

#[derive(Debug, Clone, Copy)]
struct SimulatedEpisode {
    episode: u64,
    step: u32,
    world: WorldParts,
    pose: Pose,
}

/// All lanes of a run, and the worlds that their episodes are in.
#[derive(Debug)]
pub struct SimulatedLanes {
    worlds: Worlds,
    lanes: Vec<Option<SimulatedEpisode>>,
}

impl SimulatedLanes {
    /// `lanes` idle lanes in `worlds`.
    pub fn new(worlds: Worlds, lanes: usize) -> Self {
        Self { worlds, lanes: vec![None; lanes] }
    }

    /// The worlds.
    pub fn worlds(&self) -> &Worlds {
        &self.worlds
    }

    /// World variant `number`, if an agent can stand at `pose` in it.
    ///
    /// # Errors
    /// When there is no such variant, or no agent can stand there.
    pub fn standing(&self, number: u32, pose: Pose) -> Result<WorldParts, String> {
        let world = self.worlds.variant(number).ok_or_else(|| {
            format!("variant {number} is not one of {}", self.worlds.variant_count())
        })?;
        if !self.worlds.layout_of(world).is_free(pose.cell)
            || self.worlds.closed(world).is_closed(pose.cell)
        {
            return Err(format!("an agent cannot stand at {pose}"));
        }
        Ok(world)
    }

    /// Executes a command.
    ///
    /// # Errors
    /// What is wrong, if the command is invalid or out of order. The lane is unchanged then.
    pub fn apply(&mut self, command: &StepCommand) -> Result<Stepped, String> {
        let &StepCommand { lane, episode, step, .. } = command;
        self.try_apply(command).map_err(|problem| {
            format!("command for lane {lane}, episode {episode}, step {step}: {problem}")
        })
    }

    fn try_apply(&mut self, command: &StepCommand) -> Result<Stepped, String> {
        let (lane, count) = (command.lane as usize, self.lanes.len());
        let now = *self.lanes.get(lane).ok_or_else(|| format!("there are {count} lanes"))?;
        let text = |unknown: UnknownCode| unknown.to_string();
        let kind = StepKind::try_from(command.kind).map_err(text)?;
        let (next, feedback) = match kind {
            StepKind::Reset => (self.reset(command, now)?, Feedback::Start),
            StepKind::Act => {
                let action = Action::try_from(command.action).map_err(text)?;
                let now = following(command, now)?;
                let closed = self.worlds.closed(now.world);
                let layout = self.worlds.layout_of(now.world);
                let (pose, feedback) = step(layout, closed, now.pose, action);
                (SimulatedEpisode { pose, step: command.step, ..now }, feedback)
            }
            StepKind::Stay => {
                let now = following(command, now)?;
                (SimulatedEpisode { step: command.step, ..now }, Feedback::NotUnderstood)
            }
        };
        let ends = command.last != 0;
        self.lanes[lane] = (!ends).then_some(next);
        let SimulatedEpisode { world, pose, .. } = next;
        Ok(Stepped { lane, world, pose, feedback, begins: kind == StepKind::Reset, ends })
    }

    fn reset(
        &self,
        command: &StepCommand,
        now: Option<SimulatedEpisode>,
    ) -> Result<SimulatedEpisode, String> {
        let &StepCommand { episode, step, variant, .. } = command;
        let pose = Pose::try_from(command.start).map_err(|unknown| unknown.to_string())?;
        let world = self.standing(variant, pose)?;
        if step != 0 {
            return Err(out_of_order(now));
        }
        Ok(SimulatedEpisode { episode, step, world, pose })
    }
}

/// The lane's episode, if `command` is its next one.
fn following(
    command: &StepCommand,
    now: Option<SimulatedEpisode>,
) -> Result<SimulatedEpisode, String> {
    now.filter(|now| {
        now.episode == command.episode && now.step.checked_add(1) == Some(command.step)
    })
    .ok_or_else(|| out_of_order(now))
}

fn out_of_order(now: Option<SimulatedEpisode>) -> String {
    match now {
        None => "the lane is in no episode".to_owned(),
        Some(SimulatedEpisode { episode, step, .. }) => {
            format!("the lane is in episode {episode} after step {step}")
        }
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use domain::Heading;
    use proptest::prelude::*;
    use shm_types::message::{NO_ACTION, WirePose};
    use warehouse::{CaseSet, Warehouse};

    use super::*;

    fn lanes() -> SimulatedLanes {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        SimulatedLanes::new(Worlds::new(&warehouse, &cases, Vec::new()), 2)
    }

    fn start(lanes: &SimulatedLanes) -> Pose {
        Pose { cell: lanes.worlds.layout().free_cells().next().unwrap(), heading: Heading::N }
    }

    fn reset(lanes: &SimulatedLanes, lane: u32, episode: u64) -> StepCommand {
        StepCommand {
            lane,
            episode,
            start: WirePose::from(start(lanes)),
            kind: StepKind::Reset as u8,
            action: NO_ACTION,
            ..Zeroable::zeroed()
        }
    }

    fn act(lane: u32, episode: u64, step: u32, action: Action) -> StepCommand {
        let (kind, action) = (StepKind::Act as u8, action as u8);
        StepCommand { lane, episode, step, kind, action, ..Zeroable::zeroed() }
    }

    #[test]
    fn an_episode_runs_by_the_dynamics_and_ends() {
        let mut lanes = lanes();
        let from = start(&lanes);
        let begun = lanes.apply(&reset(&lanes, 1, 7)).unwrap();
        assert_eq!((begun.pose, begun.feedback, begun.begins), (from, Feedback::Start, true));
        let turned = lanes.apply(&act(1, 7, 1, Action::TurnLeft)).unwrap();
        assert_eq!(turned.pose, Pose { heading: Heading::W, ..from });
        assert_eq!((turned.feedback, turned.begins, turned.ends), (Feedback::Turned, false, false));
        let stay =
            StepCommand { kind: StepKind::Stay as u8, last: 1, ..act(1, 7, 2, Action::Forward) };
        let stayed = lanes.apply(&stay).unwrap();
        assert_eq!((stayed.pose, stayed.feedback), (turned.pose, Feedback::NotUnderstood));
        assert!(stayed.ends);
        let error = lanes.apply(&act(1, 7, 3, Action::Forward)).unwrap_err();
        assert_eq!(error, "command for lane 1, episode 7, step 3: the lane is in no episode");
    }

    #[test]
    fn invalid_commands_are_reported_and_change_nothing() {
        let mut lanes = lanes();
        let good = reset(&lanes, 0, 7);
        lanes.apply(&good).unwrap();
        let rack = WirePose([0xff, 0, 0, 0]);
        for (command, said) in [
            (StepCommand { lane: 2, ..good }, "there are 2 lanes"),
            (StepCommand { kind: 9, ..good }, "9 is not a step kind"),
            (StepCommand { variant: 999, ..good }, "variant 999 is not one of 101"),
            (StepCommand { start: rack, ..good }, "an agent cannot stand at 255,0,N"),
            (StepCommand { start: WirePose([0, 0, 4, 0]), ..good }, "4 is not a heading"),
            (StepCommand { step: 1, ..good }, "the lane is in episode 7 after step 0"),
            (StepCommand { action: 7, ..act(0, 7, 1, Action::Left) }, "7 is not an action"),
            (act(0, 8, 1, Action::Left), "the lane is in episode 7 after step 0"),
            (act(0, 7, 2, Action::Left), "the lane is in episode 7 after step 0"),
            (act(1, 7, 1, Action::Left), "the lane is in no episode"),
        ] {
            let error = lanes.apply(&command).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
        assert!(lanes.apply(&act(0, 7, 1, Action::TurnLeft)).is_ok());
    }

    proptest! {
        #[test]
        fn no_command_panics_and_an_agent_stands_on_free_floor(
            commands in proptest::collection::vec((0..3_u32, 0..2_u64, 0..4_u32, 0..3_u32,
                any::<[u8; 4]>(), 0..4_u8, 0..9_u8, 0..2_u8), 0..64)
        ) {
            let mut lanes = lanes();
            for (lane, episode, step, variant, start, kind, action, last) in commands {
                let [x, y, heading, zero] = start;
                let start = WirePose([x % 17, y % 31, heading % 5, zero]);
                let command = StepCommand {
                    lane, episode, step, variant, start, kind, action, last, ..Zeroable::zeroed()
                };
                if let Ok(stepped) = lanes.apply(&command) {
                    let closed = lanes.worlds.closed(stepped.world);
                    prop_assert!(lanes.worlds.layout().is_free(stepped.pose.cell));
                    prop_assert!(!closed.is_closed(stepped.pose.cell));
                }
            }
        }
    }
}
