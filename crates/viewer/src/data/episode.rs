//! The data of an episode's page.

use std::collections::{BTreeMap, BTreeSet};
use std::iter::{repeat, repeat_with};

use anyhow::Result;
use case_book::act::{
    ActedDemonstration, DemonstrationsRequest, EpisodeParts, EpisodeScenery, Target,
};
use case_book::{FailureFact, LoopFact};
use conditions::key::EpisodeKey;
use domain::events::Requirement;
use domain::{Arm, Cell, DemonstrationKind, Demonstrations, Mismatch, Pose, State};
use run_log::source::{SourceStep, distances, sources};
use run_log::{EpisodeRecord, EpisodeTimings, RequestRecord, Stages};
use scores::{FailurePoints, Successes};
use serde::Serialize;
use world_client::frames::ViewKey;
use world_client::{EpisodeTimeline, RunWorld, begin_of, facts_of};

use super::{PoseData, cell_data, cell_of, pose_data};
use crate::view_file::ViewFile;

/// What the log has about an episode.
#[derive(Debug)]
pub struct LoggedEpisode<'a> {
    /// Its record.
    pub record: &'a EpisodeRecord,
    /// Its times, unless a crash lost them.
    pub timings: Option<&'a EpisodeTimings>,
    /// Its requests to a model.
    pub requests: Vec<&'a RequestRecord>,
    /// Steps of a retrieved segment.
    pub horizon: u32,
    /// Whether its prompts were logged.
    pub prompts: bool,
}

