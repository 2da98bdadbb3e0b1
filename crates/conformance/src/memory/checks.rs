//! The checks of an external memory, in the order in which they run: one function for each difficult situation.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use shm_types::description::Scope;
use shm_types::message::{
    ExternalAnswer, ExternalEpisode, ExternalQuery, Learning, MAX_INSTRUCTION, NOT_MEASURED,
    RequestId, WirePose,
};
use shm_types::process::monotonic_ns;
use shm_types::{BankContent, MemoryDescription};
use supervise::Children;

use super::answers::Supplied;
use super::{
    MemoryRole, ScriptedDemonstration, TestedMemory, demonstrated, pose, wait_for_description,
};
use crate::LANES;
use crate::checks::{Check, another_wire_version, clear_away, orchestrator_ends, stops};
use crate::messages::{external_episode, last_query, query};
use crate::subject::{CheckResult, TestedRole, Trouble, next, wait_for_exit, wrong};

type MemoryKit<'a> = crate::Kit<'a, MemoryRole>;

/// The instruction of an ordinary episode.
const INSTRUCTION: &str = "Find a blue barrel.";

/// How long a memory is watched while it waits for its run.
const WAIT_FOR_RUN: Duration = Duration::from_millis(300);

/// Checks without which the others make no sense.
pub(crate) const REQUIRED_CHECKS: usize = 4;

