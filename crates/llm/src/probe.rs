//! What a server can do, found out by asking it before a run: whether it knows the model, sees images, takes a request
//! of the run's size and in what time.
//!
//! This is no benchmark: apart from the request of the run's size, the questions are trivial.

use std::io;
use std::thread;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::Value;

use crate::client::ChatClient;
use crate::error::{AskError, AttemptError, RequestError, Transient};
use crate::http::HttpClient;
use crate::reply::{self, ChatReply, ReplyContent};
use crate::request::{ChatMessage, ChatRequest, ChatRole, ContentPart, ImageUrl, MessageContent};

/// Maximum number of tokens of a short answer, as in a run.
const ANSWER_TOKENS: u32 = 30;

/// Maximum number of tokens of an answer whose time is measured.
const TIMED_TOKENS: u32 = 64;

/// Time limit for the list of models.
const LIST_TIMEOUT: Duration = Duration::from_secs(10);

/// Edge of the coloured squares, in pixels: above the patch size of every model known.
const SQUARE: u32 = 56;

/// How good a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ProbeMark {
    /// As a run needs it.
    Ok,
    /// A run works, but its results may be worth less than they look.
    Doubtful,
    /// A run makes no sense until this is solved.
    Bad,
}

/// The outcome of one check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ProbeFinding {
    /// What was checked.
    pub what: &'static str,
    /// How good it is.
    pub mark: ProbeMark,
    /// What was seen, and what to do about it.
    pub about: String,
}

/// A request of the run's size that was accepted.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunSized {
    /// Its images.
    pub images: u32,
    /// Seconds until the reply.
    pub seconds: f64,
    /// Tokens of its prompt, where the server counts them.
    pub prompt_tokens: Option<u64>,
}

/// Everything that was found out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProbeReport {
    /// The address.
    pub endpoint: String,
    /// The model that was asked for.
    pub model: String,
    /// In the order of the checks. Checks that make no sense after a failure are left out.
    pub findings: Vec<ProbeFinding>,
    /// The largest request of a run that the server accepts; `None` when none was accepted.
    pub run_sized: Option<RunSized>,
    /// The model's name in the server's answers.
    pub reported_model: Option<String>,
}

impl ProbeReport {
    /// The worst mark.
    pub fn worst(&self) -> ProbeMark {
        self.findings.iter().map(|finding| finding.mark).max().unwrap_or(ProbeMark::Ok)
    }
}

/// The largest request of a run: its number of images, and the request with fewer of them.
pub struct RunRequest<'a> {
    /// Its images.
    pub images: u32,
    /// The request with at most this many images.
    pub with: &'a dyn Fn(u32) -> ChatRequest,
}

/// Checks what the server can do, with `together` requests at once where several are sent. `run` is the largest request
/// of the run to come.
pub fn run(client: &ChatClient, together: u32, run: &RunRequest<'_>) -> ProbeReport {
    let mut probe = ServerProbe {
        client,
        report: ProbeReport {
            endpoint: client.http().endpoint().to_string(),
            model: client.settings().model.clone(),
            findings: Vec::new(),
            run_sized: None,
            reported_model: None,
        },
    };
    if probe.reach() && probe.answer() {
        probe.constraint();
        if run.images == 0 || probe.images() {
            probe.run_sized(run);
        }
        probe.temperature();
        probe.speed(together.max(1));
    }
    probe.report
}

struct ServerProbe<'a> {
    client: &'a ChatClient,
    report: ProbeReport,
}

/// The server's reaction to a request that it may refuse.
enum TrialOutcome {
    Accepted(Box<ChatReply>),
    Refused(String),
    Failed(String),
}

