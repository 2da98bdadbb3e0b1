"""A policy on plain iceoryx2, without the package `memtransfer`. Everything it does is in docs/wire.md.

It follows a plan of the memory, or the expert's action in the retrieved view, if the expert had the same task. Otherwise it walks ahead, and turns where
its last move was blocked or where it sees nothing.
"""

import ctypes
import fcntl
import json
import os
import time
from pathlib import Path

import iceoryx2 as iox2

WIRE_VERSION = 16
ROLES = ("orchestrator", "sim", "memory", "policy", "external-memory")
POLICY = ROLES.index("policy")
NO_ACTION, ACTED = 255, 0
STEPS, PLAN = 1, 4  # the kinds of items that have their steps in the message, and their actions in a document
NOT_MEASURED = 2**32 - 1
PAGE_BYTES = 4096
U8, U32, U64, F32 = ctypes.c_uint8, ctypes.c_uint32, ctypes.c_uint64, ctypes.c_float


def struct(name, size, fields):
    """The structure of this name; `fields` are written as in the page's tables."""
    types = {"u8": U8, "u32": U32, "u64": U64, "f32": F32}
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


RecalledItem = struct("RecalledItem", 32, """document: u64, distance: f32, first_step: u32, steps: u32, first_byte: u32,
    bytes: u32, kind: u8, whole: u8, first_instruction: u8, instructions: u8""")
RecalledInstruction = struct("RecalledInstruction", 16, "document: u64, first_byte: u32, bytes: u32")
SegmentStep = struct("SegmentStep", 16, "frame: u64, action: u8, reserved: u8 x 7")
TrajectoryStep = struct("TrajectoryStep", 16, "frame: u64, action: u8, trajectory: u8, own: u8, reserved: u8 x 5")
FrameHeader = struct("FrameHeader", 32, "id: u64, width: u32, height: u32, content_hash: u8 x 16")
Page = struct("Page", PAGE_BYTES, "pixels: u8 x 4096")
DocumentHeader = struct("DocumentHeader", 24, "id: u64, episode: u64, lane: u32, kind: u32")
Eviction = struct("Eviction", 8, "frame: u64")
Stop = struct("Stop", 8, "reserved: u64")
Handshake = struct("Handshake", 512, """wire_version: u32, role: u32, pid: u32, facts_len: u32,
    index: u32, facts: u8 x 492""")
ShutdownReport = struct("ShutdownReport", 48, """role: u32, index: u32, frames_rendered: u64,
    frames_evicted: u64, frames_received: u64, pixel_bytes_copied: u64, error_reports: u64""")
PolicyEpisodeConfig = struct("PolicyEpisodeConfig", 264, """episode: u64, seed: u64, lane: u32, instruction_len: u32,
    repeat: u32, starts_as_demonstrated: u8, window: u8, demonstrated_elsewhere: u8, reserved: u8, instruction: u8 x 232""")
Observation = struct("Observation", 96, """episode: u64, frame: u64, lane: u32, step: u32, state: f32 x 16,
    feedback: u8, action: u8, last: u8, reserved: u8 x 5""")
Recall = struct("Recall", 1312, """episode: u64, lane: u32, step: u32, items_len: u32, steps_len: u32, instructions_len: u32,
    reserved: u32, items: RecalledItem x 8, steps: SegmentStep x 48, instructions: RecalledInstruction x 16""")
Decision = struct("Decision", 272, """episode: u64, received_ns: u64, started_ns: u64, prompted_ns: u64, sent_ns: u64,
    decided_ns: u64, lane: u32, step: u32, prompt_tokens: u32, completion_tokens: u32, cached_tokens: u32,
    image_tokens: u32, memory_tokens: u32, reusable_tokens: u32, images_asked: u32, images: u32, attempts: u32, outcome: u8,
    action: u8, replayed: u8, reasoning: u8, finish_reason_len: u8, model_len: u8, finish_reason: u8 x 46, model: u8 x 128""")


