//! What memory says about one instruction: the documents, and the demonstrations that have been located.
//!
//! All of it is in world coordinates and stays the same from step to step.

use std::hash::{Hash, Hasher};
use std::sync::Arc;

use domain::{Cell, Pose};
use peer::TextView;
use plates::{ItemName, Landmark};
use rustc_hash::FxHasher;

use super::cache::BoundedCache;
use super::demonstration::RelativePath;
use super::document::ParsedDocument;
use super::geometry::{PathStep, sorted};
use super::instruction::NavigationGoal;
use super::local_map::LocalMap;
use super::perception::rack_of;
use super::tour::Tour;

/// Steps after which other parts of the floor are distrusted.
const DOUBT_STEPS: u32 = 45;

/// Distrust in parts of the known floor. A plan that has long been without success may lead through a barricade that has
/// left the window. Distrusting some of the floor, another part each time, leads to other routes.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Doubt {
    seed: u64,
    period: u32,
}

impl Doubt {
    pub(super) const fn at(step: u32, seed: u64) -> Self {
        Self { seed, period: step / DOUBT_STEPS }
    }

    /// Whether `cell` is in one of the blocks of 4 x 4 cells, a third of all, that are distrusted. None is at first.
    fn covers(self, cell: Cell) -> bool {
        self.period > 0 && {
            let mut hasher = FxHasher::default();
            (self, cell.x / 4, cell.y / 4).hash(&mut hasher);
            (hasher.finish() >> 32).is_multiple_of(3)
        }
    }
}

/// What is known about one instruction.
#[derive(Debug)]
pub(super) struct Knowledge {
    /// For each target of the instruction, the cells from which one can be reached, sorted.
    pub(super) standpoints: Vec<Vec<Cell>>,
    /// Demonstrated paths: of several, those that reach the most targets.
    pub(super) demonstrations: Vec<Tour>,
    floor: Vec<Cell>,
    racks: Vec<Cell>,
}

impl Knowledge {
    fn new(
        (instruction, goal): (&str, Option<&NavigationGoal<'_>>),
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
        Self {
            demonstrations: paths.into_iter().map(|path| Tour::along(path, &goals)).collect(),
            racks: sorted(landmarks.iter().filter_map(rack_of)),
            floor,
            standpoints,
        }
    }

    /// Marks what is known on `map`, except the floor that is in doubt.
    pub(super) fn mark(&self, map: &mut LocalMap, doubt: Doubt) {
        self.floor
            .iter()
            .filter(|cell| !doubt.covers(**cell))
            .for_each(|&cell| map.mark_free(cell));
        self.racks.iter().for_each(|&cell| map.mark_occupied(cell));
    }
}

/// The standpoints of plates of the target kind.
pub(super) fn standpoints_among(
    landmarks: &[Landmark],
    target: ItemName<'_>,
) -> impl Iterator<Item = Cell> {
    let is_target = target.matcher();
    let matching = landmarks.iter().filter(move |landmark| is_target(landmark.plate));
    matching.map(|landmark| landmark.standpoint)
}

/// How many targets, in order, `path` reaches.
fn targets_reached(path: &[PathStep], standpoints: &[Vec<Cell>]) -> usize {
    let mut cells = path.iter().map(|step| step.pose.cell);
    standpoints.iter().take_while(|group| cells.any(|cell| group.contains(&cell))).count()
}

/// What knowledge is derived from: instruction, documents, and demonstrations by serial number and start.
type KnowledgeSources = (String, Vec<u128>, Vec<(u64, Pose)>);

/// Parsed documents, and the knowledge derived from them and from demonstrations.
#[derive(Debug, Default)]
pub(super) struct KnowledgeBase {
    documents: BoundedCache<u128, ParsedDocument, 64>,
    known: BoundedCache<KnowledgeSources, Knowledge, 1024>,
}

impl KnowledgeBase {
    pub(super) fn get(
        &mut self,
        (instruction, goal): (&str, Option<&NavigationGoal<'_>>),
        documents: &[TextView<'_>],
        located: &[(Arc<RelativePath>, Pose)],
    ) -> Arc<Knowledge> {
        let ids = documents.iter().map(|document| document.id).collect();
        let starts = located.iter().map(|(known, start)| (known.serial, *start)).collect();
        let parsed = &mut self.documents;
        self.known.get((instruction.to_owned(), ids, starts), || {
            let parse = |document: &TextView<'_>| {
                parsed.get(document.id, || ParsedDocument::parse(document.text))
            };
            let documents: Vec<_> = documents.iter().map(parse).collect();
            Knowledge::new((instruction, goal), &documents, located)
        })
    }
}
