//! The prompt of each representation, and of unusual requests, as golden files.
//!
//! A file in `tests/cases/` holds a request in plain form, an image budget and the expected outcome: the messages with
//! images by name, the section of each part of the user message, counts. README.md describes the plain form.
//! `UPDATE_GOLDEN=1 cargo test -p prompt --test golden` rewrites the outcomes; read the difference before you commit it,
//! and raise the template's version.

#![expect(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use domain::{Action, DocumentKind, Feedback, Heading, Pose, hex};
use peer::{
    ActionCode, CaptionedView, FrameView, Item, PastView, PlanView, PlannedActions, Request,
    StepView, StepsView, TextView,
};
use prompt::{PartContent, Prompt, PromptPart, PromptSection, Template};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// A golden file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct GoldenCase {
    about: String,
    image_budget: u32,
    request: PlainRequest,
    #[serde(default)]
    outcome: Value,
}

/// A request in plain form.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainRequest {
    instruction: String,
    pose: PlainPose,
    feedback: String,
    view: String,
    window: Vec<PlainPast>,
    items: Vec<PlainItem>,
    starts_as_demonstrated: bool,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    demonstrated_elsewhere: bool,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainPose {
    column: u8,
    row: u8,
    heading: Heading,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainPast {
    view: String,
    action: Option<String>,
    feedback: String,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
enum PlainItem {
    Text { kind: String, text: String },
    Steps { distance: Option<f32>, is_whole: bool, instruction: String, steps: Vec<PlainStep> },
    Frame { view: String, caption: String, instruction: String },
    Plan { parts: Vec<PlainActions> },
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainActions {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    instruction: Option<String>,
    actions: Vec<String>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainStep {
    view: Option<String>,
    action: Option<String>,
}

const ACTIONS: [&str; 7] =
    ["forward", "backward", "left", "right", "turn_left", "turn_right", "turn_around"];
const FEEDBACK: [&str; 5] = ["start", "moved", "turned", "blocked", "not_understood"];

fn action(name: &Option<String>) -> Option<Action> {
    let name = name.as_deref()?;
    let code = ACTIONS.iter().position(|known| *known == name);
    Some(Action::ALL[code.unwrap_or_else(|| panic!("{name} is no action"))])
}

fn feedback(name: &str) -> Feedback {
    let code = FEEDBACK.iter().position(|known| *known == name);
    Feedback::ALL[code.unwrap_or_else(|| panic!("{name} is no feedback"))]
}

/// A view without pixels.
fn view(name: &str) -> FrameView<'static> {
    let mut content_hash = [0; 16];
    assert_eq!(name.len(), 32, "{name} is no hash");
    for (index, byte) in content_hash.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&name[2 * index..2 * index + 2], 16).unwrap();
    }
    FrameView { id: 0, content_hash, width: 0, height: 0, pixels: &[] }
}

/// The outcome of a request and a budget, and the prompt as a text.
fn outcome(plain: &PlainRequest, image_budget: u32) -> (Value, String) {
    let window = plain.window.iter();
    let window: Vec<_> = window
        .map(|past| PastView {
            frame: view(&past.view),
            action: action(&past.action).map(Action::into),
            feedback: feedback(&past.feedback).into(),
        })
        .collect();
    let steps = |item: &PlainItem| -> Vec<StepView<'_>> {
        let PlainItem::Steps { steps, .. } = item else { return Vec::new() };
        let step = |step: &PlainStep| StepView {
            frame: step.view.as_deref().map(view),
            action: action(&step.action).map(Action::into),
        };
        steps.iter().map(step).collect()
    };
    let steps: Vec<_> = plain.items.iter().map(steps).collect();
    let codes = |part: &PlainActions| -> Vec<ActionCode> {
        let codes = part.actions.iter().map(|name| action(&Some(name.clone())).unwrap().into());
        codes.collect()
    };
    let parts = |item: &PlainItem| -> Vec<(Option<String>, Vec<ActionCode>)> {
        let PlainItem::Plan { parts } = item else { return Vec::new() };
        parts.iter().map(|part| (part.instruction.clone(), codes(part))).collect()
    };
    let parts: Vec<_> = plain.items.iter().map(parts).collect();
    let parts = parts.iter().map(|parts| {
        let parts = parts.iter().map(|(instruction, actions)| PlannedActions {
            instruction: instruction.as_deref(),
            actions,
        });
        parts.collect()
    });
    let parts: Vec<Vec<PlannedActions<'_>>> = parts.collect();
    let items =
        plain.items.iter().zip(steps.iter().zip(&parts)).map(|(item, (steps, parts))| match item {
            PlainItem::Text { kind, text } => {
                let kind = match kind.as_str() {
                    "summary" => DocumentKind::Summary,
                    "semantic" => DocumentKind::Semantic,
                    "note" => DocumentKind::Note,
                    other => panic!("{other} is no kind of text"),
                };
                Item::Text(TextView { id: 0, kind, text })
            }
            &PlainItem::Steps { distance, is_whole, ref instruction, .. } => {
                Item::Steps(StepsView { distance, is_whole, instruction, steps })
            }
            PlainItem::Frame { view: name, caption, instruction } => {
                Item::Frame(CaptionedView { frame: view(name), caption, instruction })
            }
            PlainItem::Plan { .. } => Item::Plan(PlanView { parts }),
        });
    let items: Vec<_> = items.collect();
    let PlainPose { column, row, heading } = plain.pose;
    let request = Request {
        lane: 3,
        step: 17,
        episode: 99,
        episode_seed: 4711,
        repeat: 2,
        instruction: &plain.instruction,
        state: Pose::new(column, row, heading).into(),
        feedback: feedback(&plain.feedback).into(),
        frame: view(&plain.view),
        window: &window,
        items: &items,
        starts_as_demonstrated: plain.starts_as_demonstrated,
        demonstrated_elsewhere: plain.demonstrated_elsewhere,
        world: &Arc::new(warehouse::declaration()),
    };
    let prompt = Prompt::new(Template::built_in(), &request, image_budget);
    let sections: Vec<_> = prompt.parts.iter().map(|part| part.section.name()).collect();
    let by_section = |count: &dyn Fn(PromptSection) -> Value| -> Value {
        PromptSection::ALL
            .into_iter()
            .map(|section| (section.name().to_owned(), count(section)))
            .collect()
    };
    let outcome = json!({
        "messages": messages(&prompt),
        "sections": sections,
        "images_asked": prompt.images_asked,
        "images_sent": prompt.images_sent(),
        "images": by_section(&|section| prompt.images(section).into()),
        "characters": by_section(&|section| prompt.characters(section).into()),
    });
    (outcome, readable(&prompt))
}

