//! The checks of a policy, in the order in which they run: one function for each difficult situation.

use std::time::Duration;

use domain::Action;
use shm_types::documents::Content;
use shm_types::message::{
    FrameId, ItemKind, MAX_INSTRUCTION, MAX_ITEMS, MAX_SEGMENT, MAX_STEPS, MAX_WINDOW, NO_ACTION,
    NO_FRAME, NOT_MEASURED, RecalledItem, TrajectoryStep,
};

use super::{PolicyRole, RequestScene, TestedPolicy};
use crate::LANES;
use crate::checks::{Check, clear_away};
use crate::messages::{item, last, observation, supplied, supply};
use crate::subject::{CheckResult, Trouble, next, wrong};

type PolicyKit<'a> = crate::Kit<'a, PolicyRole>;

/// Checks without which the others make no sense.
pub(crate) const REQUIRED_CHECKS: usize = 2;

/// The instruction of an ordinary episode.
const INSTRUCTION: &str = "Find a blue barrel.";

/// All checks. If one of the first [`REQUIRED_CHECKS`] fails, the others are skipped.
pub(crate) const CHECKS: &[Check<PolicyRole>] = &[
    Check {
        name: "joins",
        expected: "it joins the run in $MEMTRANSFER_ATTACH and sends a handshake: role, wire version, name",
        advice: "call `serve_from_environment` (Rust) or `memtransfer.run` (Python) first; loading a model may take as \
                 long as --start-timeout",
        run: |kit| Ok(kit.subject()?.introduction.clone()),
    },
    Check {
        name: "answers a step",
        expected: "one decision for one request",
        advice: "with an SDK, `act` returns one decision for each request and no error; without an SDK, answer each \
                 request once, with its lane, step and episode, and notify the orchestrator",
        run: a_step,
    },
    Check {
        name: "runs an episode",
        expected: "one decision for each of eight steps, and none for the end of the episode",
        advice: "an observation with `last` = 1 ends the episode and is not answered",
        run: an_episode,
    },
    Check {
        name: "counts correctly",
        expected: "`images_asked` is the number of images of the request, `images` is not larger, `attempts` is \
                   plausible; a count that is not known is NOT_MEASURED",
        advice: "count the current view, the window and the views of all items; set unknown counts to 4294967295",
        run: counts,
    },
    Check {
        name: "answers 64 lanes at once",
        expected: "one decision for each of 64 simultaneous requests",
        advice: "take all waiting requests into one batch; `act` returns one decision for each request",
        run: many_lanes,
    },
    Check {
        name: "keeps lanes apart",
        expected: "one decision for each of nine lanes at different steps, whose messages arrive interleaved",
        advice: "join recall and observation by lane, episode and step: either may come first",
        run: interleaved,
    },
    Check {
        name: "begins a new episode",
        expected: "the steps of a new episode are answered, whatever was open in its lane",
        advice: "an episode config ends the lane's episode: drop it, and answer with the new episode id",
        run: new_episode,
    },
    Check {
        name: "ignores late messages",
        expected: "no decision for messages of an episode that is over",
        advice: "drop messages whose episode id is not that of the lane's last config",
        run: late_messages,
    },
    Check {
        name: "waits for slow messages",
        expected: "no decision before both observation and recall have arrived, and one then",
        advice: "decide a step when its observation and its recall have arrived",
        run: slow_messages,
    },
    Check {
        name: "reads long documents",
        expected: "a decision with two documents of 1 MiB each, supplied at several steps",
        advice: "documents may have up to 16 MiB: truncate what does not fit into a prompt",
        run: long_documents,
    },
    Check {
        name: "takes 40 keyframes",
        expected: "a decision with four demonstrations that have 40 keyframes",
        advice: "a step without a keyframe has no frame; leave out images that are too many",
        run: keyframes,
    },
    Check {
        name: "takes items of every kind",
        expected: "a decision for recalls with eight items: texts of every kind, segments, parts without views or \
                   actions, demonstrations, captioned views; with plans; with 48 steps; and an `images_asked` that counts \
                   all views",
        advice: "go through `items` in order; a step may lack its view or its action, a distance may be NaN, a text may \
                 be a part of its document",
        run: every_item,
    },
    Check {
        name: "takes the longest window and segment",
        expected: "a decision without and with a window of 32 steps, and with a segment of 32 views",
        advice: "window and segment may be empty, and may have up to 32 entries",
        run: windows,
    },
    Check {
        name: "reads any instruction",
        expected: "a decision for instructions in other scripts, of full length, and empty ones",
        advice: "an instruction is UTF-8 of `instruction_len` bytes without a terminating zero",
        run: instructions,
    },
    Check {
        name: "releases frames",
        expected: "evicted frames become free again",
        advice: "drop a frame when it is evicted, and copy what is needed for longer; in Python, do not keep \
                 `frame.pixels` after `act`",
        run: frames_are_released,
    },
    Check {
        name: "survives invalid messages",
        expected: "an error report for each invalid message, no decision for it, and answers to all other requests",
        advice: "check values before use; send an `ErrorReport`, drop the message, go on",
        run: invalid_messages,
    },
    Check {
        name: "decides the same again",
        expected: "the same request gets the same answer: alone, in a batch, in another lane, later",
        advice: "decide from the request alone, seed random choices with `episode_seed`, ask models at temperature 0: \
                 otherwise runs are not reproducible",
        run: same_request_again,
    },
    Check {
        name: "can be restarted",
        expected: "after a kill in the middle of a step, it takes part in the next generation",
        advice: "leave nothing behind that prevents a second start: no lock file, no fixed port",
        run: restart,
    },
    Check::STOPS,
    Check::ENDS_WITH_THE_ORCHESTRATOR,
    Check::REFUSES_ANOTHER_WIRE_VERSION,
];

