//! The case book of a [`Simulator`]: everything is found out by acting out the expert's trajectories.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use case_book::{
    BookRequest, CaseBook, CaseDemonstrations, CaseFacts, Demonstration, DemonstrationBook,
    FailureKind, HARNESS_FAILURES, Reference, TaskFacts, TaskGroupFacts, WorldDeclaration,
    WorldFacts,
};
use domain::{DemonstrationKind, Route, Start};

use super::WorldFailure;
use super::simulator::{CaseDeclaration, Simulator, TrajectoryName};
use super::stage::{ActedTrajectory, Stage, StageBegin};

/// Most different views that a world is taken to have, where it cannot be counted.
const MOST_VIEWS: u32 = domain::limits::MAX_FRAMES;

/// The case book that `request` asks for.
///
/// # Errors
/// What is wrong with the cases: an id that occurs twice, a trajectory that does not complete its task, a set of
/// demonstrations that a case does not have; and what this world cannot do.
pub(super) fn write_books(
    simulator: &(impl Simulator + ?Sized),
    request: &BookRequest,
) -> Result<(CaseBook, DemonstrationBook), WorldFailure> {
    let world = simulator.declaration();
    let cases = simulator.cases()?;
    check_request(&world, &cases, request)?;
    for (index, case) in cases.iter().enumerate() {
        check_case(&world, &cases, index).map_err(|problem| {
            format!("case {} of the world {}: {problem}", case.id, world.name)
        })?;
    }
    let mut stage = Stage::new(simulator.environment()?);
    let mut writer =
        Writer { world: &world, cases: &cases, stage: &mut stage, acted: HashMap::new() };
    let mut book = DemonstrationBook { world: world.clone(), ..DemonstrationBook::default() };
    let mut numbers = PictureNumbers::default();
    let mut of_history = HashMap::new();
    for (number, case) in (0_u32..).zip(&cases) {
        for &name in case.trajectories.keys() {
            let kind = name.demonstration();
            if kind.is_reference() && !is_asked(kind, request) {
                continue;
            }
            of_history.insert((case.id.clone(), kind), book.demonstrations.len() as u32);
            let acted = writer.complete(number, name)?;
            let demonstration = Demonstration {
                case: number,
                kind,
                variant: if name.is_blocked() { 1 + number } else { 0 },
                instruction: case.instruction.clone(),
                states: acted.moments.iter().map(|moment| moment.state).collect(),
                feedback: acted.moments.iter().map(|moment| moment.feedback).collect(),
                sub_goals: acted.sub_goals.clone(),
                actions: case.trajectories[&name][..acted.moments.len() - 1].to_vec(),
                views: acted.moments.iter().map(|moment| numbers.of(moment.state_hash)).collect(),
            };
            book.demonstrations.push(demonstration);
        }
    }
    book.cases = cases.iter().map(|case| demonstrations_of(case, &of_history)).collect();
    // First the original ones of all cases, then the others.
    let of_kind = |kind: DemonstrationKind| {
        let listed = book.cases.iter();
        listed.filter_map(move |of| of.own.get(kind as usize).copied()).collect::<Vec<_>>()
    };
    book.bank_order = DemonstrationKind::OWN.into_iter().flat_map(of_kind).collect();
    let occurring: BTreeSet<u32> = book.demonstrations.iter().map(|of| of.variant).collect();
    let seen = |variant: u32| format!("{} {} {variant}", world.name, world.version);
    book.variants = occurring
        .into_iter()
        .map(|variant| (variant, blake3::hash(seen(variant).as_bytes()).to_hex().to_string()))
        .collect();
    check_sets(&cases, &book, request)?;
    let stale = if request.blocked { writer.stale(&book)? } else { BTreeMap::new() };
    let count = cases.len() as u32;
    let facts: Result<Vec<_>, WorldFailure> =
        (0..count).map(|number| writer.facts(number)).collect();
    let case_book =
        CaseBook { world: world_facts(simulator)?, cases: facts?, streams: None, stale };
    Ok((case_book, book))
}

/// Whether a run is to have this test reference as a demonstration.
fn is_asked(kind: DemonstrationKind, request: &BookRequest) -> bool {
    let mut references = request.demonstrations.iter().filter_map(|set| set.reference());
    references.any(|route| DemonstrationKind::reference(route) == kind)
}

/// What the world is, with the words that figures are named with.
///
/// # Errors
/// When kinds of tasks are not numbered from 1.
pub(super) fn world_facts(
    simulator: &(impl Simulator + ?Sized),
) -> Result<WorldFacts, WorldFailure> {
    let tasks = simulator.tasks();
    if tasks.is_empty() || (1..).zip(&tasks).any(|(number, task)| task.number != number) {
        return Err("the kinds of tasks are not numbered from 1".into());
    }
    let mut groups: Vec<TaskGroupFacts> = Vec::new();
    for TaskFacts { group, .. } in &tasks {
        if groups.iter().all(|known| known.name != *group) {
            groups.push(TaskGroupFacts { name: group.clone(), heading: group.clone() });
        }
    }
    let [unreadable, looped, out_of_steps] = HARNESS_FAILURES.map(FailureKind::new);
    let mut failures = vec![unreadable];
    failures.extend(simulator.failures());
    failures.extend([looped, out_of_steps]);
    Ok(WorldFacts {
        declaration: simulator.declaration(),
        hashes: BTreeMap::new(),
        views: MOST_VIEWS,
        elsewhere_views: 0,
        groups,
        tasks,
        failures,
        mismatches: simulator.mismatches(),
    })
}

