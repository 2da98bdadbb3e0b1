//! `policy-proc serve --policy openai`: the flags of a policy that asks a model.

use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use policy_proc::chat::{Client, Endpoint, Pool, PoolSettings, ResponseCache, Settings};
use policy_proc::openai::{self, ImageFormat, Openai};

/// How `--policy openai` asks its model.
#[derive(Args)]
#[command(next_help_heading = "With --policy openai")]
pub(crate) struct ModelArguments {
    /// The model, by the name that the server knows it by
    #[arg(long, value_name = "NAME", required_if_eq("policy", "openai"))]
    model: Option<String>,
    /// Where the server is, up to /v1 [default: $OPENAI_BASE_URL, else $OPENAI_API_BASE, also from .env]
    #[arg(long, value_name = "URL")]
    base_url: Option<String>,
    /// How images are sent: png, or jpeg (smaller, with loss)
    #[arg(long, value_name = "FORMAT", default_value_t = ImageFormat::Png)]
    image_format: ImageFormat,
    /// Most images of a prompt; 0 for a model that reads text alone
    #[arg(long, value_name = "N", default_value = "50")]
    image_budget: u32,
    /// Most tokens of an answer
    #[arg(long, value_name = "N", default_value = "30", value_parser = clap::value_parser!(u32).range(1..))]
    answer_tokens: u32,
    /// Most requests in flight
    #[arg(long, value_name = "N", default_value = "16", value_parser = clap::value_parser!(u32).range(1..))]
    max_connections: u32,
    /// How often a request is sent again that failed for a reason that may pass
    #[arg(long, value_name = "N", default_value = "5")]
    max_retries: u32,
    /// Longest that one attempt may take, in seconds
    #[arg(long, value_name = "SECONDS", default_value = "120", value_parser = clap::value_parser!(u32).range(1..))]
    request_timeout: u32,
    /// Where replies are kept, so that the same request need not be sent twice: on (the cache folder), off, or
    /// a folder
    #[arg(long, value_name = "on|off|DIR", default_value = "on")]
    response_cache: String,
}

/// The policy that asks a model.
///
/// # Errors
/// When no server or no place for replies is known.
pub(crate) fn policy(arguments: ModelArguments) -> anyhow::Result<Openai> {
    let ModelArguments {
        model,
        base_url,
        image_format,
        image_budget,
        answer_tokens,
        max_connections,
        max_retries,
        request_timeout,
        response_cache,
    } = arguments;
    let model = model.context("--policy openai needs --model")?;
    let endpoint = Endpoint::from_environment(base_url.as_deref(), Path::new("."))?;
    let settings = openai::Settings {
        model: model.clone(),
        endpoint: endpoint.to_string(),
        image_format,
        image_budget,
        answer_tokens,
    };
    let cache = ResponseCache::from_setting(&response_cache)
        .context("say --response-cache off, or a folder")?;
    let timeout = Duration::from_secs(request_timeout.into());
    let client = Client::new(endpoint, Settings { model, timeout, max_retries });
    let pool_settings = PoolSettings { max_connections, ..PoolSettings::default() };
    Ok(Openai::new(Pool::new(client, pool_settings, cache), settings))
}
