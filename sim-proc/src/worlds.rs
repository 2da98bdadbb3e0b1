//! The worlds of a run: the hall and what stands on its shelves, and which passages are closed.

use std::collections::{BTreeSet, HashMap};
use std::hash::Hash;
use std::path::PathBuf;

use anyhow::Result;
use case_book::CaseVariant;
use domain::{Action, Mismatch, Pose, Start};
use warehouse::{
    Case, CaseSet, ELSEWHERE_VARIANT, ExchangedItems, Layout, RunWorlds, Task, Trajectory, Variant,
    Warehouse, WorldState,
};

use crate::renderer::VisibleChanges;

/// The flags that name the files of the worlds.
#[derive(Debug, Clone, clap::Args)]
pub struct WorldsArgs {
    /// The folder with layout.toml, catalogue.toml and cases.toml, instead of what is compiled in.
    #[arg(long, value_name = "DIR")]
    pub assets: Option<PathBuf>,

    /// The run's streams, whose world states are world variants after those of the cases.
    #[arg(long, value_name = "FILE")]
    pub streams: Option<PathBuf>,

    /// The other warehouse, in which tasks are demonstrated: one more world variant.
    #[arg(long, value_name = "FILE")]
    pub elsewhere: Option<PathBuf>,
}

impl WorldsArgs {
    /// Reads the files.
    ///
    /// # Errors
    /// A file that cannot be read or is invalid.
    pub fn read(&self) -> Result<RunWorlds> {
        let Self { assets, streams, elsewhere } = self;
        Ok(RunWorlds::read(assets.as_deref(), streams.as_deref(), elsewhere.as_deref())?)
    }

    /// As [`read`](Self::read), for those who render, with the variants of these mismatches.
    ///
    /// # Errors
    /// Likewise.
    pub fn load(&self, mismatches: &[Mismatch]) -> Result<Worlds> {
        let RunWorlds { warehouse, cases, states, .. } = self.read()?;
        Ok(Worlds::new(&warehouse, &cases, states, mismatches))
    }
}

/// A world by its parts, each as an index into those of [`Worlds`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct WorldParts {
    /// The hall and what stands on its shelves.
    pub stock: u32,
    /// Which passages are closed.
    pub closing: u32,
    /// In what light, with what labels and through which camera it is seen: that of episodes with this mismatch. `None` for any
    /// other.
    pub look: Mismatch,
}

impl WorldParts {
    /// The unchanged world.
    pub const UNCHANGED: Self = Self { stock: 0, closing: 0, look: Mismatch::None };

    /// The world that looks the same: where no changed bay is visible the stock looks unchanged, and where no barricade is
    /// visible no passage looks closed.
    #[must_use]
    pub fn as_seen(self, visible: VisibleChanges) -> Self {
        Self {
            stock: if visible.stock { self.stock } else { 0 },
            closing: if visible.barricades { self.closing } else { 0 },
            look: self.look,
        }
    }
}

/// A case as the world that executes its episodes knows it.
#[derive(Debug, Clone)]
pub struct EpisodeCase {
    /// The task.
    pub task: Task,
    /// Where its original demonstration starts.
    original: Pose,
    /// Where it is tested.
    new: Pose,
    /// The same in its blocked variant.
    blocked: Pose,
}

impl EpisodeCase {
    fn new(case: &Case) -> Self {
        Self {
            task: case.task,
            original: case.original.start,
            new: case.test.start,
            blocked: case.blocked.start,
        }
    }

    /// Where an episode from `start` begins; in a stream and in the unchanged world, or in the case's own blocked variant.
    pub const fn start(&self, start: Start, is_blocked: bool) -> Pose {
        match (start, is_blocked) {
            (Start::Original, _) => self.original,
            (Start::New, false) => self.new,
            (Start::New, true) => self.blocked,
        }
    }
}

/// All worlds of a run, and their parts, each once.
#[derive(Debug, Clone)]
pub struct Worlds {
    /// The unchanged warehouse first. They differ in their items only, but for the one of another hall, which is the last.
    stocks: Vec<Warehouse>,
    /// No closed passage first.
    closings: Vec<Variant>,
    /// By number of the world variant on the wire.
    variants: Vec<WorldParts>,
    /// The warehouse in which tasks are only demonstrated, if there is one.
    elsewhere: Option<WorldParts>,
    /// The cases that episodes are of.
    cases: Vec<EpisodeCase>,
    /// The numbers of the variants that streams take place in; none without streams.
    of_streams: Vec<u32>,
    /// The mismatches that episodes can have.
    mismatches: Vec<Mismatch>,
    /// By case, the stock of its episodes with other stock; empty if there are none.
    other_stocks: Vec<u32>,
}

