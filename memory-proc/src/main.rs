//! The memory process.

use std::num::{NonZeroU32, NonZeroUsize};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::Context;
use case_book::{BookFile, DemonstrationBook};
use clap::{Args, Parser, Subcommand, ValueEnum};
use documents::{DocumentName, ModelRecipe, Recipe, Sources};
use domain::{HEADER_VARIABLE, ImageFormat, ReasoningRequest, SecretHeader, SystemRole};
use llm::{ChatClient, ChatSettings, RequestOptions, Servers, Source, extra_body};
use memory_proc::builders::build::{self, BuildSettings};
use memory_proc::builders::views::{ViewRenderer, ViewedWorld};
use memory_proc::builders::{DocumentBuilder, Extractive, ModelBuilder, model};
use memory_proc::embed_command;
use memory_proc::encoder::Provider;
use memory_proc::external::ExternalLimits;
use memory_proc::manifest::EncoderManifest;
use memory_proc::paths::CacheFolder;
use memory_proc::search_profile::{self, ProfileSettings};
use memory_proc::serve::{EncoderSettings, ServeSettings, serve};
use program::AppearanceArgs;
use search::synthetic::SyntheticVectors;

/// The memory of MemTransfer: embeds frames, builds the representations, retrieves.
#[derive(Parser)]
#[command(name = "memory-proc", version)]
struct MemoryArguments {
    #[command(subcommand)]
    verb: MemoryProcVerb,
}

#[derive(Subcommand)]
enum MemoryProcVerb {
    /// Serve a run until it stops. Started by `memtransfer run`
    Serve {
        /// The run's folder, which holds attach.json
        #[arg(long, value_name = "DIR")]
        attach: PathBuf,
        /// The run's demonstrations
        #[arg(long, value_name = "FILE")]
        demonstrations: PathBuf,
        /// The documents that summary, semantic and hybrid memory supply
        #[arg(long, value_name = "DIR")]
        documents: Option<PathBuf>,
        /// The folder for snapshots of memories that learn
        #[arg(long, value_name = "DIR")]
        snapshots: Option<PathBuf>,
        /// Start no encoder: for a run whose memories use no embeddings
        #[arg(long)]
        no_encoder: bool,
        /// Embeddings that came with the plan, used instead of this machine's own
        #[arg(long, value_name = "FILE")]
        shipped_embeddings: Option<PathBuf>,
        /// The longest time that an external memory may take to answer
        #[arg(long, value_name = "SECONDS", default_value_t = 30)]
        memory_timeout: u32,
        #[command(flatten)]
        encoder: EncoderArguments,
    },
    /// Embed PNG files and print their distances as JSON
    Embed {
        /// The images
        #[arg(required = true, value_name = "PNG")]
        files: Vec<PathBuf>,
        /// Embed them all this many times, to measure
        #[arg(long, default_value = "1", value_name = "N")]
        repeat: NonZeroUsize,
        #[command(flatten)]
        encoder: EncoderArguments,
    },
    /// Write the known embeddings to a file, and print the encoder's files as JSON. Started by
    /// `memtransfer plan --store`
    Embeddings {
        /// The file to write
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        #[command(flatten)]
        encoder: EncoderArguments,
    },
    /// Measure how long a search takes, by the size of the memory. Prints one JSON object per line
    ///
    /// The vectors are the embeddings in the cache folder, then seeded neighbours of them, or of random directions if
    /// there are no embeddings.
    Profile(ProfileArguments),
    /// Write the vectors that `profile` measures with to stdout, for other programs
    ///
    /// First the memory's vectors, then the queries, as little-endian 32-bit floats.
    Vectors {
        #[command(flatten)]
        vectors: VectorArguments,
        /// Size of the memory
        #[arg(long, value_name = "N")]
        entries: NonZeroU32,
        /// Number of queries
        #[arg(long, default_value = "0", value_name = "N")]
        queries: usize,
    },
    /// Build documents from demonstrations. Started by `memtransfer memory build`
    Build {
        /// The demonstrations
        #[arg(long, value_name = "FILE")]
        demonstrations: PathBuf,
        /// Folder of the world's assets [default: the built-in ones]
        #[arg(long, value_name = "DIR")]
        assets: Option<PathBuf>,
        /// The other world in which tasks are demonstrated
        #[arg(long, value_name = "FILE")]
        elsewhere: Option<PathBuf>,
        /// The command that starts the world, if it is another one than the warehouse
        #[arg(long, value_name = "COMMAND")]
        world_cmd: Option<String>,
        /// The ids of that world's cases in the order of the demonstrations' book, as a JSON list
        #[arg(long, value_name = "FILE")]
        case_ids: Option<PathBuf>,
        /// Width and height of the frames, in pixels
        #[arg(long, value_name = "PIXELS")]
        frame_size: u32,
        #[command(flatten)]
        appearance: AppearanceArgs,
        /// The folder that the documents are written to
        #[arg(long, value_name = "DIR")]
        documents: PathBuf,
        /// The documents, as kind/demonstrations: summary/4,semantic/original
        #[arg(long, value_name = "LIST", value_delimiter = ',', required = true)]
        wanted: Vec<DocumentName>,
        #[command(flatten)]
        builder: BuilderArguments,
    },
}

