//! The checks of an external memory, in the order in which they run: one function for each difficult situation.

use std::time::Duration;
use std::{fs, thread};

use shm_types::MemoryDescription;
use shm_types::description::Scope;
use supervise::Children;

use crate::LANES;
use crate::checks::{Check, clear_away};
use crate::memory::answers::difference;
use crate::memory::{MemoryRole, ScriptedDemonstration, demonstrated, wait_for_description};
use crate::messages::external_episode;
use crate::subject::{CheckResult, TestedRole, next, wait_for_exit, wrong};

mod episodes;
mod invalid;
mod learning;

use episodes::{
    a_query, an_episode, budgets, end, interleaved, late_queries, many_demonstrations, many_lanes,
    mixed_histories, new_episode, small_banks, texts, times,
};
use invalid::invalid_messages;
use learning::{evaluates_without_learning, learns_and_saves, loads_what_it_has_saved};

type MemoryKit<'a> = crate::Kit<'a, MemoryRole>;

/// The instruction of an ordinary episode.
const INSTRUCTION: &str = "Find a blue barrel.";

/// How long a memory is watched while it waits for its run.
const WAIT_FOR_RUN: Duration = Duration::from_secs(1);

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
        advice: "with an SDK, `build` returns no error within --start-timeout; without an SDK, read the bank, build, \
                 send ExternalBuilt with the bank's id, and notify the memory process",
        run: builds,
    },
    Check {
        name: "answers a query",
        expected: "one answer with at most eight items, whose references lie in the bank and whose texts are UTF-8",
        advice: "with an SDK, `recall` returns at most eight items and no error; without an SDK, answer each query \
                 once, with its lane, step and episode, and notify the memory process. Demonstrations and steps count \
                 from 0",
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
        advice: "with an SDK, `save` returns once everything is written; without an SDK, an ExternalStore with `loads` = 0 is \
                 answered with one ExternalStored then. The episode's steps are those of the demonstration that its last \
                 query names",
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
    Check::STOPS,
    Check::ENDS_WITH_THE_ORCHESTRATOR,
    Check {
        name: "ends if the run does not begin",
        expected: "it ends soon if its folder is removed while it waits for attach.json",
        advice: "check a few times a second whether the folder exists, and exit when it does not",
        run: run_does_not_begin,
    },
    Check::REFUSES_ANOTHER_WIRE_VERSION,
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
            "it calls itself deterministic, and its answers to the same query differ: {}",
            difference(&answers[0], &answers[at])
        )),
    }
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
    let changes = before.changes(&subject.role.description);
    if !changes.is_empty() {
        return wrong(format_args!(
            "it describes itself otherwise when it starts again: {changes}"
        ));
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
