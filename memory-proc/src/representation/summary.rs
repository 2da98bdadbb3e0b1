//! Summary memory: one document of object locations, landmarks and routes, supplied whole at every step.

use domain::DocumentKind;
use warehouse::Demonstrations;

use super::{Blueprint, Documents, Memory, Views, fixed};

/// The summary, over these demonstrations of all cases.
#[derive(Debug)]
pub(super) struct Summary(pub(super) Demonstrations);

impl Blueprint for Summary {
    fn build(&self, _: &Views, documents: &mut dyn Documents) -> anyhow::Result<Box<dyn Memory>> {
        fixed::consolidated(&[DocumentKind::Summary], self.0, documents)
    }
}
