//! What was in force when the model answered: whether it reasoned although it was asked not to, and whether its answers were
//! restricted to the actions. Requests ask for both, but servers refuse fields, or ignore them, so only replies can tell.

use domain::ReasoningRequest;
use llm::{CONSTRAINTS, ChatReply, ReplyContent};
use serde_json::Value;

const TEMPERATURE: &str = "temperature";

/// The older name of the bound on an answer.
const BOUND: &str = "max_tokens";

/// What the replies so far have shown.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct InForce {
    /// What requests say about reasoning.
    asked: ReasoningRequest,
    /// The temperature that requests ask for.
    temperature: String,
    reasoned: bool,
    /// A reply had a whole text.
    has_text: bool,
    /// An answer was none of the choices.
    unrestricted: bool,
    /// Fields that a server has refused.
    refused: Vec<&'static str>,
    /// The facts that were reported last.
    reported: Vec<(&'static str, String)>,
}

impl InForce {
    pub(super) const fn new(asked: ReasoningRequest, temperature: String) -> Self {
        Self {
            asked,
            temperature,
            reasoned: false,
            has_text: false,
            unrestricted: false,
            refused: Vec::new(),
            reported: Vec::new(),
        }
    }

    /// Takes a reply to a request with these choices, and the fields that servers have refused so far. Returns the facts for
    /// the manifest if they have changed.
    pub(super) fn add(
        &mut self,
        reply: &ChatReply,
        choices: &[&str],
        refused: Vec<&'static str>,
    ) -> Option<Vec<(&'static str, String)>> {
        self.reasoned |= reply.reasoned;
        if let ReplyContent::Text(text) = &reply.content {
            self.has_text = true;
            self.unrestricted |= !is_choice(text, choices);
        }
        self.refused = refused;
        let mut facts = vec![
            ("answers", self.answers()),
            ("reasoning", self.reasoning()),
            ("temperature", self.temperature()),
        ];
        if self.refused.contains(&BOUND) {
            let fields = "the server refuses max_tokens, max_completion_tokens is sent";
            facts.push(("fields", fields.to_owned()));
        }
        let changed = self.reported != facts;
        self.reported.clone_from(&facts);
        changed.then_some(facts)
    }

    fn answers(&self) -> String {
        let refused = self.refused(FieldKind::Constraint);
        if CONSTRAINTS.iter().all(|field| self.refused.contains(field)) {
            return format!("free text{refused}");
        }
        if self.unrestricted {
            return format!("free text, although requests restrict them{refused}");
        }
        if !self.has_text {
            return format!("no reply shows whether they are restricted{refused}");
        }
        format!("restricted, as far as replies show{refused}")
    }

    fn reasoning(&self) -> String {
        let refused = self.refused(FieldKind::Reasoning);
        if self.asked != ReasoningRequest::Off {
            let shown = if self.reasoned { "replies show it" } else { "no reply shows it" };
            format!("asked for ({}), {shown}{refused}", self.asked)
        } else if self.reasoned {
            format!("on: replies show it, although it was asked to be off{refused}")
        } else if self.has_text {
            format!("off, as far as replies show{refused}")
        } else {
            // An answer that was cut off before its first word may have been reasoning that the server does not show.
            format!("no reply shows whether it is off{refused}")
        }
    }

    fn temperature(&self) -> String {
        match self.refused.contains(&TEMPERATURE) {
            true => format!("the model's own, the server refuses {}", self.temperature),
            false => self.temperature.clone(),
        }
    }

    fn refused_of(&self, kind: FieldKind) -> Vec<&'static str> {
        self.refused.iter().copied().filter(|field| FieldKind::of(field) == kind).collect()
    }

    /// The refused fields of a kind, at the end of a sentence.
    fn refused(&self, kind: FieldKind) -> String {
        match &self.refused_of(kind)[..] {
            [] => String::new(),
            fields => format!("; the server refuses {}", fields.join(", ")),
        }
    }
}

/// What a field is for that a server may refuse.
#[derive(Clone, Copy, PartialEq, Eq)]
enum FieldKind {
    /// To restrict answers.
    Constraint,
    /// To turn reasoning off.
    Reasoning,
    Other,
}

