"""Does what memory plans, and checks that it is worded in the prompt."""

from memtransfer import Action, Decision, Policy, PlannedActions, prompt, run


class Planned(Policy):
    name = "planned"

    def act(self, batch):
        return [self.decide(request) for request in batch]

    def decide(self, request):
        if not request.plans:
            return Decision(Action.TURN_LEFT)
        (plan,) = request.plans
        (item,) = request.items
        assert item.parts == plan.parts and all(isinstance(part, PlannedActions) for part in plan.parts)
        assert plan.actions == tuple(action for part in plan.parts for action in part.actions)
        assert all(isinstance(action, Action) for action in plan.actions)
        assert request.images() == 1 + len(request.window)
        text = "".join(part.text or "" for part in prompt.render(request).parts)
        for part in plan.parts:
            assert (part.instruction or "the memory's own") in text, text
        return plan.actions[0]


run(Planned())
