//! `memtransfer cache`: passes its arguments to `policy-proc cache`, which caches the replies of models.

use std::ffi::OsString;
use std::process::Command;

use anyhow::Context;
use clap::Args;

use supervise::sibling;

use super::Exit;

#[derive(Debug, Args)]
#[command(disable_help_flag = true)]
pub(super) struct CacheArgs {
    /// ls, prune or clear, and their arguments; `memtransfer cache --help` lists them
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<OsString>,
}

pub(super) fn run(args: &CacheArgs) -> anyhow::Result<Exit> {
    let program = sibling("policy-proc")?;
    let status = Command::new(&program).arg("cache").args(&args.arguments).status();
    let status = status.with_context(|| format!("cannot start {}", program.display()))?;
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    Ok(code.map_or(Exit::CouldNot, Exit::Code))
}
