//! Valid messages. A test changes the fields that it is about.

use bytemuck::Zeroable;
use domain::{Action, Feedback, Heading, Outcome, Pose};
use shm_types::message::{
    Decision, DocumentId, FrameId, NO_ACTION, NO_FRAME, NOT_MEASURED, Observation,
    PolicyEpisodeConfig, Recall, RecallTrace, RequestId, SegmentStep, StepCommand, StepKind,
    WirePose, write_text,
};
use shm_types::process::monotonic_ns;

/// The config of an episode with a window of six steps; its seed is the number of its lane.
pub fn config(lane: u32, episode: u64, instruction: &str) -> PolicyEpisodeConfig {
    let seed = lane.into();
    let mut config =
        PolicyEpisodeConfig { lane, episode, seed, repeat: 1, window: 6, ..Zeroable::zeroed() };
    config.instruction_len = write_text(&mut config.instruction, instruction);
    config
}

/// The command that begins an episode at `start`.
pub fn reset(lane: u32, episode: u64, variant: u32, start: Pose) -> StepCommand {
    let (kind, start) = (StepKind::Reset as u8, start.into());
    StepCommand { lane, episode, variant, start, kind, action: NO_ACTION, ..Zeroable::zeroed() }
}

/// The command to act.
pub fn act(id: RequestId, action: Action) -> StepCommand {
    let RequestId { lane, episode, step } = id;
    let (kind, action) = (StepKind::Act as u8, action as u8);
    StepCommand { lane, episode, step, kind, action, sent_ns: 1, ..Zeroable::zeroed() }
}

/// The observation of a step, after a move forward.
pub fn observation(id: RequestId, frame: FrameId) -> Observation {
    let RequestId { lane, episode, step } = id;
    let (feedback, action) = match step {
        0 => (Feedback::Start, NO_ACTION),
        _ => (Feedback::Moved, Action::Forward as u8),
    };
    let now = monotonic_ns();
    Observation {
        lane,
        episode,
        step,
        frame,
        pose: WirePose::from(Pose::new(3, 4, Heading::E)),
        feedback: feedback as u8,
        action,
        commanded_ns: now,
        woken_ns: now,
        stepped_ns: now,
        rendered_ns: now,
        sent_ns: now,
        ..Zeroable::zeroed()
    }
}

/// The last observation of an episode.
pub fn last(id: RequestId) -> Observation {
    Observation { last: 1, ..observation(id, NO_FRAME) }
}

/// A recall of a segment, whose last view has no action, and of documents. As many as fit are named.
pub fn recall(id: RequestId, segment: &[FrameId], documents: &[DocumentId]) -> Recall {
    let RequestId { lane, episode, step } = id;
    let now = monotonic_ns();
    let distance = if segment.is_empty() { f32::NAN } else { 0.125 };
    let mut recall = Recall {
        lane,
        episode,
        step,
        distance,
        received_ns: now,
        sent_ns: now,
        segment_len: segment.len() as u32,
        documents_len: documents.len() as u32,
        ..Zeroable::zeroed()
    };
    for (at, (view, &frame)) in recall.segment.iter_mut().zip(segment).enumerate() {
        let action = if at + 1 == segment.len() { NO_ACTION } else { Action::TurnLeft as u8 };
        *view = SegmentStep { frame, action, reserved: [0; 7] };
    }
    for (entry, &document) in recall.documents.iter_mut().zip(documents) {
        *entry = document;
    }
    recall
}

/// The trace of a recall without a retrieval.
pub fn recall_trace(id: RequestId) -> RecallTrace {
    let RequestId { lane, episode, step } = id;
    RecallTrace {
        lane,
        episode,
        step,
        case: NOT_MEASURED,
        distance: f32::NAN,
        ..Zeroable::zeroed()
    }
}

/// The decision to act, by a policy that saw one image and asked no model.
pub fn decision(id: RequestId, action: Action) -> Decision {
    let RequestId { lane, episode, step } = id;
    Decision {
        lane,
        episode,
        step,
        outcome: Outcome::Acted as u8,
        action: action as u8,
        images: 1,
        images_asked: 1,
        prompt_tokens: NOT_MEASURED,
        completion_tokens: NOT_MEASURED,
        cached_tokens: NOT_MEASURED,
        image_tokens: NOT_MEASURED,
        memory_tokens: NOT_MEASURED,
        ..Zeroable::zeroed()
    }
}
