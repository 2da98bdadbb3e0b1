//! What a [`Simulator`] answers outside of a run: recorded episodes and demonstrations, acted out.

use case_book::act::{
    ActAnswer, ActRequest, ActedDemonstration, ActedEpisode, ActedReference, DemonstrationsRequest,
    EpisodeRequest, WorldDescription,
};
use case_book::{CaseVariant, WorldDeclaration};
use domain::{ActionCode, DemonstrationKind, Mismatch, Start, State};

use super::WorldFailure;
use super::book::{case_facts, world_facts};
use super::simulated::facts;
use super::simulator::{CaseDeclaration, Simulator, TrajectoryName};
use super::stage::{ActedTrajectory, Stage, StageBegin};

/// A simulator, asked by those who show or check episodes.
pub(super) struct ActingSimulator {
    world: WorldDeclaration,
    description: WorldDescription,
    cases: Vec<CaseDeclaration>,
    stage: Stage,
}

impl ActingSimulator {
    pub(super) fn new(simulator: &(impl Simulator + ?Sized)) -> Result<Self, WorldFailure> {
        let (world, cases) = (simulator.declaration(), simulator.cases()?);
        let mut stage = Stage::new(simulator.environment()?);
        let count = cases.len() as u32;
        let listed: Result<_, WorldFailure> =
            (0..count).map(|number| case_facts(&world, &cases, &mut stage, number)).collect();
        let description = WorldDescription {
            world: world_facts(simulator)?,
            cases: listed?,
            blocked: (1..=count).collect(),
            states: Vec::new(),
        };
        Ok(Self { world, description, cases, stage })
    }

    /// Answers a request; one that cannot be met with an error.
    pub(super) fn answer(&mut self, request: &ActRequest) -> ActAnswer {
        let answer = match request {
            ActRequest::World => Ok(ActAnswer::World(self.description.clone())),
            ActRequest::Episode(episode) => {
                self.episode(episode).map(|acted| ActAnswer::Episode(Box::new(acted)))
            }
            ActRequest::Demonstrations(asked) => {
                self.demonstrations(asked).map(ActAnswer::Demonstrations)
            }
            ActRequest::Scene(_) => Err("this world has no map".into()),
            ActRequest::Swapped(..) => Err("this world swaps no views".into()),
        };
        answer.unwrap_or_else(|failure| ActAnswer::Error(failure.to_string()))
    }

    fn number(&self, id: &str) -> Result<u32, WorldFailure> {
        let number = self.cases.iter().position(|case| case.id == id);
        Ok(number.ok_or_else(|| format!("there is no case {id}"))? as u32)
    }

    fn episode(&mut self, request: &EpisodeRequest) -> Result<ActedEpisode, WorldFailure> {
        let number = self.number(&request.case)?;
        let (start, route) = request.reference.ok_or("this world has no streams")?;
        let name = TrajectoryName::reference(start, route);
        let mismatched = CaseVariant::with_mismatch(request.variant);
        let begin = StageBegin {
            mismatch: mismatched.map_or(Mismatch::None, |of| of.mismatch),
            ..StageBegin::of(number, name)
        };
        let acted = self.act(begin, request.actions.iter().copied())?;
        let states: Vec<State> = acted.moments.iter().map(|moment| moment.state).collect();
        let told = match request.parts.facts {
            true => {
                let completed: Vec<u32> =
                    acted.moments.iter().map(|moment| moment.sub_goals).collect();
                Some(facts(&states, &completed, self.stage.facts()?))
            }
            false => None,
        };
        let reference = match request.parts.reference {
            true => self.reference(StageBegin::of(number, name), name)?,
            false => None,
        };
        let case = &self.cases[number as usize];
        let first = &acted.moments[0];
        if let Some(recorded) = request.begin
            && recorded != first.state
        {
            return Err(format!("case {} begins elsewhere than it is recorded", case.id).into());
        }
        Ok(ActedEpisode {
            task: case.task,
            instruction: case.instruction.clone(),
            states,
            feedback: acted.moments.iter().map(|moment| moment.feedback).collect(),
            sub_goals: acted.sub_goals.clone(),
            required: first.required,
            facts: told,
            conflict_at: acted.conflict_at(),
            reference,
            scenery: None,
        })
    }

