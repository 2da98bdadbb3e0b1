//! Reasons for missing figures that several sections give.

use crate::document::Missing;

pub(super) const NOTHING_RETRIEVED: Missing = Missing::Undefined("nothing was retrieved");
pub(super) const NO_RECALL: Missing = Missing::NotMeasured("no recall was timed");
pub(super) const NO_STORE: Missing = Missing::NotMeasured("the memory reported no size");