/// All checks. If one of the first [`REQUIRED_CHECKS`] fails, the others are skipped.
pub(crate) const CHECKS: &[Check<MemoryRole>] = &[
    Check {
        name: "describes itself",
        expected: "a valid `description.json` in the folder $MEMTRANSFER_ATTACH, while there is no run to join yet; then \
                   it waits for `attach.json` in the folder above",
        advice: "write the file under another name and rename it, then wait; the name is 1 to 24 lower-case letters, \
                 digits and hyphens, and not that of a built-in memory",
        run: description,
    },
    Check {
        name: "joins",
        expected: "it joins the run and sends a handshake: role, index, wire version, name",
        advice: "call `serve_from_environment` (Rust) or `memtransfer.run` (Python) first; the index is the number at the \
                 end of the folder's name",
        run: |kit| Ok(kit.subject()?.introduction.clone()),
    },
    Check {
        name: "builds itself",
        expected: "one ExternalBuilt for a bank of three demonstrations, without a failure",
        advice: "read the bank, build, send ExternalBuilt with the bank's id, and notify the memory process; building may \
                 take as long as --start-timeout",
        run: builds,
    },
    Check {
        name: "answers a query",
        expected: "one answer with at most eight items, whose references lie in the bank and whose texts are UTF-8",
        advice: "answer each query once, with its lane, step and episode, and notify the memory process; count \
                 demonstrations and steps from 0",
        run: a_query,
    },
    Check {
        name: "runs an episode",
        expected: "one answer to each of eight queries, and none to the end of the episode",
        advice: "a query with `last` = 1 ends the episode and is not answered",
        run: an_episode,
    },
    Check {
        name: "tells its times",
        expected: "`received_ns` and `sent_ns` lie between the query and the arrival of its answer",
        advice: "take both from CLOCK_MONOTONIC, in nanoseconds: their difference is reported as the memory's latency",
        run: times,
    },
    Check {
        name: "answers 64 lanes at once",
        expected: "one answer to each of 64 simultaneous queries of one bank",
        advice: "receive until the queue is empty, and answer everything that was received",
        run: many_lanes,
    },
    Check {
        name: "keeps lanes apart",
        expected: "one answer to each of nine lanes at different steps, with the lane and step of its query",
        advice: "keep what belongs to an episode under its id, and answer with the query's own numbers",
        run: interleaved,
    },
    Check {
        name: "stays within its bank",
        expected: "answers that refer to the bank of the episode alone, also if it has one demonstration of one step",
        advice: "keep a memory for each bank, and look up that of the episode; limit segments to the demonstration's end",
        run: small_banks,
    },
    Check {
        name: "begins a new episode",
        expected: "the queries of a new episode are answered, whatever was open in its lane",
        advice: "an episode ends the lane's earlier one, also if its last query was lost",
        run: new_episode,
    },
    Check {
        name: "ignores late queries",
        expected: "no answer to queries of an episode that is over",
        advice: "drop queries whose episode is not the lane's last one",
        run: late_queries,
    },
    Check {
        name: "remembers 1,000 demonstrations",
        expected: "a bank of 1,000 demonstrations with 12,000 steps is built within --start-timeout, and queries are \
                   answered",
        advice: "build indices in `build`; search all embeddings in one operation, not step by step",
        run: many_demonstrations,
    },
    Check {
        name: "remembers mixed histories",
        expected: "a bank is built and queried that holds demonstrations of other tasks, the same one twice, and one \
                   without a move",
        advice: "expect any instruction in a bank, and equal demonstrations, views and distances",
        run: mixed_histories,
    },
    Check {
        name: "reads any text",
        expected: "banks and episodes with instructions in other scripts, of full length, and empty ones",
        advice: "an instruction is UTF-8 in any script, without a terminating zero, and may be empty",
        run: texts,
    },
    Check {
        name: "heeds budgets",
        expected: "an answer with budgets of zero, one image and 64 bytes of text, in which every item fits",
        advice: "look at `image_budget` and `text_budget` of the episode: an item that does not fit is dropped whole",
        run: budgets,
    },
    Check {
        name: "releases frames",
        expected: "evicted frames become free again",
        advice: "drop a frame when it is evicted, and copy what is needed for longer; in Python, do not keep \
                 `frame.pixels` after the call",
        run: frames_are_released,
    },
    Check {
        name: "releases banks",
        expected: "200 banks are built and taken back in a run of one lane",
        advice: "a bank without demonstrations takes back the one with its id: drop the memory built from it, and the \
                 sample",
        run: banks_are_released,
    },
    Check {
        name: "survives invalid messages",
        expected: "an error report or an answer with `failed` = 1 to each invalid message, and answers to all other \
                   queries",
        advice: "check values before use; send an `ErrorReport`, or fail the episode, and go on",
        run: invalid_messages,
    },
    Check {
        name: "answers the same again",
        expected: "if it calls itself deterministic, the same query gets the same answer: alone, among others, in another \
                   lane, from a bank of the same content",
        advice: "answer from the bank and the episode alone, seed random choices with the episode's seed, break ties by \
                 number; otherwise set `deterministic` to false in the description",
        run: same_query_again,
    },
    Check {
        name: "learns and saves",
        expected: "if it says that it learns: after each of two episodes that it learns from, it saves into an empty folder, \
                   and answers that refer to demonstrations and these episodes",
        advice: "an ExternalStore with `loads` = 0 is answered with one ExternalStored once everything is written; the \
                 episode's steps are those of the demonstration that its last query names",
        run: learns_and_saves,
    },
    Check {
        name: "loads what it has saved",
        expected: "if it says that it learns: a memory of another process that was built from the same bank loads what was \
                   saved; then it gives the same answers and saves the same bytes",
        advice: "save all that answers depend on, without the time, temporary names or an order that changes",
        run: loads_what_it_has_saved,
    },
    Check {
        name: "evaluates without learning",
        expected: "if it says that it learns: episodes that read only change neither later answers nor what is saved",
        advice: "learn from an episode only if its `learning` is 1 (`episode.learns`)",
        run: evaluates_without_learning,
    },
    Check {
        name: "can be restarted",
        expected: "after a kill while it builds and answers, it describes itself as before and takes part in the next \
                   generation",
        advice: "leave nothing behind that prevents a second start: no lock file, no fixed port, no half-written store",
        run: restart,
    },
    Check {
        name: "stops",
        expected: "after a Stop message: a shutdown report, and exit status 0 soon",
        advice: "leave the loop after a Stop message, and end all threads and servers",
        run: stops,
    },
    Check {
        name: "ends with the orchestrator",
        expected: "it ends soon after the process `orchestrator_pid` of attach.json",
        advice: "check a few times a second whether that process exists, and exit when it does not",
        run: orchestrator_ends,
    },
    Check {
        name: "ends if the run does not begin",
        expected: "it ends soon if its folder is removed while it waits for attach.json",
        advice: "check a few times a second whether the folder exists, and exit when it does not",
        run: run_does_not_begin,
    },
    Check {
        name: "refuses another wire version",
        expected: "it prints a message and exits with a status other than 0",
        advice: "compare `wire_version` in attach.json first",
        run: another_wire_version,
    },
];

