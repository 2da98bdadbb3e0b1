//! The simulator's binary: `serve` takes part in a run, `render` draws pictures for people.

use std::io::IsTerminal;
use std::process::ExitCode;

use clap::Parser;
use sim_proc::render_command::{self, RenderArgs};
use sim_proc::serve_command::{self, ServeArgs};
use tracing_subscriber::EnvFilter;

/// The simulator of MemTransfer: steps the world and renders what the agent sees.
#[derive(Debug, Parser)]
#[command(name = "sim-proc", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Take part in a run until it stops. Started by `memtransfer run`.
    Serve(ServeArgs),
    /// Write views of the warehouse as PNG files.
    Render(RenderArgs),
}

fn main() -> ExitCode {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn"));
    let colours = std::io::stderr().is_terminal();
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(colours)
        .with_writer(std::io::stderr)
        .init();
    let done = match Cli::parse().command {
        Command::Serve(args) => serve_command::run(args),
        Command::Render(args) => render_command::run(&args),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("sim-proc: {error:#}");
            ExitCode::from(2)
        }
    }
}
