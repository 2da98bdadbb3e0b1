//! Notes: texts of any length that belong to one message, published before the message that names them: those of an
//! external memory's answers, and the facts of an episode that has ended.
//!
//! The host copies what an answer supplies into [documents](crate::documents) and keeps no note after its answer.

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::{BackpressureAction, LoanError};
use iceoryx2::prelude::{AllocationStrategy, ZeroCopySend};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use crate::bus::Bus;
use crate::documents::MAX_DOCUMENT_BYTES;
use crate::layout::wire_struct;
use crate::message::{DocumentId, Role, Traffic};
use crate::transport::{BusError, Ipc, delivered, receiver};

/// First part of the name of the service that carries an external memory's notes; its index follows.
pub const NOTE_SERVICE: &str = "note";

/// Name of the service that carries the simulator's notes: the facts of episodes, each a JSON object.
pub const FACTS_SERVICE: &str = "episode-facts";

/// A note is longer than a document can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "the texts of an answer have {bytes} bytes together, and at most {MAX_DOCUMENT_BYTES} can be sent"
)]
pub struct NoteTooLong {
    /// Its bytes.
    pub bytes: usize,
}

/// Bits of a note's id below the index of its sender.
const INDEX_SHIFT: u32 = 56;

/// Bytes of a note for which shared memory is reserved from the start.
const INITIAL_BYTES: usize = 4 << 10;

wire_struct! {
    /// The header of a note.
    NoteHeader: Eq Default, "memtransfer.NoteHeader", 24 bytes {
        /// The note's id, which its sender never uses twice; not [`NO_DOCUMENT`](crate::message::NO_DOCUMENT).
        id: DocumentId,
        /// The episode; 0 for the failure to build a bank.
        episode: u64,
        /// The lane.
        lane: u32,
        /// Zero.
        reserved: u32,
    }
}

fn service(bus: &Bus, name: &str) -> Result<PortFactory<Ipc, [u8], NoteHeader>, BusError> {
    let publishers = if name == FACTS_SERVICE { bus.attach().worlds.into() } else { 1 };
    bus.builder(name)?
        .publish_subscribe::<[u8]>()
        .user_header::<NoteHeader>()
        .enable_safe_overflow(false)
        .history_size(0)
        .max_publishers(publishers)
        .max_subscribers(1)
        .max_nodes(publishers + 1)
        .subscriber_max_borrowed_samples(1)
        .subscriber_max_buffer_size(bus.attach().queue_len(Traffic::Lanes))
        .open_or_create()
        .map_err(|e| BusError::open("cannot open the service of notes", e))
}

/// Publishes notes.
#[derive(Debug)]
pub struct NotePublisher {
    publisher: Publisher<Ipc, [u8], NoteHeader>,
    /// The id of the last note. It begins with the sender's index, so that no other world uses it.
    last_id: DocumentId,
}

impl NotePublisher {
    /// The publisher of an external memory.
    ///
    /// # Errors
    /// When this process is not an external memory, or the service cannot be opened.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        bus.allowed(&[Role::ExternalMemory], NOTE_SERVICE, "send")?;
        Self::open(bus, &format!("{NOTE_SERVICE}-{}", bus.index()))
    }

    /// The publisher of the facts of episodes.
    ///
    /// # Errors
    /// When this process is not the simulator, or the service cannot be opened.
    pub fn of_facts(bus: &Bus) -> Result<Self, BusError> {
        bus.allowed(&[Role::Sim], FACTS_SERVICE, "send")?;
        Self::open(bus, FACTS_SERVICE)
    }

    fn open(bus: &Bus, name: &str) -> Result<Self, BusError> {
        let publisher = service(bus, name)?
            .publisher_builder()
            .initial_max_slice_len(INITIAL_BYTES)
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .max_loaned_samples(1)
            .set_backpressure_handler(|_| BackpressureAction::DiscardDataAndFail)
            .create()
            .map_err(|e| BusError::open("cannot publish notes", e))?;
        Ok(Self { publisher, last_id: DocumentId::from(bus.index()) << INDEX_SHIFT })
    }

    /// Publishes the bytes of a note for a message, and returns its id.
    ///
    /// # Errors
    /// When it is longer than [`MAX_DOCUMENT_BYTES`], or it is not received.
    pub fn publish(
        &mut self,
        lane: u32,
        episode: u64,
        bytes: &[u8],
    ) -> Result<DocumentId, BusError> {
        if bytes.len() > MAX_DOCUMENT_BYTES {
            let too_long = NoteTooLong { bytes: bytes.len() };
            return Err(BusError::transport("publishing a note", too_long));
        }
        self.publish_of_any_length(lane, episode, bytes)
    }

    /// As [`Self::publish`], without the check of the length: for programs that test what the host makes of it.
    ///
    /// # Errors
    /// When it is not received.
    pub fn publish_of_any_length(
        &mut self,
        lane: u32,
        episode: u64,
        bytes: &[u8],
    ) -> Result<DocumentId, BusError> {
        let loaned = self.publisher.loan_slice_uninit(bytes.len());
        let failed = |e: LoanError| BusError::transport("loaning a note", e);
        let mut sample = loaned.map_err(failed)?.write_from_slice(bytes);
        self.last_id += 1;
        let id = self.last_id;
        *sample.user_header_mut() = NoteHeader { id, episode, lane, reserved: 0 };
        delivered(NOTE_SERVICE, 1, sample.send())?;
        Ok(id)
    }
}

/// A received note.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// Its id, episode and lane.
    pub header: NoteHeader,
    /// Its bytes, unless there are too many.
    pub bytes: Result<Vec<u8>, NoteTooLong>,
}

/// Receives the notes of one process.
#[derive(Debug)]
pub struct NoteReceiver {
    subscriber: Subscriber<Ipc, [u8], NoteHeader>,
    most: usize,
}

impl NoteReceiver {
    /// A receiver of every note that the external memory with this index publishes from now on.
    ///
    /// # Errors
    /// When this process is not the memory, or the service cannot be opened.
    pub fn new(bus: &Bus, index: u8) -> Result<Self, BusError> {
        bus.allowed(&[Role::Memory], NOTE_SERVICE, "receive")?;
        Self::open(bus, &format!("{NOTE_SERVICE}-{index}"))
    }

    /// A receiver of the facts of all episodes that end from now on.
    ///
    /// # Errors
    /// When this process is not the orchestrator, or the service cannot be opened.
    pub fn of_facts(bus: &Bus) -> Result<Self, BusError> {
        bus.allowed(&[Role::Orchestrator], FACTS_SERVICE, "receive")?;
        Self::open(bus, FACTS_SERVICE)
    }

    fn open(bus: &Bus, name: &str) -> Result<Self, BusError> {
        let subscriber = receiver(&service(bus, name)?, "cannot receive notes")?;
        Ok(Self { subscriber, most: bus.attach().queue_len(Traffic::Lanes) })
    }

    /// The waiting notes, in order; at most as many as the queue holds. The bytes of one that is too long are not copied.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn drain(&mut self) -> Result<Vec<Note>, BusError> {
        let mut notes = Vec::new();
        while notes.len() < self.most {
            let sample = self.subscriber.receive();
            let sample = sample.map_err(|e| BusError::transport("receiving notes", e))?;
            let Some(sample) = sample else { break };
            let bytes = match sample.payload() {
                bytes if bytes.len() <= MAX_DOCUMENT_BYTES => Ok(bytes.to_vec()),
                bytes => Err(NoteTooLong { bytes: bytes.len() }),
            };
            notes.push(Note { header: *sample.user_header(), bytes });
        }
        Ok(notes)
    }
}
