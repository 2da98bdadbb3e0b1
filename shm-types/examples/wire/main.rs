//! Writes `docs/wire.md`, the reference of the wire: prose from `wire.md` beside this file, tables from the Rust
//! declarations.
//!
//! `cargo run --release -p shm-types --example wire -- --write` writes the page; without `--write` it reports whether the
//! page is up to date. A test does the same.

mod described;
mod reference;

use std::fs;
use std::path::PathBuf;
use std::process::ExitCode;

/// The command that writes the page.
const COMMAND: &str = "cargo run --release -p shm-types --example wire -- --write";

fn page() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../docs/wire.md")
}

fn is_up_to_date() -> bool {
    fs::read_to_string(page()).is_ok_and(|found| found == reference::page())
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] if is_up_to_date() => ExitCode::SUCCESS,
        [] => {
            eprintln!("docs/wire.md is out of date: {COMMAND}");
            ExitCode::FAILURE
        }
        ["--write"] => match fs::write(page(), reference::page()) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                eprintln!("{}: {error}", page().display());
                ExitCode::from(2)
            }
        },
        _ => {
            eprintln!("usage: {COMMAND}");
            ExitCode::from(2)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_up_to_date() {
        assert!(is_up_to_date(), "docs/wire.md is out of date: {COMMAND}");
    }
}
