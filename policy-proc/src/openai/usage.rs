//! An estimate of how many tokens of a prompt are injected memory, and how many a server can reuse.
//!
//! Servers count the tokens of a whole prompt. Its text is known in characters, its images in number; what an image costs
//! depends on model and server. Within an episode the window grows, so the number of images changes from request to
//! request, and a least-squares fit of the counts gives the cost of an image and of a unit of text ([`TokenFit`]). A
//! fit belongs to one episode, so the estimate depends neither on other lanes nor on the order of replies. Where the server
//! reports image tokens, those are used.

use domain::{DocumentKind, tokens};
use peer::Request;
use prompt::{Prompt, PromptSection};

use super::reuse::EarlierPrompt;

/// What a prompt consists of, how much of it is memory, and how much the previous prompt began with too. Text is in tokens as [`tokens::of_text`] expects them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PromptSize {
    images: f64,
    memory_images: f64,
    reusable_images: f64,
    text: f64,
    memory_text: f64,
    reusable_text: f64,
}

/// Parts of the tokens of a prompt. They may overlap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct PromptTokens {
    /// Injected memory.
    pub(super) memory: u32,
    /// What a server can reuse.
    pub(super) reusable: u32,
}

impl PromptSize {
    /// `earlier` is the previous prompt of the episode.
    pub(super) fn of(
        request: &Request<'_>,
        prompt: &Prompt<'_>,
        earlier: Option<&EarlierPrompt>,
    ) -> Self {
        let documents = request.texts().filter(|text| text.kind != DocumentKind::Note);
        let documents: usize = documents.map(|document| document.text.chars().count()).sum();
        let memory = prompt.characters(PromptSection::Memory);
        let all: usize = PromptSection::ALL.iter().map(|section| prompt.characters(*section)).sum();
        let text = |characters: usize| {
            tokens::of_text((characters - documents) as u64, documents as u64) as f64
        };
        let common = earlier.map(|earlier| earlier.common_start(prompt)).unwrap_or_default();
        // Documents have more tokens than other text of the same length, and are all in memory.
        let share_of_memory = common.memory_characters as f64 / memory.max(1) as f64;
        let elsewhere = tokens::of_text(common.other_characters as u64, 0) as f64;
        Self {
            images: prompt.images_sent().into(),
            memory_images: prompt.images(PromptSection::Memory).into(),
            reusable_images: common.images.into(),
            text: text(all),
            reusable_text: share_of_memory * text(memory) + elsewhere,
            // Without a memory, the section says so in a sentence.
            memory_text: if request.items.is_empty() { 0.0 } else { text(memory) },
        }
    }
}

/// Fits `tokens = per_image * images + per_text * text` to the requests of an episode, by least squares.
#[derive(Debug, Clone, Copy)]
pub(super) struct TokenFit {
    images_images: f64,
    images_text: f64,
    text_text: f64,
    images_tokens: f64,
    text_tokens: f64,
}

impl Default for TokenFit {
    /// Starts with one observation: a text of 1,000 estimated tokens has 1,000. It decides while all requests are
    /// alike.
    fn default() -> Self {
        const TEXT: f64 = 1000.0;
        Self {
            images_images: 0.0,
            images_text: 0.0,
            text_text: TEXT * TEXT,
            images_tokens: 0.0,
            text_tokens: TEXT * TEXT,
        }
    }
}