/// The data of an episode. Step `t` is the moment after `t` actions; lists by step have an element for each, the start
/// included.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct EpisodeData {
    key: String,
    instruction: String,
    ending: &'static str,
    steps: u32,
    reference: u32,
    failure: Option<FailureData>,
    /// Since when it failed; `None` for a success.
    points: Option<PointData>,
    /// By step.
    poses: Vec<PoseData>,
    /// By step, in words.
    states: Vec<String>,
    /// By step, as a number.
    feedback: Vec<u8>,
    /// A letter for each action.
    actions: String,
    /// The steps whose move was blocked.
    blocked_moves: Vec<u32>,
    sub_goals: Vec<u32>,
    required: u32,
    visits: Vec<VisitData>,
    first_seen: BTreeMap<Requirement, u32>,
    /// On a blocked route: the step at which the agent first tried to enter a closed cell.
    conflict_at: Option<u32>,
    /// The closed cells.
    closed: Vec<(u8, u8)>,
    /// Whether it is of the first block of its sequence.
    first_block: bool,
    /// How its world differs from that of the block before in its sequence, or for the first block from the unchanged world, in
    /// words.
    changes: Vec<String>,
    /// The items that the task is about.
    targets: Vec<TargetData>,
    /// The drawing of the floor: the number of a world state of streams, or of the variant with other stock.
    pub(crate) ground: u32,
    reference_path: Vec<(u8, u8)>,
    /// By step: the cells that came into view, as row * columns + column.
    seen: Vec<Vec<u16>>,
    /// What memory was built from, as far as it is known.
    demonstrations: Vec<DemonstrationData>,
    /// By step: what memory supplied for the next action. Empty where the log has no sources.
    supplied: Vec<Vec<Supplied>>,
    /// What leads into a closed cell of what memory supplied when the agent tried to enter one.
    led: Option<LedData>,
    /// By step: the file of the view that the policy was shown. Empty where there are none.
    views: Vec<String>,
    facts: Vec<(&'static str, String)>,
    /// Mean microseconds of a step by stage.
    stages: Vec<(&'static str, u64)>,
    requests: Vec<RequestData>,
    /// Whether there is a file with its prompts.
    pub(crate) prompts: bool,
}

/// An index into the demonstrations, a step in that one, and the distance, where the memory tells it.
type Supplied = (usize, u32, Option<f64>);

/// Why the episode failed.
#[derive(Debug, Serialize)]
pub struct FailureData {
    kind: String,
    meaning: String,
    /// The step of the event that the rule of the kind is about.
    step: u32,
}

/// Since when the episode failed.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
struct PointData {
    /// The step at which the last sub-goal was completed; 0 if none was.
    last_progress: u32,
    /// First repetition and end of each loop after it. `None`: not recorded.
    loops: Option<Vec<(u32, u32)>>,
    /// The step from which it acts unlike the success with this key.
    unlike_success: Option<(u32, String)>,
    /// Without such a success: the step from which it acts unlike the reference.
    unlike_reference: Option<u32>,
}

impl PointData {
    fn new(points: FailurePoints, unlike_reference: Option<u32>) -> Self {
        let FailurePoints { last_progress, loops, divergence } = points;
        let steps = |found: LoopFact| (found.from, found.to);
        Self {
            last_progress,
            loops: loops.map(|loops| loops.into_iter().map(steps).collect()),
            unlike_success: divergence.map(|found| (found.step, found.success)),
            unlike_reference,
        }
    }
}

#[derive(Debug, Serialize)]
struct VisitData {
    step: u32,
    letter: Requirement,
    cell: (u8, u8),
}

#[derive(Debug, Serialize)]
struct TargetData {
    letter: char,
    name: String,
    cell: (u8, u8),
}

/// A demonstration, or an earlier episode of the sequence.
#[derive(Debug, Serialize)]
pub struct DemonstrationData {
    title: String,
    /// The key of the earlier episode.
    episode: Option<String>,
    /// Whether it completes its task where it was recorded and not in the world of this episode.
    stale: bool,
    /// Whether it took place in another warehouse, whose map is not shown.
    elsewhere: bool,
    poses: Vec<PoseData>,
    actions: String,
    /// By step: the file of the thumbnail of the view. Empty where there are none; a name is empty where there is no file.
    views: Vec<String>,
    #[serde(skip)]
    at: Vec<State>,
}

/// A source that leads into a closed cell.
#[derive(Debug, Serialize)]
struct LedData {
    demonstration: usize,
    /// The step that was supplied; absent if the demonstration was supplied whole.
    from: Option<u32>,
    /// The step at which the demonstration enters a closed cell.
    enters: u32,
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
struct RequestData {
    step: u32,
    outcome: &'static str,
    latency_us: Option<u64>,
    images: Option<u32>,
    prompt_tokens: Option<u32>,
    completion_tokens: Option<u32>,
    memory_tokens: Option<u32>,
    attempts: Option<u32>,
    replayed: bool,
}

/// Steps of a demonstration that the page shows at once.
const FILM: u32 = 6;

/// What makes a demonstration one of several.
#[derive(PartialEq, Eq)]
enum DemonstrationOrigin {
    /// The id of its case, and which.
    Demonstration(String, DemonstrationKind),
    Episode(u32),
}

impl EpisodeData {
    /// The data of `episode`, which is compared with `successes` if it failed. `experience` finds the record at a position of its
    /// sequence.
    ///
    /// # Errors
    /// When the episode does not fit the world.
    pub fn new<'r>(
        world: &RunWorld,
        episode: &LoggedEpisode<'_>,
        successes: &Successes,
        experience: impl Fn(u32) -> Option<&'r EpisodeRecord>,
    ) -> Result<Self> {
        let &LoggedEpisode { record, timings, horizon, prompts, .. } = episode;
        let parts = EpisodeParts { reference: true, scenery: true, ..EpisodeParts::default() };
        let timeline = EpisodeTimeline::new(world, record, successes, parts)?;
        let EpisodeTimeline { instruction, variant, steps, reference, scenery, failure, .. } =
            timeline;
        let points =
            timeline.points.map(|points| PointData::new(points, timeline.unlike_reference_at));
        // A world that draws no map has no scenery.
        let has_map = world.has_map();
        let EpisodeScenery { came_into_view, closed, targets, changes } =
            scenery.unwrap_or_default();
        let columns = if has_map { u16::from(world.scene(variant)?.size().0) } else { 0 };
        let seen = |cells: Vec<Cell>| {
            let index = |cell: Cell| u16::from(cell.y) * columns + u16::from(cell.x);
            cells.into_iter().map(index).collect()
        };
        let mut memory = DemonstrationCollector { world, record, variant, found: Vec::new() };
        let supplied = memory.supplied(experience)?;
        let told = if has_map { Some(facts_of(record)?) } else { None };
        let world_facts = &world.description().world;
        let stages = timings.map(|timings| {
            let mean = |total: u64| total / u64::from(timings.steps.max(1)) / 1000;
            Stages::NAMES.into_iter().zip(timings.stages.values().map(mean)).collect()
        });
        let demonstrations: Vec<DemonstrationData> =
            memory.found.into_iter().map(|(_, demonstration)| demonstration).collect();
        Ok(Self {
            key: record.key.clone(),
            instruction,
            ending: record.ending.name(),
            steps: record.steps,
            reference: record.reference,
            failure: failure.map(|FailureFact { kind, step }| FailureData {
                meaning: world_facts.failure_words(&kind).to_owned(),
                kind,
                step,
            }),
            points,
            poses: steps.iter().map(|step| pose_data(&step.state)).collect(),
            feedback: steps.iter().map(|step| step.feedback_code.0).collect(),
            actions: record.actions.clone(),
            blocked_moves: told.as_ref().map_or_else(Vec::new, |told| told.blocked_moves.clone()),
            sub_goals: record.sub_goals.clone(),
            required: record.required,
            visits: told
                .iter()
                .flat_map(|told| &told.visits)
                .map(|visit| VisitData {
                    step: visit.step,
                    letter: visit.requirement,
                    cell: cell_data(&visit.cell),
                })
                .collect(),
            first_seen: told.map_or_else(BTreeMap::new, |told| told.first_seen),
            conflict_at: record.conflict_at,
            led: led(horizon, record, &closed, &demonstrations, &supplied),
            closed: closed.iter().map(cell_data).collect(),
            first_block: record.stream.as_ref().is_some_and(|stream| stream.place == 0),
            changes,
            targets: targets.into_iter().map(target_data).collect(),
            ground: match &record.stream {
                Some(stream) => stream.world,
                None if record.mismatch == Mismatch::Stock => variant,
                None => 0,
            },
            reference_path: reference
                .iter()
                .flat_map(|reference| reference.states.iter().filter_map(cell_of))
                .collect(),
            seen: came_into_view.into_iter().map(seen).collect(),
            demonstrations,
            supplied,
            states: steps.iter().map(|step| in_words(world, &step.state)).collect(),
            views: file_names(steps.into_iter().map(|step| step.view), false),
            facts: facts(record),
            stages: stages.unwrap_or_default(),
            requests: episode.requests.iter().map(|request| request_data(request)).collect(),
            prompts,
        })
    }

    /// The views that it names: those of the episode, and those of what memory supplied.
    pub fn view_names(&self) -> BTreeSet<&str> {
        let demonstrations = self.demonstrations.iter().flat_map(|one| &one.views);
        self.views.iter().chain(demonstrations).map(String::as_str).collect()
    }

    /// Leaves `most` views of demonstrations: first those of what led into a closed passage and of what was supplied, each with
    /// those that the page shows beside it, then those of the demonstrations in order.
    pub fn limit_demonstration_views(&mut self, most: usize) {
        let led = self.led.iter().map(|led| {
            (led.demonstration, led.from.unwrap_or_else(|| led.enters.saturating_sub(1)))
        });
        let supplied = self.supplied.iter().flatten().map(|&(one, step, _)| (one, step));
        let beside = led.chain(supplied).flat_map(|(demonstration, step)| {
            (step..step.saturating_add(FILM)).map(move |step| (demonstration, step as usize))
        });
        let demonstrations = self.demonstrations.iter().enumerate();
        let all = demonstrations
            .flat_map(|(index, one)| (0..one.views.len()).map(move |step| (index, step)));
        let mut kept = BTreeSet::new();
        for (demonstration, step) in beside.chain(all) {
            if kept.len() == most {
                break;
            }
            if step < self.demonstrations[demonstration].views.len() {
                kept.insert((demonstration, step));
            }
        }
        for (index, one) in self.demonstrations.iter_mut().enumerate() {
            for (step, view) in one.views.iter_mut().enumerate() {
                if !kept.contains(&(index, step)) {
                    view.clear();
                }
            }
        }
    }

    /// Replaces the names of views by those that `name` gives; empty ones are left out.
    pub fn rename_views(&mut self, name: impl Fn(&str) -> Option<String>) {
        let lists = self.demonstrations.iter_mut().map(|one| &mut one.views);
        for list in lists.chain([&mut self.views]) {
            let renamed: Option<Vec<String>> = list.iter().map(|view| name(view)).collect();
            *list = renamed.unwrap_or_default();
        }
    }
}

/// Collects the demonstrations that an episode's memory had.
struct DemonstrationCollector<'a> {
    world: &'a RunWorld,
    record: &'a EpisodeRecord,
    /// The variant of the episode.
    variant: u32,
    found: Vec<(DemonstrationOrigin, DemonstrationData)>,
}

