//! The frame store: every view is written once into shared memory and held by all under its id.
//!
//! The simulator loans a [`FrameSlot`], lets the renderer write into it, and publishes it. Consumers keep
//! what they are given in a [`FrameStore`] and look frames up by the ids that messages carry. Nobody
//! copies pixels, and a published frame never changes: iceoryx2 gives its chunk to a new frame only after
//! the simulator evicted it and every consumer has let go.
//!
//! # Memory
//! The store owns [`frame_chunks`](crate::Attach::frame_chunks) chunks. They are reused last freed, first used, so a run
//! touches about as many as are alive at once. A chunk is free again when every consumer has applied the
//! eviction; the store has more chunks than may be resident so that the simulator need not wait for that,
//! and if a consumer falls far behind, [`FramePublisher::loan`] says so with [`FrameError::NoChunk`].
//!
//! # Order
//! A frame is published before any message that names it, and evicted after every message that does has
//! been answered. So a consumer that meets an unknown id finds the frame waiting in its queue.

use std::collections::hash_map::Entry;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::{BackpressureAction, LoanError};
use iceoryx2::prelude::{PayloadHeader, ZeroCopySend};
use iceoryx2::sample::Sample;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use rustc_hash::FxHashMap;

use crate::attach::{FrameSize, MAX_LOANED_FRAMES, PAGE_BYTES};
use crate::bus::{Bus, Receiver};
use crate::layout::{Field, Layout, Shaped, Struct, wire_struct};
use crate::message::{Eviction, FrameId, NO_FRAME, Role};
use crate::transport::{BusError, Ipc, delivered};

/// Last part of the name of the service that carries frames.
pub const FRAME_SERVICE: &str = "frame";

/// Who holds frames.
pub const FRAME_CONSUMERS: [Role; 2] = [Role::Memory, Role::Policy];

/// Bits of a frame id below the generation.
const ID_BITS: u32 = 40;

/// One page of a frame. The alignment is what a graphics device needs to write into it.
#[derive(Debug, Clone, Copy, Pod, Zeroable, ZeroCopySend)]
#[repr(C)]
#[repr(align(4096))]
#[type_name("memtransfer.Page")]
pub struct Page(pub [u8; PAGE_BYTES]);

wire_struct! {
    /// What travels with the pixels.
    FrameHeader: Eq Default, "memtransfer.FrameHeader", 32 bytes {
        /// The frame's id.
        id: FrameId,
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
        /// First 16 bytes of the BLAKE3 hash of the pixels.
        content_hash: [u8; 16],
    }
}

const _: () = assert!(size_of::<Page>() == PAGE_BYTES);

impl Layout for Page {
    const LAYOUT: Struct = Struct {
        name: "Page",
        type_name: "memtransfer.Page",
        doc: "One page of a frame: pixels, RGBA with 8 bits each, rows top to bottom without gaps.",
        bytes: PAGE_BYTES,
        align: align_of::<Self>(),
        fields: &[Field {
            name: "pixels",
            shape: <[u8; PAGE_BYTES]>::SHAPE,
            offset: 0,
            bytes: PAGE_BYTES,
            doc: "Its part of the pixels; what is left of a frame's last page means nothing.",
        }],
    };
}

/// Why a frame cannot be loaned, published or looked up.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// Every chunk is in use: consumers have not let go of enough evicted frames. Ring them, wait a
    /// little, and try again for a bounded time.
    #[error(
        "all {chunks} chunks of the frame store are in use: memory or policy does not let go of evicted \
         frames"
    )]
    NoChunk {
        /// How many there are.
        chunks: u32,
    },
    /// More slots at once than a renderer may fill.
    #[error("{MAX_LOANED_FRAMES} frames are being filled already: publish or drop one first")]
    TooManySlots,
    /// A frame arrived that is not what the run agreed on.
    #[error(
        "frame {id} is {width} x {height} in {pages} pages instead of {} x {} in {}",
        expected.width, expected.height, expected.pages()
    )]
    Shape {
        /// Its id.
        id: FrameId,
        /// The width it claims.
        width: u32,
        /// The height it claims.
        height: u32,
        /// Its pages.
        pages: u64,
        /// What the run agreed on.
        expected: FrameSize,
    },
    /// A frame arrived under an id that names none, or names another frame.
    #[error("a frame arrived under id {id}, which names {}", if *id == NO_FRAME { "none" } else { "another" })]
    Id {
        /// The id.
        id: FrameId,
    },
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
}

