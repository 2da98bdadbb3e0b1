//! The policy under test.

pub(crate) mod checks;

use domain::{Action, Outcome};
use shm_types::documents::Content;
use shm_types::message::{
    Decision, FrameId, ItemKind, Observation, PolicyEpisodeConfig, Recall, RecalledInstruction,
    RecalledItem, RequestId, Role, SegmentStep,
};
use shm_types::{Attach, BusError, FramePublisher};

use crate::messages::{config, item, observation, recall, supply};
use crate::neighbours::PolicyNeighbours;
use crate::subject::{CheckResult, SeesFrames, Subject, TestedRole, Trouble};

/// The role of the policy.
#[derive(Debug, Default)]
pub(crate) struct PolicyRole;

/// A policy in one generation.
pub(crate) type TestedPolicy<'a> = Subject<'a, PolicyRole>;

impl TestedRole for PolicyRole {
    const ROLE: Role = Role::Policy;
    const A_PROCESS: &'static str = "a policy";
    const NAME_FACT: &'static str = "policy";
    const ANSWER: &'static str = "decision";
    const AN_ANSWER: &'static str = "a decision";
    const ANSWERED: &'static str = "decided";
    const WAITS_FOR_RUN: bool = false;

    type Neighbours = PolicyNeighbours;
    type Answer = Decision;

    fn settings(attach: Attach) -> Attach {
        Attach { participants: vec![Role::Policy], ..attach }
    }

    fn join(attach: &Attach) -> Result<PolicyNeighbours, BusError> {
        PolicyNeighbours::join(attach)
    }

    fn receive(
        &mut self,
        neighbours: &mut PolicyNeighbours,
    ) -> CheckResult<Vec<(RequestId, Decision)>> {
        let decisions = neighbours.decisions.drain()?.into_iter().map(|decision| {
            let Decision { lane, episode, step, .. } = decision;
            (RequestId { lane, episode, step }, decision)
        });
        Ok(decisions.collect())
    }

    fn check(&self, _: RequestId, decision: &Decision) -> Result<(), String> {
        let valid = match Outcome::try_from(decision.outcome) {
            Ok(Outcome::Acted) => Action::try_from(decision.action).map(drop),
            Ok(_) => Ok(()),
            Err(error) => Err(error),
        };
        valid.map_err(|error| error.to_string())
    }

    /// A policy sends no decision for what it cannot decide.
    fn refusal(_: &Decision) -> Option<String> {
        None
    }
}

impl SeesFrames for PolicyRole {
    fn frames(neighbours: &mut PolicyNeighbours) -> &mut FramePublisher {
        &mut neighbours.frames
    }
}

/// What a request shows.
#[derive(Debug, Clone, Default)]
pub(crate) struct RequestScene {
    pub(crate) frame: FrameId,
    pub(crate) segment: Vec<FrameId>,
    /// Further items, with the steps that the message holds for them.
    pub(crate) items: Vec<(RecalledItem, Vec<SegmentStep>)>,
    /// The instruction of all demonstrations; an empty one if there is none.
    pub(crate) instruction: Option<RecalledInstruction>,
}

impl RequestScene {
    pub(crate) fn recall(&self, id: RequestId) -> Recall {
        let mut recall = recall(id, &self.segment);
        for (item, steps) in &self.items {
            supply(&mut recall, *item, steps);
        }
        if let Some(instruction) = self.instruction {
            recall.instructions[..recall.instructions_len as usize].fill(instruction);
        }
        recall
    }
}

impl TestedPolicy<'_> {
    /// Publishes a document for an episode, or for the whole run. Returns the item that supplies all of it.
    pub(crate) fn document(
        &mut self,
        of: Option<RequestId>,
        content: &Content,
    ) -> CheckResult<RecalledItem> {
        let of = of.map(|id| (id.lane, id.episode));
        let published = self.neighbours.documents.publish(of, content);
        let document = published.map_err(|error| Trouble::Wrong(error.to_string()))?;
        Ok(match content {
            Content::Trajectories(steps) => RecalledItem {
                document,
                steps: steps.len() as u32,
                whole: 1,
                instructions: steps.chunk_by(|a, b| a.trajectory == b.trajectory).count() as u8,
                ..item(ItemKind::Trajectory)
            },
            Content::Summary(text) | Content::Semantic(text) | Content::Note(text) => {
                RecalledItem { document, bytes: text.len() as u32, ..item(ItemKind::Text) }
            }
        })
    }

    /// Publishes the instruction of a demonstration for an episode.
    pub(crate) fn instruction(
        &mut self,
        of: RequestId,
        instruction: &str,
    ) -> CheckResult<RecalledInstruction> {
        let note = self.document(Some(of), &Content::Note(instruction.to_owned()))?;
        let RecalledItem { document, first_byte, bytes, .. } = note;
        Ok(RecalledInstruction { document, first_byte, bytes })
    }

    /// Begins an episode with a window of six steps.
    pub(crate) fn begin(
        &mut self,
        lane: u32,
        seed: u64,
        instruction: &str,
    ) -> CheckResult<RequestId> {
        self.begin_with_window(lane, seed, instruction, 6)
    }

    /// Begins an episode in `lane`; the lane's earlier one is over.
    pub(crate) fn begin_with_window(
        &mut self,
        lane: u32,
        seed: u64,
        instruction: &str,
        window: u8,
    ) -> CheckResult<RequestId> {
        let id = self.next_episode(lane);
        let config = config(lane, id.episode, instruction);
        self.neighbours.send(&PolicyEpisodeConfig { seed, window, ..config })?;
        Ok(id)
    }

    /// Makes a request: recall, then observation. Does not notify.
    pub(crate) fn ask(&mut self, id: RequestId, scene: &RequestScene) -> CheckResult<()> {
        self.expect(id);
        self.recall(&scene.recall(id))?;
        self.observe(&observation(id, scene.frame))
    }

    /// Makes a request and waits for its answer.
    pub(crate) fn ask_and_wait(
        &mut self,
        id: RequestId,
        scene: &RequestScene,
    ) -> CheckResult<Decision> {
        self.ask(id, scene)?;
        self.wait()?;
        self.answer(id)
    }

    pub(crate) fn recall(&mut self, message: &Recall) -> CheckResult<()> {
        Ok(self.neighbours.send(message)?)
    }

    pub(crate) fn observe(&mut self, message: &Observation) -> CheckResult<()> {
        Ok(self.neighbours.observe(message)?)
    }
}
