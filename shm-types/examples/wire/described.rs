//! What the page describes: every struct, code and constant of the wire.

use domain::{
    Arm, DocumentKind, FeedbackLevel, Outcome, Reasoning, Representation, SegmentContent,
    codes::{CodeSet, Codes},
    outcome,
};
use shm_types::attach::{
    ATTACH_FILE, MAX_FRAMES, MAX_LANES, MAX_LOANED_FRAMES, MAX_ROOT_BYTES, PAGE_BYTES,
};
use shm_types::banks::{BANK_SERVICE, BankDemonstration, BankHeader, BankStep};
use shm_types::description::DESCRIPTION_FILE;
use shm_types::documents::{DOCUMENT_SERVICE, DocumentHeader, MAX_DOCUMENT_BYTES};
use shm_types::frames::{FRAME_SERVICE, FrameHeader, Page};
use shm_types::layout::{Struct, WireLayout};
use shm_types::message::{
    AnswerItem, AnswerSource, CODE_SETS, Description, EXTERNAL, MAX_EMBEDDING,
    MAX_EXTERNAL_MEMORIES, MAX_FOLDER, MAX_INSTRUCTION, MAX_ITEMS, MAX_PLAN, MAX_SEGMENT,
    MAX_SOURCES, MAX_STEPS, MAX_SUB_GOALS, MAX_WINDOW, MAX_WORLDS, MESSAGES, NO_ACTION,
    NO_DOCUMENT, NO_FRAME, NOT_MEASURED, RecalledInstruction, RecalledItem, RecalledSource, Role,
    SegmentStep, Traffic, TrajectoryStep, WIRE_VERSION,
};
use shm_types::notes::{FACTS_SERVICE, NOTE_SERVICE, NoteHeader};

/// Structs that are parts of messages and documents.
pub(crate) const PARTS: [Struct; 9] = [
    RecalledItem::LAYOUT,
    SegmentStep::LAYOUT,
    RecalledInstruction::LAYOUT,
    TrajectoryStep::LAYOUT,
    RecalledSource::LAYOUT,
    AnswerItem::LAYOUT,
    AnswerSource::LAYOUT,
    BankDemonstration::LAYOUT,
    BankStep::LAYOUT,
];

/// What travels on the services of frames, documents, banks and notes.
pub(crate) const CARRIED: [Struct; 5] = [
    FrameHeader::LAYOUT,
    Page::LAYOUT,
    DocumentHeader::LAYOUT,
    BankHeader::LAYOUT,
    NoteHeader::LAYOUT,
];

/// Every enum with codes: first those that the log shares, then those of messages.
pub(crate) fn code_sets() -> Vec<CodeSet> {
    let shared = outcome::CODE_SETS.iter().chain(CODE_SETS).copied();
    std::iter::once(Representation::CODES).chain(shared).collect()
}

/// The words for a member of a code set in prompts, files and logs, if it has any.
pub(crate) fn words(set: &CodeSet, code: u8) -> Option<&'static str> {
    let position = usize::from(code);
    match set.name {
        "Representation" => {
            Representation::ALL.get(position).map(|representation| representation.name())
        }
        "Reasoning" => Reasoning::ALL.get(position).map(|reasoning| reasoning.word()),
        "Arm" => Arm::ALL.get(position).map(|arm| arm.word()),
        "FeedbackLevel" => FeedbackLevel::ALL.get(position).map(|level| level.word()),
        "SegmentContent" => SegmentContent::ALL.get(position).map(|content| content.word()),
        "DocumentKind" => DocumentKind::ALL.get(position).map(|kind| kind.word()),
        "Outcome" => Outcome::ALL.get(position).map(|outcome| outcome.word()),
        "Role" => Role::ALL.get(position).map(|role| role.word()),
        _ => None,
    }
}

/// A constant, with its value as text.
pub(crate) struct Constant {
    pub(crate) name: &'static str,
    pub(crate) value: String,
    pub(crate) doc: &'static str,
}

macro_rules! constants {
    ($($name:ident: $doc:literal,)*) => {
        vec![$(Constant { name: stringify!($name), value: format!("{:?}", $name), doc: $doc }),*]
    };
}