/// A scene of one view, without memory.
fn plain(subject: &mut TestedPolicy<'_>, seed: u64) -> CheckResult<RequestScene> {
    Ok(RequestScene { frame: subject.view(seed)?, ..RequestScene::default() })
}

fn a_step(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let scene = plain(subject, 1)?;
    let id = subject.begin(0, 1, INSTRUCTION)?;
    let decision = subject.ask_and_wait(id, &scene)?;
    clear_away(subject)?;
    Ok(match Action::try_from(decision.action) {
        Ok(action) => format!("its first action: {action:?}"),
        Err(_) => "its first answer was no action".to_owned(),
    })
}

fn an_episode(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let mut id = subject.begin(1, 2, INSTRUCTION)?;
    for seed in 0..8 {
        let scene = plain(subject, seed)?;
        subject.ask_and_wait(id, &scene)?;
        id = next(id);
    }
    subject.expect_none(id);
    subject.observe(&last(id))?;
    subject.notify()?;
    clear_away(subject)
}

/// A larger number of attempts for one decision is a counting mistake.
const MAX_ATTEMPTS: u32 = 1000;

fn counts(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let (frame, segment) = (subject.view(11)?, subject.views(12..15)?);
    let scene = RequestScene { frame, segment, ..RequestScene::default() };
    let id = subject.begin(14, 1, INSTRUCTION)?;
    let decision = subject.ask_and_wait(id, &scene)?;
    clear_away(subject)?;
    let shown = 1 + scene.segment.len() as u32;
    let measured = |count: u32| (count != NOT_MEASURED).then_some(count);
    if let Some(asked) = measured(decision.images_asked).filter(|&asked| asked != shown) {
        return wrong(format_args!("`images_asked` is {asked} for a request with {shown} images"));
    }
    if let Some(images) = measured(decision.images).filter(|&images| images > shown) {
        return wrong(format_args!("`images` is {images} for a request with {shown} images"));
    }
    if let Some(attempts) = measured(decision.attempts).filter(|&count| count > MAX_ATTEMPTS) {
        return wrong(format_args!("`attempts` is {attempts} for one decision"));
    }
    Ok(String::new())
}

