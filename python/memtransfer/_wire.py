"""The wire: structures, codes and constants, as docs/wire.md explains them.

Generated from the Rust code, do not edit:

    cargo run --release -p shm-types --example wire -- --write
"""

from __future__ import annotations

import ctypes
import enum
from typing import NamedTuple

#: Version of everything described here.
WIRE_VERSION = 4

#: The action code that says: no action was taken.
NO_ACTION = 255

#: A count that was not measured. Absent, never zero.
NOT_MEASURED = 4294967295

#: The frame id that names no frame.
NO_FRAME = 0

#: The document id that names no document.
NO_DOCUMENT = 0

#: Most window entries of a recall.
MAX_WINDOW = 32

#: Most entries of a recall's segment.
MAX_SEGMENT = 32

#: Most documents that a recall names.
MAX_DOCUMENTS = 4

#: Most bytes of an instruction.
MAX_INSTRUCTION = 232

#: Most bytes of a document.
MAX_DOCUMENT_BYTES = 16777216

#: Most lanes of a run.
MAX_LANES = 4096

#: Most frames that a run keeps resident.
MAX_FRAMES = 1048576

#: Frames that the simulator fills at the same time.
MAX_LOANED_FRAMES = 32

#: Longest path of a run's folder, in bytes.
MAX_ROOT_BYTES = 48

#: Bytes of a page; frames are whole pages, aligned to as much.
PAGE_BYTES = 4096

#: Last part of the name of the service that carries frames.
FRAME_SERVICE = "frame"

#: Last part of the name of the service that carries documents.
DOCUMENT_SERVICE = "document"

#: The file in a run's folder that says how to join it.
ATTACH_FILE = "attach.json"


class Action(enum.IntEnum):
    """What an agent can do in one step: seven actions."""

    #: One cell along the heading.
    FORWARD = 0
    #: One cell against the heading, still facing it.
    BACKWARD = 1
    #: One cell to the left, heading kept.
    LEFT = 2
    #: One cell to the right, heading kept.
    RIGHT = 3
    #: A quarter turn anticlockwise in place.
    TURN_LEFT = 4
    #: A quarter turn clockwise in place.
    TURN_RIGHT = 5
    #: A half turn in place.
    TURN_AROUND = 6

    @property
    def words(self) -> str:
        """The words for it."""
        return {
            0: "move forward",
            1: "move backward",
            2: "move left",
            3: "move right",
            4: "turn left",
            5: "turn right",
            6: "turn around",
        }[self.value]


class Feedback(enum.IntEnum):
    """What the world says about the last action. It never says that a target was reached."""

    #: The episode has just begun; there was no action.
    START = 0
    #: The move succeeded.
    MOVED = 1
    #: The turn was made (turns always succeed).
    TURNED = 2
    #: Something stood in the way: the agent stayed where it was, and the step counts.
    BLOCKED = 3
    #: The policy's answer could not be read: the agent stayed where it was, and the step counts.
    NOT_UNDERSTOOD = 4

    @property
    def words(self) -> str:
        """The words for it."""
        return {
            0: "The episode has just begun.",
            1: "You moved.",
            2: "You turned.",
            3: "Something blocks the way: you did not move.",
            4: "Your last answer was not understood: you did not move.",
        }[self.value]


class Heading(enum.IntEnum):
    """One of the four ways an agent can face."""

    #: North: y grows.
    N = 0
    #: East: x grows.
    E = 1
    #: South: y falls.
    S = 2
    #: West: x falls.
    W = 3

    @property
    def words(self) -> str:
        """The words for it."""
        return {
            0: "north",
            1: "east",
            2: "south",
            3: "west",
        }[self.value]


class Representation(enum.IntEnum):
    """A memory representation."""

    #: The window alone: no memory of demonstrations.
    WORKING = 0
    #: Every action of the case's demonstrations, and keyframes.
    FULL_CONTEXT = 1
    #: One document of object locations, landmarks and routes.
    SUMMARY = 2
    #: One document of general spatial and navigation knowledge.
    SEMANTIC = 3
    #: The summary and the semantic document.
    HYBRID = 4
    #: The stored view nearest to the current one, and the expert's continuation.
    EPISODIC = 5

    @property
    def words(self) -> str:
        """The words for it."""
        return {
            0: "working",
            1: "full-context",
            2: "summary",
            3: "semantic",
            4: "hybrid",
            5: "episodic",
        }[self.value]


