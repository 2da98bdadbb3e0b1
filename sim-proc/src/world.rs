//! The lanes: which episode each is in, where its agent stands, and what a command does to it.

use std::collections::HashMap;

use domain::{Action, Feedback, Pose, pose::UnknownCode};
use shm_types::message::{StepCommand, StepKind};
use warehouse::{CaseSet, Layout, Variant, Warehouse, step};

/// A command that cannot be carried out.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("command for lane {lane}, episode {episode}, step {step}: {problem}")]
pub struct BadCommand {
    /// The lane it names.
    pub lane: u32,
    /// The episode it names.
    pub episode: u64,
    /// The step it names.
    pub step: u32,
    /// What is wrong.
    pub problem: Problem,
}

/// What is wrong with a command.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Problem {
    /// There is no such lane.
    #[error("there are {0} lanes")]
    Lane(usize),
    /// There is no such world variant.
    #[error("variant {found} is not one of {variants}")]
    Variant {
        /// The variant it names.
        found: u32,
        /// How many there are.
        variants: usize,
    },
    /// A code means nothing.
    #[error(transparent)]
    Code(#[from] UnknownCode),
    /// An agent cannot stand there.
    #[error("nobody can stand at {0}")]
    Start(Pose),
    /// The lane is not in that episode at that step.
    #[error("the lane is {0}")]
    Place(Place),
}

/// Where a lane is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// In no episode.
    Idle,
    /// In an episode.
    Running {
        /// Its ticket.
        episode: u64,
        /// Steps taken.
        step: u32,
    },
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Idle => write!(f, "in no episode"),
            Self::Running { episode, step } => write!(f, "in episode {episode} after step {step}"),
        }
    }
}

/// What is true after a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stepped {
    /// The lane.
    pub lane: usize,
    /// World variant of its episode.
    pub variant: u32,
    /// Where the agent is.
    pub pose: Pose,
    /// The answer to the action.
    pub feedback: Feedback,
    /// Whether a new episode has begun.
    pub begins: bool,
    /// Whether the episode is over.
    pub ends: bool,
}

#[derive(Debug, Clone, Copy)]
struct Lane {
    episode: u64,
    step: u32,
    variant: u32,
    pose: Pose,
}

/// All lanes of a run.
#[derive(Debug)]
pub struct World {
    layout: Layout,
    /// By variant number: unchanged, then with each case's passage closed.
    variants: Vec<Variant>,
    /// By variant number: the first one that closes the same cells.
    alike: Vec<u32>,
    lanes: Vec<Option<Lane>>,
}

impl World {
    /// `lanes` idle lanes in the world of `warehouse` and `cases`.
    pub fn new(warehouse: &Warehouse, cases: &CaseSet, lanes: usize) -> Self {
        let closed =
            cases.cases.iter().map(|case| Variant::closing(case.barricade.iter().copied()));
        let variants: Vec<Variant> = std::iter::once(Variant::UNCHANGED).chain(closed).collect();
        let mut first: HashMap<&Variant, u32> = HashMap::new();
        let alike = (0..).zip(&variants).map(|(n, v)| *first.entry(v).or_insert(n)).collect();
        Self { layout: warehouse.layout.clone(), variants, alike, lanes: vec![None; lanes] }
    }

    /// The floor plan.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// World variant `number`.
    ///
    /// # Panics
    /// When it is not one that a lane can be in.
    pub fn variant(&self, number: u32) -> &Variant {
        &self.variants[number as usize]
    }

    /// The first variant that closes the same cells as variant `number`.
    ///
    /// # Panics
    /// When it is not one that a lane can be in.
    pub fn first_alike(&self, number: u32) -> u32 {
        self.alike[number as usize]
    }

    /// Carries out a command.
    ///
    /// # Errors
    /// When it means nothing, or nothing here; the lane is then as it was.
    pub fn apply(&mut self, command: &StepCommand) -> Result<Stepped, BadCommand> {
        let &StepCommand { lane, episode, step, .. } = command;
        self.try_apply(command).map_err(|problem| BadCommand { lane, episode, step, problem })
    }

    fn try_apply(&mut self, command: &StepCommand) -> Result<Stepped, Problem> {
        let (lane, count) = (command.lane as usize, self.lanes.len());
        let now = *self.lanes.get(lane).ok_or(Problem::Lane(count))?;
        let kind = StepKind::try_from(command.kind)?;
        let (next, feedback) = match kind {
            StepKind::Reset => (self.reset(command, now)?, Feedback::Start),
            StepKind::Act => {
                let action = Action::try_from(command.action)?;
                let now = following(command, now)?;
                let variant = &self.variants[now.variant as usize];
                let (pose, feedback) = step(&self.layout, variant, now.pose, action);
                (Lane { pose, step: command.step, ..now }, feedback)
            }
            StepKind::Stay => {
                let now = following(command, now)?;
                (Lane { step: command.step, ..now }, Feedback::NotUnderstood)
            }
        };
        let ends = command.last != 0;
        self.lanes[lane] = (!ends).then_some(next);
        let Lane { variant, pose, .. } = next;
        Ok(Stepped { lane, variant, pose, feedback, begins: kind == StepKind::Reset, ends })
    }

