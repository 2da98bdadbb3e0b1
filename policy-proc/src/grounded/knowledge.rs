//! What memory says about one instruction: the documents, and the demonstrations that have been located.
//!
//! All of it is in world coordinates and stays the same from step to step.

use std::hash::{Hash, Hasher};
use std::sync::{Arc, OnceLock};

use domain::{Cell, Pose};
use peer::TextView;
use plates::Landmark;
use rustc_hash::FxHasher;

use super::cache::BoundedCache;
use super::demonstration::RelativePath;
use super::document::ParsedDocument;
use super::geometry::PathStep;
use super::instruction::{FinalCell, ItemKind, NavigationGoal, VisitOrder};
use super::local_map::LocalMap;
use super::perception::rack_of;
use super::tour::Tour;

/// The number of cells of one kind that a tour takes into account.
const MOST_GOALS: usize = 10;

/// Steps after which other parts of the floor are distrusted.
const DOUBT_STEPS: u32 = 45;

/// Distrust in parts of the floor. A plan that has long been without success may lead through a blocked cell that has
/// left the window. Treating some of the floor as unknown, another part each time, leads to other routes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub(super) struct Doubt {
    seed: u64,
    period: u32,
}

impl Doubt {
    pub(super) fn at(step: u32, episode_seed: u64) -> Self {
        let period = step / DOUBT_STEPS;
        // Without doubt, all episodes of a task share their knowledge.
        Self { seed: if period == 0 { 0 } else { episode_seed }, period }
    }

    /// Whether `cell` is in one of the blocks of 4 x 4 cells, a third of all, that are distrusted.
    fn covers(self, cell: Cell) -> bool {
        let mut hasher = FxHasher::default();
        (self, cell.x / 4, cell.y / 4).hash(&mut hasher);
        self.period > 0 && (hasher.finish() >> 32).is_multiple_of(3)
    }
}

/// What is known about one instruction.
#[derive(Debug, Default)]
pub(super) struct Knowledge {
    /// For each target of the instruction, the cells from which one can be reached, sorted.
    pub(super) standpoints: Vec<Vec<Cell>>,
    /// Demonstrated paths: of several, those that reach the most targets.
    pub(super) demonstrations: Vec<Tour>,
    floor: Vec<Cell>,
    racks: Vec<Cell>,
    /// Cells at the ends of the regions in which the targets were seen.
    outlooks: Vec<Cell>,
    /// Where the episode started; if that is unknown, where a demonstration of the task did.
    origin: Option<Cell>,
    goal_tour: OnceLock<Option<Tour>>,
    search_tour: OnceLock<Option<Tour>>,
}

