//! Helper processes of benches: the bench program started again as `memtransfer-bench process NAME ARGUMENTS...`.

use std::process::{Child, Command, Stdio};

use anyhow::{Context, Result, bail};
use shm_types::process::die_with_parent;

use crate::BenchSession;

/// The main function of a helper process.
type Main = fn(&[String]) -> Result<()>;

/// Every helper process by name.
const PROCESSES: &[(&str, Main)] = &[
    ("wire-echo", crate::hop::wire_echo),
    ("iceoryx2-echo", crate::hop::iceoryx2_echo),
    ("bare-sim", crate::bare_chain::sim),
    ("bare-memory", crate::bare_chain::memory),
    ("bare-policy", crate::bare_chain::policy),
    ("render", crate::render::render_process),
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

/// Runs the helper process `name` to its end and returns its standard output.
///
/// # Errors
/// When the program is not built, does not start, or fails.
pub fn output_of(session: &BenchSession<'_>, name: &str, arguments: &[String]) -> Result<String> {
    let output = command(session, name, arguments)?
        .output()
        .with_context(|| format!("cannot start the helper process {name}"))?;
    if !output.status.success() {
        let errors = String::from_utf8_lossy(&output.stderr);
        bail!("the helper process {name} failed ({}):\n{errors}", output.status);
    }
    Ok(String::from_utf8(output.stdout)?)
}

fn command(session: &BenchSession<'_>, name: &str, arguments: &[String]) -> Result<Command> {
    let mut command = Command::new(session.program("memtransfer-bench")?);
    command
        .args(["process", name, &std::process::id().to_string()])
        .args(arguments)
        .stdin(Stdio::null());
    Ok(command)
}

/// A running helper process, killed on drop.
#[derive(Debug)]
pub struct BenchProcess {
    name: &'static str,
    child: Child,
}

impl BenchProcess {
    /// Starts the helper process `name`.
    ///
    /// # Errors
    /// When the program is not built or does not start.
    pub fn start(
        session: &BenchSession<'_>,
        name: &'static str,
        arguments: &[String],
    ) -> Result<Self> {
        let child = command(session, name, arguments)?
            .stdout(Stdio::null())
            .spawn()
            .with_context(|| format!("cannot start the helper process {name}"))?;
        Ok(Self { name, child })
    }

    /// Checks that it is still running.
    ///
    /// # Errors
    /// When it has ended.
    pub fn check(&mut self) -> Result<()> {
        match self.child.try_wait().context("cannot query a helper process")? {
            Some(status) => bail!("the helper process {} ended early ({status})", self.name),
            None => Ok(()),
        }
    }

    /// Waits for it to end.
    ///
    /// # Errors
    /// When it failed.
    pub fn finish(mut self) -> Result<()> {
        let status = self.child.wait().context("cannot wait for a helper process")?;
        if !status.success() {
            bail!("the helper process {} failed ({status})", self.name);
        }
        Ok(())
    }
}

impl Drop for BenchProcess {
    fn drop(&mut self) {
        // Both fail when it has already ended, which is fine.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
