//! The hard situations, one function each, in the order in which they are played.

use std::fs;
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::Context;
use domain::Action;
use shm_types::ATTACH_VARIABLE;
use shm_types::attach::ATTACH_FILE;
use shm_types::documents::Content;
use shm_types::message::{
    MAX_INSTRUCTION, MAX_SEGMENT, MAX_WINDOW, NO_ACTION, NO_FRAME, TrajectoryStep, WIRE_VERSION,
};

use super::stage::{
    RequestId, Scene, Stage, Step, Trouble, last, observation, recall, wait_for_death, wrong,
};
use super::{Kit, LANES};
use supervise::Children;

/// What an ordinary question asks for.
const INSTRUCTION: &str = "Find a blue barrel.";

/// A situation.
pub(super) struct Check {
    /// What the policy does if all is well.
    pub(super) name: &'static str,
    /// What exactly is expected.
    pub(super) expected: &'static str,
    /// What to do where it is not so.
    pub(super) advice: &'static str,
    /// Plays it. What it returns is worth knowing even when all is well.
    pub(super) play: fn(&mut Kit<'_>) -> Step<String>,
}

/// All of them. Nothing else can be said of a policy that fails one of the first two.
pub(super) const CHECKS: &[Check] = &[
    Check {
        name: "says hello",
        expected: "it joins the run in $MEMTRANSFER_ATTACH and says hello: its role, the wire's version, its name",
        advice: "call `serve_from_environment` (Rust) or `memtransfer.run` (Python) first thing; what loads a \
                 model may take as long as --start-timeout",
        play: |kit| Ok(kit.stage()?.introduction.clone()),
    },
    Check {
        name: "answers a step",
        expected: "one decision for the one step that it is asked for",
        advice: "answer each request once, with the lane, step and ticket that it came with, and ring the \
                 orchestrator",
        play: a_step,
    },
    Check {
        name: "walks an episode",
        expected: "one decision for each of eight steps with a growing window, and none for the episode's end",
        advice: "an observation with `last` = 1 is the end of the episode: nobody waits for a decision",
        play: an_episode,
    },
    Check {
        name: "answers 64 lanes at once",
        expected: "one decision for each of 64 lanes that are asked together",
        advice: "take all that waits into one batch; `act` returns one decision for each request of its batch",
        play: many_lanes,
    },
    Check {
        name: "keeps lanes apart",
        expected: "one decision for each of nine lanes at different steps, whose messages come interleaved",
        advice: "join recall and observation by lane, ticket and step: either may come first",
        play: interleaved,
    },
    Check {
        name: "begins anew when told to",
        expected: "a new episode's step is answered, whatever was open in its lane before",
        advice: "a brief ends what the lane had: forget it, and answer under the new ticket",
        play: new_episode,
    },
    Check {
        name: "ignores what is late",
        expected: "no decision for messages of an episode that is over",
        advice: "drop messages whose ticket is not the one of the lane's last brief",
        play: late_messages,
    },
    Check {
        name: "waits for slow messages",
        expected: "no decision before both observation and recall are there, and one then",
        advice: "decide a step when its observation and its recall have come, and not before",
        play: slow_messages,
    },
    Check {
        name: "reads long documents",
        expected: "a decision with two documents of 1 MiB each, supplied at several steps",
        advice: "documents may have up to 16 MiB: cut what does not fit into a prompt, and do not fail",
        play: long_documents,
    },
    Check {
        name: "takes 40 keyframes",
        expected: "a decision with four demonstrations that have 40 keyframes",
        advice: "a step of a demonstration without a keyframe has no frame; leave out images that are too many",
        play: keyframes,
    },
    Check {
        name: "takes the longest window and segment",
        expected: "a decision without window, with a window of 32, with a segment of 32, and with both",
        advice: "both lists may be empty, and may have up to 32 entries",
        play: windows,
    },
    Check {
        name: "reads any instruction",
        expected: "a decision for instructions in other scripts, of full length and of none",
        advice: "an instruction is UTF-8 of `instruction_len` bytes; no zero byte ends it",
        play: instructions,
    },
    Check {
        name: "lets go of frames",
        expected: "frames that were evicted come back to the store",
        advice: "keep a frame no longer than until its eviction, and copy what is needed for longer; in Python, \
                 do not store `frame.pixels` beyond `act`",
        play: frames_come_back,
    },
    Check {
        name: "survives garbage",
        expected: "a complaint for each message that cannot be used, no decision for it, and answers as ever to \
                   everybody else",
        advice: "check what comes before it is used; say what is wrong in a `Complaint`, drop it, go on",
        play: garbage,
    },
    Check {
        name: "decides the same again",
        expected: "the same request gets the same answer: alone, in company, in another lane, later",
        advice: "decide from the request alone, seed what is drawn with `episode_seed`, ask a model at \
                 temperature 0: otherwise runs cannot be repeated",
        play: the_same_again,
    },
    Check {
        name: "can be started again",
        expected: "killed in the middle of a step, it takes part in the next generation as in the first",
        advice: "leave nothing behind that keeps a second start from working: no lock file, no fixed port",
        play: started_again,
    },
    Check {
        name: "stops when told to",
        expected: "after a Stop: a farewell, and exit status 0 soon",
        advice: "leave the loop when a Stop has come; end threads and servers of its own with it",
        play: |kit| kit.take_stage()?.stop().map(|()| String::new()),
    },
    Check {
        name: "ends with the orchestrator",
        expected: "it ends soon when the process `orchestrator_pid` of attach.json is gone",
        advice: "look a few times a second whether that process lives, and end when it does not",
        play: orchestrator_gone,
    },
    Check {
        name: "refuses another wire version",
        expected: "it says so, and ends with an exit status other than 0",
        advice: "compare `wire_version` in attach.json before anything else",
        play: another_wire_version,
    },
];

/// A scene of one view, and nothing remembered.
fn plain(stage: &mut Stage<'_>, seed: u64) -> Step<Scene> {
    Ok(Scene { frame: stage.view(seed)?, ..Scene::default() })
}

/// Nothing more may come; the check's views are evicted.
fn clear_away(stage: &mut Stage<'_>) -> Step<String> {
    stage.settle()?;
    stage.evict_all()?;
    Ok(String::new())
}

fn a_step(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let scene = plain(stage, 1)?;
    let ticket = stage.begin(0, 1, INSTRUCTION)?;
    let decision = stage.ask_and_wait(ticket, &scene)?;
    clear_away(stage)?;
    Ok(match Action::try_from(decision.action) {
        Ok(action) => format!("its first action: {action:?}"),
        Err(_) => "its first answer was no action".to_owned(),
    })
}

fn an_episode(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let mut ticket = stage.begin(1, 2, INSTRUCTION)?;
    let mut window = Vec::new();
    for seed in 0..8 {
        let scene = Scene { frame: stage.view(seed)?, window: window.clone(), ..Scene::default() };
        stage.ask_and_wait(ticket, &scene)?;
        window.push(scene.frame);
        window = window.split_off(window.len().saturating_sub(6));
        ticket = ticket.next();
    }
    stage.expect_none(ticket);
    stage.observe(&last(ticket))?;
    stage.notify()?;
    clear_away(stage)
}

fn many_lanes(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let frames = stage.views(0..8)?;
    for lane in 0..LANES {
        let ticket = stage.begin(lane, lane.into(), INSTRUCTION)?;
        let frame = frames[lane as usize % frames.len()];
        stage.ask(ticket, &Scene { frame, window: frames.clone(), ..Scene::default() })?;
    }
    stage.notify()?;
    stage.wait()?;
    clear_away(stage)
}

fn interleaved(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let scene = plain(stage, 3)?;
    let mut tickets = Vec::new();
    for lane in [7, 60, 2, 31, 0, 63, 12, 40, 5] {
        let ticket = stage.begin(lane, lane.into(), INSTRUCTION)?;
        tickets.push(RequestId { step: lane % 4, ..ticket });
    }
    for (at, ticket) in tickets.iter().enumerate() {
        stage.expect(*ticket);
        if at % 2 == 0 {
            stage.observe(&observation(*ticket, scene.frame))?;
        } else {
            stage.recall(&recall(*ticket, &scene))?;
        }
    }
    stage.notify()?;
    for (at, ticket) in tickets.iter().enumerate().rev() {
        if at % 2 == 0 {
            stage.recall(&recall(*ticket, &scene))?;
        } else {
            stage.observe(&observation(*ticket, scene.frame))?;
        }
        stage.notify()?;
    }
    stage.wait()?;
    clear_away(stage)
}

fn new_episode(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let scene = plain(stage, 4)?;
    // Asked, and over before there can be an answer.
    let old = stage.begin(9, 1, INSTRUCTION)?;
    stage.ask(old, &scene)?;
    let new = stage.begin(9, 2, "Find a red cone.")?;
    stage.ask(new, &scene)?;
    stage.notify()?;
    stage.wait()?;
    // Over when only half of the question was there.
    let half = stage.begin(9, 3, INSTRUCTION)?;
    stage.expect_none(half);
    stage.observe(&observation(half, scene.frame))?;
    stage.notify()?;
    let new = stage.begin(9, 4, INSTRUCTION)?;
    stage.expect(new);
    stage.recall(&recall(new, &scene))?;
    stage.notify()?;
    stage.observe(&observation(new, scene.frame))?;
    stage.notify()?;
    stage.wait()?;
    clear_away(stage)
}

fn late_messages(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let scene = plain(stage, 5)?;
    let old = stage.begin(3, 1, INSTRUCTION)?;
    let new = stage.begin(3, 2, INSTRUCTION)?;
    stage.expect_none(old);
    stage.recall(&recall(old, &scene))?;
    stage.observe(&observation(old, scene.frame))?;
    stage.notify()?;
    stage.settle()?;
    stage.ask_and_wait(new, &scene)?;
    clear_away(stage)
}

fn slow_messages(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let scene = plain(stage, 6)?;
    let ticket = stage.begin(4, 1, INSTRUCTION)?;
    stage.expect_none(ticket);
    stage.notify()?;
    let pause = Duration::from_millis(300);
    stage.listen_for(pause)?;
    stage.observe(&observation(ticket, scene.frame))?;
    stage.notify()?;
    stage.listen_for(pause)?;
    stage.expect(ticket);
    stage.recall(&recall(ticket, &scene))?;
    stage.notify()?;
    stage.wait()?;
    clear_away(stage)
}

fn long_documents(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let text = |line: &str| line.repeat((1 << 20) / line.len());
    let summary = text("The blue barrels stand in aisle 3, bay 7 — second from the north. ");
    let semantic =
        text("Regale stehen in Blöcken; am Ende eines Ganges führt ein Quergang weiter.\n");
    let documents = vec![
        stage.document(None, &Content::Summary(summary))?,
        stage.document(None, &Content::Semantic(semantic))?,
    ];
    let mut ticket = stage.begin(6, 1, INSTRUCTION)?;
    for seed in 0..3 {
        let scene =
            Scene { frame: stage.view(seed)?, documents: documents.clone(), ..Scene::default() };
        stage.ask_and_wait(ticket, &scene)?;
        ticket = ticket.next();
    }
    clear_away(stage)
}

fn keyframes(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let views = stage.views(100..140)?;
    let ticket = stage.begin(8, 1, INSTRUCTION)?;
    let steps = views.chunks(10).enumerate().flat_map(|(trajectory, views)| {
        // Every other step has its view; the last one has no action.
        let steps = views.iter().flat_map(|&frame| [frame, NO_FRAME]);
        let acting = steps.map(|frame| (frame, Action::Forward as u8));
        acting.chain([(NO_FRAME, NO_ACTION)]).map(move |(frame, action)| TrajectoryStep {
            frame,
            action,
            trajectory: trajectory as u8,
            reserved: [0; 6],
        })
    });
    let document = stage.document(Some(ticket), &Content::Trajectories(steps.collect()))?;
    let frame = stage.view(7)?;
    stage.ask_and_wait(ticket, &Scene { frame, documents: vec![document], ..Scene::default() })?;
    clear_away(stage)
}

fn windows(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let frame = stage.view(8)?;
    let (past, remembered) =
        (stage.views(200..200 + MAX_WINDOW as u64)?, stage.views(300..300 + MAX_SEGMENT as u64)?);
    let mut ticket = stage.begin(10, 1, INSTRUCTION)?;
    ticket.step = 40;
    for (window, segment) in [(0, 0), (MAX_WINDOW, 0), (0, MAX_SEGMENT), (MAX_WINDOW, MAX_SEGMENT)]
    {
        let scene = Scene {
            frame,
            window: past[..window].to_vec(),
            segment: remembered[..segment].to_vec(),
            ..Scene::default()
        };
        stage.ask_and_wait(ticket, &scene)?;
        ticket = ticket.next();
    }
    clear_away(stage)
}

fn instructions(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let scene = plain(stage, 9)?;
    let full = "ß".repeat(MAX_INSTRUCTION / 2);
    for instruction in ["Geh zum blauen Faß, dann zurück.", "青い樽を探してください 🛢", &full, ""]
    {
        let ticket = stage.begin(11, 1, instruction)?;
        stage.ask_and_wait(ticket, &scene)?;
    }
    clear_away(stage)
}

fn frames_come_back(kit: &mut Kit<'_>) -> Step<String> {
    let chunks = kit.attach.frame_chunks() as usize;
    let stage = kit.stage()?;
    let mut shown = 0;
    let mut ticket = stage.begin(12, 1, INSTRUCTION)?;
    // A store of many more frames than there is room for, a few at a time.
    while shown < 2 * chunks {
        let views = stage.views((0..1 + MAX_WINDOW as u64).map(|seed| seed + shown as u64))?;
        shown += views.len();
        let (frame, window) = (views[0], views[1..].to_vec());
        stage.ask_and_wait(ticket, &Scene { frame, window, ..Scene::default() })?;
        ticket = ticket.next();
        stage.evict_all()?;
    }
    clear_away(stage)?;
    Ok(format!("{shown} frames through room for {chunks}"))
}

fn garbage(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let scene = plain(stage, 10)?;
    let unknown_document = Scene { documents: vec![scene.frame + 1_000_000], ..scene.clone() };
    let unknown_frame = Scene { window: vec![scene.frame + 1_000_000], ..scene.clone() };
    let mut ignored = Vec::new();
    for (lane, what) in [
        "a feedback code of 77",
        "a document that nobody published",
        "a frame that nobody published",
        "a window of 33",
    ]
    .into_iter()
    .enumerate()
    {
        let lane = 20 + lane as u32;
        let ticket = stage.begin(lane, 1, INSTRUCTION)?;
        stage.expect_none(ticket);
        let (mut observed, mut recalled) =
            (observation(ticket, scene.frame), recall(ticket, &scene));
        match lane - 20 {
            0 => observed.feedback = 77,
            1 => recalled = recall(ticket, &unknown_document),
            2 => recalled = recall(ticket, &unknown_frame),
            _ => recalled.window_len = MAX_WINDOW as u32 + 1,
        }
        stage.recall(&recalled)?;
        stage.observe(&observed)?;
        stage.notify()?;
        // Its neighbour is answered all the same.
        let other = stage.begin(lane + 20, 1, INSTRUCTION)?;
        if let Err(Trouble::Wrong(why)) = stage.ask_and_wait(other, &scene) {
            return wrong(format_args!("after {what}: {why}"));
        }
        stage.listen_for(Duration::from_millis(40))?;
        if stage.error_reports().is_empty() {
            ignored.push(what);
        }
        // And so is the lane itself, in its next episode.
        let again = stage.begin(lane, 1, INSTRUCTION)?;
        stage.ask_and_wait(again, &scene)?;
    }
    if !ignored.is_empty() {
        return wrong(format_args!("not a word about {}", ignored.join(", ")));
    }
    clear_away(stage)
}

fn the_same_again(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let mut answers = Vec::new();
    for round in 0..6 {
        // New ids for the same pixels.
        let (frame, window) = (stage.view(11)?, stage.views(12..15)?);
        let segment = stage.views(15..18)?;
        let scene = Scene { frame, window, segment, ..Scene::default() };
        let ticket = stage.begin(13 + round, 5, INSTRUCTION)?;
        let ticket = RequestId { step: 3, ..ticket };
        for lane in 30..30 + 3 * round {
            let other = stage.begin(lane, lane.into(), "Find a red cone.")?;
            stage.ask(other, &scene)?;
        }
        stage.ask_and_wait(ticket, &scene)?;
        let decision = stage.answer(ticket).map(|d| (d.outcome, d.action));
        answers.extend(decision);
        stage.evict_all()?;
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
    clear_away(stage)
}

fn started_again(kit: &mut Kit<'_>) -> Step<String> {
    let stage = kit.stage()?;
    let scene = plain(stage, 19)?;
    let ticket = stage.begin(0, 1, INSTRUCTION)?;
    stage.ask(ticket, &scene)?;
    stage.notify()?;
    kit.kill_stage();
    let stage = kit.stage()?;
    let scene = plain(stage, 20)?;
    let ticket = stage.begin(0, 1, INSTRUCTION)?;
    stage.ask_and_wait(ticket, &scene)?;
    clear_away(stage)
}

fn orchestrator_gone(kit: &mut Kit<'_>) -> Step<String> {
    kit.kill_stage();
    let stand_in = Command::new("sleep").arg("3600").stdin(Stdio::null()).spawn();
    let mut stand_in = stand_in.context("cannot start `sleep`")?;
    kit.attach.orchestrator_pid = stand_in.id();
    let outcome = kit.stage().map(drop);
    let ended = stand_in.kill().and_then(|()| stand_in.wait());
    kit.attach.orchestrator_pid = std::process::id();
    outcome?;
    ended.context("cannot end `sleep`")?;
    // It may be gone already, as it should.
    let Some(mut stage) = kit.stage.take() else { return wrong("it is not there") };
    stage.wait_for_end()?;
    Ok(String::new())
}

fn another_wire_version(kit: &mut Kit<'_>) -> Step<String> {
    kit.kill_stage();
    let (run, attach) = kit.another_run()?;
    attach.write(run.path()).map_err(anyhow::Error::from)?;
    let file = run.path().join(ATTACH_FILE);
    let from = format!("\"wire_version\": {WIRE_VERSION}");
    let text = fs::read_to_string(&file).context("cannot read attach.json")?;
    let text = text.replace(&from, "\"wire_version\": 999");
    fs::write(&file, text).context("cannot write attach.json")?;
    let launch = kit.terms.launch.clone().attached_to(run.path());
    let mut children = Children::start(&[launch], &run.path().join("logs"))?;
    let death = wait_for_death(&mut children, kit.terms)?;
    if death.status.success() {
        return wrong("it ended with exit status 0, as if all were well");
    }
    if death.log_tail.is_empty() {
        return wrong(format_args!(
            "it ended {}: nobody can tell what is wrong with ${ATTACH_VARIABLE}",
            death.how()
        ));
    }
    Ok(format!("it said: {}", death.log_tail.lines().last().unwrap_or_default()))
}
