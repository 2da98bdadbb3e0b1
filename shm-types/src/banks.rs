//! Banks: the demonstrations that an external memory remembers, published once and then identified by id.
//!
//! A bank is one sample: a list of demonstrations, the steps of all of them, and an embedding for each step as one
//! matrix. The external memory keeps the sample, so nothing is copied. Pixels stay in the [frame store](crate::frames).
//!
//! The frames that a bank names stay resident until it is built. A bank without demonstrations takes back the one with
//! its id.

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::{BackpressureAction, LoanError};
use iceoryx2::prelude::{AllocationStrategy, ZeroCopySend};
use iceoryx2::sample::Sample;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use crate::attach::Attach;
use crate::bus::Bus;
use crate::layout::wire_struct;
use crate::message::{FrameId, MAX_STATE, Role};
use crate::transport::{BusError, Ipc, delivered, receiver};
use domain::UnknownCode;

/// First part of the name of the service that carries banks; the index of the external memory follows.
pub const BANK_SERVICE: &str = "bank";

/// Bytes of a bank for which shared memory is reserved from the start.
const INITIAL_BYTES: usize = 64 << 10;

wire_struct! {
    /// The header of a bank.
    BankHeader: Eq Default, "memtransfer.BankHeader", 32 bytes {
        /// The bank's id.
        id: u64,
        /// Number of demonstrations; 0 takes the bank back.
        demonstrations: u32,
        /// Steps of all demonstrations together.
        steps: u32,
        /// Numbers in an embedding; 0: the bank has no embeddings.
        dimension: u32,
        /// Bytes of the instructions.
        text_bytes: u32,
        /// Zero.
        reserved: u64,
    }
}

wire_struct! {
    /// One demonstration of a bank.
    BankDemonstration: Eq Default, "memtransfer.BankDemonstration", 16 bytes {
        /// Its first step in the bank.
        first_step: u32,
        /// Number of steps, at least 1.
        steps: u32,
        /// First byte of its instruction in the bank's text.
        first_byte: u32,
        /// Bytes of its instruction, UTF-8.
        bytes: u32,
    }
}

wire_struct! {
    /// One step of a demonstration in a bank.
    BankStep, "memtransfer.BankStep", 96 bytes {
        /// The expert's view, or [`NO_FRAME`](crate::message::NO_FRAME) if the bank supplies none.
        frame: FrameId,
        /// First 16 bytes of the BLAKE3 hash of the view's pixels; zeros if the view was not rendered.
        content_hash: [u8; 16],
        /// The expert's state: the numbers that the world declares, then zeros.
        state: [f32; MAX_STATE],
        /// Code of the action that the expert took there, or [`NO_ACTION`](crate::message::NO_ACTION) at
        /// the end of the demonstration.
        action: u8,
        /// Code of the feedback to the action before.
        feedback: u8,
        /// Zero.
        reserved: [u8; 6],
    }
}

/// A bank to publish.
#[derive(Debug, Clone, Default)]
pub struct BankContent {
    /// The demonstrations.
    pub demonstrations: Vec<BankDemonstration>,
    /// Their steps.
    pub steps: Vec<BankStep>,
    /// The embeddings of the steps, one after the other; empty without embeddings.
    pub embeddings: Vec<f32>,
    /// The instructions.
    pub text: String,
}

/// Words of 8 bytes in a step.
const WORDS_OF_STEP: usize = size_of::<BankStep>() / 8;

/// Where the parts of a bank lie, in words of 8 bytes.
struct Parts {
    steps: usize,
    embeddings: usize,
    text: usize,
    end: usize,
}

impl Parts {
    fn of(header: &BankHeader) -> Option<Self> {
        let [demonstrations, steps, dimension, text] =
            [header.demonstrations, header.steps, header.dimension, header.text_bytes]
                .map(|count| count as usize);
        let steps_at = 2 * demonstrations;
        let embeddings_at = steps_at.checked_add(WORDS_OF_STEP * steps)?;
        let numbers = steps.checked_mul(dimension)?;
        let text_at = embeddings_at.checked_add(numbers.div_ceil(2))?;
        let end = text_at.checked_add(text.div_ceil(8))?;
        Some(Self { steps: steps_at, embeddings: embeddings_at, text: text_at, end })
    }
}

/// Banks that an external memory can keep at the same time, at most: those of the episodes that run or come next in each
/// lane, and some that no lane needs at the moment.
pub const fn max_banks(attach: &Attach) -> usize {
    2 * attach.lanes as usize + 64
}

