//! The frame store: every view is written into shared memory once, and identified by its id from then on.
//!
//! The simulator loans a [`FrameSlot`], lets the renderer write into it, and publishes it. Consumers keep received frames
//! in a [`FrameStore`] and look them up by the ids in messages. No process copies pixels, and a published frame never
//! changes: iceoryx2 reuses its chunk only after the simulator has evicted it and every consumer has dropped it.
//!
//! # Memory
//! Each world has a store of its own, with [`frame_chunks`](crate::Attach::frame_chunks) chunks. The chunk that was freed
//! last is used first, so a run touches about as many as are in use at the same time. A chunk is free when every consumer has
//! dropped its frame. There are more chunks than may be resident, so that the simulator need not wait for that; if a consumer
//! falls far behind, [`FramePublisher::loan`] returns [`FrameError::NoChunk`].
//!
//! # Order
//! A frame is published before any message that names it, and evicted after every such message has been answered. So a
//! consumer that reads an unknown id finds the frame in its queue.

use std::collections::hash_map::Entry;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Weak};

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
use crate::layout::{Field, Struct, WireLayout, WireType, wire_struct};
use crate::message::{Eviction, FrameId, MAX_WORLDS, NO_FRAME, Role};
use crate::transport::{BusError, Ipc, delivered, receiver};

/// Last part of the name of the service that carries frames.
pub const FRAME_SERVICE: &str = "frame";

/// The roles that receive frames.
pub const FRAME_CONSUMERS: [Role; 3] = [Role::Memory, Role::Policy, Role::ExternalMemory];

/// Bits of a frame id below the generation.
const ID_BITS: u32 = 40;

/// Those below the index of the world.
const NUMBER_BITS: u32 = 36;

const _: () = assert!(MAX_WORLDS <= 1 << (ID_BITS - NUMBER_BITS));

/// A page of a frame, aligned so that a graphics device can write into it.
#[derive(Debug, Clone, Copy, Pod, Zeroable, ZeroCopySend)]
#[repr(C)]
#[repr(align(4096))]
#[type_name("memtransfer.Page")]
pub struct Page(pub [u8; PAGE_BYTES]);

wire_struct! {
    /// The header of a frame.
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

impl WireLayout for Page {
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
            doc: "Pixels; the rest of a frame's last page is undefined.",
        }],
    };
}

/// Why a frame cannot be loaned, published or looked up.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// Every chunk is in use: consumers have not dropped enough evicted frames. Notify them and try again for a
    /// bounded time.
    #[error(
        "all {chunks} chunks of the frame store are in use: memory or policy does not release evicted frames"
    )]
    NoChunk {
        /// Chunks of the store.
        chunks: u32,
    },
    /// Too many slots at the same time.
    #[error("{MAX_LOANED_FRAMES} frame slots are in use: publish or drop one first")]
    TooManySlots,
    /// A received frame has the wrong size.
    #[error(
        "frame {id} is {width} x {height} in {pages} pages instead of {} x {} in {}",
        expected.width, expected.height, expected.pages()
    )]
    Shape {
        /// Its id.
        id: FrameId,
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
        /// Its pages.
        pages: u64,
        /// The frame size of the run.
        expected: FrameSize,
    },
    /// A received frame has the id 0, or that of another frame.
    #[error("a received frame has the id {id}, which is {}", if *id == NO_FRAME { "reserved" } else { "in use" })]
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
    let (worlds, consumers): (usize, usize) =
        (bus.attach().worlds.into(), bus.attach().places(&FRAME_CONSUMERS));
    bus.builder(FRAME_SERVICE)?
        .publish_subscribe::<[Page]>()
        .user_header::<FrameHeader>()
        .enable_safe_overflow(false)
        .history_size(0)
        .max_publishers(worlds)
        .max_subscribers(consumers)
        .max_nodes(worlds + consumers)
        .subscriber_max_borrowed_samples(chunks)
        .subscriber_max_buffer_size(chunks)
        .open_or_create()
        .map_err(|e| BusError::open("cannot open the frame store", e))
}

