//! The memory process: takes part in a run, or shows what an encoder makes of pictures.

use std::io::IsTerminal;
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::{Args, Parser, Subcommand};
use domain::DocumentKind;
use memory_proc::documents::build::{self, Wanted};
use memory_proc::documents::holdings::Question;
use memory_proc::documents::model::{self, Ask, ModelBuilder, Pipe};
use memory_proc::documents::sources::Sources;
use memory_proc::documents::{Builder, Extractive};
use memory_proc::embed_command;
use memory_proc::index::Effort;
use memory_proc::manifest::{Manifest, Precision};
use memory_proc::paths::Cache;
use memory_proc::profile::{self, Vectors};
use memory_proc::serve::{EncoderSettings, Settings, serve};
use shm_types::FrameSize;
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
        /// Folder of the documents that summary, semantic and hybrid memory supply, as `memtransfer memory
        /// build` makes them
        #[arg(long, value_name = "DIR")]
        documents: Option<PathBuf>,
        /// Start no encoder: for a run without episodic memory
        #[arg(long)]
        no_encoder: bool,
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
    /// Measure how long a search of a memory takes, against its size. Prints a JSON object a line.
    ///
    /// A memory's vectors are the embeddings that the cache folder holds, then seeded neighbours of them. Where
    /// it holds none, they are neighbours of seeded directions.
    Profile {
        #[command(flatten)]
        vectors: VectorArguments,
        /// Sizes of the memory
        #[arg(
            long,
            value_name = "LIST",
            value_delimiter = ',',
            default_value = "1,10,100,1000,10000"
        )]
        entries: Vec<NonZeroU32>,
        /// Kind of search
        #[arg(long, value_name = "NAME", value_enum, default_value_t = SearchName::Exact)]
        search: SearchName,
        /// Neighbours of a node of the graph that the approximate search walks
        #[arg(long, default_value_t = Effort::default().connectivity, value_name = "N")]
        connectivity: usize,
        /// Nodes that are kept in sight while the graph is built
        #[arg(long, default_value_t = Effort::default().building, value_name = "N")]
        building: usize,
        /// Nodes that are kept in sight while the graph is walked: one measurement each
        #[arg(long, default_value = "64", value_name = "LIST", value_delimiter = ',')]
        searching: Vec<usize>,
        /// Most queries of a measurement
        #[arg(long, default_value = "10000", value_name = "N")]
        queries: NonZeroUsize,
        /// Longest that a measurement takes
        #[arg(long, default_value = "3", value_name = "SECONDS")]
        seconds: f64,
        /// Most threads of a search [default: the processor's cores]
        #[arg(long, value_name = "N")]
        threads: Option<NonZeroUsize>,
    },
    /// Write the vectors that `profile` measures with to stdout, for other programs to be compared: the memory's,
    /// then the queries', as little-endian numbers of 32 bits.
    Vectors {
        #[command(flatten)]
        vectors: VectorArguments,
        /// Size of the memory
        #[arg(long, value_name = "N")]
        entries: NonZeroU32,
        /// How many queries
        #[arg(long, default_value = "0", value_name = "N")]
        queries: usize,
    },
    /// Write documents from demonstrations. Started by `memtransfer memory build`.
    Build {
        /// The run's folder, which holds attach.json
        #[arg(long, value_name = "DIR")]
        attach: PathBuf,
        /// Folder of layout, catalogue and cases instead of those that are built in
        #[arg(long, value_name = "DIR")]
        assets: Option<PathBuf>,
        /// The folder that they are written to
        #[arg(long, value_name = "DIR")]
        documents: PathBuf,
        /// Which ones, as kind/demonstrations: summary/4,semantic/original
        #[arg(long, value_name = "LIST", value_delimiter = ',', required = true, value_parser = wanted)]
        wanted: Vec<Wanted>,
        #[command(flatten)]
        builder: BuilderArguments,
    },
    /// Print as JSON which documents there are, and which of them are what would be built.
    Documents {
        /// The folder they lie in [default: that of the builder's documents in the cache folder]
        #[arg(long, value_name = "DIR")]
        documents: Option<PathBuf>,
        /// The cache folder [default: $MEMTRANSFER_CACHE, else memtransfer in the user's cache folder]
        #[arg(long, value_name = "DIR")]
        cache: Option<PathBuf>,
        /// Folder of layout, catalogue and cases instead of those that are built in
        #[arg(long, value_name = "DIR")]
        assets: Option<PathBuf>,
        /// Width and height of the frames they should be made of
        #[arg(long, value_name = "PIXELS", default_value_t = FrameSize::DEFAULT.width)]
        frame_size: u32,
        /// Which ones, as kind/demonstrations [default: all that lie there]
        #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = wanted)]
        wanted: Option<Vec<Wanted>>,
        /// Print the texts, too
        #[arg(long)]
        text: bool,
        /// Take documents by any builder, any version of it
        #[arg(long)]
        by_anyone: bool,
        #[command(flatten)]
        builder: BuilderArguments,
    },
}