/// The two messages of a chat request, with images by name. Without an image the user message is one plain text, which
/// servers of models that cannot see accept too.
fn messages(prompt: &Prompt<'_>) -> Value {
    let text = |part: &PromptPart<'_>| match &part.content {
        PartContent::Text(text) => text.clone(),
        PartContent::View(view) => panic!("{view:?}"),
    };
    let part = |part: &PromptPart<'_>| match &part.content {
        PartContent::Text(text) => json!({"type": "text", "text": text}),
        PartContent::View(view) => {
            json!({"type": "image_url", "image_url": {"url": image_name(view)}})
        }
    };
    let content: Value = match prompt.images_sent() {
        0 => prompt.parts.iter().map(text).collect::<String>().into(),
        _ => prompt.parts.iter().map(part).collect(),
    };
    json!([{"role": "system", "content": prompt.system}, {"role": "user", "content": content}])
}

fn image_name(view: &FrameView<'_>) -> String {
    format!("image:{}", hex(&view.content_hash))
}

/// The prompt as docs/prompt.md shows it.
fn readable(prompt: &Prompt<'_>) -> String {
    let parts = prompt.parts.iter().map(|part| match &part.content {
        PartContent::Text(text) => text.clone(),
        PartContent::View(view) => format!("[{}]", &image_name(view)[..14]),
    });
    let user: String = parts.collect();
    format!("```text\n{}```\n\n```text\n{user}\n```\n", prompt.system)
}

fn files() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cases");
    let mut files: Vec<_> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(files.len() >= 6);
    files
}

