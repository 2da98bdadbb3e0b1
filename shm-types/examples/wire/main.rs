//! Writes what is said about the wire outside of Rust, from the declarations that the compiler lays out:
//!
//! - `docs/wire.md`, the reference: prose from `wire.md` beside this file, tables from the code;
//! - `python/memtransfer/_wire.py`, the same as structures for ctypes.
//!
//! `cargo run --release -p shm-types --example wire -- --write` writes both; without `--write` it says which of
//! them is out of date. A test does the same.

mod described;
mod python;
mod reference;

use std::fs;
use std::path::PathBuf;
use std::process::ExitCode;

/// What brings the files up to date.
const COMMAND: &str = "cargo run --release -p shm-types --example wire -- --write";

/// A generated file: where it is below the workspace, and what it should say.
struct Generated {
    path: &'static str,
    text: String,
}

impl Generated {
    fn all() -> [Self; 2] {
        [
            Self { path: "docs/wire.md", text: reference::page() },
            Self { path: "python/memtransfer/_wire.py", text: python::module() },
        ]
    }

    fn file(&self) -> PathBuf {
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..").join(self.path)
    }

    fn is_up_to_date(&self) -> bool {
        fs::read_to_string(self.file()).is_ok_and(|found| found == self.text)
    }

    fn write(&self) -> std::io::Result<()> {
        let file = self.file();
        file.parent().map_or(Ok(()), fs::create_dir_all)?;
        fs::write(file, &self.text)
    }
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let write = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] => false,
        ["--write"] => true,
        _ => {
            eprintln!("usage: {COMMAND}");
            return ExitCode::from(2);
        }
    };
    let mut status = ExitCode::SUCCESS;
    for file in Generated::all().into_iter().filter(|file| !file.is_up_to_date()) {
        if !write {
            eprintln!("{} is not up to date: {COMMAND}", file.path);
            status = ExitCode::FAILURE;
        } else if let Err(error) = file.write() {
            eprintln!("{}: {error}", file.path);
            return ExitCode::from(2);
        } else {
            println!("wrote {}", file.path);
        }
    }
    status
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_generated_is_up_to_date() {
        for file in Generated::all() {
            assert!(file.is_up_to_date(), "{} is not up to date: {COMMAND}", file.path);
        }
    }
}