/// Samples of one service: each bank, and taking it back.
const fn queue_len(attach: &Attach) -> usize {
    2 * max_banks(attach)
}

fn service(bus: &Bus, index: u8) -> Result<PortFactory<Ipc, [u64], BankHeader>, BusError> {
    bus.builder(&format!("{BANK_SERVICE}-{index}"))?
        .publish_subscribe::<[u64]>()
        .user_header::<BankHeader>()
        .enable_safe_overflow(false)
        .history_size(0)
        .max_publishers(1)
        .max_subscribers(1)
        .max_nodes(2)
        .subscriber_max_borrowed_samples(queue_len(bus.attach()))
        .subscriber_max_buffer_size(queue_len(bus.attach()))
        .open_or_create()
        .map_err(|e| BusError::open("cannot open the service of banks", e))
}

/// Publishes banks to one external memory; for memory.
#[derive(Debug)]
pub struct BankPublisher {
    publisher: Publisher<Ipc, [u64], BankHeader>,
}

impl BankPublisher {
    /// A publisher for the external memory with this index.
    ///
    /// # Errors
    /// When this process is not the memory, or the service cannot be opened.
    pub fn new(bus: &Bus, index: u8) -> Result<Self, BusError> {
        bus.allowed(&[Role::Memory], BANK_SERVICE, "send")?;
        let publisher = service(bus, index)?
            .publisher_builder()
            .initial_max_slice_len(INITIAL_BYTES / 8)
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .max_loaned_samples(1)
            .set_backpressure_handler(|_| BackpressureAction::DiscardDataAndFail)
            .create()
            .map_err(|e| BusError::open("cannot publish banks", e))?;
        Ok(Self { publisher })
    }

    /// Publishes a bank under `id`.
    ///
    /// # Errors
    /// When the external memory does not receive it.
    pub fn publish(&mut self, id: u64, content: &BankContent) -> Result<(), BusError> {
        let BankContent { demonstrations, steps, embeddings, text } = content;
        let header = BankHeader {
            id,
            demonstrations: demonstrations.len() as u32,
            steps: steps.len() as u32,
            dimension: embeddings.len().checked_div(steps.len()).unwrap_or(0) as u32,
            text_bytes: text.len() as u32,
            reserved: 0,
        };
        let too_long = || BusError::transport("publishing a bank", "it is too long");
        let parts = Parts::of(&header).ok_or_else(too_long)?;
        let loaned = self.publisher.loan_slice_uninit(parts.end);
        let failed = |e: LoanError| BusError::transport("loaning a bank", e);
        let mut sample = loaned.map_err(failed)?.write_from_fn(|_| 0);
        let words = sample.payload_mut();
        let mut write = |at: usize, bytes: &[u8]| {
            bytemuck::cast_slice_mut(&mut words[at..])[..bytes.len()].copy_from_slice(bytes);
        };
        write(0, bytemuck::cast_slice(demonstrations));
        write(parts.steps, bytemuck::cast_slice(steps));
        write(parts.embeddings, bytemuck::cast_slice(embeddings));
        write(parts.text, text.as_bytes());
        *sample.user_header_mut() = header;
        delivered(BANK_SERVICE, 1, sample.send())
    }

    /// Takes back the bank with this id.
    ///
    /// # Errors
    /// As [`Self::publish`].
    pub fn take_back(&mut self, id: u64) -> Result<(), BusError> {
        self.publish(id, &BankContent::default())
    }
}

/// A received bank. Its content does not change and stays mapped until it is dropped.
#[derive(Debug)]
pub struct Bank {
    header: BankHeader,
    parts: [usize; 3],
    sample: Sample<Ipc, [u64], BankHeader>,
}

#[expect(unsafe_code, reason = "bindings share a bank between threads")]
// SAFETY: as for `Frame`: a `&Bank` gives access to copied numbers and to a shared slice of memory that no process writes
// while the sample exists. The sample itself is `Send`, so it may be dropped on any thread.
unsafe impl Sync for Bank {}

/// The header and the words of a bank, before they are known to fit each other.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BankWords<'a> {
    pub(crate) header: &'a BankHeader,
    pub(crate) words: &'a [u64],
}

