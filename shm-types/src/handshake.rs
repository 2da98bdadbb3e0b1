//! The first message of a process: it is ready, and facts about it.

use std::collections::BTreeMap;

use bytemuck::Zeroable;

use domain::UnknownCode;

use crate::message::{Handshake, Role, WIRE_VERSION, read_text, write_text};

/// The facts of a handshake do not fit into the message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the facts of the {}'s handshake have {bytes} bytes of JSON, and {most} fit: shorten them", role.word())]
pub struct FactsTooLong {
    /// The role of the process.
    pub role: Role,
    /// Bytes of JSON.
    pub bytes: usize,
    /// Bytes that fit.
    pub most: usize,
}

impl Handshake {
    /// The handshake of this process, with `facts` for the manifest: adapter, encoder, policy, ...
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
        let mut handshake = Self {
            wire_version: WIRE_VERSION,
            role: role as u32,
            pid: std::process::id(),
            ..Zeroable::zeroed()
        };
        handshake.facts_len = write_text(&mut handshake.facts, &facts);
        if handshake.facts_len as usize == facts.len() {
            Ok(handshake)
        } else {
            Err(FactsTooLong { role, bytes: facts.len(), most: handshake.facts.len() })
        }
    }

    /// The sender's facts.
    ///
    /// # Errors
    /// When they are not a JSON object of strings.
    pub fn facts(&self) -> Result<BTreeMap<String, String>, UnknownCode> {
        let text = read_text(&self.facts, self.facts_len)?;
        serde_json::from_str(text).map_err(|_| UnknownCode::new(text, "a JSON object of strings"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_round_trip_or_are_refused() {
        let handshake =
            Handshake::new(Role::Sim, [("adapter", "llvmpipe \"15\"".to_owned())]).unwrap();
        assert_eq!((handshake.wire_version, handshake.role), (WIRE_VERSION, 1));
        assert_eq!(handshake.facts().unwrap()["adapter"], "llvmpipe \"15\"");
        assert_eq!(Handshake::new(Role::Sim, []).unwrap().facts(), Ok(BTreeMap::new()));

        let error = Handshake::new(Role::Memory, [("encoder", "x".repeat(500))]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the facts of the memory's handshake have 514 bytes of JSON, and 492 fit: shorten them"
        );

        let broken = Handshake { facts_len: 3, ..handshake };
        assert!(broken.facts().is_err());
        assert!(Handshake { facts_len: u32::MAX, ..handshake }.facts().is_err());
    }
}
