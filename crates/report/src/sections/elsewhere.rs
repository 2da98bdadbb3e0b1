//! Demonstrations in another warehouse: what memory knows in general, apart from routes and places that it has memorised.

use conditions::PolicyKind;
use scores::Question;

use super::comparisons::asked_blocks;
use crate::document::{ReportBlock, ReportSection};
use crate::view::ScoredRun;

/// The section, if the run has such demonstrations.
pub(super) fn section(view: &ScoredRun<'_>) -> Option<ReportSection> {
    let caption = "The same tasks with demonstrations of the warehouse that is tested (here) and of another one (elsewhere), \
                   paired by case and repetition: first minus second. What a memory gains from elsewhere over working memory is \
                   general knowledge; what it gains from here beyond that belongs to the place.";
    let tables = asked_blocks(view, Question::Elsewhere, "elsewhere", caption);
    if tables.is_empty() {
        return None;
    }
    let note = left_out(view.log.manifest.settings.policy).map(ReportBlock::Notice);
    let blocks = note.into_iter().chain(tables).collect();
    Some(ReportSection::new(view.id("s-elsewhere"), "Demonstrations in another warehouse", blocks))
}

/// What a policy that does not use memories of another warehouse makes of the comparisons.
pub(crate) fn left_out(policy: PolicyKind) -> Option<String> {
    let why = match policy {
        PolicyKind::Grounded => {
            "leaves memories of another warehouse out: it takes positions and routes from memory, and none of them is of this one"
        }
        PolicyKind::Random | PolicyKind::Expert => "uses no memory",
        PolicyKind::Imitate | PolicyKind::Openai | PolicyKind::External => return None,
    };
    Some(format!(
        "The policy {policy} {why}. So its demonstrations elsewhere are as good as none, whatever the memory."
    ))
}
