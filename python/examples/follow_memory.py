"""Does what the expert did in the nearest segment that memory has retrieved. Start a run with it:

    evaluate(policy=FollowMemory(), memory=["working", "episodic"], limit=5, out="runs/follow")

in Python, or in the shell:

    memtransfer run --policy-cmd "python follow_memory.py"
"""

from collections.abc import Sequence

from memtransfer import Action, Answer, Feedback, Policy, Request, run


class FollowMemory(Policy):
    name = "follow-memory"

    def act(self, batch: Sequence[Request]) -> Sequence[Answer]:  # one request for each lane that waits for an action
        return [self.decide(request) for request in batch]

    def decide(self, request: Request) -> Answer:
        if request.feedback == Feedback.BLOCKED:
            return Action.TURN_LEFT
        expert = request.segment and request.segment.steps[0].action
        return expert or Action.FORWARD


if __name__ == "__main__":
    run(FollowMemory())
