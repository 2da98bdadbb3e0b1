//! The prompts: text files beside this one, and how they are filled in.

use super::chat::{Message, Request, Speaker};

/// Raised whenever a prompt changes, so that documents say which one made them.
pub const PROMPT_VERSION: u32 = 1;

/// What stands between the rules and the question in a file.
const USER: &str = "=== user ===\n";

/// One step of making a document.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stage {
    /// The summary so far and further demonstrations become a new summary.
    Summary,
    /// Demonstrations become notes.
    Extract,
    /// Notes become fewer notes.
    Consolidate,
    /// Notes become a document.
    Refine,
}

impl Stage {
    /// Its name, in the names of files, too.
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

    /// The request of this stage: `values` stand in the places that are named so, in braces.
    pub(super) fn request(self, max_tokens: u32, values: &[(&str, &str)]) -> Request {
        let (rules, question) = self.file().split_once(USER).unwrap_or(("", self.file()));
        let message =
            |role, template: &str| Message { role, content: fill(template.trim_end(), values) };
        let messages = vec![message(Speaker::System, rules), message(Speaker::User, question)];
        Request { messages, max_tokens }
    }
}

/// `template` with the values in their places. What a value says is never taken for a place.
fn fill(template: &str, values: &[(&str, &str)]) -> String {
    let mut filled = String::new();
    let mut rest = template;
    while let Some((before, after)) = rest.split_once('{') {
        filled.push_str(before);
        let place = after.split_once('}').and_then(|(name, after)| {
            let (_, value) = values.iter().find(|(own, _)| *own == name)?;
            Some((value, after))
        });
        match place {
            Some((value, after)) => {
                filled.push_str(value);
                rest = after;
            }
            None => {
                filled.push('{');
                rest = after;
            }
        }
    }
    filled + rest
}

#[cfg(test)]
mod tests {
    use sha2::{Digest, Sha256};

    use super::*;
    use crate::documents::transcript::hex;

    const STAGES: [Stage; 4] = [Stage::Summary, Stage::Extract, Stage::Consolidate, Stage::Refine];

    /// When this fails a prompt has changed: raise [`PROMPT_VERSION`] along with the hashes.
    #[test]
    fn the_version_stands_for_these_texts() {
        let hashes = STAGES.map(|stage| {
            let hash = hex(&Sha256::digest(stage.file()));
            format!("{} {}", stage.name(), &hash[..16])
        });
        insta::assert_snapshot!(format!("{PROMPT_VERSION}: {}", hashes.join(", ")), @"1: summary 6776078441e040b7, extract dd2963990b78b01d, consolidate 65111c567af2d179, refine 159bc2e9d2a78261");
    }

    #[test]
    fn every_place_is_filled() {
        let values = ["limit", "so_far", "demonstrations", "notes"].map(|name| (name, "{limit}!"));
        for stage in STAGES {
            let Request { messages, max_tokens } = stage.request(9, &values);
            let [system, user] = &messages[..] else { panic!("two messages") };
            assert_eq!((system.role, user.role, max_tokens), (Speaker::System, Speaker::User, 9));
            for Message { content, .. } in &messages {
                assert!(content.contains("{limit}!"), "{content}");
                let without = content.replace("{limit}!", "");
                assert!(!without.contains(['{', '}', '=']) && !without.is_empty(), "{without}");
            }
        }
    }

    #[test]
    fn braces_that_name_nothing_stay() {
        assert_eq!(fill("{a} {b} {", &[("a", "{b}"), ("b", "2")]), "{b} 2 {");
        assert_eq!(fill("{c}", &[("a", "1")]), "{c}");
    }
}
