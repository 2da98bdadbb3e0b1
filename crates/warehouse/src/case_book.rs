//! Writes the case book: what a run knows about the cases of this world, as data (crate `case-book`).

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use case_book::{
    BookRequest, CaseBook, CaseDemonstrations, CaseFacts, CaseInState, Demonstration,
    DemonstrationBook, ElsewhereRequest, Reference, StreamBlock, StreamDemonstrations, StreamFacts,
    StreamsFacts, StreamsRequest, TaskFacts, TaskGroupFacts, WorldFacts,
};
use domain::names::UnknownName;
use domain::{
    Action, Cell, DemonstrationKind, Demonstrations, Mismatch, Mixture, Pose, Route, Start, State,
    StreamOrder,
};

use crate::asset::AssetError;
use crate::case::{Case, CaseSet, History, TrajectoryKind};
use crate::case_file::CASES_FILE;
use crate::declaration::declaration;
use crate::dynamics::Variant;
use crate::elsewhere::{ELSEWHERE_VARIANT, Elsewhere};
use crate::elsewhere_source::ElsewhereError;
use crate::failure::failure_kinds;
use crate::plan::{Planner, Prices};
use crate::state::WorldState;
use crate::stream::{StreamError, StreamSet};
use crate::task_type::{TaskGroup, TaskType};
use crate::trajectory::Trajectory;
use crate::world::{CATALOGUE_FILE, LAYOUT_FILE, Warehouse};

/// The name of this world in case books.
pub const WORLD_NAME: &str = case_book::WAREHOUSE;

/// The version of its rules: what an action does, and when a task is complete.
pub const WORLD_VERSION: &str = "1";

/// Files whose contents determine the outcome of a run: name of the hash, file, built-in text.
const HASHED: [(&str, &str, &[u8]); 4] = [
    ("layout", LAYOUT_FILE, include_bytes!("../../../assets/layout.toml")),
    ("catalogue", CATALOGUE_FILE, include_bytes!("../../../assets/catalogue.toml")),
    ("cases", CASES_FILE, include_bytes!("../../../assets/cases.toml")),
    ("models", "models.toml", include_bytes!("../../../assets/models.toml")),
];

/// The files of a case book.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Books {
    /// For those who run, score and show episodes.
    pub cases: CaseBook,
    /// For memory.
    pub demonstrations: DemonstrationBook,
    /// The text of `streams.json`, for a run that consists of streams.
    pub streams: Option<String>,
    /// The text of `elsewhere.json`, for a run with another warehouse.
    pub elsewhere: Option<String>,
}

/// Why a case book cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum CaseBookError {
    /// The assets cannot be used.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// There is no such case.
    #[error(transparent)]
    UnknownCase(#[from] UnknownName),
    /// The other warehouse cannot be used.
    #[error(transparent)]
    Elsewhere(#[from] ElsewhereError),
    /// The streams cannot be drawn.
    #[error(transparent)]
    Streams(#[from] StreamError),
    /// A bank is larger than the number of demonstrations.
    #[error("the cases have {largest} demonstrations, too few for {set}")]
    BankTooLarge {
        /// The set.
        set: Demonstrations,
        /// All that there are.
        largest: usize,
    },
    /// A set takes place in another warehouse, and the request names none.
    #[error(
        "the demonstrations `{}` need another world, and the request names none",
        Demonstrations::ELSEWHERE
    )]
    NoElsewhere,
    /// A case of a stream cannot be solved in one of its worlds.
    #[error("case {case} cannot be solved in world {world} of the streams")]
    Unsolvable {
        /// The case's id.
        case: String,
        /// The index of the world.
        world: u32,
    },
}

