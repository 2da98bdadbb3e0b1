//! How a document is built: the builder, and everything in it that determines the text.

use domain::{ImageFormat, ReasoningRequest, SystemRole};

use crate::{DocumentName, sha256_of_parts};

/// The version of the extractive builder. Changes whenever the same demonstrations give another text.
pub const EXTRACTIVE_VERSION: u32 = 2;

/// The version of the prompts that the model builder sends. Changes whenever one of them does.
pub const PROMPT_VERSION: u32 = 2;

/// How a document is built.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Recipe {
    /// By rules, without a model.
    Extractive,
    /// By asking a model.
    Model(ModelRecipe),
}

/// How a model is asked for a document.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelRecipe {
    /// The model, by the name that the server knows it by.
    pub model: String,
    /// Maximum number of characters in a prompt.
    pub context_chars: usize,
    /// Maximum number of tokens in an answer, and so in the document.
    pub max_tokens: u32,
    /// Maximum number of views of each demonstration that are shown; 0 for a model that reads text only.
    pub views: u32,
    /// Maximum number of images in a prompt.
    pub image_budget: u32,
    /// What requests say about reasoning.
    pub reasoning: ReasoningRequest,
    /// How the rules are sent.
    pub system_role: SystemRole,
    /// Further fields of the requests: a JSON object, as it was given.
    pub extra_body: Option<String>,
    /// How images are encoded.
    pub image_format: ImageFormat,
}

impl ModelRecipe {
    /// The default of `context_chars`: about 40,000 tokens.
    pub const CONTEXT_CHARS: usize = 100_000;
    /// The default of `max_tokens`; the paper's summaries have about 13,000.
    pub const MAX_TOKENS: u32 = 16_000;
    /// The default of `views`: start, end, sub-goals and some turns of a demonstration.
    pub const VIEWS: u32 = 8;
    /// The default of `image_budget`: the paper's.
    pub const IMAGE_BUDGET: u32 = 50;

    /// The defaults, for `model`.
    pub fn new(model: impl Into<String>) -> Self {
        Self {
            model: model.into(),
            context_chars: Self::CONTEXT_CHARS,
            max_tokens: Self::MAX_TOKENS,
            views: Self::VIEWS,
            image_budget: Self::IMAGE_BUDGET,
            reasoning: ReasoningRequest::Off,
            system_role: SystemRole::System,
            extra_body: None,
            image_format: ImageFormat::Png,
        }
    }

    /// Maximum number of views of each demonstration, all of which have to fit into a prompt.
    pub fn views_each(&self) -> usize {
        self.views.min(self.image_budget) as usize
    }

    /// Everything in it that determines the text, in words: what requests are by default is not named.
    fn version(&self) -> String {
        let Self {
            model,
            context_chars,
            max_tokens,
            views,
            image_budget,
            reasoning,
            system_role,
            extra_body,
            image_format,
        } = self;
        let mut words = format!(
            "prompts {PROMPT_VERSION}, model {model}, {context_chars} characters to {max_tokens} tokens, {views} views of \
             each demonstration, {image_budget} images"
        );
        if *reasoning != ReasoningRequest::Off {
            words += &format!(", reasoning {reasoning}");
        }
        if *system_role != SystemRole::System {
            words += &format!(", system role {system_role}");
        }
        if *image_format != ImageFormat::Png {
            words += &format!(", images {image_format}");
        }
        if let Some(fields) = extra_body {
            words += &format!(", fields {fields}");
        }
        words
    }
}

impl Recipe {
    /// The builder's name.
    pub fn builder(&self) -> &'static str {
        match self {
            Self::Extractive => "extractive",
            Self::Model(_) => "model",
        }
    }

    /// Everything else that determines the text, in words.
    pub fn version(&self) -> String {
        match self {
            Self::Extractive => EXTRACTIVE_VERSION.to_string(),
            Self::Model(recipe) => recipe.version(),
        }
    }

    /// The address of the document that this recipe makes of sources with the hash `sources_sha256`.
    pub fn address(&self, name: DocumentName, sources_sha256: &str) -> String {
        address(name, self.builder(), &self.version(), sources_sha256)
    }
}

/// The first 12 hexadecimal digits of the SHA-256 over everything that a document depends on.
pub(crate) fn address(
    name: DocumentName,
    builder: &str,
    builder_version: &str,
    sources_sha256: &str,
) -> String {
    let mut digits = sha256_of_parts([
        "memtransfer document v1",
        &name.to_string(),
        builder,
        builder_version,
        sources_sha256,
    ]);
    digits.truncate(12);
    digits
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_that_a_document_depends_on_changes_its_address() {
        let name = |text: &str| text.parse::<DocumentName>().unwrap();
        let model = |change: fn(&mut ModelRecipe)| {
            let mut recipe = ModelRecipe::new("A");
            change(&mut recipe);
            Recipe::Model(recipe).address(name("summary/4"), "a")
        };
        let mut addresses = vec![
            Recipe::Extractive.address(name("summary/4"), "a"),
            Recipe::Extractive.address(name("summary/original"), "a"),
            Recipe::Extractive.address(name("semantic/4"), "a"),
            Recipe::Extractive.address(name("summary/4"), "b"),
            model(|_| {}),
            model(|recipe| recipe.model = "B".into()),
            model(|recipe| recipe.context_chars = 9),
            model(|recipe| recipe.max_tokens = 9),
            model(|recipe| recipe.views = 0),
            model(|recipe| recipe.image_budget = 9),
            model(|recipe| recipe.reasoning = ReasoningRequest::Low),
            model(|recipe| recipe.system_role = SystemRole::User),
            model(|recipe| recipe.image_format = ImageFormat::Jpeg),
            model(|recipe| recipe.extra_body = Some("{\"top_k\": 1}".into())),
        ];
        let count = addresses.len();
        addresses.sort();
        addresses.dedup();
        assert_eq!(addresses.len(), count);
        assert!(addresses.iter().all(|address| address.len() == 12));
    }
}
