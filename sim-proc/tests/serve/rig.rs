//! A simulator whose render workers write what they were asked to render into the pixels.

use std::collections::BTreeMap;

use anyhow::Result;
use case_book::{Demonstration, DemonstrationBook};
use conformance::messages;
use domain::{Action, Cell, DemonstrationKind, Heading, Mismatch, Pose, State};
use peer::world::{
    RenderSetup, RenderTask, RenderWorker, Renderers, WorldFailure, serve_generation,
};
use rigs::process::SimRig;
use shm_types::message::{FrameId, Observation, RequestId, Role, StepCommand, WorldEpisodeConfig};
use shm_types::{Attach, Bus, FrameSize};
use sim_proc::renderer::{Backend, RenderSettings, ViewSpec, VisibleChanges};
use sim_proc::world::{WarehousePicture, WarehouseRendering, WarehouseWorld};
use sim_proc::worlds::Worlds;
use warehouse::{
    Case, CaseSet, ELSEWHERE_VARIANT, Elsewhere, StockChange, Trajectory, Variant, Warehouse,
    WorldChange, WorldState, every_pose,
};

/// Fills a slot with pixels that encode the pose, the stock, the look and the number of nearby closed cells.
pub(crate) struct CodeWorker;

pub(crate) fn code(variant: &Variant, pose: Pose) -> [u8; 4] {
    code_with(0, variant, pose)
}

pub(crate) fn code_with(stock: u32, variant: &Variant, pose: Pose) -> [u8; 4] {
    let Pose { cell: Cell { x, y }, heading } = pose;
    let size = if is_near(variant, pose) { variant.closed().len() } else { 0 };
    let stock = if shows_stock(pose) { stock as u8 } else { 0 };
    [x, y, heading as u8 | stock << 4, size as u8]
}

/// Barricades are visible for four cells in all directions.
pub(crate) fn is_near(variant: &Variant, pose: Pose) -> bool {
    variant.closed().iter().any(|cell| cell.distance(pose.cell) <= 4)
}

/// Changed stock is visible in every other row.
pub(crate) fn shows_stock(pose: Pose) -> bool {
    pose.cell.y.is_multiple_of(2)
}

