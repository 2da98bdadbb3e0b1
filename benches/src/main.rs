//! The program `memtransfer-bench`, which `cargo xtask bench` starts.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
