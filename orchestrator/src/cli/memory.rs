//! `memtransfer memory`: builds, lists and shows the documents of summary, semantic and hybrid memory.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand, ValueEnum};
use domain::DocumentKind;
use indicatif::HumanBytes;
use serde_json::Value;
use shm_types::FrameSize;
use warehouse::Demonstrations;

use super::{Exit, print, print_json};
use crate::documents::{Builder, DocumentName, Holding, Library, Model, kind};
use crate::progress::BuildProgress;
use crate::signals::Signals;
use results::table::table;

#[derive(Debug, Args)]
#[command(after_help = "\
Documents are built from the selected demonstrations of all cases, by reading their frames. `run`
builds what it needs by itself; building beforehand is for looking at them, and for those that a
model writes.

Examples:
  memtransfer memory build                        both kinds, from one and from four demonstrations
  memtransfer memory build --kind summary --demos irrelevant,confusable
  memtransfer memory build --builder model --base-url http://localhost:8000/v1 --model NAME
  memtransfer memory ls
  memtransfer memory show summary 4")]
pub(super) struct MemoryArgs {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Build documents that are missing or out of date
    Build(BuildArgs),
    /// List the documents there are, and whether they are what would be built
    Ls(LsArgs),
    /// Print a document, and on stderr where it comes from
    Show(ShowArgs),
}

#[derive(Debug, Args)]
struct BuildArgs {
    /// The demonstrations of every case they are made of, as in `run --demos`
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "original,4")]
    demos: Vec<Demonstrations>,
    /// What they tell: summary (items, passages, routes), semantic (general knowledge)
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "summary,semantic",
          value_parser = kind)]
    kind: Vec<DocumentKind>,
    /// Who writes them
    #[arg(long, value_name = "NAME", value_enum, default_value_t = BuilderName::Extractive)]
    builder: BuilderName,
    /// Put them there [default: documents/<builder> in the cache folder]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Build them even if they are up to date or broken
    #[arg(long)]
    force: bool,
    /// Show no progress, only what goes wrong
    #[arg(long)]
    quiet: bool,
    #[command(flatten)]
    made_for: MadeFor,
    #[command(flatten)]
    asked: AskedArgs,
}

/// How a model is asked.
#[derive(Debug, Args)]
#[command(next_help_heading = "With --builder model")]
struct AskedArgs {
    /// The model, as the server calls it
    #[arg(long, value_name = "NAME", required_if_eq("builder", "model"))]
    model: Option<String>,
    /// Where the server is, up to /v1 [default: $OPENAI_BASE_URL; the key is $OPENAI_API_KEY]
    #[arg(long, value_name = "URL", requires = "model")]
    base_url: Option<String>,
    /// Most characters of what it is asked at once [default: 100000]
    #[arg(long, value_name = "N", requires = "model")]
    context_chars: Option<u32>,
    /// Most tokens of an answer [default: 16000]
    #[arg(long, value_name = "N", requires = "model")]
    max_tokens: Option<u32>,
    /// Longest that one attempt may take [default: 300]
    #[arg(long, value_name = "SECONDS", requires = "model")]
    timeout: Option<u32>,
    /// How often it is asked again when the server fails [default: 5]
    #[arg(long, value_name = "N", requires = "model")]
    max_retries: Option<u32>,
}

impl AskedArgs {
    fn builder(self, builder: BuilderName) -> Result<Builder> {
        let Self { model, base_url, context_chars, max_tokens, timeout, max_retries } = self;
        let name = match (builder, model) {
            (BuilderName::Extractive, None) => return Ok(Builder::Extractive),
            (BuilderName::Extractive, Some(_)) => bail!("--model needs --builder model"),
            (BuilderName::Model, name) => name.context("--builder model needs --model NAME")?,
        };
        let flags = [
            ("--context-chars", context_chars),
            ("--max-tokens", max_tokens),
            ("--timeout", timeout),
            ("--max-retries", max_retries),
        ];
        let flags = flags.into_iter().filter_map(|(flag, n)| Some((flag, n?.to_string())));
        Ok(Builder::Model(Model { name, base_url, flags: flags.collect() }))
    }
}

#[derive(Debug, Args)]
struct LsArgs {
    /// Those there [default: documents/<builder> in the cache folder, for every builder]
    #[arg(long, value_name = "DIR")]
    documents: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    made_for: MadeFor,
}

#[derive(Debug, Args)]
struct ShowArgs {
    /// summary or semantic
    #[arg(value_name = "KIND", value_parser = kind)]
    kind: DocumentKind,
    /// Its demonstrations: original, 4, irrelevant, ...
    #[arg(value_name = "DEMOS")]
    demos: Demonstrations,
    /// Who wrote it
    #[arg(long, value_name = "NAME", value_enum, default_value_t = BuilderName::Extractive)]
    builder: BuilderName,
    /// The folder it lies in [default: documents/<builder> in the cache folder]
    #[arg(long, value_name = "DIR")]
    documents: Option<PathBuf>,
    /// Print text, provenance and state as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    made_for: MadeFor,
}

