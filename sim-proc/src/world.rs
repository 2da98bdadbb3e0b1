//! The warehouse in the role of a run's world.

use anyhow::Result;
use case_book::DemonstrationBook;
use domain::{ActionCode, Feedback, Mismatch, Pose};
use peer::world::{Moment, Refusal, RenderSetup, World};
use rustc_hash::FxHashMap;
use shm_types::message::{NO_ACTION, StepCommand, ViewRequest, WorldEpisodeConfig};
use shm_types::{Attach, FrameControl};
use warehouse::{SwappedPoses, Variant, every_pose};

use crate::lanes::{SimulatedLanes, Stepped};
use crate::lived::LivedEpisodes;
use crate::renderer::{ViewSpec, VisibleChanges};
use crate::worlds::{WorldParts, Worlds};

/// A view of a warehouse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct WarehouseView {
    /// The hall with what stands on its shelves, and its closed passages.
    pub world: WorldParts,
    /// The camera's pose.
    pub pose: Pose,
}

/// What a renderer needs to know of a view.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WarehousePicture {
    /// The index of what stands on the shelves.
    pub stock: u32,
    /// In what light, with what labels and through which camera: that of episodes with this mismatch.
    pub look: Mismatch,
    /// Which passages are closed.
    pub variant: Variant,
    /// The camera's pose.
    pub pose: Pose,
}

/// Which changes of a world may be visible in a view. The frame of the world without the others is used instead.
pub type FindChanges = Box<dyn FnMut(Mismatch, ViewSpec<'_>) -> VisibleChanges>;

/// All lanes of a run in the worlds of its warehouse.
pub struct WarehouseWorld {
    lanes: SimulatedLanes,
    demonstrations: DemonstrationBook,
    /// The views that lanes are shown in place of theirs, for the control.
    swapped: Option<SwappedPoses>,
    find_changes: FindChanges,
    /// For every view asked for so far, the view with the same pixels that stands for it.
    same_as: FxHashMap<WarehouseView, WarehouseView>,
}

impl WarehouseWorld {
    /// The world of the run in `attach`, whose memories ask for views of `demonstrations`.
    ///
    /// # Errors
    /// When the list of episodes that memories have learned from cannot be used.
    pub fn new(attach: &Attach, worlds: Worlds, demonstrations: DemonstrationBook) -> Result<Self> {
        let is_swapped = attach.frame_control == FrameControl::Swapped;
        let swapped = is_swapped.then(|| SwappedPoses::new(worlds.layout()));
        let lived = LivedEpisodes::read(&attach.root, &worlds)?;
        Ok(Self {
            lanes: SimulatedLanes::new(lived, worlds, attach.lanes as usize),
            demonstrations,
            swapped,
            find_changes: Box::new(|_, _| VisibleChanges { stock: true, barricades: true }),
            same_as: FxHashMap::default(),
        })
    }

    /// Decides from now on by `find_changes` which views are the same.
    pub fn find_changes(&mut self, find_changes: FindChanges) {
        self.find_changes = find_changes;
    }

    /// The worlds.
    pub fn worlds(&self) -> &Worlds {
        self.lanes.worlds()
    }

    /// The view that stands for that from `pose` in `world`.
    fn with_same_pixels(&mut self, world: WorldParts, pose: Pose) -> WarehouseView {
        let view = WarehouseView { world, pose };
        let Self { lanes, find_changes, same_as, .. } = self;
        *same_as.entry(view).or_insert_with(|| {
            let (variant, stock) = (lanes.worlds().closed(world), world.stock);
            let world = world.as_seen(find_changes(world.look, ViewSpec { pose, variant, stock }));
            WarehouseView { world, pose }
        })
    }

    fn moment(
        &mut self,
        stepped: Stepped,
        action: Option<ActionCode>,
    ) -> Result<Moment<WarehouseView>, Refusal> {
        let Stepped { world, pose, feedback, sub_goals, required, conflict, ended, .. } = stepped;
        let shown = match &self.swapped {
            Some(swapped) => swapped.shown(self.lanes.worlds().closed(world), pose),
            None => pose,
        };
        let facts = stepped.facts.map(|facts| serde_json::to_string(&facts)).transpose();
        Ok(Moment {
            state: pose.into(),
            action: action.filter(|_| feedback != Feedback::NotUnderstood),
            feedback: feedback.into(),
            view: self.with_same_pixels(world, shown),
            sub_goals,
            required,
            conflict,
            ended,
            facts: facts.map_err(|error| error.to_string())?,
            state_hash: stepped.state_hash,
        })
    }

    /// The world and the pose in which the requested view is seen.
    fn place_of(&self, request: &ViewRequest) -> Result<(WorldParts, Pose), String> {
        let &ViewRequest { sequence, demonstration: number, step, .. } = request;
        if sequence != 0 {
            let seen = self.lanes.lived().view((sequence, number), step);
            return seen.ok_or_else(|| {
                format!("there is no step {step} of episode {number} of sequence {sequence}")
            });
        }
        let of = self.demonstrations.demonstrations.get(number as usize);
        let seen = of.and_then(|of| Some((of.variant, *of.states.get(step as usize)?)));
        let (variant, state) =
            seen.ok_or_else(|| format!("there is no step {step} of demonstration {number}"))?;
        let pose = Pose::try_from(state).map_err(|foreign| foreign.to_string())?;
        Ok((self.lanes.standing(variant, pose)?, pose))
    }
}

impl World for WarehouseWorld {
    type View = WarehouseView;
    type Picture = WarehousePicture;

    fn begin(&mut self, config: &WorldEpisodeConfig) -> Result<Moment<WarehouseView>, Refusal> {
        let stepped = self.lanes.begin(config)?;
        self.moment(stepped, None)
    }

    fn apply(&mut self, command: &StepCommand) -> Result<Option<Moment<WarehouseView>>, Refusal> {
        let Some(stepped) = self.lanes.apply(command)? else { return Ok(None) };
        let action = (command.action != NO_ACTION).then_some(ActionCode(command.action));
        self.moment(stepped, action).map(Some)
    }

    fn remembered(&mut self, request: &ViewRequest) -> Result<WarehouseView, String> {
        let (world, pose) = self.place_of(request)?;
        Ok(self.with_same_pixels(world, pose))
    }

    fn picture(&self, WarehouseView { world, pose }: WarehouseView) -> WarehousePicture {
        let variant = self.lanes.worlds().closed(world).clone();
        WarehousePicture { stock: world.stock, look: world.look, variant, pose }
    }

    fn first_views(&self) -> Vec<WarehouseView> {
        let world = WorldParts::UNCHANGED;
        let poses = every_pose(self.lanes.worlds().layout());
        poses.map(|pose| WarehouseView { world, pose }).collect()
    }
}

/// What a warehouse is rendered with.
pub struct WarehouseRendering {
    /// The renderers.
    pub setup: RenderSetup<WarehousePicture>,
    /// Which views differ from those of the unchanged world.
    pub find_changes: FindChanges,
}

impl WarehouseRendering {
    /// Lets `world` use it.
    pub fn install(self, world: &mut WarehouseWorld) -> RenderSetup<WarehousePicture> {
        world.find_changes(self.find_changes);
        self.setup
    }
}
