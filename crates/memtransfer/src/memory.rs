//! `memtransfer memory`: builds, lists and shows the documents of summary, semantic and hybrid memory.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use case_book::{BookRequest, ElsewhereRequest};
use clap::{Args, Subcommand, ValueEnum};
use conditions::settings::Drawn;
use documents::{
    DocumentFile, DocumentName, DocumentSelection, DocumentState, ModelRecipe, Recipe, Sources,
    StoredDocument, kind,
};
use domain::{Appearance, Demonstrations, DocumentKind};
use llm::{Servers, Source};
use orchestrator::books::{Books, WRITING_TIMEOUT};
use orchestrator::documents::{DocumentRequest, ModelServer, document_folder};
use orchestrator::progress::{BuildProgress, Verbosity};
use report::table::table;
use serde_json::json;
use settings::{Layer, variable};
use shm_types::FrameSize;

use super::{Exit, WorldArgs, print, print_json};
use crate::signals::Signals;

#[derive(Debug, Args)]
#[command(after_help = "\
Documents are built from the selected demonstrations of all cases, by reading their frames. `run`
builds the extractive documents that it needs; build them here to read them, or to have a model
write them. A document is never replaced by one of another model, frame size or world.

Examples:
  memtransfer memory build                        both kinds, of one and of four demonstrations
  memtransfer memory build --kind summary --demos irrelevant,confusable
  memtransfer memory build --builder model --base-url http://localhost:8000/v1 --model NAME
  memtransfer memory ls
  memtransfer memory show summary 4")]
pub(super) struct MemoryArgs {
    #[command(subcommand)]
    verb: MemoryVerb,
}

#[derive(Debug, Subcommand)]
enum MemoryVerb {
    /// Build documents that are missing
    Build(BuildArgs),
    /// List documents, and whether they fit the current frame size and assets
    Ls(LsArgs),
    /// Print a document, and its provenance to stderr
    Show(DocumentArgs),
}

#[derive(Debug, Args)]
struct BuildArgs {
    /// The demonstrations of every case they are made of, as in `run --demos`
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "original,4")]
    demos: Vec<Demonstrations>,
    /// The kinds: summary (the demonstrations), semantic (general knowledge)
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "summary,semantic",
          value_parser = kind)]
    kind: Vec<DocumentKind>,
    /// The builder
    #[arg(long, value_name = "NAME", value_enum, default_value_t = BuilderName::Extractive)]
    builder: BuilderName,
    /// The folder to write them to [default: documents in the cache folder]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Build them again even if they are current or broken
    #[arg(long)]
    force: bool,
    /// Print only errors
    #[arg(long)]
    quiet: bool,
    #[command(flatten)]
    made_for: MadeFor,
    #[command(flatten)]
    model: ModelArgs,
}

/// How a model is asked.
#[derive(Debug, Args)]
#[command(next_help_heading = "With --builder model")]
struct ModelArgs {
    /// The model, by the name that the server knows it by
    #[arg(long, value_name = "NAME", required_if_eq("builder", "model"))]
    model: Option<String>,
    /// The server, up to /v1 [default: $OPENAI_BASE_URL; the key is $OPENAI_API_KEY]
    #[arg(long, value_name = "URL", requires = "model")]
    base_url: Option<String>,
    /// Maximum number of characters in a prompt [default: 100000]
    #[arg(long, value_name = "N", requires = "model")]
    context_chars: Option<u32>,
    /// Maximum number of tokens in an answer [default: 16000]
    #[arg(long, value_name = "N", requires = "model")]
    max_tokens: Option<u32>,
    /// Time limit of one attempt [default: 300]
    #[arg(long = "request-timeout", value_name = "SECONDS", requires = "model")]
    timeout: Option<u32>,
    /// How often a request is sent again after a transient failure [default: 5]
    #[arg(long, value_name = "N", requires = "model")]
    max_retries: Option<u32>,
}

impl ModelArgs {
    fn recipe(self, builder: BuilderName) -> Result<(Recipe, ModelServer)> {
        let Self { model, base_url, context_chars, max_tokens, timeout, max_retries } = self;
        let model = match (builder, model) {
            (BuilderName::Extractive, None) => {
                return Ok((Recipe::Extractive, ModelServer::default()));
            }
            (BuilderName::Extractive, Some(_)) => bail!("--model needs --builder model"),
            (BuilderName::Model, name) => name.context("--builder model needs --model NAME")?,
        };
        let recipe = ModelRecipe {
            model,
            context_chars: context_chars.map_or(ModelRecipe::CONTEXT_CHARS, |n| n as usize),
            max_tokens: max_tokens.unwrap_or(ModelRecipe::MAX_TOKENS),
        };
        Ok((Recipe::Model(recipe), ModelServer { base_url, timeout, max_retries }))
    }
}

#[derive(Debug, Args)]
struct LsArgs {
    /// Their folder [default: documents in the cache folder]
    #[arg(long, value_name = "DIR")]
    documents: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    made_for: MadeFor,
}

