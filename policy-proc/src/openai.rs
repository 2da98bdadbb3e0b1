//! The `openai` policy: a vision-language model behind an OpenAI-compatible endpoint.
//!
//! Each request becomes a prompt ([`crate::prompt`]) with its images encoded (`images`), and goes to the pool
//! ([`crate::chat`]), which asks when there is room and calls back when there is a reply. What the model wrote
//! is read, what it cost is written down (`usage`), and that is the decision. Nothing is kept from one request
//! to the next but encoded images.
//!
//! A reply is the model's doing, whatever it says. That there is none never is: a request that fails for good
//! ends its episode without a result, and a server that is gone stops the run.

mod images;
mod usage;

use domain::prompt_log::{Exchange, Message, Part, hex};
use shm_types::process::monotonic_ns;

use crate::chat::{Asked, Job, Outcome, Pool, PoolError, Question, Reply};
use crate::prompt::answer::{Unread, read_answer, read_cut_off};
use crate::prompt::{self, PartContent, Prompt};
use crate::{Answer, Answers, Decider, Decision, Request, RequestId, ServeError, Usage};
use images::Images;
use usage::Shares;

pub use images::{ImageFormat, JPEG_QUALITY, UnknownFormat};

/// What decides how a model is asked, beside its server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// The model, by the name that the server knows it by.
    pub model: String,
    /// Where it is asked, for the manifest. Without a key.
    pub endpoint: String,
    /// How images are encoded.
    pub image_format: ImageFormat,
    /// Most images of a prompt; 0 for a model that reads text alone.
    pub image_budget: u32,
    /// Most tokens of an answer.
    pub answer_tokens: u32,
}

/// Asks a model what to do. What it is asked, and how its answers are read: docs/prompt.md.
#[derive(Debug)]
pub struct Openai {
    pool: Pool,
    settings: Settings,
    images: Images,
}

impl Openai {
    /// A policy that asks through `pool`.
    pub fn new(pool: Pool, settings: Settings) -> Self {
        let images = Images::new(settings.image_format);
        Self { pool, settings, images }
    }
}

impl Decider for Openai {
    fn name(&self) -> &str {
        "openai"
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        let Settings { model, endpoint, image_format, image_budget, answer_tokens } =
            &self.settings;
        vec![
            ("model", model.clone()),
            ("endpoint", endpoint.clone()),
            ("prompt", prompt::version().to_owned()),
            // There is little room for facts, and so many digits tell any two templates apart.
            ("prompt_sha256", prompt::template_sha256()[..16].to_owned()),
            ("image_format", image_format.described()),
            ("image_budget", image_budget.to_string()),
            ("answer_tokens", answer_tokens.to_string()),
            ("temperature", "0".to_owned()),
            ("reasoning", "off".to_owned()),
        ]
    }

    fn take(&mut self, batch: &[Request<'_>], answers: &Answers) -> Result<(), ServeError> {
        let budget = self.settings.image_budget;
        let prompts: Vec<_> = batch.iter().map(|request| Prompt::new(request, budget)).collect();
        let urls = self.images.urls(prompts.iter().flat_map(Prompt::views));
        for (request, prompt) in batch.iter().zip(prompts) {
            let ticket = request.id();
            if let Some(view) = prompt.views().find(|view| !urls.contains_key(&view.content_hash)) {
                answers.fail(ticket, format!("{view:?} cannot be encoded as an image"));
                continue;
            }
            let messages = prompt.messages(|view| urls[&view.content_hash].clone());
            let question =
                Question { messages: messages.into(), max_tokens: self.settings.answer_tokens };
            let pending = Pending {
                ticket,
                images: prompt.images_sent(),
                shares: Shares::of(request, &prompt),
                prompted_ns: monotonic_ns(),
                // For the prompt log; nothing is copied where there is none.
                exchange: answers.logs_prompts().then(|| exchange(&prompt)),
                answers: answers.clone(),
            };
            self.pool
                .submit(Job { question, repeat: request.repeat }, |asked| pending.finish(asked));
        }
        Ok(())
    }
}

/// A request that the pool has.
struct Pending {
    ticket: RequestId,
    /// Images that are sent.
    images: u32,
    shares: Shares,
    prompted_ns: u64,
    exchange: Option<Exchange>,
    answers: Answers,
}

impl Pending {
    fn finish(self, asked: Result<Asked, PoolError>) {
        let Self { ticket, images, shares, prompted_ns, exchange, answers } = self;
        let record = |reply: Option<&Reply>, unread: Option<String>| {
            if let Some(exchange) = exchange {
                let reply = reply.map(said);
                answers.record(ticket, || Exchange { reply, unread, ..exchange });
            }
        };
        let Asked { reply, attempts, from_cache, sent_ns, .. } = match asked {
            Ok(asked) => asked,
            Err(PoolError::Failed(error)) => {
                record(None, None);
                return answers.fail(ticket, error.to_string());
            }
            Err(PoolError::Gone(why)) => return answers.halt(why),
        };
        let answer = match judge(&reply) {
            Ok(action) => {
                record(Some(&reply), None);
                Answer::Act(action)
            }
            Err(why) => {
                record(Some(&reply), Some(why.to_string()));
                let RequestId { lane, step, .. } = ticket;
                tracing::debug!(lane, step, %why, "the answer is none: {:?}", reply.outcome);
                why.answer()
            }
        };
        let told = |count: Option<u64>| count.map(|count| count.try_into().unwrap_or(u32::MAX - 1));
        let (prompt_tokens, image_tokens) = (told(reply.prompt_tokens), told(reply.image_tokens));
        let usage = Usage {
            prompt_tokens,
            completion_tokens: told(reply.completion_tokens),
            cached_tokens: told(reply.cached_tokens),
            image_tokens,
            memory_tokens: shares.memory_tokens(prompt_tokens, image_tokens),
            attempts,
            replayed: from_cache,
            prompted_ns,
            sent_ns: if from_cache { 0 } else { sent_ns },
        };
        answers.decide(ticket, Decision { answer, images, usage: Some(usage) });
    }
}

/// What the prompt log has of a prompt.
fn exchange(prompt: &Prompt<'_>) -> Exchange {
    let user = prompt.parts.iter().map(|part| match &part.content {
        PartContent::Text(text) => Part::Text(text.clone()),
        PartContent::View(view) => Part::Image(hex(view.content_hash)),
    });
    let message = |role: &str, parts| Message { role: role.to_owned(), parts };
    Exchange {
        messages: vec![
            message("system", vec![Part::Text(prompt.system.to_owned())]),
            message("user", user.collect()),
        ],
        ..Exchange::default()
    }
}

/// The text of a reply, as it came.
fn said(reply: &Reply) -> String {
    match &reply.outcome {
        Outcome::Text(text) | Outcome::Length(text) | Outcome::Refusal(text) => text.clone(),
        Outcome::Empty => String::new(),
    }
}

/// The action that a reply names.
///
/// # Errors
/// When it names none; the error says why.
pub fn judge(reply: &Reply) -> Result<domain::Action, Unread> {
    match &reply.outcome {
        Outcome::Text(text) => read_answer(text),
        Outcome::Length(text) => read_cut_off(text),
        Outcome::Empty => Err(Unread::Empty),
        Outcome::Refusal(_) => Err(Unread::Refused),
    }
}