/// Case number `number` as the book has it.
///
/// # Errors
/// When a reference does not complete its task.
pub(super) fn case_facts(
    world: &WorldDeclaration,
    cases: &[CaseDeclaration],
    stage: &mut Stage,
    number: u32,
) -> Result<CaseFacts, WorldFailure> {
    Writer { world, cases, stage, acted: HashMap::new() }.facts(number)
}

/// Checks that the world can do what is asked for.
fn check_request(
    world: &WorldDeclaration,
    cases: &[CaseDeclaration],
    request: &BookRequest,
) -> Result<(), WorldFailure> {
    let lacks = [
        (request.assets.is_some(), "other assets"),
        (request.elsewhere.is_some(), "second place in which tasks are demonstrated"),
        (request.streams.is_some(), "streams"),
    ];
    if let Some((_, what)) = lacks.into_iter().find(|(is_asked, _)| *is_asked) {
        return Err(format!("the world {} has no {what}", world.name).into());
    }
    for id in &request.cases {
        let case = cases.iter().find(|case| case.id == *id);
        let known = cases.iter().map(|case| case.id.as_str());
        case.ok_or_else(|| domain::names::UnknownName::new("case", id, known))?;
    }
    let mut part = cases.iter().filter(|case| request.cases.contains(&case.id)).peekable();
    let has_blocked =
        |case: &CaseDeclaration| case.trajectories.contains_key(&TrajectoryName::Blocked);
    if request.blocked && part.peek().is_some() && !part.any(has_blocked) {
        return Err(format!(
            "no case of the world {} that takes part has a blocked route: leave `blocked` out of --routes",
            world.name
        )
        .into());
    }
    Ok(())
}

/// Checks what can be checked without acting anything out.
fn check_case(
    world: &WorldDeclaration,
    cases: &[CaseDeclaration],
    index: usize,
) -> Result<(), String> {
    let case = &cases[index];
    let is_id = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if !(1..=64).contains(&case.id.len()) || !case.id.chars().all(is_id) {
        return Err("its id is not 1 to 64 letters, digits, - and _".to_owned());
    }
    if cases[..index].iter().any(|other| other.id == case.id) {
        return Err("another case has the same id".to_owned());
    }
    if case.instruction.trim().is_empty() {
        return Err("it has no instruction".to_owned());
    }
    for name in [TrajectoryName::Original, TrajectoryName::New] {
        if !case.trajectories.contains_key(&name) {
            return Err(format!("it has no trajectory `{name}`"));
        }
    }
    let own = DemonstrationKind::OWN.map(|kind| {
        let name = TrajectoryName::of(kind);
        name.is_some_and(|name| case.trajectories.contains_key(&name))
    });
    if own.windows(2).any(|two| !two[0] && two[1]) {
        return Err("`nearby` needs `opposite`, and `distant` needs `nearby`".to_owned());
    }
    for (name, actions) in &case.trajectories {
        for &action in actions {
            world.read_action(Some(action)).map_err(|unknown| format!("`{name}`: {unknown}"))?;
        }
    }
    for (set, histories) in [("irrelevant", &case.irrelevant), ("confusable", &case.confusable)] {
        if !matches!(histories.len(), 0 | 2) {
            let count = histories.len();
            return Err(format!("its number of `{set}` histories is {count}, not two or none"));
        }
    }
    for (other, kind) in case.irrelevant.iter().chain(&case.confusable) {
        let named = cases.iter().find(|case| case.id == *other);
        let name = TrajectoryName::of(*kind);
        let exists = named.zip(name).is_some_and(|(of, name)| of.trajectories.contains_key(&name));
        if !exists || kind.is_reference() || *other == case.id {
            let kind = kind.name();
            return Err(format!("its history {other} {kind} is no demonstration of another case"));
        }
    }
    Ok(())
}

/// Checks that every case that takes part has the sets of demonstrations that are asked for.
fn check_sets(
    cases: &[CaseDeclaration],
    book: &DemonstrationBook,
    request: &BookRequest,
) -> Result<(), WorldFailure> {
    for (number, case) in (0..).zip(cases).filter(|(_, case)| request.cases.contains(&case.id)) {
        let has_blocked = case.trajectories.contains_key(&TrajectoryName::Blocked);
        if let Some(set) = book.missing_set(number, &request.demonstrations, has_blocked) {
            return Err(format!("case {} has no {}", case.id, set.in_words()).into());
        }
    }
    Ok(())
}