    fn act(
        &mut self,
        begin: StageBegin,
        actions: impl IntoIterator<Item = Option<ActionCode>>,
    ) -> Result<ActedTrajectory, WorldFailure> {
        self.stage.act(&self.cases, begin, actions, &self.world)
    }

    fn reference(
        &mut self,
        begin: StageBegin,
        name: TrajectoryName,
    ) -> Result<Option<ActedReference>, WorldFailure> {
        let case = &self.cases[begin.case as usize];
        let Some(actions) = case.trajectories.get(&name).cloned() else { return Ok(None) };
        let acted = self.act(begin, actions.iter().copied().map(Some))?;
        let invalidated = match self.cases[begin.case as usize]
            .trajectories
            .get(&TrajectoryName::Original)
            .cloned()
        {
            Some(original) => {
                let start = TrajectoryName::reference(Start::Original, domain::Route::Unchanged);
                let begin = StageBegin { start, ..begin };
                self.act(begin, original.into_iter().map(Some))?.length().is_none()
            }
            None => false,
        };
        Ok(Some(ActedReference {
            length: acted.length().unwrap_or(0),
            states: acted.moments.iter().map(|moment| moment.state).collect(),
            actions,
            invalidated,
        }))
    }

    fn demonstrations(
        &mut self,
        request: &DemonstrationsRequest,
    ) -> Result<Vec<ActedDemonstration>, WorldFailure> {
        let number = self.number(&request.case)?;
        let case = &self.cases[number as usize];
        let of_set: Vec<DemonstrationKind> = request.set.own().collect();
        let own = of_set.into_iter().map(|kind| (case.id.clone(), kind));
        let reference = request.set.reference().map(DemonstrationKind::reference);
        let after = request.set.take_place_after().then_some(DemonstrationKind::After);
        let single = after.or(reference).map(|kind| (case.id.clone(), kind));
        let wrong = request.set.wrong().unwrap_or(0);
        let wrong = case.irrelevant.iter().take(wrong).cloned();
        let histories = match request.set.mixture() {
            Some(domain::Mixture::Irrelevant) => case.irrelevant.clone(),
            Some(domain::Mixture::Confusable) => case.confusable.clone(),
            None => Vec::new(),
        };
        let mut asked: Vec<(String, DemonstrationKind)> =
            own.chain(histories).chain(wrong).chain(single).collect();
        for more in &request.more {
            if !asked.contains(more) {
                asked.push(more.clone());
            }
        }
        let mut acted = Vec::new();
        for (id, kind) in asked {
            acted.extend(self.demonstration(&id, kind, number, request.variant)?);
        }
        Ok(acted)
    }

    /// A demonstration; whether it is stale is judged for an episode of case `judged` in `variant`. `None` if there is none.
    fn demonstration(
        &mut self,
        id: &str,
        kind: DemonstrationKind,
        judged: u32,
        variant: u32,
    ) -> Result<Option<ActedDemonstration>, WorldFailure> {
        let number = self.number(id)?;
        let case = &self.cases[number as usize];
        let Some(name) = TrajectoryName::of(kind) else { return Ok(None) };
        let Some(actions) = case.trajectories.get(&name).cloned() else { return Ok(None) };
        let (instruction, task) = (case.instruction.clone(), case.task);
        let begin = StageBegin::of(number, name);
        let acted = self.act(begin, actions.iter().copied().map(Some))?;
        let is_judged = CaseVariant::without_mismatch(variant) == 1 + judged;
        let is_stale = number == judged && is_judged && !begin.is_blocked && {
            let blocked = StageBegin { is_blocked: true, ..begin };
            self.act(blocked, actions.iter().copied().map(Some))?.length().is_none()
        };
        Ok(Some(ActedDemonstration {
            case: id.to_owned(),
            kind,
            variant: if begin.is_blocked { 1 + number } else { 0 },
            task,
            instruction,
            states: acted.moments.iter().map(|moment| moment.state).collect(),
            feedback: acted.moments.iter().map(|moment| moment.feedback).collect(),
            length: acted.length(),
            sub_goals: acted.sub_goals,
            actions,
            is_stale,
            closed: Vec::new(),
            targets: Vec::new(),
        }))
    }
}
