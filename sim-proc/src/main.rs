//! The simulator's binary: `serve` runs the simulator of a run, `views` writes views to stdout, `act` acts out episodes, `book`
//! writes the case book, and verbs of `memtransfer` that only the world can answer.

use std::process::ExitCode;

use clap::Parser;
use sim_proc::act_command::{self, ActArgs};
use sim_proc::book_command::{self, BookArgs};
use sim_proc::serve_command::{self, ServeArgs};
use sim_proc::views_command::{self, ViewsArgs};
use sim_proc::world_commands::{self, GenerateArgs, ListArgs, MapArgs, ValidateArgs};

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
    /// Write the case book of a run: what it knows about cases and demonstrations. Started by `memtransfer run`.
    Book(BookArgs),
    /// Check every constraint on warehouse and cases. Started by `memtransfer validate`.
    Validate(ValidateArgs),
    /// Draw the warehouse, or a case, from above as SVG. Started by `memtransfer map`.
    Map(MapArgs),
    /// Generate cases, or a warehouse with its cases. Started by `memtransfer generate`.
    Generate(GenerateArgs),
    /// List histories, items or streams. Started by `memtransfer ls`.
    List(ListArgs),
}

fn main() -> ExitCode {
    program::run("sim-proc", || {
        match program::parse::<SimulatorCli>().command {
            Command::Serve(args) => serve_command::run(args)?,
            Command::Views(args) => views_command::run(&args)?,
            Command::Act(args) => act_command::run(&args)?,
            Command::Book(args) => book_command::run(&args)?,
            Command::Validate(args) => return world_commands::validate(&args),
            Command::Map(args) => world_commands::draw_map(&args)?,
            Command::Generate(args) => world_commands::generate(&args)?,
            Command::List(args) => world_commands::list(&args)?,
        }
        Ok(ExitCode::SUCCESS)
    })
}
