//! Helper processes of benches: the bench program started again as `memtransfer-bench process NAME ARGUMENTS...`.

use std::process::{Child, Command, Stdio};

use anyhow::{Context, Result, bail};

use crate::BenchSession;

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
