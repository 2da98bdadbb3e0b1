//! The counts of a decision, checked.

use super::Decision;

/// The counts of a [`Decision`] that are known and possible.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DecisionCounts {
    /// Images of the request.
    pub images_asked: Option<u32>,
    /// Images that the policy used.
    pub images: Option<u32>,
    /// Requests sent to a model's server.
    pub attempts: Option<u32>,
    /// Tokens of the prompt.
    pub prompt_tokens: Option<u32>,
    /// Tokens of the completion.
    pub completion_tokens: Option<u32>,
    /// Tokens of the prompt that the server took from its cache.
    pub cached_tokens: Option<u32>,
    /// Tokens of the prompt's images.
    pub image_tokens: Option<u32>,
    /// Tokens of the prompt that are memory.
    pub memory_tokens: Option<u32>,
    /// Tokens of the prompt that a server can reuse.
    pub reusable_tokens: Option<u32>,
}

/// Larger counts of images, attempts or tokens in one decision are not possible.
const MAX_COUNT: u32 = 1 << 24;

impl Decision {
    /// The counts: without those that are [`NOT_MEASURED`](super::NOT_MEASURED) or not possible, such as more images used than asked.
    pub fn counts(&self) -> DecisionCounts {
        let known = |count: u32| (count <= MAX_COUNT).then_some(count);
        let images_asked = known(self.images_asked);
        let fits = |images: &u32| images_asked.is_none_or(|asked| *images <= asked);
        DecisionCounts {
            images_asked,
            images: known(self.images).filter(fits),
            attempts: known(self.attempts),
            prompt_tokens: known(self.prompt_tokens),
            completion_tokens: known(self.completion_tokens),
            cached_tokens: known(self.cached_tokens),
            image_tokens: known(self.image_tokens),
            memory_tokens: known(self.memory_tokens),
            reusable_tokens: known(self.reusable_tokens),
        }
    }
}
