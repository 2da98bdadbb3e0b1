//! The data of the run page: conditions, cases, and a row for each episode.

use std::collections::BTreeMap;

use anyhow::Result;
use case_book::{CaseFacts, FailureKind, WorldDeclaration, WorldFacts};
use conditions::Condition;
use run_log::answers::WithoutAction;
use run_log::{EpisodeRecord, RunLog};
use scores::failure_of;
use serde::Serialize;
use world_client::RunWorld;

/// The data of a run.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct RunData {
    name: String,
    /// The policy, as every output names it.
    policy: String,
    facts: Vec<(&'static str, String)>,
    /// Episodes of the whole run.
    planned: u32,
    conditions: Vec<ConditionData>,
    groups: Vec<String>,
    cases: Vec<CaseData>,
    /// Every kind of failure with its meaning. An episode's outcome is 0 for a success, and otherwise 1 + the index of its
    /// failure.
    failures: Vec<(String, String)>,
    /// By the letter in an episode's actions.
    actions: BTreeMap<char, String>,
    /// In words, by number.
    feedback: Vec<String>,
    /// Side of a cell, width of the border, columns and rows of the map.
    map: (f64, f64, u8, u8),
    /// The folder of its views.
    views: String,
    episodes: Vec<EpisodeCell>,
    /// Key and error of each episode that was given up.
    given_up: Vec<(String, String)>,
    /// What the reader must know.
    pub(crate) notices: Vec<String>,
}

#[derive(Debug, Serialize)]
struct ConditionData {
    name: String,
    memory: String,
    /// The memory as people read it, with the author of its documents.
    label: String,
    /// The rest of the name.
    rest: String,
}

#[derive(Debug, Serialize)]
struct CaseData {
    id: String,
    /// Index of its group.
    group: usize,
    /// The name of its type.
    task: String,
    instruction: String,
}

/// An episode: key, index of the condition, index of the case, repetition, outcome, steps, length of the reference, whether
/// its views are there, and its place in a stream or nothing.
pub type EpisodeCell = (String, usize, usize, u32, usize, u32, u32, u8, String);

impl RunData {
    /// The data of `log` with these `conditions`, whose views are in the folder `views`.
    ///
    /// # Errors
    /// When the world does not answer.
    pub fn new(
        log: &RunLog,
        world: &RunWorld,
        conditions: &[Condition],
        views: String,
        has_views: impl Fn(usize) -> bool,
    ) -> Result<Self> {
        let episodes = log.episodes.iter().enumerate();
        let facts_of_world = &world.description().world;
        let declaration = world.declaration();
        let ((columns, rows), (cell, margin)) = match world.has_map() {
            true => {
                let scene = world.scene(0)?;
                (scene.size(), scene.measures)
            }
            false => ((0, 0), (0, 0)),
        };
        let condition = |condition: &Condition| {
            let (name, memory) = (condition.to_string(), condition.memory.to_string());
            let rest = name.strip_prefix(&format!("{memory}/")).unwrap_or_default().to_owned();
            let label = log.manifest.memory_label(condition.memory);
            ConditionData { name, memory, label, rest }
        };
        Ok(Self {
            name: log.name.clone(),
            policy: log.manifest.policy_label().to_string(),
            facts: facts(log),
            planned: log.manifest.episodes,
            conditions: conditions.iter().map(condition).collect(),
            groups: facts_of_world.groups.iter().map(|group| group.name.clone()).collect(),
            cases: world
                .description()
                .cases
                .iter()
                .map(|case| case_data(facts_of_world, case))
                .collect(),
            failures: facts_of_world.failures.iter().map(failure_data).collect(),
            actions: declaration.actions.iter().map(|of| (of.letter, of.words.clone())).collect(),
            feedback: declaration.feedback.clone(),
            map: (cell.into(), margin.into(), columns, rows),
            views,
            episodes: episodes
                .filter_map(|(index, record)| row(world, conditions, record, has_views(index)))
                .collect(),
            given_up: log.errors.iter().map(|one| (one.key.clone(), one.error.clone())).collect(),
            notices: notices(log),
        })
    }
}

fn failure_data(FailureKind { name, words }: &FailureKind) -> (String, String) {
    (name.clone(), words.clone())
}

fn case_data(world: &WorldFacts, case: &CaseFacts) -> CaseData {
    let task = world.task(case.task);
    let group = task.and_then(|task| world.groups.iter().position(|of| of.name == task.group));
    CaseData {
        id: case.id.clone(),
        group: group.unwrap_or(0),
        task: task.map(|task| task.name.clone()).unwrap_or_default(),
        instruction: case.instruction.clone(),
    }
}

/// The row of `record`; `None` if its case or condition is not of this run.
pub fn row(
    world: &RunWorld,
    conditions: &[Condition],
    record: &EpisodeRecord,
    has_views: bool,
) -> Option<EpisodeCell> {
    let condition = record.condition();
    let place = record.stream.as_ref().map(|stream| stream.key_place().to_string());
    Some((
        record.key.clone(),
        conditions.iter().position(|one| *one == condition)?,
        world.index(&record.case)?,
        record.run,
        outcome(&world.description().world, record),
        record.steps,
        record.reference,
        has_views.into(),
        place.unwrap_or_default(),
    ))
}

/// 0 for a success, otherwise 1 + the index of the failure; that of the last kind for one that the world does not list.
pub(super) fn outcome(world: &WorldFacts, record: &EpisodeRecord) -> usize {
    let last = world.failures.len();
    let index = |kind: &str| world.failure_index(kind).map_or(last, |index| 1 + index);
    failure_of(record, world).map_or(0, |failure| index(&failure.kind))
}

fn facts(log: &RunLog) -> Vec<(&'static str, String)> {
    let settings = &log.manifest.settings;
    let mut facts = vec![
        ("Suite", settings.suite.to_string()),
        ("Policy", log.manifest.policy_label().to_string()),
    ];
    facts.extend(settings.model.as_ref().map(|model| ("Model", model.model.clone())));
    if settings.own_world().is_some() {
        let WorldDeclaration { name, version, .. } = &log.world.declaration;
        facts.push(("World", format!("{name} {version}")));
    }
    facts.push(("Seed", settings.seed.to_string()));
    facts.push(("Most steps", settings.max_steps.to_string()));
    facts.push(("Folder", log.dir.display().to_string()));
    facts
}

fn notices(log: &RunLog) -> Vec<String> {
    let mut notices: Vec<String> = log.varies().into_iter().collect();
    let policy = log.manifest.policy_label();
    if policy.role.is_some() {
        notices.push(policy.sentence("Policy"));
    }
    let model = log.manifest.settings.model.as_ref();
    notices.extend(WithoutAction::of_run(log).map(|silent| silent.described(model)));
    if !log.damaged.is_empty() {
        notices.push(format!(
            "{} damaged lines of the log are left out, the first: {}.",
            log.damaged.len(),
            log.damaged[0]
        ));
    }
    notices
}
