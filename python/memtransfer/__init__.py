"""Policies, memories and worlds for MemTransfer in Python, and the results of runs.

    from memtransfer import Action, Policy, evaluate

    class AlwaysForward(Policy):
        name = "always-forward"

        def act(self, batch):
            return [Action.FORWARD for request in batch]

    result = evaluate(policy=AlwaysForward(), memory="working", limit=10, out="runs/forward")

`evaluate` starts a run with objects of this process, `memtransfer.evaluation` explains how; `run` serves a run that the shell has started.
`memtransfer.prompt` renders the benchmark's own prompt and reads a model's answers; `memtransfer.results` reads
the folder of a run. `Memory` is a memory of your own. `gymnasium.make("memtransfer.gym:MemTransfer-v0")`
makes an environment. `memtransfer.world` is for a world of your own. The guides are `docs/python.md`, `docs/memory.md` and
`docs/gymnasium.md` of the project.
"""

from typing import TYPE_CHECKING, Any

from memtransfer._native import Frame, __version__
from memtransfer.codes import Action, DocumentKind, Feedback, Heading, Outcome
from memtransfer.declaration import Pose, WorldDeclaration
from memtransfer.errors import (
    AttachError,
    BusError,
    FrameGone,
    MemTransferError,
    PolicyError,
    PromptLogError,
    RunError,
    WorldError,
)
from memtransfer.memory import (
    Demonstration,
    DemonstrationStep,
    Episode,
    EpisodeEnd,
    Memory,
    MemoryItem,
    Plan,
    Query,
    RecentStep,
    Source,
    Steps,
    Text,
    View,
)
from memtransfer.policy import Policy
from memtransfer.request import (
    Answer,
    Decision,
    Document,
    Exchange,
    Failed,
    Item,
    PastStep,
    PlannedActions,
    RememberedStep,
    RememberedView,
    Request,
    Segment,
    SuppliedPlan,
    Trajectory,
    Usage,
)
from memtransfer.serving import run, serve

if TYPE_CHECKING:
    from memtransfer.evaluation import Comparison, Result, evaluate

EMPTY = Outcome.EMPTY
REFUSED = Outcome.REFUSED
CUT_OFF = Outcome.CUT_OFF
UNREADABLE = Outcome.UNREADABLE

__all__ = [
    "CUT_OFF",
    "EMPTY",
    "REFUSED",
    "UNREADABLE",
    "Action",
    "Answer",
    "AttachError",
    "BusError",
    "Comparison",
    "Decision",
    "Demonstration",
    "DemonstrationStep",
    "Document",
    "DocumentKind",
    "Episode",
    "EpisodeEnd",
    "Exchange",
    "Failed",
    "Feedback",
    "Frame",
    "FrameGone",
    "Heading",
    "Item",
    "MemTransferError",
    "Memory",
    "MemoryItem",
    "Outcome",
    "PastStep",
    "Plan",
    "PlannedActions",
    "Policy",
    "PolicyError",
    "Pose",
    "PromptLogError",
    "Query",
    "RecentStep",
    "RememberedStep",
    "RememberedView",
    "Request",
    "Result",
    "RunError",
    "Segment",
    "Source",
    "Steps",
    "SuppliedPlan",
    "Text",
    "Trajectory",
    "Usage",
    "View",
    "WorldDeclaration",
    "WorldError",
    "__version__",
    "evaluate",
    "run",
    "serve",
]


def __getattr__(name: str) -> Any:
    # What starts runs needs more of the standard library than what serves them: imported when it is used.
    if name in ("Comparison", "Result", "evaluate"):
        from memtransfer import evaluation

        return getattr(evaluation, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
