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
    /// Becomes `verb` of `program`. Returns only an error.
    pub(super) fn run(&self, program: &str, verb: &str) -> anyhow::Result<Exit> {
        let program = sibling(program)?;
        let mut command = Command::new(&program);
        // Help and errors name the command that was given.
        command.arg0("memtransfer").arg(verb).args(&self.arguments);
        command.env(QUIET_DRIVER.0, QUIET_DRIVER.1);
        let error = command.exec();
        Err(error).with_context(|| format!("cannot start {}", program.display()))
    }
}
