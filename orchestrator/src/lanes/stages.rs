//! Where the time of a step went, by what its messages say.

use shm_types::message::{Decision, Observation, RecallTrace};

use crate::log::Stages;

/// What the simulator's part of a step took.
pub(super) fn observed(observation: &Observation) -> Stages {
    let Observation { commanded_ns, woken_ns, stepped_ns, rendered_ns, .. } = *observation;
    Stages {
        command: woken_ns.saturating_sub(commanded_ns),
        dynamics: stepped_ns.saturating_sub(woken_ns),
        render: rendered_ns.saturating_sub(stepped_ns),
        ..Stages::default()
    }
}

/// What the memory's part of a step took.
pub(super) fn recalled(trace: &RecallTrace, rendered_ns: u64) -> Stages {
    let RecallTrace { received_ns, embedded_ns, searched_ns, .. } = *trace;
    Stages {
        observation: received_ns.saturating_sub(rendered_ns),
        embed: embedded_ns.saturating_sub(received_ns),
        search: searched_ns.saturating_sub(embedded_ns),
        ..Stages::default()
    }
}

/// What the policy's part of a step took.
pub(super) fn decided(decision: &Decision, trace: &RecallTrace) -> Stages {
    let Decision { received_ns, started_ns, decided_ns, .. } = *decision;
    Stages {
        recall: received_ns.saturating_sub(trace.searched_ns),
        queue: started_ns.saturating_sub(received_ns),
        decide: decided_ns.saturating_sub(started_ns),
        ..Stages::default()
    }
}
