//! What this world says of itself to the processes of a run.

use case_book::{ActionDeclaration, StateField, WorldDeclaration};
use domain::{Action, Feedback, Heading};

use crate::case_book::{WORLD_NAME, WORLD_VERSION};

/// The declaration of this world.
pub fn declaration() -> WorldDeclaration {
    let field = |name: &str| StateField { name: name.to_owned(), words: Vec::new(), digits: 0 };
    let action = |action: Action| ActionDeclaration {
        letter: action.letter(),
        words: action.words().to_owned(),
    };
    let headings = Heading::ALL.map(|heading| heading.word().to_owned());
    WorldDeclaration {
        name: WORLD_NAME.to_owned(),
        version: WORLD_VERSION.to_owned(),
        rules: include_str!("rules.txt").trim_end().to_owned(),
        actions: Action::ALL.map(action).to_vec(),
        state: vec![
            field("column"),
            field("row"),
            StateField { words: headings.to_vec(), ..field("heading") },
        ],
        state_sentence: "You are in column {column}, row {row}, and face {heading}.".to_owned(),
        feedback: Feedback::ALL.map(|feedback| feedback.words().to_owned()).to_vec(),
        is_deterministic: true,
    }
}

#[cfg(test)]
mod tests {
    use case_book::BookFile;
    use domain::{FeedbackCode, Pose, State};

    use super::*;

    #[test]
    fn the_declaration_is_one() {
        let text = BookFile::new(declaration()).unwrap().text;
        let world = BookFile::<WorldDeclaration>::parse(text, "world.json").unwrap().book;
        assert_eq!(world.letters(Action::ALL.map(|action| Some(action.into()))), "fblrLRU");
        assert_eq!(world.not_understood(), FeedbackCode::from(Feedback::NotUnderstood));
        assert_eq!(FeedbackCode::from(Feedback::Start), FeedbackCode::START);
        let state = State::from(Pose::new(3, 12, Heading::W));
        assert_eq!(world.read_state(&state.padded()), Ok(state));
        assert_eq!(world.state_text(&state), "3,12,west");
        for action in Action::ALL {
            assert!(world.rules.contains(action.words()), "{action:?}");
        }
    }
}
