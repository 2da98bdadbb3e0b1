//! The `openai` policy: a vision-language model behind an OpenAI-compatible endpoint.
//!
//! Each request becomes a prompt with encoded images (`images`) and goes to the chat client, which calls back with the
//! reply. The action is read from the reply, its cost is recorded (`usage`), and that is the decision. Nothing is kept
//! between requests but encoded images, and of each running episode its token counts and its last prompt (`reuse`).
//!
//! Every reply counts as the model's decision. A missing reply does not: a request that fails for good ends its episode
//! without a result, and a server that is gone stops the run.

mod images;
mod in_force;
pub mod largest;
mod reuse;
mod usage;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use domain::ImageFormat;
use domain::hex;
use domain::prompt_log::{RecordedExchange, RecordedMessage, RecordedPart};
use llm::{
    AskError, ChatAnswer, ChatClient, ChatMessage, ChatReply, ChatRequest, ChatRole, ContentPart,
    ImageUrl, MessageContent, ReplyContent,
};
use peer::{
    ActionCode, Answer, Answers, Batch, Decider, Decision, FrameView, RequestId, ServeError, Usage,
    WorldDeclaration,
};

use prompt::image::described;
use prompt::{PartContent, Prompt, Template, UnreadAnswer, read_answer, read_cut_off_answer};
use shm_types::process::monotonic_ns;

use images::EncodedViews;
use in_force::InForce;
use reuse::EarlierPrompt;
use usage::{PromptSize, TokenFit};

/// The settings that determine a model's answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OpenaiSettings {
    /// How images are encoded.
    pub image_format: ImageFormat,
    /// Maximum number of images of a prompt; 0 for a model without vision.
    pub image_budget: u32,
    /// Maximum number of tokens of an answer.
    pub answer_tokens: u32,
}

/// Asks a model for an action. docs/prompt.md describes the prompt and how answers are read.
#[derive(Debug)]
pub struct Openai {
    client: ChatClient,
    template: Arc<Template>,
    settings: OpenaiSettings,
    images: EncodedViews,
    token_fits: TokenFits,
    in_force: Arc<Mutex<InForce>>,
    /// The last prompt of each lane's episode.
    earlier: HashMap<u32, (u64, EarlierPrompt)>,
    /// Reports that the server is waited for: the channel of the latest batch.
    answers: Arc<Mutex<Option<Answers>>>,
}

/// The token fit of each lane's episode.
type TokenFits = Arc<Mutex<HashMap<u32, (u64, TokenFit)>>>;

impl Openai {
    /// Creates a policy that asks through `client` in the words of `template`.
    pub fn new(client: ChatClient, template: Arc<Template>, settings: OpenaiSettings) -> Self {
        let images = EncodedViews::new(settings.image_format);
        let answers = Arc::<Mutex<Option<Answers>>>::default();
        let latest = Arc::clone(&answers);
        client.on_waiting(move |reason| {
            if let Some(answers) = &*latest.lock().unwrap_or_else(PoisonError::into_inner) {
                answers.waiting(reason.unwrap_or_default());
            }
        });
        let (token_fits, earlier) = (TokenFits::default(), HashMap::new());
        let options = &client.settings().options;
        let temperature = options.extra_body.get("temperature");
        let temperature = temperature.map_or_else(|| "0".to_owned(), ToString::to_string);
        let in_force = Arc::new(Mutex::new(InForce::new(options.reasoning, temperature)));
        Self { client, template, settings, images, token_fits, in_force, earlier, answers }
    }

    /// The server's address; of several the first one's and their number, since there is little room for facts.
    fn endpoint(&self) -> String {
        let mut endpoints = self.client.endpoints();
        let first = endpoints.next().map(ToString::to_string).unwrap_or_default();
        match endpoints.count() {
            0 => first,
            more => format!("{first} and {more} more"),
        }
    }
}

impl Drop for Openai {
    fn drop(&mut self) {
        self.client.stop("the policy has ended");
    }
}

