"""Policies for MemTransfer in Python, and the results of runs.

    from memtransfer import Action, Policy, run

    class AlwaysForward(Policy):
        name = "always-forward"

        def act(self, batch):
            return [Action.FORWARD for request in batch]

    run(AlwaysForward())

`memtransfer.prompt` renders the benchmark's own prompt and reads a model's answers; `memtransfer.results` reads
the folder of a run. The guide is `docs/python.md` of the project.
"""

from memtransfer._native import Frame
from memtransfer.codes import Action, DocumentKind, Feedback, Heading, Outcome
from memtransfer.errors import (
    AttachError,
    BusError,
    FrameGone,
    MemTransferError,
    PolicyError,
    PromptLogError,
)
from memtransfer.policy import Policy, run, serve
from memtransfer.request import (
    Answer,
    Decision,
    Document,
    Exchange,
    Failed,
    Item,
    PastStep,
    Pose,
    RememberedStep,
    RememberedView,
    Request,
    Segment,
    Trajectory,
    Usage,
)

EMPTY = Outcome.EMPTY
REFUSED = Outcome.REFUSED
UNREADABLE = Outcome.UNREADABLE

__all__ = [
    "EMPTY",
    "REFUSED",
    "UNREADABLE",
    "Action",
    "Answer",
    "AttachError",
    "BusError",
    "Decision",
    "Document",
    "DocumentKind",
    "Exchange",
    "Failed",
    "Feedback",
    "Frame",
    "FrameGone",
    "Heading",
    "Item",
    "MemTransferError",
    "Outcome",
    "PastStep",
    "Policy",
    "PolicyError",
    "Pose",
    "PromptLogError",
    "RememberedStep",
    "RememberedView",
    "Request",
    "Segment",
    "Trajectory",
    "Usage",
    "run",
    "serve",
]
