//! `policy-proc serve --policy openai`: the flags of a policy that asks a model.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use domain::{HEADER_VARIABLE, ImageFormat, ReasoningRequest, SecretHeader, SystemRole};
use llm::{
    ChatClient, ChatSettings, EndpointLimit, ReplyCache, RequestOptions, Servers, Source,
    extra_body,
};
use policy_proc::openai::{Openai, OpenaiSettings};
use prompt::{Template, TemplateError};

/// The flags of `--policy openai`.
#[derive(Args)]
#[command(next_help_heading = "With --policy openai")]
pub(crate) struct ModelArguments {
    /// The model, by the name that the server knows it by
    #[arg(long, value_name = "NAME", required_if_eq("policy", "openai"))]
    model: Option<String>,
    /// The server, up to /v1, or several of the same model, separated by commas [default: $OPENAI_BASE_URL, else
    /// $OPENAI_API_BASE, also from .env]
    #[arg(long, value_name = "URL,...")]
    base_url: Option<String>,
    /// Where the value of --base-url was given: it decides which key is sent there
    #[arg(long, value_name = "SOURCE", default_value = Source::CommandLine.word(), hide = true)]
    base_url_from: Source,
    /// Image encoding: png, or jpeg (smaller, with loss)
    #[arg(long, value_name = "FORMAT", default_value_t = ImageFormat::Png)]
    image_format: ImageFormat,
    /// Maximum number of images of a prompt; 0 for a model without vision
    #[arg(long, value_name = "N", default_value_t = prompt::IMAGE_BUDGET)]
    image_budget: u32,
    /// Maximum number of tokens of an answer
    #[arg(long, value_name = "N", default_value_t = prompt::ANSWER_TOKENS, value_parser = clap::value_parser!(u32).range(1..))]
    answer_tokens: u32,
    #[command(flatten)]
    requests: RequestArguments,
    /// Maximum number of requests in flight to one server
    #[arg(long, value_name = "N", default_value = "16", value_parser = clap::value_parser!(u32).range(1..))]
    max_connections: u32,
    /// Maximum number of requests in flight to one server from all processes together
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    endpoint_limit: Option<u32>,
    /// Where processes agree on --endpoint-limit [default: endpoint-limits in the cache folder]
    #[arg(long, value_name = "DIR")]
    endpoint_limit_folder: Option<PathBuf>,
    /// How often a request is sent again after a transient failure
    #[arg(long, value_name = "N", default_value = "5")]
    max_retries: u32,
    /// Time limit of an attempt in seconds; a server that answers slowly gets up to eight times this
    #[arg(long, value_name = "SECONDS", default_value = "120", value_parser = clap::value_parser!(u32).range(1..))]
    request_timeout: u32,
    /// How long to wait for a server that has answered before and is unreachable now; 0: only as long as the retries
    /// last
    #[arg(long, value_name = "SECONDS", default_value = "600")]
    server_patience: u32,
    /// Store replies and reuse them for the same request: on (in the cache folder), off, or a folder
    #[arg(long, value_name = "on|off|DIR", default_value = "on")]
    response_cache: String,
}

/// What all requests to a model have in common.
#[derive(Args)]
pub(crate) struct RequestArguments {
    /// What requests say about reasoning: off, minimal, low, medium, high, or nothing (model)
    #[arg(long, value_name = "LEVEL", default_value_t = ReasoningRequest::Off)]
    pub(crate) reasoning: ReasoningRequest,
    /// How the rules are sent: as system, as developer, or in the user's message (user)
    #[arg(long, value_name = "ROLE", default_value_t = SystemRole::System)]
    system_role: SystemRole,
    /// Further fields of each request, a JSON object; a field that is null is not sent
    #[arg(long, value_name = "JSON", value_parser = extra_body)]
    extra_body: Option<serde_json::Map<String, serde_json::Value>>,
    /// A further header of each request
    #[arg(long, value_name = "NAME: VALUE", env = HEADER_VARIABLE, value_delimiter = '\n', hide_env_values = true)]
    pub(crate) header: Vec<SecretHeader>,
    /// The template of the prompt, if it is not the built-in one
    #[arg(long, value_name = "FILE")]
    prompt: Option<PathBuf>,
}

impl RequestArguments {
    pub(crate) fn options(&self) -> RequestOptions {
        let Self { reasoning, system_role, extra_body, .. } = self;
        let extra_body = extra_body.clone().unwrap_or_default();
        RequestOptions { reasoning: *reasoning, system_role: *system_role, extra_body }
    }

    /// The template of the prompt.
    ///
    /// # Errors
    /// When the file is not a template.
    pub(crate) fn template(&self) -> Result<Template, TemplateError> {
        match &self.prompt {
            Some(path) => Template::read(path),
            None => Template::parse(Template::BUILT_IN_FILE),
        }
    }
}

/// The policy that asks a model.
///
/// # Errors
/// When no server or no cache folder is known.
pub(crate) fn policy(arguments: ModelArguments) -> anyhow::Result<Openai> {
    let model = arguments.model.context("--policy openai needs --model")?;
    let template = arguments.requests.template()?.into();
    let given = arguments.base_url.as_deref().map(|url| (url, arguments.base_url_from));
    let servers = Servers::from_environment(given, Path::new("."))?;
    // The program that started this one knows where the headers were given, and has checked it.
    let Servers { first, others, .. } = servers.with_headers(&arguments.requests.header, true)?;
    let limit = |most| {
        let folder = match arguments.endpoint_limit_folder {
            Some(folder) => folder,
            None => domain::cache_folder()
                .context("pass --endpoint-limit-folder")?
                .join("endpoint-limits"),
        };
        Ok::<_, anyhow::Error>(EndpointLimit { most, folder })
    };
    let endpoint_limit = arguments.endpoint_limit.map(limit).transpose()?;
    let cache = ReplyCache::from_setting(&arguments.response_cache)
        .context("pass --response-cache off, or a folder")?;
    let settings = OpenaiSettings {
        image_format: arguments.image_format,
        image_budget: arguments.image_budget,
        answer_tokens: arguments.answer_tokens,
    };
    let chat = ChatSettings {
        model,
        options: arguments.requests.options(),
        request_timeout: Duration::from_secs(arguments.request_timeout.into()),
        max_retries: arguments.max_retries,
        max_connections: arguments.max_connections,
        endpoint_limit,
        server_patience: Duration::from_secs(arguments.server_patience.into()),
    };
    Ok(Openai::new(ChatClient::balanced(first, others, chat, cache), template, settings))
}
