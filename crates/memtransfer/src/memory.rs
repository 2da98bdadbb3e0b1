//! `memtransfer memory`: builds, lists and shows the documents of summary, semantic and hybrid memory.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result, bail};
use case_book::{BookRequest, ElsewhereRequest};
use clap::{Args, Subcommand, ValueEnum};
use conditions::cost::ModelPrices;
use conditions::settings::Drawn;
use documents::asking::BuildEstimate;
use documents::{
    DocumentFile, DocumentName, DocumentSelection, DocumentState, ModelRecipe, Recipe, Sources,
    StoredDocument, kind,
};
use domain::{
    Appearance, Demonstrations, DocumentKind, ImageFormat, ReasoningRequest, SecretHeader,
    SystemRole,
};
use llm::{Servers, Source};
use orchestrator::books::{Books, WRITING_TIMEOUT};
use orchestrator::documents::{DocumentRequest, ModelServer, OwnWorld, document_folder};
use orchestrator::progress::{BuildProgress, Verbosity};
use orchestrator::run_documents::listed;
use report::table::table;
use serde_json::{Value, json};
use settings::{Layer, variable};
use shm_types::FrameSize;

use super::{Exit, WorldArgs, print, print_json};
use crate::document_estimate::document_table;
use crate::signals::Signals;

#[derive(Debug, Args)]
#[command(after_help = "\
Documents are built from the selected demonstrations of all cases. `run` builds those that it needs,
with its own model or the script; build them here to read them, with other limits, or with another
model. A document is never replaced by one of another model, frame size or world.

Examples:
  memtransfer memory build                        both kinds, of one and of four demonstrations
  memtransfer memory build --kind summary --demos irrelevant,confusable
  memtransfer memory build --builder model --base-url http://localhost:8000/v1 --model NAME
  memtransfer memory build --builder model --model NAME --dry-run          what that would take
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
    /// Print what would be built, and the estimated requests, images and tokens of a model; build nothing
    #[arg(long)]
    dry_run: bool,
    /// Print only errors
    #[arg(long)]
    quiet: bool,
    #[command(flatten)]
    made_for: MadeFor,
    #[command(flatten)]
    model: ModelArgs,
}

/// How a model is asked.
#[derive(Debug, Default, PartialEq, Args)]
#[command(next_help_heading = "With --builder model")]
struct ModelArgs {
    /// The model, by the name that the server knows it by [default: $MEMTRANSFER_MODEL]
    #[arg(long, value_name = "NAME")]
    model: Option<String>,
    /// The server, up to /v1 [default: $MEMTRANSFER_BASE_URL, else $OPENAI_BASE_URL; the key is $OPENAI_API_KEY]
    #[arg(long, value_name = "URL")]
    base_url: Option<String>,
    /// What requests say about reasoning, as in `run --reasoning` [default: $MEMTRANSFER_REASONING, else off]
    #[arg(long, value_name = "LEVEL")]
    reasoning: Option<ReasoningRequest>,
    /// How the rules are sent, as in `run --system-role` [default: $MEMTRANSFER_SYSTEM_ROLE, else system]
    #[arg(long, value_name = "ROLE")]
    system_role: Option<SystemRole>,
    /// Further fields of each request, as in `run --extra-body` [default: $MEMTRANSFER_EXTRA_BODY]
    #[arg(long, value_name = "JSON", value_parser = extra_body)]
    extra_body: Option<String>,
    /// A further header of each request, as in `run --header` [default: $MEMTRANSFER_HEADER]
    #[arg(long, value_name = "NAME: VALUE")]
    header: Vec<SecretHeader>,
    /// Encoding of images in requests, as in `run --image-format` [default: $MEMTRANSFER_IMAGE_FORMAT, else png]
    #[arg(long, value_name = "FORMAT")]
    image_format: Option<ImageFormat>,
    /// Maximum number of characters in a prompt [default: 100000]
    #[arg(long, value_name = "N")]
    context_chars: Option<u32>,
    /// Maximum number of tokens in an answer [default: 16000]
    #[arg(long, value_name = "N")]
    max_tokens: Option<u32>,
    /// Views of each demonstration that are shown, at most; 0 for a model that reads text only [default: 8]
    #[arg(long, value_name = "N")]
    views: Option<u32>,
    /// Maximum number of images in a prompt, as in `run` [default: $MEMTRANSFER_IMAGE_BUDGET, else 50]
    #[arg(long, value_name = "N")]
    image_budget: Option<u32>,
    /// The prices of the model's tokens (docs/costs.md), for the estimate
    #[arg(long, value_name = "FILE")]
    prices: Option<PathBuf>,
    /// Time limit of one attempt [default: 300]
    #[arg(long = "request-timeout", value_name = "SECONDS")]
    timeout: Option<u32>,
    /// How often a request is sent again after a transient failure [default: 5]
    #[arg(long, value_name = "N")]
    max_retries: Option<u32>,
}