fn service(bus: &Bus) -> Result<PortFactory<Ipc, [Page], FrameHeader>, BusError> {
    let chunks = bus.attach().frame_chunks() as usize;
    bus.builder(FRAME_SERVICE)?
        .publish_subscribe::<[Page]>()
        .user_header::<FrameHeader>()
        .enable_safe_overflow(false)
        .history_size(0)
        .max_publishers(1)
        .max_subscribers(FRAME_CONSUMERS.len())
        .max_nodes(1 + FRAME_CONSUMERS.len())
        .subscriber_max_borrowed_samples(chunks)
        .subscriber_max_buffer_size(chunks)
        .open_or_create()
        .map_err(|e| BusError::open("cannot open the frame store", e))
}

/// The simulator's end: hands out slots to fill.
#[derive(Debug)]
pub struct FramePublisher {
    publisher: Publisher<Ipc, [Page], FrameHeader>,
    service: PortFactory<Ipc, [Page], FrameHeader>,
    size: FrameSize,
    chunks: u32,
    generation: u32,
    published: u64,
    consumers: usize,
}

impl FramePublisher {
    /// Reserves the store. Check [`check_shared_memory`](crate::process::check_shared_memory) first.
    ///
    /// # Errors
    /// When this process is not the simulator, or the service cannot be opened.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        let (role, attach) = (bus.role(), bus.attach());
        if role != Role::Sim {
            return Err(BusError::WrongRole { service: FRAME_SERVICE, role, verb: "send" });
        }
        let chunks = attach.frame_chunks();
        let service = service(bus)?;
        let publisher = service
            .publisher_builder()
            .initial_max_slice_len(attach.frame.pages())
            .max_loaned_samples(MAX_LOANED_FRAMES as usize)
            .override_sample_preallocation(move |_| chunks as usize)
            .set_backpressure_handler(|_| BackpressureAction::DiscardDataAndFail)
            .create()
            .map_err(|e| BusError::open("cannot reserve the frame store", e))?;
        Ok(Self {
            publisher,
            service,
            size: attach.frame,
            chunks,
            generation: attach.generation,
            published: 0,
            consumers: attach.count(&FRAME_CONSUMERS),
        })
    }

    /// Whether every consumer is there. Publish nothing before: what a consumer has missed it never gets.
    pub fn is_complete(&self) -> bool {
        self.service.dynamic_config().number_of_subscribers() >= self.consumers
    }

    /// A slot to fill. Its bytes are what an earlier frame left there, or zero. At most
    /// [`MAX_LOANED_FRAMES`] at once; one that is dropped unpublished is free again.
    ///
    /// # Errors
    /// When every chunk is in use, or as many slots are out as may be.
    pub fn loan(&self) -> Result<FrameSlot, FrameError> {
        let sample =
            self.publisher.loan_slice_uninit(self.size.pages()).map_err(|error| match error {
                LoanError::OutOfMemory => FrameError::NoChunk { chunks: self.chunks },
                LoanError::ExceedsMaxLoans => FrameError::TooManySlots,
                e => BusError::transport("loaning a frame", e).into(),
            })?;
        #[expect(unsafe_code, reason = "shared memory is initialised by the system")]
        // SAFETY: the chunk lies in a file mapping, whose bytes the system has set to zero, and a `Page` is
        // plain bytes: every value of them is one.
        let sample = unsafe { sample.assume_init() };
        Ok(FrameSlot { sample, size: self.size })
    }

    /// Makes a filled slot a frame that every consumer gets, and names it. Ids grow by one and are never
    /// used again within a run.
    ///
    /// # Errors
    /// When a consumer's queue is full or a consumer is missing.
    pub fn publish(
        &mut self,
        slot: FrameSlot,
        content_hash: [u8; 16],
    ) -> Result<FrameId, FrameError> {
        let FrameSlot { mut sample, size: FrameSize { width, height } } = slot;
        self.published += 1;
        let id = (u64::from(self.generation) << ID_BITS) | self.published;
        *sample.user_header_mut() = FrameHeader { id, width, height, content_hash };
        delivered(FRAME_SERVICE, self.consumers, sample.send())?;
        Ok(id)
    }
}

/// A frame that is being filled.
#[derive(Debug)]
pub struct FrameSlot {
    sample: SampleMut<Ipc, [Page], FrameHeader>,
    size: FrameSize,
}

impl FrameSlot {
    /// The slot's pages, page-aligned: the pixels, and what is left of the last page.
    pub fn pages_mut(&mut self) -> &mut [Page] {
        self.sample.payload_mut()
    }

    /// The pixels: RGBA8, rows top to bottom without gaps.
    pub fn pixels_mut(&mut self) -> &mut [u8] {
        let bytes = self.size.bytes();
        &mut bytemuck::cast_slice_mut(self.sample.payload_mut())[..bytes]
    }

    /// The pixels.
    pub fn pixels(&self) -> &[u8] {
        &bytemuck::cast_slice(self.sample.payload())[..self.size.bytes()]
    }