/// The case book that `request` asks for. The same request and assets give the same book.
///
/// # Errors
/// Assets that cannot be used, an unknown case, a set of demonstrations or streams that the cases do not allow.
pub fn write_books(request: &BookRequest) -> Result<Books, CaseBookError> {
    let assets = request.assets.as_deref();
    let (warehouse, mut cases) = CaseSet::with_warehouse(assets)?;
    let index = |id: &String| cases.index(id).ok_or_else(|| unknown_case(id, &cases));
    // In the order of the cases, whatever that of the request.
    let among: BTreeSet<usize> = request.cases.iter().map(index).collect::<Result<_, _>>()?;
    let among: Vec<usize> = among.into_iter().collect();
    if let Some(ElsewhereRequest { assets, seed }) = &request.elsewhere {
        cases.elsewhere = Some(match assets {
            Some(folder) => Elsewhere::load(folder, &warehouse, &cases, *seed)?,
            None => Elsewhere::generate(&warehouse, &cases, *seed)?,
        });
    }
    check_sets(request, &cases)?;
    let streams = request.streams.as_ref().map(|StreamsRequest { rules, seed, .. }| {
        StreamSet::draw(&warehouse, &cases, &among, *seed, rules)
    });
    let worlds = Worlds::new(&warehouse, &cases, streams.transpose()?)?;
    let demonstrations = Writer::new(&worlds).write(request);
    let streams = worlds.streams_facts()?;
    let elsewhere = cases.elsewhere.as_ref();
    let book = CaseBook {
        world: world_facts(assets, &warehouse, &cases)?,
        cases: case_facts(&warehouse, &cases.cases),
        streams,
        stale: stale(&worlds, &demonstrations, request, &among),
    };
    Ok(Books {
        cases: book,
        demonstrations,
        streams: worlds.streams.as_ref().map(StreamSet::to_text),
        elsewhere: elsewhere.map(Elsewhere::to_text),
    })
}

fn unknown_case(id: &str, cases: &CaseSet) -> UnknownName {
    UnknownName::new("case", id, cases.cases.iter().map(|case| case.id.as_str()))
}

/// Checks that the requested sets exist.
fn check_sets(request: &BookRequest, cases: &CaseSet) -> Result<(), CaseBookError> {
    let largest = cases.largest_bank();
    for &set in &request.demonstrations {
        if set.bank_size().is_some_and(|size| usize::from(size) > largest) {
            return Err(CaseBookError::BankTooLarge { set, largest });
        }
        if set.take_place_elsewhere() && cases.elsewhere.is_none() {
            return Err(CaseBookError::NoElsewhere);
        }
    }
    Ok(())
}

/// What identifies the world of these assets.
pub(crate) fn world_facts(
    assets: Option<&Path>,
    warehouse: &Warehouse,
    cases: &CaseSet,
) -> Result<WorldFacts, AssetError> {
    let elsewhere = cases.elsewhere.as_ref();
    Ok(WorldFacts {
        declaration: declaration(),
        hashes: asset_hashes(assets)?,
        views: view_count(warehouse),
        elsewhere_views: elsewhere.map_or(0, |other| view_count(other.warehouse())),
        groups: TaskGroup::ALL.map(group_facts).into(),
        tasks: TaskType::ALL.map(task_facts).into(),
        failures: failure_kinds(),
        mismatches: Mismatch::ALL.iter().copied().filter(|one| *one != Mismatch::None).collect(),
    })
}

fn group_facts(group: TaskGroup) -> TaskGroupFacts {
    let heading = match group {
        TaskGroup::Basic => "Basic (T1–T2)",
        TaskGroup::MultiObject => "Multi-object (T3–T6)",
        TaskGroup::ReturnLoop => "Return loops (T7, T8, T10)",
        TaskGroup::Revisit => "Revisit (T9)",
    };
    TaskGroupFacts { name: group.name().to_owned(), heading: heading.to_owned() }
}

fn task_facts(task: TaskType) -> TaskFacts {
    TaskFacts {
        number: task.number(),
        name: task.name().to_owned(),
        group: task.group().name().to_owned(),
    }
}

