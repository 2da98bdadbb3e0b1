//! The neighbours of one process of a run, its *subject*: this process plays the other roles over the real bus.

use std::ops::Deref;
use std::time::Duration;

use bytemuck::Zeroable;
use shm_types::message::{
    Decision, ErrorReport, Eviction, ExternalAnswer, ExternalBuilt, ExternalEpisode, ExternalQuery,
    ExternalStore, ExternalStored, FrameId, Observation, Role, ShutdownReport, StepReport, Stop,
    View,
};
use shm_types::{
    Attach, BankPublisher, Bus, BusError, DocumentPublisher, FrameError, FramePublisher,
    FrameStore, HandshakeReceiver, NoteReceiver, Notifier, PortedMessage, Receiver, Sender,
};

/// The longest time that [`Neighbours::wait`] waits.
pub const TICK: Duration = Duration::from_millis(2);

/// The other roles of a run whose only participant is the subject.
#[derive(Debug)]
pub struct Neighbours {
    /// Handshakes of the subject.
    pub handshakes: HandshakeReceiver,
    /// Error reports of the subject.
    pub error_reports: Receiver<ErrorReport>,
    /// Shutdown reports of the subject.
    pub shutdown_reports: Receiver<ShutdownReport>,
    subject: Notifier,
    orchestrator: Bus,
    others: Vec<Bus>,
}

impl Neighbours {
    /// Joins the run of `attach`, whose only participant has to be `subject`; if it is an external memory, the only one.
    ///
    /// # Errors
    /// When the run cannot be joined.
    pub fn join(attach: &Attach, subject: Role) -> Result<Self, BusError> {
        let bus = |role| Bus::join(attach.clone(), role);
        let orchestrator = bus(Role::Orchestrator)?;
        let others = Role::CHILDREN.into_iter().filter(|role| *role != subject);
        Ok(Self {
            handshakes: orchestrator.handshake_receiver()?,
            error_reports: orchestrator.receiver()?,
            shutdown_reports: orchestrator.receiver()?,
            subject: match attach.external_memories.first() {
                Some(&index) => orchestrator.notifier_of(Role::ExternalMemory, index)?,
                None => orchestrator.notifier(subject)?,
            },
            others: others.map(bus).collect::<Result<_, _>>()?,
            orchestrator,
        })
    }

    /// The run's settings.
    pub fn attach(&self) -> &Attach {
        self.orchestrator.attach()
    }

    /// The bus of the first of `roles` that is played here; the orchestrator's if there is none.
    pub fn bus(&self, roles: &[Role]) -> &Bus {
        let is_wanted = |bus: &&Bus| roles.contains(&bus.role());
        self.others.iter().find(is_wanted).unwrap_or(&self.orchestrator)
    }

    /// The sender of `M`, as the role that sends it.
    ///
    /// # Errors
    /// When only the subject sends `M`, or the service cannot be opened.
    pub fn sender<M: PortedMessage>(&self) -> Result<Sender<M>, BusError> {
        self.bus(M::FROM).sender()
    }

    /// A receiver of `M`, as a role that receives it.
    ///
    /// # Errors
    /// When only the subject receives `M`, or the service cannot be opened.
    pub fn receiver<M: PortedMessage>(&self) -> Result<Receiver<M>, BusError> {
        self.bus(M::TO).receiver()
    }

    /// Sends a message as the role that sends it. Does not notify.
    ///
    /// # Errors
    /// When it cannot be delivered.
    pub fn send<M: PortedMessage>(&self, message: &M) -> Result<(), BusError> {
        self.sender()?.send(message)
    }

    /// Sends an observation. Does not notify.
    ///
    /// # Errors
    /// When it cannot be delivered.
    pub fn observe(&self, observation: &Observation) -> Result<(), BusError> {
        self.send(observation)
    }

    /// Evicts a frame.
    ///
    /// # Errors
    /// When the message cannot be delivered.
    pub fn evict(&self, frame: FrameId) -> Result<(), BusError> {
        self.send(&Eviction { frame })
    }

    /// Asks the subject to stop.
    ///
    /// # Errors
    /// When the message cannot be delivered.
    pub fn stop(&self) -> Result<(), BusError> {
        self.send(&Stop::zeroed())?;
        self.notify()
    }

    /// Wakes the subject.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn notify(&self) -> Result<(), BusError> {
        self.subject.notify()
    }

    /// Waits for a notification of the orchestrator, for [`TICK`] at most: not every message comes with one.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn wait(&self) -> Result<bool, BusError> {
        self.orchestrator.listener().wait(TICK)
    }
}