/// Three demonstrations of ten steps.
fn ordinary() -> Vec<ScriptedDemonstration> {
    (0..3).map(|number| demonstrated(INSTRUCTION, number, 10)).collect()
}

fn description(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let (run, _) = kit.another_run()?;
    let folder = MemoryRole::folder(run.path());
    fs::create_dir_all(&folder).map_err(anyhow::Error::from)?;
    let launch = kit.terms.launch.clone().attached_to(run.path());
    let mut children = Children::start(&[launch], &run.path().join("logs"))?;
    let MemoryDescription {
        name, version, scope, embeddings, frames, deterministic, learns, ..
    } = wait_for_description(&folder, &mut children, kit.terms)?;
    thread::sleep(WAIT_FOR_RUN);
    if let Some(exit) = children.exited() {
        return wrong(format_args!("it did not wait for the run, but ended {}", exit.how()));
    }
    let scope = match scope {
        Scope::Case => "case",
        Scope::All => "all",
    };
    let uses = match (embeddings, frames) {
        (true, true) => "embeddings and frames",
        (true, false) => "embeddings",
        (false, true) => "frames",
        (false, false) => "neither embeddings nor frames",
    };
    let not = if deterministic { "" } else { "not " };
    let learns = if learns { ", learns" } else { "" };
    Ok(format!("{name} {version}, scope {scope}, {uses}, {not}deterministic{learns}"))
}

fn builds(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    subject.remember(&ordinary())?;
    clear_away(subject)
}

fn a_query(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let id = subject.begin(0, bank, INSTRUCTION)?;
    let (_, items) = subject.ask_and_wait(id, 3)?;
    clear_away(subject)?;
    let images: usize = items.iter().map(|item| item.views.len()).sum();
    let bytes: usize = items.iter().map(|item| item.text.len()).sum();
    Ok(format!("its first answer: {} items, {images} images, {bytes} bytes of text", items.len()))
}

/// The end of an episode.
fn end(subject: &mut TestedMemory<'_>, id: RequestId) -> CheckResult<()> {
    subject.expect_none(id);
    subject.neighbours.queries.send(&last_query(id, WirePose::from(pose(0))))?;
    subject.notify()
}

fn an_episode(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let mut id = subject.begin(1, bank, INSTRUCTION)?;
    for seed in 0..8 {
        subject.ask_and_wait(id, seed)?;
        id = next(id);
    }
    end(subject, id)?;
    clear_away(subject)
}

fn times(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let id = subject.begin(1, bank, INSTRUCTION)?;
    let asked = monotonic_ns();
    let (ExternalAnswer { received_ns, sent_ns, .. }, _) = subject.ask_and_wait(id, 1)?;
    let arrived = monotonic_ns();
    if !(asked <= received_ns && received_ns <= sent_ns && sent_ns <= arrived) {
        return wrong(format_args!(
            "a query of {asked} ns was answered before {arrived} ns, with `received_ns` {received_ns} and \
             `sent_ns` {sent_ns}"
        ));
    }
    clear_away(subject)
}