class StepKind(enum.IntEnum):
    """What a StepCommand asks for."""

    #: Put the agent at the start pose.
    RESET = 0
    #: Take the action.
    ACT = 1
    #: Stay: the policy's answer could not be read.
    STAY = 2


class ViewRequestKind(enum.IntEnum):
    """What a ViewRequest asks for."""

    #: Make the view resident and keep it.
    HOLD = 0
    #: It may be evicted again.
    RELEASE = 1


class Outcome(enum.IntEnum):
    """How a decision came out. Infrastructure failures are retried by the policy and reported as
    Complaints: they are never an outcome of the model.
    """

    #: An action was chosen.
    ACTED = 0
    #: There was an answer, and no action could be read from it.
    UNREADABLE = 1
    #: The answer was empty.
    EMPTY = 2
    #: The model refused.
    REFUSED = 3

    @property
    def words(self) -> str:
        """The words for it."""
        return {
            0: "acted",
            1: "unreadable",
            2: "empty",
            3: "refused",
        }[self.value]


class ComplaintKind(enum.IntEnum):
    """What follows from a Complaint."""

    #: A message could not be used; it was dropped, and nothing else follows.
    MESSAGE = 0
    #: No decision will come for this episode's step: for a reason that is not the policy's, such as
    #: a server that refuses the request. The episode ends without a result.
    EPISODE = 1
    #: There is no point in going on with the run now, whatever the episode: a server that is gone.
    RUN = 2


class Role(enum.IntEnum):
    """A process's part in a run."""

    #: Sequences the steps; the program memtransfer.
    ORCHESTRATOR = 0
    #: Steps the world and renders.
    SIM = 1
    #: Embeds and retrieves.
    MEMORY = 2
    #: Decides.
    POLICY = 3

    @property
    def words(self) -> str:
        """The words for it."""
        return {
            0: "orchestrator",
            1: "sim",
            2: "memory",
            3: "policy",
        }[self.value]


class SegmentContent(enum.IntEnum):
    """What a retrieved segment holds."""

    #: The expert's actions and the views they led to.
    ACTIONS = 0
    #: The views alone.
    IMAGES = 1


class DocumentKind(enum.IntEnum):
    """What a Document is."""

    #: Object locations, landmarks and routes: UTF-8 text.
    SUMMARY = 0
    #: General spatial and navigation knowledge: UTF-8 text.
    SEMANTIC = 1
    #: Demonstrations with their keyframes: TrajectorySteps.
    TRAJECTORIES = 2


