//! The settings of a run: one table that is at the same time the flags of `memtransfer run`, the
//! `MEMTRANSFER_*` variables and the keys of a suite file.

use std::fmt;
use std::str::FromStr;

use domain::memory_kind::{EXTERNAL_WORD, NONE_WORD};
use domain::names::UnknownName;
use domain::{Arm, FeedbackLevel, StreamOrder};
use results::conditions::{
    Demonstrations, Frames, Hint, ImageFormat, PolicyKind, Route, SegmentContent, Start,
    representation,
};
use results::settings::{CaseSelector, DocumentSource, Drawn, ResponseCache};
use serde_json::Value;
use shm_types::attach::MAX_FRAMES;
use shm_types::message::{MAX_ITEMS, MAX_SEGMENT, MAX_WINDOW};

/// Maximum number of images in a prompt (paper, Experimental Setup).
pub const MAX_IMAGES: u32 = 50;

/// One setting.
#[derive(Debug)]
pub struct Key {
    /// Its name: the flag without `--`, and the key in a suite file.
    pub name: &'static str,
    /// What stands for its value in the help; empty for a switch.
    pub value_name: &'static str,
    /// The heading that the help lists it under.
    pub heading: &'static str,
    /// One paragraph of help.
    pub help: &'static str,
    kind: ValueKind,
}

/// The form of a setting's value.
#[derive(Debug, Clone, Copy)]
enum ValueKind {
    /// On or off.
    Switch,
    /// A whole number within bounds, a multiple of the third.
    Number(u64, u64, u64),
    /// A list of whole numbers within bounds.
    Numbers(u64, u64),
    /// An amount of money.
    Money,
    /// A text that the function accepts.
    Text(KeyCheck),
    /// A list of texts that the function accepts.
    List(KeyCheck),
    /// A list of texts that the function accepts and that may hold commas: a flag gives one of them and can be repeated,
    /// a variable has one a line.
    Repeated(KeyCheck),
}

type KeyCheck = fn(&str) -> Result<(), String>;

/// Accepts what parses as `T`.
fn parses<T: FromStr<Err: fmt::Display>>(text: &str) -> Result<(), String> {
    text.parse::<T>().map(drop).map_err(|error| error.to_string())
}

/// Accepts a built-in memory, the word for an external one that the user starts, and the one for no built-in memory.
fn is_memory(text: &str) -> Result<(), String> {
    if [EXTERNAL_WORD, NONE_WORD].contains(&text) {
        return Ok(());
    }
    representation(text).map(drop).map_err(|error| error.to_string())
}

/// Accepts one of the words `known`.
fn is_one_of<const N: usize>(
    what: &'static str,
    text: &str,
    known: [&str; N],
) -> Result<(), String> {
    if known.contains(&text) {
        Ok(())
    } else {
        Err(UnknownName::new(what, text, known).to_string())
    }
}

fn is_arm(text: &str) -> Result<(), String> {
    is_one_of("arm", text, Arm::ALL.map(Arm::word))
}

fn is_order(text: &str) -> Result<(), String> {
    is_one_of("order", text, StreamOrder::ALL.map(StreamOrder::word))
}

fn is_feedback(text: &str) -> Result<(), String> {
    is_one_of("feedback", text, FeedbackLevel::ALL.map(FeedbackLevel::word))
}

/// Accepts any text but an empty one.
fn any(text: &str) -> Result<(), String> {
    if text.is_empty() { Err("the value is empty".to_owned()) } else { Ok(()) }
}

fn is_command(text: &str) -> Result<(), String> {
    match shlex::split(text) {
        Some(words) if !words.is_empty() => Ok(()),
        _ => Err(format!("`{text}` is not a program and its arguments, with every quote closed")),
    }
}

fn is_backend(text: &str) -> Result<(), String> {
    is_one_of("backend", text, ["wgpu", "cpu"])
}

fn is_provider(text: &str) -> Result<(), String> {
    is_one_of("execution provider", text, ["cpu", "openvino", "cuda", "tensorrt"])
}

/// Keys that replace one of a suite's `[stream]` table, and are no keys of a suite file elsewhere.
pub(super) const STREAM_KEYS: &[&str] = &["streams", "rounds", "orders", "feedback"];