class Run:
    """The policy's place in a run."""

    def __init__(self, folder):
        attach = json.loads((folder / "attach.json").read_text())
        if attach["wire_version"] != WIRE_VERSION:
            raise SystemExit(f"this run speaks wire version {attach['wire_version']}, not {WIRE_VERSION}")
        world = json.loads((folder / "world.json").read_text())
        # A code is a place in the world's lists.
        actions = [action["words"] for action in world["actions"]]
        self.forward, self.turn_left = actions.index("move forward"), actions.index("turn left")
        self.blocked = world["feedback"].index("Something blocks the way: you did not move.")
        self.lock = os.open(folder / "lock", os.O_RDONLY)
        fcntl.flock(self.lock, fcntl.LOCK_SH)
        config = iox2.config.default()
        config.global_cfg.prefix = iox2.FileName.new(attach["prefix"])
        config.global_cfg.root_path = iox2.Path.new(str(folder))
        # External memories send and receive some messages, too, and there may be several simulators.
        worlds, memories = attach["worlds"], len(attach.get("external_memories", ()))
        processes = 2 + worlds + memories
        self.notifiers = 1 + processes
        config.defaults.publish_subscribe.subscriber_expired_connection_buffer = 4 * self.notifiers
        self.node = iox2.NodeBuilder.new().config(config).create(iox2.ServiceType.Ipc)
        self.generation = attach["generation"]
        self.orchestrator_process = Path(f"/proc/{attach['orchestrator_pid']}")
        lanes, capacity = attach["lanes"], attach["frame_capacity"]
        chunks = capacity + 32 + capacity // 8 + lanes + 16
        self.queues = {"lanes": 2 * lanes + 16, "frames": 2 * chunks, "few": 256}

        self.listener = self.events("policy").listener_builder().create()
        self.orchestrator = self.events("orchestrator").notifier_builder().create()
        self.handshake = self.service("handshake", Handshake, processes, 1, "few")
        self.decisions = publisher(self.service("decision", Decision, 1, 1, "lanes"))
        self.shutdown_reports = publisher(self.service("shutdown-report", ShutdownReport, processes, 1, "few"))
        subscribe = lambda *service: self.service(*service).subscriber_builder().create()
        self.configs = subscribe("policy-config", PolicyEpisodeConfig, 1, 1, "lanes")
        self.observations = subscribe("observation", Observation, worlds, 2, "lanes")
        self.recalls = subscribe("recall", Recall, 1, 1, "lanes")
        self.stops = subscribe("stop", Stop, 1, processes, "few")
        self.evictions = subscribe("eviction", Eviction, worlds, 2 + memories, "frames")
        frames = self.builder("frame").publish_subscribe(iox2.Slice[Page]).user_header(FrameHeader)
        frames = frames.payload_alignment(iox2.Alignment.new(PAGE_BYTES))
        self.frames = create(frames, worlds, 2 + memories, chunks, chunks).subscriber_builder().create()
        documents = self.builder("document").publish_subscribe(iox2.Slice[U8]).user_header(DocumentHeader)
        self.documents = create(documents, 1, 1, 1, 4 * lanes + 64).subscriber_builder().create()

    def builder(self, name):
        return self.node.service_builder(iox2.ServiceName.new(f"{self.generation}/{name}"))

    def service(self, name, message, senders, receivers, queue):
        return create(self.builder(name).publish_subscribe(message), senders, receivers, 1, self.queues[queue])

    def events(self, role):
        events = self.builder(f"event/{role}").event().max_listeners(1).max_notifiers(self.notifiers)
        return events.max_nodes(self.notifiers + 1).event_id_max_value(0).open_or_create()

    def shake_hands(self):
        facts = json.dumps({"policy": "wire-witness"}).encode()
        while self.handshake.dynamic_config.number_of_subscribers == 0:
            time.sleep(0.001)
        self.handshakes = publisher(self.handshake)
        send(self.handshakes, Handshake(WIRE_VERSION, POLICY, os.getpid(), len(facts), 0, (U8 * 492)(*facts)))
        self.orchestrator.notify()

    def serve(self):
        configs, observations, recalls, frames, documents, received = {}, {}, {}, {}, {}, 0
        while True:
            # Effects before causes: what a message refers to was sent before it.
            stops, evictions = drain(self.stops, Stop), drain(self.evictions, Eviction)
            recalls.update((recall.lane, recall) for recall in drain(self.recalls, Recall))
            observations.update((seen.lane, seen) for seen in drain(self.observations, Observation))
            for config in drain(self.configs, PolicyEpisodeConfig):
                ended = configs[config.lane].episode if config.lane in configs else None
                documents = {id: document for id, document in documents.items() if document[0] != ended}
                configs[config.lane] = config
            while (sample := self.frames.receive()) is not None:
                frames[FrameHeader.from_address(sample.user_header_ptr).id] = sample
                received += 1
            while (sample := self.documents.receive()) is not None:
                header = DocumentHeader.from_address(sample.user_header_ptr)
                documents[header.id] = header.episode, bytes(sample.payload().as_memory_view())
                sample = None  # a subscriber may borrow one at a time
            answered = 0
            for lane, observation in list(observations.items()):
                step = (observation.episode, observation.step)
                config, recall = configs.get(lane), recalls.get(lane)
                if observation.last:
                    del observations[lane]
                elif config and recall and config.episode == recall.episode and (recall.episode, recall.step) == step:
                    instruction = bytes(config.instruction[:config.instruction_len])
                    segment = planned_step(recall, documents) or same_task_segment(recall, instruction, documents)
                    self.answer(observation, segment, frames[observation.frame])
                    del observations[lane], recalls[lane]
                    answered += 1
            for eviction in evictions:
                frames.pop(eviction.frame, None)
            if stops:
                send(self.shutdown_reports, ShutdownReport(role=POLICY, frames_received=received))
            if stops or answered:
                self.orchestrator.notify()
            if stops or not self.orchestrator_process.exists():
                return
            # A recall may arrive shortly before its observation.
            self.listener.timed_wait(iox2.Duration.from_millis(1 if recalls else 1000))

    def answer(self, observation, segment, frame):
        started = time.monotonic_ns()
        action = self.decide(observation, segment, frame)
        unknown = ("images_asked", "attempts", "prompt_tokens", "completion_tokens", "cached_tokens", "image_tokens", "memory_tokens",
                   "reusable_tokens")
        send(self.decisions, Decision(
            episode=observation.episode, lane=observation.lane, step=observation.step, received_ns=started,
            started_ns=started, decided_ns=time.monotonic_ns(), images=1, outcome=ACTED,
            action=action, **dict.fromkeys(unknown, NOT_MEASURED)))

    def decide(self, observation, segment, frame):
        if segment and segment.action != NO_ACTION:
            return segment.action
        # The pixels are shared memory: only the row on the horizon is copied.
        header = FrameHeader.from_address(frame.user_header_ptr)
        start = 4 * header.width * (header.height // 2)
        horizon = ctypes.string_at(frame.payload_ptr + start, 4 * header.width)
        is_blank = horizon == horizon[:4] * header.width
        return self.turn_left if is_blank or observation.feedback == self.blocked else self.forward


def planned_step(recall, documents):
    """The first step of the first plan, if there is one."""
    for item in recall.items[:recall.items_len]:
        _, document = documents.get(item.document, (None, b""))
        if item.kind == PLAN and ctypes.sizeof(TrajectoryStep) * (item.first_step + item.steps) <= len(document):
            return TrajectoryStep.from_buffer_copy(document, ctypes.sizeof(TrajectoryStep) * item.first_step)
    return None


def same_task_segment(recall, instruction, documents):
    """The first step of the retrieved part of a demonstration of this task, if there is one."""
    for item in recall.items[:recall.items_len]:
        if item.kind == STEPS and item.first_step < recall.steps_len and item.first_instruction < recall.instructions_len:
            place = recall.instructions[item.first_instruction]
            _, document = documents.get(place.document, (None, b""))
            if document[place.first_byte:place.first_byte + place.bytes] == instruction:
                return recall.steps[item.first_step]
    return None


def create(builder, senders, receivers, borrowed, buffer):
    return (builder.enable_safe_overflow(False).history_size(0).max_publishers(senders).max_subscribers(receivers)
            .max_nodes(senders + receivers).subscriber_max_borrowed_samples(borrowed)
            .subscriber_max_buffer_size(buffer).open_or_create())


def publisher(service):
    discard = iox2.BackpressureStrategy.DiscardData
    return service.publisher_builder().max_loaned_samples(1).backpressure_strategy(discard).create()


def send(publisher, message):
    loan = publisher.loan_uninit()
    ctypes.memmove(loan.payload_ptr, ctypes.byref(message), ctypes.sizeof(message))
    if loan.assume_init().send() == 0:
        raise SystemExit("the orchestrator's queue is full, or the orchestrator is gone")


def drain(subscriber, message):
    messages = []
    while (sample := subscriber.receive()) is not None:
        messages.append(message.from_buffer_copy(ctypes.string_at(sample.payload_ptr, ctypes.sizeof(message))))
        sample = None  # a subscriber may borrow one sample of a message at a time
    return messages


if __name__ == "__main__":
    run = Run(Path(os.environ["MEMTRANSFER_ATTACH"]))
    run.shake_hands()
    run.serve()
