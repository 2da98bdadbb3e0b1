//! The worlds that the episodes of a run took place in.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use anyhow::{Context, Result, bail};
use case_book::act::{
    ActAnswer, ActRequest, ActedDemonstration, ActedEpisode, ActedReference, DemonstrationsRequest,
    EpisodeParts, EpisodeRequest, Scene, StreamBlockPlace, WorldDescription,
};
use case_book::{CaseFacts, CaseVariant, EpisodeFacts, GREY_VARIANT, WorldDeclaration};
use conditions::{Frames, Mismatch};
use domain::{ActionCode, Pose, Route, Start, State};
use run_log::{EpisodeRecord, RunLog};
use serde::Deserialize;

use crate::frames::ViewKey;
use crate::program::{Asker, WorldAccess, describe};

/// What the world has told of an episode, as that world understands it.
///
/// # Errors
/// When another world has told it.
pub fn facts_of(record: &EpisodeRecord) -> Result<EpisodeFacts> {
    let facts = EpisodeFacts::deserialize(&record.world);
    facts.with_context(|| format!("the facts of {} are not those of a warehouse", record.key))
}

/// The state in which an episode began, if its world has told it.
pub fn begin_of(record: &EpisodeRecord) -> Option<State> {
    let told = |name: &str| record.world.get(name);
    let pose = || Some(Pose::deserialize(told("start_pose")?).ok()?.into());
    told("start_state").and_then(|state| State::deserialize(state).ok()).or_else(pose)
}

/// The world of a run: its cases, and answers about its episodes.
#[derive(Debug)]
pub struct RunWorld {
    asker: RefCell<Asker>,
    description: WorldDescription,
    /// What frames showed.
    frames: Frames,
    /// Those that were asked for, by variant.
    scenes: RefCell<BTreeMap<u32, Rc<Scene>>>,
}

impl RunWorld {
    /// The world of the run `log`, which `access` leads to.
    ///
    /// # Errors
    /// When a file of the run's world cannot be used.
    pub fn new(log: &RunLog, access: &WorldAccess) -> Result<Self> {
        Self::of(access.asker(log)?, log.manifest.settings.frames)
    }

    /// The world that `asker` answers about, with these frames.
    ///
    /// # Errors
    /// When it does not answer.
    pub fn of(mut asker: Asker, frames: Frames) -> Result<Self> {
        let description = describe(&mut asker)?;
        Ok(Self { asker: RefCell::new(asker), description, frames, scenes: RefCell::default() })
    }

    /// What it is.
    pub fn description(&self) -> &WorldDescription {
        &self.description
    }

    /// Whether the world draws maps, and views of states: the warehouse does.
    pub fn has_map(&self) -> bool {
        self.scene(0).is_ok()
    }

    /// What the world says of itself.
    pub fn declaration(&self) -> &WorldDeclaration {
        &self.description.world.declaration
    }

    /// The index of the case with this id.
    pub fn index(&self, id: &str) -> Option<usize> {
        self.description.cases.iter().position(|case| case.id == id)
    }

    /// The case of `record`, and its index.
    ///
    /// # Errors
    /// When there is no such case.
    pub fn case(&self, record: &EpisodeRecord) -> Result<(usize, &CaseFacts)> {
        let index = self.index(&record.case);
        let index = index.with_context(|| format!("there is no case {}", record.case))?;
        Ok((index, &self.description.cases[index]))
    }

    /// The number of the world variant in which the episode of `record` took place.
    ///
    /// # Errors
    /// When there is no such case, or a stream has no such world.
    pub fn variant(&self, record: &EpisodeRecord) -> Result<u32> {
        let (index, _) = self.case(record)?;
        if let Some(stream) = &record.stream {
            let variant = self.description.states.get(stream.world as usize);
            return variant.copied().with_context(|| format!("there is no world {}", stream.world));
        }
        let is_blocked = record.route == Route::Blocked;
        let variant = CaseVariant { case: index as u32, is_blocked, mismatch: record.mismatch };
        Ok(match (record.mismatch.changes_world(), is_blocked) {
            (false, true) => self.description.blocked[index],
            (true, _) | (false, false) => variant.number(),
        })
    }

    /// The views that the policy was shown in the episode of `record`, which was in `states` in the world variant `variant`.
    ///
    /// # Errors
    /// When there is no such variant.
    pub(crate) fn seen_in(
        &self,
        record: &EpisodeRecord,
        variant: u32,
        states: &[State],
    ) -> Result<Vec<ViewKey>> {
        if self.frames != Frames::Rendered || self.has_map() {
            return self.seen(variant, states);
        }
        let begin = match record.route {
            Route::Blocked => record.route.name(),
            Route::Unchanged => record.start.name(),
        };
        let begin = match record.mismatch {
            mismatch if mismatch.changes_world() => format!("{begin}-{mismatch}"),
            _ => begin.to_owned(),
        };
        let actions = record.actions.chars().map(|letter| self.declaration().action_of(letter));
        Ok(self.views_after(&record.case, &begin, actions))
    }