fn many_lanes(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    for lane in 0..LANES {
        let id = subject.begin(lane, bank, INSTRUCTION)?;
        subject.ask(id, u64::from(lane) % 8)?;
    }
    subject.notify()?;
    subject.wait()?;
    clear_away(subject)
}

fn interleaved(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let mut queries = Vec::new();
    for lane in [7, 60, 2, 31, 0, 63, 12, 40, 5] {
        let mut id = subject.begin(lane, bank, INSTRUCTION)?;
        for _ in 0..lane % 4 {
            subject.ask_and_wait(id, 3)?;
            id = next(id);
        }
        queries.push(id);
    }
    for &id in &queries {
        subject.ask(id, 3)?;
    }
    subject.notify()?;
    subject.wait()?;
    clear_away(subject)
}

fn small_banks(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let large = subject.remember(&ordinary())?;
    let mut banks = vec![large];
    for (number, steps) in [(0, 1), (1, 2), (2, 4)] {
        banks.push(subject.remember(&[demonstrated(INSTRUCTION, number, steps)])?);
    }
    let mut queries = Vec::new();
    for (lane, &bank) in (0..).zip(&banks) {
        queries.push(subject.begin(lane, bank, INSTRUCTION)?);
    }
    // The view at the end of the large bank's last demonstration, then one that no bank has.
    for seed in [2009, 70] {
        for id in &mut queries {
            subject.ask(*id, seed)?;
            *id = next(*id);
        }
        subject.notify()?;
        subject.wait()?;
    }
    clear_away(subject)
}

fn new_episode(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let other = subject.remember(&[demonstrated("Find a red cone.", 4, 6)])?;
    // The episode ends before it is answered.
    let old = subject.begin(9, bank, INSTRUCTION)?;
    subject.ask(old, 4)?;
    let new = subject.begin(9, other, "Find a red cone.")?;
    subject.ask(new, 4)?;
    subject.notify()?;
    subject.wait()?;
    // A report about the old query is welcome, and none is, too.
    subject.take_errors();
    // The episode ends without its last query.
    let newer = subject.begin(9, bank, INSTRUCTION)?;
    subject.ask_and_wait(newer, 5)?;
    clear_away(subject)
}

fn late_queries(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let old = subject.begin(3, bank, INSTRUCTION)?;
    let new = subject.begin(3, bank, INSTRUCTION)?;
    subject.ask_and_wait(new, 5)?;
    subject.expect_refusal(old);
    subject.query(old, 5)?;
    subject.notify()?;
    subject.ask_and_wait(next(new), 6)?;
    subject.listen_for(Duration::from_millis(60))?;
    // A report is welcome, and none is, too.
    subject.take_errors();
    clear_away(subject)
}

fn many_demonstrations(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let tasks = ["Find a blue barrel.", "Find a red cone.", "Go to aisle 3, then to the gate."];
    let demonstrations: Vec<ScriptedDemonstration> = (0..1000)
        .map(|number| demonstrated(tasks[number as usize % tasks.len()], number, 12))
        .collect();
    let began = monotonic_ns();
    let bank = subject.remember(&demonstrations)?;
    let built = monotonic_ns();
    let mut id = subject.begin(5, bank, INSTRUCTION)?;
    let mut answered = 0;
    for seed in 0..4 {
        let asked = monotonic_ns();
        subject.ask_and_wait(id, seed)?;
        answered = monotonic_ns() - asked;
        id = next(id);
    }
    end(subject, id)?;
    clear_away(subject)?;
    subject.take_back(bank)?;
    let milliseconds = |ns: u64| ns as f64 / 1e6;
    let (built, answered) = (milliseconds(built - began), milliseconds(answered));
    Ok(format!("built in {built:.0} ms, answers a query in {answered:.1} ms"))
}