/// BLAKE3 of the assets, in hexadecimal digits, by name.
fn asset_hashes(assets: Option<&Path>) -> Result<BTreeMap<String, String>, AssetError> {
    let mut hashes = BTreeMap::new();
    for (name, file, built_in) in HASHED {
        let own = assets.map(|folder| folder.join(file)).filter(|path| path.exists());
        let hash = match own {
            None => blake3::hash(built_in),
            Some(path) => {
                let unreadable =
                    |source| AssetError::Unreadable { file: path.display().to_string(), source };
                blake3::hash(&durable::input::read(&path).map_err(unreadable)?)
            }
        };
        hashes.insert(name.to_owned(), hash.to_hex().to_string());
    }
    Ok(hashes)
}

/// Views of a hall: one for each heading on each free cell.
fn view_count(warehouse: &Warehouse) -> u32 {
    4 * warehouse.layout.free_cells().count() as u32
}

pub(crate) fn case_facts(warehouse: &Warehouse, cases: &[Case]) -> Vec<CaseFacts> {
    cases.iter().enumerate().map(|(number, case)| facts_of_case(warehouse, number, case)).collect()
}

fn facts_of_case(warehouse: &Warehouse, number: usize, case: &Case) -> CaseFacts {
    let tested = [
        (Start::Original, Route::Unchanged),
        (Start::New, Route::Unchanged),
        (Start::New, Route::Blocked),
    ];
    let references = tested.map(|(start, route)| {
        let from = TrajectoryKind::reference(start, route);
        let trajectory = case.trajectory(from);
        Reference {
            start,
            route,
            begin: trajectory.start.into(),
            actions: converted(&trajectory.actions),
            length: case.replay(warehouse, from).length.unwrap_or(0),
        }
    });
    let blocked = case.variant(TrajectoryKind::Blocked);
    CaseFacts {
        id: case.id.clone(),
        task: case.task.task_type().number(),
        instruction: case.task.instruction(&warehouse.catalogue),
        paraphrase: Some(case.task.paraphrase(&warehouse.catalogue, number)),
        references: references.into(),
        invalidated_when_blocked: case
            .original
            .replay(warehouse, &case.task, &blocked)
            .length
            .is_none(),
    }
}

/// The worlds of a run.
struct Worlds<'a> {
    warehouse: &'a Warehouse,
    cases: &'a CaseSet,
    streams: Option<StreamSet>,
    /// Those of the streams.
    states: Vec<WorldState>,
}

impl<'a> Worlds<'a> {
    fn new(
        warehouse: &'a Warehouse,
        cases: &'a CaseSet,
        streams: Option<StreamSet>,
    ) -> Result<Self, StreamError> {
        let states = match &streams {
            None => Vec::new(),
            Some(set) => {
                set.check(warehouse, cases)?;
                set.states(warehouse)?
            }
        };
        Ok(Self { warehouse, cases, streams, states })
    }

    /// The stock and the closed cells of the variant with this number.
    fn state(&self, variant: u32) -> (&Warehouse, Variant) {
        let unchanged = (self.warehouse, Variant::UNCHANGED);
        if variant == ELSEWHERE_VARIANT {
            let other = self.cases.elsewhere.as_ref().map(Elsewhere::warehouse);
            return (other.unwrap_or(self.warehouse), Variant::UNCHANGED);
        }
        let Some(index) = (variant as usize).checked_sub(1) else { return unchanged };
        match self.cases.cases.get(index) {
            Some(case) => (self.warehouse, case.variant(TrajectoryKind::Blocked)),
            None => {
                let state = self.states.get(index - self.cases.cases.len());
                state.map_or(unchanged, |state| (&state.warehouse, state.variant.clone()))
            }
        }
    }

