//! The lanes: which episode each runs, where its agent stands, and how commands change that.

use std::collections::HashMap;

use domain::UnknownCode;
use domain::{Action, Feedback, Pose};
use shm_types::message::{StepCommand, StepKind};
use warehouse::{CaseSet, Layout, Variant, Warehouse, step};

/// The outcome of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stepped {
    /// The lane.
    pub lane: usize,
    /// World variant of its episode.
    pub variant: u32,
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
struct LaneEpisode {
    episode: u64,
    step: u32,
    variant: u32,
    pose: Pose,
}

/// All lanes of a run, and the world variants that their episodes are in.
#[derive(Debug)]
pub struct Lanes {
    layout: Layout,
    /// By variant number: the unchanged world, then the world of each case.
    variants: Vec<Variant>,
    /// By variant number: the first variant that closes the same cells.
    same_as: Vec<u32>,
    lanes: Vec<Option<LaneEpisode>>,
}

impl Lanes {
    /// `lanes` idle lanes in the world of `warehouse` and `cases`.
    pub fn new(warehouse: &Warehouse, cases: &CaseSet, lanes: usize) -> Self {
        let closed =
            cases.cases.iter().map(|case| Variant::closing(case.barricade.iter().copied()));
        let variants: Vec<Variant> = std::iter::once(Variant::UNCHANGED).chain(closed).collect();
        let mut first: HashMap<&Variant, u32> = HashMap::new();
        let same_as = (0..).zip(&variants).map(|(n, v)| *first.entry(v).or_insert(n)).collect();
        Self { layout: warehouse.layout.clone(), variants, same_as, lanes: vec![None; lanes] }
    }

    /// The floor plan.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// World variant `number`.
    ///
    /// # Panics
    /// When there is no such variant.
    pub fn variant(&self, number: u32) -> &Variant {
        &self.variants[number as usize]
    }

    /// The first variant that closes the same cells as variant `number`.
    ///
    /// # Panics
    /// When there is no such variant.
    pub fn first_same(&self, number: u32) -> u32 {
        self.same_as[number as usize]
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
                let variant = &self.variants[now.variant as usize];
                let (pose, feedback) = step(&self.layout, variant, now.pose, action);
                (LaneEpisode { pose, step: command.step, ..now }, feedback)
            }
            StepKind::Stay => {
                let now = following(command, now)?;
                (LaneEpisode { step: command.step, ..now }, Feedback::NotUnderstood)
            }
        };
        let ends = command.last != 0;
        self.lanes[lane] = (!ends).then_some(next);
        let LaneEpisode { variant, pose, .. } = next;
        Ok(Stepped { lane, variant, pose, feedback, begins: kind == StepKind::Reset, ends })
    }

    fn reset(
        &self,
        command: &StepCommand,
        now: Option<LaneEpisode>,
    ) -> Result<LaneEpisode, String> {
        let &StepCommand { episode, step, variant: number, .. } = command;
        let pose = Pose::try_from(command.start).map_err(|unknown| unknown.to_string())?;
        let variant = self
            .variants
            .get(number as usize)
            .ok_or_else(|| format!("variant {number} is not one of {}", self.variants.len()))?;
        if !self.layout.is_free(pose.cell) || variant.is_closed(pose.cell) {
            return Err(format!("an agent cannot stand at {pose}"));
        }
        if step != 0 {
            return Err(out_of_order(now));
        }
        Ok(LaneEpisode { episode, step, variant: number, pose })
    }
}

/// The lane's episode, if `command` is its next one.
fn following(command: &StepCommand, now: Option<LaneEpisode>) -> Result<LaneEpisode, String> {
    now.filter(|now| {
        now.episode == command.episode && now.step.checked_add(1) == Some(command.step)
    })
    .ok_or_else(|| out_of_order(now))
}

fn out_of_order(now: Option<LaneEpisode>) -> String {
    match now {
        None => "the lane is in no episode".to_owned(),
        Some(LaneEpisode { episode, step, .. }) => {
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

    use super::*;

    fn lanes() -> Lanes {
        Lanes::new(&Warehouse::shipped(), &CaseSet::shipped(), 2)
    }

    fn start(lanes: &Lanes) -> Pose {
        Pose { cell: lanes.layout.free_cells().next().unwrap(), heading: Heading::N }
    }

    fn reset(lanes: &Lanes, lane: u32, episode: u64) -> StepCommand {
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
    fn every_case_has_its_barricade() {
        let (lanes, cases) = (lanes(), CaseSet::shipped());
        assert_eq!((lanes.variant(0), lanes.first_same(0)), (&Variant::UNCHANGED, 0));
        for (case, number) in cases.cases.iter().zip(1..) {
            assert_eq!(lanes.variant(number).closed(), case.barricade);
            let first = lanes.first_same(number);
            assert!(first > 0 && lanes.variant(first) == lanes.variant(number));
            assert!((0..first).all(|before| lanes.variant(before) != lanes.variant(number)));
        }
        assert_eq!(lanes.variants.len(), cases.cases.len() + 1);
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
                    let variant = lanes.variant(stepped.variant);
                    prop_assert!(lanes.layout.is_free(stepped.pose.cell));
                    prop_assert!(!variant.is_closed(stepped.pose.cell));
                }
            }
        }
    }
}
