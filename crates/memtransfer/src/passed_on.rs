//! Verbs of other programs: `memtransfer render` is `sim-proc render`, which has the renderer, and `memtransfer
//! cache` is `policy-proc cache`, which caches the replies of models.

use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::Command;

use anyhow::Context;
use clap::Args;
use supervise::{QUIET_DRIVER, sibling};

use super::Exit;

#[derive(Debug, Args)]
#[command(disable_help_flag = true)]
pub(super) struct PassedOn {
    /// Its arguments; with --help it lists them
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<OsString>,
}

impl PassedOn {
    /// Runs `verb` of `program`, and ends as it ends.
    pub(super) fn run(&self, program: &str, verb: &str) -> anyhow::Result<Exit> {
        let program = sibling(program)?;
        let mut command = Command::new(&program);
        // Help and errors name the command that was given.
        command.arg0("memtransfer").arg(verb).args(&self.arguments);
        command.env(QUIET_DRIVER.0, QUIET_DRIVER.1);
        let status = command.status();
        let status = status.with_context(|| format!("cannot start {}", program.display()))?;
        let code = status.code().and_then(|code| u8::try_from(code).ok());
        Ok(code.map_or(Exit::Error, Exit::Code))
    }
}
