//! How a document is built: the builder, and everything in it that determines the text.

use crate::{DocumentName, sha256_of_parts};

/// The version of the extractive builder. Changes whenever the same demonstrations give another text.
pub const EXTRACTIVE_VERSION: u32 = 2;

/// The version of the prompts that the model builder sends. Changes whenever one of them does.
pub const PROMPT_VERSION: u32 = 1;

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
}

impl ModelRecipe {
    /// The default of `context_chars`: about 40,000 tokens.
    pub const CONTEXT_CHARS: usize = 100_000;
    /// The default of `max_tokens`; the paper's summaries have about 13,000.
    pub const MAX_TOKENS: u32 = 16_000;
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
            Self::Model(ModelRecipe { model, context_chars, max_tokens }) => format!(
                "prompts {PROMPT_VERSION}, model {model}, {context_chars} characters to {max_tokens} tokens"
            ),
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
        let model = |model: &str, context_chars, max_tokens| {
            Recipe::Model(ModelRecipe { model: model.into(), context_chars, max_tokens })
        };
        let mut addresses = vec![
            Recipe::Extractive.address(name("summary/4"), "a"),
            Recipe::Extractive.address(name("summary/original"), "a"),
            Recipe::Extractive.address(name("semantic/4"), "a"),
            Recipe::Extractive.address(name("summary/4"), "b"),
            model("A", 9, 9).address(name("summary/4"), "a"),
            model("B", 9, 9).address(name("summary/4"), "a"),
            model("A", 8, 9).address(name("summary/4"), "a"),
            model("A", 9, 8).address(name("summary/4"), "a"),
        ];
        let count = addresses.len();
        addresses.sort();
        addresses.dedup();
        assert_eq!(addresses.len(), count);
        assert!(addresses.iter().all(|address| address.len() == 12));
    }
}