impl FieldKind {
    fn of(field: &str) -> Self {
        match field {
            field if CONSTRAINTS.contains(&field) => Self::Constraint,
            TEMPERATURE | BOUND => Self::Other,
            _ => Self::Reasoning,
        }
    }
}

/// Whether an answer is what a server that restricts answers lets through: the words of an action, alone or as the `action` of
/// an object.
fn is_choice(text: &str, choices: &[&str]) -> bool {
    let is_action = |text: &str| choices.contains(&text);
    let of_object = || {
        let object: Value = serde_json::from_str(text).ok()?;
        object.get("action")?.as_str().map(is_action)
    };
    is_action(text) || of_object() == Some(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reply(content: ReplyContent, reasoned: bool) -> ChatReply {
        ChatReply {
            content,
            model: None,
            prompt_tokens: None,
            completion_tokens: None,
            cached_tokens: None,
            image_tokens: None,
            finish_reason: None,
            reasoned,
        }
    }

    const CHOICES: [&str; 2] = ["move forward", "turn left"];

    #[test]
    fn the_facts_follow_from_replies_and_refusals() {
        let said = |text: &str| reply(ReplyContent::Text(text.to_owned()), false);
        let mut cut_off_only = InForce::new(ReasoningRequest::Off, "0".to_owned());
        let unknown =
            cut_off_only.add(&reply(ReplyContent::Length(String::new()), false), &CHOICES, vec![]);
        assert_eq!(
            unknown.unwrap(),
            [
                ("answers", "no reply shows whether they are restricted".to_owned()),
                ("reasoning", "no reply shows whether it is off".to_owned()),
                ("temperature", "0".to_owned()),
            ]
        );
        let mut in_force = InForce::new(ReasoningRequest::Off, "0".to_owned());
        let first = in_force.add(&said("move forward"), &CHOICES, vec![]);
        assert_eq!(
            first.unwrap(),
            [
                ("answers", "restricted, as far as replies show".to_owned()),
                ("reasoning", "off, as far as replies show".to_owned()),
                ("temperature", "0".to_owned()),
            ]
        );
        assert_eq!(in_force.add(&said("{\"action\": \"turn left\"}"), &CHOICES, vec![]), None);
        let refused = vec!["reasoning_effort", "grammar"];
        let second = in_force.add(&said("turn left"), &CHOICES, refused.clone());
        assert_eq!(
            second.unwrap(),
            [
                (
                    "answers",
                    "restricted, as far as replies show; the server refuses grammar".to_owned()
                ),
                (
                    "reasoning",
                    "off, as far as replies show; the server refuses reasoning_effort".to_owned()
                ),
                ("temperature", "0".to_owned()),
            ]
        );
        // An answer that was cut off or is empty shows no restriction, nor that there is none.
        let cut_off = reply(ReplyContent::Length("I see".to_owned()), true);
        let [_, (_, reasoning), _] =
            &in_force.add(&cut_off, &CHOICES, refused.clone()).unwrap()[..]
        else {
            panic!("three facts")
        };
        assert_eq!(
            reasoning,
            "on: replies show it, although it was asked to be off; the server refuses reasoning_effort"
        );
        let [(_, answers), ..] =
            &in_force.add(&said("I turn left."), &CHOICES, refused).unwrap()[..]
        else {
            panic!("three facts")
        };
        assert_eq!(
            answers,
            "free text, although requests restrict them; the server refuses grammar"
        );
        let mut refusing = InForce::new(ReasoningRequest::Off, "0".to_owned());
        let facts = refusing.add(&said("turn left"), &CHOICES, CONSTRAINTS.to_vec()).unwrap();
        assert!(facts[0].1.starts_with("free text; the server refuses"), "{facts:?}");
        let facts =
            refusing.add(&said("turn left"), &CHOICES, vec!["temperature", "max_tokens"]).unwrap();
        assert_eq!(
            facts[2..],
            [
                ("temperature", "the model's own, the server refuses 0".to_owned()),
                (
                    "fields",
                    "the server refuses max_tokens, max_completion_tokens is sent".to_owned()
                ),
            ]
        );
        let mut reasoning = InForce::new(ReasoningRequest::Low, "0".to_owned());
        let facts = reasoning.add(
            &reply(ReplyContent::Text("turn left".to_owned()), true),
            &CHOICES,
            vec![],
        );
        assert_eq!(facts.unwrap()[1].1, "asked for (low), replies show it");
    }
}