impl RenderWorker<WarehousePicture> for CodeWorker {
    fn render_into(
        &mut self,
        tasks: &mut [RenderTask<'_, WarehousePicture>],
    ) -> Result<u64, WorldFailure> {
        for RenderTask { picture, slot, .. } in &mut *tasks {
            let WarehousePicture { stock, look, variant, pose } = picture;
            let mut code = code_with(*stock, variant, *pose);
            code[3] |= (*look as u8) << 4;
            slot.pixels_mut().chunks_exact_mut(4).for_each(|pixel| pixel.copy_from_slice(&code));
        }
        // As if one byte had been copied for each.
        Ok(tasks.len() as u64)
    }
}

/// A render worker on a thread of its own.
pub(crate) type Worker = Box<dyn RenderWorker<WarehousePicture> + Send>;

/// Two workers.
pub(crate) fn setup() -> WarehouseRendering {
    setup_with(vec![Box::new(CodeWorker), Box::new(CodeWorker)])
}

/// These workers.
pub(crate) fn setup_with(workers: Vec<Worker>) -> WarehouseRendering {
    WarehouseRendering {
        setup: RenderSetup {
            renderers: Renderers::Threads { workers, batch: 3 },
            facts: vec![("backend", "test".to_owned())],
        },
        find_changes: Box::new(|_, ViewSpec { pose, variant, stock }| VisibleChanges {
            stock: stock != 0 && shows_stock(pose),
            barricades: is_near(variant, pose),
        }),
    }
}

/// A simulator with [`setup`] among its neighbours.
pub(crate) fn simulator(change: impl FnOnce(&mut Attach)) -> SimRig {
    let mut rig = simulator_with(change, false, |_| Ok(setup()));
    let facts = rig.handshake().facts().unwrap();
    assert_eq!(facts, BTreeMap::from([("backend".into(), "test".into())]));
    rig
}

/// Mismatches that are other ways of looking at the same world.
pub(crate) const LOOKS: [Mismatch; 4] =
    [Mismatch::Light, Mismatch::Labels, Mismatch::CameraHeight, Mismatch::FieldOfView];

/// The states that follow the worlds of the shipped cases: an item is gone; also the passage of the fourth case is closed;
/// another item is gone.
pub(crate) fn states() -> Vec<WorldState> {
    let warehouse = Warehouse::shipped();
    let state = |closed: &[Cell], item: usize| {
        let standpoint = warehouse.items[item].standpoint;
        let stock = vec![StockChange { standpoint, item_type: None }];
        WorldState::new(&warehouse, &WorldChange { closed: closed.to_vec(), stock }).unwrap()
    };
    vec![state(&[], 3), state(&CaseSet::shipped().cases[3].barricade, 3), state(&[], 4)]
}

/// The worlds of the shipped cases and of [`states`]. Beside the shipped cases there is one for each of [`poses`], which begins
/// there.
pub(crate) fn worlds() -> Worlds {
    let (warehouse, mut cases) = (Warehouse::shipped(), CaseSet::shipped());
    cases.elsewhere = Some(elsewhere());
    let worlds = Worlds::new(&warehouse, &cases, states(), &LOOKS);
    // Its task takes two items, so that no episode ends where it begins.
    let first = cases.case("t06-01").unwrap().clone();
    let at = |pose| {
        let original = Trajectory { start: pose, ..first.original.clone() };
        Case { original, ..first.clone() }
    };
    let of_poses: Vec<Case> = poses().into_iter().map(at).collect();
    worlds.with_cases(cases.cases.iter().chain(&of_poses))
}

/// The index of the first demonstration of [`elsewhere`] among [`demonstrations`].
pub(crate) fn elsewhere_demonstration() -> u32 {
    worlds().variant_count() as u32 + 1
}

/// For each variant of [`worlds`], and one that there is not, a demonstration whose steps are in all [`poses`], and in one where
/// no agent can stand; then the first of [`elsewhere`].
fn demonstrations() -> DemonstrationBook {
    let nowhere = Pose::new(200, 200, Heading::N);
    let poses: Vec<Pose> = poses().into_iter().chain([nowhere]).collect();
    let variants = (0..elsewhere_demonstration()).map(|variant| (variant, poses.clone()));
    let elsewhere = elsewhere();
    let (task, shown) = elsewhere.demonstration(0).unwrap();
    let shown = shown.replay(elsewhere.warehouse(), task, &Variant::UNCHANGED).poses;
    let demonstration = |(variant, poses): (u32, Vec<Pose>)| Demonstration {
        case: 0,
        kind: DemonstrationKind::Original,
        variant,
        instruction: String::new(),
        states: poses.into_iter().map(State::from).collect(),
        feedback: Vec::new(),
        sub_goals: Vec::new(),
        actions: Vec::new(),
        views: Vec::new(),
    };
    let all = variants.chain([(ELSEWHERE_VARIANT, shown)]);
    let demonstrations = all.map(demonstration).collect();
    let world = warehouse::declaration();
    DemonstrationBook { world, demonstrations, ..DemonstrationBook::default() }
}

/// The step of [`demonstrations`] at `pose`.
pub(crate) fn step_at(pose: Pose) -> u32 {
    poses().iter().position(|known| *known == pose).unwrap() as u32
}

/// The config that begins an episode at `pose`.
pub(crate) fn reset(lane: u32, episode: u64, variant: u32, pose: Pose) -> WorldEpisodeConfig {
    let place = poses().iter().position(|known| *known == pose).unwrap();
    let case = (CaseSet::shipped().cases.len() + place) as u32;
    messages::world_config(lane, episode, variant, case)
}

/// The other warehouse.
pub(crate) fn elsewhere() -> Elsewhere {
    Elsewhere::generate(&Warehouse::shipped(), &CaseSet::shipped(), 1).unwrap()
}

pub(crate) fn simulator_with(
    change: impl FnOnce(&mut Attach),
    warm_views: bool,
    open: impl FnOnce(&WarehouseWorld) -> Result<WarehouseRendering> + Send + 'static,
) -> SimRig {
    let change = |attach: &mut Attach| {
        attach.frame = FrameSize { width: 64, height: 32 };
        change(attach);
    };
    SimRig::in_thread(change, move |folder| {
        let attach = Attach::read(folder)?;
        let mut world = WarehouseWorld::new(&attach, worlds(), demonstrations())?;
        let bus = Bus::join(attach, Role::Sim)?;
        let open = |world: &mut WarehouseWorld| Ok(open(world)?.install(world));
        Ok(serve_generation(&bus, &mut world, warm_views, open)?)
    })
}

/// The next error report's text; the simulator is notified first.
pub(crate) fn error_report(rig: &mut SimRig) -> String {
    rig.notify();
    rig.error_report().1
}

/// The error that ends the simulator, which it has reported.
pub(crate) fn fatal_error(rig: &mut SimRig) -> String {
    let report = error_report(rig);
    assert_eq!(rig.end().unwrap_err().to_string(), report);
    report
}

/// The pose of the agent.
pub(crate) fn pose_of(seen: &Observation) -> Pose {
    let state = warehouse::declaration().read_state(&seen.state).unwrap();
    Pose::try_from(state).unwrap()
}

/// The code in the frame's pixels, as both consumers read it.
pub(crate) fn shown_code(rig: &mut SimRig, frame: FrameId) -> [u8; 4] {
    let [memory, policy] = rig.neighbours.stores.each_mut().map(|store| {
        let frame = store.get(frame).unwrap().expect("the frame is resident").clone();
        let (first, rest) = frame.pixels().split_at(4);
        assert!(rest.chunks_exact(4).all(|pixel| pixel == first));
        assert_eq!(frame.content_hash(), blake3::hash(frame.pixels()).as_bytes()[..16]);
        <[u8; 4]>::try_from(first).unwrap()
    });
    assert_eq!(memory, policy);
    memory
}

/// The poses of the shipped floor.
pub(crate) fn poses() -> Vec<Pose> {
    every_pose(&Warehouse::shipped().layout).collect()
}

/// Renderers of small frames.
pub(crate) fn small(backend: Option<Backend>) -> RenderSettings {
    let FrameSize { width: width_px, height: height_px } = SMALL;
    RenderSettings { width_px, height_px, backend, ..RenderSettings::default() }
}

pub(crate) const SMALL: FrameSize = FrameSize { width: 128, height: 96 };

pub(crate) fn act(lane: u32, episode: u64, step: u32, action: Action) -> StepCommand {
    messages::act(RequestId { lane, episode, step }, action)
}