fn mixed_histories(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let own = demonstrated(INSTRUCTION, 0, 10);
    let back = ScriptedDemonstration {
        instruction: "Go back to the gate.".to_owned(),
        views: own.views.iter().rev().copied().collect(),
    };
    let stays =
        ScriptedDemonstration { views: vec![7; 5], ..demonstrated("Wait at the gate.", 0, 1) };
    let mut demonstrations = vec![own.clone(), back, own, stays];
    for (number, task) in (10..).zip(["Find a red cone.", "Find a pallet jack.", "Find the exit."])
    {
        demonstrations.push(demonstrated(task, number, 3 * number % 20 + 1));
    }
    let bank = subject.remember(&demonstrations)?;
    // Also from a start that no demonstration has seen, and for a task that none shows.
    for (lane, instruction) in [(6, INSTRUCTION), (7, "Find a yellow ladder.")] {
        let mut id = subject.begin(lane, bank, instruction)?;
        for seed in [7, 3, 80] {
            subject.ask_and_wait(id, seed)?;
            id = next(id);
        }
    }
    clear_away(subject)
}

fn texts(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let full = "ß".repeat(MAX_INSTRUCTION / 2);
    let long = "Walk along the shelf — then turn; ".repeat(300);
    let said = ["Geh zum blauen Faß, dann zurück.", "青い樽を探してください 🛢", &full, "", " "];
    let told = said.into_iter().chain([long.as_str()]);
    let demonstrations: Vec<ScriptedDemonstration> =
        (0..).zip(told).map(|(number, text)| demonstrated(text, number, 4)).collect();
    let bank = subject.remember(&demonstrations)?;
    for instruction in said {
        let id = subject.begin(11, bank, instruction)?;
        subject.ask_and_wait(id, 2)?;
    }
    clear_away(subject)
}

fn budgets(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let mut dropped = Vec::new();
    for (lane, (images, text)) in (12..).zip([(0, 0), (1, 64), (0, 65_536), (16, 0)]) {
        let mut begun = external_episode(lane, 0, bank, INSTRUCTION);
        (begun.image_budget, begun.text_budget) = (images, text);
        let id = subject.begin_with(begun)?;
        let (_, items) = subject.ask_and_wait(id, 4)?;
        let count = items_that_do_not_fit(&items, images as usize, text as usize);
        if count > 0 {
            dropped.push(format!(
                "{count} of {} items with {images} images and {text} bytes of text",
                items.len()
            ));
        }
    }
    clear_away(subject)?;
    if dropped.is_empty() {
        return Ok(String::new());
    }
    Err(Trouble::Doubtful(format!("a run would drop {}", dropped.join(", "))))
}

/// The number of items that the memory process drops.
fn items_that_do_not_fit(items: &[Supplied], mut images: usize, mut text: usize) -> usize {
    let mut dropped = 0;
    for item in items {
        if item.views.len() <= images && item.text.len() <= text {
            images -= item.views.len();
            text -= item.text.len();
        } else {
            dropped += 1;
        }
    }
    dropped
}

fn frames_are_released(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let chunks = kit.attach.frame_chunks() as u64;
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    subject.evict_all()?;
    let mut id = subject.begin(12, bank, INSTRUCTION)?;
    // In total more than the store holds, of which the memory has asked for a few at a time.
    let mut shown = 0;
    while shown < 2 * chunks {
        for seed in 0..8 {
            subject.ask_and_wait(id, shown + seed)?;
            id = next(id);
        }
        for seed in 8..32 {
            subject.view(shown + seed)?;
        }
        shown += 32;
        // The window of the episode keeps its frames: another one begins.
        subject.evict_all()?;
        id = subject.begin(12, bank, INSTRUCTION)?;
    }
    clear_away(subject)?;
    Ok(format!("{shown} frames in a store of {chunks}"))
}

