//! What a server can do, found out by asking it: whether a run with it makes sense, before the run.
//!
//! Nothing here is a benchmark: the pictures are coloured squares and the questions are trivial.

mod picture;

use std::thread;
use std::time::{Duration, Instant};

use serde::Serialize;

use super::client::Client;
use super::error::{ChatError, Failure, Passing};
use super::fingerprint::{self, Fingerprint, Models};
use super::message::{Content, Message, Part, Question, Speaker};
use super::reply::{Outcome, Reply};
use picture::Colour;

/// Most images that one request of a run shows (SPEC section 5).
const MOST_IMAGES: u32 = 50;

/// Most tokens of an answer, as in a run.
const ANSWER_TOKENS: u32 = 30;

/// Most tokens of an answer whose time is taken.
const TIMED_TOKENS: u32 = 64;

/// How a thing is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Mark {
    /// As a run needs it.
    Ok,
    /// A run works, and its results may be worth less than they look.
    Doubtful,
    /// A run makes no sense before something is done about it.
    Bad,
}

/// One thing that was tried.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What.
    pub what: &'static str,
    /// How it is.
    pub mark: Mark,
    /// What was seen, and what to do where it is not as it should be.
    pub about: String,
}

/// How fast answers came.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Speed {
    /// Seconds for one request alone.
    pub alone_s: f64,
    /// Tokens of its answer, where the server counts them.
    pub alone_tokens: Option<u64>,
    /// How many requests were then sent at once.
    pub together: u32,
    /// Seconds until the last of them was answered.
    pub together_s: f64,
    /// Tokens of all their answers.
    pub together_tokens: Option<u64>,
}

/// All that was found out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Where requests went.
    pub endpoint: String,
    /// The model that was asked for.
    pub model: String,
    /// In the order in which it was tried; what makes no sense after a failure was not.
    pub findings: Vec<Finding>,
    /// Most images that a request may show, up to the 50 that a run can need; `None` when that is not known.
    pub images_per_request: Option<u32>,
    /// How fast it is.
    pub speed: Option<Speed>,
    /// Who serves.
    pub fingerprint: Fingerprint,
    /// The model by the name that its answers bear.
    pub reported_model: Option<String>,
    /// What the server calls the configuration that answered.
    pub system_fingerprint: Option<String>,
}

impl Report {
    /// The worst of its marks.
    pub fn worst(&self) -> Mark {
        self.findings.iter().map(|finding| finding.mark).max().unwrap_or(Mark::Ok)
    }
}

/// Finds out what the server can do, with `together` requests at once where several are sent. Takes some thirty
/// short requests.
pub fn run(client: &Client, together: u32) -> Report {
    let mut probe = Probe {
        client,
        report: Report {
            endpoint: client.endpoint().to_string(),
            model: client.settings().model.clone(),
            findings: Vec::new(),
            images_per_request: None,
            speed: None,
            fingerprint: Fingerprint::default(),
            reported_model: None,
            system_fingerprint: None,
        },
    };
    if probe.reach() && probe.answer() {
        probe.images();
        probe.temperature();
        probe.speed(together.max(1));
        fingerprint::read_pages(client, &mut probe.report.fingerprint);
    }
    probe.report
}

struct Probe<'a> {
    client: &'a Client,
    report: Report,
}

/// What a server does about a number of images.
enum Shown {
    Taken(Reply),
    Refused(String),
    Unknown(String),
}

