//! Semantic memory: one document of general spatial and navigation knowledge, supplied whole at every step.

use domain::DocumentKind;
use warehouse::Demonstrations;

use super::{Blueprint, Documents, Memory, Views, fixed};

/// The semantic document, over these demonstrations of all cases.
#[derive(Debug)]
pub(super) struct Semantic(pub(super) Demonstrations);

impl Blueprint for Semantic {
    fn build(&self, _: &Views, documents: &mut dyn Documents) -> anyhow::Result<Box<dyn Memory>> {
        fixed::consolidated(&[DocumentKind::Semantic], self.0, documents)
    }
}