    fn reset(&self, command: &StepCommand, now: Option<Lane>) -> Result<Lane, Problem> {
        let &StepCommand { episode, step, variant: found, .. } = command;
        let pose = Pose::try_from(command.start)?;
        let variant = self.variants.get(found as usize);
        let variant = variant.ok_or(Problem::Variant { found, variants: self.variants.len() })?;
        if !self.layout.is_free(pose.cell) || variant.is_closed(pose.cell) {
            return Err(Problem::Start(pose));
        }
        if step != 0 {
            return Err(Problem::Place(place(now)));
        }
        Ok(Lane { episode, step, variant: found, pose })
    }
}

/// The lane as it is, if the command is the one that follows.
fn following(command: &StepCommand, now: Option<Lane>) -> Result<Lane, Problem> {
    now.filter(|lane| {
        lane.episode == command.episode && lane.step.checked_add(1) == Some(command.step)
    })
    .ok_or(Problem::Place(place(now)))
}

fn place(lane: Option<Lane>) -> Place {
    lane.map_or(Place::Idle, |Lane { episode, step, .. }| Place::Running { episode, step })
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use domain::Heading;
    use proptest::prelude::*;
    use shm_types::message::{NO_ACTION, WirePose};

    use super::*;

    fn world() -> World {
        World::new(&Warehouse::shipped(), &CaseSet::shipped(), 2)
    }

    fn start(world: &World) -> Pose {
        Pose { cell: world.layout.free_cells().next().unwrap(), heading: Heading::N }
    }

    fn reset(world: &World, lane: u32, episode: u64) -> StepCommand {
        StepCommand {
            lane,
            episode,
            start: WirePose::from(start(world)),
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
        let mut world = world();
        let from = start(&world);
        let begun = world.apply(&reset(&world, 1, 7)).unwrap();
        assert_eq!((begun.pose, begun.feedback, begun.begins), (from, Feedback::Start, true));
        let turned = world.apply(&act(1, 7, 1, Action::TurnLeft)).unwrap();
        assert_eq!(turned.pose, Pose { heading: Heading::W, ..from });
        assert_eq!((turned.feedback, turned.begins, turned.ends), (Feedback::Turned, false, false));
        let stay =
            StepCommand { kind: StepKind::Stay as u8, last: 1, ..act(1, 7, 2, Action::Forward) };
        let stayed = world.apply(&stay).unwrap();
        assert_eq!((stayed.pose, stayed.feedback), (turned.pose, Feedback::NotUnderstood));
        assert!(stayed.ends);
        let error = world.apply(&act(1, 7, 3, Action::Forward)).unwrap_err().to_string();
        assert_eq!(error, "command for lane 1, episode 7, step 3: the lane is in no episode");
    }

    #[test]
    fn every_case_has_its_barricade() {
        let (world, cases) = (world(), CaseSet::shipped());
        assert_eq!((world.variant(0), world.first_alike(0)), (&Variant::UNCHANGED, 0));
        for (case, number) in cases.cases.iter().zip(1..) {
            assert_eq!(world.variant(number).closed(), case.barricade);
            let first = world.first_alike(number);
            assert!(first > 0 && world.variant(first) == world.variant(number));
            assert!((0..first).all(|before| world.variant(before) != world.variant(number)));
        }
        assert_eq!(world.variants.len(), cases.cases.len() + 1);
    }

    #[test]
    fn what_cannot_be_done_is_named_and_changes_nothing() {
        let mut world = world();
        let good = reset(&world, 0, 7);
        world.apply(&good).unwrap();
        let rack = WirePose([0xff, 0, 0, 0]);
        for (command, said) in [
            (StepCommand { lane: 2, ..good }, "there are 2 lanes"),
            (StepCommand { kind: 9, ..good }, "9 is not a step kind"),
            (StepCommand { variant: 999, ..good }, "variant 999 is not one of 101"),
            (StepCommand { start: rack, ..good }, "nobody can stand at 255,0,N"),
            (StepCommand { start: WirePose([0, 0, 4, 0]), ..good }, "4 is not a heading"),
            (StepCommand { step: 1, ..good }, "the lane is in episode 7 after step 0"),
            (StepCommand { action: 7, ..act(0, 7, 1, Action::Left) }, "7 is not an action"),
            (act(0, 8, 1, Action::Left), "the lane is in episode 7 after step 0"),
            (act(0, 7, 2, Action::Left), "the lane is in episode 7 after step 0"),
            (act(1, 7, 1, Action::Left), "the lane is in no episode"),
        ] {
            let error = world.apply(&command).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
        assert!(world.apply(&act(0, 7, 1, Action::TurnLeft)).is_ok());
    }

    proptest! {
        #[test]
        fn no_command_panics_and_an_agent_stands_on_free_floor(
            commands in proptest::collection::vec((0..3_u32, 0..2_u64, 0..4_u32, 0..3_u32,
                any::<[u8; 4]>(), 0..4_u8, 0..9_u8, 0..2_u8), 0..64)
        ) {
            let mut world = world();
            for (lane, episode, step, variant, start, kind, action, last) in commands {
                let [x, y, heading, zero] = start;
                let start = WirePose([x % 17, y % 31, heading % 5, zero]);
                let command = StepCommand {
                    lane, episode, step, variant, start, kind, action, last, ..Zeroable::zeroed()
                };
                if let Ok(stepped) = world.apply(&command) {
                    let variant = world.variant(stepped.variant);
                    prop_assert!(world.layout.is_free(stepped.pose.cell));
                    prop_assert!(!variant.is_closed(stepped.pose.cell));
                }
            }
        }
    }
}