impl Probe<'_> {
    fn found(&mut self, what: &'static str, mark: Mark, about: impl Into<String>) {
        self.report.findings.push(Finding { what, mark, about: about.into() });
    }

    /// Whether somebody is there, and knows the model.
    fn reach(&mut self) -> bool {
        let start = Instant::now();
        let (fingerprint, models) = match fingerprint::models(self.client) {
            Ok(found) => found,
            Err(problem) => {
                let endpoint = &self.report.endpoint;
                let about = format!(
                    "nobody answers for {endpoint}: {problem} Start the server, or correct --base-url."
                );
                self.found("reachable", Mark::Bad, about);
                return false;
            }
        };
        let elapsed = start.elapsed().as_secs_f64();
        let server = fingerprint.server.clone().unwrap_or_else(|| "no name".to_owned());
        self.report.fingerprint = fingerprint;
        let about = format!("the list of models came after {elapsed:.2} s (server: {server})");
        self.found("reachable", Mark::Ok, about);
        let model = &self.report.model;
        let (mark, about) = match models {
            Models::Listed(names) if names.contains(model) => {
                (Mark::Ok, format!("{model} is in the server's list of {}", names.len()))
            }
            Models::Listed(names) => (
                Mark::Doubtful,
                format!(
                    "{model} is not in the server's list; it has {}. Some servers answer all the same; if \
                     this one does not, pass one of these with --model.",
                    listing(&names)
                ),
            ),
            Models::Refused(401 | 403, message) => (
                Mark::Doubtful,
                format!(
                    "the server does not show its list: {message}. Set OPENAI_API_KEY, or check it."
                ),
            ),
            Models::Refused(status, message) => (
                Mark::Ok,
                format!("the server has no list to look in (status {status}: {message})"),
            ),
            Models::Unreadable => (Mark::Ok, "the server has no list to look in".to_owned()),
        };
        self.found("model", mark, about);
        true
    }

    /// Whether it answers as a run needs it: at all, without reasoning, within a few tokens.
    fn answer(&mut self) -> bool {
        let question = text("What is 17 + 25? Answer with the number only.", ANSWER_TOKENS);
        let reply = match self.client.ask(&question) {
            Ok(reply) => reply,
            Err(error) => {
                self.found("answers", Mark::Bad, error.to_string());
                return false;
            }
        };
        let Reply { outcome, reasoned, completion_tokens, .. } = reply;
        self.report.reported_model = reply.model;
        self.report.system_fingerprint = reply.system_fingerprint;
        let tokens = completion_tokens.map_or_else(String::new, |n| format!(" in {n} tokens"));
        let (mark, about) = match &outcome {
            Outcome::Text(text) => (Mark::Ok, format!("{:?}{tokens} to 17 + 25", short(text))),
            Outcome::Length(text) => (
                Mark::Doubtful,
                format!("more than {ANSWER_TOKENS} tokens to 17 + 25: {:?}", short(text)),
            ),
            Outcome::Refusal(text) => {
                (Mark::Bad, format!("it refuses to say what 17 + 25 is: {:?}", short(text)))
            }
            Outcome::Empty => (
                Mark::Bad,
                format!("nothing{tokens} to 17 + 25: see which chat template the server uses."),
            ),
        };
        self.found("answers", mark, about);
        let (mark, about) = if reasoned {
            (
                Mark::Bad,
                "the model reasons although every request asks it not to, and has few tokens for its answer: \
                 turn reasoning off at the server, or serve a variant that does not reason."
                    .to_owned(),
            )
        } else {
            (Mark::Ok, "the answer came without reasoning".to_owned())
        };
        self.found("reasoning off", mark, about);
        true
    }

    /// Whether it takes images and sees them, and how many at once.
    fn images(&mut self) {
        let mut seen = Vec::new();
        let mut one = None;
        for colour in [Colour::Red, Colour::Blue] {
            let reply = match self.show(colour, 1) {
                Shown::Taken(reply) => reply,
                Shown::Refused(message) => {
                    self.report.images_per_request = Some(0);
                    let about = format!(
                        "the server takes none: {message}. Serve a model that sees (for llama.cpp with its \
                         --mmproj file), or run with --image-budget 0."
                    );
                    return self.found("images", Mark::Bad, about);
                }
                Shown::Unknown(problem) => {
                    let about = format!("could not be found out: {problem}");
                    return self.found("images", Mark::Bad, about);
                }
            };
            let said = said(&reply.outcome).to_owned();
            seen.push((said.to_lowercase().contains(colour.word()), colour, said));
            one = Some(reply);
        }
        let story: Vec<String> = seen
            .iter()
            .map(|(_, colour, said)| format!("{:?} to a {} square", short(said), colour.word()))
            .collect();
        let story = story.join(", ");
        if seen.iter().all(|(right, ..)| *right) {
            self.found("images", Mark::Ok, story);
        } else {
            let about = format!("{story}: the model may be too small, or not see what it is sent.");
            self.found("images", Mark::Doubtful, about);
        }
        self.count(one.and_then(|reply| reply.prompt_tokens));
    }

    /// How many images a request may show. `one` is what a request with one cost.
    fn count(&mut self, one: Option<u64>) {
        const WHAT: &str = "images per request";
        let (mut taken, mut refused, mut message) = (1, MOST_IMAGES + 1, String::new());
        let mut most = None;
        while refused - taken > 1 {
            // Most servers that take many take all.
            let number = if refused > MOST_IMAGES { MOST_IMAGES } else { taken.midpoint(refused) };
            match self.show(Colour::Red, number) {
                Shown::Taken(reply) => (taken, most) = (number, reply.prompt_tokens),
                Shown::Refused(why) => (refused, message) = (number, why),
                Shown::Unknown(problem) => {
                    let about = format!(
                        "at least {taken}; with {number} it could not be found out: {problem} Run with \
                         --image-budget {taken}, or give the server more room or time."
                    );
                    return self.found(WHAT, Mark::Doubtful, about);
                }
            }
        }
        self.report.images_per_request = Some(taken);
        // Whatever an image costs, it is a token or more.
        let dropped = one.zip(most).is_some_and(|(one, most)| most < one + u64::from(taken) - 1);
        let (mark, about) = if dropped {
            let about = format!(
                "{taken} are accepted, but the server counts hardly more tokens than for one: it may drop some \
                 without a word. Look at its settings before you trust a run."
            );
            (Mark::Doubtful, about)
        } else if taken == MOST_IMAGES {
            (Mark::Ok, format!("{taken} at least, which is what a run can need"))
        } else {
            let about = format!(
                "{taken}; {refused} are refused: {message}. Raise the server's bound (vLLM: \
                 --limit-mm-per-prompt '{{\"image\": {MOST_IMAGES}}}') or its context, or run with \
                 --image-budget {taken}."
            );
            (Mark::Doubtful, about)
        };
        self.found(WHAT, mark, about);
    }

    /// Shows `number` squares, once: a refusal is an answer here. A server that fails otherwise is asked again.
    fn show(&self, colour: Colour, number: u32) -> Shown {
        let image = match colour.picture() {
            Ok(image_url) => Part::ImageUrl { image_url },
            Err(problem) => return Shown::Unknown(problem),
        };
        let mut parts = vec![image; number as usize];
        let text = "What colour is the square? Answer with one word.";
        parts.push(Part::Text { text: text.to_owned() });
        let message = Message { role: Speaker::User, content: Content::Parts(parts) };
        let question = Question { messages: vec![message], max_tokens: ANSWER_TOKENS };
        let refused = |message: String| Shown::Refused(message.trim_end_matches('.').to_owned());
        match self.client.attempt(&question) {
            Ok(reply) => Shown::Taken(reply),
            Err(Failure::Final(ChatError::Refused { message, .. })) => refused(message),
            // Some servers say so that they do not know what an image is.
            Err(Failure::Passing(Passing::Status { status: 500 | 501, message }, _)) => {
                refused(message)
            }
            Err(Failure::Final(error)) => Shown::Unknown(error.to_string()),
            Err(Failure::Passing(..)) => match self.client.ask(&question) {
                Ok(reply) => Shown::Taken(reply),
                Err(ChatError::Refused { message, .. }) => refused(message),
                Err(error) => Shown::Unknown(error.to_string()),
            },
        }
    }

    /// Whether the same question has the same answer.
    fn temperature(&mut self) {
        let question = text("Name ten animals, with commas between them.", ANSWER_TOKENS);
        let [first, second] = [0, 1].map(|_| self.client.ask(&question));
        let (mark, about) = match (first, second) {
            (Ok(first), Ok(second)) if first.outcome == second.outcome => {
                (Mark::Ok, "the same question had the same answer twice".to_owned())
            }
            (Ok(first), Ok(second)) => (
                Mark::Doubtful,
                format!(
                    "the same question had two answers, {:?} and {:?}: a run will not repeat exactly. Ask for \
                     several repetitions (--runs), or see whether the server can be made deterministic.",
                    short(said(&first.outcome)),
                    short(said(&second.outcome)),
                ),
            ),
            (Err(error), _) | (_, Err(error)) => (Mark::Bad, error.to_string()),
        };
        self.found("temperature 0", mark, about);
    }

    /// How fast it is, alone and with `together` requests at once.
    fn speed(&mut self, together: u32) {
        const WHAT: &str = "speed";
        let start = Instant::now();
        let alone = match self.client.ask(&counting(0)) {
            Ok(reply) => reply.completion_tokens,
            Err(error) => return self.found(WHAT, Mark::Bad, error.to_string()),
        };
        let alone_s = start.elapsed().as_secs_f64();
        let (start, client) = (Instant::now(), self.client);
        let replies = thread::scope(|scope| {
            let asking: Vec<_> = (1..=together)
                .map(|number| scope.spawn(move || client.ask(&counting(number))))
                .collect();
            let replies = asking.into_iter().map(|asking| asking.join().ok());
            replies.collect::<Option<Result<Vec<_>, _>>>()
        });
        let together_s = start.elapsed().as_secs_f64();
        let replies = match replies {
            Some(Ok(replies)) => replies,
            Some(Err(error)) => {
                let about = format!(
                    "{together} requests at once are too many for it: {error}. Run with fewer --max-connections."
                );
                return self.found(WHAT, Mark::Doubtful, about);
            }
            None => return self.found(WHAT, Mark::Bad, "the requests could not be sent"),
        };
        let together_tokens = replies.iter().map(|reply| reply.completion_tokens).sum();
        let speed = Speed { alone_s, alone_tokens: alone, together, together_s, together_tokens };
        self.found(WHAT, Mark::Ok, speed.to_string());
        self.report.speed = Some(speed);
    }
}