impl<'a> BankWords<'a> {
    /// Checks that every part lies within the words, and every demonstration within the parts. Returns where the parts
    /// begin.
    pub(crate) fn check(self) -> Result<[usize; 3], UnknownCode> {
        let Self { header, words } = self;
        let unusable =
            |what: &str| UnknownCode::new(format_args!("bank {}: {what}", header.id), "a bank");
        let parts = Parts::of(header).filter(|parts| parts.end <= words.len());
        let Some(Parts { steps, embeddings, text, .. }) = parts else {
            return Err(unusable(&format!("{} words are too few", words.len())));
        };
        let text_bytes = self.bytes(text, header.text_bytes as usize);
        let valid = str::from_utf8(text_bytes).map_err(|_| unusable("its text is not UTF-8"))?;
        for demonstration in self.demonstrations() {
            let BankDemonstration { first_step, steps, first_byte, bytes } = *demonstration;
            let [first_byte, bytes] = [first_byte as usize, bytes as usize];
            let has_steps =
                steps > 0 && u64::from(first_step) + u64::from(steps) <= header.steps.into();
            if !has_steps || valid.get(first_byte..first_byte + bytes).is_none() {
                return Err(unusable("a demonstration lies outside of it"));
            }
        }
        Ok([steps, embeddings, text])
    }

    /// The first `len` bytes from word `part` on.
    fn bytes(self, part: usize, len: usize) -> &'a [u8] {
        &bytemuck::cast_slice(&self.words[part..])[..len]
    }

    fn demonstrations(self) -> &'a [BankDemonstration] {
        let bytes = self.header.demonstrations as usize * size_of::<BankDemonstration>();
        bytemuck::cast_slice(self.bytes(0, bytes))
    }
}

impl Bank {
    fn of(sample: Sample<Ipc, [u64], BankHeader>) -> Result<Self, UnknownCode> {
        let header = *sample.user_header();
        let parts = BankWords { header: &header, words: sample.payload() }.check()?;
        Ok(Self { header, parts, sample })
    }

    fn words(&self) -> BankWords<'_> {
        BankWords { header: &self.header, words: self.sample.payload() }
    }

    fn bytes(&self, part: usize, len: usize) -> &[u8] {
        self.words().bytes(part, len)
    }

    fn text_bytes(&self) -> &[u8] {
        self.bytes(self.parts[2], self.header.text_bytes as usize)
    }

    /// Its id.
    pub fn id(&self) -> u64 {
        self.header.id
    }

    /// The demonstrations; none if the bank with this id is taken back.
    pub fn demonstrations(&self) -> &[BankDemonstration] {
        self.words().demonstrations()
    }

    /// The steps of all demonstrations.
    pub fn steps(&self) -> &[BankStep] {
        let bytes = self.header.steps as usize * size_of::<BankStep>();
        bytemuck::cast_slice(self.bytes(self.parts[0], bytes))
    }

    /// Numbers in an embedding; 0 without embeddings.
    pub fn dimension(&self) -> usize {
        self.header.dimension as usize
    }

    /// The embeddings of all steps, one after the other; empty without embeddings.
    pub fn embeddings(&self) -> &[f32] {
        let numbers = self.header.steps as usize * self.dimension();
        bytemuck::cast_slice(self.bytes(self.parts[1], numbers * size_of::<f32>()))
    }

    /// The instruction of a demonstration of this bank.
    pub fn instruction(&self, of: &BankDemonstration) -> &str {
        let [first, bytes] = [of.first_byte as usize, of.bytes as usize];
        let text = self.text_bytes().get(first..first + bytes);
        text.and_then(|text| str::from_utf8(text).ok()).unwrap_or_default()
    }
}

/// Receives banks; for an external memory.
#[derive(Debug)]
pub struct BankReceiver {
    subscriber: Subscriber<Ipc, [u64], BankHeader>,
}

impl BankReceiver {
    /// A receiver of every bank published from now on.
    ///
    /// # Errors
    /// When this process is not an external memory, or the service cannot be opened.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        bus.allowed(&[Role::ExternalMemory], BANK_SERVICE, "receive")?;
        let subscriber = receiver(&service(bus, bus.index())?, "cannot receive banks")?;
        Ok(Self { subscriber })
    }

    /// The next waiting bank, if there is one; or why it cannot be used.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn take(&mut self) -> Result<Option<Result<Bank, UnknownCode>>, BusError> {
        let sample = self.subscriber.receive();
        let sample = sample.map_err(|e| BusError::transport("receiving banks", e))?;
        Ok(sample.map(Bank::of))
    }
}
