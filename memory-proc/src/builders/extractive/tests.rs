use domain::DemonstrationKind;

use super::super::testing::{EAST, OPEN, corridor, demonstration};
use super::*;

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
    try_build(kind, demonstrations).unwrap()
}

fn try_build(kind: DocumentKind, demonstrations: &[Demonstration]) -> Result<String> {
    let demonstrations = Vec::from_iter(demonstrations);
    let built =
        Extractive.build(kind, &corridor(), &demonstrations, Path::new(""), &mut |_, _| ())?;
    Ok(built.text)
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
