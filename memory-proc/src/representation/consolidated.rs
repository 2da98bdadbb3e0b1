//! Memories that supply the same documents at every step: summary, semantic and hybrid; and working memory, which
//! supplies none.

use domain::DocumentKind;
use shm_types::message::DocumentId;
use warehouse::Demonstrations;

use super::{DocumentSupplier, Memory, MemoryBuilder, RecallQuery, RecalledItems, StoredViews};

/// Builds a memory of documents over the demonstrations `set` of all cases.
#[derive(Debug)]
pub(super) struct Consolidated {
    /// The kinds of document, in the order of supply.
    pub(super) kinds: &'static [DocumentKind],
    pub(super) set: Demonstrations,
}

impl MemoryBuilder for Consolidated {
    fn build(
        &self,
        _: &StoredViews,
        documents: &mut dyn DocumentSupplier,
    ) -> anyhow::Result<Box<dyn Memory>> {
        let kinds = self.kinds.iter();
        let published: anyhow::Result<_> =
            kinds.map(|&kind| documents.consolidated(kind, self.set)).collect();
        Ok(Box::new(SameDocuments(published?)))
    }
}

/// A memory that supplies the same documents at every step.
#[derive(Debug)]
pub(super) struct SameDocuments(pub(super) Vec<DocumentId>);

impl Memory for SameDocuments {
    fn recall(&self, _: &RecallQuery<'_>) -> RecalledItems {
        RecalledItems { segment: None, documents: self.0.clone() }
    }
}

#[cfg(test)]
mod tests {
    use domain::Representation;
    use shm_types::documents::Content;

    use super::super::testing::{TestDocuments, spec};
    use super::super::{MemorySpec, memory_builder};
    use super::*;

    #[test]
    fn each_representation_supplies_its_described_documents_at_every_step() {
        for &representation in Representation::ALL {
            let mut documents = TestDocuments::default();
            let made_of = MemorySpec { set: Demonstrations::ALL, ..spec(Vec::new()) };
            let builder = memory_builder(representation, made_of);
            assert!(builder.poses().is_empty());
            let memory = builder.build(&StoredViews::default(), &mut documents).unwrap();
            let now = |elapsed| RecallQuery { embedding: None, stage: 0, elapsed };
            let supply = memory.recall(&now(0));
            assert_eq!(supply, memory.recall(&now(9)), "{representation}");
            let texts = supply.documents.iter().map(|&id| documents.content(id));
            let texts = texts.filter(|content| !matches!(content, Content::Trajectories(_)));
            let kinds: Vec<DocumentKind> = texts.map(Content::kind).collect();
            assert_eq!(kinds, representation.describe().documents, "{representation}");
        }
    }

    #[test]
    fn a_missing_document_is_an_error_and_not_an_empty_memory() {
        for kind in ["summary", "semantic", "hybrid"] {
            let builder = memory_builder(kind.parse().unwrap(), spec(Vec::new()));
            let mut documents = TestDocuments { is_empty: true, ..TestDocuments::default() };
            let error =
                builder.build(&StoredViews::default(), &mut documents).err().unwrap().to_string();
            assert!(error.contains("of original"), "{error}");
        }
    }
}
