//! The messages: fixed size, no padding, no pointers.
//!
//! A message is `Pod`: every bit pattern is a value, so receiving one is never undefined behaviour. The receiver
//! checks what the values mean: codes of enums through their `TryFrom` ([`StepKind`], ...), and states, actions and feedback
//! through the declaration of the world, `world.json` in the folder to which it attaches.
//!
//! A lane has at most one message outstanding on any service. The orchestrator never uses an episode id twice in a
//! session of a run, so a late answer is recognised and dropped. All `*_ns` fields are CLOCK_MONOTONIC nanoseconds, which all
//! processes of a machine share.

use iceoryx2::prelude::ZeroCopySend;

use crate::layout::{WireLayout, wire_struct};

mod codes;
mod counts;
mod parts;
mod route;
mod text;

pub use codes::{
    CODE_SETS, EpisodeEnd, EpisodeOutcome, ErrorReportKind, ItemKind, Learning, Role, StepKind,
    ViewRequestKind, action_code, read_action, read_flag,
};
pub use counts::DecisionCounts;
pub use domain::limits::{
    MAX_EXTERNAL_MEMORIES, MAX_INSTRUCTION, MAX_ITEMS, MAX_SEGMENT, MAX_WINDOW, MAX_WORLDS,
};
pub use domain::{MAX_ACTIONS, MAX_STATE};
pub use parts::*;
pub use route::{Description, Message, Traffic};
pub use text::{MAX_REASON_BYTES, read_text, shortened_reason, write_text};

/// Version of everything that `docs/wire.md` describes; compared when a process attaches.
pub const WIRE_VERSION: u32 = 16;

/// Most demonstration steps that a [`Recall`] holds itself. A longer item is a document.
pub const MAX_STEPS: usize = 48;

/// Most parts of demonstrations that a [`RecallTrace`] names as the sources of the items.
pub const MAX_SOURCES: usize = 16;

/// Most actions of a plan.
pub const MAX_PLAN: usize = 1024;

/// Most numbers of an embedding.
pub const MAX_EMBEDDING: usize = 1024;

/// The `action` code for "no action".
pub const NO_ACTION: u8 = u8::MAX;

/// The representation code of an external memory.
pub const EXTERNAL: u8 = u8::MAX;

/// The count for "not measured".
pub const NOT_MEASURED: u32 = u32::MAX;

/// Identifies a frame in the frame store. Never reused within a run; 0 is no frame.
pub type FrameId = u64;

/// The frame id for "no frame".
pub const NO_FRAME: FrameId = 0;

/// Identifies a [`Document`](crate::documents::Document). Never reused within a run; 0 is no document.
pub type DocumentId = u64;

/// Identifies a snapshot of a memory by its content: the first bytes of the BLAKE3 hash of its files. Zeros are no snapshot.
pub type SnapshotId = [u8; 16];

/// The document id for "no document".
pub const NO_DOCUMENT: DocumentId = 0;

/// Most sub-goals of a task that an external memory can be told.
pub const MAX_SUB_GOALS: usize = 24;

/// Longest path of a folder that an external memory saves into.
pub const MAX_FOLDER: usize = 1024;

/// In [`RecalledSource::demonstration`]: the source is an earlier episode of the same stream, not a demonstration.
pub const EXPERIENCE: u16 = u16::MAX;

/// Identifies an episode. Never 0, and never reused within a session of a run. Ids have no order: they tell neither an episode's
/// place in the plan nor which of two began first.
pub type EpisodeId = u64;

/// Identifies a step of an episode: what an answer belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct RequestId {
    /// The lane that the episode runs in.
    pub lane: u32,
    /// The episode.
    pub episode: EpisodeId,
    /// Steps taken so far.
    pub step: u32,
}

/// Declares the messages of the table: layout, name, service, route and size.
macro_rules! declare_messages {
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

        /// All messages.
        pub const MESSAGES: &[Description] = &[$(Description {
            layout: $name::LAYOUT,
            service: $name::SERVICE,
            from: $name::FROM,
            to: $name::TO,
            traffic: $name::TRAFFIC,
        }),*];
    };
}

