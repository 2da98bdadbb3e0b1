//! The flags and verbs of the program, one file each.

pub(crate) mod cache;
pub(crate) mod openai;
pub(crate) mod probe;

use std::io::{self, Write};

/// Writes a text and a line end to standard output.
fn print(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{}", text.trim_end())?;
    stdout.flush()?;
    Ok(())
}
