//! What one source of settings says; also the flags of `memtransfer run`.

use std::path::PathBuf;

use clap::{Args, CommandFactory, Parser};
use domain::Representation;
use results::conditions::{
    Demonstrations, Frames, Hint, ImageFormat, PolicyKind, Route, SegmentContent, Start, Variation,
    representation,
};
use results::cost::Amount;
use results::settings::{CaseSelector, DocumentSource, ResponseCache, SuiteName};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use super::MAX_IMAGES;

/// Heading of the flags that decide what is run.
const WHAT: &str = "What is run";
/// Heading of the flags that decide what the agent perceives.
const PERCEIVED: &str = "What the agent is given";
/// Heading of the flags about a model that is asked over the network.
const MODEL: &str = "The model (with --policy openai)";
/// Heading of the flags that change no result; of another adapter the pixels may differ a little.
const HOW: &str = "How it is run (changes no result, only --adapter may)";

/// What one source of settings says. `None`: nothing.
///
/// The doc comments are the help texts, the field names the keys of a suite file.
#[derive(Debug, Clone, Default, PartialEq, Eq, Args, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Layer {
    /// A shipped suite by name, or a suite file (TOML)
    #[arg(long, value_name = "NAME|FILE", env = "MEMTRANSFER_SUITE", help_heading = WHAT)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub suite: Option<SuiteName>,

    /// Who decides: grounded (a scripted stand-in), openai (a model behind an OpenAI-compatible endpoint),
    /// external (a program of your own), random, or expert (replays the reference)
    #[arg(long, value_name = "NAME", env = "MEMTRANSFER_POLICY", help_heading = WHAT)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy: Option<PolicyKind>,

    /// The command that starts your own policy, for example "python my_policy.py"; means --policy external
    #[arg(long, value_name = "COMMAND", env = "MEMTRANSFER_POLICY_CMD", help_heading = WHAT)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy_cmd: Option<String>,

    /// Memory representations: working, full-context, summary, semantic, hybrid, episodic
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = representation,
          env = "MEMTRANSFER_MEMORY", help_heading = WHAT)]
    #[serde(
        skip_serializing_if = "Option::is_none",
        default,
        deserialize_with = "representations"
    )]
    pub memory: Option<Vec<Representation>>,

    /// Where episodes start: original (as demonstrated), new (a pose no demonstration starts from)
    #[arg(long, value_name = "LIST", value_delimiter = ',', env = "MEMTRANSFER_STARTS",
          help_heading = WHAT)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub starts: Option<Vec<Start>>,

    /// Routes: unchanged, blocked (a demonstrated passage is closed; new starts only)
    #[arg(long, value_name = "LIST", value_delimiter = ',', env = "MEMTRANSFER_ROUTES",
          help_heading = WHAT)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub routes: Option<Vec<Route>>,

    /// Sets of demonstrations to remember: original, opposite, nearby, distant, several joined by +,
    /// or 4 for all; irrelevant or confusable for original, opposite and two of other tasks. Each entry
    /// of the list is a condition of its own
    #[arg(long, value_name = "LIST", value_delimiter = ',', env = "MEMTRANSFER_DEMOS",
          help_heading = WHAT)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub demos: Option<Vec<Demonstrations>>,

    /// Cases by id (t03-07), task (t03), number (37) or range (1-10, t03-01..t04-10); `all`
    #[arg(long, value_name = "LIST", value_delimiter = ',', env = "MEMTRANSFER_CASES",
          help_heading = WHAT)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cases: Option<Vec<CaseSelector>>,

    /// At most N of the selected cases, spread evenly over them
    #[arg(long, value_name = "N", env = "MEMTRANSFER_LIMIT", help_heading = WHAT)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<u32>,

    /// Repetitions of everything, each with seeds of its own
    #[arg(long, value_name = "N", env = "MEMTRANSFER_RUNS", help_heading = WHAT)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub runs: Option<u32>,

    /// The number that every episode's seed is derived from
    #[arg(long, value_name = "N", env = "MEMTRANSFER_SEED", help_heading = WHAT)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,

    /// Steps after which an episode ends, T_max
    #[arg(long, value_name = "N", env = "MEMTRANSFER_MAX_STEPS", help_heading = WHAT)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_steps: Option<u32>,

    /// Past steps that a policy is shown, h. Each entry of the list is a condition of its own
    #[arg(long, value_name = "LIST", value_delimiter = ',', env = "MEMTRANSFER_WINDOW",
          help_heading = PERCEIVED)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub window: Option<Vec<u32>>,

    /// Expert actions that a retrieved segment follows, H_epi
    #[arg(long, value_name = "N", env = "MEMTRANSFER_HORIZON", help_heading = PERCEIVED)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub horizon: Option<u32>,

    /// What a retrieved segment holds: actions (with the views they led to), or images alone
    #[arg(long, value_name = "LIST", value_delimiter = ',', env = "MEMTRANSFER_SEGMENT",
          help_heading = PERCEIVED)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub segment: Option<Vec<SegmentContent>>,

    /// Keyframes of full-context memory, shared by a case's demonstrations
    #[arg(long, value_name = "N", env = "MEMTRANSFER_KEYFRAMES", help_heading = PERCEIVED)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub keyframes: Option<u32>,

    /// Whether the prompt says that the demonstration starts where the agent does, where that is so:
    /// on, off
    #[arg(long, value_name = "LIST", value_delimiter = ',', env = "MEMTRANSFER_HINT",
          help_heading = PERCEIVED)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hint: Option<Vec<Hint>>,

    /// The documents of summary, semantic and hybrid memory: those of the builder extractive or
    /// model, or those in the folder DIR
    #[arg(long, value_name = "BUILDER|DIR", env = "MEMTRANSFER_DOCUMENTS",
          help_heading = PERCEIVED)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub documents: Option<DocumentSource>,

    /// Width and height of a frame, a multiple of 64
    #[arg(long, value_name = "PIXELS", env = "MEMTRANSFER_FRAME_SIZE", help_heading = PERCEIVED)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_size: Option<u32>,

    /// What observed frames show: rendered, or as a control blank (grey) or swapped (another pose)
    #[arg(long, value_name = "KIND", env = "MEMTRANSFER_FRAMES", help_heading = PERCEIVED)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<Frames>,

    /// The model that embeds frames, by its name in models.toml
    #[arg(long, value_name = "NAME", env = "MEMTRANSFER_ENCODER", help_heading = PERCEIVED)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder: Option<String>,

    /// The encoder's ONNX file, for a model that set-up does not fetch
    #[arg(long, value_name = "FILE", env = "MEMTRANSFER_ENCODER_FILE", help_heading = PERCEIVED)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder_file: Option<PathBuf>,

    /// The model, by the name that the server knows it by
    #[arg(long, value_name = "NAME", env = "MEMTRANSFER_MODEL", help_heading = MODEL)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,

    /// Where the server is, up to /v1 [default: $OPENAI_BASE_URL, else $OPENAI_API_BASE]. The key, where one
    /// is needed, is $OPENAI_API_KEY; all three may stand in a file .env
    #[arg(long, value_name = "URL", env = "MEMTRANSFER_BASE_URL", help_heading = MODEL)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_url: Option<String>,

    /// How views are sent: png (without loss) or jpeg
    #[arg(long, value_name = "FORMAT", env = "MEMTRANSFER_IMAGE_FORMAT", help_heading = MODEL)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image_format: Option<ImageFormat>,

    /// Most images in a request; what is more is left out, said in the prompt and counted. 0 for a model
    /// that takes text alone
    #[arg(long, value_name = "N", env = "MEMTRANSFER_IMAGE_BUDGET", help_heading = MODEL)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image_budget: Option<u32>,

    /// Most tokens of an answer
    #[arg(long, value_name = "N", env = "MEMTRANSFER_ANSWER_TOKENS", help_heading = MODEL)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub answer_tokens: Option<u32>,

    /// Most requests under way at once; fewer while the server says that it is too much
    #[arg(long, value_name = "N", env = "MEMTRANSFER_MAX_CONNECTIONS", help_heading = MODEL)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_connections: Option<u32>,

    /// How often a request is sent again that met status 429 or 5xx, no answer in time or no connection
    #[arg(long, value_name = "N", env = "MEMTRANSFER_MAX_RETRIES", help_heading = MODEL)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_retries: Option<u32>,

    /// Seconds that one attempt may take
    #[arg(long, value_name = "SECONDS", env = "MEMTRANSFER_REQUEST_TIMEOUT", help_heading = MODEL)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub request_timeout: Option<u32>,

    /// Whether answers are kept and a request that was answered before is not sent again: on, off, or the
    /// folder to keep them in
    #[arg(long, value_name = "on|off|DIR", env = "MEMTRANSFER_RESPONSE_CACHE", help_heading = MODEL)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub response_cache: Option<ResponseCache>,

    /// What tokens cost, by model (TOML; see docs/costs.md)
    #[arg(long, value_name = "FILE", env = "MEMTRANSFER_PRICES", help_heading = MODEL)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prices: Option<PathBuf>,

    /// Stop when the run has used N tokens, earlier sessions included; the same command with more goes on
    #[arg(long, value_name = "N", env = "MEMTRANSFER_MAX_TOKENS_TOTAL", help_heading = MODEL)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_tokens_total: Option<u64>,

    /// Stop when the run has cost this much, in the currency of --prices, earlier sessions included
    #[arg(long, value_name = "AMOUNT", env = "MEMTRANSFER_MAX_COST", help_heading = MODEL)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_cost: Option<Amount>,

    /// Use the layout, catalogue, cases, suites and model manifest in DIR, not the built-in ones
    #[arg(long, value_name = "DIR", env = "MEMTRANSFER_ASSETS", help_heading = WHAT)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub assets: Option<PathBuf>,

    /// The run's folder; the same command again resumes what is in it
    #[arg(long, value_name = "DIR", env = "MEMTRANSFER_OUT", help_heading = HOW)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub out: Option<PathBuf>,

    /// Keep what the policy was given and what it answered, step by step, in the run's folder, for
    /// `memtransfer show`
    #[arg(long, env = "MEMTRANSFER_LOG_PROMPTS", help_heading = HOW)]
    #[serde(skip_serializing_if = "std::ops::Not::not", default)]
    pub log_prompts: bool,

    /// Episodes that run at once
    #[arg(long, value_name = "N", env = "MEMTRANSFER_LANES", help_heading = HOW)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lanes: Option<u32>,

    /// Frames embedded at the same time [default: the processor's cores]
    #[arg(long, value_name = "N", env = "MEMTRANSFER_ENCODER_THREADS", help_heading = HOW)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder_threads: Option<u32>,

    /// Frames that may be resident in shared memory; as many as are useful and fit (in at most half of the
    /// memory that is free), unless given
    #[arg(long, value_name = "FRAMES", env = "MEMTRANSFER_FRAME_BUDGET", help_heading = HOW)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_budget: Option<u32>,

    /// Draw on the first Vulkan adapter whose name contains this, or on the "processor", whose pixels are the
    /// same on every machine; on a graphics card, or the processor where there is none, unless given
    #[arg(long, value_name = "NAME", env = "MEMTRANSFER_ADAPTER", help_heading = HOW)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adapter: Option<String>,

    /// Draw every view of the unchanged warehouse before the first step, so that hardly any is drawn in
    /// the run; for measuring
    #[arg(long, env = "MEMTRANSFER_WARM_VIEWS", help_heading = HOW)]
    #[serde(skip_serializing_if = "std::ops::Not::not", default)]
    pub warm_views: bool,

    /// Microseconds that a process looks for work before it sleeps; 0 unless cores are free
    #[arg(long, value_name = "MICROSECONDS", env = "MEMTRANSFER_SPIN_US", help_heading = HOW)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spin_us: Option<u32>,

    /// Seconds after which an answer is overdue, and the process that owes it counts as hung
    #[arg(long, value_name = "SECONDS", env = "MEMTRANSFER_STEP_TIMEOUT", help_heading = HOW)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step_timeout: Option<u32>,

    /// Seconds that processes have to get ready
    #[arg(long, value_name = "SECONDS", env = "MEMTRANSFER_START_TIMEOUT", help_heading = HOW)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_timeout: Option<u32>,

    /// In a suite's `[[group]]`: what it is called.
    #[arg(skip)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,

    /// A suite's groups: layers that say a name and [`GROUP_KEYS`](super::GROUP_KEYS) only.
    #[arg(skip)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub group: Option<Vec<Layer>>,
}

