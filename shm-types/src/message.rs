//! The messages: fixed width, no padding, no pointers, safe to receive from anybody.
//!
//! A message is `Pod`: every bit pattern is a value, so receiving one can never be undefined behaviour.
//! Whether it *means* something is checked where it is read, through the `TryFrom` of its codes
//! ([`WirePose`], [`Action`](crate::Action), [`StepKind`], ...).
//!
//! One lane has at most one message outstanding on any service. `episode` is a ticket that the
//! orchestrator never hands out twice in a run, so an answer that arrives late is recognised and
//! dropped. All `*_ns` fields are CLOCK_MONOTONIC nanoseconds, one scale over all processes.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;

use crate::attach::Attach;
use crate::layout::{Field, Layout, Shape, Shaped, Struct, wire_struct};
use domain::{Heading, Pose, UnknownCode};

mod codes;

pub use codes::{
    CODE_SETS, ComplaintKind, DocumentKind, Outcome, Role, SegmentContent, StepKind,
    ViewRequestKind,
};

/// Changes whenever any message or the frame header changes; compared when a process attaches.
pub const WIRE_VERSION: u32 = 4;

/// Most window entries a [`Recall`] carries.
pub const MAX_WINDOW: usize = 32;

/// Most entries of a retrieved segment a [`Recall`] carries: the matched view and what follows.
pub const MAX_SEGMENT: usize = 32;

/// Most documents a [`Recall`] names.
pub const MAX_DOCUMENTS: usize = 4;

/// Most bytes of an instruction.
pub const MAX_INSTRUCTION: usize = 232;

/// The `action` code that says: no action was taken.
pub const NO_ACTION: u8 = u8::MAX;

/// A count that was not measured. Absent, never zero.
pub const NOT_MEASURED: u32 = u32::MAX;

/// Names a frame in the frame store. Never reused within a run; 0 names none.
pub type FrameId = u64;

/// The frame id that names no frame.
pub const NO_FRAME: FrameId = 0;

/// Names a [`Document`](crate::documents::Document). Never reused within a run; 0 names none.
pub type DocumentId = u64;

/// The document id that names no document.
pub const NO_DOCUMENT: DocumentId = 0;

/// A type that travels on its own service.
///
/// # Safety of the wire
/// Implemented by the macro `messages!` only, which also asserts size and padding through `Pod`.
pub trait Message: ZeroCopySend + Pod + core::fmt::Debug {
    /// Last part of the service's name; the run and generation come before it.
    const SERVICE: &'static str;
    /// Who sends it.
    const FROM: &'static [Role];
    /// Who receives it: each of them gets every one.
    const TO: &'static [Role];
    /// How many can wait for one receiver at the same time.
    const TRAFFIC: Traffic;
}

/// What bounds the number of messages that wait for a receiver, and so how long its queue must be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Traffic {
    /// A lane has at most two waiting: the last of one episode and the first of the next.
    Lanes,
    /// Every frame of the store has at most two waiting: a request and a release, or a view and an
    /// eviction.
    Frames,
    /// A few a run.
    Few,
}

impl Traffic {
    /// Messages that can wait for one receiver: what every peer has to make room for.
    pub const fn queue_len(self, attach: &Attach) -> usize {
        match self {
            Self::Lanes => 2 * attach.lanes as usize + 16,
            Self::Frames => 2 * attach.frame_chunks() as usize,
            Self::Few => 256,
        }
    }
}

/// A message's layout and its way through the run.
#[derive(Debug, Clone, Copy)]
pub struct Description {
    /// Its layout.
    pub layout: Struct,
    /// As [`Message::SERVICE`].
    pub service: &'static str,
    /// As [`Message::FROM`].
    pub from: &'static [Role],
    /// As [`Message::TO`].
    pub to: &'static [Role],
    /// As [`Message::TRAFFIC`].
    pub traffic: Traffic,
}

