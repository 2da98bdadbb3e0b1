use std::collections::BTreeSet;

use case_book::BookRequest;
use documents::Sources;
use domain::{Appearance, DemonstrationKind, Demonstrations, State};
use warehouse::case_book::write_books;
use warehouse::{CaseSet, Warehouse};

use super::super::testing::{EAST, OPEN, corridor, demonstration};
use super::*;

fn demonstrations() -> Vec<Demonstration> {
    vec![
        demonstration("Open it, then walk on.", 1, &[EAST, EAST, EAST, OPEN, EAST, EAST], &[4, 6]),
        demonstration("Walk to cell 3.", 1, &[EAST, EAST], &[2]),
        demonstration("Walk to cell 3.", 2, &[EAST], &[1]),
        demonstration("Open it.", 0, &[EAST, EAST, EAST, EAST, OPEN], &[5]),
        demonstration("Walk around.", 2, &[OPEN, EAST], &[]),
    ]
}

fn build(kind: DocumentKind, demonstrations: &[Demonstration]) -> String {
    try_build(kind, demonstrations).unwrap()
}

fn try_build(kind: DocumentKind, demonstrations: &[Demonstration]) -> Result<String> {
    of_world(kind, &corridor(), &Vec::from_iter(demonstrations))
}

fn of_world(
    kind: DocumentKind,
    world: &WorldDeclaration,
    demonstrations: &[&Demonstration],
) -> Result<String> {
    let built = Extractive.build(kind, world, demonstrations, Path::new(""), &mut |_, _| ())?;
    Ok(built.text)
}