#[derive(Args)]
struct ProfileArguments {
    #[command(flatten)]
    vectors: VectorArguments,
    /// Sizes of the memory
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "1,10,100,1000,10000")]
    entries: Vec<NonZeroU32>,
    /// Maximum number of queries in a measurement
    #[arg(long, default_value = "10000", value_name = "N")]
    queries: NonZeroUsize,
    /// Maximum duration of a measurement
    #[arg(long, default_value = "3", value_name = "SECONDS")]
    seconds: f64,
    /// Maximum number of threads of a search [default: the number of cores]
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

#[derive(Args)]
struct VectorArguments {
    /// Numbers in a vector
    #[arg(long, default_value = "384", value_name = "N")]
    dimension: NonZeroU32,
    /// Seed of all vectors that are not embeddings
    #[arg(long, default_value = "1", value_name = "N")]
    seed: u64,
    /// The cache folder [default: $MEMTRANSFER_CACHE, else memtransfer in the user's cache folder]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
}

impl VectorArguments {
    fn vectors(self) -> anyhow::Result<SyntheticVectors> {
        let cache = cache_at(self.cache)?;
        let dimension = self.dimension.get() as usize;
        let embeddings = memory_proc::embedding_cache::stored(&cache.embeddings(), dimension);
        Ok(SyntheticVectors::new(embeddings, dimension, self.seed))
    }
}

#[derive(Args)]
struct BuilderArguments {
    /// What builds the documents
    #[arg(long, value_name = "NAME", value_enum, default_value_t = BuilderKind::Extractive)]
    builder: BuilderKind,
    /// The model that the builder `model` asks, by the name that the server knows it by
    #[arg(long, value_name = "NAME", required_if_eq("builder", "model"))]
    model: Option<String>,
    /// The model's server, up to /v1 [default: $OPENAI_BASE_URL; the key is $OPENAI_API_KEY]
    #[arg(long, value_name = "URL")]
    base_url: Option<String>,
    /// Where the value of --base-url was given: it decides which key is sent there
    #[arg(long, value_name = "SOURCE", default_value = Source::CommandLine.word(), hide = true)]
    base_url_from: Source,
    /// What requests say about reasoning: off, minimal, low, medium, high, or nothing (model)
    #[arg(long, value_name = "LEVEL", default_value_t = ReasoningRequest::Off)]
    reasoning: ReasoningRequest,
    /// How the rules are sent: as system, as developer, or in the user's message (user)
    #[arg(long, value_name = "ROLE", default_value_t = SystemRole::System)]
    system_role: SystemRole,
    /// Further fields of each request, a JSON object; a field that is null is not sent
    #[arg(long, value_name = "JSON")]
    extra_body: Option<String>,
    /// A further header of each request
    #[arg(long, value_name = "NAME: VALUE", env = HEADER_VARIABLE, value_delimiter = '\n', hide_env_values = true)]
    header: Vec<SecretHeader>,
    /// Image encoding: png, or jpeg (smaller, with loss)
    #[arg(long, value_name = "FORMAT", default_value_t = ImageFormat::Png)]
    image_format: ImageFormat,
    /// Time limit of an attempt
    #[arg(long, value_name = "SECONDS", default_value_t = 300)]
    request_timeout: u32,
    /// How often a request is sent again after a transient failure
    #[arg(long, value_name = "N", default_value_t = 5)]
    max_retries: u32,
    /// Maximum number of characters in a prompt
    #[arg(long, value_name = "N", default_value_t = ModelRecipe::CONTEXT_CHARS)]
    context_chars: usize,
    /// Maximum number of tokens in an answer
    #[arg(long, value_name = "N", default_value_t = ModelRecipe::MAX_TOKENS)]
    max_tokens: u32,
    /// Maximum number of views of each demonstration that are shown
    #[arg(long, value_name = "N", default_value_t = ModelRecipe::VIEWS)]
    views: u32,
    /// Maximum number of images in a prompt
    #[arg(long, value_name = "N", default_value_t = ModelRecipe::IMAGE_BUDGET)]
    image_budget: u32,
}

