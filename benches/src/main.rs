//! The program `memtransfer-bench`, which `cargo xtask bench` starts: its command line, and the loop over the benches.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use benches::results::{BenchOutcome, Results};
use benches::{BENCHES, Bench, BenchSession, Hardware, Size, helpers};
use build_commit::COMMIT;
use clap::{Parser, Subcommand};
use memory_proc::encoder::Provider;
use orchestrator::machine::Machine;
use sim_proc::renderer::Backend;

/// Measures this project beside other programs, in turns on the same machine.
#[derive(Debug, Parser)]
#[command(name = "memtransfer-bench", version, after_help = after_help())]
struct BenchFlags {
    /// Measure only these benches, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    only: Vec<String>,
    /// Rounds; each measures this project and the baseline
    #[arg(long, value_name = "N", default_value_t = 5)]
    rounds: u32,
    /// Write the value of every round, and the machine, into FILE
    #[arg(long, value_name = "FILE", default_value = "target/bench.json")]
    json: PathBuf,
    /// Python interpreter with the baselines' packages (benches/baselines/requirements.txt); without it, only this
    /// project is measured
    #[arg(long, value_name = "FILE")]
    python: Option<PathBuf>,
    /// What renders: cpu, or wgpu for a graphics card
    #[arg(long, value_name = "NAME", default_value = "cpu")]
    backend: Backend,
    /// What the encoder computes on
    #[arg(long, value_name = "NAME", value_enum, default_value = "cpu")]
    provider: Provider,
    #[command(subcommand)]
    verb: Option<BenchVerb>,
}

#[derive(Debug, Subcommand)]
enum BenchVerb {
    /// Run a helper process of a bench
    #[command(hide = true)]
    Process { name: String, arguments: Vec<String> },
}

fn after_help() -> String {
    let width = BENCHES.iter().map(|bench| bench.name.len()).max().unwrap_or_default();
    let lines = BENCHES.iter().map(|bench| format!("  {:width$}  {}\n", bench.name, bench.about));
    format!(
        "Benches:\n{}\nThe table goes to stdout, progress to stderr. Exit status: 0 all benches ran, 1 one failed, 2 \
         could not run.\n`cargo xtask bench` builds the programs and installs the baselines first.",
        lines.collect::<String>()
    )
}

fn main() -> ExitCode {
    let flags = BenchFlags::parse();
    let done = match &flags.verb {
        Some(BenchVerb::Process { name, arguments }) => {
            helpers::run(name, arguments).map(|()| true)
        }
        None => run(&flags),
    };
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            eprintln!("memtransfer-bench: {error:#}");
            ExitCode::from(2)
        }
    }
}

/// Measures, writes the results after every bench, and prints the table. Returns whether every bench succeeded.
fn run(flags: &BenchFlags) -> Result<bool> {
    let benches = chosen(&flags.only)?;
    let program = std::env::current_exe().context("cannot find the path of this program")?;
    let programs = program.parent().context("this program has no parent folder")?;
    let mut results = Results { machine: Machine::here(), commit: COMMIT, benches: Vec::new() };
    for bench in benches {
        results.benches.push(measure(bench, flags, programs)?);
        results.write(&flags.json)?;
    }
    println!("{}\n\n{results}", results.machine.summary());
    eprintln!("every round: {}", flags.json.display());
    Ok(results.benches.iter().all(|outcome| outcome.error.is_none()))
}

fn chosen(only: &[String]) -> Result<Vec<&'static Bench>> {
    if only.is_empty() {
        return Ok(BENCHES.iter().collect());
    }
    if let Some(unknown) = only.iter().find(|name| BENCHES.iter().all(|bench| bench.name != **name))
    {
        let names: Vec<&str> = BENCHES.iter().map(|bench| bench.name).collect();
        bail!("there is no bench {unknown:?}; there are {}", names.join(", "));
    }
    Ok(BENCHES.iter().filter(|bench| only.iter().any(|name| name == bench.name)).collect())
}

fn measure(bench: &Bench, flags: &BenchFlags, programs: &Path) -> Result<BenchOutcome> {
    let mut session = BenchSession::new(bench.name, Size::Full, programs)?;
    session.hardware = Hardware { backend: flags.backend, provider: flags.provider };
    session.rounds = flags.rounds.max(1);
    session.python = flags.python.as_deref();
    session.progress(bench.about);
    let clock = Instant::now();
    let measured = (bench.run)(&session);
    let error = measured.as_ref().err().map(|error| format!("{error:#}"));
    if let Some(error) = &error {
        eprintln!("{}: failed: {error}", bench.name);
    }
    Ok(BenchOutcome {
        name: bench.name,
        seconds: clock.elapsed().as_secs_f64(),
        error,
        measurements: measured.unwrap_or_default(),
    })
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_is_well_formed_and_knows_its_benches() {
        BenchFlags::command().debug_assert();
        assert!(chosen(&["hop".to_owned()]).is_ok_and(|benches| benches.len() == 1));
        let error = chosen(&["hops".to_owned()]).unwrap_err().to_string();
        assert!(error.contains("hops") && error.contains("there are hop, "), "{error}");
    }
}
