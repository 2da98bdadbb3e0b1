use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use case_book::BookRequest;
use domain::{Action, Appearance, Cell, Demonstrations, Feedback, Pose};
use plates::painter::PlateAisle;
use proptest::prelude::*;
use warehouse::case_book::write_books;
use warehouse::{CaseSet, TrajectoryKind, Warehouse};

use super::*;
use crate::builders::{FrameReading, TranscriptStep, transcripts};
use documents::Sources;

/// The plates read in the painted aisle's image from `pose`.
fn look(pose: Pose) -> Arc<FrameReading> {
    let picture = PlateAisle::new().picture(pose);
    let read = plates::read(picture.width(), picture.width(), picture.pixels());
    let landmarks = read.into_iter().filter_map(|sighting| sighting.seen_from(pose)).collect();
    let mut frame = [0; 16];
    frame[..3].copy_from_slice(&[pose.cell.x, pose.cell.y, pose.heading as u8]);
    Arc::new(FrameReading { frame, landmarks })
}

/// A demonstration in the painted aisle: its actions as letters, with an exclamation mark after each that completes a
/// sub-goal.
fn transcript(instruction: &str, start: &str, letters: &str) -> Transcript {
    let mut pose: Pose = start.parse().unwrap();
    let state = |pose, feedback, completed| TranscriptStep {
        pose,
        feedback,
        seen: look(pose),
        completed,
        action: None,
    };
    let mut steps = vec![state(pose, Feedback::Start, 0)];
    for letter in letters.chars() {
        let last = steps.last_mut().unwrap();
        if letter == '!' {
            last.completed += 1;
            continue;
        }
        let action = Action::from_letter(letter).unwrap();
        last.action = Some(action);
        let completed = last.completed;
        let feedback = match (action.move_direction(), action.turn_quarters()) {
            (Some(direction), _) => {
                let way = pose.heading.turned(direction);
                pose.cell = pose.cell.step(way).unwrap();
                Feedback::Moved
            }
            (None, turn) => {
                pose.heading = pose.heading.turned(turn.unwrap());
                Feedback::Turned
            }
        };
        steps.push(state(pose, feedback, completed));
    }
    Transcript { instruction: instruction.to_owned(), steps }
}

fn demonstrations() -> Vec<Transcript> {
    vec![
        transcript("Find a barrels 12.", "10,10,N", "ff!L"),
        transcript("Find any item of the category cones.", "11,10,N", "ffff!R"),
        transcript(
            "Visit a barrels 12, then a cones 14, then return to the cell where you started.",
            "11,10,N",
            "ffl!ffr!bbbb!",
        ),
        transcript("Find a barrels 12.", "10,10,N", "ff!L"),
    ]
}

fn build(kind: DocumentKind, transcripts: &[Transcript]) -> String {
    Extractive.build(kind, transcripts, Path::new(""), &mut |_, _| {}).unwrap().text
}

#[test]
fn a_summary_lists_items_passages_and_routes() {
    insta::assert_snapshot!(build(DocumentKind::Summary, &demonstrations()), @r#"
    # Summary of the demonstrations
    Positions are (column, row): columns grow east, rows grow north. An item is reached by standing on the cell in front of it.

    ## Items
    - barrels 12 [plate 554-554]: stand at (10, 12) facing W
    - cones 14 [plate 316-150]: stand at (11, 14) facing E
    - cones item [plate 316-136]: stand at (11, 11) facing E
    - cones item [plate 316-161]: stand at (11, 17) facing E
    - cones item [plate 316-364]: stand at (11, 12) facing E
    - cones item [plate 316-405]: stand at (11, 15) facing E
    - cones item [plate 316-416]: stand at (11, 18) facing E
    - cones item [plate 316-622]: stand at (11, 13) facing E
    - cones item [plate 316-633]: stand at (11, 16) facing E
    - cones item [plate 316-644]: stand at (11, 19) facing E
    - item [plate 554-035]: stand at (10, 19) facing W
    - item [plate 554-112]: stand at (10, 15) facing W
    - item [plate 554-123]: stand at (10, 16) facing W
    - item [plate 554-263]: stand at (10, 18) facing W
    - item [plate 554-326]: stand at (10, 13) facing W
    - item [plate 554-340]: stand at (10, 14) facing W
    - item [plate 554-543]: stand at (10, 11) facing W
    - item [plate 554-565]: stand at (10, 17) facing W

    ## Passages
    - column 10: rows 10-14
    - column 11: rows 10-14

    ## Routes
    - "Find a barrels 12." from (10, 10) facing N: north 2 to (10, 12); reached barrels 12 at (10, 12).
    - "Find any item of the category cones." from (11, 10) facing N: north 4 to (11, 14); reached cones 14 at (11, 14).
    - "Visit a barrels 12, then a cones 14, then return to the cell where you started." from (11, 10) facing N: north 2 to (11, 12), west 1 to (10, 12); reached barrels 12 at (10, 12); north 2 to (10, 14), east 1 to (11, 14); reached cones 14 at (11, 14); south 4 to (11, 10); back at the start (11, 10).
    "#);
}

#[test]
fn general_knowledge_has_regions_and_no_routes() {
    insta::assert_snapshot!(build(DocumentKind::Semantic, &demonstrations()), @r#"
    # Knowledge of the warehouse
    Positions are (column, row): columns grow east, rows grow north.

    ## Layout
    - North-south corridors: column 11 (rows 10-14)

    ## Where kinds of items stand
    - cones [plate 316]: columns 11-11, rows 12-19; seen there: cones 14
    - items [plate 554]: columns 10-10, rows 12-19; seen there: barrels 12

    ## Navigation
    - Items of one kind stand in neighbouring bays: having found one, look beside it.
    - Standing on the cell in front of an item reaches it, whichever way one faces.
    - The first target was reached within 3 steps in half of the demonstrations, within 4 in all.
    "#);
}

#[test]
fn texts_without_demonstrations_have_a_title_only() {
    for kind in DocumentKind::TEXTS {
        assert!(build(kind, &[]).starts_with("# "));
    }
    assert!(
        Extractive.build(DocumentKind::Trajectories, &[], Path::new(""), &mut |_, _| {}).is_err()
    );
}

/// All pairs of numbers that `text` writes as positions, `(3, 7)`.
fn positions(text: &str) -> BTreeSet<Cell> {
    let position = |part: &str| {
        let (x, y) = part.split_once(')')?.0.split_once(", ")?;
        Some(Cell::new(x.parse().ok()?, y.parse().ok()?))
    };
    text.split('(').filter_map(position).collect()
}

/// The section of `text` under `heading`.
fn section<'a>(text: &'a str, heading: &str) -> &'a str {
    let after = text.split_once(&format!("## {heading}\n")).unwrap().1;
    after.split_once("\n## ").map_or(after, |(section, _)| section)
}