fn many_lanes(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let frames = subject.views(0..8)?;
    for lane in 0..LANES {
        let id = subject.begin(lane, lane.into(), INSTRUCTION)?;
        let frame = frames[lane as usize % frames.len()];
        subject.ask(id, &RequestScene { frame, ..RequestScene::default() })?;
    }
    subject.wait()?;
    clear_away(subject)
}

fn interleaved(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let scene = plain(subject, 3)?;
    let mut requests = Vec::new();
    for lane in [7, 60, 2, 31, 0, 63, 12, 40, 5] {
        let mut id = subject.begin(lane, lane.into(), INSTRUCTION)?;
        for _ in 0..lane % 4 {
            subject.ask_and_wait(id, &scene)?;
            id = next(id);
        }
        requests.push(id);
    }
    for (at, &id) in requests.iter().enumerate() {
        subject.expect(id);
        if at % 2 == 0 {
            subject.observe(&observation(id, scene.frame))?;
        } else {
            subject.recall(&scene.recall(id))?;
        }
    }
    subject.notify()?;
    for (at, &id) in requests.iter().enumerate().rev() {
        if at % 2 == 0 {
            subject.recall(&scene.recall(id))?;
        } else {
            subject.observe(&observation(id, scene.frame))?;
        }
        subject.notify()?;
    }
    subject.wait()?;
    clear_away(subject)
}

fn new_episode(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let scene = plain(subject, 4)?;
    // The episode ends before it is answered.
    let old = subject.begin(9, 1, INSTRUCTION)?;
    subject.ask(old, &scene)?;
    let new = subject.begin(9, 2, "Find a red cone.")?;
    subject.ask(new, &scene)?;
    subject.wait()?;
    // The episode ends between observation and recall.
    let half = subject.begin(9, 3, INSTRUCTION)?;
    subject.expect_none(half);
    subject.observe(&observation(half, scene.frame))?;
    subject.notify()?;
    let new = subject.begin(9, 4, INSTRUCTION)?;
    subject.expect(new);
    subject.recall(&scene.recall(new))?;
    subject.notify()?;
    subject.observe(&observation(new, scene.frame))?;
    subject.wait()?;
    clear_away(subject)
}

fn late_messages(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let scene = plain(subject, 5)?;
    let old = subject.begin(3, 1, INSTRUCTION)?;
    let new = subject.begin(3, 2, INSTRUCTION)?;
    subject.expect_none(old);
    subject.recall(&scene.recall(old))?;
    subject.observe(&observation(old, scene.frame))?;
    subject.notify()?;
    subject.settle()?;
    subject.ask_and_wait(new, &scene)?;
    clear_away(subject)
}

fn slow_messages(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let scene = plain(subject, 6)?;
    let id = subject.begin(4, 1, INSTRUCTION)?;
    subject.expect_none(id);
    subject.notify()?;
    let pause = Duration::from_millis(300);
    subject.listen_for(pause)?;
    subject.observe(&observation(id, scene.frame))?;
    subject.notify()?;
    subject.listen_for(pause)?;
    subject.expect(id);
    subject.recall(&scene.recall(id))?;
    subject.wait()?;
    clear_away(subject)
}

fn long_documents(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let text = |line: &str| line.repeat((1 << 20) / line.len());
    let summary = text("The blue barrels stand in aisle 3, bay 7 — second from the north. ");
    let semantic =
        text("Regale stehen in Blöcken; am Ende eines Ganges führt ein Quergang weiter.\n");
    let items = vec![
        (subject.document(None, &Content::Summary(summary))?, Vec::new()),
        (subject.document(None, &Content::Semantic(semantic))?, Vec::new()),
    ];
    let mut id = subject.begin(6, 1, INSTRUCTION)?;
    for seed in 0..3 {
        let scene = RequestScene {
            frame: subject.view(seed)?,
            items: items.clone(),
            ..RequestScene::default()
        };
        subject.ask_and_wait(id, &scene)?;
        id = next(id);
    }
    clear_away(subject)
}

