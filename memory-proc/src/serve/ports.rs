//! The queues of the memory process: to and from its neighbours, and to and from each external memory.

use shm_types::message::{
    ExternalAnswer, ExternalBuilt, ExternalEpisode, ExternalQuery, ExternalStore, ExternalStored,
    MemoryEpisodeConfig, Observation, Recall, RecallTrace, Role, SnapshotReport, StepReport, Stop,
    View, ViewRequest,
};
use shm_types::{
    BankPublisher, Bus, BusError, FrameStore, Heartbeats, NoteReceiver, Notifier, Receiver, Sender,
};

use crate::external::ToExternal;

/// Senders, receivers and notifiers of this process.
pub(super) struct Ports {
    pub(super) configs: Receiver<MemoryEpisodeConfig>,
    pub(super) observations: Receiver<Observation>,
    pub(super) reports: Receiver<StepReport>,
    pub(super) views: Receiver<View>,
    pub(super) stops: Receiver<Stop>,
    pub(super) frames: FrameStore,
    pub(super) recalls: Sender<Recall>,
    pub(super) traces: Sender<RecallTrace>,
    pub(super) snapshots: Sender<SnapshotReport>,
    pub(super) worlds: Vec<WorldPorts>,
    pub(super) heartbeats: Heartbeats,
    pub(super) policy: Notifier,
    pub(super) orchestrator: Notifier,
    pub(super) externals: Vec<ExternalPorts>,
}

/// Sender and notifier for one world.
pub(super) struct WorldPorts {
    pub(super) requests: Sender<ViewRequest>,
    pub(super) notifier: Notifier,
    /// Whether it has requests that it was not notified of.
    pub(super) is_due: bool,
}

impl WorldPorts {
    fn new(bus: &Bus, index: u8) -> Result<Self, BusError> {
        let (requests, notifier) = (bus.sender_to(index)?, bus.notifier_of(Role::Sim, index)?);
        Ok(Self { requests, notifier, is_due: false })
    }
}

/// Senders, receivers and notifier for one external memory.
pub(super) struct ExternalPorts {
    pub(super) index: u8,
    banks: BankPublisher,
    episodes: Sender<ExternalEpisode>,
    queries: Sender<ExternalQuery>,
    stores: Sender<ExternalStore>,
    pub(super) built: Receiver<ExternalBuilt>,
    pub(super) stored: Receiver<ExternalStored>,
    pub(super) answers: Receiver<ExternalAnswer>,
    pub(super) notes: NoteReceiver,
    pub(super) notifier: Notifier,
    /// Messages that could not be used.
    pub(super) unusable: u64,
}

impl ExternalPorts {
    fn new(bus: &Bus, index: u8) -> Result<Self, BusError> {
        Ok(Self {
            index,
            banks: BankPublisher::new(bus, index)?,
            episodes: bus.sender_to(index)?,
            queries: bus.sender_to(index)?,
            stores: bus.sender_to(index)?,
            built: bus.receiver_from(index)?,
            stored: bus.receiver_from(index)?,
            answers: bus.receiver_from(index)?,
            notes: NoteReceiver::new(bus, index)?,
            notifier: bus.notifier_of(Role::ExternalMemory, index)?,
            unusable: 0,
        })
    }

    /// Sends a message.
    pub(super) fn send(&mut self, message: &ToExternal) -> Result<(), BusError> {
        match message {
            ToExternal::Bank(id, content) => self.banks.publish(*id, content),
            ToExternal::TakeBack(id) => self.banks.take_back(*id),
            ToExternal::Episode(message) => self.episodes.send(message),
            ToExternal::Query(message) => self.queries.send(message),
            ToExternal::Store(message) => self.stores.send(message),
        }
    }
}

impl Ports {
    pub(super) fn new(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self {
            configs: bus.receiver()?,
            observations: bus.receiver()?,
            reports: bus.receiver()?,
            views: bus.receiver()?,
            stops: bus.receiver()?,
            frames: FrameStore::new(bus)?,
            recalls: bus.sender()?,
            traces: bus.sender()?,
            snapshots: bus.sender()?,
            worlds: {
                let indices = 0..bus.attach().worlds;
                indices.map(|index| WorldPorts::new(bus, index)).collect::<Result<_, _>>()?
            },
            heartbeats: Heartbeats::new(bus)?,
            policy: bus.notifier(Role::Policy)?,
            orchestrator: bus.notifier(Role::Orchestrator)?,
            externals: {
                let indices = bus.attach().external_memories.iter();
                indices.map(|&index| ExternalPorts::new(bus, index)).collect::<Result<_, _>>()?
            },
        })
    }
}
