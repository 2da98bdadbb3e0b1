//! How lists of actions and feedback are written: actions as letters, feedback as codes.

/// Actions, a letter for each: `ffR`.
pub(crate) mod letters {
    use domain::Action;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    pub(crate) fn serialize<S: Serializer>(of: &[Action], to: S) -> Result<S::Ok, S::Error> {
        to.collect_str(&of.iter().map(|action| action.letter()).collect::<String>())
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Action>, D::Error> {
        let text = String::deserialize(from)?;
        let action = |letter| {
            let found = Action::from_letter(letter);
            found.ok_or_else(|| D::Error::custom(format!("{letter:?} is not an action")))
        };
        text.chars().map(action).collect()
    }
}

/// Feedback, a code for each.
pub(crate) mod codes {
    use domain::Feedback;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(crate) fn serialize<S: Serializer>(of: &[Feedback], to: S) -> Result<S::Ok, S::Error> {
        of.iter().map(|feedback| *feedback as u8).collect::<Vec<u8>>().serialize(to)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Vec<Feedback>, D::Error> {
        let codes = Vec::<u8>::deserialize(from)?;
        codes.into_iter().map(|code| Feedback::try_from(code).map_err(D::Error::custom)).collect()
    }
}

/// Answers, a letter for each: that of its action, or `?` where none could be read.
pub(crate) mod answers {
    use domain::Action;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    pub(crate) fn serialize<S: Serializer>(
        of: &[Option<Action>],
        to: S,
    ) -> Result<S::Ok, S::Error> {
        let letter = |answer: &Option<Action>| answer.map_or('?', Action::letter);
        to.collect_str(&of.iter().map(letter).collect::<String>())
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Vec<Option<Action>>, D::Error> {
        let text = String::deserialize(from)?;
        let answer = |letter| match Action::from_letter(letter) {
            None if letter != '?' => Err(D::Error::custom(format!("{letter:?} is not an action"))),
            action => Ok(action),
        };
        text.chars().map(answer).collect()
    }
}
