//! Processes that play a part in a bench: `memtransfer-bench part NAME ARGUMENTS...`, the same program started anew.

use std::process::{Child, Command, Stdio};

use anyhow::{Context, Result, bail};
use shm_types::process::die_with_parent;

use crate::session::Session;

/// A part, by its name.
type Play = fn(&[String]) -> Result<()>;

/// Every part.
const PARTS: &[(&str, Play)] = &[
    ("wire-echo", crate::hop::wire_echo),
    ("iceoryx2-echo", crate::hop::iceoryx2_echo),
    ("bare-sim", crate::bare::sim),
    ("bare-memory", crate::bare::memory),
    ("bare-policy", crate::bare::policy),
    ("draw", crate::render::draw),
];

/// Plays the part called `name`; returns when it is over.
///
/// # Errors
/// When there is no such part, or it cannot be played.
pub fn play(name: &str, arguments: &[String]) -> Result<()> {
    let Some((_, play)) = PARTS.iter().find(|(part, _)| *part == name) else {
        bail!("there is no part {name:?}");
    };
    let (parent, arguments) = arguments.split_first().context("a part is told who started it")?;
    die_with_parent(parent.parse().context("a part is told who started it")?)?;
    play(arguments)
}

/// Plays the part called `name` to its end in a process of its own, which has these variables too, and returns what
/// it printed.
///
/// # Errors
/// When the program is not built or does not start, or the part fails.
pub fn printed(
    session: &Session<'_>,
    name: &str,
    arguments: &[String],
    variables: &[(&str, &str)],
) -> Result<String> {
    let output = command(session, name, arguments)?
        .envs(variables.iter().copied())
        .output()
        .with_context(|| format!("cannot start the part {name}"))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        bail!("the part {name} failed ({}):\n{said}", output.status);
    }
    Ok(String::from_utf8(output.stdout)?)
}

fn command(session: &Session<'_>, name: &str, arguments: &[String]) -> Result<Command> {
    let mut command = Command::new(session.program("memtransfer-bench")?);
    command
        .args(["part", name, &std::process::id().to_string()])
        .args(arguments)
        .stdin(Stdio::null());
    Ok(command)
}

/// A part that is being played. Dropping it ends it.
#[derive(Debug)]
pub struct Part {
    name: &'static str,
    child: Child,
}

impl Part {
    /// Starts the part called `name` in a process of its own.
    ///
    /// # Errors
    /// When the program is not built or does not start.
    pub fn start(session: &Session<'_>, name: &'static str, arguments: &[String]) -> Result<Self> {
        let child = command(session, name, arguments)?
            .stdout(Stdio::null())
            .spawn()
            .with_context(|| format!("cannot start the part {name}"))?;
        Ok(Self { name, child })
    }

    /// Fails when the part is over already.
    ///
    /// # Errors
    /// As said.
    pub fn check(&mut self) -> Result<()> {
        match self.child.try_wait().context("cannot look after a part")? {
            Some(status) => bail!("the part {} ended too early ({status})", self.name),
            None => Ok(()),
        }
    }

    /// Waits until it is over.
    ///
    /// # Errors
    /// When it failed.
    pub fn finish(mut self) -> Result<()> {
        let status = self.child.wait().context("cannot wait for a part")?;
        if !status.success() {
            bail!("the part {} failed ({status})", self.name);
        }
        Ok(())
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
