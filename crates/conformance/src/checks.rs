//! What a check is, and the checks of every role.

use std::fs;
use std::process::{Command, Stdio};

use anyhow::Context;
use shm_types::ATTACH_VARIABLE;
use shm_types::attach::ATTACH_FILE;
use shm_types::message::WIRE_VERSION;
use supervise::Children;

use crate::Kit;
use crate::subject::{CheckResult, Subject, TestedRole, wait_for_exit, wrong};

/// A check.
pub(crate) struct Check<R: TestedRole> {
    /// What the process does if it passes.
    pub(crate) name: &'static str,
    /// What exactly is expected.
    pub(crate) expected: &'static str,
    /// What to do if it fails.
    pub(crate) advice: &'static str,
    /// Runs it. Returns a remark, which may be empty.
    pub(crate) run: fn(&mut Kit<'_, R>) -> CheckResult<String>,
}

impl<R: TestedRole> Check<R> {
    /// The process stops when it is asked to.
    pub(crate) const STOPS: Self = Self {
        name: "stops",
        expected: "after a Stop message: a shutdown report, and exit status 0 soon",
        advice: "end all threads and servers once `memtransfer.run` (Python) or `serve_from_environment` (Rust) returns; \
                 without an SDK, leave the loop after a Stop message",
        run: stops,
    };

    /// The process ends with the orchestrator.
    pub(crate) const ENDS_WITH_THE_ORCHESTRATOR: Self = Self {
        name: "ends with the orchestrator",
        expected: "it ends soon after the process `orchestrator_pid` of attach.json",
        advice: "check a few times a second whether that process exists, and exit when it does not",
        run: orchestrator_ends,
    };

    /// The process refuses a run of another wire version, with a message.
    pub(crate) const REFUSES_ANOTHER_WIRE_VERSION: Self = Self {
        name: "refuses another wire version",
        expected: "it prints a message and exits with a status other than 0",
        advice: "compare `wire_version` in attach.json first",
        run: another_wire_version,
    };
}

/// Ends a check: expects no further message, and evicts its views.
pub(crate) fn clear_away<R: TestedRole>(subject: &mut Subject<'_, R>) -> CheckResult<String> {
    subject.settle()?;
    subject.evict_all()?;
    Ok(String::new())
}

fn stops<R: TestedRole>(kit: &mut Kit<'_, R>) -> CheckResult<String> {
    kit.take_subject()?.stop().map(|()| String::new())
}

fn orchestrator_ends<R: TestedRole>(kit: &mut Kit<'_, R>) -> CheckResult<String> {
    kit.kill_subject();
    // Ends with this program, whose end closes the pipe.
    let stand_in = Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::null()).spawn();
    let mut stand_in = stand_in.context("cannot start `cat`")?;
    kit.attach.orchestrator_pid = stand_in.id();
    let outcome = kit.subject().map(drop);
    let ended = stand_in.kill().and_then(|()| stand_in.wait());
    kit.attach.orchestrator_pid = std::process::id();
    outcome?;
    ended.context("cannot end `cat`")?;
    // It may have ended already.
    let Some(mut subject) = kit.subject.take() else { return wrong("it did not start") };
    subject.wait_for_exit()?;
    Ok(String::new())
}

fn another_wire_version<R: TestedRole>(kit: &mut Kit<'_, R>) -> CheckResult<String> {
    kit.kill_subject();
    let (run, attach) = kit.another_run()?;
    R::write_world(run.path()).map_err(anyhow::Error::from)?;
    attach.write(run.path()).map_err(anyhow::Error::from)?;
    let file = run.path().join(ATTACH_FILE);
    let from = format!("\"wire_version\": {WIRE_VERSION}");
    let text = fs::read_to_string(&file).context("cannot read attach.json")?;
    let text = text.replace(&from, "\"wire_version\": 999");
    fs::write(&file, text).context("cannot write attach.json")?;
    let folder = R::folder(run.path());
    fs::create_dir_all(&folder).context("cannot create its folder")?;
    // Nothing but the version keeps the process from joining.
    let _neighbours = R::join(&attach).map_err(anyhow::Error::from)?;
    let launch = kit.terms.launch.clone().attached_to(run.path());
    let mut children = Children::start(&[launch], &run.path().join("logs"))?;
    let exit = wait_for_exit(&mut children, kit.terms)?;
    if exit.status.success() {
        return wrong("it ended with exit status 0, which means success");
    }
    if exit.log_tail.is_empty() {
        return wrong(format_args!(
            "it ended {}: without a message, the user cannot tell what is wrong with ${ATTACH_VARIABLE}",
            exit.how()
        ));
    }
    Ok(format!("it printed: {}", exit.log_tail.lines().last().unwrap_or_default()))
}
