//! The first message of a process: that it is ready, and what it runs on.

use std::collections::BTreeMap;

use bytemuck::Zeroable;

use crate::message::{Hello, Role, WIRE_VERSION, read_text, write_text};
use domain::UnknownCode;

/// What a process says about itself does not fit into a message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the {}'s facts take {bytes} bytes of JSON, and {most} fit: say less", role.word())]
pub struct FactsTooLong {
    /// Whose.
    pub role: Role,
    /// Bytes of JSON.
    pub bytes: usize,
    /// Bytes there are.
    pub most: usize,
}

impl Hello {
    /// This process, as `role`, with `facts` for the manifest: adapter, frame path, encoder, policy, ...
    ///
    /// # Errors
    /// When the facts do not fit.
    pub fn new<'a>(
        role: Role,
        facts: impl IntoIterator<Item = (&'a str, String)>,
    ) -> Result<Self, FactsTooLong> {
        let facts: serde_json::Map<_, _> =
            facts.into_iter().map(|(name, value)| (name.to_owned(), value.into())).collect();
        let facts = serde_json::Value::from(facts).to_string();
        let mut hello = Self {
            wire_version: WIRE_VERSION,
            role: role as u32,
            pid: std::process::id(),
            ..Zeroable::zeroed()
        };
        hello.facts_len = write_text(&mut hello.facts, &facts);
        if hello.facts_len as usize == facts.len() {
            Ok(hello)
        } else {
            Err(FactsTooLong { role, bytes: facts.len(), most: hello.facts.len() })
        }
    }

    /// What the sender said about itself.
    ///
    /// # Errors
    /// When it is not a JSON object of strings.
    pub fn facts(&self) -> Result<BTreeMap<String, String>, UnknownCode> {
        let text = read_text(&self.facts, self.facts_len)?;
        serde_json::from_str(text).map_err(|_| UnknownCode::new(text, "a JSON object of strings"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_arrive_or_do_not_leave() {
        let hello = Hello::new(Role::Sim, [("adapter", "llvmpipe \"15\"".to_owned())]).unwrap();
        assert_eq!((hello.wire_version, hello.role), (WIRE_VERSION, 1));
        assert_eq!(hello.facts().unwrap()["adapter"], "llvmpipe \"15\"");
        assert_eq!(Hello::new(Role::Sim, []).unwrap().facts(), Ok(BTreeMap::new()));

        let error = Hello::new(Role::Memory, [("encoder", "x".repeat(500))]).unwrap_err();
        let said = "the memory's facts take 514 bytes of JSON, and 496 fit: say less";
        assert_eq!(error.to_string(), said);

        let broken = Hello { facts_len: 3, ..hello };
        assert!(broken.facts().is_err());
        assert!(Hello { facts_len: u32::MAX, ..hello }.facts().is_err());
    }
}
