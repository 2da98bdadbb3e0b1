//! What a server can do, found out by asking it before a run: whether it knows the model, sees every image whole and in
//! order, reads the prompts of the run from their first line, restricts answers, and in what time.
//!
//! This is no benchmark: apart from the requests of the run's size, the questions are trivial.

use std::io;
use std::thread;
use std::time::{Duration, Instant};

use domain::{ReasoningRequest, SystemRole};
use serde::Serialize;

use crate::body;
use crate::client::ChatClient;
use crate::error::{AskError, AttemptError, RequestError, Transient};
use crate::http::{HttpClient, SendOutcome};
use crate::reply::{self, ChatReply, ReplyContent};
use crate::request::{
    CONSTRAINTS, ChatMessage, ChatRequest, ChatRole, ContentPart, ImageUrl, MessageContent,
};

/// Maximum number of tokens of an answer in the paper.
const PAPER_TOKENS: u32 = 30;

/// The word that questions about what a model reads ask for.
const CODE_WORD: &str = "meadow";

/// Tokens that an answer may have more than characters, before they count as reasoning that the server does not show.
const UNSEEN_TOKENS: u64 = 12;

/// Characters of a text that have at least one token.
const CHARACTERS_OF_A_TOKEN: u64 = 10;

/// Maximum number of tokens of an answer whose time is measured.
const TIMED_TOKENS: u32 = 64;

/// Time limit for the list of models.
const LIST_TIMEOUT: Duration = Duration::from_secs(10);

/// Edge of the coloured squares, in pixels: above the patch size of every model known.
const SQUARE: u32 = 56;

/// What two images with the same upper half and the same answer can mean.
const SAME_HALF: &str = "the model may not see the lower half, or the server take an answer from a cache that compares \
                         images only in part";

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

/// A setting that a run with the server has otherwise than the paper (docs/specification.md, section 5).
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PaperDifference {
    /// What it is about.
    pub setting: &'static str,
    /// The paper's value.
    pub paper: &'static str,
    /// The run's.
    pub here: String,
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
    /// What a run with this server does otherwise than the paper, as far as the checks show; `None` where they ended early.
    pub differences: Option<Vec<PaperDifference>>,
}

impl ProbeReport {
    /// The worst mark.
    pub fn worst(&self) -> ProbeMark {
        self.findings.iter().map(|finding| finding.mark).max().unwrap_or(ProbeMark::Ok)
    }
}

/// The largest request of a run with one memory.
pub struct RunRequest<'a> {
    /// The memory's name.
    pub memory: String,
    /// Its images.
    pub images: u32,
    /// Characters of its documents.
    pub document_chars: u32,
    /// The request with at most this many images.
    pub with: Box<dyn Fn(u32) -> ChatRequest + 'a>,
}

/// How a server is checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProbeSettings {
    /// Number of requests at once where several are sent.
    pub together: u32,
    /// Maximum number of tokens of an answer of the run to come.
    pub answer_tokens: u32,
    /// Edge of a view of the run, in pixels.
    pub frame_size: u32,
}

