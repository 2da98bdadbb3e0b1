"""Write a policy for MemTransfer in Python, and read the results of runs.

    from memtransfer import Action, Policy, run

    class Mine(Policy):
        name = "mine"

        def act(self, batch):
            return [Action.FORWARD for request in batch]

    run(Mine())

`docs/python.md` of the project is the guide. `memtransfer.prompt` renders the harness's own prompt,
`memtransfer.results` reads a run's folder.
"""

from typing import TYPE_CHECKING, Any

from memtransfer._frames import Frame
from memtransfer._wire import Action, DocumentKind, Feedback, Heading, Outcome
from memtransfer.errors import (
    AttachError,
    BusError,
    FrameGone,
    MemTransferError,
    PolicyError,
    PromptLogError,
)
from memtransfer.policy import Policy
from memtransfer.request import (
    Answer,
    Decision,
    DemonstrationStep,
    Document,
    Exchange,
    Failed,
    PastStep,
    Pose,
    RememberedStep,
    Request,
    Segment,
    Trajectory,
    Usage,
)

if TYPE_CHECKING:
    from memtransfer._serve import run, serve

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
    "DemonstrationStep",
    "Document",
    "DocumentKind",
    "Exchange",
    "Failed",
    "Feedback",
    "Frame",
    "FrameGone",
    "Heading",
    "MemTransferError",
    "Outcome",
    "PastStep",
    "Policy",
    "PolicyError",
    "Pose",
    "PromptLogError",
    "RememberedStep",
    "Request",
    "Segment",
    "Trajectory",
    "Usage",
    "run",
    "serve",
]


def __getattr__(name: str) -> Any:
    """`run` and `serve` load the transport, which whoever only reads results does without."""
    if name in ("run", "serve"):
        from memtransfer import _serve

        return getattr(_serve, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
