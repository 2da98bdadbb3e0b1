//! The serve loop among scripted neighbours. The render workers write what they were asked to render into the pixels.

#![expect(clippy::unwrap_used, reason = "test helpers fail loudly")]

mod rig;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver as Permissions, channel};

use bytemuck::Zeroable;
use case_book::{CaseVariant, EpisodeFacts};
use conformance::messages;
use domain::{Action, Feedback, Heading, Mismatch, Pose};
use peer::world::{RenderTask, RenderWorker, WorldFailure};
use shm_types::FrameControl;
use shm_types::message::{
    EpisodeEnd, FrameId, NO_FRAME, ShutdownReport, StepCommand, ViewRequest, WorldEpisodeConfig,
};
use sim_proc::renderer::{Backend, Renderer, ViewSpec};
use sim_proc::world::{WarehousePicture, WarehouseRendering};
use warehouse::{CaseSet, TrajectoryKind, Variant, Warehouse, step};

use rig::{
    CodeWorker, LOOKS, SMALL, act, code, code_with, elsewhere, elsewhere_demonstration,
    error_report, fatal_error, is_near, pose_of, poses, reset, setup, setup_with, shown_code,
    shows_stock, simulator, simulator_with, small, step_at,
};

#[test]
fn episodes_run_by_the_dynamics_and_show_what_is_there() {
    let mut sim = simulator(|_| {});
    let case = CaseSet::shipped().cases[3].clone();
    let layout = Warehouse::shipped().layout;
    let variant = Variant::closing(case.barricade.iter().copied());
    // All four lanes follow the blocked reference in step.
    let mut pose = case.blocked.start;
    let mut shown = BTreeSet::new();
    for lane in 0..4 {
        let config = messages::world_config(lane, 10 + u64::from(lane), 4, 3);
        sim.command(&WorldEpisodeConfig { start: 1, ..config });
    }
    let length = case.replay(&Warehouse::shipped(), TrajectoryKind::Blocked).length.unwrap();
    let mut feedback = Feedback::Start;
    for (n, &action) in case.blocked.actions[..length as usize].iter().enumerate() {
        let observations = sim.observe(4);
        let lanes: BTreeSet<u32> = observations.iter().map(|o| o.lane).collect();
        assert_eq!(lanes, BTreeSet::from([0, 1, 2, 3]));
        for o in &observations {
            assert_eq!((pose_of(o), o.feedback), (pose, feedback as u8));
            assert_eq!((o.step, o.episode, o.last), (n as u32, 10 + u64::from(o.lane), 0));
            assert_eq!(o.frame, observations[0].frame, "one view, one frame");
            assert!(
                o.report.woken_ns <= o.report.stepped_ns
                    && o.report.stepped_ns <= o.report.rendered_ns
            );
            assert!(o.report.rendered_ns <= o.report.sent_ns);
        }
        assert_eq!(shown_code(&mut sim, observations[0].frame), code(&variant, pose));
        shown.insert(observations[0].frame);
        (pose, feedback) = step(&layout, &variant, pose, action);
        for lane in 0..4 {
            let command = act(lane, 10 + u64::from(lane), n as u32 + 1, action);
            sim.command(&command);
        }
    }
    for over in sim.observe(4) {
        assert_eq!((over.last, over.frame, over.step), (1, NO_FRAME, length));
        assert_eq!(over.report.ended, EpisodeEnd::Complete as u8);
        assert_eq!(over.report.sub_goals, over.report.required);
    }
    let notes = sim.neighbours.facts.drain().unwrap();
    assert_eq!(notes.len(), 4);
    let facts: EpisodeFacts = serde_json::from_slice(notes[3].bytes.as_ref().unwrap()).unwrap();
    assert_eq!((facts.start_pose, facts.final_pose), (case.blocked.start, pose));
    let shutdown_report = sim.stop();
    assert_eq!(shutdown_report.frames_rendered, shown.len() as u64);
    assert_eq!(
        (shutdown_report.error_reports, shutdown_report.pixel_bytes_copied),
        (0, shutdown_report.frames_rendered)
    );
}