/// The cells of the lines under "Passages".
fn passages(summary: &str) -> BTreeSet<Cell> {
    let cells = |line: &str| {
        let (line, range) = line.strip_prefix("- ")?.split_once(": ")?;
        let ((what, at), (_, range)) = (line.split_once(' ')?, range.split_once(' ')?);
        let (from, to) = range.split_once('-')?;
        let (at, from, to): (u8, u8, u8) = (at.parse().ok()?, from.parse().ok()?, to.parse().ok()?);
        let is_column = what == "column";
        Some((from..=to).map(move |i| if is_column { Cell::new(at, i) } else { Cell::new(i, at) }))
    };
    section(summary, "Passages").lines().flat_map(|line| cells(line).unwrap()).collect()
}

fn covered(transcripts: &[Transcript]) -> BTreeSet<Cell> {
    transcripts.iter().flat_map(|t| &t.steps).map(|step| step.pose.cell).collect()
}

fn sighted(transcripts: &[Transcript]) -> BTreeSet<Cell> {
    let seen = transcripts.iter().flat_map(|t| &t.steps).flat_map(|step| &step.seen.landmarks);
    seen.map(|landmark| landmark.standpoint).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// A document contains what its own demonstrations show and cover, and nothing else.
    #[test]
    fn a_summary_contains_what_its_demonstrations_contain(
        letters in prop::collection::vec("[flrLRU]{1,9}", 1..5),
        starts in prop::collection::vec((10..12_u8, 11..15_u8, 0..4_usize), 5),
    ) {
        let transcripts: Vec<_> = letters
            .iter()
            .zip(starts)
            .map(|(letters, (x, y, heading))| {
                let start = Pose::new(x, y, domain::Heading::ALL[heading]);
                transcript("Find a barrels 12.", &start.to_string(), letters)
            })
            .collect();
        let text = build(DocumentKind::Summary, &transcripts);
        prop_assert_eq!(positions(section(&text, "Items")), sighted(&transcripts));
        prop_assert_eq!(passages(&text), covered(&transcripts));
        prop_assert!(positions(section(&text, "Routes")).is_subset(&covered(&transcripts)));
        prop_assert_eq!(build(DocumentKind::Summary, &transcripts), text);
    }
}

/// Cells that only test references or unselected demonstrations cover do not occur in documents of the shipped cases. (No
/// plates are read here, so every position comes from a route.)
#[test]
fn cells_of_test_references_do_not_occur() {
    let book = write_books(&BookRequest::default()).unwrap().demonstrations;
    let sources = Sources::new(book, 448, Appearance::STANDARD);
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
    let cells = |kinds: &[TrajectoryKind]| -> BTreeSet<Cell> {
        let replays = cases
            .cases
            .iter()
            .flat_map(|case| kinds.iter().flat_map(|&kind| case.replay(&warehouse, kind).poses));
        replays.map(|pose| pose.cell).collect()
    };
    let own = cells(&[TrajectoryKind::Original]);
    let elsewhere = cells(&[
        TrajectoryKind::Test,
        TrajectoryKind::Blocked,
        TrajectoryKind::Nearby,
        TrajectoryKind::Distant,
    ]);
    assert!(elsewhere.difference(&own).count() > 0, "the test needs such cells");
    let transcripts =
        transcripts(&sources, Demonstrations::ORIGINAL, |_| Some(Arc::default())).unwrap();
    let summary = build(DocumentKind::Summary, &transcripts);
    assert_eq!(passages(&summary), own);
    assert!(positions(&summary).is_subset(&own));
}
