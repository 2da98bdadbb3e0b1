use case_book::{ActionDeclaration, StateField};
use domain::{ActionCode, DemonstrationKind, FeedbackCode};

use super::*;

const EAST: u8 = 0;
const OPEN: u8 = 1;

/// A corridor with a door that stands between cell 3 and cell 4.
fn corridor() -> WorldDeclaration {
    let action = |letter, words: &str| ActionDeclaration { letter, words: words.to_owned() };
    let doors = ["closed", "open"].map(str::to_owned).to_vec();
    WorldDeclaration {
        name: "corridor".to_owned(),
        actions: vec![action('e', "walk east"), action('o', "open the door")],
        state: vec![
            StateField { name: "cell".to_owned(), words: Vec::new(), digits: 0 },
            StateField { name: "door".to_owned(), words: doors, digits: 0 },
        ],
        state_sentence: "You are in cell {cell}, and the door is {door}.".to_owned(),
        feedback: ["Go.", "Done.", "There is a door.", "What?"].map(str::to_owned).to_vec(),
        ..WorldDeclaration::default()
    }
}

/// A demonstration from a cell.
fn demonstration(instruction: &str, cell: u8, actions: &[u8], sub_goals: &[u32]) -> Demonstration {
    let mut at = [f32::from(cell), 0.0];
    let mut states = vec![State::new(&at).unwrap()];
    let mut feedback = vec![FeedbackCode::START];
    for action in actions {
        let is_stopped = at == [3.0, 0.0] && *action == EAST;
        match *action {
            _ if is_stopped => {}
            EAST => at[0] += 1.0,
            _ => at[1] = 1.0,
        }
        states.push(State::new(&at).unwrap());
        feedback.push(FeedbackCode(if is_stopped { 2 } else { 1 }));
    }
    Demonstration {
        case: 0,
        kind: DemonstrationKind::Original,
        variant: 0,
        instruction: instruction.to_owned(),
        views: (0..).take(states.len()).collect(),
        states,
        feedback,
        sub_goals: sub_goals.to_vec(),
        actions: actions.iter().copied().map(ActionCode).collect(),
    }
}

fn demonstrations() -> Vec<Demonstration> {
    vec![
        demonstration("Open it, then walk on.", 1, &[EAST, EAST, EAST, OPEN, EAST, EAST], &[4, 6]),
        demonstration("Walk to cell 3.", 1, &[EAST, EAST], &[2]),
        demonstration("Walk to cell 3.", 2, &[EAST], &[1]),
        demonstration("Open it.", 0, &[EAST, EAST, EAST, EAST, OPEN], &[5]),
        demonstration("Open it.", 2, &[OPEN], &[1]),
    ]
}

fn build(kind: DocumentKind, demonstrations: &[Demonstration]) -> String {
    text(kind, &corridor(), &Vec::from_iter(demonstrations)).unwrap()
}

#[test]
fn a_summary_tells_each_demonstration_in_words() {
    insta::assert_snapshot!(build(DocumentKind::Summary, &demonstrations()[..2]), @r#"
    # Summary of the demonstrations
    A number after an action says how often in a row it was taken.

    ## "Open it, then walk on."
    - start: You are in cell 1, and the door is closed.
    - walk east 2, walk east ("There is a door."), open the door
    - sub-goal 1 of 2: You are in cell 3, and the door is open.
    - walk east 2
    - end: You are in cell 5, and the door is open.

    ## "Walk to cell 3."
    - start: You are in cell 1, and the door is closed.
    - walk east 2
    - end: You are in cell 3, and the door is closed.
    "#);
}

#[test]
fn general_knowledge_is_what_demonstrations_have_in_common() {
    insta::assert_snapshot!(build(DocumentKind::Semantic, &demonstrations()), @r#"
    # Knowledge of the world corridor

    ## What actions change
    - walk east, taken 12 times: cell 10 times, nothing 2 times ("There is a door.")
    - open the door, taken 3 times: door 3 times

    ## Where tasks end
    - "Open it, then walk on." (1 of 5): You are in cell 5, and the door is open.
    - "Open it." (2 of 5): door open in all of them
    - "Walk to cell 3." (2 of 5): You are in cell 3, and the door is closed.

    ## Where several demonstrations pass
    - 5 of 5: You are in cell 2, and the door is closed.
    - 4 of 5: You are in cell 3, and the door is closed.
    - 3 of 5: You are in cell 1, and the door is closed.
    - 2 of 5: You are in cell 3, and the door is open.
    "#);
}

#[test]
fn other_demonstrations_give_other_texts() {
    let all = demonstrations();
    for kind in DocumentKind::TEXTS {
        let texts: BTreeSet<String> = (0..=all.len()).map(|end| build(kind, &all[..end])).collect();
        assert_eq!(texts.len(), all.len() + 1, "{kind:?}");
        assert!(texts.iter().all(|text| text.starts_with("# ")));
    }
    assert!(text(DocumentKind::Note, &corridor(), &[]).is_err());
}

/// Nothing gets into a document that is not in the words of a demonstration.
#[test]
fn cases_variants_and_pictures_make_no_difference() {
    let mut others = demonstrations();
    for (other, number) in others.iter_mut().zip(10..) {
        (other.case, other.variant, other.kind) = (number, number, DemonstrationKind::After);
        other.views.fill(number);
    }
    for kind in DocumentKind::TEXTS {
        assert_eq!(build(kind, &others), build(kind, &demonstrations()));
    }
}

#[test]
fn a_long_list_of_states_is_cut_to_those_that_most_demonstrations_pass() {
    let walk = |cell, steps| {
        demonstration(
            "Walk.",
            cell,
            &vec![OPEN; 1].into_iter().chain(vec![EAST; steps]).collect::<Vec<_>>(),
            &[],
        )
    };
    let text = build(DocumentKind::Semantic, &[walk(0, 60), walk(0, 60), walk(50, 5)]);
    let (_, passed) = text.split_once("## Where several demonstrations pass\n").unwrap();
    assert_eq!(passed.lines().count(), MOST_STATES);
    assert!(passed.starts_with("- 3 of 3: You are in cell 50,"), "{passed}");
}