impl Decider for Openai {
    fn name(&self) -> &str {
        "openai"
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        let OpenaiSettings { image_format, image_budget, answer_tokens } = &self.settings;
        vec![
            ("model", self.client.settings().model.clone()),
            ("endpoint", self.endpoint()),
            ("prompt", self.template.version().to_owned()),
            // There is little room for facts, and 16 digits tell any two templates apart.
            ("prompt_hash", self.template.hash()[..16].to_owned()),
            ("image_format", described(*image_format)),
            ("image_budget", image_budget.to_string()),
            ("answer_tokens", answer_tokens.to_string()),
        ]
    }

    fn take(&mut self, batch: &Batch<'_>, answers: &Answers) -> Result<(), ServeError> {
        *self.answers.lock().unwrap_or_else(PoisonError::into_inner) = Some(answers.clone());
        let budget = self.settings.image_budget;
        let prompt = |request| Prompt::new(&self.template, request, budget);
        let prompts: Vec<_> = batch.iter().map(prompt).collect();
        let urls = self.images.urls(prompts.iter().flat_map(Prompt::views));
        for (request, prompt) in batch.iter().zip(prompts) {
            let id = request.id();
            if let Some(view) = prompt.views().find(|view| !urls.contains_key(&view.content_hash)) {
                answers.fail(id, format!("{view:?} cannot be encoded as an image"));
                continue;
            }
            let now = (id.episode, EarlierPrompt::new(&prompt));
            let earlier = self.earlier.insert(id.lane, now);
            let earlier = earlier.filter(|(episode, _)| *episode == id.episode);
            let pending = PendingRequest {
                id,
                images: prompt.images_sent(),
                size: PromptSize::of(request, &prompt, earlier.as_ref().map(|(_, prompt)| prompt)),
                token_fits: Arc::clone(&self.token_fits),
                in_force: Arc::clone(&self.in_force),
                client: self.client.clone(),
                prompted_ns: monotonic_ns(),
                exchange: answers.logs_prompts().then(|| exchange(&prompt)),
                answers: answers.clone(),
                world: Arc::clone(request.world),
            };
            let chat = chat_request(request.world, &prompt, self.settings.answer_tokens, |view| {
                Arc::clone(&urls[&view.content_hash])
            });
            self.client.submit(chat, request.repeat, |answered| pending.finish(answered));
        }
        Ok(())
    }
}

/// The chat request for a prompt, with `url` as the address of each image.
fn chat_request<'a>(
    world: &WorldDeclaration,
    prompt: &Prompt<'a>,
    max_tokens: u32,
    url: impl Fn(&FrameView<'a>) -> Arc<str>,
) -> ChatRequest {
    let parts = prompt.parts.iter().map(|part| match &part.content {
        PartContent::Text(text) => ContentPart::Text { text: text.clone() },
        PartContent::View(view) => ContentPart::ImageUrl { image_url: ImageUrl { url: url(view) } },
    });
    let content = if prompt.images_sent() == 0 {
        // Servers of models without vision may accept nothing but plain text.
        let text = |part| match part {
            ContentPart::Text { text } => text,
            ContentPart::ImageUrl { .. } => String::new(),
        };
        MessageContent::Text(parts.map(text).collect())
    } else {
        MessageContent::Parts(parts.collect())
    };
    ChatRequest {
        messages: vec![
            ChatMessage::text(ChatRole::System, &prompt.system),
            ChatMessage { role: ChatRole::User, content },
        ],
        max_tokens,
        choices: prompt::answer_choices(world).into_iter().map(str::to_owned).collect(),
    }
}

/// A request that waits for its reply.
struct PendingRequest {
    id: RequestId,
    /// Images that are sent.
    images: u32,
    size: PromptSize,
    token_fits: TokenFits,
    in_force: Arc<Mutex<InForce>>,
    client: ChatClient,
    prompted_ns: u64,
    /// For the prompt log, where there is one.
    exchange: Option<RecordedExchange>,
    answers: Answers,
    /// What the world says of itself.
    world: Arc<WorldDeclaration>,
}

