//! Prompts of a world that is not the warehouse.

use std::sync::Arc;

use domain::{ActionCode, FeedbackCode, State};
use peer::{ActionDeclaration, PastView, StateField, StepView, StepsView};

use super::*;

/// A world of doors with two actions, of which one's words begin with the other's.
pub(crate) fn doors() -> WorldDeclaration {
    let action = |letter, words: &str| ActionDeclaration { letter, words: words.to_owned() };
    let room = ["kitchen", "hall"].map(str::to_owned).to_vec();
    WorldDeclaration {
        name: "doors".to_owned(),
        version: "1".to_owned(),
        rules: "You open doors {carefully}.".to_owned(),
        actions: vec![action('o', "open door"), action('s', "open door 2 slowly")],
        state: vec![
            StateField { name: "height".to_owned(), words: Vec::new(), digits: 2 },
            StateField { name: "room".to_owned(), words: room, digits: 0 },
        ],
        state_sentence: "Your hand is {height} m high in the {room}.".to_owned(),
        feedback: ["Begin.", "It opened.", "What?"].map(str::to_owned).to_vec(),
        is_deterministic: true,
    }
}

#[test]
fn a_prompt_is_in_the_words_of_its_world() {
    let world = Arc::new(doors());
    let [open, open_slowly] = [0, 1].map(ActionCode);
    let frame = FrameView::NONE;
    let past = |action, feedback| PastView { frame, action, feedback: FeedbackCode(feedback) };
    let step = |action| StepView { frame: Some(frame), action };
    let steps = [step(Some(open_slowly)), step(Some(open)), step(Some(open)), step(None)];
    let demonstration = peer::Item::Steps(StepsView {
        distance: None,
        is_whole: true,
        instruction: "Open the {place}.",
        steps: &steps,
    });
    let request = Request {
        lane: 0,
        step: 2,
        episode: 1,
        episode_seed: 0,
        repeat: 1,
        instruction: "Open everything.",
        state: State::new(&[1.25, 1.0]).unwrap(),
        feedback: FeedbackCode(2),
        frame,
        window: &[past(Some(open_slowly), 1), past(None, 2)],
        items: &[demonstration],
        starts_as_demonstrated: true,
        demonstrated_elsewhere: false,
        world: &world,
    };
    let prompt = Prompt::new(Template::built_in(), &request, IMAGE_BUDGET);
    assert!(prompt.system.starts_with("You open doors {carefully}.\n\nThe images\n"));
    assert!(prompt.system.ends_with("It is one of:\nopen door\nopen door 2 slowly\n"));
    let text = |section| -> String {
        let parts = prompt.parts.iter().filter(|part| part.section == section);
        let texts = parts.map(|part| match &part.content {
            PartContent::Text(text) => text.as_str(),
            PartContent::View(_) => "(view)",
        });
        texts.collect()
    };
    let memory = text(PromptSection::Memory);
    for text in [&prompt.system, &memory] {
        for word in ["walk", "heading", "aisle", "warehouse"] {
            assert!(!text.contains(word), "{word}: {text}");
        }
    }
    let task =
        "An expert acted here before, from start to end, to do this: \"Open the {place}.\"\n";
    assert!(memory.contains(task), "{memory}");
    assert!(memory.contains("Actions: open door 2 slowly\n"), "{memory}");
    assert!(memory.contains("Actions: open door\n"), "{memory}");
    assert_eq!(
        text(PromptSection::Window),
        "<recent_steps>\nRecent step 1 of 2. You saw:\nImage 5:\n(view)\n\
         Your action: open door 2 slowly. Feedback: It opened.\n\
         Recent step 2 of 2. You saw:\nImage 6:\n(view)\nYour action: none. Feedback: What?\n\
         </recent_steps>\n\n"
    );
    assert_eq!(
        text(PromptSection::Now),
        "<now>\nYour hand is 1.25 m high in the hall.\nFeedback: What?\nYou see:\nImage 7:\n(view)\n</now>\n\n\
         Your next action, as one of: open door, open door 2 slowly."
    );
    assert_eq!(answer_choices(&world), ["open door", "open door 2 slowly"]);
    let settings = request_settings(&world);
    assert_eq!(settings["choices"], json!(["open door", "open door 2 slowly"]));
}
