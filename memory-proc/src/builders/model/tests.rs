//! The builder with a scripted model.

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

/// A recipe whose prompts of `stage` have room for `count` demonstrations beside `other` characters.
fn room_for(stage: PromptStage, count: usize, other: usize) -> ModelRecipe {
    let words = stage.prompt(0, &[("limit", "2000")]).chars();
    let one = chars(&narration::narrate(1, &corridor(), &demonstration())) + 20;
    let context_chars = words + count * one + other;
    ModelRecipe { context_chars, max_tokens: 1000, ..ModelRecipe::new("m") }
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
        mut script: impl FnMut(usize, &DocumentPrompt) -> anyhow::Result<ChatReply>,
    ) -> (anyhow::Result<BuiltText>, Vec<DocumentPrompt>) {
        let mut asked = Vec::new();
        let ask = |prompt: &DocumentPrompt, _: &mut dyn FnMut()| {
            asked.push(prompt.clone());
            script(asked.len(), prompt)
        };
        let steps = self.folder.path().join("summary-4.steps");
        let mut builder = ModelBuilder::new(ask, recipe.clone());
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
fn a_demonstration_in_words() {
    insta::assert_snapshot!(narration::narrate(7, &corridor(), &demonstration()), @r#"
    ## Demonstration 7
    Task: "Walk to cell 5."
    - start: You are in cell 1, and the door is closed.
    - walk east 2: You are in cell 3, and the door is closed.
    - walk east: You are in cell 3, and the door is closed.
    - told: There is a door.
    - open the door: You are in cell 3, and the door is open.
    - sub-goal 1 of the task is completed
    - walk east 2: You are in cell 5, and the door is open.
    - sub-goal 2 of the task is completed
    "#);
}

#[test]
fn each_summary_continues_the_previous_one() {
    let recipe = room_for(PromptStage::Summary, 2, 60);
    let script = |number, _: &DocumentPrompt| Ok(says(format!("# Summary {number}")));
    let (built, asked) = Bench::new().build(DocumentKind::Summary, 5, &recipe, script);
    let built = built.unwrap();
    assert_eq!(built.text, "# Summary 3\n");
    assert_eq!(
        built.account,
        BuildAccount {
            model: Some("scripted-1".into()),
            prompt_version: Some(PROMPT_VERSION),
            requests: Some(3),
            cut_off: None,
            prompt_tokens: Some(300),
            completion_tokens: Some(30),
        }
    );
    let numbers = |prompt: &DocumentPrompt| {
        (1..=5).filter(|n| prompt.user.contains(&format!("## Demonstration {n}\n"))).collect()
    };
    let shown: Vec<Vec<u32>> = asked.iter().map(numbers).collect();
    assert_eq!(shown, [vec![1, 2], vec![3, 4], vec![5]]);
    assert!(asked[0].user.contains("(There is none yet.)"));
    assert!(asked[1].user.contains("# Summary 1\n") && !asked[2].user.contains("Summary 1"));
    let longest = asked.iter().map(DocumentPrompt::chars);
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
    assert!(asked[4].user.contains("## Notes 2\n") && !asked[4].user.contains("## Notes 3"));
}

#[test]
fn a_stopped_build_continues_and_a_finished_one_asks_nothing() {
    for kind in [DocumentKind::Summary, DocumentKind::Semantic] {
        let recipe = room_for(PromptStage::Summary, 1, 60);
        let fails_at = |number, _: &DocumentPrompt| match number {
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

        let unreachable = |_, _: &DocumentPrompt| -> anyhow::Result<ChatReply> { panic!("asked") };
        let (again, _) = bench.build(kind, 4, &recipe, unreachable);
        assert_eq!(again.unwrap(), built.unwrap());
    }
}

#[test]
fn counts_that_the_server_does_not_report_are_absent() {
    let recipe = room_for(PromptStage::Summary, 1, 60);
    let script = |number, _: &DocumentPrompt| {
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
        let script = |_, _: &DocumentPrompt| Ok(reply(content.clone()));
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
