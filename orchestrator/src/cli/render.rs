//! `memtransfer render`: passes its arguments to `sim-proc render`, which has the renderer.

use std::ffi::OsString;
use std::process::Command;

use anyhow::Context;
use clap::Args;

use supervise::{QUIET_DRIVER, sibling};

use super::Exit;

#[derive(Debug, Args)]
#[command(disable_help_flag = true)]
pub(super) struct RenderArgs {
    /// Arguments of `sim-proc render`; `memtransfer render --help` lists them
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<OsString>,
}

pub(super) fn run(args: &RenderArgs) -> anyhow::Result<Exit> {
    let program = sibling("sim-proc")?;
    let mut command = Command::new(&program);
    command.arg("render").args(&args.arguments).env(QUIET_DRIVER.0, QUIET_DRIVER.1);
    let status = command.status();
    let status = status.with_context(|| format!("cannot start {}", program.display()))?;
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    Ok(code.map_or(Exit::CouldNot, Exit::Code))
}
