//! The structures that messages and documents consist of.

use iceoryx2::prelude::ZeroCopySend;

use super::*;
use crate::layout::wire_struct;

wire_struct! {
    /// One step of a demonstration in a [`Recall`].
    SegmentStep, "memtransfer.SegmentStep", 16 bytes {
        /// The remembered view, or [`NO_FRAME`].
        frame: FrameId,
        /// Code of the action that the expert took there, or [`NO_ACTION`]: at the end of the item, and
        /// throughout an item of views alone.
        action: u8,
        /// Zero.
        reserved: [u8; 7],
    }
}

wire_struct! {
    /// One item of what memory supplies for a step.
    RecalledItem, "memtransfer.RecalledItem", 32 bytes {
        /// Text and captioned frame: the document that holds the text. Trajectory and plan: the document that holds the steps.
        /// Otherwise, and for an empty caption, [`NO_DOCUMENT`].
        document: DocumentId,
        /// Distance between the item and the query; NaN if the memory tells none.
        distance: f32,
        /// First step: in [`Recall::steps`], or in the document of a trajectory or plan.
        first_step: u32,
        /// Number of steps, at least 1; 1 for a captioned frame, 0 for a text. Those of a trajectory or plan can belong to
        /// several demonstrations, one after the other.
        steps: u32,
        /// First byte of the text in the document.
        first_byte: u32,
        /// Bytes of the text.
        bytes: u32,
        /// An [`ItemKind`] code.
        kind: u8,
        /// Steps and trajectory: 1 if they are a whole demonstration, from its start to its end.
        whole: u8,
        /// All but text: the first entry in [`Recall::instructions`].
        first_instruction: u8,
        /// Number of entries: one for each demonstration that the steps belong to, in their order; 0 for a text. Plan: one
        /// for each of its parts that is taken from a demonstration.
        instructions: u8,
    }
}

wire_struct! {
    /// The instruction of a demonstration that an item of a [`Recall`] comes from.
    RecalledInstruction, "memtransfer.RecalledInstruction", 16 bytes {
        /// The note that holds it; [`NO_DOCUMENT`] if it is empty.
        document: DocumentId,
        /// Its first byte in the note.
        first_byte: u32,
        /// Its bytes.
        bytes: u32,
    }
}

wire_struct! {
    /// Where an item comes from: consecutive steps of one demonstration.
    RecalledSource, "memtransfer.RecalledSource", 16 bytes {
        /// Index of the demonstration's case; with [`EXPERIENCE`], the episode's position in its sequence.
        case: u32,
        /// Distance between the item and the query; NaN if the memory tells none.
        distance: f32,
        /// The demonstration (0 original, 1 opposite, 2 nearby, 3 distant, 6 after, 7 elsewhere, 8 new, 9 blocked), or
        /// [`EXPERIENCE`].
        demonstration: u16,
        /// Its first step.
        first: u16,
        /// Number of steps.
        steps: u16,
        /// Number of the item that comes from here, from 0.
        item: u8,
        /// The item's [`ItemKind`] code.
        kind: u8,
    }
}

wire_struct! {
    /// One item of an [`ExternalAnswer`].
    AnswerItem, "memtransfer.AnswerItem", 28 bytes {
        /// Text and captioned frame: first byte of the text in the answer's note. Plan: that of its actions, one byte each: the
        /// code of an action of the memory's own, or [`NO_ACTION`] for the expert's action at the next of the steps that the
        /// item's sources name, in their order.
        first_byte: u32,
        /// Bytes of the text or of the actions.
        bytes: u32,
        /// Steps and captioned frame: number of the demonstration in the bank.
        demonstration: u32,
        /// Its first step.
        first_step: u32,
        /// Number of steps; 1 for a captioned frame.
        steps: u32,
        /// Distance between the item and the query, which prompts word as a cosine distance of views; NaN if there is none.
        distance: f32,
        /// An [`ItemKind`] code; steps of any length are [`ItemKind::Steps`].
        kind: u8,
        /// Steps: 1 to supply their views; 2 to supply those whose numbers the answer's note holds, as `bytes / 4`
        /// little-endian 32-bit numbers from `first_byte` on.
        views: u8,
        /// Steps: 1 to supply their actions.
        actions: u8,
        /// Zero.
        reserved: u8,
    }
}

wire_struct! {
    /// Where a text or a plan of an [`ExternalAnswer`] comes from: consecutive steps of one demonstration.
    AnswerSource, "memtransfer.AnswerSource", 16 bytes {
        /// Number of the item, from 0.
        item: u32,
        /// Number of the demonstration in the bank.
        demonstration: u32,
        /// Its first step.
        first_step: u32,
        /// Number of steps.
        steps: u32,
    }
}

wire_struct! {
    /// One step of a demonstration in a [`DocumentKind::Trajectories`](domain::DocumentKind) document: the expert's
    /// action, and its view if that is a keyframe. Or one of a plan: an action, without a view.
    TrajectoryStep: Eq, "memtransfer.TrajectoryStep", 16 bytes {
        /// The view before the action, or [`NO_FRAME`] if it is not a keyframe.
        frame: FrameId,
        /// Code of the action that the expert took there, or [`NO_ACTION`] at the end of the
        /// demonstration. Plan: code of the action.
        action: u8,
        /// Which demonstration, or part of a plan, from 0, in the order of the document.
        trajectory: u8,
        /// Plan: 1 if the memory chose the action itself, 0 if it is an expert's. Otherwise 0.
        own: u8,
        /// Zero.
        reserved: [u8; 5],
    }
}