impl Worlds {
    /// The unchanged warehouse, the warehouse with the barricade of each case, `states` of it, each with those of `mismatches`, and
    /// the other warehouse of the cases.
    pub fn new(
        warehouse: &Warehouse,
        cases: &CaseSet,
        states: Vec<WorldState>,
        mismatches: &[Mismatch],
    ) -> Self {
        let closing = |cells: &[domain::Cell]| Variant::closing(cells.iter().copied());
        let first = 1 + cases.cases.len() as u32;
        // A state without a change has the number of the unchanged world.
        let of_streams = match states.len() as u32 {
            0 => Vec::new(),
            count => std::iter::once(0).chain(first..first + count).collect(),
        };
        let mut parts = vec![(warehouse.clone(), Variant::UNCHANGED)];
        parts.extend(cases.cases.iter().map(|c| (warehouse.clone(), closing(&c.barricade))));
        parts.extend(states.into_iter().map(|state| (state.warehouse, state.variant)));
        let (mut stocks, closings): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
        if mismatches.contains(&Mismatch::Stock) {
            stocks.extend(other_stocks(warehouse, cases));
        }
        let stock_key = |warehouse: &Warehouse| {
            let items = warehouse.items.iter().map(|item| (item.standpoint, item.item_type));
            items.collect::<Vec<_>>()
        };
        let (mut stocks, stock_of) = distinct(stocks, stock_key);
        let (closings, closing_of) = distinct(closings, Variant::clone);
        let (stock_of, other_stocks) = stock_of.split_at(closing_of.len());
        let variants = stock_of.iter().zip(closing_of);
        let variants = variants.map(|(&stock, closing)| WorldParts {
            stock,
            closing,
            ..WorldParts::UNCHANGED
        });
        let (variants, other_stocks) = (variants.collect(), other_stocks.to_vec());
        let elsewhere = cases.elsewhere.as_ref().map(|elsewhere| {
            stocks.push(elsewhere.warehouse().clone());
            WorldParts { stock: stocks.len() as u32 - 1, ..WorldParts::UNCHANGED }
        });
        let cases = cases.cases.iter().map(EpisodeCase::new).collect();
        let mismatches = mismatches.to_vec();
        Self { stocks, closings, variants, elsewhere, cases, of_streams, mismatches, other_stocks }
    }

    /// The floor plan of the warehouse that is tested.
    pub fn layout(&self) -> &Layout {
        &self.stocks[0].layout
    }

    /// The floor plan of `world`.
    ///
    /// # Panics
    /// When `world` is not one of these.
    pub fn layout_of(&self, world: WorldParts) -> &Layout {
        &self.stocks[world.stock as usize].layout
    }

    /// The warehouse with each stock, and the other warehouse, if there is one.
    pub fn halls(&self) -> (&[Warehouse], Option<&Warehouse>) {
        match self.elsewhere {
            None => (&self.stocks, None),
            Some(world) => {
                let (stocks, other) = self.stocks.split_at(world.stock as usize);
                (stocks, other.first())
            }
        }
    }

    /// The number of variants of the world that is tested.
    pub fn variant_count(&self) -> usize {
        self.variants.len()
    }

    /// World variant `number`, if there is one.
    pub fn variant(&self, number: u32) -> Option<WorldParts> {
        if number == ELSEWHERE_VARIANT {
            return self.elsewhere;
        }
        match CaseVariant::with_mismatch(number) {
            Some(of) => self.with_mismatch(of),
            None => self.variants.get(number as usize).copied(),
        }
    }

    /// The variant with a mismatch, if there is one.
    fn with_mismatch(&self, of: CaseVariant) -> Option<WorldParts> {
        let CaseVariant { case, mismatch, .. } = of;
        if case as usize >= self.cases.len() || !self.mismatches.contains(&mismatch) {
            return None;
        }
        let without = self.variant(CaseVariant { mismatch: Mismatch::None, ..of }.number())?;
        Some(match mismatch {
            Mismatch::Stock => {
                WorldParts { stock: *self.other_stocks.get(case as usize)?, ..without }
            }
            look => WorldParts { look, ..without },
        })
    }

