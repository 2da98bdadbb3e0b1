//! The builder with a scripted conversation instead of a model.

use std::sync::Arc;

use domain::{Action, Cell, Feedback, Heading, Pose};
use plates::{Landmark, Plate};
use tempfile::TempDir;

use super::super::{Seen, Step};
use super::*;

/// Answers by a function of the request, and remembers what it was asked.
struct Scripted<F> {
    script: F,
    asked: Vec<Request>,
}

impl<F: FnMut(usize, &Request) -> Result<Reply, ChatError>> Chat for &mut Scripted<F> {
    fn ask(&mut self, request: &Request, _: &mut dyn FnMut()) -> Result<Reply, ChatError> {
        self.asked.push(request.clone());
        (self.script)(self.asked.len(), request)
    }
}

fn says(text: impl Into<String>) -> Reply {
    Reply {
        text: text.into(),
        outcome: Outcome::Text,
        model: Some("scripted-1".into()),
        prompt_tokens: Some(100),
        completion_tokens: Some(10),
    }
}

/// A walk of two steps past a barrel to a cone behind a turn.
fn transcript(instruction: &str) -> Transcript {
    let barrel = Landmark {
        standpoint: Cell::new(3, 5),
        face: Heading::W,
        plate: Plate::new("barrels", "blue barrel"),
    };
    let cone = Landmark { plate: Plate::new("cones", "orange cone"), ..barrel };
    let (none, one, both) = (vec![], vec![barrel], vec![barrel, cone]);
    let step = |y, heading, feedback, landmarks: &Vec<_>, completed, action| Step {
        pose: Pose::new(3, y, heading),
        feedback,
        seen: Arc::new(Seen { frame: [0; 16], landmarks: landmarks.clone() }),
        completed,
        action,
    };
    use Heading::{N, W};
    let forward = Some(Action::Forward);
    Transcript {
        instruction: instruction.into(),
        steps: vec![
            step(2, N, Feedback::Start, &one, 0, forward),
            step(3, N, Feedback::Moved, &one, 0, forward),
            step(4, N, Feedback::Moved, &none, 0, forward),
            step(4, N, Feedback::Blocked, &none, 0, forward),
            step(5, N, Feedback::Moved, &none, 1, Some(Action::TurnLeft)),
            step(5, W, Feedback::Turned, &both, 1, None),
        ],
    }
}

fn transcripts(count: usize) -> Vec<Transcript> {
    (0..count).map(|_| transcript("Find a blue barrel.")).collect()
}

/// The settings in which a prompt of `stage` has room for `told` demonstrations beside `other` characters.
fn room_for(stage: Stage, told: usize, other: usize) -> Settings {
    let words = stage.request(0, &[("limit", "2000")]).messages;
    let words: usize = words.iter().map(|message| chars(&message.content)).sum();
    let one = chars(&telling::tell(1, &transcripts(1)[0])) + 20;
    let context_chars = words + told * one + other;
    Settings { model: "m".into(), context_chars, max_tokens: 1000 }
}

struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    /// Builds; the outcome, and what was asked on the way.
    fn build(
        &self,
        kind: DocumentKind,
        count: usize,
        settings: &Settings,
        script: impl FnMut(usize, &Request) -> Result<Reply, ChatError>,
    ) -> (anyhow::Result<Built>, Vec<Request>) {
        let mut chat = Scripted { script, asked: Vec::new() };
        let steps = self.folder.path().join("summary-4.steps");
        let mut builder = ModelBuilder::new(&mut chat, settings.clone());
        let mut seen = Vec::new();
        let mut progress = |done, of| seen.push((done, of));
        let built = builder.build(kind, &transcripts(count), &steps, &mut progress);
        assert!(seen.is_sorted(), "{seen:?}");
        if built.is_ok() {
            assert!(seen.last().is_some_and(|(done, of)| done == of), "{seen:?}");
        }
        (built, chat.asked)
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

fn user(request: &Request) -> &str {
    &request.messages[1].content
}

#[test]
fn a_demonstration_as_it_is_told() {
    insta::assert_snapshot!(telling::tell(7, &transcript("Find a blue barrel.")), @r#"
    ## Demonstration 7
    Task: "Find a blue barrel."
    - start: at (3, 2) facing N
    - sees blue barrel [plate 554-611]: stand at (3, 5) facing W
    - move forward 3: at (3, 4) facing N
    - the way is blocked
    - move forward: at (3, 5) facing N
    - sub-goal 1 of the task is completed
    - turn left: at (3, 5) facing W
    - sees item [plate 316-110]: stand at (3, 5) facing W
    "#);
}

#[test]
fn a_summary_goes_on_from_the_one_before() {
    let settings = room_for(Stage::Summary, 2, 60);
    let script = |number, _: &Request| Ok(says(format!("# Summary {number}")));
    let (built, asked) = Bench::new().build(DocumentKind::Summary, 5, &settings, script);
    let built = built.unwrap();
    assert_eq!(built.text, "# Summary 3\n");
    assert_eq!(
        built.account,
        Account {
            model: Some("scripted-1".into()),
            prompt_version: Some(PROMPT_VERSION),
            requests: Some(3),
            cut_off: Some(0),
            prompt_tokens: Some(300),
            completion_tokens: Some(30),
        }
    );
    let numbers = |request: &Request| {
        (1..=5).filter(|n| user(request).contains(&format!("## Demonstration {n}\n"))).collect()
    };
    let shown: Vec<Vec<u32>> = asked.iter().map(numbers).collect();
    assert_eq!(shown, [vec![1, 2], vec![3, 4], vec![5]]);
    assert!(user(&asked[0]).contains("(There is none yet.)"));
    assert!(user(&asked[1]).contains("# Summary 1\n") && !user(&asked[2]).contains("Summary 1"));
    let longest = asked.iter().map(|r| r.messages.iter().map(|m| chars(&m.content)).sum());
    assert!(longest.max().is_some_and(|chars: usize| chars <= settings.context_chars));
}

#[test]
fn knowledge_is_extracted_consolidated_and_refined() {
    // Notes that fit twice into a prompt, so that four sets of them take two rounds.
    let settings = room_for(Stage::Extract, 1, 0);
    let consolidate = room_for(Stage::Consolidate, 0, 0).context_chars;
    let notes = "n".repeat((settings.context_chars - consolidate) / 2 - 20);
    let bench = Bench::new();
    let (built, asked) = bench.build(DocumentKind::Semantic, 4, &settings, |number, _| {
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
fn a_build_that_was_stopped_goes_on_and_a_finished_one_asks_nothing() {
    for kind in [DocumentKind::Summary, DocumentKind::Semantic] {
        let settings = room_for(Stage::Summary, 1, 60);
        let fails_at = |number, _: &Request| match number {
            3 => Err(ChatError::NoReply("the server is gone".into())),
            _ => Ok(says(format!("# Text {number}"))),
        };
        let bench = Bench::new();
        let (built, asked) = bench.build(kind, 4, &settings, fails_at);
        let error = format!("{:#}", built.unwrap_err());
        assert!(error.contains("the server is gone"), "{error}");
        assert_eq!((asked.len(), bench.steps().len()), (3, 2));

        let (built, rest) =
            bench.build(kind, 4, &settings, |n, _| Ok(says(format!("# Text {}", n + 2))));
        let whole = Bench::new().build(kind, 4, &settings, |n, _| Ok(says(format!("# Text {n}"))));
        assert_eq!(built.as_ref().unwrap(), &whole.0.unwrap());
        assert_eq!([&asked[..2], &rest].concat(), whole.1, "nothing is asked twice");

        let nobody = |_, _: &Request| -> Result<Reply, ChatError> { panic!("asked") };
        let (again, _) = bench.build(kind, 4, &settings, nobody);
        assert_eq!(again.unwrap(), built.unwrap());
    }
}

#[test]
fn what_was_not_counted_is_absent() {
    let settings = room_for(Stage::Summary, 1, 60);
    let script = |number, _: &Request| {
        let prompt_tokens = (number != 2).then_some(7);
        Ok(Reply { model: None, prompt_tokens, ..says("# Summary") })
    };
    let (built, _) = Bench::new().build(DocumentKind::Summary, 3, &settings, script);
    let Account { model, prompt_tokens, completion_tokens, .. } = built.unwrap().account;
    assert_eq!((model, prompt_tokens, completion_tokens), (None, None, Some(30)));
}

#[test]
fn an_answer_that_is_none_fails_the_build_and_is_not_kept() {
    for (outcome, text, expected) in [
        (Outcome::Empty, "", "answered with nothing"),
        (Outcome::Refusal, "No.", "refused to answer: \"No.\""),
        (Outcome::Text, "```\n```", "has no text in it"),
        (Outcome::Length, "# Summ", "cut off before its first sentence ended"),
    ] {
        let (bench, settings) = (Bench::new(), room_for(Stage::Summary, 9, 60));
        let script = |_, _: &Request| Ok(Reply { outcome, ..says(text) });
        let (built, _) = bench.build(DocumentKind::Summary, 1, &settings, script);
        let error = format!("{:#}", built.unwrap_err());
        assert!(error.contains(expected), "{error}");
        assert!(bench.steps().is_empty());
    }
}

#[test]
fn what_models_wrap_around_an_answer_is_taken_off() {
    for (outcome, text, expected) in [
        (Outcome::Text, " # A\nb\n", Some("# A\nb")),
        (Outcome::Text, "```markdown\n# A\nb\n```\n", Some("# A\nb")),
        (Outcome::Length, "```\n# A\nb\nhal", Some("# A\nb")),
        (Outcome::Length, "# A\nb\nhal", Some("# A\nb")),
        (Outcome::Length, "A. B. hal", Some("A. B.")),
        (Outcome::Length, "half", None),
        (Outcome::Text, "```", None),
    ] {
        assert_eq!(text_of(&Reply { outcome, ..says(text) }), expected, "{text:?}");
    }
}

#[test]
fn an_answer_that_was_cut_off_is_counted() {
    let settings = room_for(Stage::Summary, 9, 60);
    let script = |_, _: &Request| Ok(Reply { outcome: Outcome::Length, ..says("# A\nb\nhal") });
    let built = Bench::new().build(DocumentKind::Summary, 1, &settings, script).0.unwrap();
    assert_eq!((&*built.text, built.account.cut_off), ("# A\nb\n", Some(1)));
}

#[test]
fn what_does_not_fit_is_said_before_anybody_is_asked() {
    let long = "n".repeat(4000);
    for (kind, stage, told, asked_before, expected) in [
        (DocumentKind::Summary, Stage::Summary, 0, 0, "demonstration 1 has"),
        (DocumentKind::Summary, Stage::Summary, 1, 1, "beside a summary of 4000"),
        (DocumentKind::Semantic, Stage::Extract, 0, 0, "for the stage `extract`"),
        (DocumentKind::Semantic, Stage::Extract, 1, 3, "for the stage `consolidate`"),
    ] {
        let settings = room_for(stage, told, 30);
        let (built, asked) = Bench::new().build(kind, 3, &settings, |_, _| Ok(says(&long)));
        let error = format!("{:#}", built.unwrap_err());
        assert!(error.contains(expected), "{error}");
        assert_eq!(asked.len(), asked_before);
    }
}

#[test]
fn a_document_is_not_made_of_nothing_and_not_without_bounds() {
    for kind in [DocumentKind::Summary, DocumentKind::Semantic] {
        let settings = room_for(Stage::Summary, 1, 60);
        let (built, _) = Bench::new().build(kind, 0, &settings, |_, _| Ok(says("# A")));
        assert!(format!("{:#}", built.unwrap_err()).contains("there are no demonstrations"));
    }
    let settings = Settings { context_chars: 100_000, ..room_for(Stage::Summary, 1, 60) };
    let long = "n".repeat(LARGEST_DOCUMENT + 1);
    let (built, _) =
        Bench::new().build(DocumentKind::Summary, 1, &settings, |_, _| Ok(says(&long)));
    assert!(format!("{:#}", built.unwrap_err()).contains("262144 is the most"));
}