impl ModelArgs {
    /// How documents are built, and the model's server; unless `quiet`, it is told.
    fn recipe(self, builder: BuilderName, quiet: bool) -> Result<(Recipe, ModelServer)> {
        match builder {
            BuilderName::Extractive if self == Self::default() => {
                return Ok((Recipe::Extractive, ModelServer::default()));
            }
            BuilderName::Extractive => {
                bail!("--model needs --builder model, as do the other flags about a model")
            }
            BuilderName::Model => {}
        }
        let model = setting(self.model, "model")?;
        let mut recipe = ModelRecipe::new(model.context("--builder model needs --model NAME")?);
        let ModelRecipe { reasoning, system_role, extra_body, image_format, .. } = &mut recipe;
        *reasoning = setting(self.reasoning, "reasoning")?.unwrap_or(*reasoning);
        *system_role = setting(self.system_role, "system-role")?.unwrap_or(*system_role);
        *extra_body = setting(self.extra_body, "extra-body")?;
        *image_format = setting(self.image_format, "image-format")?.unwrap_or(*image_format);
        recipe.context_chars = self.context_chars.map_or(recipe.context_chars, |n| n as usize);
        recipe.max_tokens = self.max_tokens.unwrap_or(recipe.max_tokens);
        recipe.views = self.views.unwrap_or(recipe.views);
        let of_run = variable("image-budget")?.and_then(|n| u32::try_from(n.as_u64()?).ok());
        recipe.image_budget = self.image_budget.or(of_run).unwrap_or(recipe.image_budget);
        let source = match &self.base_url {
            Some(_) => Source::CommandLine,
            None => Source::Environment,
        };
        let base_url = setting(self.base_url, "base-url")?;
        let headers = match (self.header, variable("header")?) {
            (headers, Some(lines)) if headers.is_empty() => serde_json::from_value(lines)?,
            (headers, _) => headers,
        };
        let given = base_url.as_deref().map(|url| (url, source));
        let servers = Servers::from_environment(given, Path::new("."))?;
        let servers = servers.with_headers(&headers, false)?;
        if !quiet {
            say!("asking {} at {servers}", recipe.model);
        }
        let server = ModelServer {
            base_url,
            base_url_from: Some(source.word()),
            headers,
            timeout: self.timeout,
            max_retries: self.max_retries,
        };
        Ok((Recipe::Model(recipe), server))
    }
}

/// The value of a setting of `run`: that of the flag, else that of the environment.
fn setting<T: FromStr>(flag: Option<T>, name: &str) -> Result<Option<T>>
where
    anyhow::Error: From<T::Err>,
{
    let of_variable = || match variable(name)?.as_ref().and_then(Value::as_str) {
        Some(text) => Ok(Some(text.parse()?)),
        None => Ok(None),
    };
    flag.map_or_else(of_variable, |value| Ok(Some(value)))
}

/// A text that `run --extra-body` accepts.
fn extra_body(text: &str) -> Result<String, String> {
    llm::extra_body(text).map(|_| text.to_owned())
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
    /// Read frames with a plate above every item, as in `run --plates on` and with `run --policy grounded`
    #[arg(long, value_name = "on|off")]
    plates: Option<Drawn>,
    /// Read frames without anything written in them, as in `run --labels off`
    #[arg(long, value_name = "on|off")]
    labels: Option<Drawn>,
    /// Read frames with this light and these tints, as in `run --appearance-seed`
    #[arg(long, value_name = "N")]
    appearance_seed: Option<u64>,
}

