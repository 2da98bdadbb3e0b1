//! `policy-proc probe`: what a model's server can do. `memtransfer doctor --policy openai` starts it.

use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use clap::Args;
use policy_proc::chat::probe::{self, Finding, Mark, Report};
use policy_proc::chat::{Client, Endpoint, Settings};

use super::print;

#[derive(Args)]
#[command(after_help = "\
Sends some thirty short requests. The key comes from $OPENAI_API_KEY or .env, and is never printed.
Exit status 0 when a run makes sense, 1 when something stands against it, 2 when nothing could be asked.")]
pub(crate) struct ProbeArguments {
    /// Where the server is, up to /v1 [default: $OPENAI_BASE_URL, else $OPENAI_API_BASE]
    #[arg(long, value_name = "URL")]
    base_url: Option<String>,
    /// The model, by the name that the server knows it by
    #[arg(long, value_name = "NAME")]
    model: String,
    /// Longest that one request may take, in seconds
    #[arg(long, value_name = "SECONDS", default_value = "60", value_parser = clap::value_parser!(u32).range(1..))]
    timeout: u32,
    /// How many requests are sent at once where several are
    #[arg(long, value_name = "N", default_value = "8", value_parser = clap::value_parser!(u32).range(1..=1000))]
    together: u32,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// How often a request is sent again that failed for a passing reason.
const MAX_RETRIES: u32 = 2;

pub(crate) fn run(arguments: &ProbeArguments) -> anyhow::Result<ExitCode> {
    let ProbeArguments { base_url, model, timeout, together, json } = arguments;
    let endpoint = Endpoint::from_environment(base_url.as_deref(), Path::new("."))?;
    let timeout = Duration::from_secs((*timeout).into());
    let settings = Settings { model: model.clone(), timeout, max_retries: MAX_RETRIES };
    let report = probe::run(&Client::new(endpoint, settings), *together);
    print(&if *json { serde_json::to_string_pretty(&report)? } else { plain(&report)? })?;
    Ok(ExitCode::from(u8::from(report.worst() == Mark::Bad)))
}

fn plain(report: &Report) -> anyhow::Result<String> {
    let mut lines = format!("{} at {}\n", report.model, report.endpoint);
    for Finding { what, mark, about } in &report.findings {
        let mark = match mark {
            Mark::Ok => "ok      ",
            Mark::Doubtful => "doubtful",
            Mark::Bad => "NOT YET ",
        };
        lines += &format!("{mark} {what}: {about}\n");
    }
    let fingerprint = serde_json::to_string(&report.fingerprint)?;
    Ok(lines + "fingerprint: " + &fingerprint)
}
