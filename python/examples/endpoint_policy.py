"""Asks a vision-language model behind an OpenAI-compatible endpoint, with the benchmark's own prompt.

    export OPENAI_BASE_URL=http://localhost:8000/v1 OPENAI_API_KEY=...
    memtransfer run --policy-cmd "python endpoint_policy.py MODEL"

A small version of `--policy openai`, as a start for a policy of your own: another prompt, another model, a chain of
calls. Use `--image-budget 0` for text-only models. Needs `pip install openai`.
"""

import argparse
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from openai import OpenAI, OpenAIError

from memtransfer import Answer, Decision, Exchange, Failed, Outcome, Policy, Request, Usage, run
from memtransfer.prompt import IMAGE_BUDGET, SETTINGS, VERSION, read_answer, render


class Endpoint(Policy):
    name = "endpoint-python"

    def __init__(self, model: str, image_budget: int) -> None:
        self.model = model
        self.image_budget = image_budget
        # Reads OPENAI_BASE_URL and OPENAI_API_KEY, and retries after status 429.
        self.client = OpenAI(timeout=60, max_retries=4)
        self.threads = ThreadPoolExecutor(max_workers=64)

    def facts(self) -> Mapping[str, str]:
        return {"model": self.model, "prompt": VERSION}

    def act(self, batch: Sequence[Request]) -> Sequence[Answer]:
        # The requests of all lanes are in flight together.
        return list(self.threads.map(self.ask, batch))

    def ask(self, request: Request) -> Answer:
        prompt = render(request, self.image_budget)
        messages = prompt.messages()
        sent_ns = time.monotonic_ns()
        try:
            reply = self.client.chat.completions.create(
                model=self.model, messages=messages, stream=False, **SETTINGS
            )
        except OpenAIError as error:
            # Not the model's mistake: the episode is not scored, and the same command runs it again.
            return Failed(f"{type(error).__name__}: {error}", exchange=Exchange(messages))
        used, choice = reply.usage, reply.choices[0]
        usage = Usage(
            prompt_tokens=used.prompt_tokens if used else None,
            completion_tokens=used.completion_tokens if used else None,
            sent_ns=sent_ns,
            finish_reason=choice.finish_reason,
            model=reply.model,
        )
        text = choice.message.content or ""
        answer = read_answer(text, choice.finish_reason == "length", request.world)
        # Stored with `--log-prompts`, for `memtransfer show`.
        if isinstance(answer, Outcome):
            exchange = Exchange(messages, text, unread=answer.words)
            return Decision(None, answer, prompt.images_sent, usage, exchange)
        return Decision(answer, Outcome.ACTED, prompt.images_sent, usage, Exchange(messages, text))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("model", help="the model's name on the server")
    parser.add_argument("--image-budget", type=int, default=IMAGE_BUDGET, metavar="N")
    arguments = parser.parse_args()
    run(Endpoint(arguments.model, arguments.image_budget))


if __name__ == "__main__":
    main()