impl ServerProbe<'_> {
    fn found(&mut self, what: &'static str, mark: ProbeMark, about: impl Into<String>) {
        self.report.findings.push(ProbeFinding { what, mark, about: about.into() });
    }

    fn ask(&self, request: &ChatRequest) -> Result<ChatReply, AskError> {
        self.client.ask(request, 0).map(|answered| answered.reply)
    }

    /// Sends a request that the server may refuse: once, and with retries if the first attempt fails otherwise.
    fn try_once(&self, request: &ChatRequest) -> TrialOutcome {
        let refused =
            |message: String| TrialOutcome::Refused(message.trim_end_matches('.').to_owned());
        let timeout = self.client.settings().request_timeout;
        match self.client.http().attempt(request, timeout) {
            Ok(reply) => TrialOutcome::Accepted(Box::new(reply)),
            Err(AttemptError::Final(RequestError::Refused { message, .. })) => refused(message),
            // Some servers answer so when they cannot handle images.
            Err(AttemptError::Transient(Transient::Status { status: 500 | 501, message }, _)) => {
                refused(message)
            }
            Err(AttemptError::Transient(reason @ Transient::Timeout(_), _)) => {
                TrialOutcome::Failed(reason.to_string())
            }
            Err(AttemptError::Final(error)) => TrialOutcome::Failed(error.to_string()),
            Err(AttemptError::Transient(..)) => match self.ask(request) {
                Ok(reply) => TrialOutcome::Accepted(Box::new(reply)),
                Err(AskError::Failed(RequestError::Refused { message, .. })) => refused(message),
                Err(error) => TrialOutcome::Failed(error.to_string()),
            },
        }
    }

    /// Whether a server is there, and knows the model.
    fn reach(&mut self) -> bool {
        let start = Instant::now();
        let (server, models) = match models(self.client.http()) {
            Ok(answer) => answer,
            Err(problem) => {
                let about = format!(
                    "no answer from {}: {problem} Start the server, or correct --base-url.",
                    self.report.endpoint
                );
                self.found("reachable", ProbeMark::Bad, about);
                return false;
            }
        };
        let elapsed = start.elapsed().as_secs_f64();
        let server = server.unwrap_or_else(|| "no name".to_owned());
        let about = format!("the list of models came after {elapsed:.2} s (server: {server})");
        self.found("reachable", ProbeMark::Ok, about);
        let model = &self.report.model;
        let (mark, about) = match models {
            ModelList::Listed(names) if names.contains(model) => {
                (ProbeMark::Ok, format!("{model} is in the server's list of {}", names.len()))
            }
            ModelList::Listed(names) => (
                ProbeMark::Doubtful,
                format!(
                    "{model} is not in the server's list ({}). If requests fail, pass one of these with --model.",
                    self.client.http().endpoint().masked(&abbreviated(&names))
                ),
            ),
            ModelList::Refused(401 | 403, message) => (
                ProbeMark::Doubtful,
                format!(
                    "the server does not show its list: {message}. Set or check OPENAI_API_KEY."
                ),
            ),
            ModelList::Refused(status, message) => {
                (ProbeMark::Ok, format!("the server has no list (status {status}: {message})"))
            }
            ModelList::Unreadable => (ProbeMark::Ok, "the server has no list".to_owned()),
        };
        self.found("model", mark, about);
        true
    }

    /// Whether the model answers: at all, without reasoning, within a few tokens.
    fn answer(&mut self) -> bool {
        let question =
            ChatRequest::text("What is 17 + 25? Answer with the number only.", ANSWER_TOKENS);
        let reply = match self.ask(&question) {
            Ok(reply) => reply,
            Err(error) => {
                self.found("answers", ProbeMark::Bad, error.to_string());
                return false;
            }
        };
        let tokens =
            reply.completion_tokens.map_or_else(String::new, |n| format!(" in {n} tokens"));
        let text = short(reply.text());
        let (mark, about) = match &reply.content {
            ReplyContent::Text(_) => (ProbeMark::Ok, format!("{text:?}{tokens} to 17 + 25")),
            ReplyContent::Length(answer) if answer.is_empty() => (
                ProbeMark::Bad,
                format!(
                    "no text within {ANSWER_TOKENS} tokens to 17 + 25: the model spends them on reasoning that the server \
                     does not show. Turn reasoning off at the server, or serve a variant that does not reason."
                ),
            ),
            ReplyContent::Length(_) => (
                ProbeMark::Doubtful,
                format!("more than {ANSWER_TOKENS} tokens to 17 + 25: {text:?}"),
            ),
            ReplyContent::Refusal(_) => {
                (ProbeMark::Bad, format!("the model refuses to say what 17 + 25 is: {text:?}"))
            }
            ReplyContent::Empty => (
                ProbeMark::Bad,
                format!("nothing{tokens} to 17 + 25: check the server's chat template."),
            ),
        };
        self.found("answers", mark, about);
        let (mark, about) = if matches!(&reply.content, ReplyContent::Length(text) if text.is_empty())
            && !reply.reasoned
        {
            (ProbeMark::Doubtful, "not known, because no text came".to_owned())
        } else if reply.reasoned {
            (
                ProbeMark::Bad,
                "the model reasons although every request turns reasoning off, and has few tokens for its answer: turn \
                 reasoning off at the server, or serve a variant that does not reason."
                    .to_owned(),
            )
        } else {
            (ProbeMark::Ok, "the answer came without reasoning".to_owned())
        };
        self.found("reasoning off", mark, about);
        self.report.reported_model = reply.model;
        true
    }

    /// Whether the server keeps an answer to a list of choices.
    fn constraint(&mut self) {
        const CHOICES: [&str; 2] = ["harbour", "meadow"];
        let question = ChatRequest {
            choices: CHOICES.map(str::to_owned).to_vec(),
            ..ChatRequest::text("What is 17 + 25? Answer with the number only.", ANSWER_TOKENS)
        };
        let (mark, about) = match self.ask(&question) {
            Ok(reply) if CHOICES.iter().any(|choice| reply.text().contains(choice)) => {
                (ProbeMark::Ok, "the server restricts answers to the actions")
            }
            Ok(_) => (
                ProbeMark::Ok,
                "the server does not restrict answers: the first action in the model's text is taken",
            ),
            Err(_) => (ProbeMark::Doubtful, "the server fails when answers are restricted"),
        };
        self.found("restricted answers", mark, about);
    }

    /// Whether the model sees images; `false` when the server takes none.
    fn images(&mut self) -> bool {
        let mut right = true;
        let mut story = Vec::new();
        for (colour, rgba) in [("red", [230, 20, 20, 255]), ("blue", [20, 20, 230, 255])] {
            let reply = match self.try_once(&square(rgba)) {
                TrialOutcome::Accepted(reply) => reply,
                TrialOutcome::Refused(message) => {
                    let about = format!(
                        "the server takes none: {message}. Serve a model that sees (for llama.cpp with its --mmproj \
                         file), or run with --image-budget 0."
                    );
                    self.found("images", ProbeMark::Bad, about);
                    return false;
                }
                TrialOutcome::Failed(problem) => {
                    self.found("images", ProbeMark::Bad, format!("not known: {problem}"));
                    return false;
                }
            };
            right &= reply.text().to_lowercase().contains(colour);
            story.push(format!("{:?} to a {colour} square", short(reply.text())));
        }
        let story = story.join(", ");
        if right {
            self.found("images", ProbeMark::Ok, story);
        } else {
            let about = format!("{story}: the model may be too small, or not see what it is sent.");
            self.found("images", ProbeMark::Doubtful, about);
        }
        true
    }

    /// Whether the server takes the largest request of the run, and in what time; if not, with how many images.
    fn run_sized(&mut self, run: &RunRequest<'_>) {
        const WHAT: &str = "request of the run's size";
        let (mut accepted, mut refused) = (None::<RunSized>, None::<(u32, String)>);
        let mut images = run.images;
        loop {
            let start = Instant::now();
            match self.try_once(&(run.with)(images)) {
                TrialOutcome::Accepted(reply) => {
                    let seconds = start.elapsed().as_secs_f64();
                    accepted =
                        Some(RunSized { images, seconds, prompt_tokens: reply.prompt_tokens });
                }
                TrialOutcome::Refused(message) => refused = Some((images, message)),
                TrialOutcome::Failed(problem) => {
                    let about = format!(
                        "with {images} images: {problem}. Run with a longer --request-timeout or a smaller \
                         --image-budget."
                    );
                    return self.found(WHAT, ProbeMark::Bad, about);
                }
            }
            images = match (&accepted, &refused) {
                (_, None) | (None, Some((0, _))) => break,
                (Some(accepted), Some((refused, _))) if refused - accepted.images <= 1 => break,
                (Some(accepted), Some((refused, _))) => accepted.images.midpoint(*refused),
                (None, Some((refused, _))) => refused / 2,
            };
        }
        if let Some(RunSized { images: 1.., prompt_tokens: Some(tokens), .. }) = accepted
            && let TrialOutcome::Accepted(reply) = self.try_once(&(run.with)(0))
            && reply.prompt_tokens.is_some_and(|without| tokens <= without)
        {
            let about = "images are accepted, but add no tokens to the prompt: the server may drop them. Check its settings.";
            return self.found(WHAT, ProbeMark::Bad, about);
        }
        let (mark, about) =
            judge(run.images, accepted.as_ref(), refused, self.client.settings().request_timeout);
        self.found(WHAT, mark, about);
        self.report.run_sized = accepted;
    }

    /// Whether the same question gets the same answer.
    fn temperature(&mut self) {
        let question =
            ChatRequest::text("Name ten animals, with commas between them.", ANSWER_TOKENS);
        let (mark, about) = match [0, 1].map(|_| self.ask(&question)) {
            [Ok(first), Ok(second)] if first.content == second.content => {
                (ProbeMark::Ok, "the same question had the same answer twice".to_owned())
            }
            [Ok(first), Ok(second)] => (
                ProbeMark::Doubtful,
                format!(
                    "the same question had two answers, {:?} and {:?}: a run will not repeat exactly. Ask for several \
                     repetitions (--runs), or make the server deterministic.",
                    short(first.text()),
                    short(second.text()),
                ),
            ),
            [Err(error), _] | [_, Err(error)] => (ProbeMark::Bad, error.to_string()),
        };
        self.found("temperature 0", mark, about);
    }

    /// The speed of short answers, alone and with `together` requests at once.
    fn speed(&mut self, together: u32) {
        const WHAT: &str = "speed";
        let start = Instant::now();
        let alone = match self.ask(&counting(0)) {
            Ok(reply) => timed(start, reply.completion_tokens),
            Err(error) => return self.found(WHAT, ProbeMark::Bad, error.to_string()),
        };
        let (start, client) = (Instant::now(), self.client);
        let tokens: io::Result<Result<Option<u64>, AskError>> = thread::scope(|scope| {
            let ask = |number| {
                let ask = move || client.ask(&counting(number), 0);
                thread::Builder::new().spawn_scoped(scope, ask)
            };
            let threads = (1..=together).map(ask).collect::<io::Result<Vec<_>>>()?;
            let answers = threads.into_iter().filter_map(|thread| thread.join().ok());
            let tokens = answers.map(|answer| answer.map(|answer| answer.reply.completion_tokens));
            Ok(tokens.collect::<Result<Vec<_>, _>>().map(|tokens| tokens.into_iter().sum()))
        });
        let tokens = match tokens {
            Ok(tokens) => tokens,
            Err(error) => {
                let about = format!("cannot start {together} threads (`ulimit -u`): {error}");
                return self.found(WHAT, ProbeMark::Doubtful, about);
            }
        };
        match tokens {
            Ok(tokens) => {
                let about = format!("alone {alone}; {together} at once {}", timed(start, tokens));
                self.found(WHAT, ProbeMark::Ok, about);
            }
            Err(error) => {
                let about = format!(
                    "{together} requests at once are too many: {error}. Run with fewer --max-connections."
                );
                self.found(WHAT, ProbeMark::Doubtful, about);
            }
        }
    }
}

