//! The simulator's binary: `serve` runs the simulator of a run, `views` writes views to stdout, `first-views` checks where
//! cases begin, `book` writes the case book.

use std::process::ExitCode;

use clap::Parser;
use sim_proc::act_command::{self, ActArgs};
use sim_proc::book_command::{self, BookArgs};
use sim_proc::first_views::{self, FirstViewsArgs};
use sim_proc::serve_command::{self, ServeArgs};
use sim_proc::views_command::{self, ViewsArgs};

/// The simulator of MemTransfer: steps the world and renders what the agent sees.
#[derive(Debug, Parser)]
#[command(name = "sim-proc", version)]
struct SimulatorCli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Take part in a run until it stops. Started by `memtransfer run`.
    Serve(ServeArgs),
    /// Write the views that stdin names to stdout, as pixels. Started by `memtransfer render` and `memtransfer view`.
    Views(ViewsArgs),
    /// Act out the episodes that stdin names, as JSON. Started by `memtransfer view`, `show`, `export` and `validate`.
    Act(ActArgs),
    /// Render the first views of cases, which must show no target. Started by `memtransfer validate`.
    FirstViews(FirstViewsArgs),
    /// Write the case book of a run: what it knows about cases and demonstrations. Started by `memtransfer run`.
    Book(BookArgs),
}

fn main() -> ExitCode {
    program::run("sim-proc", || {
        match program::parse::<SimulatorCli>().command {
            Command::Serve(args) => serve_command::run(args)?,
            Command::Views(args) => views_command::run(&args)?,
            Command::Act(args) => act_command::run(&args)?,
            Command::FirstViews(args) => first_views::run(&args)?,
            Command::Book(args) => book_command::run(&args)?,
        }
        Ok(ExitCode::SUCCESS)
    })
}