fn banks_are_released(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    kit.kill_subject();
    kit.attach.lanes = 1;
    let outcome = kit.subject().and_then(|subject| {
        for _ in 0..20 {
            let mut banks = Vec::new();
            for number in 0..10 {
                let content = subject.content(&[demonstrated(INSTRUCTION, number, 2)])?;
                banks.push(subject.publish_bank(&content)?);
            }
            subject.wait_for_banks()?;
            let id = subject.begin(0, banks[0], INSTRUCTION)?;
            subject.ask_and_wait(id, 1)?;
            end(subject, next(id))?;
            for bank in banks {
                subject.take_back(bank)?;
            }
        }
        clear_away(subject)
    });
    kit.attach.lanes = LANES;
    kit.kill_subject();
    outcome
}

/// A message that cannot be used, in words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Invalid {
    Feedback,
    Heading,
    Bank,
    Instruction,
    Episode,
    Demonstration,
}

impl Invalid {
    const ALL: [Self; 6] = [
        Self::Feedback,
        Self::Heading,
        Self::Bank,
        Self::Instruction,
        Self::Episode,
        Self::Demonstration,
    ];

    const fn words(self) -> &'static str {
        match self {
            Self::Feedback => "a feedback code of 77",
            Self::Heading => "a pose with heading code 77",
            Self::Bank => "an episode that remembers a bank that was never published",
            Self::Instruction => "an instruction of 4,000,000,000 bytes",
            Self::Episode => "a query of an episode that never began",
            Self::Demonstration => "a bank whose demonstration lies outside of it",
        }
    }
}

fn invalid_messages(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let mut ignored = Vec::new();
    for (lane, invalid) in (20..).zip(Invalid::ALL) {
        let mut begun = external_episode(lane, 0, bank, INSTRUCTION);
        match invalid {
            Invalid::Bank => begun.bank += 1_000_000,
            Invalid::Instruction => begun.instruction_len = 4_000_000_000,
            _ => {}
        }
        let mut id = subject.begin_with(begun)?;
        if invalid == Invalid::Episode {
            id.episode += 1_000_000;
        }
        let mut refused_bank = None;
        if invalid == Invalid::Demonstration {
            let mut content: BankContent = subject.content(&ordinary())?;
            content.demonstrations[1].first_step = 1_000_000;
            refused_bank = Some(subject.publish_unusable(&content)?);
        } else {
            subject.expect_refusal(id);
            let frame = subject.seen(10)?;
            let usual = query(id, frame, WirePose::from(pose(10)), &[]);
            let sent = match invalid {
                Invalid::Feedback => ExternalQuery { feedback: 77, ..usual },
                Invalid::Heading => ExternalQuery { pose: WirePose([3, 4, 77, 0]), ..usual },
                _ => usual,
            };
            subject.neighbours.queries.send(&sent)?;
        }
        subject.notify()?;
        // Queries of another lane are still answered.
        let other = subject.begin(lane + 20, bank, INSTRUCTION)?;
        if let Err(Trouble::Wrong(why)) = subject.ask_and_wait(other, 11) {
            return wrong(format_args!("after {}: {why}", invalid.words()));
        }
        subject.listen_for(Duration::from_millis(40))?;
        let is_refused = refused_bank.is_some_and(|bank| subject.refused(bank));
        if subject.take_errors().is_empty() && !is_refused {
            ignored.push(invalid.words());
        }
        // The lane itself is answered again, too, in its next episode.
        let again = subject.begin(lane, bank, INSTRUCTION)?;
        subject.ask_and_wait(again, 11)?;
    }
    if !ignored.is_empty() {
        return wrong(format_args!("neither report nor failure after {}", ignored.join(", ")));
    }
    clear_away(subject)
}