const WHAT: &str = "What is run";
const GIVEN: &str = "What the agent is given";
const MODEL: &str = "The model (with --policy openai)";
const HOW: &str = "How it is run";

/// Writes the table: one line of names and form, one of help.
macro_rules! keys {
    ($($heading:ident: $($name:literal $value_name:tt $kind:expr, $help:literal;)*)*) => {
        &[$($(Key {
            name: $name,
            value_name: $value_name,
            heading: $heading,
            help: $help,
            kind: $kind,
        }),*),*]
    };
}

use ValueKind::{List, Money, Number, Numbers, Repeated, Switch, Text};

const SECONDS: ValueKind = Number(1, 86_400, 1);

/// Every setting, in the order of the help.
pub const KEYS: &[Key] = keys! {
    WHAT:
    "suite" "NAME|FILE" Text(any),
        "A shipped suite by name, or a suite file (TOML)";
    "policy" "NAME" Text(parses::<PolicyKind>),
        "What decides: grounded (scripted, needs no model), openai (a model behind an \
         OpenAI-compatible endpoint), external (your own program), random, or expert (replays the \
         reference)";
    "policy-cmd" COMMAND Text(is_command),
        "The command that starts your own policy, for example \"python my_policy.py\"; implies \
         --policy external";
    "memory" "LIST" List(is_memory),
        "Memories: working, full-context, summary, semantic, hybrid, episodic, adaptive; external \
         for one of your own that you start yourself (the run prints how); none for external ones only";
    "memory-cmd" COMMAND Repeated(is_command),
        "The command that starts a memory of your own, for example \"python my_memory.py\"; it runs \
         beside those of --memory, under the name it reports. Can be given up to 8 times";
    "starts" "LIST" List(parses::<Start>),
        "Starting poses: original (as demonstrated), new (no demonstration starts there)";
    "routes" "LIST" List(parses::<Route>),
        "Routes: unchanged, blocked (a passage of the demonstrations is closed; new starts only)";
    "demos" "LIST" List(parses::<Demonstrations>),
        "Demonstrations in memory: original, opposite, nearby, distant, several joined by +, or 4 \
         for all; irrelevant or confusable for original, opposite and two of other tasks; after for one \
         by an expert who knows the closed passage, before-after or after-before for original and that one; \
         bank-N for N of all cases, the case's original among them; elsewhere for one of the same task in another \
         warehouse. Each entry of the list is a condition of its own";
    "cases" "LIST" List(parses::<CaseSelector>),
        "Cases by id (t03-07), task (t03), number (37) or range (1-10, t03-01..t04-10); `all`";
    "limit" "N" Number(0, 1_000_000, 1),
        "Run N of the selected cases, balanced over the tasks. A larger N includes the cases of a \
         smaller one";
    "arms" "LIST" List(is_arm),
        "What the memories of a suite of streams are built from: frozen (as demonstrated), learning (and it learns), \
         oracle (demonstrations in the world as it is), wrong (of other tasks)";
    "streams" "N" Number(1, 1000, 1),
        "Number of streams of a suite of streams (see `memtransfer ls streams`)";
    "rounds" "N" Number(0, 1000, 1),
        "How often a memory learns from the cases of a block, in a suite of streams";
    "orders" "LIST" List(is_order),
        "Orders of the blocks of a suite of streams: drawn, reversed, shuffled";
    "feedback" "LEVEL" Text(is_feedback),
        "What a memory that learns is told at the end of an episode: none, success, sub-goals";
    "runs" "N" Number(1, 1000, 1),
        "Repetitions of every episode, each with its own seed";
    "seed" "N" Number(0, u64::MAX, 1),
        "The number that every episode's seed is derived from";
    "max-steps" "N" Number(1, 10_000, 1),
        "Steps after which an episode ends, T_max";
    "assets" "DIR" Text(any),
        "Use the layout, catalogue, cases, suites and model manifest in DIR, not the built-in ones";
    "elsewhere" "DIR" Text(any),
        "The warehouse of --demos elsewhere: its layout and catalogue [default: drawn from --seed, of the same size]";

    GIVEN:
    "window" "LIST" Numbers(0, MAX_WINDOW as u64),
        "Past steps shown to the policy, h. Each entry of the list is a condition of its own";
    "horizon" "N" Number(0, MAX_SEGMENT as u64 - 1, 1),
        "Expert actions that a retrieved segment covers, H_epi";
    "hits" "N" Number(1, MAX_ITEMS as u64, 1),
        "Segments that episodic memory supplies at a step, the nearest first, k";
    "segment" "LIST" List(parses::<SegmentContent>),
        "Content of a retrieved segment: actions (with the views they led to), or images only";
    "keyframes" "N" Number(1, MAX_IMAGES as u64, 1),
        "Keyframes of full-context memory, shared by the demonstrations of a case";
    "memory-images" "N" Number(0, 1000, 1),
        "Maximum number of images that a memory supplies at a step; an item that does not fit is left out and \
         counted [default: as many as any built-in memory supplies]";
    "memory-text-bytes" "N" Number(0, 16_000_000, 1),
        "Maximum number of bytes of text that a memory supplies at a step; an item that does not fit is left out \
         and counted";
    "hint" "LIST" List(parses::<Hint>),
        "Whether the prompt says that the demonstration has the same starting pose, where it has: \
         on, off";
    "documents" "BUILDER|DIR" Text(parses::<DocumentSource>),
        "Documents of summary, semantic and hybrid memory: from the builder extractive or model, or \
         from the folder DIR";
    "frame-size" "PIXELS" Number(64, 4096, 64),
        "Width and height of a frame, a multiple of 64";
    "frames" "KIND" Text(parses::<Frames>),
        "What frames show: rendered, or as a control blank (grey) or swapped (another pose), which leave what \
         memory supplies as it is, or blank-all (grey, also in memory's views; memory supplies no texts)";
    "plates" "on|off" Text(parses::<Drawn>),
        "Whether a coloured plate hangs above every item; grounded and the builders of documents read \
         nothing else";
    "labels" "on|off" Text(parses::<Drawn>),
        "Whether anything is written in the warehouse: names of items, numbers of bays, signs";
    "appearance-seed" "N" Number(0, u64::MAX, 1),
        "Vary the light and the tints of walls, floor and racks; 0 is the standard look";
    "encoder" "NAME" Text(any),
        "The model that embeds frames, by its name in models.toml";
    "encoder-file" "FILE" Text(any),
        "The encoder's ONNX file, for a model that `cargo xtask setup` does not fetch";

    MODEL:
    "model" "NAME" Text(any),
        "The model, by the name that the server knows";
    "base-url" "URL,..." Text(any),
        "The server, up to /v1 [default: $OPENAI_BASE_URL, else $OPENAI_API_BASE]. Several servers of \
         the same model, separated by commas, share the requests. The key is $OPENAI_API_KEY; a file \
         .env may hold all three";
    "image-format" "FORMAT" Text(parses::<ImageFormat>),
        "Encoding of images in requests: png (lossless) or jpeg";
    "image-budget" "N" Number(0, 1000, 1),
        "Maximum number of images in a request; the prompt says how many were left out. 0 for a model that \
         reads text only";
    "answer-tokens" "N" Number(1, 100_000, 1),
        "Maximum number of tokens in an answer";
    "max-connections" "N" Number(1, 1024, 1),
        "Maximum number of requests in flight to one server; fewer while it is overloaded or slow";
    "endpoint-limit" "N" Number(1, 1024, 1),
        "Maximum number of requests in flight to one server from all runs together that have this flag";
    "endpoint-limit-folder" "DIR" Text(any),
        "Where runs agree on --endpoint-limit; machines that share the folder share the limit \
         [default: endpoint-limits in the cache folder]";
    "max-retries" "N" Number(0, 100, 1),
        "How often a request is repeated after status 429 or 5xx, a timeout or a failed connection";
    "request-timeout" "SECONDS" SECONDS,
        "Time limit of one attempt";
    "server-patience" "SECONDS" Number(0, 86_400, 1),
        "How long a run waits for a server that answered before and is unreachable; 0 does not wait";
    "stop-without-action" "N" Number(0, 1_000_000, 1),
        "Stop if none of the first N answers of at least three episodes has an action; 0 never stops";
    "response-cache" "on|off|DIR" Text(parses::<ResponseCache>),
        "Cache replies, so that no request is sent twice: on, off, or the folder of the cache";
    "prices" "FILE" Text(any),
        "Prices of tokens, by model (TOML; see docs/costs.md)";
    "max-tokens-total" "N" Number(0, u64::MAX, 1),
        "Stop when the run has used N tokens, earlier sessions included";
    "max-cost" "AMOUNT" Money,
        "Stop when the run has cost AMOUNT in the currency of --prices, earlier sessions included";

    HOW:
    "out" "DIR" Text(any),
        "The run's folder; the same command again resumes the run in it";
    "log-prompts" "" Switch,
        "Log every prompt, its images and the answer in the run's folder, for `memtransfer show`";
    "lanes" "N" Number(1, 1024, 1),
        "Episodes that run at the same time";
    "encoder-threads" "N" Number(1, 1024, 1),
        "Frames embedded at the same time [default: number of cores]";
    "provider" "NAME" Text(is_provider),
        "ONNX Runtime's execution provider for the encoder: cpu, openvino, cuda, tensorrt \
         [default: cpu]";
    "frame-budget" "FRAMES" Number(1, MAX_FRAMES as u64, 1),
        "Frames kept in shared memory [default: as many as are useful and fit into half of the \
         free memory]";
    "backend" "NAME" Text(is_backend),
        "Render with wgpu (a graphics device) or on the cpu, whose pixels are the same on every \
         machine [default: wgpu where there is a graphics card]";
    "adapter" "NAME" Text(any),
        "Render with the best Vulkan adapter whose name contains NAME";
    "warm-views" "" Switch,
        "Render every view of the unchanged warehouse before the first step; for measurements";
    "spin-us" "MICROSECONDS" Number(0, 1_000_000, 1),
        "How long a process polls for messages before it sleeps; useful where cores are idle";
    "step-timeout" "SECONDS" SECONDS,
        "Time limit of an answer; a process that exceeds it is restarted";
    "memory-timeout" "SECONDS" SECONDS,
        "Time limit of an answer of an external memory; an episode that it leaves unanswered ends \
         without a result";
    "start-timeout" "SECONDS" SECONDS,
        "Time limit for the processes to get ready";
};

