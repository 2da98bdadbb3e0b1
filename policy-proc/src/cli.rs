//! Verbs of the program that are no part of a run.

pub(crate) mod cache;
pub(crate) mod probe;

use std::io::{self, Write};

/// Writes data to stdout, line end included.
fn print(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{}", text.trim_end())?;
    stdout.flush()?;
    Ok(())
}