#[derive(Debug, Args)]
struct DocumentArgs {
    /// summary or semantic
    #[arg(value_name = "KIND", value_parser = kind)]
    kind: DocumentKind,
    /// Its demonstrations: original, 4, irrelevant, ...
    #[arg(value_name = "DEMOS")]
    demos: Demonstrations,
    /// The builder [default: extractive, or model with --model]
    #[arg(long, value_name = "NAME", value_enum)]
    builder: Option<BuilderName>,
    /// The model that wrote it
    #[arg(long, value_name = "NAME")]
    model: Option<String>,
    /// Its folder [default: documents in the cache folder]
    #[arg(long, value_name = "DIR")]
    documents: Option<PathBuf>,
    /// Print text, provenance and state as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    made_for: MadeFor,
}

/// A width that `run` accepts.
fn frame_width(text: &str) -> anyhow::Result<u32> {
    Layer::flags([("frame-size", text)])?;
    Ok(text.parse()?)
}

/// The world, frame size and appearance that documents are made for.
#[derive(Debug, Args)]
struct MadeFor {
    #[command(flatten)]
    world: WorldArgs,
    /// The warehouse of --demos elsewhere, as in `run --elsewhere` [default: drawn from --seed]
    #[arg(long, value_name = "DIR")]
    elsewhere: Option<PathBuf>,
    /// The seed of the run that the documents of --demos elsewhere are for [default: $MEMTRANSFER_SEED, else 1]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Width and height of the frames that are read [default: $MEMTRANSFER_FRAME_SIZE, else 448]
    #[arg(long, value_name = "PIXELS", value_parser = frame_width)]
    frame_size: Option<u32>,
    /// Read frames without anything written in them, as in `run --labels off`
    #[arg(long, value_name = "on|off")]
    labels: Option<Drawn>,
    /// Read frames with this light and these tints, as in `run --appearance-seed`
    #[arg(long, value_name = "N")]
    appearance_seed: Option<u64>,
}

/// The default of `run --seed`.
const SEED: u64 = 1;

/// A builder of documents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum BuilderName {
    /// Deterministic and offline
    Extractive,
    /// Asks a model behind an OpenAI-compatible endpoint
    Model,
}

impl MadeFor {
    fn request(
        self,
        folder: Option<PathBuf>,
        selection: DocumentSelection,
        demos: &[Demonstrations],
    ) -> Result<DocumentRequest> {
        let Self { world, elsewhere, seed, frame_size, labels, appearance_seed } = self;
        world.warehouse()?;
        let assets = world.assets;
        let of_run = variable("seed")?.and_then(|seed| seed.as_u64());
        let take_place_elsewhere = demos.iter().any(|set| set.take_place_elsewhere());
        let books = Books::of_world(
            None,
            &BookRequest {
                assets: assets.clone(),
                demonstrations: demos.to_vec(),
                elsewhere: take_place_elsewhere.then(|| ElsewhereRequest {
                    assets: elsewhere,
                    seed: seed.or(of_run).unwrap_or(SEED),
                }),
                ..BookRequest::default()
            },
            WRITING_TIMEOUT,
        )?;
        let size = variable("frame-size")?.and_then(|size| u32::try_from(size.as_u64()?).ok());
        let frame_size = frame_size.or(size).unwrap_or(FrameSize::DEFAULT.width);
        let drawn = variable("labels")?.and_then(|word| word.as_str()?.parse().ok());
        let seed = variable("appearance-seed")?.and_then(|seed| seed.as_u64());
        let appearance = Appearance {
            labels: labels.or(drawn).unwrap_or_default() == Drawn::On,
            seed: appearance_seed.or(seed).unwrap_or_default(),
            ..Appearance::STANDARD
        };
        Ok(DocumentRequest {
            folder,
            sources: Sources::new(books.demonstrations.book, frame_size, appearance),
            assets,
            elsewhere: books.elsewhere,
            selection,
            server: ModelServer::default(),
        })
    }
}

pub(super) fn run(args: MemoryArgs) -> Result<Exit> {
    match args.verb {
        MemoryVerb::Build(args) => build(args),
        MemoryVerb::Ls(args) => ls(args),
        MemoryVerb::Show(args) => show(args),
    }
}

fn build(args: BuildArgs) -> Result<Exit> {
    let (recipe, server) = args.model.recipe(args.builder)?;
    let mut wanted = Vec::new();
    for &demonstrations in &args.demos {
        if demonstrations == Demonstrations::NONE {
            bail!("--demos none: a document needs demonstrations");
        }
        wanted.extend(args.kind.iter().map(|&kind| DocumentName { kind, demonstrations }));
    }
    wanted.sort_unstable();
    wanted.dedup();
    let signals = Signals::listen().context("cannot listen to signals")?;
    let request =
        args.made_for.request(args.out, DocumentSelection::Recipe(recipe), &args.demos)?;
    let request = DocumentRequest { server, ..request };
    if let (DocumentSelection::Recipe(Recipe::Model(recipe)), false) =
        (&request.selection, args.quiet)
    {
        let given = request.server.base_url.as_deref().map(|url| (url, Source::CommandLine));
        let servers = Servers::from_environment(given, Path::new("."))?;
        say!("asking {} at {servers}", recipe.model);
    }
    let mut progress = BuildProgress::new(Verbosity::of_quiet(args.quiet));
    let ready =
        request.ensure(&wanted, args.force, signals.stop(), &mut |stage| progress.show(stage));
    progress.close(matches!(ready, Ok(Some(_))));
    let Some(ready) = ready? else {
        say!("stopped; give the same command again to continue");
        return Ok(Exit::Signal(signals.received().unwrap_or_default()));
    };
    print(&overview(&ready.documents))?;
    if !args.quiet {
        let (all, built) = (ready.documents.len(), ready.built.len());
        let folder = request.folder()?;
        say!("{built} built, {} current, in {}", all - built, folder.path().display());
    }
    Ok(Exit::Complete)
}