    fn streams_facts(&self) -> Result<Option<StreamsFacts>, CaseBookError> {
        let Some(set) = &self.streams else { return Ok(None) };
        let streams = (0..).zip(&set.streams).map(|(number, stream)| {
            let blocks = stream.blocks.iter();
            let blocks =
                blocks.map(|block| StreamBlock { world: block.world, cases: block.cases.clone() });
            let shuffled = set.order(number, StreamOrder::Shuffled);
            StreamFacts { blocks: blocks.collect(), shuffled }
        });
        let count = self.cases.cases.len();
        let numbers = 0..set.worlds.len() as u32;
        Ok(Some(StreamsFacts {
            hash: blake3::hash(set.to_text().as_bytes()).to_hex().to_string(),
            streams: streams.collect(),
            variants: numbers.clone().map(|world| set.variant(world, count)).collect(),
            states: numbers
                .map(|world| self.cases_in(set, world))
                .collect::<Result<_, CaseBookError>>()?,
        }))
    }

    /// The cases that take place in world `world` of the streams.
    fn cases_in(
        &self,
        set: &StreamSet,
        world: u32,
    ) -> Result<BTreeMap<u32, CaseInState>, CaseBookError> {
        let state = &self.states[world as usize];
        let expert = state.expert();
        let blocks = set.streams.iter().flat_map(|stream| &stream.blocks);
        let listed: BTreeSet<u32> = blocks
            .filter(|block| block.world == world)
            .flat_map(|block| block.cases.iter().copied())
            .collect();
        let in_state = |number: u32| {
            let case = &self.cases.cases[number as usize];
            let reference = state.reference(&expert, &case.task, case.test.start);
            let (Trajectory { start, actions }, length) = reference
                .ok_or_else(|| CaseBookError::Unsolvable { case: case.id.clone(), world })?;
            let invalidated = !state.completes(&case.original, &case.task);
            let (begin, actions) = (start.into(), converted(&actions));
            Ok((number, CaseInState { begin, actions, length, invalidated }))
        };
        listed.into_iter().map(in_state).collect()
    }
}

/// What a view shows beside the agent's pose: which hall, what stands on its shelves, and the closed cells.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct VisibleParts {
    is_elsewhere: bool,
    stock: Vec<(Cell, usize)>,
    closed: Vec<Cell>,
}

/// Collects the demonstrations of a book.
struct Writer<'w> {
    worlds: &'w Worlds<'w>,
    book: DemonstrationBook,
    /// What is visible in each variant that occurs, as an index; equal for variants that look the same.
    parts_of: HashMap<u32, usize>,
    parts: HashMap<VisibleParts, usize>,
    views: HashMap<(usize, State), u32>,
}

impl<'w> Writer<'w> {
    fn new(worlds: &'w Worlds<'w>) -> Self {
        Self {
            worlds,
            book: DemonstrationBook { world: declaration(), ..DemonstrationBook::default() },
            parts_of: HashMap::new(),
            parts: HashMap::new(),
            views: HashMap::new(),
        }
    }

    fn write(mut self, request: &BookRequest) -> DemonstrationBook {
        let Worlds { warehouse, cases, .. } = *self.worlds;
        // Each case's own four first, so that the place of a history follows from its case and kind.
        for case in 0..cases.cases.len() {
            for kind in DemonstrationKind::OWN {
                self.add_history(History { case, kind });
            }
        }
        let own = |history: History| {
            (DemonstrationKind::OWN.len() * history.case + history.kind as usize) as u32
        };
        let are_after = request.demonstrations.iter().any(|set| set.take_place_after());
        for (index, case) in cases.cases.iter().enumerate() {
            let after =
                are_after.then_some(History { case: index, kind: DemonstrationKind::After });
            let after = after.and_then(|of| self.add_history(of));
            let elsewhere =
                self.add_history(History { case: index, kind: DemonstrationKind::Elsewhere });
            let mut reference = |route| {
                let is_asked =
                    request.demonstrations.iter().any(|set| set.reference() == Some(route));
                let kind = DemonstrationKind::reference(route);
                is_asked.then(|| self.add_history(History { case: index, kind })).flatten()
            };
            let [new, blocked] = [Route::Unchanged, Route::Blocked].map(&mut reference);
            let of = DemonstrationKind::OWN.map(|kind| own(History { case: index, kind }));
            self.book.cases.push(CaseDemonstrations {
                instruction: case.task.instruction(&warehouse.catalogue),
                paraphrase: Some(case.task.paraphrase(&warehouse.catalogue, index)),
                own: of.into(),
                irrelevant: case.mixed(Mixture::Irrelevant).map(own).into(),
                confusable: case.mixed(Mixture::Confusable).map(own).into(),
                after,
                elsewhere,
                new,
                blocked,
            });
        }
        self.book.bank_order = cases.bank_order().into_iter().map(own).collect();
        let is_planned = request.streams.as_ref().is_some_and(|streams| streams.planned);
        self.add_streams(if is_planned { &request.demonstrations } else { &[] });
        for variant in self.worlds.streams_variants() {
            self.parts(variant);
        }
        self.book.variants = self.variant_hashes();
        self.book
    }

