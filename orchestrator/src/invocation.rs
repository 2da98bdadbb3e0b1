//! What the caller decides about one execution of a run.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use anyhow::Result;
use conditions::settings::RunSettings;
use shm_types::Attach;

use crate::pipeline::PipelineOptions;
use crate::progress::Verbosity;

/// Changes how the processes of a run are started.
pub type Adjustment<'a> =
    dyn Fn(&RunSettings, &mut Attach, &mut PipelineOptions) -> Result<()> + 'a;

/// How a run is executed this time. It changes no result.
pub struct Invocation<'a> {
    /// Whether the run starts over, and an earlier one in its folder is removed.
    pub fresh: bool,
    /// What is shown on stderr.
    pub verbosity: Verbosity,
    /// The file of a trace of every process and step.
    pub trace: Option<PathBuf>,
    /// Set when the run is to stop.
    pub stop: &'a AtomicBool,
    /// What asked it to stop, such as the name of a signal, for the record of the session.
    pub stop_reason: Box<dyn Fn() -> Option<&'static str> + 'a>,
    /// Called when episodes are missing, before the processes are started.
    pub adjust: Box<Adjustment<'a>>,
}

impl<'a> Invocation<'a> {
    /// One that continues an earlier run, shows everything, and ends early when `stop` is set.
    pub fn until(stop: &'a AtomicBool) -> Self {
        Self {
            fresh: false,
            verbosity: Verbosity::Progress,
            trace: None,
            stop,
            stop_reason: Box::new(|| None),
            adjust: Box::new(|_, _, _| Ok(())),
        }
    }
}