impl PendingRequest {
    fn finish(mut self, answered: Result<ChatAnswer, AskError>) {
        let id = self.id;
        let answered = match answered {
            Ok(answered) => answered,
            Err(AskError::Failed(error)) => {
                self.record(None, None);
                return self.answers.fail(id, error.to_string());
            }
            Err(AskError::Stopped(why)) => return self.answers.stop_run(why),
        };
        let read = read_reply(&self.world, &answered.reply);
        self.report_facts(&answered.reply);
        self.record(Some(&answered.reply), read.err());
        let answer = read.map_or_else(UnreadAnswer::answer, Answer::Act);
        let usage = Some(self.usage(&answered));
        self.answers.decide(id, Decision { answer, images: self.images, usage });
    }

    /// Reports what is in force if this reply is the first that shows it.
    fn report_facts(&self, reply: &ChatReply) {
        let refused = self.client.refused_fields();
        let mut in_force = self.in_force.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(facts) = in_force.add(reply, refused) {
            // Under the lock, so that the latest facts are reported last.
            self.answers.learned(facts);
        }
    }

    fn record(&mut self, reply: Option<&ChatReply>, unread: Option<UnreadAnswer>) {
        if let Some(exchange) = self.exchange.take() {
            let reply = reply.map(|reply| reply.text().to_owned());
            let unread = unread.map(|unread| unread.to_string());
            self.answers.record(self.id, || RecordedExchange { reply, unread, ..exchange });
        }
    }

    fn usage(&self, answered: &ChatAnswer) -> Usage {
        // The highest value on the wire means that the count is unknown.
        let count =
            |count: Option<u64>| count.map(|count| count.try_into().unwrap_or(u32::MAX - 1));
        let ChatAnswer { reply, attempts, from_cache, sent_ns, .. } = answered;
        let (prompt_tokens, image_tokens) = (count(reply.prompt_tokens), count(reply.image_tokens));
        let mut fits = self.token_fits.lock().unwrap_or_else(PoisonError::into_inner);
        let RequestId { lane, episode, .. } = self.id;
        let (fitted, fit) = fits.entry(lane).or_default();
        if *fitted != episode {
            (*fitted, *fit) = (episode, TokenFit::default());
        }
        let parts = fit.parts(self.size, prompt_tokens, image_tokens);
        Usage {
            prompt_tokens,
            completion_tokens: count(reply.completion_tokens),
            cached_tokens: count(reply.cached_tokens),
            image_tokens,
            memory_tokens: parts.map(|parts| parts.memory),
            reusable_tokens: parts.map(|parts| parts.reusable),
            attempts: *attempts,
            replayed: *from_cache,
            prompted_ns: self.prompted_ns,
            sent_ns: if *from_cache { 0 } else { *sent_ns },
            finish_reason: reply.finish_reason.clone(),
            reasoned: Some(reply.reasoned),
            model: reply.model.clone(),
        }
    }
}

/// A prompt as the prompt log stores it.
fn exchange(prompt: &Prompt<'_>) -> RecordedExchange {
    let user = prompt.parts.iter().map(|part| match &part.content {
        PartContent::Text(text) => RecordedPart::Text(text.clone()),
        PartContent::View(view) => RecordedPart::Image(hex(&view.content_hash)),
    });
    let message = |role: &str, parts| RecordedMessage { role: role.to_owned(), parts };
    RecordedExchange {
        messages: vec![
            message("system", vec![RecordedPart::Text(prompt.system.clone())]),
            message("user", user.collect()),
        ],
        ..RecordedExchange::default()
    }
}

/// The action that a reply names.
fn read_reply(world: &WorldDeclaration, reply: &ChatReply) -> Result<ActionCode, UnreadAnswer> {
    match &reply.content {
        ReplyContent::Text(text) => read_answer(world, text),
        ReplyContent::Length(text) => read_cut_off_answer(world, text),
        ReplyContent::Empty => Err(UnreadAnswer::Empty),
        ReplyContent::Refusal(_) => Err(UnreadAnswer::Refused),
    }
}