#[derive(Clone, Copy, ValueEnum)]
enum BuilderKind {
    /// Rules: deterministic and offline
    Extractive,
    /// A model behind an OpenAI-compatible endpoint
    Model,
}

impl BuilderArguments {
    /// The builder of documents from `sources` in `world`.
    fn builder(
        self,
        world: ViewedWorld,
        sources: Sources,
    ) -> anyhow::Result<(Recipe, Box<dyn DocumentBuilder>)> {
        let model = match self.builder {
            BuilderKind::Extractive => return Ok((Recipe::Extractive, Box::new(Extractive))),
            BuilderKind::Model => self.model.context("--builder model needs --model NAME")?,
        };
        let given = self.base_url.as_deref().map(|url| (url, self.base_url_from));
        let servers = Servers::from_environment(given, Path::new("."))?;
        // The program that started this one knows where the headers were given, and has checked it.
        let Servers { first, others, .. } = servers.with_headers(&self.header, true)?;
        let fields = self.extra_body.as_deref().map(extra_body).transpose();
        let fields = fields.map_err(anyhow::Error::msg).context("--extra-body")?;
        let options = RequestOptions {
            reasoning: self.reasoning,
            system_role: self.system_role,
            extra_body: fields.unwrap_or_default(),
        };
        let settings = ChatSettings {
            options,
            request_timeout: Duration::from_secs(self.request_timeout.into()),
            max_retries: self.max_retries,
            max_connections: 1,
            ..ChatSettings::new(&*model)
        };
        let client = ChatClient::balanced(first, others, settings, None);
        let recipe = ModelRecipe {
            model,
            context_chars: self.context_chars,
            max_tokens: self.max_tokens,
            views: self.views,
            image_budget: self.image_budget,
            reasoning: self.reasoning,
            system_role: self.system_role,
            extra_body: self.extra_body,
            image_format: self.image_format,
        };
        let views = ViewRenderer::new(world, sources, self.image_format);
        let builder = ModelBuilder::new(model::ask_through(client), views, recipe.clone());
        Ok((Recipe::Model(recipe), Box::new(builder)))
    }
}

#[derive(Args)]
struct EncoderArguments {
    /// Folder of the model manifest [default: the built-in one]
    #[arg(long, value_name = "DIR")]
    assets: Option<PathBuf>,
    /// The encoder, by its name in the model manifest [default: the manifest's]
    #[arg(long, value_name = "NAME")]
    encoder: Option<String>,
    /// The encoder's ONNX file [default: the one that `cargo xtask setup` fetched]
    #[arg(long, value_name = "FILE")]
    encoder_file: Option<PathBuf>,
    /// Images embedded at the same time; each needs memory for the model [default: the number of
    /// cores, at most 8]
    #[arg(long, value_name = "N")]
    encoder_threads: Option<NonZeroUsize>,
    /// The execution provider of ONNX Runtime that the encoder runs on
    #[arg(long, value_name = "NAME", value_enum, default_value_t)]
    provider: Provider,
    /// The cache folder [default: $MEMTRANSFER_CACHE, else memtransfer in the user's cache folder]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
}

/// The default limit on encoder threads: every session has its own copy of the weights.
const MAX_DEFAULT_THREADS: NonZeroUsize = NonZeroUsize::new(8).unwrap();