impl TokenFit {
    /// Adds a prompt of `prompt_tokens` tokens, of which the server reports `image_tokens` as images, and returns its parts;
    /// `None` where the server did not count.
    pub(super) fn parts(
        &mut self,
        size: PromptSize,
        prompt_tokens: Option<u32>,
        image_tokens: Option<u32>,
    ) -> Option<PromptTokens> {
        let prompt = f64::from(prompt_tokens?);
        let PromptSize { images, text, .. } = size;
        self.images_images += images * images;
        self.images_text += images * text;
        self.text_text += text * text;
        self.images_tokens += images * prompt;
        self.text_tokens += text * prompt;
        let (per_image, per_text) = self.solve();
        let image_tokens = match image_tokens {
            _ if images == 0.0 => 0.0,
            Some(reported) => f64::from(reported),
            None => prompt * per_image * images / (per_image * images + per_text * text).max(1.0),
        };
        let image_tokens = image_tokens.min(prompt);
        let part = |of_images: f64, of_text: f64| {
            let tokens = image_tokens * of_images / images.max(1.0)
                + (prompt - image_tokens) * of_text.min(text) / text.max(1.0);
            tokens.round() as u32
        };
        let PromptSize { memory_images, memory_text, reusable_images, reusable_text, .. } = size;
        Some(PromptTokens {
            memory: part(memory_images, memory_text),
            reusable: part(reusable_images, reusable_text),
        })
    }

    /// Tokens of an image and of a unit of text, neither of them negative.
    fn solve(&self) -> (f64, f64) {
        let determinant = self.images_images * self.text_text - self.images_text.powi(2);
        // Without images there is nothing to tell apart.
        if determinant <= f64::EPSILON * self.images_images * self.text_text {
            return (0.0, self.text_tokens / self.text_text);
        }
        let per_image = (self.images_tokens * self.text_text - self.text_tokens * self.images_text)
            / determinant;
        let per_text = (self.text_tokens * self.images_images
            - self.images_tokens * self.images_text)
            / determinant;
        (per_image.max(0.0), per_text.max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Requests of an episode with episodic memory: seven retrieved views, a growing window.
    fn episode(per_image: f64, per_text: f64) -> Vec<(PromptSize, u32, f64)> {
        let size = |step: u32| PromptSize {
            images: f64::from(8 + step.min(6)),
            memory_images: 7.0,
            reusable_images: 0.0,
            text: 740.0 + 22.0 * f64::from(step.min(6)),
            memory_text: 138.0,
            reusable_text: 600.0,
        };
        let tokens = |size: PromptSize| (size.images * per_image + size.text * per_text) as u32;
        let memory = 7.0 * per_image + 138.0 * per_text;
        (0..20).map(|step| (size(step), tokens(size(step)), memory)).collect()
    }

    /// Images cost 64, 256 or 20 tokens, depending on the server.
    #[test]
    fn memory_tokens_follow_the_cost_of_an_image() {
        for (per_image, per_text) in [(256.0, 1.0), (64.0, 0.9), (20.0, 1.1), (1300.0, 1.0)] {
            let mut fit = TokenFit::default();
            for (step, (size, tokens, expected)) in
                episode(per_image, per_text).into_iter().enumerate()
            {
                let memory = f64::from(fit.parts(size, Some(tokens), None).unwrap().memory);
                let error = (memory - expected).abs() / expected;
                let most = if step < 2 { 0.5 } else { 0.15 };
                assert!(error < most, "{per_image} an image, step {step}: {memory} for {expected}");
            }
        }
    }

    #[test]
    fn reported_image_tokens_are_used() {
        let size = PromptSize {
            images: 47.0,
            memory_images: 40.0,
            reusable_images: 41.0,
            text: 1000.0,
            memory_text: 200.0,
            reusable_text: 700.0,
        };
        let parts = |memory, reusable| Some(PromptTokens { memory, reusable });
        for (prompt, images, expected) in [
            (Some(5700), Some(4700), parts(4200, 4800)),
            (Some(1000), Some(9000), parts(851, 872)),
            (None, Some(9000), None),
        ] {
            assert_eq!(TokenFit::default().parts(size, prompt, images), expected);
        }
        let text = PromptSize { images: 0.0, memory_images: 0.0, reusable_images: 0.0, ..size };
        assert_eq!(TokenFit::default().parts(text, Some(1000), Some(900)), parts(200, 700));
    }
}