/// The answer to a request for the list of models.
#[derive(Debug, PartialEq)]
enum ModelList {
    /// The names.
    Listed(Vec<String>),
    /// The server refuses: status and message.
    Refused(u16, String),
    /// The answer is no list.
    Unreadable,
}

/// The `Server` header, and the list of models.
fn models(client: &HttpClient) -> Result<(Option<String>, ModelList), Transient> {
    let page = client.get(&client.endpoint().page("/models"), LIST_TIMEOUT)?;
    if page.status != 200 {
        let message = reply::error_message(&page.body, |text| client.endpoint().masked(text));
        return Ok((page.server, ModelList::Refused(page.status, message)));
    }
    let list: Value = serde_json::from_slice(&page.body).unwrap_or_default();
    let list = match list["data"].as_array() {
        Some(models) => {
            let names = models.iter().filter_map(|model| model["id"].as_str());
            ModelList::Listed(names.map(str::to_owned).collect())
        }
        None => ModelList::Unreadable,
    };
    Ok((page.server, list))
}

/// The finding about a request of the run's size with `images` images.
fn judge(
    images: u32,
    accepted: Option<&RunSized>,
    refused: Option<(u32, String)>,
    timeout: Duration,
) -> (ProbeMark, String) {
    let Some(RunSized { images: taken, seconds, prompt_tokens }) = accepted else {
        let (_, message) = refused.unwrap_or_default();
        let about = format!(
            "refused even without images: {message}. The prompt is longer than the server's context: raise it."
        );
        return (ProbeMark::Bad, about);
    };
    let tokens =
        prompt_tokens.map_or_else(String::new, |tokens| format!(", {tokens} prompt tokens"));
    let took = format!("{taken} images took {seconds:.1} s{tokens}");
    match refused {
        Some((refused, message)) => {
            let about = format!(
                "{refused} images are refused: {message}. {took}. Raise the server's context or its bound on images \
                 (vLLM: --limit-mm-per-prompt '{{\"image\": {images}}}'), or run with --image-budget {taken}."
            );
            (ProbeMark::Bad, about)
        }
        None if *seconds * 4.0 > timeout.as_secs_f64() => {
            let about = format!(
                "{took}. A request has {} s, and several at once take longer: run with fewer --max-connections or a \
                 longer --request-timeout.",
                timeout.as_secs()
            );
            (ProbeMark::Doubtful, about)
        }
        None => (ProbeMark::Ok, took),
    }
}

