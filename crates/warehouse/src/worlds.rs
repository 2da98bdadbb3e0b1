//! The worlds of a run, read from its files.

use std::io;
use std::path::Path;

use case_book::{CaseVariant, WorldFacts};
use domain::Mismatch;

use crate::asset::AssetError;
use crate::case::{CaseSet, TrajectoryKind};
use crate::case_book::world_facts;
use crate::dynamics::Variant;
use crate::elsewhere::{ELSEWHERE_VARIANT, Elsewhere};
use crate::elsewhere_source::ElsewhereError;
use crate::mismatch::ExchangedItems;
use crate::state::WorldState;
use crate::stream::{StreamError, StreamSet};
use crate::world::Warehouse;

/// The warehouse of a run, its cases, and what its streams make of it.
#[derive(Debug, Clone)]
pub struct RunWorlds {
    /// What identifies them.
    pub facts: WorldFacts,
    /// The unchanged warehouse.
    pub warehouse: Warehouse,
    /// The cases, and the other warehouse in which they are demonstrated.
    pub cases: CaseSet,
    /// The streams.
    pub streams: Option<StreamSet>,
    /// The world states of the streams.
    pub states: Vec<WorldState>,
}

/// Why the worlds of a run cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RunWorldsError {
    /// The assets cannot be used.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// A file cannot be read.
    #[error("cannot read {file}")]
    Unreadable {
        /// The file.
        file: String,
        /// Why.
        source: io::Error,
    },
    /// The streams do not fit.
    #[error("{file}")]
    Streams {
        /// The file.
        file: String,
        /// Why.
        source: StreamError,
    },
    /// The other warehouse does not fit.
    #[error(transparent)]
    Elsewhere(#[from] ElsewhereError),
}

impl RunWorlds {
    /// Reads the folder `assets`, or takes what is compiled in; and the files of the run's streams and of its other warehouse,
    /// where it has them.
    ///
    /// # Errors
    /// A file that cannot be read or does not fit.
    pub fn read(
        assets: Option<&Path>,
        streams: Option<&Path>,
        elsewhere: Option<&Path>,
    ) -> Result<Self, RunWorldsError> {
        let (warehouse, mut cases) = CaseSet::with_warehouse(assets)?;
        let (mut set, mut states) = (None, Vec::new());
        if let Some(path) = streams {
            let file = path.display().to_string();
            let text = durable::input::read_text(path)
                .map_err(|source| RunWorldsError::Unreadable { file: file.clone(), source })?;
            let unfit = |source| RunWorldsError::Streams { file: file.clone(), source };
            let read = StreamSet::parse(&text, &warehouse, &cases).map_err(unfit)?;
            states = read.states(&warehouse).map_err(unfit)?;
            set = Some(read);
        }
        if let Some(file) = elsewhere {
            cases.elsewhere = Some(Elsewhere::read(file, &warehouse, &cases)?);
        }
        let facts = world_facts(assets, &warehouse, &cases)?;
        Ok(Self { facts, warehouse, cases, streams: set, states })
    }

    /// The variant with this number; `None` if there is none. The other warehouse is one.
    pub fn variant(&self, number: u32) -> Option<WorldState> {
        let state =
            |warehouse: &Warehouse, variant| WorldState { warehouse: warehouse.clone(), variant };
        if number == ELSEWHERE_VARIANT {
            let other = self.cases.elsewhere.as_ref()?;
            return Some(state(other.warehouse(), Variant::UNCHANGED));
        }
        if let Some(of) = CaseVariant::with_mismatch(number) {
            return self.with_mismatch(of);
        }
        let Some(index) = (number as usize).checked_sub(1) else {
            return Some(state(&self.warehouse, Variant::UNCHANGED));
        };
        match self.cases.cases.get(index) {
            Some(case) => Some(state(&self.warehouse, case.variant(TrajectoryKind::Blocked))),
            None => self.states.get(index - self.cases.cases.len()).cloned(),
        }
    }

    /// The variant with a mismatch; `None` if there is no such case.
    fn with_mismatch(&self, of: CaseVariant) -> Option<WorldState> {
        let case = self.cases.cases.get(of.case as usize)?;
        let kind = if of.is_blocked { TrajectoryKind::Blocked } else { TrajectoryKind::Test };
        let variant = case.variant(kind);
        let warehouse = match of.mismatch {
            Mismatch::Stock => {
                let items = ExchangedItems::draw(&self.warehouse, self.cases.seed);
                let change = items.change(&self.warehouse, &case.task);
                WorldState::new(&self.warehouse, &change).ok()?.warehouse
            }
            Mismatch::None
            | Mismatch::Light
            | Mismatch::Labels
            | Mismatch::CameraHeight
            | Mismatch::FieldOfView
            | Mismatch::Wording => self.warehouse.clone(),
        };
        Some(WorldState { warehouse, variant })
    }
}