fn read(path: &Path) -> GoldenCase {
    let text = fs::read_to_string(path).unwrap();
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn every_file_has_the_prompt_of_its_request() {
    let mut wrong = Vec::new();
    for path in files() {
        let mut case = read(&path);
        let (outcome, readable) = outcome(&case.request, case.image_budget);
        if case.outcome != outcome {
            case.outcome = outcome;
            if std::env::var_os("UPDATE_GOLDEN").is_some() {
                let text = serde_json::to_string_pretty(&case).unwrap();
                fs::write(&path, text + "\n").unwrap();
            }
            wrong.push(format!("{}:\n{readable}", path.display()));
        }
    }
    assert!(wrong.is_empty(), "UPDATE_GOLDEN=1 accepts these prompts:\n{}", wrong.join("\n"));
}

#[test]
fn the_example_in_the_docs_is_a_case() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/prompt.md");
    let page = fs::read_to_string(page).unwrap();
    let case = read(files().iter().find(|path| path.ends_with("example.json")).unwrap());
    let (_, readable) = outcome(&case.request, case.image_budget);
    assert!(page.contains(&readable), "docs/prompt.md should show:\n{readable}");
}

/// A text without the numbers of images: how many there are before an image depends on memory.
fn without_image_numbers(text: &str) -> String {
    let mut parts = text.split("Image ");
    let first = parts.next().unwrap_or_default().to_owned();
    first
        + &parts
            .map(|part| part.trim_start_matches(|c: char| c.is_ascii_digit()))
            .collect::<String>()
}

#[test]
fn the_system_message_and_what_memory_does_not_touch_are_the_same_for_all() {
    let user = |messages: &Value| -> Vec<Value> {
        match &messages[1]["content"] {
            Value::Array(parts) => parts.clone(),
            text => vec![text.clone()],
        }
    };
    let name = |path: &Path| path.file_stem().unwrap().to_str().unwrap().to_owned();
    let mut systems = Vec::new();
    let mut rests = Vec::new();
    for path in files() {
        let outcome = read(&path).outcome;
        systems.push(outcome["messages"][0].clone());
        let sections = outcome["sections"].as_array().unwrap();
        let after = sections.iter().take_while(|section| *section == "memory").count();
        assert!(sections[after..].iter().all(|section| section != "memory"), "{}", path.display());
        if ["working", "full-context", "summary", "semantic", "hybrid", "episodic"]
            .contains(&name(&path).as_str())
        {
            let rest = Value::from(&user(&outcome["messages"])[after..]).to_string();
            rests.push(without_image_numbers(&rest));
        }
    }
    systems.dedup();
    assert_eq!(systems.len(), 1);
    assert_eq!(rests.len(), 6);
    rests.dedup();
    assert_eq!(rests.len(), 1);
}

#[test]
fn images_are_numbered_in_reading_order_and_the_current_view_is_the_last() {
    let mut references = 0;
    for path in files() {
        let outcome = read(&path).outcome;
        let Value::Array(parts) = &outcome["messages"][1]["content"] else { continue };
        let images = parts.iter().filter(|part| part["type"] == "image_url").count();
        let mut number = 0;
        for pair in parts.windows(2).filter(|pair| pair[1]["type"] == "image_url") {
            number += 1;
            let before = pair[0]["text"].as_str().unwrap();
            assert!(before.ends_with(&format!("\nImage {number}:\n")), "{path:?}: {before}");
        }
        assert_eq!(number, images, "{path:?}");
        let texts = parts.iter().filter_map(|part| part["text"].as_str());
        for rest in texts.flat_map(|text| text.split("your current view, image ").skip(1)) {
            assert!(rest.starts_with(&format!("{images} (")), "{path:?}: {rest}");
            references += 1;
        }
    }
    assert!(references > 5);
}

#[test]
fn nothing_but_the_request_is_in_a_prompt() {
    // Lane, step, seed, episode and repetition are not in the prompt: 3, 17, 4711, 99 and 2 in `outcome`.
    for path in files() {
        let case = read(&path);
        let known = serde_json::to_string(&case.request).unwrap();
        let (outcome, _) = outcome(&case.request, case.image_budget);
        let content = outcome["messages"][1]["content"].to_string();
        for number in ["17", "4711", "99"] {
            if !known.contains(number) {
                assert!(!content.contains(number), "{number} in {}", path.display());
            }
        }
    }
}

#[test]
fn without_an_image_the_user_message_is_plain_text() {
    let case = read(files().iter().find(|path| path.ends_with("text-only.json")).unwrap());
    assert!(case.outcome["messages"][1]["content"].is_string());
    let case = read(files().iter().find(|path| path.ends_with("working.json")).unwrap());
    let parts = case.outcome["messages"][1]["content"].as_array().unwrap();
    assert_eq!(parts.iter().filter(|part| part["type"] == "image_url").count(), 7);
}