/// Reads names of representations, so that an unknown one is answered with the nearest.
fn representations<'de, D>(deserializer: D) -> Result<Option<Vec<Representation>>, D::Error>
where
    D: Deserializer<'de>,
{
    let words = Vec::<String>::deserialize(deserializer)?;
    let members: Result<_, _> = words.iter().map(|word| representation(word)).collect();
    members.map(Some).map_err(D::Error::custom)
}

impl Layer {
    /// What holds when nobody says anything. A suite normally says most of it.
    pub fn defaults() -> Self {
        Self {
            suite: Some(SuiteName::quick()),
            policy: Some(PolicyKind::Grounded),
            policy_cmd: None,
            memory: Some(Representation::ALL.to_vec()),
            starts: Some(Start::ALL.to_vec()),
            routes: Some(vec![Route::Unchanged]),
            demos: Some(vec![Demonstrations::ORIGINAL]),
            cases: Some(vec![CaseSelector::All]),
            limit: None,
            runs: Some(1),
            seed: Some(1),
            max_steps: Some(warehouse::MAX_STEPS),
            window: Some(vec![Variation::STANDARD.window]),
            horizon: Some(6),
            segment: Some(vec![Variation::STANDARD.segment]),
            keyframes: Some(40),
            hint: Some(vec![Variation::STANDARD.hint]),
            documents: Some(DocumentSource::Extractive),
            frame_size: Some(448),
            frames: Some(Frames::Rendered),
            encoder: Some("dinov2-s14".to_owned()),
            encoder_file: None,
            model: None,
            base_url: None,
            image_format: Some(ImageFormat::Png),
            image_budget: Some(MAX_IMAGES),
            answer_tokens: Some(30),
            max_connections: Some(16),
            max_retries: Some(5),
            request_timeout: Some(120),
            response_cache: Some(ResponseCache::On),
            prices: None,
            max_tokens_total: None,
            max_cost: None,
            assets: None,
            log_prompts: false,
            // Follows from suite and policy.
            out: None,
            lanes: Some(16),
            encoder_threads: None,
            frame_budget: None,
            adapter: None,
            warm_views: false,
            spin_us: Some(0),
            step_timeout: Some(120),
            start_timeout: Some(300),
            name: None,
            group: None,
        }
    }

    /// Every key but `group` and what is in groups alone, as suite files and `--show-settings` spell it.
    pub fn keys() -> Vec<String> {
        #[derive(Parser)]
        struct Flags {
            #[command(flatten)]
            _layer: Layer,
        }
        let command = Flags::command();
        command.get_arguments().filter_map(|arg| arg.get_long()).map(str::to_owned).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_and_keys_of_files_are_the_same_words() {
        for key in Layer::keys() {
            let Err(error) = toml::from_str::<Layer>(&format!("{key} = {{}}")) else {
                panic!("`{key}` takes a table");
            };
            assert!(!error.message().contains("unknown field"), "{key}: {error}");
        }
    }
}