    /// Adds what the memories of streams are built from, with the own demonstrations of `planned` planned for each block.
    fn add_streams(&mut self, planned: &[Demonstrations]) {
        let worlds = self.worlds;
        let Some(set) = &worlds.streams else { return };
        let kinds: BTreeSet<DemonstrationKind> = planned.iter().flat_map(|set| set.own()).collect();
        let mut known: BTreeMap<(u32, u32), Vec<u32>> = BTreeMap::new();
        for stream in &set.streams {
            let cases = stream.cases();
            let mut of_blocks = Vec::new();
            for block in stream.blocks.iter().filter(|_| !kinds.is_empty()) {
                let variant = set.variant(block.world, worlds.cases.cases.len());
                let unknown: Vec<u32> = cases
                    .iter()
                    .copied()
                    .filter(|&case| !known.contains_key(&(variant, case)))
                    .collect();
                let (warehouse, closed) = worlds.state(variant);
                let planner = Planner::new(warehouse, closed.clone(), Prices::EXPERT);
                for case in unknown {
                    let made = kinds.iter().filter_map(|&kind| {
                        self.add_planned(&planner, (warehouse, &closed), variant, case, kind)
                    });
                    known.insert((variant, case), made.collect());
                }
                let listed = cases.iter().filter_map(|&case| known.get(&(variant, case)));
                of_blocks.push(listed.flatten().copied().collect());
            }
            self.book.streams.push(StreamDemonstrations { cases, planned: of_blocks });
        }
    }

    /// The demonstration that an expert who knows the variant gives from where the case's own one begins. `None` if it cannot
    /// be planned.
    fn add_planned(
        &mut self,
        planner: &Planner<'_>,
        (warehouse, closed): (&Warehouse, &Variant),
        variant: u32,
        number: u32,
        kind: DemonstrationKind,
    ) -> Option<u32> {
        let case = self.worlds.cases.cases.get(number as usize)?;
        let own = case.trajectory(TrajectoryKind::demonstration(kind)?);
        if closed.is_closed(own.start.cell) {
            return None;
        }
        let trajectory = planner.plan(own.start, &case.task)?;
        if variant == 0 && trajectory == *own {
            return self.book.cases.get(number as usize)?.own.get(kind as usize).copied();
        }
        let replay = trajectory.replay(warehouse, &case.task, closed);
        Some(self.add(Demonstration {
            case: number,
            kind,
            variant,
            instruction: case.task.instruction(&self.worlds.warehouse.catalogue),
            states: converted(&replay.poses),
            feedback: converted(&replay.feedback),
            sub_goals: replay.goal_steps,
            actions: converted(&trajectory.actions),
            views: Vec::new(),
        }))
    }

    /// Adds a demonstration of the set of cases, if there is such a one.
    fn add_history(&mut self, history: History) -> Option<u32> {
        let of = self.worlds.cases.demonstrated(self.worlds.warehouse, history)?;
        let replay = of.replay();
        Some(self.add(Demonstration {
            case: history.case as u32,
            kind: history.kind,
            variant: of.variant,
            instruction: of.instruction(),
            states: converted(&replay.poses),
            feedback: converted(&replay.feedback),
            sub_goals: replay.goal_steps,
            actions: converted(&of.trajectory.actions),
            views: Vec::new(),
        }))
    }

