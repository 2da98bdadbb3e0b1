//! The simulator's binary: `render` draws pictures for people.

use std::process::ExitCode;

use clap::Parser;
use sim_proc::render_command::{self, RenderArgs};

/// The simulator of MemTransfer: steps the world and renders what the agent sees.
#[derive(Debug, Parser)]
#[command(name = "sim-proc", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Write views of the warehouse as PNG files.
    Render(RenderArgs),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let done = match &cli.command {
        Command::Render(args) => render_command::run(args),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("sim-proc: {error:#}");
            ExitCode::from(2)
        }
    }
}