impl std::fmt::Display for Speed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { alone_s, alone_tokens, together, together_s, together_tokens } = self;
        let rate = |tokens: &Option<u64>, seconds: &f64| match tokens {
            Some(tokens) if *seconds > 0.0 => {
                format!(" for {tokens} tokens ({:.0} a second)", *tokens as f64 / seconds)
            }
            _ => String::new(),
        };
        write!(f, "alone {alone_s:.2} s{}", rate(alone_tokens, alone_s))?;
        write!(f, "; {together} at once {together_s:.2} s{}", rate(together_tokens, together_s))
    }
}

fn text(text: &str, max_tokens: u32) -> Question {
    Question { messages: vec![Message::text(Speaker::User, text)], max_tokens }
}

/// Something to say for a while; each number begins in its own way, so that no prefix is known.
fn counting(number: u32) -> Question {
    text(&format!("{number}: count upwards from here in words, as far as you can."), TIMED_TOKENS)
}

fn said(outcome: &Outcome) -> &str {
    match outcome {
        Outcome::Text(text) | Outcome::Length(text) | Outcome::Refusal(text) => text,
        Outcome::Empty => "",
    }
}

/// The beginning of a model's words.
fn short(text: &str) -> String {
    const MOST: usize = 60;
    let mut begun: String = text.chars().take(MOST).collect();
    if begun.len() < text.len() {
        begun.push_str("...");
    }
    begun
}

/// The first few of the server's models.
fn listing(names: &[String]) -> String {
    const MOST: usize = 5;
    match names.len() {
        0 => "none".to_owned(),
        n if n > MOST => format!("{} and {} more", names[..MOST].join(", "), n - MOST),
        _ => names.join(", "),
    }
}

/// The patience of a probe: a request more than one in a run, and not so long.
pub const TIMEOUT: Duration = Duration::from_secs(60);

#[cfg(test)]
mod tests;
