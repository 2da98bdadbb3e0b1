//! A small world, its demonstrations, and a recipe.

use std::collections::BTreeMap;

use case_book::{
    ActionDeclaration, CaseDemonstrations, Demonstration, DemonstrationBook, StateField,
    WorldDeclaration,
};
use domain::{ActionCode, DemonstrationKind, FeedbackCode, State};

use crate::ModelRecipe;

pub(super) fn recipe() -> ModelRecipe {
    ModelRecipe { max_tokens: 1000, views: 2, ..ModelRecipe::new("m") }
}

/// A corridor of cells.
pub(super) fn world() -> WorldDeclaration {
    let action = |letter, words: &str| ActionDeclaration { letter, words: words.to_owned() };
    WorldDeclaration {
        name: "corridor".to_owned(),
        version: "1".to_owned(),
        rules: "You are in a corridor of ten cells.".to_owned(),
        actions: vec![action('e', "go east"), action('w', "go west"), action('r', "turn round")],
        state: vec![StateField { name: "cell".to_owned(), words: Vec::new(), digits: 0 }],
        state_sentence: "You are in cell {cell}.".to_owned(),
        feedback: ["You begin.", "You went.", "A wall is in the way.", "Not understood."]
            .map(str::to_owned)
            .to_vec(),
        is_deterministic: true,
    }
}

/// Walks east to a wall in cell 5, then west to cell 4.
pub(super) fn demonstration() -> Demonstration {
    let cells = [2, 3, 4, 5, 5, 5, 5, 4];
    let feedback = [0, 1, 1, 1, 2, 2, 1, 1];
    Demonstration {
        case: 0,
        kind: DemonstrationKind::Original,
        variant: 0,
        instruction: "Go to the wall, then to cell 4.".to_owned(),
        states: cells.map(|cell| State::new(&[cell as f32]).unwrap()).to_vec(),
        feedback: feedback.map(FeedbackCode).to_vec(),
        sub_goals: vec![3, 7],
        actions: [0, 0, 0, 0, 0, 2, 1].map(ActionCode).to_vec(),
        views: cells.to_vec(),
    }
}

/// A book of `cases` cases with one demonstration each.
pub(super) fn book(cases: u32) -> DemonstrationBook {
    let of_case = |case| CaseDemonstrations {
        instruction: demonstration().instruction,
        own: vec![case],
        ..CaseDemonstrations::default()
    };
    DemonstrationBook {
        world: world(),
        demonstrations: (0..cases).map(|case| Demonstration { case, ..demonstration() }).collect(),
        cases: (0..cases).map(of_case).collect(),
        variants: BTreeMap::from([(0, "one".to_owned())]),
        ..DemonstrationBook::default()
    }
}
