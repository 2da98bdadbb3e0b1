//! What the documents of a request say about what its instruction asks for.
//!
//! A document never changes, so it is taken apart once, and asked once for each instruction.

use std::sync::Arc;

use domain::{Cell, Heading};
use rustc_hash::FxHashMap;
use shm_types::message::DocumentId;

use super::chart::PathStep;
use super::document::{Atlas, Rect, Route, straight};
use super::geometry::along;
use super::instruction::Goal;
use crate::{DocumentView, Request};

/// Documents that are kept.
const MOST_ATLASES: usize = 64;

/// Pairs of documents and instruction that are kept.
const MOST_KEPT: usize = 1024;

/// Most steps of a route that are kept.
const LONGEST_ROUTE: usize = 400;

/// What documents say about one instruction.
#[derive(Debug, Default)]
pub(super) struct Lore {
    /// Names it among the lores of one policy; 0 where there is no document.
    pub(super) serial: u64,
    /// For each thing wanted, in order: cells to stand on.
    pub(super) standpoints: Vec<Vec<Cell>>,
    /// For each thing wanted, in order: where to look for it.
    pub(super) regions: Vec<Vec<Rect>>,
    /// Cells that can be walked on.
    pub(super) floor: Vec<Cell>,
    /// Routes that were walked for the very instruction.
    pub(super) routes: Vec<Vec<PathStep>>,
}

impl Lore {
    fn of(serial: u64, atlases: &[Arc<Atlas>], instruction: &str) -> Self {
        let wants = Goal::parse(instruction).map(|goal| goal.wants()).unwrap_or_default();
        let mut lore = Self { serial, ..Self::default() };
        for want in wants {
            let mut cells: Vec<_> =
                atlases.iter().flat_map(|atlas| atlas.standpoints(want)).collect();
            cells.sort_unstable();
            cells.dedup();
            lore.standpoints.push(cells);
            lore.regions.push(atlases.iter().flat_map(|atlas| atlas.regions(want)).collect());
        }
        for atlas in atlases {
            lore.floor.extend(atlas.passages.iter().flat_map(|rect| rect.cells()));
            lore.floor.extend(atlas.walked());
            lore.routes.extend(atlas.routes(instruction).filter_map(walk));
        }
        lore.floor.extend(lore.standpoints.iter().flatten());
        lore.floor.sort_unstable();
        lore.floor.dedup();
        lore
    }
}

/// A route as poses and actions, facing the way that is walked.
fn walk(route: &Route) -> Option<Vec<PathStep>> {
    let mut cells = route.cells();
    cells.truncate(LONGEST_ROUTE);
    let (&first, rest) = cells.split_first()?;
    let ahead = rest.first().and_then(|&next| straight(first, next));
    let facing = route.facing.or(ahead).unwrap_or(Heading::N);
    let start = domain::Pose { cell: first, heading: facing };
    let legs = cells.windows(2).filter_map(|leg| straight(leg[0], leg[1]));
    let mut steps = Vec::new();
    let end = along(start, legs, &mut steps);
    steps.push(PathStep { pose: end, action: None });
    Some(steps)
}

/// Lores and what they are made from.
#[derive(Debug, Default)]
pub(super) struct Lores {
    atlases: FxHashMap<DocumentId, Arc<Atlas>>,
    kept: FxHashMap<Vec<DocumentId>, FxHashMap<String, Arc<Lore>>>,
    made: u64,
    nothing: Arc<Lore>,
}

impl Lores {
    /// What the documents of `request` say about its instruction.
    pub(super) fn of(&mut self, request: &Request<'_>) -> Arc<Lore> {
        if request.documents.is_empty() {
            return Arc::clone(&self.nothing);
        }
        let ids: Vec<DocumentId> = request.documents.iter().map(|document| document.id).collect();
        let known = self.kept.get(&ids).and_then(|kept| kept.get(request.instruction));
        if let Some(lore) = known {
            return Arc::clone(lore);
        }
        if self.made.is_multiple_of(MOST_KEPT as u64) {
            self.kept.clear();
        }
        self.made += 1;
        let atlases: Vec<_> = request.documents.iter().map(|text| self.atlas(text)).collect();
        let lore = Arc::new(Lore::of(self.made, &atlases, request.instruction));
        let kept = self.kept.entry(ids).or_default();
        kept.insert(request.instruction.to_owned(), Arc::clone(&lore));
        lore
    }

    fn atlas(&mut self, document: &DocumentView<'_>) -> Arc<Atlas> {
        if self.atlases.len() >= MOST_ATLASES && !self.atlases.contains_key(&document.id) {
            self.atlases.clear();
        }
        let atlas = self.atlases.entry(document.id);
        Arc::clone(atlas.or_insert_with(|| Arc::new(Atlas::parse(document.text))))
    }
}