impl Knowledge {
    fn new(
        (instruction, goal): (&str, Option<&NavigationGoal<'_>>),
        (origin, doubt): (Option<Cell>, Doubt),
        documents: &[Arc<ParsedDocument>],
        located: &[(Arc<RelativePath>, Pose)],
    ) -> Self {
        let targets = goal.map_or(&[][..], |goal| &goal.targets);
        let landmarks = located.iter().flat_map(|(known, start)| known.landmarks_from(*start));
        let landmarks: Vec<Landmark> = landmarks.collect();
        let standpoints = targets.iter().map(|&target| {
            let documented = documents.iter().flat_map(|document| document.standpoints(target));
            sorted(documented.chain(standpoints_among(&landmarks, target)))
        });
        let standpoints: Vec<Vec<Cell>> = standpoints.collect();
        let goals = standpoints.concat();

        let paths = located.iter().map(|(known, start)| known.path_from(*start));
        let paths = paths.chain(documents.iter().flat_map(|document| document.routes(instruction)));
        let mut paths: Vec<Vec<PathStep>> = paths.collect();
        let reached = |path: &Vec<PathStep>| targets_reached(path, &standpoints);
        let most = paths.iter().map(reached).max();
        paths.retain(|path| Some(reached(path)) == most);

        let floor = documents.iter().flat_map(|document| document.floor.iter().copied());
        let floor = floor.chain(landmarks.iter().map(|landmark| landmark.standpoint));
        let walked = paths.iter().flatten().map(|step| step.pose.cell);
        let floor = sorted(floor.chain(walked).chain(goals.iter().copied()));
        let regions = documents
            .iter()
            .flat_map(|document| targets.iter().flat_map(|&target| document.regions(target)));
        let outlooks = regions.flat_map(|region| {
            let cells = || region.cells().filter(|cell| floor.binary_search(cell).is_ok());
            cells().min().into_iter().chain(cells().max())
        });
        let start = paths.iter().find_map(|path| path.first()).map(|step| step.pose.cell);
        Self {
            outlooks: sorted(outlooks),
            demonstrations: paths.into_iter().map(|path| Tour::along(path, &goals)).collect(),
            racks: sorted(landmarks.iter().filter_map(rack_of)),
            origin: origin.or(start),
            floor: floor.into_iter().filter(|&cell| !doubt.covers(cell)).collect(),
            standpoints,
            ..Self::default()
        }
    }

    /// Marks what is known on `map`.
    pub(super) fn mark(&self, map: &mut LocalMap) {
        self.floor.iter().for_each(|&cell| map.mark_free(cell));
        self.racks.iter().for_each(|&cell| map.mark_occupied(cell));
    }

    /// A tour that fulfils `goal`, if it is known where everything is.
    pub(super) fn goal_tour(&self, goal: &NavigationGoal<'_>) -> Option<&Tour> {
        let tour = self.goal_tour.get_or_init(|| {
            let mut stages = self.standpoints.clone();
            stages.iter_mut().for_each(|stage| stage.truncate(MOST_GOALS));
            if goal.visit == VisitOrder::Every {
                stages = vec![stages[0].clone(); stages[0].len()];
            }
            let origin = self.origin.filter(|_| goal.ending == FinalCell::Origin);
            stages.extend(origin.map(|cell| vec![cell]));
            self.tour(&stages)
        });
        tour.as_ref()
    }

    /// A tour through the regions in which the targets were seen.
    pub(super) fn search_tour(&self) -> Option<&Tour> {
        let tour = self.search_tour.get_or_init(|| {
            let outlooks = &self.outlooks[..self.outlooks.len().min(MOST_GOALS)];
            self.tour(&vec![outlooks.to_vec(); outlooks.len()])
        });
        tour.as_ref()
    }

    fn tour(&self, stages: &[Vec<Cell>]) -> Option<Tour> {
        let mut map = LocalMap::around(*stages.first()?.first()?);
        self.mark(&mut map);
        Tour::through(stages, &map)
    }
}

fn sorted(cells: impl Iterator<Item = Cell>) -> Vec<Cell> {
    let mut cells: Vec<Cell> = cells.collect();
    cells.sort_unstable();
    cells.dedup();
    cells
}

/// The standpoints of plates of the target kind.
pub(super) fn standpoints_among(
    landmarks: &[Landmark],
    target: ItemKind<'_>,
) -> impl Iterator<Item = Cell> {
    let matching = landmarks.iter().filter(move |landmark| target.matches(landmark.plate));
    matching.map(|landmark| landmark.standpoint)
}

/// How many targets, in order, `path` reaches.
fn targets_reached(path: &[PathStep], standpoints: &[Vec<Cell>]) -> usize {
    let mut cells = path.iter().map(|step| step.pose.cell);
    standpoints.iter().take_while(|group| cells.any(|cell| group.contains(&cell))).count()
}

/// What knowledge is derived from: instruction, origin, doubt, documents, and demonstrations by serial number
/// and start.
type Sources = (String, (Option<Cell>, Doubt), Vec<u128>, Vec<(u64, Pose)>);

/// Parsed documents, and the knowledge derived from them and from demonstrations.
#[derive(Debug, Default)]
pub(super) struct KnowledgeBase {
    documents: BoundedCache<u128, ParsedDocument, 64>,
    known: BoundedCache<Sources, Knowledge, 1024>,
}

impl KnowledgeBase {
    pub(super) fn get(
        &mut self,
        (instruction, goal): (&str, Option<&NavigationGoal<'_>>),
        situation: (Option<Cell>, Doubt),
        documents: &[TextView<'_>],
        located: &[(Arc<RelativePath>, Pose)],
    ) -> Arc<Knowledge> {
        let ids = documents.iter().map(|document| document.id).collect();
        let starts = located.iter().map(|(known, start)| (known.serial, *start)).collect();
        let parsed = &mut self.documents;
        self.known.get((instruction.to_owned(), situation, ids, starts), || {
            let parse = |document: &TextView<'_>| {
                parsed.get(document.id, || ParsedDocument::parse(document.text))
            };
            let documents: Vec<_> = documents.iter().map(parse).collect();
            Knowledge::new((instruction, goal), situation, &documents, located)
        })
    }
}
