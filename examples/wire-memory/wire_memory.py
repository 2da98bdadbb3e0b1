"""A memory on plain iceoryx2, without the package `memtransfer`. Everything it does is in docs/wire.md.

It remembers states: it supplies how the demonstration went on that came closest to the agent's state, and its task.
"""

import ctypes
import fcntl
import json
import math
import os
import sys
import time
from pathlib import Path

import iceoryx2 as iox2

WIRE_VERSION, EXTERNAL_MEMORY = 16, 4
TEXT, STEPS, PLAN = 0, 1, 4
NO_ACTION, MAX_PLAN = 255, 1024
SEGMENT = 6
NOT_MEASURED = 2**32 - 1
PAGE_BYTES = 4096
U8, U16, U32, U64, F32 = ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_uint64, ctypes.c_float
DESCRIPTION = {"name": "wire-places", "version": "1", "scope": "case", "embeddings": False, "frames": False, "deterministic": True}


def struct(name, size, fields):
    """The structure of this name; `fields` are written as in the page's tables."""
    types = {"u8": U8, "u16": U16, "u32": U32, "u64": U64, "f32": F32}
    members = []
    for field in fields.split(","):
        member, kind = field.strip().split(": ")
        kind, _, count = kind.partition(" x ")
        kind = types.get(kind) or globals()[kind]
        members.append((member, kind * int(count) if count else kind))
    body = {"_fields_": members, "type_name": staticmethod(lambda: f"memtransfer.{name}")}
    made = type(name, (ctypes.Structure,), body)
    assert ctypes.sizeof(made) == size, f"{name} has {ctypes.sizeof(made)} bytes instead of {size}"
    return made


FrameHeader = struct("FrameHeader", 32, "id: u64, width: u32, height: u32, content_hash: u8 x 16")
Page = struct("Page", PAGE_BYTES, "pixels: u8 x 4096")
Eviction = struct("Eviction", 8, "frame: u64")
Stop = struct("Stop", 8, "reserved: u64")
Handshake = struct("Handshake", 512, """wire_version: u32, role: u32, pid: u32, facts_len: u32, index: u32,
    facts: u8 x 492""")
ErrorReport = struct("ErrorReport", 512, """episode: u64, role: u32, count: u32, kind: u32, lane: u32, text_len: u32,
    index: u32, text: u8 x 480""")
ShutdownReport = struct("ShutdownReport", 48, """role: u32, index: u32, frames_rendered: u64, frames_evicted: u64,
    frames_received: u64, pixel_bytes_copied: u64, error_reports: u64""")
BankHeader = struct("BankHeader", 32, """id: u64, demonstrations: u32, steps: u32, dimension: u32, text_bytes: u32,
    reserved: u64""")
BankDemonstration = struct("BankDemonstration", 16, "first_step: u32, steps: u32, first_byte: u32, bytes: u32")
BankStep = struct("BankStep", 96, """frame: u64, content_hash: u8 x 16, state: f32 x 16, action: u8, feedback: u8,
    reserved: u8 x 6""")
NoteHeader = struct("NoteHeader", 24, "id: u64, episode: u64, lane: u32, reserved: u32")
ExternalEpisode = struct("ExternalEpisode", 280, """episode: u64, bank: u64, seed: u64, lane: u32, text_budget: u32,
    image_budget: u32, repeat: u32, instruction_len: u32, learning: u32, instruction: u8 x 232""")
ExternalQuery = struct("ExternalQuery", 4256, """episode: u64, frame: u64, lane: u32, step: u32, state: f32 x 16,
    embedding_len: u32, feedback: u8, action: u8, last: u8, outcome: u8, reserved: u8 x 8,
    demonstration: u32, sub_goals_len: u32, sub_goals: u16 x 24, embedding: f32 x 1024""")
ExternalBuilt = struct("ExternalBuilt", 32, "bank: u64, store_bytes: u64, failure: u64, took_ns: u64")
AnswerItem = struct("AnswerItem", 28, """first_byte: u32, bytes: u32, demonstration: u32, first_step: u32, steps: u32,
    distance: f32, kind: u8, views: u8, actions: u8, reserved: u8""")
AnswerSource = struct("AnswerSource", 16, "item: u32, demonstration: u32, first_step: u32, steps: u32")
ExternalAnswer = struct("ExternalAnswer", 544, """episode: u64, received_ns: u64, sent_ns: u64, store_bytes: u64,
    note: u64, lane: u32, step: u32, items_len: u32, sources_len: u32, tokens: u32, failed: u32, items: AnswerItem x 8,
    sources: AnswerSource x 16""")