/// Declares messages: layout, name, service, route and asserted size in one place.
macro_rules! messages {
    ($($(#[doc = $doc:literal])* $name:ident, $type_name:literal, $service:literal, $size:literal bytes,
        [$($from:ident)*] to [$($to:ident)*], $traffic:ident {
        $($(#[doc = $field_doc:literal])* $field:ident: $type:ty,)*
    })*) => {
        $(
            wire_struct! {
                $(#[doc = $doc])*
                $name, $type_name, $size bytes { $($(#[doc = $field_doc])* $field: $type,)* }
            }
            impl Message for $name {
                const SERVICE: &'static str = $service;
                const FROM: &'static [Role] = &[$(Role::$from),*];
                const TO: &'static [Role] = &[$(Role::$to),*];
                const TRAFFIC: Traffic = Traffic::$traffic;
            }
        )*

        /// Every message, described.
        pub const MESSAGES: &[Description] = &[$(Description {
            layout: $name::LAYOUT,
            service: $name::SERVICE,
            from: $name::FROM,
            to: $name::TO,
            traffic: $name::TRAFFIC,
        }),*];
    };
}

/// A pose on the wire: column, row, heading code, and a zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[repr(C)]
#[type_name("memtransfer.WirePose")]
pub struct WirePose(pub [u8; 4]);

impl Shaped for WirePose {
    const SHAPE: Shape = Shape::Struct("WirePose");
}

impl Layout for WirePose {
    const LAYOUT: Struct = {
        const fn byte(offset: usize, name: &'static str, doc: &'static str) -> Field {
            Field { name, shape: u8::SHAPE, offset, bytes: 1, doc }
        }
        Struct {
            name: "WirePose",
            type_name: "memtransfer.WirePose",
            doc: "A pose: the cell stood on and the way faced.",
            bytes: size_of::<Self>(),
            align: align_of::<Self>(),
            fields: &[
                byte(0, "x", "Column, growing east."),
                byte(1, "y", "Row, growing north."),
                byte(2, "heading", "Code of the [`Heading`]."),
                byte(3, "reserved", "Zero."),
            ],
        }
    };
}

impl From<Pose> for WirePose {
    fn from(pose: Pose) -> Self {
        Self([pose.cell.x, pose.cell.y, pose.heading as u8, 0])
    }
}

impl TryFrom<WirePose> for Pose {
    type Error = UnknownCode;

    fn try_from(WirePose([x, y, heading, _]): WirePose) -> Result<Self, UnknownCode> {
        Ok(Self::new(x, y, Heading::try_from(heading)?))
    }
}

wire_struct! {
    /// One past step: the view it was taken from, what was done there, and what the world answered.
    PastStep, "memtransfer.PastStep", 16 bytes {
        /// The view before the action.
        frame: FrameId,
        /// Code of the [`Action`](crate::Action) taken, or [`NO_ACTION`].
        action: u8,
        /// Code of the [`Feedback`](crate::Feedback) it got.
        feedback: u8,
        /// Zero.
        reserved: [u8; 6],
    }
}

wire_struct! {
    /// One view of a retrieved segment and the expert's next action there.
    SegmentStep, "memtransfer.SegmentStep", 16 bytes {
        /// The remembered view.
        frame: FrameId,
        /// Code of the [`Action`](crate::Action) the expert took there, or [`NO_ACTION`] for the last
        /// view of the segment, and for every view of a segment of images alone.
        action: u8,
        /// Zero.
        reserved: [u8; 7],
    }
}

wire_struct! {
    /// One step of a demonstration in a [`DocumentKind::Trajectories`] document: what the expert did, and the
    /// view it had there if that is a keyframe.
    TrajectoryStep: Eq, "memtransfer.TrajectoryStep", 16 bytes {
        /// The view before the action, or [`NO_FRAME`] where it was not kept.
        frame: FrameId,
        /// Code of the [`Action`](crate::Action) the expert took there, or [`NO_ACTION`] at the end of the
        /// demonstration.
        action: u8,
        /// Which demonstration, from 0, in the order of the document.
        trajectory: u8,
        /// Zero.
        reserved: [u8; 6],
    }
}

messages! {
    /// Orchestrator to simulator: put a lane's agent somewhere, or let it act.
    StepCommand, "memtransfer.StepCommand", "command", 40 bytes,
        [Orchestrator] to [Sim], Lanes {
        /// The episode's ticket.
        episode: u64,
        /// When the orchestrator sent it.
        sent_ns: u64,
        /// The lane.
        lane: u32,
        /// Steps taken once this command is done: 0 for a reset.
        step: u32,
        /// World variant: 0 is unchanged, `1 + case index` has that case's passage closed.
        variant: u32,
        /// For a reset: where the agent starts. Otherwise ignored.
        start: WirePose,
        /// A [`StepKind`] code.
        kind: u8,
        /// For an act: the [`Action`](crate::Action) code. Otherwise [`NO_ACTION`].
        action: u8,
        /// 1 when the episode ends with this step: nothing is rendered, nobody decides any more.
        last: u8,
        /// Zero.
        reserved: [u8; 5],
    }

    /// Simulator to memory, policy and orchestrator: what is true after a step.
    Observation, "memtransfer.Observation", "observation", 72 bytes,
        [Sim] to [Memory Policy Orchestrator], Lanes {
        /// The episode's ticket.
        episode: u64,
        /// The agent's view; [`NO_FRAME`] when `last` is 1.
        frame: FrameId,
        /// When the command was sent.
        commanded_ns: u64,
        /// When the simulator took the command up.
        woken_ns: u64,
        /// When the dynamics were applied.
        stepped_ns: u64,
        /// When the view was there (at once, if it was rendered before).
        rendered_ns: u64,
        /// When this message was sent.
        sent_ns: u64,
        /// The lane.
        lane: u32,
        /// Steps taken so far.
        step: u32,
        /// Where the agent is.
        pose: WirePose,
        /// Code of the [`Feedback`](crate::Feedback) to the last action.
        feedback: u8,
        /// Code of the last action, or [`NO_ACTION`].
        action: u8,
        /// 1 when the episode is over: forget the lane.
        last: u8,
        /// Zero.
        reserved: u8,
    }

    /// Orchestrator to memory, before a reset: whose memory the lane's next episode is given.
    MemoryBrief, "memtransfer.MemoryBrief", "memory-brief", 32 bytes,
        [Orchestrator] to [Memory], Lanes {
        /// The episode's ticket.
        episode: u64,
        /// The lane.
        lane: u32,
        /// Index of the case.
        case: u32,
        /// Which demonstrations are remembered: bits 0 to 3 the case's own (original, opposite, nearby,
        /// distant), bit 4 its irrelevant histories, bit 5 its confusable ones.
        demonstrations: u32,
        /// Code of the [`Representation`](crate::Representation).
        representation: u8,
        /// Window length h, at most [`MAX_WINDOW`].
        window: u8,
        /// Expert actions a retrieved segment follows, H_epi, less than [`MAX_SEGMENT`].
        horizon: u8,
        /// Keyframes of full-context memory, shared by all its demonstrations.
        keyframes: u8,
        /// Code of the [`SegmentContent`].
        segment: u8,
        /// Zero.
        reserved: [u8; 7],
    }

    /// Orchestrator to policy, before a reset: what the lane's next episode asks for.
    PolicyBrief, "memtransfer.PolicyBrief", "policy-brief", 264 bytes,
        [Orchestrator] to [Policy], Lanes {
        /// The episode's ticket.
        episode: u64,
        /// A policy that draws at random draws from this.
        seed: u64,
        /// The lane.
        lane: u32,
        /// Bytes of `instruction` in use.
        instruction_len: u32,
        /// Which repetition of the run this is, from 1: equal requests of one repetition are the same request.
        repeat: u32,
        /// 1 when the policy is told that the demonstration started where this episode starts.
        starts_as_demonstrated: u8,
        /// Zero.
        reserved: [u8; 3],
        /// The instruction, UTF-8.
        instruction: [u8; MAX_INSTRUCTION],
    }

    /// Memory to simulator: make a view of the unchanged world resident, or let it go.
    ViewRequest, "memtransfer.ViewRequest", "view-request", 16 bytes,
        [Memory] to [Sim], Frames {
        /// For a release: the frame. For a request: [`NO_FRAME`].
        frame: FrameId,
        /// For a request: the view's pose.
        pose: WirePose,
        /// A [`ViewRequestKind`] code.
        kind: u8,
        /// Zero.
        reserved: [u8; 3],
    }

    /// Simulator to memory: the requested view is resident and stays until it is released.
    View, "memtransfer.View", "view", 16 bytes,
        [Sim] to [Memory], Frames {
        /// The view's frame.
        frame: FrameId,
        /// The pose that was asked for.
        pose: WirePose,
        /// Zero.
        reserved: u32,
    }

    /// Simulator to whoever holds frames: let this one go. No live lane or memory refers to it.
    Eviction, "memtransfer.Eviction", "eviction", 8 bytes,
        [Sim] to [Memory Policy], Frames {
        /// The frame.
        frame: FrameId,
    }

    /// Memory to policy: the window, and what was remembered for this step.
    Recall, "memtransfer.Recall", "recall", 1104 bytes,
        [Memory] to [Policy], Lanes {
        /// The episode's ticket.
        episode: u64,
        /// When the observation was taken up.
        received_ns: u64,
        /// When this message was sent.
        sent_ns: u64,
        /// The lane.
        lane: u32,
        /// The step it answers.
        step: u32,
        /// Cosine distance of the segment's first view to the current one; NaN without a segment.
        distance: f32,
        /// Entries of `window` in use, oldest first.
        window_len: u32,
        /// Entries of `segment` in use: 0 without a retrieval.
        segment_len: u32,
        /// Entries of `documents` in use.
        documents_len: u32,
        /// What is supplied beside window and segment, in order. A document is published before the first
        /// recall that names it.
        documents: [DocumentId; MAX_DOCUMENTS],
        /// The last steps before the current one, oldest first.
        window: [PastStep; MAX_WINDOW],
        /// The matched view, then the views that the expert's actions led to.
        segment: [SegmentStep; MAX_SEGMENT],
    }

    /// Memory to orchestrator, with every recall: where it came from and what it cost.
    RecallTrace, "memtransfer.RecallTrace", "recall-trace", 72 bytes,
        [Memory] to [Orchestrator], Lanes {
        /// The episode's ticket.
        episode: u64,
        /// When the observation was taken up.
        received_ns: u64,
        /// When the embeddings that the answer needs were there: the current view's and, in an episode's
        /// first steps, those of the demonstrations.
        embedded_ns: u64,
        /// When the nearest view was found.
        searched_ns: u64,
        /// When the recall was put together.
        assembled_ns: u64,
        /// When the recall was sent.
        sent_ns: u64,
        /// The lane.
        lane: u32,
        /// The step.
        step: u32,
        /// Case whose demonstration was matched, or [`NOT_MEASURED`] without a retrieval.
        case: u32,
        /// Which of its demonstrations (0 original, 1 opposite, 2 nearby, 3 distant).
        demonstration: u16,
        /// Step of the matched view in it.
        index: u16,
        /// Cosine distance of the match; NaN without one.
        distance: f32,
        /// Zero.
        reserved: u32,
    }

    /// Anyone to orchestrator, about once a second while it changes: what the sender is at. Memory is at work as
    /// long as `done` grows, however long an answer takes: where nothing is cached, the views of many lanes'
    /// demonstrations do take long.
    Pulse, "memtransfer.Pulse", "pulse", 40 bytes,
        [Sim Memory Policy] to [Orchestrator], Few {
        /// Code of the sender's [`Role`].
        role: u32,
        /// Zero.
        reserved: u32,
        /// Work done since the sender started: views drawn, images embedded, requests answered.
        done: u64,
        /// Work that is known to wait: views to draw, images to embed, requests to answer.
        waiting: u64,
        /// Frames that are resident (simulator), held for memories (memory) or held (policy).
        held: u64,
        /// How many there may be; 0 where nothing bounds it.
        room: u64,
    }

    /// Policy to orchestrator: what to do. Counts that nobody told are [`NOT_MEASURED`].
    Decision, "memtransfer.Decision", "decision", 112 bytes,
        [Policy] to [Orchestrator], Lanes {
        /// The episode's ticket.
        episode: u64,
        /// When observation and recall were both there.
        received_ns: u64,
        /// When the policy began to decide.
        started_ns: u64,
        /// When the prompt was built; 0 where none is.
        prompted_ns: u64,
        /// When the request went to a model's server, the last time if it went several times; 0 where none did.
        sent_ns: u64,
        /// When it had decided.
        decided_ns: u64,
        /// The lane.
        lane: u32,
        /// The step it answers.
        step: u32,
        /// Tokens of the prompt.
        prompt_tokens: u32,
        /// Tokens of the completion.
        completion_tokens: u32,
        /// Tokens of the prompt that the server had computed before and took from its own cache.
        cached_tokens: u32,
        /// Tokens of the prompt's images.
        image_tokens: u32,
        /// Tokens of the prompt that are injected memory, an estimate.
        memory_tokens: u32,
        /// Images that the request held.
        images_asked: u32,
        /// Images that the policy was shown: fewer where its budget is smaller.
        images: u32,
        /// Requests to a model's server that this decision took, failed ones included.
        attempts: u32,
        /// An [`Outcome`] code.
        outcome: u8,
        /// Code of the action when the outcome is [`Outcome::Acted`], otherwise [`NO_ACTION`].
        action: u8,
        /// 1 when the reply was one that had been kept from an earlier request: it cost nothing this time.
        replayed: u8,
        /// Zero.
        reserved: [u8; 21],
    }

    /// Anyone to orchestrator, once, when ready to work.
    Hello, "memtransfer.Hello", "hello", 512 bytes,
        [Sim Memory Policy] to [Orchestrator], Few {
        /// [`WIRE_VERSION`] the sender was built with.
        wire_version: u32,
        /// Code of its [`Role`].
        role: u32,
        /// Its process id.
        pid: u32,
        /// Bytes of `facts` in use.
        facts_len: u32,
        /// A JSON object of strings for the manifest: adapter, frame path, encoder, policy, ...
        facts: [u8; 496],
    }

    /// Anyone to orchestrator: what went wrong, and what follows from it ([`ComplaintKind`]).
    Complaint, "memtransfer.Complaint", "complaint", 512 bytes,
        [Sim Memory Policy] to [Orchestrator], Few {
        /// For a [`ComplaintKind::Episode`]: the episode's ticket. Otherwise 0.
        episode: u64,
        /// Code of the sender's [`Role`].
        role: u32,
        /// Complaints the sender has made so far, this one included.
        count: u32,
        /// Code of the [`ComplaintKind`].
        kind: u32,
        /// For a [`ComplaintKind::Episode`]: the episode's lane. Otherwise 0.
        lane: u32,
        /// Bytes of `text` in use.
        text_len: u32,
        /// Zero.
        reserved: u32,
        /// What, which value, what was expected; UTF-8.
        text: [u8; 480],
    }

    /// Anyone to orchestrator, once, after [`Stop`]: what the sender did with frames.
    Farewell, "memtransfer.Farewell", "farewell", 48 bytes,
        [Sim Memory Policy] to [Orchestrator], Few {
        /// Code of the sender's [`Role`].
        role: u32,
        /// Zero.
        reserved: u32,
        /// Frames rendered into the store (simulator only).
        frames_rendered: u64,
        /// Frames evicted from the store (simulator only).
        frames_evicted: u64,
        /// Frames that this process took hold of (memory and policy).
        frames_held: u64,
        /// Bytes of pixels that the sender's own code copied on their way to another process.
        pixel_bytes_copied: u64,
        /// Messages that could not be used.
        complaints: u64,
    }

    /// Orchestrator to everyone: finish, send a [`Farewell`], exit.
    Stop, "memtransfer.Stop", "stop", 8 bytes,
        [Orchestrator] to [Sim Memory Policy], Few {
        /// Zero.
        reserved: u64,
    }
}

/// Copies as much of `text` as fits into `buffer`, cut at a character; returns the bytes used.
pub fn write_text(buffer: &mut [u8], text: &str) -> u32 {
    let mut end = text.len().min(buffer.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    buffer[..end].copy_from_slice(&text.as_bytes()[..end]);
    end as u32
}

/// The text that the first `len` bytes of `buffer` hold.
///
/// # Errors
/// When `len` is past the buffer or the bytes are not UTF-8: the sender is broken.
pub fn read_text(buffer: &[u8], len: u32) -> Result<&str, UnknownCode> {
    let broken = || UnknownCode::new(format_args!("a text of {len} bytes"), "UTF-8 that fits");
    let bytes = buffer.get(..len as usize).ok_or_else(broken)?;
    core::str::from_utf8(bytes).map_err(|_| broken())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{Action, Feedback};

    /// Calls `$check::<M>($arguments)` for every message `M`.
    macro_rules! every_message {
        ($check:ident $(, $argument:expr)*) => {
            every_message!(@ $check, ($($argument),*), StepCommand Observation MemoryBrief PolicyBrief
                ViewRequest View Eviction Recall RecallTrace Pulse Decision Hello Complaint Farewell Stop)
        };
        (@ $check:ident, $arguments:tt, $($message:ident)*) => {$($check::<$message>$arguments;)*};
    }

    #[test]
    fn codes_are_positions() {
        for (code, role) in Role::ALL.iter().enumerate() {
            assert_eq!(Role::try_from(code as u8), Ok(*role));
        }
        assert!(Role::try_from(4).is_err());
        assert!(Outcome::try_from(NO_ACTION).is_err());
        assert!(Action::try_from(NO_ACTION).is_err() && Feedback::try_from(NO_ACTION).is_err());
    }

    #[test]
    fn every_message_has_a_way_to_go() {
        fn check<M: Message>() {
            assert!(!M::FROM.is_empty() && !M::TO.is_empty(), "{}", M::SERVICE);
            assert!(M::FROM.iter().all(|role| !M::TO.contains(role)), "{}", M::SERVICE);
        }
        every_message!(check);
    }

    proptest! {
        /// Whatever arrives is a value or an error.
        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 2048)) {
            fn check<M: Message>(bytes: &[u8]) {
                let message: M = bytemuck::pod_read_unaligned(&bytes[..size_of::<M>()]);
                let _ = format!("{message:?}");
            }
            every_message!(check, &bytes);

            for &byte in &bytes {
                let _ = (StepKind::try_from(byte), ViewRequestKind::try_from(byte));
                let _ = (Outcome::try_from(byte), Role::try_from(byte));
                let _ = (Action::try_from(byte), Feedback::try_from(byte));
                let _ = (DocumentKind::try_from(byte), SegmentContent::try_from(byte));
                let _ = ComplaintKind::try_from(byte);
            }
            for pose in bytes.chunks_exact(4) {
                let wire: WirePose = bytemuck::pod_read_unaligned(pose);
                if let Ok(pose) = Pose::try_from(wire) {
                    prop_assert_eq!(&WirePose::from(pose).0[..3], &wire.0[..3]);
                }
            }
            let hello: Hello = bytemuck::pod_read_unaligned(&bytes[..size_of::<Hello>()]);
            let _ = read_text(&hello.facts, hello.facts_len);
            for len in 0..=u32::from(u8::MAX) {
                if let Ok(text) = read_text(&bytes[..240], len) {
                    let mut buffer = [0; 240];
                    prop_assert_eq!(write_text(&mut buffer, text), len);
                }
            }
        }

        /// What is written is read, up to what fits.
        #[test]
        fn text_round_trips(text in any::<String>()) {
            let mut buffer = [0; 24];
            let used = write_text(&mut buffer, &text);
            let read = read_text(&buffer, used).map_err(|e| TestCaseError::fail(e.to_string()))?;
            prop_assert!(text.starts_with(read) && (read == text || read.len() > 20));
        }
    }

    #[test]
    fn text_is_cut_at_a_character_and_read_with_care() {
        let mut buffer = [0; 4];
        let used = write_text(&mut buffer, "abcé");
        assert_eq!(read_text(&buffer, used), Ok("abc"));
        assert!(read_text(&buffer, 5).is_err());
        assert!(read_text(&[0xff; 4], 4).is_err());
    }
}