/// What stands for a command in the help.
const COMMAND: &str = "COMMAND";

/// Names of the keys that concern a model: for `--policy openai` only.
pub(super) fn model_keys() -> impl Iterator<Item = &'static str> {
    KEYS.iter().filter(|key| key.heading == MODEL).map(|key| key.name)
}

/// The defaults of keys that no source sets. A suite sets most of them.
pub(super) const DEFAULTS: &str = r#"
suite = "quick"
policy = "grounded"
memory = ["working", "full-context", "summary", "semantic", "hybrid", "episodic"]
starts = ["original", "new"]
routes = ["unchanged"]
demos = ["original"]
cases = ["all"]
runs = 1
seed = 1
max-steps = 200
window = [6]
horizon = 6
hits = 1
segment = ["actions"]
keyframes = 40
memory-text-bytes = 1048576
hint = ["on"]
arms = ["frozen"]
documents = "extractive"
frame-size = 448
frames = "rendered"
plates = "on"
labels = "on"
appearance-seed = 0
encoder = "dinov2-s14"
image-format = "png"
image-budget = 50
answer-tokens = 30
max-connections = 16
max-retries = 5
request-timeout = 120
server-patience = 600
stop-without-action = 100
response-cache = "on"
lanes = 16
spin-us = 0
step-timeout = 120
memory-timeout = 30
start-timeout = 300
"#;