    /// The mismatches of which each is a way of looking at the world, which a renderer of its own draws.
    pub fn looks(&self) -> impl Iterator<Item = Mismatch> + '_ {
        let is_look =
            |mismatch: &Mismatch| mismatch.changes_world() && *mismatch != Mismatch::Stock;
        self.mismatches.iter().copied().filter(is_look)
    }

    /// The hall of `world`, and what stands on its shelves.
    ///
    /// # Panics
    /// When `world` is not one of these.
    pub fn warehouse(&self, world: WorldParts) -> &Warehouse {
        &self.stocks[world.stock as usize]
    }

    /// The same worlds with these cases, without a change of their variants.
    pub fn with_cases<'a>(mut self, cases: impl IntoIterator<Item = &'a Case>) -> Self {
        self.cases = cases.into_iter().map(EpisodeCase::new).collect();
        self
    }

    /// Case number `case`, if there is one.
    pub fn case(&self, case: u32) -> Option<&EpisodeCase> {
        self.cases.get(case as usize)
    }

    /// The variants of the run's streams in which `actions` from `start` complete the task of case number `case`.
    pub fn completed_in(&self, case: u32, start: Pose, actions: Vec<Action>) -> BTreeSet<u32> {
        let Some(case) = self.case(case) else { return BTreeSet::new() };
        let trajectory = Trajectory { start, actions };
        let completes = |number: &u32| {
            self.variant(*number).is_some_and(|world| {
                let (warehouse, closed) = (self.warehouse(world), self.closed(world));
                trajectory.replay(warehouse, &case.task, closed).length.is_some()
            })
        };
        self.of_streams.iter().copied().filter(completes).collect()
    }

    /// Whether episodes of the run's streams take place in the variant with this number.
    pub fn is_of_streams(&self, variant: u32) -> bool {
        self.of_streams.contains(&variant)
    }

    /// The poses of what the expert does from `begin` for case number `case` in `variant`; `None` if there is nothing.
    pub fn reference_poses(&self, case: u32, variant: u32, begin: Pose) -> Option<Vec<Pose>> {
        let (task, parts) = (&self.case(case)?.task, self.variant(variant)?);
        let (warehouse, variant) = (self.warehouse(parts).clone(), self.closed(parts).clone());
        let state = WorldState { warehouse, variant };
        let (trajectory, _) = state.reference(&state.expert(), task, begin)?;
        Some(trajectory.replay(&state.warehouse, task, &state.variant).poses)
    }

    /// The closed passages of `world`.
    ///
    /// # Panics
    /// When `world` is not one of these.
    pub fn closed(&self, world: WorldParts) -> &Variant {
        &self.closings[world.closing as usize]
    }
}

/// By case, the warehouse with the stock of its episodes with other stock.
fn other_stocks(warehouse: &Warehouse, cases: &CaseSet) -> Vec<Warehouse> {
    let items = ExchangedItems::draw(warehouse, cases.seed);
    let of_case = |case: &Case| {
        let state = WorldState::new(warehouse, &items.change(warehouse, &case.task));
        // Items that have changed places always fit.
        state.map_or_else(|_| warehouse.clone(), |state| state.warehouse)
    };
    cases.cases.iter().map(of_case).collect()
}

/// The distinct values of `all` in the order of their first occurrence, and the index among them of each of `all`.
fn distinct<T, K: Eq + Hash>(all: Vec<T>, key: impl Fn(&T) -> K) -> (Vec<T>, Vec<u32>) {
    let (mut kept, mut known) = (Vec::new(), HashMap::new());
    let index = |value: T| {
        *known.entry(key(&value)).or_insert_with(|| {
            kept.push(value);
            kept.len() as u32 - 1
        })
    };
    let indices = all.into_iter().map(index).collect();
    (kept, indices)
}

#[cfg(test)]
mod tests {
    use domain::{Cell, DemonstrationKind, Demonstrations};
    use shm_types::layout::WireLayout;
    use shm_types::message::{MemoryEpisodeConfig, RecalledSource};
    use warehouse::{Elsewhere, StockChange, WorldChange};

    use super::*;

