//! The settings of a run: one table that is at the same time the flags of `memtransfer run`, the
//! `MEMTRANSFER_*` variables and the keys of a suite file, and says what each setting affects.

use std::fmt;
use std::str::FromStr;

use domain::limits::{MAX_FRAMES, MAX_ITEMS, MAX_SEGMENT, MAX_WINDOW, MAX_WORLDS};
use domain::memory_kind::{EXTERNAL_WORD, NONE_WORD};
use domain::names::UnknownName;
use domain::{
    Arm, FeedbackLevel, ImageFormat, REQUEST_FIELDS, ReasoningRequest, SecretHeader, StreamOrder,
    SystemRole,
};
use serde_json::{Map, Value};

use super::{CaseSelector, DocumentSource, Drawn, ResponseCache, WorldStart};
use crate::{
    Demonstrations, Frames, Hint, Mismatch, PolicyKind, Route, SegmentContent, Start,
    representation,
};

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
    /// What part of a run it is a setting of.
    pub scope: Scope,
    /// What it affects.
    pub effect: Effect,
    /// Its value where nothing sets it, as a flag gives it. A suite sets most of them.
    pub default: Option<&'static str>,
    kind: ValueKind,
}

/// What part of a run a setting belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scope {
    /// The whole run.
    Run,
    /// Each group of conditions, which a suite may list as `[[group]]`.
    Group,
    /// The streams of a suite, its table `[stream]`.
    Stream,
    /// The model of `--policy openai`.
    Model,
}

/// What a setting affects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effect {
    /// Which episodes the run has. A run may be resumed with other values, and grows or shrinks.
    Selection,
    /// The outcome of episodes, and runs with different values are not to be compared.
    Protocol,
    /// The outcome of episodes.
    Outcome,
    /// No result. The contents that a path stands for are compared instead.
    Nothing,
    /// No result, and another machine may need another value.
    Machine,
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
    kind: &'static str,
    text: &str,
    known: [&str; N],
) -> Result<(), String> {
    if known.contains(&text) {
        Ok(())
    } else {
        Err(UnknownName::new(kind, text, known).to_string())
    }
}

