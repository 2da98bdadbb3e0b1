//! The largest request of a run with a memory, with invented content: what a server has to accept before a run makes sense.

use std::sync::Arc;

use domain::{DocumentKind, ImageFormat};
use llm::ChatRequest;
use peer::{
    ActionCode, ActionDeclaration, FeedbackCode, FrameView, Item, PastView, Request, State,
    StateField, StepView, StepsView, TextView, WorldDeclaration,
};
use prompt::image::data_url;
use prompt::{Prompt, Template};

/// Steps between two keyframes of a demonstration, about what the demonstrations of the benchmark have.
const KEYFRAME_DISTANCE: u32 = 2;

/// A line of an invented document.
const DOCUMENT_LINE: &str =
    "- blue barrel: stand at (12, 7) facing N; from (3, 1) go (3, 7), (12, 7)\n";

/// A line of invented rules.
const RULE_LINE: &str = "- You cannot walk through racks, walls and barricades.\n";

/// About the length of the benchmark's rules.
const RULES_BYTES: usize = 2000;

/// The size of the largest request of a run with a memory: its views, a full window, its documents.
#[derive(Debug, Clone, Copy)]
pub struct LargestRequest {
    /// Edge of a view, in pixels.
    pub frame_size: u32,
    /// Encoding of the images.
    pub image_format: ImageFormat,
    /// Views of the memory.
    pub keyframes: u32,
    /// Past steps.
    pub window: u32,
    /// Characters of documents.
    pub document_chars: u32,
}

impl LargestRequest {
    /// Its images.
    pub const fn images(&self) -> u32 {
        1 + self.window + self.keyframes
    }

    /// The chat request in the words of `template`, with at most `image_budget` images.
    pub fn chat_request(&self, template: &Template, image_budget: u32) -> ChatRequest {
        let world = Arc::new(invented_world());
        let pixels = pixels(self.frame_size);
        let (width, height) = (self.frame_size, self.frame_size);
        let frame = FrameView { pixels: &pixels, width, height, ..FrameView::NONE };
        let past = PastView { frame, action: Some(ActionCode(0)), feedback: FeedbackCode::START };
        let window = vec![past; self.window as usize];
        let steps: Vec<_> = (0..self.keyframes * KEYFRAME_DISTANCE)
            .map(|step| StepView {
                frame: (step % KEYFRAME_DISTANCE == 0).then_some(frame),
                action: Some(ActionCode(step as u8 % world.actions.len() as u8)),
            })
            .collect();
        let text: String =
            DOCUMENT_LINE.chars().cycle().take(self.document_chars as usize).collect();
        let document = TextView { id: 0, kind: DocumentKind::Summary, text: &text };
        let trajectory = StepsView { distance: None, is_whole: true, steps: &steps };
        let mut items = Vec::new();
        if self.keyframes > 0 {
            items.push(Item::Steps(trajectory));
        }
        if self.document_chars > 0 {
            items.push(Item::Text(document));
        }
        let request = Request {
            lane: 0,
            step: 0,
            episode: 0,
            episode_seed: 0,
            repeat: 0,
            instruction: "Find a blue barrel, then return to the cell where you started.",
            state: State::default(),
            feedback: FeedbackCode::START,
            frame,
            window: &window,
            items: &items,
            starts_as_demonstrated: true,
            demonstrated_elsewhere: true,
            world: &world,
        };
        // A square view can be encoded.
        let url = data_url(&frame, self.image_format).unwrap_or_default().into();
        super::chat_request(
            &world,
            &Prompt::new(template, &request, image_budget),
            prompt::ANSWER_TOKENS,
            |_| Arc::clone(&url),
        )
    }
}

/// A world with rules as long as those of the benchmark's.
fn invented_world() -> WorldDeclaration {
    let actions = ["move forward", "move backward", "move left", "move right", "turn left"];
    let actions = ('a'..).zip(actions.into_iter().chain(["turn right", "turn around"]));
    let action =
        |(letter, words): (char, &str)| ActionDeclaration { letter, words: words.to_owned() };
    let state = StateField { name: "column".to_owned(), words: Vec::new(), digits: 0 };
    WorldDeclaration {
        name: "invented".to_owned(),
        version: "1".to_owned(),
        rules: RULE_LINE.repeat(RULES_BYTES / RULE_LINE.len()),
        actions: actions.map(action).collect(),
        state: vec![state],
        state_sentence: "You are in column {column}.".to_owned(),
        feedback: ["The episode has just begun.", "You moved."].map(str::to_owned).to_vec(),
        is_deterministic: true,
    }
}

/// A square view with as much detail as a rendered one: stripes that grow brighter.
fn pixels(edge: u32) -> Vec<u8> {
    let cells = (0..edge).flat_map(|row| (0..edge).map(move |column| (row, column)));
    let shade = |value: u32| (value % 256) as u8;
    cells
        .flat_map(|(row, column)| {
            [shade(row + column / 8), shade(column ^ row), shade(column), 255]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_request_has_the_images_and_documents_of_a_run() {
        let largest = LargestRequest {
            frame_size: 64,
            image_format: ImageFormat::Png,
            keyframes: 40,
            window: 6,
            document_chars: 5000,
        };
        assert_eq!(largest.images(), 47);
        assert_eq!(largest.chat_request(Template::built_in(), 50).images(), 47);
        let request = largest.chat_request(Template::built_in(), 10);
        assert_eq!(request.images(), 10);
        let text = format!("{request:?}");
        assert!(text.contains("blue barrel") && text.contains("data:image/png;base64,"));
    }
}