class Run:
    """The memory's place in a run."""

    def __init__(self, folder, index):
        attach = json.loads((folder / "attach.json").read_text())
        if attach["wire_version"] != WIRE_VERSION:
            raise SystemExit(f"this run speaks wire version {attach['wire_version']}, not {WIRE_VERSION}")
        self.world = json.loads((folder / "world.json").read_text())
        self.index, self.orchestrator_pid = index, attach["orchestrator_pid"]
        externals, worlds = len(attach["external_memories"]), attach["worlds"]
        lanes, capacity = attach["lanes"], attach["frame_capacity"]
        config = iox2.config.default()
        config.global_cfg.prefix = iox2.FileName.new(attach["prefix"])
        config.global_cfg.root_path = iox2.Path.new(str(folder))
        config.defaults.publish_subscribe.subscriber_expired_connection_buffer = 12 + 4 * (worlds + externals)
        self.node = iox2.NodeBuilder.new().config(config).create(iox2.ServiceType.Ipc)
        self.generation, self.roles, self.lanes = attach["generation"], 3 + worlds + externals, lanes
        chunks = capacity + 32 + capacity // 8 + lanes + 16
        self.queues = {"lanes": 2 * lanes + 16, "frames": 2 * chunks, "few": 256}

        self.listener = self.events(f"external-memory-{index}").listener_builder().create()
        self.orchestrator = self.events("orchestrator").notifier_builder().create()
        self.host = self.events("memory").notifier_builder().create()
        processes = 2 + worlds + externals
        self.handshake = self.service("handshake", Handshake, processes, 1, "few")
        self.errors = publisher(self.service("error-report", ErrorReport, processes, 1, "few"))
        self.shutdown_reports = publisher(self.service("shutdown-report", ShutdownReport, processes, 1, "few"))
        self.built = publisher(self.service(f"external-built-{index}", ExternalBuilt, 1, 1, "lanes"))
        self.answers = publisher(self.service(f"external-answer-{index}", ExternalAnswer, 1, 1, "lanes"))
        subscribe = lambda *service: self.service(*service).subscriber_builder().create()
        self.episodes = subscribe(f"external-episode-{index}", ExternalEpisode, 1, 1, "lanes")
        self.queries = subscribe(f"external-query-{index}", ExternalQuery, 1, 1, "lanes")
        self.stops = subscribe("stop", Stop, 1, processes, "few")
        self.evictions = subscribe("eviction", Eviction, worlds, 2 + externals, "frames")
        frames = self.builder("frame").publish_subscribe(iox2.Slice[Page]).user_header(FrameHeader)
        frames = frames.payload_alignment(iox2.Alignment.new(PAGE_BYTES))
        self.frames = create(frames, worlds, 2 + externals, chunks, chunks).subscriber_builder().create()
        banks = self.builder(f"bank-{index}").publish_subscribe(iox2.Slice[U64]).user_header(BankHeader)
        self.banks = create(banks, 1, 1, 4 * lanes + 128, 4 * lanes + 128).subscriber_builder().create()
        notes = self.builder(f"note-{index}").publish_subscribe(iox2.Slice[U8]).user_header(NoteHeader)
        notes = create(notes, 1, 1, 1, self.queues["lanes"]).publisher_builder().initial_max_slice_len(4096)
        self.notes = limited(notes.allocation_strategy(iox2.AllocationStrategy.PowerOfTwo)).create()
        self.last_note, self.reported, self.received = 0, 0, 0

    def builder(self, name):
        return self.node.service_builder(iox2.ServiceName.new(f"{self.generation}/{name}"))

    def service(self, name, message, senders, receivers, queue):
        return create(self.builder(name).publish_subscribe(message), senders, receivers, 1, self.queues[queue])

    def events(self, name):
        events = self.builder(f"event/{name}").event().max_listeners(1).max_notifiers(self.roles)
        return events.max_nodes(self.roles + 1).event_id_max_value(0).open_or_create()

    def shake_hands(self):
        facts = json.dumps({"memory": DESCRIPTION["name"], "version": DESCRIPTION["version"]}).encode()
        while self.handshake.dynamic_config.number_of_subscribers == 0:
            time.sleep(0.001)
        self.handshakes = publisher(self.handshake)
        text = (U8 * 492)(*facts)
        send(self.handshakes, Handshake(WIRE_VERSION, EXTERNAL_MEMORY, os.getpid(), len(facts), self.index, text))
        self.orchestrator.notify()

    def serve(self):
        memories = {}
        lanes = {}  # for each its episode, then those that are announced
        while True:
            # Effects before causes: what a message refers to was sent before it.
            stops, queries = drain(self.stops, Stop), drain(self.queries, ExternalQuery)
            begun = drain(self.episodes, ExternalEpisode)
            while (sample := self.banks.receive()) is not None:
                self.build(sample, memories)
            while (sample := self.frames.receive()) is not None:
                self.received += 1  # this memory looks at no pixels, so it keeps no frame
            drain(self.evictions, Eviction)
            for episode in begun:
                lanes.setdefault(episode.lane, []).append(episode)
            for query in queries:
                known = lanes.get(query.lane, [])
                if all(episode.episode != query.episode for episode in known):
                    self.report(f"query of unknown episode {query.episode} in lane {query.lane}")
                    continue
                while known[0].episode != query.episode:  # its first query: the earlier ones are over
                    known.pop(0)
                if query.last:
                    known.pop(0)
                elif len(known) == 1:  # otherwise the lane awaits no answer: the next episode is announced
                    self.answer(query, known[0], memories.get(known[0].bank))
            if queries:
                self.host.notify()
            if stops:
                totals = {"frames_received": self.received, "error_reports": self.reported}
                send(self.shutdown_reports, ShutdownReport(role=EXTERNAL_MEMORY, index=self.index, **totals))
                self.orchestrator.notify()
                return
            if not Path(f"/proc/{self.orchestrator_pid}").exists():
                sys.exit("the run was abandoned")
            self.listener.timed_wait(iox2.Duration.from_millis(500))

    def build(self, sample, memories):
        """Builds a memory from a bank: for each demonstration its task and its states."""
        started, header = time.monotonic_ns(), BankHeader.from_address(sample.user_header_ptr)
        bank, count, steps = header.id, header.demonstrations, header.steps
        if count == 0:
            memories.pop(bank, None)
            return
        # Demonstrations, steps, embeddings and text follow each other, each from a multiple of 8 bytes.
        first_step = 16 * count
        first_byte = first_step + 96 * steps + (4 * steps * header.dimension + 7) // 8 * 8
        content = ctypes.string_at(sample.payload_ptr, first_byte + header.text_bytes)
        memory = []
        for part in (BankDemonstration * count).from_buffer_copy(content):
            if part.first_step + part.steps > steps:
                return self.report(f"bank {bank}: a demonstration lies outside of it")
            text = content[first_byte + part.first_byte :][: part.bytes].decode()
            part = (BankStep * part.steps).from_buffer_copy(content, first_step + 96 * part.first_step)
            memory.append((text, [list(step.state) for step in part]))
        memories[bank] = memory
        send(self.built, ExternalBuilt(bank=bank, took_ns=time.monotonic_ns() - started))
        self.host.notify()

    def answer(self, query, episode, memory):
        answer = ExternalAnswer(
            episode=query.episode, received_ns=time.monotonic_ns(), lane=query.lane, step=query.step, tokens=NOT_MEASURED)
        try:
            note = self.recall(query, episode, memory, answer)
        except ValueError as error:
            answer.failed, note = 1, str(error).encode()
        if note:
            answer.note = self.publish_note(query, note)
        answer.sent_ns = time.monotonic_ns()
        send(self.answers, answer)

    def recall(self, query, episode, memory, answer):
        """Writes the items into the answer, and returns their note."""
        if memory is None or episode.instruction_len > 232:
            raise ValueError(f"bank {episode.bank} or the instruction of {episode.instruction_len} bytes is unknown")
        now = list(query.state)
        if query.feedback >= len(self.world["feedback"]) or not self.is_state(now):
            raise ValueError(f"invalid values: feedback {query.feedback}, state {now}")
        places = ((self.distance(now, state), number, step)
                  for number, (_, states) in enumerate(memory) for step, state in enumerate(states))
        # Equal distances: the first demonstration and step, so that equal queries have equal answers.
        distance, number, first = min(places)
        task, states = memory[number]
        steps = min(SEGMENT, len(states) - first)
        # An item that does not fit into a budget would be dropped: without their views, steps always fit.
        # A distance that is told is one of views.
        answer.items[0] = AnswerItem(kind=STEPS, demonstration=number, first_step=first, steps=steps,
            distance=float("nan"), views=steps <= episode.image_budget, actions=1)
        answer.items_len = 1
        note = b""
        planned = min(len(states) - 1 - first, MAX_PLAN)
        if distance == 0 and planned > 0:
            # The agent stands where the expert stood: a plan of what the expert did from there to the end.
            note = bytes([NO_ACTION]) * planned
            self.add(answer, AnswerItem(kind=PLAN, bytes=planned), number, first, planned)
        text = f"From a demonstration of: {task}".encode()
        if len(text) <= episode.text_budget:
            self.add(answer, AnswerItem(kind=TEXT, first_byte=len(note), bytes=len(text)), number, first, steps)
            note += text
        return note

    def add(self, answer, item, demonstration, first, steps):
        """Adds an item without a distance that has these steps as its source."""
        item.distance = float("nan")
        answer.items[answer.items_len] = item
        answer.sources[answer.sources_len] = AnswerSource(
            item=answer.items_len, demonstration=demonstration, first_step=first, steps=steps)
        answer.items_len, answer.sources_len = answer.items_len + 1, answer.sources_len + 1

    def is_state(self, numbers):
        """Whether each number is one that the world's field can have, with zeros after them."""
        fields = self.world["state"]
        known = lambda field, number: number in range(len(field["words"])) if field.get("words") else math.isfinite(number)
        return all(map(known, fields, numbers)) and not any(numbers[len(fields):])

    def distance(self, one, other):
        """The sum of the differences; another word, such as another heading, counts half."""
        fields = self.world["state"]
        differences = (0.5 * (a != b) if field.get("words") else abs(a - b) for field, a, b in zip(fields, one, other))
        return sum(differences)

    def publish_note(self, query, text):
        loan = self.notes.loan_slice_uninit(len(text))
        ctypes.memmove(loan.payload_ptr, text, len(text))
        self.last_note += 1
        header = NoteHeader(id=self.last_note, episode=query.episode, lane=query.lane)
        ctypes.memmove(loan.user_header_ptr, ctypes.byref(header), ctypes.sizeof(header))
        loan.assume_init().send()
        return self.last_note

    def report(self, what):
        text, self.reported = what.encode()[:480], self.reported + 1
        send(self.errors, ErrorReport(role=EXTERNAL_MEMORY, count=self.reported, index=self.index,
            text_len=len(text), text=(U8 * 480)(*text)))
        self.orchestrator.notify()