/// Accepts demonstrations that conditions name.
fn is_set(text: &str) -> Result<(), String> {
    parses::<Demonstrations>(text)?;
    match text.parse().is_ok_and(Demonstrations::is_control) {
        true => {
            Err(format!("`{text}` is held in a control arm: give --arms oracle or --arms wrong"))
        }
        false => Ok(()),
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

/// Accepts a JSON object without the fields that a run sets itself.
fn is_extra_body(text: &str) -> Result<(), String> {
    let fields: Map<String, Value> = serde_json::from_str(text)
        .map_err(|error| format!("not a JSON object such as {{\"top_k\": 1}}: {error}"))?;
    match REQUEST_FIELDS.iter().find(|own| fields.contains_key(**own)) {
        Some(own) => Err(format!("the run sets {own:?} itself")),
        None => Ok(()),
    }
}

fn is_provider(text: &str) -> Result<(), String> {
    is_one_of("execution provider", text, ["cpu", "openvino", "cuda", "tensorrt"])
}

const WHAT: &str = "What is run";
const GIVEN: &str = "What the agent is given";
const MODEL: &str = "The model (with --policy openai)";
const HOW: &str = "How it is run";

/// Writes the table: one line of names, form, scope, effect and default, one of help.
macro_rules! keys {
    ($($heading:ident: $($name:literal $value_name:tt $kind:expr, $scope:ident $effect:ident $(= $default:literal)?,
        $help:literal;)*)*) => {
        &[$($(Key {
            name: $name,
            value_name: $value_name,
            heading: $heading,
            help: $help,
            kind: $kind,
            scope: Scope::$scope,
            effect: Effect::$effect,
            default: keys!(@default $($default)?),
        }),*),*]
    };
    (@default) => { None };
    (@default $default:literal) => { Some($default) };
}

use ValueKind::{List, Money, Number, Numbers, Repeated, Switch, Text};

const SECONDS: ValueKind = Number(1, 86_400, 1);

/// Every setting, in the order of the help.
pub const KEYS: &[Key] = keys! {
    WHAT:
    "suite" "NAME|FILE" Text(any), Run Nothing = "quick",
        "A shipped suite by name, or a suite file (TOML)";
    "policy" "NAME" Text(parses::<PolicyKind>), Run Outcome = "grounded",
        "What decides: grounded (scripted, needs no model), imitate (scripted, for any world), openai (a model behind an \
         OpenAI-compatible endpoint), external (your own program), random, or expert (replays the \
         reference)";
    "policy-cmd" COMMAND Text(is_command), Run Outcome,
        "The command that starts your own policy, for example \"python my_policy.py\"; implies \
         --policy external";
    "world-cmd" COMMAND Text(is_command), Run Nothing,
        "The command that starts a world of your own in place of the warehouse, for example \"python my_world.py\"; \
         `book`, `serve`, `act` and `views` are added to it";
    "world" "external" Text(parses::<WorldStart>), Run Nothing,
        "Wait for a world of your own that you start yourself (the run prints how); needs --world-book";
    "world-book" "DIR" Text(any), Run Nothing,
        "The folder with the case book of that world, which `your-program book --out DIR` writes; implies --world external";
    "memory" "LIST" List(is_memory), Group Selection = "working,full-context,summary,semantic,hybrid,episodic",
        "Memories: working, full-context, summary, semantic, hybrid, episodic, adaptive; external \
         for one of your own that you start yourself (the run prints how); none for external ones only";
    "memory-cmd" COMMAND Repeated(is_command), Run Nothing,
        "The command that starts a memory of your own, for example \"python my_memory.py\"; it runs \
         beside those of --memory, under the name it reports. Can be given up to 8 times";
    "starts" "LIST" List(parses::<Start>), Group Selection = "original,new",
        "Starting poses: original (as demonstrated), new (no demonstration starts there)";
    "routes" "LIST" List(parses::<Route>), Group Selection = "unchanged",
        "Routes: unchanged, blocked (a passage of the demonstrations is closed; new starts only)";
    "demos" "LIST" List(is_set), Group Selection = "original",
        "Demonstrations in memory: original, opposite, nearby, distant, several joined by +, or 4 \
         for all; irrelevant or confusable for original, opposite and two of other tasks; after for one \
         by an expert who knows the closed passage, before-after or after-before for original and that one; \
         bank-N for N of all cases, the case's original among them; elsewhere for one of the same task in another \
         warehouse. Each entry of the list is a condition of its own";
    "cases" "LIST" List(parses::<CaseSelector>), Run Selection = "all",
        "Cases by id (t03-07), task (t03), number (37) or range (1-10, t03-01..t04-10); `all`";
    "limit" "N" Number(0, 1_000_000, 1), Run Selection,
        "Run N of the selected cases, balanced over the tasks and their groups. A larger N includes the cases of a \
         smaller one";
    "arms" "LIST" List(is_arm), Group Selection = "frozen",
        "What memories are built from: frozen (as demonstrated); as controls oracle (the test reference; in streams \
         demonstrations in the world as it is) and wrong (demonstrations of other tasks, documents of another warehouse); in \
         streams also learning (as frozen, and it learns)";
    "streams" "N" Number(1, 1000, 1), Stream Protocol,
        "Number of streams of a suite of streams (see `memtransfer ls streams`)";
    "rounds" "N" Number(0, 1000, 1), Stream Protocol,
        "How often a memory learns from the cases of a block, in a suite of streams";
    "orders" "LIST" List(is_order), Stream Protocol,
        "Orders of the blocks of a suite of streams: drawn, reversed, shuffled";
    "feedback" "LEVEL" Text(is_feedback), Stream Protocol,
        "What a memory that learns is told at the end of an episode: none, success, sub-goals";
    "runs" "N" Number(1, 1000, 1), Group Selection = "1",
        "Repetitions of every episode, each with its own seed";
    "seed" "N" Number(0, u64::MAX, 1), Run Protocol = "1",
        "The number that every episode's seed is derived from";
    "max-steps" "N" Number(1, 10_000, 1), Run Protocol = "200",
        "Steps after which an episode ends, T_max";
    "assets" "DIR" Text(any), Run Machine,
        "Use the layout, catalogue, cases, suites and model manifest in DIR, not the built-in ones";
    "elsewhere" "DIR" Text(any), Run Machine,
        "The warehouse of --demos elsewhere: its layout and catalogue [default: drawn from --seed, of the same size]";

    GIVEN:
    "window" "LIST" Numbers(0, MAX_WINDOW as u64), Group Selection = "6",
        "Past steps shown to the policy, h. Each entry of the list is a condition of its own";
    "horizon" "N" Number(0, MAX_SEGMENT as u64 - 1, 1), Run Outcome = "6",
        "Expert actions that a retrieved segment covers, H_epi";
    "hits" "N" Number(1, MAX_ITEMS as u64, 1), Run Outcome = "1",
        "Segments that episodic memory supplies at a step, the nearest first, k";
    "segment" "LIST" List(parses::<SegmentContent>), Group Selection = "actions",
        "Content of a retrieved segment: actions (with the views they led to), or images only";
    "keyframes" "N" Number(1, MAX_IMAGES as u64, 1), Run Outcome = "40",
        "Keyframes of full-context memory, shared by the demonstrations of a case";
    "memory-images" "N" Number(0, 1000, 1), Run Outcome,
        "Maximum number of images that a memory supplies at a step; an item that does not fit is left out and \
         counted [default: as many as any built-in memory supplies]";
    "memory-text-bytes" "N" Number(0, 16_000_000, 1), Run Outcome = "1048576",
        "Maximum number of bytes of text that a memory supplies at a step; an item that does not fit is left out \
         and counted";
    "hint" "LIST" List(parses::<Hint>), Group Selection = "on",
        "Whether the prompt says that the demonstration has the same starting pose, where it has: \
         on, off";
    "mismatch" "LIST" List(parses::<Mismatch>), Group Selection = "none",
        "What an episode differs in from the demonstrations, one at a time: none, light, labels (without them), \
         camera-height, field-of-view, wording (of the instruction), stock. Each entry of the list is a condition of \
         its own";
    "documents" "BUILDER|DIR" Text(parses::<DocumentSource>), Run Outcome,
        "Documents of summary, semantic and hybrid memory: extractive (written by a script), model (by the run's own \
         model, or by any that has written them before), model:NAME (by that one before), or those in the folder DIR \
         [default: model with --policy openai, otherwise extractive]";
    "frame-size" "PIXELS" Number(64, 4096, 64), Run Protocol = "448",
        "Width and height of a frame, a multiple of 64";
    "frames" "KIND" Text(parses::<Frames>), Run Protocol = "rendered",
        "What frames show: rendered, or as a control blank (grey) or swapped (another pose), which leave what \
         memory supplies as it is, or blank-all (grey, also in memory's views; memory supplies no texts)";
    "plates" "on|off" Text(parses::<Drawn>), Run Protocol,
        "Whether a coloured plate hangs above every item, which the paper's warehouse lacks \
         [default: on for --policy grounded, which reads nothing else, otherwise off]";
    "labels" "on|off" Text(parses::<Drawn>), Run Protocol = "on",
        "Whether anything is written in the warehouse: names of items, numbers of bays, signs";
    "appearance-seed" "N" Number(0, u64::MAX, 1), Run Protocol = "0",
        "Vary the light and the tints of walls, floor and racks; 0 is the standard look";
    "encoder" "NAME" Text(any), Run Outcome = "dinov2-s14",
        "The model that embeds frames, by its name in models.toml";
    "encoder-file" "FILE" Text(any), Run Outcome,
        "The encoder's ONNX file, for a model that `cargo xtask setup` does not fetch";

    MODEL:
    "model" "NAME" Text(any), Model Outcome,
        "The model, by the name that the server knows";
    "base-url" "URL,..." Text(any), Model Machine,
        "The server, up to /v1 [default: $OPENAI_BASE_URL, else $OPENAI_API_BASE]. Several servers of \
         the same model, separated by commas, share the requests. The key is $OPENAI_API_KEY; a file \
         .env may hold all three";
    "image-format" "FORMAT" Text(parses::<ImageFormat>), Model Outcome = "png",
        "Encoding of images in requests: png (lossless) or jpeg";
    "image-budget" "N" Number(0, 1000, 1), Model Outcome = "50",
        "Maximum number of images in a request; the prompt says how many were left out. 0 for a model that \
         reads text only";
    "answer-tokens" "N" Number(1, 100_000, 1), Model Outcome = "30",
        "Maximum number of tokens in an answer, reasoning included";
    "prompt" "FILE" Text(any), Model Machine,
        "A template of your own for the prompt; `memtransfer ls prompt` prints the built-in one to start from";
    "reasoning" "LEVEL" Text(parses::<ReasoningRequest>), Model Outcome = "off",
        "What requests say about reasoning: off, minimal, low, medium, high, or nothing (model). With any but off, \
         raise --answer-tokens";
    "system-role" "ROLE" Text(parses::<SystemRole>), Model Outcome = "system",
        "How the rules are sent: as system, as developer, or at the beginning of the user's message (user), for \
         models that know no other role";
    "extra-body" "JSON" Text(is_extra_body), Model Outcome,
        "Further fields of each request, a JSON object such as {\"top_k\": 1}; a field that is null is not sent";
    "header" "NAME: VALUE" Repeated(parses::<SecretHeader>), Model Machine,
        "A further header of each request. Can be given several times. Values are masked and kept nowhere, as a key is";
    "max-connections" "N" Number(1, 1024, 1), Model Machine = "16",
        "Maximum number of requests in flight to one server; fewer while it is overloaded or slow";
    "endpoint-limit" "N" Number(1, 1024, 1), Model Machine,
        "Maximum number of requests in flight to one server from all runs together that have this flag";
    "endpoint-limit-folder" "DIR" Text(any), Model Machine,
        "Where runs agree on --endpoint-limit; machines that share the folder share the limit \
         [default: endpoint-limits in the cache folder]";
    "max-retries" "N" Number(0, 100, 1), Model Machine = "5",
        "How often a request is repeated after a failure that may pass, such as status 429 or 5xx, a timeout or a \
         failed connection";
    "request-timeout" "SECONDS" SECONDS, Model Machine = "120",
        "Time limit of one attempt";
    "server-patience" "SECONDS" Number(0, 86_400, 1), Model Machine = "600",
        "How long a run waits for a server that answered before and is unreachable; 0 does not wait";
    "stop-without-action" "N" Number(0, 1_000_000, 1), Model Machine = "100",
        "Stop if none of the first N answers of at least three episodes has an action; 0 never stops";
    "response-cache" "on|off|DIR" Text(parses::<ResponseCache>), Model Machine = "on",
        "Cache replies, so that no request is sent twice: on, off, or the folder of the cache";
    "prices" "FILE" Text(any), Model Nothing,
        "Prices of tokens, by model (TOML; see docs/costs.md)";
    "max-tokens-total" "N" Number(0, u64::MAX, 1), Model Nothing,
        "Stop when the run has used N tokens, earlier sessions included";
    "max-cost" "AMOUNT" Money, Model Nothing,
        "Stop when the run has cost AMOUNT in the currency of --prices, earlier sessions included";

    HOW:
    "out" "DIR" Text(any), Run Nothing,
        "The run's folder; the same command again resumes the run in it";
    "log-prompts" "" Switch, Run Nothing,
        "Log every prompt, its images and the answer in the run's folder, for `memtransfer show`";
    "lanes" "N" Number(1, 1024, 1), Run Machine = "16",
        "Episodes that run at the same time";
    "worlds" "N" Number(1, MAX_WORLDS as u64, 1), Run Machine = "1",
        "Processes of the world, which share the lanes; for a slow world where cores are idle";
    "encoder-threads" "N" Number(1, 1024, 1), Run Machine,
        "Frames embedded at the same time [default: number of cores]";
    "provider" "NAME" Text(is_provider), Run Outcome,
        "ONNX Runtime's execution provider for the encoder: cpu, openvino, cuda, tensorrt \
         [default: cpu]";
    "frame-budget" "FRAMES" Number(1, MAX_FRAMES as u64, 1), Run Machine,
        "Frames that each world keeps in shared memory [default: as many as are useful and fit into half of the \
         free memory]";
    "backend" "NAME" Text(is_backend), Run Outcome,
        "Render with wgpu (a graphics device) or on the cpu, whose pixels are the same on every \
         machine [default: wgpu where there is a graphics card]";
    "adapter" "NAME" Text(any), Run Outcome,
        "Render with the best Vulkan adapter whose name contains NAME";
    "warm-views" "" Switch, Run Machine,
        "Render every view of the unchanged warehouse before the first step; for measurements";
    "spin-us" "MICROSECONDS" Number(0, 1_000_000, 1), Run Machine = "0",
        "How long a process polls for messages before it sleeps; useful where cores are idle";
    "step-timeout" "SECONDS" SECONDS, Run Machine = "120",
        "Time limit of an answer; a process that exceeds it is restarted";
    "memory-timeout" "SECONDS" SECONDS, Run Machine = "30",
        "Time limit of an answer of an external memory; an episode that it leaves unanswered ends \
         without a result";
    "start-timeout" "SECONDS" SECONDS, Run Machine = "300",
        "Time limit for the processes to get ready";
};

/// The table of a suite that holds the settings of [`Scope::Stream`] and others.
pub const STREAM_TABLE: &str = "stream";

/// What stands for a command in the help.
const COMMAND: &str = "COMMAND";

impl Key {
    /// The setting called `name`.
    pub fn find(name: &str) -> Option<&'static Self> {
        KEYS.iter().find(|key| key.name == name)
    }

    /// The settings of a scope.
    pub fn of_scope(scope: Scope) -> impl Iterator<Item = &'static Self> {
        KEYS.iter().filter(move |key| key.scope == scope)
    }

    /// The settings that another machine may need other values of, and that change no result.
    pub fn of_machine() -> impl Iterator<Item = &'static Self> {
        KEYS.iter().filter(|key| key.effect == Effect::Machine)
    }

    /// Whether the setting `name` changes the outcome of episodes, so that a run cannot be resumed with another value.
    pub fn changes_outcome(name: &str) -> bool {
        match Self::find(name) {
            Some(key) => matches!(key.effect, Effect::Protocol | Effect::Outcome),
            None => name == STREAM_TABLE,
        }
    }

    /// Whether runs with different values of the setting `name` are not to be compared.
    pub fn is_of_protocol(name: &str) -> bool {
        match Self::find(name) {
            Some(key) => matches!(key.effect, Effect::Selection | Effect::Protocol),
            None => name == STREAM_TABLE,
        }
    }

    /// The help, with the default if there is one.
    pub fn help_text(&self) -> String {
        match self.default {
            Some(default) => format!("{} [default: {default}]", self.help),
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
    pub fn read(&self, text: &str) -> Result<Value, String> {
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
    pub fn check(&self, value: &Value) -> Result<(), String> {
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
                    value.as_f64().and_then(|amount| crate::cost::Money::try_from(amount).ok());
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
pub const VARIABLE_PREFIX: &str = "MEMTRANSFER_";