    /// Adds `demonstration` with the numbers of its views.
    fn add(&mut self, mut demonstration: Demonstration) -> u32 {
        let parts = self.parts(demonstration.variant);
        let numbers = demonstration.states.iter().map(|&state| {
            let next = self.views.len() as u32;
            *self.views.entry((parts, state)).or_insert(next)
        });
        demonstration.views = numbers.collect();
        self.book.demonstrations.push(demonstration);
        self.book.demonstrations.len() as u32 - 1
    }

    /// The number of what is visible in `variant`.
    fn parts(&mut self, variant: u32) -> usize {
        if let Some(&known) = self.parts_of.get(&variant) {
            return known;
        }
        let (warehouse, closed) = self.worlds.state(variant);
        let parts = VisibleParts {
            is_elsewhere: variant == ELSEWHERE_VARIANT,
            stock: warehouse.items.iter().map(|item| (item.standpoint, item.item_type)).collect(),
            closed: closed.closed().to_vec(),
        };
        let next = self.parts.len();
        let number = *self.parts.entry(parts).or_insert(next);
        self.parts_of.insert(variant, number);
        number
    }

    /// Hashes of what is visible in the variants that occur.
    fn variant_hashes(&self) -> BTreeMap<u32, String> {
        let by_number: HashMap<usize, &VisibleParts> =
            self.parts.iter().map(|(parts, &number)| (number, parts)).collect();
        let hashed = self.parts_of.iter().filter_map(|(&variant, number)| {
            let parts = by_number.get(number)?;
            let hall = match &self.worlds.cases.elsewhere {
                Some(other) if parts.is_elsewhere => other.warehouse(),
                _ => self.worlds.warehouse,
            };
            Some((variant, hash_of(hall, parts)))
        });
        hashed.collect()
    }
}

/// BLAKE3 of the floor plan, the catalogue, the items and the closed cells, in hexadecimal digits.
fn hash_of(hall: &Warehouse, parts: &VisibleParts) -> String {
    let Warehouse { layout, catalogue, .. } = hall;
    let mut hasher = blake3::Hasher::new();
    let described = format!("{layout:?} {catalogue:?} {:?} {:?}", parts.stock, parts.closed);
    hasher.update(described.as_bytes());
    hasher.finalize().to_hex().to_string()
}

impl Worlds<'_> {
    /// The variants of the streams, each once.
    fn streams_variants(&self) -> BTreeSet<u32> {
        let worlds = 0..self.states.len() as u32;
        let variant = |world| Some(self.streams.as_ref()?.variant(world, self.cases.cases.len()));
        worlds.filter_map(variant).collect()
    }
}

/// For each variant in which demonstrations can be stale, those that can be retrieved there and are.
fn stale(
    worlds: &Worlds<'_>,
    book: &DemonstrationBook,
    request: &BookRequest,
    among: &[usize],
) -> BTreeMap<u32, BTreeSet<u32>> {
    let mut found: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
    if request.blocked {
        let suspects = Suspects::new(worlds, book);
        for &case in among {
            let retrieved = retrievable(book, &request.demonstrations, [case as u32]);
            let variant = 1 + case as u32;
            let (_, closed) = worlds.state(variant);
            let stale = found.entry(variant).or_default();
            let suspects = suspects.of(&closed).filter(|&of| retrieved[of as usize]);
            stale.extend(suspects.filter(|&of| is_stale(worlds, book, of, variant)));
        }
    }
    for (stream, of) in worlds.streams.iter().flat_map(|set| set.streams.iter().zip(&book.streams))
    {
        let mut retrieved = retrievable(book, &request.demonstrations, of.cases.iter().copied());
        // The arm that learns from other tasks.
        let listed = of.cases.iter().filter_map(|&case| book.cases.get(case as usize));
        for &irrelevant in listed.flat_map(|case| &case.irrelevant) {
            retrieved[irrelevant as usize] = true;
        }
        let variants: BTreeSet<u32> = stream
            .blocks
            .iter()
            .filter_map(|block| {
                Some(worlds.streams.as_ref()?.variant(block.world, worlds.cases.cases.len()))
            })
            .collect();
        for variant in variants {
            let all = (0_u32..).zip(&retrieved).filter(|(_, is_retrieved)| **is_retrieved);
            let stale = found.entry(variant).or_default();
            stale.extend(all.map(|(of, _)| of).filter(|&of| is_stale(worlds, book, of, variant)));
        }
    }
    found
}