    /// The views that the policy was shown in `states` in the world variant `variant`: others than the true ones where frames
    /// were a control.
    ///
    /// # Errors
    /// When there is no such variant.
    pub fn seen(&self, variant: u32, states: &[State]) -> Result<Vec<ViewKey>> {
        let of = |variant, states: &[State]| {
            states.iter().map(|state| ViewKey::State(variant, *state)).collect()
        };
        Ok(match self.frames {
            Frames::Rendered => of(variant, states),
            Frames::Blank | Frames::BlankAll => of(GREY_VARIANT, states),
            Frames::Swapped => {
                let request = ActRequest::Swapped(variant, states.to_vec());
                let ActAnswer::Swapped(shown) = self.asker.borrow_mut().ask(&request)? else {
                    bail!("the world swaps something else");
                };
                of(variant, &shown)
            }
        })
    }

    /// The views in `states` in the world variant `variant` that memory was given.
    pub fn supplied(&self, variant: u32, states: &[State]) -> Vec<ViewKey> {
        let variant = match self.frames {
            Frames::BlankAll => GREY_VARIANT,
            Frames::Rendered | Frames::Blank | Frames::Swapped => variant,
        };
        states.iter().map(|state| ViewKey::State(variant, *state)).collect()
    }

    /// The views of a demonstration that memory was given.
    pub fn supplied_of(&self, acted: &ActedDemonstration) -> Vec<ViewKey> {
        if self.frames == Frames::BlankAll || self.has_map() {
            return self.supplied(acted.variant, &acted.states);
        }
        self.views_after(&acted.case, acted.kind.name(), acted.actions.iter().copied().map(Some))
    }

    /// What is seen at the begin of the trajectory `begin` of a case, and after each of `actions`. Without an action nothing happens.
    pub fn views_after(
        &self,
        case: &str,
        begin: &str,
        actions: impl IntoIterator<Item = Option<ActionCode>>,
    ) -> Vec<ViewKey> {
        let mut steps = format!("{case}.{begin}.");
        let mut views = vec![ViewKey::Steps(steps.as_str().into())];
        for action in actions {
            steps.extend(action.map(|action| self.declaration().letter(Some(action))));
            views.push(ViewKey::Steps(steps.as_str().into()));
        }
        views
    }

    /// Acts out the episode of `record`, with these parts.
    ///
    /// # Errors
    /// When it does not fit the world.
    pub fn act(&self, record: &EpisodeRecord, parts: EpisodeParts) -> Result<ActedEpisode> {
        self.act_in(record, self.variant(record)?, begin_of(record), parts)
    }

    /// As [`act`](Self::act), from `begin`, or from where its reference begins, in the world variant `variant`.
    ///
    /// # Errors
    /// Likewise.
    pub fn act_in(
        &self,
        record: &EpisodeRecord,
        variant: u32,
        begin: Option<State>,
        parts: EpisodeParts,
    ) -> Result<ActedEpisode> {
        let request = EpisodeRequest {
            case: record.case.clone(),
            variant,
            reference: record.stream.is_none().then_some((record.start, record.route)),
            begin,
            actions: record
                .actions
                .chars()
                .map(|letter| self.declaration().action_of(letter))
                .collect(),
            stream: record.stream.as_ref().map(|stream| StreamBlockPlace {
                stream: stream.stream,
                order: stream.order,
                place: stream.place,
                block: stream.block,
            }),
            parts,
        };
        self.episode(request)
    }

    fn episode(&self, request: EpisodeRequest) -> Result<ActedEpisode> {
        match self.asker.borrow_mut().ask(&ActRequest::Episode(request))? {
            ActAnswer::Episode(acted) => Ok(*acted),
            _ => bail!("the world acts out something else"),
        }
    }

    /// What the expert does from a start of a case.
    ///
    /// # Errors
    /// When there is no such case or variant.
    pub fn reference(
        &self,
        case: &str,
        variant: u32,
        of: (Start, Route),
    ) -> Result<ActedReference> {
        let request = EpisodeRequest {
            case: case.to_owned(),
            variant,
            reference: Some(of),
            begin: None,
            actions: Vec::new(),
            stream: None,
            parts: EpisodeParts { reference: true, ..EpisodeParts::default() },
        };
        self.episode(request)?.reference.context("there is no reference")
    }

    /// Acts out demonstrations.
    ///
    /// # Errors
    /// When there is no such case or variant.
    pub fn demonstrations(
        &self,
        request: DemonstrationsRequest,
    ) -> Result<Vec<ActedDemonstration>> {
        match self.asker.borrow_mut().ask(&ActRequest::Demonstrations(request))? {
            ActAnswer::Demonstrations(acted) => Ok(acted),
            _ => bail!("the world acts out something else"),
        }
    }

    /// The world variant with this number from above, whence only another stock differs.
    ///
    /// # Errors
    /// When there is no such variant.
    pub fn scene(&self, variant: u32) -> Result<Rc<Scene>> {
        let variant = match CaseVariant::with_mismatch(variant) {
            Some(CaseVariant { mismatch: Mismatch::Stock, .. }) => variant,
            _ => CaseVariant::without_mismatch(variant),
        };
        if let Some(known) = self.scenes.borrow().get(&variant) {
            return Ok(Rc::clone(known));
        }
        let ActAnswer::Scene(scene) = self.asker.borrow_mut().ask(&ActRequest::Scene(variant))?
        else {
            bail!("the world shows something else");
        };
        let scene = Rc::new(scene);
        self.scenes.borrow_mut().insert(variant, Rc::clone(&scene));
        Ok(scene)
    }
}