#[test]
fn lanes_share_a_frame_wherever_their_worlds_look_alike() {
    let mut sim = simulator(|attach| attach.frame_capacity = 2000);
    let cases = CaseSet::shipped().cases;
    // Two cases that close the same passage, and one that closes another.
    let (one, another) = (0..cases.len())
        .flat_map(|b| (0..b).map(move |a| (a, b)))
        .find(|&(a, b)| cases[a].barricade == cases[b].barricade)
        .unwrap();
    let elsewhere = cases.iter().position(|c| c.barricade != cases[one].barricade).unwrap();
    let numbers = [0, one, another, elsewhere];
    let variants = numbers.map(|n| Variant::closing(cases[n].barricade.iter().copied()));
    let variants =
        [Variant::UNCHANGED, variants[1].clone(), variants[2].clone(), variants[3].clone()];
    let free = |pose: &Pose| variants.iter().all(|variant| !variant.is_closed(pose.cell));
    let poses: Vec<Pose> = poses().into_iter().filter(free).step_by(3).collect();
    let mut looks = BTreeSet::new();
    for (n, &pose) in (0..).zip(&poses) {
        let frames: Vec<FrameId> = (0..4)
            .map(|lane| {
                let variant = if lane == 0 { 0 } else { numbers[lane] as u32 + 1 };
                let command = reset(lane as u32, 4 * n + lane as u64, variant, pose);
                let seen = sim.ask(&command);
                assert_eq!(shown_code(&mut sim, seen.frame), code(&variants[lane], pose));
                seen.frame
            })
            .collect();
        assert_eq!(frames[1], frames[2], "they close the same passage");
        for lane in [1, 3] {
            assert_eq!(frames[lane] == frames[0], !is_near(&variants[lane], pose), "{pose}");
        }
        looks.extend(frames);
    }
    let shutdown_report = sim.stop();
    assert_eq!(shutdown_report.frames_rendered, looks.len() as u64);
    assert!(looks.len() > poses.len() && looks.len() < 2 * poses.len());
}

/// The variant number of entry `state` of [`states`].
fn state(state: u32) -> u32 {
    1 + CaseSet::shipped().cases.len() as u32 + state
}

#[test]
fn lanes_and_memory_see_the_world_state_they_name() {
    let mut sim = simulator(|attach| attach.frame_capacity = 2000);
    let closed = Variant::closing(CaseSet::shipped().cases[3].barricade.iter().copied());
    let open = Variant::UNCHANGED;
    let worlds =
        [(0, 0, &open), (state(0), 1, &open), (state(1), 1, &closed), (state(2), 2, &open)];
    let (mut shown, mut seen) = (BTreeSet::new(), BTreeSet::new());
    let free = |pose: &Pose| !closed.is_closed(pose.cell);
    for (n, pose) in (0..).zip(poses().into_iter().filter(free).step_by(7)) {
        let mut frames = Vec::new();
        for (lane, &(variant, stock, closed)) in (0..).zip(&worlds) {
            let expected = code_with(stock, closed, pose);
            let frame = sim.ask(&reset(lane, 4 * n + u64::from(lane), variant, pose)).frame;
            assert_eq!(shown_code(&mut sim, frame), expected, "variant {variant} at {pose}");
            sim.pin(variant, step_at(pose));
            let view = sim.view();
            assert_eq!(
                (view.frame, view.demonstration, view.step),
                (frame, variant, step_at(pose))
            );
            sim.release(frame);
            frames.push(frame);
            seen.insert(expected);
        }
        // Views of different worlds are one where the worlds look alike.
        assert_eq!(frames[1] == frames[0], !shows_stock(pose), "{pose}");
        assert_eq!(frames[2] == frames[1], !is_near(&closed, pose), "{pose}");
        shown.extend(frames);
    }
    assert_eq!(shown.len(), seen.len());
    for (variant, pose, said) in [
        (state(3), poses()[0], "variant 104 is not one of 104"),
        (state(1), Pose { cell: closed.closed()[0], heading: Heading::N }, "an agent cannot stand"),
    ] {
        sim.pin(variant, step_at(pose));
        let report = error_report(&mut sim);
        assert!(report.contains(said), "{report}");
    }
    assert_eq!(sim.stop().frames_rendered, shown.len() as u64);
}