    #[test]
    fn every_case_has_its_barricade_and_equal_worlds_are_one() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let worlds = Worlds::new(&warehouse, &cases, Vec::new(), &[]);
        assert_eq!(worlds.variant(0), Some(WorldParts::UNCHANGED));
        assert_eq!(worlds.closed(WorldParts::UNCHANGED), &Variant::UNCHANGED);
        for (case, number) in cases.cases.iter().zip(1..) {
            let world = worlds.variant(number).unwrap();
            assert_eq!(worlds.closed(world).closed(), case.barricade);
            assert_eq!(world.stock, 0);
        }
        assert_eq!((worlds.variant_count(), worlds.stocks.len()), (cases.cases.len() + 1, 1));
        assert_eq!(worlds.variant(ELSEWHERE_VARIANT), None);
        let closings = &worlds.closings;
        assert!((1..closings.len()).all(|n| !closings[..n].contains(&closings[n])));
    }

    #[test]
    fn the_other_warehouse_has_a_floor_plan_of_its_own() {
        let (warehouse, mut cases) = (Warehouse::shipped(), CaseSet::shipped());
        cases.elsewhere = Elsewhere::generate(&warehouse, &cases, 1).ok();
        let worlds = Worlds::new(&warehouse, &cases, Vec::new(), &[]);
        let world = worlds.variant(ELSEWHERE_VARIANT).unwrap();
        assert_eq!(worlds.variant_count(), cases.cases.len() + 1);
        assert_ne!(worlds.layout_of(world), worlds.layout());
        let (stocks, other) = worlds.halls();
        assert_eq!((stocks.len(), world.stock), (1, 1));
        assert_eq!(other.unwrap().layout, *worlds.layout_of(world));
    }

    #[test]
    fn states_come_after_the_cases_and_share_stocks_and_closings() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let emptied = |at: usize| {
            vec![StockChange { standpoint: warehouse.items[at].standpoint, item_type: None }]
        };
        let closed: Vec<Cell> = cases.cases[0].barricade.clone();
        let changes = [
            WorldChange { closed: closed.clone(), stock: Vec::new() },
            WorldChange { closed: closed.clone(), stock: emptied(3) },
            WorldChange { closed: Vec::new(), stock: emptied(4) },
            WorldChange { closed: Vec::new(), stock: emptied(3) },
        ];
        let states = changes.iter().map(|change| WorldState::new(&warehouse, change).unwrap());
        let worlds = Worlds::new(&warehouse, &cases, states.collect(), &[]);
        let first = cases.cases.len() as u32 + 1;
        let closing = worlds.variant(1).unwrap().closing;
        let expected = [(0, closing), (1, closing), (2, 0), (1, 0)];
        for (number, (stock, closing)) in (first..).zip(expected) {
            assert_eq!(
                worlds.variant(number),
                Some(WorldParts { stock, closing, ..WorldParts::UNCHANGED })
            );
        }
        assert_eq!(worlds.variant(first + 4), None);
        let standpoint = warehouse.items[3].standpoint;
        assert_eq!(worlds.stocks[1].item_at(standpoint), None);
    }

    #[test]
    fn the_reference_of_the_wire_names_every_demonstration_by_its_code() {
        let doc = |message: shm_types::layout::Struct, field: &str| {
            let found = message.fields.iter().find(|found| found.name == field).unwrap();
            found.doc.split_whitespace().collect::<Vec<_>>().join(" ")
        };
        let kinds = DemonstrationKind::ALL.map(|kind| format!("{} {}", kind as u16, kind.name()));
        let source = doc(RecalledSource::LAYOUT, "demonstration");
        assert!(source.contains(&kinds.join(", ")), "{source}");

        let own: u32 = DemonstrationKind::OWN.iter().map(|&kind| 1 << kind as u32).sum();
        let bit = |set: Demonstrations, without: Demonstrations| {
            let bits = set.bits() & !without.bits();
            assert_eq!(bits.count_ones(), 1, "{set}");
            bits.trailing_zeros()
        };
        let pair = Demonstrations::from_bits(0b11).unwrap();
        let set = doc(MemoryEpisodeConfig::LAYOUT, "demonstrations");
        for told in [
            format!("Bits 0 to {}: the case's own", own.trailing_ones() - 1),
            DemonstrationKind::OWN.map(DemonstrationKind::name).join(", "),
            format!("Bit {}: its irrelevant", bit(Demonstrations::IRRELEVANT, pair)),
            format!("Bit {}: its confusable", bit(Demonstrations::CONFUSABLE, pair)),
            format!("Bit {}: the one after", bit(Demonstrations::AFTER, Demonstrations::NONE)),
            format!(
                "Bit {}: that one comes first",
                bit(Demonstrations::AFTER_BEFORE, Demonstrations::BEFORE_AFTER)
            ),
            format!(
                "Bit {}: the one of another",
                bit(Demonstrations::ELSEWHERE, Demonstrations::NONE)
            ),
            format!(
                "bit {}: the test reference on the unchanged route",
                bit(Demonstrations::NEW_REFERENCE, Demonstrations::NONE)
            ),
            format!(
                "bit {}: on the blocked",
                bit(Demonstrations::BLOCKED_REFERENCE, Demonstrations::NONE)
            ),
            format!("bit {}: its first", bit(Demonstrations::WRONG_1, Demonstrations::NONE)),
            format!("bit {}: its two", bit(Demonstrations::WRONG_2, Demonstrations::NONE)),
            format!(
                "Bits {} to 31: the size of a bank",
                Demonstrations::bank(1).bits().trailing_zeros()
            ),
        ] {
            assert!(set.contains(&told), "{told:?} is not in {set:?}");
        }
    }
}