/// The neighbours of a policy.
#[derive(Debug)]
pub struct PolicyNeighbours {
    /// Decisions of the policy.
    pub decisions: Receiver<Decision>,
    /// Publishes the documents of memory.
    pub documents: DocumentPublisher,
    /// Publishes frames to it.
    pub frames: FramePublisher,
    neighbours: Neighbours,
}

impl Deref for PolicyNeighbours {
    type Target = Neighbours;

    fn deref(&self) -> &Neighbours {
        &self.neighbours
    }
}

impl PolicyNeighbours {
    /// Joins the run of `attach`, whose only participant has to be the policy.
    ///
    /// # Errors
    /// When the run cannot be joined.
    pub fn join(attach: &Attach) -> Result<Self, BusError> {
        let neighbours = Neighbours::join(attach, Role::Policy)?;
        Ok(Self {
            decisions: neighbours.receiver()?,
            documents: DocumentPublisher::new(neighbours.bus(&[Role::Memory]))?,
            frames: FramePublisher::new(neighbours.bus(&[Role::Sim]))?,
            neighbours,
        })
    }

    /// Publishes a frame that `fill` writes.
    ///
    /// # Errors
    /// When no frame is free, or it cannot be delivered.
    pub fn publish(
        &mut self,
        content_hash: [u8; 16],
        fill: impl FnOnce(&mut [u8]),
    ) -> Result<FrameId, FrameError> {
        let mut slot = self.frames.loan()?;
        fill(slot.pixels_mut());
        self.frames.publish(slot, content_hash)
    }
}

/// The neighbours of an external memory.
#[derive(Debug)]
pub struct ExternalMemoryNeighbours {
    /// What it has built.
    pub built: Receiver<ExternalBuilt>,
    /// Its answers.
    pub answers: Receiver<ExternalAnswer>,
    /// Its notes.
    pub notes: NoteReceiver,
    /// Publishes its banks.
    pub banks: BankPublisher,
    /// Sends the episodes that it remembers for.
    pub episodes: Sender<ExternalEpisode>,
    /// Sends its queries.
    pub queries: Sender<ExternalQuery>,
    /// Asks it to save or load.
    pub stores: Sender<ExternalStore>,
    /// What it has saved or loaded.
    pub stored: Receiver<ExternalStored>,
    /// Publishes frames to it.
    pub frames: FramePublisher,
    neighbours: Neighbours,
}

impl Deref for ExternalMemoryNeighbours {
    type Target = Neighbours;

    fn deref(&self) -> &Neighbours {
        &self.neighbours
    }
}

impl ExternalMemoryNeighbours {
    /// Joins the run of `attach`, whose only participant has to be one external memory.
    ///
    /// # Errors
    /// When the run cannot be joined.
    pub fn join(attach: &Attach) -> Result<Self, BusError> {
        let index = attach.external_memories.first().copied().unwrap_or_default();
        let neighbours = Neighbours::join(attach, Role::ExternalMemory)?;
        let memory = neighbours.bus(&[Role::Memory]);
        Ok(Self {
            built: memory.receiver_from(index)?,
            answers: memory.receiver_from(index)?,
            notes: NoteReceiver::new(memory, index)?,
            banks: BankPublisher::new(memory, index)?,
            episodes: memory.sender_to(index)?,
            queries: memory.sender_to(index)?,
            stores: memory.sender_to(index)?,
            stored: memory.receiver_from(index)?,
            frames: FramePublisher::new(neighbours.bus(&[Role::Sim]))?,
            neighbours,
        })
    }
}

/// The neighbours of a world.
#[derive(Debug)]
pub struct WorldNeighbours {
    /// What memory and policy see.
    pub observations: Receiver<Observation>,
    /// What the orchestrator is told.
    pub reports: Receiver<StepReport>,
    /// The facts of episodes.
    pub facts: NoteReceiver,
    /// Views that memory has asked for.
    pub views: Receiver<View>,
    /// The frames that the world publishes.
    pub frames: FrameStore,
    neighbours: Neighbours,
}

impl Deref for WorldNeighbours {
    type Target = Neighbours;

    fn deref(&self) -> &Neighbours {
        &self.neighbours
    }
}

impl WorldNeighbours {
    /// Joins the run of `attach`, whose only participant has to be the world.
    ///
    /// # Errors
    /// When the run cannot be joined.
    pub fn join(attach: &Attach) -> Result<Self, BusError> {
        let neighbours = Neighbours::join(attach, Role::Sim)?;
        let memory = neighbours.bus(&[Role::Memory]);
        Ok(Self {
            observations: memory.receiver()?,
            reports: neighbours.bus(&[Role::Orchestrator]).receiver()?,
            facts: NoteReceiver::of_facts(neighbours.bus(&[Role::Orchestrator]))?,
            views: memory.receiver()?,
            frames: FrameStore::new(memory)?,
            neighbours,
        })
    }
}