    /// Where the first page lies: a multiple of 4096 that stays mapped, and names the same chunk, for as
    /// long as the publisher exists.
    pub fn as_mut_ptr(&mut self) -> *mut Page {
        self.sample.payload_mut().as_mut_ptr()
    }
}

/// A frame that this process holds. Its pixels do not change and stay where they are until the last
/// holder drops it, evicted or not.
#[derive(Debug)]
pub struct Frame {
    header: FrameHeader,
    size: FrameSize,
    sample: Sample<Ipc, [Page], FrameHeader>,
}

#[expect(unsafe_code, reason = "frames are looked at by worker threads")]
// SAFETY: a `&Frame` gives out a copied header and a shared slice of memory that nobody writes while the
// sample exists. Reading the sample's length locks the subscriber's mutex (`ipc_threadsafe`), and the sample
// itself is `Send`, so the last holder may drop it on any thread.
unsafe impl Sync for Frame {}

impl Frame {
    /// The frame's id.
    pub fn id(&self) -> FrameId {
        self.header.id
    }

    /// Width and height in pixels.
    pub fn size(&self) -> FrameSize {
        self.size
    }

    /// First 16 bytes of the BLAKE3 hash of the pixels.
    pub fn content_hash(&self) -> [u8; 16] {
        self.header.content_hash
    }

    /// The pixels in shared memory: RGBA8, rows top to bottom without gaps.
    pub fn pixels(&self) -> &[u8] {
        &bytemuck::cast_slice(self.sample.payload())[..self.size.bytes()]
    }
}

/// A consumer's end: holds every frame that is resident.
#[derive(Debug)]
pub struct FrameStore {
    subscriber: Subscriber<Ipc, [Page], FrameHeader>,
    evictions: Receiver<Eviction>,
    size: FrameSize,
    frames: FxHashMap<FrameId, Arc<Frame>>,
    taken: u64,
}

impl FrameStore {
    /// An empty store that gets every frame published from now on.
    ///
    /// # Errors
    /// When this process is not a consumer of frames, or a service cannot be opened.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        let role = bus.role();
        if !FRAME_CONSUMERS.contains(&role) {
            return Err(BusError::WrongRole { service: FRAME_SERVICE, role, verb: "receive" });
        }
        let evictions = bus.receiver()?;
        let subscriber = service(bus)?
            .subscriber_builder()
            .create()
            .map_err(|e| BusError::open("cannot receive frames", e))?;
        let size = bus.attach().frame;
        Ok(Self { subscriber, evictions, size, frames: FxHashMap::default(), taken: 0 })
    }

    /// The frame that `id` names: `None` when there is none, because it was evicted or never published.
    ///
    /// # Errors
    /// When a frame that arrived cannot be used; it is dropped, and the next call goes on after it.
    pub fn get(&mut self, id: FrameId) -> Result<Option<&Arc<Frame>>, FrameError> {
        if !self.frames.contains_key(&id) {
            self.take_waiting()?;
        }
        Ok(self.frames.get(&id))
    }

    /// Lets go of every frame that was evicted; returns how many. Call it whenever the process wakes:
    /// what is not let go of keeps its memory.
    ///
    /// # Errors
    /// As [`FrameStore::get`], and when the transport fails.
    pub fn apply_evictions(&mut self) -> Result<usize, FrameError> {
        let mut evicted = 0;
        while let Some(Eviction { frame }) = self.evictions.next()? {
            if !self.frames.contains_key(&frame) {
                // Never asked for, so still in the queue.
                self.take_waiting()?;
            }
            evicted += usize::from(self.frames.remove(&frame).is_some());
        }
        Ok(evicted)
    }

    /// Frames held now.
    pub fn held(&self) -> usize {
        self.frames.len()
    }

    /// Frames that were ever taken hold of.
    pub fn taken(&self) -> u64 {
        self.taken
    }

    fn take_waiting(&mut self) -> Result<(), FrameError> {
        let failed = |e| BusError::transport("receiving frames", e);
        while let Some(sample) = self.subscriber.receive().map_err(failed)? {
            self.take(sample)?;
        }
        Ok(())
    }

    fn take(&mut self, sample: Sample<Ipc, [Page], FrameHeader>) -> Result<(), FrameError> {
        let header = *sample.user_header();
        let FrameHeader { id, width, height, .. } = header;
        let (expected, pages) = (self.size, sample.header().number_of_elements());
        if (FrameSize { width, height }) != expected || pages != expected.pages() as u64 {
            return Err(FrameError::Shape { id, width, height, pages, expected });
        }
        match self.frames.entry(id) {
            Entry::Vacant(entry) if id != NO_FRAME => {
                entry.insert(Arc::new(Frame { header, size: expected, sample }));
                self.taken += 1;
                Ok(())
            }
            _ => Err(FrameError::Id { id }),
        }
    }
}
