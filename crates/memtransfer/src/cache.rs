//! `memtransfer cache`: the verb of `policy-proc`, which caches the replies of models.

use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::Command;

use anyhow::Context;
use clap::Args;
use supervise::sibling;

use super::Exit;

#[derive(Debug, Args)]
#[command(disable_help_flag = true)]
pub(super) struct CacheArgs {
    /// Its arguments; with --help it lists them
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<OsString>,
}

/// Becomes `policy-proc cache`. Returns only an error.
pub(super) fn run(args: &CacheArgs) -> anyhow::Result<Exit> {
    let program = sibling("policy-proc")?;
    let mut command = Command::new(&program);
    // Help and errors name the command that was given.
    command.arg0("memtransfer").arg("cache").args(&args.arguments);
    let error = command.exec();
    Err(error).with_context(|| format!("cannot start {}", program.display()))
}