impl DemonstrationCollector<'_> {
    /// The sources by step. One that does not exist is left out.
    fn supplied<'r>(
        &mut self,
        experience: impl Fn(u32) -> Option<&'r EpisodeRecord>,
    ) -> Result<Vec<Vec<Supplied>>> {
        let record = self.record;
        let retrieved = record.retrieved.iter().flat_map(|words| words.split(' '));
        let retrieved: Vec<Vec<SourceStep>> = retrieved.map(sources).collect();
        let case_of = |case: &Option<String>| case.as_ref().unwrap_or(&record.case).clone();
        let named = retrieved.iter().flatten().filter_map(|source| match source {
            SourceStep::Demonstration { case, kind, .. } => Some((case_of(case), *kind)),
            SourceStep::Experience { .. } => None,
        });
        // Streams have no sets.
        if record.stream.is_none() {
            let set = record.condition().control_set().unwrap_or(record.demonstrations);
            for acted in self.act(set, Vec::new())? {
                self.add(acted);
            }
        }
        let missing = named.filter(|(case, kind)| self.known(case, *kind).is_none());
        let missing: BTreeSet<_> = missing.collect();
        let mut more = self.act(Demonstrations::NONE, missing.into_iter().collect())?;
        let told = record.distances.as_deref().unwrap_or_default().split(' ');
        let told = told.map(distances).chain(repeat_with(Vec::new));
        let mut supplied = Vec::new();
        for (sources, told) in retrieved.into_iter().zip(told) {
            let mut of_step = Vec::new();
            for (source, told) in sources.into_iter().zip(told.into_iter().chain(repeat(None))) {
                let found = match source {
                    SourceStep::Demonstration { case, kind, step } => {
                        let case = case_of(&case);
                        let is_it = |one: &ActedDemonstration| one.case == case && one.kind == kind;
                        if let Some(at) = more.iter().position(is_it) {
                            self.add(more.swap_remove(at));
                        }
                        self.known(&case, kind).map(|found| (found, step))
                    }
                    SourceStep::Experience { position, step } => match experience(position) {
                        Some(past) => Some((self.episode(position, past)?, step)),
                        None => None,
                    },
                };
                of_step.extend(found.map(|(found, step)| (found, step, told)));
            }
            supplied.push(of_step);
        }
        Ok(supplied)
    }

    /// Acts out the demonstrations of a set, and `more`.
    fn act(
        &self,
        set: Demonstrations,
        more: Vec<(String, DemonstrationKind)>,
    ) -> Result<Vec<ActedDemonstration>> {
        if set == Demonstrations::NONE && more.is_empty() {
            return Ok(Vec::new());
        }
        self.world.demonstrations(DemonstrationsRequest {
            case: self.record.case.clone(),
            set,
            more,
            variant: self.variant,
            planned: self.is_planned(),
        })
    }

    /// Whether the demonstrations are those that the expert of a stream's block acts out in the world of the episode.
    fn is_planned(&self) -> bool {
        self.record.arm == Arm::Oracle && self.record.stream.is_some()
    }

    /// The index of a demonstration that was found.
    fn known(&self, case: &str, kind: DemonstrationKind) -> Option<usize> {
        let origin = DemonstrationOrigin::Demonstration(case.to_owned(), kind);
        self.found.iter().position(|(known, _)| *known == origin)
    }

    fn add(&mut self, acted: ActedDemonstration) {
        let (case, kind) = (acted.case.clone(), acted.kind);
        let other = if case == self.record.case { String::new() } else { format!(" of {case}") };
        let planned = if self.is_planned() { ", planned in this world" } else { "" };
        let demonstration = DemonstrationData {
            title: match kind.is_reference() {
                true => format!("test reference{other}"),
                false => format!("{} demonstration{other}{planned}", kind.name()),
            },
            episode: None,
            stale: acted.is_stale,
            elsewhere: kind == DemonstrationKind::Elsewhere,
            poses: acted.states.iter().map(pose_data).collect(),
            actions: self.world.declaration().letters(acted.actions.iter().copied().map(Some)),
            views: file_names(self.world.supplied_of(&acted), true),
            at: acted.states,
        };
        self.found.push((DemonstrationOrigin::Demonstration(case, kind), demonstration));
    }

    /// The index of the episode at `position` of the sequence, whose record is `past`.
    fn episode(&mut self, position: u32, past: &EpisodeRecord) -> Result<usize> {
        let origin = DemonstrationOrigin::Episode(position);
        if let Some(known) = self.found.iter().position(|(known, _)| *known == origin) {
            return Ok(known);
        }
        let world = self.world;
        let acted = world.act(past, EpisodeParts::default())?;
        let is_stale = past.is_success() && {
            let here = world.act_in(past, self.variant, begin_of(past), EpisodeParts::default())?;
            here.sub_goals.len() < here.required as usize
        };
        let demonstration = DemonstrationData {
            title: format!("episode at position {position}, {}", past.case),
            episode: Some(past.key.clone()),
            stale: is_stale,
            elsewhere: false,
            poses: acted.states.iter().map(pose_data).collect(),
            actions: past.actions.clone(),
            views: file_names(world.supplied(world.variant(past)?, &acted.states), true),
            at: acted.states,
        };
        self.found.push((origin, demonstration));
        Ok(self.found.len() - 1)
    }
}