#[test]
fn a_view_with_a_mismatch_is_never_the_one_without() {
    let mut sim = simulator(|attach| attach.frame_capacity = 2000);
    let mut shown = BTreeSet::new();
    for (n, pose) in (0..).zip(poses().into_iter().step_by(31)) {
        let usual = sim.ask(&reset(0, 5 * n, 0, pose)).frame;
        let mut frames = vec![usual];
        for (place, mismatch) in (1..).zip(LOOKS) {
            let case = reset(0, 0, 0, pose).case;
            let variant = CaseVariant { case, is_blocked: false, mismatch }.number();
            let frame = sim.ask(&reset(place % 4, 5 * n + u64::from(place), variant, pose)).frame;
            let mut expected = code(&Variant::UNCHANGED, pose);
            expected[3] |= (mismatch as u8) << 4;
            assert_eq!(shown_code(&mut sim, frame), expected, "{mismatch} at {pose}");
            frames.push(frame);
        }
        // Demonstrations are shown as they were recorded.
        sim.pin(0, step_at(pose));
        let view = sim.view();
        assert_eq!(view.frame, usual);
        sim.release(usual);
        shown.extend(frames);
    }
    assert_eq!(shown.len(), 5 * poses().into_iter().step_by(31).count());
    let pose = poses()[0];
    let case = reset(0, 0, 0, pose).case;
    for (of, said) in [
        (
            CaseVariant { case: 0, is_blocked: false, mismatch: Mismatch::Light },
            "is not one of case 100",
        ),
        (CaseVariant { case, is_blocked: false, mismatch: Mismatch::Stock }, "is not one of"),
    ] {
        sim.command(&reset(0, 9000, of.number(), pose));
        let report = error_report(&mut sim);
        assert!(report.contains(said), "{report}");
    }
    sim.stop();
}

#[test]
fn memory_gets_the_views_it_requests_until_it_releases_them() {
    let mut sim = simulator(|_| {});
    let poses = poses();
    let held: Vec<Pose> = poses[..40].to_vec();
    for &pose in &held {
        sim.pin(0, step_at(pose));
    }
    let mut frames = BTreeMap::new();
    while frames.len() < held.len() {
        let view = sim.view();
        frames.insert(poses[view.step as usize], view.frame);
    }
    assert_eq!(frames.keys().copied().collect::<BTreeSet<_>>(), held.iter().copied().collect());

    // An episode that needs more than the rest of the store does not evict them.
    let start = poses[0];
    sim.ask(&reset(0, 1, 0, start));
    for step in 1..60 {
        let action = if step % 4 == 0 { Action::Forward } else { Action::TurnLeft };
        sim.ask(&act(0, 1, step, action));
    }
    for (&pose, &frame) in &frames {
        assert_eq!(shown_code(&mut sim, frame), code(&Variant::UNCHANGED, pose));
    }
    // A view that is resident is answered with the same frame, also to a lane.
    let (&pose, &frame) = frames.first_key_value().unwrap();
    assert_eq!(sim.ask(&reset(1, 2, 0, pose)).frame, frame);
    sim.pin(0, step_at(pose));
    assert_eq!(sim.view().frame, frame);
    sim.release(frame);
    for &frame in frames.values() {
        sim.release(frame);
    }
    sim.release(frame);
    assert_eq!(
        error_report(&mut sim),
        format!("view request: frame {frame} is released, but it is not pinned")
    );
    let shutdown_report = sim.stop();
    assert_eq!(shutdown_report.error_reports, 1);
}