fn keyframes(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let views = subject.views(100..140)?;
    let id = subject.begin(8, 1, INSTRUCTION)?;
    let steps = views.chunks(10).enumerate().flat_map(|(trajectory, views)| {
        // Every other step has its view; the last one has no action.
        let steps = views.iter().flat_map(|&frame| [frame, NO_FRAME]);
        let acting = steps.map(|frame| (frame, Action::Forward as u8));
        acting.chain([(NO_FRAME, NO_ACTION)]).map(move |(frame, action)| TrajectoryStep {
            frame,
            action,
            trajectory: trajectory as u8,
            own: 0,
            reserved: [0; 5],
        })
    });
    let document = subject.document(Some(id), &Content::Trajectories(steps.collect()))?;
    let frame = subject.view(7)?;
    let items = vec![(document, Vec::new())];
    let instruction = subject.instruction(id, "Geh zum blauen Faß, dann zurück.")?;
    let scene =
        RequestScene { frame, items, instruction: Some(instruction), ..RequestScene::default() };
    subject.ask_and_wait(id, &scene)?;
    clear_away(subject)
}

fn every_item(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let views = subject.views(400..400 + MAX_STEPS as u64)?;
    let mut id = subject.begin(16, 1, INSTRUCTION)?;
    let note = subject.document(Some(id), &Content::Note("Zurück — nach Süden.".to_owned()))?;
    let summary =
        subject.document(None, &Content::Summary("The barrels stand in aisle 3.".into()))?;
    let of_trajectory = |trajectory, frame, action| TrajectoryStep {
        frame,
        action,
        trajectory,
        own: 0,
        reserved: [0; 5],
    };
    let demonstrations = vec![
        of_trajectory(0, views[0], Action::Forward as u8),
        of_trajectory(0, NO_FRAME, NO_ACTION),
        of_trajectory(1, NO_FRAME, Action::Left as u8),
        of_trajectory(1, views[1], NO_ACTION),
    ];
    let demonstrations = subject.document(Some(id), &Content::Trajectories(demonstrations))?;
    let own = |trajectory, action: Action| TrajectoryStep {
        own: 1,
        ..of_trajectory(trajectory, NO_FRAME, action as u8)
    };
    let plan = vec![
        own(0, Action::TurnLeft),
        own(0, Action::Forward),
        of_trajectory(1, NO_FRAME, Action::Left as u8),
        of_trajectory(2, NO_FRAME, Action::Forward as u8),
        own(3, Action::TurnAround),
    ];
    let plan = subject.document(Some(id), &Content::Trajectories(plan))?;
    // Two of its parts are of demonstrations.
    let plan = RecalledItem { kind: ItemKind::Plan as u8, whole: 0, instructions: 2, ..plan };
    let steps = |frames: &[FrameId], action| -> Vec<_> {
        frames.iter().map(|&frame| supplied(frame, action)).collect()
    };
    let of_steps = item(ItemKind::Steps);
    let frame_of =
        |caption| RecalledItem { kind: ItemKind::Frame as u8, instructions: 1, ..caption };
    let forward = Some(Action::Forward);
    let mixed = vec![
        // "nach": a text may be a part of its document.
        (RecalledItem { first_byte: 12, bytes: 4, ..note }, Vec::new()),
        (RecalledItem { distance: 0.25, ..of_steps }, steps(&views[..3], forward)),
        (RecalledItem { distance: 0.5, ..of_steps }, steps(&views[3..5], None)),
        (of_steps, steps(&[NO_FRAME; 4], forward)),
        (demonstrations, Vec::new()),
        (frame_of(note), steps(&views[..1], None)),
        (frame_of(item(ItemKind::Frame)), steps(&views[..1], None)),
        (summary, Vec::new()),
    ];
    let part = RecalledItem { first_step: 1, steps: 2, whole: 0, ..demonstrations };
    let repeated = vec![(part, Vec::new()); MAX_ITEMS];
    let longest = vec![(of_steps, steps(&views, forward))];
    // A plan may begin within another's document, after its own actions.
    let rest = RecalledItem { first_step: 2, steps: 3, ..plan };
    let planned =
        vec![(plan, Vec::new()), (of_steps, steps(&views[..2], forward)), (rest, Vec::new())];
    // One text for all demonstrations of the episode, and more than the instruction of an episode can have.
    let long = "青い樽を探してください 🛢 ".repeat(40);
    let instruction = Some(subject.instruction(id, &long)?);
    for (items, images) in
        [(mixed, 10), (repeated, 1), (longest, 1 + MAX_STEPS as u32), (planned, 3)]
    {
        let frame = subject.view(5)?;
        let scene = RequestScene { frame, items, instruction, ..RequestScene::default() };
        let decision = subject.ask_and_wait(id, &scene)?;
        // The steps before this one are in the window.
        let (asked, shown) = (decision.images_asked, images + id.step);
        if asked != NOT_MEASURED && asked != shown {
            return wrong(format_args!(
                "`images_asked` is {asked} for a request with {shown} images"
            ));
        }
        id = next(id);
    }
    clear_away(subject)
}

