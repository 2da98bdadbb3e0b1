//! The worlds that the episodes of a run took place in.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use anyhow::{Context, Result, bail};
use case_book::act::{
    ActAnswer, ActRequest, ActedDemonstration, ActedEpisode, DemonstrationsRequest, EpisodeParts,
    EpisodeRequest, Scene, StreamBlockPlace, WorldDescription,
};
use case_book::{CaseFacts, GREY_VARIANT};
use domain::{Action, Pose};
use results::conditions::{Frames, Route};
use results::log::{EpisodeRecord, RunLog};

use crate::frames::ViewKey;
use crate::program::{Asker, WorldAccess};

/// The world of a run: its cases, and answers about its episodes.
#[derive(Debug)]
pub struct RunWorld {
    access: WorldAccess,
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
        let mut asker = access.asker(log)?;
        let ActAnswer::World(description) = asker.ask(&ActRequest::World)? else {
            bail!("the world describes something else");
        };
        Ok(Self {
            access: access.clone(),
            asker: RefCell::new(asker),
            description,
            frames: log.manifest.settings.frames,
            scenes: RefCell::default(),
        })
    }

    /// How it was found.
    pub fn access(&self) -> &WorldAccess {
        &self.access
    }

    /// What it is.
    pub fn description(&self) -> &WorldDescription {
        &self.description
    }

    /// The ids of all cases, in their order.
    pub fn case_ids(&self) -> Vec<&str> {
        self.description.cases.iter().map(|case| case.id.as_str()).collect()
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
        Ok(match record.route {
            Route::Blocked => self.description.blocked[index],
            Route::Unchanged => 0,
        })
    }

    /// The view that the policy was shown at `pose` in the world variant `variant`, where the control `swapped` shows that of
    /// `shown`.
    pub fn seen(&self, variant: u32, pose: Pose, shown: Option<Pose>) -> ViewKey {
        match self.frames {
            Frames::Rendered => (variant, pose),
            Frames::Blank | Frames::BlankAll => (GREY_VARIANT, pose),
            Frames::Swapped => (variant, shown.unwrap_or(pose)),
        }
    }

    /// The view from `pose` in the world variant `variant` that memory was given.
    pub fn supplied(&self, variant: u32, pose: Pose) -> ViewKey {
        match self.frames {
            Frames::BlankAll => (GREY_VARIANT, pose),
            Frames::Rendered | Frames::Blank | Frames::Swapped => (variant, pose),
        }
    }

    /// Acts out the episode of `record`, with these parts.
    ///
    /// # Errors
    /// When it does not fit the world.
    pub fn act(&self, record: &EpisodeRecord, parts: EpisodeParts) -> Result<ActedEpisode> {
        self.act_in(record, self.variant(record)?, record.start_pose, parts)
    }

    /// As [`act`](Self::act), from `begin` in the world variant `variant`.
    ///
    /// # Errors
    /// Likewise.
    pub fn act_in(
        &self,
        record: &EpisodeRecord,
        variant: u32,
        begin: Pose,
        parts: EpisodeParts,
    ) -> Result<ActedEpisode> {
        let request = EpisodeRequest {
            case: record.case.clone(),
            variant,
            reference: record.stream.is_none().then_some((record.start, record.route)),
            begin: Some(begin),
            actions: record.actions.chars().map(Action::from_letter).collect(),
            stream: record.stream.as_ref().map(|stream| StreamBlockPlace {
                stream: stream.stream,
                order: stream.order,
                place: stream.place,
                block: stream.block,
            }),
            parts: EpisodeParts { swapped: self.frames == Frames::Swapped, ..parts },
        };
        match self.asker.borrow_mut().ask(&ActRequest::Episode(request))? {
            ActAnswer::Episode(acted) => Ok(*acted),
            _ => bail!("the world acts out something else"),
        }
    }

    /// Acts out demonstrations.
    ///
    /// # Errors
    /// When there is no such case or variant.
    pub fn demonstrations(&self, request: DemonstrationsRequest) -> Result<Vec<ActedDemonstration>> {
        match self.asker.borrow_mut().ask(&ActRequest::Demonstrations(request))? {
            ActAnswer::Demonstrations(acted) => Ok(acted),
            _ => bail!("the world acts out something else"),
        }
    }

    /// The world variant with this number from above.
    ///
    /// # Errors
    /// When there is no such variant.
    pub fn scene(&self, variant: u32) -> Result<Rc<Scene>> {
        if let Some(known) = self.scenes.borrow().get(&variant) {
            return Ok(Rc::clone(known));
        }
        let ActAnswer::Scene(scene) = self.asker.borrow_mut().ask(&ActRequest::Scene(variant))? else {
            bail!("the world shows something else");
        };
        let scene = Rc::new(scene);
        self.scenes.borrow_mut().insert(variant, Rc::clone(&scene));
        Ok(scene)
    }
}