/// Publishes frames; for the simulator.
#[derive(Debug)]
pub struct FramePublisher {
    publisher: Publisher<Ipc, [Page], FrameHeader>,
    service: PortFactory<Ipc, [Page], FrameHeader>,
    size: FrameSize,
    chunks: u32,
    /// The id of the last frame.
    last_id: FrameId,
    consumers: usize,
    /// Consumers without which a frame is not delivered.
    required: usize,
}

impl FramePublisher {
    /// Reserves the store. Check [`check_shared_memory`](crate::process::check_shared_memory) first.
    ///
    /// # Errors
    /// When this process is not the simulator, or the service cannot be opened.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        bus.allowed(&[Role::Sim], FRAME_SERVICE, "send")?;
        let attach = bus.attach();
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
            last_id: (u64::from(attach.generation) << ID_BITS)
                | (u64::from(bus.index()) << NUMBER_BITS),
            consumers: attach.count(&FRAME_CONSUMERS),
            required: attach.count_required(&FRAME_CONSUMERS),
        })
    }

    /// Whether all consumers exist. Publish nothing before: a consumer never gets earlier frames.
    pub fn is_complete(&self) -> bool {
        self.service.dynamic_config().number_of_subscribers() >= self.consumers
    }

    /// A slot to write a frame into. Its bytes are zero or those of an earlier frame. A slot that is dropped unpublished is
    /// free again.
    ///
    /// # Errors
    /// When every chunk is in use, or [`MAX_LOANED_FRAMES`] slots exist.
    pub fn loan(&self) -> Result<FrameSlot, FrameError> {
        let sample =
            self.publisher.loan_slice_uninit(self.size.pages()).map_err(|error| match error {
                LoanError::OutOfMemory => FrameError::NoChunk { chunks: self.chunks },
                LoanError::ExceedsMaxLoans => FrameError::TooManySlots,
                e => BusError::transport("loaning a frame", e).into(),
            })?;
        #[expect(unsafe_code, reason = "shared memory is initialised by the system")]
        // SAFETY: the chunk lies in a file mapping, whose bytes the kernel has initialised with zeros, and every bit pattern
        // is a valid `Page`.
        let sample = unsafe { sample.assume_init() };
        Ok(FrameSlot { sample, size: self.size })
    }

    /// Sends a slot to all consumers as a frame and returns its id. Ids grow by one and are never reused within a run, by any of
    /// its worlds.
    ///
    /// # Errors
    /// When a consumer's queue is full or a consumer other than an external memory is missing.
    pub fn publish(
        &mut self,
        slot: FrameSlot,
        content_hash: [u8; 16],
    ) -> Result<FrameId, FrameError> {
        let FrameSlot { mut sample, size: FrameSize { width, height } } = slot;
        self.last_id += 1;
        let id = self.last_id;
        *sample.user_header_mut() = FrameHeader { id, width, height, content_hash };
        delivered(FRAME_SERVICE, self.required, sample.send())?;
        Ok(id)
    }
}

/// A frame that is being written.
#[derive(Debug)]
pub struct FrameSlot {
    sample: SampleMut<Ipc, [Page], FrameHeader>,
    size: FrameSize,
}

impl FrameSlot {
    /// The slot's pages: the pixels, and the rest of the last page.
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

    /// The address of the first page. It stays mapped, and belongs to the same chunk, while the publisher exists.
    pub fn as_mut_ptr(&mut self) -> *mut Page {
        self.sample.payload_mut().as_mut_ptr()
    }
}

/// A received frame. Its pixels do not change and stay mapped until it is dropped, even after its eviction.
#[derive(Debug)]
pub struct Frame {
    header: FrameHeader,
    size: FrameSize,
    evicted: AtomicBool,
    /// The pixels of `sample`. To ask the sample for them locks the subscriber's mutex and reads shared memory.
    pixels: NonNull<[u8]>,
    /// Keeps the pixels mapped.
    _sample: Sample<Ipc, [Page], FrameHeader>,
}