/// The time since `start`, and the rate of `tokens` where the server counts them.
fn timed(start: Instant, tokens: Option<u64>) -> String {
    let seconds = start.elapsed().as_secs_f64();
    let rate = tokens.map(|tokens| {
        let rate = tokens as f64 / seconds.max(f64::EPSILON);
        format!(" for {tokens} tokens ({rate:.0} a second)")
    });
    format!("{seconds:.2} s{}", rate.unwrap_or_default())
}

/// The question for the colour of a square.
fn square(rgba: [u8; 4]) -> ChatRequest {
    let image = png_file::RgbaImage::filled(SQUARE, SQUARE, rgba);
    let png = png_file::encode(SQUARE, SQUARE, png_file::Channels::Rgba, image.as_bytes());
    let image_url = ImageUrl::of_bytes("image/png", &png.unwrap_or_default());
    let text = "What colour is the square? Answer with one word.".to_owned();
    let parts = vec![ContentPart::ImageUrl { image_url }, ContentPart::Text { text }];
    let message = ChatMessage { role: ChatRole::User, content: MessageContent::Parts(parts) };
    ChatRequest { messages: vec![message], max_tokens: ANSWER_TOKENS, choices: Vec::new() }
}

/// A request for a long answer. The number at its beginning keeps it out of the server's prefix cache.
fn counting(number: u32) -> ChatRequest {
    let text = format!("{number}: count upwards from here in words, as far as you can.");
    ChatRequest::text(text, TIMED_TOKENS)
}

/// The beginning of a text.
fn short(text: &str) -> String {
    const MOST: usize = 60;
    let mut begun: String = text.chars().take(MOST).collect();
    if begun.len() < text.len() {
        begun.push_str("...");
    }
    begun
}

/// The first names of a list.
fn abbreviated(names: &[String]) -> String {
    const MOST: usize = 5;
    match names.len() {
        0 => "empty".to_owned(),
        n if n > MOST => format!("{} and {} more", names[..MOST].join(", "), n - MOST),
        _ => names.join(", "),
    }
}

#[cfg(test)]
mod tests;