#[derive(Args)]
struct VectorArguments {
    /// Numbers of a vector
    #[arg(long, default_value = "384", value_name = "N")]
    dimension: NonZeroU32,
    /// Decides all vectors that are no embeddings
    #[arg(long, default_value = "1", value_name = "N")]
    seed: u64,
    /// The cache folder [default: $MEMTRANSFER_CACHE, else memtransfer in the user's cache folder]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
}

impl VectorArguments {
    fn vectors(self) -> anyhow::Result<Vectors> {
        let cache = self.cache.map_or_else(Cache::from_environment, |dir| Ok(Cache::at(dir)))?;
        Ok(Vectors::new(
            memory_proc::embedding_cache::stored(
                &cache.embeddings(),
                self.dimension.get() as usize,
            ),
            self.dimension.get() as usize,
            self.seed,
        ))
    }
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum SearchName {
    /// The nearest, always.
    Exact,
    /// Mostly the nearest.
    Approximate,
    /// One after the other.
    Both,
}

#[derive(Args)]
struct BuilderArguments {
    /// Who writes the documents
    #[arg(long, value_name = "NAME", value_enum, default_value_t = BuilderName::Extractive)]
    builder: BuilderName,
    /// The model that a builder asks, by the name that its server knows it by
    #[arg(long, value_name = "NAME")]
    model: Option<String>,
    /// Where the model's server is, up to /v1 [default: $OPENAI_BASE_URL; the key is $OPENAI_API_KEY]
    #[arg(long, value_name = "URL")]
    base_url: Option<String>,
    /// Longest that one attempt to ask the model may take [default: that of `policy-proc ask`]
    #[arg(long, value_name = "SECONDS")]
    timeout: Option<u32>,
    /// How often the model is asked again when its server fails [default: that of `policy-proc ask`]
    #[arg(long, value_name = "N")]
    max_retries: Option<u32>,
    /// Most characters of what the model is asked at once
    #[arg(long, value_name = "N", default_value_t = model::Settings::CONTEXT_CHARS)]
    context_chars: usize,
    /// Most tokens of an answer of the model
    #[arg(long, value_name = "N", default_value_t = model::Settings::MAX_TOKENS)]
    max_tokens: u32,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum BuilderName {
    /// Deterministic and offline.
    Extractive,
    /// Asks a model behind an OpenAI-compatible endpoint.
    Model,
}

impl BuilderName {
    const fn word(self) -> &'static str {
        match self {
            Self::Extractive => "extractive",
            Self::Model => "model",
        }
    }
}

impl BuilderArguments {
    fn builder(&self) -> anyhow::Result<Box<dyn Builder>> {
        Ok(match self.builder {
            BuilderName::Extractive => Box::new(Extractive),
            BuilderName::Model => {
                let model = self.model.clone().context("the builder `model` needs --model")?;
                let ask = Ask {
                    // Both are installed together.
                    program: std::env::current_exe()?.with_file_name("policy-proc"),
                    base_url: self.base_url.clone(),
                    model: model.clone(),
                    timeout_s: self.timeout,
                    max_retries: self.max_retries,
                };
                let &Self { context_chars, max_tokens, .. } = self;
                let settings = model::Settings { model, context_chars, max_tokens };
                Box::new(ModelBuilder::new(Pipe::new(ask), settings))
            }
        })
    }
}

/// Reads `summary/4`.
fn wanted(text: &str) -> Result<Wanted, String> {
    let (kind, demonstrations) = text.split_once('/').ok_or("not kind/demonstrations")?;
    let kinds = DocumentKind::TEXTS;
    let kind = kinds.into_iter().find(|known| known.word() == kind);
    let kind =
        kind.ok_or_else(|| format!("a kind is {}", kinds.map(DocumentKind::word).join(" or ")))?;
    let demonstrations = demonstrations.parse();
    Ok((kind, demonstrations.map_err(|e: warehouse::UnknownDemonstrations| e.to_string())?))
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
    /// What the encoder computes with: f32 or bf16x3 [default: the model's own in the manifest, where this
    /// machine can, else f32]
    #[arg(long, value_name = "PRECISION", value_parser = precision)]
    encoder_precision: Option<Precision>,
    /// The cache folder [default: $MEMTRANSFER_CACHE, else memtransfer in the user's cache folder]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
}

/// Reads `bf16x3`.
fn precision(text: &str) -> Result<Precision, String> {
    let known = Precision::ALL.into_iter().find(|known| known.word() == text);
    known.ok_or_else(|| {
        format!("a precision is {}", Precision::ALL.map(Precision::word).join(" or "))
    })
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
            precision: self.encoder_precision,
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
        Verb::Serve { attach, documents, no_encoder, encoder } => {
            let assets = encoder.assets.clone();
            let encoder = if no_encoder { None } else { Some(encoder.settings()?) };
            serve(&Settings { attach, assets, documents, encoder })
        }
        Verb::Embed { files, repeat, encoder } => {
            let manifest = match &encoder.assets {
                None => Manifest::shipped()?,
                Some(folder) => Manifest::load(folder)?,
            };
            embed_command::run(&files, repeat, &manifest, &encoder.settings()?)
        }
        Verb::Profile {
            vectors,
            entries,
            search,
            connectivity,
            building,
            searching,
            queries,
            seconds,
            threads,
        } => {
            let cores = || std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
            let settings = profile::Settings {
                entries: entries.into_iter().map(NonZeroU32::get).collect(),
                exact: !matches!(search, SearchName::Approximate),
                approximate: !matches!(search, SearchName::Exact),
                effort: Effort { connectivity, building, ..Effort::default() },
                searching,
                queries: queries.get(),
                seconds,
                threads: threads.unwrap_or_else(cores),
            };
            profile::run(&settings, &vectors.vectors()?, &mut std::io::stdout().lock())
        }
        Verb::Vectors { vectors, entries, queries } => {
            let mut out = std::io::BufWriter::with_capacity(1 << 20, std::io::stdout().lock());
            profile::write(&vectors.vectors()?, entries.get(), queries, &mut out)
        }
        Verb::Build { attach, assets, documents, wanted, builder } => {
            let settings = build::Settings { attach, assets, documents, wanted };
            build::build(&settings, builder.builder()?.as_mut())
        }
        Verb::Documents {
            documents,
            cache,
            assets,
            frame_size,
            wanted,
            text,
            by_anyone,
            builder,
        } => {
            let in_cache = || {
                let cache = cache.map_or_else(Cache::from_environment, |dir| Ok(Cache::at(dir)))?;
                anyhow::Ok(cache.documents(builder.builder.word()))
            };
            let wanted_builder = || {
                let builder = builder.builder()?;
                anyhow::Ok((builder.name().to_owned(), builder.version()))
            };
            let question = Question {
                folder: documents.map_or_else(in_cache, Ok)?,
                wanted,
                frame: FrameSize { width: frame_size, height: frame_size },
                builder: if by_anyone { None } else { Some(wanted_builder()?) },
                with_text: text,
            };
            let holdings = question.answer(&Sources::load(assets.as_deref())?)?;
            serde_json::to_writer_pretty(std::io::stdout().lock(), &holdings)?;
            Ok(())
        }
    }
}
