//! The builder with a scripted model.

use case_book::{CaseDemonstrations, DemonstrationBook};
use documents::asking::BuildEstimate;
use documents::{DocumentName, Sources};
use domain::{Appearance, Demonstrations, ImageFormat, tokens};
use tempfile::TempDir;

use super::super::testing::{self, EAST, OPEN, corridor};
use super::*;

pub(super) fn reply(content: ReplyContent) -> ChatReply {
    ChatReply {
        content,
        model: Some("scripted-1".into()),
        prompt_tokens: Some(100),
        completion_tokens: Some(10),
        cached_tokens: None,
        image_tokens: None,
        finish_reason: None,
        reasoned: false,
    }
}

fn says(text: impl Into<String>) -> ChatReply {
    reply(ReplyContent::Text(text.into()))
}

/// A demonstration: through a door.
fn demonstration() -> Demonstration {
    testing::demonstration("Walk to cell 5.", 1, &[EAST, EAST, EAST, OPEN, EAST, EAST], &[4, 6])
}

/// A recipe whose prompts of `stage` have room for `count` demonstrations without views beside `other` characters.
fn room_for(stage: PromptStage, count: usize, other: usize) -> ModelRecipe {
    let endless =
        ModelRecipe { context_chars: 1 << 20, max_tokens: 1000, views: 0, ..ModelRecipe::new("m") };
    let world = corridor();
    let room = PromptTexts { world: &world, recipe: &endless }.room(stage, 0).chars;
    let one = narrations(&world, &[&demonstration()], 0)[0].size().chars + 20;
    ModelRecipe { context_chars: (1 << 20) - room + count * one + other, ..endless }
}

/// Draws a view as one pixel, whose red is the view's number.
struct Pixels;

impl DrawViews for Pixels {
    fn draw(&mut self, view: u32) -> anyhow::Result<DrawnView> {
        DrawnView::of_pixels(1, &[view as u8, 0, 0, 255], ImageFormat::Png)
    }
}

/// A prompt as it was asked.
type Prompt = DocumentPrompt<DrawnView>;

/// The text of a prompt's user message.
fn user(prompt: &Prompt) -> String {
    let texts = prompt.user.iter().filter_map(|part| match part {
        PromptPart::Text(text) => Some(text.as_str()),
        PromptPart::View(_) => None,
    });
    texts.collect()
}

struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    /// Builds; the result, and the prompts that were sent.
    fn build(
        &self,
        kind: DocumentKind,
        count: usize,
        recipe: &ModelRecipe,
        mut script: impl FnMut(usize, &Prompt) -> anyhow::Result<ChatReply>,
    ) -> (anyhow::Result<BuiltText>, Vec<Prompt>) {
        let mut asked = Vec::new();
        let ask = |prompt: &Prompt, _: &mut dyn FnMut()| {
            asked.push(prompt.clone());
            script(asked.len(), prompt)
        };
        let steps = self.folder.path().join("summary-4.steps");
        let mut builder = ModelBuilder::new(ask, Pixels, recipe.clone());
        let mut seen = Vec::new();
        let mut progress = |done, of| seen.push((done, of));
        let demonstrations = vec![demonstration(); count];
        let demonstrations = Vec::from_iter(&demonstrations);
        let built = builder.build(kind, &corridor(), &demonstrations, &steps, &mut progress);
        assert!(seen.is_sorted(), "{seen:?}");
        if built.is_ok() {
            assert!(seen.last().is_some_and(|(done, of)| done == of), "{seen:?}");
        }
        drop(builder);
        (built, asked)
    }

    fn steps(&self) -> Vec<String> {
        let folder = self.folder.path().join("summary-4.steps");
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<_> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

#[test]
fn each_summary_continues_the_previous_one() {
    let recipe = room_for(PromptStage::Summary, 2, 60);
    let script = |number, _: &Prompt| Ok(says(format!("# Summary {number}")));
    let (built, asked) = Bench::new().build(DocumentKind::Summary, 5, &recipe, script);
    let built = built.unwrap();
    assert_eq!(built.text, "# Summary 3\n");
    assert_eq!(
        built.account,
        BuildAccount {
            model: Some("scripted-1".into()),
            prompt_version: Some(PROMPT_VERSION),
            requests: Some(3),
            images: Some(0),
            prompt_tokens: Some(300),
            completion_tokens: Some(30),
        }
    );
    let numbers = |prompt: &Prompt| {
        (1..=5).filter(|n| user(prompt).contains(&format!("## Demonstration {n}\n"))).collect()
    };
    let shown: Vec<Vec<u32>> = asked.iter().map(numbers).collect();
    assert_eq!(shown, [vec![1, 2], vec![3, 4], vec![5]]);
    assert!(user(&asked[0]).contains("(There is none yet.)"));
    assert!(user(&asked[1]).contains("# Summary 1\n") && !user(&asked[2]).contains("Summary 1"));
    let longest = asked.iter().map(Prompt::chars);
    assert!(longest.max().is_some_and(|chars| chars <= recipe.context_chars));
}

#[test]
fn knowledge_is_extracted_consolidated_and_refined() {
    // Notes that fit twice into a prompt, so that four sets of them take two rounds.
    let recipe = room_for(PromptStage::Extract, 1, 0);
    let consolidate = room_for(PromptStage::Consolidate, 0, 0).context_chars;
    let notes = "n".repeat((recipe.context_chars - consolidate) / 2 - 20);
    let bench = Bench::new();
    let (built, asked) = bench.build(DocumentKind::Semantic, 4, &recipe, |number, _| {
        Ok(says(if number == 8 { "# Knowledge".to_owned() } else { notes.clone() }))
    });
    let built = built.unwrap();
    assert_eq!((&*built.text, built.account.requests), ("# Knowledge\n", Some(8)));
    assert_eq!(asked.len(), 8);
    assert_eq!(
        bench.steps(),
        [
            "001-extract.json",
            "002-extract.json",
            "003-extract.json",
            "004-extract.json",
            "005-consolidate.json",
            "006-consolidate.json",
            "007-consolidate.json",
            "008-refine.json",
        ]
    );
    assert!(user(&asked[4]).contains("## Notes 2\n") && !user(&asked[4]).contains("## Notes 3"));
}

#[test]
fn a_stopped_build_continues_and_a_finished_one_asks_nothing() {
    for kind in [DocumentKind::Summary, DocumentKind::Semantic] {
        let recipe = room_for(PromptStage::Summary, 1, 60);
        let fails_at = |number, _: &Prompt| match number {
            3 => bail!("the server is gone"),
            _ => Ok(says(format!("# Text {number}"))),
        };
        let bench = Bench::new();
        let (built, asked) = bench.build(kind, 4, &recipe, fails_at);
        let error = format!("{:#}", built.unwrap_err());
        assert!(error.contains("the server is gone"), "{error}");
        assert_eq!((asked.len(), bench.steps().len()), (3, 2));

        let (built, rest) =
            bench.build(kind, 4, &recipe, |n, _| Ok(says(format!("# Text {}", n + 2))));
        let whole = Bench::new().build(kind, 4, &recipe, |n, _| Ok(says(format!("# Text {n}"))));
        assert_eq!(built.as_ref().unwrap(), &whole.0.unwrap());
        assert_eq!([&asked[..2], &rest].concat(), whole.1, "nothing is asked twice");

        let unreachable = |_, _: &Prompt| -> anyhow::Result<ChatReply> { panic!("asked") };
        let (again, _) = bench.build(kind, 4, &recipe, unreachable);
        assert_eq!(again.unwrap(), built.unwrap());
    }
}

/// The numbers of the views in each prompt.
fn shown(asked: &[Prompt]) -> Vec<Vec<u32>> {
    let number = |view: &DrawnView| {
        let is_it = |number: &u32| Pixels.draw(*number).unwrap() == *view;
        (0..256).find(is_it).unwrap()
    };
    asked.iter().map(|prompt| prompt.views().map(number).collect()).collect()
}

#[test]
fn prompts_show_keyframes_within_the_image_budget() {
    let recipe = ModelRecipe { views: 3, image_budget: 7, ..room_for(PromptStage::Summary, 9, 99) };
    let script = |number, _: &Prompt| Ok(says(format!("# Text {number}")));
    for (kind, others) in [(DocumentKind::Summary, 0), (DocumentKind::Semantic, 2)] {
        let (built, asked) = Bench::new().build(kind, 5, &recipe, script);
        let account = built.unwrap().account;
        // Start, door and end of two demonstrations each.
        let pair = vec![0, 4, 6, 0, 4, 6];
        let mut expected = vec![pair.clone(), pair, vec![0, 4, 6]];
        expected.extend(vec![Vec::new(); others]);
        assert_eq!(shown(&asked), expected);
        assert_eq!((account.requests, account.images), (Some(3 + others as u64), Some(15)));
        assert!(user(&asked[1]).contains("Image 6:\n") && !user(&asked[1]).contains("Image 7"));
    }
    let none = ModelRecipe { image_budget: 0, ..recipe };
    let (_, asked) = Bench::new().build(DocumentKind::Summary, 5, &none, script);
    assert_eq!(shown(&asked), [Vec::<u32>::new()]);
}

#[test]
fn a_view_that_is_not_drawn_fails_the_build() {
    struct Blind;
    impl DrawViews for Blind {
        fn draw(&mut self, view: u32) -> anyhow::Result<DrawnView> {
            bail!("no view {view}")
        }
    }
    let recipe = ModelRecipe { views: 1, ..room_for(PromptStage::Summary, 1, 999) };
    let ask = |_: &Prompt, _: &mut dyn FnMut()| panic!("asked");
    let bench = Bench::new();
    let built = ModelBuilder::new(ask, Blind, recipe).build(
        DocumentKind::Summary,
        &corridor(),
        &[&demonstration()],
        bench.folder.path(),
        &mut |_, _| (),
    );
    let error = format!("{:#}", built.unwrap_err());
    assert_eq!(error, "the stage `summary` of the document failed: no view 0");
}

#[test]
fn a_request_has_images_where_the_prompt_has_views_and_is_plain_text_without() {
    let recipe = ModelRecipe { views: 1, ..room_for(PromptStage::Extract, 2, 999) };
    let script = |_, _: &Prompt| Ok(says("# Text"));
    let (_, asked) = Bench::new().build(DocumentKind::Semantic, 2, &recipe, script);
    let MessageContent::Parts(parts) = request(&asked[0]).messages.remove(1).content else {
        panic!("no parts")
    };
    let words = parts.iter().map(|part| match part {
        ContentPart::Text { text } => text.lines().last().unwrap(),
        ContentPart::ImageUrl { image_url } => &image_url.url[..22],
    });
    let image = "data:image/png;base64,";
    let words: Vec<&str> = words.collect();
    assert_eq!(words, ["Image 1:", image, "Image 2:", image, "Extract the knowledge."]);
    let content = request(&asked[1]).messages.remove(1).content;
    assert!(matches!(content, MessageContent::Text(_)), "{content:?}");
}

/// What is asked is what was estimated, and answers of any allowed length are within the estimate.
#[test]
fn requests_are_within_the_estimate() {
    let recipe = ModelRecipe { views: 2, ..room_for(PromptStage::Summary, 4, 3000) };
    let demonstrations = vec![demonstration(); 20];
    let book = DemonstrationBook {
        world: corridor(),
        cases: (0..20)
            .map(|own| CaseDemonstrations { own: vec![own], ..Default::default() })
            .collect(),
        demonstrations,
        ..DemonstrationBook::default()
    };
    let sources = Sources::new(book, 448, Appearance::STANDARD);
    for kind in DocumentKind::TEXTS {
        let name = DocumentName { kind, demonstrations: Demonstrations::ORIGINAL };
        let estimate = BuildEstimate::of(name, &sources, &recipe);
        for length in [1, 900, 2300] {
            let script = |_, _: &Prompt| Ok(says("n".repeat(length)));
            let (built, asked) = Bench::new().build(kind, 20, &recipe, script);
            let BuiltText { account, .. } = built.unwrap();
            let [least, most] = estimate.requests;
            assert!((least..=most).contains(&account.requests.unwrap()), "{length}: {estimate:?}");
            assert_eq!(account.images, Some(estimate.images));
            let chars: usize = asked.iter().map(Prompt::chars).sum();
            let text = (chars as f64 / tokens::PROSE) as u64 + tokens::IMAGE * estimate.images;
            let [_, most] = estimate.prompt_tokens;
            assert!(text <= most, "{kind:?} {length}: {text} {most}");
        }
        if kind == DocumentKind::Summary {
            assert!(estimate.requests[0] < estimate.requests[1]);
        }
    }
}

#[test]
fn counts_that_the_server_does_not_report_are_absent() {
    let recipe = room_for(PromptStage::Summary, 1, 60);
    let script = |number, _: &Prompt| {
        let prompt_tokens = (number != 2).then_some(7);
        Ok(ChatReply { model: None, prompt_tokens, ..says("# Summary") })
    };
    let (built, _) = Bench::new().build(DocumentKind::Summary, 3, &recipe, script);
    let BuildAccount { model, prompt_tokens, completion_tokens, .. } = built.unwrap().account;
    assert_eq!((model, prompt_tokens, completion_tokens), (None, None, Some(30)));
}

#[test]
fn an_unusable_answer_fails_the_build_and_is_not_stored() {
    for (content, expected) in [
        (ReplyContent::Empty, "answer is empty"),
        (ReplyContent::Refusal("No.".into()), "refused to answer: \"No.\""),
        (ReplyContent::Text("```\n```".into()), "has no text in it"),
        (
            ReplyContent::Length("# A\nb\nhal".into()),
            "the model's answer was cut off after 10 tokens, and nothing of it is stored: raise --max-tokens",
        ),
    ] {
        let (bench, recipe) = (Bench::new(), room_for(PromptStage::Summary, 9, 60));
        let script = |_, _: &Prompt| Ok(reply(content.clone()));
        let (built, _) = bench.build(DocumentKind::Summary, 1, &recipe, script);
        let error = format!("{:#}", built.unwrap_err());
        assert!(error.contains(expected), "{error}");
        assert!(bench.steps().is_empty());
    }
}

#[test]
fn fences_around_an_answer_are_removed() {
    for (text, expected) in [
        (" # A\nb\n", Some("# A\nb")),
        ("```markdown\n# A\nb\n```\n", Some("# A\nb")),
        ("```", None),
    ] {
        assert_eq!(text_of(&says(text)), expected, "{text:?}");
    }
}

#[test]
fn material_that_does_not_fit_is_an_error_before_any_request() {
    let long = "n".repeat(4000);
    for (kind, stage, told, asked_before, expected) in [
        (DocumentKind::Summary, PromptStage::Summary, 0, 0, "demonstration 1 has"),
        (DocumentKind::Summary, PromptStage::Summary, 1, 1, "beside a summary of 4000"),
        (DocumentKind::Semantic, PromptStage::Extract, 0, 0, "for the stage `extract`"),
        (DocumentKind::Semantic, PromptStage::Extract, 1, 3, "for the stage `consolidate`"),
    ] {
        let recipe = room_for(stage, told, 30);
        let (built, asked) = Bench::new().build(kind, 3, &recipe, |_, _| Ok(says(&long)));
        let error = format!("{:#}", built.unwrap_err());
        assert!(error.contains(expected), "{error}");
        assert_eq!(asked.len(), asked_before);
    }
}

#[test]
fn a_document_needs_demonstrations_and_has_a_maximum_size() {
    for kind in [DocumentKind::Summary, DocumentKind::Semantic] {
        let recipe = room_for(PromptStage::Summary, 1, 60);
        let (built, _) = Bench::new().build(kind, 0, &recipe, |_, _| Ok(says("# A")));
        assert!(format!("{:#}", built.unwrap_err()).contains("there are no demonstrations"));
    }
    let recipe = ModelRecipe { context_chars: 100_000, ..room_for(PromptStage::Summary, 1, 60) };
    let long = "n".repeat(MAX_DOCUMENT_BYTES + 1);
    let (built, _) = Bench::new().build(DocumentKind::Summary, 1, &recipe, |_, _| Ok(says(&long)));
    assert!(format!("{:#}", built.unwrap_err()).contains("at most 262144 fit"));
}
