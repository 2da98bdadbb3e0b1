//! What the helper processes of benches do.

use anyhow::{Context, Result, bail};
use shm_types::process::die_with_parent;

use crate::{bare_chain, hop, render};

/// The main function of a helper process.
type Main = fn(&[String]) -> Result<()>;

/// Every helper process by name.
const PROCESSES: &[(&str, Main)] = &[
    ("wire-echo", hop::wire_echo),
    ("iceoryx2-echo", hop::iceoryx2_echo),
    ("bare-sim", bare_chain::sim),
    ("bare-memory", bare_chain::memory),
    ("bare-policy", bare_chain::policy),
    ("render", render::render_process),
];

/// Runs the helper process `name` in this process. The first argument is the id of the process that started it.
///
/// # Errors
/// When there is no such helper, or it fails.
pub fn run(name: &str, arguments: &[String]) -> Result<()> {
    let Some((_, main)) = PROCESSES.iter().find(|(known, _)| *known == name) else {
        bail!("there is no helper process {name:?}");
    };
    let (parent, arguments) =
        arguments.split_first().context("the parent's process id is missing")?;
    die_with_parent(parent.parse().context("the parent's process id is not a number")?)?;
    main(arguments)
}
