//! A run with an external memory that works, ends, hangs or complains, among scripted processes.

use std::collections::BTreeMap;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use bytemuck::Zeroable;
use conditions::Condition;
use conformance::messages::{recall, recall_trace};
use orchestrator::external_memory::ExternalMemory;
use orchestrator::lanes::Lanes;
use orchestrator::pipeline::{Ending, MemoryState, PipelineOptions, run_episodes};
use orchestrator::plan::plan;
use rigs::process::{LONG, ScratchRun};
use rigs::scripted::{ScriptedProcess, ScriptedRun, request};
use shm_types::description::{DESCRIPTION_FILE, memory_folder};
use shm_types::message::{
    EXTERNAL, ErrorReport, ErrorReportKind, Heartbeat, MemoryEpisodeConfig, Observation, RequestId,
    Role, write_text,
};
use shm_types::{Attach, Bus, MemoryDescription};
use supervise::{Children, Launch};

use crate::common::{RULES, Seen, books, options};

const TICK: Duration = Duration::from_millis(20);
const LANES: u32 = 4;
const SHORT: Duration = Duration::from_millis(300);

/// The name of the external memory of the tests below.
const MEMORY: &str = "top-3";

/// The external memory, which `command` starts.
fn memory(command: Option<String>) -> ExternalMemory {
    let description = MemoryDescription { name: MEMORY.to_owned(), ..MemoryDescription::default() };
    ExternalMemory { index: 0, name: MEMORY.parse().unwrap(), description, command }
}

/// What the host of the external memory does about its episodes.
#[derive(Clone, Copy)]
enum Host {
    /// It waits, and recalls nothing.
    Waits,
    /// It gives each of them up after so many milliseconds.
    GivesUp(u64),
    /// It recalls as for all other episodes.
    Recalls,
}

/// The memory process of a run with an external memory.
fn host(run: &ScriptedRun<'_>, about_external: Host) {
    let mut ports = None;
    let mut external = BTreeMap::new();
    let mut asked: Vec<(RequestId, Instant)> = Vec::new();
    run.serve(Role::Memory, |process| {
        let (configs, observations) = ports.get_or_insert_with(|| {
            let configs = process.bus.receiver::<MemoryEpisodeConfig>().unwrap();
            (configs, process.bus.receiver::<Observation>().unwrap())
        });
        // The config of an episode comes before its observations.
        let observations = observations.drain().unwrap();
        for config in configs.drain().unwrap() {
            assert!(config.representation != EXTERNAL || config.external == 0);
            external.insert(config.episode, config.representation == EXTERNAL);
        }
        for observation in observations.iter().filter(|observation| observation.last == 0) {
            let (id, is_external) = (request(observation), external[&observation.episode]);
            match about_external {
                Host::GivesUp(_) if is_external => asked.push((id, Instant::now())),
                Host::Waits if is_external => {}
                _ => {
                    // Slow enough that the run lasts for several looks at the reports.
                    thread::sleep(Duration::from_millis(if is_external { 10 } else { 0 }));
                    process.send(&recall_trace(id), &[]);
                    process.send(&recall(id, &[]), &[Role::Policy]);
                }
            }
        }
        let Host::GivesUp(after_ms) = about_external else { return };
        let is_due = |asked: &Instant| asked.elapsed() >= Duration::from_millis(after_ms);
        for (id, _) in asked.extract_if(.., |(_, asked)| is_due(asked)) {
            let text = format!("{MEMORY} has not answered step 0 within {after_ms} ms");
            report(process, ErrorReportKind::Overdue, (id.episode, id.lane), &text);
        }
    });
}

fn report(
    process: &ScriptedProcess,
    kind: ErrorReportKind,
    (episode, lane): (u64, u32),
    text: &str,
) {
    let mut report = ErrorReport {
        episode,
        role: process.bus.role() as u32,
        kind: kind as u32,
        lane,
        index: process.bus.index().into(),
        ..Zeroable::zeroed()
    };
    report.text_len = write_text(&mut report.text, text);
    process.send(&report, &[Role::Orchestrator]);
}

