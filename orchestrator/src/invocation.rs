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

/// Prepares that the model of a run with these settings is asked.
pub type Announcement<'a> = dyn Fn(&RunSettings) -> Result<()> + 'a;

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
    /// Where the address of the model's server was given, on which the key depends: a word of `--base-url-from`.
    pub base_url_from: Option<&'static str>,
    /// Called before the run's model is asked: for documents, and for decisions. It ends the run if the model must not be
    /// asked.
    pub before_asking: Box<Announcement<'a>>,
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
            base_url_from: None,
            before_asking: Box::new(|_| Ok(())),
            adjust: Box::new(|_, _, _| Ok(())),
        }
    }
}
