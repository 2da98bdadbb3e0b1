//! Flags and verbs of the program, one file for each.

pub(crate) mod cache;
pub(crate) mod openai;
pub(crate) mod probe;

use std::io::{self, Write};

/// Writes data to stdout, line end included.
fn print(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{}", text.trim_end())?;
    stdout.flush()?;
    Ok(())
}