#[test]
fn an_episode_longer_than_the_store_evicts_and_memory_stays_bounded() {
    // Two lanes of window 1 keep three views each.
    let mut sim = simulator(|attach| {
        (attach.frame_capacity, attach.lanes, attach.window) = (6, 2, 1);
    });
    let poses = poses();
    let mut recent = [const { Vec::<(FrameId, Pose)>::new() }; 2];
    for (n, pair) in poses.chunks_exact(2).enumerate() {
        for (lane, &pose) in pair.iter().enumerate() {
            // Every third step begins an episode, which unpins the lane's views.
            let seen = if n % 3 == 0 {
                recent[lane].clear();
                sim.ask(&reset(lane as u32, n as u64, 0, pose))
            } else {
                let (episode, step) = (n as u64 / 3 * 3, (n % 3) as u32);
                sim.ask(&act(lane as u32, episode, step, Action::TurnRight))
            };
            recent[lane].push((seen.frame, pose_of(&seen)));
            assert!(sim.neighbours.stores[0].len() <= 6);
        }
        for (frame, pose) in recent.concat() {
            assert_eq!(shown_code(&mut sim, frame), code(&Variant::UNCHANGED, pose));
        }
    }
    let shutdown_report = sim.stop();
    assert!(shutdown_report.frames_evicted > 100);
    assert!(shutdown_report.frames_rendered - shutdown_report.frames_evicted <= 6);
}

#[test]
fn controls_change_what_lanes_see_and_only_one_what_memory_gets() {
    for control in [FrameControl::Blank, FrameControl::Swapped, FrameControl::BlankAll] {
        let mut sim = simulator(|attach| attach.frame_control = control);
        let poses = poses();
        let mut shown = BTreeSet::new();
        for (episode, &pose) in poses.iter().step_by(50).enumerate() {
            let seen = sim.ask(&reset(0, episode as u64, 0, pose));
            assert_eq!(pose_of(&seen), pose);
            let pixel = shown_code(&mut sim, seen.frame);
            assert_ne!(pixel, code(&Variant::UNCHANGED, pose));
            assert_eq!(pixel == [128, 128, 128, 255], control != FrameControl::Swapped);
            shown.insert(seen.frame);
            sim.pin(0, step_at(pose));
            let view = sim.view();
            let supplied = shown_code(&mut sim, view.frame);
            match control {
                FrameControl::BlankAll => assert_eq!(supplied, [128, 128, 128, 255]),
                _ => assert_eq!(supplied, code(&Variant::UNCHANGED, pose)),
            }
        }
        assert_eq!(shown.len() == 1, control != FrameControl::Swapped, "one grey frame for all");
        sim.stop();
    }
}

#[test]
fn invalid_messages_are_reported_and_the_run_continues() {
    let mut sim = simulator(|_| {});
    let pose = poses()[0];
    let last = poses().len() as u32;
    let good = reset(0, 1, 0, pose);
    for (config, said) in [
        (WorldEpisodeConfig { lane: 9, ..good }, "there are 4 lanes"),
        (WorldEpisodeConfig { case: 7777, ..good }, "there is no case 7777"),
        (reset(0, 1, 4000, pose), "variant 4000 is not one of"),
    ] {
        sim.command(&config);
        let error_report = error_report(&mut sim);
        assert!(error_report.contains(said), "{error_report}");
    }
    let forward = act(0, 1, 1, Action::Forward);
    for (command, said) in [
        (StepCommand { kind: 77, ..forward }, "77 is not a step kind"),
        (forward, "the lane is in no episode"),
    ] {
        sim.command(&command);
        let error_report = error_report(&mut sim);
        assert!(error_report.contains(said), "{error_report}");
    }
    for (request, said) in [
        (ViewRequest { kind: 9, ..Zeroable::zeroed() }, "9 is not a view request kind"),
        (ViewRequest { step: last, ..Zeroable::zeroed() }, "an agent cannot stand at 200,200,N"),
        (ViewRequest { step: last + 1, ..Zeroable::zeroed() }, "of demonstration 0"),
        (ViewRequest { demonstration: 4000, ..Zeroable::zeroed() }, "step 0 of demonstration 4000"),
        (ViewRequest { sequence: 3, ..Zeroable::zeroed() }, "step 0 of episode 0 of sequence 3"),
        (ViewRequest { frame: 5, kind: 1, ..Zeroable::zeroed() }, "frame 5 is released"),
    ] {
        sim.neighbours.send(&request).unwrap();
        let error_report = error_report(&mut sim);
        assert!(error_report.contains(said), "{error_report}");
    }
    assert_eq!(sim.ask(&reset(0, 1, 0, pose)).feedback, Feedback::Start as u8);
    assert_eq!(sim.stop().error_reports, 11);
}