class WirePose(ctypes.Structure):
    """A pose: the cell stood on and the way faced."""

    #: Column, growing east.
    x: int
    #: Row, growing north.
    y: int
    #: Code of the Heading.
    heading: int
    #: Zero.
    reserved: int

    _fields_ = [
        ("x", ctypes.c_uint8),
        ("y", ctypes.c_uint8),
        ("heading", ctypes.c_uint8),
        ("reserved", ctypes.c_uint8),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.WirePose"


class PastStep(ctypes.Structure):
    """One past step: the view it was taken from, what was done there, and what the world answered."""

    #: The view before the action.
    frame: int
    #: Code of the Action taken, or NO_ACTION.
    action: int
    #: Code of the Feedback it got.
    feedback: int
    #: Zero.
    reserved: ctypes.Array[ctypes.c_uint8]

    _fields_ = [
        ("frame", ctypes.c_uint64),
        ("action", ctypes.c_uint8),
        ("feedback", ctypes.c_uint8),
        ("reserved", ctypes.c_uint8 * 6),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.PastStep"


class SegmentStep(ctypes.Structure):
    """One view of a retrieved segment and the expert's next action there."""

    #: The remembered view.
    frame: int
    #: Code of the Action the expert took there, or NO_ACTION for the last view of the segment, and
    #: for every view of a segment of images alone.
    action: int
    #: Zero.
    reserved: ctypes.Array[ctypes.c_uint8]

    _fields_ = [
        ("frame", ctypes.c_uint64),
        ("action", ctypes.c_uint8),
        ("reserved", ctypes.c_uint8 * 7),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.SegmentStep"


class TrajectoryStep(ctypes.Structure):
    """One step of a demonstration in a DocumentKind::Trajectories document: what the expert did,
    and the view it had there if that is a keyframe.
    """

    #: The view before the action, or NO_FRAME where it was not kept.
    frame: int
    #: Code of the Action the expert took there, or NO_ACTION at the end of the demonstration.
    action: int
    #: Which demonstration, from 0, in the order of the document.
    trajectory: int
    #: Zero.
    reserved: ctypes.Array[ctypes.c_uint8]

    _fields_ = [
        ("frame", ctypes.c_uint64),
        ("action", ctypes.c_uint8),
        ("trajectory", ctypes.c_uint8),
        ("reserved", ctypes.c_uint8 * 6),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.TrajectoryStep"


class FrameHeader(ctypes.Structure):
    """What travels with the pixels."""

    #: The frame's id.
    id: int
    #: Pixels in a row.
    width: int
    #: Rows.
    height: int
    #: First 16 bytes of the BLAKE3 hash of the pixels.
    content_hash: ctypes.Array[ctypes.c_uint8]

    _fields_ = [
        ("id", ctypes.c_uint64),
        ("width", ctypes.c_uint32),
        ("height", ctypes.c_uint32),
        ("content_hash", ctypes.c_uint8 * 16),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.FrameHeader"


class Page(ctypes.Structure):
    """One page of a frame: pixels, RGBA with 8 bits each, rows top to bottom without gaps."""

    #: Its part of the pixels; what is left of a frame's last page means nothing.
    pixels: ctypes.Array[ctypes.c_uint8]

    # Python looks at this from 3.13 on.
    _align_ = 4096

    _fields_ = [
        ("pixels", ctypes.c_uint8 * 4096),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.Page"


class DocumentHeader(ctypes.Structure):
    """What travels with a document's bytes."""

    #: The document's id.
    id: int
    #: Ticket of the episode it belongs to; 0: for the whole run.
    episode: int
    #: That episode's lane.
    lane: int
    #: Code of the DocumentKind.
    kind: int

    _fields_ = [
        ("id", ctypes.c_uint64),
        ("episode", ctypes.c_uint64),
        ("lane", ctypes.c_uint32),
        ("kind", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.DocumentHeader"


class StepCommand(ctypes.Structure):
    """Orchestrator to simulator: put a lane's agent somewhere, or let it act."""

    #: The episode's ticket.
    episode: int
    #: When the orchestrator sent it.
    sent_ns: int
    #: The lane.
    lane: int
    #: Steps taken once this command is done: 0 for a reset.
    step: int
    #: World variant: 0 is unchanged, 1 + case index has that case's passage closed.
    variant: int
    #: For a reset: where the agent starts. Otherwise ignored.
    start: WirePose
    #: A StepKind code.
    kind: int
    #: For an act: the Action code. Otherwise NO_ACTION.
    action: int
    #: 1 when the episode ends with this step: nothing is rendered, nobody decides any more.
    last: int
    #: Zero.
    reserved: ctypes.Array[ctypes.c_uint8]

    _fields_ = [
        ("episode", ctypes.c_uint64),
        ("sent_ns", ctypes.c_uint64),
        ("lane", ctypes.c_uint32),
        ("step", ctypes.c_uint32),
        ("variant", ctypes.c_uint32),
        ("start", WirePose),
        ("kind", ctypes.c_uint8),
        ("action", ctypes.c_uint8),
        ("last", ctypes.c_uint8),
        ("reserved", ctypes.c_uint8 * 5),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.StepCommand"


class Observation(ctypes.Structure):
    """Simulator to memory, policy and orchestrator: what is true after a step."""

    #: The episode's ticket.
    episode: int
    #: The agent's view; NO_FRAME when last is 1.
    frame: int
    #: When the command was sent.
    commanded_ns: int
    #: When the simulator took the command up.
    woken_ns: int
    #: When the dynamics were applied.
    stepped_ns: int
    #: When the view was there (at once, if it was rendered before).
    rendered_ns: int
    #: When this message was sent.
    sent_ns: int
    #: The lane.
    lane: int
    #: Steps taken so far.
    step: int
    #: Where the agent is.
    pose: WirePose
    #: Code of the Feedback to the last action.
    feedback: int
    #: Code of the last action, or NO_ACTION.
    action: int
    #: 1 when the episode is over: forget the lane.
    last: int
    #: Zero.
    reserved: int

    _fields_ = [
        ("episode", ctypes.c_uint64),
        ("frame", ctypes.c_uint64),
        ("commanded_ns", ctypes.c_uint64),
        ("woken_ns", ctypes.c_uint64),
        ("stepped_ns", ctypes.c_uint64),
        ("rendered_ns", ctypes.c_uint64),
        ("sent_ns", ctypes.c_uint64),
        ("lane", ctypes.c_uint32),
        ("step", ctypes.c_uint32),
        ("pose", WirePose),
        ("feedback", ctypes.c_uint8),
        ("action", ctypes.c_uint8),
        ("last", ctypes.c_uint8),
        ("reserved", ctypes.c_uint8),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.Observation"


class MemoryBrief(ctypes.Structure):
    """Orchestrator to memory, before a reset: whose memory the lane's next episode is given."""

    #: The episode's ticket.
    episode: int
    #: The lane.
    lane: int
    #: Index of the case.
    case: int
    #: Which demonstrations are remembered: bits 0 to 3 the case's own (original, opposite, nearby,
    #: distant), bit 4 its irrelevant histories, bit 5 its confusable ones.
    demonstrations: int
    #: Code of the Representation.
    representation: int
    #: Window length h, at most MAX_WINDOW.
    window: int
    #: Expert actions a retrieved segment follows, H_epi, less than MAX_SEGMENT.
    horizon: int
    #: Keyframes of full-context memory, shared by all its demonstrations.
    keyframes: int
    #: Code of the SegmentContent.
    segment: int
    #: Zero.
    reserved: ctypes.Array[ctypes.c_uint8]

    _fields_ = [
        ("episode", ctypes.c_uint64),
        ("lane", ctypes.c_uint32),
        ("case", ctypes.c_uint32),
        ("demonstrations", ctypes.c_uint32),
        ("representation", ctypes.c_uint8),
        ("window", ctypes.c_uint8),
        ("horizon", ctypes.c_uint8),
        ("keyframes", ctypes.c_uint8),
        ("segment", ctypes.c_uint8),
        ("reserved", ctypes.c_uint8 * 7),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.MemoryBrief"


class PolicyBrief(ctypes.Structure):
    """Orchestrator to policy, before a reset: what the lane's next episode asks for."""

    #: The episode's ticket.
    episode: int
    #: A policy that draws at random draws from this.
    seed: int
    #: The lane.
    lane: int
    #: Bytes of instruction in use.
    instruction_len: int
    #: Which repetition of the run this is, from 1: equal requests of one repetition are the same
    #: request.
    repeat: int
    #: 1 when the policy is told that the demonstration started where this episode starts.
    starts_as_demonstrated: int
    #: Zero.
    reserved: ctypes.Array[ctypes.c_uint8]
    #: The instruction, UTF-8.
    instruction: ctypes.Array[ctypes.c_uint8]

    _fields_ = [
        ("episode", ctypes.c_uint64),
        ("seed", ctypes.c_uint64),
        ("lane", ctypes.c_uint32),
        ("instruction_len", ctypes.c_uint32),
        ("repeat", ctypes.c_uint32),
        ("starts_as_demonstrated", ctypes.c_uint8),
        ("reserved", ctypes.c_uint8 * 3),
        ("instruction", ctypes.c_uint8 * 232),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.PolicyBrief"


class ViewRequest(ctypes.Structure):
    """Memory to simulator: make a view of the unchanged world resident, or let it go."""

    #: For a release: the frame. For a request: NO_FRAME.
    frame: int
    #: For a request: the view's pose.
    pose: WirePose
    #: A ViewRequestKind code.
    kind: int
    #: Zero.
    reserved: ctypes.Array[ctypes.c_uint8]

    _fields_ = [
        ("frame", ctypes.c_uint64),
        ("pose", WirePose),
        ("kind", ctypes.c_uint8),
        ("reserved", ctypes.c_uint8 * 3),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.ViewRequest"


class View(ctypes.Structure):
    """Simulator to memory: the requested view is resident and stays until it is released."""

    #: The view's frame.
    frame: int
    #: The pose that was asked for.
    pose: WirePose
    #: Zero.
    reserved: int

    _fields_ = [
        ("frame", ctypes.c_uint64),
        ("pose", WirePose),
        ("reserved", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.View"


class Eviction(ctypes.Structure):
    """Simulator to whoever holds frames: let this one go. No live lane or memory refers to it."""

    #: The frame.
    frame: int

    _fields_ = [
        ("frame", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.Eviction"


class Recall(ctypes.Structure):
    """Memory to policy: the window, and what was remembered for this step."""

    #: The episode's ticket.
    episode: int
    #: When the observation was taken up.
    received_ns: int
    #: When this message was sent.
    sent_ns: int
    #: The lane.
    lane: int
    #: The step it answers.
    step: int
    #: Cosine distance of the segment's first view to the current one; NaN without a segment.
    distance: float
    #: Entries of window in use, oldest first.
    window_len: int
    #: Entries of segment in use: 0 without a retrieval.
    segment_len: int
    #: Entries of documents in use.
    documents_len: int
    #: What is supplied beside window and segment, in order. A document is published before the
    #: first recall that names it.
    documents: ctypes.Array[ctypes.c_uint64]
    #: The last steps before the current one, oldest first.
    window: ctypes.Array[PastStep]
    #: The matched view, then the views that the expert's actions led to.
    segment: ctypes.Array[SegmentStep]

    _fields_ = [
        ("episode", ctypes.c_uint64),
        ("received_ns", ctypes.c_uint64),
        ("sent_ns", ctypes.c_uint64),
        ("lane", ctypes.c_uint32),
        ("step", ctypes.c_uint32),
        ("distance", ctypes.c_float),
        ("window_len", ctypes.c_uint32),
        ("segment_len", ctypes.c_uint32),
        ("documents_len", ctypes.c_uint32),
        ("documents", ctypes.c_uint64 * 4),
        ("window", PastStep * 32),
        ("segment", SegmentStep * 32),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.Recall"


class RecallTrace(ctypes.Structure):
    """Memory to orchestrator, with every recall: where it came from and what it cost."""

    #: The episode's ticket.
    episode: int
    #: When the observation was taken up.
    received_ns: int
    #: When the embeddings that the answer needs were there: the current view's and, in an episode's
    #: first steps, those of the demonstrations.
    embedded_ns: int
    #: When the nearest view was found.
    searched_ns: int
    #: When the recall was put together.
    assembled_ns: int
    #: When the recall was sent.
    sent_ns: int
    #: The lane.
    lane: int
    #: The step.
    step: int
    #: Case whose demonstration was matched, or NOT_MEASURED without a retrieval.
    case: int
    #: Which of its demonstrations (0 original, 1 opposite, 2 nearby, 3 distant).
    demonstration: int
    #: Step of the matched view in it.
    index: int
    #: Cosine distance of the match; NaN without one.
    distance: float
    #: Zero.
    reserved: int

    _fields_ = [
        ("episode", ctypes.c_uint64),
        ("received_ns", ctypes.c_uint64),
        ("embedded_ns", ctypes.c_uint64),
        ("searched_ns", ctypes.c_uint64),
        ("assembled_ns", ctypes.c_uint64),
        ("sent_ns", ctypes.c_uint64),
        ("lane", ctypes.c_uint32),
        ("step", ctypes.c_uint32),
        ("case", ctypes.c_uint32),
        ("demonstration", ctypes.c_uint16),
        ("index", ctypes.c_uint16),
        ("distance", ctypes.c_float),
        ("reserved", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.RecallTrace"


class Pulse(ctypes.Structure):
    """Anyone to orchestrator, about once a second while it changes: what the sender is at. Memory
    is at work as long as done grows, however long an answer takes: where nothing is cached, the
    views of many lanes' demonstrations do take long.
    """

    #: Code of the sender's Role.
    role: int
    #: Zero.
    reserved: int
    #: Work done since the sender started: views drawn, images embedded, requests answered.
    done: int
    #: Work that is known to wait: views to draw, images to embed, requests to answer.
    waiting: int
    #: Frames that are resident (simulator), held for memories (memory) or held (policy).
    held: int
    #: How many there may be; 0 where nothing bounds it.
    room: int

    _fields_ = [
        ("role", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("done", ctypes.c_uint64),
        ("waiting", ctypes.c_uint64),
        ("held", ctypes.c_uint64),
        ("room", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.Pulse"


class Decision(ctypes.Structure):
    """Policy to orchestrator: what to do. Counts that nobody told are NOT_MEASURED."""

    #: The episode's ticket.
    episode: int
    #: When observation and recall were both there.
    received_ns: int
    #: When the policy began to decide.
    started_ns: int
    #: When the prompt was built; 0 where none is.
    prompted_ns: int
    #: When the request went to a model's server, the last time if it went several times; 0 where
    #: none did.
    sent_ns: int
    #: When it had decided.
    decided_ns: int
    #: The lane.
    lane: int
    #: The step it answers.
    step: int
    #: Tokens of the prompt.
    prompt_tokens: int
    #: Tokens of the completion.
    completion_tokens: int
    #: Tokens of the prompt that the server had computed before and took from its own cache.
    cached_tokens: int
    #: Tokens of the prompt's images.
    image_tokens: int
    #: Tokens of the prompt that are injected memory, an estimate.
    memory_tokens: int
    #: Images that the request held.
    images_asked: int
    #: Images that the policy was shown: fewer where its budget is smaller.
    images: int
    #: Requests to a model's server that this decision took, failed ones included.
    attempts: int
    #: An Outcome code.
    outcome: int
    #: Code of the action when the outcome is Outcome::Acted, otherwise NO_ACTION.
    action: int
    #: 1 when the reply was one that had been kept from an earlier request: it cost nothing this
    #: time.
    replayed: int
    #: Zero.
    reserved: ctypes.Array[ctypes.c_uint8]

    _fields_ = [
        ("episode", ctypes.c_uint64),
        ("received_ns", ctypes.c_uint64),
        ("started_ns", ctypes.c_uint64),
        ("prompted_ns", ctypes.c_uint64),
        ("sent_ns", ctypes.c_uint64),
        ("decided_ns", ctypes.c_uint64),
        ("lane", ctypes.c_uint32),
        ("step", ctypes.c_uint32),
        ("prompt_tokens", ctypes.c_uint32),
        ("completion_tokens", ctypes.c_uint32),
        ("cached_tokens", ctypes.c_uint32),
        ("image_tokens", ctypes.c_uint32),
        ("memory_tokens", ctypes.c_uint32),
        ("images_asked", ctypes.c_uint32),
        ("images", ctypes.c_uint32),
        ("attempts", ctypes.c_uint32),
        ("outcome", ctypes.c_uint8),
        ("action", ctypes.c_uint8),
        ("replayed", ctypes.c_uint8),
        ("reserved", ctypes.c_uint8 * 21),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.Decision"


class Hello(ctypes.Structure):
    """Anyone to orchestrator, once, when ready to work."""

    #: WIRE_VERSION the sender was built with.
    wire_version: int
    #: Code of its Role.
    role: int
    #: Its process id.
    pid: int
    #: Bytes of facts in use.
    facts_len: int
    #: A JSON object of strings for the manifest: adapter, frame path, encoder, policy, ...
    facts: ctypes.Array[ctypes.c_uint8]

    _fields_ = [
        ("wire_version", ctypes.c_uint32),
        ("role", ctypes.c_uint32),
        ("pid", ctypes.c_uint32),
        ("facts_len", ctypes.c_uint32),
        ("facts", ctypes.c_uint8 * 496),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.Hello"


class Complaint(ctypes.Structure):
    """Anyone to orchestrator: what went wrong, and what follows from it (ComplaintKind)."""

    #: For a ComplaintKind::Episode: the episode's ticket. Otherwise 0.
    episode: int
    #: Code of the sender's Role.
    role: int
    #: Complaints the sender has made so far, this one included.
    count: int
    #: Code of the ComplaintKind.
    kind: int
    #: For a ComplaintKind::Episode: the episode's lane. Otherwise 0.
    lane: int
    #: Bytes of text in use.
    text_len: int
    #: Zero.
    reserved: int
    #: What, which value, what was expected; UTF-8.
    text: ctypes.Array[ctypes.c_uint8]

    _fields_ = [
        ("episode", ctypes.c_uint64),
        ("role", ctypes.c_uint32),
        ("count", ctypes.c_uint32),
        ("kind", ctypes.c_uint32),
        ("lane", ctypes.c_uint32),
        ("text_len", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("text", ctypes.c_uint8 * 480),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.Complaint"


class Farewell(ctypes.Structure):
    """Anyone to orchestrator, once, after Stop: what the sender did with frames."""

    #: Code of the sender's Role.
    role: int
    #: Zero.
    reserved: int
    #: Frames rendered into the store (simulator only).
    frames_rendered: int
    #: Frames evicted from the store (simulator only).
    frames_evicted: int
    #: Frames that this process took hold of (memory and policy).
    frames_held: int
    #: Bytes of pixels that the sender's own code copied on their way to another process.
    pixel_bytes_copied: int
    #: Messages that could not be used.
    complaints: int

    _fields_ = [
        ("role", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("frames_rendered", ctypes.c_uint64),
        ("frames_evicted", ctypes.c_uint64),
        ("frames_held", ctypes.c_uint64),
        ("pixel_bytes_copied", ctypes.c_uint64),
        ("complaints", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.Farewell"


class Stop(ctypes.Structure):
    """Orchestrator to everyone: finish, send a Farewell, exit."""

    #: Zero.
    reserved: int

    _fields_ = [
        ("reserved", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name() -> str:
        """The name that iceoryx2 knows it by."""
        return "memtransfer.Stop"


class Service(NamedTuple):
    """A message's way through the run."""

    #: Last part of the service's name; the generation and a slash come before it.
    name: str
    #: Who sends the message.
    senders: tuple[Role, ...]
    #: Who receives it: each of them gets every one.
    receivers: tuple[Role, ...]
    #: What bounds the queue: "lanes", "frames" or "few"; see queue_len().
    traffic: str


#: Every message's service.
SERVICES: dict[type[ctypes.Structure], Service] = {
    StepCommand: Service(
        "command",
        (Role.ORCHESTRATOR,),
        (Role.SIM,),
        "lanes",
    ),
    Observation: Service(
        "observation",
        (Role.SIM,),
        (Role.MEMORY, Role.POLICY, Role.ORCHESTRATOR,),
        "lanes",
    ),
    MemoryBrief: Service(
        "memory-brief",
        (Role.ORCHESTRATOR,),
        (Role.MEMORY,),
        "lanes",
    ),
    PolicyBrief: Service(
        "policy-brief",
        (Role.ORCHESTRATOR,),
        (Role.POLICY,),
        "lanes",
    ),
    ViewRequest: Service(
        "view-request",
        (Role.MEMORY,),
        (Role.SIM,),
        "frames",
    ),
    View: Service(
        "view",
        (Role.SIM,),
        (Role.MEMORY,),
        "frames",
    ),
    Eviction: Service(
        "eviction",
        (Role.SIM,),
        (Role.MEMORY, Role.POLICY,),
        "frames",
    ),
    Recall: Service(
        "recall",
        (Role.MEMORY,),
        (Role.POLICY,),
        "lanes",
    ),
    RecallTrace: Service(
        "recall-trace",
        (Role.MEMORY,),
        (Role.ORCHESTRATOR,),
        "lanes",
    ),
    Pulse: Service(
        "pulse",
        (Role.SIM, Role.MEMORY, Role.POLICY,),
        (Role.ORCHESTRATOR,),
        "few",
    ),
    Decision: Service(
        "decision",
        (Role.POLICY,),
        (Role.ORCHESTRATOR,),
        "lanes",
    ),
    Hello: Service(
        "hello",
        (Role.SIM, Role.MEMORY, Role.POLICY,),
        (Role.ORCHESTRATOR,),
        "few",
    ),
    Complaint: Service(
        "complaint",
        (Role.SIM, Role.MEMORY, Role.POLICY,),
        (Role.ORCHESTRATOR,),
        "few",
    ),
    Farewell: Service(
        "farewell",
        (Role.SIM, Role.MEMORY, Role.POLICY,),
        (Role.ORCHESTRATOR,),
        "few",
    ),
    Stop: Service(
        "stop",
        (Role.ORCHESTRATOR,),
        (Role.SIM, Role.MEMORY, Role.POLICY,),
        "few",
    ),
}


def frame_chunks(frame_capacity: int, lanes: int) -> int:
    """Chunks of the frame store: what a consumer must be able to hold and to have waiting."""
    return frame_capacity + MAX_LOANED_FRAMES + frame_capacity // 8 + lanes + 16


def queue_len(traffic: str, frame_capacity: int, lanes: int) -> int:
    """Messages that can wait for one receiver: what every peer has to make room for."""
    if traffic == "lanes":
        return 2 * lanes + 16
    if traffic == "frames":
        return 2 * frame_chunks(frame_capacity, lanes)
    if traffic == "few":
        return 256
    raise ValueError(f"{traffic!r} is not a kind of traffic")


def document_queue_len(lanes: int) -> int:
    """Documents that can wait for the policy."""
    return 2 * lanes + 64


# Bytes and field offsets, as the Rust compiler lays them out.
_LAYOUTS: dict[type[ctypes.Structure], tuple[int, dict[str, int]]] = {
    WirePose: (
        4,
        {
            "x": 0,
            "y": 1,
            "heading": 2,
            "reserved": 3,
        },
    ),
    PastStep: (
        16,
        {
            "frame": 0,
            "action": 8,
            "feedback": 9,
            "reserved": 10,
        },
    ),
    SegmentStep: (
        16,
        {
            "frame": 0,
            "action": 8,
            "reserved": 9,
        },
    ),
    TrajectoryStep: (
        16,
        {
            "frame": 0,
            "action": 8,
            "trajectory": 9,
            "reserved": 10,
        },
    ),
    FrameHeader: (
        32,
        {
            "id": 0,
            "width": 8,
            "height": 12,
            "content_hash": 16,
        },
    ),
    Page: (
        4096,
        {
            "pixels": 0,
        },
    ),
    DocumentHeader: (
        24,
        {
            "id": 0,
            "episode": 8,
            "lane": 16,
            "kind": 20,
        },
    ),
    StepCommand: (
        40,
        {
            "episode": 0,
            "sent_ns": 8,
            "lane": 16,
            "step": 20,
            "variant": 24,
            "start": 28,
            "kind": 32,
            "action": 33,
            "last": 34,
            "reserved": 35,
        },
    ),
    Observation: (
        72,
        {
            "episode": 0,
            "frame": 8,
            "commanded_ns": 16,
            "woken_ns": 24,
            "stepped_ns": 32,
            "rendered_ns": 40,
            "sent_ns": 48,
            "lane": 56,
            "step": 60,
            "pose": 64,
            "feedback": 68,
            "action": 69,
            "last": 70,
            "reserved": 71,
        },
    ),
    MemoryBrief: (
        32,
        {
            "episode": 0,
            "lane": 8,
            "case": 12,
            "demonstrations": 16,
            "representation": 20,
            "window": 21,
            "horizon": 22,
            "keyframes": 23,
            "segment": 24,
            "reserved": 25,
        },
    ),
    PolicyBrief: (
        264,
        {
            "episode": 0,
            "seed": 8,
            "lane": 16,
            "instruction_len": 20,
            "repeat": 24,
            "starts_as_demonstrated": 28,
            "reserved": 29,
            "instruction": 32,
        },
    ),
    ViewRequest: (
        16,
        {
            "frame": 0,
            "pose": 8,
            "kind": 12,
            "reserved": 13,
        },
    ),
    View: (
        16,
        {
            "frame": 0,
            "pose": 8,
            "reserved": 12,
        },
    ),
    Eviction: (
        8,
        {
            "frame": 0,
        },
    ),
    Recall: (
        1104,
        {
            "episode": 0,
            "received_ns": 8,
            "sent_ns": 16,
            "lane": 24,
            "step": 28,
            "distance": 32,
            "window_len": 36,
            "segment_len": 40,
            "documents_len": 44,
            "documents": 48,
            "window": 80,
            "segment": 592,
        },
    ),
    RecallTrace: (
        72,
        {
            "episode": 0,
            "received_ns": 8,
            "embedded_ns": 16,
            "searched_ns": 24,
            "assembled_ns": 32,
            "sent_ns": 40,
            "lane": 48,
            "step": 52,
            "case": 56,
            "demonstration": 60,
            "index": 62,
            "distance": 64,
            "reserved": 68,
        },
    ),
    Pulse: (
        40,
        {
            "role": 0,
            "reserved": 4,
            "done": 8,
            "waiting": 16,
            "held": 24,
            "room": 32,
        },
    ),
    Decision: (
        112,
        {
            "episode": 0,
            "received_ns": 8,
            "started_ns": 16,
            "prompted_ns": 24,
            "sent_ns": 32,
            "decided_ns": 40,
            "lane": 48,
            "step": 52,
            "prompt_tokens": 56,
            "completion_tokens": 60,
            "cached_tokens": 64,
            "image_tokens": 68,
            "memory_tokens": 72,
            "images_asked": 76,
            "images": 80,
            "attempts": 84,
            "outcome": 88,
            "action": 89,
            "replayed": 90,
            "reserved": 91,
        },
    ),
    Hello: (
        512,
        {
            "wire_version": 0,
            "role": 4,
            "pid": 8,
            "facts_len": 12,
            "facts": 16,
        },
    ),
    Complaint: (
        512,
        {
            "episode": 0,
            "role": 8,
            "count": 12,
            "kind": 16,
            "lane": 20,
            "text_len": 24,
            "reserved": 28,
            "text": 32,
        },
    ),
    Farewell: (
        48,
        {
            "role": 0,
            "reserved": 4,
            "frames_rendered": 8,
            "frames_evicted": 16,
            "frames_held": 24,
            "pixel_bytes_copied": 32,
            "complaints": 40,
        },
    ),
    Stop: (
        8,
        {
            "reserved": 0,
        },
    ),
}

for _struct, (_bytes, _offsets) in _LAYOUTS.items():
    assert ctypes.sizeof(_struct) == _bytes, _struct
    for _field, _offset in _offsets.items():
        assert getattr(_struct, _field).offset == _offset, (_struct, _field)

# Queues of some runs, as the Rust code has them: frames, lanes, length.
assert queue_len("lanes", 1536, 1) == 18
assert queue_len("frames", 1536, 1) == 3554
assert queue_len("few", 1536, 1) == 256
assert document_queue_len(1) == 66
assert queue_len("lanes", 100, 64) == 144
assert queue_len("frames", 100, 64) == 448
assert queue_len("few", 100, 64) == 256
assert document_queue_len(64) == 192
