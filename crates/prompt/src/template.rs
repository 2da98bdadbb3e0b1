//! The template's file as a struct, and the replacement of names in its texts.

use std::sync::LazyLock;

use domain::{Action, Feedback, Heading};
use serde::Deserialize;

pub(super) const FILE: &str = include_str!("../v1.toml");

/// Defines structs of texts, which have to be in the file and are the only ones there.
macro_rules! texts {
    ($($name:ident { $($field:ident),* $(,)? })*) => {
        $(
            #[derive(Debug, Deserialize)]
            #[serde(deny_unknown_fields)]
            pub(super) struct $name {
                $(pub(super) $field: String,)*
            }
        )*
    };
}

/// The template's texts. `v1.toml` says what each is for.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Template {
    pub(super) version: String,
    pub(super) system: String,
    pub(super) view_not_shown: String,
    pub(super) memory: MemoryTexts,
    pub(super) task: TaskTexts,
    pub(super) window: WindowTexts,
    pub(super) now: NowTexts,
    pub(super) view: ViewTexts,
    actions: ActionTexts,
    feedback: FeedbackTexts,
    headings: HeadingTexts,
}

texts! {
    MemoryTexts {
        begin, nothing, end, elsewhere, document, summary, semantic, note, captioned_begin, caption,
        captioned_end, demonstration_begin, demonstration_view, demonstration_actions, then, several,
        demonstration_end, part_begin, part_end, hint, retrieved_begin, one_retrieved_begin,
        retrieved_action, retrieved_view, retrieved_view_alone, retrieved_end,
    }
    TaskTexts { text }
    WindowTexts { begin, nothing, view, step, no_action, end }
    NowTexts { begin, end }
    ViewTexts { after }
    ActionTexts { forward, backward, left, right, turn_left, turn_right, turn_around }
    FeedbackTexts { start, moved, turned, blocked, not_understood }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "UPPERCASE")]
struct HeadingTexts {
    n: String,
    e: String,
    s: String,
    w: String,
}

impl Template {
    pub(super) fn action(&self, action: Action) -> &str {
        let words = &self.actions;
        match action {
            Action::Forward => &words.forward,
            Action::Backward => &words.backward,
            Action::Left => &words.left,
            Action::Right => &words.right,
            Action::TurnLeft => &words.turn_left,
            Action::TurnRight => &words.turn_right,
            Action::TurnAround => &words.turn_around,
        }
    }

    pub(super) fn feedback(&self, feedback: Feedback) -> &str {
        let words = &self.feedback;
        match feedback {
            Feedback::Start => &words.start,
            Feedback::Moved => &words.moved,
            Feedback::Turned => &words.turned,
            Feedback::Blocked => &words.blocked,
            Feedback::NotUnderstood => &words.not_understood,
        }
    }

    pub(super) fn heading(&self, heading: Heading) -> &str {
        let words = &self.headings;
        match heading {
            Heading::N => &words.n,
            Heading::E => &words.e,
            Heading::S => &words.s,
            Heading::W => &words.w,
        }
    }
}

/// The template that this program was built with.
pub(super) fn template() -> &'static Template {
    static TEMPLATE: LazyLock<Template> = LazyLock::new(|| {
        // The file is compiled in, and a test parses it.
        toml::from_str(FILE).expect("the template parses")
    });
    &TEMPLATE
}

/// `text` with each `{name}` of `values` replaced. Names inside values are not replaced, and other braces stay.
pub(super) fn fill(text: &str, values: &[(&str, &str)]) -> String {
    let mut filled = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find('{') {
        let (before, from_brace) = rest.split_at(at);
        filled.push_str(before);
        let known = values.iter().find_map(|&(name, value)| {
            let after = from_brace[1..].strip_prefix(name)?.strip_prefix('}')?;
            Some((value, after))
        });
        match known {
            Some((value, after)) => {
                filled.push_str(value);
                rest = after;
            }
            None => {
                filled.push('{');
                rest = &from_brace[1..];
            }
        }
    }
    filled.push_str(rest);
    filled
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_of_the_file_are_those_of_the_project() {
        let template = template();
        assert_eq!(template.version, "prompt/1");
        for action in Action::ALL {
            assert_eq!(template.action(action), action.words());
            assert!(template.system.lines().any(|line| line == action.words()), "{action:?}");
            assert!(template.now.end.contains(action.words()));
        }
        for feedback in Feedback::ALL {
            assert_eq!(template.feedback(feedback), feedback.words());
        }
        for heading in Heading::ALL {
            assert_eq!(template.heading(heading), heading.word());
        }
    }

    #[test]
    fn names_are_replaced_once_and_other_braces_stay() {
        let values = [("a", "{b}"), ("b", "B")];
        for (text, filled) in [
            ("{a} and {b}", "{b} and B"),
            ("{c} {a", "{c} {a"),
            ("{{b}}", "{B}"),
            ("é{a}é", "é{b}é"),
            ("", ""),
        ] {
            assert_eq!(fill(text, &values), filled);
        }
    }
}