def create(builder, senders, receivers, borrowed, buffer):
    return (builder.enable_safe_overflow(False).history_size(0).max_publishers(senders).max_subscribers(receivers)
            .max_nodes(senders + receivers).subscriber_max_borrowed_samples(borrowed)
            .subscriber_max_buffer_size(buffer).open_or_create())


def limited(builder):
    return builder.max_loaned_samples(1).backpressure_strategy(iox2.BackpressureStrategy.DiscardData)


def publisher(service):
    return limited(service.publisher_builder()).create()


def send(publisher, message):
    loan = publisher.loan_uninit()
    ctypes.memmove(loan.payload_ptr, ctypes.byref(message), ctypes.sizeof(message))
    if loan.assume_init().send() == 0:
        raise SystemExit("the receiver's queue is full, or the receiver is gone")


def drain(subscriber, message):
    messages = []
    while (sample := subscriber.receive()) is not None:
        messages.append(message.from_buffer_copy(ctypes.string_at(sample.payload_ptr, ctypes.sizeof(message))))
        sample = None  # a subscriber may borrow one sample of a message at a time
    return messages


def main():
    folder = Path(os.environ["MEMTRANSFER_ATTACH"])
    run, index = folder.parent, int(folder.name.removeprefix("memory-"))
    lock = os.open(run / "lock", os.O_RDONLY)
    # The run plans with the description, and writes attach.json later.
    draft = folder / "description.json.new"
    draft.write_text(json.dumps(DESCRIPTION))
    draft.rename(folder / "description.json")
    while not (run / "attach.json").exists():
        if not folder.exists():
            sys.exit("the run is over")
        time.sleep(0.02)
    fcntl.flock(lock, fcntl.LOCK_SH)
    joined = Run(run, index)
    joined.shake_hands()
    joined.serve()


if __name__ == "__main__":
    main()
