//! The memory process: takes part in a run, or shows what an encoder makes of pictures.

use std::io::IsTerminal;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};
use memory_proc::embed_command;
use memory_proc::manifest::Manifest;
use memory_proc::paths::Cache;
use memory_proc::serve::{EncoderSettings, Settings, serve};
use tracing_subscriber::EnvFilter;

/// The memory of MemTransfer: embeds frames, builds the representations, retrieves.
#[derive(Parser)]
#[command(name = "memory-proc", version)]
struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand)]
enum Verb {
    /// Take part in a run until it stops. Started by `memtransfer run`.
    Serve {
        /// The run's folder, which holds attach.json
        #[arg(long, value_name = "DIR")]
        attach: PathBuf,
        #[command(flatten)]
        encoder: EncoderArguments,
    },
    /// Embed PNG files and print their distances as JSON.
    Embed {
        /// The pictures
        #[arg(required = true, value_name = "PNG")]
        files: Vec<PathBuf>,
        /// Embed them all this many times, to measure
        #[arg(long, default_value = "1", value_name = "N")]
        repeat: NonZeroUsize,
        #[command(flatten)]
        encoder: EncoderArguments,
    },
}

#[derive(Args)]
struct EncoderArguments {
    /// Folder of layout, catalogue, cases and model manifest instead of those that are built in
    #[arg(long, value_name = "DIR")]
    assets: Option<PathBuf>,
    /// The encoder, by its name in the model manifest [default: the manifest's]
    #[arg(long, value_name = "NAME")]
    encoder: Option<String>,
    /// The encoder's ONNX file [default: where `cargo xtask setup` puts it]
    #[arg(long, value_name = "FILE")]
    encoder_file: Option<PathBuf>,
    /// Pictures embedded at the same time; each takes memory for the model [default: the processor's
    /// cores, at most 8]
    #[arg(long, value_name = "N")]
    encoder_threads: Option<NonZeroUsize>,
    /// The cache folder [default: $MEMTRANSFER_CACHE, else memtransfer in the user's cache folder]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
}

/// Most threads that are taken without being asked for: every session has its own copy of the weights.
const MOST_THREADS: NonZeroUsize = NonZeroUsize::new(8).unwrap();

impl EncoderArguments {
    fn settings(self) -> anyhow::Result<EncoderSettings> {
        let cores = || {
            std::thread::available_parallelism().map_or(NonZeroUsize::MIN, |n| n.min(MOST_THREADS))
        };
        Ok(EncoderSettings {
            name: self.encoder,
            file: self.encoder_file,
            threads: self.encoder_threads.unwrap_or_else(cores),
            cache: self
                .cache
                .map_or_else(Cache::from_environment, |folder| Ok(Cache::at(folder)))?,
        })
    }
}

fn main() -> ExitCode {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn"));
    let colours = std::io::stderr().is_terminal();
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(colours)
        .with_writer(std::io::stderr)
        .init();
    match run(Arguments::parse().verb) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("memory-proc: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn run(verb: Verb) -> anyhow::Result<()> {
    match verb {
        Verb::Serve { attach, encoder } => {
            let assets = encoder.assets.clone();
            serve(&Settings { attach, assets, encoder: encoder.settings()? })
        }
        Verb::Embed { files, repeat, encoder } => {
            let manifest = match &encoder.assets {
                None => Manifest::shipped()?,
                Some(folder) => Manifest::load(folder)?,
            };
            embed_command::run(&files, repeat, &manifest, &encoder.settings()?)
        }
    }
}
