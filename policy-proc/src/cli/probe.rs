//! `policy-proc probe`: what a model's server can do. `memtransfer doctor --policy openai` starts it.

use std::path::Path;
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use anyhow::ensure;
use clap::Args;
use domain::ImageFormat;
use llm::probe::{self, PaperDifference, ProbeFinding, ProbeMark, ProbeReport, RunRequest};
use llm::{ChatClient, ChatSettings, Servers, Source};
use policy_proc::openai::largest::LargestRequest;

use super::print;

#[derive(Args)]
#[command(after_help = "\
Sends about thirty requests, some of them of a run's size. The key comes from $OPENAI_API_KEY or .env,
and is sent only to an address that was given in the same place or with --base-url.
Exit status 0 if a run can start, 1 if something prevents it, 2 if the server could not be asked.")]
pub(crate) struct ProbeArguments {
    /// The server, up to /v1 [default: $OPENAI_BASE_URL, else $OPENAI_API_BASE, also from .env]
    #[arg(long, value_name = "URL")]
    base_url: Option<String>,
    /// Where the value of --base-url was given: it decides which key is sent there
    #[arg(long, value_name = "SOURCE", default_value = Source::CommandLine.word(), hide = true)]
    base_url_from: Source,
    /// The model, by the name that the server knows it by
    #[arg(long, value_name = "NAME")]
    model: String,
    /// Edge of a view of the run, in pixels
    #[arg(long, value_name = "PIXELS", default_value = "448", value_parser = clap::value_parser!(u32).range(8..=4096))]
    frame_size: u32,
    /// Image encoding of the run: png or jpeg
    #[arg(long, value_name = "FORMAT", default_value_t = ImageFormat::Png)]
    image_format: ImageFormat,
    /// A memory of the run and the most that it adds to a prompt: its views, and characters of documents. Can be given
    /// several times
    #[arg(long, value_name = "NAME:VIEWS:CHARACTERS", default_value = "full-context:40:0")]
    memory_size: Vec<MemorySize>,
    /// Past steps in a prompt of the run
    #[arg(long, value_name = "N", default_value = "6")]
    window: u32,
    /// Maximum number of images of a prompt of the run
    #[arg(long, value_name = "N", default_value_t = prompt::IMAGE_BUDGET)]
    image_budget: u32,
    /// Maximum number of tokens of an answer of the run
    #[arg(long, value_name = "N", default_value_t = prompt::ANSWER_TOKENS, value_parser = clap::value_parser!(u32).range(1..))]
    answer_tokens: u32,
    #[command(flatten)]
    requests: super::openai::RequestArguments,
    /// Time limit of an attempt, in seconds
    #[arg(long, value_name = "SECONDS", default_value = "120", value_parser = clap::value_parser!(u32).range(1..))]
    request_timeout: u32,
    /// Number of concurrent requests in the measurement of throughput
    #[arg(long, value_name = "N", default_value = "8", value_parser = clap::value_parser!(u32).range(1..=1000))]
    together: u32,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What a memory adds to a prompt at most.
#[derive(Debug, Clone)]
struct MemorySize {
    name: String,
    views: u32,
    document_chars: u32,
}

impl FromStr for MemorySize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let read = || {
            let (rest, document_chars) = text.rsplit_once(':')?;
            let (name, views) = rest.rsplit_once(':')?;
            let (views, document_chars) = (views.parse().ok()?, document_chars.parse().ok()?);
            Some(Self { name: name.to_owned(), views, document_chars })
        };
        read().ok_or_else(|| "it is written NAME:VIEWS:CHARACTERS".to_owned())
    }
}

/// Retries of a request of the probe.
const MAX_RETRIES: u32 = 2;

pub(crate) fn run(arguments: &ProbeArguments) -> anyhow::Result<ExitCode> {
    let given = arguments.base_url.as_deref().map(|url| (url, arguments.base_url_from));
    let servers = Servers::from_environment(given, Path::new("."))?;
    let servers = servers.with_headers(&arguments.requests.header, true)?;
    ensure!(servers.others.is_empty(), "one server can be checked at a time: pass --base-url URL");
    let settings = ChatSettings {
        options: arguments.requests.options(),
        request_timeout: Duration::from_secs(arguments.request_timeout.into()),
        max_retries: MAX_RETRIES,
        max_connections: arguments.together,
        server_patience: Duration::ZERO,
        ..ChatSettings::new(&*arguments.model)
    };
    let client = ChatClient::new(servers.first, settings, None);
    let template = Arc::new(arguments.requests.template()?);
    let request = |MemorySize { name, views, document_chars }: &MemorySize| {
        let largest = LargestRequest {
            frame_size: arguments.frame_size,
            image_format: arguments.image_format,
            keyframes: *views,
            window: arguments.window,
            document_chars: *document_chars,
        };
        RunRequest {
            memory: name.clone(),
            images: largest.images().min(arguments.image_budget),
            document_chars: *document_chars,
            with: Box::new({
                let template = Arc::clone(&template);
                move |budget| largest.chat_request(&template, budget)
            }),
        }
    };
    let requests: Vec<_> = arguments.memory_size.iter().map(request).collect();
    let report = probe::run(&client, arguments.together, arguments.answer_tokens, &requests);
    print(&if arguments.json { serde_json::to_string_pretty(&report)? } else { plain(&report) })?;
    Ok(ExitCode::from(u8::from(report.worst() == ProbeMark::Bad)))
}

fn plain(report: &ProbeReport) -> String {
    let mut lines = format!("{} at {}\n", report.model, report.endpoint);
    for ProbeFinding { what, mark, about } in &report.findings {
        let mark = match mark {
            ProbeMark::Ok => "ok      ",
            ProbeMark::Doubtful => "doubtful",
            ProbeMark::Bad => "NOT YET ",
        };
        lines += &format!("{mark} {what}: {about}\n");
    }
    if let Some(differences) = &report.differences {
        lines += "what a run with this server does differently from the paper:\n";
        if differences.is_empty() {
            lines += "  nothing, as far as these checks show\n";
        }
        for PaperDifference { setting, paper, here } in differences {
            lines += &format!("  {setting:20} {here} (paper: {paper})\n");
        }
    }
    lines.trim_end().to_owned()
}