impl Key {
    /// The setting called `name`.
    pub fn find(name: &str) -> Option<&'static Self> {
        KEYS.iter().find(|key| key.name == name)
    }

    /// The help, with the default if there is one.
    pub fn help_text(&self) -> String {
        let prefix = format!("{} = ", self.name);
        let default = DEFAULTS.lines().find_map(|line| line.strip_prefix(&prefix));
        match default {
            Some(default) => {
                let plain = |c: char| !"[]\" ".contains(c);
                let default: String = default.chars().filter(|c| plain(*c)).collect();
                format!("{} [default: {default}]", self.help)
            }
            None => self.help.to_owned(),
        }
    }

    /// Whether its value is a command, which a run starts.
    pub fn is_command(&self) -> bool {
        self.value_name == COMMAND
    }

    /// Whether the flag can be repeated, each time with one more value.
    pub const fn is_repeated(&self) -> bool {
        matches!(self.kind, ValueKind::Repeated(_))
    }

    /// Whether the flag takes no value.
    pub const fn is_switch(&self) -> bool {
        matches!(self.kind, ValueKind::Switch)
    }

    /// The environment variable.
    pub fn variable(&self) -> String {
        format!("{VARIABLE_PREFIX}{}", self.name.replace('-', "_").to_uppercase())
    }

    /// The value that `text` stands for, on the command line or in a variable.
    ///
    /// # Errors
    /// When it stands for none.
    pub(super) fn read(&self, text: &str) -> Result<Value, String> {
        let invalid = || self.kind.rejects(text);
        let number = |text: &str| text.trim().parse::<u64>().map(Value::from);
        let entries = || text.split(',').map(str::trim);
        let value = match self.kind {
            ValueKind::Switch => match text {
                "1" | "true" | "yes" | "on" => true.into(),
                "0" | "false" | "no" | "off" => false.into(),
                _ => return Err(invalid()),
            },
            ValueKind::Number(..) => number(text).map_err(|_| invalid())?,
            ValueKind::Numbers(..) => {
                let numbers: Result<Vec<Value>, _> = entries().map(number).collect();
                numbers.map_err(|_| invalid())?.into()
            }
            ValueKind::Money => text.trim().parse::<f64>().map_err(|_| invalid())?.into(),
            ValueKind::Text(_) => text.into(),
            ValueKind::List(_) => entries().collect::<Vec<_>>().into(),
            ValueKind::Repeated(_) => {
                text.lines().filter(|line| !line.trim().is_empty()).collect::<Vec<_>>().into()
            }
        };
        self.check(&value)?;
        Ok(value)
    }

    /// Whether the setting can have this value.
    ///
    /// # Errors
    /// When it cannot.
    pub(super) fn check(&self, value: &Value) -> Result<(), String> {
        let shown = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        let invalid = || self.kind.rejects(&shown(value));
        let within = |value: &Value, least, most, step| {
            let number = value.as_u64().filter(|n| (least..=most).contains(n) && n % step == 0);
            let expected = ValueKind::Number(least, most, step);
            number.map(drop).ok_or_else(|| expected.rejects(&shown(value)))
        };
        let list = || value.as_array().filter(|list| !list.is_empty()).ok_or_else(invalid);
        match self.kind {
            ValueKind::Switch => value.as_bool().map(drop).ok_or_else(invalid),
            ValueKind::Number(least, most, step) => within(value, least, most, step),
            ValueKind::Numbers(least, most) => {
                list()?.iter().try_for_each(|number| within(number, least, most, 1))
            }
            ValueKind::Money => {
                let amount =
                    value.as_f64().and_then(|amount| results::cost::Money::try_from(amount).ok());
                amount.map(drop).ok_or_else(invalid)
            }
            ValueKind::Text(check) => check(value.as_str().ok_or_else(invalid)?),
            ValueKind::List(check) | ValueKind::Repeated(check) => {
                list()?.iter().try_for_each(|entry| check(entry.as_str().ok_or_else(invalid)?))
            }
        }
    }
}

impl ValueKind {
    /// The message about a value that is not of this form.
    fn rejects(self, given: &str) -> String {
        let expected = match self {
            Self::Switch => "true or false".to_owned(),
            Self::Number(least, u64::MAX, _) => format!("a whole number from {least}"),
            Self::Number(least, most, 1) => format!("a whole number from {least} to {most}"),
            Self::Number(least, most, step) => {
                format!("a multiple of {step} from {least} to {most}")
            }
            Self::Numbers(least, most) => format!("a list of whole numbers from {least} to {most}"),
            Self::Money => "an amount of money, such as 0.25".to_owned(),
            Self::Text(_) => "a text".to_owned(),
            Self::List(_) | Self::Repeated(_) => "a list of texts".to_owned(),
        };
        format!("{given} is not {expected}")
    }
}

/// Every setting's variable begins with this.
pub(super) const VARIABLE_PREFIX: &str = "MEMTRANSFER_";
