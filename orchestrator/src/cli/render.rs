//! `memtransfer render`: hands everything to the simulator's own verb, which has the renderer.

use std::ffi::OsString;
use std::process::Command;

use anyhow::Context;
use clap::Args;

use super::Exit;
use crate::supervise::sibling;

#[derive(Debug, Args)]
#[command(disable_help_flag = true)]
pub(super) struct RenderArgs {
    /// Whatever `sim-proc render` takes; `memtransfer render --help` lists it
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<OsString>,
}

pub(super) fn run(args: &RenderArgs) -> anyhow::Result<Exit> {
    let program = sibling("sim-proc")?;
    let status = Command::new(&program).arg("render").args(&args.arguments).status();
    let status = status.with_context(|| format!("cannot start {}", program.display()))?;
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    Ok(code.map_or(Exit::CouldNot, Exit::Code))
}
