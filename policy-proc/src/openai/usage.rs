//! How many tokens of a prompt are injected memory.
//!
//! Servers count tokens of the whole prompt. How many of them are memory is estimated: images get the tokens
//! that the server told for images, or 256 each, which is what the paper's figures come to; all other tokens
//! are the text's. Each kind is shared out evenly, over images and over characters.

use crate::Request;
use crate::prompt::{Prompt, Section};

/// Tokens of an image where the server does not tell them: a 448 x 448 tile.
const IMAGE_TOKENS: u64 = 256;

/// What a prompt consists of, and what memory has of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shares {
    images: u64,
    memory_images: u64,
    characters: u64,
    memory_characters: u64,
}

impl Shares {
    pub(super) fn of(request: &Request<'_>, prompt: &Prompt<'_>) -> Self {
        let characters = Section::ALL.map(|section| prompt.characters(section) as u64);
        // Without memory the prompt says so in a sentence, which is no memory.
        let injects = !request.documents.is_empty()
            || !request.trajectories.is_empty()
            || request.segment.is_some();
        Self {
            images: prompt.images_sent().into(),
            memory_images: prompt.images(Section::Memory).into(),
            characters: characters.iter().sum(),
            memory_characters: match injects {
                true => prompt.characters(Section::Memory) as u64,
                false => 0,
            },
        }
    }

    /// Tokens of memory in a prompt of `prompt_tokens`, of which `image_tokens` are images; `None` where the
    /// server did not count. Never more than the prompt has.
    pub(super) fn memory_tokens(
        self,
        prompt_tokens: Option<u32>,
        image_tokens: Option<u32>,
    ) -> Option<u32> {
        let prompt = u64::from(prompt_tokens?);
        let Self { images, memory_images, characters, memory_characters } = self;
        let image_tokens = image_tokens.map_or(IMAGE_TOKENS * images, u64::from);
        let image_tokens = if images == 0 { 0 } else { image_tokens.min(prompt) };
        let text_tokens = prompt - image_tokens;
        let tokens = image_tokens * memory_images / images.max(1)
            + text_tokens * memory_characters / characters.max(1);
        u32::try_from(tokens).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_has_its_share_of_images_and_of_text() {
        let full =
            Shares { images: 47, memory_images: 40, characters: 5000, memory_characters: 1000 };
        let text = Shares { images: 0, memory_images: 0, ..full };
        let none = Shares { images: 7, memory_images: 0, characters: 4000, memory_characters: 0 };
        for (shares, prompt, images, expected) in [
            (full, Some(13_032), None, Some(40 * 256 + 200)),
            (full, Some(13_032), Some(4700), Some(4000 + 8332 / 5)),
            (full, Some(1000), None, Some(851)),
            (full, Some(1000), Some(9000), Some(851)),
            (text, Some(1000), None, Some(200)),
            (text, Some(1000), Some(9000), Some(200)),
            (none, Some(3000), None, Some(0)),
            (full, None, Some(9000), None),
            (full, Some(u32::MAX), Some(0), Some(u32::MAX / 5)),
        ] {
            assert_eq!(shares.memory_tokens(prompt, images), expected, "{prompt:?} {images:?}");
        }
    }
}