/// What documents are made for: others are out of date.
#[derive(Debug, Args)]
struct MadeFor {
    /// Use the layout, catalogue and cases in DIR instead of the built-in ones
    #[arg(long, value_name = "DIR", env = "MEMTRANSFER_ASSETS")]
    assets: Option<PathBuf>,
    /// Width and height of the frames that are read
    #[arg(long, value_name = "PIXELS", env = "MEMTRANSFER_FRAME_SIZE",
          default_value_t = FrameSize::DEFAULT.width)]
    frame_size: u32,
}

/// A builder of documents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum BuilderName {
    /// Deterministic and offline
    Extractive,
    /// Asks a model behind an OpenAI-compatible endpoint
    Model,
}

impl BuilderName {
    const fn word(self) -> &'static str {
        match self {
            Self::Extractive => "extractive",
            Self::Model => "model",
        }
    }

    /// To look at its documents, whichever version or model made them.
    const fn anyone(self) -> Builder {
        Builder::Anyone { of: self.word() }
    }
}

impl MadeFor {
    fn library(self, folder: Option<PathBuf>, builder: Builder) -> Library {
        let Self { assets, frame_size } = self;
        Library { folder, assets, frame_size, builder }
    }
}

pub(super) fn run(args: MemoryArgs) -> Result<Exit> {
    match args.verb {
        Verb::Build(args) => build(args),
        Verb::Ls(args) => ls(args),
        Verb::Show(args) => show(args),
    }
}

fn build(args: BuildArgs) -> Result<Exit> {
    let builder = args.asked.builder(args.builder)?;
    let mut wanted = Vec::new();
    for &demonstrations in &args.demos {
        if demonstrations == Demonstrations::NONE {
            bail!("--demos none: a document needs demonstrations");
        }
        let names = args.kind.iter().map(|&kind| DocumentName { kind, demonstrations });
        wanted.extend(names);
    }
    wanted.sort_unstable();
    wanted.dedup();
    let signals = Signals::listen().context("cannot listen to signals")?;
    let library = args.made_for.library(args.out, builder);
    let mut progress = BuildProgress::new(args.quiet);
    let supply =
        library.ensure(&wanted, args.force, signals.stop(), &mut |stage| progress.show(stage));
    progress.close();
    let Some(supply) = supply? else {
        return Ok(Exit::Signal(signals.received().unwrap_or_default()));
    };
    print(&overview(&supply.documents))?;
    if !args.quiet {
        let (all, built) = (supply.documents.len(), supply.built.len());
        eprintln!("{built} built, {} up to date, in {}", all - built, supply.folder.display());
    }
    Ok(Exit::Complete)
}

fn ls(args: LsArgs) -> Result<Exit> {
    let MadeFor { assets, frame_size } = args.made_for;
    let builders: &[BuilderName] = match args.documents {
        // Whose they are is said in them.
        Some(_) => &[BuilderName::Extractive],
        None => BuilderName::value_variants(),
    };
    let mut documents = Vec::new();
    for builder in builders {
        let made_for = MadeFor { assets: assets.clone(), frame_size };
        let library = made_for.library(args.documents.clone(), builder.anyone());
        documents.extend(library.ask(None, false)?.documents);
    }
    if args.json {
        print_json(&documents)?;
    } else {
        print(&overview(&documents))?;
        if documents.is_empty() {
            eprintln!("no documents yet: `memtransfer memory build` makes them");
        }
    }
    Ok(Exit::Complete)
}

fn show(args: ShowArgs) -> Result<Exit> {
    let ShowArgs { kind, demos: demonstrations, builder, documents, json, made_for } = args;
    let library = made_for.library(documents, builder.anyone());
    let name = DocumentName { kind, demonstrations };
    let mut found = library.ask(Some(&[name]), true)?.documents;
    let Some(Holding { text: Some(text), .. }) = found.first() else {
        let problem = found.pop().and_then(|document| document.problem);
        bail!("{}", problem.unwrap_or_else(|| format!("there is no document {name}")));
    };
    if json {
        print_json(&found[0])?;
        return Ok(Exit::Complete);
    }
    for (key, value) in found[0].provenance.iter().flatten() {
        match value {
            Value::String(word) => eprintln!("{key}: {word}"),
            other => eprintln!("{key}: {other}"),
        }
    }
    eprintln!("state: {}\n", found[0].problem.as_deref().unwrap_or("current"));
    print(text)?;
    Ok(Exit::Complete)
}

fn overview(documents: &[Holding]) -> String {
    let header =
        ["document", "builder", "state", "size", "words", "demonstrations", "views", "file"];
    let mut table = table(&header, 3);
    for document in documents {
        let count = |value: Option<u64>| value.map_or("-".to_owned(), |n| n.to_string());
        let number = |key: &str| {
            count(document.provenance.as_ref().and_then(|facts| facts.get(key)?.as_u64()))
        };
        let account = document.provenance.as_ref().and_then(|facts| facts.get("account"));
        let model = account.and_then(|account| account.get("model")).and_then(Value::as_str);
        let builder = document.said("builder").unwrap_or("-".to_owned());
        table.add_row([
            document.name.to_string(),
            model.map_or(builder.clone(), |model| format!("{builder} {model}")),
            document.state.word().to_owned(),
            document.bytes.map_or("-".to_owned(), |bytes| HumanBytes(bytes).to_string()),
            count(document.words),
            number("trajectories"),
            number("views"),
            document.file.display().to_string(),
        ]);
    }
    table.to_string()
}
