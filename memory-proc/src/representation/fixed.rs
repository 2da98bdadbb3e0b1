//! What memories without a choice share: the same documents at every step.

use domain::DocumentKind;
use shm_types::message::DocumentId;
use warehouse::Demonstrations;

use super::{Documents, Memory, Situation, Supply};

/// A memory that is supplied whole, whatever the step.
#[derive(Debug)]
pub(super) struct Fixed(pub(super) Vec<DocumentId>);

impl Memory for Fixed {
    fn access(&self, _: &Situation<'_>) -> Supply {
        Supply { segment: None, documents: self.0.clone() }
    }
}

/// The documents of `kinds`, in this order, consolidated over the demonstrations `set` of all cases.
pub(super) fn consolidated(
    kinds: &[DocumentKind],
    set: Demonstrations,
    documents: &mut dyn Documents,
) -> anyhow::Result<Box<dyn Memory>> {
    let published: anyhow::Result<_> =
        kinds.iter().map(|&kind| documents.consolidated(kind, set)).collect();
    Ok(Box::new(Fixed(published?)))
}

#[cfg(test)]
mod tests {
    use domain::Representation;
    use shm_types::documents::Content;

    use super::super::testing::{Shelf, ingredients};
    use super::super::{Ingredients, Views, blueprint};
    use super::*;

    #[test]
    fn each_supplies_the_documents_it_is_described_with_at_every_step() {
        for &representation in Representation::ALL {
            let mut shelf = Shelf::default();
            let made_of = Ingredients { set: Demonstrations::ALL, ..ingredients(Vec::new()) };
            let blueprint = blueprint(representation, made_of);
            assert!(blueprint.poses().is_empty());
            let memory = blueprint.build(&Views::default(), &mut shelf).unwrap();
            let now = |elapsed| Situation { embedding: None, stage: 0, elapsed };
            let supply = memory.access(&now(0));
            assert_eq!(supply, memory.access(&now(9)), "{representation}");
            let texts = supply.documents.iter().map(|&id| shelf.content(id));
            let texts = texts.filter(|content| !matches!(content, Content::Trajectories(_)));
            let kinds: Vec<DocumentKind> = texts.map(Content::kind).collect();
            assert_eq!(kinds, representation.describe().documents, "{representation}");
        }
    }

    #[test]
    fn a_missing_document_is_an_error_and_not_an_empty_memory() {
        for kind in ["summary", "semantic", "hybrid"] {
            let blueprint = blueprint(kind.parse().unwrap(), ingredients(Vec::new()));
            let mut shelf = Shelf { is_bare: true, ..Shelf::default() };
            let error = blueprint.build(&Views::default(), &mut shelf).err().unwrap().to_string();
            assert!(error.contains("of original"), "{error}");
        }
    }
}