fn windows(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let views = subject.views(200..202 + MAX_WINDOW as u64)?;
    let segment = subject.views(300..300 + MAX_SEGMENT as u64)?;
    for window in [0, MAX_WINDOW] {
        let mut id = subject.begin_with_window(10, 1, INSTRUCTION, window as u8)?;
        for (step, &frame) in views.iter().enumerate() {
            let segment = if step < MAX_WINDOW { Vec::new() } else { segment.clone() };
            subject
                .ask_and_wait(id, &RequestScene { frame, segment, ..RequestScene::default() })?;
            id = next(id);
        }
    }
    clear_away(subject)
}

fn instructions(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let scene = plain(subject, 9)?;
    let full = "ß".repeat(MAX_INSTRUCTION / 2);
    for instruction in ["Geh zum blauen Faß, dann zurück.", "青い樽を探してください 🛢", &full, ""]
    {
        let id = subject.begin(11, 1, instruction)?;
        subject.ask_and_wait(id, &scene)?;
    }
    clear_away(subject)
}

fn frames_are_released(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let chunks = kit.attach.frame_chunks() as usize;
    let subject = kit.subject()?;
    let mut shown = 0;
    let mut id = subject.begin_with_window(12, 1, INSTRUCTION, 0)?;
    // A few frames at a time, in total more than the store holds.
    while shown < 2 * chunks {
        let views = subject.views((0..1 + MAX_SEGMENT as u64).map(|seed| seed + shown as u64))?;
        shown += views.len();
        let (frame, segment) = (views[0], views[1..].to_vec());
        subject.ask_and_wait(id, &RequestScene { frame, segment, ..RequestScene::default() })?;
        id = next(id);
        subject.evict_all()?;
    }
    clear_away(subject)?;
    Ok(format!("{shown} frames in a store of {chunks}"))
}

