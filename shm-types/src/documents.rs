//! Documents: content that memory supplies and that is too long for a message. Published once, then named by id.
//!
//! Memory publishes a document before the first [`Recall`](crate::message::Recall) that names it. A document belongs to
//! the whole run (episode 0), or to one episode of one lane and is dropped with it. The policy copies its bytes once:
//! documents are texts and short lists. Pixels stay in the [frame store](crate::frames).

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::{BackpressureAction, LoanError};
use iceoryx2::prelude::{AllocationStrategy, ZeroCopySend};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use crate::attach::Attach;
use crate::bus::Bus;
use crate::layout::wire_struct;
use crate::message::{DocumentId, EpisodeId, NO_DOCUMENT, Role, TrajectoryStep, read_action};
use crate::transport::{BusError, Ipc, delivered, receiver};
use domain::{DocumentKind, UnknownCode};

/// Last part of the name of the service that carries documents.
pub const DOCUMENT_SERVICE: &str = "document";

/// Maximum length of a document, in bytes: far more than any prompt holds.
pub const MAX_DOCUMENT_BYTES: usize = 16 << 20;

/// Bytes of a document for which shared memory is reserved from the start.
const INITIAL_BYTES: usize = 16 << 10;

/// Documents of the whole run that can wait beside those of episodes.
const RUN_DOCUMENTS: usize = 64;

/// Bits of a document id below the generation.
const ID_BITS: u32 = 40;

wire_struct! {
    /// The header of a document.
    DocumentHeader: Eq Default, "memtransfer.DocumentHeader", 24 bytes {
        /// The document's id.
        id: DocumentId,
        /// The episode it belongs to; 0: for the whole run.
        episode: u64,
        /// The lane of that episode.
        lane: u32,
        /// Code of the [`DocumentKind`].
        kind: u32,
    }
}

/// The content of a document.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Content {
    /// Object locations, landmarks and routes.
    Summary(String),
    /// General spatial and navigation knowledge.
    Semantic(String),
    /// Demonstrations with their keyframes, one after the other.
    Trajectories(Vec<TrajectoryStep>),
    /// Text of an external memory.
    Note(String),
}

impl Content {
    /// The kind of document.
    pub const fn kind(&self) -> DocumentKind {
        match self {
            Self::Summary(_) => DocumentKind::Summary,
            Self::Semantic(_) => DocumentKind::Semantic,
            Self::Trajectories(_) => DocumentKind::Trajectories,
            Self::Note(_) => DocumentKind::Note,
        }
    }

    /// The text; `None` for demonstrations.
    pub fn text(&self) -> Option<&str> {
        match self {
            Self::Summary(text) | Self::Semantic(text) | Self::Note(text) => Some(text),
            Self::Trajectories(_) => None,
        }
    }

    pub(crate) fn bytes(&self) -> &[u8] {
        match self {
            Self::Summary(text) | Self::Semantic(text) | Self::Note(text) => text.as_bytes(),
            Self::Trajectories(steps) => bytemuck::cast_slice(steps),
        }
    }

    pub(crate) fn read(kind: DocumentKind, bytes: &[u8]) -> Result<Self, UnknownCode> {
        let text = || match std::str::from_utf8(bytes) {
            Ok(text) => Ok(text.to_owned()),
            Err(error) => Err(UnknownCode::new(error, "UTF-8")),
        };
        Ok(match kind {
            DocumentKind::Summary => Self::Summary(text()?),
            DocumentKind::Semantic => Self::Semantic(text()?),
            DocumentKind::Note => Self::Note(text()?),
            DocumentKind::Trajectories => {
                let (steps, []) = bytes.as_chunks::<{ size_of::<TrajectoryStep>() }>() else {
                    let count = format_args!("{} bytes", bytes.len());
                    return Err(UnknownCode::new(count, "whole trajectory steps of 16 bytes"));
                };
                let steps = steps.iter().map(|step| bytemuck::pod_read_unaligned(step));
                let known = |step: &TrajectoryStep| read_action(step.action).map(|_| *step);
                let steps = steps.map(|step| known(&step)).collect::<Result<Vec<_>, _>>()?;
                if !steps.is_sorted_by_key(|step| step.trajectory) {
                    return Err(UnknownCode::new(
                        "a mixture of trajectories",
                        "one after the other",
                    ));
                }
                Self::Trajectories(steps)
            }
        })
    }
}

/// A received document.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Document {
    /// Its id.
    pub id: DocumentId,
    /// The episode it belongs to; 0: for the whole run.
    pub episode: u64,
    /// The lane of that episode.
    pub lane: u32,
    /// Its content.
    pub content: Content,
}

/// Why a document cannot be published or used.
#[derive(Debug, thiserror::Error)]
pub enum DocumentError {
    /// It is too long.
    #[error("a document has {bytes} bytes, and at most {MAX_DOCUMENT_BYTES} can be supplied")]
    TooLong {
        /// Its bytes.
        bytes: usize,
    },
    /// A received document is invalid; it is dropped, and the next call continues after it.
    #[error("document {id}: {problem}")]
    Unusable {
        /// Its id.
        id: DocumentId,
        /// The problem.
        problem: UnknownCode,
    },
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
}

/// Documents that can wait for the policy: the queue length that both processes must agree on.
pub const fn queue_len(attach: &Attach) -> usize {
    4 * attach.lanes as usize + RUN_DOCUMENTS
}

