//! The program `memtransfer-bench`, which `cargo xtask bench` starts: its command line, and the loop over the benches.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Instant, SystemTime};

use anyhow::{Context, Result, bail};
use benches::markdown::{self, Column};
use benches::results::{BenchOutcome, FILE, Results};
use benches::{BENCHES, Bench, BenchSession, Hardware, Size, compare, processes};
use build_commit::COMMIT;
use clap::{Parser, Subcommand};
use memory_proc::encoder::Provider;
use sim_proc::renderer::Backend;

/// Measures this project beside other programs, alternating on the same machine.
#[derive(Debug, Parser)]
#[command(name = "memtransfer-bench", version, after_help = after_help())]
struct BenchFlags {
    /// Measure only these benches, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    only: Vec<String>,
    /// Rounds; each measures this project and the baseline
    #[arg(long, value_name = "N", default_value_t = 5)]
    rounds: u32,
    /// Compare with earlier results (a bench.json)
    #[arg(long, value_name = "FILE")]
    compare: Option<PathBuf>,
    /// Folder for bench.json and bench.md
    #[arg(long, value_name = "DIR", default_value = "target/bench")]
    out: PathBuf,
    /// Keep the results in bench.json of benches that are not measured now
    #[arg(long)]
    keep: bool,
    /// Python interpreter with the baselines' packages (benches/baselines/requirements.txt); without it, only this
    /// project is measured
    #[arg(long, value_name = "FILE")]
    python: Option<PathBuf>,
    /// Only show that the benches work; the figures mean nothing
    #[arg(long)]
    tiny: bool,
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
    /// Write the results of several machines into a Markdown page, side by side, between its markers
    Page {
        page: PathBuf,
        /// Results (bench.json), one file for each machine; the name of the file is the heading of its column
        #[arg(required = true)]
        results: Vec<PathBuf>,
    },
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
    let arguments = BenchFlags::parse();
    let done = match &arguments.verb {
        Some(BenchVerb::Process { name, arguments }) => {
            processes::run(name, arguments).map(|()| true)
        }
        Some(BenchVerb::Page { page, results }) => write_page(page, results).map(|()| true),
        None => run(&arguments),
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

/// Measures and writes the results after every bench. Returns whether every bench succeeded.
fn run(arguments: &BenchFlags) -> Result<bool> {
    let benches = chosen(&arguments.only)?;
    let earlier = arguments.compare.as_deref().map(Results::read).transpose()?;
    let program = std::env::current_exe().context("cannot find the path of this program")?;
    let programs = program.parent().context("this program has no parent folder")?;
    std::fs::create_dir_all(&arguments.out)
        .with_context(|| format!("cannot create {}", arguments.out.display()))?;
    let mut results = Results::here();
    let kept = arguments.out.join(FILE);
    if arguments.keep && kept.is_file() {
        results.benches = Results::read(&kept)?.benches;
    }
    let size = if arguments.tiny { Size::Tiny } else { Size::Full };
    for bench in benches {
        let hardware = Hardware { backend: arguments.backend, provider: arguments.provider };
        let rounds = arguments.rounds;
        let session = BenchSession::new(
            bench.name,
            size,
            hardware,
            rounds,
            programs,
            arguments.python.as_deref(),
        )?;
        results.add(measure(bench, session));
        write(&results, earlier.as_ref(), &arguments.out)?;
    }
    print!("{}", render(&results));
    if let Some(earlier) = &earlier {
        if earlier.machine != results.machine {
            println!(
                "\nThe earlier results are from another machine: {}.",
                earlier.machine.summary()
            );
        }
        println!("\n{}", markdown::changes(&compare::compare(earlier, &results)));
    }
    eprintln!("written to {}", arguments.out.display());
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

fn measure(bench: &Bench, mut session: BenchSession<'_>) -> BenchOutcome {
    session.say(bench.about);
    let (began, clock) = (httpdate::fmt_http_date(SystemTime::now()), Instant::now());
    let figures = (bench.run)(&mut session);
    let error = figures.as_ref().err().map(|error| format!("{error:#}"));
    if let Some(error) = &error {
        eprintln!("{}: failed: {error}", bench.name);
    }
    BenchOutcome {
        name: bench.name.to_owned(),
        about: bench.about.to_owned(),
        began,
        commit: COMMIT.map(str::to_owned),
        seconds: clock.elapsed().as_secs_f64(),
        error,
        figures: figures.unwrap_or_default(),
    }
}

fn render(results: &Results) -> String {
    markdown::render(&[Column { name: "this machine", results }])
}

fn write_page(page: &Path, files: &[PathBuf]) -> Result<()> {
    let results = files.iter().map(|file| Results::read(file)).collect::<Result<Vec<_>>>()?;
    let names: Vec<Cow<'_, str>> =
        files.iter().map(|file| file.file_stem().unwrap_or_default().to_string_lossy()).collect();
    let columns: Vec<Column<'_>> = names
        .iter()
        .zip(&results)
        .map(|(name, results)| Column { name: name.as_ref(), results })
        .collect();
    markdown::insert(page, &columns)
}

fn write(results: &Results, earlier: Option<&Results>, out: &Path) -> Result<()> {
    results.write(out)?;
    let mut text = render(results);
    if let Some(earlier) = earlier {
        text += &format!("\n{}", markdown::changes(&compare::compare(earlier, results)));
    }
    let path = out.join("bench.md");
    std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
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