#[test]
fn a_summary_tells_each_demonstration_in_words() {
    insta::assert_snapshot!(build(DocumentKind::Summary, &demonstrations()), @r#"
    # Summary of the demonstrations
    A number after an action says how often in a row it was taken.

    ## "Open it, then walk on."
    - start: You are in cell 1, and the door is closed.
    - walk east 2, walk east ("There is a door."), open the door
    - sub-goal 1 of 2: You are in cell 3, and the door is open.
    - walk east 2
    - sub-goal 2 of 2: You are in cell 5, and the door is open.

    ## "Walk to cell 3."
    - start: You are in cell 1, and the door is closed.
    - walk east 2
    - sub-goal 1 of 1: You are in cell 3, and the door is closed.
    - start: You are in cell 2, and the door is closed.
    - walk east
    - sub-goal 1 of 1: You are in cell 3, and the door is closed.

    ## "Open it."
    - start: You are in cell 0, and the door is closed.
    - walk east 3, walk east ("There is a door."), open the door
    - sub-goal 1 of 1: You are in cell 3, and the door is open.

    ## "Walk around."
    - start: You are in cell 2, and the door is closed.
    - open the door, walk east
    - end: You are in cell 3, and the door is open.
    "#);
}

#[test]
fn general_knowledge_is_what_demonstrations_have_in_common() {
    insta::assert_snapshot!(build(DocumentKind::Semantic, &demonstrations()), @r#"
    # General knowledge of the world corridor
    Numbers of actions are medians over 5 demonstrations, with the least and the most in brackets.

    ## What actions change
    - open the door, 3 of 16 actions: door 100 %
    - walk east, 13 of 16 actions: cell 85 %, nothing ("There is a door.") 15 %

    ## How actions follow each other
    - open the door: 1 in a row, then walk east 100 %
    - walk east: 2 (1 to 4) in a row, then open the door 100 %

    ## How tasks go
    - actions that complete sub-goals: walk east 60 %, open the door 40 %
    - 0 sub-goals, 1 of 5 demonstrations: 2 actions
    - 1 sub-goal, 3 of 5 demonstrations: 2 (1 to 5) actions
    - 2 sub-goals, 1 of 5 demonstrations: 4 actions to the first, 2 to each further one
    "#);
}

#[test]
fn equal_demonstrations_are_told_once_and_what_follows_the_last_sub_goal_is_not() {
    let all = demonstrations();
    let mut more = all.clone();
    more.extend_from_within(..);
    more[2] = demonstration("Walk to cell 3.", 2, &[EAST, OPEN], &[1]);
    assert_eq!(build(DocumentKind::Summary, &more), build(DocumentKind::Summary, &all));
}

#[test]
fn other_demonstrations_give_other_texts() {
    let all = demonstrations();
    for kind in DocumentKind::TEXTS {
        let texts: BTreeSet<String> = (0..=all.len()).map(|end| build(kind, &all[..end])).collect();
        assert_eq!(texts.len(), all.len() + 1, "{kind:?}");
        assert!(texts.iter().all(|text| text.starts_with("# ")));
    }
    assert!(try_build(DocumentKind::Note, &[]).is_err());
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

fn warehouse(assets: Option<&Path>) -> Sources {
    let request = BookRequest {
        assets: assets.map(Into::into),
        elsewhere: Some(case_book::ElsewhereRequest { assets: None, seed: 1 }),
        ..BookRequest::default()
    };
    Sources::new(write_books(&request).unwrap().demonstrations, 448, Appearance::STANDARD)
}

fn of_warehouse(kind: DocumentKind, sources: &Sources, set: Demonstrations) -> String {
    of_world(kind, &sources.book().world, &sources.demonstrations(set)).unwrap()
}

#[test]
fn general_knowledge_has_no_states_and_depends_on_its_demonstrations() {
    let sources = warehouse(None);
    let mut elsewhere = sources.book().clone();
    for of in &mut elsewhere.demonstrations {
        for state in &mut of.states {
            let &[column, row, heading] = state.numbers() else { panic!("{state}") };
            *state = State::new(&[column + 100.0, row + 100.0, heading]).unwrap();
        }
    }
    let elsewhere = Sources::new(elsewhere, 448, Appearance::STANDARD);
    let sets = ["original", "4", "irrelevant", "confusable", "elsewhere"];
    let text = |set: &str| {
        let set = set.parse().unwrap();
        let text = of_warehouse(DocumentKind::Semantic, &sources, set);
        assert_eq!(text, of_warehouse(DocumentKind::Semantic, &elsewhere, set));
        text
    };
    assert_eq!(sets.map(text).into_iter().collect::<BTreeSet<_>>().len(), sets.len());
    insta::assert_snapshot!(text("4"), @r#"
    # General knowledge of the world warehouse
    Numbers of actions are medians over 400 demonstrations, with the least and the most in brackets.

    ## What actions change
    - move backward, 1 of 13243 actions: column 100 %
    - move forward, 10145 of 13243 actions: row 66 %, column 34 %
    - move left, 519 of 13243 actions: row 62 %, column 38 %
    - move right, 317 of 13243 actions: row 63 %, column 37 %
    - turn around, 138 of 13243 actions: heading 100 %
    - turn left, 1089 of 13243 actions: heading 100 %
    - turn right, 1034 of 13243 actions: heading 100 %

    ## How actions follow each other
    - move backward: 1 in a row, then move right 100 %
    - move forward: 3 (1 to 14) in a row, then turn left 47 %, turn right 41 %, move left 6 %, move right 4 %, turn around 2 %
    - move left: 1 (1 to 11) in a row, then move forward 79 %, turn left 15 %, turn right 3 %, move right 2 %, turn around 1 %
    - move right: 1 (1 to 13) in a row, then move forward 41 %, turn right 40 %, turn left 18 %, move left 1 %
    - turn around: 1 in a row, then move forward 100 %
    - turn left: 1 (1 to 2) in a row, then move forward 81 %, move right 9 %, turn right 8 %, move left 2 %, turn around 1 %
    - turn right: 1 (1 to 2) in a row, then move forward 84 %, move left 9 %, turn left 6 %, move right 1 %

    ## How tasks go
    - actions that complete sub-goals: move forward 60 %, move left 24 %, move right 16 %
    - 1 sub-goal, 80 of 400 demonstrations: 16 (6 to 30) actions
    - 2 sub-goals, 120 of 400 demonstrations: 13 (1 to 35) actions to the first, 14 (3 to 35) to each further one
    - 3 sub-goals, 92 of 400 demonstrations: 17 (2 to 34) actions to the first, 12 (2 to 37) to each further one
    - 4 sub-goals, 8 of 400 demonstrations: 16 (10 to 22) actions to the first, 5 (1 to 32) to each further one
    - 5 sub-goals, 16 of 400 demonstrations: 18 (3 to 31) actions to the first, 4 (2 to 9) to each further one
    - 6 sub-goals, 16 of 400 demonstrations: 19 (12 to 30) actions to the first, 5 (1 to 30) to each further one
    - 7 sub-goals, 12 of 400 demonstrations: 19 (10 to 27) actions to the first, 4 (1 to 35) to each further one
    - 8 sub-goals, 12 of 400 demonstrations: 18 (1 to 32) actions to the first, 3 (1 to 27) to each further one
    - 9 sub-goals, 4 of 400 demonstrations: 9 (7 to 13) actions to the first, 3 (1 to 17) to each further one
    - 13 sub-goals, 28 of 400 demonstrations: 14 (2 to 28) actions to the first, 1 (1 to 5) to each further one
    - 14 sub-goals, 8 of 400 demonstrations: 25 (2 to 29) actions to the first, 1 (1 to 7) to each further one
    - 15 sub-goals, 4 of 400 demonstrations: 23 (3 to 27) actions to the first, 1 (1 to 2) to each further one
    "#);
}

/// References cannot get into a document, nor what is closed in tests.
#[test]
fn test_references_and_barricades_make_no_difference() {
    let mut cases = CaseSet::shipped();
    let passage = cases.cases[0].barricade.clone();
    for case in &mut cases.cases {
        case.test = case.original.clone();
        case.blocked = case.distant.clone();
        case.barricade.clone_from(&passage);
        case.id.push('x');
    }
    let assets = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets");
    let folder = tempfile::tempdir().unwrap();
    for file in ["layout.toml", "catalogue.toml"] {
        std::fs::copy(Path::new(assets).join(file), folder.path().join(file)).unwrap();
    }
    let text = cases.to_toml(&Warehouse::shipped().catalogue);
    std::fs::write(folder.path().join("cases.toml"), text).unwrap();
    let (sources, others) = (warehouse(None), warehouse(Some(folder.path())));
    for set in
        ["original", "opposite", "nearby+distant", "4", "irrelevant", "confusable", "elsewhere"]
    {
        let set = set.parse().unwrap();
        for kind in DocumentKind::TEXTS {
            assert_eq!(of_warehouse(kind, &sources, set), of_warehouse(kind, &others, set));
        }
        assert_eq!(sources.sha256(set), others.sha256(set));
    }
}