/// The constants that an implementation needs.
pub(crate) fn constants() -> Vec<Constant> {
    constants![
        WIRE_VERSION: "Version of everything described here.",
        NO_ACTION: "The action code that says: no action was taken.",
        NOT_MEASURED: "A count that was not measured. Absent, never zero.",
        NO_FRAME: "The frame id that names no frame.",
        NO_DOCUMENT: "The document id that names no document.",
        MAX_WINDOW: "Most window entries of a recall.",
        MAX_ITEMS: "Most items of a recall or an answer.",
        MAX_STEPS: "Most steps that a recall holds itself.",
        MAX_SEGMENT: "Most steps of an item that a recall holds itself.",
        MAX_SOURCES: "Most sources of a recall or an answer.",
        MAX_PLAN: "Most actions of a plan.",
        MAX_EMBEDDING: "Most numbers of an embedding.",
        MAX_EXTERNAL_MEMORIES: "Most external memories of a run.",
        MAX_WORLDS: "Most simulators of a run.",
        EXTERNAL: "The representation code of an external memory.",
        MAX_INSTRUCTION: "Most bytes of an instruction.",
        MAX_FOLDER: "Most bytes of the path of a folder.",
        MAX_SUB_GOALS: "Most sub-goals of a task.",
        MAX_DOCUMENT_BYTES: "Most bytes of a document.",
        MAX_LANES: "Most lanes of a run.",
        MAX_FRAMES: "Most frames that a simulator keeps resident.",
        MAX_LOANED_FRAMES: "Frames that the simulator fills at the same time.",
        MAX_ROOT_BYTES: "Longest path of a run's folder, in bytes.",
        PAGE_BYTES: "Bytes of a page; frames are whole pages, aligned to pages.",
        FRAME_SERVICE: "Last part of the name of the service that carries frames.",
        DOCUMENT_SERVICE: "Last part of the name of the service that carries documents.",
        BANK_SERVICE: "First part of the name of the service that carries banks.",
        NOTE_SERVICE: "First part of the name of the service that carries the notes of an external memory.",
        FACTS_SERVICE: "Last part of the name of the service that carries the facts of episodes, as notes.",
        DESCRIPTION_FILE: "The file in an external memory's folder that describes it.",
        ATTACH_FILE: "The file in a run's folder that says how to join it.",
    ]
}

/// Whose messages a section lists.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Section {
    /// Those that a policy sends or receives.
    Policy,
    /// Those that an external memory sends or receives, and no policy.
    ExternalMemory,
    /// All others.
    Others,
}

/// The messages of a section.
pub(crate) fn messages(of: Section) -> impl Iterator<Item = &'static Description> {
    MESSAGES.iter().filter(move |message| {
        let ends = [message.from, message.to].concat();
        let section = if ends.contains(&Role::Policy) {
            Section::Policy
        } else if ends.contains(&Role::ExternalMemory) {
            Section::ExternalMemory
        } else {
            Section::Others
        };
        section == of
    })
}

/// The name of a queue in the tables.
pub(crate) const fn traffic(traffic: Traffic) -> &'static str {
    match traffic {
        Traffic::Lanes => "lanes",
        Traffic::Frames => "frames",
        Traffic::Few => "few",
    }
}

/// A doc comment as one paragraph of plain Markdown: links to code become names, and references to the specification
/// and the paper are removed.
pub(crate) fn plain(doc: &str) -> String {
    let mut rest = doc.split_whitespace().collect::<Vec<_>>().join(" ");
    let mut text = String::new();
    while let Some((before, link)) = rest.split_once('[') {
        text.push_str(before);
        let Some((name, after)) = link.split_once(']') else {
            text.push('[');
            rest = link.to_owned();
            continue;
        };
        text.push_str(name);
        let after = after
            .strip_prefix('(')
            .and_then(|target| target.split_once(')'))
            .map_or(after, |(_, after)| after);
        rest = after.to_owned();
    }
    text.push_str(&rest);
    for aside in [" (specification, ", " (paper, "] {
        if let Some((before, after)) = text.split_once(aside)
            && let Some((_, after)) = after.split_once(')')
        {
            text = format!("{before}{after}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_become_names() {
        let doc = " Code of the [`Action`](crate::Action) taken,\n or [`NO_ACTION`] (nothing [else) so.\n";
        assert_eq!(plain(doc), "Code of the `Action` taken, or `NO_ACTION` (nothing [else) so.");
    }

    #[test]
    fn fields_follow_each_other_without_gaps() {
        for layout in MESSAGES.iter().map(|m| m.layout).chain(PARTS).chain(CARRIED) {
            let end = layout.fields.iter().fold(0, |at, field| {
                assert_eq!(field.offset, at, "{}.{}", layout.name, field.name);
                at + field.bytes
            });
            assert_eq!(end, layout.bytes, "{}", layout.name);
        }
    }
}
