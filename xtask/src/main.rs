//! `cargo xtask VERB`: everything between a fresh clone and a result.
//!
//! This is the only place that installs or downloads anything; the program itself says which of
//! these verbs brings what it misses. It knows cargo, pip and apt-get, and the list in
//! `xtask/setup.toml`; it knows nothing of the benchmark, and links none of its crates, so that it
//! builds in seconds.
//!
//! Exit status: 0 done, 1 a check or a test failed, 2 could not do it.

mod apt;
mod bench;
mod boundaries;
mod cache;
mod check;
mod citations;
mod demo;
mod environments;
mod files;
mod licences;
mod pins;
mod probe;
mod python;
mod setup;
mod sha256;
mod test;
mod workspace;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::cache::Cache;
use crate::pins::{Pins, Purpose};
use crate::workspace::Workspace;

#[derive(Parser)]
#[command(
    name = "xtask",
    bin_name = "cargo xtask",
    about = "Everything between a fresh clone and a result."
)]
struct Arguments {
    #[command(subcommand)]
    verb: Verb,
    /// The list of what set-up may bring [default: xtask/setup.toml]
    #[arg(long, value_name = "FILE", global = true)]
    pins: Option<PathBuf>,
}

#[derive(Subcommand)]
enum Verb {
    /// Bring what is missing: system packages, ONNX Runtime, the default encoder
    Setup {
        /// Also what only tests need: a Vulkan driver, Python packages and a small language model
        #[arg(long)]
        tests: bool,
    },
    /// Set up, build, run the quick suite on real frames, print its table
    Demo {
        /// Flags for `memtransfer run`, for example `-- --fresh --lanes 8`
        #[arg(last = true)]
        run_flags: Vec<String>,
    },
    /// Set up as `setup --tests` does, build, run every test
    Test {
        /// Arguments for the test binaries, for example `-- expert`
        #[arg(last = true)]
        test_arguments: Vec<String>,
    },
    /// Set up with the baselines' Python packages, build, measure beside them, write target/bench
    Bench(bench::BenchArguments),
    /// Format, lints, docs and licences
    Check,
    /// What CI runs: `check`, then `test`
    Ci,
    /// Write a ViT-B/16 with seeded weights, for tests and timing (untrained: its scores mean
    /// nothing)
    VitB16Untrained,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match run(&arguments) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
    }
}

/// Does what was asked; `false` when a check or a test failed.
fn run(arguments: &Arguments) -> anyhow::Result<bool> {
    let cache = Cache::locate()?;
    let workspace = Workspace::locate(&cache)?;
    let pins_path =
        arguments.pins.clone().unwrap_or_else(|| workspace.root().join("xtask/setup.toml"));
    let pins = Pins::load(&pins_path)?;

    match &arguments.verb {
        Verb::Setup { tests } => {
            let purpose = if *tests { Purpose::Tests } else { Purpose::Use };
            setup::bring_missing(purpose, &pins, &cache, &workspace).map(|()| true)
        }
        Verb::Demo { run_flags } => {
            setup::bring_missing(Purpose::Use, &pins, &cache, &workspace)?;
            demo::run(&workspace, run_flags)
        }
        Verb::Test { test_arguments } => {
            setup::bring_missing(Purpose::Tests, &pins, &cache, &workspace)?;
            test::run(&workspace, test_arguments)
        }
        Verb::Bench(arguments) => {
            let purpose = if arguments.no_baselines { Purpose::Use } else { Purpose::Benches };
            setup::bring_missing(purpose, &pins, &cache, &workspace)?;
            bench::run(arguments, &pins, &cache, &workspace)
        }
        Verb::Check => check::run(&workspace),
        Verb::Ci => {
            let checked = check::run(&workspace)?;
            setup::bring_missing(Purpose::Tests, &pins, &cache, &workspace)?;
            Ok(test::run(&workspace, &[])? && checked)
        }
        Verb::VitB16Untrained => {
            setup::bring_on_demand("vit-b16-untrained", &pins, &cache, &workspace).map(|()| true)
        }
    }
}