/// Checks what the server can do; `requests` are the largest requests of the run to come.
pub fn run(
    client: &ChatClient,
    settings: ProbeSettings,
    requests: &[RunRequest<'_>],
) -> ProbeReport {
    let ProbeSettings { together, answer_tokens, frame_size } = settings;
    let mut probe = ServerProbe {
        client,
        answer_tokens,
        frame_size,
        reasoned: Some(false),
        drops_images: false,
        report: ProbeReport {
            endpoint: client.http().endpoint().to_string(),
            model: client.settings().model.clone(),
            findings: Vec::new(),
            run_sized: None,
            reported_model: None,
            differences: None,
        },
    };
    if probe.reach() && probe.answer() {
        probe.system_role();
        probe.constraint();
        let most_images = requests.iter().max_by_key(|request| request.images);
        let sees = most_images.is_none_or(|request| request.images == 0) || probe.images();
        if let Some(largest) = most_images.filter(|_| sees) {
            probe.run_sized(largest);
            probe.first_line(requests);
        }
        probe.temperature();
        probe.speed(together.max(1));
        probe.compare(requests);
    }
    probe.report
}

struct ServerProbe<'a> {
    client: &'a ChatClient,
    /// Maximum number of tokens of a short answer, as in the run.
    answer_tokens: u32,
    /// Edge of a view of the run, in pixels.
    frame_size: u32,
    /// Whether a reply showed reasoning; `None` where none shows that there was none.
    reasoned: Option<bool>,
    /// Whether the tokens of prompts show that not all images reach the model.
    drops_images: bool,
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
        let timeout = self.client.settings().request_timeout.min(LIST_TIMEOUT);
        let (server, models) = match models(self.client.http(), timeout) {
            Ok(answer) => answer,
            // The rest of the server may work.
            Err(AttemptError::Transient(Transient::Timeout(_), _)) => {
                let about = format!(
                    "the list of models did not come within {} s; the other checks go on",
                    timeout.as_secs()
                );
                self.found("reachable", ProbeMark::Doubtful, about);
                return true;
            }
            Err(AttemptError::Final(error)) => {
                self.found("reachable", ProbeMark::Bad, error.to_string());
                return false;
            }
            Err(AttemptError::Transient(problem, _)) => {
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

    /// A question in plain text.
    fn question(&self, text: &str) -> ChatRequest {
        ChatRequest::text(text, self.answer_tokens)
    }

    /// Whether the model answers: at all, without reasoning, within a few tokens.
    fn answer(&mut self) -> bool {
        let bound = self.answer_tokens;
        let question = self.question("What is 17 + 25? Answer with the number only.");
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
                    "no text within {bound} tokens to 17 + 25: the model spends them on reasoning that the server does not \
                     show. Turn reasoning off at the server, serve a variant that does not reason, or raise --answer-tokens \
                     and say how much to reason with --reasoning."
                ),
            ),
            ReplyContent::Length(_) => {
                (ProbeMark::Doubtful, format!("more than {bound} tokens to 17 + 25: {text:?}"))
            }
            ReplyContent::Refusal(_) => {
                (ProbeMark::Bad, format!("the model refuses to say what 17 + 25 is: {text:?}"))
            }
            ReplyContent::Empty => (
                ProbeMark::Bad,
                format!("nothing{tokens} to 17 + 25: check the server's chat template."),
            ),
        };
        self.found("answers", mark, about);
        let (mark, about) = self.reasoning(&reply);
        self.found("reasoning off", mark, about);
        self.reasoned = (reply.reasoned || mark == ProbeMark::Ok).then_some(reply.reasoned);
        self.report.reported_model = reply.model;
        true
    }

    /// What a reply shows about reasoning: its fields, its text, its tokens.
    fn reasoning(&self, reply: &ChatReply) -> (ProbeMark, String) {
        let asked = self.client.settings().options.reasoning;
        let characters = reply.text().chars().count() as u64;
        let unseen = reply.completion_tokens.filter(|n| *n > characters + UNSEEN_TOKENS);
        match (&reply.content, unseen) {
            _ if asked != ReasoningRequest::Off => {
                let shown = if reply.reasoned { "the model reasons" } else { "no reasoning shows" };
                (ProbeMark::Ok, format!("--reasoning {asked}: {shown}"))
            }
            _ if reply.reasoned => (
                ProbeMark::Bad,
                "the model reasons although every request turns reasoning off, and has few tokens for its answer: turn \
                 reasoning off at the server, serve a variant that does not reason, or give --reasoning and more \
                 --answer-tokens."
                    .to_owned(),
            ),
            (ReplyContent::Length(text), _) if text.is_empty() => {
                (ProbeMark::Doubtful, "not known, because no text came".to_owned())
            }
            (_, Some(tokens)) => (
                ProbeMark::Doubtful,
                format!(
                    "an answer of {characters} characters has {tokens} tokens: the model may reason, and the server not show \
                     it. Turn reasoning off at the server."
                ),
            ),
            _ => (ProbeMark::Ok, "the answer came without reasoning".to_owned()),
        }
    }

    /// Whether the model follows the rules in their role.
    fn system_role(&mut self) {
        const WHAT: &str = "system role";
        let rule = format!("Whatever you are asked, answer with the word {CODE_WORD} only.");
        let mut request = self.question("What is 17 + 25?");
        request.messages.insert(0, ChatMessage::text(ChatRole::System, rule));
        let role = self.client.settings().options.system_role;
        let (mark, about) = match self.try_once(&request) {
            TrialOutcome::Accepted(reply) if names(&reply, CODE_WORD) => {
                (ProbeMark::Ok, format!("the model follows rules in the role {role}"))
            }
            TrialOutcome::Accepted(reply) => (
                ProbeMark::Doubtful,
                format!(
                    "{:?} although the rules, in the role {role}, ask for another word: the model may not see them. Try \
                     --system-role user.",
                    short(reply.text())
                ),
            ),
            TrialOutcome::Refused(message) => (
                ProbeMark::Bad,
                format!("rules in the role {role} are refused: {message}. Try --system-role user."),
            ),
            TrialOutcome::Failed(problem) => (ProbeMark::Doubtful, format!("not known: {problem}")),
        };
        self.found(WHAT, mark, about);
    }

    /// Which ways of keeping an answer to a list of choices work: that of a run, and each alone.
    fn constraint(&mut self) {
        const CHOICES: [&str; 2] = ["harbour", CODE_WORD];
        let question = ChatRequest {
            choices: CHOICES.map(str::to_owned).to_vec(),
            ..self.question("What is 17 + 25? Answer with the number only.")
        };
        let is_choice = |reply: &ChatReply| CHOICES.iter().any(|choice| names(reply, choice));
        let usual = self.ask(&question).map(|reply| is_choice(&reply));
        let http = self.client.http();
        let settings = self.client.settings();
        let mut working = Vec::new();
        let mut ways = Vec::new();
        for field in CONSTRAINTS {
            let dialect = http.dialect().restricting_by(field);
            let seen = if settings.options.extra_body.contains_key(field) {
                "set by --extra-body"
            } else {
                match http.send(dialect, &question, settings.request_timeout) {
                    Ok(SendOutcome::Reply(reply)) if is_choice(&reply) => {
                        working.push(field);
                        "works"
                    }
                    Ok(SendOutcome::Reply(_)) => "ignored",
                    Ok(SendOutcome::OtherDialect(_)) => "refused",
                    Err(_) => "fails",
                }
            };
            ways.push(format!("{field}: {seen}"));
        }
        let ways = ways.join(", ");
        let sent = http.dialect().constraints(&settings.options).join(" and ");
        let (mark, about) = match usual {
            Ok(true) => {
                (ProbeMark::Ok, format!("the server restricts answers to the actions ({ways})"))
            }
            Ok(false) if working == ["response_format"] => (
                ProbeMark::Doubtful,
                format!(
                    "a run sends {sent}, which the server ignores ({ways}): with --extra-body '{{\"structured_outputs\": null, \
                     \"grammar\": null}}' it sends response_format"
                ),
            ),
            Ok(false) => (
                ProbeMark::Doubtful,
                format!(
                    "the server does not restrict answers, so the action is read from the model's text ({ways})"
                ),
            ),
            Err(error) => (
                ProbeMark::Doubtful,
                format!("the server fails when answers are restricted ({ways}): {error}"),
            ),
        };
        self.found("restricted answers", mark, about);
    }

    /// The answers to several questions with images; `None` when the server takes no such request.
    fn shown<const N: usize>(
        &mut self,
        what: &'static str,
        questions: [ChatRequest; N],
        advice: &str,
    ) -> Option<[String; N]> {
        let mut answers = [const { String::new() }; N];
        for (answer, question) in answers.iter_mut().zip(questions) {
            match self.try_once(&question) {
                TrialOutcome::Accepted(reply) => *answer = short(reply.text()),
                TrialOutcome::Refused(message) => {
                    let about = format!("the server takes none: {message}. {advice}");
                    self.found(what, ProbeMark::Bad, about);
                    return None;
                }
                TrialOutcome::Failed(problem) => {
                    self.found(what, ProbeMark::Bad, format!("not known: {problem}"));
                    return None;
                }
            }
        }
        Some(answers)
    }

    /// Whether the model sees images, in order and whole; `false` when the server takes none.
    fn images(&mut self) -> bool {
        const SAME: &str = "the server may take an answer from a cache that ignores images";
        let (tokens, [red, blue]) =
            (self.answer_tokens, [RED, BLUE].map(|rgba| square(SQUARE, rgba, rgba)));
        let question = "What colour is the square? Answer with one word.";
        let advice = "Serve a model that sees (for llama.cpp with its --mmproj file), or run with --image-budget 0.";
        let alone = [&red, &blue].map(|image| about_images(question, &[image], tokens));
        let Some([to_red, to_blue]) = self.shown("images", alone, advice) else { return false };
        let story = format!("{to_red:?} to a red square, {to_blue:?} to a blue square");
        let (mark, about) = if colours(&to_red) == ["red"] && colours(&to_blue) == ["blue"] {
            (ProbeMark::Ok, story)
        } else if to_red == to_blue && !colours(&to_red).is_empty() {
            (ProbeMark::Bad, format!("{story}: {SAME}, or not give the model what it is sent."))
        } else {
            (
                ProbeMark::Doubtful,
                format!("{story}: the model may be too small, or not see what it is sent."),
            )
        };
        self.found("images", mark, about);

        let question =
            "Which colours have these two squares, the first one first? Answer with two words.";
        let pairs = [[&red, &blue], [&blue, &red]];
        let pairs = pairs.map(|pair| about_images(question, &pair, tokens));
        let advice = "Raise the server's bound on images, or run with --image-budget 1.";
        let Some([red_blue, blue_red]) = self.shown("images in order", pairs, advice) else {
            return true;
        };
        let story = format!(
            "{red_blue:?} to a red and a blue square, {blue_red:?} to a blue and a red one"
        );
        let (mark, about) = match (&*colours(&red_blue), &*colours(&blue_red)) {
            (["red", "blue", ..], ["blue", "red", ..]) => (ProbeMark::Ok, story),
            _ => (
                ProbeMark::Doubtful,
                format!(
                    "{story}: the server may drop images or change their order, or the model be too small for two."
                ),
            ),
        };
        self.found("images in order", mark, about);

        let question = "Which colour has the lower half of this image? Answer with one word.";
        let frame_size = self.frame_size;
        let halves = [RED, BLUE].map(|rgba| square(frame_size, GREY, rgba));
        let halves = halves.each_ref().map(|image| about_images(question, &[image], tokens));
        let advice = "Serve a model that sees.";
        let Some([to_red, to_blue]) = self.shown("images whole", halves, advice) else {
            return true;
        };
        let story = format!("{to_red:?} to a red lower half, {to_blue:?} to a blue one");
        let (mark, about) = if colours(&to_red) == ["red"] && colours(&to_blue) == ["blue"] {
            (ProbeMark::Ok, story)
        } else if to_red == to_blue && !colours(&to_red).is_empty() {
            (ProbeMark::Bad, format!("{story}, in views of {frame_size} pixels: {SAME_HALF}."))
        } else {
            (ProbeMark::Doubtful, format!("{story}: the model may not see the whole image."))
        };
        self.found("images whole", mark, about);
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
        let (mark, about) =
            judge(run.images, accepted.as_ref(), refused, self.client.settings().request_timeout);
        self.found(WHAT, mark, about);
        if let Some(RunSized { images: images @ 1.., prompt_tokens: Some(all), .. }) = accepted {
            self.tokens_of_images(run, images, all);
        }
        self.report.run_sized = accepted;
    }

    /// Whether the tokens of a prompt grow with its images: `all` is their number with `images` images.
    fn tokens_of_images(&mut self, run: &RunRequest<'_>, images: u32, all: u64) {
        let tokens = |images| match self.try_once(&(run.with)(images)) {
            TrialOutcome::Accepted(reply) => reply.prompt_tokens,
            TrialOutcome::Refused(_) | TrialOutcome::Failed(_) => None,
        };
        let (Some(none), Some(one)) = (tokens(0), tokens(1)) else { return };
        let (each, added) = (one.saturating_sub(none), all.saturating_sub(none));
        let story = format!("{none} without images, {one} with one, {all} with {images}");
        let (mark, about) = if added == 0 {
            (
                ProbeMark::Bad,
                "images are accepted, but add no tokens to the prompt: the server may drop them. Check its settings."
                    .to_owned(),
            )
        } else if added * 2 < each * u64::from(images) {
            (
                ProbeMark::Bad,
                format!(
                    "{story}: the server drops images, or cuts the prompt. Check its settings and its context."
                ),
            )
        } else {
            (ProbeMark::Ok, story)
        };
        self.drops_images = mark == ProbeMark::Bad;
        self.found("tokens of images", mark, about);
    }

    /// Whether the model reads the largest prompt of each memory from its first line.
    fn first_line(&mut self, requests: &[RunRequest<'_>]) {
        const WHAT: &str = "first line of the prompt";
        let most = self.report.run_sized.as_ref().map_or(0, |sized| sized.images);
        let mut missed = Vec::new();
        for request in requests {
            let RunRequest { memory, document_chars, .. } = request;
            let question = with_code_word((request.with)(request.images.min(most)));
            let reply = match self.try_once(&question) {
                TrialOutcome::Accepted(reply) => reply,
                TrialOutcome::Refused(problem) | TrialOutcome::Failed(problem) => {
                    let about = format!("the prompt of {memory} memory is not accepted: {problem}");
                    return self.found(WHAT, ProbeMark::Bad, about);
                }
            };
            let fewest = u64::from(*document_chars) / CHARACTERS_OF_A_TOKEN;
            if let Some(tokens) = reply.prompt_tokens.filter(|tokens| *tokens < fewest) {
                let about = format!(
                    "the prompt of {memory} memory has {document_chars} characters of documents, and the server counts {tokens} \
                     tokens: it cuts the prompt. Raise its context."
                );
                return self.found(WHAT, ProbeMark::Bad, about);
            }
            if !names(&reply, CODE_WORD) {
                missed.push(format!("{memory} memory ({:?})", short(reply.text())));
            }
        }
        let (mark, about) = if missed.is_empty() {
            (
                ProbeMark::Ok,
                "the model knows a word from the first line of the longest prompts".to_owned(),
            )
        } else {
            (
                ProbeMark::Doubtful,
                format!(
                    "asked for a word from the first line of a prompt of the run's size, the model does not know it with {}: \
                     the server may cut the beginning (raise its context), or the model be too small",
                    missed.join(" and ")
                ),
            )
        };
        self.found(WHAT, mark, about);
    }

    /// What a run does otherwise than the paper.
    fn compare(&mut self, requests: &[RunRequest<'_>]) {
        let settings = self.client.settings();
        let options = &settings.options;
        let refused = self.client.refused_fields();
        let asked = options.reasoning;
        let needed = requests.iter().map(|request| request.images).max().unwrap_or(0);
        let taken = self.report.run_sized.as_ref().map_or(0, |sized| sized.images);
        let temperature = match options.extra_body.get("temperature") {
            Some(value) => Some(value.to_string()),
            None => refused.contains(&"temperature").then(|| "the model's own".to_owned()),
        };
        let reasoning = match (asked, self.reasoned) {
            (ReasoningRequest::Off, Some(false)) => None,
            (ReasoningRequest::Off, Some(true)) => Some("on".to_owned()),
            (ReasoningRequest::Off, None) => Some("not known".to_owned()),
            (asked, _) => Some(asked.to_string()),
        };
        let role =
            (options.system_role != SystemRole::System).then(|| options.system_role.to_string());
        let extra = (!options.extra_body.is_empty())
            .then(|| serde_json::Value::Object(options.extra_body.clone()).to_string());
        let tokens =
            (self.answer_tokens != PAPER_TOKENS).then(|| format!("at most {}", self.answer_tokens));
        let images = match self.drops_images {
            true => Some("not all reach the model".to_owned()),
            false => (taken < needed).then(|| format!("at most {taken}")),
        };
        let rows = [
            ("temperature", "0", temperature),
            ("reasoning", "off", reasoning),
            ("tokens of an answer", "at most 30", tokens),
            ("images of a prompt", "at most 50", images),
            ("role of the rules", "system", role),
            ("further fields", "none", extra),
        ];
        let difference = |(setting, paper, here): (_, _, Option<String>)| {
            Some(PaperDifference { setting, paper, here: here? })
        };
        self.report.differences = Some(rows.into_iter().filter_map(difference).collect());
    }

    /// Whether the same question gets the same answer.
    fn temperature(&mut self) {
        let question = self.question("Name ten animals, with commas between them.");
        let answers = [0, 1].map(|_| self.ask(&question));
        let (mark, about) = match answers {
            _ if self.client.refused_fields().contains(&"temperature") => (
                ProbeMark::Doubtful,
                "the server refuses it, so the model's own is in force: a run will not repeat exactly. Ask for several \
                 repetitions (--runs)."
                    .to_owned(),
            ),
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
fn models(
    client: &HttpClient,
    timeout: Duration,
) -> Result<(Option<String>, ModelList), AttemptError> {
    let page = client.get(&client.endpoint().page("/models"), timeout)?;
    if page.status != 200 {
        let message = reply::error_message(&page.body, |text| client.endpoint().masked(text));
        return Ok((page.server, ModelList::Refused(page.status, message)));
    }
    let list = body::json(&page.body).unwrap_or_default();
    // Some servers send the list alone.
    let alone = list.as_array().filter(|models| !models.is_empty());
    let list = match list["data"].as_array().or(alone) {
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

const RED: [u8; 4] = [230, 20, 20, 255];
const BLUE: [u8; 4] = [20, 20, 230, 255];
const GREY: [u8; 4] = [128, 128, 128, 255];

/// The names of these colours in an answer, in order.
fn colours(answer: &str) -> Vec<&'static str> {
    let answer = answer.to_lowercase();
    let words = answer.split(|c: char| !c.is_alphanumeric());
    words.filter_map(|word| ["red", "blue"].into_iter().find(|colour| *colour == word)).collect()
}

/// Whether an answer has this word.
fn names(reply: &ChatReply, word: &str) -> bool {
    reply.text().to_lowercase().contains(word)
}

/// A square of `edge` pixels whose halves have these colours.
fn square(edge: u32, upper: [u8; 4], lower: [u8; 4]) -> ImageUrl {
    let row = |rgba: [u8; 4]| rgba.repeat(edge as usize);
    let (above, below) = (edge / 2, edge - edge / 2);
    let pixels = [row(upper).repeat(above as usize), row(lower).repeat(below as usize)].concat();
    let png = png_file::encode(edge, edge, png_file::Channels::Rgba, &pixels);
    ImageUrl::of_bytes("image/png", &png.unwrap_or_default())
}

/// A question about images.
fn about_images(text: &str, images: &[&ImageUrl], max_tokens: u32) -> ChatRequest {
    let images = images.iter().map(|image| ContentPart::ImageUrl { image_url: (*image).clone() });
    let parts = images.chain([ContentPart::Text { text: text.to_owned() }]).collect();
    let message = ChatMessage { role: ChatRole::User, content: MessageContent::Parts(parts) };
    ChatRequest { messages: vec![message], max_tokens, choices: Vec::new() }
}

/// The request with a word in the first line of its question, and the question for that word in its last one.
fn with_code_word(mut request: ChatRequest) -> ChatRequest {
    let first = format!("The code word is {CODE_WORD}.\n\n");
    let last = "\n\nDo not choose an action now. What is the code word in the first line? Answer with that word only.";
    request.choices.clear();
    if let Some(message) = request.messages.last_mut() {
        match &mut message.content {
            MessageContent::Text(text) => *text = format!("{first}{text}{last}"),
            MessageContent::Parts(parts) => {
                parts.insert(0, ContentPart::Text { text: first });
                parts.push(ContentPart::Text { text: last.to_owned() });
            }
        }
    }
    request
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