/// By demonstration: whether a memory of these cases can hold it.
fn retrievable(
    book: &DemonstrationBook,
    sets: &[Demonstrations],
    cases: impl IntoIterator<Item = u32>,
) -> Vec<bool> {
    let mut retrieved = vec![false; book.demonstrations.len()];
    for case in cases {
        for of in sets.iter().filter_map(|&set| book.of_case(case, set)).flatten() {
            retrieved[of as usize] = true;
        }
    }
    retrieved
}

/// Whether a demonstration, acted out in `variant`, does not complete its task. What took place in another hall was never
/// true of this one.
fn is_stale(worlds: &Worlds<'_>, book: &DemonstrationBook, of: u32, variant: u32) -> bool {
    let of = &book.demonstrations[of as usize];
    if of.variant == ELSEWHERE_VARIANT {
        return false;
    }
    let Some((case, trajectory)) = worlds.cases.cases.get(of.case as usize).zip(trajectory_of(of))
    else {
        return false;
    };
    let (warehouse, closed) = worlds.state(variant);
    trajectory.replay(warehouse, &case.task, &closed).length.is_none()
}

/// The trajectory of a demonstration that this world has written.
fn trajectory_of(of: &Demonstration) -> Option<Trajectory> {
    let start = Pose::try_from(*of.states.first()?).ok()?;
    let actions = of.actions.iter().map(|&action| Action::try_from(action).ok());
    Some(Trajectory { start, actions: actions.collect::<Option<_>>()? })
}

/// Poses, actions or feedback as what any world has.
pub(crate) fn converted<T: Copy + Into<U>, U>(values: &[T]) -> Vec<U> {
    values.iter().map(|&value| value.into()).collect()
}

/// Which demonstrations closed cells can make stale.
struct Suspects {
    /// By cell, the demonstrations of the unchanged world that come to it.
    by_cell: HashMap<Cell, Vec<u32>>,
    /// Those that any variant can: they took place in another one, or do not complete their task in the unchanged world.
    others: Vec<u32>,
}

impl Suspects {
    fn new(worlds: &Worlds<'_>, book: &DemonstrationBook) -> Self {
        let mut suspects = Self { by_cell: HashMap::new(), others: Vec::new() };
        for (number, of) in (0..).zip(&book.demonstrations) {
            if of.variant != 0 || is_stale(worlds, book, number, 0) {
                suspects.others.push(number);
                continue;
            }
            let poses = of.states.iter().filter_map(|&state| Pose::try_from(state).ok());
            let cells: BTreeSet<Cell> = poses.map(|pose| pose.cell).collect();
            for cell in cells {
                suspects.by_cell.entry(cell).or_default().push(number);
            }
        }
        suspects
    }

    /// Those that can be stale where the cells of `variant` are closed: all others take the same way as in the unchanged
    /// world. One may be named more than once.
    fn of<'s>(&'s self, variant: &'s Variant) -> impl Iterator<Item = u32> + 's {
        let met = variant.closed().iter().filter_map(|cell| self.by_cell.get(cell)).flatten();
        met.chain(&self.others).copied()
    }
}

#[cfg(test)]
mod tests;
