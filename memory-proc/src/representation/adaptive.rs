//! Adaptive memory: episodic retrieval that verifies, updates and forgets while it is used.
//!
//! It stores trajectories: the demonstrations, and its own successful episodes. A trajectory `T` has states `p`, actions `a`,
//! feedback `f` and embedded views `e`; its transition `k` leads from step `k` to step `k + 1`.
//!
//! **Recall.** At step `t` of an episode with instruction `I`, the candidates are the steps of the trajectories with
//! instruction `I`, or of all trajectories if none has it. Those whose transition is cut or changed no state are left out.
//! With the cosine distance `d` and a margin `EPSILON`, it supplies the continuation, to the horizon or the next such
//! transition, of
//!
//! ```text
//! argmin over {(T, k): d(e[k], e_t) <= min d + EPSILON}  of  (cut ahead, -confirmed(T), demonstrated, d, ties)
//! ```
//!
//! `cut ahead` is 1 if `T` has a cut transition after `k`, and `confirmed(T)` the number of the last episode that confirmed
//! `T`, 0 if none has. Ties are those of [episodic](super::episodic) memory, task stage and then elapsed steps; of two
//! visits to one place in one stage, an own episode continues from the later. Before anything is learned this is episodic
//! retrieval among the demonstrations of the task.
//!
//! **Verify.** The agent was in state `p`, took action `a`, and got feedback `f'`, state `p'` and view `e'`. Every stored
//! transition with `p[k] = p` and `a[k] = a` had predicted that. It is
//!
//! ```text
//! verified      if  f[k + 1] = f',  p[k + 1] = p'  and  d(e[k + 1], e') <= TAU
//! contradicted  otherwise
//! ```
//!
//! `TAU` lets through what has changed far away, and not a barricade, or another item, before the agent.
//!
//! **Update.** Episode `n`, if it is known to be a success, is stored as a trajectory with `confirmed = n`, and each
//! trajectory of its instruction of which it has verified a transition gets `confirmed = n`. Of any other episode only
//! what it has verified and contradicted is kept.
//!
//! **Forget.** A contradicted transition is cut, until it is verified again. When the trajectories have more than
//! [`BUDGET`] steps together, the one with the lowest `(confirmed, number)` is dropped, until they fit.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::path::Path;
use std::sync::Arc;

use domain::{ActionCode, FeedbackCode, SegmentContent, State};
use peer::memory::{
    Demonstration, Episode, EpisodeEnd, Memory, MemoryError, MemoryItem, Query, Source, Step, Views,
};
use search::{Embedding, Index, IndexBuilder, Neighbour, ViewEntry, distance};
use serde::{Deserialize, Serialize};

use super::{KnownStages, MemorySettings, SuppliedStage, dimension};
use crate::bank::Embeddings;

/// The distance by which a preferred view may be farther than the nearest. Neighbouring views of an aisle differ by 0.004 and
/// more.
const EPSILON: f32 = 0.01;

/// The distance from which a view is not the one that was predicted.
const TAU: f32 = 0.05;

/// Steps that are stored, of all trajectories together.
const BUDGET: usize = 65_536;

/// Nearest views that are looked at.
const CANDIDATES: usize = 64;

/// The files of [`Memory::save`].
const STATE_FILE: &str = "adaptive.json";
const VIEWS_FILE: &str = "views.f32";

/// A step of a trajectory. The last has no transition.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct StoredStep {
    state: State,
    action: Option<ActionCode>,
    /// The feedback to the action before.
    feedback: FeedbackCode,
    /// Sub-goals completed, if that is known.
    stage: Option<u32>,
    content: [u8; 16],
    /// The transition is contradicted.
    is_cut: bool,
}