#[expect(unsafe_code, reason = "worker threads read frames")]
// SAFETY: a `&Frame` gives access to a copied header, an atomic, and a shared slice of memory that no process writes while
// the sample exists.
unsafe impl Sync for Frame {}

#[expect(unsafe_code, reason = "worker threads drop frames")]
// SAFETY: the pixels belong to the sample, and the sample is `Send`.
unsafe impl Send for Frame {}

impl Frame {
    /// The frame's id.
    pub fn id(&self) -> FrameId {
        self.header.id
    }

    /// Whether the simulator has evicted the frame: no later message names it.
    pub fn is_evicted(&self) -> bool {
        self.evicted.load(Relaxed)
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
        #[expect(unsafe_code, reason = "the sample and a slice of its pixels are in one structure")]
        // SAFETY: they stay mapped, at the same address, and unchanged while the sample exists.
        unsafe {
            self.pixels.as_ref()
        }
    }
}

/// The frames that a consumer has received and that are not evicted.
#[derive(Debug)]
pub struct FrameStore {
    subscriber: Subscriber<Ipc, [Page], FrameHeader>,
    evictions: Receiver<Eviction>,
    size: FrameSize,
    frames: FxHashMap<FrameId, Arc<Frame>>,
    /// Evicted frames that are in use outside the store.
    pinned: Vec<Weak<Frame>>,
    received: u64,
}

impl FrameStore {
    /// Creates an empty store, which receives every frame published from now on.
    ///
    /// # Errors
    /// When this role does not receive frames, or a service cannot be opened.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        bus.allowed(&FRAME_CONSUMERS, FRAME_SERVICE, "receive")?;
        let evictions = bus.receiver()?;
        let subscriber = receiver(&service(bus)?, "cannot receive frames")?;
        let size = bus.attach().frame;
        Ok(Self {
            subscriber,
            evictions,
            size,
            frames: FxHashMap::default(),
            pinned: Vec::new(),
            received: 0,
        })
    }

    /// The frame that `id` names; `None` if it was evicted or never published.
    ///
    /// # Errors
    /// When a received frame is invalid; it is dropped, and the next call continues after it.
    pub fn get(&mut self, id: FrameId) -> Result<Option<&Arc<Frame>>, FrameError> {
        if !self.frames.contains_key(&id) {
            self.take_waiting()?;
        }
        Ok(self.frames.get(&id))
    }

    /// Drops the frames that were evicted, and returns how many. Call it whenever the process wakes: a frame that is not
    /// dropped keeps its memory.
    ///
    /// # Errors
    /// As [`FrameStore::get`], and when the transport fails.
    pub fn apply_evictions(&mut self) -> Result<usize, FrameError> {
        let mut evicted = 0;
        while let Some(Eviction { frame }) = self.evictions.next()? {
            if !self.frames.contains_key(&frame) {
                // Never looked up, so still in the queue.
                self.take_waiting()?;
            }
            if let Some(frame) = self.frames.remove(&frame) {
                evicted += 1;
                frame.evicted.store(true, Relaxed);
                if Arc::strong_count(&frame) > 1 {
                    self.pinned.push(Arc::downgrade(&frame));
                }
            }
        }
        Ok(evicted)
    }

    /// Number of frames in the store.
    #[expect(
        clippy::len_without_is_empty,
        reason = "the number is reported, emptiness is not asked for"
    )]
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Number of frames received so far.
    pub fn received(&self) -> u64 {
        self.received
    }

    /// Number of evicted frames that this process still uses, and whose memory is therefore not free.
    pub fn evicted_but_pinned(&mut self) -> usize {
        self.pinned.retain(|frame| frame.strong_count() > 0);
        self.pinned.len()
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
                let pixels = &bytemuck::cast_slice(sample.payload())[..expected.bytes()];
                entry.insert(Arc::new(Frame {
                    header,
                    size: expected,
                    evicted: AtomicBool::new(false),
                    pixels: pixels.into(),
                    _sample: sample,
                }));
                self.received += 1;
                Ok(())
            }
            _ => Err(FrameError::Id { id }),
        }
    }
}
