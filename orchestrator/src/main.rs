//! The program `memtransfer`. What each verb does is in [`orchestrator::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    orchestrator::cli::main()
}