fn ls(args: LsArgs) -> Result<Exit> {
    if let Some(folder) = args.documents.as_deref().filter(|folder| !folder.is_dir()) {
        bail!("{} is no folder", folder.display());
    }
    let folder = document_folder(args.documents.as_deref())?;
    let stored =
        folder.files().with_context(|| format!("cannot list {}", folder.path().display()))?;
    // Without a seed, those of another world cannot be told from outdated ones.
    let sets = stored.into_iter().map(|(name, _)| name.demonstrations);
    let sets: Vec<Demonstrations> = sets.filter(|set| !set.take_place_elsewhere()).collect();
    let request = args.made_for.request(args.documents, DocumentSelection::Any, &sets)?;
    let documents = request.list()?;
    if args.json {
        print_json(&documents)?;
        return Ok(Exit::Complete);
    }
    print(&overview(&documents))?;
    let folder = request.folder()?;
    match documents.len() {
        0 => say!(
            "no documents in {}: `memtransfer memory build` builds them",
            folder.path().display()
        ),
        _ => say!("in {}", folder.path().display()),
    }
    Ok(Exit::Complete)
}

fn show(args: DocumentArgs) -> Result<Exit> {
    let selection = match (args.builder, args.model) {
        (Some(BuilderName::Extractive), Some(_)) => bail!("--model needs --builder model"),
        (Some(BuilderName::Model), model) | (None, model @ Some(_)) => {
            DocumentSelection::Model(model)
        }
        (Some(BuilderName::Extractive), None) => DocumentSelection::Recipe(Recipe::Extractive),
        // In a given folder, any document is acceptable.
        (None, None) if args.documents.is_some() => DocumentSelection::Any,
        (None, None) => DocumentSelection::Recipe(Recipe::Extractive),
    };
    let request = args.made_for.request(args.documents, selection, &[args.demos])?;
    let name = DocumentName { kind: args.kind, demonstrations: args.demos };
    let Some(stored) = request.find(&[name])?.pop() else { bail!("there is no document {name}") };
    let Some(DocumentFile { provenance, text, .. }) = &stored.document else {
        bail!("{}", stored.problem.unwrap_or_else(|| format!("there is no document {name}")));
    };
    if args.json {
        let mut document = serde_json::to_value(&stored)?;
        document["text"] = json!(text);
        print_json(&document)?;
        return Ok(Exit::Complete);
    }
    say!("file: {}", stored.file.display());
    say!("address: {}", stored.address.as_deref().unwrap_or("-"));
    if let serde_json::Value::Object(facts) = serde_json::to_value(provenance)? {
        for (key, value) in facts {
            match value {
                serde_json::Value::String(word) => say!("{key}: {word}"),
                other => say!("{key}: {other}"),
            }
        }
    }
    say!("state: {}\n", stored.problem.as_deref().unwrap_or(DocumentState::Current.word()));
    print(text)?;
    Ok(Exit::Complete)
}

/// A table of documents, at most 100 columns wide.
fn overview(documents: &[StoredDocument]) -> String {
    let header = ["document", "address", "builder", "state", "size", "words", "demos", "views"];
    let mut table = table(&header, 4);
    for stored in documents {
        let document = stored.document.as_ref();
        let made = |cell: fn(&DocumentFile) -> String| document.map_or("-".to_owned(), cell);
        table.add_row([
            stored.name.to_string(),
            stored.address.clone().unwrap_or("-".to_owned()),
            made(|file| match model_of(file) {
                Some(model) => format!("model {model}"),
                None => file.provenance.builder.clone(),
            }),
            stored.state.word().to_owned(),
            made(|file| format!("{:.1} KiB", file.text.len() as f64 / 1024.0)),
            made(|file| file.words().to_string()),
            made(|file| file.provenance.trajectories.to_string()),
            made(|file| file.provenance.views.to_string()),
        ]);
    }
    table.to_string()
}

/// The name of the model that wrote a document.
fn model_of(file: &DocumentFile) -> Option<String> {
    if file.provenance.builder != "model" {
        return None;
    }
    let version = file.provenance.builder_version.split(", ");
    let named = version.into_iter().find_map(|part| part.strip_prefix("model "));
    named.map(str::to_owned).or_else(|| file.provenance.account.model.clone())
}