fn service(bus: &Bus) -> Result<PortFactory<Ipc, [u8], DocumentHeader>, BusError> {
    bus.builder(DOCUMENT_SERVICE)?
        .publish_subscribe::<[u8]>()
        .user_header::<DocumentHeader>()
        .enable_safe_overflow(false)
        .history_size(0)
        .max_publishers(1)
        .max_subscribers(1)
        .max_nodes(2)
        .subscriber_max_borrowed_samples(1)
        .subscriber_max_buffer_size(queue_len(bus.attach()))
        .open_or_create()
        .map_err(|e| BusError::open("cannot open the service of documents", e))
}

/// Publishes documents; for memory.
#[derive(Debug)]
pub struct DocumentPublisher {
    publisher: Publisher<Ipc, [u8], DocumentHeader>,
    generation: u32,
    published: u64,
    readers: usize,
}

impl DocumentPublisher {
    /// A publisher.
    ///
    /// # Errors
    /// When this process is not the memory, or the service cannot be opened.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        bus.allowed(&[Role::Memory], DOCUMENT_SERVICE, "send")?;
        let attach = bus.attach();
        let publisher = service(bus)?
            .publisher_builder()
            .initial_max_slice_len(INITIAL_BYTES)
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .max_loaned_samples(1)
            .set_backpressure_handler(|_| BackpressureAction::DiscardDataAndFail)
            .create()
            .map_err(|e| BusError::open("cannot publish documents", e))?;
        let readers = attach.count(&[Role::Policy]);
        Ok(Self { publisher, generation: attach.generation, published: 0, readers })
    }

    /// Publishes a document for an episode (lane and id) or for the whole run, and returns its id.
    ///
    /// # Errors
    /// When it is too long, or the policy does not receive it.
    pub fn publish(
        &mut self,
        episode: Option<(u32, u64)>,
        content: &Content,
    ) -> Result<DocumentId, DocumentError> {
        let bytes = content.bytes();
        if bytes.len() > MAX_DOCUMENT_BYTES {
            return Err(DocumentError::TooLong { bytes: bytes.len() });
        }
        let sample = self.publisher.loan_slice_uninit(bytes.len()).map_err(|e: LoanError| {
            DocumentError::from(BusError::transport("loaning a document", e))
        })?;
        let mut sample = sample.write_from_slice(bytes);
        self.published += 1;
        let id = (u64::from(self.generation) << ID_BITS) | self.published;
        let (lane, episode) = episode.unwrap_or((0, 0));
        *sample.user_header_mut() =
            DocumentHeader { id, episode, lane, kind: content.kind() as u32 };
        delivered(DOCUMENT_SERVICE, self.readers, sample.send())?;
        Ok(id)
    }
}

/// The documents that the policy has received and that messages can still name.
#[derive(Debug)]
pub struct DocumentStore {
    subscriber: Subscriber<Ipc, [u8], DocumentHeader>,
    documents: HashMap<DocumentId, Arc<Document>>,
    /// The episode of each lane.
    running: HashMap<u32, EpisodeId>,
    /// Episodes that are over. A document of one can still arrive.
    ended: HashSet<EpisodeId>,
}

impl DocumentStore {
    /// Creates an empty store, which receives every document published from now on.
    ///
    /// # Errors
    /// When this process is not the policy, or the service cannot be opened.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        bus.allowed(&[Role::Policy], DOCUMENT_SERVICE, "receive")?;
        let subscriber = receiver(&service(bus)?, "cannot receive documents")?;
        let (documents, running, ended) = (HashMap::new(), HashMap::new(), HashSet::new());
        Ok(Self { subscriber, documents, running, ended })
    }

    /// The document that `id` names, if there is one.
    ///
    /// # Errors
    /// When a received document is invalid; it is dropped, and the next call continues after it.
    pub fn get(&mut self, id: DocumentId) -> Result<Option<&Arc<Document>>, DocumentError> {
        if !self.documents.contains_key(&id) {
            self.take_waiting()?;
        }
        Ok(self.documents.get(&id))
    }

    /// Episode `episode` begins in `lane`: drops the documents of the lane's earlier one. Those of a later one may have arrived
    /// early.
    pub fn begin(&mut self, lane: u32, episode: EpisodeId) {
        if let Some(ended) = self.running.insert(lane, episode) {
            self.ended.insert(ended);
            self.documents.retain(|_, document| document.episode != ended);
        }
    }

    /// Number of documents in the store.
    #[expect(clippy::len_without_is_empty, reason = "emptiness is not asked for")]
    pub fn len(&self) -> usize {
        self.documents.len()
    }

    fn take_waiting(&mut self) -> Result<(), DocumentError> {
        let failed = |e| BusError::transport("receiving documents", e);
        while let Some(sample) = self.subscriber.receive().map_err(failed)? {
            let DocumentHeader { id, episode, lane, kind } = *sample.user_header();
            if self.ended.contains(&episode) {
                continue;
            }
            let unusable = |problem| DocumentError::Unusable { id, problem };
            let kind = u8::try_from(kind).unwrap_or(u8::MAX);
            let kind = DocumentKind::try_from(kind).map_err(unusable)?;
            let content = Content::read(kind, sample.payload()).map_err(unusable)?;
            if id == NO_DOCUMENT || self.documents.contains_key(&id) {
                return Err(unusable(UnknownCode::new(id, "an id that names no other document")));
            }
            self.documents.insert(id, Arc::new(Document { id, episode, lane, content }));
        }
        Ok(())
    }
}