fn invalid_messages(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let scene = plain(subject, 10)?;
    let text = subject.document(None, &Content::Note("— a note".to_owned()))?;
    let of_item =
        |item: RecalledItem| RequestScene { items: vec![(item, Vec::new())], ..scene.clone() };
    let unknown_document = of_item(RecalledItem { document: text.document + 1_000_000, ..text });
    let cut = of_item(RecalledItem { bytes: 1, ..text });
    let kind = ItemKind::Trajectory as u8;
    let wrong_kind = of_item(RecalledItem { kind, steps: 1, ..text });
    let unknown_frame = RequestScene { segment: vec![scene.frame + 1_000_000], ..scene.clone() };
    let mut ignored = Vec::new();
    for (lane, what) in [
        "a feedback code of 77",
        "a document that was never published",
        "a frame that was never published",
        "nine items",
        "an item of kind 77",
        "an item with steps that the message does not have",
        "a text that ends within a character",
        "steps of a document that is a text",
    ]
    .into_iter()
    .enumerate()
    {
        let lane = 20 + lane as u32;
        let id = subject.begin(lane, 1, INSTRUCTION)?;
        subject.expect_none(id);
        let (mut observed, mut recalled) = (observation(id, scene.frame), scene.recall(id));
        match lane - 20 {
            0 => observed.feedback = 77,
            1 => recalled = unknown_document.recall(id),
            2 => recalled = unknown_frame.recall(id),
            3 => recalled.items_len = MAX_ITEMS as u32 + 1,
            4 => supply(&mut recalled, RecalledItem { kind: 77, ..item(ItemKind::Text) }, &[]),
            5 => supply(&mut recalled, RecalledItem { steps: 3, ..item(ItemKind::Steps) }, &[]),
            6 => recalled = cut.recall(id),
            _ => recalled = wrong_kind.recall(id),
        }
        subject.recall(&recalled)?;
        subject.observe(&observed)?;
        subject.notify()?;
        // Requests of another lane are still answered.
        let other = subject.begin(lane + 20, 1, INSTRUCTION)?;
        if let Err(Trouble::Wrong(why)) = subject.ask_and_wait(other, &scene) {
            return wrong(format_args!("after {what}: {why}"));
        }
        subject.listen_for(Duration::from_millis(40))?;
        if subject.take_errors().is_empty() {
            ignored.push(what);
        }
        // The lane itself is answered again, too, in its next episode.
        let again = subject.begin(lane, 1, INSTRUCTION)?;
        subject.ask_and_wait(again, &scene)?;
    }
    if !ignored.is_empty() {
        return wrong(format_args!("no error report about {}", ignored.join(", ")));
    }
    clear_away(subject)
}

fn same_request_again(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let mut answers = Vec::new();
    for round in 0..6 {
        // New ids for the same pixels.
        let (frame, segment) = (subject.view(11)?, subject.views(15..18)?);
        let scene = RequestScene { frame, segment, ..RequestScene::default() };
        let mut id = subject.begin(13 + round, 5, INSTRUCTION)?;
        for past in subject.views(12..15)? {
            subject.ask_and_wait(id, &RequestScene { frame: past, ..RequestScene::default() })?;
            id = next(id);
        }
        for lane in 30..30 + 3 * round {
            let other = subject.begin(lane, lane.into(), "Find a red cone.")?;
            subject.ask(other, &scene)?;
        }
        let decision = subject.ask_and_wait(id, &scene)?;
        answers.push((decision.outcome, decision.action));
        subject.evict_all()?;
    }
    let said = |(_, action): &(u8, u8)| match Action::try_from(*action) {
        Ok(action) => format!("{action:?}"),
        Err(_) => "no action".to_owned(),
    };
    if answers.iter().any(|answer| *answer != answers[0]) {
        let said: Vec<String> = answers.iter().map(said).collect();
        let what = format!("the same request, six times: {}", said.join(", "));
        return Err(Trouble::Doubtful(what));
    }
    clear_away(subject)
}

fn restart(kit: &mut PolicyKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let scene = plain(subject, 19)?;
    let id = subject.begin(0, 1, INSTRUCTION)?;
    subject.ask(id, &scene)?;
    subject.notify()?;
    kit.kill_subject();
    let subject = kit.subject()?;
    let scene = plain(subject, 20)?;
    let id = subject.begin(0, 1, INSTRUCTION)?;
    subject.ask_and_wait(id, &scene)?;
    clear_away(subject)
}