/// The names of the files of views.
fn file_names(views: impl IntoIterator<Item = ViewKey>, is_small: bool) -> Vec<String> {
    views.into_iter().map(|view| ViewFile { view, is_small }.name()).collect()
}

/// A state: the names of its numbers, and these in words.
fn in_words(world: &RunWorld, state: &State) -> String {
    let words = world.declaration().state_words(state);
    let words: Vec<String> = words.iter().map(|(name, word)| format!("{name} {word}")).collect();
    words.join(", ")
}

fn target_data(Target { letter, name, cell }: Target) -> TargetData {
    TargetData { letter, name, cell: cell_data(&cell) }
}
/// Looks for the source that leads into a closed cell where the agent tried to enter one: what was supplied for that step and enters a closed cell within
/// the supplied steps; where demonstrations are supplied whole, the first that enters one.
fn led(
    horizon: u32,
    record: &EpisodeRecord,
    closed: &[Cell],
    demonstrations: &[DemonstrationData],
    supplied: &[Vec<Supplied>],
) -> Option<LedData> {
    let tried_at = record.conflict_at? as usize;
    let enters = |demonstration: usize, from: u32, most: u32| {
        let supplied = demonstrations.get(demonstration).filter(|one| !one.elsewhere)?;
        let cells = supplied.at.iter().map(|&state| Some(Pose::try_from(state).ok()?.cell));
        let mut ahead = cells.enumerate().skip(from as usize).take(most as usize + 1);
        let (step, _) = ahead.find(|(_, cell)| cell.is_some_and(|cell| closed.contains(&cell)))?;
        u32::try_from(step).ok()
    };
    if supplied.is_empty() {
        let found =
            (0..demonstrations.len()).find_map(|one| Some((one, enters(one, 0, u32::MAX - 1)?)));
        return found.map(|(demonstration, enters)| LedData { demonstration, from: None, enters });
    }
    let sources = supplied.get(tried_at.checked_sub(1)?)?;
    sources.iter().find_map(|&(demonstration, from, _)| {
        let enters = enters(demonstration, from, horizon)?;
        Some(LedData { demonstration, from: Some(from), enters })
    })
}

