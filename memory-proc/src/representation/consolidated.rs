//! Memories that supply the same documents at every step: summary, semantic and hybrid; and working memory, which
//! supplies none.

use std::sync::Arc;

use peer::memory::{Memory, MemoryError, MemoryItem, Query};

/// A memory of documents.
#[derive(Debug)]
pub(super) struct Consolidated {
    /// The documents, in the order of supply.
    pub(super) documents: Vec<Arc<str>>,
}

impl Memory for Consolidated {
    fn recall(&mut self, _: &Query<'_>) -> Result<Vec<MemoryItem>, MemoryError> {
        Ok(self.documents.iter().map(|text| MemoryItem::text(text.clone())).collect())
    }

    fn store_bytes(&self) -> Option<u64> {
        Some(self.documents.iter().map(|text| text.len() as u64).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{build, recall, settings};
    use super::super::{MemorySettings, built_in};
    use domain::Representation;

    #[test]
    fn documents_are_supplied_in_order_at_every_step() {
        let documents = vec!["summary".into(), "knowledge".into()];
        let settings = MemorySettings { documents, ..settings() };
        let mut memory = built_in(Representation::Hybrid, &settings);
        build(&mut *memory, &[]).unwrap();
        let items = recall(&mut *memory, None, 0).unwrap();
        assert_eq!(items, ["summary", "knowledge"].map(super::MemoryItem::text));
        assert_eq!(items, recall(&mut *memory, None, 9).unwrap());
        assert_eq!(memory.store_bytes(), Some(16));
    }
}
