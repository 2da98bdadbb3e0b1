//! A small world and demonstrations in it, for tests of the builders.

use case_book::{
    ActionDeclaration, Demonstration, DemonstrationBook, StateField, WorldDeclaration,
};
use domain::{ActionCode, DemonstrationKind, FeedbackCode, State};

/// The action "walk east".
pub(super) const EAST: u8 = 0;
/// The action "open the door".
pub(super) const OPEN: u8 = 1;

/// A corridor with a door that stands between cell 3 and cell 4.
pub(super) fn corridor() -> WorldDeclaration {
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
pub(super) fn demonstration(
    instruction: &str,
    cell: u8,
    actions: &[u8],
    sub_goals: &[u32],
) -> Demonstration {
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

/// A book of two cases, each with a demonstration whose views are seen nowhere else.
pub(super) fn book() -> DemonstrationBook {
    let of_case = |case: u32| {
        let of = demonstration("Walk to cell 4.", 2, &[EAST, EAST, OPEN, EAST], &[4]);
        Demonstration { case, views: of.views.iter().map(|view| 10 * case + view).collect(), ..of }
    };
    DemonstrationBook {
        world: corridor(),
        demonstrations: vec![of_case(0), of_case(1)],
        ..DemonstrationBook::default()
    }
}