#[test]
fn a_store_that_is_too_small_is_reported() {
    let mut sim = simulator(|attach| attach.frame_capacity = 3);
    let poses = poses();
    for (lane, &pose) in poses[..4].iter().enumerate() {
        sim.command(&reset(lane as u32, 1, 0, pose));
    }
    assert_eq!(
        fatal_error(&mut sim),
        "4 views are in use at once and the frame store has room for 3: raise --frame-budget or lower --lanes"
    );
}

/// Panics at its first task.
struct PanickingWorker;

impl RenderWorker<WarehousePicture> for PanickingWorker {
    fn render_into(
        &mut self,
        _tasks: &mut [RenderTask<'_, WarehousePicture>],
    ) -> Result<u64, WorldFailure> {
        panic!("this worker panics, as the test wants");
    }
}

#[test]
fn a_panicking_worker_ends_the_run() {
    let panicking_setup = || setup_with(vec![Box::new(PanickingWorker), Box::new(PanickingWorker)]);
    let mut sim = simulator_with(|_| {}, false, move |_| Ok(panicking_setup()));
    sim.command(&reset(0, 1, 0, poses()[0]));
    assert_eq!(
        fatal_error(&mut sim),
        "a render worker has ended; its own message on standard error says why"
    );
}

/// Waits for permission before each batch.
struct WaitingWorker(Permissions<()>);

impl RenderWorker<WarehousePicture> for WaitingWorker {
    fn render_into(
        &mut self,
        tasks: &mut [RenderTask<'_, WarehousePicture>],
    ) -> Result<u64, WorldFailure> {
        // After a failed test the channel is closed.
        let _ = self.0.recv();
        CodeWorker.render_into(tasks)
    }
}

#[test]
fn no_lane_waits_for_the_view_of_another() {
    // The sender is dropped before the rig.
    let (mut sim, go_on) = {
        let (go_on, permissions) = channel();
        let worker = Box::new(WaitingWorker(permissions));
        (simulator_with(|_| {}, false, |_| Ok(setup_with(vec![worker]))), go_on)
    };
    let poses = poses();
    let (here, elsewhere) = (poses[0], poses[50]);
    go_on.send(()).unwrap();
    let resident = sim.ask(&reset(0, 1, 0, here)).frame;

    sim.command(&reset(1, 2, 0, elsewhere));
    for episode in 3..13 {
        let seen = sim.ask(&reset(0, episode, 0, here));
        assert_eq!((seen.lane, seen.episode, seen.frame), (0, episode, resident));
        assert_eq!(seen.report.rendered_ns, seen.report.stepped_ns, "the view was resident");
    }
    assert_eq!(sim.neighbours.reports.next().unwrap(), None, "lane 1's view is not drawn yet");

    go_on.send(()).unwrap();
    let seen = sim.observe(1)[0];
    assert_eq!((seen.lane, seen.episode, pose_of(&seen)), (1, 2, elsewhere));
    assert!(seen.report.stepped_ns < seen.report.rendered_ns);
    assert_eq!(shown_code(&mut sim, seen.frame), code(&Variant::UNCHANGED, elsewhere));
    assert_eq!(sim.stop().frames_rendered, 2);
}

#[test]
fn no_lane_waits_until_evicted_frames_are_released() {
    let mut sim = simulator(|attach| {
        (attach.frame_capacity, attach.lanes, attach.window) = (6, 1, 1);
    });
    let poses = poses();
    let here = reset(0, 1, 0, poses[0]);
    let resident = sim.ask(&here).frame;

    // Memory and policy are at work and do not look at evictions.
    let chunks = sim.neighbours.attach().frame_chunks() as usize;
    for &pose in &poses[1..chunks] {
        sim.pin(0, step_at(pose));
        let view = sim.view();
        sim.release(view.frame);
    }
    sim.pin(0, chunks as u32);
    sim.command(&WorldEpisodeConfig { episode: 2, ..here });
    sim.notify();
    let seen = sim.until(|neighbours| neighbours.reports.next().unwrap());
    assert_eq!((seen.episode, seen.frame), (2, resident));
    assert_eq!(sim.neighbours.views.next().unwrap(), None, "there is no slot for it");

    for store in &mut sim.neighbours.stores {
        store.apply_evictions().unwrap();
    }
    let view = sim.until(|neighbours| neighbours.views.next().unwrap());
    assert_eq!(shown_code(&mut sim, view.frame), code(&Variant::UNCHANGED, poses[chunks]));
    sim.stop();
}

#[test]
fn warm_views_are_not_rendered_again() {
    let mut sim = simulator_with(|attach| attach.frame_capacity = 1500, true, |_| Ok(setup()));
    sim.handshake();
    let poses = poses();
    for (episode, &pose) in poses.iter().enumerate().step_by(7) {
        let seen = sim.ask(&reset(0, episode as u64, 0, pose));
        assert_eq!(seen.report.rendered_ns, seen.report.stepped_ns, "{pose} was resident");
        assert_eq!(shown_code(&mut sim, seen.frame), code(&Variant::UNCHANGED, pose));
    }
    let shutdown_report = sim.stop();
    assert_eq!(
        (shutdown_report.frames_rendered, shutdown_report.frames_evicted),
        (poses.len() as u64, 0)
    );
}

#[test]
fn a_store_without_room_for_warm_views_is_reported() {
    let mut sim = simulator_with(|_| {}, true, |_| Ok(setup()));
    let views = poses().len();
    assert_eq!(
        fatal_error(&mut sim),
        format!(
            "--warm-views needs room for {views} frames and the frame store has room for 64: raise \
             --frame-budget or leave --warm-views out"
        )
    );
}

/// Frames in shared memory equal the renderer's, byte for byte, and are copied only where the device cannot write them.
#[test]
fn the_renderer_writes_into_the_frame_store() {
    let mut sim = simulator_with(
        |attach| {
            (attach.frame, attach.frame_capacity, attach.lanes, attach.window) = (SMALL, 6, 1, 2)
        },
        false,
        |world| WarehouseRendering::open(world.worlds(), small(None), None),
    );
    let handshake = sim.handshake();
    let facts = handshake.facts().unwrap();
    let mut renderer = Renderer::new(&Warehouse::shipped(), small(None)).unwrap();
    let case = CaseSet::shipped().cases[0].clone();
    let variant = Variant::closing(case.barricade.iter().copied());
    let mut seen = sim.ask(&reset(0, 1, 1, case.blocked.start));
    for (&action, step) in case.blocked.actions.iter().zip(1..) {
        let pose = pose_of(&seen);
        let view = ViewSpec { pose, variant: &variant, stock: 0 };
        let expected = renderer.render_image(view).unwrap();
        for store in &mut sim.neighbours.stores {
            let frame = store.get(seen.frame).unwrap().unwrap();
            assert!(frame.pixels() == expected.as_bytes(), "{pose}");
        }
        seen = sim.ask(&act(0, 1, step, action));
    }
    let ShutdownReport { frames_rendered, frames_evicted, pixel_bytes_copied, .. } = sim.stop();
    assert!(frames_rendered > 6 && frames_evicted >= frames_rendered - 6);
    let copied = if facts["frame path"] == "direct" { 0 } else { frames_rendered };
    assert_eq!(pixel_bytes_copied, copied * SMALL.bytes() as u64, "{facts:?}");
}

/// Simulators share views through a folder: the first renders them, the next reads them, and one that finds a damaged file
/// renders the view again.
#[test]
fn views_that_another_simulator_has_rendered_are_read_from_files() {
    let settings = small(Some(Backend::Cpu));
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().to_owned();
    let case = CaseSet::shipped().cases[0].clone();
    let variant = Variant::closing(case.barricade.iter().copied());
    let mut renderer = Renderer::new(&Warehouse::shipped(), settings.clone()).unwrap();
    let mut walk = || {
        let (settings, root) = (settings.clone(), root.clone());
        let mut sim = simulator_with(
            |attach| attach.frame = SMALL,
            false,
            move |world| WarehouseRendering::open(world.worlds(), settings, Some(&root)),
        );
        sim.handshake();
        let mut seen = sim.ask(&reset(0, 1, 1, case.blocked.start));
        for (&action, step) in case.blocked.actions.iter().zip(1..) {
            let pose = pose_of(&seen);
            let view = ViewSpec { pose, variant: &variant, stock: 0 };
            let expected = renderer.render_image(view).unwrap();
            let frame = sim.neighbours.stores[0].get(seen.frame).unwrap().unwrap();
            assert!(frame.pixels() == expected.as_bytes(), "{pose}");
            let hash = blake3::hash(expected.as_bytes());
            assert_eq!(frame.content_hash()[..], hash.as_bytes()[..16]);
            seen = sim.ask(&act(0, 1, step, action));
        }
        sim.stop();
    };
    // Which files there are: a file that is written again is another one.
    let files = || {
        let of_renderer = fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
        let files = fs::read_dir(of_renderer).unwrap().map(|file| file.unwrap());
        let files = files.map(|file| (file.path(), file.metadata().unwrap().ino()));
        files.collect::<BTreeMap<PathBuf, u64>>()
    };
    walk();
    let kept = files();
    assert!(kept.len() > 5);
    walk();
    assert_eq!(files(), kept);
    for (number, path) in kept.keys().enumerate() {
        let mut bytes = fs::read(path).unwrap();
        match number % 3 {
            0 => bytes.truncate(bytes.len() / 2),
            1 => *bytes.last_mut().unwrap() ^= 1,
            _ => bytes.clear(),
        }
        fs::write(path, bytes).unwrap();
    }
    walk();
    assert!(files().keys().eq(kept.keys()));
    assert!(files().iter().all(|(path, inode)| kept[path] != *inode));
}

/// The other warehouse has its own floor plan, stock and scene, in one frame store with the tested one.
#[test]
fn views_of_the_other_warehouse_are_those_of_a_simulator_that_is_started_in_it() {
    let settings = small(Some(Backend::Cpu));
    let with = settings.clone();
    let mut sim = simulator_with(
        |attach| attach.frame = SMALL,
        false,
        move |world| WarehouseRendering::open(world.worlds(), with, None),
    );
    sim.handshake();
    let (tested, other) = (Warehouse::shipped(), elsewhere());
    let mut renderer = Renderer::new(other.warehouse(), settings.clone()).unwrap();
    let mut here = Renderer::new(&tested, settings).unwrap();
    let render = |renderer: &mut Renderer, pose| {
        let view = ViewSpec { pose, variant: &Variant::UNCHANGED, stock: 0 };
        renderer.render_image(view).unwrap()
    };
    let (task, shown) = other.demonstration(0).unwrap();
    let replay = shown.replay(other.warehouse(), task, &Variant::UNCHANGED);
    assert!(replay.poses.iter().any(|pose| !tested.layout.is_free(pose.cell)));
    for (pose, step) in replay.poses.into_iter().zip(0_u32..) {
        sim.pin(elsewhere_demonstration(), step);
        let view = sim.view();
        for store in &mut sim.neighbours.stores {
            let frame = store.get(view.frame).unwrap().unwrap();
            assert!(frame.pixels() == render(&mut renderer, pose).as_bytes(), "{pose}");
        }
        sim.release(view.frame);
        if tested.layout.is_free(pose.cell) {
            let seen = sim.ask(&reset(1, 100 + u64::from(step), 0, pose));
            let frame = sim.neighbours.stores[0].get(seen.frame).unwrap().unwrap();
            assert!(frame.pixels() == render(&mut here, pose).as_bytes(), "{pose}");
        }
    }
    sim.stop();
}