fn same_query_again(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let first = subject.remember(&ordinary())?;
    let mut answers = Vec::new();
    for round in 0..6 {
        let bank = if round < 3 { first } else { subject.remember(&ordinary())? };
        let mut begun = external_episode(13 + round, 0, bank, INSTRUCTION);
        begun.seed = 5;
        let mut id = subject.begin_with(begun)?;
        for past in [12, 13, 14] {
            subject.ask_and_wait(id, past)?;
            id = next(id);
        }
        for lane in 30..30 + 3 * round {
            let other = subject.begin(lane, bank, "Find a red cone.")?;
            subject.ask(other, 15)?;
        }
        let (_, items) = subject.ask_and_wait(id, 16)?;
        answers.push(items);
        subject.evict_all()?;
    }
    let differs = answers.iter().position(|answer| *answer != answers[0]);
    let is_deterministic = subject.role.description.deterministic;
    clear_away(subject)?;
    match differs {
        None => Ok(String::new()),
        Some(_) if !is_deterministic => Ok("it does not, as it says".to_owned()),
        Some(at) => wrong(format_args!(
            "it calls itself deterministic, and answers the same query with {:?}, then with {:?}",
            answers[0], answers[at]
        )),
    }
}

/// What the checks of learning say of a memory that does not.
const NO_LEARNING: &str = "it does not learn, as it says";

/// The views of an episode that is learned from.
const LEARNED: [u64; 4] = [3, 4, 71, 72];

/// Plays an episode that the memory of `bank` learns from, and has it saved into a new folder.
fn learn(kit: &mut MemoryKit<'_>, bank: u64, success: bool) -> CheckResult<PathBuf> {
    let subject = kit.subject()?;
    let learning = Learning::Learns as u32;
    let begun = ExternalEpisode { learning, ..external_episode(0, 0, bank, INSTRUCTION) };
    let mut id = subject.begin_with(begun)?;
    for seed in LEARNED {
        subject.ask_and_wait(id, seed)?;
        id = next(id);
    }
    subject.expect_none(id);
    let demonstration = subject.add_experience(bank, id.step + 1);
    let last = ExternalQuery {
        outcome: 1 + u8::from(success),
        demonstration,
        sub_goals_len: NOT_MEASURED,
        ..last_query(id, WirePose::from(pose(0)))
    };
    subject.neighbours.queries.send(&last)?;
    save(kit, bank)
}

/// Has the memory of `bank` saved into a new folder.
fn save(kit: &mut MemoryKit<'_>, bank: u64) -> CheckResult<PathBuf> {
    let root = kit.attach.root.clone();
    let mut folders = (0..).map(|number| root.join(format!("snapshot-{number}")));
    let folder = folders.find(|folder| !folder.exists()).unwrap_or(root);
    fs::create_dir(&folder).map_err(anyhow::Error::from)?;
    kit.subject()?.store(bank, &folder, false)?;
    Ok(folder)
}

/// What the memory of `bank` supplies in an episode that reads only.
fn evaluated(kit: &mut MemoryKit<'_>, bank: u64) -> CheckResult<Vec<Vec<Supplied>>> {
    let subject = kit.subject()?;
    let learning = Learning::ReadsOnly as u32;
    let begun = ExternalEpisode { learning, ..external_episode(1, 0, bank, INSTRUCTION) };
    let mut id = subject.begin_with(begun)?;
    let mut supplied = Vec::new();
    for seed in [12, 71, 80] {
        supplied.push(subject.ask_and_wait(id, seed)?.1);
        id = next(id);
    }
    end(subject, id)?;
    Ok(supplied)
}

/// The files below `folder`, by path.
fn files(folder: &Path) -> CheckResult<BTreeMap<PathBuf, Vec<u8>>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).map_err(anyhow::Error::from)? {
            let path = entry.map_err(anyhow::Error::from)?.path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let bytes = fs::read(&path).map_err(anyhow::Error::from)?;
                found.insert(path.strip_prefix(folder).unwrap_or(&path).to_owned(), bytes);
            }
        }
    }
    Ok(found)
}