impl EncoderArguments {
    fn manifest(&self) -> anyhow::Result<EncoderManifest> {
        self.assets.as_deref().map_or_else(EncoderManifest::shipped, EncoderManifest::load)
    }

    fn settings(self) -> anyhow::Result<EncoderSettings> {
        Ok(EncoderSettings {
            name: self.encoder,
            file: self.encoder_file,
            threads: self.encoder_threads.unwrap_or_else(|| cores().min(MAX_DEFAULT_THREADS)),
            provider: self.provider,
            cache: cache_at(self.cache)?,
        })
    }
}

fn cores() -> NonZeroUsize {
    std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN)
}

fn cache_at(folder: Option<PathBuf>) -> anyhow::Result<CacheFolder> {
    Ok(folder.map_or_else(CacheFolder::from_environment, |folder| Ok(CacheFolder::at(folder)))?)
}

fn main() -> ExitCode {
    program::run("memory-proc", || {
        run(program::parse::<MemoryArguments>().verb).map(|()| ExitCode::SUCCESS)
    })
}

fn run(verb: MemoryProcVerb) -> anyhow::Result<()> {
    match verb {
        MemoryProcVerb::Serve {
            attach,
            demonstrations,
            documents,
            snapshots,
            no_encoder,
            shipped_embeddings,
            memory_timeout,
            encoder,
        } => {
            let limits = ExternalLimits {
                answer: Duration::from_secs(memory_timeout.into()),
                ..ExternalLimits::default()
            };
            let assets = encoder.assets.clone();
            let encoder = if no_encoder { None } else { Some(encoder.settings()?) };
            let settings = ServeSettings {
                attach,
                demonstrations,
                assets,
                documents,
                encoder,
                shipped_embeddings,
                snapshots,
                limits,
            };
            serve(&settings)
        }
        MemoryProcVerb::Embed { files, repeat, encoder } => {
            embed_command::run(&files, repeat, &encoder.manifest()?, &encoder.settings()?)
        }
        MemoryProcVerb::Embeddings { out, encoder } => {
            embed_command::ship(&out, &encoder.manifest()?, &encoder.settings()?)
        }
        MemoryProcVerb::Profile(arguments) => profile(arguments),
        MemoryProcVerb::Vectors { vectors, entries, queries } => {
            let mut out = std::io::BufWriter::with_capacity(1 << 20, std::io::stdout().lock());
            search_profile::write_vectors(&vectors.vectors()?, entries.get(), queries, &mut out)
        }
        MemoryProcVerb::Build {
            demonstrations,
            assets,
            elsewhere,
            world_cmd,
            case_ids,
            frame_size,
            appearance,
            documents,
            wanted,
            builder,
        } => {
            let book = BookFile::<DemonstrationBook>::read(&demonstrations)?.book;
            let sources = Sources::new(book, frame_size, appearance.into());
            let world = match case_ids {
                Some(file) => {
                    ViewedWorld::Other { command: world_cmd, cases: read_case_ids(&file)? }
                }
                None => {
                    let files = [("--assets", assets), ("--elsewhere", elsewhere)];
                    let flags = files.into_iter();
                    let given = flags.filter_map(|(flag, file)| Some([flag.into(), file?.into()]));
                    ViewedWorld::Warehouse { demonstrations, arguments: given.flatten().collect() }
                }
            };
            let (recipe, mut builder) = builder.builder(world, sources.clone())?;
            let settings = BuildSettings { sources, documents, wanted, recipe };
            build::build(&settings, builder.as_mut(), std::io::stdout().lock())
        }
    }
}

fn read_case_ids(file: &Path) -> anyhow::Result<Vec<String>> {
    let ids = durable::input::read_text(file).map_err(anyhow::Error::from);
    let ids = ids.and_then(|text| Ok(serde_json::from_str(&text)?));
    ids.with_context(|| format!("cannot read {}", file.display()))
}

fn profile(arguments: ProfileArguments) -> anyhow::Result<()> {
    let settings = ProfileSettings {
        entries: arguments.entries.into_iter().map(NonZeroU32::get).collect(),
        queries: arguments.queries.get(),
        seconds: arguments.seconds,
        threads: arguments.threads.unwrap_or_else(cores),
    };
    search_profile::run(&settings, &arguments.vectors.vectors()?, &mut std::io::stdout().lock())
}
