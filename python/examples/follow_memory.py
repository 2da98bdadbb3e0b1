from memtransfer import Action, Feedback, Policy, run

class FollowMemory(Policy):
    name = "follow-memory"

    def act(self, batch):  # one request for each lane that waits for an action
        return [self.decide(request) for request in batch]

    def decide(self, request):
        if request.feedback == Feedback.BLOCKED:
            return Action.TURN_LEFT
        expert = request.segment and request.segment.steps[0].action
        return expert or Action.FORWARD

run(FollowMemory())