/// The demonstrations that the sets of a case name.
fn demonstrations_of(
    case: &CaseDeclaration,
    of_history: &HashMap<(String, DemonstrationKind), u32>,
) -> CaseDemonstrations {
    let of = |id: &str, kind| of_history.get(&(id.to_owned(), kind)).copied();
    let histories = |listed: &[(String, DemonstrationKind)]| {
        listed.iter().filter_map(|(id, kind)| of(id, *kind)).collect()
    };
    CaseDemonstrations {
        instruction: case.instruction.clone(),
        paraphrase: case.paraphrase.clone(),
        own: DemonstrationKind::OWN.into_iter().filter_map(|kind| of(&case.id, kind)).collect(),
        irrelevant: histories(&case.irrelevant),
        confusable: histories(&case.confusable),
        after: of(&case.id, DemonstrationKind::After),
        elsewhere: None,
        new: of(&case.id, DemonstrationKind::New),
        blocked: of(&case.id, DemonstrationKind::Blocked),
    }
}

/// Numbers pictures: those of states with the same hash alike, all others apart.
#[derive(Default)]
struct PictureNumbers {
    of_hash: HashMap<u64, u32>,
    next: u32,
}

impl PictureNumbers {
    fn of(&mut self, state_hash: Option<u64>) -> u32 {
        let next = self.next;
        let number = state_hash.map_or(next, |hash| *self.of_hash.entry(hash).or_insert(next));
        self.next += u32::from(number == next);
        number
    }
}

/// Acts trajectories out, each once.
struct Writer<'a> {
    world: &'a WorldDeclaration,
    cases: &'a [CaseDeclaration],
    stage: &'a mut Stage,
    acted: HashMap<(u32, TrajectoryName), ActedTrajectory>,
}

impl Writer<'_> {
    /// The trajectory of a case, which has to complete its task.
    fn complete(
        &mut self,
        number: u32,
        name: TrajectoryName,
    ) -> Result<&ActedTrajectory, WorldFailure> {
        if !self.acted.contains_key(&(number, name)) {
            let acted = self.act(StageBegin::of(number, name), name)?;
            if acted.length().is_none() {
                let (id, steps) = (&self.cases[number as usize].id, acted.moments.len() - 1);
                return Err(format!(
                    "case {id} of the world {}: its trajectory `{name}` does not complete the task in {steps} steps",
                    self.world.name
                )
                .into());
            }
            self.acted.insert((number, name), acted);
        }
        Ok(&self.acted[&(number, name)])
    }

    /// What the actions of a trajectory lead to from `begin`.
    fn act(
        &mut self,
        begin: StageBegin,
        name: TrajectoryName,
    ) -> Result<ActedTrajectory, WorldFailure> {
        let case = &self.cases[begin.case as usize];
        let actions = case.trajectories[&name].iter().copied().map(Some);
        let acted = self.stage.act(self.cases, begin, actions, self.world);
        acted.map_err(|failure| format!("case {}: {failure}", case.id).into())
    }

    fn facts(&mut self, number: u32) -> Result<CaseFacts, WorldFailure> {
        let cases = self.cases;
        let case = &cases[number as usize];
        let tested = [
            (Start::Original, Route::Unchanged),
            (Start::New, Route::Unchanged),
            (Start::New, Route::Blocked),
        ];
        let mut references = Vec::new();
        for (start, route) in tested {
            let name = TrajectoryName::reference(start, route);
            let Some(actions) = case.trajectories.get(&name) else { continue };
            let acted = self.complete(number, name)?;
            references.push(Reference {
                start,
                route,
                begin: acted.moments[0].state,
                actions: actions.clone(),
                length: acted.length().unwrap_or(0),
            });
        }
        let blocked = case.trajectories.contains_key(&TrajectoryName::Blocked);
        let is_stale = blocked && self.is_stale(number, TrajectoryName::Original)?;
        Ok(CaseFacts {
            id: case.id.clone(),
            task: case.task,
            instruction: case.instruction.clone(),
            paraphrase: case.paraphrase.clone(),
            references,
            invalidated_when_blocked: is_stale,
        })
    }

    /// Whether a demonstration of the case does not complete the task where its way is blocked.
    fn is_stale(&mut self, number: u32, name: TrajectoryName) -> Result<bool, WorldFailure> {
        let begin = StageBegin { is_blocked: true, ..StageBegin::of(number, name) };
        Ok(self.act(begin, name)?.length().is_none())
    }

    /// The demonstrations that are stale in each blocked variant: a case's own. Those of other cases take place elsewhere.
    fn stale(
        &mut self,
        book: &DemonstrationBook,
    ) -> Result<BTreeMap<u32, BTreeSet<u32>>, WorldFailure> {
        let mut stale = BTreeMap::new();
        for (number, case) in (0_u32..).zip(self.cases) {
            if !case.trajectories.contains_key(&TrajectoryName::Blocked) {
                continue;
            }
            let mut of_case = BTreeSet::new();
            for &of in &book.cases[number as usize].own {
                let name = TrajectoryName::of(book.demonstrations[of as usize].kind);
                if let Some(name) = name
                    && self.is_stale(number, name)?
                {
                    of_case.insert(of);
                }
            }
            stale.insert(1 + number, of_case);
        }
        Ok(stale)
    }
}