/// The table of all messages, passed to the macro `$with`: each one's documentation, names, size, route and fields.
#[rustfmt::skip]
macro_rules! message_table {
($with:ident) => { $with! {
    /// Orchestrator to simulator: the lane's next episode, which begins at once.
    WorldEpisodeConfig, "memtransfer.WorldEpisodeConfig", "world-config", 56 bytes,
        [Orchestrator] to [Sim], Lanes {
        /// The episode.
        episode: u64,
        /// Seed for random choices of the world: that of the policy's config.
        seed: u64,
        /// Identifies the sequence of episodes of a stream that share a memory; 0 outside of streams.
        sequence: u64,
        /// When the orchestrator sent it.
        sent_ns: u64,
        /// The lane.
        lane: u32,
        /// Index of the case.
        case: u32,
        /// World variant: 0 is the unchanged world; in `1 + case index` that case's passage is closed; after these come the
        /// states of the run's streams. Where the world differs from the demonstrations beside that, and the case book offers
        /// it: `(mismatch << 24) + (case index << 1) + closed`, with `closed` 1 if the case's passage is, and `mismatch` 1 for other
        /// light, 2 without labels, 3 for another height of the camera, 4 for another field of view, 6 for other stock.
        variant: u32,
        /// Steps after which the episode ends.
        max_steps: u32,
        /// In a stream: the episode's position in its sequence, from 0.
        position: u32,
        /// Where it begins: 0 at the case's original start, 1 at its new one.
        start: u8,
        /// 1 if a memory learns from the episode, and may ask for its views later.
        learns: u8,
        /// Zero.
        reserved: [u8; 2],
    }

    /// Orchestrator to simulator: act in a lane.
    StepCommand, "memtransfer.StepCommand", "command", 32 bytes,
        [Orchestrator] to [Sim], Lanes {
        /// The episode.
        episode: u64,
        /// When the orchestrator sent it.
        sent_ns: u64,
        /// The lane.
        lane: u32,
        /// Steps taken after this command, from 1.
        step: u32,
        /// A [`StepKind`] code.
        kind: u8,
        /// For an act: the code of the action. Otherwise [`NO_ACTION`].
        action: u8,
        /// Zero.
        reserved: [u8; 6],
    }

    /// Simulator to memory and policy: the state at the beginning of an episode and after each step.
    Observation, "memtransfer.Observation", "observation", 96 bytes,
        [Sim] to [Memory Policy], Lanes {
        /// The episode.
        episode: u64,
        /// The agent's view; [`NO_FRAME`] if `last` is 1.
        frame: FrameId,
        /// The lane.
        lane: u32,
        /// Steps taken so far.
        step: u32,
        /// The agent's state: the numbers that the world declares, then zeros.
        state: [f32; MAX_STATE],
        /// Code of the feedback to the last action.
        feedback: u8,
        /// Code of the last action, or [`NO_ACTION`].
        action: u8,
        /// 1 when the episode is over.
        last: u8,
        /// Zero.
        reserved: [u8; 5],
    }

    /// Simulator to orchestrator and memory, before each [`Observation`]: how far the episode is, and when the step was taken.
    /// External memories get no such message: after an episode that they learn from, they get what the feedback level of its
    /// config says.
    StepReport, "memtransfer.StepReport", "step-report", 88 bytes,
        [Sim] to [Memory Orchestrator], Lanes {
        /// The episode.
        episode: u64,
        /// The frame of the observation: [`NO_FRAME`] if the episode has ended.
        frame: FrameId,
        /// The note with the facts of the episode, published before, if it has ended; otherwise [`NO_DOCUMENT`].
        facts: DocumentId,
        /// When the orchestrator sent the command.
        commanded_ns: u64,
        /// When the simulator received the command.
        woken_ns: u64,
        /// When the dynamics were applied.
        stepped_ns: u64,
        /// When the view was resident: at once if it had been rendered before.
        rendered_ns: u64,
        /// When this message was sent.
        sent_ns: u64,
        /// At the begin and at the end of an episode: a hash of the whole state of its world, as the world defines it. Equal
        /// states have equal hashes. Otherwise 0.
        state_hash: u64,
        /// The lane.
        lane: u32,
        /// Steps taken so far.
        step: u32,
        /// Sub-goals completed so far.
        sub_goals: u16,
        /// All sub-goals of the task.
        required: u16,
        /// An [`EpisodeEnd`] code.
        ended: u8,
        /// 1 if the agent ran in this step into what the variant has changed.
        conflict: u8,
        /// Zero.
        reserved: [u8; 2],
    }

    /// Orchestrator to memory, before an episode begins: its memory.
    MemoryEpisodeConfig, "memtransfer.MemoryEpisodeConfig", "memory-config", 88 bytes,
        [Orchestrator] to [Memory], Lanes {
        /// The episode.
        episode: u64,
        /// Seed for random choices of the memory: that of the policy's config.
        seed: u64,
        /// The lane.
        lane: u32,
        /// Index of the case.
        case: u32,
        /// The demonstrations in memory. Bits 0 to 3: the case's own (original, opposite, nearby, distant). Bit 4: its
        /// irrelevant histories. Bit 5: its confusable ones. Bit 6: the one after the case's passage has closed. Bit 7:
        /// that one comes first. Bit 8: the one of another warehouse. In control arms, bit 9: the test reference on the
        /// unchanged route, bit 10: on the blocked route, bit 11: its first irrelevant history alone, bit 12: its two
        /// irrelevant histories alone. Bits 16 to 31: the size of a bank of the case's own and others.
        demonstrations: u32,
        /// Code of the [`Representation`](domain::Representation), or [`EXTERNAL`].
        representation: u8,
        /// Expert actions a retrieved segment follows, H_epi, less than [`MAX_SEGMENT`].
        horizon: u8,
        /// Keyframes of full-context memory, shared by all its demonstrations.
        keyframes: u8,
        /// Code of the [`SegmentContent`](domain::SegmentContent).
        segment: u8,
        /// Most bytes of text in one recall.
        text_budget: u32,
        /// Most images in one recall.
        image_budget: u16,
        /// Segments that episodic memory supplies, k.
        hits: u8,
        /// For [`EXTERNAL`]: index of the external memory.
        external: u8,
        /// The repetition of the run, from 1.
        repeat: u32,
        /// World variant of the episode, as in [`WorldEpisodeConfig`], without its mismatch.
        variant: u32,
        /// Identifies the memory that persists from episode to episode of a stream; 0 outside of streams, where every
        /// episode has a memory of its own.
        sequence: u64,
        /// The snapshot that a persistent memory continues from; zero if it is built anew.
        snapshot: SnapshotId,
        /// In a stream: its number in the run's list of streams.
        stream: u32,
        /// In a stream: the block of the stream's list of blocks that the episode belongs to.
        block: u32,
        /// In a stream: the episode's position in its sequence, from 0.
        position: u32,
        /// Code of the [`Arm`](domain::Arm).
        arm: u8,
        /// 1 if the memory learns from the episode: it observes it, is told of its end, and a snapshot is taken then.
        learns: u8,
        /// Code of the [`FeedbackLevel`](domain::FeedbackLevel): what a memory that learns is told at the end.
        feedback: u8,
        /// 1 if the instruction is the case's paraphrase.
        paraphrased: u8,
    }

    /// Orchestrator to policy, before an episode begins: the episode.
    PolicyEpisodeConfig, "memtransfer.PolicyEpisodeConfig", "policy-config", 264 bytes,
        [Orchestrator] to [Policy], Lanes {
        /// The episode.
        episode: u64,
        /// Seed for random choices of the policy.
        seed: u64,
        /// The lane.
        lane: u32,
        /// Bytes of `instruction` in use.
        instruction_len: u32,
        /// The repetition of the run, from 1: equal requests of one repetition are the same request.
        repeat: u32,
        /// 1 when the prompt says that a demonstration started in this episode's start pose.
        starts_as_demonstrated: u8,
        /// Window length h, at most [`MAX_WINDOW`]: how many past steps belong to a request.
        window: u8,
        /// 1 when the prompt says that the demonstrations took place in another warehouse.
        demonstrated_elsewhere: u8,
        /// Zero.
        reserved: u8,
        /// The instruction, UTF-8.
        instruction: [u8; MAX_INSTRUCTION],
    }

    /// Memory to simulator: pin or release a view.
    ViewRequest, "memtransfer.ViewRequest", "view-request", 32 bytes,
        [Memory] to [Sim], Frames {
        /// For a release: the frame. To pin: [`NO_FRAME`].
        frame: FrameId,
        /// To pin: 0 for a view of a demonstration; otherwise the sequence of an episode that a memory has learned from.
        sequence: u64,
        /// To pin: the index of the demonstration in the run's demonstrations, or the episode's position in its sequence.
        demonstration: u32,
        /// To pin: the step.
        step: u32,
        /// A [`ViewRequestKind`] code.
        kind: u8,
        /// Zero.
        reserved: [u8; 7],
    }

    /// Simulator to memory: the requested view is resident and pinned until it is released.
    View, "memtransfer.View", "view", 24 bytes,
        [Sim] to [Memory], Frames {
        /// The view's frame.
        frame: FrameId,
        /// As requested.
        sequence: u64,
        /// As requested.
        demonstration: u32,
        /// As requested.
        step: u32,
    }

    /// Simulator to memory, policy and external memories: drop this frame. No running episode and no memory refers to it.
    Eviction, "memtransfer.Eviction", "eviction", 8 bytes,
        [Sim] to [Memory Policy ExternalMemory], Frames {
        /// The frame.
        frame: FrameId,
    }

    /// Memory to policy: what memory supplies for a step.
    Recall, "memtransfer.Recall", "recall", 1312 bytes,
        [Memory] to [Policy], Lanes {
        /// The episode.
        episode: u64,
        /// The lane.
        lane: u32,
        /// The step it answers.
        step: u32,
        /// Entries of `items` in use.
        items_len: u32,
        /// Entries of `steps` in use.
        steps_len: u32,
        /// Entries of `instructions` in use.
        instructions_len: u32,
        /// Zero.
        reserved: u32,
        /// What is supplied, in order. A document is published before the first recall that names it.
        items: [RecalledItem; MAX_ITEMS],
        /// The steps of the items that hold theirs here.
        steps: [SegmentStep; MAX_STEPS],
        /// The instructions of the demonstrations that steps and captioned frames come from.
        instructions: [RecalledInstruction; MAX_SOURCES],
    }

    /// Memory to orchestrator, with every recall: what was supplied, where it comes from, and when.
    RecallTrace, "memtransfer.RecallTrace", "recall-trace", 360 bytes,
        [Memory] to [Orchestrator], Lanes {
        /// The episode.
        episode: u64,
        /// When memory received the observation.
        received_ns: u64,
        /// When the embeddings that the answer needs were complete: the current view's and, in an episode's first
        /// steps, those of the demonstrations.
        embedded_ns: u64,
        /// When the memory had answered the query.
        searched_ns: u64,
        /// When the recall was put together.
        assembled_ns: u64,
        /// When the recall was sent.
        sent_ns: u64,
        /// Nanoseconds that an external memory computed, by its own clock; 0 for a built-in one. The rest of the time
        /// between `embedded_ns` and `searched_ns` is the wire.
        method_ns: u64,
        /// Bytes of the memory's store, if it tells them; otherwise 0.
        store_bytes: u64,
        /// The lane.
        lane: u32,
        /// The step.
        step: u32,
        /// Images that the memory asked for.
        images_asked: u32,
        /// Images that are supplied.
        images: u32,
        /// Bytes of text that the memory asked for.
        text_asked: u32,
        /// Bytes of text that are supplied.
        text: u32,
        /// Items that the memory asked for.
        items_asked: u16,
        /// Items that are supplied. An item that does not fit into a budget is dropped whole.
        items: u16,
        /// Tokens of the memory's own requests to a model for this step; [`NOT_MEASURED`] if it reports none.
        tokens: u32,
        /// Entries of `sources` in use. An item without a source comes from the memory as a whole.
        sources_len: u32,
        /// Zero.
        reserved: u32,
        /// Where the items come from, in order of the items.
        sources: [RecalledSource; MAX_SOURCES],
    }

    /// Memory to orchestrator: a memory has learned from an episode of a stream, and the snapshot of what it knows now is on
    /// disk. Sent once for each episode that is learned from, after its last observation.
    SnapshotReport, "memtransfer.SnapshotReport", "snapshot-report", 40 bytes,
        [Memory] to [Orchestrator], Lanes {
        /// The episode.
        episode: u64,
        /// The snapshot.
        snapshot: SnapshotId,
        /// Bytes of the memory's store, if it tells them; otherwise 0.
        store_bytes: u64,
        /// The lane.
        lane: u32,
        /// Zero.
        reserved: u32,
    }

    /// Memory to an external memory: an episode begins.
    ExternalEpisode, "memtransfer.ExternalEpisode", "external-episode", 280 bytes,
        [Memory] to [ExternalMemory], Lanes {
        /// The episode.
        episode: u64,
        /// The demonstrations it remembers: the id of a bank.
        bank: u64,
        /// Seed for random choices.
        seed: u64,
        /// The lane.
        lane: u32,
        /// Most bytes of text in one answer.
        text_budget: u32,
        /// Most images in one answer.
        image_budget: u32,
        /// The repetition of the run, from 1.
        repeat: u32,
        /// Bytes of `instruction` in use.
        instruction_len: u32,
        /// A [`Learning`] code.
        learning: u32,
        /// The instruction, UTF-8.
        instruction: [u8; MAX_INSTRUCTION],
    }

    /// Memory to an external memory: the agent's state after a step. Each is answered, except the last of an episode.
    ExternalQuery, "memtransfer.ExternalQuery", "external-query", 4256 bytes,
        [Memory] to [ExternalMemory], Lanes {
        /// The episode.
        episode: u64,
        /// The agent's view; [`NO_FRAME`] if `last` is 1.
        frame: FrameId,
        /// The lane.
        lane: u32,
        /// Steps taken so far.
        step: u32,
        /// The agent's state: the numbers that the world declares, then zeros.
        state: [f32; MAX_STATE],
        /// Numbers of `embedding` in use; 0 if the memory asked for no embeddings.
        embedding_len: u32,
        /// Code of the feedback to the last action.
        feedback: u8,
        /// Code of the last action, or [`NO_ACTION`].
        action: u8,
        /// 1 when the episode is over: no answer is awaited.
        last: u8,
        /// With `last`, if the memory learns from the episode: an [`EpisodeOutcome`] code.
        outcome: u8,
        /// Zero.
        reserved: [u8; 8],
        /// With `last`, if the memory learns from the episode: the number under which items can name its steps.
        demonstration: u32,
        /// With `last`: entries of `sub_goals` in use; [`NOT_MEASURED`] if the memory is not told.
        sub_goals_len: u32,
        /// The steps at which sub-goals were completed.
        sub_goals: [u16; MAX_SUB_GOALS],
        /// The embedding of the view, of length 1.
        embedding: [f32; MAX_EMBEDDING],
    }

    /// An external memory to memory: it has built itself from a bank, or cannot. Answers each new bank once.
    ExternalBuilt, "memtransfer.ExternalBuilt", "external-built", 32 bytes,
        [ExternalMemory] to [Memory], Lanes {
        /// The bank.
        bank: u64,
        /// Bytes of its store; 0 if it does not tell.
        store_bytes: u64,
        /// The note with the reason, if it failed; otherwise [`NO_DOCUMENT`].
        failure: DocumentId,
        /// Nanoseconds it took, by its own clock.
        took_ns: u64,
    }

    /// Memory to an external memory: save what the memory of a bank knows, or load it. Each is answered with an
    /// [`ExternalStored`]. Nothing else is asked of the memory until then.
    ExternalStore, "memtransfer.ExternalStore", "external-store", 1040 bytes,
        [Memory] to [ExternalMemory], Lanes {
        /// The bank.
        bank: u64,
        /// 0 to save, 1 to load.
        loads: u32,
        /// Bytes of `folder` in use.
        folder_len: u32,
        /// The folder to write into, which is empty, or to read from: an absolute path, UTF-8.
        folder: [u8; MAX_FOLDER],
    }

    /// An external memory to memory: it has saved or loaded what it knows, or cannot.
    ExternalStored, "memtransfer.ExternalStored", "external-stored", 24 bytes,
        [ExternalMemory] to [Memory], Lanes {
        /// The bank.
        bank: u64,
        /// Bytes of its store; 0 if it does not tell.
        store_bytes: u64,
        /// The note with the reason, if it failed; otherwise [`NO_DOCUMENT`].
        failure: DocumentId,
    }

    /// An external memory to memory: the answer to a query.
    ExternalAnswer, "memtransfer.ExternalAnswer", "external-answer", 544 bytes,
        [ExternalMemory] to [Memory], Lanes {
        /// The episode.
        episode: u64,
        /// When it received the query.
        received_ns: u64,
        /// When it sent this message.
        sent_ns: u64,
        /// Bytes of its store; 0 if it does not tell.
        store_bytes: u64,
        /// The note with the texts of the items, published before; otherwise [`NO_DOCUMENT`].
        note: DocumentId,
        /// The lane.
        lane: u32,
        /// The step it answers.
        step: u32,
        /// Entries of `items` in use.
        items_len: u32,
        /// Entries of `sources` in use.
        sources_len: u32,
        /// Tokens of its own requests to a model for this step; [`NOT_MEASURED`] if it reports none.
        tokens: u32,
        /// 1 if the memory failed: the note holds the reason, and there are no items.
        failed: u32,
        /// What it supplies, the most important first.
        items: [AnswerItem; MAX_ITEMS],
        /// Where texts and plans come from.
        sources: [AnswerSource; MAX_SOURCES],
    }

    /// All to orchestrator: progress, about once a second if it has changed. The orchestrator waits for memory as long
    /// as its `done` grows: without cached embeddings, an answer can take minutes.
    Heartbeat, "memtransfer.Heartbeat", "heartbeat", 40 bytes,
        [Sim Memory Policy ExternalMemory] to [Orchestrator], Few {
        /// Code of the sender's [`Role`].
        role: u32,
        /// Index of a world or an external memory; 0 for other roles.
        index: u32,
        /// Work done since the sender started: views rendered, images embedded, requests answered.
        done: u64,
        /// Work that waits: views to render, images to embed, requests to answer.
        waiting: u64,
        /// Frames that are resident (simulator), pinned by memories (memory) or in the store (policy).
        held: u64,
        /// Limit of `held`; 0 if there is none.
        room: u64,
    }

    /// Policy to orchestrator: the answer to a step. Counts that are not known are [`NOT_MEASURED`].
    Decision, "memtransfer.Decision", "decision", 272 bytes,
        [Policy] to [Orchestrator], Lanes {
        /// The episode.
        episode: u64,
        /// When observation and recall had both been received.
        received_ns: u64,
        /// When the policy was called.
        started_ns: u64,
        /// When the prompt was built; 0 without one.
        prompted_ns: u64,
        /// When the last request was sent to a model's server; 0 without one.
        sent_ns: u64,
        /// When the policy had decided.
        decided_ns: u64,
        /// The lane.
        lane: u32,
        /// The step it answers.
        step: u32,
        /// Tokens of the prompt.
        prompt_tokens: u32,
        /// Tokens of the completion.
        completion_tokens: u32,
        /// Tokens of the prompt that the server took from its cache.
        cached_tokens: u32,
        /// Tokens of the prompt's images.
        image_tokens: u32,
        /// Tokens of the prompt that are memory; an estimate.
        memory_tokens: u32,
        /// Tokens of the prompt that a server can reuse: the previous prompt of the episode began with them too. 0 for the
        /// first one; an estimate.
        reusable_tokens: u32,
        /// Images that the request held.
        images_asked: u32,
        /// Images that the policy used: fewer if its budget is smaller. At most `images_asked`.
        images: u32,
        /// Requests sent to a model's server for this decision, including failed ones.
        attempts: u32,
        /// An [`Outcome`](domain::Outcome) code.
        outcome: u8,
        /// Code of the action when the outcome is [`Acted`](domain::Outcome::Acted), otherwise [`NO_ACTION`].
        action: u8,
        /// 1 when the reply came from the response cache.
        replayed: u8,
        /// Code of [`Reasoning`](domain::Reasoning): whether the model reasoned before it answered.
        reasoning: u8,
        /// Bytes of `finish_reason` in use.
        finish_reason_len: u8,
        /// Bytes of `model` in use.
        model_len: u8,
        /// Why the model's reply ended, in the server's terms; UTF-8.
        finish_reason: [u8; 46],
        /// The model that the reply names; UTF-8.
        model: [u8; 128],
    }

    /// All to orchestrator, once, when ready.
    Handshake, "memtransfer.Handshake", "handshake", 512 bytes,
        [Sim Memory Policy ExternalMemory] to [Orchestrator], Few {
        /// [`WIRE_VERSION`] of the sender.
        wire_version: u32,
        /// Code of its [`Role`].
        role: u32,
        /// Its process id.
        pid: u32,
        /// Bytes of `facts` in use.
        facts_len: u32,
        /// Index of a world or an external memory; 0 for other roles.
        index: u32,
        /// A JSON object of strings for the manifest: adapter, frame path, encoder, policy, ...
        facts: [u8; 492],
    }

    /// All to orchestrator: an error, and what follows from it ([`ErrorReportKind`]).
    ErrorReport, "memtransfer.ErrorReport", "error-report", 512 bytes,
        [Sim Memory Policy ExternalMemory] to [Orchestrator], Few {
        /// For [`ErrorReportKind::Episode`] and [`ErrorReportKind::Overdue`]: the episode. Otherwise 0.
        episode: u64,
        /// Code of the sender's [`Role`].
        role: u32,
        /// Reports of the sender so far, this one included.
        count: u32,
        /// Code of the [`ErrorReportKind`].
        kind: u32,
        /// The lane of `episode`. Otherwise 0.
        lane: u32,
        /// Bytes of `text` in use.
        text_len: u32,
        /// Index of a world or an external memory; 0 for other roles.
        index: u32,
        /// What is wrong, the value, and what was expected; UTF-8.
        text: [u8; 480],
    }

    /// All to orchestrator, once, after [`Stop`]: totals of the process. One that the user started also sends it when it is
    /// interrupted: it leaves, and the run waits until it attaches again.
    ShutdownReport, "memtransfer.ShutdownReport", "shutdown-report", 48 bytes,
        [Sim Memory Policy ExternalMemory] to [Orchestrator], Few {
        /// Code of the sender's [`Role`].
        role: u32,
        /// Index of a world or an external memory; 0 for other roles.
        index: u32,
        /// Frames rendered into the store (simulator only).
        frames_rendered: u64,
        /// Frames evicted from the store (simulator only).
        frames_evicted: u64,
        /// Frames received (memory and policy).
        frames_received: u64,
        /// Bytes of pixels that the sender copied for another process.
        pixel_bytes_copied: u64,
        /// Reports that the sender made.
        error_reports: u64,
    }

    /// Orchestrator to all: send a [`ShutdownReport`] and exit.
    Stop, "memtransfer.Stop", "stop", 8 bytes,
        [Orchestrator] to [Sim Memory Policy ExternalMemory], Few {
        /// Zero.
        reserved: u64,
    }
} };
}

message_table!(declare_messages);

pub(crate) use message_table;

#[cfg(test)]
mod tests;