fn facts(record: &EpisodeRecord) -> Vec<(&'static str, String)> {
    let mut facts = Vec::new();
    let mut count = |name, value: Option<u64>| {
        facts.extend(value.map(|value| (name, value.to_string())));
    };
    count("Requests", record.requests.map(u64::from));
    count("Images", record.images);
    count("Images left out", Some(record.images_dropped).filter(|&count| count > 0));
    count("Prompt tokens", record.prompt_tokens);
    count("Answer tokens", record.completion_tokens);
    count("Memory tokens, estimated", record.memory_tokens);
    let unread = Some(u64::from(record.unread.total())).filter(|&count| count > 0);
    count("Unreadable answers", unread);
    let dropped = Some(record.memory_items_dropped).filter(|&count| count > 0);
    count("Memory items over budget", dropped);
    if let Some(stream) = &record.stream {
        count("Block of the stream", Some(stream.block.into()));
        count("Learning round", stream.round.map(u64::from));
        count("Sources retrieved", Some(stream.retrievals.into()));
        count("Of them stale", Some(stream.stale.into()));
        count("Memory's store, bytes", stream.store_bytes);
    }
    if let Some(key) = EpisodeKey::read(&record.key).and_then(|key| key.sequence()) {
        facts.push(("Sequence", key));
    }
    facts.push(("Seed", record.seed.to_string()));
    facts
}

fn request_data(request: &RequestRecord) -> RequestData {
    RequestData {
        step: request.step,
        outcome: request.outcome.word(),
        latency_us: request.latency_us,
        images: request.images,
        prompt_tokens: request.prompt_tokens,
        completion_tokens: request.completion_tokens,
        memory_tokens: request.memory_tokens,
        attempts: request.attempts,
        replayed: request.replayed,
    }
}

#[cfg(test)]
mod tests;