/// Checks that two snapshots are equal.
fn compare_files(one: &Path, other: &Path, when: &str) -> CheckResult<()> {
    let (one, other) = (files(one)?, files(other)?);
    let all: BTreeSet<&PathBuf> = one.keys().chain(other.keys()).collect();
    let differs: Vec<String> = all
        .into_iter()
        .filter(|path| one.get(*path) != other.get(*path))
        .map(|path| path.display().to_string())
        .collect();
    if differs.is_empty() {
        return Ok(());
    }
    wrong(format_args!("it saves other bytes {when}: {}", differs.join(", ")))
}

/// Checks that two evaluations had the same answers.
fn compare_answers(one: &[Vec<Supplied>], other: &[Vec<Supplied>], when: &str) -> CheckResult<()> {
    match one.iter().zip(other).find(|(one, other)| one != other) {
        None => Ok(()),
        Some((one, other)) => {
            wrong(format_args!("it answered a query with {one:?}, and {when} with {other:?}"))
        }
    }
}

fn learns_and_saves(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    if !subject.role.description.learns {
        return Ok(NO_LEARNING.to_owned());
    }
    let bank = subject.remember(&ordinary())?;
    for success in [true, false] {
        learn(kit, bank, success)?;
        evaluated(kit, bank)?;
    }
    clear_away(kit.subject()?)
}

fn loads_what_it_has_saved(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let MemoryDescription { learns, deterministic, .. } = subject.role.description;
    if !learns {
        return Ok(NO_LEARNING.to_owned());
    }
    let bank = subject.remember(&ordinary())?;
    let saved = learn(kit, bank, true)?;
    let before = evaluated(kit, bank)?;
    kit.kill_subject();
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    subject.store(bank, &saved, true)?;
    subject.add_experience(bank, LEARNED.len() as u32 + 1);
    let after = evaluated(kit, bank)?;
    let again = save(kit, bank)?;
    clear_away(kit.subject()?)?;
    if !deterministic {
        return Ok("it does not call itself deterministic: not compared".to_owned());
    }
    let when = "after it was loaded";
    compare_answers(&before, &after, when)?;
    compare_files(&saved, &again, when)?;
    Ok(String::new())
}

fn evaluates_without_learning(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let MemoryDescription { learns, deterministic, .. } = subject.role.description;
    if !learns {
        return Ok(NO_LEARNING.to_owned());
    }
    let bank = subject.remember(&ordinary())?;
    let saved = learn(kit, bank, true)?;
    let [before, after] = [evaluated(kit, bank)?, evaluated(kit, bank)?];
    let again = save(kit, bank)?;
    clear_away(kit.subject()?)?;
    let when = "after an episode that reads only";
    compare_files(&saved, &again, when)?;
    if deterministic {
        compare_answers(&before, &after, when)?;
    }
    Ok(String::new())
}

fn restart(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let before = subject.role.description.clone();
    let bank = subject.remember(&ordinary())?;
    let id = subject.begin(0, bank, INSTRUCTION)?;
    subject.ask(id, 19)?;
    let content = subject.content(&ordinary())?;
    subject.publish_bank(&content)?;
    kit.kill_subject();
    let subject = kit.subject()?;
    let after = subject.role.description.clone();
    if before != after {
        return wrong(format_args!("it described itself as {before:?}, and then as {after:?}"));
    }
    let bank = subject.remember(&ordinary())?;
    let id = subject.begin(0, bank, INSTRUCTION)?;
    subject.ask_and_wait(id, 20)?;
    clear_away(subject)
}

fn run_does_not_begin(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let (run, _) = kit.another_run()?;
    let folder = MemoryRole::folder(run.path());
    fs::create_dir_all(&folder).map_err(anyhow::Error::from)?;
    let launch = kit.terms.launch.clone().attached_to(run.path());
    // Its log outlives the run.
    let logs = kit.attach.root.join("logs-without-a-run");
    let mut children = Children::start(&[launch], &logs)?;
    wait_for_description(&folder, &mut children, kit.terms)?;
    drop(run);
    wait_for_exit(&mut children, kit.terms)?;
    Ok(String::new())
}
