//! `--die-with`: a program that starts runs may be killed before it can stop them.
//!
//! The kernel can send a signal to a process whose parent ends, but it watches the thread that started the process, which a program in
//! Python does not choose. So a thread watches the whole process.

use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::{fs, io};

use anyhow::{Context, Result, bail};
use clap::Args;
use rustix::process::{Signal, getpid, kill_process};
use shm_types::process::ProcessWatch;

/// Names the process that this one ends with.
#[derive(Debug, Clone, Args)]
pub(crate) struct ParentFlags {
    /// Stop, as SIGTERM does, when the process PID ends in any way
    #[arg(long, value_name = "PID", help_heading = HEADING)]
    die_with: Option<u32>,
}

/// Of flags for programs, in the help.
pub(crate) const HEADING: &str = "For programs that start this one";

impl ParentFlags {
    /// Starts to watch the process, if one is named.
    ///
    /// # Errors
    /// When there is no such process, or the system cannot watch it.
    pub(crate) fn watch(&self) -> Result<Parent> {
        let Some(pid) = self.die_with else { return Ok(Parent { process: None }) };
        let process = match ProcessWatch::new(pid) {
            Ok(process) => Arc::new(process),
            Err(error) => bail!("--die-with: cannot watch process {pid}: {error}"),
        };
        let watched = Arc::clone(&process);
        let stop_after = move || {
            watched.wait();
            // To itself, which no system refuses.
            let _ = kill_process(getpid(), Signal::TERM);
        };
        let thread = thread::Builder::new().name("parent".to_owned()).spawn(stop_after);
        thread.context("cannot start a thread")?;
        Ok(Parent { process: Some(process) })
    }
}

/// The process that this one ends with, if there is one.
#[derive(Debug)]
pub(crate) struct Parent {
    process: Option<Arc<ProcessWatch>>,
}

impl Parent {
    /// Removes `folder` if the process has ended, which would have removed it.
    ///
    /// # Errors
    /// When the system refuses.
    pub(crate) fn remove_if_ended(&self, folder: &Path) -> Result<()> {
        if !self.process.as_ref().is_some_and(|process| process.has_ended()) {
            return Ok(());
        }
        match fs::remove_dir_all(folder) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                Err(error).with_context(|| format!("cannot remove {}", folder.display()))
            }
            _ => Ok(()),
        }
    }
}
