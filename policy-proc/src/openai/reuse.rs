//! How much of a prompt its episode's previous prompt began with too. A server with a prefix cache need not read that
//! part again.

use prompt::{PartContent, Prompt, PromptSection};

/// A prompt, kept until the next one of its episode is compared with it.
#[derive(Debug)]
pub(super) struct EarlierPrompt(Vec<EarlierPart>);

#[derive(Debug)]
enum EarlierPart {
    Text(String),
    /// The hash of the pixels.
    Image([u8; 16]),
}

/// The beginning that two prompts have in common.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct CommonStart {
    pub(super) images: u32,
    /// Characters of text in the memory section.
    pub(super) memory_characters: usize,
    /// Characters of text elsewhere, the rules included.
    pub(super) other_characters: usize,
}

impl EarlierPrompt {
    pub(super) fn new(prompt: &Prompt<'_>) -> Self {
        let parts = prompt.parts.iter().map(|part| match &part.content {
            PartContent::Text(text) => EarlierPart::Text(text.clone()),
            PartContent::View(view) => EarlierPart::Image(view.content_hash),
        });
        Self(parts.collect())
    }

    /// What `prompt` begins with as this one did. All prompts have the same rules.
    pub(super) fn common_start(&self, prompt: &Prompt<'_>) -> CommonStart {
        let other_characters = prompt.system.chars().count();
        let mut common = CommonStart { other_characters, ..CommonStart::default() };
        let Self(parts) = self;
        for (earlier, part) in parts.iter().zip(&prompt.parts) {
            let is_same = match (earlier, &part.content) {
                (EarlierPart::Text(earlier), PartContent::Text(text)) => {
                    let same =
                        earlier.chars().zip(text.chars()).take_while(|(a, b)| a == b).count();
                    match part.section {
                        PromptSection::Memory => common.memory_characters += same,
                        _ => common.other_characters += same,
                    }
                    earlier == text
                }
                (EarlierPart::Image(earlier), PartContent::View(view)) => {
                    let is_same = *earlier == view.content_hash;
                    common.images += u32::from(is_same);
                    is_same
                }
                _ => false,
            };
            if !is_same {
                break;
            }
        }
        common
    }
}

#[cfg(test)]
mod tests {
    use peer::FrameView;
    use prompt::PromptPart;

    use super::*;

    const SYSTEM: &str = "rules";

    /// A prompt of texts of the memory section, and of images, written `#N`, of the window.
    fn prompt(parts: &[&str]) -> Prompt<'static> {
        let part = |text: &&str| match text.strip_prefix('#') {
            Some(number) => {
                let content_hash = [number.parse().unwrap(); 16];
                let view = FrameView { content_hash, ..FrameView::NONE };
                PromptPart { section: PromptSection::Window, content: PartContent::View(view) }
            }
            None => {
                let content = PartContent::Text((*text).to_owned());
                PromptPart { section: PromptSection::Memory, content }
            }
        };
        Prompt {
            system: SYSTEM.to_owned(),
            parts: parts.iter().map(part).collect(),
            images_asked: 0,
        }
    }

    #[test]
    fn the_common_start_ends_at_the_first_difference() {
        for (earlier, now, images, characters) in [
            (&["document", "#1", "#2"][..], &["document", "#1", "#3"][..], 1, 8),
            (&["document", "#1"], &["document", "#1", "#2"], 1, 8),
            (&["distance 0.1", "#1"], &["distance 0.2", "#1"], 0, 11),
            (&["#1", "text"], &["#2", "text"], 0, 0),
            (&["#1"], &["text"], 0, 0),
            (&["é"], &["é"], 0, 1),
        ] {
            let common = EarlierPrompt::new(&prompt(earlier)).common_start(&prompt(now));
            let (memory_characters, other_characters) = (characters, SYSTEM.len());
            let expected = CommonStart { images, memory_characters, other_characters };
            assert_eq!(common, expected, "{earlier:?} {now:?}");
        }
    }
}
