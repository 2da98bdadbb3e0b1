//! Hybrid memory: the summary, then the semantic document, both supplied whole at every step.

use domain::DocumentKind;
use warehouse::Demonstrations;

use super::{Blueprint, Documents, Memory, Views, fixed};

/// Both documents, over these demonstrations of all cases.
#[derive(Debug)]
pub(super) struct Hybrid(pub(super) Demonstrations);

impl Blueprint for Hybrid {
    fn build(&self, _: &Views, documents: &mut dyn Documents) -> anyhow::Result<Box<dyn Memory>> {
        fixed::consolidated(&[DocumentKind::Summary, DocumentKind::Semantic], self.0, documents)
    }
}
