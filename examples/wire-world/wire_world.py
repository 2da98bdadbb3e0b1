"""A world on plain iceoryx2, without the package `memtransfer`. Everything it does is in docs/wire.md and docs/case-book.md.

This file is its part in a run; what happens in the world, and its case book, are in ring.py.
"""

import ctypes
import fcntl
import json
import os
import sys
import time
from pathlib import Path

import iceoryx2 as iox2
import ring
from blake3 import blake3

WIRE_VERSION, SIM = 16, 1
GOES_ON, COMPLETE, STEP_LIMIT = 0, 1, 2
ACT, STAY = 0, 1
PIN, RELEASE = 0, 1
NO_ACTION, NO_FRAME, NO_DOCUMENT = 255, 0, 0
PAGE_BYTES = 4096
U8, U16, U32, U64, F32 = ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_uint64, ctypes.c_float


def struct(name, size, fields):
    """The structure of this name; `fields` are written as in the page's tables."""
    types = {"u8": U8, "u16": U16, "u32": U32, "u64": U64, "f32": F32}
    members = []
    for field in fields.split(","):
        member, kind = field.strip().split(": ")
        kind, _, count = kind.partition(" x ")
        members.append((member, types[kind] * int(count) if count else types[kind]))
    made = type(name, (ctypes.Structure,), {"_fields_": members, "type_name": staticmethod(lambda: f"memtransfer.{name}")})
    assert ctypes.sizeof(made) == size, f"{name} has {ctypes.sizeof(made)} bytes instead of {size}"
    return made


FrameHeader = struct("FrameHeader", 32, "id: u64, width: u32, height: u32, content_hash: u8 x 16")
NoteHeader = struct("NoteHeader", 24, "id: u64, episode: u64, lane: u32, reserved: u32")
Page = struct("Page", PAGE_BYTES, "pixels: u8 x 4096")
Eviction = struct("Eviction", 8, "frame: u64")
Stop = struct("Stop", 8, "reserved: u64")
Handshake = struct("Handshake", 512, "wire_version: u32, role: u32, pid: u32, facts_len: u32, index: u32, facts: u8 x 492")
ErrorReport = struct("ErrorReport", 512, """episode: u64, role: u32, count: u32, kind: u32, lane: u32, text_len: u32,
    index: u32, text: u8 x 480""")
ShutdownReport = struct("ShutdownReport", 48, """role: u32, index: u32, frames_rendered: u64, frames_evicted: u64,
    frames_received: u64, pixel_bytes_copied: u64, error_reports: u64""")
WorldEpisodeConfig = struct("WorldEpisodeConfig", 56, """episode: u64, seed: u64, sequence: u64, sent_ns: u64, lane: u32,
    case: u32, variant: u32, max_steps: u32, position: u32, start: u8, learns: u8, reserved: u8 x 2""")
StepCommand = struct("StepCommand", 32, "episode: u64, sent_ns: u64, lane: u32, step: u32, kind: u8, action: u8, reserved: u8 x 6")
StepReport = struct("StepReport", 88, """episode: u64, frame: u64, facts: u64, commanded_ns: u64, woken_ns: u64, stepped_ns: u64,
    rendered_ns: u64, sent_ns: u64, state_hash: u64, lane: u32, step: u32, sub_goals: u16, required: u16, ended: u8,
    conflict: u8, reserved: u8 x 2""")
Observation = struct("Observation", 96, """episode: u64, frame: u64, lane: u32, step: u32, state: f32 x 16, feedback: u8,
    action: u8, last: u8, reserved: u8 x 5""")
ViewRequest = struct("ViewRequest", 32, "frame: u64, sequence: u64, demonstration: u32, step: u32, kind: u8, reserved: u8 x 7")
View = struct("View", 24, "frame: u64, sequence: u64, demonstration: u32, step: u32")