impl StoredStep {
    fn new(state: State, action: Option<ActionCode>, feedback: FeedbackCode) -> Self {
        Self { state, action, feedback, stage: None, content: [0; 16], is_cut: false }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct OwnTrajectory {
    /// The number under which items name it.
    number: u32,
    instruction: String,
    /// An own episode, not a demonstration.
    is_own: bool,
    confirmed: u32,
    steps: Vec<StoredStep>,
    /// The embeddings of the first steps' views. The last step of an own episode has none.
    #[serde(skip)]
    views: Vec<Embedding>,
}

impl OwnTrajectory {
    /// The embedding of a step's view.
    fn view(&self, step: usize) -> Option<&[f32]> {
        self.views.get(step).map(Embedding::as_slice)
    }

    /// Whether a transition can be supplied: it is not cut, and changed the state.
    fn continues(&self, step: usize) -> bool {
        let now = &self.steps[step];
        !now.is_cut && self.steps.get(step + 1).is_some_and(|next| next.state != now.state)
    }

    /// Whether a later transition is cut.
    fn is_cut_ahead(&self, step: usize) -> bool {
        self.steps[step..].iter().any(|step| step.is_cut)
    }

    fn is_same_path(&self, other: &[StoredStep]) -> bool {
        let path = |step: &StoredStep| (step.state, step.action, step.feedback);
        self.steps.iter().map(path).eq(other.iter().map(path))
    }
}

/// An episode that is learned from, so far.
#[derive(Debug, Default)]
struct Running {
    instruction: String,
    steps: Vec<StoredStep>,
    views: Vec<Embedding>,
    /// Trajectories of which a transition was verified.
    verified: BTreeSet<u32>,
}

/// What [`Memory::save`] writes, beside the views of own episodes.
#[derive(Serialize, Deserialize)]
struct Stored {
    episodes: u32,
    dimension: usize,
    trajectories: Vec<OwnTrajectory>,
}

#[derive(Debug)]
pub(super) struct Adaptive {
    horizon: u32,
    content: SegmentContent,
    hits: usize,
    budget: usize,
    /// Numbers in an embedding.
    dimension: usize,
    /// Episodes that were learned from.
    episodes: u32,
    /// What is stored, in bytes.
    bytes: u64,
    /// Of the demonstrations, until it is built.
    embeddings: Arc<Embeddings>,
    /// In the order of their numbers.
    trajectories: Vec<OwnTrajectory>,
    running: BTreeMap<u64, Running>,
    stages: KnownStages,
    /// The steps that can be supplied, by instruction; `None`: of all trajectories. Made when first needed. An entry's
    /// demonstration is a position in `trajectories`.
    indexes: BTreeMap<Option<String>, Index>,
}

impl Adaptive {
    pub(super) fn new(settings: &MemorySettings) -> Self {
        let &MemorySettings { horizon, segment: content, hits, .. } = settings;
        Self {
            horizon,
            content,
            hits,
            budget: BUDGET,
            dimension: 0,
            episodes: 0,
            bytes: 0,
            embeddings: settings.embeddings.clone(),
            trajectories: Vec::new(),
            running: BTreeMap::new(),
            stages: KnownStages::default(),
            indexes: BTreeMap::new(),
        }
    }

    /// An index of the steps that can be supplied of these trajectories.
    fn index(&self, instruction: Option<&str>) -> Index {
        let mut index = IndexBuilder::with_capacity(self.dimension, 0);
        for (position, of) in (0..).zip(&self.trajectories) {
            if instruction.is_some_and(|wanted| wanted != of.instruction) {
                continue;
            }
            for (at, step) in of.steps.iter().enumerate() {
                let is_last = at + 1 == of.steps.len();
                let view = of.view(at).filter(|_| is_last || of.continues(at));
                let Some(view) = view else { continue };
                let stage = step.stage.unwrap_or(0);
                let entry = ViewEntry { demonstration: position, step: at as u16, stage };
                match of.is_own {
                    true => index.add_distinct(entry, view),
                    false => index.add(entry, step.content, view),
                }
            }
        }
        index.build()
    }

    /// The views nearest to the current one, the most preferred first.
    fn nearest(&mut self, query: &Query<'_>, embedding: &[f32]) -> Vec<Neighbour> {
        let (stage, elapsed) = (self.stages.of(&query.now), query.now.step);
        let asked = search::SearchQuery { embedding, stage, elapsed };
        for instruction in [Some(query.instruction), None] {
            let key = instruction.map(str::to_owned);
            if !self.indexes.contains_key(&key) {
                let index = self.index(instruction);
                self.indexes.insert(key.clone(), index);
            }
            let found = self.indexes[&key].nearest_of_many(&[asked], CANDIDATES.max(self.hits));
            let mut found = found.into_iter().next().unwrap_or_default();
            if let Some(nearest) = found.first() {
                let limit = nearest.distance + EPSILON;
                let within = found.partition_point(|found| found.distance <= limit);
                found[..within].sort_by(|a, b| {
                    let preference = |of: &Neighbour| self.preference(of);
                    let order = preference(a).cmp(&preference(b));
                    order
                        .then(a.distance.total_cmp(&b.distance))
                        .then_with(|| self.tie(a, &asked).cmp(&self.tie(b, &asked)))
                });
                found.truncate(self.hits);
                return found;
            }
        }
        Vec::new()
    }

    /// (cut ahead, -confirmed, demonstrated): the least is preferred.
    fn preference(&self, found: &Neighbour) -> (bool, Reverse<u32>, bool) {
        let of = &self.trajectories[usize::from(found.entry.demonstration)];
        let cut = of.is_cut_ahead(found.entry.step.into());
        // What nothing has confirmed is a demonstration.
        (cut, Reverse(of.confirmed), of.confirmed > 0 && !of.is_own)
    }

    /// Orders views of equal distance as episodic memory does, except that an own episode whose stages are known is
    /// continued from the latest of several visits.
    fn tie(&self, found: &Neighbour, query: &search::SearchQuery<'_>) -> (u32, u32, u16, u16) {
        let ViewEntry { demonstration, step, .. } = found.entry;
        let of = &self.trajectories[usize::from(demonstration)];
        let stage = of.steps[usize::from(step)].stage;
        let time = match (of.is_own, stage) {
            (true, Some(_)) => u32::from(u16::MAX - step),
            _ => u32::from(step).abs_diff(query.elapsed),
        };
        (stage.map_or(0, |stage| stage.abs_diff(query.stage)), time, demonstration, step)
    }

    /// The view that was found, and the continuation from there.
    fn segment(&self, Neighbour { entry, distance }: Neighbour) -> MemoryItem {
        let of = &self.trajectories[usize::from(entry.demonstration)];
        let first = usize::from(entry.step);
        let transitions = first..(first + self.horizon as usize).min(of.steps.len());
        let count = 1 + transitions.take_while(|&at| of.continues(at)).count() as u32;
        MemoryItem::Steps {
            source: Source { demonstration: of.number, first: first as u32, count },
            views: Views::All,
            actions: self.content == SegmentContent::Actions,
            distance: Some(distance),
        }
    }

    /// Verifies the transitions that had predicted a step, given the step before.
    fn verify(&mut self, before: StoredStep, now: &Step<'_>) -> BTreeSet<u32> {
        let mut verified = BTreeSet::new();
        let Some(action) = now.last_action else { return verified };
        let mut has_changed = false;
        for of in &mut self.trajectories {
            for at in 1..of.steps.len() {
                let (from, to) = (of.steps[at - 1], of.steps[at]);
                if (from.state, from.action) != (before.state, Some(action)) {
                    continue;
                }
                let views = of.view(at).zip(now.embedding);
                let shows_same = views.map(|(known, seen)| distance(known, seen) <= TAU);
                let is_same = (to.state, to.feedback) == (now.state, now.feedback)
                    && shows_same != Some(false);
                if is_same {
                    verified.insert(of.number);
                }
                // Without a view, what was cut for its view stays cut.
                let is_cut = !is_same || from.is_cut && shows_same.is_none();
                has_changed |= is_cut != from.is_cut;
                of.steps[at - 1].is_cut = is_cut;
            }
        }
        if has_changed {
            self.indexes.clear();
        }
        verified
    }

    /// Stores a successful episode, unless its path is known, and confirms what it has verified.
    fn update(&mut self, number: u32, running: Running, sub_goals: Option<&[u32]>) {
        let Running { instruction, mut steps, views, verified } = running;
        let mut is_known = false;
        for of in self.trajectories.iter_mut().filter(|of| of.instruction == instruction) {
            let is_same = of.is_same_path(&steps);
            is_known |= is_same;
            if is_same || verified.contains(&of.number) {
                of.confirmed = self.episodes;
            }
        }
        if is_known {
            return;
        }
        for (at, step) in (0..).zip(&mut steps) {
            let completed = |goals: &[u32]| goals.iter().filter(|&&goal| goal <= at).count() as u32;
            step.stage = sub_goals.map(completed);
        }
        let confirmed = self.episodes;
        let own = OwnTrajectory { number, instruction, is_own: true, confirmed, steps, views };
        self.trajectories.push(own);
    }

    /// Drops trajectories until the others fit into the budget.
    fn forget(&mut self) {
        self.drop_oldest();
        let steps: usize = self.trajectories.iter().map(|of| size_of_val(&*of.steps)).sum();
        let all = self.trajectories.iter().flat_map(|of| &of.views);
        let views: HashSet<*const f32> = all.map(|view| view.as_slice().as_ptr()).collect();
        self.bytes = (steps + views.len() * self.dimension * size_of::<f32>()) as u64;
    }

    fn drop_oldest(&mut self) {
        let mut steps: usize = self.trajectories.iter().map(|of| of.steps.len()).sum();
        if steps <= self.budget {
            return;
        }
        let mut oldest: Vec<(u32, u32, usize)> =
            self.trajectories.iter().map(|of| (of.confirmed, of.number, of.steps.len())).collect();
        oldest.sort_unstable();
        let mut dropped = BTreeSet::new();
        for (_, number, length) in oldest {
            if steps > self.budget {
                steps -= length;
                dropped.insert(number);
            }
        }
        self.trajectories.retain(|of| !dropped.contains(&of.number));
    }
}

impl Memory for Adaptive {
    fn build(&mut self, demonstrations: &[Demonstration<'_>]) -> Result<(), MemoryError> {
        let embeddings = std::mem::take(&mut self.embeddings);
        self.dimension = dimension(&embeddings);
        for (number, of) in (0..).zip(demonstrations) {
            let views = of.steps.iter().map(|step| embeddings.get(&step.content_hash).cloned());
            let views: Option<Vec<Embedding>> = views.collect();
            let views =
                views.ok_or_else(|| MemoryError::new("the views have not been embedded"))?;
            let steps = of.steps.iter().zip(of.stages).map(|(step, &stage)| StoredStep {
                stage: Some(stage),
                content: step.content_hash,
                ..StoredStep::new(step.state, step.action, step.feedback)
            });
            self.trajectories.push(OwnTrajectory {
                number,
                instruction: of.instruction.to_owned(),
                is_own: false,
                confirmed: 0,
                steps: steps.collect(),
                views,
            });
        }
        self.forget();
        Ok(())
    }

    fn begin_episode(&mut self, episode: &Episode<'_>) -> Result<(), MemoryError> {
        if episode.learns {
            let instruction = episode.instruction.to_owned();
            self.running.insert(episode.episode, Running { instruction, ..Running::default() });
        }
        Ok(())
    }

    fn observe(&mut self, step: &Step<'_>) -> Result<(), MemoryError> {
        let Some(mut running) = self.running.remove(&step.episode) else { return Ok(()) };
        if let Some(before) = running.steps.last_mut() {
            before.action = step.last_action;
            running.verified.extend(self.verify(*before, step));
        }
        running.steps.push(StoredStep::new(step.state, None, step.feedback));
        running.views.extend(step.embedding.and_then(|view| Embedding::restored(view.to_vec())));
        self.running.insert(step.episode, running);
        Ok(())
    }

    fn recall(&mut self, query: &Query<'_>) -> Result<Vec<MemoryItem>, MemoryError> {
        let embedding = query.now.embedding;
        let embedding =
            embedding.ok_or_else(|| MemoryError::new("the current view has not been embedded"))?;
        let nearest = self.nearest(query, embedding);
        let supplied = nearest.first().and_then(|found| {
            let steps = &self.trajectories[usize::from(found.entry.demonstration)].steps;
            let at = usize::from(found.entry.step);
            let StoredStep { stage, action, .. } = steps[at];
            let stage = stage?;
            let next = steps.get(at + 1).and_then(|next| next.stage).unwrap_or(stage);
            Some(SuppliedStage { stage, action, next })
        });
        if let Some(supplied) = supplied {
            self.stages.supplied(&query.now, supplied);
        }
        Ok(nearest.into_iter().map(|found| self.segment(found)).collect())
    }

    fn end_episode(&mut self, end: &EpisodeEnd<'_>) -> Result<(), MemoryError> {
        let running = self.running.remove(&end.episode);
        let (Some(running), Some(number)) = (running, end.demonstration) else { return Ok(()) };
        self.episodes += 1;
        if end.success == Some(true) {
            self.update(number, running, end.sub_goals);
            self.forget();
        }
        self.indexes.clear();
        Ok(())
    }

    fn save(&mut self, folder: &Path) -> Result<(), MemoryError> {
        let stored = Stored {
            episodes: self.episodes,
            dimension: self.dimension,
            trajectories: self.trajectories.clone(),
        };
        let own = self.trajectories.iter().filter(|of| of.is_own);
        let views: Vec<u8> = own
            .flat_map(|of| &of.views)
            .flat_map(Embedding::as_slice)
            .flat_map(|number| number.to_le_bytes())
            .collect();
        let write = |name, bytes: &[u8]| {
            durable::write_file(&folder.join(name), bytes).map_err(MemoryError::new)
        };
        write(STATE_FILE, &serde_json::to_vec(&stored).map_err(MemoryError::new)?)?;
        write(VIEWS_FILE, &views)
    }

    fn load(&mut self, folder: &Path) -> Result<(), MemoryError> {
        let read = |name| durable::read(&folder.join(name)).map_err(MemoryError::new);
        let stored: Stored =
            serde_json::from_slice(&read(STATE_FILE)?).map_err(MemoryError::new)?;
        let views = read(VIEWS_FILE)?;
        let (views, []) = views.as_chunks() else {
            return Err(MemoryError::new(format_args!("{VIEWS_FILE} is cut off")));
        };
        let views: Vec<f32> = views.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        let mut views = views.chunks(stored.dimension.max(1));
        let mut built: BTreeMap<u32, Vec<Embedding>> =
            self.trajectories.drain(..).map(|of| (of.number, of.views)).collect();
        (self.episodes, self.dimension) = (stored.episodes, stored.dimension);
        for mut of in stored.trajectories {
            of.views = match of.is_own {
                false => built.remove(&of.number).unwrap_or_default(),
                true => {
                    let own = views.by_ref().take(of.steps.len().saturating_sub(1));
                    let own = own.map(|view| Embedding::restored(view.to_vec()));
                    own.collect::<Option<_>>().ok_or_else(|| {
                        MemoryError::new(format_args!(
                            "{VIEWS_FILE} has a vector of another length than 1"
                        ))
                    })?
                }
            };
            self.trajectories.push(of);
        }
        self.forget();
        self.indexes.clear();
        Ok(())
    }

    /// Steps and views, a view of several steps once. Indexes are left out: they are made as needed.
    fn store_bytes(&self) -> Option<u64> {
        Some(self.bytes)
    }
}

#[cfg(test)]
mod tests;
