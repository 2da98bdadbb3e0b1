//! How a run's policy is named beside its figures.
//!
//! Three policies are no models: their figures test the harness or bound the scale. Every output that shows figures of a
//! run names its policy as [`PolicyLabel`] does, so that no such figure passes for a model's.

use std::fmt;

use domain::names::named;
use serde::{Deserialize, Serialize};

use crate::Manifest;
use conditions::PolicyKind;

/// The fact with which a policy declares that it is a scripted stand-in.
const STAND_IN_FACT: &str = "stand_in";

named! {
    /// What the figures of a policy stand for that is no model.
    PolicyRole, "role of a policy" {
        /// It takes the place of a model to test the harness.
        StandIn = "scripted stand-in",
        /// Nothing that looks at its observations should do worse.
        LowerBound = "lower bound",
        /// Nothing can succeed more often.
        UpperBound = "upper bound",
    }
}

impl PolicyRole {
    /// What a reader of the figures must know, as a sentence.
    pub const fn meaning(self) -> &'static str {
        match self {
            Self::StandIn => "It tests the harness; its figures are no claim about any model.",
            Self::LowerBound => "It chooses every action at random.",
            Self::UpperBound => "It replays the reference.",
        }
    }
}

/// A run's policy. Written `grounded, scripted stand-in` or `openai (gpt-5)`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyLabel {
    /// Its kind, with the name of the model or of the external policy.
    pub name: String,
    /// What its figures stand for; absent for a model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub role: Option<PolicyRole>,
}

impl PolicyLabel {
    /// Names the policy after `subject`, and says what a reader of its figures must know:
    /// `Policy: random, lower bound. It chooses every action at random.`
    pub fn sentence(&self, subject: &str) -> String {
        match self.role {
            Some(role) => format!("{subject}: {self}. {}", role.meaning()),
            None => format!("{subject}: {self}."),
        }
    }
}

impl fmt::Display for PolicyLabel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, role } = self;
        match role {
            Some(role) => write!(f, "{name}, {role}"),
            None => f.write_str(name),
        }
    }
}

impl Manifest {
    /// What the figures of the run's policy stand for; `None` for a model.
    pub fn policy_role(&self) -> Option<PolicyRole> {
        let is_stand_in = || {
            let facts = self.processes.get("policy")?;
            (facts.get(STAND_IN_FACT)? == "true").then_some(PolicyRole::StandIn)
        };
        match self.settings.policy {
            PolicyKind::Grounded | PolicyKind::Imitate => Some(PolicyRole::StandIn),
            PolicyKind::Random => Some(PolicyRole::LowerBound),
            PolicyKind::Expert => Some(PolicyRole::UpperBound),
            PolicyKind::Openai | PolicyKind::External => is_stand_in(),
        }
    }

    /// The run's policy as every output names it.
    pub fn policy_label(&self) -> PolicyLabel {
        let model = self.settings.model.as_ref().map(|model| model.model.as_str());
        let kind = self.settings.policy.to_string();
        let name = match model.or(self.policy_name()) {
            Some(name) if name != kind => format!("{kind} ({name})"),
            _ => kind,
        };
        PolicyLabel { name, role: self.policy_role() }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::records::manifest;

    #[test]
    fn policies_that_are_no_models_say_so() {
        let label = |policy, facts: &[(&str, &str)]| {
            let mut manifest = manifest();
            manifest.settings.policy = policy;
            let facts: BTreeMap<String, String> =
                facts.iter().map(|(fact, value)| ((*fact).into(), (*value).into())).collect();
            manifest.processes.insert("policy".to_owned(), facts);
            manifest.policy_label().to_string()
        };
        let name = ("policy", "top-three");
        for (policy, facts, expected) in [
            (PolicyKind::Grounded, &[][..], "grounded, scripted stand-in"),
            (PolicyKind::Random, &[], "random, lower bound"),
            (PolicyKind::Expert, &[], "expert, upper bound"),
            (PolicyKind::External, &[name], "external (top-three)"),
            (PolicyKind::External, &[name, ("stand_in", "no")], "external (top-three)"),
            (
                PolicyKind::External,
                &[name, ("stand_in", "true")],
                "external (top-three), scripted stand-in",
            ),
        ] {
            assert_eq!(label(policy, facts), expected);
        }
    }

    #[test]
    fn a_label_is_read_as_it_is_written_and_a_model_has_no_role() {
        for (label, json) in [
            (
                PolicyLabel { name: "grounded".to_owned(), role: Some(PolicyRole::StandIn) },
                r#"{"name":"grounded","role":"scripted stand-in"}"#,
            ),
            (
                PolicyLabel { name: "openai (gpt-5)".to_owned(), role: None },
                r#"{"name":"openai (gpt-5)"}"#,
            ),
        ] {
            assert_eq!(serde_json::to_string(&label).unwrap(), json);
            assert_eq!(serde_json::from_str::<PolicyLabel>(json).unwrap(), label);
        }
    }
}