/// What the flag `name`, or else its variable, says about something that is drawn or not.
fn is_drawn(name: &str, flag: Option<Drawn>) -> Result<Option<bool>> {
    let of_variable = variable(name)?.and_then(|word| word.as_str()?.parse().ok());
    Ok(flag.or(of_variable).map(|drawn: Drawn| drawn == Drawn::On))
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
        let Self { world, elsewhere, seed, frame_size, plates, labels, appearance_seed } = self;
        world.program()?;
        let of_warehouse = [
            ("elsewhere", elsewhere.is_some()),
            ("plates", plates.is_some()),
            ("labels", labels.is_some()),
            ("appearance-seed", appearance_seed.is_some()),
        ];
        let given = of_warehouse.into_iter().find(|(_, is_given)| *is_given);
        let command = world.other.command().map(str::to_owned);
        if let (Some(_), Some((flag, _))) = (&command, given) {
            bail!(
                "--{flag} is about the warehouse, and --world-cmd (or MEMTRANSFER_WORLD_CMD) names another world: leave one \
                 of them out"
            );
        }
        let assets = world.assets;
        let of_run = variable("seed")?.and_then(|seed| seed.as_u64());
        let take_place_elsewhere = demos.iter().any(|set| set.take_place_elsewhere());
        let books = Books::of_world(
            command.as_deref(),
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
        let seed = variable("appearance-seed")?.and_then(|seed| seed.as_u64());
        let standard = Appearance::STANDARD;
        let of_world = Appearance {
            plates: is_drawn("plates", plates)?.unwrap_or(standard.plates),
            labels: is_drawn("labels", labels)?.unwrap_or(standard.labels),
            seed: appearance_seed.or(seed).unwrap_or(standard.seed),
        };
        let appearance = if command.is_some() { Appearance::STANDARD } else { of_world };
        Ok(DocumentRequest {
            folder,
            sources: Sources::new(books.demonstrations.book, frame_size, appearance),
            assets,
            elsewhere: books.elsewhere,
            own_world: command.map(|command| OwnWorld::of(Some(command), &books.cases.book)),
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
    let prices = args.model.prices.clone();
    let (recipe, server) = args.model.recipe(args.builder, args.quiet || args.dry_run)?;
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
    let missing = request.missing(&wanted, args.force)?;
    let estimate = estimate(&request, &missing, prices.as_deref())?;
    if args.dry_run {
        let names = listed(&missing);
        let all = wanted.len();
        print(&format!("{} of {all} documents would be built: {names}\n", missing.len()))?;
        print(&estimate.unwrap_or_default())?;
        return Ok(Exit::Complete);
    }
    if let (Some(estimate), false) = (&estimate, args.quiet) {
        say!("{estimate}");
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

/// What a model would be asked for the documents that are missing. `None` when no model is.
fn estimate(
    request: &DocumentRequest,
    missing: &[DocumentName],
    prices: Option<&Path>,
) -> Result<Option<String>> {
    let DocumentSelection::Recipe(Recipe::Model(recipe)) = &request.selection else {
        return Ok(None);
    };
    let prices = prices.map(|file| ModelPrices::read(file, &recipe.model)).transpose()?;
    if missing.is_empty() {
        return Ok(None);
    }
    let of = |name: &DocumentName| (*name, BuildEstimate::of(*name, &request.sources, recipe));
    let estimates: Vec<_> = missing.iter().map(of).collect();
    Ok(Some(document_table(&estimates, prices.as_ref())))
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
    if let Value::Object(facts) = serde_json::to_value(provenance)? {
        for (key, value) in facts {
            match value {
                Value::String(word) => say!("{key}: {word}"),
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
    let header =
        ["document", "address", "builder", "state", "size", "demos", "requests", "images", "Mtok"];
    let mut table = table(&header, 4);
    for stored in documents {
        let document = stored.document.as_ref();
        let made = |cell: fn(&DocumentFile) -> String| document.map_or("-".to_owned(), cell);
        table.add_row([
            stored.name.to_string(),
            stored.address.clone().unwrap_or("-".to_owned()),
            made(|file| match file.provenance.model() {
                Some(model) => format!("model {model}"),
                None => file.provenance.builder.clone(),
            }),
            stored.state.word().to_owned(),
            made(|file| format!("{:.1} KiB", file.text.len() as f64 / 1024.0)),
            made(|file| file.provenance.trajectories.to_string()),
            made(|file| count(file.provenance.account.requests)),
            made(|file| count(file.provenance.account.images)),
            made(|file| match file.provenance.account.tokens() {
                Some(tokens) => format!("{:.2}", tokens as f64 / 1e6),
                None => "-".to_owned(),
            }),
        ]);
    }
    table.to_string()
}

/// A number that was counted.
fn count(count: Option<u64>) -> String {
    count.map_or("-".to_owned(), |count| count.to_string())
}