class Run:
    """The world's place in a run."""

    def __init__(self, folder, demonstrations):
        self.attach = attach = json.loads((folder / "attach.json").read_text())
        if attach["wire_version"] != WIRE_VERSION:
            raise SystemExit(f"this run speaks wire version {attach['wire_version']}, not {WIRE_VERSION}")
        self.lock = os.open(folder / "lock", os.O_RDONLY)
        fcntl.flock(self.lock, fcntl.LOCK_SH)
        self.demonstrations = json.loads(demonstrations.read_text())["demonstrations"]
        self.width, self.height = attach["frame"]["width"], attach["frame"]["height"]
        lanes, capacity = attach["lanes"], attach["frame_capacity"]
        worlds, externals = attach["worlds"], len(attach.get("external_memories", ()))
        self.index = int(os.environ.get("MEMTRANSFER_WORLD_INDEX", 0))
        config = iox2.config.default()
        config.global_cfg.prefix = iox2.FileName.new(attach["prefix"])
        config.global_cfg.root_path = iox2.Path.new(str(folder))
        config.defaults.publish_subscribe.subscriber_expired_connection_buffer = 12 + 4 * (worlds + externals)
        self.node = iox2.NodeBuilder.new().config(config).create(iox2.ServiceType.Ipc)
        chunks = capacity + 32 + capacity // 8 + lanes + 16
        self.queues, self.roles = {"lanes": 2 * lanes + 16, "frames": 2 * chunks, "few": 256}, 3 + worlds + externals

        self.listener = self.events(f"sim-{self.index}").listener_builder().create()
        self.notifiers = {role: self.events(role).notifier_builder().create() for role in ("memory", "policy", "orchestrator")}
        processes, consumers, both = 2 + worlds + externals, 2 + externals, ("memory", "policy")
        publish = lambda to, *service: self.publisher(self.service(*service).publisher_builder(), to)
        self.handshake = self.service("handshake", Handshake, processes, 1, "few")
        self.errors = publish(("orchestrator",), "error-report", ErrorReport, processes, 1, "few")
        self.totals = publish(("orchestrator",), "shutdown-report", ShutdownReport, processes, 1, "few")
        self.observations = publish(both, "observation", Observation, worlds, 2, "lanes")
        self.reports = publish(("memory", "orchestrator"), "step-report", StepReport, worlds, 2, "lanes")
        self.views = publish(("memory",), "view", View, worlds, 1, "frames")
        self.evictions = publish(both, "eviction", Eviction, worlds, consumers, "frames")
        notes = self.builder("episode-facts").publish_subscribe(iox2.Slice[U8]).user_header(NoteHeader)
        notes = create(notes, worlds, 1, 1, self.queues["lanes"]).publisher_builder().initial_max_slice_len(4096)
        self.notes = self.publisher(notes.allocation_strategy(iox2.AllocationStrategy.PowerOfTwo), ("orchestrator",))
        frames = self.builder("frame").publish_subscribe(iox2.Slice[Page]).user_header(FrameHeader)
        frames = create(frames.payload_alignment(iox2.Alignment.new(PAGE_BYTES)), worlds, consumers, chunks, chunks).publisher_builder()
        self.pages = -(-4 * self.width * self.height // PAGE_BYTES)
        frames = frames.initial_max_slice_len(self.pages).override_sample_preallocation(chunks)
        self.frames = self.publisher(frames, both)
        subscribe = lambda *service: self.service(*service).subscriber_builder().create()
        self.configs = subscribe(f"world-config-{self.index}", WorldEpisodeConfig, 1, 1, "lanes")
        self.commands = subscribe(f"command-{self.index}", StepCommand, 1, 1, "lanes")
        self.requests = subscribe(f"view-request-{self.index}", ViewRequest, 1, 1, "frames")
        self.stops = subscribe("stop", Stop, 1, processes, "few")
        self.lanes = [None] * lanes  # for each its episode: config, agent, states, and the pictures that may be named
        self.resident, self.pins = {}, []  # pictures with their frames; what memory has pinned
        self.published = self.evicted = self.reported = 0
        self.last_note = self.index << 56  # of no other world

    def builder(self, name):
        return self.node.service_builder(iox2.ServiceName.new(f"{self.attach['generation']}/{name}"))

    def service(self, name, message, senders, receivers, queue):
        return create(self.builder(name).publish_subscribe(message), senders, receivers, 1, self.queues[queue])

    def events(self, role):
        events = self.builder(f"event/{role}").event().max_listeners(1).max_notifiers(self.roles)
        return events.max_nodes(self.roles + 1).event_id_max_value(0).open_or_create()

    def publisher(self, builder, receivers):
        """A publisher, and the number of receivers that take part: without one of them, a message is lost."""
        builder = builder.max_loaned_samples(1).backpressure_strategy(iox2.BackpressureStrategy.DiscardData)
        return builder.create(), sum(role in (*self.attach["participants"], "orchestrator") for role in receivers)

    def shake_hands(self):
        facts = json.dumps({"world": "ring 1"}).encode()
        while self.handshake.dynamic_config.number_of_subscribers == 0:
            time.sleep(0.001)
        self.handshakes = self.publisher(self.handshake.publisher_builder(), ("orchestrator",))
        send(self.handshakes, Handshake(WIRE_VERSION, SIM, os.getpid(), len(facts), self.index, (U8 * 492)(*facts)))
        self.notifiers["orchestrator"].notify()

    def serve(self):
        while True:
            self.woken, self.to_notify = time.monotonic_ns(), set()
            # Effects before causes: what a message refers to was sent before it.
            stops, requests = drain(self.stops, Stop), drain(self.requests, ViewRequest)
            commands, configs = drain(self.commands, StepCommand), drain(self.configs, WorldEpisodeConfig)
            if stops:
                totals = {"frames_rendered": self.published, "frames_evicted": self.evicted, "error_reports": self.reported}
                send(self.totals, ShutdownReport(role=SIM, index=self.index, **totals))
                return self.notifiers["orchestrator"].notify()
            for take, messages in ((self.remember, requests), (self.begin, configs), (self.act, commands)):
                for message in messages:
                    take(message)
            for role in self.to_notify:
                self.notifiers[role].notify()
            if not Path(f"/proc/{self.attach['orchestrator_pid']}").exists():
                sys.exit("the run was abandoned")
            self.listener.timed_wait(iox2.Duration.from_millis(500))

    def begin(self, config):
        is_known = config.lane < len(self.lanes) and config.case < len(ring.IDS) and config.start < len(ring.STARTS)
        if not is_known or config.variant not in (0, 1 + config.case):
            return self.report(f"a config of lane {config.lane}, case {config.case}, variant {config.variant}, start {config.start}")
        agent = ring.Ring(config.case, "new" if config.start or config.variant else "original", config.variant > 0)
        self.lanes[config.lane] = config, agent, [], []
        self.tell(config, NO_ACTION)

    def act(self, command):
        lane = self.lanes[command.lane] if command.lane < len(self.lanes) else None
        config, agent, states, _ = lane or (None, None, [], [])
        if config and command.episode != config.episode:
            return None  # it is late: the lane has gone on
        is_next = config and command.step == len(states)
        is_stay = (command.kind, command.action) == (STAY, NO_ACTION)
        if not is_next or not is_stay and (command.kind != ACT or command.action not in (ring.RIGHT, ring.LEFT)):
            return self.report(f"a command for lane {command.lane}, episode {command.episode}, step {command.step}")
        agent.step(None if is_stay else command.action)
        self.tell(command, command.action)

    def tell(self, cause, action):
        """Tells the others what follows from a config or a command."""
        (config, agent, states, shown), stepped = self.lanes[cause.lane], time.monotonic_ns()
        step, frame, note = len(states), NO_FRAME, NO_DOCUMENT
        states.append(agent.state())
        ended = COMPLETE if agent.is_complete() else STEP_LIMIT if step >= config.max_steps else GOES_ON
        if ended:
            note, self.lanes[cause.lane] = self.publish_note(cause, json.dumps(ring.facts(states)).encode()), None
        else:
            shown.append((agent.cell, agent.has_wall) if self.attach["frame_control"] == "rendered" else None)
            del shown[: -self.attach["window"] - 2]
            frame = self.show(shown[-1])
        now, place = time.monotonic_ns(), {"episode": cause.episode, "lane": cause.lane, "step": step, "frame": frame}
        send(self.reports, StepReport(**place, facts=note, commanded_ns=cause.sent_ns, woken_ns=self.woken, stepped_ns=stepped,
            rendered_ns=now, sent_ns=now, state_hash=agent.state_hash() if ended or step == 0 else 0, sub_goals=agent.visited,
            required=len(agent.places), ended=ended, conflict=agent.conflict))
        send(self.observations, Observation(**place, state=(F32 * 16)(*agent.state()), feedback=agent.feedback, action=action,
            last=ended != GOES_ON))
        # Memory's own notification tells the policy, and the policy's the orchestrator.
        self.to_notify |= {"memory", "orchestrator"} if ended or "policy" not in self.attach["participants"] else {"memory"}

    def remember(self, request):
        """Pins a view for memory, or releases it."""
        pinned = [picture for picture in self.pins if self.resident[picture] == request.frame]
        known = self.demonstrations[request.demonstration]["states"] if request.demonstration < len(self.demonstrations) else []
        if request.kind == RELEASE and pinned:
            self.pins.remove(pinned[0])
        elif request.kind == PIN and request.sequence == 0 and request.step < len(known):
            picture = (known[request.step][0], False) if self.attach["frame_control"] != "blank-all" else None
            self.pins.append(picture)
            send(self.views, View(self.show(picture), request.sequence, request.demonstration, request.step))
            self.to_notify.add("memory")
        else:
            self.report(f"a view request of kind {request.kind}, frame {request.frame}, step {request.step} of {request.demonstration}")

    def show(self, picture):
        """The frame of a picture, which is drawn if it is not resident."""
        if picture not in self.resident:
            in_use = {picture, *self.pins}.union(*(lane[3] for lane in self.lanes if lane))
            idle = [old for old in self.resident if old not in in_use]  # the one drawn first at first
            for old in idle[: max(0, len(self.resident) + 1 - self.attach["frame_capacity"])]:
                send(self.evictions, Eviction(self.resident.pop(old)))
                self.evicted += 1
                self.to_notify |= {"memory", "policy"}
            self.resident[picture] = self.draw(picture)
        return self.resident[picture]

    def draw(self, picture):
        loan = self.frames[0].loan_slice_uninit(self.pages)
        row = ring.pixel_row(picture, self.width)
        for y in range(self.height):  # straight into shared memory
            ctypes.memmove(loan.payload_ptr + y * len(row), row, len(row))
        pixels = (U8 * (self.height * len(row))).from_address(loan.payload_ptr)
        self.published += 1
        frame = self.attach["generation"] << 40 | self.index << 36 | self.published  # of no other generation and world
        header = FrameHeader(frame, self.width, self.height, (U8 * 16)(*blake3(memoryview(pixels).cast("B")).digest()[:16]))
        deliver(self.frames, loan, loan.user_header_ptr, header)
        return frame

    def publish_note(self, cause, text):
        loan = self.notes[0].loan_slice_uninit(len(text))
        ctypes.memmove(loan.payload_ptr, text, len(text))
        self.last_note += 1
        deliver(self.notes, loan, loan.user_header_ptr, NoteHeader(id=self.last_note, episode=cause.episode, lane=cause.lane))
        return self.last_note

    def report(self, what):
        text, self.reported = f"not understood: {what}".encode()[:480], self.reported + 1
        send(self.errors, ErrorReport(role=SIM, index=self.index, count=self.reported, text_len=len(text), text=(U8 * 480)(*text)))
        self.to_notify.add("orchestrator")


def create(builder, senders, receivers, borrowed, buffer):
    return (builder.enable_safe_overflow(False).history_size(0).max_publishers(senders).max_subscribers(receivers)
            .max_nodes(senders + receivers).subscriber_max_borrowed_samples(borrowed)
            .subscriber_max_buffer_size(buffer).open_or_create())


def send(publisher, message):
    loan = publisher[0].loan_uninit()
    deliver(publisher, loan, loan.payload_ptr, message)


def deliver(publisher, loan, address, message):
    ctypes.memmove(address, ctypes.byref(message), ctypes.sizeof(message))
    if loan.assume_init().send() < publisher[1]:
        raise SystemExit("a receiver's queue is full, or a receiver is gone")


def drain(subscriber, message):
    messages = []
    while (sample := subscriber.receive()) is not None:
        messages.append(message.from_buffer_copy(ctypes.string_at(sample.payload_ptr, ctypes.sizeof(message))))
        sample = None  # a subscriber may borrow one sample of a message at a time
    return messages


def main():
    match sys.argv[1:]:
        case ["book", "--request", request, "--out", out]:
            ring.write_book(Path(request), Path(out))
        case ["serve", "--demonstrations", demonstrations]:
            run = Run(Path(os.environ["MEMTRANSFER_ATTACH"]), Path(demonstrations))
            run.shake_hands()
            run.serve()
        case ["views", "--size", size]:
            width, height = map(int, size.split("x"))
            for line in sys.stdin:
                sys.stdout.buffer.write(ring.pixel_row(ring.picture_after(line.rstrip("\n")), width) * height)
                sys.stdout.buffer.flush()
        case ["act"]:
            for line in sys.stdin:
                try:
                    told = ring.answer(json.loads(line))
                except ValueError as problem:
                    told = {"error": str(problem)}
                print(json.dumps(told), flush=True)
        case _:
            sys.exit("usage: wire_world.py book --request FILE --out DIR | serve --demonstrations FILE | views --size WIDTHxHEIGHT | act")


if __name__ == "__main__":
    main()
