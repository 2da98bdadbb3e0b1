//! The prompts: templates in text files, and how they are filled in.

use case_book::fill;
use llm::{ChatMessage, ChatRequest, ChatRole};
use serde::{Deserialize, Serialize};

/// Separates the system message from the user message in a template.
const USER: &str = "=== user ===\n";

/// A prompt for the model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DocumentPrompt {
    /// The system message: the rules.
    pub system: String,
    /// The user message: the material.
    pub user: String,
    /// Maximum number of tokens in the answer.
    pub max_tokens: u32,
}

impl DocumentPrompt {
    /// Number of characters in both messages.
    pub(super) fn chars(&self) -> usize {
        self.system.chars().count() + self.user.chars().count()
    }

    /// The request that carries it.
    pub(super) fn request(&self) -> ChatRequest {
        let messages = vec![
            ChatMessage::text(ChatRole::System, &*self.system),
            ChatMessage::text(ChatRole::User, &*self.user),
        ];
        ChatRequest { messages, max_tokens: self.max_tokens, choices: Vec::new() }
    }
}

/// A step in building a document.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PromptStage {
    /// The summary so far and further demonstrations become a new summary.
    Summary,
    /// Demonstrations become notes.
    Extract,
    /// Notes become fewer notes.
    Consolidate,
    /// Notes become a document.
    Refine,
}

impl PromptStage {
    /// Its name, also in file names.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Summary => "summary",
            Self::Extract => "extract",
            Self::Consolidate => "consolidate",
            Self::Refine => "refine",
        }
    }

    const fn file(self) -> &'static str {
        match self {
            Self::Summary => include_str!("prompts/summary.txt"),
            Self::Extract => include_str!("prompts/extract.txt"),
            Self::Consolidate => include_str!("prompts/consolidate.txt"),
            Self::Refine => include_str!("prompts/refine.txt"),
        }
    }

    /// The prompt of this stage, with `values` in place of their names in braces.
    pub(super) fn prompt(self, max_tokens: u32, values: &[(&str, &str)]) -> DocumentPrompt {
        let (system, user) = self.file().split_once(USER).unwrap_or(("", self.file()));
        let filled = |template: &str| fill(template.trim_end(), values);
        DocumentPrompt { system: filled(system), user: filled(user), max_tokens }
    }
}

#[cfg(test)]
mod tests {
    use sha2::{Digest, Sha256};

    use super::*;
    use documents::PROMPT_VERSION;
    use domain::hex;

    const STAGES: [PromptStage; 4] =
        [PromptStage::Summary, PromptStage::Extract, PromptStage::Consolidate, PromptStage::Refine];

    /// When this fails, a prompt has changed: raise [`PROMPT_VERSION`] along with the hashes.
    #[test]
    fn the_version_belongs_to_these_texts() {
        let hashes = STAGES.map(|stage| {
            let hash = hex(&Sha256::digest(stage.file()));
            format!("{} {}", stage.name(), &hash[..16])
        });
        insta::assert_snapshot!(format!("{PROMPT_VERSION}: {}", hashes.join(", ")), @"1: summary 6776078441e040b7, extract dd2963990b78b01d, consolidate 65111c567af2d179, refine 159bc2e9d2a78261");
    }

    #[test]
    fn every_placeholder_is_filled() {
        let values = ["limit", "so_far", "demonstrations", "notes"].map(|name| (name, "{limit}!"));
        for stage in STAGES {
            let DocumentPrompt { system, user, max_tokens } = stage.prompt(9, &values);
            assert_eq!(max_tokens, 9);
            for content in [system, user] {
                assert!(content.contains("{limit}!"), "{content}");
                let without = content.replace("{limit}!", "");
                assert!(!without.contains(['{', '}', '=']) && !without.is_empty(), "{without}");
            }
        }
    }
}
