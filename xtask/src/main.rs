//! `cargo xtask VERB`: everything between a fresh clone and a result.
//!
//! Only these verbs install or download anything; the programs name the verb to run when something is missing. xtask knows
//! cargo, git, pip, uv, MkDocs, apt-get and `xtask/setup.toml`. It links no other crate of the workspace, so that it builds in seconds.
//!
//! Exit status: 0 success, 1 a check or a test failed, 2 error.

mod bench;
mod boundaries;
mod cache;
mod check;
mod citations;
mod demo;
mod docs;
mod drill;
mod features;
mod pins;
mod python;
mod setup;
mod system;
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
struct TaskArguments {
    #[command(subcommand)]
    verb: Verb,
    /// What set-up installs [default: xtask/setup.toml]
    #[arg(long, value_name = "FILE", global = true)]
    pins: Option<PathBuf>,
}

#[derive(Subcommand)]
enum Verb {
    /// Install what is missing: system packages, ONNX Runtime, the default encoder
    Setup {
        /// Also install what tests need: a Vulkan driver, Mesa, Chromium, ffmpeg, Python packages and a small language model
        #[arg(long)]
        tests: bool,
        /// Also install LeRobot with PyTorch, 8 GB, for the test of its data sets
        #[arg(long)]
        lerobot: bool,
    },
    /// Set up, build, run `memtransfer demo`
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
    /// Set up with the baselines' packages, build, measure, print a table, write target/bench.json
    Bench(bench::BenchArguments),
    /// Build, disturb runs on purpose, write target/drill (docs/reliability.md)
    Drill(drill::DrillArguments),
    /// Build the wheel, with the programs and the Python package, into target/wheels
    Wheel,
    /// Check the documents and build them as a site with search into target/site
    Docs,
    /// Check links between crates, features, citations, format, lints and rustdoc
    Check,
    /// What CI runs: `check`, `docs`, `test`, `drill --quick`
    Ci,
    /// Write an untrained ViT-B/16 with seeded weights, for tests and timing
    VitB16Untrained,
}

fn main() -> ExitCode {
    let arguments = TaskArguments::parse();
    match run(&arguments) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
    }
}

/// Executes the verb. Returns `false` when a check or a test failed.
fn run(arguments: &TaskArguments) -> anyhow::Result<bool> {
    let cache = Cache::locate()?;
    let workspace = Workspace::locate(&cache)?;
    let pins_path =
        arguments.pins.clone().unwrap_or_else(|| workspace.root().join("xtask/setup.toml"));
    let pins = Pins::load(&pins_path)?;

    match &arguments.verb {
        Verb::Setup { tests, lerobot } => {
            let purpose = if *tests { Purpose::Tests } else { Purpose::Use };
            setup::install_missing(purpose, &pins, &cache, &workspace)?;
            if *lerobot {
                let python = Purpose::Only("python-lerobot");
                setup::install_missing(python, &pins, &cache, &workspace)?;
            }
            Ok(true)
        }
        Verb::Demo { run_flags } => {
            setup::install_missing(Purpose::Use, &pins, &cache, &workspace)?;
            demo::run(&workspace, run_flags)
        }
        Verb::Test { test_arguments } => test::run(&pins, &cache, &workspace, test_arguments),
        Verb::Bench(arguments) => {
            let purpose = if arguments.no_baselines { Purpose::Use } else { Purpose::Benches };
            setup::install_missing(purpose, &pins, &cache, &workspace)?;
            bench::run(arguments, &cache, &workspace)
        }
        Verb::Drill(arguments) => {
            setup::install_missing(Purpose::Use, &pins, &cache, &workspace)?;
            drill::run(arguments, &workspace)
        }
        Verb::Wheel => python::build_wheel(&workspace),
        Verb::Docs => docs::build(&pins, &cache, &workspace),
        Verb::Check => check::run(&workspace),
        Verb::Ci => {
            let checked = check::run(&workspace)?;
            let built = docs::build(&pins, &cache, &workspace)?;
            let tested = test::run(&pins, &cache, &workspace, &[])?;
            Ok(drill::run(&drill::DrillArguments::of_ci(), &workspace)?
                && tested
                && built
                && checked)
        }
        Verb::VitB16Untrained => {
            let encoder = Purpose::Only("models/vit-b16-untrained.onnx");
            setup::install_missing(encoder, &pins, &cache, &workspace).map(|()| true)
        }
    }
}