/// The external memory: it attaches once it has described itself, and calls `turn`.
fn external_memory(run: &ScriptedRun<'_>, turn: impl Fn(&ScriptedProcess)) {
    let described = memory_folder(&run.attach.root, 0).join(DESCRIPTION_FILE);
    while !described.exists() {
        if run.over.load(Ordering::Relaxed) {
            return;
        }
        thread::sleep(TICK);
    }
    run.external_memory(0, turn);
}

/// Calls `serve` for each generation of a run that `over` does not end, as long as the external memory takes part.
fn in_each_generation(
    attach: &Attach,
    over: &AtomicBool,
    is_memory: bool,
    serve: impl Fn(&ScriptedRun<'_>),
) {
    let mut last = 0;
    while !over.load(Ordering::Relaxed) {
        match Attach::read(&attach.root) {
            Ok(now) if now.generation > last => {
                last = now.generation;
                if !is_memory || !now.external_memories.is_empty() {
                    serve(&ScriptedRun { attach: &now, over });
                }
            }
            _ => thread::sleep(TICK),
        }
    }
}

/// Runs four episodes with working memory and four with an external one, whose process executes `script` after it has
/// described itself, and which calls `turn` on its bus.
fn run_with_memory(
    about_external: Host,
    script: &str,
    turn: impl Fn(&ScriptedProcess) + Copy + Send,
) -> (Seen, Ending) {
    let scratch = ScratchRun::new(&Role::CHILDREN, |attach| {
        attach.lanes = LANES;
        attach.external_memories = vec![0];
    });
    let books = books();
    let ids = books.cases.book.ids();
    let conditions = ["working/original/unchanged/none", "top-3/original/unchanged/original"];
    let conditions = conditions.map(|name| (Condition::logged(name).unwrap(), 1));
    let episodes = plan(&conditions, &[0, 1, 2, 3], &ids, 1);
    let mut rules = RULES;
    rules.external_memories[0] = Some(MEMORY.parse().unwrap());
    let mut lanes = Lanes::new(&books, rules, LANES as usize);
    let script = format!(
        "cd $MEMTRANSFER_ATTACH; echo '{}' > d; mv d {DESCRIPTION_FILE}; {script}",
        r#"{"name": "top-3"}"#
    );
    let command = format!("/bin/sh -c {}", shlex::try_quote(&script).unwrap());
    let sleeper = Launch::command(Role::Sim, "sleep 3600").unwrap();
    // Exceeded only where the host gives episodes up that late.
    let memory_timeout = match about_external {
        Host::GivesUp(after_ms) if after_ms > SHORT.as_millis() as u64 => SHORT,
        _ => LONG,
    };
    let options = PipelineOptions {
        memories: vec![memory(Some(command))],
        memory_timeout,
        ..options(&scratch, vec![sleeper], LONG)
    };
    let (mut seen, over) = (Seen::default(), AtomicBool::new(false));
    let outcome = thread::scope(|scope| {
        let each = |is_memory, serve: Box<dyn Fn(&ScriptedRun<'_>) + Send>| {
            let (attach, over) = (scratch.attach(), &over);
            scope.spawn(move || in_each_generation(attach, over, is_memory, serve));
        };
        each(false, Box::new(|run| run.sim()));
        each(false, Box::new(move |run| host(run, about_external)));
        each(false, Box::new(|run| run.policy(|_, decision| decision)));
        each(true, Box::new(move |run| external_memory(run, turn)));
        let (stop, none) = (AtomicBool::new(false), Children::default());
        let outcome =
            run_episodes(&mut lanes, episodes, scratch.attach(), &options, none, &stop, &mut seen);
        over.store(true, Ordering::Relaxed);
        outcome
    });
    seen.finished.sort();
    (seen, outcome.unwrap())
}

/// Checks that the episodes with the external memory have no result, for a reason that says all of `said`, and that all
/// others are finished.
fn check_only_the_memory_suffers(seen: &Seen, ending: &Ending, said: &[&str]) {
    assert_eq!(seen.finished, [0, 1, 2, 3], "{:?}", seen.problems);
    assert_eq!(ending.unfinished.len(), 4);
    for (episode, why) in &ending.unfinished {
        assert_eq!(episode.key.condition.memory.name(), MEMORY);
        assert!(said.iter().all(|said| why.contains(said)), "{why}");
    }
}

/// Otherwise an external memory that is killed while it creates one of them ends the run.
#[test]
fn the_orchestrator_creates_its_services_before_others_can_join() {
    let scratch = ScratchRun::new(&Role::CHILDREN, |attach| attach.external_memories = vec![0]);
    Attach::withdraw(&scratch.attach().root).unwrap();
    let books = books();
    let conditions = [(Condition::logged("working/original/unchanged/none").unwrap(), 1)];
    let ids = books.cases.book.ids();
    let episodes = plan(&conditions, &[0], &ids, 1);
    let mut lanes = Lanes::new(&books, RULES, 1);
    let options = PipelineOptions {
        external_policy: true,
        memories: vec![memory(None)],
        ..options(&scratch, Vec::new(), Duration::from_secs(120))
    };
    let stop = AtomicBool::new(false);
    let attached = thread::scope(|scope| {
        let stop = &stop;
        let memory = scope.spawn(|| {
            let attach = loop {
                match Attach::read(&scratch.attach().root) {
                    Ok(attach) => break attach,
                    Err(_) => thread::yield_now(),
                }
            };
            let bus = Bus::join_as(attach, Role::ExternalMemory, 0).unwrap();
            let heartbeats = bus.sender::<Heartbeat>().unwrap();
            let attached = heartbeats.is_complete();
            stop.store(true, Ordering::Relaxed);
            attached
        });
        let none = Children::default();
        let mut seen = Seen::default();
        run_episodes(&mut lanes, episodes, scratch.attach(), &options, none, stop, &mut seen)
            .unwrap();
        memory.join().unwrap()
    });
    assert!(attached, "the orchestrator does not receive yet");
}

#[test]
fn an_external_memory_that_works_takes_part_and_says_what_it_has_no_say_in() {
    // It asks for the run's end, and for that of the first episode, which is not its own.
    let once = Once::new();
    let once = &once;
    let complains = move |process: &ScriptedProcess| {
        once.call_once(|| {
            report(process, ErrorReportKind::Run, (0, 0), "stop");
            report(process, ErrorReportKind::Episode, (1, 0), "not mine");
        });
    };
    let (seen, ending) = run_with_memory(Host::Recalls, "exec sleep 300", complains);
    assert_eq!(seen.finished, [0, 0, 1, 1, 2, 2, 3, 3], "{:?}", seen.problems);
    assert!(ending.unfinished.is_empty() && ending.halted.is_none());
    assert_eq!((seen.generations, ending.shutdown_reports.len()), (1, 4));
    assert!(seen.problems.contains(&"external-memory top-3: stop".to_owned()));
}

#[test]
fn an_external_memory_that_fails_on_everything_is_left_out_and_the_run_goes_on() {
    let (seen, ending) = run_with_memory(Host::Waits, "sleep 0.5; exit 7", |_| ());
    let said = ["times without finishing an episode, and is left out", "exit status 7"];
    check_only_the_memory_suffers(&seen, &ending, &said);
    assert!(seen.states.iter().all(|(name, _)| name.as_str() == MEMORY));
    let states: Vec<_> = seen.states.iter().map(|(_, state)| state).collect();
    let [failed @ .., MemoryState::Excluded(_)] = &states[..] else { panic!("{states:?}") };
    assert!(failed.len() >= 2, "{states:?}");
    let counts = (1..).map(MemoryState::Failed);
    assert!(failed.iter().zip(counts).all(|(state, count)| **state == count), "{states:?}");
}

#[test]
fn an_external_memory_that_answers_nothing_counts_as_failed() {
    let (seen, ending) = run_with_memory(Host::GivesUp(400), "exec sleep 300", |_| ());
    let said = ["and is left out", "has not answered anything", "--memory-timeout"];
    check_only_the_memory_suffers(&seen, &ending, &said);
    assert!(seen.generations >= 3, "{}", seen.generations);
}

#[test]
fn an_episode_that_the_host_gives_up_is_that_one_and_no_other() {
    let (seen, ending) = run_with_memory(Host::GivesUp(0), "exec sleep 300", |_| ());
    check_only_the_memory_suffers(
        &seen,
        &ending,
        &["memory: top-3 has not answered step 0 within 0 ms"],
    );
    assert_eq!((seen.generations, seen.states.len()), (1, 0));
}
